"""Flights through the built-in room with faults: the plan is completed, or the vehicle lands.

The room goes through the whole pipeline. Both filters fly it against the simulated autopilot, with its noise
and delay; where the vehicle truly was is held against the map by exact distances, of which no filter knows.
"""

import numpy as np
import pytest

from alula.cli.main import run
from alula.schemas.artifacts.artifact import read_artifact
from alula.schemas.artifacts.kinds import COVER, PLAN, SCENE
from alula.schemas.scenarios.vehicle import read_vehicle
from alula.stages.flight.loop.supervisor import Event, State
from support.flights.flights import mission
from support.paths import VEHICLES
from support.vehicles.autopilot_client import QUICK
from support.vehicles.lockstep import Flight, Upset, fault

START, GOAL = "0.8 0.8 0.9", "4.7 3.6 1.1"  # behind a hoop and a pillar
FILTERS = ("cone-backup", "polytope-cbf")
SENT = dict(zip(FILTERS, ("rates", "velocity"), strict=True))
BARE = ("--filter", "none", "--interface", "body-rates")  # as fast as the vehicle
AS_PLANNED = ["checks", "arming", "take-off", "fly", "land", "done"]


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """Missions among the ellipsoids and among the hulls of the room, by the rate of the loop."""
    folder = tmp_path_factory.mktemp("room")
    f = lambda name: str(folder / name)  # noqa: E731
    poses = ("--colmap", f("colmap"), "--reference", f("poses.csv"))
    for step in (
        ("demo-scene", "-o", f("room.ply"), "--gaussians", "12000", "--images", "24", *poses),
        ("import-splat", f("room.ply"), "-o", f("scene.npz"), "--min-opacity", "0.1", "--drop-floaters"),
        ("scale-align", f("scene.npz"), "-o", f("metric.npz"), *poses, "--max-rms", "0.02"),
        ("voxelize", f("metric.npz"), "-o", f("voxels.npz"), "--size", "0.1"),
        ("merge", f("voxels.npz"), "-o", f("cover.npz"), "--hulls", "150"),
        (
            "plan",
            f("cover.npz"),
            "-o",
            f("plan.npz"),
            "--start",
            START,
            "--goal",
            GOAL,
            "--radius",
            "0.25",
            *BARE,
        ),
    ):
        speed = ("--speed", "1.5") if step[0] == "plan" else ()
        assert run([*step, *speed, "-q"]) == 0, step
    cover, scene, plan = (
        read_artifact(folder / name, kind)
        for name, kind in (("cover.npz", COVER), ("metric.npz", SCENE), ("plan.npz", PLAN))
    )
    copter = read_vehicle(VEHICLES / "arducopter.toml")  # that turns about its yaw axis as slowly
    return {
        rate_hz: {
            "cone-backup": mission("cone-backup", scene=scene, plan=plan, rate_hz=rate_hz, vehicle=copter),
            "polytope-cbf": mission("polytope-cbf", cover=cover, plan=plan, rate_hz=rate_hz),
        }
        for rate_hz in (100.0, 50.0)
    }


def burst(kind, after, seconds=0.5, probability=1.0, **fields):
    do = fault(kind, duration=seconds, probability=probability, **fields)
    return Upset(State.FLY, after, do)


LINE = [  # one after another, while it flies
    burst("drop", 0.3, probability=0.4),
    burst("duplicate", 0.8),
    burst("reorder", 1.3),
    burst("wrong-system", 1.8, probability=0.4),
    burst("bad-crc", 2.3, probability=0.4),
    burst("nan", 2.8, probability=0.4),
    burst("freeze", 3.3, probability=0.4),
    burst("delay", 3.8, amount=0.05),
    burst("drop", 4.3, probability=0.3, way="in"),
]
GAPS = [  # each too long to continue; times count from where it flies again
    burst("freeze", 0.8, 0.4),
    burst("delay", 1.0, 0.3, amount=0.4),
    burst("drop", 1.25, 0.4),
]
LANDED_M = 0.5  # above the floor; below, the ground is near


def fly(made, *upsets, **limits):
    return Flight(made, list(upsets), limits, noise=QUICK).fly()


@pytest.mark.every(4)
@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("faults", [LINE, GAPS], ids=["a bad line", "gaps"])
def test_admissible_faults_end_at_the_goal_in_the_safe_set(room, name, faults):
    flight = fly(room[100.0][name], *faults)
    flight.judge()
    assert flight.cause is Event.PLAN_FINISHED, flight.recorder.lines[-6:]
    assert not flight.upsets
    assert flight.rows.count((State.FLY, Event.STATE_STALE)) == (3 if faults is GAPS else 0)
    assert flight.clearance(State.FLY, State.HOLD) > 0.5 * room[100.0][name].config.margin_m
    assert np.linalg.norm(flight.path(State.FLY)[-1, 1:] - room[100.0][name].goal) < 0.4
    assert not flight.copter.is_armed
    assert flight.link.status.bad_packets > 10 or faults is GAPS
    assert {s.safety.sent for s in flight.recorder.samples if s.safety} == {SENT[name]}


@pytest.mark.every(6)
@pytest.mark.parametrize("seconds", [0.06, 0.7, 1.5])
@pytest.mark.parametrize("way", ["in", "out"])
def test_no_flight_begins_on_a_line_that_was_always_slow(room, seconds, way):
    slow = Upset(None, 0.0, fault("delay", duration=1e3, amount=seconds, way=way))
    flight = fly(room[100.0]["polytope-cbf"], slow)
    assert "latency" in flight.loop.checks.failure(), (flight.rows, flight.loop.checks.failure())
    assert not flight.copter.is_armed
    assert flight.recorder.states == ["checks", "done"]


HELD, LOST = ["fly", "hold", "land", "done"], ["fly", "hold", "land", "hand-over", "done"]
ENDING = {  # the fault, the cause that ends the flight, and its states
    "freeze": (fault("freeze"), Event.ESTIMATOR_BAD, HELD),  # satellites contradict it
    "no numbers": (fault("nan"), Event.ESTIMATOR_BAD, HELD),
    "150 ms late": (fault("delay", amount=0.15), Event.TIMED_OUT, HELD),
    "400 ms late": (fault("delay", amount=0.4), Event.TIMED_OUT, HELD),
    "silence": (fault("drop"), Event.LINK_LOST, LOST),
    "damaged": (fault("bad-crc"), Event.LINK_LOST, LOST),
    "another's": (fault("wrong-system"), Event.LINK_LOST, LOST),
    "jump": (fault("jump", amount=1.0), Event.STATE_JUMPED, ["fly", "land", "done"]),
    "battery": (fault("battery", amount=0.15), Event.BATTERY_LOW, ["fly", "land", "done"]),
    "mode": (fault("mode", amount=9), Event.MODE_CHANGED, ["fly", "hand-over", "done"]),  # the pilot lands it
}
SPARED = {  # as others are: with one filter only
    *(("cone-backup", "400 ms late"), ("cone-backup", "another's")),
    *(("polytope-cbf", "no numbers"), ("polytope-cbf", "damaged")),
}


@pytest.mark.every(8)
@pytest.mark.parametrize(("name", "kind"), [(n, k) for n in FILTERS for k in ENDING if (n, k) not in SPARED])
def test_other_faults_end_on_the_ground_in_the_safe_set(room, name, kind):
    fault, cause, states = ENDING[kind]
    flight = fly(room[50.0][name], Upset(State.FLY, 1.6, fault), landing_s=8.0)
    flight.judge(seen_is_true=kind != "jump")
    assert flight.cause is cause
    assert flight.recorder.states == [*AS_PLANNED[:3], *states]
    path = flight.path(State.HOLD, State.LAND, State.HAND_OVER)
    down = path[path[:, 3] > LANDED_M, 1:]
    assert flight.clearance_of(down) > 0
    assert not flight.copter.is_armed
    assert flight.truth[-1][3] > -0.02  # down, where it stood
