"""The built-in scene: its contents, and the recovery of its frame."""

import hashlib

import numpy as np
import pytest

from alula.schemas.errors import UsageError
from alula.schemas.parameters.configs.demo_scene import DemoSceneConfig
from alula.schemas.parameters.configs.import_splat import ImportSplatConfig
from alula.stages.alignment.robust import fit_similarity
from alula.stages.alignment.similarity import transform_points
from alula.stages.reconstruction.demo_cameras import colmap_model, demo_cameras, positions_csv
from alula.stages.reconstruction.demo_scene import demo_scene, scene_from_world, world_from_scene
from alula.stages.reconstruction.formats.ply import encode_ply
from alula.stages.reconstruction.import_splat import import_splat
from alula.stages.reconstruction.room import HOOPS, SIZE, hoop_centres, room
from alula.stages.reconstruction.surfaces import box, disc, sphere, torus, tube
from alula.stages.rotation import matrix_from_quat_wxyz


@pytest.fixture(scope="module")
def splats():
    return demo_scene(DemoSceneConfig(), 0)


@pytest.fixture(scope="module")
def world(splats):
    return transform_points(world_from_scene(), splats.mean)


def digest(splats):
    return hashlib.sha256(b"".join(encode_ply(splats))).hexdigest()


def test_equal_seeds_give_equal_bytes_and_others_do_not():
    config = DemoSceneConfig(gaussians=3000)
    assert digest(demo_scene(config, 7)) == digest(demo_scene(config, 7))
    assert digest(demo_scene(config, 7)) != digest(demo_scene(config, 8))


@pytest.mark.parametrize("count", [2000, 2001, 54321])
def test_the_count_is_as_asked(count):
    assert len(demo_scene(DemoSceneConfig(gaussians=count), 1)) == count


@pytest.mark.parametrize("wrong", [{"gaussians": 1999}, {"images": 3}])
def test_unreasonable_counts_are_refused(wrong):
    with pytest.raises(UsageError):
        DemoSceneConfig(**wrong)


def test_the_room_is_the_world_box(splats, world):
    assert len(splats) == 200_000
    np.testing.assert_allclose(world.min(0), 0, atol=0.02)
    np.testing.assert_allclose(world.max(0), SIZE, atol=0.02)
    for axis, size in enumerate(SIZE):  # floor, ceiling and all walls are covered: no 25 cm square is empty
        others = [i for i in range(3) if i != axis]
        for level in (0.0, size):
            near = world[(np.abs(world[:, axis] - level) < 0.02) & (splats.opacity > 0.1)][:, others]
            cells = np.unique(np.floor(near / 0.25).astype(int).clip(0), axis=0)
            assert len(cells) >= np.prod([round(SIZE[i] / 0.25) for i in others])


def test_gaussians_are_like_those_of_a_training_run(splats):
    metres = np.sort(splats.scale / 0.37, axis=1)
    assert metres[:, 0].min() > 0.0004
    assert np.quantile(metres[:, 0], 0.97) < 0.0025
    assert 0.005 < np.median(metres[:, 2]) < 0.02
    assert (metres[:, 2] > 10 * metres[:, 1]).mean() > 0.0005  # needles
    assert (splats.opacity > 0.5).mean() > 0.85
    assert 0.02 < (splats.opacity < 0.1).mean() < 0.08
    norm = np.linalg.norm(splats.quat_wxyz, axis=1)
    assert norm.min() < 0.65
    assert norm.max() > 1.35
    assert len(np.unique(splats.color, axis=0)) > 1000


def test_gaussians_lie_flat_on_the_floor(splats, world):
    quat = splats.quat_wxyz / np.linalg.norm(splats.quat_wxyz, axis=1, keepdims=True)
    floor = (np.abs(world[:, 2]) < 0.003) & (world[:, 0] > 6) & (world[:, 1] > 2) & (world[:, 1] < 3.5)
    rotation = np.array(world_from_scene().rotation) @ matrix_from_quat_wxyz(quat[floor])
    thin = np.take_along_axis(
        rotation, splats.scale[floor].argmin(axis=1)[:, None, None].repeat(3, axis=1), axis=2
    )[:, :, 0]
    assert np.median(np.abs(thin[:, 2])) > 0.99


def test_hoops_are_there_and_can_be_flown_through(splats, world):
    opaque = world[splats.opacity > 0.1]
    np.testing.assert_array_equal(hoop_centres(), [hoop.centre for hoop in HOOPS])
    for hoop in HOOPS:
        axis = np.array(hoop.axis)
        offset = opaque - np.array(hoop.centre)
        along = offset @ axis
        across = np.linalg.norm(offset - along[:, None] * axis, axis=1)
        assert not ((np.abs(along) < 0.6) & (across < hoop.radius_m - 0.06)).any()
        ring = (np.abs(along) < 0.04) & (np.abs(across - hoop.radius_m) < 0.04)
        assert ring.sum() > 500
        angle = np.arctan2(offset[ring, 2], offset[ring] @ np.cross([0, 0, 1], axis))
        assert np.histogram(angle, 36, (-np.pi, np.pi))[0].min() > 3


def test_the_filters_remove_the_floaters(splats):
    scene = import_splat(ImportSplatConfig(min_opacity=0.1, drop_floaters=True), splats)
    removed = scene.manifest.source["removed"]
    assert removed["floaters"] == 400
    assert 5000 < removed["min_opacity"] < 15000
    mean = transform_points(world_from_scene(), scene["mean"])
    middle = (np.abs(mean - [4.0, 3.0, 1.7]) < [3, 2, 1]).all(axis=1)
    at_pillar = np.hypot(mean[:, 0] - 4, mean[:, 1] - 3) < 0.22
    near_hoop = (np.linalg.norm(mean[:, None] - hoop_centres(), axis=2) < 1.3).any(axis=1)
    assert not (middle & ~at_pillar & ~near_hoop & (mean[:, 2] > 1.0) & (mean[:, 1] < 4)).any()


def test_the_frame_is_recovered_to_millimetres():
    cameras = demo_cameras(60, 0)
    fit = fit_similarity(cameras.centre_scene, cameras.reference_world, 0.05, 0)
    assert fit.inlier.sum() == 58
    corners = np.array(SIZE) * np.stack(np.meshgrid([0, 1], [0, 1], [0, 1]), -1).reshape(-1, 3)
    error = transform_points(fit.similarity, scene_from_world(corners)) - corners
    assert np.linalg.norm(error, axis=1).max() < 0.003
    assert fit.similarity.scale == pytest.approx(1 / 0.37, rel=3e-4)


def test_world_and_scene_are_inverse():
    points = np.random.default_rng(0).normal(size=(10, 3))
    np.testing.assert_allclose(
        transform_points(world_from_scene(), scene_from_world(points)), points, atol=1e-12
    )


def test_the_colmap_model_is_one(tmp_path, splats):
    pycolmap = pytest.importorskip("pycolmap")
    cameras = demo_cameras(20, 3)
    for name, text in colmap_model(cameras, splats, 3).items():
        (tmp_path / name).write_text(text)
    model = pycolmap.Reconstruction(str(tmp_path))
    assert (model.num_reg_images(), model.num_points3D() > 100) == (20, True)
    for image in model.images.values():
        i = cameras.names.index(image.name)
        np.testing.assert_allclose(image.projection_center(), cameras.centre_scene[i], atol=1e-9)
        for point in image.points2D:
            if point.has_point3D():
                seen = image.project_point(model.points3D[point.point3D_id].xyz)
                np.testing.assert_allclose(seen, point.xy, atol=2e-3)


def test_positions_are_written_as_csv():
    text = positions_csv(["a.jpg"], np.array([[1.0, -2.5, 1 / 3]]))
    assert text == "image,x,y,z\na.jpg,1.00000000,-2.50000000,0.33333333\n"


@pytest.mark.parametrize(
    "surface",
    [
        *box((0, 0, 0), (1, 2, 3), None),
        tube((1, 2, 0), 0.3, 1.2, None),
        tube((1, 2, 0), 0.3, 1.2, None, top=0.1),
        tube((1, 2, 0), 0.1, 1.2, None, top=0.4),
        disc((0, 1, 2), 0.5, None),
        sphere((0, 1, 2), 0.5, None),
        torus((1, 2, 3), (1, 1, 0), 0.45, 0.2, None),
    ],
)
def test_surfaces_have_their_area_and_are_sampled_evenly(surface):
    """The area element is the cross product of the derivatives, everywhere the same and the area."""
    u, v = np.random.default_rng(0).uniform(0.05, 0.95, (2, 200))
    step = 1e-6
    du = (surface.sample(u + step, v)[0] - surface.sample(u - step, v)[0]) / (2 * step)
    dv = (surface.sample(u, v + step)[0] - surface.sample(u, v - step)[0]) / (2 * step)
    cross = np.cross(du, dv)
    size = np.linalg.norm(cross, axis=1)
    np.testing.assert_allclose(size, surface.area, rtol=1e-6)
    normals = surface.sample(u, v)[1]
    np.testing.assert_allclose(np.abs((cross * normals).sum(axis=1)) / size, 1, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-12)


def test_boxes_look_outward():
    for face in box((0, 0, 0), (1, 2, 3), None):
        point, normal = face.sample(np.array([0.5]), np.array([0.5]))
        assert ((point - [0.5, 1, 1.5]) @ normal[0] > 0).all()


def test_every_paint_stays_a_colour():
    u, v = np.random.default_rng(0).uniform(size=(2, 500))
    for surface in room():
        color = surface.paint(u, v)
        assert color.shape == (500, 3)
        assert color.min() >= 0
        assert color.max() <= 1
