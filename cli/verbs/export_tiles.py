"""Export of a cover as an onboard map in tiles, by `alula export --tiles`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from alula.cli.shell.options import Common
from alula.schemas.parameters.configs.export import ExportConfig

if TYPE_CHECKING:
    from alula.schemas.artifacts.provenance import Provenance
    from alula.schemas.progress import Progress

_AT_ONCE = 2**24  # bytes of a file that are copied together


def export_tiles(path: Path, config: ExportConfig, key_path: Path | None, common: Common) -> None:
    """Write the folder of a map in tiles.

    Args:
        key_path: file of the key that signs the index; None for no signature.

    Raises:
        UsageError: the output is a folder of other files.
        InputError, ArtifactError: cover or key cannot be read, or the cover cannot be encoded.
        InfeasibleError: the tiles are too many or too small.
        OutputError: the folder cannot be written.
    """
    import hashlib
    import shutil
    from tempfile import TemporaryFile

    import msgspec

    from alula.cli.shell.runner import run
    from alula.schemas.artifacts.kinds import COVER
    from alula.schemas.artifacts.manifest import map_origin
    from alula.schemas.artifacts.parts import open_parts
    from alula.schemas.artifacts.parts_join import write_joined_cover
    from alula.schemas.artifacts.signing_key import read_key
    from alula.schemas.artifacts.tiles import (
        BINARY,
        MEMBERS,
        SIGNATURE,
        TILES,
        TILES_SCHEMA,
        TILES_VERSION,
        WHOLE,
        key_id,
        sign,
    )
    from alula.schemas.atomic import atomic_folder
    from alula.schemas.errors import AlulaError
    from alula.stages.compression.onboard.tiles import cut_tiles, fastest_m_s, sealed, tiles_facts

    key = None if key_path is None else read_key(key_path)
    parameters = config.tile_parameters() | {"key_id": key_id(key)}

    with TemporaryFile(dir=common.output.parent) as whole, TemporaryFile(dir=common.output.parent) as images:

        def make(provenance: Provenance, progress: Progress) -> tuple[Any, dict[str, Any]]:
            cover = open_parts(path, COVER)
            if cover.is_folder:
                write_joined_cover(cover, whole)
            else:
                with path.open("rb") as file:
                    shutil.copyfileobj(file, whole, _AT_ONCE)
            whole.seek(0)
            sha256 = hashlib.file_digest(whole, "sha256").hexdigest()
            try:
                cut = cut_tiles(
                    cover,
                    images.write,
                    tile_m=parameters["tile_m"],
                    reach_m=parameters["reach_m"],
                    hysteresis_m=parameters["hysteresis_m"],
                    largest_normal=config.largest_normal,
                    cover_sha256=sha256,
                    jobs=common.jobs,
                )
            except AlulaError as error:
                if str(error).startswith(f"{path}"):
                    raise
                raise error.reworded(f"{path}: {error}") from error
            index = sealed(cut, key_id=key_id(key), provenance=provenance)
            facts = {"format": "tiles", **tiles_facts(index), "notes": []}
            if (origin := map_origin(cover.manifest)) is not None:
                facts["map_origin_m"] = origin
            if cover.is_folder:
                facts["cover_sha256"] = sha256
            images.seek(0)
            one = images.read(index.tiles[0].bytes)
            facts["fastest_m_s"] = round(fastest_m_s(one, index.reach_m) - 5e-4, 3)
            if key is None:
                facts["notes"] = [
                    "the index is not signed: readers cannot tell who made it; sign it with --sign"
                ]
            recorded = msgspec.structs.replace(
                index, provenance=msgspec.structs.replace(provenance, summary=facts | {"notes": []})
            )

            def write() -> None:
                binary = index.binary()
                images.seek(0)
                whole.seek(0)
                with atomic_folder(common.output) as folder:
                    folder.mkdir()
                    for tile in index.tiles:
                        (folder / tile.file).write_bytes(images.read(tile.bytes))
                    (folder / BINARY).write_bytes(binary)
                    if key is not None:
                        (folder / SIGNATURE).write_bytes(sign(binary, key))
                    with (folder / WHOLE).open("wb") as file:
                        shutil.copyfileobj(whole, file, _AT_ONCE)
                    text = msgspec.json.format(msgspec.json.encode(recorded, order="sorted"), indent=1)
                    (folder / TILES).write_bytes(text + b"\n")

            return write, facts

        inputs = {"cover": path}
        run(common, TILES_SCHEMA, TILES_VERSION, parameters, inputs, make, mark=TILES, members=MEMBERS)
