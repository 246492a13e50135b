"""Budgets of blocks: how far each is merged before the last join, and how regions divide the limits."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from alula.schemas.configs.merge import MergeConfig
from alula.schemas.errors import InfeasibleError

_FINER = 6.0  # hulls of all blocks over the final number
_FINER_AT_LAST = 2.5  # the same before the last join
_MARGIN = 4.0  # curves begin and end at this factor from the number of hulls by voxels
_FEW_HULLS = 64  # so many hulls of a block are always kept before its curve begins
_PLANES_PER_HULL, _BYTES_PER_HULL = 7, 20  # fewer than covers within such budgets have


def wanted_hulls(config: MergeConfig) -> int | None:
    """Number of hulls that the limits allow at most, roughly; None where only the growth is limited.

    Args:
        config: with the limits.
    """
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
    return _FINER * (_FINER_AT_LAST / _FINER) ** (level / max(1, last - 1))


def to_begin(config: MergeConfig, fraction: float) -> MergeConfig:
    """Configuration of the merge of a block up to where its curve begins.

    Args:
        config: of the whole.
        fraction: of the voxels that are in the block.
    """
    return _plain(config, fraction, _MARGIN * _FINER, _FEW_HULLS)


def to_end(config: MergeConfig, fraction: float, finer: float) -> MergeConfig:
    """Configuration of the merge that shows the curve of a block or a cube.

    Args:
        config: of the whole.
        fraction: of the voxels that it has.
        finer: see `finer_than_last`.
    """
    return _plain(config, fraction, finer / _MARGIN, 1)


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

    def merges(self, slope: float) -> int:
        """Number of merges after which the next ones add more than `slope` on average.

        Args:
            slope: increase of the sum of W per merge [voxels].
        """
        cost = self.excess - slope * np.arange(len(self.excess))
        return len(cost) - 1 - int(np.argmin(cost[::-1]))


def slope_for(config: MergeConfig, curves: Sequence[Curve], voxels: int, finer: float) -> float:
    """Slope at which all cubes have `finer` times the hulls of the limits, or that part of the growth.

    Every cube stops where the next merge adds the same volume, which is the greedy rule over all of them.

    Args:
        config: of the whole.
        curves: of all cubes.
        voxels: number of all voxels.
        finer: see `finer_than_last`; 1 for the limits themselves.
    """
    hulls = wanted_hulls(config)
    if hulls is not None:
        most = finer * hulls
        return _largest(lambda s: sum(c.hulls - c.merges(s) for c in curves) >= most)
    assert config.max_growth is not None
    room = (config.max_growth - 1) / finer * voxels
    return _largest(lambda s: sum(c.excess[c.merges(s)] for c in curves) <= room)


def divided(config: MergeConfig, curves: Sequence[Curve], voxels: Sequence[int]) -> list[MergeConfig]:
    """Configurations of the last merges of all regions, whose limits add up to those of the whole.

    Numbers of planes and bytes are divided like the hulls.

    Args:
        config: of the whole.
        curves: of the regions.
        voxels: numbers of voxels of the regions.

    Raises:
        InfeasibleError: there are more regions than hulls.
    """
    hulls = wanted_hulls(config)
    slope = slope_for(config, curves, sum(voxels), 1.0)
    if hulls is None:
        return [
            replace(config, block_m=None, max_growth=1 + float(curve.excess[curve.merges(slope)]) / count)
            for curve, count in zip(curves, voxels, strict=True)
        ]
    if hulls < len(curves):
        raise InfeasibleError(
            f"no cover within the limits: they allow about {hulls} hulls, but each of the {len(curves)} parts"
            " that are not joined needs one; relax a limit"
        )
    parts = _rounded([curve.hulls - curve.merges(slope) for curve in curves], hulls)
    return [
        replace(
            config,
            block_m=None,
            max_growth=None,
            hulls=None if config.hulls is None else part,
            max_planes=None if config.max_planes is None else config.max_planes * part // hulls,
            max_bytes=None if config.max_bytes is None else config.max_bytes * part // hulls,
        )
        for part in parts
    ]


def _largest(holds: Callable[[float], bool]) -> float:
    """Largest slope for which a monotonous condition holds; 0 where none does."""
    low, high = 0.0, 1e-6
    while holds(high) and high < 1e18:
        low, high = high, 4 * high
    for _ in range(50):
        middle = (low + high) / 2
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def _rounded(parts: Sequence[int], total: int) -> list[int]:
    """Whole numbers of at least 1 in proportion to `parts` whose sum is `total`."""
    exact = np.array(parts, np.float64) * total / sum(parts)
    whole = np.maximum(np.floor(exact).astype(np.int64), 1)
    while whole.sum() != total:
        gap = exact - whole
        if whole.sum() < total:
            whole[int(np.argmax(gap))] += 1
        else:
            gap[whole == 1] = np.inf
            whole[int(np.argmin(gap))] -= 1
    return [int(n) for n in whole]
