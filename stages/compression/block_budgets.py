"""Budgets of blocks: how far each is merged before the last join, and how regions divide the limits."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from alula.schemas.errors import InfeasibleError
from alula.schemas.parameters.configs.merge import BOX_PLANES, MergeConfig

_FINER = 6.0  # hulls of all blocks over the final number
_FINER_AT_LAST = 2.5  # the same before the last join
_BEGIN = 12.0  # curves begin at so many times the final number of hulls, by voxels
_END = 4.0  # and end at this factor below the number of hulls after a level, by voxels
_FEW_HULLS = 64  # so many hulls of a block are always kept before its curve begins
HEADER_BYTES, HULL_BYTES = 64, 14  # see native/core/include/alula/cover/budget.hpp
_PLANES_PER_HULL, _BYTES_PER_HULL = 7, 20  # fewer than covers within such budgets have


def wanted_hulls(config: MergeConfig) -> int | None:
    """Number of hulls that the limits allow at most, roughly; None where only the growth is limited."""
    limits = [config.hulls] if config.hulls is not None else []
    if config.max_planes is not None:
        limits.append(math.ceil(config.max_planes / _PLANES_PER_HULL))
    if config.max_bytes is not None:
        limits.append(math.ceil(config.max_bytes / _BYTES_PER_HULL))
    return min(limits, default=None)


def finer_than_last(level: int, last: int) -> float:
    """Number of hulls of all cubes of a level over the final number; it falls by equal factors.

    Args:
        level: 0 for blocks.
        last: level of the last join, larger than `level`.
    """
    return float(_FINER * (_FINER_AT_LAST / _FINER) ** (level / max(1, last - 1)))


def to_begin(config: MergeConfig, fraction: float) -> MergeConfig:
    """Configuration of the merge of a block up to where its curve begins.

    Args:
        fraction: of the voxels that are in the block.
    """
    return _plain(config, fraction, _BEGIN, _FEW_HULLS)


def to_end(config: MergeConfig, fraction: float, finer: float) -> MergeConfig:
    """Configuration of the merge that shows the curve of a block or a cube.

    Args:
        fraction: of the voxels that it has.
    """
    return _plain(config, fraction, finer / _END, 1)


def _plain(config: MergeConfig, fraction: float, finer: float, least: int) -> MergeConfig:
    hulls, growth = wanted_hulls(config), None
    if hulls is not None:
        hulls = max(least, math.ceil(finer * fraction * hulls))
    else:
        assert config.max_growth is not None
        growth = 1 + (config.max_growth - 1) / finer
    return MergeConfig(
        hulls=hulls,
        max_growth=growth,
        facet_cap="none",
        method=config.method,
        cluster_radius=config.cluster_radius,
    )


@dataclass(frozen=True, slots=True)
class Curve:
    """Merge curve: the sum of W after each merge.

    Attributes:
        hulls: number before the first merge.
        excess: sum of W [voxels], before the first merge and after each, shape (H + 1,).
    """

    hulls: int
    excess: NDArray[np.float64]


def merges_of(config: MergeConfig, curves: Sequence[Curve], voxels: int, finer: float) -> list[int]:
    """Numbers of merges of cubes that leave `finer` times the final hulls, or that part of the growth.

    The merges that add least volume come first, those of a cube in their order: the greedy rule over all
    cubes. Cubes have more hulls where their curves end before.

    Args:
        finer: see `finer_than_last`; 1 for the limits themselves.
    """
    owner = np.repeat(np.arange(len(curves)), [len(curve.excess) - 1 for curve in curves])
    increase = np.concatenate([np.maximum.accumulate(np.diff(curve.excess)) for curve in curves])
    order = np.argsort(increase, kind="stable")

    def first(count: int) -> list[int]:
        return [int(n) for n in np.bincount(owner[order[:count]], minlength=len(curves))]

    hulls = wanted_hulls(config)
    if hulls is not None:
        return first(max(0, sum(curve.hulls for curve in curves) - math.ceil(finer * hulls)))
    assert config.max_growth is not None
    room = (config.max_growth - 1) / finer * voxels

    def exceeds(count: int) -> bool:
        parts = zip(curves, first(count), strict=True)
        return sum(float(curve.excess[merges]) for curve, merges in parts) > room

    return first(max(0, bisect_left(range(len(order) + 1), True, key=exceeds) - 1))


def divided(config: MergeConfig, curves: Sequence[Curve], voxels: Sequence[int]) -> list[MergeConfig]:
    """Configurations of the last merges of all regions, whose limits add up to those of the whole.

    Planes and bytes beyond those that all hulls have are divided like the hulls.

    Raises:
        InfeasibleError: there are more regions than hulls.
    """
    hulls = wanted_hulls(config)
    if hulls is not None and hulls < len(curves):
        raise InfeasibleError(
            f"no cover within the limits: they allow about {hulls} hulls, but each of the {len(curves)} parts"
            " that are not joined needs one; relax a limit"
        )
    merges = merges_of(config, curves, sum(voxels), 1.0)
    if hulls is None:
        return [
            replace(config, block_m=None, max_growth=1 + max(0.0, float(curve.excess[done])) / count)
            for curve, done, count in zip(curves, merges, voxels, strict=True)
        ]
    parts = [curve.hulls - done for curve, done in zip(curves, merges, strict=True)]
    return [
        replace(
            config,
            block_m=None,
            max_growth=None,
            hulls=None if config.hulls is None else part,
            max_planes=_divided(config.max_planes, part, parts, 0, BOX_PLANES),
            max_bytes=_divided(config.max_bytes, part, parts, HEADER_BYTES, HULL_BYTES),
        )
        for part in parts
    ]


def _divided(limit: int | None, hulls: int, all_hulls: Sequence[int], fixed: int, each: int) -> int | None:
    """Part of a limit: what the part and its hulls need at least, and of the rest a share by hulls."""
    if limit is None:
        return None
    rest = limit - fixed * len(all_hulls) - each * sum(all_hulls)
    if rest < 0:
        raise InfeasibleError(
            f"no cover within the limits: {len(all_hulls)} parts with {sum(all_hulls)} hulls need"
            f" {limit - rest}, more than {limit}; relax a limit"
        )
    return fixed + each * hulls + rest * hulls // sum(all_hulls)
