"""Native flights of a racing drone by a simulated pilot in a geofence, apart from any scenario file."""

from typing import Any

import numpy as np

from alula import _core
from alula.schemas.parameters.filter_options import GeofenceParameters
from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.stages.vehicles.bodies import quadrotor

STATUSES = ("passed", "blended", "backup", "no-pilot", "hand-over", "refused")


def fly_in(
    geofence: _core.Geofence,
    *,
    start: np.ndarray | None = None,
    starts: tuple[Any, Any] | None = None,
    speed_m_s: float = 10.0,
    tilt_rad: float = 1.0,
    pilot: _core.Pilot | None = None,
    rule: str = "geofence",
    model: _core.RacerModel | None = None,
    options: _core.RacerOptions | None = None,
    losses: _core.Losses | None = None,
    duration_s: float = 8.0,
    plant_steps: int = 4,
    seed: int = 0,
    first: int = 0,
    count: int = 1,
    keeps_ticks: bool = False,
    jobs: int = 0,
) -> list[dict[str, Any]]:
    """Fly consecutive trials from one start (13), or from random safe starts in a box.

    Returns:
        Per trial the native log, with the figures of its fence beside the others, `start` (13), and with
        keeps_ticks per tick `racer` (position, velocity, attitude w x y z, body rates: 13).
    """
    if start is None and starts is None:
        raise ValueError("a flight needs a start or a box of starts")
    tick_s = geofence.parameters["tick_s"]
    # A racer moves by its own model: the body and its controller are not used.
    vehicle = _core.VehicleSpec(
        quadrotor(FASTBRIDGE),
        model="racer",
        interface="sticks",
        racer=model or _core.RacerModel(),
        racer_options=options or _core.RacerOptions(),
    )
    spec = _core.SimulationSpec(
        vehicle,
        options=_core.FlightOptions(dt_s=tick_s),
        rules=_core.SimulationRules(
            plant_steps=plant_steps, ends_when_refused=False, keeps_path=False, keeps_ticks=keeps_ticks
        ),
        losses=losses or _core.Losses(),
        fence=geofence,
    )
    states = [
        _core.safe_racer_start(
            geofence, starts, speed_m_s=speed_m_s, tilt_rad=tilt_rad, seed=seed, trial=trial
        )
        if start is None
        else start
        for trial in range(first, first + count)
    ]
    by_sticks, hand = _core.Mission.by_sticks(), pilot or _core.Pilot("straight")
    logs = _core.simulate(
        spec,
        [_core.Task(state, by_sticks, pilot=hand, max_time_s=duration_s) for state in states],
        [
            _core.FenceFilter(
                geofence, GeofenceParameters().alpha if rule == "backup-qp" else None, is_bare=rule == "none"
            )
        ],
        seed=seed,
        first_trial=first,
        jobs=jobs,
    )
    return [_with_fence(log, state) for log, state in zip(logs, states, strict=True)]


def _with_fence(log: dict[str, Any], start: np.ndarray) -> dict[str, Any]:
    fence = log.pop("fence")
    found = {key: value for key, value in log.items() if key != "status"} | fence | {"start": start}
    if len(log["state"]):
        state = log["state"][:-1]
        found["racer"] = np.hstack([state[:, :3], state[:, 6:9], log["attitude"][:-1], state[:, 9:]])
    return found
