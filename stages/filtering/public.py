"""What a filter of your own is made of: `alula.filtering`."""

from alula._core import EllipsoidMap, HullMap
from alula.stages.filtering.protocol import FilterResult, FilterStatus, FilterWorld, FlightState, Nominal

__all__ = [
    "EllipsoidMap",
    "FilterResult",
    "FilterStatus",
    "FilterWorld",
    "FlightState",
    "HullMap",
    "Nominal",
]
