"""Replay of a recorded flight: its logged inputs through the native flight again, compared bit by bit."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from alula.schemas.decode import json_decoder
from alula.schemas.errors import InputError
from alula.schemas.log.channels import REPLAY_TOPIC, Replay
from alula.schemas.log.mcap import messages
from alula.stages.flight.commanders.native import FlightCommander
from alula.stages.flight.commanders.protocol import TickInputs
from alula.stages.flight.recorder.samples import numbers_of
from alula.stages.vehicles.setpoints import AccelerationSetpoint, RatesSetpoint, Setpoint, VelocitySetpoint


@dataclass(frozen=True, slots=True)
class Replayed:
    """Result of a replay.

    Attributes:
        differing: times of the ticks whose set-point differs, since the start of the flight [s].
    """

    ticks: int
    differing: list[float]


def replay(log: Path, commander: FlightCommander) -> Replayed:
    """Feed the logged inputs of a flight to a commander, and compare its set-points with the logged ones.

    Args:
        commander: of the same mission and kind of set-point; it is reset.

    Raises:
        InputError: the log cannot be read, has no ticks of set-points, or lacks some of them.
    """
    ticks, differing, next_number = 0, list[float](), 0
    sent: Setpoint | None = None
    for tick in _ticks(log):
        if tick.number == 0:
            commander.reset()
        elif tick.number != next_number:
            raise InputError(f"{log}: ticks before {tick.time_s:.2f} s are missing; it cannot be replayed")
        elif sent is not None:
            for _ in range(tick.repeats):
                commander.sent(sent)
        inputs = TickInputs(
            np.array(tick.measured),
            tick.age_s,
            tick.slip_m,
            np.array(tick.target),
            tick.number,
            tick.repeats,
        )
        decision = commander.step(inputs)
        ticks, next_number = ticks + 1, tick.number + 1
        kind, values = numbers_of(decision.setpoint)
        if kind != tick.decided or np.array(values).tobytes() != np.array(tick.decided_values).tobytes():
            differing.append(tick.time_s)
        sent = decision.setpoint if tick.is_own else _setpoint(tick.sent, tick.sent_values)
        if sent is not None:
            commander.sent(sent)
    if ticks == 0:
        raise InputError(f"{log}: it has no set-points of a real flight")
    return Replayed(ticks, differing)


def _ticks(log: Path) -> Iterator[Replay]:
    decode = json_decoder(Replay).decode
    try:
        with log.open("rb") as file:
            for _, data in messages(file, (REPLAY_TOPIC,)):
                yield decode(data)
    except OSError as error:
        raise InputError(f"{log}: cannot read: {error.strerror}") from error
    except (ValueError, EOFError) as error:
        raise InputError(f"{log}: {' '.join(str(error).split())[:200]}") from error


def _setpoint(kind: str, values: tuple[float, ...]) -> Setpoint | None:
    """A set-point from its numbers in the log."""
    if kind == "rates":
        return RatesSetpoint(values[0], np.array(values[1:]))
    if kind == "acceleration":
        unknown = np.zeros(3)
        return AccelerationSetpoint(np.array(values[:3]), unknown, unknown, values[3])
    return VelocitySetpoint(np.array(values[:3]), values[3]) if kind == "velocity" else None
