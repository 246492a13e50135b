"""Contents of the log of a flight in a geofence: state, regulation function and commands over time."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.errors import DamagedError
from alula.schemas.log.channels import SAFETY_TOPIC, STATE_TOPIC, Safety, State, decoded
from alula.schemas.log.foxglove import UPRIGHT
from alula.schemas.log.mcap import messages, open_log


@dataclass(frozen=True, slots=True)
class Ticks:
    """One flight at the log's rate, n samples.

    Attributes:
        time_s: times, shape (n,) [s].
        position: shape (n, 3), world [m].
        velocity: shape (n, 3), world [m/s].
        tilt_rad: angle between the body's z axis and up, shape (n,) [rad].
        regulation: regulation function lambda: 1 passes the pilot's command, 0 the backup's; shape (n,), NaN
            where there is none.
        h_i_m: h_I, shape (n,) [m]; NaN where it was not evaluated.
        distance_m: minimum distance to the fence since the sample before, less the radius, shape (n,) [m].
        throttle: the pilot's (NaN without one) and the flown one, shape (n, 2).
        status: n words.
    """

    time_s: FloatArray
    position: FloatArray
    velocity: FloatArray
    tilt_rad: FloatArray
    regulation: FloatArray
    h_i_m: FloatArray
    distance_m: FloatArray
    throttle: FloatArray
    status: tuple[str, ...]


def read_ticks(log: Path) -> dict[int, Ticks]:
    """Read the flights in a geofence run's log, by trial.

    Raises:
        InputError: the log cannot be read.
        DamagedError: truncated or corrupt, or states and messages of the filter have different times.
    """
    states: dict[int, list[State]] = {}
    answers: dict[int, list[Safety]] = {}
    with open_log(log) as file:
        for topic, data in messages(file, (STATE_TOPIC, SAFETY_TOPIC)):
            message = decoded(topic, data)
            if isinstance(message, State):
                states.setdefault(message.trial, []).append(message)
            elif isinstance(message, Safety):
                if message.fence_distance_m is None:
                    raise DamagedError(f"{log}: a message of the filter has no distance to a fence")
                answers.setdefault(message.trial, []).append(message)
    if {k: len(v) for k, v in states.items()} != {k: len(v) for k, v in answers.items()}:
        raise DamagedError(f"{log}: its states and the messages of the filter have different times")
    return {trial: _ticks(states[trial], answers[trial]) for trial in sorted(states)}


def _ticks(states: list[State], answers: list[Safety]) -> Ticks:
    states.sort(key=lambda state: state.time_s)
    answers.sort(key=lambda answer: answer.time_s or 0.0)
    states, answers = states[:-1], answers[:-1]  # the last is the end of the flight, which is no tick

    def known(values: list[float | None]) -> FloatArray:
        return np.array(values, np.float64)  # None becomes NaN

    turns = [UPRIGHT if state.attitude is None else state.attitude for state in states]
    upright = [1 - 2 * (turn.x**2 + turn.y**2) for turn in turns]
    return Ticks(
        time_s=np.array([s.time_s for s in states]),
        position=np.array([s.position_m.tuple for s in states]),
        velocity=np.array([s.velocity_m_s.tuple for s in states]),
        tilt_rad=np.array([math.acos(max(-1.0, min(1.0, c))) for c in upright]),
        regulation=known([a.regulation for a in answers]),
        h_i_m=known([a.h_m for a in answers]),
        distance_m=known([a.fence_distance_m for a in answers]),
        throttle=np.stack(
            [known([a.throttle_nom for a in answers]), known([a.throttle_safe for a in answers])], axis=1
        ),
        status=tuple(a.status_name for a in answers),
    )
