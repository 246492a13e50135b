"""The stage `merge` by blocks: cover blocks of voxels on their own, then join their hulls level by level."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import msgspec
import numpy as np

from alula.schemas.artifact import Artifact
from alula.schemas.configs.merge import MergeConfig
from alula.schemas.errors import InfeasibleError, InputError
from alula.schemas.manifest import CoverManifest, Guarantee, Manifest, VoxelsManifest
from alula.schemas.progress import Progress
from alula.stages.compression.block_budgets import (
    Curve,
    divided,
    finer_than_last,
    intermediate,
    to_curve,
)
from alula.stages.compression.block_tree import (
    Node,
    Place,
    VoxelParts,
    block_rows,
    blocks_of,
    chosen_edge,
    edge_of,
    regions_of,
)
from alula.stages.compression.limits import MERGE_VOXELS
from alula.stages.compression.merge import merge
from alula.stages.distribute import distribute
from alula.stages.progress import WHOLE

_JOIN_SHARE = 0.15  # time of a join over that of covering the same voxels


class CoverStore(Protocol):
    """Finished covers of blocks and of cubes of blocks, by (level, x, y, z)."""

    def has(self, key: tuple[int, ...]) -> bool:
        """Whether there is an undamaged cover."""
        ...

    def get(self, key: tuple[int, ...]) -> Artifact:
        """Return a cover that is there."""
        ...

    def put(self, key: tuple[int, ...], cover: Artifact) -> None:
        """Keep a cover."""
        ...

    def drop(self, key: tuple[int, ...]) -> None:
        """Forget a cover that is not needed any more."""
        ...


class MemoryStore:
    """Covers in memory."""

    def __init__(self) -> None:
        self._covers: dict[tuple[int, ...], Artifact] = {}

    def has(self, key: tuple[int, ...]) -> bool:
        """See `CoverStore`."""
        return key in self._covers

    def get(self, key: tuple[int, ...]) -> Artifact:
        """See `CoverStore`."""
        return self._covers[key]

    def put(self, key: tuple[int, ...], cover: Artifact) -> None:
        """See `CoverStore`."""
        self._covers[key] = cover

    def drop(self, key: tuple[int, ...]) -> None:
        """See `CoverStore`."""
        self._covers.pop(key, None)


@dataclass(frozen=True, slots=True)
class BlockPlan:
    """Division of voxels into blocks and regions.

    Attributes:
        parts: the voxels.
        edge: of a block [voxels].
        regions: cubes of blocks that are joined; each becomes a cover of its own.
        lowest: lowest place of all blocks, from which cubes are counted.
        blocks: number of blocks.
    """

    parts: VoxelParts
    edge: int
    regions: list[Node]
    lowest: Place
    blocks: int

    @property
    def voxels(self) -> int:
        """Number of voxels."""
        return sum(region.voxels for region in self.regions)

    def domain(self, number: int) -> list[list[int]]:
        """Lowest and highest voxel of a region's cube.

        Args:
            number: of the region.
        """
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


def plan_blocks(config: MergeConfig, parts: VoxelParts) -> BlockPlan | None:
    """Divide voxels into blocks; None where `merge` covers them at once.

    Args:
        config: see `MergeConfig`; without `block_m`, only more than `MERGE_VOXELS` voxels are divided, into
            blocks whose edge depends on the voxels alone.
        parts: the voxels.

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

    Each block is covered by `merge` down to `FINER` times its part of the final number of hulls, by voxels.
    Then the hulls of up to 2 x 2 x 2 cubes are merged together, level by level, to fewer and fewer, and the
    hulls of a region to its limits. As a block is convex, its hulls do not leave it: their W does not depend
    on the voxels of other blocks. A single block is merged as without blocks, to the bit. Several regions
    divide the limits so that the next merge of each adds the same volume; with `per_block` every block is a
    region with the limits of the whole.

    Args:
        config: see `MergeConfig`.
        plan: see `plan_blocks`; the result depends on the voxels and on its edge alone.
        jobs: processes, 0 for all processors; a single cover is merged with this number of threads.
        scheduler: address of a `dask.distributed` scheduler, instead of processes of this machine.
        store: of finished covers, those of an interrupted run of the same merge among them.
        progress: called with (done, total) from time to time.

    Raises:
        InputError: two parts of the voxels have the same voxel.
        InfeasibleError: the limits contradict each other.
        UsageError, LinkError: see `distribute`.
    """
    store = MemoryStore() if store is None else store
    work = _Work(config, plan, jobs, scheduler, store, progress)
    missing = [number for number in range(len(plan.regions)) if not store.has((number,))]
    regions = [plan.regions[number] for number in missing]
    if missing:
        if not config.per_block:
            for height in range(1 + max(region.height for region in plan.regions)):
                work.cover([node for node in work.missing() if node.height == height])
        limits = work.limits()
        tasks = work.last(regions, [limits[number] for number in missing])
        for number, cover in zip(missing, work.run(tasks, regions), strict=True):
            summary = {**cover.manifest.summary, **plan.summary()}
            manifest = msgspec.structs.replace(cover.manifest, summary=summary)
            store.put((number,), Artifact(manifest, cover.arrays))
    _check_growth(config, [store.get((number,)).manifest for number in range(len(plan.regions))])
    yield from (store.get((number,)) for number in range(len(plan.regions)))


def whole_fields(config: MergeConfig, plan: BlockPlan, parts: Sequence[Manifest]) -> dict[str, Any]:
    """Fields of the manifest of a cover in parts.

    Args:
        config: of the whole.
        plan: the division.
        parts: manifests of the covers of all regions, in their order.
    """
    manifests = [each for each in parts if isinstance(each, CoverManifest)]
    first = manifests[0]
    growth = _growth(manifests)
    assert first.guarantee is not None
    _, mark, rest = first.guarantee.statement.partition("exactly, in integers.")
    kind = "an outer polytope" if first.polytopes == "outer" else "a hull"
    claims = {**first.guarantee.claims, "covered_voxels": plan.voxels, "uncovered_voxels": 0}
    sums = ("voxels", "hulls", "half_planes", "vertices", "onboard_bytes", "geometry_bytes")
    summary: dict[str, Any] = {name: sum(each.summary[name] for each in manifests) for name in sums}
    most = "most_half_planes_of_a_hull"
    summary |= {most: max(each.summary[most] for each in manifests), "conservativeness": growth}
    level = {name: getattr(first, name) for name in VoxelsManifest.__struct_fields__ if name in _LEVEL}
    statement = f"Each of the {plan.voxels} occupied voxels lies in {kind} that lists it as a member, {mark}"
    return level | {
        "frame": first.frame,
        "unit": first.unit,
        "summary": summary | plan.summary(),
        "guarantee": Guarantee(statement + rest, claims),
        "polytopes": first.polytopes,
        "requires": first.requires,
        "conservativeness": growth,
        "certificate": {"containment": first.certificate["containment"]},
    }


_LEVEL = ("voxel_size_m", "sigma", "min_overlap", "inflation_m", "crop", "min_opacity", "ignore_loss")


@dataclass(frozen=True, slots=True)
class _Task:
    """A merge for a worker: of voxels, or of the hulls of several covers together."""

    config: MergeConfig
    manifest: Manifest
    index: tuple[Any, ...]  # of the voxels, or members of each cover
    start: tuple[Any, ...] = ()  # of the members
    jobs: int = 1


def _cover(task: _Task) -> Artifact:
    """Merge in a worker."""
    arrays: Mapping[str, Any] = {"index": task.index[0]}
    if task.start:
        ends = np.cumsum([0, *(start[-1] for start in task.start)])
        starts = [start[:-1] + end for start, end in zip(task.start, ends, strict=False)]
        arrays = {
            "member_index": np.concatenate(task.index),
            "member_start": np.concatenate([*starts, ends[-1:]]).astype(np.int64),
        }
    return merge(task.config, Artifact(task.manifest, arrays), jobs=task.jobs)


def _cover_before_last(task: _Task) -> Artifact:
    """Merge in a worker; where already the start grows more than allowed, without merging."""
    try:
        return _cover(task)
    except InfeasibleError:
        most = sum(len(index) for index in task.index)
        return _cover(replace(task, config=replace(task.config, hulls=most, max_growth=None)))


class _Work:
    """Merges on workers, and the covers that are finished."""

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
        self._top = {
            node: region.height + (len(plan.regions) > 1)
            for region in plan.regions
            for node in region.nodes()
        }
        joins = 2 + max(region.height for region in plan.regions)
        self._done, self._total = 0.0, plan.voxels * (1 + _JOIN_SHARE * joins)

    def missing(self) -> list[Node]:
        """Cubes that must be covered before the last merges, in their order."""

        def below(node: Node) -> Iterator[Node]:
            if self._top[node] == node.height or not self._store.has(_key(node)):
                for child in node.children:
                    yield from below(child)
                if self._top[node] > node.height:
                    yield node

        return [node for region in self._plan.regions for node in below(region)]

    def cover(self, nodes: Sequence[Node]) -> None:
        """Cover cubes of one height, whose children are covered, and keep the covers."""
        tasks: Iterable[_Task]
        if nodes and nodes[0].height == 0:
            nodes = sorted(nodes, key=lambda node: node.place)
            rows = block_rows(self._plan.parts, self._plan.edge, _places(self._plan, nodes))
            tasks = (
                self.of_voxels(self._before_last(node), index)
                for node, (_, index) in zip(nodes, rows, strict=True)
            )
        else:
            tasks = (self.of_covers(self._before_last(node), node) for node in nodes)
        for node, cover in zip(nodes, self.run(tasks, nodes, _cover_before_last), strict=True):
            self._store.put(_key(node), cover)
            for child in node.children:
                self._store.drop(_key(child))

    def _before_last(self, node: Node) -> MergeConfig:
        finer = finer_than_last(node.height, self._top[node])
        return intermediate(self._config, node.voxels / self._plan.voxels, finer)

    def limits(self) -> list[MergeConfig]:
        """Configurations of the last merges of all regions."""
        regions, whole = self._plan.regions, self._plan.voxels
        if len(regions) == 1 or self._config.per_block:
            return [self._config] * len(regions)
        shown = [to_curve(self._config, region.voxels / whole) for region in regions]
        curves = [Curve.of(cover) for cover in self.run(map(self.of_covers, shown, regions), regions)]
        return divided(self._config, curves, [region.voxels for region in regions])

    def last(self, regions: Sequence[Node], limits: Sequence[MergeConfig]) -> Iterator[_Task]:
        """Last merges of regions."""
        if all(region.height == 0 and not self._store.has(_key(region)) for region in regions):
            rows = block_rows(self._plan.parts, self._plan.edge, _places(self._plan, regions))
            return (self.of_voxels(config, index) for config, (_, index) in zip(limits, rows, strict=True))
        return map(self.of_covers, limits, regions)

    def of_voxels(self, config: MergeConfig, index: Any) -> _Task:
        """Merge of the voxels of a block."""
        return _Task(config, msgspec.structs.replace(self._plan.parts.manifest, arrays={}), (index,))

    def of_covers(self, config: MergeConfig, node: Node) -> _Task:
        """Merge of the covers of the children of a cube, or of its own cover where it has one."""
        own = self._store.has(_key(node))
        covers = [self._store.get(_key(each)) for each in ([node] if own else node.children)]
        index, start = ([cover[name] for cover in covers] for name in ("member_index", "member_start"))
        manifest = msgspec.structs.replace(covers[0].manifest, arrays={})
        return _Task(config, manifest, tuple(index), tuple(start))

    def run(
        self,
        tasks: Iterable[_Task],
        nodes: Sequence[Node],
        function: Callable[[_Task], Artifact] = _cover,
    ) -> Iterator[Artifact]:
        """Covers of tasks, one for each node, in order."""
        results: Iterator[Artifact]
        if self._scheduler is None and (len(nodes) == 1 or self._jobs == 1):
            threads = self._jobs if len(nodes) == 1 else 1
            results = (function(replace(task, jobs=threads)) for task in tasks)
        else:
            results = distribute(function, tasks, jobs=self._jobs, processes=True, scheduler=self._scheduler)
        for node, cover in zip(nodes, results, strict=True):
            self._done += node.voxels * (1 if node.height == 0 else _JOIN_SHARE)
            if self._progress is not None:
                self._progress(int(WHOLE * min(self._done / self._total, 1)), WHOLE)
            yield cover


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
