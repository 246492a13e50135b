"""Coverage of the reported 95 % intervals over many seeds, and agreement with COLMAP's own fit."""

import os
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from alula.schemas.artifacts.manifest import Similarity
from alula.stages.alignment.robust import fit_similarity
from alula.stages.alignment.similarity import transform_points, umeyama
from alula.stages.alignment.uncertainty import uncertainty_of_points, untruncated

pycolmap = pytest.importorskip("pycolmap")


@pytest.fixture(scope="module")
def cameras():
    """Centres of 60 cameras around a synthetic COLMAP model."""
    settings = pycolmap.SyntheticDatasetOptions()
    settings.num_rigs, settings.num_frames_per_rig, settings.num_points3D = 1, 60, 20
    pycolmap.set_random_seed(3)
    model = pycolmap.synthesize_dataset(settings)
    found = np.array([image.projection_center() for image in model.images.values()])
    assert found.shape == (60, 3)
    return found


def draw(rng, cameras, sigma, outliers):
    """A random similarity, and where a survey with gross errors says that the cameras are."""
    truth = Similarity(
        scale=float(np.exp(0.5 * rng.normal())),
        rotation=Rotation.from_rotvec(2 * rng.normal(size=3)).as_matrix().tolist(),
        translation_m=rng.normal(size=3).tolist(),
    )
    world = transform_points(truth, cameras)
    measured = world + sigma * rng.normal(size=world.shape)
    wrong = rng.permutation(len(world))[: round(outliers * len(world))]
    measured[wrong] = rng.uniform(world.min(axis=0), world.max(axis=0), (len(wrong), 3))
    return truth, measured


def covered(cameras, sigma, threshold, seeds, outliers=0.4):
    """Shares of seeds whose intervals hold the scale, three angles, three shifts; and all of the box."""
    held, box = np.zeros(7), 0
    corners = np.array(list(product(*zip(cameras.min(axis=0), cameras.max(axis=0), strict=True))))
    for seed in range(seeds):
        truth, measured = draw(np.random.default_rng([seed, len(cameras)]), cameras, sigma, outliers)
        fit = fit_similarity(cameras, measured, threshold, 0)
        record = fit.uncertainty.record(fit.similarity)
        low, high = record["scale_interval"]
        turn = np.array(truth.rotation) @ np.array(fit.similarity.rotation).T
        off = np.abs(Rotation.from_matrix(turn).as_rotvec(degrees=True))
        shift = np.abs(np.subtract(truth.translation_m, fit.similarity.translation_m))
        held[0] += low <= truth.scale <= high
        held[1:4] += off <= record["rotation_interval_deg"]
        held[4:] += shift <= record["translation_interval_m"]
        mapped = transform_points(fit.similarity, corners)
        error = np.linalg.norm(transform_points(truth, corners) - mapped, axis=1).max()
        box += error <= fit.uncertainty.position_error(mapped)
    return held / seeds, box / seeds


@pytest.mark.slow
def test_five_hundred_seeds_with_noise_and_40_percent_outliers(cameras):
    held, box = covered(cameras, 0.01, 0.1, 500)
    assert (held >= 0.93).all(), held
    assert (held <= 0.97).all(), held
    assert box >= 0.95


@pytest.mark.slow
@pytest.mark.parametrize(("count", "sigma"), [(12, 0.1 / 3), (30, 0.1 / 3), (12, 0.001)])
def test_few_cameras_and_noise_that_fills_a_third_of_the_threshold(cameras, count, sigma):
    """250 seeds: the standard error is 1.4 %."""
    held, box = covered(cameras[:count], sigma, 0.1, 250)
    assert (held >= 0.90).all(), held
    assert box >= 0.95


def on_a_path(count, rng):
    t = np.linspace(0, 2 * np.pi, count, endpoint=False) * rng.uniform(0.6, 1.4)
    return np.stack([3 * np.cos(t), 2 * np.sin(t + rng.uniform(0, 6)), 0.6 * np.sin(2 * t)], axis=1)


@pytest.mark.slow
@pytest.mark.parametrize(("count", "least"), [(20, 0.82), (60, 0.85)])
def test_intervals_are_wider_where_errors_drift_along_the_path(count, least):
    """Intervals for independent errors held the scale in 51 % of such trials with 20, in 32 % with 60."""
    held = sound = 0
    for seed in range(60):
        rng = np.random.default_rng([seed, count])
        source = on_a_path(count, rng)
        walk = np.cumsum(rng.normal(size=(count, 3)), axis=0)
        walk -= walk.mean(axis=0)
        fit = fit_similarity(source, 1.3 * source + 0.02 / walk.std() * walk, 0.1, 0)
        low, high = fit.uncertainty.record(fit.similarity)["scale_interval"]
        held += low <= 1.3 <= high
        sound += fit.correlated > 0.9
    assert held >= least * 60
    assert sound >= 50


@pytest.mark.slow
def test_independent_errors_hardly_widen_the_intervals():
    ratios, found = [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        source = on_a_path(60, rng)
        fit = fit_similarity(source, source + 0.01 * rng.normal(size=source.shape), 0.1, 0)
        plain = uncertainty_of_points(transform_points(fit.similarity, source), fit.sigma, 173)
        ratios.append(np.sqrt(fit.uncertainty.covariance[3, 3] / plain.covariance[3, 3]))
        found.append(fit.correlated)
    assert np.median(ratios) < 1.1
    assert np.median(found) < 0.5


@pytest.mark.slow
def test_euroc_intervals_of_a_drifting_estimate_contain_the_scale_of_the_whole():
    """Each quarter of the flight against the scale of all of it, which has an error too."""
    root = os.environ.get("ALULA_DATA")
    if not root:
        pytest.skip("ALULA_DATA is not set")
    folder = Path(root) / "euroc-mav-V1_02"
    truth = np.loadtxt(folder / "stamped_groundtruth.txt")
    held = missed = 0
    for name in ("stamped_ba_estimate0.txt", "stamped_ba_estimate1.txt"):
        estimate = np.loadtxt(folder / name)
        at = np.abs(truth[:, 0] - estimate[:, :1]).argmin(axis=1)
        x, y = estimate[:, 1:4], truth[at, 1:4]
        whole = fit_similarity(x, y, 0.1, 0).similarity.scale
        for part in np.array_split(np.arange(len(x)), 4):
            fit = fit_similarity(x[part], y[part], 0.1, 0)
            low, high = fit.uncertainty.record(fit.similarity)["scale_interval"]
            held += low <= whole <= high
            mapped = transform_points(fit.similarity, x[part][fit.inlier])
            plain = uncertainty_of_points(mapped, fit.sigma, 3 * len(mapped) - 7).record(fit.similarity)
            missed += not plain["scale_interval"][0] <= whole <= plain["scale_interval"][1]
    assert held >= 7
    assert missed >= 4  # with intervals for independent errors


@pytest.mark.slow
def test_without_the_correction_intervals_would_miss(cameras):
    """Errors of a third of the threshold: 3 % are cut off, and the naive sigma is 9 % too small."""
    rng = np.random.default_rng(0)
    error = rng.normal(size=(200_000, 3)) / 3
    kept = error[np.linalg.norm(error, axis=1) <= 1]
    naive = float(np.sqrt((kept**2).mean()))
    found = untruncated(naive, 3.0 * len(kept), 1.0)
    assert found.error == pytest.approx(1 / 3, rel=0.01)
    assert found.fit > 1.08 * naive
    assert found.freedom < 0.5 * 3 * len(kept)
    world = cameras.copy()
    scales, sizes = [], []
    for seed in range(400):
        draws = np.random.default_rng(seed)
        fit = fit_similarity(world, world + 0.1 / 3 * draws.normal(size=world.shape), 0.1, 0)
        scales.append(fit.similarity.scale)
        sizes.append(np.sqrt(fit.uncertainty.covariance[3, 3]))
    assert np.mean(sizes) == pytest.approx(np.std(scales), rel=0.08)  # 400 give 3.5 %
    untouched = untruncated(0.001, 10.0, 1.0)
    assert (untouched.error, untouched.fit, untouched.freedom) == (0.001, 0.001, 10.0)
    assert untruncated(5.0, 10.0, 1.0).error == pytest.approx(2 / 3)


def test_covariances_are_those_of_repeated_fits(cameras):
    rng = np.random.default_rng(0)
    sigma, few = 0.02, cameras[:15]
    fits = [umeyama(few, few + sigma * rng.normal(size=few.shape)) for _ in range(3000)]
    point = np.array([[4.0, -3.0, 7.0]])
    moved = np.array([transform_points(fit, point)[0] for fit in fits])
    expected = uncertainty_of_points(few, sigma, 38).at(point)[0]
    np.testing.assert_allclose(np.cov(moved.T), expected, atol=0.1 * np.trace(expected) / 3)


def test_colmap_agrees_robustly_and_on_the_inliers(cameras):
    for seed in range(5):
        _, measured = draw(np.random.default_rng(seed), cameras, 0.01, 0.4)
        ours = fit_similarity(cameras, measured, 0.1, 0)
        options = pycolmap.RANSACOptions()
        options.max_error, options.random_seed = 0.1, 0
        theirs = pycolmap.estimate_sim3d_robust(cameras, measured, options)
        mask = np.asarray(theirs["inlier_mask"], bool)
        assert (mask != ours.inlier).sum() <= 1
        exact = pycolmap.estimate_sim3d(cameras[ours.inlier], measured[ours.inlier])
        assert ours.similarity.scale == pytest.approx(exact.scale, rel=1e-9)
        np.testing.assert_allclose(ours.similarity.rotation, exact.rotation.matrix(), atol=1e-9)
        np.testing.assert_allclose(ours.similarity.translation_m, exact.translation, atol=1e-8)
        assert theirs["tgt_from_src"].scale == pytest.approx(exact.scale, rel=0.01)


def test_ten_thousand_correspondences_of_which_most_are_wrong(cameras):
    rng = np.random.default_rng(0)
    points = rng.normal(size=(10_000, 3)) * [3, 2, 1]
    truth, measured = draw(rng, points, 0.01, 0.6)
    fit = fit_similarity(points, measured, 0.1, 0)
    assert fit.similarity.scale == pytest.approx(truth.scale, rel=1e-3)
    assert 4000 <= fit.inlier.sum() <= 4020  # gross errors may land near the truth


def drifting(seed, growth):
    """A path whose estimate grows along it, as one with a drifting scale: no similarity describes it."""
    rng = np.random.default_rng([seed, 61])
    source = on_a_path(60, rng)
    steps = np.diff(source, axis=0) * np.linspace(1, 1 + growth, 59)[:, None]
    target = np.concatenate([source[:1], source[0] + np.cumsum(steps, axis=0)])
    return source, target + 0.002 * rng.normal(size=target.shape)


def test_parts_of_a_path_that_disagree_about_the_scale_are_named():
    source, target = drifting(19, 0.06)
    fit = fit_similarity(source, target, 0.3, 0)
    (said,) = (
        warning for warning in fit.warnings if "the parts of the path have different scales" in warning
    )
    assert "which no single similarity describes" in said
    low, high = fit.uncertainty.record(fit.similarity)["scale_interval"]
    assert low < 1.0 < 1.06 < high  # the scales of its ends
    source, target = drifting(19, 0.0)
    fit = fit_similarity(source, target, 0.3, 0)
    assert not any("parts of the path" in warning for warning in fit.warnings)


def test_halves_of_euroc_estimates_do_not_contradict_each_other():
    root = os.environ.get("ALULA_DATA")
    if not root:
        pytest.skip("ALULA_DATA is not set")
    folder = Path(root) / "euroc-mav-V1_02"
    truth = np.loadtxt(folder / "stamped_groundtruth.txt")
    for name in ("stamped_ba_estimate0.txt", "stamped_ba_estimate1.txt"):
        estimate = np.loadtxt(folder / name)
        at = np.abs(truth[:, 0] - estimate[:, :1]).argmin(axis=1)
        fits = [
            fit_similarity(estimate[part, 1:4], truth[at[part], 1:4], 0.1, 0)
            for part in np.array_split(np.arange(len(estimate)), 2)
        ]
        one, two = (fit.uncertainty.record(fit.similarity)["scale_interval"] for fit in fits)
        assert max(one[0], two[0]) <= min(one[1], two[1])
