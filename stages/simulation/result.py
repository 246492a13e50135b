"""Results of simulated flights: outcomes, samples for the log, and everything that a run's files hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import msgspec
import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray, IntArray
from alula.schemas.artifact import Artifact
from alula.schemas.manifest import Guarantee
from alula.schemas.run import PLAN_OUTCOMES, Outcome, TrialResult

LOOP_OUTCOMES: tuple[Outcome, ...] = ("reached", "stuck", "timeout", "refused")  # native numbers, from 1


def outcomes_of(trials: Sequence[TrialResult]) -> tuple[Outcome, ...]:
    """Outcomes that a summary of start-goal flights counts; those of plans only where plans were flown.

    Args:
        trials: verdicts.
    """
    return LOOP_OUTCOMES + (PLAN_OUTCOMES if any(trial.plan is not None for trial in trials) else ())


def logged_ticks(last: int, dt_s: float, rate_hz: float) -> IntArray:
    """Ticks that a log shows: one in so many from 0 on, as the rate requires, and the last one once.

    Args:
        last: number of the last tick.
        dt_s: duration of a tick [s].
        rate_hz: samples per second in the log.

    Returns:
        Shape (T,), increasing.
    """
    stride = max(1, round(1 / (rate_hz * dt_s)))
    return np.append(np.arange(0, last, stride, dtype=np.int64), np.int64(last))


@dataclass(frozen=True, slots=True)
class SplatFlightLog:
    """Samples of a flight among ellipsoids at the log's rate and at its end.

    `flown` has rows of `SplatFlown` by name, shape (T, ...). `state`, shape (T, 12), and `position`, shape
    (T, 3), are those at the time. Rows of controller and filter are of the tick that begins then; in the last
    sample, of the tick before.
    """

    time_s: FloatArray
    position: FloatArray
    state: FloatArray
    flown: dict[str, NDArray[Any]]


class _StoredFlight(msgspec.Struct, frozen=True, kw_only=True):
    """Samples of a trial at the log's rate: T rows of numbers, as bytes so that a journal can hold them.

    `tick` has the number of the tick of each sample, int64; `status` the filter's, a byte for each.
    """

    _SHAPES: ClassVar[dict[str, tuple[int, ...]]]  # of a row, by name

    trial: int
    tick: bytes
    status: bytes

    def rows(self, name: str) -> FloatArray:
        """Numbers of a field, shape (T, ...) as the class documents it.

        Args:
            name: of the field.
        """
        flat: FloatArray = np.frombuffer(getattr(self, name), np.float64)
        return flat.reshape(len(self.status), *self._SHAPES[name])

    def time_s(self, tick_s: float) -> FloatArray:
        """Times of the samples, shape (T,) [s].

        Args:
            tick_s: duration of a tick [s].
        """
        return np.frombuffer(self.tick, np.int64).astype(np.float64) * tick_s


class FenceFlight(_StoredFlight, frozen=True, kw_only=True):
    """Samples of a flight in a geofence.

    `state` has position, velocity, attitude wxyz and rates, shape (T, 13); `pilot` and `command` throttle and
    rates, shape (T, 4), NaN without a pilot; `figure` lambda, h_I, the filter's distance, its margin and
    speed towards the fence, shape (T, 5); `distance` the minimum true one since the sample before,
    shape (T,).
    """

    _SHAPES = {"state": (13,), "pilot": (4,), "command": (4,), "figure": (5,), "distance": ()}

    state: bytes
    pilot: bytes
    command: bytes
    figure: bytes
    distance: bytes

    @classmethod
    def of(cls, trial: int, flown: dict[str, Any], tick_s: float, rate_hz: float) -> Self:
        """Sample a native log; see `logged_ticks`.

        Args:
            trial: its number.
            flown: arrays by name, a row per tick.
            tick_s: duration of a tick [s].
            rate_hz: samples per second.
        """
        sample = logged_ticks(len(flown["status"]) - 1, tick_s, rate_hz)
        nearest = flown["distance"][sample]
        nearest[1:] = np.minimum(nearest[1:], np.minimum.reduceat(flown["distance"], sample)[:-1])
        rows = {
            name: flown[name][sample].tobytes() for name in (*cls._SHAPES, "status") if name != "distance"
        }
        return cls(trial=trial, tick=sample.tobytes(), distance=nearest.tobytes(), **rows)


class WorldFlight(_StoredFlight, frozen=True, kw_only=True):
    """Samples of a flight behind f filters, with n moving obstacles around it.

    The samples end with the end of the flight: there `state` is of the end, all else of the tick before.
    `state` has position, attitude (MRP), velocity and rates, shape (T, 12), `estimate` what the filters got;
    `nominal` the mission's velocity or acceleration, shape (T, 3); `command` velocity, acceleration or rates
    (3), wrench (4) and sticks (4); `obstacles` and `tracks` positions, shape (T, n, 3), NaN without a track;
    `margin` of each filter, shape (T, f), or of the hulls without one; `each_status` and `each_flags` a byte
    for each filter, the bits of `SimulatedFlight` in native/core.
    """

    _SHAPES = {
        **{"state": (12,), "estimate": (12,), "nominal": (3,), "command": (11,)},
        **{"obstacles": (-1, 3), "tracks": (-1, 3), "margin": (-1,)},
    }

    state: bytes
    estimate: bytes
    nominal: bytes
    command: bytes
    obstacles: bytes
    tracks: bytes
    margin: bytes
    each_status: bytes
    each_flags: bytes

    @classmethod
    def of(cls, trial: int, flown: dict[str, Any], dt_s: float, rate_hz: float) -> Self:
        """Sample a native log; see `logged_ticks`.

        Args:
            trial: its number.
            flown: arrays by name, a row per tick.
            dt_s: duration of a tick [s].
            rate_hz: samples per second.
        """
        ticks = len(flown["mark"])
        sample = logged_ticks(ticks, dt_s, rate_hz)
        held = np.minimum(sample, ticks - 1)
        status = flown["status"][held]
        last = status[:, -1] if status.shape[1] else np.zeros(len(sample), np.uint8)
        return cls(
            trial=trial,
            tick=sample.tobytes(),
            status=np.ascontiguousarray(last).tobytes(),
            state=flown["state"][sample].tobytes(),
            estimate=flown["estimate"][held].tobytes(),
            nominal=flown["nominal"][held].tobytes(),
            command=flown["command"][held].tobytes(),
            obstacles=flown["obstacle"][held].tobytes(),
            tracks=flown["track"][held].tobytes(),
            margin=flown["margin"][held].tobytes(),
            each_status=status.tobytes(),
            each_flags=flown["flags"][held].tobytes(),
        )

    def mode(self) -> NDArray[np.uint8]:
        """Modes of the last filter, one among moving obstacles: 0 nominal, 1 avoid, 2 hover; shape (T,)."""
        last: NDArray[np.uint8] = self.of_filters("each_flags")[:, -1] >> np.uint8(4)
        return last

    def of_filters(self, name: str) -> NDArray[np.uint8]:
        """Bytes of a field for each filter, shape (T, f).

        Args:
            name: `each_status` or `each_flags`.
        """
        flat = np.frombuffer(getattr(self, name), np.uint8)
        return flat.reshape(len(self.status), -1) if len(flat) else flat.reshape(len(self.status), 0)

    def rows(self, name: str) -> FloatArray:
        """Numbers of a field; see the class.

        Args:
            name: of the field.
        """
        flat: FloatArray = np.frombuffer(getattr(self, name), np.float64)
        shape = self._SHAPES[name]
        if not len(flat) and -1 in shape:  # no obstacle, no filter
            return flat.reshape(len(self.status), *(0 if size == -1 else size for size in shape))
        return flat.reshape(len(self.status), *shape)


@dataclass(frozen=True, slots=True)
class RunResult:
    """Contents of a run's record and log; `filter_s` and `tick_s` are measured times, the rest is not.

    Attributes:
        filter: name of the filter.
        vehicle: the vehicle in words.
        trials: verdicts, in their order.
        summary: numbers over all trials.
        guarantee: statement and claims.
        flights: samples for the log, in the order of `trials`.
        map: the cover or the scene that was flown through.
        filter_s: time of the filter per call, shape (C,) [s].
        tick_s: time of controller and filter per tick, shape (S,) [s]; None where it was not measured.
    """

    filter: str
    vehicle: str
    trials: list[TrialResult]
    summary: dict[str, Any]
    guarantee: Guarantee
    flights: Sequence[SplatFlightLog]
    map: Artifact
    filter_s: NDArray[np.float32]
    tick_s: NDArray[np.float32] | None = None
