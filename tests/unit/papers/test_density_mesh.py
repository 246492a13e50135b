"""The surface of a splat's density: closed, oriented outward, and at the level."""

import numpy as np
import pytest

from alula.schemas.errors import InputError
from alula.schemas.parameters.configs.voxelize import VoxelizeConfig
from alula.stages.compression.voxelize import voxelize
from papers.polymerge.density_mesh import density_mesh, level_set, simplified
from support.scenes.small_scenes import ball_scene


def closed(triangle, corners):
    """Whether each directed edge has its reverse, once."""
    edges = np.concatenate([triangle[:, [0, 1]], triangle[:, [1, 2]], triangle[:, [2, 0]]])
    forward, backward = (np.sort(e[:, 0] * corners + e[:, 1]) for e in (edges, edges[:, ::-1]))
    return (forward == backward).all() and len(np.unique(forward)) == len(forward)


def volume(corner, triangle):
    a, b, c = (corner[triangle[:, i]] for i in range(3))
    return float((np.cross(b - a, c - a) * a).sum() / 6)


@pytest.mark.parametrize("seed", range(3))
def test_the_level_set_of_any_grid_is_closed_and_encloses_a_positive_volume(seed):
    values = np.zeros((9, 8, 7), np.float32)
    values[1:-1, 1:-1, 1:-1] = np.random.default_rng(seed).random((7, 6, 5))
    corner, triangle = level_set(values, 0.5)
    assert closed(triangle, len(corner))
    assert 0 < volume(corner, triangle) < 7 * 6 * 5


@pytest.mark.slow  # open3d takes seconds to import
def test_the_level_set_of_a_distance_is_a_sphere_also_simplified():
    node = np.indices((24, 24, 24)).astype(float)
    centre = np.array([11.3, 11.7, 11.1])
    distance = np.sqrt(((node - centre[:, None, None, None]) ** 2).sum(axis=0))
    corner, triangle = level_set((8 - distance).astype(np.float32), 0.0)
    assert np.linalg.norm(corner - centre, axis=1) == pytest.approx(8, abs=0.05)
    assert volume(corner, triangle) == pytest.approx(4 / 3 * np.pi * 8**3, rel=0.02)
    coarse_corner, coarse = simplified(corner, triangle, 400)
    assert len(coarse) <= 400
    assert volume(coarse_corner, coarse) == pytest.approx(4 / 3 * np.pi * 8**3, rel=0.05)


def test_no_value_above_the_level_is_no_surface():
    assert [len(a) for a in level_set(np.zeros((4, 4, 4), np.float32), 0.5)] == [0, 0]


def test_the_surface_of_one_gaussian_lies_at_the_level_of_its_widened_density():
    radius, size, opacity, level = 0.5, 0.05, 0.9, 0.3
    scene = ball_scene([(0.3, -0.2, 0.1)], radius)
    opacity = float(scene["opacity"][0])
    voxels = voxelize(VoxelizeConfig(size_m=size, sigma=2.0), scene)
    corner, triangle = density_mesh(scene, voxels, level=level)
    assert closed(triangle, len(corner))
    sigma = np.sqrt(radius**2 + (size / 2) ** 2)
    expected = sigma * np.sqrt(2 * np.log(opacity / level))
    found = np.linalg.norm(corner * size - (0.3, -0.2, 0.1), axis=1)
    assert found == pytest.approx(expected, abs=0.05 * size)
    assert volume(corner * size, triangle) == pytest.approx(4 / 3 * np.pi * expected**3, rel=0.01)


def test_gaussians_far_from_every_occupied_voxel_have_no_surface():
    both = ball_scene([(0, 0, 0), (3, 0, 0)], 0.2)
    one = voxelize(VoxelizeConfig(size_m=0.1, sigma=2.0), ball_scene([(0, 0, 0)], 0.2))
    corner, _ = density_mesh(both, one)
    assert len(corner)
    assert np.abs(corner).max() < 1 / 0.1


def test_a_scene_without_voxels_or_with_too_large_a_grid_is_refused(monkeypatch):
    scene = ball_scene([(0, 0, 0)], 0.2)
    voxels = voxelize(VoxelizeConfig(size_m=0.1), scene)
    monkeypatch.setattr("papers.polymerge.density_mesh.MAX_NODES", 10)
    with pytest.raises(InputError, match="too large"):
        density_mesh(scene, voxels)
