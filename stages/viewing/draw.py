"""Draw the content of a view into a scene of viser, and record flights on its timeline."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray
from alula.stages.viewing.active import DECIDES_COLOR
from alula.stages.viewing.camera import FIELD_RAD
from alula.stages.viewing.content import (
    CUT,
    Body,
    Camera,
    Content,
    Copies,
    Decides,
    Faces,
    Gaussians,
    Lines,
    Part,
    Play,
    segments_of,
)
from alula.stages.viewing.corridor import NEW_PLAN_COLOR
from alula.stages.viewing.shapes import ball_mesh, disc_mesh, frame_mesh

PLAYBACK = "Playback"
GAP_S = 1.0  # a flight stays at its end so long before the next one begins
_HALF_MOST = 250.0  # largest standard deviation in units of the scale: its square fits half precision
_BODY_COLOR, _ROTOR_COLOR = (45, 50, 60), (250, 200, 40)
_PASSES_COLOR, _ACTS_COLOR = (110, 110, 110), DECIDES_COLOR
_OBSTACLE_COLOR, _TRACK_COLOR = (204, 77, 26), (26, 115, 204)


def draw(server: Any, content: Content) -> None:
    """Draw all parts of a view, and set its first camera.

    Args:
        server: a `viser.ViserServer`.
        content: of the view.
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
        part: to draw.

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
        name: in the scene tree.
        body: its size.
        visible: shown at first.
    """

    def __init__(self, scene: Any, name: str, body: Body, *, visible: bool = True) -> None:
        self.frame = scene.add_frame(f"/{name}", show_axes=False, visible=visible)
        for part, (corners, triangles), color, opacity in (
            ("body", frame_mesh(body), _BODY_COLOR, 1.0),
            ("rotors", disc_mesh(body), _ROTOR_COLOR, 0.85),
        ):
            faces = Faces(
                name=f"{name}/{part}", corners=corners, triangles=triangles, color=color, opacity=opacity
            )
            draw_part(scene, faces)
        draw_part(scene, Lines(name=f"{name}/mark", segments=_mark(body), color=_ROTOR_COLOR, width_px=3.0))

    def move(self, position: FloatArray, quat_wxyz: FloatArray) -> None:
        """Place it.

        Args:
            position: shape (3,), world frame [m].
            quat_wxyz: body to world.
        """
        self.frame.position, self.frame.wxyz = tuple(position), tuple(quat_wxyz)


def _mark(body: Body) -> FloatArray:
    """Outline of the vehicle's sphere as three circles, so that a small vehicle is found, (48, 2, 3)."""
    angle = np.linspace(0, 2 * np.pi, 25)
    ring = body.radius_m * np.stack([np.cos(angle), np.sin(angle), np.zeros(25)], axis=1)
    return np.concatenate([segments_of(ring), segments_of(ring[:, [0, 2, 1]])])


@dataclass(frozen=True, slots=True)
class Span:
    """Place of a flight on the timeline [s]."""

    begin_s: float
    end_s: float


def record(server: Any, plays: Sequence[Play], sleep: Callable[[float], None]) -> list[Span]:
    """Play flights one after the other, each at its own speed.

    Args:
        server: a `viser.ViserServer`; its scene is being recorded.
        plays: the flights.
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
        acts = np.where(play.acts[1:, None], _ACTS_COLOR, _PASSES_COLOR).astype(np.uint8)
        path = Lines(
            name=f"{name}/path (orange where the filter acts)",
            segments=segments_of(play.position_world),
            color=np.repeat(acts[:, None], 2, axis=1),
            width_px=5.0,  # wider than the path of its outcome, which it covers
        )
        draw_part(scene, path)
        scene.add_label(f"/{name}/vehicle/name", ascii(play.label)[1:-1], anchor="bottom-left")
        self.obstacles = self._balls(scene, "moving obstacle", _OBSTACLE_COLOR, 1.0, 1.0)
        self.tracks = self._balls(scene, "track", _TRACK_COLOR, 0.35, 2.0)
        self.decides = [self._deciding(scene, one) for one in play.decides]
        self.plans = [self._new_plan(scene, k, points) for k, (_, points) in enumerate(play.plans, 1)]
        self.nearest: Any = None
        self.acts: bool | None = None
        if np.isfinite(play.nearest_world).any():
            line = Lines(
                name=f"{name}/line to the nearest obstacle (orange where the filter acts)",
                segments=np.zeros((1, 2, 3)),
                color=_PASSES_COLOR,
                width_px=2.0,
            )
            self.nearest = draw_part(scene, line)

    def _balls(self, scene: Any, what: str, color: Any, opacity: float, grown: float) -> list[Any]:
        corners, triangles = ball_mesh()
        found = []
        for k, radius in enumerate(self.play.obstacle_radius_m.tolist()):
            ball = Faces(
                name=f"{self.name}/{what} {k + 1}",
                corners=grown * radius * corners,
                triangles=triangles,
                color=color,
                opacity=opacity,
            )
            found.append(draw_part(scene, ball))
        return found

    def _deciding(self, scene: Any, one: Decides) -> Any:
        faces = Faces(
            name=f"{self.name}/deciding/{one.name}",
            corners=one.corners,
            triangles=one.triangles,
            color=DECIDES_COLOR,
            visible=False,
        )
        return draw_part(scene, faces)

    def _new_plan(self, scene: Any, number: int, points: FloatArray) -> Any:
        name, color = f"{self.name}/new plan {number}", NEW_PLAN_COLOR
        return draw_part(
            scene, Lines(name=name, segments=segments_of(points), color=color, width_px=4.0, visible=False)
        )

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
        end = play.nearest_world[row]
        start = play.position_world[row]
        line = np.stack([start, end if np.isfinite(end).all() else start])[None]
        self.nearest.points = line.astype(np.float32)
        if (acts := bool(play.acts[row])) != self.acts:
            self.acts = acts
            self.nearest.colors = np.array(_ACTS_COLOR if acts else _PASSES_COLOR, np.uint8)


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
