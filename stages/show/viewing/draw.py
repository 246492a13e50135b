"""Draw the content of a view into a scene of viser, and record flights on its timeline."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray
from alula.stages.show.drawing.content import (
    CUT,
    Body,
    Camera,
    Content,
    Copies,
    Faces,
    Gaussians,
    Lines,
    Part,
    Play,
)
from alula.stages.show.drawing.sight import FIELD_RAD
from alula.stages.show.viewing.actors import (
    ball_parts,
    deciding_part,
    nearest_line,
    new_plan_part,
    path_part,
    vehicle_parts,
)

PLAYBACK = "Playback"
GAP_S = 1.0  # a flight stays at its end so long before the next one begins
_HALF_MOST = 250.0  # largest standard deviation in units of the scale: its square fits half precision


def draw(server: Any, content: Content) -> None:
    """Draw all parts of a view, and set its first camera.

    Args:
        server: a `viser.ViserServer`.
    """
    scene = server.scene
    scene.world_axes.visible = False
    scene.set_up_direction(content.up)
    scene.configure_environment_map(hdri=None)  # it and shadows take most of the time without a GPU
    scene.configure_default_lights(cast_shadow=False)
    scene.add_light_ambient("/Light", intensity=0.9)
    if any(part.name.startswith(f"{CUT}/") for part in content.parts):
        scene.add_frame(f"/{CUT}", show_axes=False, visible=False)
    for part in content.parts:
        draw_part(scene, part)
    set_camera(server, content.camera)


def set_camera(server: Any, camera: Camera) -> None:
    """Set the first camera."""
    first = server.initial_camera
    first.fov = float(FIELD_RAD)
    first.near, first.far = camera.far_m / 1e5, camera.far_m
    first.position, first.look_at = tuple(camera.position), tuple(camera.look_at)


def draw_part(scene: Any, part: Part) -> Any:
    """Draw one part.

    Args:
        scene: `scene` of a `viser.ViserServer`.

    Returns:
        The handle of viser.
    """
    name = f"/{part.name}"
    if isinstance(part, Gaussians):
        return _gaussians(scene, name, part)
    if isinstance(part, Faces):
        return scene.add_mesh_simple(
            name,
            part.corners,
            part.triangles,
            color=part.color,
            opacity=None if part.opacity >= 1 else part.opacity,
            flat_shading=True,
            side="back" if part.far_only else "double",
            cast_shadow=False,
            receive_shadow=False,
            visible=part.visible,
        )
    if isinstance(part, Lines):
        color = part.color
        return scene.add_line_segments(
            name,
            part.segments.astype(np.float32),
            _linear(color) if isinstance(color, np.ndarray) else np.array(color, np.uint8),
            thickness=part.width_px,
            thickness_units="screen",
            visible=part.visible,
        )
    return _copies(scene, name, part)


def _linear(color: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Linear light of sRGB colours: so viser reads those of single ends of lines, unlike that of a part."""
    part = color / 255.0
    light = np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)
    return np.round(255 * light).astype(np.uint8)


def _gaussians(scene: Any, name: str, part: Gaussians) -> Any:
    """Covariances are sent in half precision: the unit is chosen so that the largest one fits."""
    size = np.sqrt(part.covariance[:, range(3), range(3)].max(initial=1e-12))
    scale = float(2.0 ** np.ceil(np.log2(size / _HALF_MOST)))
    return scene.add_gaussian_splats(
        name,
        part.mean / np.float32(scale),
        part.covariance / np.float32(scale**2),
        part.color,
        np.round(255 * part.opacity[:, None]).astype(np.uint8),
        scale=scale,
        visible=part.visible,
    )


def _copies(scene: Any, name: str, part: Copies) -> Any:
    return scene.add_batched_meshes_simple(
        name,
        part.corners.astype(np.float32),
        part.triangles.astype(np.uint32),
        part.quat_wxyz.astype(np.float32),
        part.position.astype(np.float32),
        batched_scales=part.scale.astype(np.float32),
        batched_colors=part.color if isinstance(part.color, np.ndarray) else np.array(part.color, np.uint8),
        opacity=None if part.opacity >= 1 else part.opacity,
        lod="off",
        cast_shadow=False,
        receive_shadow=False,
        visible=part.visible,
    )


class Vehicle:
    """A vehicle at its true size: hub, arms, nose and rotors, and a ring that is visible from far away.

    Args:
        scene: `scene` of a `viser.ViserServer`.
    """

    def __init__(self, scene: Any, name: str, body: Body, *, visible: bool = True) -> None:
        self.frame = scene.add_frame(f"/{name}", show_axes=False, visible=visible)
        for part in vehicle_parts(name, body):
            draw_part(scene, part)

    def move(self, position: FloatArray, quat_wxyz: FloatArray) -> None:
        """Place it.

        Args:
            position: shape (3,), world frame [m].
            quat_wxyz: body to world.
        """
        self.frame.position, self.frame.wxyz = tuple(position), tuple(quat_wxyz)


@dataclass(frozen=True, slots=True)
class Span:
    """Place of a flight on the timeline [s]."""

    begin_s: float
    end_s: float


def record(server: Any, plays: Sequence[Play], sleep: Callable[[float], None]) -> list[Span]:
    """Play flights one after the other, each at its own speed.

    Args:
        server: a `viser.ViserServer`; its scene is being recorded.
        sleep: lets the time of the record pass [s].

    Returns:
        Where each flight lies on the timeline.
    """
    scene = server.scene
    actors = [_Actor(scene, play, number) for number, play in enumerate(plays)]
    spans, now = [], 0.0
    for actor, play in zip(actors, plays, strict=True):
        actor.show(True)
        begin, before = now, 0.0
        for row, time in enumerate(play.time_s.tolist()):
            if time > before:
                sleep(time - before)
                now, before = now + time - before, time
            actor.move(row)
        spans.append(Span(begin, now))
        sleep(GAP_S)
        now += GAP_S
        if len(plays) > 1:
            actor.show(False)
    return spans


class _Actor:
    """Nodes of one flight: vehicle, path, what moves, new plans, what decides, line to the nearest point."""

    def __init__(self, scene: Any, play: Play, number: int) -> None:
        self.play = play
        self.name = name = f"{PLAYBACK}/{number + 1}. {play.label}: {play.outcome}"
        self.frame = scene.add_frame(f"/{name}", show_axes=False, visible=False)
        self.vehicle = Vehicle(scene, f"{name}/vehicle", play.body)
        draw_part(scene, path_part(name, play))
        scene.add_label(f"/{name}/vehicle/name", ascii(play.label)[1:-1], anchor="bottom-left")
        self.obstacles = [draw_part(scene, ball) for ball in ball_parts(name, play, tracks=False)]
        self.tracks = [draw_part(scene, ball) for ball in ball_parts(name, play, tracks=True)]
        self.decides = [draw_part(scene, deciding_part(name, one, visible=False)) for one in play.decides]
        self.plans = [
            draw_part(scene, new_plan_part(name, number, points, visible=False))
            for number, (_, points) in enumerate(play.plans, 1)
        ]
        self.nearest: Any = None
        self.acts: bool | None = None
        if np.isfinite(play.nearest_world).any():
            self.nearest = draw_part(scene, nearest_line(name, play, 0))

    def show(self, is_shown: bool) -> None:
        """Show or hide all of it."""
        self.frame.visible = is_shown

    def move(self, row: int) -> None:
        """Place all of it as at one sample."""
        play = self.play
        self.vehicle.move(play.position_world[row], play.quat_world_body_wxyz[row])
        for handles, places in ((self.obstacles, play.obstacles_world), (self.tracks, play.tracks_world)):
            for handle, place in zip(handles, places[row], strict=True):
                _place(handle, place)
        for one, handle in zip(play.decides, self.decides, strict=True):
            _show(handle, bool(one.rows[row]))
        for (time_s, _), handle in zip(play.plans, self.plans, strict=True):
            _show(handle, bool(play.time_s[row] >= time_s))
        if self.nearest is None:
            return
        line = nearest_line(self.name, play, row)
        self.nearest.points = line.segments.astype(np.float32)
        if (acts := bool(play.acts[row])) != self.acts:
            self.acts = acts
            self.nearest.colors = np.array(line.color, np.uint8)


def _show(handle: Any, is_shown: bool) -> None:
    """Show or hide a node; a recording holds only changes."""
    if handle.visible != is_shown:
        handle.visible = is_shown


def _place(handle: Any, place: NDArray[np.float64]) -> None:
    """Move a node, or hide it where its place is not known."""
    is_known = bool(np.isfinite(place).all())
    _show(handle, is_known)
    if is_known:
        handle.position = tuple(place)
