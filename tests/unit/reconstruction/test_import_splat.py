"""The rules that decide which Gaussians enter a scene."""

import dataclasses
import itertools
import tracemalloc

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from alula.schemas.errors import InputError, UsageError
from alula.schemas.parameters.configs.import_splat import ImportSplatConfig
from alula.stages.reconstruction.floaters import SMALLEST_GROUP, floaters
from alula.stages.reconstruction.formats.splats import Loss, Splats, loss_bound, rounded_up
from alula.stages.reconstruction.import_splat import SCALE_FLOOR, import_splat
from alula.stages.rotation import matrix_from_quat_wxyz
from support.effort import examples


def splats(rows=12, **changes):
    rng = np.random.default_rng(1)
    values = {
        "mean": rng.normal(size=(rows, 3)),
        "scale": rng.uniform(0.01, 0.02, (rows, 3)),
        "quat_wxyz": rng.normal(size=(rows, 4)) * 2,
        "opacity": rng.uniform(0.5, 1, rows),
    }
    for name, edits in changes.items():
        for row, value in edits.items():
            values[name][row] = value
    return Splats(
        format="ply",
        color=np.arange(rows * 3, dtype=np.uint8).reshape(rows, 3),
        **{name: value.astype(np.float32) for name, value in values.items()},
    )


def removed(result):
    return {reason: count for reason, count in result.manifest.source["removed"].items() if count}


def test_clean_rows_are_kept_bit_by_bit_and_in_order():
    given_ = splats()
    scene = import_splat(ImportSplatConfig(), given_)
    for name in ("mean", "scale", "opacity", "color"):
        np.testing.assert_array_equal(scene[name], getattr(given_, name))
    norm = np.linalg.norm(given_.quat_wxyz, axis=1, keepdims=True)
    np.testing.assert_allclose(scene["quat_wxyz"], given_.quat_wxyz / norm, atol=2e-7)
    manifest = scene.manifest
    assert (manifest.frame, manifest.unit) == ("scene", "arbitrary")
    assert manifest.source["rows"] == manifest.source["kept"] == 12
    assert manifest.world_from_scene is None
    assert manifest.guarantee.claims["left_out"] == {}


@pytest.mark.parametrize(
    ("reason", "changes"),
    [
        ("not_a_number", {"mean": {3: (0, np.nan, 0)}}),
        ("not_a_number", {"scale": {3: (1, 1, np.nan)}}),
        ("not_a_number", {"quat_wxyz": {3: (np.nan, 0, 0, 0)}}),
        ("not_a_number", {"opacity": {3: np.nan}}),
        ("infinite_mean", {"mean": {3: (-np.inf, 0, 0)}}),
        ("infinite_scale", {"scale": {3: (np.inf, 1, 1)}}),
        ("infinite_rotation", {"quat_wxyz": {3: (np.inf, 0, 0, 1)}}),
        ("zero_rotation", {"quat_wxyz": {3: (0, 0, 0, 0)}}),
        ("min_opacity", {"opacity": {3: 0.003}}),
        ("crop", {"mean": {3: (50, 0, 0)}}),
        ("crop_sphere", {"mean": {3: (8, 8, 8)}}),
        ("max_scale", {"scale": {3: (0.1, 3.0, 0.1)}}),
    ],
)
def test_each_rule_removes_its_row_and_counts_it(reason, changes):
    config = ImportSplatConfig(
        crop=(-9, -9, -9, 9, 9, 9), crop_sphere=(1, 1, 1, 12), max_scale=2.0, drop_nan=True
    )
    given_ = splats(**changes)
    scene = import_splat(config, given_)
    assert removed(scene) == {reason: 1}
    np.testing.assert_array_equal(scene["mean"], np.delete(given_.mean, 3, axis=0))
    assert scene.manifest.guarantee.claims["left_out"] == {reason: 1}
    assert f"1 by {reason}" in scene.manifest.guarantee.statement


def test_a_row_counts_once_and_counts_add_up():
    given_ = splats(mean={0: np.nan, 1: np.inf}, opacity={0: 0.0, 1: 0.0, 2: 0.0}, scale={0: np.inf})
    scene = import_splat(ImportSplatConfig(drop_nan=True), given_)
    assert removed(scene) == {"not_a_number": 1, "infinite_mean": 1, "min_opacity": 1}
    assert scene.manifest.source["rows"] == scene.manifest.source["kept"] + 3


def test_no_thickness_becomes_the_floor_and_certain_opacities_stay():
    given_ = splats(scale={2: (0, 1, 1)}, opacity={2: 1.0, 4: 0.0})
    scene = import_splat(ImportSplatConfig(min_opacity=0.0), given_)
    assert scene["scale"][2].tolist() == [np.float32(SCALE_FLOOR), 1, 1]
    assert scene["opacity"][4] == 0
    assert scene.manifest.source["scale_floored"] == 1
    assert removed(scene) == {}


def test_a_scene_without_gaussians_is_refused_with_the_reasons():
    config = ImportSplatConfig(crop=(90, 90, 90, 91, 91, 91), drop_nan=True)
    with pytest.raises(InputError, match="no Gaussian is left of 12: removed 1 by infinite_mean, 11 by crop"):
        import_splat(config, splats(mean={0: np.inf}))


def test_a_few_rows_without_a_rotation_are_told_and_many_are_refused():
    one = import_splat(ImportSplatConfig(), splats(quat_wxyz={3: (0, 0, 0, 0)}))
    assert any(
        "1 of 12 Gaussians have a quaternion of length zero" in n for n in one.manifest.summary["notes"]
    )
    many = splats(quat_wxyz=dict.fromkeys(range(3, 9), (0, 0, 0, 0)))
    words = "6 of 12 Gaussians have a quaternion of length zero, the first in row 3: .*--drop-nan"
    with pytest.raises(InputError, match=words):
        import_splat(ImportSplatConfig(), many)
    assert removed(import_splat(ImportSplatConfig(drop_nan=True), many)) == {"zero_rotation": 6}


def test_values_that_are_not_finite_are_refused_unless_they_are_to_be_dropped():
    given_ = splats(mean={7: np.inf}, opacity={4: np.nan})
    words = (
        r"2 of 12 Gaussians .* not finite \(not_a_number 1, infinite_mean 1\), the first in row 4; --drop-nan"
    )
    with pytest.raises(InputError, match=words):
        import_splat(ImportSplatConfig(), given_)


@pytest.mark.parametrize(("axis", "signs"), [("x", (1, -1, -1)), ("y", (-1, 1, -1)), ("z", (-1, -1, 1))])
def test_a_turn_moves_ellipsoids_by_exactly_half_a_turn(axis, signs):
    given_ = splats()
    still, scene = (import_splat(ImportSplatConfig(turn=turn), given_) for turn in ("none", axis))
    flip = np.diag(signs).astype(float)
    np.testing.assert_array_equal(scene["mean"], given_.mean * np.float32(signs))
    for before, after, s in zip(still["quat_wxyz"], scene["quat_wxyz"], scene["scale"], strict=True):
        r, t = matrix_from_quat_wxyz(before), matrix_from_quat_wxyz(after)
        one, other = (m @ np.diag(s.astype(float) ** 2) @ m.T for m in (flip @ r, t))
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-6 * np.abs(one).max())
    assert sorted(np.abs(scene["quat_wxyz"][0])) == pytest.approx(
        sorted(np.abs(still["quat_wxyz"][0])), rel=1e-6
    )
    assert scene.manifest.source["frame"] == {"file": "unnamed", "turn": axis}
    assert "180 degrees" in scene.manifest.summary["frame"]


def test_the_loss_of_the_kept_rows_is_in_the_scene():
    bound = loss_bound(12, position=np.arange(12) / 100, scale=0.03, rotation=np.arange(12) / 4)
    given_ = dataclasses.replace(splats(opacity={11: 0.0}), loss=Loss(bound, 0.002, {"scale": "a codebook"}))
    scene = import_splat(ImportSplatConfig(), given_)
    np.testing.assert_array_equal(scene["loss"], bound[:11])
    assert scene.manifest.requires == ["splat-loss"]
    figures = scene.manifest.source["loss"]
    assert figures["position"] == pytest.approx(0.1)
    assert figures["rotation_rad"] == pytest.approx(2.5)
    assert (figures["opacity"], figures["unbounded"]) == (0.002, {"scale": "a codebook"})
    assert "a codebook" in scene.manifest.guarantee.statement
    none = import_splat(
        ImportSplatConfig(), dataclasses.replace(given_, loss=Loss(np.zeros((12, 3), np.float32)))
    )
    assert "loss" not in none.arrays
    assert none.manifest.requires == []
    for bad in (np.nan, np.inf, -1):
        bound[3, 1] = bad
        with pytest.raises(InputError, match="is negative or not finite"):
            import_splat(ImportSplatConfig(), given_)


@settings(max_examples=examples(200), deadline=None)
@given(st.floats(0, 3e38))
def test_bounds_are_rounded_up(value):
    (up,) = rounded_up([value])
    assert float(up) >= value
    assert float(up) <= value * (1 + 2**-22) + 2e-45
    assert loss_bound(1, rotation=7.0)[0, 2] >= np.pi


@pytest.mark.parametrize(
    "wrong",
    [
        {"crop_sphere": (0, 0, 0, 0)},
        {"min_opacity": 1.1},
        {"min_opacity": -0.1},
        {"max_scale": 0.0},
        {"crop": (0, 0, 0, 1, 0, 1)},
    ],
)
def test_parameters_that_mean_nothing_are_refused(wrong):
    with pytest.raises(UsageError):
        ImportSplatConfig(**wrong)


@settings(max_examples=examples(60), deadline=None)
@given(st.integers(0, 2**32), st.floats(0, 1))
@example(1, 0.0)  # the median of sizes near the largest number
def test_whatever_is_kept_is_a_valid_scene(seed, min_opacity):
    rng = np.random.default_rng(seed)
    odd = np.array([np.nan, np.inf, -np.inf, 0.0, 1e-38, 3e38, 1.0, -2.0, 0.5], np.float32)
    given_ = Splats(
        format="ply",
        mean=rng.choice(odd, (40, 3)),
        scale=np.abs(rng.choice(odd, (40, 3))),
        quat_wxyz=rng.choice(odd, (40, 4)),
        opacity=rng.choice(np.float32([0, 1, 0.5, np.nan]), 40),
        color=np.zeros((40, 3), np.uint8),
    )
    try:
        scene = import_splat(
            ImportSplatConfig(min_opacity=min_opacity, drop_nan=True), given_
        )  # checks what it makes
    except InputError:
        return
    assert scene.manifest.source["kept"] + sum(removed(scene).values()) == 40


def sheet(count, size, rng, z=0.0):
    points = rng.uniform(0, size, (count, 3))
    points[:, 2] = z
    return points


def marked(mean, scale, quat=None):
    quat = np.tile([1.0, 0, 0, 0], (len(mean), 1)) if quat is None else quat
    arrays = (each.astype(np.float32) for each in (mean, scale, quat))
    return floaters(*arrays, np.arange(len(mean)))[0]


def test_isolated_groups_are_floaters_and_surfaces_are_not():
    rng = np.random.default_rng(0)
    floor = sheet(4000, 5, rng)
    blob = np.array([2.0, 2.0, 2.0]) + 0.02 * rng.normal(size=(SMALLEST_GROUP - 1, 3))
    single = rng.uniform(0, 5, (20, 3)) + np.array([0, 0, 4])
    mean = np.vstack([floor, blob, single])
    found = marked(mean, np.full_like(mean, 0.02))
    assert not found[:4000].any()
    assert found[4000:].all()
    bigger = np.vstack([floor, blob, blob[:5] + 0.01])
    assert not marked(bigger, np.full_like(bigger, 0.02)).any()


def test_a_sparse_surface_of_large_gaussians_is_kept():
    rng = np.random.default_rng(0)
    dense = sheet(4000, 2, rng)
    corners = np.stack(np.meshgrid(np.arange(6), np.arange(6)), -1).reshape(-1, 2).astype(float)
    wall = np.column_stack([corners * 0.8 + [0, 4.0], np.full(36, 1.5)])  # fewer than 50, 0.8 apart
    mean = np.vstack([dense, wall])
    small = np.vstack([np.full((4000, 3), 0.01), np.full((36, 3), 0.01)])
    large = small.copy()
    large[4000:, :2] = 0.4  # overlapping discs
    assert marked(mean, small)[4000:].all()
    bridge = np.column_stack([np.full(9, 1.0), np.linspace(1.9, 4.0, 9), np.linspace(0, 1.5, 9)])
    mean = np.vstack([mean, bridge])
    large = np.vstack([large, np.full((9, 3), 0.15)])
    assert not marked(mean, large).any()


def test_the_marks_do_not_depend_on_order_or_unit():
    rng = np.random.default_rng(3)
    mean = np.vstack([sheet(2000, 3, rng), rng.uniform(0, 3, (30, 3)) + np.array([0, 0, 1])])
    scale = np.full_like(mean, 0.01)
    found = marked(mean, scale)
    order = rng.permutation(len(mean))
    np.testing.assert_array_equal(marked(mean[order], scale[order]), found[order])
    np.testing.assert_array_equal(marked(mean * 128, scale * 128), found)


def scattered(count, seed):
    """Clusters, needles that join some of them, and single points."""
    rng = np.random.default_rng(seed)
    mean = rng.normal(size=(count, 3)) * [3, 1, 0.2]
    mean[: count // 10] += rng.normal(size=(count // 10, 3)) * 30
    return mean, np.exp(rng.normal(-3, 1, (count, 3))), rng.normal(size=(count, 4))


def touched(mean, scale, quat, edge):
    """Cubes of each Gaussian, one by one."""
    mean, scale = mean.astype(np.float32).astype(float), scale.astype(np.float32).astype(float)
    axes = matrix_from_quat_wxyz((quat / np.linalg.norm(quat, axis=1, keepdims=True)).astype(np.float32))
    centred = mean - np.median(mean, axis=0)
    ends = [2 * sign * scale[:, a, None] * axes[:, :, a] for a in range(3) for sign in (1, -1)]
    return [
        {tuple(cell) for cell in np.floor(np.array(points) / edge).astype(int)}
        for points in zip(centred, *(centred + end for end in ends), strict=True)
    ]


def test_groups_are_those_of_a_plain_search():
    mean, scale, quat = scattered(1500, 1)
    arrays = (array.astype(np.float32) for array in (mean, scale, quat))
    drop, edge = floaters(*arrays, np.arange(len(mean)))
    owners: dict[tuple[int, ...], list[int]] = {}
    for row, cells in enumerate(mine := touched(mean, scale, quat.astype(np.float32), edge)):
        for cell in cells:
            owners.setdefault(cell, []).append(row)
    around = list(itertools.product((-1, 0, 1), repeat=3))
    group = [-1] * len(mine)
    for first in range(len(mine)):
        waiting = [first] if group[first] < 0 else []
        while waiting:
            row = waiting.pop()
            if group[row] >= 0:
                continue
            group[row] = first
            for x, y, z in mine[row]:
                for i, j, k in around:
                    waiting += [other for other in owners.get((x + i, y + j, z + k), ()) if group[other] < 0]
    size = np.bincount(group)
    largest = size.argmax()
    expected = [size[g] < SMALLEST_GROUP and g != largest for g in group]
    np.testing.assert_array_equal(drop, expected)
    assert 50 < drop.sum() < 1000


@pytest.mark.parametrize("part", [7, 300, 5000])
def test_floaters_do_not_depend_on_the_parts(monkeypatch, part):
    given_ = [array.astype(np.float32) for array in scattered(5000, 2)]
    whole = floaters(*given_, np.arange(len(given_[0])))
    monkeypatch.setattr("alula.stages.reconstruction.floaters._PART", part)
    monkeypatch.setattr("alula.stages.reconstruction.floaters._TREE", max(part, 100))
    found = floaters(*given_, np.arange(len(given_[0])))
    np.testing.assert_array_equal(found[0], whole[0])
    assert found[1] == whole[1]


def test_the_memory_for_floaters_is_bounded(monkeypatch):
    """650 bytes per Gaussian were 7.8 GB for a large capture."""
    count = 200_000
    given_ = [array.astype(np.float32) for array in scattered(count, 3)]
    monkeypatch.setattr("alula.stages.reconstruction.floaters._PART", 2**13)
    tracemalloc.start()
    floaters(*given_, np.arange(len(given_[0])))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 200 * count


def test_few_or_equal_points_have_no_floaters():
    assert not marked(np.random.default_rng(0).normal(size=(5, 3)), np.ones((5, 3))).any()
    assert not marked(np.zeros((100, 3)), np.ones((100, 3))).any()
    far = np.vstack([np.random.default_rng(0).normal(size=(100, 3)), [[1e30, 0, 0]]])
    assert marked(far, np.ones_like(far)).tolist() == [False] * 100 + [True]


def test_dropped_floaters_are_counted_and_the_rule_is_recorded():
    rng = np.random.default_rng(0)
    mean = np.vstack([sheet(2000, 3, rng), [[1, 1, 2]]]).astype(np.float32)
    given_ = Splats(
        format="ply",
        mean=mean,
        scale=np.full_like(mean, 0.01),
        quat_wxyz=np.tile(np.float32([1, 0, 0, 0]), (2001, 1)),
        opacity=np.ones(2001, np.float32),
        color=np.zeros((2001, 3), np.uint8),
    )
    scene = import_splat(ImportSplatConfig(drop_floaters=True), given_)
    assert removed(scene) == {"floaters": 1}
    assert len(scene["quat_wxyz"]) == 2000
    rule = scene.manifest.source["rules"]["floaters"]
    assert rule["smallest_group"] == SMALLEST_GROUP
    assert 0.1 < rule["cell"] < 0.4


def test_centres_far_from_the_origin_grow_by_their_rounding():
    rng = np.random.default_rng(0)
    true = rng.uniform(-2, 2, (500, 3)) + np.array([450_000.0, 4_500_000.0, 100.0])
    far = dataclasses.replace(splats(rows=500), mean=true.astype(np.float32))
    scene = import_splat(ImportSplatConfig(), far)
    shift = np.linalg.norm(scene["mean"] - true, axis=1)
    assert shift.max() > 0.2
    assert (shift <= scene["loss"][:, 0]).all()
    assert any("rounded by up to 0.251 file units" in note for note in scene.manifest.summary["notes"])
    near = import_splat(ImportSplatConfig(), dataclasses.replace(far, mean=far.mean - far.mean[0]))
    assert "loss" not in near.arrays
