"""Results of simulated flights: outcomes, and samples for the log."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, Self

import msgspec
import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray, IntArray
from alula.schemas.log.run import PLAN_OUTCOMES, Outcome, TrialResult

LOOP_OUTCOMES: tuple[Outcome, ...] = ("reached", "stuck", "timeout", "refused")  # native numbers, from 1


def outcomes_of(trials: Sequence[TrialResult]) -> tuple[Outcome, ...]:
    """Outcomes that a summary of start-goal flights counts; those of plans only where plans were flown."""
    return LOOP_OUTCOMES + (PLAN_OUTCOMES if any(trial.plan is not None for trial in trials) else ())


def logged_ticks(last: int, dt_s: float, rate_hz: float) -> IntArray:
    """Ticks that a log shows: one in so many from 0 on, as the rate requires, and the last one once.

    Args:
        dt_s: duration of a tick [s].
        rate_hz: samples per second in the log.

    Returns:
        Shape (T,), increasing.
    """
    stride = max(1, round(1 / (rate_hz * dt_s)))
    return np.append(np.arange(0, last, stride, dtype=np.int64), np.int64(last))


class WorldFlight(msgspec.Struct, frozen=True, kw_only=True):
    """Samples of a flight behind f filters, with n moving obstacles around it, at the log's rate.

    T rows of numbers, as bytes so that a journal can hold them. `tick` has the number of the tick of each
    sample, int64; `status` that of the last filter, a byte for each.
    The samples end with the end of the flight: there `state` is of the end, all else of the tick before.
    `state` has position, attitude (MRP), velocity and rates, shape (T, 12); `estimate` what the filters got;
    `nominal` the mission's velocity or acceleration, shape (T, 3), and `u_nominal` its wrench, shape (T, 4);
    `a_command` the commanded acceleration, shape (T, 3), NaN where there is none, and `a_error` the largest
    difference of the body's from it since the sample before, shape (T,); `command` velocity, acceleration or
    rates (3), wrench (4) and sticks (4); `sticks` the pilot's, shape (T, 4), NaN without; `rotor_thrust` of
    each rotor, shape (T, 4); `obstacles` and `tracks` positions, shape (T, n, 3), NaN without a track.
    Of each filter: `margin`, shape (T, f), or of the hulls without one, `gate_m`, shape (T, f), and `counts`,
    shape (T, f, 4): active obstacle, candidates, rows, iterations; `each_status` and `each_flags` a byte for
    each filter, and `mark` one for all, the bits of `SimulatedFlight` in native/core.

    Of a pilot's flight in a fence, else of shape (T, 0): `figure` lambda, h_I, the filter's distance, its
    margin and speed towards the fence, shape (T, 5); `distance` the minimum true one since the sample before,
    shape (T, 1); `fence_status` a byte, the number of alula_geofence_status.
    """

    _SHAPES: ClassVar[dict[str, tuple[int, ...]]] = {  # of a row, by name
        **{"state": (12,), "estimate": (12,), "nominal": (3,), "command": (11,), "sticks": (4,)},
        **{"u_nominal": (4,), "a_command": (3,), "a_error": (), "rotor_thrust": (4,)},
        **{"obstacles": (-1, 3), "tracks": (-1, 3), "margin": (-1,), "gate_m": (-1,), "counts": (-1, 4)},
        **{"figure": (-1,), "distance": (-1,)},
    }

    trial: int
    tick: bytes
    status: bytes
    state: bytes
    estimate: bytes
    nominal: bytes
    u_nominal: bytes
    a_command: bytes
    a_error: bytes
    command: bytes
    sticks: bytes
    rotor_thrust: bytes
    obstacles: bytes
    tracks: bytes
    margin: bytes
    gate_m: bytes
    counts: bytes
    each_status: bytes
    each_flags: bytes
    mark: bytes
    figure: bytes = b""
    distance: bytes = b""
    fence_status: bytes = b""

    @classmethod
    def of(
        cls, trial: int, flown: dict[str, Any], dt_s: float, rate_hz: float, filter_ticks: int = 1
    ) -> Self:
        """Sample a native log; see `logged_ticks`.

        Args:
            flown: arrays by name, a row per tick.
            dt_s: duration of a tick [s].
            filter_ticks: ticks for which the filters' command is held.
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
            sticks=flown["sticks"][sample].tobytes(),
            obstacles=flown["obstacle"][sample].tobytes(),
            tracks=flown["track"][sample].tobytes(),
            margin=flown["margin"][sample].tobytes(),
            gate_m=flown["gate_m"][sample].tobytes(),
            counts=np.stack(counts, axis=-1).astype(np.float64).tobytes(),
            each_status=status.tobytes(),
            each_flags=flown["flags"][sample].tobytes(),
            mark=flown["mark"][sample].tobytes(),
            **(_fence_samples(flown["fence"], sample // filter_ticks) if "fence" in flown else {}),
        )

    def time_s(self, tick_s: float) -> FloatArray:
        """Times of the samples, shape (T,) [s]."""
        return np.frombuffer(self.tick, np.int64).astype(np.float64) * tick_s

    def of_filters(self, name: str) -> NDArray[np.uint8]:
        """Bytes of a field for each filter, shape (T, f).

        Args:
            name: `each_status`, `each_flags`, or `fence_status` of the fence alone.
        """
        flat = np.frombuffer(getattr(self, name), np.uint8)
        return flat.reshape(len(self.status), -1) if len(flat) else flat.reshape(len(self.status), 0)

    def rows(self, name: str) -> FloatArray:
        """Numbers of a field; see the class."""
        flat: FloatArray = np.frombuffer(getattr(self, name), np.float64)
        shape = self._SHAPES[name]
        if not len(flat) and -1 in shape:  # no obstacle, no filter
            return flat.reshape(len(self.status), *(0 if size == -1 else size for size in shape))
        return flat.reshape(len(self.status), *shape)


def _fence_samples(log: dict[str, Any], at: IntArray) -> dict[str, bytes]:
    """Samples of a native log of a fence at some of its rows."""
    nearest = log["distance"][at]
    nearest[1:] = np.minimum(nearest[1:], np.minimum.reduceat(log["distance"], at)[:-1])
    return {
        "figure": log["figure"][at].tobytes(),
        "distance": nearest.tobytes(),
        "fence_status": log["status"][at].tobytes(),
    }
