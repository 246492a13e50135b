"""`verify` refuses what `voxelize` refuses, within its memory and a bounded time, and stops at once."""

import time

import numpy as np
import pytest

from alula import _core
from alula.schemas.artifacts.artifact import make_artifact
from alula.schemas.artifacts.kinds import SCENE
from alula.schemas.errors import InputError
from alula.schemas.parameters.configs.voxelize import VoxelizeConfig
from alula.stages.compression.ellipsoids import unproven_voxels
from alula.stages.compression.verify import verify
from alula.stages.compression.voxelize import voxelize
from support.scenes.covers import changed, cover_of, failing, furniture, holds_voxel, planes, voxels_of

FEW = np.array([[0, 0, 0]], np.int32)
MOST_CPU_S = 20.0


def balls(count, radius_m, spread_m=0.0):
    """A scene of some kilobytes with large Gaussians."""
    rng = np.random.default_rng(4)
    arrays = {
        "mean": rng.uniform(-spread_m, spread_m, (count, 3)),
        "scale": np.full((count, 3), radius_m),
        "quat_wxyz": np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)),
        "opacity": np.ones(count),
        "color": np.zeros((count, 3)),
    }
    return make_artifact(SCENE, arrays, frame="world", unit="m", parameters={}, summary={}, source={})


@pytest.mark.every(3)
@pytest.mark.parametrize("crop", [None, (-40.0, -40.0, -40.0, 40.0, 40.0, 40.0)])
@pytest.mark.parametrize(("count", "radius_m"), [(1, 100.0), (250, 20.0), (250, 10.0)])
def test_what_voxelize_refuses_verify_refuses_too(count, radius_m, crop):
    scene = balls(count, radius_m, spread_m=30.0)
    begin = time.process_time()
    with pytest.raises(InputError, match="the scene would need"):
        voxelize(VoxelizeConfig(size_m=0.05, crop=crop, max_voxels=2**27), scene)
    with pytest.raises(InputError, match="the scene would need"):
        unproven_voxels(scene, FEW, voxel_size_m=0.05, sigma=1.0, crop=crop)
    assert time.process_time() - begin < MOST_CPU_S


@pytest.mark.slow
def test_ellipsoids_that_the_voxels_lack_are_not_searched_to_the_end():
    """No budget of `voxelize` refuses these; together they touch a missing voxel a billion times."""
    begin = time.process_time()
    with pytest.raises(InputError, match="the voxels are not those of this scene"):
        unproven_voxels(balls(250, 5.0), FEW, voxel_size_m=0.05, sigma=1.0)
    assert time.process_time() - begin < MOST_CPU_S


class Interrupted(Exception):
    """Raised by a progress callback, as Ctrl-C raises in a poll."""


def interrupted_after(work):
    """Seconds from the interruption of some work to its end."""
    raised = []

    def progress(done, total):
        raised.append(time.monotonic())
        raise Interrupted

    with pytest.raises(Interrupted):
        work(progress)
    return time.monotonic() - raised[0]


def test_an_interruption_stops_within_an_ellipsoid():
    scene = balls(40, 5.0)

    def prove(progress):
        unproven_voxels(scene, FEW, voxel_size_m=0.05, sigma=1.0, min_overlap=2, jobs=2, progress=progress)

    assert interrupted_after(prove) < 2.0


def test_an_interruption_stops_voxelize_within_an_ellipsoid():
    config = VoxelizeConfig(size_m=0.05)
    assert interrupted_after(lambda p: voxelize(config, balls(400, 7.0), jobs=2, progress=p)) < 2.0


def test_a_hull_with_more_planes_and_vertices_than_can_be_checked_is_refused():
    cover = cover_of(voxels_of([(0, 0, 0)]))
    rng = np.random.default_rng(2)
    count = 80_000
    crafted = changed(
        cover,
        vertex=np.unique(rng.integers(-(2**20), 2**20, (count, 3)), axis=0).astype(np.int32),
        vertex_start=np.array([0, count]),
        plane_normal=rng.integers(-1000, 1000, (count, 3)),
        plane_offset=rng.integers(1, 10**9, count),
        plane_start=np.array([0, count]),
    )
    begin = time.process_time()
    with pytest.raises(InputError, match="no cover that merge makes: a hull has 80000 half-planes"):
        verify(crafted)
    assert time.process_time() - begin < MOST_CPU_S


@pytest.mark.slow
def test_many_hulls_that_overlap_are_measured_in_bounded_time():
    """All have the same slanted faces, so that no box is full or empty however often it is halved."""
    corners = np.array([[0, 0, 0], [400, 3, 1], [5, 400, 2], [7, 11, 400], [399, 398, 397]], np.int32)
    hull = _core.lattice_hull(corners)
    count = 300
    vertex, normal, offset = (
        np.concatenate([hull[name]] * count) for name in ("vertex", "plane_normal", "plane_offset")
    )
    vertex_start, plane_start = (np.arange(count + 1) * len(hull[n]) for n in ("vertex", "plane_offset"))
    begin = time.process_time()
    excess = _core.cover_excess(
        *(np.array([[200, 200, 200]], np.int32), vertex, vertex_start, normal, offset, plane_start, 0, None)
    )
    assert time.process_time() - begin < 4 * MOST_CPU_S
    assert excess > 0


def test_every_member_outside_is_named():
    """The extreme members decide; when one is outside, all that are outside are named."""
    rng = np.random.default_rng(9)
    cover = cover_of(voxels_of(furniture(3, 12)), hulls=6)
    named = 0
    for row in rng.choice(len(cover["plane_offset"]), 40, replace=False).tolist():
        offset = cover["plane_offset"].copy()
        offset[row] -= int(rng.integers(1, 4)) * int(np.abs(cover["plane_normal"][row]).max())
        bad = changed(cover, plane_offset=offset)
        hull = int(np.searchsorted(cover["plane_start"], row, "right")) - 1
        begin, end = cover["member_start"][hull : hull + 2]
        outside = {
            tuple(voxel)
            for voxel in cover["member_index"][begin:end].tolist()
            if not holds_voxel(planes(bad, hull), voxel)
        }
        certificate = verify(bad)
        check = next(c for c in certificate.checks if c.name == "members lie in their hulls")
        assert check.failed == len(outside)
        assert {o.voxel for o in check.first} <= outside
        assert ("members lie in their hulls" in failing(certificate)) == bool(outside)
        named += len(outside)
    assert named > 40
