"""Protocol of the safety filters for a vehicle whose input is its velocity."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Protocol

from alula.schemas.arrays import FloatArray
from alula.stages.compression.hulls import Hulls


class FilterStatus(IntEnum):
    """Outcome of a filter; the numbers are those of `alula_filter_status` in native/onboard."""

    OK = 0
    """The nominal input is safe and is returned unchanged, bit by bit."""
    FILTERED = 1
    """Changed by a barrier's row or the speed limit."""
    SHORTENED = 2
    """Scaled down further, so that the held step stays clear."""
    RECOVERING = 3
    """The vehicle is too close already: the filter drives it out and ignores the nominal input."""
    REFUSED = 4
    """No safe input is known; `u` is zero."""
    BACKUP = 5
    """The backup policy is flown; only filters among ellipsoids return this."""


@dataclass(frozen=True, slots=True)
class FilterResult:
    """Result of one call of a filter.

    Attributes:
        u: the input to fly, shape (3,), world frame [m/s].
        status: outcome; every caller branches on it.
        margin: value of the barrier, negative when violated [m].
        active: index of the deciding obstacle, -1 for none.
        solve_time: duration measured by the filter [s]; NaN when it measures none.
    """

    u: FloatArray
    status: FilterStatus
    margin: float
    active: int = -1
    solve_time: float = float("nan")


@dataclass(frozen=True, slots=True, kw_only=True)
class World:
    """Obstacles, vehicle and rate that a filter is built for.

    Attributes:
        hulls: the obstacles.
        radius_m: radius of the vehicle's sphere [m].
        speed_m_s: speed limit [m/s].
        dt_s: time for which an input is held [s].
        extent_m: bound of the coordinates of all positions [m].
        image: the hulls as an onboard map with an index, which `polytope-cbf` then reads instead of `hulls`.
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
