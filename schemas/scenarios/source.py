"""Scenario that stands for a cover, a scene or a plan on a command line: values that a file would have."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from alula.schemas.artifacts.artifact import read_manifest
from alula.schemas.parameters.flight_defaults import NO_FILTER, filter_in
from alula.schemas.scenarios.check import TRACKING
from alula.schemas.scenarios.vehicles import VEHICLES, point_limits

_LOGGED = 1000  # first flights in the log, besides the worst ones


def source_tree(
    files: Mapping[str, Path],
    kind_of: Callable[[str], str],
    *,
    filters: Sequence[str] | None = None,
    vehicle: str | None = None,
    speed_m_s: float | None = None,
) -> dict[str, Any]:
    """Plain values of a scenario in which a cover or a scene is flown through, or a plan is flown.

    The ellipsoids of a scene beside a cover have the level of the cover.

    Args:
        files: `cover`, `scene`, `plan`; at least one of the first two.
        kind_of: kind of command of a filter, by its name.
        filters: names; default: as `filter_in`.
        vehicle: name of a built-in vehicle, or a file; default: the one that the filters are made for, a
            point moved by velocities or accelerations, a racer or the quadrotor of FastBridge.
        speed_m_s: of the mission, or limit of the point.

    Raises:
        InputError, ArtifactError: plan or cover cannot be read.
        UsageError: there is no such filter.
    """
    names = list(filters or ()) if filters is not None else [filter_in(files)]
    names = [name for name in names if name != NO_FILTER]
    mission: dict[str, Any] = {"kind": "plan" if "plan" in files else "pairs"}
    if "plan" in files:
        mission["plan"] = str(files["plan"])
    flown = (
        vehicle_table(vehicle)
        if vehicle is not None
        else {"type": _made_for(names, {kind_of(name) for name in names}, "cover" in files)}
    )
    if vehicle is None and flown["type"] == "single-integrator":
        flown |= point_limits(files.get("plan"), speed_m_s=speed_m_s)
    elif speed_m_s is not None:
        mission["speed_m_s"] = speed_m_s
    world: dict[str, Any] = {role: str(files[role]) for role in ("cover", "tiles", "scene") if role in files}
    if {"cover", "scene"} <= files.keys():
        manifest: Any = read_manifest(files["cover"])
        if manifest.sigma is not None:  # the obstacles of the cover are ellipsoids, too
            world["sigma"] = float(manifest.sigma)
    return {
        "vehicle": flown,
        "world": world,
        "mission": mission,
        "safety": {"filters": names},
        "rules": {"logged": _LOGGED},
    }


def vehicle_table(vehicle: str) -> dict[str, Any]:
    """Values of the table `vehicle` for a built-in vehicle or a file.

    Args:
        vehicle: a name of `VEHICLES`, or else a file.
    """
    return {"type": vehicle} if vehicle in VEHICLES else {"file": vehicle}


def _made_for(names: Sequence[str], kinds: set[str], has_cover: bool) -> str:
    """Name of the built-in vehicle that filters are made for; without one, of the world."""
    if "velocity" in kinds or (not names and has_cover):
        return "single-integrator"
    if "sticks" in kinds:
        return "racer7"
    return "double-integrator" if names and TRACKING.issuperset(names) else "fastbridge"
