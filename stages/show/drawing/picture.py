"""Parts of a view as a picture, drawn on the processor: what a page draws with WebGL."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.stages.rotation import matrix_from_quat_wxyz
from alula.stages.show.drawing.content import Copies, Faces, Gaussians, Lines, Part
from alula.stages.show.drawing.sight import Sight

BACKGROUND = (240, 243, 247)
_PAGE_ROWS = 800.0  # height of the page that widths of lines are meant for [px]
_LEAST_WIDTH = 0.7  # of lines, in smaller pictures
_LIGHT = np.array([0.36, -0.48, 0.8])  # direction to the light
_AMBIENT = 0.62


@dataclass(frozen=True, slots=True, kw_only=True)
class Model:
    """Parts as arrays that the renderer takes.

    Attributes:
        corners: of triangles, shape (T, 3, 3), world frame [m].
        color, opacity: of triangles, shapes (T, 3) and (T,).
        far_only: of triangles, shape (T,); as of `Faces`.
        ends: of line segments, shape (L, 2, 3) [m].
        line_color: shape (L, 3).
        width_px, line_opacity: of lines on a page, shape (L,).
        line: number of the part that a segment belongs to, shape (L,).
    """

    gaussians: Sequence[Gaussians]
    corners: FloatArray
    color: NDArray[np.uint8]
    opacity: NDArray[np.float32]
    far_only: NDArray[np.bool_]
    ends: FloatArray
    line_color: NDArray[np.uint8]
    width_px: FloatArray
    line_opacity: FloatArray
    line: NDArray[np.int32]


def model_of(parts: Iterable[Part]) -> Model:
    """Arrays of the parts that are shown at first."""
    shown = [part for part in parts if part.visible]
    faces = [each for part in shown if isinstance(part, Faces | Copies) for each in _meshes(part)]
    lines = [part for part in shown if isinstance(part, Lines)]
    counts = np.array([len(part.segments) for part in lines], np.int64)
    triangles = np.array([len(part.triangles) for part in faces], np.int64)
    return Model(
        gaussians=[part for part in shown if isinstance(part, Gaussians)],
        corners=_joined([part.corners[part.triangles] for part in faces], (3, 3)),
        color=np.repeat(np.array([part.color for part in faces], np.uint8).reshape(-1, 3), triangles, axis=0),
        opacity=np.repeat(np.array([part.opacity for part in faces], np.float32), triangles),
        far_only=np.repeat(np.array([part.far_only for part in faces], np.bool_), triangles),
        ends=_joined([part.segments for part in lines], (2, 3)),
        line_color=np.concatenate([np.empty((0, 3), np.uint8), *map(_line_colors, lines)]),
        width_px=np.repeat(np.array([part.width_px for part in lines], np.float64), counts),
        line_opacity=np.ones(int(counts.sum())),
        line=np.repeat(np.arange(len(lines), dtype=np.int32), counts),
    )


def _joined(arrays: Sequence[FloatArray], shape: tuple[int, int]) -> FloatArray:
    return np.concatenate([np.empty((0, *shape)), *arrays])


def _line_colors(part: Lines) -> NDArray[np.uint8]:
    """Colour of each segment; one with two colours gets that of its end."""
    if isinstance(part.color, np.ndarray):
        found: NDArray[np.uint8] = part.color[:, 1]
        return found
    return np.tile(np.array(part.color, np.uint8), (len(part.segments), 1))


def _meshes(part: Faces | Copies) -> list[Faces]:
    """A mesh as it is, and copies of one as a mesh each."""
    if isinstance(part, Faces):
        return [part]
    color = part.color if isinstance(part.color, np.ndarray) else np.tile(part.color, (len(part.position), 1))
    turn = matrix_from_quat_wxyz(part.quat_wxyz)
    return [
        Faces(
            name=part.name,
            corners=(part.corners * part.scale[k]) @ turn[k].T + part.position[k],
            triangles=part.triangles,
            color=tuple(int(value) for value in color[k]),  # type: ignore[arg-type]
            opacity=part.opacity,
        )
        for k in range(len(part.position))
    ]


def picture(
    models: Sequence[Model],
    sight: Sight,
    *,
    background: Sequence[float] = BACKGROUND,
    through: float = 0.0,
    jobs: int = 0,
) -> NDArray[np.uint8]:
    """Draw models into one picture, rows from the top, shape (rows, columns, 3).

    Gaussians, faces and lines are composited by depth, so what is behind matter is hidden by it. The result
    does not depend on `jobs`.

    Args:
        background: red, green and blue, 0 to 255.
        through: opacity of lines of the last model where something hides them.
    """
    image, light = _drawn(models, sight, through, jobs)
    return _bytes(image + light[:, :, None] * np.asarray(background, np.float32))


def translucent(model: Model, sight: Sight, *, jobs: int = 0) -> NDArray[np.uint8]:
    """Draw a model with red, green, blue and opacity, for any background, shape (rows, columns, 4)."""
    image, light = _drawn([model], sight, 0.0, jobs)
    opacity = 1 - light[:, :, None]
    return _bytes(np.concatenate([image / np.maximum(opacity, 1e-6), 255 * opacity], axis=2))


def _bytes(values: NDArray[np.float32]) -> NDArray[np.uint8]:
    found: NDArray[np.uint8] = np.clip(np.round(values), 0, 255).astype(np.uint8)
    return found


def _drawn(
    models: Sequence[Model], sight: Sight, through: float, jobs: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Colours without what is behind, (rows, columns, 3), and how much of it is seen, (rows, columns)."""
    gaussians = [part for model in models for part in model.gaussians]
    corners, color, opacity = zip(*(_lit(model, sight) for model in models), strict=True)
    width = np.concatenate([model.width_px for model in models]) * max(sight.rows / _PAGE_ROWS, 0.5)
    solid = np.concatenate([model.line_opacity for model in models])
    behind = np.repeat([0.0] * (len(models) - 1) + [through], [len(model.ends) for model in models])
    first = np.cumsum([0, *(int(model.line.max(initial=-1)) + 1 for model in models)])
    none = np.empty(0, np.float32)
    image, light, _ = _core.draw_picture(
        sight.R_camera_world,
        sight.position,
        sight.focal,
        sight.columns,
        sight.rows,
        sight.near_m,
        sight.is_parallel,
        mean=np.concatenate([none.reshape(0, 3), *(part.mean for part in gaussians)]),
        covariance=np.concatenate([none.reshape(0, 3, 3), *(part.covariance for part in gaussians)]),
        color=np.concatenate([np.empty((0, 3), np.uint8), *(part.color for part in gaussians)]),
        opacity=np.concatenate([none, *(part.opacity for part in gaussians)]),
        corner=np.concatenate(corners),
        corner_color=np.concatenate(color),
        corner_opacity=np.concatenate(opacity),
        end=np.concatenate([model.ends for model in models]),
        end_color=np.concatenate([model.line_color for model in models]),
        style=np.stack([np.maximum(width, _LEAST_WIDTH), solid, behind], axis=1).astype(np.float32),
        line=np.concatenate([model.line + np.int32(at) for model, at in zip(models, first, strict=False)]),
        jobs=jobs,
    )
    return image, light


def _lit(model: Model, sight: Sight) -> tuple[FloatArray, NDArray[np.uint8], NDArray[np.float32]]:
    """Corners, colours and opacities of the triangles that are drawn, lighter where they face the light."""
    a, b, c = (model.corners[:, k] for k in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    along = sight.R_camera_world[2] if sight.is_parallel else a - sight.position
    is_away = (normal * along).sum(axis=1) > 0
    facing = np.where(is_away[:, None], -normal, normal)
    bright = _AMBIENT + (1 - _AMBIENT) * np.clip(facing @ _LIGHT, 0, 1)
    keep = is_away | ~model.far_only
    color = np.clip(np.round(model.color * bright[:, None]), 0, 255).astype(np.uint8)
    return model.corners[keep], color[keep], model.opacity[keep]
