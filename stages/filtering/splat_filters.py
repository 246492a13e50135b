"""The filters among ellipsoids that run natively."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

import numpy as np

from alula import _core
from alula.schemas.errors import UsageError
from alula.stages.filtering.protocol import FilterStatus
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


def _cone_di(world: SplatWorld, own: dict[str, Any]) -> _core.SplatFilter:
    return _core.ConeDi(world.index, **own)


def _safer_splat(world: SplatWorld, own: dict[str, Any]) -> _core.SplatFilter:
    return _core.SaferSplat(world.index, **own)


_Build = Callable[[SplatWorld, dict[str, Any]], _core.SplatFilter]
_NATIVE: dict[str, tuple[type, _Build]] = {
    "cone-di": (_core.ConeDi, _cone_di),
    "safer-splat": (_core.SaferSplat, _safer_splat),
}


def parameters_of(name: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """All parameters of a native filter: those given, else their defaults; of the pruning too.

    Raises:
        UsageError: a parameter is unknown or of the wrong type.
    """
    own = defaults_of(_NATIVE[name][0])
    known = {key: value for key, value in own.items() if key not in _PARTS} | {
        key: value for part in _PARTS if part in own for key, value in defaults_of(_PARTS[part]).items()
    }
    for key, value in given.items():
        if key not in known:
            raise UsageError(f"{name}: unknown parameter {key!r}; it has {', '.join(known)}")
        if not _fits(value, known[key]):
            wanted = {bool: "true or false", int: "a whole number", float: "a number"}.get(
                type(known[key]), "a word" if isinstance(known[key], str) else "several numbers"
            )
            raise UsageError(f"{name}: {key} must be {wanted}, not {value!r}")
    return known | {key: _like(value, known[key]) for key, value in given.items()}


_PARTS: dict[str, type] = {"pruning": _core.Pruning}


def _fits(value: Any, default: Any) -> bool:
    if isinstance(default, bool) or isinstance(value, bool):
        return isinstance(default, bool) and isinstance(value, bool)
    if isinstance(default, float):
        return isinstance(value, int | float)
    if isinstance(default, tuple | list):
        return isinstance(value, list | tuple) and len(value) == len(default)
    return isinstance(value, type(default))


def _like(value: Any, default: Any) -> Any:
    return float(value) if isinstance(default, float) else value


def _factory(name: str) -> Callable[[SplatWorld, Mapping[str, Any]], SplatFilter]:
    def make(world: SplatWorld, given: Mapping[str, Any]) -> SplatFilter:
        parameters = parameters_of(name, given)
        native, build = _NATIVE[name]
        own = {key: value for key, value in parameters.items() if key in defaults_of(native)}
        try:
            for part, kind in _PARTS.items():
                if part in defaults_of(native):
                    own[part] = kind(**{key: parameters[key] for key in defaults_of(kind)})
            return NativeSplatFilter(build(world, own), parameters)
        except (ValueError, TypeError, OverflowError) as error:
            raise UsageError(f"{name}: {' '.join(str(error).split())[:300]}") from error

    return make


SPLAT_FILTERS = {name: _factory(name) for name in _NATIVE}
