"""polytope-cbf in front of vehicles that follow velocities late: they stop before a wall in their way."""

import numpy as np
import pytest

from alula.schemas.scenarios.defaults import completed
from alula.schemas.scenarios.scenario import decoded
from alula.schemas.scenarios.vehicles import VEHICLES
from alula.stages.simulation.judge import hits_static
from alula.stages.simulation.simulate import simulate_world
from support.scenes.small_scenes import box_cover

WALL = box_cover([((20, 0, 0), (23, 40, 30))])  # in front of the goal, x from 2.0 to 2.3 m


def flown(vehicle):
    scenario = decoded(
        {
            "schema": "alula/scenario",
            "version": "2.0",
            "vehicle": vehicle,
            "world": {"cover": "wall.cover.npz"},
            "mission": {
                "kind": "goal",
                "start_m": [0.3, 2.0, 1.0],
                "goal_m": [3.5, 2.0, 1.0],
                "speed_m_s": 1.5,
                "beyond_map_m": 10.0,
            },
            "safety": {"filters": ["polytope-cbf"]},
            "rules": {"max_time_s": 5.0},
        },
        "test",
    )
    return simulate_world(scenario, VEHICLES[vehicle["type"]], cover=WALL, jobs=1).trials[0]


@pytest.mark.parametrize("vehicle", ["crazyflie21", "fastbridge", "double-integrator"])
@pytest.mark.parametrize("interface", [None, "velocity"])
def test_a_vehicle_that_lags_is_stopped_before_the_wall(vehicle, interface):
    named = {"type": vehicle, "interface": interface}
    assert hits_static(flown(named | {"velocity_lag_s": 0.0}))
    assert not hits_static(flown(named))


def test_the_lag_is_that_of_both_loops_unless_it_is_given():
    def lag_of(**vehicle):
        scenario = decoded({"schema": "alula/scenario", "version": "2.0", "vehicle": vehicle}, "test")
        return completed(scenario, VEHICLES[vehicle["type"]]).vehicle.velocity_lag_s

    assert lag_of(type="single-integrator") is None
    gain = VEHICLES["crazyflie21"].tracking.kv_per_s
    assert lag_of(type="crazyflie21") == pytest.approx(1 / gain + 0.15)
    assert lag_of(type="crazyflie21", velocity_gain_per_s=4.0) == pytest.approx(0.4)
    assert lag_of(type="crazyflie21", velocity_lag_s=0.0) == 0
    assert np.isfinite(lag_of(type="double-integrator"))
