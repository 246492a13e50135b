"""`alula voxelize` where the scene or the voxels are a folder of parts."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from alula.cli.options import Common
from alula.cli.parted import is_parted, run_parts
from alula.cli.runner import run_stage
from alula.schemas.artifacts.provenance import Provenance, parameters_of
from alula.schemas.errors import InfeasibleError, InputError, OutputError
from alula.schemas.parameters.configs.voxelize import VoxelizeConfig
from alula.schemas.progress import Progress

if TYPE_CHECKING:
    from alula.schemas.artifacts.artifact import Artifact
    from alula.schemas.artifacts.manifest import Manifest
    from alula.schemas.artifacts.parts_output import PartsWriter, WrittenPart
    from alula.stages.compression.voxelize_parts import BlockVoxelizer


def voxelize_parts(
    scene: Path, config: VoxelizeConfig, tile_m: float | None, scheduler: str | None, common: Common
) -> None:
    """Voxelize block by block, into a folder of parts or one file.

    Args:
        scene: a scene, a file or a folder.
        config: see `VoxelizeConfig`.
        tile_m: edge of a block [m]; None for the default.
        scheduler: address of a `dask.distributed` scheduler.
        common: the shared options.

    Raises:
        UsageError, InputError, InfeasibleError, LinkError: see `BlockVoxelizer`.
    """
    from alula.schemas.artifacts.kinds import VOXELS
    from alula.stages.compression.voxelize import tile_edge
    from alula.stages.compression.voxelize_parts import BLOCK_ELLIPSOIDS, EDGE, voxelize_whole

    edge, most = (EDGE, BLOCK_ELLIPSOIDS) if tile_m is None else (tile_edge(tile_m, config.size_m), None)

    def into_parts(writer: PartsWriter, recorded: Provenance, progress: Progress) -> Manifest:
        with _voxelizer(scene, config, edge, most, writer.folder) as voxelizer:
            for part in _parts(voxelizer, writer.folder, scheduler, common.jobs, progress):
                writer.take(part)
            return writer.whole(recorded, **voxelizer.whole(len(writer)))

    def into_one(progress: Progress) -> Artifact:
        with _voxelizer(scene, config, edge, most, common.output.parent) as voxelizer:
            return voxelize_whole(voxelizer, common.jobs, scheduler, progress)

    if is_parted(common.output, VOXELS.folder_suffix):
        parameters = parameters_of(config) | {"tile_voxels": edge}
        run_parts(common, VOXELS, parameters, {"scene": scene}, into_parts)
    else:
        run_stage(common, VOXELS, config, {"scene": scene}, into_one)


@contextmanager
def _voxelizer(
    scene: Path, config: VoxelizeConfig, edge: int, most: int | None, folder: Path | None
) -> Iterator[BlockVoxelizer]:
    """Context with a voxelizer, whose temporary files are in a folder; errors name the scene."""
    from alula.schemas.artifacts.kinds import SCENE
    from alula.schemas.artifacts.parts import open_parts
    from alula.stages.compression.voxelize_parts import BlockVoxelizer

    parts = open_parts(scene, SCENE)
    try:
        with tempfile.TemporaryDirectory(prefix=".rows-", dir=folder) as scratch:
            yield BlockVoxelizer(config, parts, edge, Path(scratch), most)
    except OutputError:
        raise
    except (InputError, InfeasibleError) as error:
        if str(error).startswith(f"{scene}"):
            raise
        raise error.reworded(f"{scene}: {error}") from error


def _parts(
    voxelizer: BlockVoxelizer, folder: Path | None, scheduler: str | None, jobs: int, progress: Progress
) -> list[WrittenPart]:
    """Make and write all parts that an interrupted run has not finished, in the order of the blocks."""
    from alula.schemas.artifacts.artifact import read_artifact
    from alula.schemas.artifacts.kinds import VOXELS
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
