"""Cameras of a moving picture: two follow the flight, one turns around the scene, one stands."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.stages.show.drawing.content import CUT, Camera, Content, Play
from alula.stages.show.drawing.sight import Sight, sight_of
from alula.stages.show.viewing.actors import pose_at
from alula.stages.show.viewing.camera import upright

CHASE, COCKPIT, ORBIT, FIXED = "chase", "cockpit", "orbit", "fixed"
FLOWN = (CHASE, COCKPIT)  # cameras that are in the world, so nothing of it is cut away
_AWAY = 20.0  # radii of the vehicle from it to a following camera
_LEAST_AWAY_M = 0.8
_ABOVE = np.deg2rad(20.0)
_AHEAD = 0.5  # of that distance: what the camera looks at, in front of the vehicle
_HIDES = 0.7  # of that distance: what is nearer is not drawn
_WIDE_RAD = np.deg2rad(62.0)
_AROUND_S = 0.7  # half the time that a direction of flight is taken from
_SMOOTH_S = 0.6  # standard deviation of the camera's smoothing
_SWEEP_RAD = np.deg2rad(50.0)  # of a camera that turns in front of a room
_TURN = 0.12  # of the time: standard deviation of the smoothing of one that turns with the flight
_CLOSER = 0.56  # of the first camera's distance, for one that turns with the flight
_LOWER = np.deg2rad(24.0)  # how far it looks down
_LEAN = 0.55  # of the way from the middle to the vehicle: what it looks at


def sights(
    kind: str, content: Content, play: Play | None, time_s: Sequence[float], size: tuple[int, int]
) -> list[Sight]:
    """Cameras of the frames of a moving picture.

    Args:
        kind: chase (behind and above the vehicle), cockpit (where it is, along its motion), orbit (around the
            scene, on the side where the vehicle is, or in front of a room that is cut open) or fixed (the
            first camera).
        play: the flight; None without one, for orbit and fixed.
        time_s: of the frames, from the begin of the flight [s].
        size: of the picture, columns and rows [px].
    """
    up = upright(content.up)[:, 2]
    is_cut = any(part.name.startswith(f"{CUT}/") for part in content.parts)
    if kind == FIXED or play is None or (kind == ORBIT and is_cut):
        sweep = 0.0 if kind == FIXED else _SWEEP_RAD if is_cut else 2 * np.pi
        angles = sweep * (np.linspace(0, 1, len(time_s)) - 0.5)
        return [sight_of(_turned(content.camera, angle, up), size, up) for angle in angles.tolist()]
    time = np.asarray(time_s)
    place = np.array([pose_at(play, at)[0] for at in time_s])
    if kind == ORBIT:
        return [sight_of(camera, size, up) for camera in _around(content.camera, place, time, up)]
    along = _smooth(_directions(play, time, up), time)
    if kind == COCKPIT:
        near = play.body.radius_m
        return [
            sight_of(Camera(p, p + d), size, up, field_rad=float(_WIDE_RAD), near_m=near)
            for p, d in zip(place, along, strict=True)
        ]
    flat = along - np.outer(along @ up, up)
    flat /= np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-9)
    away = max(_AWAY * play.body.radius_m, _LEAST_AWAY_M)
    place = _smooth(place, time, 0.5 * _SMOOTH_S)
    eye = place - away * np.cos(_ABOVE) * flat + away * np.sin(_ABOVE) * up
    return [
        sight_of(Camera(e, p + _AHEAD * away * d), size, up, field_rad=float(_WIDE_RAD), near_m=_HIDES * away)
        for e, p, d in zip(eye, place, flat, strict=True)
    ]


def _turned(camera: Camera, angle: float, up: FloatArray) -> Camera:
    """The camera, turned about the vertical axis through what it looks at."""
    arm = camera.position - camera.look_at
    turned = np.cos(angle) * arm + np.sin(angle) * np.cross(up, arm) + (1 - np.cos(angle)) * (up @ arm) * up
    return Camera(camera.look_at + turned, camera.look_at, camera.far_m)


def _around(first: Camera, place: FloatArray, time: FloatArray, up: FloatArray) -> list[Camera]:
    """Cameras that see the scene behind the vehicle: outwards from the scene's middle."""
    away = _CLOSER * float(np.linalg.norm(first.position - first.look_at))
    ahead, side = np.roll(up, 1), np.cross(up, np.roll(up, 1))
    arm = _smooth(place - first.look_at, time)
    angle = np.unwrap(np.arctan2(arm @ side, arm @ ahead))[:, None]  # smooth where it passes the middle too
    angle = _smooth(angle, time, _TURN * max(float(time[-1] - time[0]), 1e-3))
    arm = np.cos(angle) * ahead + np.sin(angle) * side
    aim = first.look_at + _LEAN * (_smooth(place, time) - first.look_at)
    eye = aim + away * (np.cos(_LOWER) * arm + np.sin(_LOWER) * up)
    return [Camera(e, a, first.far_m) for e, a in zip(eye, aim, strict=True)]


def _directions(play: Play, time: FloatArray, up: FloatArray) -> FloatArray:
    """Directions of flight, unit vectors, shape (n, 3); while the vehicle hovers those before or after."""
    chord = np.array([pose_at(play, at + _AROUND_S)[0] - pose_at(play, at - _AROUND_S)[0] for at in time])
    level = np.linalg.norm(chord - np.outer(chord @ up, up), axis=1)
    moves = np.flatnonzero(level > 0.3 * max(float(level.max(initial=0)), 1e-6))
    if not len(moves):
        return np.tile(np.roll(up, 1), (len(time), 1))
    nearest = moves[np.abs(moves[None] - np.arange(len(time))[:, None]).argmin(axis=1)]
    found: FloatArray = chord[nearest] / np.linalg.norm(chord[nearest], axis=1, keepdims=True)
    return found


def _smooth(value: FloatArray, time: FloatArray, sigma_s: float = _SMOOTH_S) -> FloatArray:
    """Mean of rows over time with Gaussian weights, shape (n, k)."""
    weight = np.exp(-0.5 * ((time[:, None] - time[None]) / sigma_s) ** 2)
    found: FloatArray = (weight @ value) / weight.sum(axis=1, keepdims=True)
    return found
