"""Similarities: closed form, robust estimation (MSAC) and its uncertainty."""

import os
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from alula.schemas.artifacts.manifest import Similarity
from alula.schemas.errors import InputError
from alula.stages.alignment.robust import fit_similarity
from alula.stages.alignment.similarity import compose, inverse, transform_points, umeyama
from support.effort import examples, some


def true_similarity(rng):
    rotation = Rotation.random(random_state=int(rng.integers(2**31))).as_matrix()
    return Similarity(
        scale=float(np.exp(rng.normal())),
        rotation=rotation.tolist(),
        translation_m=rng.normal(size=3).tolist(),
    )


def case(seed, count=60, sigma=0.005, outliers=0.4):
    """Points in a room-sized cloud in the world, noise there, gross errors on some."""
    rng = np.random.default_rng(seed)
    truth = true_similarity(rng)
    world = rng.uniform(-1, 1, (count, 3)) * [3, 2, 1]
    source = (world - truth.translation_m) @ np.array(truth.rotation) / truth.scale
    measured = world + sigma * rng.normal(size=world.shape)
    wrong = rng.permutation(count)[: round(outliers * count)]
    measured[wrong] = rng.uniform(-1, 1, (len(wrong), 3)) * [3, 2, 1]
    good = np.ones(count, bool)
    good[wrong] = False
    return truth, source, measured, good


@settings(max_examples=examples(60), deadline=None)
@given(st.integers(0, 2**32), st.integers(4, 30))
def test_exact_correspondences_give_the_similarity_back(seed, count):
    truth, source, _, _ = case(seed, count)
    found = umeyama(source, transform_points(truth, source))
    assert found.scale == pytest.approx(truth.scale, rel=1e-12)
    np.testing.assert_allclose(found.rotation, truth.rotation, atol=1e-9)
    np.testing.assert_allclose(found.translation_m, truth.translation_m, atol=1e-9)
    assert np.linalg.det(np.array(found.rotation)) == pytest.approx(1, abs=1e-12)


@settings(max_examples=examples(40), deadline=None)
@given(st.integers(0, 2**32))
def test_no_similarity_nearby_has_a_smaller_sum_of_squares(seed):
    _, source, measured, _ = case(seed, 12, sigma=0.2, outliers=0)
    found = umeyama(source, measured)
    best = ((transform_points(found, source) - measured) ** 2).sum()
    rng = np.random.default_rng(seed)
    for _ in range(20):
        turn = Rotation.from_rotvec(0.01 * rng.normal(size=3)).as_matrix()
        other = Similarity(
            scale=found.scale * float(np.exp(0.01 * rng.normal())),
            rotation=(turn @ np.array(found.rotation)).tolist(),
            translation_m=(np.array(found.translation_m) + 0.01 * rng.normal(size=3)).tolist(),
        )
        assert ((transform_points(other, source) - measured) ** 2).sum() >= best


def test_pycolmap_finds_the_same():
    pycolmap = pytest.importorskip("pycolmap")
    for seed in range(20):
        _, source, measured, _ = case(seed, 9, sigma=0.1, outliers=0)
        theirs, ours = pycolmap.estimate_sim3d(source, measured), umeyama(source, measured)
        assert ours.scale == pytest.approx(theirs.scale, rel=1e-9)
        np.testing.assert_allclose(ours.rotation, theirs.rotation.matrix(), atol=1e-9)
        np.testing.assert_allclose(ours.translation_m, theirs.translation, atol=1e-8)


@pytest.mark.slow
def test_noise_and_outliers_leave_the_truth_within_the_reported_bounds():
    """60 cases of 95 % statements: more than 10 misses have a probability below 0.0004."""
    misses, outside, sigmas = 0, 0, []
    for seed in range(60):
        truth, source, measured, good = case(seed)
        fit = fit_similarity(source, measured, 0.03, seed=0)
        assert (fit.inlier == good).sum() >= 58  # a gross error may land close to the truth
        low, high = fit.uncertainty.record(fit.similarity)["scale_interval"]
        misses += not (low <= truth.scale <= high)
        sigmas.append(fit.sigma)
        box = np.array(list(product(*zip(source.min(0) * 2, source.max(0) * 2, strict=True))))
        error = np.linalg.norm(
            transform_points(fit.similarity, box) - transform_points(truth, box), axis=1
        ).max()
        bound = fit.uncertainty.position_error(transform_points(fit.similarity, box))
        outside += error > bound
        assert bound < 20 * error
    assert misses <= 10
    assert outside <= 10
    assert np.mean(sigmas) == pytest.approx(0.005, rel=0.05)


def test_the_bound_of_a_box_holds_inside_too():
    """The largest error over a box is at a corner, for errors of translation, scale and rotation."""
    _, source, measured, _ = case(3, outliers=0)
    fit = fit_similarity(source, measured, 0.1, 0)
    rng = np.random.default_rng(0)
    lower, upper = np.array([-1.0, -2, -3]), np.array([4.0, 3, 2])
    corners = np.array(list(product(*zip(lower, upper, strict=True))))
    bound = fit.uncertainty.position_error(transform_points(fit.similarity, corners))
    inside = transform_points(fit.similarity, rng.uniform(lower, upper, (50, 3)))
    for point in inside:
        assert fit.uncertainty.position_error(point[None]) <= bound


def test_the_spread_of_the_scale_is_that_of_repeated_measurements():
    rng = np.random.default_rng(0)
    truth, source, _, _ = case(1, 20, outliers=0)
    world = transform_points(truth, source)
    fits = [umeyama(source, world + 0.05 * rng.normal(size=world.shape)).scale for _ in range(4000)]
    x = source - source.mean(axis=0)
    assert np.std(fits) == pytest.approx(0.05 / np.sqrt((x * x).sum()), rel=0.04)


def test_leaving_one_out_equals_fitting_without_it():
    _, source, measured, _ = case(5, 10, sigma=0.05, outliers=0)
    fit = fit_similarity(source, measured, 1.0, 0)
    scales = [umeyama(np.delete(source, i, 0), np.delete(measured, i, 0)).scale for i in range(10)]
    np.testing.assert_allclose(fit.leave_one_out, [min(scales), max(scales)], rtol=1e-10)


def test_the_same_arguments_give_the_same_bits_and_any_seed_the_same_inliers():
    _, source, measured, _ = case(8, 100)
    first, again = (fit_similarity(source, measured, 0.03, 4) for _ in range(2))
    assert first.similarity == again.similarity
    other = fit_similarity(source, measured, 0.03, 5)
    np.testing.assert_array_equal(first.inlier, other.inlier)
    assert first.similarity == other.similarity


def test_composition_applies_the_first_first():
    rng = np.random.default_rng(0)
    first, second, points = true_similarity(rng), true_similarity(rng), rng.normal(size=(5, 3))
    np.testing.assert_allclose(
        transform_points(compose(second, first), points),
        transform_points(second, transform_points(first, points)),
        atol=1e-12,
    )
    back = transform_points(compose(inverse(first), first), points)
    np.testing.assert_allclose(back, points, atol=1e-12)


def line(count):
    return np.linspace(0, 1, count)[:, None] * [1.0, 2.0, 3.0]


@pytest.mark.parametrize(
    ("source", "target", "message"),
    [
        (np.eye(3)[:2], np.eye(3)[:2], "2 correspondences; three"),
        (line(9), line(9) * 2, "all 9 points are collinear in the scene"),
        (np.random.default_rng(0).normal(size=(9, 3)), line(9), "all 9 points are collinear in the world"),
        (np.ones((9, 3)), line(9), "all 9 points are collinear in the scene"),
    ],
)
def test_sets_that_determine_nothing_are_refused(source, target, message):
    with pytest.raises(InputError, match=message):
        fit_similarity(source, target, 0.1, 0)


@pytest.mark.every(5)
@pytest.mark.parametrize("count", [4, 5, 8, 60])
@pytest.mark.parametrize("sigma", [0.0, 0.005])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_mirrored_sets_are_refused(count, sigma, axis):
    for seed in range(5):
        _, source, measured, _ = case(seed, count, sigma, outliers=0)
        flip = np.ones(3)
        flip[axis] = -1
        with pytest.raises(InputError, match="mirror images"):
            fit_similarity(source * flip, measured, 0.05, 0)


def test_a_flat_mirrored_set_is_noticed_by_its_residuals():
    """2 cm of height within a threshold of 10 cm: every point is an inlier of both."""
    rng = np.random.default_rng(0)
    world = rng.uniform(-1, 1, (40, 3)) * [3, 2, 0.02]
    measured = world + 0.0005 * rng.normal(size=world.shape)
    with pytest.raises(InputError, match="mirror images"):
        fit_similarity(world * [1, 1, -1], measured, 0.1, 0)
    assert "planar" in fit_similarity(world, measured, 0.1, 0).warnings[0]


@pytest.mark.parametrize("count", [4, 6, 60])
def test_proper_sets_are_not_taken_for_mirrored_ones(count):
    for seed in some(range(40 if count < 10 else 10), 4):
        truth, source, measured, _ = case(seed, count, outliers=0)
        fit = fit_similarity(source, measured, 0.05, 0)
        assert fit.similarity.scale == pytest.approx(truth.scale, rel=0.05)


def test_a_plane_is_aligned_with_a_warning():
    rng = np.random.default_rng(0)
    source = rng.uniform(-1, 1, (20, 3)) * [1, 1, 0]
    truth = true_similarity(rng)
    fit = fit_similarity(source, transform_points(truth, source), 0.01, 0)
    assert fit.similarity.scale == pytest.approx(truth.scale)
    assert "nearly planar" in fit.warnings[0]
    narrow = fit_similarity(source * [1, 0.01, 0], transform_points(truth, source * [1, 0.01, 0]), 0.01, 0)
    assert "nearly collinear" in narrow.warnings[0]


def test_euroc_estimate_to_ground_truth():
    root = os.environ.get("ALULA_DATA")
    if not root:
        pytest.skip("ALULA_DATA is not set")
    folder = Path(root) / "euroc-mav-V1_02"
    truth = np.loadtxt(folder / "stamped_groundtruth.txt")
    estimate = np.loadtxt(folder / "stamped_ba_estimate0.txt")
    at = np.clip(np.searchsorted(truth[:, 0], estimate[:, 0]), 1, len(truth) - 1)
    at -= estimate[:, 0] - truth[at - 1, 0] < truth[at, 0] - estimate[:, 0]
    assert np.abs(truth[at, 0] - estimate[:, 0]).max() < 1e-4
    fit = fit_similarity(estimate[:, 1:4], truth[at, 1:4], 0.1, 0)
    assert fit.inlier.sum() == len(estimate) == 264
    assert fit.similarity.scale == pytest.approx(1.00978, abs=5e-6)
    assert np.sqrt((fit.residual**2).mean()) == pytest.approx(0.0132, abs=1e-4)
