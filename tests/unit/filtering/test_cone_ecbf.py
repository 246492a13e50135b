"""The exponential cone filter: its program against another solver, its edges, and flights with it alone."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from alula import _core
from alula.stages.planning.rest_to_rest import rest_to_rest
from support.flights.reference_flights import along, vehicle_of
from support.models import quadrotor_model as body
from support.models import splat_filter_model as filters
from support.models.wrench_flight import (
    BACKUP,
    FILTERED,
    HOVER,
    OK,
    RANGES,
    RECOVERING,
    REFUSED,
    VEHICLE,
    Flight,
    Scene,
    attitude_controlled,
    empty_scene,
    random_case,
    random_scene,
    tick,
)

POLICY = _core.BackupPolicy(VEHICLE, "brake")
DT = 0.01


def ecbf(scene, **options):
    return _core.ConeEcbf(POLICY, scene.index, _core.ConeEcbfOptions(**options))


def rows_of(scene, x, thrust, rate, lambda_=14.0, most=40.0, min_speed=0.8):
    """Rows over (u_T'', tau) of what the filter finds near."""
    speed = np.linalg.norm(x[6:9])
    reach = max(0.5, speed**2 / 12 + 0.3 * speed + scene.radius)
    centres, matrices = scene.index.grown()
    items, _ = scene.index.nearest(x[:3], x[:3], reach=reach, count=len(scene.index))
    rows = []
    for i in items:
        r, a = centres[i] - x[:3], matrices[i]
        inside = r @ a @ r < 1
        if r @ a @ x[6:9] < 0 and not inside and speed >= min_speed:
            continue
        at = {"thrust": thrust, "thrust_rate": rate, "centre": centres[i], "a": a}
        psi = _core.snap_rows(VEHICLE, x, rate=0.0, **at)["psi"]  # h, h', h''
        beta, _, delta, h = filters.cone(centres[i], a, x[:3], x[6:9])
        pole = _core.ecbf_pole(*psi, lambda_, most) if h > 0 else np.clip(8 * beta / delta, lambda_, most)
        record = _core.snap_rows(VEHICLE, x, rate=pole, **at)
        escape = _core.snap_rows(VEHICLE, x, rate=5.0, **at)
        rows.append(
            (escape["escape_row"], escape["escape_bound"])
            if inside or speed < min_speed
            else (record["ecbf_row"], record["ecbf_bound"])
        )
    return rows


def nearest_input(rows, x, wrench, thrust, rate, cascade):
    """(T, tau) by another solver, or None when there is none."""
    import cvxpy

    m, z = VEHICLE.mass, cvxpy.Variable(4)
    ranges = RANGES.copy()
    u, u1, w = thrust / m, rate / m, 30.0
    if cascade == "extension":
        asked = w * w * (wrench[0] / m - u) - 2 * w * u1
        ranges[0] = w * w * VEHICLE.max_thrust / m
        second = z[0] * ranges[0]
        total = m * (u + u1 * DT + second * DT**2 / 2)
        limits = [cvxpy.abs(rate + m * DT * second) <= 150.0]
    else:
        asked = wrench[0]
        total = z[0] * ranges[0]
        second = (total / m - u - u1 * DT) / DT**2
        limits = []
    nominal = np.array([asked, *wrench[1:]]) / ranges
    torque = cvxpy.multiply(z[1:], ranges[1:])
    f = VEHICLE.inverse_allocation @ cvxpy.hstack([total, torque])
    limits += [f >= 0, f <= 4.25, total >= 0.1 * HOVER]
    for row, bound in rows:
        scale = np.abs(np.array(row) * [1e4, 0.1, 0.1, 0.1]).max()
        limits.append((row[0] * second + row[1:] @ torque - bound) / scale >= 0)
    problem = cvxpy.Problem(cvxpy.Minimize(cvxpy.sum_squares(z - nominal)), limits)
    problem.solve(solver=cvxpy.CLARABEL, tol_gap_abs=1e-11, tol_gap_rel=1e-11, tol_feas=1e-11)
    if problem.status == "infeasible":
        return None
    return np.array([total.value, *torque.value])


@pytest.mark.every(2)
@pytest.mark.filterwarnings("ignore:Solution may be inaccurate")
@pytest.mark.parametrize("cascade", ["extension", "difference"])
def test_the_nearest_input_agrees_with_another_solver(cascade):
    seen = {OK: 0, FILTERED: 0, BACKUP: 0}
    for seed in range(60):
        rng = np.random.default_rng(seed)
        scene, x, wrench = random_case(rng, 30)
        thrust, rate = HOVER + 0.5 * rng.normal(), rng.normal()
        centres, matrices = scene.index.grown()
        r = centres - x[:3]
        inside = (np.einsum("ni,nij,nj->n", r, matrices, r) < 1).any()
        flown = ecbf(
            scene,
            shield=False,
            cascade=cascade,
            lateral_bias=0.0,
            smooth_nominal=_core.SmoothNominalOptions(release_rad_s=0),
            pruning=_core.Pruning(sweep=False, count=0),
        )
        report = tick(flown, x, wrench, thrust, rate)
        rows = rows_of(scene, x, thrust, rate)
        assert report["rows"] == len(rows)
        expected = nearest_input(rows, x, wrench, thrust, rate, cascade)
        if expected is None:
            assert report["infeasible"]
            assert report["status"] == BACKUP
            np.testing.assert_array_equal(report["wrench"], POLICY(x))
        elif report["wrench"] == wrench.tolist():
            np.testing.assert_allclose(expected, wrench, atol=1e-5 if cascade == "difference" else 0.06)
        else:
            np.testing.assert_allclose(report["wrench"], expected, rtol=1e-4, atol=2e-5)
            assert report["status"] == (RECOVERING if inside else FILTERED)
        seen[OK if report["status"] == RECOVERING else report["status"]] += 1
    assert min(seen.values()) > 0
    assert seen[FILTERED] > 10


def test_a_nominal_that_holds_all_rows_comes_back_bit_by_bit():
    flown = ecbf(empty_scene())
    rng = np.random.default_rng(0)
    for x in body.random_states(20, seed=1, speed=1.0, rate=0.5):
        x[3:6] *= 0.1
        wrench = [HOVER + 1e-3 * rng.normal(), *rng.normal(0, 1e-3, 3)]
        report = tick(flown, x, wrench, thrust=wrench[0], nominal_thrust_rate=0.25, thrust_rate=0.25)
        assert report["status"] == OK
        assert report["wrench"] == wrench
        assert report["thrust_rate"] == 0.25
        assert report["margin"] == np.inf
        assert report["certified"]


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_numbers_that_are_not_finite_are_refused_with_hover(bad):
    flown = ecbf(random_scene(np.random.default_rng(0), 10))
    x, wrench = np.zeros(12), np.array([HOVER, 0, 0, 0])
    reports = []
    for i in range(12):
        y = x.copy()
        y[i] = bad
        reports.append(tick(flown, y, wrench))
    for i in range(4):
        u = wrench.copy()
        u[i] = bad
        reports.append(tick(flown, x, u))
    reports += [tick(flown, x, wrench, thrust=bad), tick(flown, x, wrench, nominal_thrust_acceleration=bad)]
    for report in reports:
        assert report["status"] == REFUSED
        assert report["wrench"] == [HOVER, 0, 0, 0]
        assert not report["certified"]


@given(
    h=st.floats(1e-3, 1e3),
    h1=st.floats(-1e3, 1e3),
    h2=st.floats(-1e4, 1e4),
    lambda_=st.floats(0.5, 10),
    most=st.floats(10, 50),
)
def test_the_pole_of_a_row_starts_it_inside_its_safe_set(h, h1, h2, lambda_, most):
    def starts_inside(pole):
        slack = 1e-9 * (abs(h2) + 2 * pole * abs(h1) + pole**2 * h)
        return h1 + pole * h >= -slack and h2 + 2 * pole * h1 + pole**2 * h >= -slack

    pole = _core.ecbf_pole(h, h1, h2, lambda_, most)
    assert lambda_ <= pole <= most
    if pole > lambda_:
        assert starts_inside(pole)
        # Just below it does not: it is the least.
        below = pole * (1 - 1e-6)
        assert h1 + below * h < 0 or h2 + 2 * below * h1 + below**2 * h < 0 or below <= lambda_
    else:
        assert starts_inside(lambda_) or not starts_inside(most * (1 - 1e-6))
    assert _core.ecbf_pole(-h, h1, h2, lambda_, most) == lambda_


def test_a_vehicle_within_a_grown_ellipsoid_is_only_reported_safe_when_certified():
    """The grown set of a flat disc is far thicker than the disc and the radius."""
    scene = Scene([[0.3, 0, 0]], [[0.01, 1.0, 1.0]], [[1, 0, 0, 0]])
    r, a = np.array([0.3, 0, 0]), scene.index.grown()[1][0]
    assert r @ a @ r < 1
    x, u = np.zeros(12), np.array([HOVER, 0, 0, 0])
    bare, shielded = tick(ecbf(scene, shield=False), x, u), tick(ecbf(scene), x, u)
    assert bare["status"] == RECOVERING
    assert bare["margin"] <= 0
    assert shielded["status"] == FILTERED
    assert shielded["certified"]
    assert bare["wrench"][2] < 0  # pitches back, away from the disc


def test_a_head_on_course_is_bent_to_the_left_every_time():
    scene = Scene([[1.3, 0, 0]], [[0.3] * 3], [[1, 0, 0, 0]])
    x = np.zeros(12)
    x[6] = 2.0
    report, again = (tick(ecbf(scene, shield=False), x, (HOVER, 0, 0, 0)) for _ in range(2))
    assert report == again
    assert report["wrench"][1] < 0  # a negative roll torque tilts the thrust to +y
    straight = tick(ecbf(scene, shield=False, lateral_bias=0.0), x, (HOVER, 0, 0, 0))
    assert abs(straight["wrench"][1]) < 1e-9


def past_a_sphere(speed, offset, **options):
    scene = Scene([[5, offset, 0]], [[0.5] * 3], [[1, 0, 0, 0]])

    def onward(_, x):
        a = np.clip([2 * (speed - x[6]), -2 * x[7] - 0.5 * x[1], -3 * x[8] - 2 * x[2]], -4, 4)
        return attitude_controlled(VEHICLE, x, a)

    x = np.zeros(12)
    x[6] = speed
    return Flight(scene, VEHICLE, ecbf(scene, **options), x, onward, int(700 / speed))


@pytest.mark.parametrize("speed", [2.5, 4.5])
@pytest.mark.parametrize("offset", [0.0, 0.2, -0.3])
@pytest.mark.parametrize("shield", [False, True])
def test_rows_lead_around_a_sphere_at_speed(speed, offset, shield):
    """Rows keep 8 cm more than the radius beside a shield, which then finds nothing to object to."""
    late = speed > 4 and offset == 0  # head-on the poles of the defaults turn late, see below
    flight = past_a_sphere(speed, offset, **({"lambda_": 8.0} if late else {}), shield=shield)
    assert flight.clearance > (0.07 if shield else -1e-3)
    assert flight.state[0] > 5.5
    assert flight.count(FILTERED) > 0
    assert flight.count(BACKUP) <= 1


def test_where_poles_turn_too_late_for_the_rotors_the_shield_stops_the_vehicle():
    """Head-on at 4.5 m/s, seen late, a pole of 14 1/s turns too late to keep all of the room."""
    stiff = _core.SmoothNominalOptions(release_rad_s=0)
    stopped = past_a_sphere(4.5, 0.0, shield=True, smooth_nominal=stiff, pruning=_core.Pruning())
    assert stopped.clearance > 0.02
    assert stopped.count(BACKUP) > 1
    assert stopped.state[0] < 4.5
    assert np.linalg.norm(stopped.state[6:9]) < 0.5


def test_the_thrust_extension_stays_bounded_and_follows_the_nominal():
    flown, thrust, rate = ecbf(empty_scene(), max_thrust_rate_n_s=40.0), HOVER, 0.0
    x, seen = np.zeros(12), []
    for k in range(200):
        asked = 16.0 if k < 50 else 4.0
        report = tick(flown, x, (asked, 0, 0, 0), thrust, rate)
        if report["status"] == FILTERED:
            assert abs(report["thrust_rate"]) <= 40.0 + 1e-6
        thrust, rate = report["wrench"][0], report["thrust_rate"]
        seen.append(thrust)
    assert max(seen) == pytest.approx(16.0, abs=0.2)
    assert seen[-1] == pytest.approx(4.0, abs=0.01)
    assert min(seen) > 0.1 * HOVER - 1e-9


def test_a_tracking_row_gives_way_to_the_rows_of_obstacles():
    scene, x = empty_scene(), np.zeros(12)
    u = (HOVER, 0, 0, 0)
    errors = {"position_error": (0, 0, -1.0), "velocity_error": (0, 0, -0.5)}
    plain = tick(ecbf(scene), x, u, **errors)
    tracked = tick(ecbf(scene, clf_weight=1e3), x, u, **errors)
    assert plain["status"] == OK
    assert tracked["status"] == FILTERED
    assert tracked["wrench"][0] > plain["wrench"][0]


@pytest.mark.parametrize(
    "options",
    [
        {"lambda_": 0.0},
        {"lambda_max": 1.0},
        {"thrust_bandwidth_rad_s": 100.0},
        {"least_thrust": 1.0},
        {"max_thrust_rate_n_s": 0.0},
        {"cascade": "other"},
        {"clf_weight": -1.0},
    ],
)
def test_options_without_meaning_are_refused(options):
    with pytest.raises(ValueError):
        ecbf(empty_scene(), **options)


def test_clones_and_repetitions_give_the_same_bits():
    rng = np.random.default_rng(3)
    scene, x, wrench = random_case(rng, 30)
    thrust, rate = HOVER + 0.5 * rng.normal(), rng.normal()
    flown = ecbf(scene)
    first = tick(flown, x, wrench, thrust, rate)
    flown.reset()
    assert tick(flown, x, wrench, thrust, rate) == first == tick(ecbf(scene).clone(), x, wrench, thrust, rate)


def flown_through_a_cloud(**options):
    """Mean jerk [m/s^3] of flights on straight references through a cloud, and how many reach their goals."""
    scene = random_scene(np.random.default_rng(4), 100, size=2.5)
    vehicle = vehicle_of(VEHICLE, gains=_core.TrackingGains(catch_up_m_s=1.0))
    references = []
    for angle in np.linspace(0, np.pi, 8, endpoint=False):
        end = 4.0 * np.array([np.cos(angle), np.sin(angle), 0])
        path = rest_to_rest(-end, end, 2.0)
        references.append(_core.ReferenceCurve(path.time, path.coefficient))
    flights = along(references, [ecbf(scene, **options)], vehicle, dt_s=DT)
    assert all((flight["flags"] & 4).all() for flight in flights)  # certified
    assert min(scene.clearance(flight["path"]) for flight in flights) > 0
    jerk = [np.linalg.norm(np.diff(f["state"][:, 6:9], n=2, axis=0), axis=1).mean() / DT**2 for f in flights]
    return np.mean(jerk), sum(flight["end"] == "reached" for flight in flights)


def test_the_smooth_nominal_makes_flights_smoother_and_loses_no_goal():
    gate = _core.Pruning(reaction_time_s=0.6)
    stiff, reached = flown_through_a_cloud(
        pruning=gate, smooth_nominal=_core.SmoothNominalOptions(release_rad_s=0)
    )
    smooth, also_reached = flown_through_a_cloud()
    assert smooth < 0.8 * stiff
    assert also_reached >= reached >= 6


def held_then_free():
    """Statuses and wrenches of hovering ticks: free, held back from a wall by its rows, and free again."""
    scene = Scene([[1.3, 0, 0]], [[0.3] * 3], [[1, 0, 0, 0]])
    flown, held, free = ecbf(scene), np.zeros(12), np.zeros(12)
    held[6], free[0] = 2.0, -50.0
    u = (HOVER, 0, 0, 0)

    def ticks(x, count):
        return [tick(flown, x, u, velocity_error=(0.5, 0, 0)) for _ in range(count)]

    return flown, ticks, held, free


def test_the_smooth_nominal_fades_into_the_nominal_input_which_then_comes_back_bit_by_bit():
    _, ticks, held, free = held_then_free()
    assert ticks(free, 1)[0]["status"] == OK
    assert ticks(held, 1)[0]["status"] == FILTERED
    after = ticks(free, 200)
    torque = [abs(report["wrench"][2]) for report in after]
    assert after[0]["status"] == FILTERED
    assert torque[0] > 1e-4
    assert after[-1]["status"] == OK
    assert after[-1]["wrench"] == [HOVER, 0, 0, 0]
    assert [report["status"] for report in after] == sorted((r["status"] for r in after), reverse=True)
    assert 50 < sum(report["status"] == FILTERED for report in after) < 150


@pytest.mark.parametrize("broken", [1e2, 1e6, 1e200, 1.7e308])
def test_one_broken_error_does_not_stiffen_the_smooth_nominal_permanently(broken):
    """The reference speed, and with it the poles of the smooth nominal, follow from the error while held."""
    answers = []
    for error in (0.5, broken):
        flown, ticks, held, _ = held_then_free()
        ticks(held, 1)
        tick(flown, held, (HOVER, 0, 0, 0), velocity_error=(error, -error, 0))
        answers.append(ticks(held, 1)[0])
    assert not answers[1]["infeasible"]
    np.testing.assert_allclose(answers[1]["wrench"], answers[0]["wrench"], rtol=1e-3, atol=1e-4)


def test_reset_forgets_that_the_vehicle_was_held_and_a_clone_remembers():
    flown, ticks, held, free = held_then_free()
    ticks(held, 1)
    other = flown.clone()
    assert tick(other, free, (HOVER, 0, 0, 0), velocity_error=(0.5, 0, 0)) == ticks(free, 1)[0]
    flown.reset()
    assert ticks(free, 1)[0]["status"] == OK


@pytest.mark.parametrize(
    "name", ["release_rad_s", "nominal_position_rad_s", "nominal_speed_m_s", "nominal_cone_rate_1_s"]
)
def test_options_of_the_smooth_nominal_beyond_their_limits_are_refused(name):
    with pytest.raises(ValueError, match=f"{name} must be (above|at least) 0"):
        _core.SmoothNominalOptions(**{name: -1.0})


def test_poles_of_the_smooth_nominal_in_the_wrong_order_are_refused():
    with pytest.raises(ValueError, match="release_rad_s < nominal_attitude_rad_s"):
        ecbf(empty_scene(), smooth_nominal=_core.SmoothNominalOptions(release_rad_s=40.0))
