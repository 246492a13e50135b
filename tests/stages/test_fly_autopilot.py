"""Whole flights against the simulated autopilot through sockets, on one clock."""

from contextlib import contextmanager

import numpy as np
import pytest
from fake_vehicle import Kept
from flights import BALL, GOAL, START, loop_of, mission
from mavlink_peer import Time
from test_link_and_autopilot import Served
from test_simulate import box_cover, line_plan

from alula.stages.flight.autopilot.modes import Mode
from alula.stages.flight.autopilot.px4 import Px4Copter
from alula.stages.flight.autopilot.px4_modes import Px4Mode
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


class WatchedPx4(Watched):
    kind, fast = Px4Copter, {"MPC_TKO_SPEED": 5.0, "MPC_TKO_RAMP_T": 0.25}


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


@pytest.mark.parametrize("kind", [Watched, WatchedPx4])
def test_cone_backup_flies_around_an_ellipsoid_and_lands(kind):
    made = mission("cone-backup", scene=BALL, is_clear=True)
    loop, served = fly(made, kind=kind)
    assert loop.recorder.states == AS_PLANNED
    assert loop.supervision.cause is Event.PLAN_FINISHED
    path = true_path(loop, served, "fly")
    assert clearance(made, path) > 0
    assert np.linalg.norm(path[-1] - GOAL) < 0.3
    assert not served.is_armed
    assert {s.filter.sent for s in loop.recorder.samples if s.filter} == {"rates"}


@pytest.mark.parametrize(
    ("kind", "flown", "land"), [(Watched, "mode", Mode.LAND), (WatchedPx4, "flown", Px4Mode.LAND)]
)
def test_polytope_cbf_flies_past_a_pillar_and_lands(among_hulls, kind, flown, land):
    loop, served = fly(among_hulls, kind=kind)
    assert loop.recorder.states == AS_PLANNED
    assert clearance(among_hulls, true_path(loop, served, "fly")) > 0
    assert {s.filter.sent for s in loop.recorder.samples if s.filter} == {"velocity"}
    assert getattr(served.copter, flown) is land


def test_a_plan_that_ends_fast_before_a_wall_leaves_all_of_the_margin():
    """At 3 m/s; a filter that knows nothing of the autopilot's lag is flown into the wall."""
    wall = box_cover([((40, 0, 0), (44, 40, 30))])
    made = mission(cover=wall, plan=line_plan(START, GOAL, 2.5), speed_m_s=3.0)
    loop, served = fly(made)
    assert loop.recorder.states == AS_PLANNED
    assert clearance(made, true_path(loop, served, "fly")) >= made.config.margin_m
