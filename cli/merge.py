"""`alula merge`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from alula.cli import grouped, options, parted
from alula.schemas.parameters.configs.merge import MergeConfig

if TYPE_CHECKING:
    from alula.schemas.artifacts.artifact import Artifact
    from alula.schemas.artifacts.parts import Parts

EXAMPLES = """\b
Examples:
  alula merge room.voxels.npz -o room.cover.npz --hulls 300
  alula merge room.cover.npz -o small.cover.npz --max-planes 1500
  alula merge city.voxels -o city.cover --hulls 20000 --block 50
"""


@grouped.command(epilog=EXAMPLES)
@click.argument("source", type=options.input_path(), metavar="VOXELS|COVER")
@options.from_config(MergeConfig)
@options.scheduler("Send blocks")
@options.output(".cover.npz, or a folder .cover")
def command(source: Path, config: MergeConfig, scheduler: str | None, common: options.Common) -> None:
    """Cover voxels with a limited number of convex polytopes.

    Every occupied voxel lies inside a hull, in exact integers. Hulls are merged greedily: the pair that
    encloses the least free space comes first, until the limits hold. A cover as input is merged further.

    With a limit of half-planes or bytes the cover has more hulls with fewer planes each: outer polytopes
    that contain the hulls, with the planes that remove most free space.

    Without a limit the cover is at most 300 outer polytopes. They enclose no more volume than 300 hulls, in
    40, 55 or 75 % of their bytes where that is possible. It takes two to three times as long as --hulls
    300, which keeps the hulls as they are.

    Threads (--jobs) share the tiles of a scene, in which clusters of voxels are chosen and merged down to an
    eighth of them, the volumes, the division of voxels between hulls and the shapes of outer polytopes. The
    last merges follow one another; there the threads only measure pairs ahead that may be next.

    With --block the voxels are covered block by block, by --jobs processes or the workers of --scheduler,
    and the hulls of neighbouring blocks are then joined, level by level. The result depends on the block, not
    on the workers. Cubes of blocks with more than 8,388,608 voxels are not joined; the output is then a
    folder NAME.cover with a part for each, and the limits hold for all of them together.

    An interrupted merge leaves OUTPUT.journal, or with blocks a folder OUTPUT.KEY.partial. The same command
    then continues from it and writes the same bytes.

    Memory: about 200 bytes per voxel where voxels form surfaces; at most 2,600 where they are scattered,
    --cluster-radius is 0 or the method is that of the paper. With blocks these are the voxels of one block
    per job, and 250 bytes per voxel of a cube of blocks that is joined. A block of more than 8,388,608
    voxels, or a cover of more than 16,777,216, is refused.
    """
    from alula.cli.merge_blocks import merge_to_file, merge_to_parts
    from alula.schemas.artifacts.kinds import COVER, VOXELS
    from alula.schemas.artifacts.parts import open_parts
    from alula.schemas.artifacts.parts_join import joined
    from alula.schemas.errors import UsageError, WrongKindError

    def read() -> Artifact | Parts:
        """A cover, or voxels in parts."""
        found = open_parts(source)
        if found.kind not in (VOXELS, COVER):
            raise WrongKindError(f"{source}: is {found.manifest.schema}, but voxels or a cover are needed")
        if found.kind is COVER and (config.block_m is not None or scheduler is not None):
            raise UsageError(f"{source}: is a cover; --block and --scheduler are for voxels")
        return joined(found) if found.kind is COVER else found

    is_parted = parted.is_parted(common.output, COVER.folder_suffix)
    (merge_to_parts if is_parted else merge_to_file)(config, scheduler, common, source, read)
