"""Obstacles of a plan: hulls of a cover, ellipsoids of a scene, an onboard map, or several."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.lineage import origins_of
from alula.schemas.artifacts.manifest import CoverManifest, SceneManifest
from alula.schemas.errors import InfeasibleError, InputError
from alula.schemas.parameters.configs.plan import PlanConfig
from alula.stages.clearance import hull_obstacles, scene_obstacles, segment_clearance
from alula.stages.compression.cover_checks import require_solid_hulls
from alula.stages.compression.ellipsoids import removed_from
from alula.stages.compression.hulls import Hulls, image_hulls
from alula.stages.compression.level import (
    hull_words,
    level_of,
    level_words,
    omissions,
    recorded_level,
    scene_level,
)
from alula.stages.compression.onboard.image import decode_map
from alula.stages.compression.voxelize import sigma_of_confidence
from alula.stages.filtering.obstacles import beyond_hulls, ellipsoid_index, require_metric
from alula.stages.planning.corridor import Kept, Obstacles
from alula.stages.planning.inside import floor_of
from alula.stages.planning.mapped import Mapped, ellipsoid_box, within_crop
from alula.stages.planning.unseen import unseen_hulls

IMAGE_FRAME = "world"  # an onboard map does not name its frame
_WORDS = {
    "cover": "hull of the cover",
    "scene": "ellipsoid of the scene",
    "image": "hull of the onboard map",
    "seen": "point that was not seen",
}
_IMAGE_WORDS = "hull of the onboard map, which does not record its level"
_NEAR = ("an obstacle", "space that was not seen")
_FAR_M = 1e3  # distances of maps are measured up to this


class Ellipsoids(NamedTuple):
    """The ellipsoids of a scene at a level: as a set for proofs, and as a native map."""

    solids: _core.EllipsoidSet
    map: _core.ObstacleMap


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanMap:
    """One map among the obstacles of a plan.

    Attributes:
        role: cover, scene, image, or seen, whose obstacles are what was not seen.
        keep_m: distance that the plan keeps from it [m].
        obstacles: what the proof of the plan is about.
        map: the same as a native map.
        lower, upper: corners of a box around all obstacles, shape (3,) [m]; None without any.
        facts: for the manifest, with the level of the obstacles.
        level_words: an obstacle with its level, for guarantees.
        omits: what the level leaves out, in words.
        solids: the same as hulls or ellipsoids.
        short_m: maximum by which distances in `map` are smaller than those of `solids` [m].
        crop: box beyond which the map knows nothing, XMIN YMIN ZMIN XMAX YMAX ZMAX; None for none [m].
    """

    role: str
    keep_m: float
    solids: Obstacles
    obstacles: _core.PolytopeSet | _core.ObstacleMap
    map: _core.ObstacleMap
    lower: FloatArray | None
    upper: FloatArray | None
    facts: dict[str, Any]
    level_words: str
    omits: tuple[str, ...] = ()
    short_m: float = 0.0
    crop: tuple[float, ...] | None = None

    @property
    def extent_m(self) -> float:
        """Largest coordinate of the box around the obstacles [m]."""
        corners = [each for each in (self.lower, self.upper) if each is not None]
        return float(np.abs(corners).max(initial=0.0))

    @property
    def is_of_hulls(self) -> bool:
        """Whether the proof is by separating planes."""
        return isinstance(self.obstacles, _core.PolytopeSet)

    @property
    def words(self) -> str:
        """An obstacle in words, for messages."""
        return _WORDS[self.role]


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanSpace:
    """The obstacles of a plan.

    Attributes:
        maps: at least one.
        keep_m: the least distance that a plan keeps from a map [m].
        map: all obstacles, where those that need a larger distance have grown by the difference.
        floor_m: height of the floor that the scene was levelled to; None where it was not [m].
    """

    maps: tuple[PlanMap, ...]
    frame: str
    keep_m: float
    map: _core.ObstacleMap
    floor_m: float | None = None

    @classmethod
    def of(cls, maps: Sequence[PlanMap], frame: str, floor_m: float | None = None) -> PlanSpace:
        """Join maps in one frame.

        Args:
            maps: at least one.
            floor_m: height of the floor, if it is known [m].
        """
        keep = min(one.keep_m for one in maps)
        grown = [
            one.map if one.keep_m == keep else _core.GrownMap(one.map, one.keep_m - keep) for one in maps
        ]
        joined = grown[0] if len(grown) == 1 else _core.MapUnion(grown)
        return cls(maps=tuple(maps), frame=frame, keep_m=keep, map=joined, floor_m=floor_m)

    def kept(self, more_m: float) -> PlanSpace:
        """The same obstacles, from which plans keep a larger distance.

        Args:
            more_m: by which it is larger [m].
        """
        maps = [
            replace(one, keep_m=one.keep_m + more_m, facts=one.facts | {"keep_m": one.keep_m + more_m})
            for one in self.maps
        ]
        return PlanSpace.of(maps, self.frame, self.floor_m)

    def distances(self) -> str:
        """Distances that a plan keeps, and from what, with the level of the obstacles, in words."""
        each = [f"{one.keep_m:g} m from every {one.level_words}" for one in self.maps]
        return ", and ".join(each)

    def omits(self) -> list[str]:
        """What the levels of the obstacles leave out, in words."""
        return list(dict.fromkeys(words for one in self.maps for words in one.omits))

    def solids(self) -> list[Kept]:
        """Obstacles of all maps, with the distance to keep from them beyond `keep_m`."""
        return [Kept(one.solids, one.keep_m - self.keep_m + one.short_m) for one in self.maps]

    def box(self) -> tuple[FloatArray, FloatArray] | None:
        """Corners of a box around all obstacles, each of shape (3,) [m]; None without any."""
        boxes = [(one.lower, one.upper) for one in self.maps if one.lower is not None]
        if not boxes:
            return None
        lower, upper = (np.array(each) for each in zip(*boxes, strict=True))
        return lower.min(axis=0), upper.max(axis=0)

    def nearest_part(self, point: Sequence[float]) -> str:
        """What is nearest to a point, beyond the distance to keep from it: an obstacle, or unseen space.

        Args:
            point: shape (3,) [m].
        """
        at = np.array([point], np.float64)
        away = [float(one.map.distance(at, one.keep_m)[0]) - one.keep_m for one in self.maps]
        return _NEAR[self.maps[int(np.argmin(away))].role == "seen"]

    def is_free(self, points: ArrayLike, radius_m: float) -> Any:
        """Whether balls at points are free, shape (N,); never wrongly true.

        Args:
            points: shape (N, 3) [m].
            radius_m: of the balls, where obstacles have not grown [m].
        """
        at = np.ascontiguousarray(points, np.float64)
        return self.map.is_clear(at, at, radius_m)

    def clearance_m(self, points: ArrayLike, jobs: int = 0) -> float | None:
        """Distance of a path from the nearest obstacle, ungrown [m]; None if there is nothing within 1 km.

        Args:
            points: shape (T, 3), T > 1 [m].
        """
        path = np.ascontiguousarray(points, np.float64)
        least = _FAR_M
        for one in self.maps:
            # What is farther than one of the points does not matter, and is passed over quickly.
            least = min(least, float(one.map.distance(path[::16], least).min()) + 1e-9)
            if isinstance(one.obstacles, _core.PolytopeSet):
                found = segment_clearance(path[:-1], path[1:], one.obstacles, jobs, least)
            else:
                found = one.map.segment_distance(path[:-1], path[1:], least)
            least = min(least, float(found.min()))
        return least if least < _FAR_M else None


def plan_space(
    config: PlanConfig,
    cover: Artifact | None = None,
    scene: Artifact | None = None,
    image: bytes | None = None,
    within: Artifact | None = None,
    *,
    ellipsoids: Ellipsoids | None = None,
    jobs: int = 0,
) -> PlanSpace:
    """Make the obstacles of a plan, each with the distance to keep from it.

    Of a configuration with a margin, this is `radius_m` and what filters add to it: among ellipsoids
    `inflation_m`, or else the inflation that the scene's alignment suggests; for hulls what of that the
    cover lacks. Of a configuration without a margin `radius_m` is the whole distance.

    Args:
        config: complete, see `resolve_plan`.
        within: an `alula/seen`; what it does not list is an obstacle, from which plans keep `radius_m`.
        ellipsoids: of the scene at the level of the configuration, where they have been made before.

    Raises:
        ArtifactError: planes and vertices of the cover do not describe the same polytopes, or the onboard map
            is damaged.
        InputError: a map is not metric, or the maps are in different frames.
        UsageError: the level is invalid for these ellipsoids.
    """
    given = {"cover": cover, "scene": scene, "seen space": within}
    maps = {role: each for role, each in given.items() if each is not None}
    for role, each in maps.items():
        require_metric(role, each)
    frames = {role: each.manifest.frame for role, each in maps.items()}
    if len(set(frames.values())) > 1:
        words = ", ".join(f"the {role} is in frame {frame!r}" for role, frame in frames.items())
        raise InputError(f"the maps do not fit each other: {words}")
    suggested = 0.0 if scene is None else float(scene.manifest.suggested_inflation_m)  # type: ignore[attr-defined]
    is_whole = config.margin_m is None
    inflation = suggested if config.inflation_m is None else config.inflation_m
    kept = []
    if cover is not None:
        beyond = 0.0 if is_whole else beyond_hulls(config.inflation_m, cover, suggested)
        kept.append(_cover_map(cover, config.keep_m, beyond, jobs))
    if image is not None:
        kept.append(_image_map(image, config.keep_m, config.inflation_m or 0.0))
    if scene is not None:
        sigma = config.sigma if config.confidence is None else sigma_of_confidence(config.confidence)
        kept.append(scene_map(scene, sigma, config.keep_m, 0.0 if is_whole else inflation, ellipsoids))
    if within is not None:
        kept.append(_seen_map(within, config.keep_m))
    floors = [floor for each in maps.values() if (floor := floor_of(each)) is not None]
    return PlanSpace.of(kept, next(iter(frames.values()), IMAGE_FRAME), max(floors, default=None))


def _origins(cover: Artifact) -> dict[str, Any]:
    """What the cover's voxels were made from, by which another map of the same scene is recognised."""
    manifest = cover.manifest
    found = origins_of(manifest) if isinstance(manifest, CoverManifest) else []
    return {"made_from": found} if found else {}


def _cover_map(cover: Artifact, keep_m: float, beyond_m: float, jobs: int) -> PlanMap:
    require_solid_hulls(cover, jobs=jobs)
    level = level_of(cover)
    facts = {
        "map": "cover",
        "inflation_m": beyond_m,
        "keep_m": keep_m + beyond_m,
        "level": recorded_level(level),
        **_origins(cover),
    }
    hulls, left_out = Hulls.from_cover(cover), omissions(level)
    one = _hull_map("cover", hulls, keep_m + beyond_m, facts, hull_words(level), left_out)
    return replace(one, crop=None if level.crop is None else tuple(level.crop))


def _seen_map(within: Artifact, keep_m: float) -> PlanMap:
    level = level_of(within)
    facts = {"map": "seen", "keep_m": keep_m, "level": recorded_level(level)}
    left_out = omissions(level, is_cropped=False)
    return _hull_map("seen", unseen_hulls(within), keep_m, facts, _WORDS["seen"], left_out)


def _hull_map(
    role: str, hulls: Hulls, keep_m: float, facts: dict[str, Any], words: str, left_out: Sequence[str]
) -> PlanMap:
    obstacles = hull_obstacles(hulls)
    points = hulls.vertices_world
    return PlanMap(
        role=role,
        keep_m=keep_m,
        solids=obstacles,
        obstacles=obstacles,
        map=_core.HullMap(obstacles),
        lower=points.min(axis=0) if len(points) else None,
        upper=points.max(axis=0) if len(points) else None,
        facts=facts,
        level_words=words,
        omits=tuple(left_out),
    )


def scene_map(
    scene: Artifact,
    sigma: float,
    keep_m: float,
    inflation_m: float = 0.0,
    ellipsoids: Ellipsoids | None = None,
) -> PlanMap:
    """The ellipsoids of a scene.

    Args:
        keep_m: distance to keep, without the inflation [m].
        inflation_m: distance to keep beyond that [m].
        ellipsoids: of the scene at this level, where they have been made before.

    Raises:
        UsageError: the level or the distance is invalid for these ellipsoids.
    """
    if ellipsoids is None:
        among = _core.EllipsoidMap(ellipsoid_index(scene, sigma, keep_m + inflation_m))
        ellipsoids = Ellipsoids(scene_obstacles(scene, sigma), among)
    corners = ellipsoid_box(scene, sigma)
    return PlanMap(
        role="scene",
        keep_m=keep_m + inflation_m,
        solids=ellipsoids.solids,
        obstacles=ellipsoids.map,
        map=ellipsoids.map,
        lower=corners[0][0] if corners else None,
        upper=corners[1][0] if corners else None,
        facts={
            "map": "scene",
            "sigma": sigma,
            "inflation_m": inflation_m,
            "keep_m": keep_m + inflation_m,
            "level": scene_level(sigma),
        },
        level_words=f"ellipsoid of the scene at {level_words(sigma)}",
        omits=tuple(removed_from(scene.manifest)) if isinstance(scene.manifest, SceneManifest) else (),
    )


def _image_map(image: bytes, keep_m: float, inflation_m: float) -> PlanMap:
    decoded = decode_map(image)
    among = _core.ImageMap(image[: decoded.image_bytes])
    edge = decoded.voxel_size_m
    return PlanMap(
        role="image",
        keep_m=keep_m + inflation_m,
        solids=hull_obstacles(image_hulls(decoded)),
        short_m=2 * decoded.margin_m,
        obstacles=among,
        map=among,
        lower=edge * decoded.lower.min(axis=0) if len(decoded) else None,
        upper=edge * decoded.upper.max(axis=0) if len(decoded) else None,
        facts={
            "map": "image",
            "cover_hash": decoded.cover_hash.hex(),
            "inflation_m": inflation_m,
            "keep_m": keep_m + inflation_m,
        },
        level_words=_IMAGE_WORDS,
    )


def mapped_box(space: PlanSpace, beyond_m: float = 0.0) -> Mapped | None:
    """The box beyond which the obstacles' maps know nothing; None without obstacles.

    Args:
        beyond_m: see `Mapped`.
    """
    box = space.box()
    if box is None:
        return None
    for one in space.maps:
        box = within_crop(box, one.crop)
    return Mapped(*box, beyond_m)


def room_around(
    config: PlanConfig, space: PlanSpace, points: Sequence[Sequence[float]]
) -> tuple[FloatArray, FloatArray]:
    """Corners of the box for the centre of the vehicle: within what is mapped, and the given bounds.

    Without bounds no way leads below the floor, where it is known and no point of the flight is there.

    Args:
        points: of the flight, around which there is room where nothing is mapped at all [m].

    Raises:
        InfeasibleError: bounds and mapped box have no point in common.
        InputError: the map has no finite bounds.
    """
    mapped = mapped_box(space, config.beyond_map_m)
    given = None if config.bounds is None else (np.array(config.bounds[:3]), np.array(config.bounds[3:]))
    if mapped is None:
        if given is not None:
            return given
        every, room = np.array(points, np.float64).reshape(-1, 3), 3 * space.keep_m
        lower, upper = every.min(axis=0) - room, every.max(axis=0) + room
    else:
        lower, upper = mapped.room(space.keep_m)
        heights = [point[2] for point in points]
        if given is None and space.floor_m is not None and min(heights, default=math.inf) >= space.floor_m:
            lower[2] = min(max(lower[2], space.floor_m), upper[2])  # no way below the floor
    if not math.isfinite(float(np.abs([lower, upper]).max())):
        raise InputError("the map has no finite bounds")
    if given is not None:
        lower, upper = np.maximum(lower, given[0]), np.minimum(upper, given[1])
        if not (lower <= upper).all():
            raise InfeasibleError("--bounds and the mapped box have no point in common that keeps the radius")
    return lower, upper
