"""Blocks of voxels on the lattice, and the order in which their covers are joined."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from alula.schemas.artifacts.parts import Parts
from alula.schemas.errors import InputError
from alula.stages.compression.limits import LATTICE_LIMIT, require_near

Place = tuple[int, int, int]

BLOCK_VOXELS = 2**20  # of a block whose edge is chosen: at most 2.7 GB while it is merged
REGION_VOXELS = 2**23  # of blocks that are joined to one cover, by the memory of the last join
_FINEST = 16  # edge of the cells that chosen blocks consist of [voxels]
_KEY = np.array([2**42, 2**21, 1])
_AT_ONCE = 2**22  # rows that are assigned to blocks together


@dataclass(frozen=True, slots=True)
class Block:
    """A block: its place in the grid, and its number of voxels."""

    place: Place
    voxels: int


@dataclass(frozen=True, slots=True)
class Node:
    """A cube of blocks whose covers are joined to one; a leaf is one block.

    Attributes:
        level: it has 2^level blocks along an edge.
        place: in the grid of cubes of its size, counted from the lowest place of all blocks.
        height: longest way down to a leaf.
        children: the cubes that are joined; empty for a leaf.
    """

    level: int
    place: Place
    voxels: int
    height: int = 0
    children: tuple[Node, ...] = field(default=())

    def nodes(self) -> Iterator[Node]:
        """This node and all below it."""
        yield self
        for child in self.children:
            yield from child.nodes()


def edge_of(block_m: float, voxel_size_m: float) -> int:
    """Edge of a block in voxels: the nearest whole number, at least 1.

    Args:
        block_m: wanted edge [m].
    """
    return max(1, round(block_m / voxel_size_m))


def blocks_of(parts: Parts, edge: int) -> list[Block]:
    """Blocks that have voxels, by their place. Block b has the voxels v with floor(v / edge) = b.

    Args:
        edge: of a block [voxels].

    Raises:
        InputError: a voxel lies more than 2^20 voxels from the origin.
    """
    count: dict[Place, int] = {}
    for part in _each(parts):
        for begin in range(0, len(part), _AT_ONCE):
            require_near(part[begin : begin + _AT_ONCE])
            _count(np.floor_divide(part[begin : begin + _AT_ONCE], edge), count)
    return [Block(place, count[place]) for place in sorted(count)]


def chosen_edge(parts: Parts, most: int = BLOCK_VOXELS) -> int:
    """Largest power of two, at least 16, with which no block has more than `most` voxels."""
    cells, edge = {block.place: block.voxels for block in blocks_of(parts, _FINEST)}, _FINEST
    while len(cells) > 1:
        coarser: dict[Place, int] = {}
        for place, voxels in cells.items():
            half = _half(place)
            coarser[half] = coarser.get(half, 0) + voxels
        if max(coarser.values()) > most or len(coarser) == len(cells):
            break
        cells, edge = coarser, 2 * edge
    return edge


def regions_of(
    blocks: Sequence[Block], most: int = REGION_VOXELS, *, join: bool = True
) -> tuple[list[Node], Place]:
    """Largest cubes of blocks with at most `most` voxels each, with the cubes in them; and the lowest place.

    A cube of level k consists of 2^k x 2^k x 2^k places, counted from the lowest place of all. Cubes with one
    child only are left out.

    Args:
        join: join blocks; else each is a region.

    Raises:
        InputError: a block has more voxels.
    """
    if (largest := max(block.voxels for block in blocks)) > most:
        raise InputError(f"a block has {largest:,} voxels, but memory limits it to {most:,}; smaller --block")
    x0, y0, z0 = np.min([block.place for block in blocks], axis=0).tolist()
    level: dict[Place, Node] = {}
    for block in blocks:
        place = (block.place[0] - x0, block.place[1] - y0, block.place[2] - z0)
        level[place] = Node(0, place, block.voxels)
    regions: list[Node] = []
    number = 0
    while join and len(level) > 1:
        number += 1
        groups: dict[Place, list[Node]] = {}
        for place in sorted(level):
            groups.setdefault(_half(place), []).append(level[place])
        above: dict[Place, Node] = {}
        for place, children in groups.items():
            voxels = sum(child.voxels for child in children)
            if voxels > most:
                regions += children
            elif len(children) == 1:
                above[place] = children[0]
            else:
                height = 1 + max(child.height for child in children)
                above[place] = Node(number, place, voxels, height, tuple(children))
        level = above
    return regions + [level[place] for place in sorted(level)], (x0, y0, z0)


def block_rows(
    parts: Parts, edge: int, wanted: Mapping[Place, int]
) -> Iterator[tuple[Place, NDArray[np.int32]]]:
    """Sorted voxels of each wanted block, shape (M, 3), one layer of blocks in memory at a time.

    Args:
        edge: of a block [voxels].
        wanted: places in ascending order, and their numbers of voxels.

    Raises:
        InputError: two parts have the same voxel.
    """
    assert list(wanted) == sorted(wanted)
    layers: dict[int, list[Place]] = {}
    for place in wanted:
        layers.setdefault(place[0], []).append(place)
    for layer, places in layers.items():
        rows = [_between(part, layer * edge, (layer + 1) * edge) for part in _each(parts)]
        rows = [some for some in rows if len(some)]
        index = np.ascontiguousarray(np.concatenate(rows), np.int32)
        block = np.floor_divide(index[:, 1:], edge)
        order = np.lexsort((*index.T[::-1], block[:, 1], block[:, 0]))
        index, block = index[order], block[order]
        if (index[1:] == index[:-1]).all(axis=1).any():
            raise InputError("two parts of the voxels have the same voxel")
        starts = np.flatnonzero(np.r_[True, (block[1:] != block[:-1]).any(axis=1)])
        at = {
            (int(block[b, 0]), int(block[b, 1])): (b, e)
            for b, e in zip(starts.tolist(), [*starts[1:].tolist(), len(index)], strict=True)
        }
        for place in places:
            begin, end = at[place[1:]]
            yield place, index[begin:end]


def _each(parts: Parts) -> Iterator[NDArray[np.int32]]:
    return (parts[number]["index"] for number in range(len(parts)))


def _between(index: NDArray[np.int32], low: int, high: int) -> NDArray[np.int32]:
    """Rows with low <= x < high of sorted voxels, without reading the others."""
    begin, end = (bisect_left(range(len(index)), x, key=lambda i: int(index[i, 0])) for x in (low, high))
    return index[begin:end]


def _count(places: NDArray[np.int32], count: dict[Place, int]) -> None:
    key = (places.astype(np.int64) + LATTICE_LIMIT) @ _KEY
    _, first, numbers = np.unique(key, return_index=True, return_counts=True)
    for (x, y, z), number in zip(places[first].tolist(), numbers.tolist(), strict=True):
        count[x, y, z] = count.get((x, y, z), 0) + number


def _half(place: Place) -> Place:
    x, y, z = place
    return x // 2, y // 2, z // 2
