"""Merging by blocks: every voxel in one block and in a hull, the same result for all workers, the budgets."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula.schemas.artifacts.parts import Parts
from alula.schemas.errors import InfeasibleError, InputError, LinkError, UsageError
from alula.schemas.parameters.configs.merge import MergeConfig
from alula.stages.compression import block_tree, merge_blocks
from alula.stages.compression.block_budgets import Curve, divided
from alula.stages.compression.block_tree import Block, block_rows, blocks_of, chosen_edge, regions_of
from alula.stages.compression.merge import merge
from alula.stages.compression.merge_blocks import CoverStore, plan_blocks
from support.clusters import Cluster
from support.effort import examples
from support.scenes.covers import SIZE_M, assert_covers, cover_of, excess, furniture, rows, voxels_of

voxel_sets = st.sets(st.tuples(*3 * [st.integers(-7, 7)]), min_size=1, max_size=80)
SCENE = voxels_of(furniture())
MOST = 900  # voxels of a region


class InParts:
    """Voxels in several parts, cut without regard to blocks."""

    def __init__(self, voxels, count):
        self.manifest = voxels.manifest
        order = np.random.default_rng(0).integers(0, count, len(voxels["index"]))
        self._parts = [voxels_of(voxels["index"][order == k]) for k in range(count)]

    def __len__(self):
        return len(self._parts)

    def __getitem__(self, number):
        return self._parts[number]


def blocked(voxels, block=4, *, jobs=1, store=None, scheduler=None, **limits):
    config = MergeConfig(block_m=block * SIZE_M, **limits)
    parts = voxels if isinstance(voxels, InParts) else Parts.of(voxels)
    plan = plan_blocks(config, parts)
    return list(merge_blocks.merge_blocks(config, plan, jobs=jobs, store=store, scheduler=scheduler))


def assert_equal(a, b):
    assert a.manifest.arrays == b.manifest.arrays
    assert a.manifest.conservativeness == b.manifest.conservativeness


def members(cover):
    return [tuple(row) for row in cover["member_index"].tolist()]


@given(voxel_sets, st.integers(1, 6), st.integers(1, 12), st.sampled_from(["default", "paper"]))
@settings(deadline=None, max_examples=examples(60))
def test_every_voxel_is_covered_by_at_most_so_many_hulls(index, block, hulls, method):
    voxels = voxels_of(sorted(index))
    (cover,) = blocked(voxels, block, hulls=hulls, method=method)
    assert len(cover["plane_start"]) - 1 <= hulls
    assert_covers(cover, voxels)


@given(voxel_sets, st.integers(1, 6))
@settings(deadline=None, max_examples=examples(60))
def test_each_voxel_belongs_to_one_block(index, edge):
    voxels = Parts.of(voxels_of(sorted(index)))
    blocks = blocks_of(voxels, edge)
    assert sum(block.voxels for block in blocks) == len(index)
    seen = []
    for place, block in block_rows(voxels, edge, {b.place: b.voxels for b in blocks}):
        assert (block >= np.multiply(place, edge)).all()
        assert (block < np.multiply(place, edge) + edge).all()
        found = [tuple(row) for row in block.tolist()]
        assert found == sorted(found)
        seen += found
    assert sorted(seen) == sorted(index)


@given(voxel_sets, st.integers(1, 4))
@settings(deadline=None, max_examples=examples(40))
def test_with_limits_per_block_hulls_stay_in_their_block(index, edge):
    voxels = voxels_of(sorted(index))
    covers = blocked(voxels, edge, hulls=2, per_block=True)
    places = [{tuple(np.floor_divide(m, edge).tolist()) for m in members(cover)} for cover in covers]
    assert all(len(place) == 1 for place in places)
    assert len(set().union(*places)) == len(covers)
    assert sorted(m for cover in covers for m in set(members(cover))) == sorted(index)
    for cover, ((x, y, z),) in zip(covers, places, strict=True):
        assert len(cover["plane_start"]) - 1 <= 2
        low = edge * np.array([x, y, z])
        assert (cover["vertex"] >= low).all()
        assert (cover["vertex"] <= low + edge).all()


def test_one_block_gives_the_same_as_no_blocks():
    whole = cover_of(SCENE, hulls=40)
    shifted = voxels_of(SCENE["index"] + 50)
    (one,) = blocked(shifted, 200, hulls=40)
    assert one.manifest.summary["blocks"] == 1
    for name in ("plane_normal", "plane_start", "vertex_start", "member_start", "history"):
        np.testing.assert_array_equal(one[name], cover_of(shifted, hulls=40)[name])
    assert one.manifest.conservativeness == pytest.approx(whole.manifest.conservativeness, rel=1e-12)


@pytest.mark.every(2)
@pytest.mark.parametrize("block", [9, 14])
def test_the_excess_is_at_most_that_of_one_block_and_a_twentieth(block):
    """Also where single voxels lie far from all others, which few hulls cover at a great cost."""
    in_blocks = at_once = 0.0
    for hulls in (20, 40, 60):  # together: at 60 hulls, 5 % are two voxels
        (cover,) = blocked(SCENE, block, hulls=hulls)
        assert cover.manifest.summary["blocks"] > 4
        assert_covers(cover, SCENE)
        in_blocks += excess(cover)
        at_once += excess(cover_of(SCENE, hulls=hulls))
    assert in_blocks <= 1.05 * at_once


@pytest.mark.slow
def test_the_result_depends_neither_on_workers_nor_on_parts():
    (alone,) = blocked(SCENE, 9, hulls=50)
    (two,) = blocked(SCENE, 9, hulls=50, jobs=2)
    (parts,) = blocked(InParts(SCENE, 3), 9, hulls=50)
    assert_equal(alone, two)
    assert_equal(alone, parts)


def test_a_voxel_in_two_parts_is_refused():
    twice = InParts(SCENE, 2)
    twice._parts[1] = voxels_of(np.concatenate([twice[0]["index"][:1], twice[1]["index"]]))
    with pytest.raises(InputError, match="two parts of the voxels have the same voxel"):
        blocked(twice, 9, hulls=50)


@pytest.mark.parametrize(
    "limits",
    [{"max_planes": 300}, {"max_bytes": 900}, {"hulls": 40, "kdop": 14}, {"max_growth": 1.1}, {}],
    ids=str,
)
def test_budgets_hold_over_all_blocks(limits):
    (cover,) = blocked(SCENE, 10, **limits)
    assert_covers(cover, SCENE)
    summary = cover.manifest.summary
    assert summary["half_planes"] <= limits.get("max_planes", 10**9)
    assert summary["onboard_bytes"] <= limits.get("max_bytes", 10**9)
    assert summary["hulls"] <= limits.get("hulls", 300)
    assert cover.manifest.conservativeness <= limits.get("max_growth", 100)


@pytest.mark.parametrize("limits", [{"hulls": 60}, {"max_planes": 500}, {"max_growth": 1.2}], ids=str)
def test_regions_that_are_not_joined_share_the_budget(monkeypatch, limits):
    monkeypatch.setattr(block_tree.regions_of, "__defaults__", (MOST,))
    covers = blocked(SCENE, 8, **limits)
    assert len(covers) > 3
    assert sorted(m for cover in covers for m in members(cover)) == sorted(
        map(tuple, SCENE["index"].tolist())
    )
    summaries = [cover.manifest.summary for cover in covers]
    assert sum(s["half_planes"] for s in summaries) <= limits.get("max_planes", 10**9)
    assert sum(s["hulls"] for s in summaries) <= limits.get("hulls", 10**9)
    growth = 1 + sum(excess(c) * s["voxels"] for c, s in zip(covers, summaries, strict=True)) / 2082
    published = {} if "max_growth" in limits else {"method": "paper"}
    at_once = excess(cover_of(SCENE, **limits, **published))
    assert growth <= limits.get("max_growth", 1 + 0.3 * at_once)  # hulls cannot cross borders of regions


def test_too_few_hulls_for_the_parts_are_infeasible(monkeypatch):
    monkeypatch.setattr(block_tree.regions_of, "__defaults__", (MOST,))
    with pytest.raises(InfeasibleError, match=r"allow about 2 hulls, but each of the \d+ parts"):
        blocked(SCENE, 8, hulls=2)
    with pytest.raises(InfeasibleError, match="no cover has 3 half-planes"):
        blocked(SCENE, 100, max_planes=3)


def test_impossible_limits_are_refused_in_words():
    with pytest.raises(InfeasibleError, match=r"no cover with 1 hulls at a growth of at most 1\.01"):
        blocked(SCENE, 12, hulls=1, max_growth=1.01)
    for wrong in ({"block_m": 0.0}, {"block_m": 2e6}, {"per_block": True}):
        with pytest.raises(UsageError, match="--block"):
            MergeConfig(**wrong)
    with pytest.raises(InputError, match="a block has 2,082 voxels, but memory limits it to 1,000"):
        regions_of([Block((0, 0, 0), 2082)], 1000)
    with pytest.raises(InputError, match="more than 1048576 voxels from the origin"):
        blocks_of(Parts.of(voxels_of([(2**20, 0, 0)])), 8)


def test_cubes_of_blocks_are_joined_up_to_the_limit():
    blocks = [Block(place, 10) for place in sorted(product(range(-1, 3), range(2), range(1)))]
    (whole,), lowest = regions_of(blocks, 80)
    assert (lowest, whole.level, whole.height, whole.voxels) == ((-1, 0, 0), 2, 2, 80)
    assert [child.voxels for child in whole.children] == [40, 40]
    halves, _ = regions_of(blocks, 79)
    assert [half.voxels for half in halves] == [40, 40]
    assert len(regions_of(blocks, 80, join=False)[0]) == 8
    (far,), _ = regions_of([Block((0, 0, 0), 1), Block((9, 0, 0), 1)], 2)
    assert (far.level, far.height) == (4, 1)  # the empty levels between are left out


def test_blocks_are_chosen_for_many_voxels_alone(monkeypatch):
    monkeypatch.setattr(merge_blocks, "MERGE_VOXELS", 2082)
    assert plan_blocks(MergeConfig(hulls=9), Parts.of(SCENE)) is None
    monkeypatch.setattr(merge_blocks, "MERGE_VOXELS", 2081)
    monkeypatch.setattr(block_tree.chosen_edge, "__defaults__", (900,))
    plan = plan_blocks(MergeConfig(hulls=9), Parts.of(SCENE))
    assert plan.edge == 32
    assert plan.summary()["block_m"] == 32 * SIZE_M
    grid = Parts.of(voxels_of(list(product(range(40), repeat=3))))
    for most in (2**15, 2**15 - 1):
        edge = chosen_edge(grid, most)
        assert max(block.voxels for block in blocks_of(grid, edge)) <= most
        assert max(block.voxels for block in blocks_of(grid, 2 * edge)) > most


class Stopping(CoverStore):
    """A store whose user is interrupted after so many covers."""

    left = 10**9

    def put(self, key, cover):
        if self.left == 0:
            raise KeyboardInterrupt
        self.left -= 1
        super().put(key, cover)


@pytest.mark.parametrize("after", [3, 17, 23])
def test_an_interrupted_merge_does_the_rest_only(monkeypatch, after):
    (whole,) = blocked(SCENE, 8, hulls=50)
    store = Stopping()
    store.left = after
    with pytest.raises(KeyboardInterrupt):
        blocked(SCENE, 8, hulls=50, store=store)
    done, made = set(store._covers), []
    store.left = 10**9
    put = store.put
    store.put = lambda key, cover: (made.append(key), put(key, cover))
    (continued,) = blocked(SCENE, 8, hulls=50, store=store)
    assert_equal(continued, whole)
    assert made
    assert not done & set(made)


@given(
    st.lists(st.lists(st.floats(0, 100), min_size=1, max_size=9), min_size=2, max_size=5), st.integers(2, 30)
)
@settings(deadline=None, max_examples=examples(60))
def test_divided_limits_add_up(increases, hulls):
    curves = [Curve(len(part) + 1, np.concatenate([[0], np.cumsum(sorted(part))])) for part in increases]
    voxels = [100] * len(curves)
    if hulls < len(curves):
        return
    limits = divided(MergeConfig(hulls=hulls, max_bytes=40 * hulls + 64 * len(curves)), curves, voxels)
    assert sum(limit.hulls for limit in limits) == min(hulls, sum(curve.hulls for curve in curves))
    assert sum(limit.max_bytes for limit in limits) <= 40 * hulls + 64 * len(curves)
    assert min(limit.hulls for limit in limits) >= 1
    growth = divided(MergeConfig(max_growth=1.5), curves, voxels)
    assert sum(100 * (limit.max_growth - 1) for limit in growth) <= 0.5 * sum(voxels) + 1e-6


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_a_cluster_gives_the_same_and_a_lost_worker_loses_nothing(tmp_path, monkeypatch):
    from alula.stages import distribute as module

    monkeypatch.setattr(
        module.distribute, "__kwdefaults__", module.distribute.__kwdefaults__ | {"timeout_s": 60.0}
    )
    (alone,) = blocked(SCENE, 6, hulls=50)
    cluster = Cluster(tmp_path, 2)
    try:
        store = CoverStore()
        put, killed = store.put, []

        def kill_after_three(key, cover):
            put(key, cover)
            if len(store._covers) == 3:
                killed.append(cluster.workers[0].kill())

        store.put = kill_after_three
        (spread,) = blocked(SCENE, 6, hulls=50, store=store, scheduler=cluster.wait_for_workers())
        assert killed
        assert_equal(alone, spread)
    finally:
        cluster.stop()


def test_lost_processes_are_said(monkeypatch):
    def lost(*_, **__):
        raise LinkError("processes were lost 3 times")
        yield

    monkeypatch.setattr(merge_blocks, "distribute", lost)
    with pytest.raises(LinkError, match="lost 3 times"):
        blocked(SCENE, 9, hulls=50, jobs=2)


def test_a_merge_of_a_cover_starts_from_its_members():
    """A cover by blocks is an ordinary cover, which can be merged further."""
    (cover,) = blocked(SCENE, 9, hulls=50)
    fewer = merge(MergeConfig(hulls=20), cover, jobs=1)
    assert_covers(fewer, SCENE)
    assert len(rows(fewer, 0, "vertex")) > 0
    assert fewer.manifest.summary["start_hulls"] == 50
