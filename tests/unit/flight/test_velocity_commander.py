"""Velocity commander with vehicles that lag: other models keep clear of boxes, and measured lags."""

import math

import msgspec
import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from alula.schemas.errors import UsageError
from alula.schemas.scenarios.vehicle import FASTBRIDGE, IdentifiedTable, VelocitiesTable
from alula.stages.filtering.protocol import FilterResult, FilterStatus
from alula.stages.flight.mission import make_commander
from alula.stages.vehicles.setpoints import RatesSetpoint, VelocitySetpoint
from alula.stages.vehicles.simulated_body import STEP_S, Body
from alula.stages.vehicles.velocity_lag import filter_lags_s, max_speed_m_s, needed_deceleration_m_s2
from support.effort import examples
from support.flights.flights import mission
from support.flights.velocity_worlds import BOXES, ZERO, commander_around, seen, target_at, world
from support.scenes.small_scenes import box_cover
from support.vehicles.autopilot_client import EXACT, Client
from support.vehicles.crazyflie_rehearsal import Rehearsal
from support.vehicles.crazyflie_rehearsal import velocity as crazyflie_velocity
from support.vehicles.responses import MEASURED

DT, STEPS = 0.01, 4
RADIUS_M, MARGIN_M = 0.15, 0.1
LOW, HIGH = (0.1 * np.array([box[i] for box in BOXES]) for i in (0, 1))


def clearance(x):
    """Clearance of the vehicle's sphere from boxes."""
    away = np.maximum(np.maximum(LOW - x, x - HIGH), 0.0)
    return float(np.sqrt((away**2).sum(axis=1)).min()) - RADIUS_M


def first_order(tau):
    """Exact x, v, a after a step with constant u; tau of all axes, or of each."""
    tau = np.broadcast_to(np.array(tau), (3,))

    def step(x, v, a, u, dt):
        after = u + (v - u) * np.exp(-dt / tau)
        return x + dt * u + tau * (v - after), after, a

    return step


def jerk_limited(gain, attitude_s, most_m_s2, most_m_s3):
    """Velocity loop with a lag of the acceleration, and with limits of acceleration and jerk."""

    def within(vector, most):
        size = np.linalg.norm(vector)
        return vector if size <= most else vector * (most / size)

    def step(x, v, a, u, dt):
        jerk = within((within(gain * (u - v), most_m_s2) - a) / attitude_s, most_m_s3)
        a = a + jerk * dt
        v = v + a * dt
        return x + v * dt, v, a

    return step


def stopping_s(step, speed):
    """Duration of 63 % of a stop."""
    x, v, a, ticks = ZERO, np.array([speed, 0, 0]), ZERO, 0
    while v[0] > math.exp(-1) * speed:
        x, v, a = step(x, v, a, ZERO, 1e-3)
        ticks += 1
    return ticks * 1e-3


def commander_of(speed, lag):
    made, _ = world(speed, lag)
    return make_commander(made, frozenset({VelocitySetpoint}))


def least_clearance(step, speed, lag, start, goals, ticks=90):
    """Minimum clearance of a flight towards arbitrary points, each for some time; and its last state."""
    commander = commander_of(speed, lag)
    x, v, a, least = np.array(start, float), ZERO, ZERO, math.inf
    for goal in goals:
        for _ in range(ticks):
            decision = commander.decide(seen(x, v), 0.0, target_at(goal))
            assert decision.setpoint is not None
            commander.sent(decision.setpoint)
            for _ in range(STEPS):
                x, v, a = step(x, v, a, decision.setpoint.velocity, DT / STEPS)
                least = min(least, clearance(x))
    return least, x, v


STARTS = st.sampled_from([(0.6, 2.6, 1.5), (2.0, 0.6, 1.5), (3.2, 3.0, 2.0), (2.0, 3.0, 1.0)])
POINTS = st.tuples(st.floats(-1, 5.5), st.floats(-1, 4.5), st.floats(0.8, 3.0))
FOUND = (Phase.explicit, Phase.reuse, Phase.generate)  # flights are too long to shrink
GOALS = st.lists(POINTS, min_size=2, max_size=3)


@settings(max_examples=examples(12), deadline=None, phases=FOUND)
@given(
    STARTS, GOALS, st.sampled_from([1.0, 2.0, 3.0]), st.sampled_from([(0.25, 0.25), (0.25, 0.5), (0.5, 0.5)])
)
def test_a_first_order_vehicle_keeps_its_margin_whatever_is_asked(start, goals, speed, lags):
    true, assumed = lags
    least, _, _ = least_clearance(first_order(true), speed, assumed, start, goals)
    assert least >= MARGIN_M - 1e-3


@settings(max_examples=examples(8), deadline=None, phases=FOUND)
@given(STARTS, GOALS, st.sampled_from([1.0, 3.0]), st.sampled_from([(0.25, 0.6, 0.4), (0.6, 0.3, 0.9)]))
def test_a_vehicle_whose_axes_lag_differently_keeps_its_margin(start, goals, speed, lags):
    least, _, _ = least_clearance(first_order(lags), speed, lags, start, goals)
    assert least >= MARGIN_M - 1e-3


class Slope:
    """The barrier of a plane in any direction, beta = 2."""

    kind = "velocity"

    def __init__(self, normal, speed):
        self.normal, self.speed = normal / np.linalg.norm(normal), speed

    def reset(self):
        pass

    def __call__(self, state, nominal):
        h, u = float(self.normal @ state.position), nominal.velocity
        short = max(0.0, -2.0 * h - float(self.normal @ u))
        if short == 0:
            return FilterResult(u, FilterStatus.OK, h)
        u = u + short * self.normal
        size = np.linalg.norm(u)
        status = FilterStatus.RECOVERING if h < 0 else FilterStatus.FILTERED
        return FilterResult(u * min(1.0, self.speed / size), status, h)


@pytest.mark.slow
@pytest.mark.parametrize("normal", [(1, 0, 1), (1, 0, -1), (1, 1, 0.4), (0.3, 0.2, 1)])
def test_a_slope_is_not_touched_along_the_curve_of_a_stop(normal):
    """With lags that differ a stop is curved; the chord between its ends is not what has to be clear."""
    lags, rng = (0.3, 0.3, 0.9), np.random.default_rng(5)
    slope = Slope(np.array(normal, float), 2.0)
    commander = commander_around(slope, 8.0, 2.0, lag_s=lags)
    x, v, least = slope.normal * 1.0, ZERO, math.inf
    for tick in range(1200):
        if tick % 60 == 0:
            goal = rng.normal(size=3) * 2.0 - slope.normal
        decision = commander.decide(seen(x, v), 0.0, target_at(goal))
        commander.sent(decision.setpoint)
        x, v, _ = first_order(lags)(x, v, ZERO, decision.setpoint.velocity, DT)
        least = min(least, float(slope.normal @ x))
    assert least >= -2e-3
    assert least < 0.3  # it came close


SLUGGISH = {  # the parameters of an ArduPilot, and worse ones
    "lean": jerk_limited(2.5, 0.12, 5.66, 60.0),
    "slow": jerk_limited(2.5, 0.15, 4.5, 25.0),
}


@settings(max_examples=examples(12), deadline=None, phases=FOUND)
@given(STARTS, GOALS, st.sampled_from([1.5, 3.0]), st.sampled_from(list(SLUGGISH)))
def test_a_jerk_limited_vehicle_keeps_nearly_all_of_it(start, goals, speed, name):
    step = SLUGGISH[name]
    lag = round(1.25 * stopping_s(step, speed), 2)
    least, _, _ = least_clearance(step, speed, lag, start, goals)
    assert least >= 0.8 * MARGIN_M


HEAD_ON = ((2.0, 1.6, 1.5), [(2.0, 3.0, 1.5), (5.0, 1.0, 1.5), (0.0, -1.0, 1.5)])


@pytest.mark.parametrize("name", ["first order", *SLUGGISH])
def test_without_the_lag_the_margin_is_used_up(name):
    step = first_order(0.4) if name == "first order" else SLUGGISH[name]
    lag = 0.4 if name == "first order" else round(1.25 * stopping_s(step, 3.0), 2)
    assert least_clearance(step, 3.0, 0.0, *HEAD_ON)[0] < 0.3 * MARGIN_M
    assert least_clearance(step, 3.0, lag, *HEAD_ON)[0] >= 0.8 * MARGIN_M


def test_corners_are_not_cut():
    """Close around the end of a pillar: q turns before p does, and p keeps clear of the corner."""
    goals = [(0.6, 0.0, 1.5), (2.0, 0.0, 1.5), (2.0, 2.0, 1.5), (2.0, 0.0, 1.5), (0.6, 0.0, 1.5)]
    least, x, _ = least_clearance(first_order(0.5), 3.0, 0.5, (0.7, 1.5, 1.5), goals, ticks=120)
    assert least >= MARGIN_M - 1e-3
    assert np.linalg.norm(x - goals[-1]) < 0.2  # it arrives


def test_a_wall_between_the_vehicle_and_its_lead_is_not_flown_through():
    """q is beyond the middle of a hull, or beyond the hull: the way out of it at q leads p into it."""
    for y_speed in (0.0, 0.5):
        for speed in (1.5, 2.5, 3.5):
            commander = commander_of(3.0, 0.6)
            p, v = np.array([2.1, 2.4, 1.5]), np.array([speed, y_speed, 0.0])  # a pillar from x = 2.5 to 2.8
            decision = commander.decide(seen(p, v), 0.0, target_at((3.4, 2.4, 1.5)))
            assert decision.status is FilterStatus.RECOVERING
            u = decision.setpoint.velocity
            assert u[0] < 0
            assert np.linalg.norm(u) <= 3.0 + 1e-6
            deep = p[0] + 0.6 * speed - (2.5 - RADIUS_M - MARGIN_M)
            assert u[0] == pytest.approx(-min(3.0, 2.0 / 0.6 * deep), abs=0.15)


def test_who_is_engaged_too_fast_is_led_out_and_does_not_touch():
    """q begins within the margin, even within the hull."""
    for p_y, speed in ((2.9, 1.0), (2.7, 1.5)):
        commander = commander_of(3.0, 0.5)
        x, v, a = np.array([2.0, p_y, 1.5]), np.array([0.0, speed, 0.0]), ZERO
        least, first = math.inf, None
        for _ in range(300):
            decision = commander.decide(seen(x, v), 0.0, target_at((2.0, 3.6, 1.5)))
            first = first or decision.status
            commander.sent(decision.setpoint)
            x, v, a = first_order(0.4)(x, v, a, decision.setpoint.velocity, DT)
            least = min(least, clearance(x))
        assert first is FilterStatus.RECOVERING
        assert least > 0
        assert clearance(x) >= MARGIN_M - 1e-3


class Passing:
    """Filter that records its arguments and changes nothing."""

    kind = "velocity"

    def __init__(self, margin=1.0):
        self.asked, self.margin = [], margin

    def reset(self):
        pass

    def __call__(self, state, nominal):
        self.asked.append((state.position, nominal.velocity))
        return FilterResult(nominal.velocity, FilterStatus.OK, self.margin)


@settings(max_examples=examples(50), deadline=None)
@given(
    st.lists(st.tuples(*[st.floats(-3, 3)] * 3), min_size=1, max_size=8),
    st.floats(0.05, 1.0),
    st.integers(0, 7),
    st.floats(0, 1),
)
def test_an_old_state_is_taken_on_by_what_was_sent(sent, tau, whole, part):
    """The prediction of a first-order vehicle from the sent set-points equals its true state."""
    age = min(whole + part, len(sent)) * DT
    step, x, v = first_order(tau), np.array([1.0, -2.0, 3.0]), np.array([0.5, 1.0, -1.5])
    passing = Passing()
    commander = commander_around(passing, 2.0, 20.0, lag_s=tau, delay_s=0.4 * age, dt_s=DT)
    begin, left = len(sent) * DT - age, age
    now_x, now_v = x, v
    for i, u in enumerate(np.array(sent)):
        commander.sent(VelocitySetpoint(u, 0.0))
        held = min(max((i + 1) * DT - begin, 0.0), DT)
        left -= held
        now_x, now_v, _ = step(now_x, now_v, ZERO, u, held)
    assert left == pytest.approx(0, abs=1e-9)
    commander.decide(seen(x, v), 0.6 * age, target_at(ZERO))
    lead, _ = passing.asked[-1]
    np.testing.assert_allclose(lead, now_x + tau * now_v, atol=1e-9)
    found = commander.decide(seen(x, v), 0.6 * age, target_at(ZERO))
    np.testing.assert_allclose(found.nominal, -now_x, atol=1e-9)  # the error is that of p


def test_what_is_not_known_is_taken_on_by_its_velocity():
    passing = Passing()
    commander = commander_around(passing, 2.0, 20.0, lag_s=0.5, delay_s=0.03, dt_s=DT)
    v = np.array([1.0, 2.0, 0.0])
    for then in (lambda: None, lambda: commander.sent(RatesSetpoint(9.8, ZERO)), commander.reset):
        passing.asked.clear()
        then()
        commander.decide(seen(ZERO, v), 0.02, target_at(ZERO))
        np.testing.assert_allclose(passing.asked[-1][0], (0.05 + 0.5) * v, atol=1e-12)


def test_at_a_high_rate_as_much_time_is_known():
    passing = Passing()
    commander = commander_around(passing, 2.0, 20.0, lag_s=0.5, delay_s=0.5, dt_s=0.002)
    for _ in range(1000):
        commander.sent(VelocitySetpoint(ZERO, 0.0))
    commander.decide(seen(ZERO, np.array([1.0, 0, 0])), 0.15, target_at(ZERO))
    np.testing.assert_allclose(passing.asked[-1][0], (0.5, 0, 0), atol=1e-9)  # q stays where it was


@pytest.mark.parametrize("margin", [0.01, 0.3, 5.0])
def test_the_chord_is_asked_for_closely_and_from_end_to_end(margin):
    passing = Passing(margin)
    commander = commander_around(passing, 2.0, 20.0, lag_s=0.5)
    commander.decide(seen(ZERO, np.array([3.0, 0, 0])), 0.0, target_at(ZERO))
    places = [x[0] for x, _ in passing.asked]
    assert places[0] == 0
    assert places[-1] == 1.5
    assert 2 <= len(places) <= 13
    assert max(np.diff(places)) <= max(0.5 * margin, 1.5 / 12) + 1e-9


@pytest.mark.parametrize("share", [0.27, 0.4])
def test_a_fast_vehicle_does_not_cut_across_a_thin_pillar(share):
    """A chord of 16 m near a pillar of 0.1 m: on the path to its other side the chord sweeps over it."""
    made = mission(
        cover=box_cover([((0, 0, 0), (1, 1, 40))]),
        is_clear=True,
        speed_m_s=10.0,
        velocity_lag_s=2.95,
        gain=8.0,
        fence=(-40.0, -40.0, 0.0, 40.0, 40.0, 10.0),
    )
    lag = made.config.velocity_lag_s
    commander = make_commander(made, frozenset({VelocitySetpoint}))
    x, v, least = np.array([0.05 - 16.0 * share, 0.42, 1.5]), np.array([16.0 / lag, 0, 0]), math.inf
    for _ in range(160):
        decision = commander.decide(seen(x, v), 0.0, target_at((2.1, -3.6, 1.5)))
        commander.sent(decision.setpoint)
        for _ in range(STEPS):
            x, v, _ = first_order(lag)(x, v, ZERO, decision.setpoint.velocity, DT / STEPS)
            away = np.maximum(np.abs(x[:2] - 0.05) - 0.05, 0.0)
            least = min(least, float(np.hypot(*away)) - RADIUS_M)
    assert least >= MARGIN_M - 1e-3


@pytest.mark.parametrize(("speed", "most_m"), [(3.0, 0.15), (10.0, 0.2), (100.0, 0.2)])
def test_no_thin_hull_fits_between_two_points_of_a_fast_vehicle(speed, most_m):
    passing = Passing(0.01)
    commander = commander_around(passing, 2.0, 100.0, lag_s=0.6)
    commander.decide(seen(ZERO, np.array([speed, 0, 0])), 0.0, target_at(ZERO))
    places = [x[0] for x, _ in passing.asked]
    assert max(np.diff(places)) <= most_m + 1e-9


def responses():
    """Speed during a stop from 3 m/s of each simulated vehicle, at steps of DT, as a fraction from 1 to 0."""
    level = np.array([1.0, 0, 0])
    client = Client(options=EXACT).fly(10.0)
    mask = 0b111 | 0b111 << 6 | 1 << 11
    body = Body(FASTBRIDGE, ZERO, 0.0, 0)
    for up in (0.8, 0.0):
        for _ in range(400):
            body.step(VelocitySetpoint(np.array([0, 0, up]), 0.0))
    flown = Rehearsal(controller=1)
    flown.fly(1.0)

    def ardupilot(v):
        client.target(mask, v=tuple(v))
        client.wait(DT)
        return client.truth.velocity[0]

    def simulated(v):
        for _ in range(round(DT / STEP_S)):
            body.step(VelocitySetpoint(v, 0.0))
        return body.velocity[0]

    def crazyflie(v):
        flown.live(DT, crazyflie_velocity(*v))
        return flown.vehicle.body.velocity[0]

    for name, tick in (("ardupilot", ardupilot), ("sim", simulated), ("crazyflie", crazyflie)):
        for _ in range(300):
            begin = tick(3.0 * level)
        yield name, np.array([tick(ZERO) for _ in range(150)]) / begin


def test_lags_are_what_the_page_says_and_the_default_covers_them():
    measured = {name: DT * (1 + float(np.argmax(stop < math.exp(-1)))) for name, stop in responses()}
    assert measured == pytest.approx({"ardupilot": 1.11, "sim": 0.29, "crazyflie": 0.34}, abs=0.01)
    lags = mission(cover=box_cover(BOXES), is_clear=True, speed_m_s=3.0).config.velocity_lag_s
    assert lags == pytest.approx((1.406, 1.406, 2.056), abs=0.001)
    assert lags[0] >= 1.25 * max(measured.values())
    assert filter_lags_s(VelocitiesTable(), 90.0) == (5.0, 5.0, pytest.approx(2.056, abs=0.001))
    for speed in (1.0, 2.0, 3.0):  # ArduPilot's own simulation
        level, _, climb = mission(speed_m_s=speed).config.velocity_lag_s
        assert 1.25 * MEASURED[f"stop_{speed:g}_s"] <= level <= 1.35 * MEASURED[f"stop_{speed:g}_s"]
        if speed < 3:
            slowest = MEASURED[f"stop_up_{speed:g}_s"]
            assert 1.25 * slowest <= climb <= 1.3 * slowest
    assert mission(speed_m_s=3.0, velocity_lag_s=0.2).config.velocity_lag_s == 0.2


def test_a_speed_that_the_vehicle_cannot_shed_is_refused_with_the_one_that_it_can():
    slow = msgspec.structs.replace(FASTBRIDGE, velocities=VelocitiesTable(deceleration_m_s2=1.0))
    with pytest.raises(
        UsageError, match=r"needs a deceleration of 1\.57 .* sustains 1; .* up to --speed"
    ) as refused:
        mission(vehicle=slow, speed_m_s=3.0)
    fastest = float(str(refused.value).split()[-1])
    assert mission(vehicle=slow, speed_m_s=fastest).config.speed_m_s == fastest
    with pytest.raises(UsageError, match="sustains"):
        mission(vehicle=slow, speed_m_s=1.01 * fastest)
    # a lag that the user gives is compared with a deceleration of the file
    with pytest.raises(UsageError, match=r"--speed 0\.9$"):
        mission(vehicle=slow, speed_m_s=3.0, velocity_lag_s=0.4)
    assert mission(speed_m_s=3.0, velocity_lag_s=0.0).config.velocity_lag_s == 0


def test_a_speed_beyond_those_measured_is_noted():
    measured = msgspec.structs.replace(FASTBRIDGE, identified=IdentifiedTable(speeds_m_s=(0.5, 1.0)))
    assert any(
        "extrapolated: it was measured up to 1 m/s" in note
        for note in mission(vehicle=measured, speed_m_s=1.5).notes
    )
    assert not any("extrapolated" in note for note in mission(vehicle=measured, speed_m_s=1.0).notes)


@pytest.mark.parametrize("beta", [0.5, 2.0, 8.0])
def test_the_largest_speed_needs_just_the_deceleration_that_there_is(beta):
    for most in (0.4, 1.0, 2.5, 6.0):
        following = VelocitiesTable(deceleration_m_s2=most)
        fastest = max_speed_m_s(following, beta)
        lag = filter_lags_s(following, fastest)[0]
        assert needed_deceleration_m_s2(fastest, lag, beta) == pytest.approx(most, rel=1e-9)
    for speed in (0.5, 1.0, 2.0, 3.0):  # ArduPilot's defaults
        assert speed < max_speed_m_s(VelocitiesTable(), 8.0)
