"""`alula import-splat` with a folder of parts as the output."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

from alula.cli.options import Common
from alula.cli.parted import run_parts
from alula.schemas.artifacts.provenance import Provenance, parameters_of
from alula.schemas.parameters.configs.import_splat import ImportSplatConfig
from alula.schemas.progress import Progress

if TYPE_CHECKING:
    from alula.schemas.artifacts.manifest import InputRef, Manifest
    from alula.schemas.artifacts.parts_output import PartsWriter, WrittenPart
    from alula.stages.reconstruction.formats.registry import SplatFile
    from alula.stages.reconstruction.formats.splats import Level
    from alula.stages.reconstruction.import_parts import Nothing
    from alula.stages.reconstruction.pieces import Piece


def inputs_of(found: Sequence[SplatFile]) -> list[dict[str, Path]]:
    """Files to read by role, for each splat.

    Args:
        found: the splats.
    """
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
        found: the splats.
        roles: files by role, for each splat; the splat itself is the first one.
        shown: names of splats by their paths.
    """
    pairs = zip(found, roles, strict=True)
    return {next(iter(files)): shown[one.path] for one, files in pairs if one.path in shown}


def import_parts(
    paths: Sequence[Path],
    config: ImportSplatConfig,
    part_gaussians: int,
    common: Common,
    shown: Mapping[Path, str],
) -> None:
    """Import splats into a folder of parts; jobs share the pieces of the files.

    Args:
        paths: files and folders.
        config: see `ImportSplatConfig`.
        part_gaussians: maximum number of Gaussians of a part.
        common: the shared options.
        shown: names to record in place of those of the files, by their paths.

    Raises:
        UsageError, InputError, OutputError: as `run_parts` and `import_piece`.
    """
    from alula.schemas.artifacts.kinds import SCENE
    from alula.stages.distribute import distribute
    from alula.stages.reconstruction.import_parts import Nothing, check_parted, whole_scene
    from alula.stages.reconstruction.pieces import find_splats, levels_of, pieces_of

    found = find_splats(paths, config.format, config.lod)
    levels = levels_of(found)
    check_parted(config, levels)
    pieces = list(pieces_of(found, part_gaussians))
    roles = inputs_of(found)

    def build(writer: PartsWriter, recorded: Provenance, progress: Progress) -> Manifest:
        by_role = {ref.role: ref for ref in recorded.inputs}
        own = [[by_role[role] for role in of_file] for of_file in roles]

        def work(piece: Piece) -> list[WrittenPart | Nothing]:
            return _imported(config, piece, own[piece.file], levels, part_gaussians, writer.folder)

        nothing: list[Nothing] = []
        for done, made in enumerate(distribute(work, pieces, jobs=common.jobs)):
            for one in made:
                if isinstance(one, Nothing):
                    nothing.append(one)
                else:
                    writer.take(one)
            progress(done + 1, len(pieces))
        return writer.whole(recorded, **whole_scene(config, writer.manifests, nothing, levels))

    inputs = {role: path for files in roles for role, path in files.items()}
    parameters = parameters_of(config) | {"part_gaussians": part_gaussians}
    run_parts(common, SCENE, parameters, inputs, build, names=names_of(found, roles, shown))


def _imported(
    config: ImportSplatConfig,
    piece: Piece,
    refs: Sequence[InputRef],
    levels: Sequence[Level],
    most: int,
    folder: Path | None,
) -> list[WrittenPart | Nothing]:
    """Import and write the parts of one piece, unless an interrupted run has done so."""
    import msgspec

    from alula.schemas.artifacts.artifact import Artifact
    from alula.schemas.artifacts.kinds import SCENE
    from alula.schemas.artifacts.manifest import SceneManifest
    from alula.schemas.artifacts.parts_output import kept_part, part_name, write_part
    from alula.stages.reconstruction.import_parts import Nothing, import_piece

    kept = kept_part(folder, part_name(SCENE, piece.file, piece.number, 0), SCENE)
    if kept is not None:
        assert isinstance(kept.manifest, SceneManifest)
        if piece.rows is not None or kept.manifest.source["rows"] < most:  # else there may be further parts
            return [kept]
    made: list[WrittenPart | Nothing] = []
    for at, scene in enumerate(import_piece(config, piece, levels, most)):
        if isinstance(scene, Nothing):
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
