"""`alula merge`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from alula.cli.shell import grouped, options
from alula.schemas.parameters.configs.merge import MergeConfig

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from alula.schemas.artifacts.artifact import Artifact
    from alula.schemas.artifacts.provenance import Provenance
    from alula.schemas.progress import Progress
    from alula.stages.compression.merge_blocks import CoverStore

EXAMPLES = """\b
Examples:
  alula merge room.voxels.npz -o room.cover.npz --hulls 300
  alula merge room.cover.npz -o small.cover.npz --max-planes 1500
  alula merge city.voxels -o city.cover --hulls 20000 --block 50
"""


@grouped.command(epilog=EXAMPLES)
@click.argument("source", type=options.PATH, metavar="VOXELS|COVER")
@options.fields_of(MergeConfig)
@options.scheduler("Send blocks")
@options.output(".cover.npz, or a folder .cover")
def command(source: Path, fields: dict[str, Any], scheduler: str | None, common: options.Common) -> None:
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
    import shutil

    from alula import _core
    from alula.cli.shell.journal import JournalFile
    from alula.cli.shell.parted import is_parted, run_parts
    from alula.cli.shell.runner import run_stage
    from alula.cli.verbs.block_store import covers_kept_in
    from alula.cli.verbs.merge import merge
    from alula.schemas.artifacts.journal import MERGE
    from alula.schemas.artifacts.kinds import COVER
    from alula.schemas.artifacts.parts_output import partial_folder
    from alula.schemas.artifacts.provenance import parameters_of

    step, inputs = merge.step(source, scheduler=scheduler, jobs=common.jobs, **fields), {"source": source}
    if is_parted(common.output, COVER):
        run_parts(common, COVER, parameters_of(step.config), inputs, step.into(covers_kept_in))
        return
    journal = JournalFile(common, MERGE, _core.MergeJournal)
    wanted: list[Provenance] = []

    def begin(provenance: Provenance) -> None:
        journal.begin(provenance)
        wanted.append(provenance)

    def build(progress: Progress) -> Artifact:
        def stored() -> AbstractContextManager[CoverStore]:
            folder = partial_folder(common.output, wanted[0])
            return covers_kept_in(None if common.dry_run else folder, wanted[0].inputs)

        cover: Artifact = step.cover(progress, kept=journal.kept, stored=stored, output=common.output)
        return cover

    with journal.until_written():
        run_stage(common, COVER, step.config, inputs, build, begin=begin)
    journal.remove()
    for provenance in wanted:
        if not common.dry_run:
            shutil.rmtree(partial_folder(common.output, provenance), ignore_errors=True)
