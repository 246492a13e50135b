"""The stage `voxelize` for scenes in parts: a block of the lattice at a time, from parts that touch it."""

from __future__ import annotations

import dataclasses
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.artifacts.artifact import Artifact, make_artifact
from alula.schemas.artifacts.kinds import VOXELS
from alula.schemas.artifacts.manifest import SceneManifest
from alula.schemas.artifacts.parts import Parts
from alula.schemas.artifacts.provenance import parameters_of
from alula.schemas.decimals import exact
from alula.schemas.errors import InfeasibleError, InputError
from alula.schemas.parameters.configs.voxelize import VoxelizeConfig
from alula.schemas.progress import Progress
from alula.stages.compression.ellipsoids import retained
from alula.stages.compression.forecast import estimated_voxels, largest_volume, may_exceed
from alula.stages.compression.lattice_blocks import Block, Tally, along_a_curve, crop_of, figures_of
from alula.stages.compression.tiles import Corner, Ellipsoids, Marked, joined_tiles, mark, tile_at
from alula.stages.compression.voxelize import (
    SURE,
    check_some,
    ellipsoids_of,
    giant_note,
    is_notable,
    level_for,
    rounded,
    voxels_fields,
)
from alula.stages.distribute import distribute
from alula.stages.progress import share

EDGE = 512  # voxels, of a block
BLOCK_ELLIPSOIDS = 2**20  # a block that more may touch is halved, unless its edge is given
_LEAST_EDGE = 16  # voxels, of a block that is not halved any more
ASSIGNED = 0.15  # fraction of the time in which ellipsoids are assigned to blocks
_CACHED = 3  # parts of the scene that are kept


@dataclass(frozen=True, slots=True)
class _Work:
    """Ellipsoids of one block; this is what a scheduler sends."""

    block: Block
    ellipsoids: Ellipsoids
    jobs: int


_RowsOf = list[tuple[int, int, int]]  # see `Block.rows`


class BlockVoxelizer:
    """Voxels of a scene in parts, block by block.

    A block holds exactly the voxels, with the same overlaps, that `voxelize` would mark in it for the whole
    scene: all ellipsoids whose boxes touch the block are gathered from all parts. Memory holds one part
    while ellipsoids are assigned to blocks; then the ellipsoids and counters of a block and a few parts.

    Args:
        config: see `VoxelizeConfig`; `max_voxels` is the maximum of a block.
        scene: an `alula/scene` in metres.
        edge: of a block [voxels].
        scratch: folder for the rows of each block, 4 bytes per Gaussian and block that it touches.
        most: a block that more ellipsoids may touch is divided into eight of half the edge, and so on; None
            for blocks of one edge.

    Attributes:
        config: the configuration.

    Raises:
        InputError: the scene is not metric.
    """

    def __init__(
        self, config: VoxelizeConfig, scene: Parts, edge: int, scratch: Path, most: int | None = None
    ) -> None:
        assert isinstance(scene.manifest, SceneManifest)
        self.config, self._scene, self._manifest = config, scene, scene.manifest
        self._edge, self._scratch, self._most = edge, scratch, most
        self._sigma, self._inflation = level_for(config, scene.manifest)
        self._is_lossy = "loss" in scene.manifest.arrays and not config.ignore_loss
        self._cache: OrderedDict[int, Artifact] = OrderedDict()
        self.tally = Tally()

    def blocks(self, progress: Progress | None = None) -> list[Block]:
        """Assign the ellipsoids of all parts to blocks.

        Returns:
            Blocks that an ellipsoid may touch, in lexicographic order of their lowest voxels.

        Raises:
            InputError: a part is damaged, or there are too many blocks.
            InfeasibleError: no Gaussian has the minimum opacity.
        """
        found: dict[Corner, _RowsOf] = {}
        tally, config = self.tally, self.config
        needed = self._needed()
        for number, ref in enumerate(self._scene.refs):
            if number not in needed:
                tally.gaussians, tally.retained = tally.gaussians + ref.count, tally.retained + ref.count
                continue
            part = self._scene[number]
            rows = retained(part, config.min_opacity)
            tally.gaussians += len(part["mean"])
            tally.retained += len(rows)
            if len(rows):
                mine = self._ellipsoids(part, rows)
                self._note_largest(mine, number, rows)
                tiles = self._assign(mine, number, rows, self._edge)
                for tile, begin, end in tiles:
                    found.setdefault(tile, []).append((number, begin, end))
                if config.crop is not None:
                    tally.reach[number] = np.zeros(len(part["mean"]), np.uint8)
            if progress is not None:
                progress(number + 1, len(self._scene))
        if tally.retained == 0:
            raise InfeasibleError(f"no Gaussian has an opacity of at least {exact(config.min_opacity)}")
        cubes = []
        for edge, corner, rows_of in self._divided(found):
            cubes.append((*tile_at(np.array(corner, np.int64) * edge, edge), tuple(rows_of)))
        return [Block(number, *cube) for number, cube in enumerate(sorted(cubes))]

    def _divided(self, found: dict[Corner, _RowsOf]) -> Iterator[tuple[int, Corner, _RowsOf]]:
        """Edge, corner in units of the edge, and rows of all blocks, after those with too many are halved."""
        edge = self._edge
        while True:
            large = {
                corner: rows_of
                for corner, rows_of in found.items()
                if self._most is not None
                and edge >= 2 * _LEAST_EDGE
                and edge % 2 == 0
                and sum(end - begin for _, begin, end in rows_of) > self._most
            }
            yield from ((edge, corner, rows) for corner, rows in found.items() if corner not in large)
            if not large:
                return
            edge //= 2
            by_part: dict[int, list[tuple[int, int]]] = {}
            for rows_of in large.values():
                for number, begin, end in rows_of:
                    by_part.setdefault(number, []).append((begin, end))
            found = {}
            for number, spans in sorted(by_part.items()):
                rows = np.unique(np.concatenate([self._rows(number, *span) for span in spans]))
                mine = self._ellipsoids(self._part(number), rows.astype(np.intp))
                for corner, begin, end in self._assign(mine, number, rows.astype(np.intp), edge):
                    x, y, z = corner
                    if (x // 2, y // 2, z // 2) in large:
                        found.setdefault(corner, []).append((number, begin, end))

    def _ellipsoids(self, part: Artifact, rows: NDArray[np.intp]) -> Ellipsoids:
        """Ellipsoids of rows of a part."""
        mine = ellipsoids_of(self.config, part, rows, self._sigma, self._inflation)
        if self._is_lossy and mine.loss is None:  # bounds of rows with a loss of 0 are rounded up
            mine = dataclasses.replace(mine, loss=np.zeros_like(mine.mean))
        return mine

    def _needed(self) -> set[int]:
        """Parts to read: those that may touch the crop, or all where the opacities count."""
        crop = self.config.crop
        if crop is None or self.config.min_opacity > 0:
            return set(range(len(self._scene)))
        level = {"sigma": self._sigma, "inflation": self._inflation}
        return set(self._scene.touching(crop[:3], crop[3:], **level))

    def _assign(
        self, mine: Ellipsoids, number: int, rows: NDArray[np.intp], edge: int
    ) -> Iterator[tuple[Corner, int, int]]:
        """Blocks of the ellipsoids of a part; the list of their rows is appended to a file."""
        try:
            tile, start, row = _core.tiles_of(**mine.level(), edge=edge)
        except OverflowError as error:
            raise InputError(f"{error}; use a larger --tile, --crop or a larger --size") from error
        # A file, unlike elsewhere in a stage: these rows are the only data that grows with the scene.
        listed, file = rows[row].astype(np.uint32), self._rows_file(number)
        before = np.load(file) if file.exists() else listed[:0]
        np.save(file, np.concatenate([before, listed]))
        start += len(before)
        for at, corner in enumerate(tile.tolist()):
            yield (corner[0], corner[1], corner[2]), int(start[at]), int(start[at + 1])

    def _rows_file(self, number: int) -> Path:
        return self._scratch / f"rows-{number:05d}.npy"

    def _note_largest(self, mine: Ellipsoids, number: int, rows: NDArray[np.intp]) -> None:
        row, volume = largest_volume(mine)
        if volume > self.tally.largest[0]:
            self.tally.largest = volume, float(mine.scale[row].max()), number, int(rows[row])

    def marked(
        self,
        blocks: Sequence[Block],
        jobs: int = 0,
        scheduler: str | None = None,
        progress: Progress | None = None,
    ) -> Iterator[tuple[Block, NDArray[np.int32], NDArray[np.uint32], int]]:
        """Mark the voxels of blocks, in an order in which neighbours follow one another.

        Args:
            scheduler: address of a `dask.distributed` scheduler whose workers mark the blocks.

        Yields:
            Block, voxels (sorted, shape (M, 3)), their overlaps, and the number of touched voxels that are
            left out because of `min_overlap`.

        Raises:
            InputError: a block has more voxels than `max_voxels`, or a part is damaged.
            UsageError, LinkError: see `distribute`.
        """
        work = (self._work(block, jobs) for block in along_a_curve(blocks))
        results = (
            map(_mark_block, work)
            if scheduler is None
            else distribute(_mark_block, work, scheduler=scheduler)
        )
        for done, (block, found) in enumerate(results):
            if found is None or len(found.index) > self.config.max_voxels:
                raise self._too_many(block, _core.MAX_VOXELS if found is None else len(found.index))
            self.tally.max_overlap = max(self.tally.max_overlap, found.max_overlap)
            self._note_reach(block, found.reach)
            yield block, found.index, found.overlap, found.below
            if progress is not None:
                progress(done + 1, len(blocks))

    def _work(self, block: Block, jobs: int) -> _Work:
        """Work of a block that does not have far too many voxels, which is estimated before it is done."""
        mine, limit = self._gathered(block), self.config.max_voxels
        inside = dataclasses.replace(mine, crop=crop_of(block, self.config.size_m, self.config.crop))
        if limit < _core.MAX_VOXELS and may_exceed(inside, limit, jobs):
            about = estimated_voxels(inside)
            if about > SURE * limit:
                raise self._too_many(block, about)
        return _Work(block, mine, jobs)

    def _too_many(self, block: Block, voxels: float) -> InputError:
        size, limit = self.config.size_m, self.config.max_voxels
        number = f"about {rounded(voxels)}" if np.isfinite(voxels) else "far too many"
        return InputError(
            f"the tile from {block.lower} has {number} voxels of {size:g} m; --max-voxels is {limit:,}; "
            "use a smaller --tile or a larger --size, or import-splat --max-scale if giants fill it"
        )

    def _gathered(self, block: Block) -> Ellipsoids:
        """Ellipsoids of all parts that may touch a block."""
        arrays: dict[str, list[NDArray[np.float32]]] = {"mean": [], "scale": [], "quat_wxyz": [], "loss": []}
        for number, begin, end in block.rows:
            part, rows = self._part(number), self._rows(number, begin, end)
            for name, values in arrays.items():
                found = part.arrays.get(name)
                values.append(np.zeros((len(rows), 3), np.float32) if found is None else found[rows])
        joined = {name: np.concatenate(values) for name, values in arrays.items()}
        loss = joined.pop("loss")
        config = self.config
        return Ellipsoids(
            **joined,
            loss=loss if self._is_lossy else None,
            sigma=self._sigma,
            inflation_m=self._inflation,
            voxel_size_m=config.size_m,
            crop=config.crop,
            min_overlap=config.min_overlap,
        )

    def _rows(self, number: int, begin: int, end: int) -> NDArray[np.uint32]:
        """Rows of a part, from its list of the rows of all blocks."""
        return np.array(np.load(self._rows_file(number), mmap_mode="r")[begin:end])

    def _part(self, number: int) -> Artifact:
        """A part of the scene, with few others in memory."""
        if number in self._cache:
            self._cache.move_to_end(number)
        else:
            while len(self._cache) >= _CACHED:
                self._cache.popitem(last=False)
            self._cache[number] = self._scene[number]
        return self._cache[number]

    def _note_reach(self, block: Block, reach: NDArray[np.uint8]) -> None:
        first = 0
        for number, begin, end in block.rows if self.tally.reach else ():
            rows = self._rows(number, begin, end)
            mine = reach[first : first + len(rows)]
            np.maximum.at(self.tally.reach[number], rows, mine)
            first += len(rows)

    def part(
        self, block: Block, index: NDArray[np.int32], overlap: NDArray[np.uint32], below: int
    ) -> Artifact:
        """Voxels of a block as an artifact of their own, whose crop is the block.

        Args:
            below: number of touched voxels left out because of `min_overlap`.
        """
        crop = crop_of(block, self.config.size_m, self.config.crop)
        config = dataclasses.replace(self.config, crop=crop)
        left_out = {**self._left_out(), "voxels_below_min_overlap": below}
        tally = Tally()
        tally.add(index, overlap, below)
        return make_artifact(
            VOXELS,
            {"index": index, "overlap": overlap},
            parameters=parameters_of(config),
            summary={"gaussians": sum(end - begin for _, begin, end in block.rows)} | self._figures(tally),
            **voxels_fields(config, self._manifest, left_out),
        )

    def _left_out(self) -> dict[str, Any]:
        return {
            "removed_from_splat": dict(self._manifest.source.get("removed", {})),
            "gaussians_below_opacity": self.tally.gaussians - self.tally.retained,
        }

    def _figures(self, tally: Tally) -> dict[str, Any]:
        level = {"sigma": self._sigma, "inflation_m": self._inflation}
        return figures_of(tally, self.config.size_m) | level

    def whole(self, parts: int) -> dict[str, Any]:
        """Fields of the manifest of all voxels, after all blocks are counted in `tally`.

        Raises:
            InfeasibleError: there is no voxel.
        """
        tally, config = self.tally, self.config
        check_some(config, tally.voxels, tally.below, tally.max_overlap)
        reach = [np.bincount(each, minlength=3) for each in tally.reach.values()]
        outside = 0 if config.crop is None else tally.retained - sum(int(c[1] + c[2]) for c in reach)
        left_out = self._left_out() | {
            "voxels_below_min_overlap": tally.below,
            "gaussians_outside_crop": outside,
            "gaussians_cut_by_crop": sum(int(counts[2]) for counts in reach),
        }
        summary = {
            "gaussians": tally.gaussians,
            "gaussians_below_opacity": left_out["gaussians_below_opacity"],
            "gaussians_outside_crop": left_out["gaussians_outside_crop"],
            "parts": parts,
            **self._figures(tally),
        }
        volume, longest, part, row = tally.largest
        share = volume / tally.voxels
        if config.crop is None and is_notable(share, tally.retained):
            summary["notes"] = [giant_note(f"{row} of part {part}", longest, min(share, 1.0))]
        return {"summary": summary, **voxels_fields(config, self._manifest, left_out)}


def voxelize_whole(
    voxelizer: BlockVoxelizer, jobs: int = 0, scheduler: str | None = None, progress: Progress | None = None
) -> Artifact:
    """Voxels of a scene in parts as one artifact, equal to those of `voxelize` for the whole scene.

    Raises:
        InputError: there are more voxels than `max_voxels`; for the rest see `BlockVoxelizer`.
        InfeasibleError: there is no voxel.
    """
    parts: list[tuple[NDArray[np.int32], NDArray[np.uint32]]] = []
    config, tally = voxelizer.config, voxelizer.tally
    blocks = voxelizer.blocks(share(progress, 0, ASSIGNED))
    for _, index, overlap, below in voxelizer.marked(blocks, jobs, scheduler, share(progress, ASSIGNED, 1)):
        tally.add(index, overlap, below)
        parts.append((index, overlap))
        if tally.voxels > config.max_voxels:
            raise InputError(
                f"voxels of {config.size_m:g} m: more than the {config.max_voxels:,} of --max-voxels; write "
                "a folder (-o NAME.voxels), whose parts may have as many each, or use a larger --size"
            )
    fields = voxelizer.whole(len(parts))
    index, overlap = joined_tiles(parts)
    return make_artifact(
        VOXELS, {"index": index, "overlap": overlap}, parameters=parameters_of(config), **fields
    )


def _mark_block(work: _Work) -> tuple[Block, Marked | None]:
    """Mark the voxels of a block; None where there are too many."""
    try:
        return work.block, mark(work.ellipsoids, work.jobs, tile=work.block.domain)
    except OverflowError:
        return work.block, None
