"""Files that `simulate` and `fly` take in place of a scenario: a cover, a scene, or a plan with its map."""

from __future__ import annotations

from pathlib import Path

from alula.schemas.errors import UsageError, WrongKindError


def map_role(path: Path) -> str:
    """Role of a map: `cover` or `scene`.

    Args:
        path: of the map.

    Raises:
        WrongKindError: it is another artifact.
    """
    from alula.schemas.kinds import COVER, SCENE
    from alula.schemas.parts import manifest_of

    found = manifest_of(path).schema
    if found not in (COVER.name, SCENE.name):
        raise WrongKindError(f"{path}: is {found}, but {COVER.name} or {SCENE.name} is needed")
    return found.removeprefix("alula/")


def source_files(source: Path, map_path: Path | None, scene: Path | None) -> dict[str, Path]:
    """Paths of a cover, a scene or a plan and of its map, by role.

    Args:
        source: plan, cover or scene.
        map_path: cover or scene of --map.
        scene: of --scene.

    Raises:
        WrongKindError: a file is of another kind.
        UsageError: the files do not go together.
    """
    from alula.schemas.kinds import COVER, PLAN, SCENE
    from alula.schemas.parts import manifest_of

    found = manifest_of(source).schema
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
    files = {role: source}
    if map_path is not None:
        files[map_role(map_path)] = map_path
    if scene is not None:
        files["scene"] = scene
    return files
