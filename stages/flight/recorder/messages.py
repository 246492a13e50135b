"""Messages of a flight's log, built from samples: the channels of `simulate`, and `/supervisor`."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import numpy as np

from alula.stages.filtering.protocol import FilterStatus
from alula.stages.flight.loop.supervisor import State
from alula.stages.flight.recorder.samples import FilterSample, ReplaySample, TickSample
from alula.stages.runlog import messages
from alula.stages.runlog.messages import DECIMALS, xyz

_NUMBERS = {state.value: number for number, state in enumerate(State)}


def state_message(sample: TickSample) -> dict[str, Any]:
    """Message `alula.State` of a tick.

    Args:
        sample: of a tick.
    """
    return {
        "trial": 0,
        "time_s": round(sample.time_s, 9),
        "position_m": _point(sample.position),
        "velocity_m_s": _point(sample.velocity),
        "attitude": _attitude(sample),
        "omega_body_rad_s": _point(sample.omega),
    }


def pose_message(sample: TickSample, frame: str, time_ns: int) -> dict[str, Any]:
    """Message `foxglove.PoseInFrame` of a tick.

    Args:
        sample: of a tick.
        frame: name of the map's frame.
        time_ns: log time [ns].
    """
    return messages.pose_message(_point(sample.position), _attitude(sample), frame, time_ns)


def transform_message(sample: TickSample, frame: str, time_ns: int) -> dict[str, Any]:
    """Message `foxglove.FrameTransform` of a tick.

    Args:
        sample: of a tick.
        frame: name of the map's frame.
        time_ns: log time [ns].
    """
    return messages.transform_message(_point(sample.position), _attitude(sample), frame, time_ns)


def safety_message(sample: TickSample, done: FilterSample, *, is_splat: bool) -> dict[str, Any]:
    """Message `alula.Safety` of a tick.

    Among hulls it holds velocities and a distance in metres; among ellipsoids accelerations and the value of
    the barrier.

    Args:
        sample: of a tick.
        done: result of controller and filter in the tick.
        is_splat: the filter uses ellipsoids.
    """
    status = FilterStatus(done.status)
    margin = _number(done.margin)
    common: dict[str, Any] = {
        "trial": 0,
        "time_s": round(sample.time_s, 9),
        "status": int(status),
        "status_name": status.name.lower(),
        "active": done.active,
        "infeasible": done.infeasible,
        "certified": done.certified,
        "sent": done.sent,
        "sent_values": [_number(value) for value in done.sent_values],
        "solve_time_s": _number(done.filter_s),
    }
    if done.disturbance is not None:
        common["disturbance_m_s2"] = _point(done.disturbance)
        common["disturbance_bound_m_s2"] = _number(done.disturbance_bound)
        common["added_margin_m"] = _number(done.added_margin_m)
    nominal, safe = _point(done.nominal), _point(done.safe)
    if not is_splat:
        return common | {"h_m": margin, "u_nom_m_s": nominal, "u_safe_m_s": safe}
    splat: dict[str, Any] = {
        "margin_unit": "of the filter's barrier",
        "a_nom_m_s2": nominal,
        "a_safe_m_s2": safe,
    }
    if done.thrust_nominal_n is not None:
        splat["thrust_nom_n"] = _number(done.thrust_nominal_n)
    return common | splat | ({} if margin is None else {"margin": margin})


def replay_message(time_s: float, tick: ReplaySample) -> dict[str, Any]:
    """Message `alula.Replay` of a tick; nothing is rounded.

    Args:
        time_s: time since the start of the flight [s].
        tick: its inputs and set-points.
    """
    return {"time_s": time_s, **msgspec.structs.asdict(tick)}


def tick_message(sample: TickSample) -> dict[str, Any]:
    """Message `alula.Supervisor` of a tick; unknown values are left out.

    Args:
        sample: of a tick.
    """
    known: dict[str, Any] = {
        "time_s": round(sample.time_s, 9),
        "state": _NUMBERS[sample.state],
        "state_name": sample.state,
        "mode": sample.mode,
        "armed": sample.armed,
        "landed": sample.landed,
        "battery_share": sample.battery_share,
        "state_age_s": sample.age_s,
        "late_s": sample.late_s,
        "tick_s": sample.tick_s,
        "fence_m": sample.fence_m,
    }
    if (done := sample.filter) is not None:
        known |= {
            "fence_h_m": done.fence_h_m,
            "fence_share": done.fence_share,
            "fence_flies": done.fence_flies,
            "plan_s": done.plan_s,
            "plan_rate": done.plan_rate,
            "error_m": done.error_m,
        }
    numbers = {key: _number(value) if isinstance(value, float) else value for key, value in known.items()}
    return {key: value for key, value in numbers.items() if value is not None}


def step_message(time_s: float, state: str, event: str, action: str) -> dict[str, Any]:
    """Message `alula.Supervisor` of a step of the supervisor.

    Args:
        time_s: time since the start of the flight [s].
        state: name of the state after the step.
        event: name of the event.
        action: name of the action.
    """
    return {
        "time_s": round(time_s, 9),
        "state": _NUMBERS[state],
        "state_name": state,
        "event_name": event,
        "action_name": action,
    }


def log_line(words: str, level: int, time_ns: int) -> dict[str, Any]:
    """Message `foxglove.Log`.

    Args:
        words: the message.
        level: as in foxglove.Log.
        time_ns: log time [ns].
    """
    return messages.line_message(words, level, "fly", time_ns)


def _attitude(sample: TickSample) -> dict[str, float]:
    w, x, y, z = sample.attitude_wxyz or (1.0, 0.0, 0.0, 0.0)
    return {
        "x": round(x, DECIMALS),
        "y": round(y, DECIMALS),
        "z": round(z, DECIMALS),
        "w": round(w, DECIMALS),
    }


def _point(values: tuple[float, ...] | None) -> dict[str, float]:
    return xyz(np.array((0.0, 0.0, 0.0) if values is None else values))


def _number(value: float | None) -> float | None:
    if value is None or not math.isfinite(value):
        return None
    return round(value, 9)
