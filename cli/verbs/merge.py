"""`merge`: the cover of voxels of one or several parts, in one file or a folder of parts."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

from alula.cli.verbs.keywords import configured
from alula.cli.verbs.results import Cover, File, Result, Source, source_of
from alula.cli.verbs.verb import verb
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.kinds import COVER, VOXELS
from alula.schemas.errors import UsageError, WrongKindError
from alula.schemas.parameters.configs.merge import MergeConfig
from alula.schemas.progress import Progress

if TYPE_CHECKING:
    from alula._core import MergeJournal
    from alula.schemas.artifacts.manifest import InputRef, Manifest
    from alula.schemas.artifacts.parts import Parts
    from alula.schemas.artifacts.parts_output import PartsWriter
    from alula.schemas.artifacts.provenance import Provenance
    from alula.schemas.parameters.keywords import MergeFields
    from alula.stages.compression.merge_blocks import BlockPlan, CoverStore

Kept = Callable[[Progress], tuple["MergeJournal", Progress]]
Stored = Callable[[], AbstractContextManager["CoverStore"]]
StoredIn = Callable[[Path | None, Sequence["InputRef"]], AbstractContextManager["CoverStore"]]


@verb(MergeConfig)
def merge(
    source: Source, *, scheduler: str | None = None, jobs: int = 0, **fields: Unpack[MergeFields]
) -> Merging:
    """Cover voxels with a limited number of convex polytopes.

    Args:
        source: voxels, or a cover to merge further.
        scheduler: address of a dask.distributed scheduler, for blocks.
        jobs: threads, of blocks processes; 0 is all processors.
        **fields: as in the signature.

    Raises:
        InfeasibleError: there is no cover within the limits.
        UsageError: the voxels are too many for one cover.
    """
    return Merging(configured("merge", MergeConfig, fields), source_of(source), scheduler, jobs)


@dataclass(frozen=True, slots=True)
class Merging:
    """A merge before its work."""

    config: MergeConfig
    source: Result | File
    scheduler: str | None
    jobs: int

    def make(self, progress: Progress) -> Cover:
        """The cover in memory."""
        return Cover(self.cover(progress), {"source": self.source})

    def cover(
        self,
        progress: Progress,
        *,
        kept: Kept | None = None,
        stored: Stored | None = None,
        output: Path = Path("cover"),
    ) -> Artifact:
        """One cover.

        Args:
            kept: function from the progress to a journal that the merge continues, and a progress.
            stored: function to a context with the covers of blocks that the merge continues.
            output: file of the cover, for messages.

        Raises:
            UsageError: the voxels are too many for one cover, or there are no blocks to send to a scheduler.
            WrongKindError: the source is neither voxels nor a cover.
            InputError, InfeasibleError: see `merge` and `merge_blocks`.
        """
        from alula.schemas.artifacts.parts_join import joined
        from alula.stages.compression.merge import merge as stage

        parts, plan = self._planned()
        if plan is None:
            journal, watched = (None, progress) if kept is None else kept(progress)
            return stage(self.config, joined(parts), jobs=self.jobs, progress=watched, journal=journal)
        if len(plan.regions) > 1:
            name = f"{self.source.path}: its" if isinstance(self.source, File) else "its"
            raise UsageError(
                f"{name} cover has {len(plan.regions)} parts that are not joined; give a folder,"
                f" such as -o {output.name.split('.')[0]}{COVER.folder_suffix}"
            )
        with nullcontext() if stored is None else stored() as store:
            (cover,) = self._covers(plan, store, progress)
        return cover

    def into(self, stored: StoredIn) -> Callable[[PartsWriter, Provenance, Progress], Manifest]:
        """Function that writes a cover with a part for each region, see `run_parts`.

        Args:
            stored: function to a context with the covers of blocks that the merge continues, from the folder
                of parts, None in a dry run, and their inputs.
        """
        from alula.schemas.artifacts.parts_output import kept_part, part_name, write_part
        from alula.stages.compression.merge_blocks import whole_fields

        def build(writer: PartsWriter, recorded: Provenance, progress: Progress) -> Manifest:
            _, plan = self._planned()
            if plan is None:
                raise UsageError(f"{writer.path}: a cover in parts needs --block; else give a file .npz")
            with stored(writer.folder, recorded.inputs) as store:
                for number, cover in enumerate(self._covers(plan, store, progress)):
                    name, domain = part_name(COVER, number), plan.domain(number)
                    part = kept_part(writer.folder, name, COVER, domain)
                    writer.take(part or write_part(writer.folder, name, cover, domain))
            return writer.whole(recorded, **whole_fields(self.config, plan, writer.manifests))

        return build

    def _planned(self) -> tuple[Parts, BlockPlan | None]:
        """The voxels or the cover, and the division into blocks; None where all are merged at once."""
        from alula.stages.compression.merge_blocks import plan_blocks

        parts, config = self._parts(), self.config
        plan = None if parts.kind is COVER else plan_blocks(config, parts)
        if plan is None and self.scheduler is not None:
            raise UsageError("--scheduler sends blocks to workers; give --block, their edge")
        return parts, plan

    def _parts(self) -> Parts:
        from alula.schemas.artifacts.parts import Parts, open_parts

        given, name = self.source, "a result"
        if isinstance(given, File):
            parts, name = open_parts(given.path), f"{given.path}:"
        else:  # the cover names the files of its voxels
            parts = Parts.of(Artifact(given.manifest, given.artifact.arrays))
        if parts.kind not in (VOXELS, COVER):
            raise WrongKindError(f"{name} is {parts.kind.name}, but voxels or a cover are needed")
        if parts.kind is COVER and (self.config.block_m is not None or self.scheduler is not None):
            raise UsageError(f"{name} is a cover; --block and --scheduler are for voxels")
        return parts

    def _covers(self, plan: BlockPlan, store: CoverStore | None, progress: Progress) -> Iterator[Artifact]:
        from alula.stages.compression.merge_blocks import merge_blocks

        how: dict[str, Any] = {"jobs": self.jobs, "scheduler": self.scheduler}
        return merge_blocks(self.config, plan, **how, store=store, progress=progress)
