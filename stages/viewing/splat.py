"""Gaussians of a scene as a browser draws them: those that contribute most, with their covariances."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from alula.schemas.artifact import Artifact
from alula.schemas.configs.view import MOST_GAUSSIANS
from alula.stages.rotation import matrix_from_quat_wxyz
from alula.stages.viewing.content import Gaussians

_GRID_M = 2.0**-10  # centres are rounded to this, or to a sixteenth of a small Gaussian


def contribution(scene: Artifact) -> NDArray[np.float64]:
    """Opacity times the area of the projected ellipse along its shortest axis, shape (N,).

    Args:
        scene: an `alula/scene`.
    """
    axes = np.sort(np.asarray(scene["scale"], np.float64), axis=1)
    area: NDArray[np.float64] = np.asarray(scene["opacity"], np.float64) * axes[:, 1] * axes[:, 2]
    return area


def chosen(scene: Artifact, maximum: int = MOST_GAUSSIANS) -> NDArray[np.int64]:
    """Rows of the at most `maximum` Gaussians that contribute most, in order along a space-filling curve.

    Neighbours in space are neighbours in the order, so that the rows compress well.

    Args:
        scene: an `alula/scene`.
        maximum: number of rows.
    """
    order = np.argsort(-contribution(scene), kind="stable")[:maximum]
    return order[np.argsort(_morton(np.asarray(scene["mean"])[order]), kind="stable")]


def _morton(points: NDArray[np.float32]) -> NDArray[np.uint64]:
    """Interleave the bits of the coordinates, ten of each, within the central 99 % of the points."""
    if not len(points):
        return np.empty(0, np.uint64)
    low, high = np.quantile(points, (0.005, 0.995), axis=0)
    cell = np.clip((points - low) / np.maximum(high - low, 1e-9) * 1023, 0, 1023).astype(np.uint64)
    code = np.zeros(len(points), np.uint64)
    for bit in range(10):
        for axis in range(3):
            code |= ((cell[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return code


def gaussians(name: str, scene: Artifact, rows: NDArray[np.int64], *, visible: bool = True) -> Gaussians:
    """Gaussians of some rows of a scene.

    Centres are rounded to a fraction of the smallest common size, far below what can be seen.

    Args:
        name: in the scene tree.
        scene: an `alula/scene`.
        rows: from `chosen`.
        visible: shown at first.
    """
    scale = np.asarray(scene["scale"], np.float64)[rows]
    turn = matrix_from_quat_wxyz(np.asarray(scene["quat_wxyz"], np.float64)[rows])
    half = turn * scale[:, None, :]
    mean = np.asarray(scene["mean"], np.float64)[rows]
    if len(rows):
        small = float(np.quantile(scale.max(axis=1), 0.05)) / 16
        grid = min(_GRID_M, 2.0 ** np.floor(np.log2(max(small, 1e-9))))
        mean = np.round(mean / grid) * grid
    return Gaussians(
        name=name,
        mean=mean.astype(np.float32),
        covariance=(half @ half.transpose(0, 2, 1)).astype(np.float32),
        color=np.asarray(scene["color"])[rows],
        opacity=np.asarray(scene["opacity"], np.float32)[rows],
        visible=visible,
    )
