"""What every safety filter takes and gives."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Protocol

from alula.schemas.arrays import FloatArray
from alula.stages.compression.hulls import Hulls


class FilterStatus(IntEnum):
    """What a filter did; the numbers are those of `alula_filter_status` in native/onboard."""

    OK = 0
    """The nominal input is safe and is returned unchanged, bit by bit."""
    FILTERED = 1
    """Changed by a barrier's row or the speed limit."""
    SHORTENED = 2
    """Scaled down further, so that the held step stays clear."""
    RECOVERING = 3
    """Too close already: drives out, the nominal input is ignored."""
    REFUSED = 4
    """No safe input is known; `u` is zero."""
    BACKUP = 5
    """The backup policy is flown; only by filters among ellipsoids."""


@dataclass(frozen=True, slots=True)
class FilterResult:
    """A filter's answer.

    Attributes:
        u: the input to fly, shape (3,), world frame [m/s].
        status: what was done; every caller branches on it.
        margin: value of the barrier, negative when violated [m].
        active: index of the obstacle that decides, -1 for none.
        solve_time: measured by the filter itself [s]; NaN when it did not.
    """

    u: FloatArray
    status: FilterStatus
    margin: float
    active: int = -1
    solve_time: float = float("nan")


@dataclass(frozen=True, slots=True, kw_only=True)
class World:
    """What a filter is built for.

    Attributes:
        hulls: the obstacles.
        radius_m: of the vehicle's sphere [m].
        speed_m_s: speed limit [m/s].
        dt_s: how long an input is held [s].
        extent_m: no coordinate of a position exceeds this [m].
        image: the hulls as an onboard map with an index, when `polytope-cbf` is to read that instead.
    """

    hulls: Hulls
    radius_m: float
    speed_m_s: float
    dt_s: float
    extent_m: float
    image: bytes = b""


class Filter(Protocol):
    """A safety filter for a vehicle whose input is its velocity."""

    def __call__(self, x: FloatArray, u_nom: FloatArray) -> FilterResult:
        """Filter the nominal input `u_nom` at position `x`, both of shape (3,), world frame."""
        ...


FilterFactory = Callable[[World, Mapping[str, Any]], Filter]
