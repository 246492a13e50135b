"""Cameras of pictures: where each pixel of a picture looks, in perspective or in parallel projection."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.stages.show.drawing.content import Camera

FIELD_RAD = np.deg2rad(50.0)  # vertical field of view
_NEAR = 1e-3  # of the distance to what is looked at


@dataclass(frozen=True, slots=True, kw_only=True)
class Sight:
    """A camera of a picture.

    Attributes:
        R_camera_world: rows right, down and forward, shape (3, 3).
        position: of the camera, world frame [m]; in parallel projection of the middle of its image.
        focal: focal length [px]; in parallel projection pixels per metre.
        columns, rows: of the picture [px].
        near_m: what is nearer along the optical axis is not drawn.
        is_parallel: parallel projection, in which a length has one scale everywhere.
    """

    R_camera_world: FloatArray
    position: FloatArray
    focal: float
    columns: int
    rows: int
    near_m: float
    is_parallel: bool = False

    def pixels(self, points: FloatArray) -> FloatArray:
        """Place of points in the picture, from its upper left corner, shape (n, 2) [px].

        Args:
            points: shape (n, 3), world frame [m]; in perspective in front of the camera.
        """
        seen = (points - self.position) @ self.R_camera_world.T
        scale = self.focal if self.is_parallel else self.focal / seen[:, 2:]
        found: FloatArray = np.array([self.columns, self.rows]) / 2 + scale * seen[:, :2]
        return found


def turned_to(along: FloatArray, up: FloatArray) -> FloatArray:
    """Rotation from the world to a camera that looks along a direction, rows right, down, forward, (3, 3).

    Args:
        along: direction of sight, of any length but zero.
        up: direction that is up in the picture; another one is taken where it is parallel to the first.
    """
    forward = along / np.linalg.norm(along)
    right = np.cross(forward, up)
    if float(np.linalg.norm(right)) < 1e-6:
        right = np.cross(forward, np.roll(up, 1))
    right = right / np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


def sight_of(
    camera: Camera,
    size: tuple[int, int],
    up: FloatArray,
    *,
    field_rad: float = float(FIELD_RAD),
    near_m: float | None = None,
) -> Sight:
    """Camera of a picture from a camera of a page.

    Args:
        size: columns and rows [px].
        up: axis that points up, shape (3,).
        near_m: as of `Sight`; None for a small fraction of the distance.
    """
    along = camera.look_at - camera.position
    return Sight(
        R_camera_world=turned_to(along, up),
        position=camera.position,
        focal=size[1] / 2 / float(np.tan(field_rad / 2)),
        columns=size[0],
        rows=size[1],
        near_m=_NEAR * float(np.linalg.norm(along)) if near_m is None else near_m,
    )
