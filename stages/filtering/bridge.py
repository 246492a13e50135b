"""Native filters behind the Python protocol, and filters in Python as native ones, for the native flight."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.errors import InputError
from alula.stages.filtering.protocol import (
    SIZES,
    CommandKind,
    FilterResult,
    FilterStatus,
    FlightState,
    Nominal,
    SafetyFilter,
)


class NativeFilter:
    """A native filter behind the protocol; flights take `native` itself.

    Attributes:
        parameters: all of its parameters, defaults included.
    """

    def __init__(self, native: _core.SafetyFilter, parameters: Mapping[str, Any]) -> None:
        self.native = native
        self.parameters = dict(parameters)

    @property
    def kind(self) -> CommandKind:
        """The kind of command that the filter returns."""
        return self.native.kind  # type: ignore[return-value]

    def __call__(self, state: FlightState, nominal: Nominal) -> FilterResult:
        """Filter one tick; see `SafetyFilter`."""
        report = self.native.filter(
            np.concatenate([state.position, state.sigma, state.velocity, state.omega]).tolist(),
            nominal.acceleration.tolist(),
            velocity=nominal.velocity.tolist(),
            wrench=nominal.wrench.tolist(),
            sticks=None if nominal.sticks is None else nominal.sticks.tolist(),
            thrust=state.thrust,
            thrust_rate=state.thrust_rate,
            nominal_thrust_rate=nominal.thrust_rate,
            nominal_thrust_acceleration=nominal.thrust_acceleration,
            position_error=nominal.position_error.tolist(),
            velocity_error=nominal.velocity_error.tolist(),
            reference_acceleration=nominal.reference_acceleration.tolist(),
            rotors=None if state.rotors is None else [float(thrust) for thrust in state.rotors],
            tracks=np.ascontiguousarray(state.tracks, np.float64),
            position_variance=state.position_variance.tolist(),
            is_known=state.is_known,
        )
        return FilterResult(
            u=np.array(report[self.kind]),
            status=FilterStatus(report["status"]),
            margin=report["margin"],
            active=report["active"],
            thrust_rate=report["thrust_rate"],
            infeasible=report["infeasible"],
            certified=report["certified"],
            certified_moving=report["certified_moving"],
        )

    def reset(self) -> None:
        """Forget the flight before; see `SafetyFilter`."""
        self.native.reset()


def native_filter(made: SafetyFilter) -> _core.SafetyFilter:
    """A filter as a native one.

    Args:
        made: of this package or another one. What it returns is checked in each tick: a command that is not
            finite or of another shape raises InputError.
    """
    return made.native if isinstance(made, NativeFilter) else _core.PythonFilter(made.kind, _Ticks(made))


class _Ticks:
    """A filter in Python as the native flight calls it: plain values in and out."""

    def __init__(self, made: SafetyFilter) -> None:
        self._made = made

    def reset(self) -> None:
        self._made.reset()

    def tick(self, state: Mapping[str, Any], nominal: Mapping[str, Any]) -> dict[str, Any]:
        """Filter one tick, given the fields of `FlightState` and `Nominal` by name."""
        seen = FlightState(**_arrays(state))
        wanted = Nominal(**_arrays(nominal))
        try:
            result = self._made(seen, wanted)
        except Exception as error:  # another type of error would be taken for one of the native loop
            raise RuntimeError(f"the filter {type(self._made).__name__} failed: {error}") from error
        status = FilterStatus(result.status)
        return {
            "status": int(status),
            "u": [0.0] * SIZES[self._made.kind]
            if status is FilterStatus.REFUSED
            else _checked(result.u, self._made.kind, seen.position),
            "margin": float(result.margin),
            "active": int(result.active),
            "thrust_rate": float(result.thrust_rate),
            "infeasible": bool(result.infeasible),
            "certified": bool(result.certified),
            "certified_moving": bool(result.certified_moving),
            "solve_time_s": float(result.solve_time) if math.isfinite(result.solve_time) else None,
        }


def _arrays(values: Mapping[str, Any]) -> dict[str, Any]:
    return {key: np.array(value) if isinstance(value, list) else value for key, value in values.items()}


def _checked(u: Any, kind: CommandKind, position: FloatArray) -> list[float]:
    array = np.asarray(u, np.float64)
    if array.shape != (SIZES[kind],) or not np.isfinite(array).all():
        where = np.round(position, 3).tolist()
        raise InputError(f"the filter returned {u!r}, which is no {kind}, at {where}")
    found: list[float] = array.tolist()
    return found
