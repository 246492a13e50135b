"""By rates, the height of the plan is flown also where the vehicle's hover throttle is not the true one."""

import numpy as np
import pytest

from alula.schemas.scenarios.vehicle import FASTBRIDGE, read_vehicle
from alula.stages.flight.loop.supervisor import Event, State
from alula.stages.sim_vehicle.ardupilot.copter import ArduCopter
from support.flights.flights import mission
from support.paths import VEHICLES
from support.scenes.small_scenes import ball_scene, line_plan
from support.vehicles.lockstep import Flight

FAR = ball_scene([(2.0, 9.0, 1.0)], 0.3)
PLAN = line_plan((0.3, 2.0, 1.0), (3.7, 2.0, 1.0), 7.0)


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.85, 1.07, 1.2])
def test_the_height_is_kept(factor):
    """ArduPilot's own simulation reports 0.39 and hovers at 0.365: 7 %, which was 0.19 m of height."""
    right = ArduCopter(FASTBRIDGE).hover_throttle
    made = mission("cone-backup", scene=FAR, plan=PLAN, vehicle=read_vehicle(VEHICLES / "arducopter.toml"))
    flown = Flight(made, parameters={"MOT_THST_HOVER": factor * right}).fly()
    assert flown.cause is Event.PLAN_FINISHED
    assert flown.link.hover.value == pytest.approx(right, rel=0.02)
    rows = flown.path(State.FLY)
    later = rows[rows[:, 0] > rows[0, 0] + 3.0]  # it takes over in the climb, and overshoots
    assert np.abs(later[:, 3] - 1.0).max() < 0.1
    assert np.abs(later[-200:, 3] - 1.0).max() < 0.05
