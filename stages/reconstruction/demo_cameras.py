"""Camera poses of the built-in scene: estimates as from COLMAP, and positions as from a tracker."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.stages.reconstruction.demo_scene import Q_SCENE_WORLD_WXYZ, scene_from_world
from alula.stages.reconstruction.formats.splats import Splats
from alula.stages.reconstruction.room import SIZE
from alula.stages.rotation import matrix_from_quat_wxyz, quat_wxyz_from_matrix

_WIDTH, _HEIGHT, _FOCAL = 1280, 720, 720.0
_TRACKER_NOISE_M = 0.002
_COLMAP_NOISE_M = 0.001
_OUTLIERS = ((0.2, (0.9, -0.4, 0.3)), (0.7, (-0.5, 1.3, 0.2)))  # fraction of the walk, error [m]
_POINTS = 400


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoCameras:
    """Cameras along a walk through the room.

    Attributes:
        centre_scene: estimated camera centres, shape (n, 3), scene frame.
        quat_camera_scene_wxyz: rotation from the scene to the camera (x right, y down, z forward),
            shape (n, 4).
        reference_world: measured camera centres, shape (n, 3) [m], with two gross errors.
    """

    names: tuple[str, ...]
    centre_scene: FloatArray
    quat_camera_scene_wxyz: FloatArray
    reference_world: FloatArray


def demo_cameras(count: int, seed: int) -> DemoCameras:
    """Generate cameras along a lap of the room that look inward.

    The estimated centres have a noise of 1 mm per coordinate, the measured ones of 2 mm and two outliers.
    """
    rng = np.random.default_rng([seed, 1])
    angle = 2 * np.pi * np.arange(count) / count
    middle = np.array(SIZE) / 2
    height = 1.55 + 0.35 * np.sin(2 * angle) + 0.15 * np.cos(3 * angle)
    centre = np.column_stack([middle[0] + 3.0 * np.cos(angle), middle[1] + 2.05 * np.sin(angle), height])
    target = np.column_stack(
        [middle[0] + 1.2 * np.cos(angle + 2.2), middle[1] + 0.9 * np.sin(angle + 2.2), np.full(count, 1.0)]
    )
    forward = target - centre
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    right = np.cross(forward, np.array([0.0, 0.0, 1.0]))
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    R_camera_world = np.stack([right, np.cross(forward, right), forward], axis=1)
    R_camera_scene = R_camera_world @ matrix_from_quat_wxyz(Q_SCENE_WORLD_WXYZ).T

    reference = centre + _TRACKER_NOISE_M * rng.standard_normal((count, 3))
    for fraction, error in _OUTLIERS:
        reference[int(fraction * count)] += np.array(error)
    return DemoCameras(
        names=tuple(f"walk_{i:04d}.jpg" for i in range(count)),
        centre_scene=scene_from_world(centre + _COLMAP_NOISE_M * rng.standard_normal((count, 3))),
        quat_camera_scene_wxyz=quat_wxyz_from_matrix(R_camera_scene),
        reference_world=reference,
    )


def positions_csv(names: Sequence[str], positions: FloatArray) -> str:
    """CSV text with rows `image,x,y,z`, rounded to 1e-8 units.

    Args:
        positions: shape (n, 3), any frame and units.
    """
    rows = [f"{name},{x:.8f},{y:.8f},{z:.8f}" for name, (x, y, z) in zip(names, positions, strict=True)]
    return "\n".join(["image,x,y,z", *rows]) + "\n"


def colmap_model(cameras: DemoCameras, splats: Splats, seed: int) -> dict[str, str]:
    """Sparse COLMAP model in the text format.

    Its 3D points are opaque Gaussians of the scene, with the pixels of their projections; occlusion is
    ignored.

    Args:
        splats: the Gaussians, scene frame and units.

    Returns:
        File name to content.
    """
    rng = np.random.default_rng([seed, 2])
    opaque = np.flatnonzero(splats.opacity > 0.9)
    chosen = rng.choice(opaque, min(_POINTS, len(opaque)), replace=False)
    points = splats.mean[chosen].astype(np.float64)
    R_camera_scene = matrix_from_quat_wxyz(cameras.quat_camera_scene_wxyz)
    translation = -np.einsum("nij,nj->ni", R_camera_scene, cameras.centre_scene)
    x, y, z = np.moveaxis(np.einsum("nij,pj->npi", R_camera_scene, points) + translation[:, None], 2, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        column, row = _FOCAL * x / z + _WIDTH / 2, _FOCAL * y / z + _HEIGHT / 2
    seen = (z > 0.1) & (column > 0) & (column < _WIDTH) & (row > 0) & (row < _HEIGHT)
    seen &= seen.sum(axis=0) >= 2

    tracks: list[list[str]] = [[] for _ in chosen]
    images = ["# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME; then X, Y, POINT3D_ID of each point"]
    for i, name in enumerate(cameras.names):
        numbers = (*cameras.quat_camera_scene_wxyz[i], *translation[i])
        pixels = []
        for index, point in enumerate(np.flatnonzero(seen[i])):
            tracks[point].append(f"{i + 1} {index}")
            pixels.append(f"{column[i, point]:.3f} {row[i, point]:.3f} {point + 1}")
        images += [f"{i + 1} {' '.join(f'{value:.12g}' for value in numbers)} 1 {name}", " ".join(pixels)]
    rows = ["# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)"]
    for point in np.flatnonzero(seen.any(axis=0)):
        position = " ".join(f"{value:.9g}" for value in points[point])
        color = " ".join(str(value) for value in splats.color[chosen[point]])
        rows.append(f"{point + 1} {position} {color} 0.5 {' '.join(tracks[point])}")
    camera = f"1 PINHOLE {_WIDTH} {_HEIGHT} {_FOCAL} {_FOCAL} {_WIDTH / 2} {_HEIGHT / 2}"
    return {
        "cameras.txt": f"# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n{camera}\n",
        "images.txt": "\n".join(images) + "\n",
        "points3D.txt": "\n".join(rows) + "\n",
    }
