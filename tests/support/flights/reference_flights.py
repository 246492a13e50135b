"""Flights of the native loop along reference curves, from the beginning of the curve to its end."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from alula import _core
from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.stages.filtering.bridge import native_filter
from alula.stages.vehicles.bodies import quadrotor, tracking_gains

BODY, GAINS = quadrotor(FASTBRIDGE), tracking_gains(FASTBRIDGE)


def vehicle_of(body: _core.Quadrotor = BODY, **fields: Any) -> _core.VehicleSpec:
    """A quadrotor by wrench, or with `model` a double integrator by acceleration.

    Args:
        body: rigid body.
        fields: of `VehicleSpec`.
    """
    is_point = fields.get("model") == "double-integrator"
    given = {"interface": "acceleration" if is_point else "wrench", "gains": GAINS}
    return _core.VehicleSpec(body, **(given | fields))


def start_of(curve: _core.ReferenceCurve, *, has_yaw: bool = True) -> np.ndarray:
    """State at the beginning of a curve, level, with its velocity and yaw."""
    row, state = curve.at(np.zeros(1))[0], np.zeros(12)
    state[:3], state[6:9] = row[:3], row[3:6]
    state[5] = np.tan(row[15] / 4) if has_yaw else 0.0
    return state


def along(
    curves: Sequence[_core.ReferenceCurve],
    filters: Sequence[Any] = (),
    vehicle: _core.VehicleSpec | None = None,
    *,
    has_yaw: bool = True,
    max_time_s: float | None = None,
    dt_s: float = 0.01,
    plant_steps: int | None = None,
    controller_ticks: int = 1,
    filter_ticks: int = 1,
    disturbance_time_s: float = 0.0,
    seed: int = 0,
    first_trial: int = 0,
    jobs: int = 1,
    **rules: Any,
) -> list[dict[str, Any]]:
    """Fly each curve; native logs.

    Args:
        curves: references.
        filters: native ones, or of the protocol of other packages.
        vehicle: default: FastBridge's quadrotor by wrench.
        has_yaw: whether flights begin with the curve's yaw.
        max_time_s: default: three times the duration of the curve.
        dt_s, plant_steps, controller_ticks, filter_ticks: timing; default: as of a scenario.
        disturbance_time_s: of the estimate of disturbances, 0 for none.
        seed, first_trial, jobs: as of `simulate`.
        rules: of `SimulationRules`.
    """
    tasks = []
    for curve in curves:
        start, end = curve.at(np.array([0.0, curve.duration_s]))[:, :3]
        tasks.append(
            _core.Task(
                start_of(curve, has_yaw=has_yaw),
                _core.Mission.along(curve),
                max_time_s=max_time_s or 3 * curve.duration_s,
                stop_distance_m=max(0.01 * float(np.linalg.norm(end - start)), 0.05),
            )
        )
    spec = _core.SimulationSpec(
        vehicle or vehicle_of(),
        options=_core.FlightOptions(
            dt_s=dt_s,
            controller_ticks=controller_ticks,
            filter_ticks=filter_ticks,
            disturbance_time_s=disturbance_time_s,
        ),
        rules=_core.SimulationRules(
            plant_steps=plant_steps or max(1, math.ceil(dt_s / 1e-3 - 1e-9)), **rules
        ),
    )
    native = [one if isinstance(one, _core.SafetyFilter) else native_filter(one) for one in filters]
    return _core.simulate(spec, tasks, native, seed=seed, first_trial=first_trial, jobs=jobs)
