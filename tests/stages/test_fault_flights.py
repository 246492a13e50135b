"""Flights through the built-in room with faults on the way: the plan is flown, or they end on the ground.

The room goes through the whole pipeline. Both filters fly it against the simulated autopilot, with its noise and
delay; where the vehicle truly was is held against the map by exact distances, of which no filter knows.
"""

import numpy as np
import pytest
from autopilot_client import QUICK
from flights import mission
from lockstep import Flight, Upset, cut, fault, stall

from alula.cli.main import run
from alula.schemas.artifact import read_artifact
from alula.schemas.kinds import COVER, PLAN, SCENE
from alula.stages.flight.supervisor import Event, State

START, GOAL = "0.8 0.8 0.9", "4.7 3.6 1.1"  # behind a hoop and a pillar
FILTERS = ("cone-backup", "polytope-cbf")
AS_PLANNED = ["checks", "arming", "take-off", "fly", "land", "done"]


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """A mission among its ellipsoids, and one among its hulls."""
    folder = tmp_path_factory.mktemp("room")
    f = lambda name: str(folder / name)  # noqa: E731
    poses = ("--colmap", f("colmap"), "--reference", f("poses.csv"))
    for step in (
        ("demo-scene", "-o", f("room.ply"), "--gaussians", "12000", "--images", "24", *poses),
        ("import-splat", f("room.ply"), "-o", f("scene.npz"), "--drop-floaters"),
        ("scale-align", f("scene.npz"), "-o", f("metric.npz"), *poses, "--max-rms", "0.02"),
        ("voxelize", f("metric.npz"), "-o", f("voxels.npz"), "--size", "0.1"),
        ("merge", f("voxels.npz"), "-o", f("cover.npz"), "--hulls", "150"),
        ("plan", f("cover.npz"), "-o", f("plan.npz"), "--start", START, "--goal", GOAL, "--radius", "0.25"),
    ):
        speed = ("--speed", "1.5") if step[0] == "plan" else ()
        assert run([*step, *speed, "-q"]) == 0, step
    cover, scene, plan = (
        read_artifact(folder / name, kind)
        for name, kind in (("cover.npz", COVER), ("metric.npz", SCENE), ("plan.npz", PLAN))
    )
    return {
        "cone-backup": mission("cone-backup", scene=scene, plan=plan),
        "polytope-cbf": mission("polytope-cbf", cover=cover, plan=plan),
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
GAPS = [  # each too long to be flown on
    burst("freeze", 0.8, 0.4),
    burst("delay", 2.0, 0.3, amount=0.4),
    burst("drop", 3.2, 0.4),
]


def fly(room, name, *upsets):
    flight = Flight(room[name], list(upsets), noise=QUICK)
    flight.fly()
    return flight


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("faults", ["a bad line", "gaps"])
def test_admissible_faults_end_at_the_goal_in_the_safe_set(room, name, faults):
    flight = fly(room, name, *(LINE if faults == "a bad line" else GAPS))
    flight.judge()
    assert flight.cause is Event.PLAN_FINISHED, flight.recorder.lines[-6:]
    assert not flight.upsets
    print(name, faults, flight.clearance(State.FLY, State.HOLD), flight.recorder.states, len(flight.truth))
    end = flight.path(State.FLY)[-1, 1:]
    assert np.linalg.norm(end - room[name].goal) < 0.4
    assert not flight.copter.is_armed


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("after", [1.0, 2.5])
@pytest.mark.parametrize("kind", ENDING := {
    "freeze": ([fault("freeze")], Event.TIMED_OUT),
    "nan": ([fault("nan")], Event.TIMED_OUT),
    "delay": ([fault("delay", amount=0.4)], Event.TIMED_OUT),
    "delay 150": ([fault("delay", amount=0.15)], Event.TIMED_OUT),
    "drop": ([fault("drop")], Event.LINK_LOST),
    "bad-crc": ([fault("bad-crc")], Event.LINK_LOST),
    "wrong-system": ([fault("wrong-system")], Event.LINK_LOST),
    "jump": ([fault("jump", amount=1.0)], Event.STATE_JUMPED),
    "mode": ([fault("mode", amount=9)], Event.MODE_CHANGED),
    "battery": ([fault("battery", amount=0.15)], Event.BATTERY_LOW),
    "cut": ([cut], Event.LINK_LOST),
    "stall": ([stall(0.5)], Event.PLAN_FINISHED),
})
def test_other_faults_end_on_the_ground_in_the_safe_set(room, name, kind, after):
    dos, cause = ENDING[kind]
    flight = fly(room, name, *(Upset(State.FLY, after, do) for do in dos))
    print(name, kind, flight.clearance(State.FLY, State.HOLD), flight.clearance(State.LAND), flight.recorder.states, flight.cause, len(flight.truth), flight.copter.is_armed)
    flight.judge(seen_is_true=kind != "jump")
    assert flight.cause is cause
