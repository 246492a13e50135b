"""The filters among ellipsoids that run natively."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from alula import _core
from alula.schemas.errors import UsageError
from alula.stages.filtering.protocol import FilterStatus
from alula.stages.filtering.qp import clarabel_backend
from alula.stages.filtering.splat_protocol import (
    FlightState,
    InputKind,
    Nominal,
    SplatFilter,
    SplatFilterResult,
    SplatWorld,
)

_DEFAULT = re.compile(r"(\w+): [^,=]+ = \\(\d+)")  # of a parameter in a signature of nanobind


class NativeSplatFilter:
    """A native filter behind the common protocol; `fly` takes `native` itself.

    Attributes:
        native: the filter.
        parameters: all of its parameters, defaults included.
    """

    def __init__(self, native: _core.SplatFilter, parameters: Mapping[str, Any]) -> None:
        self.native = native
        self.parameters = dict(parameters)

    @property
    def kind(self) -> InputKind:
        """What the filter returns."""
        return "wrench" if self.native.gives_wrench else "acceleration"

    def __call__(self, state: FlightState, nominal: Nominal) -> SplatFilterResult:
        """See `SplatFilter`."""
        report = self.native.filter(
            np.concatenate([state.position, state.sigma, state.velocity, state.omega]).tolist(),
            nominal.acceleration.tolist(),
            wrench=nominal.wrench.tolist(),
            thrust=state.thrust,
            thrust_rate=state.thrust_rate,
            nominal_thrust_rate=nominal.thrust_rate,
            nominal_thrust_acceleration=nominal.thrust_acceleration,
            position_error=nominal.position_error.tolist(),
            velocity_error=nominal.velocity_error.tolist(),
            reference_acceleration=nominal.reference_acceleration.tolist(),
            rotors=state.rotors,
        )
        return SplatFilterResult(
            u=np.array(report[self.kind]),
            status=FilterStatus(report["status"]),
            margin=report["margin"],
            active=report["active"],
            thrust_rate=report["thrust_rate"],
            infeasible=report["infeasible"],
            certified=report["certified"],
        )

    def reset(self) -> None:
        """See `SplatFilter`."""
        self.native.reset()


@cache
def defaults_of(native: type) -> dict[str, Any]:
    """The parameters of a native class and their defaults, from its own signature."""
    signature, _, values = native.__init__.__nb_signature__[0]  # type: ignore[misc]
    return {name: values[int(number)] for name, number in _DEFAULT.findall(signature)}


@dataclass(frozen=True, slots=True)
class _Spec:
    """How a native filter is built: parameters of its parts are given beside its own.

    Attributes:
        native: its class.
        parts: arguments that are objects with parameters of their own, and their classes.
        has_policy: whether a backup policy is the first argument; such a filter returns wrenches.
        solvers: what the parameter `solver` may be, the default first; empty when there is none.
    """

    native: type
    parts: Mapping[str, type]
    has_policy: bool = False
    solvers: tuple[str, ...] = ()

    def defaults(self) -> dict[str, Any]:
        """All parameters and their defaults; the kind of the backup policy is called `policy`."""
        own = {key: value for key, value in defaults_of(self.native).items() if key not in self.parts}
        policy = {**defaults_of(_core.BackupPolicy)} if self.has_policy else {}
        kind = {"policy": policy.pop("kind")} if policy else {}
        of_parts = {
            key: getattr(defaults_of(self.native)[name], key)
            for name, part in self.parts.items()
            for key in defaults_of(part)
        }
        merged = own | kind | policy | of_parts
        merged.pop("tick_s", None)  # that of the flight
        merged.pop("motor_time_constant_s", None)  # that of the vehicle
        merged.pop("qp_backend", None)  # `solver` says it
        return merged | ({"solver": self.solvers[0]} if self.solvers else {})

    def build(self, world: SplatWorld, parameters: Mapping[str, Any]) -> _core.SplatFilter:
        """The filter itself, from all parameters."""
        given = {
            **parameters,
            "tick_s": world.dt_s,
            "motor_time_constant_s": world.motor_time_constant_s,
        }
        if given.get("solver") == "clarabel":
            given |= {"solver": "active-set", "qp_backend": clarabel_backend}

        def pick(native: type) -> dict[str, Any]:
            return {key: given[key] for key in defaults_of(native) if key in given}

        arguments = pick(self.native) | {name: part(**pick(part)) for name, part in self.parts.items()}
        first: tuple[Any, ...] = (world.index,)
        if self.has_policy:
            policy = _core.BackupPolicy(world.body, given["policy"], **pick(_core.BackupPolicy))
            first = (policy, world.index)
        native: _core.SplatFilter = self.native(*first, **arguments)
        return native


_PRUNED = {"pruning": _core.Pruning}
_SHIELDED = {"shield_options": _core.ShieldOptions, **_PRUNED}
_SOLVERS = ("active-set", "clarabel")
_NATIVE: dict[str, _Spec] = {
    "cone-di": _Spec(_core.ConeDi, _PRUNED, solvers=_SOLVERS),
    "cone-ecbf": _Spec(
        _core.ConeEcbf,
        {"wish_options": _core.SmoothWishOptions, **_SHIELDED},
        has_policy=True,
        solvers=_SOLVERS,
    ),
    "cone-backup": _Spec(
        _core.ConeBackup, _SHIELDED, has_policy=True, solvers=("active-set", "interpolation", "clarabel")
    ),
    "safer-splat": _Spec(_core.SaferSplat, _PRUNED),
}
GUIDES = tuple(name for name, spec in _NATIVE.items() if not spec.has_policy)


def parameters_of(name: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """All parameters of a native filter: those given, else their defaults.

    Raises:
        UsageError: a parameter is unknown or of the wrong type.
    """
    known = _NATIVE[name].defaults()
    for key, value in given.items():
        if key not in known:
            raise UsageError(f"{name}: unknown parameter {key!r}; it has {', '.join(sorted(known))}")
        if not _fits(value, known[key]):
            raise UsageError(f"{name}: {key} must be {_wanted(known[key])}, not {value!r}")
        if key == "solver" and value not in _NATIVE[name].solvers:
            raise UsageError(f"{name}: solver must be {' or '.join(_NATIVE[name].solvers)}, not {value!r}")
    return known | {key: _like(value, known[key]) for key, value in given.items()}


def _fits(value: Any, default: Any) -> bool:
    if isinstance(default, bool) or isinstance(value, bool):
        return isinstance(default, bool) and isinstance(value, bool)
    if isinstance(default, float):
        return isinstance(value, int | float)
    if isinstance(default, int):
        return isinstance(value, int) and 0 <= value < 2**31
    if isinstance(default, tuple | list):
        numbers = isinstance(value, list | tuple) and all(_fits(item, 0.0) for item in value)
        return numbers and len(value) == len(default)
    return isinstance(value, type(default))


def _like(value: Any, default: Any) -> Any:
    return float(value) if isinstance(default, float) else value


def _wanted(default: Any) -> str:
    if isinstance(default, tuple | list):
        return f"{len(default)} numbers"
    return {bool: "true or false", int: "a whole number from 0 to 2147483647", float: "a number"}.get(
        type(default), "a word"
    )


def _factory(name: str) -> Callable[[SplatWorld, Mapping[str, Any]], SplatFilter]:
    def make(world: SplatWorld, given: Mapping[str, Any]) -> SplatFilter:
        parameters = parameters_of(name, given)
        try:
            return NativeSplatFilter(_NATIVE[name].build(world, parameters), parameters)
        except (ValueError, TypeError, OverflowError) as error:
            raise UsageError(f"{name}: {' '.join(str(error).split())[:300]}") from error

    return make


SPLAT_FILTERS = {name: _factory(name) for name in _NATIVE}
