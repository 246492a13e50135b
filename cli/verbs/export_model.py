"""Exports of covers by `alula export` to formats of several files: URDF and Gazebo."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from alula.cli.shell.options import Common

if TYPE_CHECKING:
    from alula.schemas.artifacts.provenance import Provenance
    from alula.schemas.progress import Progress

MEMBERS = r"hull-\d+\.obj|model\.config"
MAIN = {"urdf": "map.urdf", "gazebo": "model.sdf"}  # the file that holds the provenance


def export_model(source: Path, name: str, parameters: dict[str, Any], common: Common) -> None:
    """Write a cover as a folder: a model, and the mesh of each hull.

    Args:
        name: `urdf` or `gazebo`.

    Raises:
        UsageError: the output is a folder of other files.
        WrongKindError: the input is no cover.
        OutputError: the folder cannot be written.
    """
    from alula.cli.shell.runner import run
    from alula.schemas.artifacts.artifact import read_artifact
    from alula.schemas.artifacts.kinds import COVER
    from alula.schemas.atomic import atomic_folder
    from alula.stages.export.bodies import gazebo, urdf
    from alula.stages.export.export import located

    encode = {"urdf": urdf, "gazebo": gazebo}[name]

    def make(provenance: Provenance, progress: Progress) -> tuple[Any, dict[str, Any]]:
        cover = read_artifact(source, COVER)
        placed = located(provenance, cover)
        files = list(encode(cover, placed))

        def write() -> None:
            with atomic_folder(common.output) as folder:
                folder.mkdir()
                for path, text in files:
                    (folder / path).write_bytes(text)

        hulls = len(cover["plane_start"]) - 1
        size = sum(len(text) for _, text in files)
        return write, {"format": name, "hulls": hulls, **placed.summary, "bytes": size}

    run(common, "alula/export", "1.0", parameters, {"input": source}, make, mark=MAIN[name], members=MEMBERS)
