"""Where the filters of a scenario act along a plan, before it is flown."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.scenarios.scenario import Scenario
from alula.stages.filtering.protocol import FilterStatus
from alula.stages.planning.behind import Behind

_EXTRA_S = 5.0  # after the end of a plan, for a vehicle that filters hold up
_STOP_M = 0.01
_NO_NOISE: dict[str, Any] = {
    "position_noise_m": 0.0,
    "velocity_noise_m_s": 0.0,
    "attitude_noise_rad": 0.0,
    "rate_noise_rad_s": 0.0,
}


def undisturbed(scenario: Scenario) -> Scenario:
    """The same without noise and gusts; lag, drag, wind and delay remain."""
    table = scenario.vehicle
    still = msgspec.structs.replace(table.disturbance, gust_m_s=(0.0, 0.0, 0.0))
    return msgspec.structs.replace(
        scenario,
        vehicle=msgspec.structs.replace(table, disturbance=still),
        estimation=msgspec.structs.replace(scenario.estimation, **_NO_NOISE),
    )


def flown_behind(
    scenario: Scenario,
    filters: list[_core.SafetyFilter],
    guides: int,
    spec: _core.VehicleSpec,
    options: _core.FlightOptions,
    *,
    plant_steps: int,
    max_speed_m_s: float,
) -> Behind:
    """How a plan is flown for its planner: behind the filters, past nothing that moves, without noise.

    Args:
        filters: native, in their order; the first ones are guides.
        guides: number of guides, which may change commands.
        spec: the vehicle of the scenario without noise and gusts.
        plant_steps: of the plant in a tick.
        max_speed_m_s: limit of velocity commands [m/s].
    """
    dt_s, gain = scenario.rules.dt_s, scenario.mission.controller.gain_per_s
    rules = _core.SimulationRules(plant_steps=plant_steps, keeps_path=False)
    native = _core.SimulationSpec(spec, options=options, rules=rules)

    def acting_s(time: FloatArray, coefficient: FloatArray) -> FloatArray:
        curve = _core.ReferenceCurve(time, coefficient)
        start = np.zeros(12)
        start[:3], start[5] = coefficient[0, :3, 0], np.tan(coefficient[0, 3, 0] / 4)
        task = _core.Task(
            start,
            _core.Mission.along(curve, gain_per_s=gain, speed_m_s=max_speed_m_s),
            max_time_s=curve.duration_s + _EXTRA_S,
            stop_distance_m=_STOP_M,
        )
        (flown,) = _core.simulate(native, [task], filters, jobs=1)
        status = flown["status"][:, guides:]
        ticks = np.flatnonzero((status != FilterStatus.OK).any(axis=1))
        return np.asarray(np.minimum(dt_s * ticks, time[-1]), np.float64)

    return Behind(" + ".join(scenario.safety.filters), acting_s)
