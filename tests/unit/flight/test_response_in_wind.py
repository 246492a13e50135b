"""Wind and changed vehicles on flights by velocities and accelerations: noticed, countered, landed."""

import numpy as np
import pytest

from alula.schemas.scenarios.vehicle import read_vehicle
from alula.stages.flight import mission as missions
from alula.stages.flight.loop.supervisor import Event, State
from alula.stages.sim_vehicle.common.estimator import EstimatorOptions
from support.flights.flights import mission
from support.paths import VEHICLES
from support.scenes.small_scenes import ball_scene, box_cover, line_plan
from support.vehicles.lockstep import Flight, Upset, blow

COPTER = read_vehicle(VEHICLES / "arducopter.toml")
NOISY = EstimatorOptions(boot_time_s=0.5)  # its default noise
WALL = [((-20, 24, 0), (80, 26, 40))]  # at y = 2.4, beside a plan at y = 2.05: 0.2 m clear
BALLS = [(x, 2.85, 1.0) for x in (1.4, 3.0, 4.6, 6.2)]  # of 0.3 m, at y = 2.55
FILTERS = ["polytope-cbf", "cone-di", "safer-splat"]
LIMIT_M_S2 = 2.0  # at which a flight by velocities or accelerations is held


def along(name, speed, length=6.0, **words):
    plan = line_plan((0.4, 2.05, 1.0), (0.4 + length, 2.05, 1.0), length / speed)
    where = {"cover": box_cover(WALL)} if name == "polytope-cbf" else {"scene": ball_scene(BALLS, 0.3)}
    return mission(name, plan=plan, vehicle=COPTER, **where, **words)


def fly(name, speed, *upsets, **words):
    # Whether a gust is taken for a wrong frame is the subject of other tests.
    made = along(name, speed, frame_check="none", **words.pop("made", {}))
    return Flight(made, list(upsets), noise=NOISY, **words).fly()


def seen(flight):
    """Estimates (T, 3) and bounds (T,) of the ticks with set-points."""
    found = [s.safety for s in flight.recorder.samples if s.safety is not None]
    estimate = np.array([f.disturbance_m_s2.tuple for f in found])
    return estimate, np.array([f.disturbance_bound_m_s2 for f in found])


def worst(flight):
    estimate, bound = seen(flight)
    return max(np.linalg.norm(estimate, axis=1).max(), bound.max())


@pytest.mark.slow
@pytest.mark.parametrize("speed", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("name", FILTERS)
def test_without_a_change_the_watch_is_quiet_with_room_to_spare(name, speed):
    flight = fly(name, speed, seed=round(10 * speed), made={"length": min(6 * speed, 6)})
    assert flight.cause is Event.PLAN_FINISHED
    # Accelerations at 2 m/s end in a stop that the autopilot's own velocity loop does not follow.
    assert worst(flight) <= (0.0 if name == "polytope-cbf" else 0.6 * LIMIT_M_S2 if speed == 2 else 0.1)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("speed", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("name", FILTERS)
def test_it_is_quiet_for_many_seeds(name, speed, seed):
    flight = fly(name, speed, seed=100 + seed, made={"length": min(6 * speed, 6)})
    assert flight.cause is Event.PLAN_FINISHED
    assert worst(flight) <= (0.1 if name == "polytope-cbf" or speed < 2 else 0.6 * LIMIT_M_S2)


@pytest.mark.every(3)
@pytest.mark.parametrize(
    ("name", "wind", "more_m"),
    [("polytope-cbf", 3.0, 0.02), ("polytope-cbf", 6.0, 0.04), ("cone-di", 6.0, 0.03)],
)
def test_a_wind_that_rises_at_once_towards_an_obstacle_is_countered(monkeypatch, name, wind, more_m):
    gust = [Upset(State.FLY, 2.0, blow(0.0, wind, 0.0))]
    flight = fly(name, 1.0, *gust)
    monkeypatch.setattr(missions, "_RESPONSE_S", 0.0)
    without = fly(name, 1.0, Upset(State.FLY, 2.0, blow(0.0, wind, 0.0)))
    kept, lost = (each.clearance(State.FLY, State.HOLD) for each in (flight, without))
    assert kept > lost + more_m
    assert not seen(without)[1].any()
    estimate, bound = seen(flight)
    assert estimate[:, 1].max() > 0.15
    assert bound.max() > 0.3
    assert (State.FLY, Event.MODEL_WRONG) not in flight.rows  # a gust that passes is no reason to land
    assert bound[-1] < 0.2 * bound.max()  # released
    logged = [s.safety.added_margin_m for s in flight.recorder.samples if s.safety is not None]
    way = 0.125 if name == "cone-di" else 0.5 * np.max(flight.made.config.velocity_lag_s)
    assert max(logged) == pytest.approx(bound.max() * way)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["polytope-cbf", "cone-di"])
def test_a_wind_that_is_too_strong_holds_and_lands(name):
    flight = fly(name, 1.0, Upset(State.FLY, 2.0, blow(0.0, -12.0, 0.0)))
    assert (State.FLY, Event.MODEL_WRONG) in flight.rows
    said = "\n".join(words for _, words in flight.recorder.lines)
    assert "m/s^2 that the model leaves out, at most 2 are allowed" in said


def lose_thrust(share):
    """From now on the rotors give this share of the thrust that they are commanded to give."""

    def do(flight):
        step = flight.copter.airframe.step
        flight.copter.airframe.step = lambda thrust_n, torque: step(share * thrust_n, torque)

    return do


@pytest.mark.slow
@pytest.mark.parametrize("name", ["polytope-cbf", "cone-di"])
def test_lost_thrust_is_seen_as_an_acceleration_downwards(name):
    flight = fly(name, 1.0, Upset(State.FLY, 2.0, lose_thrust(0.5)))
    estimate, bound = seen(flight)
    assert estimate[:, 2].min() < -0.4
    assert bound.max() > 1.0


@pytest.mark.slow
@pytest.mark.parametrize("limit_cm_s2", [250.0, 60.0])
def test_a_vehicle_that_brakes_too_slowly_is_noticed(limit_cm_s2):
    """WPNAV_ACCEL of the vehicle is lowered in flight, which it does not tell; its plan leads into a wall."""

    def slow(flight):
        flight.link._parameters.watch(())
        assert flight.copter.parameters.set("WPNAV_ACCEL", limit_cm_s2)

    made = mission(
        cover=box_cover([((80, -40, 0), (90, 80, 40))]),
        plan=line_plan((0.4, 2.05, 1.0), (10.4, 2.05, 1.0), 5.0),
        vehicle=COPTER,
        is_clear=True,
        frame_check="none",
        max_time_s=10.0,
    )
    flight = Flight(made, [Upset(State.FLY, 1.0, slow)], noise=NOISY).fly()
    if limit_cm_s2 == 250.0:  # its default
        assert worst(flight) == 0
    else:
        assert seen(flight)[0][:, 0].max() > 0.3
