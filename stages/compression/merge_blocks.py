"""The stage `merge` by blocks: cover blocks of voxels on their own, then join their hulls level by level."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import msgspec
import numpy as np

from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.manifest import CoverManifest, Manifest, VoxelsManifest, level_fields
from alula.schemas.artifacts.parts import Parts
from alula.schemas.errors import InfeasibleError, InputError
from alula.schemas.parameters.configs.merge import MergeConfig
from alula.schemas.progress import Progress
from alula.stages.compression.block_budgets import (
    Curve,
    divided,
    finer_than_last,
    merges_of,
    to_begin,
    to_end,
)
from alula.stages.compression.block_sets import BlockTask, last_cover, sets_of
from alula.stages.compression.block_tree import (
    Node,
    Place,
    block_rows,
    blocks_of,
    chosen_edge,
    edge_of,
    regions_of,
)
from alula.stages.compression.limits import MERGE_VOXELS
from alula.stages.compression.merge import cover_guarantee, require_possible
from alula.stages.distribute import distribute
from alula.stages.progress import WHOLE

_JOIN_SHARE = 0.15  # time of a join over that of covering the same voxels


class CoverStore:
    """Finished covers of blocks and of cubes of blocks by (level, x, y, z), of regions by (number,).

    They are kept in memory; a class that is derived may keep them elsewhere.
    """

    def __init__(self) -> None:
        self._covers: dict[tuple[int, ...], Artifact] = {}

    def has(self, key: tuple[int, ...]) -> bool:
        """Whether there is an undamaged cover."""
        return key in self._covers

    def get(self, key: tuple[int, ...]) -> Artifact:
        """Return a cover that is there."""
        return self._covers[key]

    def put(self, key: tuple[int, ...], cover: Artifact) -> None:
        """Keep a cover."""
        self._covers[key] = cover

    def drop(self, key: tuple[int, ...]) -> None:
        """Forget a cover that is not needed any more."""
        self._covers.pop(key, None)


@dataclass(frozen=True, slots=True)
class BlockPlan:
    """Division of voxels into blocks and regions.

    Attributes:
        edge: of a block [voxels].
        regions: cubes of blocks that are joined; each becomes a cover of its own.
        lowest: lowest place of all blocks, from which cubes are counted.
    """

    parts: Parts
    edge: int
    regions: list[Node]
    lowest: Place
    blocks: int

    @property
    def voxels(self) -> int:
        """Number of voxels."""
        return sum(region.voxels for region in self.regions)

    def domain(self, number: int) -> list[list[int]]:
        """Lowest and highest voxel of a region's cube."""
        region = self.regions[number]
        edge = self.edge * 2**region.level
        low = [(a + p * 2**region.level) * self.edge for a, p in zip(self.lowest, region.place, strict=True)]
        return [low, [min(c + edge - 1, 2**31 - 1) for c in low]]

    def summary(self) -> dict[str, Any]:
        """Figures of the division for a manifest."""
        size = float(self.parts.manifest.voxel_size_m)  # type: ignore[attr-defined]
        return {
            "block_m": self.edge * size,
            "blocks": self.blocks,
            "levels": max(region.height for region in self.regions),
            "regions": len(self.regions),
        }


def plan_blocks(config: MergeConfig, parts: Parts) -> BlockPlan | None:
    """Divide voxels into blocks; None where `merge` covers them at once.

    Args:
        config: see `MergeConfig`; without `block_m`, only more than `MERGE_VOXELS` voxels are divided, into
            blocks whose edge depends on the voxels alone.

    Raises:
        InputError: there is no voxel, one lies too far from the origin, or a block has too many.
    """
    assert isinstance(parts.manifest, VoxelsManifest)
    total = sum(len(parts[number]["index"]) for number in range(len(parts)))
    if total == 0:
        raise InputError("there is no occupied voxel to cover")
    if config.block_m is not None:
        edge = edge_of(config.block_m, parts.manifest.voxel_size_m)
    elif total > MERGE_VOXELS:
        edge = chosen_edge(parts)
    else:
        return None
    blocks = blocks_of(parts, edge)
    regions, lowest = regions_of(blocks, join=not config.per_block)
    return BlockPlan(parts, edge, regions, lowest, len(blocks))


def merge_blocks(
    config: MergeConfig,
    plan: BlockPlan,
    *,
    jobs: int = 0,
    scheduler: str | None = None,
    store: CoverStore | None = None,
    progress: Progress | None = None,
) -> Iterator[Artifact]:
    """Cover voxels block by block; yields the cover of each region, in their order.

    Guarantee: as of `merge`. Every voxel belongs to exactly one block, floor(index / edge), and every hull to
    one region, whose cube contains it.

    Each block is merged on its own, further than needed, and its merges are recorded. All blocks then stop
    where the next merge adds the same volume, such that all together have some times the final number of
    hulls: what the greedy rule would do without borders. The sets of 2 x 2 x 2 cubes are merged further
    together, level by level, stopping in the same way at fewer and fewer hulls, and those of a region to its
    limits. As a block is convex, its hulls do not leave it: their W does not depend on the voxels of other
    blocks. A single block is merged as without blocks, to the bit. Several regions divide the limits where
    the next merge of each adds the same volume; with `per_block` every block is a region with the limits of
    the whole.

    Args:
        plan: see `plan_blocks`; the result depends on the voxels and on its edge alone.
        jobs: processes, 0 for all processors; a single cover is merged with this number of threads.
        scheduler: address of a `dask.distributed` scheduler, instead of processes of this machine.
        store: of finished covers, those of an interrupted run of the same merge among them.

    Raises:
        InputError: two parts of the voxels have the same voxel.
        InfeasibleError: the limits contradict each other.
        UsageError, LinkError: see `distribute`.
    """
    require_possible(config)
    store = CoverStore() if store is None else store
    work = _Work(config, plan, jobs, scheduler, store, progress)
    missing = [number for number in range(len(plan.regions)) if not store.has((number,))]
    regions = [plan.regions[number] for number in missing]
    if missing:
        if not config.per_block:
            work.rise()
        for number, cover in zip(missing, work.run(last_cover, work.last(missing), regions), strict=True):
            summary = {**cover.manifest.summary, **plan.summary()}
            manifest = msgspec.structs.replace(cover.manifest, summary=summary)
            store.put((number,), Artifact(manifest, cover.arrays))
    _check_growth(config, [store.get((number,)).manifest for number in range(len(plan.regions))])
    yield from (store.get((number,)) for number in range(len(plan.regions)))


def whole_fields(config: MergeConfig, plan: BlockPlan, parts: Sequence[Manifest]) -> dict[str, Any]:
    """Fields of the manifest of a cover in parts."""
    manifests = [each for each in parts if isinstance(each, CoverManifest)]
    first = manifests[0]
    growth = _growth(manifests)
    sums = ("voxels", "hulls", "half_planes", "vertices", "onboard_bytes", "geometry_bytes")
    summary: dict[str, Any] = {name: sum(each.summary[name] for each in manifests) for name in sums}
    most = "most_half_planes_of_a_hull"
    summary |= {most: max(each.summary[most] for each in manifests), "conservativeness": growth}
    return level_fields(first) | {
        "frame": first.frame,
        "unit": first.unit,
        "summary": summary | plan.summary(),
        "guarantee": cover_guarantee(first.guarantee, plan.voxels, is_outer=first.polytopes == "outer"),
        "polytopes": first.polytopes,
        "requires": first.requires,
        "conservativeness": growth,
        "certificate": {"containment": first.certificate["containment"]},
    }


class _Work:
    """Merges on workers, and the sets that are finished."""

    def __init__(
        self,
        config: MergeConfig,
        plan: BlockPlan,
        jobs: int,
        scheduler: str | None,
        store: CoverStore,
        progress: Progress | None,
    ) -> None:
        self._config, self._plan, self._store = config, plan, store
        self._jobs, self._scheduler, self._progress = jobs, scheduler, progress
        self._last = max(region.level for region in plan.regions) + (len(plan.regions) > 1)
        self._merges: dict[tuple[int, ...], int] = {}  # of the cubes below, which are joined after them
        self._curves: dict[tuple[int, ...], Curve] = {}
        self._done, self._total = 0.0, plan.voxels * (1 + _JOIN_SHARE * (1 + self._last))

    def rise(self) -> None:
        """Make the sets of all cubes below the last merges, level by level."""
        levels = range(self._last)
        finished = [level for level in levels if all(map(self._has, self._active(level)))]
        for level in levels[max(finished, default=0) :]:
            finer = finer_than_last(level, self._last)
            missing = [node for node in self._active(level) if not self._has(node)]
            if level == 0:
                missing.sort(key=lambda node: node.place)  # the order of the voxels
            results = self.run(sets_of, self._tasks(missing, finer), missing)
            for node, sets in zip(missing, results, strict=True):
                self._store.put(_key(node), sets)
            cubes = self._active(level)
            curves = [self._curve(node) for node in cubes]
            merges = merges_of(self._config, curves, self._plan.voxels, finer)
            self._merges = dict(zip(map(_key, cubes), merges, strict=True))
            for node in self._active(level):  # not before all are there, because all share the limits
                for child in node.children:
                    self._store.drop(_key(child))

    def _has(self, node: Node) -> bool:
        return self._store.has(_key(node))

    def _active(self, level: int) -> list[Node]:
        """The largest cubes up to a level; together they have all voxels."""

        def largest(node: Node) -> Iterator[Node]:
            if node.level <= level:
                yield node
            else:
                for child in node.children:
                    yield from largest(child)

        return [node for region in self._plan.regions for node in largest(region)]

    def _curve(self, node: Node) -> Curve:
        if (key := _key(node)) not in self._curves:
            sets = self._store.get(key)
            first = float(sets.manifest.summary["excess_voxels"])
            excess = first + np.concatenate([[0.0], np.cumsum(sets["history"][:, 2])])
            self._curves[key] = Curve(len(sets["member_start"]) - 1, excess)
        return self._curves[key]

    def _tasks(self, nodes: Sequence[Node], finer: float) -> Iterator[BlockTask]:
        fraction, regions = {n: n.voxels / self._plan.voxels for n in nodes}, {*self._plan.regions}
        blocks = [node for node in nodes if not node.children]
        rows = block_rows(self._plan.parts, self._plan.edge, _places(self._plan, blocks))
        for node in nodes:
            end = to_end(self._config, fraction[node], 1.0 if node in regions else finer)
            if node.children:
                yield self._joined(end, node.children)
            else:
                yield replace(
                    self._of_voxels(end, next(rows)[1]), begin=to_begin(self._config, fraction[node])
                )

    def last(self, numbers: Sequence[int]) -> Iterator[BlockTask]:
        """Last merges of regions."""
        regions = self._plan.regions
        if self._last == 0 or self._config.per_block:
            wanted = _places(self._plan, [regions[number] for number in numbers])
            for _, index in block_rows(self._plan.parts, self._plan.edge, wanted):
                yield self._of_voxels(self._config, index)
        elif len(regions) == 1:
            yield self._joined(self._config, regions[0].children)
        else:
            voxels = [region.voxels for region in regions]
            limits = divided(self._config, [self._curve(region) for region in regions], voxels)
            for number in numbers:
                yield self._joined(limits[number], [regions[number]], is_last=True)

    def _of_voxels(self, config: MergeConfig, index: Any) -> BlockTask:
        return BlockTask(config, msgspec.structs.replace(self._plan.parts.manifest, arrays={}), index=index)

    def _joined(self, config: MergeConfig, nodes: Sequence[Node], *, is_last: bool = False) -> BlockTask:
        """Merge of the sets of cubes together, after their own merges."""
        sets, manifest = [], self._plan.parts.manifest
        for node in nodes:
            one = self._store.get(_key(node))
            merges = 0 if is_last else self._merges[_key(node)]
            sets.append((one["member_index"], one["member_start"], one["history"][:merges]))
            manifest = one.manifest
        return BlockTask(config, msgspec.structs.replace(manifest, arrays={}), sets=tuple(sets))

    def run(
        self, function: Callable[[BlockTask], Artifact], tasks: Iterable[BlockTask], nodes: Sequence[Node]
    ) -> Iterator[Artifact]:
        """Results of tasks, one for each node, in order."""
        results: Iterator[Artifact]
        if self._scheduler is None and (len(nodes) == 1 or self._jobs == 1):
            threads = self._jobs if len(nodes) == 1 else 1
            results = (function(replace(task, jobs=threads)) for task in tasks)
        else:
            results = distribute(function, tasks, jobs=self._jobs, processes=True, scheduler=self._scheduler)
        for node, result in zip(nodes, results, strict=True):
            self._done += node.voxels * (_JOIN_SHARE if node.children else 1)
            if self._progress is not None:
                self._progress(int(WHOLE * min(self._done / self._total, 1)), WHOLE)
            yield result


def _key(node: Node) -> tuple[int, ...]:
    return (node.level, *node.place)


def _places(plan: BlockPlan, nodes: Iterable[Node]) -> dict[Place, int]:
    """Places of blocks in the grid of all blocks, from their nodes."""
    x, y, z = plan.lowest
    return {(n.place[0] + x, n.place[1] + y, n.place[2] + z): n.voxels for n in nodes}


def _growth(parts: Sequence[CoverManifest]) -> float:
    """Volume of the union over that of the voxels; hulls of different regions do not overlap."""
    voxels = [each.summary["voxels"] for each in parts]
    excess = sum((each.conservativeness - 1) * count for each, count in zip(parts, voxels, strict=True))
    return float(1 + excess / sum(voxels))


def _check_growth(config: MergeConfig, parts: Sequence[Manifest]) -> None:
    growth = _growth([each for each in parts if isinstance(each, CoverManifest)])
    if config.max_growth is not None and growth > config.max_growth:
        raise InfeasibleError(
            f"the cover grows the voxels by {growth:.6g}, more than {config.max_growth:g}; relax a limit"
        )
