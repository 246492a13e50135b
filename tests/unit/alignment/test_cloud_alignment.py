"""Registration to a surveyed cloud: unbiased on partial overlap, with a realistic uncertainty."""

import os
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from alula.schemas.artifacts.manifest import Similarity
from alula.schemas.errors import CheckError, InputError
from alula.stages.alignment.cloud import fit_cloud, icp
from alula.stages.alignment.cloud_files import read_cloud
from alula.stages.alignment.estimates import scale_only
from alula.stages.alignment.sampling import blocks, jackknife, thinned
from alula.stages.alignment.similarity import compose, inverse, transform_points


def box(rng, low, high, density):
    """Points on the six faces of a box."""
    low, high = np.array(low, float), np.array(high, float)
    parts = []
    for axis in range(3):
        b, c = (axis + 1) % 3, (axis + 2) % 3
        size = high - low
        for wall in (low, high):
            points = low + rng.uniform(size=(int(density * size[b] * size[c]) + 1, 3)) * size
            points[:, axis] = wall[axis]
            parts.append(points)
    return np.concatenate(parts)


def room(rng, density=70):
    boxes = [([0, 0, 0], [8, 6, 3]), ([1, 1, 0], [2.5, 2, 0.8]), ([5, 4, 0], [6, 5.5, 1.2])]
    return np.concatenate([box(rng, *corners, density) for corners in boxes])


def guess(rng, truth, size=1.0):
    step = Similarity(
        scale=1 + 0.02 * size * float(rng.normal()),
        rotation=Rotation.from_rotvec(0.02 * size * rng.normal(size=3)).as_matrix().tolist(),
        translation_m=(0.05 * size * rng.normal(size=3)).tolist(),
    )
    return compose(step, truth)


def similarity(seed, scale=2.5):
    rotation = Rotation.random(random_state=seed).as_matrix().tolist()
    return Similarity(scale=scale, rotation=rotation, translation_m=[1.0, -2.0, 3.0])


def case(seed, noise=0.01, lumps=0.0):
    """A room in the scene's units, a cloud of its half x < 4 m, both noisy, and a rough first guess.

    `lumps` moves all Gaussians within a cube of 0.7 m alike: the errors of neighbours in a splat.
    """
    rng = np.random.default_rng(seed)
    splat, survey = room(rng), room(rng)
    survey = survey[survey[:, 0] < 4]
    splat = splat + noise * rng.normal(size=splat.shape)
    if lumps:
        label = np.unique(np.floor(splat / 0.7), axis=0, return_inverse=True)[1].reshape(-1)
        splat = splat + lumps * rng.normal(size=(label.max() + 1, 3))[label]
    survey = survey + noise * rng.normal(size=survey.shape)
    truth = similarity(seed)
    return truth, transform_points(inverse(truth), splat), survey, guess(rng, truth)


@pytest.fixture(scope="module")
def trials():
    found = []
    for seed in range(16):
        truth, source, survey, first = case(seed, lumps=0.01 if seed >= 8 else 0.0)
        found.append((truth, fit_cloud(source, survey, first, 0.1, 0.3)))
    return found


@pytest.mark.slow
def test_half_a_cloud_does_not_bias_the_scale(trials):
    for part in (trials[:8], trials[8:]):
        off = np.array([fit.similarity.scale / truth.scale - 1 for truth, fit in part])
        assert abs(off.mean()) < 5e-4  # 0.05 %
        assert abs(off).max() < 2e-3
    off = np.array([fit.similarity.scale / truth.scale - 1 for truth, fit in trials[:8]])
    assert abs(off.mean()) < 2e-4
    assert abs(off).max() < 6e-4


@pytest.mark.slow
def test_intervals_hold_the_truth_also_when_neighbours_err_alike(trials):
    """8 cases of 95 %: more than 2 misses have a probability of 0.006; as if independent most miss."""
    for part in (trials[:8], trials[8:]):
        inside = 0
        for truth, fit in part:
            low, high = fit.uncertainty.record(fit.similarity)["scale_interval"]
            inside += low <= truth.scale <= high
        assert inside >= 6
    naive = 0
    for truth, fit in trials[8:]:
        spread = (fit.singular_values**2).sum()
        sigma = np.sqrt((fit.residual**2).mean() / spread)
        naive += abs(fit.similarity.scale / truth.scale - 1) < 1.96 * sigma
    assert naive < 6


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2, 9])
def test_the_first_guess_hardly_matters_and_intervals_hold_whatever_it_is(seed):
    truth, source, survey, _ = case(seed, lumps=0.01 if seed == 9 else 0.0)
    found = []
    for k in range(5):
        first = guess(np.random.default_rng(100 + k), truth, (1, 1, 1.5, 2, 2.5)[k])
        fit = fit_cloud(source, survey, first, 0.1, 0.3)
        off = fit.similarity.scale / truth.scale - 1
        sigma = float(np.sqrt(fit.uncertainty.covariance[3, 3]))
        assert abs(off) < 2.2 * sigma
        found.append((off, sigma))
    off, sigma = np.array(found).T
    assert np.ptp(off) < sigma.min()


def test_the_overlap_is_reported():
    _, source, survey, first = case(0)
    fit = fit_cloud(source, survey, first, 0.1, 0.3)
    assert 0.4 < fit.scene_fraction < 0.6
    assert fit.cloud_fraction > 0.85
    assert len(fit.block_centre) >= 10
    low, high = fit.leave_one_out
    assert low < fit.similarity.scale < high


@pytest.mark.slow
def test_it_repeats_to_the_bit():
    _, source, survey, first = case(3)
    one, two = (fit_cloud(source, survey, first, 0.1, 0.3) for _ in range(2))
    assert one.similarity == two.similarity
    np.testing.assert_array_equal(one.uncertainty.covariance, two.uncertainty.covariance)


@pytest.mark.slow
def test_coarse_rounds_equal_those_of_another_library():
    open3d = pytest.importorskip("open3d")
    _, source, survey, first = case(2)
    mapped = transform_points(first, source)[::5]
    ours = icp(mapped, survey, cKDTree(survey), scale_only(1.0), 0.4)
    registration = open3d.pipelines.registration
    source_cloud, target_cloud = (
        open3d.geometry.PointCloud(open3d.utility.Vector3dVector(p)) for p in (mapped, survey)
    )
    theirs = registration.registration_icp(
        source_cloud,
        target_cloud,
        0.4,
        np.eye(4),
        registration.TransformationEstimationPointToPoint(with_scaling=True),
        registration.ICPConvergenceCriteria(1e-12, 1e-12, 200),
    ).transformation
    moved = transform_points(ours, mapped)
    np.testing.assert_allclose(mapped @ theirs[:3, :3].T + theirs[:3, 3], moved, atol=0.01)


def test_too_little_overlap_is_a_failed_check_with_figure_and_limit():
    _, source, survey, first = case(0)
    with pytest.raises(CheckError, match=r"\d\.\d% of the scene .* below --min-fitness 0.3"):
        fit_cloud(source, survey + 20, first, 0.1, 0.3)
    with pytest.raises(CheckError, match=r"below --min-fitness 0\.999"):
        fit_cloud(source, survey, first, 0.1, 0.999)


def test_surfaces_that_are_not_the_same_are_a_failed_check():
    def plates(seed):
        rng = np.random.default_rng(seed)
        flat = rng.uniform(-0.6, 0.6, (250, 120, 3)) * [1, 1, 0.01]
        turn = Rotation.random(250, random_state=seed).as_matrix()
        return (flat @ turn.swapaxes(1, 2) + rng.uniform(-5, 5, (250, 1, 3))).reshape(-1, 3)

    with pytest.raises(CheckError, match=r"RMS residual is .* surfaces that are not the same"):
        fit_cloud(plates(1), plates(2), scale_only(1.0), 0.5, 0.3)
    fit = fit_cloud(plates(1), plates(1)[::2], scale_only(1.01), 0.5, 0.3)
    assert fit.similarity.scale == pytest.approx(1.0, abs=2e-3)


def test_surfaces_along_which_it_slides_are_refused():
    rng = np.random.default_rng(0)
    identity = Similarity(scale=1.0, rotation=np.eye(3).tolist(), translation_m=[0.0, 0.0, 0.0])
    plane, other = (rng.uniform(0, 5, (9000, 3)) * [1, 1, 0] for _ in range(2))
    with pytest.raises(InputError, match="does not determine the similarity"):
        fit_cloud(plane, other, identity, 0.1, 0.3)
    ball, shell = (rng.normal(size=(9000, 3)) for _ in range(2))
    ball, shell = (p / np.linalg.norm(p, axis=1, keepdims=True) for p in (ball, shell))
    with pytest.raises(InputError, match="does not determine the similarity"):
        fit_cloud(ball, shell, identity, 0.1, 0.3)
    with pytest.raises(InputError, match="only 3 points to register"):
        fit_cloud(np.eye(3), np.eye(3), identity, 0.1, 0.3)


def test_means_of_cubes():
    points = np.array([[0.0, 0, 0], [0.4, 0, 0], [1.2, 0, 0], [0.2, 0.9, 0]])
    for many in (1, 100):  # few cubes beside the points are counted in another way
        spread = np.tile(points, (many, 1))
        np.testing.assert_allclose(thinned(spread, 0.5), [[0.2, 0, 0], [0.2, 0.9, 0], [1.2, 0, 0]])
    with pytest.raises(InputError, match="spread too far"):
        thinned(np.array([[0.0, 0, 0], [1e12, 1e12, 1e12]]), 1e-3)
    label, count, edge = blocks(np.random.default_rng(0).uniform(size=(5000, 3)), 0.01, 40)
    assert count >= 40
    assert 0.2 < edge < 0.5
    assert label.max() == count - 1


def test_the_jackknife_of_a_mean_is_its_standard_error():
    values = np.random.default_rng(0).normal(size=50)
    score = (values - values.mean())[:, None]
    found = jackknife(np.ones((50, 1, 1)), score)
    assert found[0, 0] == pytest.approx(values.var(ddof=1) / 50)


def test_clouds_from_files(tmp_path):
    open3d = pytest.importorskip("open3d")
    points = np.random.default_rng(0).normal(size=(20, 3))
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    for name in ("a.ply", "a.pcd", "a.xyz"):
        assert open3d.io.write_point_cloud(str(tmp_path / name), cloud)
        np.testing.assert_allclose(read_cloud(tmp_path / name), points, atol=1e-6)
    np.savez(tmp_path / "a.npz", points=points.astype(np.float32))
    np.testing.assert_allclose(read_cloud(tmp_path / "a.npz"), points, atol=1e-6)


def test_files_that_are_no_cloud_are_refused(tmp_path, capfd):
    pytest.importorskip("open3d")

    def refused(name, content, message):
        if isinstance(content, bytes):
            (tmp_path / name).write_bytes(content)
        elif content is not None:
            np.savez(tmp_path / name, **content)
        with pytest.raises(InputError, match=message):
            read_cloud(tmp_path / name)

    refused("a.las", b"", "clouds end in .ply")
    refused("none.ply", None, "cannot read")
    refused("bad.ply", b"ply\nnonsense", "PLY: truncated, or no line 'end_header'")
    refused("bad.npz", b"no zip", "no readable .npz")
    refused("keys.npz", {"colors": np.ones((3, 3))}, "has no array points or xyz or positions, only colors")
    refused("flat.npz", {"points": np.ones((3, 2))}, r"shape \(n, 3\), not \(3, 2\)")
    refused("nan.npz", {"points": np.array([[0, 0, 0], [np.nan, 0, 0]])}, "point 1 is not finite")
    header = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
    refused("nan.ply", f"{header}end_header\nnan 0 0\n".encode(), "point 0 is not finite")
    assert capfd.readouterr().out == ""


def test_a_real_cloud_half_covered_by_its_noisy_copy():
    root = os.environ.get("ALULA_DATA")
    if not root:
        pytest.skip("ALULA_DATA is not set")
    with np.load(Path(root) / "garden-npz/test_garden.npz") as file:
        points = np.asarray(file["means3d"], np.float64)
    points = points[np.linalg.norm(points, axis=1) < 6]
    rng = np.random.default_rng(0)
    truth = similarity(1)
    splat = transform_points(inverse(truth), points[::2] + 0.005 * rng.normal(size=points[::2].shape))
    survey = points[1::2]
    survey = survey[survey[:, 0] < np.median(survey[:, 0])]
    survey = survey + 0.005 * rng.normal(size=survey.shape)
    fit = fit_cloud(splat, survey, guess(rng, truth, 0.5), 0.1, 0.3)
    off = abs(fit.similarity.scale / truth.scale - 1)
    assert off < 1e-3
    assert off < 4 * np.sqrt(fit.uncertainty.covariance[3, 3])
    assert fit.cloud_fraction > 0.98
