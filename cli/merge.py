"""`alula merge`."""

from __future__ import annotations

from pathlib import Path

import click

from alula.cli import options
from alula.schemas.configs.merge import MergeConfig

EXAMPLES = """\b
Examples:
  alula merge room.voxels.npz -o room.cover.npz --hulls 300
  alula merge room.cover.npz -o small.cover.npz --max-planes 1500
"""


@click.command(epilog=EXAMPLES)
@click.argument("source", type=options.input_path(), metavar="VOXELS|COVER")
@options.from_config(MergeConfig)
@options.output(".cover.npz")
def command(source: Path, config: MergeConfig, common: options.Common) -> None:
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

    An interrupted merge leaves OUTPUT.journal. The same command then continues from it and writes the
    same bytes.

    Memory: about 200 bytes per voxel where voxels form surfaces; at most 2,600 where they are
    scattered, --block is 0 or the method is that of the paper. More than 16,777,216 voxels are refused.
    """
    from alula import _core
    from alula.cli.journal import JournalFile
    from alula.cli.runner import run_stage
    from alula.schemas.artifact import Artifact, read_artifact
    from alula.schemas.errors import WrongKindError
    from alula.schemas.journal import MERGE
    from alula.schemas.kinds import COVER, VOXELS
    from alula.schemas.progress import Progress
    from alula.stages.compression.merge import merge

    def build(progress: Progress) -> Artifact:
        artifact = read_artifact(source)
        if artifact.kind not in (VOXELS, COVER):
            raise WrongKindError(f"{source}: is {artifact.manifest.schema}, but voxels or a cover are needed")
        with journal.kept(progress) as (measured, watched):
            return merge(config, artifact, jobs=common.jobs, progress=watched, journal=measured)

    journal = JournalFile(common, MERGE, _core.MergeJournal)
    run_stage(common, COVER, config, {"source": source}, build, begin=journal.begin)
    journal.remove()
