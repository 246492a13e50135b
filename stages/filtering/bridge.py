"""Filters of the Python protocols as native filters, for the native flight."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.errors import InputError
from alula.stages.filtering.polytope_cbf import NativeFilter
from alula.stages.filtering.protocol import Filter, FilterStatus
from alula.stages.filtering.splat_filters import NativeSplatFilter
from alula.stages.filtering.splat_protocol import FlightState, Nominal, SplatFilter


def native_filter(made: SplatFilter) -> _core.SafetyFilter:
    """A filter of accelerations or wrenches as a native one.

    Args:
        made: of this package or another one.
    """
    if isinstance(made, NativeSplatFilter):
        return made.native
    return _core.PythonFilter(made.kind, _Bridge(made))


def native_velocity_filter(
    made: Filter, *, lag_s: float = 0.0, max_speed_m_s: float = 0.0
) -> _core.SafetyFilter:
    """A filter of velocities as a native one, on the chord of a vehicle that follows them with a lag.

    Args:
        made: of this package or another one.
        lag_s: time constant of the vehicle; 0: the filter is evaluated at its position alone [s].
        max_speed_m_s: a velocity of the filter above it is an error [m/s].

    Raises:
        ValueError: the lag or the speed is out of range.
    """
    native: _core.SafetyFilter
    if isinstance(made, NativeFilter):
        native = _core.VelocityFilter(made.native, is_bare=not made.enabled)
    else:
        native = _core.PythonFilter("velocity", _VelocityBridge(made))
    return _core.ChordFilter(native, lag_s=lag_s, max_speed_m_s=max_speed_m_s)


class _VelocityBridge:
    """A filter of velocities in Python as the native flight calls it: plain values in and out."""

    def __init__(self, made: Filter) -> None:
        self._made = made

    def reset(self) -> None:
        """Nothing to forget: the answer depends on the arguments alone."""

    def tick(self, state: Mapping[str, Any], nominal: Mapping[str, Any]) -> dict[str, Any]:
        """Filter one tick.

        Args:
            state: fields of `FlightState` by name.
            nominal: its `velocity`.
        """
        position = np.array(state["position"])
        result = _called(self._made, position, np.array(nominal["velocity"]))
        return _answer(result, _command(result, "velocity", position))


class _Bridge:
    """A filter of accelerations or wrenches in Python as the native flight calls it."""

    def __init__(self, made: SplatFilter) -> None:
        self._made = made

    def reset(self) -> None:
        """Discard the state of the flight before."""
        self._made.reset()

    def tick(self, state: Mapping[str, Any], nominal: Mapping[str, Any]) -> dict[str, Any]:
        """Filter one tick.

        Args:
            state: fields of `FlightState` by name.
            nominal: fields of `Nominal` by name.
        """
        seen = FlightState(
            position=np.array(state["position"]),
            sigma=np.array(state["sigma"]),
            velocity=np.array(state["velocity"]),
            omega=np.array(state["omega"]),
            thrust=state["thrust"],
            thrust_rate=state["thrust_rate"],
            rotors=state["rotors"],
        )
        wanted = Nominal(
            acceleration=np.array(nominal["acceleration"]),
            wrench=np.array(nominal["wrench"]),
            thrust_rate=nominal["thrust_rate"],
            thrust_acceleration=nominal["thrust_acceleration"],
            position_error=np.array(nominal["position_error"]),
            velocity_error=np.array(nominal["velocity_error"]),
            reference_acceleration=np.array(nominal["reference_acceleration"]),
        )
        result = _called(self._made, seen, wanted)
        u = _command(result, self._made.kind, seen.position)
        return _answer(result, u) | {
            "thrust_rate": float(result.thrust_rate),
            "infeasible": bool(result.infeasible),
            "certified": bool(result.certified),
        }


def _called(made: Any, *arguments: Any) -> Any:
    """Result of a filter; its error as one that the native loop passes on unchanged."""
    try:
        return made(*arguments)
    except Exception as error:
        raise RuntimeError(f"the filter {type(made).__name__} failed: {error}") from error


def _command(result: Any, kind: str, position: FloatArray) -> list[float]:
    """The command of a result, checked; zero where the filter refused."""
    size = 4 if kind in ("wrench", "sticks") else 3
    if FilterStatus(result.status) is FilterStatus.REFUSED:
        return [0.0] * size
    u = np.asarray(result.u, np.float64)
    if u.shape != (size,) or not np.isfinite(u).all():
        where = ", ".join(f"{value:.3f}" for value in position)
        raise InputError(f"the filter returned {result.u!r}, which is no {kind}, at ({where})")
    commanded: list[float] = u.tolist()
    return commanded


def _answer(result: Any, u: list[float]) -> dict[str, Any]:
    return {
        "status": int(result.status),
        "u": u,
        "margin": float(result.margin),
        "active": int(result.active),
        "thrust_rate": 0.0,
        "infeasible": False,
        "certified": False,
    }
