"""Export of a cover as an onboard map in tiles, by `alula export --tiles`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from alula.cli.options import Common
from alula.schemas.configs.export import ExportConfig

if TYPE_CHECKING:
    from alula.schemas.progress import Progress
    from alula.schemas.provenance import Provenance


def export_tiles(path: Path, config: ExportConfig, key_path: Path | None, common: Common) -> None:
    """Write the folder of a map in tiles.

    Args:
        path: of the cover.
        config: with `tiles_m`.
        key_path: file of the key that signs the index; None for no signature.
        common: common options of commands.

    Raises:
        UsageError: the output is a folder of other files.
        InputError, ArtifactError: cover or key cannot be read, or the cover cannot be encoded.
        InfeasibleError: the tiles are too many or too small.
        OutputError: the folder cannot be written.
    """
    import hashlib

    import msgspec

    from alula.cli.runner import run
    from alula.schemas.artifact import encode_artifact
    from alula.schemas.atomic import atomic_folder
    from alula.schemas.errors import AlulaError
    from alula.schemas.kinds import COVER
    from alula.schemas.parts_join import read_whole
    from alula.schemas.signing_key import read_key
    from alula.schemas.tiles import (
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
    from alula.stages.compression.onboard.tiles import cut_map, fastest_m_s, sealed, tiles_facts

    key = None if key_path is None else read_key(key_path)
    parameters = config.tile_parameters() | {"key_id": key_id(key)}

    def make(provenance: Provenance, progress: Progress) -> tuple[Any, dict[str, Any]]:
        cover = read_whole(path, COVER)
        whole = path.read_bytes() if path.is_file() else encode_artifact(cover)
        sha256 = hashlib.sha256(whole).hexdigest()
        try:
            cut = cut_map(
                cover,
                tile_m=parameters["tile_m"],
                reach_m=parameters["reach_m"],
                hysteresis_m=parameters["hysteresis_m"],
                largest_normal=config.largest_normal,
                cover_sha256=sha256,
                jobs=common.jobs,
            )
        except AlulaError as error:
            raise type(error)(f"{path}: {error}") from error
        index = sealed(cut, key_id=key_id(key), provenance=provenance)
        facts = {"format": "tiles", **tiles_facts(index), "notes": []}
        if not path.is_file():
            facts["cover_sha256"] = sha256
        facts["fastest_m_s"] = round(fastest_m_s(cut.images[0], index.reach_m) - 5e-4, 3)
        if key is None:
            facts["notes"] = ["the index is not signed: readers cannot tell who made it; sign it with --sign"]
        recorded = msgspec.structs.replace(
            index, provenance=msgspec.structs.replace(provenance, summary=facts | {"notes": []})
        )

        def write() -> None:
            binary = index.binary()
            with atomic_folder(common.output) as folder:
                folder.mkdir()
                for tile, image in zip(index.tiles, cut.images, strict=True):
                    (folder / tile.file).write_bytes(image)
                (folder / BINARY).write_bytes(binary)
                if key is not None:
                    (folder / SIGNATURE).write_bytes(sign(binary, key))
                (folder / WHOLE).write_bytes(whole)
                text = msgspec.json.format(msgspec.json.encode(recorded, order="sorted"), indent=1)
                (folder / TILES).write_bytes(text + b"\n")

        return write, facts

    run(common, TILES_SCHEMA, TILES_VERSION, parameters, {"cover": path}, make, mark=TILES, members=MEMBERS)
