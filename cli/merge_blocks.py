"""`alula merge` by blocks: what it keeps when interrupted, and the two kinds of output."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from alula import _core
from alula.cli.block_store import FolderStore
from alula.cli.interruption import InterruptedWithAdvice
from alula.cli.journal import JournalFile
from alula.cli.options import Common
from alula.cli.parted import run_parts
from alula.cli.runner import run_stage
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.journal import MERGE
from alula.schemas.artifacts.kinds import COVER
from alula.schemas.artifacts.manifest import InputRef, Manifest
from alula.schemas.artifacts.parts import Parts
from alula.schemas.artifacts.parts_join import joined
from alula.schemas.artifacts.parts_output import PartsWriter, kept_part, part_name, partial_folder, write_part
from alula.schemas.artifacts.provenance import Provenance, parameters_of
from alula.schemas.errors import LinkError, OutputError, UsageError
from alula.schemas.parameters.configs.merge import MergeConfig
from alula.schemas.progress import Progress
from alula.stages.compression.merge_blocks import (
    BlockPlan,
    CoverStore,
    MemoryStore,
    merge_blocks,
    plan_blocks,
    whole_fields,
)

Read = Callable[[], Artifact | Parts]


def merge_to_file(
    config: MergeConfig, scheduler: str | None, common: Common, source: Path, read: Read
) -> None:
    """Merge to one file.

    Args:
        config: see `MergeConfig`.
        scheduler: see `merge_blocks`.
        common: the shared options.
        source: path of the input.
        read: function that reads it: a cover, or voxels in parts.

    Raises:
        UsageError: the voxels are too many for one cover, or there are no blocks to send to a scheduler.
        the rest as `run_stage`, `merge` and `merge_blocks`.
    """
    journal = JournalFile(common, MERGE, _core.MergeJournal)
    wanted: list[Provenance] = []

    def begin(provenance: Provenance) -> None:
        journal.begin(provenance)
        wanted.append(provenance)

    def build(progress: Progress) -> Artifact:
        from alula.stages.compression.merge import merge

        found = read()
        plan = _plan(config, found, scheduler)
        if plan is None:
            measured, watched = journal.kept(progress)
            return merge(config, _whole(found), jobs=common.jobs, progress=watched, journal=measured)
        if len(plan.regions) > 1:
            raise UsageError(
                f"{source}: its cover has {len(plan.regions)} parts that are not joined; give a folder,"
                f" such as -o {common.output.name.split('.')[0]}{COVER.folder_suffix}"
            )
        folder = partial_folder(common.output, wanted[0])
        with _kept(None if common.dry_run else folder, wanted[0].inputs) as store:
            (cover,) = merge_blocks(
                config, plan, jobs=common.jobs, scheduler=scheduler, store=store, progress=progress
            )
        return cover

    with journal.until_written():
        run_stage(common, COVER, config, {"source": source}, build, begin=begin)
    journal.remove()
    for provenance in wanted:
        if not common.dry_run:
            shutil.rmtree(partial_folder(common.output, provenance), ignore_errors=True)


def merge_to_parts(
    config: MergeConfig, scheduler: str | None, common: Common, source: Path, read: Read
) -> None:
    """Merge to a folder with a part for each region.

    Args:
        config: see `MergeConfig`.
        scheduler: see `merge_blocks`.
        common: the shared options.
        source: path of the input.
        read: function that reads it: voxels in parts.

    Raises:
        UsageError: there are no blocks.
        the rest as `run_parts` and `merge_blocks`.
    """

    def build(writer: PartsWriter, recorded: Provenance, progress: Progress) -> Manifest:
        plan = _plan(config, read(), scheduler)
        if plan is None:
            raise UsageError(f"{common.output}: a cover in parts needs --block; else give a file .npz")
        with _kept(writer.folder, recorded.inputs) as store:
            covers = merge_blocks(
                config, plan, jobs=common.jobs, scheduler=scheduler, store=store, progress=progress
            )
            for number, cover in enumerate(covers):
                name, domain = part_name(COVER, number), plan.domain(number)
                part = kept_part(writer.folder, name, COVER, domain)
                writer.take(part or write_part(writer.folder, name, cover, domain))
        return writer.whole(recorded, **whole_fields(config, plan, writer.manifests))

    run_parts(common, COVER, parameters_of(config), {"source": source}, build)


def _plan(config: MergeConfig, found: Artifact | Parts, scheduler: str | None) -> BlockPlan | None:
    plan = None if isinstance(found, Artifact) else plan_blocks(config, found)
    if plan is None and scheduler is not None:
        raise UsageError("--scheduler sends blocks to workers; give --block, their edge")
    return plan


def _whole(found: Artifact | Parts) -> Artifact:
    """All voxels at once, or the cover."""
    if isinstance(found, Artifact):
        return found
    return joined(found)


@contextmanager
def _kept(folder: Path | None, inputs: Sequence[InputRef]) -> Iterator[CoverStore]:
    """Context with a store in a folder, which stays after an interruption or the loss of all workers.

    Args:
        folder: None for a dry run.
        inputs: of the parts.

    Raises:
        OutputError: the folder cannot be made.
        InterruptedWithAdvice: the command was interrupted, and the folder allows it to continue.
    """
    if folder is None:
        yield MemoryStore()
        return
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot write: {error.strerror or error}") from error
    store = FolderStore(folder, inputs)
    try:
        yield store
    except KeyboardInterrupt as interruption:
        if not len(store):
            raise
        raise InterruptedWithAdvice(
            f"the same command continues from {folder.name}, {len(store):,} covers of blocks"
        ) from interruption
    except LinkError as error:
        raise LinkError(f"{error}; the same command continues from {folder.name}") from error
    except Exception:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    finally:
        with suppress(OSError):
            folder.rmdir()  # only when it is empty
