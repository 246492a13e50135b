"""The stage `observe`: mark the voxels that were seen to be free, and that a vehicle can reach."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.artifact import Artifact, make_artifact
from alula.schemas.artifacts.kinds import SEEN
from alula.schemas.artifacts.manifest import Guarantee, SceneManifest, map_origin
from alula.schemas.artifacts.provenance import parameters_of
from alula.schemas.decimals import at_most, exact
from alula.schemas.errors import InfeasibleError, InputError, UsageError
from alula.schemas.parameters.configs.observe import LONGEST_RADIUS_VOXELS, ObserveConfig
from alula.schemas.progress import Progress
from alula.stages.alignment.estimates import VISIBLE
from alula.stages.alignment.evidence import UNCHECKED
from alula.stages.alignment.model_frame import ModelFrame, model_frame
from alula.stages.alignment.uncertainty import CONFIDENCE
from alula.stages.compression.ellipsoids import excluded_errors, retained, rows_of
from alula.stages.compression.level import level_words, require_sigma
from alula.stages.compression.voxelize import voxelize
from alula.stages.planning.pinholes import Pinholes
from alula.stages.planning.reach import (
    Mask,
    centres_of,
    components,
    is_line_clear,
    layers_of,
    rim,
    touched,
)

MAX_BOX = (
    _core.MAX_VOXELS
)  # voxels of the box: 2 bytes for the views of each, and 12 while the reach is found
_WORTH = 0.25  # excess of an ellipsoid's first bound that justifies the second [voxels]
_TRIED = 2000  # places near a camera that are tried as a start, nearest first


@dataclass(frozen=True, slots=True)
class _Space:
    """What is known of the voxels of a box.

    Attributes:
        lower: lowest voxel of the box, shape (3,).
        blocked: voxels that an obstacle touches.
        free: voxels that are taken for free.
        views: number of cameras that see each.
        starts: voxels with a ball around their centre from which the others must be reached, relative to
            `lower`, shape (n, 3).
        reason: why the voxels are taken for free, as a clause.
    """

    lower: NDArray[np.int64]
    blocked: Mask
    free: Mask
    views: NDArray[np.uint16]
    starts: NDArray[np.int64]
    figures: dict[str, Any]
    reason: str


def observe(
    config: ObserveConfig,
    scene: Artifact,
    cameras: Pinholes | None,
    voxels: Artifact | None = None,
    *,
    jobs: int = 0,
    progress: Progress | None = None,
) -> Artifact:
    """Mark the voxels that were seen to be free and that a ball of `radius_m` can reach.

    With cameras, a voxel is free when `min_views` of them see it. A camera sees a voxel when its whole cube,
    grown by the inflation, is in the image and at least `near_m` deep, and when in each pixel that the cube
    touches no ellipsoid, at the level of the obstacles, is as near as the cube's farthest corner. A pixel
    holds the smallest depth of any surface in its whole pyramid, not only on its centre ray; `range_m`
    where no surface touches it. The chain of voxels from the cube to the camera must hold no obstacle
    either, which closes gaps between ellipsoids narrower than a voxel. Without cameras, all voxels around
    `reach` that no obstacle touches are free, as far as they are closed in.

    Then the ball moves from the places nearest to the cameras that hold it, in sight of them, along the lines
    between the centres of neighbouring voxels; what it touches is kept. Everything else is unknown.

    Memory: the scene (56 bytes per Gaussian, and 104 to 208 for the depth images), 14 bytes per voxel of the
    box; per thread a depth image, and 1 byte per voxel of the box.

    Args:
        config: see `ObserveConfig`; with `voxels`, its level is replaced by theirs.
        scene: an `alula/scene` in metres.
        cameras: in the scene's frame of `world_from_scene`'s source, before the alignment; None with `reach`.
        voxels: the obstacles as an `alula/voxels` of the scene; default: those of `voxelize`.

    Returns:
        An `alula/seen` in the frame of the scene.

    Raises:
        CheckError: the cameras are not in the frame of the scene, and it was not found (see `model_frame`).
        InputError: the scene is not metric; its box has too many voxels.
        InfeasibleError: nothing is seen, or the ball fits nowhere near a camera, or it leaks out of the box.
        UsageError: cameras and `reach` are both given or both missing, or there is no radius.
    """
    manifest = scene.manifest
    assert isinstance(manifest, SceneManifest)
    if (cameras is None) == (config.reach is None):
        raise UsageError("give cameras (--colmap or --cameras) or --reach, one of them")
    if config.radius_m is None:
        raise UsageError("observe needs a radius; give --radius or --vehicle")
    if manifest.unit != "m":
        raise InputError(f"the scene's unit is {manifest.unit!r}; run scale-align first")
    if voxels is None:
        voxels = voxelize(config, scene, jobs=jobs)
    parameters = parameters_of(config)
    config = _with_level_of(config, voxels)
    assert config.radius_m is not None
    radius = config.radius_m / config.size_m
    if radius > LONGEST_RADIUS_VOXELS:
        raise UsageError(f"--radius is more than {LONGEST_RADIUS_VOXELS:g} voxels; use larger voxels")
    lower, blocked = _obstacles(config, voxels)
    frame = ModelFrame()
    if cameras is None:
        space = _closed(config, lower, blocked, radius)
    else:
        if manifest.world_from_scene is not None:
            cameras = cameras.moved(manifest.world_from_scene)
        frame = _frame(config, scene, cameras)
        if frame.scene_from_model is not None:
            cameras = cameras.moved(frame.scene_from_model)
        space = _seen(config, scene, cameras, lower, blocked, radius, jobs, progress)
    return _artifact(config, parameters, manifest, space, radius, frame)


def _with_level_of(config: ObserveConfig, voxels: Artifact) -> ObserveConfig:
    level: Any = voxels.manifest
    return dataclasses.replace(
        config,
        size_m=level.voxel_size_m,
        sigma=require_sigma(level),
        confidence=None,
        min_overlap=level.min_overlap,
        crop=None if level.crop is None else tuple(level.crop),
        min_opacity=level.min_opacity,
        inflation_m=level.inflation_m,
        ignore_loss=level.ignore_loss,
    )


def _obstacles(config: ObserveConfig, voxels: Artifact) -> tuple[NDArray[np.int64], Mask]:
    """Lowest voxel of the box, which is the crop or holds all obstacles, and the obstacles in it."""
    index = np.asarray(voxels["index"], np.int64)
    if config.crop is not None:  # the voxels that lie wholly in the crop, where all obstacles are known
        edges = np.array(config.crop) / config.size_m
        lower, upper = (
            np.ceil(edges[:3] - 1e-9).astype(np.int64),
            np.floor(edges[3:] + 1e-9).astype(np.int64) - 1,
        )
    elif len(index):
        lower, upper = index.min(axis=0), index.max(axis=0)
    else:
        raise InputError("there are no voxels, so the scene has no box")
    size = upper - lower + 1
    if (size < 1).any():
        raise InfeasibleError("--crop holds no whole voxel")
    if math.prod(size.tolist()) > MAX_BOX:
        raise InputError(
            f"the box of the scene has {math.prod(size.tolist()):,} voxels, more than {MAX_BOX:,}; use "
            "--crop or a larger --size"
        )
    blocked = np.zeros(tuple(size.tolist()), np.bool_)
    inside = index[((index >= lower) & (index <= upper)).all(axis=1)] - lower
    blocked[tuple(inside.T)] = True
    return lower, blocked


def _frame(config: ObserveConfig, scene: Artifact, cameras: Pinholes) -> ModelFrame:
    """The cameras' frame, checked against the scene by the 3D points of their model; see `model_frame`."""
    landmarks = cameras.poses.landmarks
    if landmarks is None:
        return ModelFrame(warnings=(UNCHECKED.format(why="they come without 3D points"),))
    mean = np.asarray(scene["mean"], np.float64)[scene["opacity"] >= VISIBLE]
    found = model_frame(landmarks, lambda: mean, config.min_near)
    if found.fit is None:
        return found
    error = found.position_error(mean.min(axis=0), mean.max(axis=0))
    return dataclasses.replace(found, facts={**found.facts, "position_error_m": error})


def _frame_words(frame: ModelFrame) -> str:
    if not frame.facts:
        return ", whose frame was not checked"
    if frame.fit is None:
        return ""
    return (
        f", which were mapped to the splat by a similarity that was found, with {CONFIDENCE:.0%} confidence "
        f"to {at_most(frame.facts['position_error_m'])} m"
    )


def _seen(
    config: ObserveConfig,
    scene: Artifact,
    cameras: Pinholes,
    lower: NDArray[np.int64],
    blocked: Mask,
    radius: float,
    jobs: int,
    progress: Progress | None,
) -> _Space:
    """Find the voxels that cameras see, and the starts next to the cameras."""
    if len(cameras) > np.iinfo(np.uint16).max:
        raise InputError(f"{len(cameras):,} cameras are more than {np.iinfo(np.uint16).max:,}")
    rows = rows_of(scene, retained(scene, config.min_opacity), ignore_loss=config.ignore_loss)
    assert config.inflation_m is not None
    occluders = _core.Occluders(
        mean=np.ascontiguousarray(rows.mean),
        scale=np.ascontiguousarray(rows.scale),
        quat_wxyz=np.ascontiguousarray(rows.quat_wxyz),
        sigma=config.sigma,
        inflation=config.inflation_m,
        worth=_WORTH * config.size_m,
        jobs=jobs,
        loss=None if rows.loss is None else np.ascontiguousarray(rows.loss),
    )
    views, seen, blind = _core.observe(
        occluders,
        **cameras.arrays(config.columns),
        near=config.near_m,
        range=config.range_m,
        voxel_size=config.size_m,
        lower=lower.tolist(),
        blocked=blocked.view(np.uint8),
        margin=config.inflation_m,
        jobs=jobs,
        progress=progress,
    )
    free = views >= config.min_views
    if not free.any():
        raise InfeasibleError(
            f"none of {len(cameras)} cameras sees a voxel ({int(blind.sum())} touch an obstacle); check that "
            "the cameras are in the frame that the splat was trained in"
        )
    centres = centres_of(free, radius)
    starts, started = _starts(config, cameras, lower, blocked, centres)
    if not started:
        raise InfeasibleError(
            f"no camera has room for a ball of {config.radius_m:g} m near it that was seen; use a smaller "
            "--radius, or more cameras"
        )
    figures = {
        "cameras": len(cameras),
        "cameras_touching_an_obstacle": int(blind.sum()),
        "cameras_that_see_nothing": int((seen == 0).sum()),
        "cameras_next_to_reached_space": started,
        "seen_voxels": int(free.sum()),
    }
    reason = (
        f"at least {config.min_views} of {len(cameras)} cameras saw it, in front of every surface, and at "
        f"most {exact(config.range_m)} m deep where there is none"
    )
    return _Space(lower, blocked, free, views, starts, figures, reason)


def _starts(
    config: ObserveConfig, cameras: Pinholes, lower: NDArray[np.int64], blocked: Mask, centres: Mask
) -> tuple[NDArray[np.int64], int]:
    """Place of the ball nearest to each camera, in sight of it, and the number of cameras that have one.

    A camera whose image is tan(t) high, from its axis to the nearest edge, shows all voxels that a ball of
    radius r touches from (r + sqrt(3) g) / sin(t) on; places up to two voxels farther count as next to it.
    """
    assert config.radius_m is not None
    g, r = config.size_m, config.radius_m + math.sqrt(3) * config.size_m
    tangent = np.abs(cameras.image).min(axis=1)
    around = np.maximum(r * np.sqrt(1 + tangent**2) / np.maximum(tangent, 1e-3), config.near_m + r) + 2 * g
    place = cameras.poses.position / g - lower
    found = []
    for start, reach in zip(place, np.ceil(around / g), strict=True):
        first = np.clip(np.floor(start - reach), 0, centres.shape).astype(np.int64)
        last = np.clip(np.floor(start + reach) + 1, 0, centres.shape).astype(np.int64)
        near = np.argwhere(centres[tuple(slice(a, b) for a, b in zip(first, last, strict=True))]) + first
        away = np.linalg.norm(near + 0.5 - start, axis=1)
        order = np.argsort(away, kind="stable")[: int((away <= reach).sum())][:_TRIED]
        for voxel in near[order]:
            if is_line_clear(blocked, start, voxel + 0.5):
                found.append(voxel)
                break
    return np.array(found, np.int64).reshape(-1, 3), len(found)


def _closed(config: ObserveConfig, lower: NDArray[np.int64], blocked: Mask, radius: float) -> _Space:
    """Find the closed space around a point, which no obstacle touches."""
    assert config.reach is not None
    g = config.size_m
    start = np.floor(np.array(config.reach) / g).astype(np.int64) - lower
    where = f"--reach ({' '.join(f'{x:g}' for x in config.reach)})"
    if not ((start >= 0) & (start < blocked.shape)).all():
        raise InfeasibleError(f"{where} is outside of the scene's box")
    centres = centres_of(~blocked, radius, is_closed=False)
    if not centres[tuple(start)]:
        raise InfeasibleError(
            f"{where} has no room for a ball of {config.radius_m:g} m{_nearest(config, lower, centres)}"
        )
    label = components(centres)
    reached = label == label[tuple(start)]
    leaks = np.argwhere(reached & rim(blocked.shape, max(layers_of(radius), 1)))
    if len(leaks):
        out = leaks[np.argmin(((leaks - start) ** 2).sum(axis=1))]
        point = " ".join(f"{x:.3g}" for x in (out + lower + 0.5) * g)
        raise InfeasibleError(
            f"the space around {where} is not closed: a ball of {config.radius_m:g} m leaves the scene's box "
            f"near ({point}); use a larger --radius, or cameras"
        )
    point = " ".join(map(exact, config.reach))
    reason = f"it is inside of closed space around ({point}) m, whether it was seen or not"
    return _Space(lower, blocked, ~blocked, np.zeros(blocked.shape, np.uint16), start[None], {}, reason)


def _nearest(config: ObserveConfig, lower: NDArray[np.int64], centres: Mask) -> str:
    found: FloatArray = (np.argwhere(centres) + lower).astype(np.float64) * config.size_m + config.size_m / 2
    if len(found) == 0:
        return ", and nowhere else has"
    near = found[np.argmin(((found - np.array(config.reach)) ** 2).sum(axis=1))]
    return f"; the nearest place with room is ({' '.join(f'{x:.4g}' for x in near)})"


def _artifact(
    config: ObserveConfig,
    parameters: dict[str, Any],
    scene: SceneManifest,
    space: _Space,
    radius: float,
    frame: ModelFrame,
) -> Artifact:
    """Keep what the ball reaches, and say why it is taken for free."""
    centres = centres_of(space.free, radius, is_closed=bool(space.figures))
    label = components(centres)
    number = np.unique(label[tuple(space.starts.T)])
    starts = [space.starts[np.argmax(label[tuple(space.starts.T)] == n)] for n in number]
    kept = touched(np.isin(label, number), radius) & space.free
    index = (np.argwhere(kept) + space.lower).astype(np.int32)
    g, inflation = config.size_m, config.inflation_m
    assert inflation is not None
    box = math.prod(kept.shape)
    what = f"no obstacle touches it: the ellipsoid at {level_words(config.sigma)} of a Gaussian"
    if config.min_opacity > 0:
        what += f" with an opacity of at least {exact(config.min_opacity)}"
    what += f", grown by {exact(inflation)} m" * (inflation > 0)
    if config.min_overlap > 1:
        what += f", where at least {config.min_overlap} meet"
    where = "next to a camera" if space.figures else "around the point"
    statement = (
        f"Each voxel was taken for free because {space.reason}. By the voxels of the same level, {what}. "
        f"From a place {where}, a ball of {exact(config.radius_m or 0)} m goes to it and touches no voxel "
        "outside of the file. Everything else is unknown"
    )
    before = excluded_errors(scene, inflation, ignore_loss=config.ignore_loss)
    if space.figures:
        before.append("an error of the cameras' poses" + _frame_words(frame))
    before += ["what the splat does not show, such as glass, thin wires and what has moved since"]
    return make_artifact(
        SEEN,
        {"index": index, "views": space.views[kept]},
        frame=scene.frame,
        unit="m",
        parameters=parameters,
        summary={
            "voxels": len(index),
            "volume_m3": len(index) * g**3,
            "fraction_of_box": len(index) / box,
            "box_voxels": box,
            "obstacle_voxels": int(space.blocked.sum()),
            **space.figures,
            **({"notes": list(frame.warnings)} if frame.warnings else {}),
            "seen_but_not_reached": int((space.free & ~kept).sum()),
            "lower_m": (index.min(axis=0) * g).tolist(),
            "upper_m": ((index.max(axis=0).astype(np.int64) + 1) * g).tolist(),
        },
        guarantee=Guarantee(
            statement + ". Not included: " + "; ".join(before) + ".",
            {
                "method": "cameras" if space.figures else "reach",
                "sigma": config.sigma,
                "inflation_m": inflation,
                "min_opacity": config.min_opacity,
                "radius_m": config.radius_m,
                "range_m": config.range_m,
                "near_m": config.near_m,
                "columns": config.columns,
                "min_views": config.min_views,
                "model_frame": dict(frame.facts) or None,
            },
        ),
        voxel_size_m=g,
        sigma=config.sigma,
        min_overlap=config.min_overlap,
        inflation_m=inflation,
        crop=None if config.crop is None else list(config.crop),
        min_opacity=config.min_opacity,
        ignore_loss=config.ignore_loss,
        floor_m=scene.floor_m,
        map_origin_m=map_origin(scene),
        method="cameras" if space.figures else "reach",
        radius_m=config.radius_m,
        lower=space.lower.tolist(),
        size=list(kept.shape),
        started_from=[(start + space.lower).tolist() for start in starts],
    )
