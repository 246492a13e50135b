"""Loss of the position in flight: noticed at once, and never the end of a flight that went well."""

import math
from types import SimpleNamespace

import pytest

from alula.cli.verbs.fly.flight import _conclude, _Flown
from alula.schemas.errors import CheckError, LinkError
from alula.stages.flight.links.mavlink.satellites import Satellites
from alula.stages.flight.links.mavlink.telemetry import Telemetry
from alula.stages.flight.loop.supervisor import Event, State
from alula.stages.sim_vehicle.common.packets import mavlink
from support.flights.flights import fly, mission
from support.scenes.small_scenes import line_plan
from support.vehicles.lockstep import Flight, Upset, fault

START, GOAL = (0.3, 2.0, 0.5), (2.7, 2.0, 0.5)


def flown(state, after, do, parameters=None, *, seen_is_true=True):
    made = mission(plan=line_plan(START, GOAL, 3.5), rate_hz=50.0)
    flight = Flight(made, [Upset(state, after, do)], {}, parameters or {}).fly()
    flight.judge(seen_is_true=seen_is_true)
    return flight


def said_of(loop):
    """The error of the command, after a flight whose log says nothing else."""
    with pytest.raises((CheckError, LinkError)) as caught:
        _conclude(loop, _Flown(None, []), SimpleNamespace(output="f.run.mcap", quiet=True))
    return caught.value


def test_lost_satellites_land_it_within_a_second():
    flight = flown(State.FLY, 1.0, fault("satellites"))
    assert flight.cause is Event.ESTIMATOR_BAD
    assert flight.entered[State.LAND] - flight.entered[State.FLY] < 2.0
    error = said_of(flight.loop)
    assert isinstance(error, LinkError)
    assert "estimator not healthy (no new satellite fix for" in str(error)


def test_satellites_lost_in_the_landing_spoil_a_finished_plan():
    flight = flown(State.LAND, 0.0, fault("satellites"))
    assert (State.FLY, Event.PLAN_FINISHED) in flight.rows
    assert flight.cause is Event.ESTIMATOR_BAD
    assert "the plan was flown, but not landed as planned: estimator" in str(said_of(flight.loop))


def test_a_failsafe_in_the_landing_spoils_a_finished_plan():
    flight = flown(State.LAND, 0.1, fault("radio-loss"), {"FS_THR_ENABLE": 3})
    assert flight.cause is Event.FAILSAFE
    assert "not landed as planned: vehicle's own failsafe (Radio Failsafe)" in str(said_of(flight.loop))


def test_satellites_do_not_matter_to_a_vehicle_that_does_not_use_them():
    telemetry = Telemetry()
    assert not telemetry.satellites.is_watched
    telemetry.take(report(1, 3), 1.0)
    telemetry.take(report(1, 0), 9.0)
    telemetry.take(mavlink.MAVLink_ekf_status_report_message(0x33F, 0, 0, 0, 0, 0), 9.0)
    telemetry.poll(9.1)
    assert telemetry.status.is_estimator_ready


def test_a_landing_away_from_the_goal_is_no_success():
    def carry(vehicle, now):
        if vehicle.status.mode == "LAND" and vehicle.hold_at is not None and not carried:
            carried.append(now)
            vehicle.hold_at[0] -= 0.8

    carried = []
    loop, _ = fly(on_poll=carry)
    assert loop.supervision.cause is Event.LANDED_AWAY
    error = said_of(loop)
    assert isinstance(error, CheckError)
    assert "the plan was flown, but the vehicle landed away from the plan's end (0." in str(error)


def test_an_estimate_that_slips_away_slowly_is_no_success():
    """So does PX4 with an antenna 3.3 m ahead, by its parameter: it lands there, and all is plausible."""

    def mislead(flight):
        estimator, begun = flight.copter.estimator, flight.copter.time_s

        def update(*args, **keywords):
            own(*args, **keywords)
            slipped = min(1.5, 0.3 * (flight.copter.time_s - begun))
            estimator.offset = (-slipped, 0.0, 0.0)

        own, estimator.update = estimator.update, update

    made = mission(plan=line_plan(START, GOAL, 3.5), rate_hz=50.0)
    flight = Flight(made, [Upset(State.FLY, 0.2, mislead)]).fly()
    assert flight.cause is Event.ESTIMATOR_BAD
    assert "its position strayed by 1.0 m from the way by the velocities of satellites" in str(
        said_of(flight.loop)
    )


def test_a_vehicle_that_never_disarms_after_its_landing_is_no_success():
    made = mission(plan=line_plan(START, GOAL, 3.5), rate_hz=50.0)
    stuck = lambda flight: setattr(flight.copter, "disarm", lambda **_: False)  # noqa: E731
    flight = Flight(made, [Upset(State.FLY, 0.1, stuck)], {"landing_s": 4.0})
    flight.upsets.append(Upset(State.HAND_OVER, 0.1, lambda flight: setattr(flight, "interrupts", 1)))
    flight.fly()
    assert flight.cause is Event.TIMED_OUT
    error = said_of(flight.loop)
    assert isinstance(error, LinkError)
    assert "not landed as planned: took too long (landing: the vehicle has not disarmed within 4 s)" in str(
        error
    )


def report(stamp, fix, kind="gps_raw_int"):
    make = getattr(mavlink, f"MAVLink_{kind}_message")
    more = (0, 0) if kind == "gps2_raw" else ()
    return make(stamp, fix, 0, 0, 0, 121, 200, 0, 0, 10, *more)


@pytest.mark.parametrize(
    ("reports", "at", "trouble"),
    [
        ([], 9.0, ""),  # never a fix: another source of the position
        ([(1.0, 1, 1)], 9.0, ""),
        ([(1.0, 1, 3), (1.2, 2, 3)], 1.3, ""),
        ([(1.0, 1, 3), (1.8, 1, 3)], 1.9, ""),
        ([(1.0, 1, 3), (2.1, 1, 3)], 2.1, "no new satellite fix for 1.1 s"),
        ([(1.0, 1, 3), (1.2, 1, 1), (1.4, 1, 1)], 1.4, ""),
        ([(1.0, 1, 3), (1.2, 1, 1), (1.6, 1, 1)], 1.6, "no new satellite fix for 0.6 s"),
        ([(1.0, 1, 3), (1.6, 1, 1), (1.8, 2, 3)], 1.8, ""),
        ([(1.0, 1, 3)], 3.9, ""),  # the line may be bad
        ([(1.0, 1, 3)], 4.1, "no report of satellites for 3.1 s"),
    ],
)
def test_fixes_that_stop_are_noticed(reports, at, trouble):
    satellites = Satellites()
    satellites.is_watched = True
    for when, stamp, fix in reports:
        satellites.take(report(stamp, fix), when)
    assert satellites.trouble(at) == trouble


def velocity_report(stamp, speed_m_s, course_deg, kind="gps_raw_int", accuracy_m_s=0.1):
    made = report(stamp, 3, kind)
    made.vel, made.cog, made.vel_acc = (
        round(100 * speed_m_s),
        round(100 * course_deg),
        round(1e3 * accuracy_m_s),
    )
    return made


@pytest.mark.parametrize(
    ("speed", "course", "accuracy", "is_wrong"),
    [
        (1.0, 90.0, 0.1, False),  # as estimated: 1 m/s to the east
        (2.1, 90.0, 0.1, False),
        (2.3, 90.0, 0.1, True),
        (1.0, 0.0, 0.1, True),  # by 1.41 m/s: the course counts
        (1.0, 0.0, 0.3, False),  # a bad receiver
        (655.35, 0.0, 0.1, False),  # unknown
        (1.0, 655.35, 0.1, False),
    ],
)
def test_an_estimate_that_contradicts_the_velocity_of_satellites_is_noticed(
    speed, course, accuracy, is_wrong
):
    satellites = Satellites()
    satellites.is_watched = True
    satellites.estimated((0.0, 1.0))
    for i in range(5):
        satellites.take(velocity_report(i, speed, course, accuracy_m_s=accuracy), 0.2 * i)
        assert satellites.trouble(0.2 * i) == "" or i >= 3
    assert ("differs from that of the satellites" in satellites.trouble(0.8)) == is_wrong
    satellites.take(velocity_report(9, 1.0, 90.0), 1.0)
    assert satellites.trouble(1.0) == ""


def test_one_of_two_receivers_alone_does_not_contradict():
    satellites = Satellites()
    satellites.is_watched = True
    satellites.estimated((0.0, 1.0))
    for i in range(10):
        satellites.take(velocity_report(i, 5.0, 90.0), 0.2 * i)
        satellites.take(velocity_report(i, 1.0, 90.0, "gps2_raw"), 0.2 * i)
    assert satellites.trouble(1.9) == ""


def test_an_estimate_that_drifts_away_in_flight_lands_it():
    """The estimator takes a false velocity, as after the fault of an accelerometer."""

    def mislead(flight):
        estimator = flight.copter.estimator
        kind = type(estimator)
        own = kind.reported.fget

        def reported(self):
            motion = own(self)
            north, east, down = motion.velocity
            return motion._replace(velocity=(north + 1.5, east, down))

        flight.monkeypatch.setattr(kind, "reported", property(reported))

    patch = pytest.MonkeyPatch()
    with patch.context() as patched:
        made = mission(plan=line_plan(START, GOAL, 3.5), rate_hz=50.0)
        flight = Flight(made, [Upset(State.FLY, 0.5, mislead)])
        flight.monkeypatch = patched
        flight.fly()
    assert flight.cause is Event.ESTIMATOR_BAD
    assert flight.entered[State.LAND] - flight.entered[State.FLY] < 0.5 + 1.2
    assert "differs from that of the satellites" in str(said_of(flight.loop))


def position_report(stamp, north_m, east_m, kind="gps_raw_int", accuracy_m=0.3):
    made = report(stamp, 3, kind)
    made.lat = round(1e7 * (math.degrees(north_m / 6378100.0) + 47.0))
    made.lon = round(1e7 * (math.degrees(east_m / (6378100.0 * math.cos(math.radians(47.0)))) + 8.0))
    made.h_acc, made.vel = round(1e3 * accuracy_m), 0xFFFF
    return made


@pytest.mark.parametrize(
    ("jump_m", "accuracy_m", "is_jump"),
    [(1.5, 0.3, False), (-1.7, 0.3, True), (3.3, 0.3, True), (3.3, 1.2, False)],
)
@pytest.mark.parametrize("speed_m_s", [0.0, 5.0])
def test_fixes_that_jump_are_noticed(jump_m, accuracy_m, is_jump, speed_m_s):
    """Their delay is no jump where the vehicle speeds up."""
    satellites = Satellites()
    satellites.is_watched = True
    for i in range(30):
        at, begun = 0.2 * i, max(0.0, 0.2 * i - 1.0)
        place = lambda t: speed_m_s * max(0.0, t - 1.0)  # noqa: E731
        satellites.estimated((0.0, speed_m_s if begun else 0.0), (0.0, place(at)))
        moved = jump_m if i >= 20 else 0.0
        satellites.take(position_report(i, moved, place(at - 0.2), accuracy_m=accuracy_m), at)
        said = satellites.trouble(at)
        assert bool(said) == (is_jump and 21 <= i < 29), (i, said)


def test_a_jump_of_one_of_two_receivers_is_no_jump():
    satellites = Satellites()
    satellites.is_watched = True
    for i in range(20):
        satellites.estimated((0.0, 0.0), (0.0, 0.0))
        satellites.take(position_report(i, 9.0 if i > 9 else 0.0, 0.0), 0.2 * i)
        satellites.take(position_report(i, 0.0, 0.0, "gps2_raw"), 0.2 * i)
        assert satellites.trouble(0.2 * i) == ""


@pytest.mark.parametrize(
    ("drift_m_s", "speed_m_s", "is_wrong"), [(0.04, 1.0, False), (0.2, 1.0, True), (0.2, 0.0, True)]
)
def test_a_position_that_leaves_the_way_by_velocities_of_satellites_is_noticed(
    drift_m_s, speed_m_s, is_wrong
):
    """Slowly, so that neither two states nor two seconds show it, and the fixes with it."""
    satellites = Satellites()
    satellites.is_watched = True
    said = set()
    for i in range(150):
        at, flown_s = 0.2 * i, max(0.0, 0.2 * i - 10.0)
        if i == 50:
            satellites.take_off()
        place = drift_m_s * flown_s, speed_m_s * flown_s
        satellites.estimated((0.0, speed_m_s if flown_s else 0.0), place)
        made = position_report(i, *place)
        made.vel, made.cog, made.vel_acc = (100 if speed_m_s and flown_s else 0), 9000, 100
        satellites.take(made, at)
        said.add(satellites.trouble(at)[:20])
    assert satellites.strayed_m == pytest.approx(max(0.0, 20 * drift_m_s - 0.4 * speed_m_s - 0.2), abs=0.1)
    assert said == {"", *(["its position strayed"] if is_wrong else [])}
    satellites.is_watched = False  # it flies by something else
    assert satellites.strayed_m == 0


def test_fixes_that_jump_land_it_before_the_estimate_has_followed():
    def mislead(flight):
        flight.changes["GPS_RAW_INT"] = lambda message: setattr(message, "lat", message.lat + 296)

    flight = flown(State.FLY, 0.5, mislead)
    assert flight.cause is Event.ESTIMATOR_BAD
    assert flight.entered[State.LAND] - flight.entered[State.FLY] < 0.5 + 0.6
    assert "the position of the satellites jumped by 3.3 m" in str(said_of(flight.loop))


def test_fixes_that_jump_do_not_move_it_in_its_landing():
    """The estimate follows them, and a mode that holds a position would fly as far the other way."""
    flight = flown(State.FLY, 0.5, fault("fixes"), seen_is_true=False)
    assert flight.cause is Event.ESTIMATOR_BAD
    assert "the position of the satellites jumped by " in str(said_of(flight.loop))
    way = flight.path(State.LAND)
    assert math.dist(way[0, 1:3], way[-1, 1:3]) < 0.35
    assert not flight.copter.is_armed


def test_a_compass_that_contradicts_the_estimate_lands_it_before_the_heading_is_lost():
    def mislead(flight):
        flight.changes["EKF_STATUS_REPORT"] = lambda message: setattr(message, "compass_variance", 0.75)

    flight = flown(State.FLY, 0.5, mislead)
    assert flight.cause is Event.ESTIMATOR_BAD
    assert flight.entered[State.LAND] - flight.entered[State.FLY] < 0.5 + 1.6
    assert "it contradicts what it measures: compass" in str(said_of(flight.loop))


def test_a_vehicle_that_runs_twice_as_fast_is_held_and_landed():
    """SIM_SPEEDUP 2 in flight."""

    def hurry(flight):
        advance, from_s = flight.vehicle.advance, flight.time() - flight.begin
        flight.vehicle.advance = lambda t: advance(from_s + 2 * (t - from_s))

    flight = flown(State.FLY, 0.5, hurry)
    assert (State.FLY, Event.STATE_STALE) in flight.rows
    assert flight.entered[State.HOLD] - flight.entered[State.FLY] < 0.5 + 1.1
    assert State.LAND in flight.entered
    assert any("its clock runs faster" in each[-1] for each in flight.recorder.lines)


def test_a_second_receiver_is_enough():
    satellites = Satellites()
    satellites.is_watched = True
    for tenth in range(30):
        satellites.take(report(1, 3), 0.1 * tenth)
        satellites.take(report(tenth, 3, "gps2_raw"), 0.1 * tenth)
    assert satellites.trouble(3.0) == ""


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (0x33F, ""),
        (0x27, "no position"),
        (0xA7, "no position; constant position mode"),
        (0x33F | 1 << 15, "satellites are not accurate"),
        (0x33C, "no attitude, horizontal velocity"),
    ],
)
def test_the_flags_of_the_estimate_say_what_is_wrong(flags, words):
    telemetry = Telemetry()
    telemetry.take(mavlink.MAVLink_ekf_status_report_message(flags, 0, 0, 0, 0, 0), 1.0)
    assert telemetry.status.estimator == words
    assert telemetry.status.is_estimator_ready is not bool(words)


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (0x3FF, ""),  # PX4 at rest on the ground, ready to fly
        (0x37F, ""),  # in the air
        (0x33F, ""),
        (
            0xE5,
            "no horizontal velocity, position; constant position mode",
        ),  # at rest without a source of positions
        (0x2FF, "constant position mode"),  # at rest, and what it holds constant is no measurement
        (0x7FF, "a jump of satellites"),
        (
            0x80,
            "no attitude, horizontal velocity, vertical velocity, height, position; constant position mode",
        ),
    ],
)
def test_the_flags_of_px4s_estimate_say_what_is_wrong(flags, words):
    telemetry = Telemetry()
    telemetry.take(mavlink.MAVLink_estimator_status_message(0, flags, *[0.0] * 8), 1.0)
    assert telemetry.status.estimator == words
    assert telemetry.status.is_estimator_ready is not bool(words)
