"""`scale-align`: from the arbitrary frame of a splat to metres in a world frame."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product
from typing import Any

import numpy as np

from alula.schemas.artifact import Artifact, make_artifact
from alula.schemas.configs.scale_align import Distance, ScaleAlignConfig
from alula.schemas.errors import CheckError, InputError, UsageError
from alula.schemas.kinds import SCENE
from alula.schemas.manifest import Guarantee, SceneManifest, Similarity
from alula.schemas.provenance import parameters_of
from alula.stages.alignment.evidence import Correspondences
from alula.stages.alignment.similarity import (
    CONFIDENCE,
    Array,
    compose,
    fit_similarity,
    position_error,
    shape_warnings,
    transform_points,
)
from alula.stages.reconstruction.formats.splats import rounded_up
from alula.stages.rotation import multiply_quat_wxyz, quat_wxyz_from_matrix

Evidence = Correspondences | Sequence[Distance] | Similarity


def scale_align(
    config: ScaleAlignConfig,
    scene: Artifact,
    evidence: Evidence,
    seed: int,
    report: Callable[[dict[str, Any]], None] | None = None,
) -> Artifact:
    """Estimate the similarity, judge it, and map the scene with it.

    mean' = s R mean + t, scale' = s scale, q' = q_R q; opacity and colour stay. Means and scales are
    rounded to single precision (`alignment["rounding_m"]` bounds the move), and the result, not the
    original, is what later stages are measured against. A scene that is aligned already may be
    aligned again: `world_from_scene` is then the composition, and the suggested inflations add up.

    Args:
        config: see `ScaleAlignConfig`.
        scene: an `alula/scene`.
        evidence: correspondences; distances, which fix the scale alone; or the similarity itself.
        seed: of the robust estimation.
        report: called with the record of the alignment before the gates are applied.

    Returns:
        An `alula/scene`, frame `world`, unit `m`.

    Raises:
        InputError: the evidence does not determine a similarity, or the result overflows.
        CheckError: a gate does not hold, with the figure and the limit.
        UsageError: a gate that the evidence has no figure for.
    """
    manifest = scene.manifest
    assert isinstance(manifest, SceneManifest)
    mean = np.asarray(scene["mean"], np.float64)
    lower, upper = mean.min(axis=0), mean.max(axis=0)
    corners = np.array(list(product(*zip(lower, upper, strict=True))))
    match evidence:
        case Correspondences():
            similarity, found = _by_correspondences(config, evidence, seed, corners)
        case Similarity():
            similarity, found = evidence, _exact(config)
        case _:
            similarity, found = _by_distances(evidence, corners)

    matrix = np.eye(4)
    matrix[:3, :3] = similarity.scale * np.array(similarity.rotation)
    matrix[:3, 3] = similarity.translation_m
    q_world_scene = quat_wxyz_from_matrix(np.array(similarity.rotation))
    arrays, rounding = _mapped(scene, similarity, q_world_scene)
    alignment = {
        "from_frame": manifest.frame,
        "from_unit": manifest.unit,
        "to_frame": "world",
        "to_unit": "m",
        "scale": similarity.scale,
        "q_world_scene_wxyz": q_world_scene.tolist(),
        "matrix": matrix.tolist(),
        "determinant": float(np.linalg.det(np.array(similarity.rotation))),
        "rounding_m": rounding,
        **found,
    }
    if report is not None:
        report(alignment)
    _check_gates(config, alignment)

    whole, inflation = similarity, float(found["position_error_m"] or 0.0)
    if manifest.world_from_scene is not None:
        whole = compose(similarity, manifest.world_from_scene)
        inflation += similarity.scale * manifest.suggested_inflation_m
        alignment["previous"] = manifest.alignment
    lower, upper = arrays["mean"].min(axis=0), arrays["mean"].max(axis=0)
    figures = ("method", "scale", "scale_sigma", "count", "inliers", "rms_m", "max_m", "position_error_m")
    summary = {
        "gaussians": len(mean),
        **{key: alignment[key] for key in figures if alignment.get(key) is not None},
        "lower_m": lower.tolist(),
        "upper_m": upper.tolist(),
        "suggested_inflation_m": inflation,
    }
    if alignment["warnings"]:
        summary["warnings"] = alignment["warnings"]
    return make_artifact(
        SCENE,
        arrays,
        frame="world",
        unit="m",
        parameters=parameters_of(config),
        summary=summary,
        guarantee=_guarantee(manifest, found["position_error_m"], inflation),
        source=manifest.source,
        requires=manifest.requires,
        world_from_scene=whole,
        alignment=alignment,
        suggested_inflation_m=inflation,
    )


def _by_correspondences(
    config: ScaleAlignConfig, evidence: Correspondences, seed: int, corners: Array
) -> tuple[Similarity, dict[str, Any]]:
    fit = fit_similarity(evidence.scene, evidence.world, config.threshold_m, seed)
    inliers = fit.residual[fit.inlier]
    items = [
        {"item": row, "residual_m": float(residual), "inlier": bool(inlier)}
        for row, residual, inlier in zip(evidence.rows, fit.residual, fit.inlier, strict=True)
    ]
    return fit.similarity, {
        "method": "correspondences",
        "scale_sigma": fit.scale_sigma,
        "scale_interval": list(fit.scale_interval),
        "scale_leave_one_out": list(fit.leave_one_out),
        "sigma_m": fit.sigma,
        "count": len(items),
        "inliers": len(inliers),
        "unused": evidence.unused,
        "threshold_m": config.threshold_m,
        "seed": seed,
        "rms_m": float(np.sqrt((inliers**2).mean())),
        "median_m": float(np.median(inliers)),
        "max_m": float(inliers.max()),
        "singular_values": fit.singular_values.tolist(),
        "items": items,
        "position_error_m": position_error(fit, evidence.scene, corners),
        "warnings": shape_warnings(fit),
    }


def _by_distances(distances: Sequence[Distance], corners: Array) -> tuple[Similarity, dict[str, Any]]:
    """Least squares of metres = scale * length through the origin."""
    from scipy.stats import t as student

    start, end = np.array([d[0] for d in distances]), np.array([d[1] for d in distances])
    metres = np.array([d[2] for d in distances])
    length = np.linalg.norm(end - start, axis=1)
    spread = float(length @ length)
    scale = float(length @ metres) / spread
    residual = metres - scale * length
    found: dict[str, Any] = {
        "method": "distance",
        "count": len(metres),
        "inliers": len(metres),
        "rms_m": float(np.sqrt((residual**2).mean())),
        "median_m": float(np.median(np.abs(residual))),
        "max_m": float(np.abs(residual).max()),
        "items": [
            {"item": f"distance {i + 1}", "residual_m": float(abs(r)), "inlier": True}
            for i, r in enumerate(residual)
        ],
        "scale_sigma": None,
        "position_error_m": None,
        "warnings": ["one distance: how well the scale is known is unknown"],
    }
    freedom = len(metres) - 1
    if freedom:
        sigma = float(np.sqrt((residual @ residual) / freedom / spread))
        half = float(student.ppf((1 + CONFIDENCE) / 2, freedom)) * sigma
        found |= {
            "scale_sigma": sigma,
            "scale_interval": [scale - half, scale + half],
            "position_error_m": half * float(np.linalg.norm(corners, axis=1).max()),
            "warnings": [],
        }
    return scale_only(scale), found


def scale_only(scale: float) -> Similarity:
    """A similarity that keeps the origin and the axes."""
    return Similarity(scale=scale, rotation=np.eye(3).tolist(), translation_m=[0.0, 0.0, 0.0])


def _exact(config: ScaleAlignConfig) -> dict[str, Any]:
    if (config.max_rms_m, config.max_scale_sigma, config.min_inliers) != (None, None, None):
        raise UsageError(
            "--max-rms, --max-scale-sigma and --min-inliers need something to be measured against"
        )
    return {
        "method": "given",
        "scale_sigma": None,
        "position_error_m": None,
        "warnings": ["the similarity was given: nothing checks it"],
    }


def _guarantee(manifest: SceneManifest, known: float | None, inflation: float) -> Guarantee:
    """What was promised before, and how far the alignment may be off."""
    before = manifest.guarantee or Guarantee(statement="")
    if known is None:
        error = "how far that is off is not known."
    else:
        error = (
            f"with {CONFIDENCE:.0%} confidence no point is off by more than {inflation:.3g} m, if the "
            "errors of the correspondences are independent."
        )
    return Guarantee(
        statement=f"{before.statement} It was mapped by one similarity; {error}".strip(),
        claims=before.claims
        | {"position_error_m": None if known is None else inflation, "confidence": CONFIDENCE},
    )


def _check_gates(config: ScaleAlignConfig, alignment: dict[str, Any]) -> None:
    if alignment["method"] == "given":
        return
    count, inliers, rms = alignment["count"], alignment["inliers"], alignment["rms_m"]
    needed = config.min_inliers if config.min_inliers is not None else count // 2 + 1
    if inliers < needed:
        raise CheckError(
            f"alignment: {inliers} of {count} correspondences are inliers, {needed} are needed "
            f"(--min-inliers); --threshold {config.threshold_m:g} m may be too small"
        )
    if config.max_rms_m is not None and rms > config.max_rms_m:
        raise CheckError(
            f"alignment: the RMS residual is {rms:.4g} m, above --max-rms {config.max_rms_m:g} m"
        )
    sigma = alignment["scale_sigma"]
    if config.max_scale_sigma is not None and (sigma is None or sigma > config.max_scale_sigma):
        figure = "unknown" if sigma is None else f"{sigma:.4g}"
        raise CheckError(
            f"alignment: the scale's sigma is {figure}, above --max-scale-sigma {config.max_scale_sigma:g}"
        )


def _mapped(scene: Artifact, similarity: Similarity, q_world_scene: Array) -> tuple[dict[str, Any], float]:
    """The arrays in the new frame, and how far the rounding of means moves one."""
    exact = transform_points(similarity, scene["mean"])
    quat = multiply_quat_wxyz(q_world_scene, scene["quat_wxyz"])
    quat /= np.linalg.norm(quat, axis=1, keepdims=True)
    with np.errstate(over="ignore", under="ignore"):
        mean = exact.astype(np.float32)
        scale = (similarity.scale * np.asarray(scene["scale"], np.float64)).astype(np.float32)
    for name, values in (("mean", mean), ("scale", scale)):
        if not np.isfinite(values).all():
            row = int(np.argwhere(~np.isfinite(values))[0][0])
            raise InputError(f"the {name} of Gaussian {row} does not fit single precision in metres")
    arrays = {
        "mean": mean,
        "scale": np.maximum(scale, np.finfo(np.float32).tiny),
        "quat_wxyz": quat.astype(np.float32),
        "opacity": scene["opacity"],
        "color": scene["color"],
    }
    if "loss" in scene.arrays:  # of the centre it is a length
        arrays["loss"] = np.array(scene["loss"])
        arrays["loss"][:, 0] = rounded_up(similarity.scale * np.asarray(scene["loss"][:, 0], np.float64))
    return arrays, float(np.linalg.norm(mean - exact, axis=1).max())
