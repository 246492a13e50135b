"""Static obstacles: hulls, ellipsoids, fence and walls as native maps, for filters and for the judge."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.manifest import LevelManifest
from alula.schemas.artifacts.tiles import TileFiles
from alula.schemas.errors import InputError, UsageError
from alula.schemas.scenarios.moving import WallTable
from alula.schemas.scenarios.scenario import Scenario
from alula.stages.clearance import hull_obstacles, scene_obstacles, segment_clearance
from alula.stages.compression.hulls import Hulls
from alula.stages.compression.onboard.layout import encode_map
from alula.stages.compression.voxelize import sigma_of_confidence
from alula.stages.filtering.obstacles import (
    beyond_hulls,
    ellipsoid_index,
    require_metric,
    require_obstacles,
    tile_set,
    union_of,
)
from alula.stages.filtering.protocol import Kept
from alula.stages.planning.inside import floor_of
from alula.stages.planning.mapped import BEYOND_KEY, Mapped, ellipsoid_box, within_crop
from alula.stages.planning.space import Ellipsoids
from alula.stages.planning.unseen import is_seen, joined, unseen_hulls
from alula.stages.vehicles.fence import fence_faces

# Around static obstacles and references; a flight that leaves this box is refused. Those among moving
# obstacles may fly far.
_BEYOND_M, _BEYOND_MOVING_M = 20.0, 1e3
_FACES = np.concatenate([np.eye(3), -np.eye(3)])
_CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float64)


@dataclass(frozen=True, slots=True, kw_only=True)
class StaticWorld(Kept):
    """Static obstacles of a run.

    Attributes:
        radius_m, inflation_m: see `Kept`.
        hulls: of the cover, the walls and unseen space; None without any.
        polytopes: the same as a native set.
        ellipsoids: of the scene, for the judge; None without a scene.
        index: of the scene for filters; empty without a scene, and where none of them reads it.
        faces: of the fence, shape (L, 4), rows (n, d) with unit n and n . p <= d inside.
        parts: native maps by name, of those there are: ellipsoids (where filters read them), hulls, fence.
        seen: space that was seen; the boxes of all other space are among the hulls.
        image: the cover as an onboard map; empty unless filters read it.
        tiles: the cover in tiles; None unless a filter reads them.
        scene: that the scenario names; None without one.
        floor_m: height of the floor that the scene was levelled to; None where it was not [m].
        mapped: box around the hulls and ellipsoids of cover, scene and seen space; None without any.
        claims: of the guarantees of scene and cover, for that of the run.
        suggested_inflation_m: bound of the error of the scene's alignment [m].
    """

    sigma: float
    hulls: Hulls | None
    polytopes: _core.PolytopeSet | None
    ellipsoids: _core.EllipsoidSet | None
    index: _core.EllipsoidIndex
    faces: FloatArray
    parts: dict[str, _core.ObstacleMap]
    seen: Artifact | None
    image: bytes
    tiles: _core.TileSet | None
    scene: Artifact | None
    floor_m: float | None
    mapped: Mapped | None
    claims: dict[str, Any]
    suggested_inflation_m: float

    @property
    def vertices(self) -> FloatArray:
        """Vertices of the hulls, shape (N, 3) [m]."""
        return np.empty((0, 3)) if self.hulls is None else self.hulls.vertices_world

    @property
    def centres(self) -> FloatArray:
        """Vertices of the hulls and centres of the Gaussians, shape (N, 3) [m]."""
        points = [] if self.scene is None else [self.scene["mean"]]
        return np.concatenate([self.vertices, *points], dtype=np.float64)

    @property
    def among(self) -> Ellipsoids | None:
        """The ellipsoids for planners: the map of the filters that read them, or that of the judge's set."""
        if self.ellipsoids is None:
            return None
        return Ellipsoids(
            self.ellipsoids, self.parts.get("ellipsoids") or _core.EllipsoidSetMap(self.ellipsoids)
        )

    @property
    def map(self) -> _core.ObstacleMap | None:
        """All static obstacles; None without any."""
        return self.of(*self.parts)

    @property
    def most_keep_m(self) -> float:
        """The largest distance that filters keep from a part of the world [m]."""
        return self.keeps_m(*self.parts)

    def of(self, *names: str) -> _core.ObstacleMap | None:
        """The union of some parts; None without any."""
        return union_of(self.parts, *names)

    def clearance(self, start: FloatArray, end: FloatArray, cap_m: float, jobs: int) -> FloatArray:
        """Signed distance of segments to the nearest static obstacle, fence included.

        Args:
            start: shape (S, 3), world frame [m].
            end: shape (S, 3).
            cap_m: larger distances are returned as this [m].

        Returns:
            Shape (S,) [m].
        """
        start, end = np.ascontiguousarray(start), np.ascontiguousarray(end)
        sets = [each for each in (self.polytopes, self.ellipsoids) if each is not None]
        found = [np.full(len(start), cap_m), self.inside(start), self.inside(end)]
        found += [segment_clearance(start, end, each, jobs, cap_m) for each in sets]
        least: FloatArray = np.min(found, axis=0)
        return least

    def extent_m(
        self, points: Sequence[FloatArray], *, speed_m_s: float, lag_s: float, radii: float = 1
    ) -> float:
        """Twice the largest coordinate of obstacles and points, and a second of flight [m].

        Filters of velocities refuse beyond it, and bound their rounding by it.

        Args:
            points: each of shape (N, 3) [m].
            speed_m_s: limit of velocity commands [m/s].
            lag_s: with which they are followed, at most [s].
            radii: number of radii by which flights may lead around the points.
        """
        known = self.centres if self.hulls is None else self.vertices
        largest = float(np.abs(np.concatenate([known, *points])).max(initial=1.0))
        return 2 * largest + radii * self.radius_m + (1 + lag_s) * speed_m_s

    def inside(self, points: FloatArray) -> FloatArray:
        """Distance of points from the nearest face of the fence, negative outside; infinite without one.

        Args:
            points: shape (N, 3) [m].

        Returns:
            Shape (N,) [m].
        """
        if len(self.faces) == 0:
            return np.full(len(points), np.inf)
        least: FloatArray = (self.faces[:, 3:] - self.faces[:, :3] @ points.T).min(axis=0)
        return least

    def room(
        self, paths: list[FloatArray], *, has_moving: bool
    ) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Lower and upper corner of the box that no flight may leave [m].

        Args:
            paths: points of the references, each of shape (N, 3) [m].
        """
        means = [] if self.scene is None else [self.scene["mean"]]
        points = [each for each in (self.vertices, *means, *paths) if len(each)]
        beyond = _BEYOND_MOVING_M if has_moving else _BEYOND_M
        lower = np.min([each.min(axis=0).astype(np.float64) for each in points], axis=0) - beyond
        upper = np.max([each.max(axis=0).astype(np.float64) for each in points], axis=0) + beyond
        return tuple(lower), tuple(upper)


def require_named(scenario: Scenario, **files: Artifact | None) -> None:
    """Check the files that were read for a scenario.

    Args:
        files: by role: cover, scene, seen, plan; None where there is none.

    Raises:
        UsageError: the scenario names another set of files.
        InputError: one is not metric, or they are not in one frame.
    """
    table = scenario.world
    named = {"cover": table.cover, "scene": table.scene, "seen": table.seen, "plan": scenario.mission.plan}
    for role, file in files.items():
        key = f"{'mission' if role == 'plan' else 'world'}.{role}"
        if file is None and named[role] is not None:
            raise UsageError(
                f"`$.{key}`: the {role} {named[role]!r} was not given; give it, or leave the key out"
            )
        if file is not None and named[role] is None:
            raise UsageError(f"`$.{key}`: a {role} was given, which the scenario does not name; set {key}")
    given = [(role, file) for role, file in files.items() if file is not None]
    for role, file in given:
        require_metric(role, file)
        first, frame = given[0][0], given[0][1].manifest.frame
        if file.manifest.frame != frame:
            raise InputError(f"the {first} is in frame {frame!r}, the {role} in {file.manifest.frame!r}")


def static_world(
    scenario: Scenario,
    *,
    cover: Artifact | None,
    scene: Artifact | None,
    seen: Artifact | None = None,
    tiles: TileFiles | None = None,
    beyond_map_m: float = 0.0,
    needs_image: bool,
    needs_index: bool,
    jobs: int,
) -> StaticWorld:
    """Make the static world of a scenario.

    Args:
        beyond_map_m: distance around the mapped box in which space counts as free [m].
        needs_image: whether a filter reads the cover as an onboard map.
        needs_index: whether a filter, or the choice of starts, reads the ellipsoids; the judge does not.

    Raises:
        InputError: the cover is not metric.
        ArtifactError: planes and vertices of the cover do not describe the same polytopes.
        UsageError: the level or the radius is invalid for these ellipsoids.
    """
    table = scenario.world
    if cover is not None:
        require_obstacles(cover, jobs=jobs)
    sigma = table.sigma if table.confidence is None else sigma_of_confidence(table.confidence)
    suggested = 0.0 if scene is None else _suggested(scene)
    inflation = suggested if table.inflation_m is None else table.inflation_m
    assert scenario.vehicle.radius_m is not None
    kept = Kept(
        radius_m=scenario.vehicle.radius_m,
        inflation_m={
            "ellipsoids": inflation,
            "hulls": beyond_hulls(table.inflation_m, cover, suggested),
        },
    )
    hulls = static_walls(table.walls, cover, seen)
    polytopes = None if hulls is None else hull_obstacles(hulls)
    index = ellipsoid_index(scene if needs_index else None, sigma, kept.keeps_m("ellipsoids"))
    box = None if table.fence is None else table.fence.box_m
    faces = fence_faces(box, () if table.fence is None else table.fence.faces)
    parts: dict[str, _core.ObstacleMap] = {}
    if scene is not None and needs_index:
        parts["ellipsoids"] = _core.EllipsoidMap(index)
    image = encode_map(cover, indexed=True, jobs=jobs) if cover is not None and needs_image else b""
    if polytopes is not None and hulls is not None and len(hulls.plane_start) > 1:
        reads = table.onboard and image and not table.has_boxes
        parts["hulls"] = _core.ImageMap(image) if reads else _core.HullMap(polytopes)
    if len(faces):
        parts["fence"] = _core.FenceMap(np.ascontiguousarray(faces[:, :3]), np.ascontiguousarray(faces[:, 3]))
    return StaticWorld(
        radius_m=kept.radius_m,
        inflation_m=kept.inflation_m,
        sigma=sigma,
        hulls=hulls,
        polytopes=polytopes,
        ellipsoids=None if scene is None else scene_obstacles(scene, sigma),
        index=index,
        faces=faces,
        parts=parts,
        seen=seen,
        image=image,
        tiles=None if tiles is None else tile_set(tiles),
        scene=scene,
        floor_m=max(
            (at for each in (cover, scene) if each is not None and (at := floor_of(each)) is not None),
            default=None,
        ),
        mapped=_mapped(None if cover is None and seen is None else hulls, scene, sigma, beyond_map_m, cover),
        claims={
            f"{name}_claims": {} if each.manifest.guarantee is None else each.manifest.guarantee.claims
            for name, each in (("scene", scene), ("cover", cover))
            if each is not None
        },
        suggested_inflation_m=suggested,
    )


def _mapped(
    hulls: Hulls | None, scene: Artifact | None, sigma: float, beyond_m: float, cover: Artifact | None
) -> Mapped | None:
    """The mapped box: a world that is only walls, fence and moving obstacles is known everywhere."""
    points = [] if hulls is None else [hulls.vertices_world]
    if scene is not None:
        points += ellipsoid_box(scene, sigma)
    corners = np.concatenate([np.empty((0, 3)), *points])
    if not len(corners):
        return None
    crop = cover.manifest.crop if cover is not None and isinstance(cover.manifest, LevelManifest) else None
    return Mapped(*within_crop((corners.min(axis=0), corners.max(axis=0)), crop), beyond_m)


def _suggested(scene: Artifact) -> float:
    manifest: Any = scene.manifest
    return float(manifest.suggested_inflation_m)


def require_clear(world: StaticWorld, points: FloatArray, what: str, jobs: int) -> None:
    """Refuse starts and goals that touch an obstacle or are outside of the mapped box.

    Args:
        points: shape (N, 3), world frame [m].
        what: the points in words.

    Raises:
        UsageError: one does.
    """
    if world.mapped is not None:
        named = [(what, point) for point in points.tolist()]
        if (words := world.mapped.refusal(named, world.radius_m, BEYOND_KEY)) is not None:
            raise UsageError(words)
    if world.seen is not None and not (known := is_seen(world.seen, points)).all():
        where = " ".join(f"{value:.3f}" for value in points[np.argmin(known)])
        raise UsageError(f"{what} at ({where}) is not in the space that was seen")
    clear: NDArray[Any] = world.clearance(points, points, world.radius_m + 1, jobs) - world.radius_m
    if len(clear) and clear.min() < 0:
        i = int(np.argmin(clear))
        where = " ".join(f"{value:.3f}" for value in points[i])
        raise UsageError(
            f"{what} at ({where}) is {-clear[i]:.3g} m inside an obstacle or outside of the fence"
        )


def static_walls(
    walls: Sequence[WallTable], cover: Artifact | None, seen: Artifact | None = None
) -> Hulls | None:
    """Join hulls of a cover, boxes of a scenario and those of unseen space to one set; None without any.

    Args:
        cover: an `alula/cover`, in metres, if there is one.
    """
    parts = [_box(wall) for wall in walls]
    if cover is not None:
        parts.insert(0, Hulls.from_cover(cover))
    if seen is not None:
        parts.append(unseen_hulls(seen))
    return joined(parts) if parts else None


def _box(wall: WallTable) -> Hulls:
    lower, upper = np.array(wall.lower_m, np.float64), np.array(wall.upper_m, np.float64)
    return Hulls(
        normal_world=_FACES.copy(),
        offset_m=np.concatenate([upper, -lower]),
        plane_start=np.array([0, 6], np.int64),
        vertices_world=lower + _CORNERS * (upper - lower),
        vertex_start=np.array([0, 8], np.int64),
    )
