"""`read`: what a command or `save` wrote, as a result."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from alula.cli.verbs.results import RESULTS, Cover, File, Plan, Scene, Seen, Voxels
from alula.schemas.errors import InputError

if TYPE_CHECKING:
    from alula.cli.verbs.runs import Run


def read(path: str | Path) -> Scene | Voxels | Seen | Cover | Plan | Run:
    """Read an artifact, or the log of a run, that a command or `save` wrote.

    Returns:
        A result of its kind. Large arrays are mapped, not copied.

    Raises:
        InputError: the file cannot be read, is damaged, or is a splat file, which `import_splat` reads.
    """
    from alula.schemas.artifacts.parts_join import read_whole
    from alula.schemas.artifacts.salvage import is_artifact_like
    from alula.schemas.log.mcap import MAGIC

    file = Path(path).expanduser()
    with_magic = b""
    if file.is_file():
        with file.open("rb") as opened:
            with_magic = opened.read(len(MAGIC))
    if with_magic == MAGIC:
        from alula.cli.verbs.runs import Run

        return Run.read(file)
    if file.is_file() and not is_artifact_like(file):
        raise InputError(f"{file}: is not an artifact or a run; alula.import_splat reads splat files")
    state = File.at(file)
    artifact = read_whole(file)
    found: Any = RESULTS[artifact.kind.name](artifact, file=state)
    return found  # type: ignore[no-any-return]
