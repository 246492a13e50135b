"""Whole flights against the simulated autopilot through sockets, on one clock, with faults on the way."""

import math
from contextlib import contextmanager

import numpy as np
import pytest
from fake_vehicle import Kept
from flights import BALL, GOAL, START, loop_of, mission
from mavlink_peer import Time
from test_link_and_autopilot import Served
from test_simulate import box_cover, line_plan

from alula.stages.flight.autopilot.faults import Fault
from alula.stages.flight.frames import LocalFrame
from alula.stages.flight.links.open_link import open_link
from alula.stages.flight.links.options import LinkOptions
from alula.stages.flight.supervisor import Event, State
from alula.stages.reporting.metrics import path_clearance

# The vehicle boots at the origin of its local frame: that is below the plan's start.
FRAME = LocalFrame(origin_enu_m=(-START[0], -START[1], 0.0))
RADIUS_M = 0.15
AS_PLANNED = ["checks", "arming", "take-off", "fly", "land", "done"]


class Watched(Served):
    """Keeps where it truly was, and injects a fault a while after set-points began."""

    def __init__(self, *faults, **keywords):
        super().__init__(**keywords)
        self.path, self.faults, self.flown = [], list(faults), None

    @property
    def is_armed(self):
        return self.copter.is_armed

    def tick(self, now):
        super().tick(now)
        truth = self.copter.airframe.truth
        self.path.append((now, *FRAME.position_from_ned(np.array(truth.position))))
        if self.flown is not None and now - self.flown > 1.5:
            while self.faults:
                self.vehicle.inject(self.faults.pop())


@contextmanager
def flight(made, served, **keywords):
    time = Time(served)
    link = open_link(
        f"udpout:127.0.0.1:{served.port}", LinkOptions(frame=FRAME, clock=time, sleep=time.sleep)
    )
    link.clock = time  # of the loop, too
    recorder = Kept()
    try:
        link.open(5.0)
        link.prepare()
        loop = loop_of(made, link, recorder=recorder, **keywords)
        tell, limits = recorder.step, loop.options.limits
        recorder.step = lambda at, taken: (began(served, time, taken), tell(at, taken))
        assert limits.stale_s == 0.15
        loop.run()
        yield loop
    finally:
        link.close()
        served.socket.close()


def began(served, time, taken):
    if taken.step.state is State.FLY and served.flown is None:
        served.flown = time()


def fly(made, *faults, kind=Watched, **keywords):
    served = kind(*faults, **keywords)
    with flight(made, served) as loop:
        return loop, served


def true_path(loop, served, *states):
    """Where it truly was while the supervisor was in these states, shape (T, 3)."""
    begin = loop._begin_s
    spans = [(s.time_s + begin) for s in loop.recorder.samples if s.state in states]
    rows = np.array(served.path)
    return rows[(rows[:, 0] >= spans[0]) & (rows[:, 0] <= spans[-1]), 1:]


def clearance(made, path):
    return (
        min(float(path_clearance(np.ascontiguousarray(path), o).min()) for _, o in made.obstacles) - RADIUS_M
    )


@pytest.fixture(scope="module")
def among_hulls():
    return mission(plan=line_plan(START, GOAL, 4.5))


def test_cone_backup_flies_around_an_ellipsoid_and_lands():
    made = mission("cone-backup", scene=BALL, is_clear=True)
    loop, served = fly(made)
    assert loop.recorder.states == AS_PLANNED
    assert loop.supervision.cause is Event.PLAN_FINISHED
    path = true_path(loop, served, "fly")
    assert clearance(made, path) > 0
    assert np.linalg.norm(path[-1] - GOAL) < 0.3
    assert not served.is_armed
    assert {s.filter.sent for s in loop.recorder.samples if s.filter} == {"rates"}


def test_polytope_cbf_flies_past_a_pillar_and_lands(among_hulls):
    loop, served = fly(among_hulls)
    assert loop.recorder.states == AS_PLANNED
    assert clearance(among_hulls, true_path(loop, served, "fly")) > 0
    assert {s.filter.sent for s in loop.recorder.samples if s.filter} == {"velocity"}


def test_a_plan_that_ends_fast_before_a_wall_leaves_all_of_the_margin():
    """At 3 m/s; a filter that knows nothing of the autopilot's lag is flown into the wall."""
    wall = box_cover([((40, 0, 0), (44, 40, 30))])
    made = mission(cover=wall, plan=line_plan(START, GOAL, 2.5), speed_m_s=3.0)
    loop, served = fly(made)
    assert loop.recorder.states == AS_PLANNED
    assert clearance(made, true_path(loop, served, "fly")) >= made.config.margin_m


ADMISSIBLE = {  # the plan is flown to its end
    "packets lost, twice, damaged": ("drop", "duplicate", "bad-crc"),
    "packets out of order, of others, without numbers": ("reorder", "wrong-system", "nan"),
    "short freeze": (Fault(kind="freeze", duration=0.4),),
    "short drop": (Fault(kind="drop", duration=0.4),),
}


@pytest.mark.parametrize("name", ADMISSIBLE)
def test_admissible_faults_end_at_the_goal_in_the_safe_set(among_hulls, name):
    faults = [Fault(kind=f, probability=0.2) if isinstance(f, str) else f for f in ADMISSIBLE[name]]
    loop, served = fly(among_hulls, *faults)
    assert loop.supervision.cause is Event.PLAN_FINISHED, loop.recorder.lines[-6:]
    assert clearance(among_hulls, true_path(loop, served, "fly", "hold")) > 0
    assert not served.is_armed


ENDING = {  # what ends the flight, and the states after flying
    "long freeze": (Fault(kind="freeze"), Event.TIMED_OUT, ["hold", "land", "done"]),
    "late packets": (Fault(kind="delay", amount=0.5), Event.TIMED_OUT, ["hold", "land", "done"]),
    "silence": (Fault(kind="drop"), Event.LINK_LOST, ["hold", "land", "hand-over", "done"]),
    "battery": (Fault(kind="battery", amount=0.15), Event.BATTERY_LOW, ["land", "done"]),
    "estimator": (Fault(kind="estimator"), Event.ESTIMATOR_BAD, ["land", "done"]),
}


@pytest.mark.parametrize("name", ENDING)
def test_other_faults_end_on_the_ground_in_the_safe_set(among_hulls, name):
    fault, cause, states = ENDING[name]
    loop, served = fly(among_hulls, fault)
    assert loop.recorder.states == [*AS_PLANNED[:4], *states]
    assert loop.supervision.cause is cause
    assert ("hold" in states) == (Event.STATE_STALE in [taken.event for _, taken in loop.taken])
    assert clearance(among_hulls, true_path(loop, served, "fly", "hold", "land")) > 0
    assert not served.is_armed


@pytest.mark.parametrize("mode", ["LOITER", "LAND"])
def test_the_pilots_switch_wins_for_good(among_hulls, mode):
    from alula.stages.flight.autopilot.modes import Mode

    served = Watched(Fault(kind="mode", amount=float(Mode[mode])))
    time = Time(served)
    end = []

    def asked():  # the operator leaves it to the pilot after a while
        if not served.faults and not end:
            end.append(time())
        return int(bool(end) and time() - end[0] > 4.0)

    link = open_link(
        f"udpout:127.0.0.1:{served.port}", LinkOptions(frame=FRAME, clock=time, sleep=time.sleep)
    )
    link.clock = time
    loop = None
    try:
        link.open(5.0)
        link.prepare()
        loop = loop_of(among_hulls, link, interrupts=asked)
        tell = loop.recorder.step
        loop.recorder.step = lambda at, taken: (began(served, time, taken), tell(at, taken))
        loop.run()
        assert loop.recorder.states[:5] == [*AS_PLANNED[:4], "hand-over"]
        assert loop.supervision.cause in (Event.MODE_CHANGED, Event.FAILSAFE)
        assert served.copter.mode.name == mode
    finally:
        link.close()
        served.socket.close()


def test_a_jump_of_the_estimate_lands_it(among_hulls):
    loop, served = fly(among_hulls, Fault(kind="jump", amount=1.5))
    assert loop.supervision.cause is Event.STATE_JUMPED
    assert not served.is_armed
    assert all(math.isfinite(v) for s in loop.recorder.samples if s.filter for v in s.filter.sent_values)
