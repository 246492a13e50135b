"""`import-splat`: splat files of one frame, read once, and the scenes that they become."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Unpack

from alula.cli.verbs.keywords import configured
from alula.cli.verbs.results import File, Scene
from alula.cli.verbs.verb import Step, verb
from alula.schemas.errors import InputError, UsageError
from alula.schemas.files import printable
from alula.schemas.parameters.configs.import_splat import PART_GAUSSIANS, ImportSplatConfig
from alula.schemas.progress import Progress

if TYPE_CHECKING:
    from alula.schemas.artifacts.artifact import Artifact
    from alula.schemas.artifacts.manifest import InputRef, Manifest
    from alula.schemas.artifacts.parts_output import PartsWriter, WrittenPart
    from alula.schemas.artifacts.provenance import Provenance
    from alula.schemas.parameters.keywords import ImportSplatFields
    from alula.stages.reconstruction.formats.registry import SplatFile
    from alula.stages.reconstruction.formats.splats import Level, Splats
    from alula.stages.reconstruction.import_splat import NothingLeftError, Screened
    from alula.stages.reconstruction.pieces import Piece


@verb(ImportSplatConfig)
def import_splat(*splats: str | Path, **fields: Unpack[ImportSplatFields]) -> Step[Scene]:
    """Splats Gaussian splat files into a scene.

    Args:
        *splats: files, or the output folder of a trainer; several that share one frame become one scene.
        **fields: as in the signature.

    Raises:
        InputError: a file cannot be read, or no Gaussian is left.
    """
    if not splats:
        raise UsageError("import_splat needs a splat file")
    config = configured("import_splat", ImportSplatConfig, fields)
    return SplatFiles([Path(path).expanduser() for path in splats], config.format, config.lod).step(config)


class SplatFiles:
    """Splat files of one frame; they are read once, however many scenes are made of them.

    Args:
        paths: files, or the output folder of a trainer.
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
        self._whole: Splats | None = None

    def _read(self, progress: Progress) -> Splats:
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
        """The scene of what is kept."""
        from alula.stages.reconstruction.import_splat import scene_of

        return Scene(scene_of(screened), self._inputs)

    def step(
        self, config: ImportSplatConfig, part_gaussians: int = PART_GAUSSIANS, jobs: int = 0
    ) -> Step[Scene]:
        """A scene of the files.

        Args:
            part_gaussians: maximum number of Gaussians of a part, where the output is a folder.
            jobs: threads, which share the pieces of the files, where the output is a folder.
        """
        from alula.stages.reconstruction.import_splat import scene_of

        def build(progress: Progress) -> Artifact:
            return scene_of(self.screened(config, progress))

        def into(writer: PartsWriter, recorded: Provenance, progress: Progress) -> Manifest:
            from alula.stages.distribute import distribute
            from alula.stages.reconstruction.import_parts import check_parted, whole_scene
            from alula.stages.reconstruction.import_splat import NothingLeftError
            from alula.stages.reconstruction.pieces import levels_of, pieces_of

            levels = levels_of(self.found)
            check_parted(config, levels)
            pieces = list(pieces_of(self.found, part_gaussians))
            by_role = {ref.role: ref for ref in recorded.inputs}
            own = [[by_role[role] for role in of_file] for of_file in inputs_of(self.found)]

            def work(piece: Piece) -> list[WrittenPart | NothingLeftError]:
                return _imported(config, piece, own[piece.file], levels, part_gaussians, writer.folder)

            nothing: list[NothingLeftError] = []
            for done, made in enumerate(distribute(work, pieces, jobs=jobs)):
                for one in made:
                    if isinstance(one, NothingLeftError):
                        nothing.append(one)
                    else:
                        writer.take(one)
                progress(done + 1, len(pieces))
            return writer.whole(recorded, **whole_scene(config, writer.manifests, nothing, levels))

        return Step(Scene, config, self._inputs, build, into=into, extra={"part_gaussians": part_gaussians})


def inputs_of(found: Sequence[SplatFile]) -> list[dict[str, Path]]:
    """Files to read by role, for each splat."""
    return [
        {
            role if k == 0 else f"splat {k + 1}{role.removeprefix('splat')}": path
            for role, path in one.fresh().files().items()
        }
        for k, one in enumerate(found)
    ]


def names_of(
    found: Sequence[SplatFile], roles: Sequence[Mapping[str, Path]], shown: Mapping[Path, str]
) -> dict[str, str]:
    """Names to record in place of those of the files, by role.

    Args:
        roles: files by role, for each splat; the splat itself is the first one.
    """
    pairs = zip(found, roles, strict=True)
    return {next(iter(files)): shown[one.path] for one, files in pairs if one.path in shown}


def _imported(
    config: ImportSplatConfig,
    piece: Piece,
    refs: Sequence[InputRef],
    levels: Sequence[Level],
    most: int,
    folder: Path | None,
) -> list[WrittenPart | NothingLeftError]:
    """Import and write the parts of one piece, unless an interrupted run has done so."""
    import msgspec

    from alula.schemas.artifacts.artifact import Artifact
    from alula.schemas.artifacts.kinds import SCENE
    from alula.schemas.artifacts.manifest import SceneManifest
    from alula.schemas.artifacts.parts_output import kept_part, part_name, write_part
    from alula.stages.reconstruction.import_parts import import_piece
    from alula.stages.reconstruction.import_splat import NothingLeftError

    kept = kept_part(folder, part_name(SCENE, piece.file, piece.number, 0), SCENE)
    if kept is not None:
        assert isinstance(kept.manifest, SceneManifest)
        if piece.rows is not None or kept.manifest.source["rows"] < most:  # else there may be further parts
            return [kept]
    made: list[WrittenPart | NothingLeftError] = []
    for at, scene in enumerate(import_piece(config, piece, levels, most)):
        if isinstance(scene, NothingLeftError):
            made.append(scene)
            continue
        manifest = msgspec.structs.replace(scene.manifest, inputs=_refs_of(piece, refs))
        name = part_name(SCENE, piece.file, piece.number, at)
        made.append(write_part(folder, name, Artifact(manifest, scene.arrays)))
    return made


def _refs_of(piece: Piece, refs: Sequence[InputRef]) -> list[InputRef]:
    """Inputs of a piece: of a streamed SOG the index and the files of one of its SOG files."""
    if not piece.member:
        return list(refs)
    of_file = "splat " if piece.file == 0 else f"splat {piece.file + 1} "
    member = PurePosixPath(piece.member)
    inside = f"{of_file}{member.parent}/" if member.name == "meta.json" else f"{of_file}{member}"
    return [refs[0], *(ref for ref in refs[1:] if ref.role.startswith(inside))]
