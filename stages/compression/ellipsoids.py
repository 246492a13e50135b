"""The ellipsoids of a scene against a set of voxels: proof that nothing is left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.artifact import Artifact
from alula.schemas.errors import InputError
from alula.schemas.manifest import SPLAT_LOSS, SceneManifest
from alula.schemas.progress import Progress


@dataclass(frozen=True, slots=True)
class UnprovenVoxels:
    """Voxels that a set lacks, or that could not be proven unneeded.

    Attributes:
        total: how many there are; 0 means that the set is proven to contain the ellipsoids.
        voxel: the first 100 of them in lexicographic order, shape (K, 3).
        ellipsoid: the first row of the scene that touches each, shape (K,).
    """

    total: int
    voxel: NDArray[np.int32]
    ellipsoid: NDArray[np.int64]


def retained(scene: Artifact, min_opacity: float) -> NDArray[np.intp]:
    """Rows of the Gaussians that count: those of at least this opacity."""
    return np.flatnonzero(scene["opacity"] >= np.float32(min_opacity))


@dataclass(frozen=True, slots=True)
class Rows:
    """The Gaussians of a scene that count, as the native functions take them."""

    mean: NDArray[np.float32]
    scale: NDArray[np.float32]
    quat_wxyz: NDArray[np.float32]
    loss: NDArray[np.float32] | None


def rows_of(scene: Artifact, rows: NDArray[np.intp], *, ignore_loss: bool = False) -> Rows:
    """Those of rows that are given in ascending order; no copy when that is all."""
    arrays: dict[str, Any] = {name: scene[name] for name in ("mean", "scale", "quat_wxyz")}
    arrays["loss"] = None if ignore_loss else scene.arrays.get("loss")
    if len(rows) < len(scene["mean"]):
        arrays = {name: None if array is None else array[rows] for name, array in arrays.items()}
    return Rows(**arrays)


def lost_before(scene: SceneManifest, inflation_m: float, *, ignore_loss: bool = False) -> list[str]:
    """What separates the ellipsoids of a scene from the true ones and nothing makes up for, in words."""
    source, parts = scene.source, []
    removed = source.get("removed")
    if isinstance(removed, dict):
        parts += [
            f"{count} Gaussians removed by {reason}" for reason, count in sorted(removed.items()) if count
        ]
    loss = source.get("loss")
    losses: dict[str, Any] = loss if isinstance(loss, dict) else {}
    if (moved := losses.get("opacity")) and isinstance(removed, dict) and removed.get("min_opacity"):
        parts.append(f"what the format may have moved below that opacity, by up to {moved:.3g}")
    if SPLAT_LOSS not in scene.requires or ignore_loss:  # nothing allows for it
        found = [
            f"{key} {value:.3g}"
            for key, value in sorted(losses.items())
            if isinstance(value, float) and value and key != "opacity"
        ]
        if found:
            parts.append(
                f"what the splat file's format lost against its own source, up to {', '.join(found)}"
            )
    unbounded = losses.get("unbounded")
    for what, why in sorted(unbounded.items()) if isinstance(unbounded, dict) else ():
        parts.append(f"an error of {what} beyond the bound of the splat file's format: {why}")
    if inflation_m < scene.suggested_inflation_m:
        parts.append(
            f"an error of the alignment beyond {inflation_m:g} m, where it suggests"
            f" {scene.suggested_inflation_m:.3g} m"
        )
    elif (scene.alignment or {}).get("position_error_m", 0.0) is None:
        parts.append("the error of the alignment, which is not known")
    return parts


def unproven_voxels(
    scene: Artifact,
    index: NDArray[np.int32],
    *,
    voxel_size_m: float,
    sigma: float,
    inflation_m: float = 0.0,
    crop: Sequence[float] | None = None,
    min_overlap: int = 1,
    min_opacity: float = 0.0,
    ignore_loss: bool = False,
    jobs: int = 0,
    progress: Progress | None = None,
) -> UnprovenVoxels:
    """Prove, by another method than `voxelize`, that voxels contain the ellipsoids of a scene.

    Each voxel i = [i g, (i + 1) g] that is not in `index` and touches the crop is proven to be touched
    by fewer than `min_overlap` of the sets {c + R diag(k s) u + b : |u| <= 1, |b| <= r}, with k and r those
    of `level_of` in `ellipsoid.hpp` where the scene has a `loss`, each time by
    a plane n with n.c + |diag(k s) R' n| + r |n| < min n.x over the voxel, both sides evaluated with
    rigorous rounding bounds. A voxel is never passed wrongly.

    Args:
        scene: an `alula/scene`, in the frame and unit of the voxels.
        index: the voxels, shape (M, 3), in any order; repetitions are allowed.
        voxel_size_m: g [m].
        sigma: k, level of the ellipsoids.
        inflation_m: r [m], radius of the ball added to each ellipsoid.
        crop: XMIN YMIN ZMIN XMAX YMAX ZMAX [m]; voxels that do not touch it do not count.
        min_overlap: voxels touched by fewer ellipsoids may be missing.
        min_opacity: ellipsoids of Gaussians below it do not count.
        ignore_loss: take the ellipsoids as they are, not grown by what the scene's `loss` says.
        jobs: threads; the result does not depend on it.
        progress: called with (done, total) ellipsoids.

    Raises:
        InputError: the touched voxels that are missing exceed the memory budget.
    """
    rows = retained(scene, min_opacity)
    found = rows_of(scene, rows, ignore_loss=ignore_loss)
    try:
        total, voxel, ellipsoid = _core.unproven_voxels(
            found.mean,
            found.scale,
            found.quat_wxyz,
            sigma,
            voxel_size_m,
            inflation_m,
            None if crop is None else tuple(crop),
            min_overlap,
            np.ascontiguousarray(index, np.int32),
            jobs,
            progress,
            found.loss,
        )
    except OverflowError as error:
        raise InputError(f"the voxels are not those of this scene: {error}") from error
    return UnprovenVoxels(total, voxel, rows[ellipsoid].astype(np.int64))
