"""Common work of commands whose output may be a folder of parts."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from alula.cli.shell.interruption import InterruptedWithAdvice
from alula.cli.shell.options import Common
from alula.cli.shell.runner import INDEX, run_beside
from alula.schemas.artifacts.provenance import Provenance
from alula.schemas.progress import Progress

if TYPE_CHECKING:
    from alula.schemas.artifacts.kinds import Kind
    from alula.schemas.artifacts.manifest import Manifest
    from alula.schemas.artifacts.parts_output import PartsWriter


def is_parted(output: Path, kind: Kind) -> bool:
    """Test whether an output is to be a folder of parts, by its name."""
    return output.suffix == kind.folder_suffix


def run_parts(
    common: Common,
    kind: Kind,
    parameters: dict[str, Any],
    inputs: Mapping[str, Path],
    build: Callable[[PartsWriter, Provenance, Progress], Manifest],
    *,
    seed: int | None = None,
    names: Mapping[str, str] | None = None,
) -> None:
    """Run a stage whose output is a folder of parts, unless the output is already current.

    Args:
        parameters: all parameters that the output depends on, as plain JSON values.
        inputs: role to path of all files that the output depends on.
        build: function that hands all parts to the writer and returns the manifest of the whole.
        names: role to name of inputs that are recorded by another name than the file's own.

    Raises:
        UsageError, InputError, OutputError: as `runner.run`.
        InterruptedWithAdvice: the command was interrupted, and the parts that it leaves allow it to continue.
    """
    from alula.schemas.artifacts.parts_output import partial_folder, parts_output

    left: list[Path] = []

    def make(
        provenance: Callable[[], Provenance], progress: Progress
    ) -> tuple[Callable[[], None], dict[str, Any]]:
        recorded = provenance()
        left.append(partial_folder(common.output, recorded))
        writer = stack.enter_context(parts_output(common.output, kind, recorded, dry_run=common.dry_run))
        whole = build(writer, recorded, progress)
        return lambda: writer.finish(whole), whole.summary

    try:
        with contextlib.ExitStack() as stack:
            known = (common, kind.name, kind.version, parameters, inputs, make, seed, INDEX, "part-.*")
            run_beside(*known, names)
    except KeyboardInterrupt as interruption:
        parts = [*left[0].glob(f"part-*{kind.suffix}")] if left else []
        if not parts:
            raise
        raise InterruptedWithAdvice(
            f"the same command continues from {left[0].name}, {len(parts):,} parts"
        ) from interruption
