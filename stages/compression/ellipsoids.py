"""Proof that a set of voxels contains the ellipsoids of a scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.manifest import SPLAT_LOSS, LevelManifest, SceneManifest
from alula.schemas.decimals import at_most, exact
from alula.schemas.errors import InputError
from alula.schemas.progress import Progress
from alula.stages.reconstruction.formats.properties import unknown_words


@dataclass(frozen=True, slots=True)
class UnprovenVoxels:
    """Voxels outside a set that are touched by an ellipsoid, or not proven to be untouched.

    Attributes:
        total: their number; 0 means that the set is proven to contain the ellipsoids.
        voxel: the first 100 of them in lexicographic order, shape (K, 3).
        ellipsoid: the first row of the scene that touches each, shape (K,).
    """

    total: int
    voxel: NDArray[np.int32]
    ellipsoid: NDArray[np.int64]


def retained(scene: Artifact, min_opacity: float) -> NDArray[np.intp]:
    """Rows of the Gaussians with at least this opacity, in ascending order.

    Args:
        min_opacity: minimum opacity, compared in single precision.
    """
    return np.flatnonzero(scene["opacity"] >= np.float32(min_opacity))


@dataclass(frozen=True, slots=True)
class Rows:
    """Some Gaussians of a scene, as the arrays that the native functions take.

    Attributes:
        mean: centres, shape (K, 3), frame and unit of the scene.
        scale: one-sigma semi-axes, shape (K, 3), unit of the scene.
        quat_wxyz: rotations from local axes to the frame, shape (K, 4).
        loss: bounds of the splat format's error, shape (K, 3) (see `SCENE`); None when it is zero or ignored.
    """

    mean: NDArray[np.float32]
    scale: NDArray[np.float32]
    quat_wxyz: NDArray[np.float32]
    loss: NDArray[np.float32] | None


def rows_of(scene: Artifact, rows: NDArray[np.intp], *, ignore_loss: bool = False) -> Rows:
    """Select rows of a scene; no copy is made when all rows are selected.

    Args:
        rows: in ascending order, shape (K,).
    """
    arrays: dict[str, Any] = {name: scene[name] for name in ("mean", "scale", "quat_wxyz")}
    arrays["loss"] = None if ignore_loss else scene.arrays.get("loss")
    if len(rows) < len(scene["mean"]):
        arrays = {name: None if array is None else array[rows] for name, array in arrays.items()}
    return Rows(**arrays)


def lacks_of(scene: SceneManifest) -> list[str]:
    """Phrases that name what a scene lacks of its capture: files of its level of detail, properties."""
    lacks, unknown = scene.source.get("lacks") or [], scene.source.get("unknown_properties") or []
    words = [f"{what}, not imported" for what in lacks]
    return [*words, f"what {unknown_words(unknown)}, may do to its Gaussians"] if unknown else words


def removed_from(scene: SceneManifest) -> list[str]:
    """Phrases that name what of its splat a scene does not have: what it lacks, and the rows removed."""
    removed = scene.source.get("removed")
    rows = sorted(removed.items()) if isinstance(removed, dict) else []
    return lacks_of(scene) + [f"{count} Gaussians removed by {reason}" for reason, count in rows if count]


def recorded_lacks(level: LevelManifest) -> list[str]:
    """The phrases of `lacks_of` that voxels, or a cover made from them, record.

    Args:
        level: manifest of an `alula/voxels` or an `alula/cover`.
    """
    left_out = (level.guarantee.claims if level.guarantee is not None else {}).get("left_out")
    lacks = left_out.get("lacks_of_capture") if isinstance(left_out, dict) else None
    return [str(what) for what in lacks] if isinstance(lacks, list) else []


def excluded_errors(scene: SceneManifest, inflation_m: float, *, ignore_loss: bool = False) -> list[str]:
    """Phrases that name the errors of a scene's ellipsoids that neither `loss` nor the inflation covers.

    Args:
        inflation_m: radius of the ball added to each ellipsoid [m].
        ignore_loss: the scene's `loss` is not used.
    """
    source, parts = scene.source, removed_from(scene)
    removed = source.get("removed")
    loss = source.get("loss")
    losses: dict[str, Any] = loss if isinstance(loss, dict) else {}
    if (moved := losses.get("opacity")) and isinstance(removed, dict) and removed.get("min_opacity"):
        parts.append(f"what the format may have moved below that opacity, by up to {at_most(moved)}")
    if SPLAT_LOSS not in scene.requires or ignore_loss:  # the ellipsoids are not grown by it
        found = [
            f"{key} {at_most(value)}"
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
            f"an error of the alignment beyond {exact(inflation_m)} m, where it suggests"
            f" {at_most(scene.suggested_inflation_m)} m"
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
    by fewer than `min_overlap` of the sets {c + R diag(k s) u + b : |u| <= 1, |b| <= r}. Where the scene has
    a `loss`, k and r are those of `level_of` in `ellipsoid.hpp`. Each proof is a separating plane n with
    n.c + |diag(k s) R' n| + r |n| < min n.x over the voxel, both sides evaluated with rigorous rounding
    bounds. So no touched voxel passes as untouched.

    Args:
        scene: an `alula/scene`, in the frame and unit of the voxels.
        index: the voxels, shape (M, 3), in any order; repetitions are allowed.
        voxel_size_m: g [m].
        sigma: k, level of the ellipsoids.
        inflation_m: r [m], radius of the ball added to each ellipsoid.
        crop: XMIN YMIN ZMIN XMAX YMAX ZMAX [m]; voxels that do not touch it do not count.
        min_overlap: voxels touched by fewer ellipsoids may be missing.
        min_opacity: ellipsoids of Gaussians below it do not count.
        ignore_loss: do not grow the ellipsoids by the scene's `loss`.

    Returns:
        The voxels without a proof.

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
