"""The sensors of obstacles: what is seen, how well, with which ghosts; a function of (seed, trial, step)."""

import numpy as np
import pytest
from scipy import stats

from alula._core import RadarOptions, obstacle_paths, own_states, radar_scans
from support.flights.moving_worlds import HARDWARE, MOCAP, SCENARIO_1, closing, obstacle, vehicle_path

HALF_AZIMUTH, HALF_ELEVATION = np.radians(40), np.radians(10)


def still(count, p=(0, 0, 0), v=(0, 0, 0)):
    rows = np.zeros((count, 9))
    rows[:, :3], rows[:, 3:6] = p, v
    return rows


def scans(truth, vehicle=None, yaw=0.0, seed=0, trial=0, first_step=0, **options):
    """Scans of obstacles (N, obstacles, 9) from a vehicle, at rest in the origin unless given."""
    n = len(truth)
    chosen = RadarOptions(**({"clutter_per_scan": 0} | options))
    vehicle = still(n) if vehicle is None else vehicle
    yaw = np.full(n, yaw) if np.isscalar(yaw) else yaw
    return radar_scans(chosen, vehicle, yaw, truth, seed=seed, trial=trial, first_step=first_step)


def directions(azimuth, elevation):
    return np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=-1
    )


def nees(d, truth):
    error = d["position"] - truth[d["scan"], 0, :3]
    return np.einsum("ni,nij,nj->n", error, np.linalg.inv(d["covariance"]), error)


def test_detections_are_those_in_the_field_of_view_with_the_probability():
    rng, n, yaw = np.random.default_rng(1), 20000, 2.3
    vehicle = still(n, p=(5, -3, 10))
    azimuth, elevation, distance = rng.uniform(-1, 1, n), rng.uniform(-0.3, 0.3, n), rng.uniform(1, 200, n)
    truth = still(n)
    truth[:, :3] = vehicle[:, :3] + distance[:, None] * directions(azimuth + yaw, elevation)
    inside = (abs(azimuth) < HALF_AZIMUTH) & (abs(elevation) < HALF_ELEVATION) & (distance < 150)
    sure = scans(truth[:, None], vehicle, yaw, detection_probability=1)["scan"]
    assert (sure == np.flatnonzero(inside)).all()
    seen = scans(truth[:, None], vehicle, yaw, detection_probability=0.7)["scan"]
    assert np.isin(seen, sure).all()
    assert stats.binomtest(len(seen), len(sure), 0.7).pvalue > 1e-3
    assert len(scans(truth[:, None], vehicle, yaw, detection_probability=0)["scan"]) == 0


@pytest.mark.parametrize(
    ("options", "p"),
    [
        ({}, (60, 30, 8)),
        ({"noise_scale": 2}, (140, -50, -20)),
        ({"half_elevation_rad": 1.5}, (5, 3, 6)),
        ({"own_position_sigma_m": 0.3, "own_velocity_sigma_m_s": 0.2}, (60, 30, 8)),
        ({"kind": "ideal", "position_sigma_m": 0.05}, (-7, 1, 40)),
        (MOCAP, (-1, 1, 2)),
    ],
)
def test_the_covariance_is_that_of_the_errors(options, p):
    n = 30000
    truth = still(n, p)[:, None]
    d = scans(truth, **({"detection_probability": 1} | options))
    count = len(d["scan"])
    assert count > 0.98 * n
    # The mean square of three standard normals: 3 with a variance of 6 / n. Beyond the first order an
    # error across the line of sight shortens the range by d (a^2 + e^2) / 2.
    second, excess = 0.0, 0.0
    if "kind" not in options:
        scale = options.get("noise_scale", 1)
        a, e = (scale * np.radians((0.5, 0.7))) ** 2
        half = np.linalg.norm(p) / (2 * scale * 0.15)
        second, excess = half * (a + e), half**2 * (3 * a * a + 3 * e * e + 2 * a * e)
    assert nees(d, truth).mean() == pytest.approx(3 + excess, abs=4 * np.sqrt(6 / count) + 0.01)
    assert stats.kstest(nees(d, truth)[:2000], stats.chi2(3).cdf).pvalue > 1e-3
    error = d["position"] - p
    typical = np.linalg.cholesky(d["covariance"].mean(0))
    assert np.abs(np.linalg.solve(typical, error.mean(0))).max() < 5 / np.sqrt(count) + 0.01 + second
    assert np.cov(np.linalg.solve(typical, error.T)) == pytest.approx(np.eye(3), abs=0.04 + excess)


def test_the_covariance_is_the_formula():
    yaw, n = 0.7, 50
    truth = still(n, 80 * directions(0.4 + yaw, 0.1))[:, None]
    d = scans(truth, yaw=yaw, noise_scale=2)
    for position, covariance, los in zip(d["position"], d["covariance"], d["los"], strict=True):
        distance = np.linalg.norm(position)
        assert los == pytest.approx(position / distance)
        left = np.cross([0, 0, 1], los)
        T = np.stack([los, left / np.linalg.norm(left), np.cross(los, left / np.linalg.norm(left))], axis=1)
        variances = [0.3**2, (2 * np.radians(0.5) * distance) ** 2, (2 * np.radians(0.7) * distance) ** 2]
        assert covariance == pytest.approx(T @ np.diag(variances) @ T.T)


def test_doppler_is_the_obstacles_own_speed_along_the_line_of_sight():
    n, v = 20000, np.array([-6.0, 2.0, 0.5])
    p, own = np.array([50.0, 10.0, 3.0]), (4.0, -1.0, 0.3)
    d = scans(still(n, p, v)[:, None], still(n, v=own), detection_probability=1)
    assert (d["has_doppler"] == 1).all()
    assert (d["range_rate_sigma"] == 0.1).all()
    error = d["range_rate"] - d["los"] @ v
    # Noise, and the error of the line of sight times the relative velocity across it.
    across = v - own - (v - own) @ (p / np.linalg.norm(p)) * p / np.linalg.norm(p)
    assert abs(error.mean()) < 4 * error.std() / np.sqrt(n) + 1e-3
    assert 0.1 < error.std() < np.hypot(0.1, np.radians(0.7) * np.linalg.norm(across)) * 1.02
    blurred = scans(still(n, p, v)[:, None], still(n, v=own), own_velocity_sigma_m_s=0.5)
    assert blurred["range_rate_sigma"] == pytest.approx(np.hypot(0.1, 0.5))
    assert (blurred["range_rate"] - blurred["los"] @ v).std() == pytest.approx(
        np.hypot(error.std(), 0.5), rel=0.03
    )


@pytest.mark.parametrize("mean", [0.1, 3.0, 60.0])
def test_clutter_is_poisson_and_uniform_in_the_volume(mean):
    n, yaw = 4000, -1.2
    vehicle = still(n, p=(1, 2, 30))
    d = scans(np.zeros((n, 0, 9)), vehicle, yaw, clutter_per_scan=mean)
    counts = np.bincount(d["scan"], minlength=n)
    k = np.arange(counts.max() + 1)
    expected, observed = n * stats.poisson.pmf(k, mean), np.bincount(counts)
    used = expected > 5
    assert stats.chisquare(
        np.append(observed[used], n - observed[used].sum()),
        np.append(expected[used], n - expected[used].sum()),
    ).pvalue > (1e-4)
    relative = (d["position"] - vehicle[0, :3])[:5000]
    distance = np.linalg.norm(relative, axis=1)
    azimuth = np.angle(np.exp(1j * (np.arctan2(relative[:, 1], relative[:, 0]) - yaw)))
    for value, low, high in [
        (distance**3, 0, 150**3),
        (azimuth, -HALF_AZIMUTH, HALF_AZIMUTH),
        (relative[:, 2] / distance, -np.sin(HALF_ELEVATION), np.sin(HALF_ELEVATION)),
        (d["range_rate"][:5000], -15, 15),
    ]:
        assert stats.kstest((value - low) / (high - low), "uniform").pvalue > 1e-4


def test_a_scan_is_a_function_of_seed_trial_and_step():
    truth = np.stack([still(40, (50, 5, 2)), still(40, (90, -20, -3))], axis=1)
    whole = scans(truth, clutter_per_scan=2, seed=3, trial=9)
    later = scans(truth[25:], clutter_per_scan=2, seed=3, trial=9, first_step=25)
    kept = whole["scan"] >= 25
    assert (later["scan"] + 25 == whole["scan"][kept]).all()
    for name in ("position", "covariance", "range_rate", "los"):
        assert (later[name] == whole[name][kept]).all()
    assert (
        scans(truth, seed=3, trial=9)["position"][0] == whole["position"][0]
    ).all()  # clutter changes nothing else
    for other in (
        {"seed": 4, "trial": 9},
        {"seed": 3, "trial": 10},
        {"seed": 3, "trial": 9, "first_step": 1},
    ):
        assert not np.isin(scans(truth, **other)["range_rate"], whole["range_rate"][whole["scan"] == 0]).any()


def test_what_one_sees_of_an_obstacle_does_not_depend_on_the_others():
    near, behind = still(100, (50, 5, 2)), still(100, (-50, 5, 2))
    alone = scans(near[:, None])
    both = scans(np.stack([near, behind], axis=1))
    assert (alone["position"] == both["position"]).all()
    gone = still(100, (np.nan, 0, 0))
    assert (scans(np.stack([near, gone], axis=1))["position"] == alone["position"]).all()


def test_ideal_sees_all_and_mocap_misses_some():
    n = 5000
    truth = np.stack([still(n, (-3, 0, 1)), still(n, (0, 0, 9)), still(n, (400, 0, 0))], axis=1)
    ideal = scans(truth, kind="ideal", detection_probability=0.5, clutter_per_scan=5)
    assert len(ideal["scan"]) == 3 * n
    assert (ideal["has_doppler"] == 0).all()
    assert ideal["position"].reshape(n, 3, 3) == pytest.approx(truth[..., :3], abs=1e-3)
    assert ideal["covariance"][0] == pytest.approx(1e-8 * np.eye(3))
    mocap = scans(truth, **MOCAP, clutter_per_scan=5, max_range_m=20)
    assert stats.binomtest(len(mocap["scan"]), 2 * n, 0.99).pvalue > 1e-3
    assert np.linalg.norm(mocap["position"], axis=1).max() < 20


def test_own_noise_moves_all_detections_of_a_scan_alike():
    n, options = 2000, {"own_position_sigma_m": 0.5, "own_velocity_sigma_m_s": 0.2}
    vehicle = still(n, (1, 2, 3), (4, 0, 0))
    believed = own_states(RadarOptions(**options), vehicle, seed=8, trial=2)
    error = (believed - vehicle)[:, :6] / np.repeat([0.5, 0.2], 3)
    assert stats.kstest(error.ravel(), "norm").pvalue > 1e-3
    assert np.corrcoef(error.T) == pytest.approx(np.eye(6), abs=0.1)
    truth = np.stack([still(n, (60, 5, 2)), still(n, (80, -5, 4))], axis=1)
    sharp = scans(truth, vehicle, seed=8, trial=2)
    blurred = scans(truth, vehicle, seed=8, trial=2, **options)
    assert (blurred["scan"] == sharp["scan"]).all()
    shift = believed[blurred["scan"], :3] - vehicle[blurred["scan"], :3]
    assert blurred["position"] - sharp["position"] == pytest.approx(shift, abs=1e-9)
    assert (own_states(RadarOptions(), vehicle) == vehicle).all()


def test_the_radar_sees_the_obstacles_of_scenario_1_until_they_are_near():
    vehicle = vehicle_path(400)
    truth = np.stack(
        [obstacle_paths(obstacle(t), vehicle, dt_s=0.01, obstacle=i)[0] for i, t in enumerate(SCENARIO_1)],
        axis=1,
    )
    every = slice(0, 400, 5)
    d = scans(truth[every], vehicle[every])
    distance, _ = closing(vehicle, truth.transpose(1, 0, 2))
    assert (distance.min(1) < 20).all()
    to = truth[every, :, :3] - vehicle[every, None, :3]
    azimuth, height = np.arctan2(to[..., 1], to[..., 0]), to[..., 2] / np.linalg.norm(to, axis=2)
    inside = (abs(azimuth) < HALF_AZIMUTH) & (abs(height) < np.sin(HALF_ELEVATION))
    assert inside[:, 1].all()
    assert stats.binomtest(len(d["scan"]), inside.sum(), 0.95).pvalue > 1e-3
    found = np.linalg.norm(d["position"][:, None] - truth[every][d["scan"], :, :3], axis=2).min(1)
    assert np.median(found) < 0.8


def test_mocap_at_120_hz_sees_what_is_thrown_and_who_approaches():
    dt = 1 / 120
    vehicle = vehicle_path(360, v=(0, 0, 0), p=(0, 0, 1), dt=dt)
    truth = np.stack(
        [obstacle_paths(obstacle(t), vehicle, dt_s=dt, obstacle=i)[0] for i, t in enumerate(HARDWARE)], axis=1
    )
    d = scans(truth, vehicle, **MOCAP)
    assert stats.binomtest(len(d["scan"]), 720, 0.99).pvalue > 1e-3
    error = np.abs(d["position"][:, None] - truth[d["scan"], :, :3]).max(2).min(1)
    assert 0.001 < error.mean() < 0.002
    assert d["covariance"] == pytest.approx(np.broadcast_to(1e-6 * np.eye(3), (len(error), 3, 3)))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"kind": "sonar"}, "kind must be radar, ideal or mocap"),
        ({"rate_hz": 0}, "rate"),
        ({"rate_hz": np.inf}, "rate"),
        ({"half_azimuth_rad": 4}, "field of view"),
        ({"half_elevation_rad": 0}, "field of view"),
        ({"max_range_m": np.nan}, "range"),
        ({"detection_probability": 1.1}, "probability"),
        ({"sigma_range_m": -1}, "standard deviations"),
        ({"own_velocity_sigma_m_s": np.nan}, "standard deviations"),
        ({"noise_scale": 0}, "singular"),
        ({"sigma_azimuth_rad": 0}, "singular"),
        ({"clutter_per_scan": 101}, "clutter"),
        ({"clutter_range_rate_m_s": -1}, "clutter"),
        ({"delay_s": 11}, "delay"),
    ],
)
def test_options_without_meaning_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        RadarOptions(**options)


def test_rows_must_fit():
    with pytest.raises(ValueError, match="different numbers of rows"):
        scans(np.zeros((3, 1, 9)), still(2))
