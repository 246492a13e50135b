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
class FlightLog:
    """Samples of a flight among hulls at the log's rate and at its end; shapes (T,) and (T, 3).

    `velocity` is the input flown from that time on; in the last sample, the one flown before.
    """

    time_s: FloatArray
    position: FloatArray
    velocity: FloatArray
    u_nom: FloatArray
    margin: NDArray[np.float32]
    status: NDArray[np.uint8]


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

    `state` has position, attitude (MRP), velocity and rates, shape (T, 12); its last row is the end of the
    flight. All else is of the tick that begins then; in the last sample, of the tick before. `estimate` is
    what the filters got; `nominal` the mission's velocity or acceleration, shape (T, 3), and `u_nominal` its
    wrench, shape (T, 4); `a_command` the commanded acceleration, shape (T, 3), NaN where there is none, and
    `a_error` the largest difference of the body's from it since the sample before, shape (T,); `command`
    velocity, acceleration or rates (3), wrench (4) and sticks (4); `rotor_thrust` of each rotor, shape
    (T, 4); `obstacles` and `tracks` positions, shape (T, n, 3), NaN without a track. Of each filter: `margin`
    and `gate_m`, shape (T, f), and `counts`, shape (T, f, 4): active obstacle, candidates, rows, iterations;
    `each_status` and `each_flags` a byte for each filter, and `mark` one for all, the bits of
    `SimulatedFlight` in native/core.
    """

    _SHAPES = {
        **{"state": (12,), "estimate": (12,), "nominal": (3,), "command": (11,)},
        **{"u_nominal": (4,), "a_command": (3,), "a_error": (), "rotor_thrust": (4,)},
        **{"obstacles": (-1, 3), "tracks": (-1, 3), "margin": (-1,), "gate_m": (-1,), "counts": (-1, 4)},
    }

    state: bytes
    estimate: bytes
    nominal: bytes
    u_nominal: bytes
    a_command: bytes
    a_error: bytes
    command: bytes
    rotor_thrust: bytes
    obstacles: bytes
    tracks: bytes
    margin: bytes
    gate_m: bytes
    counts: bytes
    each_status: bytes
    each_flags: bytes
    mark: bytes

    @classmethod
    def of(cls, trial: int, flown: dict[str, Any], dt_s: float, rate_hz: float) -> Self:
        """Sample a native log; see `logged_ticks`.

        Args:
            trial: its number.
            flown: arrays by name, a row per tick.
            dt_s: duration of a tick [s].
            rate_hz: samples per second.
        """
        steps = len(flown["mark"])
        ends = logged_ticks(steps, dt_s, rate_hz)
        error = np.append(flown["a_error"][:1], np.fmax.reduceat(flown["a_error"], ends[:-1]))
        known = np.isfinite(flown["state"][ends]).all(axis=1)  # else the flight is refused at once
        ends, error = ends[known], error[known]
        sample = np.minimum(ends, steps - 1)
        counts = [flown[name][sample] for name in ("active", "candidates", "rows", "iterations")]
        status = flown["status"][sample]
        last = status[:, -1] if status.shape[1] else np.zeros(len(sample), np.uint8)
        return cls(
            trial=trial,
            tick=ends.tobytes(),
            status=np.ascontiguousarray(last).tobytes(),
            state=flown["state"][ends].tobytes(),
            estimate=flown["estimate"][sample].tobytes(),
            nominal=flown["nominal"][sample].tobytes(),
            u_nominal=flown["u_nominal"][sample].tobytes(),
            a_command=flown["a_command"][sample].tobytes(),
            a_error=error.tobytes(),
            rotor_thrust=flown["rotor_thrust"][sample].tobytes(),
            command=flown["command"][sample].tobytes(),
            obstacles=flown["obstacle"][sample].tobytes(),
            tracks=flown["track"][sample].tobytes(),
            margin=flown["margin"][sample].tobytes(),
            gate_m=flown["gate_m"][sample].tobytes(),
            counts=np.stack(counts, axis=-1).astype(np.float64).tobytes(),
            each_status=status.tobytes(),
            each_flags=flown["flags"][sample].tobytes(),
            mark=flown["mark"][sample].tobytes(),
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
        map: the cover that was flown through.
        filter_s: time of the filter per call, shape (C,) [s].
        tick_s: time of controller and filter per tick, shape (S,) [s]; None where it was not measured.
    """

    filter: str
    vehicle: str
    trials: list[TrialResult]
    summary: dict[str, Any]
    guarantee: Guarantee
    flights: Sequence[FlightLog]
    map: Artifact
    filter_s: NDArray[np.float32]
    tick_s: NDArray[np.float32] | None = None
