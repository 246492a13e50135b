"""Worlds, targets and states for the commander of velocities."""

import dataclasses

import msgspec
import numpy as np

from alula.stages.flight.links.protocol import VehicleState
from alula.stages.flight.mission import make_commander
from alula.stages.vehicles.setpoints import VelocitySetpoint
from support.flights.flights import behind, mission, safety_of
from support.scenes.small_scenes import box_cover, line_plan

LEVEL, ZERO = np.array([1.0, 0, 0, 0]), np.zeros(3)


# Walls and pillars around 4 m by 3 m, in voxels of 0.1 m.
BOXES = [
    ((-5, -5, 0), (-1, 40, 40)),
    ((45, -5, 0), (50, 40, 40)),
    ((-5, -10, 0), (50, -5, 40)),
    ((-5, 36, 0), (50, 40, 40)),
    ((10, 5, 0), (13, 20, 40)),
    ((25, 12, 0), (28, 36, 40)),
    ((35, 3, 0), (38, 6, 40)),
]


_MADE = {}


def world(speed, lag):
    """Filter and configuration, made once."""
    if (speed, lag) not in _MADE:
        made = mission(
            cover=box_cover(BOXES),
            plan=line_plan((0.3, 2.0, 1.0), (4.2, 1.5, 1.0)),
            is_clear=True,
            speed_m_s=speed,
            velocity_lag_s=lag,
            gain=8.0,
            fence=(-1.0, -1.0, 0.0, 6.0, 6.0, 4.0),
        )
        _MADE[speed, lag] = made, safety_of(made)
    return _MADE[speed, lag]


def commander_around(filtering, gain, speed, *, lag_s=0.0, delay_s=0.0, dt_s=0.01):
    """The commander of velocities around any filter."""
    made, _ = world(3.0, 0.6)
    fields = {"gain": gain, "speed_m_s": speed, "velocity_lag_s": lag_s, "rate_hz": 1 / dt_s}
    vehicle, scenario = made.world.vehicle, made.world.scenario
    assumed = msgspec.structs.replace(scenario.vehicle.assumed, delay_s=delay_s)
    table = msgspec.structs.replace(scenario.vehicle, assumed=assumed)
    own = msgspec.structs.replace(vehicle.assumed, delay_s=delay_s)
    world_ = dataclasses.replace(
        made.world,
        scenario=msgspec.structs.replace(scenario, vehicle=table),
        vehicle=msgspec.structs.replace(vehicle, assumed=own),
        max_speed_m_s=speed,
        lag_s=lag_s if isinstance(lag_s, tuple) else (lag_s, lag_s, lag_s),
    )
    made = dataclasses.replace(made, config=dataclasses.replace(made.config, **fields), world=world_)
    return make_commander(behind(made, filtering), frozenset({VelocitySetpoint}))


def target_at(point):
    row = np.zeros((1, 18))
    row[0, :3] = point
    return row


def seen(x, v):
    return VehicleState(0.0, x.copy(), v.copy(), LEVEL, ZERO)
