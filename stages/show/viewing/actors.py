"""What moves while a flight plays: vehicle, path, obstacles, tracks, and the line to what is nearest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.stages.rotation import matrix_from_quat_wxyz
from alula.stages.show.drawing.content import Body, Color, Decides, Faces, Lines, Part, Play, segments_of
from alula.stages.show.viewing.active import DECIDES_COLOR
from alula.stages.show.viewing.corridor import NEW_PLAN_COLOR
from alula.stages.show.viewing.shapes import ball_mesh, disc_mesh, frame_mesh

BODY_COLOR, ROTOR_COLOR = (45, 50, 60), (250, 200, 40)
PASSES_COLOR, ACTS_COLOR = (110, 110, 110), (230, 120, 0)
OBSTACLE_COLOR, TRACK_COLOR = (204, 77, 26), (26, 115, 204)


def vehicle_parts(name: str, body: Body) -> list[Faces | Lines]:
    """A vehicle in its body frame, at its true size: hub, arms, nose and rotors, and a ring around it."""
    meshes = (
        ("body", frame_mesh(body), BODY_COLOR, 1.0),
        ("rotors", disc_mesh(body), ROTOR_COLOR, 0.85),
    )
    parts: list[Faces | Lines] = [
        Faces(name=f"{name}/{part}", corners=corners, triangles=triangles, color=color, opacity=opacity)
        for part, (corners, triangles), color, opacity in meshes
    ]
    return [*parts, Lines(name=f"{name}/mark", segments=_mark(body), color=ROTOR_COLOR, width_px=3.0)]


def _mark(body: Body) -> FloatArray:
    """Outline of the vehicle's sphere as two circles, so that a small vehicle is found, (48, 2, 3)."""
    angle = np.linspace(0, 2 * np.pi, 25)
    ring = body.radius_m * np.stack([np.cos(angle), np.sin(angle), np.zeros(25)], axis=1)
    return np.concatenate([segments_of(ring), segments_of(ring[:, [0, 2, 1]])])


def path_part(name: str, play: Play) -> Lines:
    """The whole path of a flight, in another colour where the filter acts."""
    acts = np.where(play.acts[1:, None], ACTS_COLOR, PASSES_COLOR).astype(np.uint8)
    return Lines(
        name=f"{name}/path (orange where the filter acts)",
        segments=segments_of(play.position_world),
        color=np.repeat(acts[:, None], 2, axis=1),
        width_px=5.0,  # wider than the path of its outcome, which it covers
    )


def ball_parts(name: str, play: Play, *, tracks: bool) -> list[Faces]:
    """Moving obstacles of a flight, or its tracks, each around the origin.

    Args:
        tracks: the tracks, twice as large as their obstacles and translucent.
    """
    corners, triangles = ball_mesh()
    what, grown = ("track", 2.0) if tracks else ("moving obstacle", 1.0)
    return [
        Faces(
            name=f"{name}/{what} {k + 1}",
            corners=grown * radius * corners,
            triangles=triangles,
            color=TRACK_COLOR if tracks else OBSTACLE_COLOR,
            opacity=0.35 if tracks else 1.0,
        )
        for k, radius in enumerate(play.obstacle_radius_m.tolist())
    ]


def nearest_line(name: str, play: Play, row: int) -> Lines:
    """The line from the vehicle to the nearest point of the world; without length where there is none."""
    start, end = play.position_world[row], play.nearest_world[row]
    return Lines(
        name=f"{name}/line to the nearest obstacle (orange where the filter acts)",
        segments=np.stack([start, end if np.isfinite(end).all() else start])[None],
        color=ACTS_COLOR if play.acts[row] else PASSES_COLOR,
        width_px=2.0,
    )


def deciding_part(name: str, one: Decides, *, visible: bool = True) -> Faces:
    """An obstacle while it decides what is sent."""
    return Faces(
        name=f"{name}/deciding/{one.name}",
        corners=one.corners,
        triangles=one.triangles,
        color=DECIDES_COLOR,
        visible=visible,
    )


def new_plan_part(name: str, number: int, points: FloatArray, *, visible: bool = True) -> Lines:
    """A new plan that a flight joined on its way.

    Args:
        number: of the plan, from 1.
        points: along it, shape (k, 3) [m].
    """
    return Lines(
        name=f"{name}/new plan {number}",
        segments=segments_of(points),
        color=NEW_PLAN_COLOR,
        width_px=4.0,
        visible=visible,
    )


def moment(play: Play, time_s: float, *, color: Color = PASSES_COLOR, vehicle: bool = True) -> list[Part]:
    """All of it at one time, in the world's frame: the path so far is thick, the rest of it thin.

    Between samples the vehicle and the obstacles are interpolated; tracks and the line are those of the
    sample before.

    Args:
        time_s: from its begin [s].
        color: of the path where the filter passes the command.
    """
    row = int(np.clip(np.searchsorted(play.time_s, time_s, "right") - 1, 0, len(play.time_s) - 2))
    place, turn = pose_at(play, time_s)
    path = path_part("", play)
    ends = np.where(play.acts[1:, None, None], ACTS_COLOR, color).astype(np.uint8).repeat(2, axis=1)
    here = np.stack([play.position_world[row], place])[None]
    flown = replace(
        path,
        segments=np.concatenate([path.segments[:row], here]),
        color=ends[: row + 1],
    )
    rest = Lines(name="/rest", segments=path.segments[row:], color=PASSES_COLOR, width_px=1.5)
    parts: list[Part] = [rest, flown]
    parts += [deciding_part("", one) for one in play.decides if one.rows[row]]
    parts += [
        new_plan_part("", number, points)
        for number, (joined_s, points) in enumerate(play.plans, 1)
        if time_s >= joined_s
    ]
    if vehicle:
        parts += [_moved(part, place, turn) for part in vehicle_parts("", play.body)]
        line = nearest_line("", play, row)
        line.segments[0, 0] = place
        parts += [line] if np.isfinite(play.nearest_world[row]).all() else []
    part_of = (time_s - play.time_s[row]) / max(play.time_s[row + 1] - play.time_s[row], 1e-9)
    between = play.obstacles_world[row] + np.clip(part_of, 0, 1) * (
        play.obstacles_world[row + 1] - play.obstacles_world[row]
    )
    for tracks, places in ((False, between), (True, play.tracks_world[row])):
        balls = zip(ball_parts("", play, tracks=tracks), places, strict=True)
        parts += [_moved(part, at, np.eye(3)) for part, at in balls if np.isfinite(at).all()]
    return parts


def pose_at(play: Play, time_s: float) -> tuple[FloatArray, FloatArray]:
    """Position [m] and rotation of the body to the world, shapes (3,) and (3, 3), linear between samples."""
    position = np.array([np.interp(time_s, play.time_s, axis) for axis in play.position_world.T])
    row = int(np.clip(np.searchsorted(play.time_s, time_s, "right") - 1, 0, len(play.time_s) - 2))
    a, b = play.quat_world_body_wxyz[row], play.quat_world_body_wxyz[row + 1]
    part_of = np.clip((time_s - play.time_s[row]) / max(play.time_s[row + 1] - play.time_s[row], 1e-9), 0, 1)
    quat = (1 - part_of) * a + part_of * (b if a @ b >= 0 else -b)
    return position, matrix_from_quat_wxyz(quat / max(float(np.linalg.norm(quat)), 1e-12))


def _moved(part: Faces | Lines, place: FloatArray, turn: FloatArray) -> Faces | Lines:
    if isinstance(part, Faces):
        return replace(part, corners=part.corners @ turn.T + place)
    return replace(part, segments=part.segments @ turn.T + place)
