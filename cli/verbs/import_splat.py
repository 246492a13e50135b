"""`import-splat`: splat files of one frame, read once, and the scenes that they become."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Unpack

from alula.cli.import_parts import inputs_of
from alula.cli.verbs.keywords import configured
from alula.cli.verbs.results import File, Scene
from alula.cli.verbs.verb import Step, verb
from alula.schemas.errors import InputError, UsageError
from alula.schemas.files import printable
from alula.schemas.parameters.configs.import_splat import ImportSplatConfig
from alula.schemas.progress import Progress

if TYPE_CHECKING:
    from alula.schemas.artifacts.artifact import Artifact
    from alula.schemas.parameters.keywords import ImportSplatFields
    from alula.stages.reconstruction.formats.splats import Splats as Read
    from alula.stages.reconstruction.import_splat import Screened


@verb(ImportSplatConfig)
def import_splat(*splats: str | Path, **fields: Unpack[ImportSplatFields]) -> Step[Scene]:
    """Read Gaussian splat files into a scene.

    Args:
        *splats: files, or the output folder of a trainer; several that share one frame become one scene.
        **fields: as in the signature.

    Raises:
        InputError: a file cannot be read, or no Gaussian is left.
    """
    if not splats:
        raise UsageError("import_splat needs a splat file")
    config = configured("import_splat", ImportSplatConfig, fields)
    return Splats([Path(path).expanduser() for path in splats], config.format, config.lod).step(config)


class Splats:
    """Splat files of one frame; they are read once, however many scenes are made of them.

    Args:
        paths: files, or the output folder of a trainer.
        format: of the files.
        lod: level of detail of a streamed splat.
        known_as: names of files that users know by another name, such as an address.

    Raises:
        InputError: a file cannot be read.
    """

    def __init__(
        self,
        paths: Sequence[Path],
        format: str = "auto",
        lod: int | None = None,
        known_as: Mapping[Path, str] | None = None,
    ) -> None:
        from alula.stages.reconstruction.pieces import find_splats

        self.found = find_splats(list(paths), format, lod)
        self._inputs = {
            role: File.at(path) for files in inputs_of(self.found) for role, path in files.items()
        }
        self._known_as = known_as or {}
        self._first = self._known_as.get(paths[0], str(paths[0]))
        self._whole: Read | None = None

    def _read(self, progress: Progress) -> Read:
        from alula.stages.progress import share
        from alula.stages.reconstruction.formats.capture import joined

        if self._whole is None:
            count = len(self.found)
            self._whole = joined(
                [
                    (
                        printable(self._known_as.get(one.path, one.path.name)),
                        one.decode(share(progress, k / count, (k + 1) / count)),
                    )
                    for k, one in enumerate(self.found)
                ]
            )
        return self._whole

    def screened(self, config: ImportSplatConfig, progress: Progress) -> Screened:
        """What a configuration keeps of the files.

        Args:
            config: see `ImportSplatConfig`.
            progress: called with (done, total).

        Raises:
            InputError: a file cannot be read, or the configuration keeps nothing of it.
        """
        from alula.stages.reconstruction.import_splat import screened

        whole = self._read(progress)
        try:
            return screened(config, whole)
        except InputError as error:
            more = f" and {len(self.found) - 1} more" if len(self.found) > 1 else ""
            raise error.reworded(f"{self._first}{more}: {error}") from error

    def scene(self, screened: Screened) -> Scene:
        """The scene of what is kept.

        Args:
            screened: of these files.
        """
        from alula.stages.reconstruction.import_splat import scene_of

        return Scene(scene_of(screened), self._inputs)

    def step(self, config: ImportSplatConfig) -> Step[Scene]:
        """A scene of the files.

        Args:
            config: see `ImportSplatConfig`.
        """
        from alula.stages.reconstruction.import_splat import scene_of

        def build(progress: Progress) -> Artifact:
            return scene_of(self.screened(config, progress))

        return Step(Scene, config, self._inputs, build)
