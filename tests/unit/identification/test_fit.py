"""The fit of steps against recordings whose truth is known: first-order and jerk-limited vehicles."""

import math

import msgspec
import numpy as np
import pytest

from alula.schemas.errors import CheckError
from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.stages.identification.estimates import line_of, mean_of
from alula.stages.identification.fit import fit
from alula.stages.identification.recording import Phase, Recording
from alula.stages.identification.responses import crossing, smoothed
from alula.stages.identification.result import disagreements, identified_vehicle
from alula.stages.identification.steps import Step, plan_steps
from alula.stages.vehicles.own_limits import first_guess
from alula.stages.vehicles.velocity_lag import stop_time_s

G, HOVER, RATE_HZ = 9.81, 0.31, 50.0
BOX = (-20.0, -20.0, 0.0, 20.0, 20.0, 40.0)
REST_S = 1.0
BARE = msgspec.structs.replace(FASTBRIDGE, body=msgspec.structs.replace(FASTBRIDGE.body, radius_m=0.2))


def quat_of(thrust, yaw):
    """Attitude whose body z axis is along a thrust, with a heading; w, x, y, z."""
    z = thrust / np.linalg.norm(thrust)
    y = np.cross(z, [math.cos(yaw), math.sin(yaw), 0.0])
    y /= np.linalg.norm(y)
    R = np.column_stack([np.cross(y, z), y, z])
    w = 0.5 * math.sqrt(max(0.0, 1 + np.trace(R)))
    return np.array([w, *(np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / (4 * w))])


class Truth:
    """A vehicle whose speed along each axis follows set-points by a law of the test."""

    def __init__(
        self, responds, *, drag=(0.0, 0.0, 0.0), wind=(0.0, 0.0, 0.0), yaw=0.4, noise=0.0, top=math.inf
    ):
        self.responds, self.drag, self.wind = responds, np.array(drag), np.array(wind)
        self.yaw, self.noise, self.top = yaw, noise, top
        self.rng = np.random.default_rng(3)

    def record(self, steps, begin_s=100.0):
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        turned = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])  # from the heading to the world
        rows, begins, now_s = [], [], begin_s
        for number, step in enumerate(steps):
            ends = np.cumsum([REST_S, step.out_s, step.back_s])
            begins.append({Phase.REST: now_s, Phase.OUT: now_s + ends[0], Phase.BACK: now_s + ends[1]})
            size = math.copysign(min(abs(step.size), self.top if step.axis == 2 else math.inf), step.size)
            times = np.arange(round(ends[2] * RATE_HZ)) / RATE_HZ
            speed, change = self.responds(times, ends[0], ends[1], size)
            for t, v, a in zip(times, speed, change, strict=True):
                velocity, acceleration = np.zeros(3), np.zeros(3)
                velocity[step.axis], acceleration[step.axis] = v, a
                drag = turned @ (self.drag * (turned.T @ (velocity - self.wind)))
                thrust = acceleration + drag + [0, 0, G]
                phase = Phase(1 + int(np.searchsorted(ends, t, side="right")))
                seen = velocity + self.noise * self.rng.normal(size=3)
                throttle = HOVER * np.linalg.norm(thrust) / G
                rows.append((now_s + t, *seen, *quat_of(thrust, self.yaw), 0, 0, 0, throttle, number, phase))
            now_s += ends[2] + 3.0
        return recorded(rows, steps, begins)


def recorded(rows, steps, begins):
    rows = np.array(rows)
    return Recording(
        steps=steps,
        begins=begins,
        time_s=rows[:, 0],
        velocity=rows[:, 1:4],
        attitude_wxyz=rows[:, 4:8],
        omega=rows[:, 8:11],
        throttle=rows[:, 11],
        step=rows[:, 12].astype(int),
        phase=rows[:, 13].astype(int),
    )


def first_order(lag_of, dead_s):
    """Exact response with a dead time and a lag by speed."""

    def responds(times, begin_s, end_s, size):
        tau = lag_of(abs(size))
        out, back = (np.maximum(times - each - dead_s, 0.0) / tau for each in (begin_s, end_s))
        began, ended = (times > each + dead_s for each in (begin_s, end_s))
        top = 1 - math.exp(-(end_s - begin_s) / tau)
        speed = np.where(ended, top * np.exp(-back), 1 - np.exp(-out)) * size
        change = np.where(ended, -top * np.exp(-back), began * np.exp(-out)) * size / tau
        return speed, change

    return responds


def jerk_limited(most_m_s2, most_m_s3, gain_per_s):
    """By small steps: acceleration gain (u - v) with limits of it and of its change."""

    def responds(times, begin_s, end_s, size):
        v = a = 0.0
        found, small = [], 1e-3
        for k in range(round(times[-1] / small) + 1):
            t = k * small
            u = size if begin_s <= t < end_s else 0.0
            if k % round(1 / (RATE_HZ * small)) == 0:
                found.append((v, a))
            wanted = min(most_m_s2, max(-most_m_s2, gain_per_s * (u - v)))
            a += min(most_m_s3 * small, max(-most_m_s3 * small, wanted - a))
            v += a * small
        speed, change = np.array(found[: len(times)]).T
        return speed, change

    return responds


def steps_of(speeds, **more):
    given = {"reserve_m": 0.5, "rates": False} | more
    return plan_steps(BARE, speeds, BOX, **given).flown


LAW, DEAD_S = (0.35, 0.12), 0.06


def lag_of(speed):
    return LAW[0] + LAW[1] * speed - DEAD_S  # 63 % after the dead time and a time constant


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_a_first_order_vehicle_is_found(noise):
    truth = Truth(first_order(lag_of, DEAD_S), drag=(0.3, 0.2, 0.1), noise=noise)
    found = fit(truth.record(steps_of((0.5, 1.0, 2.0))), G)
    loose = 0.01 + 2 * noise
    for law in (found.horizontal_lag, found.vertical_lag):
        for speed in (0.5, 1.0, 2.0, 3.0):
            assert stop_time_s((law.a.value, law.b.value), speed) == pytest.approx(
                LAW[0] + LAW[1] * speed, rel=loose + 0.01
            )
    assert found.delay_s.value == pytest.approx(
        DEAD_S + 0.0513 * np.mean([lag_of(v) for v in (0.5, 1, 2)]), abs=0.02
    )
    assert found.hover_throttle.value == pytest.approx(HOVER, rel=1e-6)
    for drag, true in zip(found.drag_per_s, (0.3, 0.2, 0.1), strict=True):
        assert drag.value == pytest.approx(true, abs=0.004 + 4 * noise)
    assert (
        found.residual_m_s2 < 0.25 + 20 * noise
    )  # the jump of a first-order acceleration is within a window
    # a first-order stop falls from 80 % to 20 % in tau log 4
    assert found.deceleration_m_s2.value == pytest.approx(
        0.6 * 2.0 / (lag_of(2.0) * math.log(4)), rel=0.03 + noise
    )
    assert found.max_up_m_s is None
    assert not found.left_out


def test_a_jerk_limited_vehicle_is_found():
    responds = jerk_limited(2.0, 6.0, 2.5)
    found = fit(Truth(responds).record(steps_of((1.0, 2.0, 3.0))), G)
    fine = np.arange(0, 20, 1 / RATE_HZ)
    for speed in (1.0, 2.0, 3.0):
        v, _ = responds(fine, 1.0, 10.0, speed)
        after = fine >= 10.0
        stop_s = float(fine[after][np.argmax(v[after] < speed * math.exp(-1))]) - 10.0
        stops = [each.time_s for each in found.responses if (each.kind, each.asked_m_s) == ("stop", speed)]
        assert stops == pytest.approx([stop_s] * len(stops), abs=0.015)
        law = found.horizontal_lag
        assert stop_time_s((law.a.value, law.b.value), speed) == pytest.approx(stop_s, rel=0.05)
    assert 0.9 * 2.0 < found.deceleration_m_s2.value <= 2.0 + 1e-6


def test_the_slower_axis_and_the_slower_direction_count():
    steps = steps_of((0.5, 1.0, 2.0))
    slow = Truth(first_order(lambda speed: 0.5 + 0.2 * speed, 0.0)).record(steps)
    found = Truth(first_order(lambda speed: 0.3 + 0.1 * speed, 0.0)).record(steps)
    for number, step in enumerate(steps):
        if step.axis == 1 or step.name.startswith("-z"):
            found.velocity[found.step == number] = slow.velocity[slow.step == number]
    law = fit(found, G)
    for each in (law.horizontal_lag, law.vertical_lag):
        assert (each.a.value, each.b.value) == pytest.approx((0.5, 0.2), abs=0.02)


def test_a_wind_is_no_drag():
    truth = Truth(first_order(lag_of, DEAD_S), drag=(0.3, 0.3, 0.3), wind=(2.0, -1.0, 0.0))
    found = fit(truth.record(steps_of((0.5, 1.0, 2.0))), G)
    assert [each.value for each in found.drag_per_s[:2]] == pytest.approx([0.3, 0.3], abs=0.01)


def test_an_acceleration_that_the_model_lacks_is_in_the_residual():
    steps = steps_of((1.0, 2.0))
    recording = Truth(first_order(lag_of, DEAD_S)).record(steps)
    pushed = (recording.step == 0) & (recording.phase == Phase.BACK)
    shape = 0.4 * np.cumsum(pushed) / RATE_HZ * pushed  # across the step
    recording.velocity[:, 1] += shape
    assert fit(recording, G).residual_m_s2 == pytest.approx(0.4, abs=0.05)


def test_a_speed_that_is_not_reached_is_a_limit():
    found = fit(Truth(first_order(lag_of, DEAD_S), top=1.2).record(steps_of((1.0, 2.0))), G)
    assert found.max_up_m_s == pytest.approx(1.2, rel=0.01)
    assert found.max_down_m_s == pytest.approx(1.2, rel=0.01)
    assert {each.speed_m_s for each in found.responses if each.axis == 2} <= {
        each.speed_m_s for each in found.responses if each.speed_m_s < 1.25
    }


def test_a_lag_that_falls_with_the_speed_counts_as_constant():
    found = fit(Truth(first_order(lambda speed: 0.6 - 0.1 * speed, 0.0)).record(steps_of((0.5, 1.0, 2.0))), G)
    assert found.horizontal_lag.b.value == 0
    assert found.horizontal_lag.a.value == pytest.approx(0.6 - 0.1 * 3.5 / 3, abs=0.01)


def test_steps_without_an_answer_are_named_and_too_few_are_refused():
    steps = steps_of((0.5, 1.0))
    recording = Truth(first_order(lag_of, DEAD_S)).record(steps)
    recording.velocity[recording.step == 1] = 0.0
    assert fit(recording, G).left_out == [steps[1].name]
    recording.velocity[np.isin(recording.step, [0, 2, 3])] = 0.0  # all horizontal ones at 0.5 m/s
    with pytest.raises(CheckError, match="fewer than two speeds"):
        fit(recording, G)


def rotated(rate_of, *, speeds=(0.5, 1.0), thrust_s=0.06, vehicle=BARE, **more):
    """Recording of all steps with --rates: `rate_of(step, s)` is the rate so long after a step began."""
    steps = plan_steps(vehicle, speeds, BOX, reserve_m=0.5, rates=True, **more).flown
    level = [each for each in steps if each.kind == "velocity"]
    base = Truth(first_order(lag_of, DEAD_S)).record(level)
    parts = (base.time_s[:, None], base.velocity, base.attitude_wxyz, base.omega, base.throttle[:, None])
    rows = np.hstack([*parts, base.step[:, None], base.phase[:, None]]).tolist()
    begins, now_s = list(base.begins), base.time_s[-1] + 5.0
    for number, step in enumerate(steps[len(level) :], len(level)):
        begins.append({Phase.REST: now_s, Phase.OUT: now_s + 1.0, Phase.BACK: now_s + 1.0 + step.out_s})
        for t in np.arange(0, 1.0 + step.duration_s, 1 / RATE_HZ):
            phase = Phase(1 + int(np.searchsorted([1.0, 1.0 + step.out_s], t, side="right")))
            since = max(0.0, t - 1.0)
            omega, climb = np.zeros(3), 0.0
            if phase is Phase.OUT and step.kind == "rate":
                omega[step.axis] = rate_of(step, since)
            elif phase is Phase.OUT:
                climb = step.size * G * (since - thrust_s * (1 - math.exp(-since / thrust_s)))
            rows.append((now_s + t, 0, 0, climb, 1, 0, 0, 0, *omega, HOVER, number, phase))
        now_s += 10.0
    return recorded(rows, steps, begins)


TAUS = (0.05, 0.04, 0.25)


def follows(step, since):
    return step.size * (1 - math.exp(-since / TAUS[step.axis]))


def test_steps_of_rates_and_thrust_are_found():
    found = fit(rotated(follows), G)
    assert [each.value for each in found.rate_s] == pytest.approx(TAUS, abs=0.003)
    assert found.thrust_s.value == pytest.approx(0.06, abs=0.003)
    assert all(low <= each.value <= high for each in found.rate_s for low, high in [each.interval])


def written(found, parameters=None):
    guess = first_guess(BARE, parameters or {})
    mine = identified_vehicle(guess, found, (0.5, 1.0), name="mine", autopilot="", date="")
    return mine, [
        line for line in disagreements(found, guess, parameters or {}) if "by the first guess" not in line
    ]


def test_rates_that_are_reached_leave_the_files_limits():
    lags = msgspec.structs.replace(BARE.rates, axis_time_constant_s=TAUS)
    found = fit(rotated(follows, vehicle=msgspec.structs.replace(BARE, rates=lags)), G)
    for limit in found.rate_limits:
        assert limit.reached_rad_s.value == pytest.approx(limit.asked_rad_s, rel=0.06)
        assert not limit.is_limited
    mine, lines = written(found)
    assert mine.rates.max_rad_s == BARE.rates.max_rad_s
    assert mine.identified.reached_rad_s[2] == pytest.approx(4.0, rel=0.06)
    assert mine.identified.reached_interval_rad_s is not None
    assert lines == []


def test_a_rate_that_is_not_reached_and_an_acceleration_that_is_not_given_are_found_and_named():
    own = {"ATC_RATE_Y_MAX": math.degrees(3.0), "ATC_ACCEL_Y_MAX": 100 * math.degrees(3.0)}

    def ramps(step, since):
        return (
            math.copysign(min(abs(step.size), 1.5 * since, 2.0), step.size)
            if step.axis == 2
            else follows(step, since)
        )

    vehicle = first_guess(BARE, own)
    found = fit(rotated(ramps, vehicle=vehicle, turns_rad_s2=3.0), G)
    turn = found.rate_limits[2]
    assert turn.asked_rad_s == 3.0
    assert turn.is_limited
    mine, lines = written(found, own)
    assert mine.rates.max_rad_s == pytest.approx((10.0, 10.0, turn.reached_rad_s.value), rel=1e-3)
    assert mine.identified.yaw_acceleration_rad_s2 == pytest.approx(1.5, rel=0.02)
    assert [line.split(":")[0] for line in lines] == [
        "fastest yaw rate, by ATC_RATE_Y_MAX",
        "yaw acceleration, by ATC_ACCEL_Y_MAX",
    ]


def test_a_rate_that_still_rises_is_no_limit():
    """A step too short for the vehicle says nothing of its limit."""
    found = fit(
        rotated(lambda step, since: follows(step, since / 6) if step.is_fast else follows(step, since)), G
    )
    turn = found.rate_limits[2]
    assert turn.reached_rad_s.value < 0.9 * turn.asked_rad_s
    assert not turn.is_limited
    assert written(found)[0].rates.max_rad_s == BARE.rates.max_rad_s


def test_a_fast_step_that_ended_early_shows_no_rate():
    recording = rotated(follows)
    for number, step in enumerate(recording.steps):
        if step.is_fast and step.axis == 0:
            recording.begins[number][Phase.BACK] -= 0.5 * step.out_s
    roll, pitch, _ = fit(recording, G).rate_limits
    assert roll is None
    assert pitch is not None


def test_intervals_contain_the_truth_nineteen_times_out_of_twenty():
    rng = np.random.default_rng(11)
    x = np.array([0.5, 0.5, 1.0, 1.0, 2.0, 2.0])
    hits = np.zeros(3)
    for _ in range(1000):
        a, b = line_of(x, 0.5 + 0.2 * x + rng.normal(scale=0.03, size=6))
        mean = mean_of((0.7 + rng.normal(scale=0.1, size=5)).tolist())
        for i, (found, true) in enumerate(((a, 0.5), (b, 0.2), (mean, 0.7))):
            hits[i] += found.interval[0] <= true <= found.interval[1]
    assert (np.abs(hits / 1000 - 0.95) < 0.025).all()
    assert mean_of([0.3]).interval is None
    assert line_of([1.0, 2.0], [0.5, 0.6])[0].interval is None


def test_smoothing_does_not_shift_a_crossing():
    times = np.arange(0, 2, 0.01)
    ramp = np.clip(times - 0.5, 0, 1)
    assert crossing(times, smoothed(times, ramp), 0.632) == pytest.approx(1.132, abs=1e-9)
    assert crossing(times, ramp, 1.5) is None


@pytest.mark.parametrize("speed", [0.5, 2.0])
def test_a_step_fits_into_its_box(speed):
    for step in steps_of((speed,)):
        end = step.start.copy()
        end[step.axis] += math.copysign(step.travel_m, step.size)
        for point in (step.start, end):
            assert (point >= np.array(BOX[:3]) + 0.7 - 1e-9).all()
            assert (point <= np.array(BOX[3:]) - 0.7 + 1e-9).all()
        assert step.travel_m > speed * step.out_s


def test_what_does_not_fit_is_left_out_and_said():
    planned = plan_steps(BARE, (1.0, 3.0), (-3, -9, 0, 3, 9, 4), reserve_m=0.5, rates=True)
    assert {each.name for each in planned.flown if each.kind == "velocity"} == {
        *("+x at 1 m/s", "-x at 1 m/s", "+y at 1 m/s", "-y at 1 m/s", "+y at 3 m/s", "-y at 3 m/s")
    }
    assert "+z at 1 m/s: it needs 3.1 m, and the box has 2.6 m" in planned.skipped
    assert sum(each.kind != "velocity" for each in planned.flown) == 16 + 6  # slow and fast
    assert isinstance(planned.flown[0], Step)
