"""What a run's log holds of each flight: states and safety margins over time."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from alula.schemas.errors import ArtifactError, DamagedError, InputError

STATE_TOPIC = "/state"
SAFETY_TOPIC = "/safety"


@dataclass(frozen=True, slots=True)
class Flight:
    """One trial of a run, as logged.

    Attributes:
        time_s: times of the states, shape (n,) [s].
        position_world: shape (n, 3) [m].
        speed_m_s: shape (n,) [m/s].
        margin_time_s: times of the filter's answers, shape (m,) [s].
        margin_m: margin that the filter reported, NaN where it had none, shape (m,) [m].
        status: status that the filter reported, m words.
    """

    time_s: NDArray[np.float64]
    position_world: NDArray[np.float64]
    speed_m_s: NDArray[np.float64]
    margin_time_s: NDArray[np.float64]
    margin_m: NDArray[np.float64]
    status: tuple[str, ...]


class _State(msgspec.Struct, gc=False):
    trial: int
    time_s: float
    position_m: tuple[float, float, float]
    velocity_m_s: tuple[float, float, float]


class _Safety(msgspec.Struct, gc=False):
    trial: int
    time_s: float
    margin_m: float | None = None
    status: str = ""


def read_flights(log: Path) -> dict[int, Flight]:
    """The flights in a run's log, by trial; empty when it holds no states.

    Raises:
        InputError: the log cannot be read.
        DamagedError: truncated or corrupt, or a message does not have the documented fields.
    """
    from mcap.exceptions import McapError
    from mcap.reader import make_reader

    states: dict[int, list[_State]] = {}
    safety: dict[int, list[_Safety]] = {}
    decode_state = msgspec.json.Decoder(_State).decode
    decode_safety = msgspec.json.Decoder(_Safety).decode
    try:
        with log.open("rb") as file:
            for _, channel, message in make_reader(file).iter_messages(
                topics=[STATE_TOPIC, SAFETY_TOPIC], log_time_order=False
            ):
                if channel.message_encoding != "json":
                    raise ArtifactError(f"{log}: channel {channel.topic} is not JSON")
                if channel.topic == STATE_TOPIC:
                    state = decode_state(message.data)
                    states.setdefault(state.trial, []).append(state)
                else:
                    answer = decode_safety(message.data)
                    safety.setdefault(answer.trial, []).append(answer)
    except OSError as error:
        raise InputError(f"{log}: cannot read: {error.strerror or error}") from error
    except msgspec.MsgspecError as error:
        raise DamagedError(f"{log}: a message is not as documented ({error})") from error
    except (McapError, ValueError, EOFError) as error:
        raise DamagedError(f"{log}: truncated or corrupt MCAP log ({error})") from error
    return {trial: _flight(states[trial], safety.get(trial, [])) for trial in sorted(states)}


def _flight(states: list[_State], safety: list[_Safety]) -> Flight:
    states.sort(key=lambda state: state.time_s)
    safety.sort(key=lambda answer: answer.time_s)
    velocity = np.array([state.velocity_m_s for state in states]).reshape(-1, 3)
    return Flight(
        time_s=np.array([state.time_s for state in states]),
        position_world=np.array([state.position_m for state in states]).reshape(-1, 3),
        speed_m_s=np.sqrt((velocity * velocity).sum(axis=1)),
        margin_time_s=np.array([answer.time_s for answer in safety], np.float64),
        margin_m=np.array([math.nan if a.margin_m is None else a.margin_m for a in safety], np.float64),
        status=tuple(answer.status for answer in safety),
    )
