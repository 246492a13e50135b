"""Checks of map artifacts before a flight, and the index of a scene's ellipsoids."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from alula import _core
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.tiles import TileFiles
from alula.schemas.errors import ArtifactError, InputError, UsageError
from alula.stages.compression.cover_checks import require_solid_hulls
from alula.stages.compression.ellipsoids import retained, rows_of


def require_metric(role: str, artifact: Artifact) -> None:
    """Refuse an artifact that is not in metres.

    Raises:
        InputError: naming its role.
    """
    unit = artifact.manifest.unit
    if unit != "m":
        raise InputError(f"the {role} is in {unit} units, not metres; run scale-align first")


def require_obstacles(cover: Artifact, *, jobs: int = 0) -> None:
    """Refuse a cover whose hulls cannot be flown among.

    Raises:
        InputError: it is not in metres.
        ArtifactError: planes and vertices do not describe the same polytopes.
    """
    require_metric("cover", cover)
    require_solid_hulls(cover, jobs=jobs)


def beyond_hulls(inflation_m: float | None, cover: Artifact | None, suggested_m: float) -> float:
    """Length beyond the radius that shields keep from hulls; those of a cover have grown already.

    Args:
        inflation_m: of the user, if given.
        suggested_m: inflation that the scene's alignment suggests [m].

    Returns:
        At least 0 [m].
    """
    if inflation_m is not None or cover is None:
        return inflation_m or 0.0
    return max(0.0, suggested_m - float(cover.manifest.inflation_m))  # type: ignore[attr-defined]


def union_of(parts: Mapping[str, _core.ObstacleMap], *names: str) -> _core.ObstacleMap | None:
    """The union of some native maps; None without any.

    Args:
        names: of those to join; a name without a map is left out.
    """
    found = [parts[name] for name in names if name in parts]
    return None if not found else found[0] if len(found) == 1 else _core.MapUnion(found)


def ellipsoid_index(scene: Artifact | None, sigma: float, radius_m: float) -> _core.EllipsoidIndex:
    """The index of filters among a scene's ellipsoids, at the level `sigma` and for a sphere.

    Without a scene the index is empty.

    Raises:
        UsageError: the level or the radius is invalid for these ellipsoids.
    """
    if scene is None:
        rows3, rows4 = np.empty((0, 3), np.float32), np.empty((0, 4), np.float32)
        return _core.EllipsoidIndex(rows3, rows3, rows4, sigma=sigma, radius=radius_m or 1.0)
    rows = rows_of(scene, retained(scene, 0.0))
    try:
        return _core.EllipsoidIndex(
            rows.mean, rows.scale, rows.quat_wxyz, sigma=sigma, radius=radius_m, loss=rows.loss
        )
    except ValueError as error:
        raise UsageError(f"no barriers for this scene: {error}") from error


def tile_set(tiles: TileFiles) -> _core.TileSet:
    """A map in tiles, as the onboard code reads it.

    Raises:
        ArtifactError: the onboard code refuses the index.
    """
    try:
        return _core.TileSet(tiles.binary, list(tiles.images))
    except ValueError as error:
        raise ArtifactError(f"the index of the tiles: {error}") from error
