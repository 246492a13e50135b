"""Types of the entries that readers use in the open tables of manifests and records.

Tables such as `summary` and `source` may have any further entries. The entries here are checked once, where
a file is read, so that no reader meets another type than it expects.
"""

from __future__ import annotations

import math
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from alula.schemas.decode import convert

LARGEST = 1e15  # of a number that is measured or computed; larger ones overflow in figures and sums

_Number = Annotated[float, Meta(ge=-LARGEST, le=LARGEST)]
_NotNegative = Annotated[float, Meta(ge=0, le=LARGEST)]
_Voxels = Annotated[float, Meta(ge=0, le=1e30)]  # a sum of volumes; hulls may be 2^17 voxels long
_Whole = Annotated[int, Meta(ge=0, le=2**53)]
_Fraction = Annotated[float, Meta(ge=0, le=1)]


class FenceSummary(msgspec.Struct, frozen=True, kw_only=True):
    """Figures of a pilot's flights in a fence, within the summary of a run."""

    min_distance_m: _Number
    violations: _Whole
    passed: _Whole
    max_speed_km_h: _NotNegative
    interventions: _Whole
    engaged_trials: _Whole
    blended: _Whole | None = None
    backup: _Whole | None = None
    no_pilot: _Whole | None = None
    hand_over: _Whole | None = None
    refused: _Whole | None = None
    altered_passes: _Whole | None = None
    out_of_range: _Whole | None = None
    longest_backup_s: _NotNegative | None = None
    min_lambda: _Number | None = None
    min_h_i_m: _Number | None = None
    brake_distance_m: _Number | None = None
    stop_distance_m: _Number | None = None
    start_h_i_m: _Number | None = None


class RunSummary(msgspec.Struct, frozen=True):
    """Summary of a run."""

    trials: _Whole = 0
    success_rate: _Fraction | None = None
    success_interval: tuple[_Fraction, _Fraction] | None = None
    collisions: _Whole | None = None
    min_map_clearance_m: _Number | None = None
    min_scene_clearance_m: _Number | None = None
    min_fence_clearance_m: _Number | None = None
    min_moving_clearance_m: _Number | None = None
    static_collisions: _Whole | None = None
    moving_collisions: _Whole | None = None
    certified_share_static: _Fraction | None = None
    certified_share_moving: _Fraction | None = None
    mean_path_ratio: _NotNegative | None = None
    sigma: _Number | None = None
    blocked_pairs: _Whole | None = None
    inflation_m: _Number | None = None
    holds: _Whole | None = None
    worst_trial: _Whole | None = None
    fence: FenceSummary | None = None
    ended_by: str | None = None
    notes: list[str] = []


class RunTiming(msgspec.Struct, frozen=True):
    """Measured times of a run that tables compare [s], and counts."""

    filter_calls: _NotNegative | None = None
    filter_total_s: _NotNegative | None = None
    filter_p50_s: _NotNegative | None = None
    filter_p99_s: _NotNegative | None = None
    filter_max_s: _NotNegative | None = None
    filter_mean_s: _NotNegative | None = None
    filter_std_s: _NotNegative | None = None
    tick_mean_s: _NotNegative | None = None
    tick_p50_s: _NotNegative | None = None
    tick_p99_s: _NotNegative | None = None
    tick_max_s: _NotNegative | None = None
    overruns: _NotNegative | None = None
    ticks: _NotNegative | None = None
    trials_flown: _NotNegative | None = None
    wall_s: _NotNegative | None = None
    command_mean_s: list[_NotNegative | None] | _NotNegative | None = None
    reaction_mean_s: list[_NotNegative | None] | _NotNegative | None = None


class FenceShape(msgspec.Struct, frozen=True):
    """Fence of a run, as in its scenario."""

    box_m: tuple[_Number, _Number, _Number, _Number, _Number, _Number] | None = None
    faces: list[tuple[_Number, _Number, _Number, _Number]] = []


class WorldShape(msgspec.Struct, frozen=True):
    """World of a run, as in its scenario."""

    fence: FenceShape | None = None


class RunParameters(msgspec.Struct, frozen=True):
    """Parameters of a run."""

    world: WorldShape | None = None
    fence: tuple[_Number, _Number, _Number, _Number, _Number, _Number] | None = None  # box of `fly`
    filter_parameters: dict[str, Any] | None = None


class SourceLoss(msgspec.Struct, frozen=True):
    """Bounds of the loss of a splat format."""

    opacity: _NotNegative | None = None
    unbounded: dict[str, str] | None = None


class SceneSource(msgspec.Struct, frozen=True):
    """Source of a scene."""

    removed: dict[str, _Whole] | None = None
    lacks: list[str] | None = None
    applied: list[str] | None = None
    unknown_properties: list[str] | None = None
    loss: SourceLoss | None = None


class SceneAlignment(msgspec.Struct, frozen=True):
    """Alignment of a scene."""

    position_error_m: _NotNegative | None = None
    map_origin_m: Annotated[list[_Number], Meta(min_length=3, max_length=3)] | None = None


class Curve(msgspec.Struct, frozen=True):
    """Course of a merge: numbers of hulls and of half-planes, and the volume without voxels."""

    hulls: list[_NotNegative] | None = None
    excess_sum_voxels: list[_Voxels] | None = None
    half_planes: list[_NotNegative] | None = None

    def __post_init__(self) -> None:
        """Refuse columns of different lengths."""
        columns = [c for c in (self.hulls, self.excess_sum_voxels, self.half_planes) if c is not None]
        if len({len(column) for column in columns}) > 1:
            raise ValueError("the columns of `curve` have different lengths")


class CoverRecord(msgspec.Struct, frozen=True):
    """Record of a cover's construction, its `certificate`."""

    curve: Curve | None = None


def check(table: dict[str, Any] | None, kind: type[msgspec.Struct], name: str) -> None:
    """Check the entries of a table that readers use.

    Args:
        table: the table; None passes.

    Raises:
        ValueError: an entry has another type, or is out of range.
    """
    if table is None:
        return
    try:
        convert(table, kind)
    except ValueError as error:
        raise ValueError(f"`{name}`: {error}") from error


def first_wild(value: Any, path: str = "$") -> str | None:
    """Path of the first number in plain values that is not finite or beyond `LARGEST`; None without one."""
    if isinstance(value, float):
        return None if math.isfinite(value) and abs(value) <= LARGEST else path
    if isinstance(value, int):
        return None if abs(value) <= 2**63 else path
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return next((wild for key, item in items if (wild := first_wild(item, f"{path}.{key}"))), None)
