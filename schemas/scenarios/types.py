"""Types of the values of a scenario that several tables have, and the base of all tables."""

from __future__ import annotations

from typing import Annotated, Any

import msgspec
from msgspec import Meta

LARGEST = 1e6
"""Bound of positions, velocities and accelerations: ALULA_LARGEST of native/onboard."""

NotNegative = Annotated[float, Meta(ge=0)]
Positive = Annotated[float, Meta(gt=0)]
Length = Annotated[float, Meta(ge=0, le=1e3)]
Limit = Annotated[float, Meta(gt=0)]  # inf: no limit
Scale = Annotated[float, Meta(ge=0.01, le=100)]
Share = Annotated[float, Meta(ge=0, lt=1)]
Lag = Annotated[float, Meta(ge=0, le=1)]
Delay = Annotated[float, Meta(ge=0, le=10)]
Ticks = Annotated[int, Meta(ge=1, le=1000)]
Gain = Annotated[float, Meta(ge=1e-6, le=1e6)]
Speed = Annotated[float, Meta(ge=1e-3, le=1e3)]
FileName = Annotated[str, Meta(min_length=1)]
Coordinate = Annotated[float, Meta(gt=-LARGEST, lt=LARGEST)]
Vector = tuple[Coordinate, Coordinate, Coordinate]
Sizes = tuple[NotNegative, NotNegative, NotNegative]
Box = tuple[float, float, float, float, float, float]


def about(description: str, **limits: Any) -> Meta:
    """Describe a key, for `alula scenario --keys` and the JSON Schema.

    Args:
        description: a phrase; it says what None stands for.
    """
    return Meta(description=description, **limits)


class Table(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A table of the file: unknown keys are refused."""


class SparseTable(Table, frozen=True, kw_only=True, omit_defaults=True):
    """A table of the file without the keys that have their defaults."""
