"""Still and moving pictures of a view: which parts are drawn, when, and from where."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray
from alula.stages.reporting.palette import COLORS
from alula.stages.show.drawing.content import CUT, Camera, Content, Gaussians, Lines, Part, Play, rgb
from alula.stages.show.drawing.picture import Model, model_of, picture
from alula.stages.show.drawing.sight import sight_of
from alula.stages.show.viewing.actors import moment
from alula.stages.show.viewing.camera import upright, view_direction
from alula.stages.show.viewing.follow import FLOWN, ORBIT, sights

THROUGH = 0.3  # opacity of a flight's lines behind what hides them
_FAINT = 0.25  # opacity of the map's edges beside a splat
_FILLS = 0.94  # of a picture, by what it shows
_CORE = (0.01, 0.99)  # quantiles of Gaussians
_ROUNDS = 8
_LEAST_AWAY = 1e-6  # of the coordinates: least distance of the camera
_TURN_S = 8.0  # of a scene without flights


@dataclass(frozen=True, slots=True, kw_only=True)
class Film:
    """Frames of a moving picture.

    Attributes:
        frames: shape (rows, columns, 3) each.
        words: to stand in each frame, and whether the filter acts then.
        faster: how many times faster than it was flown.
    """

    frames: list[NDArray[np.uint8]]
    words: list[tuple[str, bool]]
    faster: float


def still(content: Content, size: tuple[int, int], jobs: int = 0) -> NDArray[np.uint8]:
    """Draw what a page shows at first, with the first flight at its worst moment, shape (rows, columns, 3).

    Args:
        size: columns and rows [px].
    """
    parts = [part for part in content.parts if not _is_cut(part)]
    if content.plays:
        parts = [part for part in parts if "/corridor/" not in part.name]  # its flight is clearer without
    world = model_of(parts)
    models = _faded(parts)
    if content.plays:
        play = content.plays[0]
        models.append(model_of(moment(play, play.marked_s, color=_color(play))))
    sight = sight_of(framed(content, world, size), size, upright(content.up)[:, 2])
    return picture(models, sight, through=THROUGH, jobs=jobs)


def film(
    content: Content,
    kind: str,
    size: tuple[int, int],
    *,
    rate_hz: float,
    most_s: float,
    jobs: int = 0,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Film:
    """Draw the frames of the first flight, or of a scene without flights.

    Args:
        kind: of camera, as of `sights`.
        size: columns and rows [px].
        most_s: a longer flight is shown faster, in this time [s].
    """
    play = content.plays[0] if content.plays else None
    kind = ORBIT if play is None else kind
    flown_s = float(play.time_s[-1]) if play is not None else min(_TURN_S, most_s)
    faster = max(1.0, flown_s / most_s)
    time = np.arange(max(int(np.ceil(flown_s / faster * rate_hz)), 1) + 1) * (faster / rate_hz)
    time_s = np.minimum(time, flown_s).tolist()
    parts = [part for part in content.parts if _is_in_film(part, kind, play)]
    content = replace(content, camera=framed(content, model_of(parts), size))
    world = _faded(parts)
    frames = []
    for number, (at, sight) in enumerate(zip(time_s, sights(kind, content, play, time_s, size), strict=True)):
        progress(number, len(time_s))
        models = list(world)
        if play is not None:
            models.append(model_of(moment(play, at, color=_color(play), vehicle=kind != "cockpit")))
        frames.append(picture(models, sight, through=THROUGH, jobs=jobs))
    words = [("", False) if play is None else _words(play, at) for at in time_s]
    return Film(frames=frames, words=words, faster=faster)


def _color(play: Play) -> tuple[int, int, int]:
    return rgb(COLORS[play.outcome])


def _faded(parts: Sequence[Part]) -> list[Model]:
    """Models of parts: beside a splat the map's edges are faint, and its faces, which dim it, left out."""
    is_map = [part.name.removeprefix(f"{CUT}/").startswith("Hulls") for part in parts]
    if not any(isinstance(part, Gaussians) for part in parts) or not any(is_map):
        return [model_of(parts)]
    edges = model_of(part for part, of in zip(parts, is_map, strict=True) if of and isinstance(part, Lines))
    rest = model_of(part for part, of in zip(parts, is_map, strict=True) if not of)
    return [replace(edges, line_opacity=np.full(len(edges.line), _FAINT)), rest]


def _is_cut(part: Part) -> bool:
    return part.name.startswith(f"{CUT}/")


def _is_in_film(part: Part, kind: str, play: Play | None) -> bool:
    """Whether a part is drawn while a flight plays.

    All of the room where the camera is inside of it. Of the plan only its goal: the path is drawn anyway, and
    corridors and balls would stand in the way. No other flights.
    """
    if _is_cut(part) and kind not in FLOWN:
        return False
    if play is None:
        return True
    folder, _, name = part.name.partition("/")
    if folder.startswith("Plan"):
        return name == "goal"
    return folder not in ("Flights", "Flights by run", "Contacts")


def _words(play: Play, at: float) -> tuple[str, bool]:
    """Time, speed and clearance in words, and whether the filter acts."""
    row = int(np.clip(np.searchsorted(play.time_s, at, "right") - 1, 0, len(play.time_s) - 1))
    found = [f"{at:.1f} s"]
    near = np.inf
    for series in play.series:
        value = float(np.interp(at, series.time_s, series.value)) if len(series.time_s) else np.nan
        if series.plot.startswith("speed") and np.isfinite(value):
            found.append(f"{value:.1f} m/s")
        elif series.plot.startswith("clearance") and np.isfinite(value):
            near = min(near, value)
    if np.isfinite(near):
        found.append(f"{near:.2f} m to the nearest obstacle")
    return "   ".join(found), bool(play.acts[row])


def framed(content: Content, world: Model, size: tuple[int, int]) -> Camera:
    """Camera that looks as the first one of a page and is filled by what that one looks at.

    Args:
        size: columns and rows [px].
    """
    camera, up = content.camera, upright(content.up)[:, 2]
    least = _LEAST_AWAY * float(np.abs(camera.look_at).max(initial=1.0))  # far away, smaller steps are lost
    away = max(float(np.linalg.norm(camera.position - camera.look_at)), least)
    points = _outline(world, camera.look_at, 0.6 * away)
    along = view_direction(content.up)
    if len(points) < 2:
        return Camera(camera.look_at - away * along, camera.look_at, camera.far_m)
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    for _ in range(_ROUNDS):
        sight = sight_of(Camera(centre - away * along, centre), size, up)
        if ((points - sight.position) @ sight.R_camera_world[2]).min() <= 0:
            away *= 1.5
            continue
        pixels = sight.pixels(points)
        low, high = pixels.min(axis=0), pixels.max(axis=0)
        shift = ((low + high - np.array(size)) / 2) * away / sight.focal
        centre = centre + shift @ sight.R_camera_world[:2]
        away *= float(np.clip(((high - low) / (_FILLS * np.array(size))).max(), 0.5, 2.0))
        away = max(away, least)
    return Camera(centre - away * along, centre, camera.far_m)


def _outline(world: Model, centre: FloatArray, reach: float) -> FloatArray:
    """Points within a distance of a centre: of meshes, lines and the core of the Gaussians, shape (n, 3)."""
    found: list[FloatArray] = [world.corners.reshape(-1, 3), world.ends.reshape(-1, 3)]
    means: Sequence[FloatArray] = [part.mean.astype(np.float64) for part in world.gaussians]
    every = np.concatenate([np.empty((0, 3)), *means])
    if len(every):
        low, high = np.quantile(every, _CORE, axis=0)
        found.append(every[((every >= low) & (every <= high)).all(axis=1)])
    points = np.concatenate(found)
    points = points[np.isfinite(points).all(axis=1)]
    inside: FloatArray = points[np.linalg.norm(points - centre, axis=1) <= reach]
    return inside
