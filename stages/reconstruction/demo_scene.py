"""The stage `demo-scene`: Gaussians on the surfaces of a furnished room, like those of a training run."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.manifest import Similarity
from alula.schemas.parameters.configs.demo_scene import DemoSceneConfig
from alula.stages.reconstruction.formats.splats import Splats
from alula.stages.reconstruction.room import HOOPS, SIZE, room
from alula.stages.reconstruction.surfaces import Surface
from alula.stages.rotation import matrix_from_quat_wxyz, multiply_quat_wxyz, quat_wxyz_from_matrix

SCENE_SCALE = 0.37  # scene units per metre
Q_SCENE_WORLD_WXYZ = np.array([0.61, -0.66, 0.35, -0.26]) / np.sqrt(0.61**2 + 0.66**2 + 0.35**2 + 0.26**2)
T_SCENE = np.array([0.84, -1.37, 2.05])  # the world's origin in scene units
_SIZES = 200_000  # number of Gaussians for which the sizes below hold

_FLOATER_FRACTION = 0.01
_BLOB = 25  # Gaussians per isolated blob
_BLOBS = 16  # maximum number; blobs take up to a third of the floaters
_NEEDLE_FRACTION = 0.01
_FAINT_FRACTION = 0.04


def scene_from_world(points_world: FloatArray) -> FloatArray:
    """Map points to the arbitrary frame of the built-in scene: p_scene = 0.37 R p_world + t.

    Args:
        points_world: shape (n, 3), world frame [m].

    Returns:
        Shape (n, 3), scene frame and units.
    """
    points_scene: FloatArray = (
        SCENE_SCALE * points_world @ matrix_from_quat_wxyz(Q_SCENE_WORLD_WXYZ).T + T_SCENE
    )
    return points_scene


def world_from_scene() -> Similarity:
    """Inverse of `scene_from_world`: the similarity that `scale-align` has to estimate."""
    rotation = matrix_from_quat_wxyz(Q_SCENE_WORLD_WXYZ).T
    translation = -rotation @ T_SCENE / SCENE_SCALE
    return Similarity(scale=1.0 / SCENE_SCALE, rotation=rotation.tolist(), translation_m=translation.tolist())


def demo_scene(config: DemoSceneConfig, seed: int) -> Splats:
    """Cover the room with flat Gaussians, add floaters, and map all to an arbitrary frame.

    1 % of the Gaussians are floaters: faint haze (opacity below 0.1) and up to 16 isolated blobs of 25 in
    free space, away from the hoops' openings. 4 % of the others are faint (opacity below 0.1) and 1 % are
    needles. At 200,000 Gaussians the semi-axes are 5 to 20 mm along the surface and 0.5 to 2 mm across it.
    Those along the surface grow with the inverse square root of the number, so that surfaces stay closed.
    Quaternions are not normalised.

    Args:
        seed: seed of all randomness; equal seeds give equal bytes.

    Returns:
        The Gaussians, scene frame and units (0.37 per metre), in random order.
    """
    rng = np.random.default_rng(seed)
    n_floaters = round(config.gaussians * _FLOATER_FRACTION)
    surfaces = room()
    weights = np.array([s.area * s.density for s in surfaces])
    counts = _split(weights, config.gaussians - n_floaters)
    growth = float(np.sqrt(_SIZES / config.gaussians))
    parts = [_cover(s, n, growth, rng) for s, n in zip(surfaces, counts, strict=True) if n]
    parts.append(_floaters(n_floaters, np.vstack([part["mean"] for part in parts]), rng))
    merged = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    order = rng.permutation(config.gaussians)
    mean, scale, quat, opacity, color = (
        merged[name][order] for name in ("mean", "scale", "quat_wxyz", "opacity", "color")
    )
    quat = multiply_quat_wxyz(Q_SCENE_WORLD_WXYZ, quat) * rng.uniform(0.6, 1.4, (len(quat), 1))
    return Splats(
        format="ply",
        mean=scene_from_world(mean).astype(np.float32),
        scale=(SCENE_SCALE * scale).astype(np.float32),
        quat_wxyz=quat.astype(np.float32),
        opacity=opacity.astype(np.float32),
        color=np.rint(np.clip(color, 0, 1) * 255).astype(np.uint8),
    )


def _split(weights: FloatArray, total: int) -> NDArray[np.int64]:
    """Split a total into whole numbers in proportion to the weights."""
    ends = np.rint(np.cumsum(weights) / weights.sum() * total).astype(np.int64)
    counts: NDArray[np.int64] = np.diff(ends, prepend=0)
    return counts


def _cover(surface: Surface, count: int, growth: float, rng: np.random.Generator) -> dict[str, Any]:
    """Gaussians spread evenly over one surface and flat on it."""
    steps = np.arange(count)[:, None] * np.array([0.7548776662466927, 0.5698402909980532])  # R2 sequence
    u, v = ((steps + rng.random(2)) % 1.0).T
    points, normals = surface.sample(u, v)
    size = growth * surface.detail
    along = np.clip(0.010 * np.exp(0.35 * rng.standard_normal((count, 2))), 0.005, 0.020) * size
    across = np.clip(0.001 * np.exp(0.4 * rng.standard_normal(count)), 0.0005, 0.002)
    needle = rng.random(count) < _NEEDLE_FRACTION
    along[needle] *= np.array([1.8, 0.2])
    scale = np.column_stack([along, across])

    normals = normals + 0.05 * rng.standard_normal(normals.shape)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    first = np.cross(normals, rng.standard_normal(normals.shape))
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    axes = np.stack([first, np.cross(normals, first), normals], axis=2)
    turn = (np.arange(3) + rng.integers(0, 3, (count, 1))) % 3  # no axis is always the thin one
    scale = np.take_along_axis(scale, turn, axis=1)
    axes = np.take_along_axis(axes, turn[:, None, :], axis=2)

    opacity = 1.0 - 0.5 * rng.beta(1.2, 4.0, count)
    weak = rng.random(count) < 0.08
    opacity[weak] = rng.uniform(0.1, 0.5, int(weak.sum()))
    faint = rng.random(count) < _FAINT_FRACTION
    opacity[faint] = rng.uniform(0.006, 0.1, int(faint.sum()))
    light = 0.82 + 0.18 * np.abs(normals @ np.array([0.3, 0.2, 0.93]))
    color = surface.paint(u, v) * light[:, None] + 0.025 * rng.standard_normal((count, 3))
    return {
        "mean": points + normals * (0.0015 * rng.standard_normal((count, 1))),
        "scale": scale,
        "quat_wxyz": quat_wxyz_from_matrix(axes),
        "opacity": opacity,
        "color": color,
    }


def _floaters(count: int, surface_points: FloatArray, rng: np.random.Generator) -> dict[str, Any]:
    """Faint haze everywhere and small solid blobs in free space."""
    blob_centres = _free_points(min(_BLOBS, -(-count // (3 * _BLOB))), surface_points, rng)
    n_blob = min(count // 3, _BLOB * len(blob_centres))
    haze = rng.uniform(0.0, 1.0, (count - n_blob, 3)) * np.array(SIZE)
    centres = np.repeat(blob_centres, _BLOB, axis=0)[:n_blob]
    blob = centres + np.clip(0.03 * rng.standard_normal((n_blob, 3)), -0.07, 0.07)
    quat = rng.standard_normal((count, 4))
    return {
        "mean": np.vstack([haze, blob]),
        "scale": np.clip(0.02 * np.exp(0.6 * rng.standard_normal((count, 3))), 0.002, 0.04),
        "quat_wxyz": quat / np.linalg.norm(quat, axis=1, keepdims=True),
        "opacity": np.concatenate([rng.uniform(0.006, 0.095, len(haze)), rng.uniform(0.15, 0.6, n_blob)]),
        "color": np.full((count, 3), 0.6) + 0.1 * rng.standard_normal((count, 3)),
    }


def _free_points(count: int, surface_points: FloatArray, rng: np.random.Generator) -> FloatArray:
    """At most `count` points, 0.5 m from every surface, 1 m from every hoop's centre and 0.6 m apart."""
    from scipy.spatial import cKDTree

    tree = cKDTree(surface_points[:: max(1, len(surface_points) // 50_000)])
    hoops = cKDTree(np.array([hoop.centre for hoop in HOOPS]))
    tried = rng.uniform(0.0, 1.0, (20_000, 3)) * np.array(SIZE)
    found: list[FloatArray] = []
    for point in tried[(tree.query(tried)[0] > 0.5) & (hoops.query(tried)[0] > 1.0)]:
        if len(found) < count and all(np.linalg.norm(point - other) > 0.6 for other in found):
            found.append(point)
    return np.array(found).reshape(-1, 3)
