"""Budgets of blocks and regions: how many hulls each may keep before the last join and at the end."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from alula.schemas.artifact import Artifact
from alula.schemas.configs.merge import MergeConfig
from alula.schemas.errors import InfeasibleError

FINER = 6.0  # hulls of a block over its part of the final number
_FINER_AT_LAST = 2.5  # the same before the last join
_PLANES_PER_HULL, _BYTES_PER_HULL = 7, 20  # fewer than covers within such budgets have
_BEYOND = 4.0  # the curve of a region ends at this fraction of its part of the hulls, or of the growth


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


def finer_than_last(height: int, top: int) -> float:
    """Number of hulls after a join over the part of the final number: from `FINER` down, by equal factors.

    Args:
        height: 0 for blocks.
        top: height of the last join, larger than `height`.
    """
    return FINER * (_FINER_AT_LAST / FINER) ** (height / max(1, top - 1))


def intermediate(config: MergeConfig, fraction: float, finer: float) -> MergeConfig:
    """Configuration of a merge before the last one: hulls as they are, `finer` times as many as in the end.

    Args:
        config: of the whole.
        fraction: of the voxels that it covers.
        finer: factor of the number of hulls, and divisor of the growth; at least 1.
    """
    hulls, growth = wanted_hulls(config), None
    if hulls is not None:
        hulls = max(1, math.ceil(finer * fraction * hulls))
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
    """Merge curve of a region: sum of W against the number of hulls, which decreases."""

    hulls: NDArray[np.float64]
    excess: NDArray[np.float64]

    @classmethod
    def of(cls, cover: Artifact) -> Curve:
        """Curve that a cover records.

        Args:
            cover: an `alula/cover` that `merge` made.
        """
        curve = cover.manifest.certificate["curve"]  # type: ignore[attr-defined]
        excess = np.maximum.accumulate(np.array(curve["excess_sum_voxels"], np.float64))
        return cls(np.array(curve["hulls"], np.float64), excess)

    def at(self, slope: float) -> tuple[float, float]:
        """Hulls and excess where the next merge adds more than `slope` voxels on average.

        Args:
            slope: excess per merge [voxels].
        """
        cost = self.excess + slope * self.hulls
        best = len(cost) - 1 - int(np.argmin(cost[::-1]))
        return float(self.hulls[best]), float(self.excess[best])


def to_curve(config: MergeConfig, fraction: float) -> MergeConfig:
    """Configuration of the merge that shows the curve of a region beyond its part of the budget.

    Args:
        config: of the whole.
        fraction: of the voxels in the region.
    """
    hulls = wanted_hulls(config)
    if hulls is not None:
        return intermediate(config, fraction, 1 / _BEYOND)
    assert config.max_growth is not None
    return MergeConfig(
        max_growth=1 + _BEYOND * (config.max_growth - 1),
        facet_cap="none",
        method=config.method,
        cluster_radius=config.cluster_radius,
    )


def divided(config: MergeConfig, curves: Sequence[Curve], voxels: Sequence[int]) -> list[MergeConfig]:
    """Configurations of the last merges of all regions, whose limits add up to those of the whole.

    Every region stops where the next merge adds the same volume, which minimises the sum of W: the greedy
    rule over all regions. Numbers of planes and bytes are divided like the hulls.

    Args:
        config: of the whole.
        curves: of the regions.
        voxels: numbers of voxels of the regions.

    Raises:
        InfeasibleError: there are more regions than hulls, or a region would get less than one hull needs.
    """
    hulls = wanted_hulls(config)
    if hulls is None:
        assert config.max_growth is not None
        room = (config.max_growth - 1) * sum(voxels)
        slope = _largest(lambda s: sum(curve.at(s)[1] for curve in curves) <= room)
        return [
            replace(config, block_m=None, max_growth=1 + curve.at(slope)[1] / count)
            for curve, count in zip(curves, voxels, strict=True)
        ]
    if hulls < len(curves):
        raise InfeasibleError(
            f"no cover with {hulls} hulls: {len(curves)} regions are merged on their own and need one each;"
            " relax the limit"
        )
    slope = _largest(lambda s: sum(curve.at(s)[0] for curve in curves) >= hulls)
    parts = _rounded([curve.at(slope)[0] for curve in curves], hulls)
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
    """Largest slope for which a monotonous condition holds, within a thousandth; 0 where none does."""
    low, high = 0.0, 1e-6
    while holds(high) and high < 1e18:
        low, high = high, 4 * high
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def _rounded(parts: Sequence[float], total: int) -> list[int]:
    """Whole numbers of at least 1 in proportion to `parts` whose sum is `total`."""
    exact = np.array(parts) * total / sum(parts)
    whole = np.maximum(np.floor(exact).astype(np.int64), 1)
    while whole.sum() != total:
        gap = exact - whole
        if whole.sum() < total:
            whole[int(np.argmax(gap))] += 1
        else:
            gap[whole == 1] = np.inf
            whole[int(np.argmin(gap))] -= 1
    return [int(n) for n in whole]
