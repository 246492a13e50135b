"""Files that `simulate` and `fly` take in place of a scenario: a cover, a scene, or a plan with its map."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from alula.schemas.errors import UsageError, WrongKindError

if TYPE_CHECKING:
    from alula.schemas.artifacts.tiles import TileFiles


def map_role(path: Path) -> str:
    """Role of a map: `cover` or `scene`.

    Raises:
        WrongKindError: it is another artifact.
    """
    from alula.schemas.artifacts.kinds import COVER, SCENE
    from alula.schemas.artifacts.parts import manifest_of

    found = manifest_of(path).schema
    if found not in (COVER.name, SCENE.name):
        raise WrongKindError(f"{path}: is {found}, but {COVER.name} or {SCENE.name} is needed")
    return found.removeprefix("alula/")


def map_files(path: Path) -> dict[str, Path]:
    """Files of a map by role: `cover` or `scene`; of a map in tiles `tiles`, and the cover in its folder.

    Args:
        path: of a cover or a scene, or the folder of a map in tiles.

    Raises:
        WrongKindError: it is another artifact.
    """
    from alula.schemas.artifacts.tiles import WHOLE, is_tiles

    return {"cover": path / WHOLE, "tiles": path} if is_tiles(path) else {map_role(path): path}


def source_files(source: Path, map_path: Path | None, scene: Path | None) -> dict[str, Path]:
    """Paths of a cover, a scene or a plan and of its map, by role.

    Args:
        source: plan, cover or scene, or the folder of a map in tiles.
        map_path: cover, scene or tiles of --map.

    Raises:
        WrongKindError: a file is of another kind.
        UsageError: the files do not go together.
    """
    from alula.schemas.artifacts.kinds import COVER, PLAN, SCENE
    from alula.schemas.artifacts.parts import manifest_of
    from alula.schemas.artifacts.tiles import is_tiles

    found = COVER.name if is_tiles(source) else manifest_of(source).schema
    if found not in (COVER.name, PLAN.name, SCENE.name):
        raise WrongKindError(
            f"{source}: is {found}, but a scenario, {PLAN.name}, {COVER.name} or {SCENE.name} is needed"
        )
    role = found.removeprefix("alula/")
    if role != "plan" and map_path is not None:
        raise UsageError(f"{source} is a {role}; --map is for plans and scenarios")
    if role == "plan" and map_path is None:
        raise UsageError("a plan needs --map: a cover or a scene to fly it in")
    if role == "scene" and scene is not None:
        raise UsageError(f"{source} is a scene; --scene is for covers")
    files = {role: source} if role == "plan" else map_files(source)
    if map_path is not None:
        files |= map_files(map_path)
    if scene is not None:
        files["scene"] = scene
    return files


def read_tiles_of(paths: dict[str, Path], key_path: Path | None) -> TileFiles | None:
    """Read the map in tiles among the files of a run; None without one.

    Args:
        paths: files by role; the path of `tiles` becomes that of the file that lists all others.
        key_path: of the key that must have signed it; None for any tiles.

    Raises:
        UsageError: there is a key, and there are no tiles.
        InputError, ArtifactError: they cannot be read, or are of another cover than the file `cover`.
        CheckError: they are not signed with the key.
    """
    from alula.schemas.artifacts.artifact import file_hash
    from alula.schemas.artifacts.signing_key import read_key
    from alula.schemas.artifacts.tiles import TILES, read_tiles
    from alula.schemas.errors import InputError

    if "tiles" not in paths:
        if key_path is not None:
            raise UsageError("--key is for tiles; give their folder as --map")
        return None
    folder = paths["tiles"]
    found = read_tiles(folder, None if key_path is None else read_key(key_path))
    if "cover" in paths and file_hash(paths["cover"])[:16] != found.index.cover_hash:
        raise InputError(f"{folder}: its tiles were cut from another cover than {paths['cover']}")
    paths["tiles"] = folder / TILES
    return found
