"""The stage `scale-align`: from a scene in its own frame to metres."""

import json
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from alula.schemas.artifacts.artifact import encode_manifest
from alula.schemas.artifacts.manifest import Similarity
from alula.schemas.errors import CheckError, InputError, UsageError
from alula.schemas.parameters.configs.import_splat import ImportSplatConfig
from alula.schemas.parameters.configs.scale_align import ScaleAlignConfig
from alula.stages.alignment.evidence import Correspondences
from alula.stages.alignment.scale_align import scale_align, scale_only
from alula.stages.alignment.similarity import transform_points
from alula.stages.reconstruction.formats.splats import Splats
from alula.stages.reconstruction.import_splat import import_splat
from alula.stages.rotation import matrix_from_quat_wxyz
from support.effort import examples


def scene(rows=30, spread=1.0):
    rng = np.random.default_rng(0)
    splats = Splats(
        format="ply",
        mean=(spread * rng.normal(size=(rows, 3))).astype(np.float32),
        scale=np.exp(rng.normal(size=(rows, 3)) - 3).astype(np.float32),
        quat_wxyz=rng.normal(size=(rows, 4)).astype(np.float32),
        opacity=rng.uniform(0, 1, rows).astype(np.float32),
        color=rng.integers(0, 256, (rows, 3)).astype(np.uint8),
    )
    return import_splat(ImportSplatConfig(min_opacity=0), splats)


def similarity(seed=1, scale=2.5):
    rng = np.random.default_rng(seed)
    return Similarity(
        scale=scale,
        rotation=Rotation.random(random_state=seed).as_matrix().tolist(),
        translation_m=rng.normal(size=3).tolist(),
    )


def pairs(truth, count=20, sigma=0.002, seed=0):
    rng = np.random.default_rng(seed)
    source = rng.normal(size=(count, 3))
    world = transform_points(truth, source) + sigma * rng.normal(size=source.shape)
    return Correspondences(tuple(f"row {i}" for i in range(count)), source, world)


def covariances(scene_):
    rotation = matrix_from_quat_wxyz(scene_["quat_wxyz"])
    scale = np.asarray(scene_["scale"], np.float64)
    return rotation @ (scale[:, :, None] ** 2 * rotation.swapaxes(1, 2))


@settings(max_examples=examples(30), deadline=None)
@given(st.integers(0, 2**31), st.floats(1e-3, 1e3))
def test_means_and_covariances_are_those_of_the_mapped_gaussians(seed, scale):
    before, S = scene(), similarity(seed, scale)
    after = scale_align(ScaleAlignConfig(), before, S, 0)
    exact = transform_points(S, before["mean"])
    move = np.linalg.norm(after["mean"] - exact, axis=1).max()
    assert move <= after.manifest.alignment["rounding_m"] <= 2.0**-24 * 2 * np.abs(exact).max()
    sR = scale * np.array(S.rotation)
    expected = sR @ covariances(before) @ sR.T
    np.testing.assert_allclose(covariances(after), expected, atol=1e-5 * np.abs(expected).max())
    for name in ("opacity", "color"):
        np.testing.assert_array_equal(after[name], before[name])


def test_the_identity_changes_no_bit_of_means_and_scales():
    before = scene()
    after = scale_align(ScaleAlignConfig(), before, scale_only(1.0), 0)
    for name in ("mean", "scale"):
        np.testing.assert_array_equal(after[name], before[name])
    assert (after.manifest.frame, after.manifest.unit) == ("world", "m")
    assert after.manifest.alignment["rounding_m"] == 0


@settings(max_examples=examples(30), deadline=None)
@given(st.integers(0, 2**31), st.floats(1e-3, 1e3))
def test_the_stated_rounding_bounds_the_exact_shift_closely(seed, scale):
    before, S = scene(), similarity(seed, scale)
    after = scale_align(ScaleAlignConfig(), before, S, 0)

    def exact(point, axis):
        turned = sum(Fraction(r) * Fraction(p) for r, p in zip(S.rotation[axis], point, strict=True))
        return Fraction(scale) * turned + Fraction(S.translation_m[axis])

    shifts = [
        sum((Fraction(new[axis]) - exact(old, axis)) ** 2 for axis in range(3))
        for old, new in zip(before["mean"].tolist(), after["mean"].tolist(), strict=True)
    ]
    bound = Fraction(after.manifest.alignment["rounding_m"])
    assert max(shifts) <= bound**2 <= max(shifts) * Fraction(1.001)


def test_correspondences_are_reported_item_by_item():
    truth = similarity()
    evidence = pairs(truth)
    evidence.world[3] += 1.0
    shown = []
    found = scale_align(ScaleAlignConfig(threshold_m=0.02), scene(), evidence, 5, shown.append)
    record = found.manifest.alignment
    assert shown == [record]
    assert (record["count"], record["inliers"], record["seed"]) == (20, 19, 5)
    assert [item["item"] for item in record["items"] if not item["inlier"]] == ["row 3"]
    assert record["items"][3]["residual_m"] == pytest.approx(np.sqrt(3), abs=0.02)
    inliers = np.array([item["residual_m"] for item in record["items"] if item["inlier"]])
    assert record["rms_m"] == pytest.approx(np.sqrt((inliers**2).mean()))
    assert record["max_m"] == inliers.max()
    assert record["scale_interval"][0] < truth.scale < record["scale_interval"][1]
    assert record["determinant"] == pytest.approx(1)
    np.testing.assert_allclose(
        np.array(record["matrix"])[:3, :3] / record["scale"], truth.rotation, atol=0.005
    )
    assert 0 < record["position_error_m"] == found.manifest.suggested_inflation_m < 0.05
    assert found.manifest.world_from_scene.scale == record["scale"]
    json.loads(encode_manifest(found.manifest))
    assert "19 are" not in found.manifest.guarantee.statement


def test_a_larger_scene_needs_a_larger_inflation():
    near = scale_align(ScaleAlignConfig(), scene(), pairs(similarity()), 0)
    far = scale_align(ScaleAlignConfig(), scene(spread=50.0), pairs(similarity()), 0)
    ratio = far.manifest.suggested_inflation_m / near.manifest.suggested_inflation_m
    assert 10 < ratio < 60


@pytest.mark.parametrize(
    ("gate", "message"),
    [
        ({"max_rms_m": 0.001}, r"RMS residual is 0\.00\d+ m, above --max-rms 0.001 m"),
        ({"max_scale_sigma": 1e-6}, r"sigma is 0\.000\d+, above --max-scale-sigma 1e-06"),
        ({"min_inliers": 21}, "20 of 20 correspondences are inliers, 21 are needed"),
        ({"threshold_m": 1e-4}, r"\d of 20 correspondences are inliers, 11 are needed"),
    ],
)
def test_gates_fail_with_the_figure_and_the_limit_after_the_report(gate, message):
    shown = []
    with pytest.raises(CheckError, match=message):
        scale_align(ScaleAlignConfig(**gate), scene(), pairs(similarity()), 0, shown.append)
    assert len(shown) == 1
    loose = ScaleAlignConfig(max_rms_m=0.01, max_scale_sigma=0.01, min_inliers=20)
    scale_align(loose, scene(), pairs(similarity()), 0)


def test_distances_fix_the_scale_alone():
    distances = (((0, 0, 0), (1, 0, 0), 2.0), ((0, 0, 0), (0, 2, 0), 4.02), ((1, 1, 1), (1, 1, 4), 5.97))
    found = scale_align(ScaleAlignConfig(), scene(), distances, 0).manifest
    lengths, metres = np.array([1.0, 2, 3]), np.array([2.0, 4.02, 5.97])
    line = np.linalg.lstsq(lengths[:, None], metres, rcond=None)
    assert found.world_from_scene.scale == pytest.approx(float(line[0][0]), rel=1e-12)
    assert found.world_from_scene.rotation == np.eye(3).tolist()
    sigma = np.sqrt(float(line[1][0]) / 2 / (lengths @ lengths))
    assert found.alignment["scale_sigma"] == pytest.approx(sigma, rel=1e-9)
    assert found.alignment["scale_interval"][1] - found.alignment["scale"] == pytest.approx(
        4.3027 * sigma, 1e-4
    )
    assert found.suggested_inflation_m > 0
    with pytest.raises(CheckError, match="RMS residual"):
        scale_align(ScaleAlignConfig(max_rms_m=0.001), scene(), distances, 0)


def test_one_distance_has_no_uncertainty_to_report():
    one = (((0, 0, 0), (1, 0, 0), 2.0),)
    found = scale_align(ScaleAlignConfig(), scene(), one, 0).manifest
    assert "one distance" in found.summary["warnings"][0]
    assert "not known" in found.guarantee.statement
    assert found.guarantee.claims["position_error_m"] is None
    with pytest.raises(CheckError, match="sigma is unknown"):
        scale_align(ScaleAlignConfig(max_scale_sigma=1.0), scene(), one, 0)


@pytest.mark.parametrize("gate", [{"max_rms_m": 1.0}, {"max_scale_sigma": 1.0}, {"min_inliers": 3}])
def test_a_given_similarity_has_nothing_to_check(gate):
    with pytest.raises(UsageError, match="need measurements; a given similarity has none"):
        scale_align(ScaleAlignConfig(**gate), scene(), scale_only(2.0), 0)


def test_aligning_again_composes_and_adds_the_errors():
    first = scale_align(ScaleAlignConfig(), scene(), pairs(similarity()), 0)
    second = scale_align(ScaleAlignConfig(rescale=True), first, similarity(2, 3.0), 0)
    assert second.manifest.suggested_inflation_m == pytest.approx(3 * first.manifest.suggested_inflation_m)
    assert second.manifest.alignment["previous"]["method"] == "correspondences"
    assert second.manifest.alignment["from_frame"] == "world"
    whole = transform_points(second.manifest.world_from_scene, scene()["mean"])
    np.testing.assert_allclose(second["mean"], whole, atol=5e-6)


def test_metres_are_not_rescaled_without_insistence():
    metric = scale_align(ScaleAlignConfig(), scene(), scale_only(1.8), 0)
    for factor in (1.8, 0.9, 1 / 1.8):
        with pytest.raises(
            CheckError, match=rf"in metres already, and this would make {factor:.6g} m of each"
        ):
            scale_align(ScaleAlignConfig(), metric, scale_only(factor), 0)
        again = scale_align(ScaleAlignConfig(rescale=True), metric, scale_only(factor), 0)
        assert (
            f"the scene was in metres already; a metre of it becomes {factor:.6g} m"
            in (again.manifest.alignment["warnings"])
        )
    corrected = scale_align(ScaleAlignConfig(), metric, scale_only(1.02), 0)
    assert any("becomes 1.02 m" in warning for warning in corrected.manifest.alignment["warnings"])
    moved = scale_align(ScaleAlignConfig(), metric, similarity(2, 1.0), 0)
    assert not any("metres already" in warning for warning in moved.manifest.alignment["warnings"])


def test_what_does_not_fit_single_precision_is_refused():
    with pytest.raises(InputError, match="the mean of Gaussian 0 does not fit"):
        scale_align(ScaleAlignConfig(), scene(spread=1e34), scale_only(1e8), 0)
    tiny = scale_align(ScaleAlignConfig(), scene(), scale_only(1e-9), 0)
    assert (tiny["scale"] > 0).all()


def test_an_origin_far_away_is_warned_of():
    far = Similarity(scale=1.0, rotation=np.eye(3).tolist(), translation_m=[650_000.0, 4_540_000.0, 0.0])
    as_it_is = ScaleAlignConfig(map_origin=(0.0, 0.0, 0.0))
    found = scale_align(as_it_is, scene(), far, 0).manifest
    assert 0.1 < found.alignment["rounding_m"] < 0.5
    assert "origin nearer to the scene" in found.summary["warnings"][-1]
    near = scale_align(ScaleAlignConfig(), scene(), scale_only(1.0), 0).manifest
    assert len(near.summary["warnings"]) == 1


def test_rounding_far_from_the_origin_is_part_of_the_suggested_inflation():
    as_it_is = ScaleAlignConfig(map_origin=(0.0, 0.0, 0.0))
    near, far = similarity(), similarity()
    far.translation_m[:] = [650_000.0, 4_540_000.0, 0.0]
    found, other = (scale_align(as_it_is, scene(), pairs(s), 0).manifest for s in (near, far))
    rounded = other.alignment["rounding_m"]
    assert rounded > 0.1
    grown = other.suggested_inflation_m - found.suggested_inflation_m
    assert grown == pytest.approx(rounded, rel=1e-3)
    assert f"{other.suggested_inflation_m:.3g} m" in other.guarantee.statement
    given_far = scale_align(as_it_is, scene(), far, 0).manifest
    assert given_far.suggested_inflation_m == given_far.alignment["rounding_m"]
    assert given_far.alignment["position_error_m"] is None


def test_the_bound_holds_for_the_ellipsoids_and_not_only_for_their_centres():
    found = pairs(similarity(), count=6, sigma=0.02)
    small = scene()
    large = scene()
    large["scale"][0] = 40.0
    bounds = [scale_align(ScaleAlignConfig(), s, found, 0).manifest for s in (small, large)]
    assert bounds[1].suggested_inflation_m > 10 * bounds[0].suggested_inflation_m
    # The tip of the long ellipsoid by the true similarity, and by the one that was found.
    tip = large["mean"][0].astype(float) + 3 * 40 * np.eye(3)
    moved = [transform_points(s, tip) for s in (similarity(), bounds[1].world_from_scene)]
    off = np.linalg.norm(moved[0] - moved[1], axis=1).max()
    assert bounds[0].suggested_inflation_m < off < bounds[1].suggested_inflation_m


def test_distances_that_disagree_are_refused():
    wrong = (((0, 0, 0), (1, 0, 0), 2.5), ((0, 0, 0), (0, 1, 0), 5.6))
    with pytest.raises(CheckError, match="0 of 2 correspondences are inliers"):
        scale_align(ScaleAlignConfig(), scene(), wrong, 0)
    loose = scale_align(ScaleAlignConfig(threshold_m=2.0), scene(), wrong, 0).manifest
    assert loose.alignment["inliers"] == 2


def test_a_drift_is_warned_of():
    truth, count = similarity(), 80
    found = pairs(truth, count, sigma=0.0)
    drift = np.cumsum(np.random.default_rng(4).normal(size=(count, 3)), axis=0)
    drift *= 0.02 / drift.std()
    order = np.argsort(found.scene[:, 0])
    found.world[order] += drift - drift.mean(axis=0)
    warnings = scale_align(ScaleAlignConfig(), scene(), found, 0).manifest.alignment["warnings"]
    assert any("residuals of neighbours are alike" in w for w in warnings)
    sound = scale_align(ScaleAlignConfig(), scene(), pairs(truth, count, 0.02), 0).manifest
    assert not sound.alignment["warnings"]


@pytest.mark.parametrize(
    "wrong",
    [
        {"threshold_m": 0.0},
        {"max_rms_m": -1.0},
        {"scale": 0.0},
        {"scale": -1.0},
        {"min_inliers": 0},
        {"distances": (((0, 0, 0), (1, 0, 0), 0.0),)},
        {"distances": (((1, 0, 0), (1, 0, 0), 1.0),)},
        {"distances": (((0, 0, 0), (1, 0, 0), 1.0), ((1, 0, 0), (0, 0, 0), 1.0))},
    ],
)
def test_parameters_that_mean_nothing_are_refused(wrong):
    with pytest.raises(UsageError):
        ScaleAlignConfig(**wrong)
