"""Cubes of the lattice that are voxelized one by one, and counts over all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.stages.compression.tiles import Box, Corner, Cube


@dataclass(frozen=True, slots=True)
class Block:
    """A cube of the lattice that Gaussians may touch.

    Attributes:
        number: rank among all blocks in lexicographic order of their lowest voxels.
        rows: for each part that touches the block its number, and where its rows begin and end in the
            list of the rows of all blocks.
    """

    number: int
    lower: Corner
    upper: Corner
    rows: tuple[tuple[int, int, int], ...]

    @property
    def domain(self) -> Cube:
        """Lowest and highest voxel."""
        return self.lower, self.upper


@dataclass(slots=True)
class Tally:
    """Counts over all blocks and parts.

    Attributes:
        retained: of at least the minimum opacity.
        below: touched voxels left out because of `min_overlap`.
        max_overlap: maximum overlap of all touched voxels.
        lower: lowest marked voxel along each axis.
        upper: highest one.
        largest: volume of the largest ellipsoid [voxels], its longest semi-axis [m], its part and its row.
        reach: effect of each retained ellipsoid, as in `Marked`, by part; only with a crop.
    """

    gaussians: int = 0
    retained: int = 0
    below: int = 0
    max_overlap: int = 0
    voxels: int = 0
    overlaps: int = 0
    lower: list[int] = field(default_factory=lambda: [2**31] * 3)
    upper: list[int] = field(default_factory=lambda: [-(2**31)] * 3)
    largest: tuple[float, float, int, int] = (0.0, 0.0, 0, 0)
    reach: dict[int, NDArray[np.uint8]] = field(default_factory=dict)

    def add(self, index: NDArray[np.int32], overlap: NDArray[np.uint32], below: int) -> None:
        """Count the voxels of a block.

        Args:
            index: marked voxels, shape (M, 3).
        """
        self.below += below
        if len(index):
            self.voxels += len(index)
            self.overlaps += int(overlap.sum(dtype=np.uint64))
            self.max_overlap = max(self.max_overlap, int(overlap.max()))
            self.lower = np.minimum(self.lower, index.min(axis=0)).tolist()
            self.upper = np.maximum(self.upper, index.max(axis=0)).tolist()


def figures_of(tally: Tally, size: float) -> dict[str, Any]:
    """Figures of voxels of an edge [m] for a summary."""
    return {
        "voxels": tally.voxels,
        "dropped_by_min_overlap": tally.below,
        "volume_m3": tally.voxels * size**3,
        "mean_overlap": tally.overlaps / max(tally.voxels, 1),
        "max_overlap": tally.max_overlap,
        "lower_m": [c * size for c in tally.lower],
        "upper_m": [(c + 1) * size for c in tally.upper],
    }


def crop_of(block: Block, size: float, crop: Sequence[float] | None) -> Box:
    """Box that touches the voxels of a block that touch a crop, and no others.

    It ends a quarter of a voxel inside of the block, as closed voxels touch the faces of their neighbours.

    Args:
        size: edge of a voxel [m].
        crop: box that a marked voxel must touch [m]; None for all of space.
    """
    lower, upper = [], []
    for axis in range(3):
        low, high = (block.lower[axis] + 0.25) * size, (block.upper[axis] + 0.75) * size
        if crop is not None:
            inner = (block.lower[axis] + 0.5) * size, (block.upper[axis] + 0.5) * size
            low = min(max(low, crop[axis]), inner[1])
            high = max(min(high, crop[axis + 3]), inner[0])
        lower.append(low)
        upper.append(high)
    return lower[0], lower[1], lower[2], upper[0], upper[1], upper[2]


def along_a_curve(blocks: Sequence[Block]) -> list[Block]:
    """Blocks in the order of a Z-order curve, along which the parts of the scene change seldom.

    Args:
        blocks: in any order.
    """
    if not blocks:
        return []
    lowest = np.min([block.lower for block in blocks], axis=0)
    edge = min(high - low + 1 for block in blocks for low, high in zip(block.lower, block.upper, strict=True))

    def place(block: Block) -> int:
        cell = [(c - low) // edge for c, low in zip(block.lower, lowest.tolist(), strict=True)]
        bits = range(max(max(cell).bit_length(), 1))
        return sum(((c >> bit) & 1) << (3 * bit + axis) for axis, c in enumerate(cell) for bit in bits)

    return sorted(blocks, key=place)
