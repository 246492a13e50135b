"""Files that `alula fly` reads, and the obstacles that a filter sees in them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from alula.schemas.errors import UsageError

if TYPE_CHECKING:
    from alula.schemas.scenarios.scenario import Read


def inputs_of(
    source: Path, map_path: Path | None, scene: Path | None, vehicle: Path | None, within: Path | None
) -> tuple[dict[str, Path], Read | None]:
    """Paths of all inputs by role, and the scenario if there is one; its files are relative to its folder.

    Raises:
        WrongKindError: a file is of another kind.
        UsageError: the files do not go together, or there is no plan.
    """
    from alula.cli.verbs.sources import map_files, source_files
    from alula.schemas.scenarios.fly import flown_files
    from alula.schemas.scenarios.scenario import read_sources

    read = None
    if source.suffix == ".toml":
        read = read_sources(source)
        paths = flown_files(read.scenario, source.parent) | {"scenario": source}
        if map_path is not None:
            paths |= map_files(map_path)
        if scene is not None:
            paths["scene"] = scene
    else:
        paths = source_files(source, map_path, scene)
    given = {"vehicle": vehicle, "within": within}
    paths |= {role: path for role, path in given.items() if path is not None}
    if "plan" not in paths:
        raise UsageError(f"{source}: only a plan can be flown; make one with alula plan")
    return paths, read


def is_among_ellipsoids(name: str, paths: Mapping[str, Path]) -> bool:
    """Decide by the filter between flights by rates or accelerations (True) and by velocities among hulls.

    The filter `none` takes the cover if there is one.

    Raises:
        UsageError: there is no such filter, or its map is missing.
    """
    from alula.schemas.parameters.flight_defaults import NO_FILTER
    from alula.schemas.scenarios.check import TRACKING
    from alula.stages.filtering.ellipsoid_filters import ELLIPSOID_FILTERS
    from alula.stages.filtering.registry import FLIES_AMONG_HULLS, filter_kind

    if name == NO_FILTER:
        return "cover" not in paths
    kind = filter_kind(name)
    if name in TRACKING or kind == "sticks":
        raise UsageError(f"{name} is simulated only, in a scenario; see alula scenario")
    if kind != "velocity":
        if "scene" not in paths and not (name in FLIES_AMONG_HULLS and "cover" in paths):
            raise UsageError(f"{name} needs a scene, for its ellipsoids; add --scene to a cover")
        return True
    if "cover" not in paths:
        others = ", ".join(ELLIPSOID_FILTERS)
        raise UsageError(f"{name} needs a cover, for its hulls; in a scene --filter is {others} or none")
    return False
