"""`voxelize`: the voxels of a scene of one or several parts, in one file or a folder of parts."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Unpack

from alula.cli.verbs.keywords import configured
from alula.cli.verbs.results import Source, Voxels, named, source_of
from alula.cli.verbs.verb import Step, verb
from alula.schemas.artifacts.kinds import SCENE, VOXELS
from alula.schemas.errors import UsageError
from alula.schemas.parameters.configs.voxelize import VoxelizeConfig
from alula.schemas.progress import Progress

if TYPE_CHECKING:
    from alula.schemas.artifacts.artifact import Artifact
    from alula.schemas.artifacts.manifest import Manifest
    from alula.schemas.artifacts.parts import Parts
    from alula.schemas.artifacts.parts_output import PartsWriter, WrittenPart
    from alula.schemas.artifacts.provenance import Provenance
    from alula.schemas.parameters.keywords import VoxelizeFields
    from alula.stages.compression.voxelize_parts import BlockVoxelizer


@verb(VoxelizeConfig)
def voxelize(
    scene: Source,
    *,
    tile_m: float | None = None,
    scheduler: str | None = None,
    scratch: str | Path | None = None,
    jobs: int = 0,
    **fields: Unpack[VoxelizeFields],
) -> Step[Voxels]:
    """Mark every voxel that an obstacle touches.

    Args:
        scene: in metres, of `align`.
        tile_m: edge of a tile, which bounds the memory [m].
        scheduler: address of a dask.distributed scheduler.
        scratch: folder for 4 bytes per Gaussian and tile of a scene in parts; default: that of the system.
        jobs: threads; 0 is all processors.
        **fields: as in the signature.

    Raises:
        InputError: the scene is not in metres.
        InfeasibleError: there are far more voxels than `max_voxels`.
    """
    from alula.stages.compression.voxelize import tile_edge
    from alula.stages.compression.voxelize import voxelize as stage
    from alula.stages.compression.voxelize_parts import BLOCK_ELLIPSOIDS, EDGE, BlockVoxelizer, voxelize_whole

    config, source = configured("voxelize", VoxelizeConfig, fields), source_of(scene)
    if config.confidence is not None and "sigma" in fields:
        raise UsageError("--confidence sets sigma; give one of --confidence and --sigma")
    edge, most = (EDGE, BLOCK_ELLIPSOIDS) if tile_m is None else (tile_edge(tile_m, config.size_m), None)

    @contextmanager
    def by_blocks(parts: Parts, folder: Path | str | None) -> Iterator[BlockVoxelizer]:
        with named(source), tempfile.TemporaryDirectory(prefix=".rows-", dir=folder) as rows:
            yield BlockVoxelizer(config, parts, edge, Path(rows), most)

    def build(progress: Progress) -> Artifact:
        parts = source.parts(SCENE)
        if parts.is_folder:
            with by_blocks(parts, scratch) as voxelizer:
                return voxelize_whole(voxelizer, jobs, scheduler, progress)
        with named(source):
            return stage(config, parts[0], tile_m=tile_m, scheduler=scheduler, jobs=jobs, progress=progress)

    def into(writer: PartsWriter, recorded: Provenance, progress: Progress) -> Manifest:
        with by_blocks(source.parts(SCENE), writer.folder) as voxelizer:
            for part in _parts(voxelizer, writer.folder, scheduler, jobs, progress):
                writer.take(part)
            return writer.whole(recorded, **voxelizer.whole(len(writer)))

    return Step(Voxels, config, {"scene": source}, build, into=into, extra={"tile_voxels": edge})


def _parts(
    voxelizer: BlockVoxelizer, folder: Path | None, scheduler: str | None, jobs: int, progress: Progress
) -> list[WrittenPart]:
    """Make and write all parts that an interrupted run has not finished, in the order of the blocks."""
    from alula.schemas.artifacts.artifact import read_artifact
    from alula.schemas.artifacts.parts_output import kept_part, part_name, write_part
    from alula.stages.compression.voxelize_parts import ASSIGNED
    from alula.stages.progress import share

    blocks = voxelizer.blocks(share(progress, 0, ASSIGNED))
    made: dict[int, WrittenPart] = {}
    for block in blocks if voxelizer.config.crop is None else ():  # a crop needs the effect of each ellipsoid
        name = part_name(VOXELS, block.number)
        kept = kept_part(folder, name, VOXELS, block.domain)
        if kept is not None and folder is not None:
            found = read_artifact(folder / name, VOXELS, is_checked=True)
            below = int(kept.manifest.summary["dropped_by_min_overlap"])
            voxelizer.tally.add(found["index"], found["overlap"], below)
            made[block.number] = kept
    left = [block for block in blocks if block.number not in made]
    for block, index, overlap, below in voxelizer.marked(left, jobs, scheduler, share(progress, ASSIGNED, 1)):
        voxelizer.tally.add(index, overlap, below)
        if len(index):
            part = voxelizer.part(block, index, overlap, below)
            made[block.number] = write_part(folder, part_name(VOXELS, block.number), part, block.domain)
    return [made[number] for number in sorted(made)]
