"""Whole flights against a simulated autopilot whose true path is recorded."""

from contextlib import contextmanager

import numpy as np

from alula.stages.clearance import path_clearance
from alula.stages.flight.links.open_link import open_link
from alula.stages.flight.links.options import LinkOptions
from alula.stages.flight.loop.supervisor import State
from alula.stages.sim_vehicle.px4.vehicle import Px4Copter
from alula.stages.vehicles.frames import LocalFrame
from support.flights.flights import START, loop_of
from support.vehicles.fake_vehicle import Kept
from support.vehicles.mavlink_peer import Time
from support.vehicles.served_autopilot import FAST, Served

# The vehicle boots at the origin of its local frame: that is below the plan's start.
FRAME = LocalFrame(origin_enu_m=(-START[0], -START[1], 0.0))


RADIUS_M = 0.15


AS_PLANNED = ["checks", "arming", "take-off", "fly", "land", "done"]


INDOORS = {"FS_THR_ENABLE": 3.0, "FS_DR_ENABLE": 1.0}  # near walls it must not fly home in an emergency
INDOORS_PX4 = {"NAV_RCL_ACT": 3.0, "COM_LOW_BAT_ACT": 2.0}


class Watched(Served):
    """Keeps where it truly was, and injects a fault a while after set-points began."""

    fast = FAST | INDOORS

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
    kind, fast = Px4Copter, {"MPC_TKO_SPEED": 5.0, "MPC_TKO_RAMP_T": 0.25} | INDOORS_PX4


@contextmanager
def flight(made, served, recorder=None, **keywords):
    time = Time(served)
    options = LinkOptions(frame=FRAME, clock=time, sleep=time.sleep, flies_rates=made.is_splat)
    link = open_link(f"udpout:127.0.0.1:{served.port}", options)
    link.clock = time  # of the loop, too
    recorder = recorder or Kept()
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


def fly(made, *faults, kind=Watched, recorder=None, **keywords):
    served = kind(*faults, **keywords)
    with flight(made, served, recorder) as loop:
        return loop, served


def true_path(loop, served, *states):
    """Where it truly was while the supervisor was in these states, shape (T, 3)."""
    begin = loop._begin_s
    spans = [
        (s.supervisor.time_s + begin) for s in loop.recorder.samples if s.supervisor.state_name in states
    ]
    rows = np.array(served.path)
    return rows[(rows[:, 0] >= spans[0]) & (rows[:, 0] <= spans[-1]), 1:]


def clearance(made, path):
    return (
        min(float(path_clearance(np.ascontiguousarray(path), o).min()) for _, o in made.obstacles) - RADIUS_M
    )
