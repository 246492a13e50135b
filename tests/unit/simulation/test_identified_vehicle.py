"""A vehicle that `identify` measured flies in simulations as it did in flight."""

import itertools
import math

import msgspec
import numpy as np
import pytest

from alula import _core
from alula.schemas.errors import UsageError
from alula.schemas.parameters.configs.plan import PlanConfig
from alula.schemas.scenarios.check import refusal
from alula.schemas.scenarios.defaults import completed
from alula.schemas.scenarios.scenario import Scenario
from alula.schemas.scenarios.vehicle import IdentifiedTable, VelocitiesTable, read_vehicle
from alula.stages.flight.loop.plan_clock import PlanClock
from alula.stages.planning.adherence import FINISHED_M, waits
from alula.stages.planning.plan import plan
from alula.stages.sim_vehicle.ardupilot.shaping import LevelProfile, VerticalProfile
from alula.stages.sim_vehicle.common.airframe import TICK_S
from alula.stages.simulation.prepare import prepare
from alula.stages.vehicles.bodies import plant_options, quadrotor, tracking_gains
from alula.stages.vehicles.following import following_options, shaped_stop_s, shaping_limits
from alula.stages.vehicles.velocity_lag import filter_lags_s, stop_time_s
from alula.stages.world.vehicle import velocity_lags_s
from support.paths import VEHICLES
from support.scenes.small_scenes import box_cover

COPTER = read_vehicle(VEHICLES / "arducopter.toml")
MEASURED = msgspec.structs.replace(
    COPTER,
    velocities=VelocitiesTable(horizontal_lag=(0.57, 0.16), vertical_lag=(0.19, 0.59)),
    identified=IdentifiedTable(speeds_m_s=(0.5, 1.0, 2.0)),
    disturbance=msgspec.structs.replace(COPTER.disturbance, linear_drag_n_s_m=(0.137, 0.137, 0.146)),
)
ARDUPILOT = {"acceleration": (2.5, 1.0), "jerk": 5.0}  # horizontally and vertically [m/s^2], [m/s^3]
DT = 0.01


def scenario(interface="velocity", mission=None, **vehicle):
    return msgspec.convert(
        {
            "schema": "alula/scenario",
            "version": "2.0",
            "name": "identified",
            "vehicle": {"interface": interface, **vehicle},
            "mission": mission or {"kind": "hover", "start_m": [0.0, 0.0, 1.0]},
        },
        Scenario,
    )


def steps(axis, speeds, seconds, interface="velocity", vehicle=MEASURED):
    """Fly set-points of constant velocity one after another; times and states."""
    ends = np.arange(len(speeds) + 1) * seconds
    pieces = np.zeros((len(speeds), 4, 8))
    pieces[:, 2, 0], pieces[:, axis, 1] = 50.0, speeds
    pieces[:, axis, 0] += np.concatenate([[0.0], np.cumsum(np.array(speeds) * seconds)[:-1]])
    spec = _core.VehicleSpec(
        quadrotor(vehicle),
        interface=interface,
        gains=tracking_gains(vehicle, 0.5),
        plant=plant_options(vehicle),
        following=following_options(vehicle),
        max_speed_m_s=5.0,
    )
    start = np.zeros(12)
    start[2] = 50.0
    simulation = _core.SimulationSpec(
        spec,
        options=_core.FlightOptions(dt_s=DT),
        rules=_core.SimulationRules(plant_steps=10, ends_at_goal=False),
    )
    mission = _core.Mission.along(_core.ReferenceCurve(ends, pieces), gain_per_s=1e-9)
    task = _core.Task(start, mission, max_time_s=float(ends[-1]), stop_distance_m=1e-9)
    (log,) = _core.simulate(simulation, [task], [])
    return np.arange(len(log["state"])) * DT, log["state"], log


@pytest.mark.parametrize(("axis", "speed_m_s"), list(itertools.product((0, 2), (0.5, 1.0, 2.0))))
def test_a_simulated_stop_takes_as_long_as_the_measured_one(axis, speed_m_s):
    times, states, _ = steps(axis, [speed_m_s, 0.0], 5.0)
    after = states[times >= 5.0, 6 + axis]
    assert after[0] == pytest.approx(speed_m_s, rel=0.02)
    taken_s = np.flatnonzero(after < math.exp(-1) * speed_m_s)[0] * DT
    law = MEASURED.velocities.horizontal_lag if axis == 0 else MEASURED.velocities.vertical_lag
    assert taken_s == pytest.approx(stop_time_s(law, speed_m_s), abs=0.07)  # of a link, too
    assert after.min() > -0.05 * speed_m_s  # it hardly flies back


def test_velocities_are_shaped_as_by_the_simulated_autopilot():
    limits = _core.FollowingOptions(
        horizontal_acceleration_m_s2=2.5,
        horizontal_jerk_m_s3=5.0,
        vertical_acceleration_m_s2=1.0,
        vertical_jerk_m_s3=5.0,
        lag_s=0.0,
        velocity_gain_per_s=0.0,
        climb_gain_per_s=0.0,
    )
    level, climb, autopilot = LevelProfile(), VerticalProfile(), _core.Autopilot(limits)
    level.start((0.0, 0.0), (1.5, 2.0)), climb.start(0.0, 0.0)
    state = np.zeros(12)
    state[6:9] = *level.velocity, 0.0
    autopilot.reset(state)
    for _ in range(600):
        level.advance(), climb.advance()
        level.to_velocity((-0.6, -0.8), (0.0, 0.0), 2.5, 5.0)
        climb.to_velocity(1.2, 0.0, 1.0, 5.0)
        autopilot.follow_velocity(TICK_S, (-0.6, -0.8, 1.2), np.zeros(12))
        np.testing.assert_allclose(autopilot.velocity, (*level.velocity, climb.velocity), atol=1e-9)


def test_accelerations_are_followed_with_the_jerk_of_the_stops():
    autopilot = _core.Autopilot(following_options(MEASURED))
    state = np.zeros(12)
    autopilot.reset(state)
    for _ in range(100):
        autopilot.follow_acceleration(1e-3, (3.0, 4.0, 0.0), state)
    assert math.hypot(*autopilot.acceleration[:2]) == pytest.approx(0.1 * 5.0, rel=0.1)
    np.testing.assert_allclose(autopilot.acceleration[0] / autopilot.acceleration[1], 0.75)


def test_a_climb_is_being_braked_where_a_flight_begins():
    autopilot = _core.Autopilot(following_options(MEASURED))
    state = np.zeros(12)
    state[8] = 0.35
    autopilot.reset(state)
    assert autopilot.acceleration[2] == pytest.approx(-1.0, rel=0.1)


def test_limits_found_from_stops_are_those_that_made_them():
    for acceleration in ARDUPILOT["acceleration"]:
        times = [shaped_stop_s(acceleration, ARDUPILOT["jerk"], speed) for speed in (0.5, 2.0)]
        b = (times[1] - times[0]) / 1.5
        law = (times[0] - 0.5 * b + 0.08, b)
        np.testing.assert_allclose(
            shaping_limits(law, (0.5, 1.0, 2.0)), (acceleration, ARDUPILOT["jerk"]), rtol=0.02
        )


def test_the_time_of_a_shaped_stop_is_that_of_the_simulated_autopilot():
    for speed in (0.3, 1.0, 1.3, 3.0):
        profile = LevelProfile()
        profile.start((0.0, 0.0), (speed, 0.0))
        ticks = 0
        while profile.velocity[0] > math.exp(-1) * speed:
            profile.advance()
            profile.to_velocity((0.0, 0.0), (0.0, 0.0), 2.5, 5.0)
            ticks += 1
        assert shaped_stop_s(2.5, 5.0, speed) == pytest.approx(ticks * TICK_S, abs=3 * TICK_S)


def test_only_a_measured_vehicle_has_an_autopilot_and_waits():
    along = {"kind": "plan", "plan": "a.plan.npz"}
    for vehicle, has in ((MEASURED, True), (COPTER, False)):
        full = completed(scenario(mission=along), vehicle)
        assert (bool(full.vehicle.autopilot), bool(full.mission.waits)) == (has, has)
        assert (full.vehicle.velocity_gain_per_s is None) == has
        assert completed(full, vehicle) == full
    assert completed(scenario(), COPTER).vehicle.velocity_gain_per_s == COPTER.tracking.kv_per_s
    own = completed(scenario(velocity_gain_per_s=1.5), MEASURED).vehicle
    assert (own.velocity_gain_per_s, own.autopilot) == (1.5, None)
    assert not completed(scenario("body-rates"), MEASURED).vehicle.autopilot


@pytest.mark.parametrize(
    ("words", "changed"),
    [
        ("`$.vehicle.autopilot`: it follows velocities", {"interface": "wrench", "autopilot": True}),
        ("`$.vehicle.velocity_gain_per_s`: an autopilot", {"autopilot": True, "velocity_gain_per_s": 1.0}),
    ],
)
def test_an_autopilot_that_makes_no_sense_is_refused(words, changed):
    assert refusal(scenario(**{"interface": "velocity"} | changed), MEASURED).startswith(words)


PILLAR = [((20, -30, -10), (21, 10, 40))]
VIA = (2.05, 1.4, 1.0)


def around(speed_m_s=1.0):
    cover = box_cover(PILLAR)
    config = PlanConfig(
        beyond_map_m=3.0,
        start=(0.4, 0.5, 1.0),
        goal=(3.6, 0.5, 1.0),
        via=(VIA,),
        radius_m=0.27,
        speed_m_s=speed_m_s,
    )
    return cover, plan(config, cover)


def prepared(cover, way, vehicle=MEASURED, **mission):
    words = {
        "kind": "plan",
        "plan": "a.plan.npz",
        "start_velocity_m_s": [0.0, 0.0, 0.35],
        **mission,
    }
    given = scenario(mission=words)
    world = msgspec.structs.replace(given.world, cover="a.cover.npz", inflation_m=0.1)
    safety = msgspec.structs.replace(given.safety, filters=("polytope-cbf",))
    return prepare(
        msgspec.structs.replace(given, world=world, safety=safety), vehicle, cover=cover, plan=way, jobs=1
    )


def test_the_time_of_a_plan_waits_by_the_clock_of_fly():
    cover, way = around()
    run = prepared(cover, way)
    (log,) = run.fly(0, 1, jobs=1)
    trial = run.judged(0, log)
    assert trial.outcome == "reached", trial
    (curve,) = run.missions.curves
    clock = PlanClock(curve, waits(way, 0.15, 0.15))
    for estimate, time_s in zip(log["estimate"], log["plan_s"], strict=False):
        assert clock.time_s == pytest.approx(time_s, abs=1e-12)
        clock.advance(DT, float(np.linalg.norm(estimate[:3] - clock.target()[0, :3])))
    assert trial.duration_s > curve.duration_s + 0.5  # it did wait
    assert np.linalg.norm(log["last"][:3] - run.missions.goal[0]) < FINISHED_M
    at = curve.at(log["plan_s"])[:, :3]
    error = np.linalg.norm(log["state"][:, :3] - at, axis=1).max()
    assert trial.max_tracking_error_m == pytest.approx(error)
    assert log["state"][0, 8] == 0.35


def test_without_waits_the_time_of_a_plan_is_that_of_the_clock():
    cover, way = around()
    run = prepared(cover, way, waits=False)
    (log,) = run.fly(0, 1, jobs=1)
    assert len(log["plan_s"]) == 0


def test_filters_of_velocities_assume_the_lags_of_fly():
    full = completed(scenario(), MEASURED)
    assert velocity_lags_s(full, MEASURED, 1.5) == filter_lags_s(MEASURED.velocities, 1.5)
    assert velocity_lags_s(completed(scenario(velocity_lag_s=0.4), MEASURED), MEASURED, 1.5) == (
        0.4,
        0.4,
        0.4,
    )


def test_errors_of_an_estimate_are_correlated_over_their_time():
    found = {}
    for time_s in (0.0, 2.0):
        given = scenario(mission={"kind": "hover", "start_m": [0.0, 0.0, 1.0]})
        known = msgspec.structs.replace(
            given.estimation, position_noise_m=0.01, velocity_noise_m_s=0.01, noise_time_s=time_s
        )
        given = msgspec.structs.replace(given, estimation=known)
        rules = msgspec.structs.replace(given.rules, max_time_s=60.0)
        run = prepare(msgspec.structs.replace(given, rules=rules), MEASURED, jobs=1)
        (log,) = run.fly(0, 1, jobs=1)
        error = log["measured"] - log["state"][:-1]
        for first in (0, 6):
            each = error[:, first : first + 3]
            assert each.std() == pytest.approx(0.01, rel=0.35)
            found[time_s, first] = (each[1:] * each[:-1]).mean() / (each * each).mean()
    for first in (0, 6):
        assert abs(found[0.0, first]) < 0.1
        assert found[2.0, first] == pytest.approx(math.exp(-DT / 2.0), abs=0.01)


def test_a_flight_along_a_plan_begins_where_the_climb_ends():
    cover, way = around()
    run = prepared(cover, way, start_m=[0.4, 0.5, 0.95])
    (log,) = run.fly(0, 1, jobs=1)
    np.testing.assert_allclose(log["state"][0, [0, 1, 2, 8]], (0.4, 0.5, 0.95, 0.35))
    with pytest.raises(UsageError, match="start_m"):
        prepared(cover, way, start_m=[2.05, -1.0, 1.0])
