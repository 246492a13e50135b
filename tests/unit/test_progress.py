"""Progress never decreases, ends at the whole, and reports an unknown total."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from alula.schemas.parameters.configs.merge import MergeConfig
from alula.schemas.parameters.configs.voxelize import VoxelizeConfig
from alula.stages.compression.merge import merge
from alula.stages.compression.verify import verify
from alula.stages.compression.voxelize import voxelize
from alula.stages.progress import WHOLE, share
from support.scenes.fabricate import make_scene

reports = st.lists(st.tuples(st.integers(0, 100), st.integers(0, 90)))


@given(reports, reports)
def test_parts_follow_each_other_and_never_go_back(first, second):
    seen = []
    record = lambda done, total: seen.append((done, total))  # noqa: E731
    for part, rows in ((share(record, 0, 0.3), first), (share(record, 0.3, 1), second)):
        for done, total in rows:
            part(done, total)
    fractions = [done / total for done, total in seen]
    assert fractions == sorted(fractions)
    assert all(total == WHOLE for _, total in seen)
    assert all(f <= 0.3 for f in fractions[: len(first)])
    assert all(0.3 <= f <= 1 for f in fractions[len(first) :])


def test_no_progress_stays_none():
    assert share(None, 0, 1) is None


@pytest.mark.parametrize("tile_m", [None, 0.7])
@pytest.mark.parametrize(
    "limit", [{"hulls": 30}, {"max_planes": 400}, {"max_growth": 2.0}, {"cluster_radius": 4}]
)
def test_every_stage_reports_up_to_the_end(tile_m, limit):
    scene = make_scene(200)
    fractions: list[float] = []

    def record(done: int, total: int) -> None:
        if total > 1:
            fractions.append(done / total)

    def check() -> None:
        assert fractions == sorted(fractions)
        assert fractions[-1] == 1.0
        fractions.clear()

    voxels = voxelize(VoxelizeConfig(size_m=0.1), scene, tile_m=tile_m, progress=record)
    check()
    cover = merge(MergeConfig(**limit), voxels, progress=record)
    check()
    certificate = verify(cover, voxels=voxels, scene=scene, progress=record)
    assert certificate.covered
    check()
