"""Filters of the Python protocols as native filters, for the native flight."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from alula import _core
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
        result = self._made(np.array(state["position"]), np.array(nominal["velocity"]))
        return _answer(result, np.asarray(result.u, np.float64).tolist())


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
        result = self._made(seen, wanted)
        refused = FilterStatus(result.status) is FilterStatus.REFUSED
        size = 3 if self._made.kind == "acceleration" else 4
        u = [0.0] * size if refused else np.asarray(result.u, np.float64).tolist()
        return _answer(result, u) | {
            "thrust_rate": float(result.thrust_rate),
            "infeasible": bool(result.infeasible),
            "certified": bool(result.certified),
        }


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
