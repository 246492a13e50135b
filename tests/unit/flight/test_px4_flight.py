"""Whole flights of the PX4 link against the simulated PX4, through sockets, on one clock."""

import pytest

from alula.stages.flight.loop.supervisor import Event
from alula.stages.sim_vehicle.common.faults import Fault
from alula.stages.sim_vehicle.px4.modes import Px4Mode
from support.flights.flights import GOAL, START, mission
from support.flights.watched_flights import AS_PLANNED, WatchedPx4, clearance, fly, true_path
from support.scenes.small_scenes import line_plan


def fly_px4(made, *faults, **keywords):
    return fly(made, *faults, kind=WatchedPx4, **keywords)


@pytest.fixture(scope="module")
def among_hulls():
    return mission(plan=line_plan(START, GOAL, 4.5))


@pytest.mark.slow
def test_a_stream_that_stops_ends_in_its_own_landing_and_nothing_takes_it_back(among_hulls):
    """Set-points are lost for some time: the vehicle lands by COM_OBL_RC_ACT."""
    loop, served = fly_px4(among_hulls, Fault(kind="drop", way="in", duration=0.6))
    assert loop.recorder.states[:5] == [*AS_PLANNED[:4], "hand-over"]
    assert loop.supervision.cause in (Event.MODE_CHANGED, Event.FAILSAFE)
    assert served.copter.flown is Px4Mode.LAND
    assert not served.is_armed
    assert clearance(among_hulls, true_path(loop, served, "fly", "hand-over")) > 0


def test_the_pilots_sticks_win_in_offboard(among_hulls):
    class Handled(WatchedPx4):
        def tick(self, now):
            super().tick(now)
            if self.flown is not None and now - self.flown > 1.5:
                self.copter.pilot.move(2, 1900 if now - self.flown < 1.8 else 1500)
            if self.flown is not None and now - self.flown > 3.0 and not self.copter.is_landed:
                self.copter.set_mode(Px4Mode.LAND)  # a choice of the pilot again

    loop, served = fly(among_hulls, kind=Handled)
    assert loop.recorder.states[:5] == [*AS_PLANNED[:4], "hand-over"]
    assert loop.supervision.cause is Event.MODE_CHANGED
    assert not served.is_armed
    assert served.copter.parameters["COM_RC_OVERRIDE"] == 1  # put back


@pytest.mark.slow
def test_lost_satellites_land_it_before_its_own_flags_change(among_hulls):
    loop, served = fly_px4(among_hulls, Fault(kind="satellites"))
    assert loop.supervision.cause is Event.ESTIMATOR_BAD
    assert "no new satellite fix for" in loop.ending
    flown = [at for at, taken in loop.taken if taken.event in (Event.AIRBORNE, Event.ESTIMATOR_BAD)]
    assert flown[1] - flown[0] < 2.5
    assert not served.is_armed
    assert clearance(among_hulls, true_path(loop, served, "fly", "land")) > 0
