"""Estimates of a similarity from each kind of evidence, with their records."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import radians
from typing import Any

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.manifest import Similarity
from alula.schemas.errors import UsageError
from alula.schemas.parameters.configs.scale_align import Distance, ScaleAlignConfig
from alula.stages.alignment.cloud import Cloud, fit_cloud
from alula.stages.alignment.evidence import Correspondences
from alula.stages.alignment.poses import fit_poses
from alula.stages.alignment.robust import Fit, fit_similarity
from alula.stages.alignment.uncertainty import CONFIDENCE, Uncertainty, mapped_corners
from alula.stages.quantiles import student_quantile

VISIBLE = 0.1  # opacity of Gaussians that are registered to a cloud


@dataclass(frozen=True, slots=True)
class Given:
    """A similarity that was given, not estimated.

    Attributes:
        similarity: world from scene.
    """

    similarity: Similarity
    method: str = "given"
    warnings: tuple[str, ...] = ("the similarity was given: nothing checks it",)
    facts: Mapping[str, Any] = field(default_factory=dict)


Evidence = Correspondences | Cloud | Sequence[Distance] | Similarity | Given


@dataclass(frozen=True, slots=True)
class Alignment:
    """An estimated similarity.

    Attributes:
        similarity: world from scene.
        record: the alignment's record, as the manifest holds it.
        position_error: bound of the error of positions in the scene's box, with 95 % confidence [m]; None
            where it is not known.
    """

    similarity: Similarity
    record: dict[str, Any]
    position_error: float | None = None


def estimate(
    config: ScaleAlignConfig,
    visible: Callable[[], FloatArray],
    evidence: Evidence,
    seed: int,
    box: tuple[FloatArray, FloatArray],
) -> Alignment:
    """Estimate the similarity from any kind of evidence.

    Args:
        visible: function that returns the centres of Gaussians with an opacity of at least `VISIBLE`, shape
            (n, 3), scene units; called for a cloud.
        box: smallest and largest coordinates of the scene, each of shape (3,), scene units.

    Raises:
        InputError: the evidence does not determine a similarity.
        CheckError: a cloud does not overlap the scene.
        UsageError: a gate needs figures that the evidence does not provide.
    """
    match evidence:
        case Correspondences():
            return _by_correspondences(config, evidence, seed, box)
        case Cloud():
            return _by_cloud(config, visible(), evidence, seed, box)
        case Similarity():
            return _given(config, Given(evidence))
        case Given():
            return _given(config, evidence)
        case _:
            return _by_distances(evidence, config.threshold_m, mapped_corners(scale_only(1.0), *box))


def scale_only(scale: float) -> Similarity:
    """Similarity that changes the scale alone: the origin and the axes stay.

    Args:
        scale: target units per source unit.
    """
    return Similarity(scale=scale, rotation=np.eye(3).tolist(), translation_m=[0.0, 0.0, 0.0])


def _fit(config: ScaleAlignConfig, evidence: Correspondences, seed: int) -> Fit:
    if evidence.R_scene is None or evidence.R_world is None:
        return fit_similarity(evidence.scene, evidence.world, config.threshold_m, seed)
    limits = config.threshold_m, radians(config.max_angle_deg)
    return fit_poses(evidence.scene, evidence.R_scene, evidence.world, evidence.R_world, *limits, seed)


def _by_correspondences(
    config: ScaleAlignConfig, evidence: Correspondences, seed: int, box: tuple[FloatArray, FloatArray]
) -> Alignment:
    fit = _fit(config, evidence, seed)
    items: list[dict[str, Any]] = [
        {"item": row, "residual_m": float(residual), "inlier": bool(inlier)}
        for row, residual, inlier in zip(evidence.rows, fit.residual, fit.inlier, strict=True)
    ]
    record = {
        "method": "correspondences" if fit.angle is None else "poses",
        **fit.uncertainty.record(fit.similarity),
        "scale_leave_one_out": list(fit.leave_one_out),
        "sigma_m": fit.sigma,
        "correlated_probability": fit.correlated,
        "count": len(items),
        "inliers": int(fit.inlier.sum()),
        "unused": evidence.unused,
        "unmatched": list(evidence.unmatched),
        "threshold_m": config.threshold_m,
        "seed": seed,
        **_statistics(fit.residual[fit.inlier], "m"),
        "singular_values": fit.singular_values.tolist(),
        "items": items,
        **evidence.facts,
        "warnings": [*fit.warnings, *evidence.warnings],
    }
    if fit.angle is not None:
        angle = np.degrees(fit.angle)
        for item, each in zip(items, angle.tolist(), strict=True):
            item["residual_deg"] = each
        record |= {"threshold_deg": config.max_angle_deg, **_statistics(angle[fit.inlier], "deg")}
    return Alignment(fit.similarity, record, _bound(fit.similarity, fit.uncertainty, box))


def _by_cloud(
    config: ScaleAlignConfig,
    visible: FloatArray,
    evidence: Cloud,
    seed: int,
    box: tuple[FloatArray, FloatArray],
) -> Alignment:
    facts: dict[str, Any] = {"initial": "as it is"}
    match evidence.initial:
        case Correspondences() as found:
            first = _by_correspondences(config, found, seed, box)
            initial = first.similarity
            facts = {"initial": {"by": first.record["method"], "rms_m": first.record["rms_m"]}, **found.facts}
        case Similarity() as initial:
            facts = {"initial": "given"}
        case None:
            initial = scale_only(1.0)
    fit = fit_cloud(visible, evidence.points, initial, config.threshold_m, config.min_fitness)
    square = np.bincount(fit.block, weights=fit.residual**2) / np.bincount(fit.block)
    items = [
        {
            "item": f"block at {' '.join(f'{x:.2f}' for x in centre)}",
            "residual_m": float(np.sqrt(mean_square)),
            "inlier": True,
        }
        for centre, mean_square in zip(fit.block_centre, square, strict=True)
    ]
    record = {
        "method": "cloud",
        "cloud": evidence.name,
        **facts,
        **evidence.facts,
        **fit.uncertainty.record(fit.similarity),
        "uncertainty_from": f"{len(items)} blocks of {fit.block_edge:.3g} m, each left out in turn",
        "scale_leave_one_out": list(fit.leave_one_out),
        "count": fit.count,
        "inliers": len(fit.residual),
        "fitness": fit.scene_fraction,
        "cloud_fitness": fit.cloud_fraction,
        "thinning_m": fit.thinning_m,
        "threshold_m": config.threshold_m,
        "seed": seed,
        **_statistics(fit.residual, "m"),
        "singular_values": fit.singular_values.tolist(),
        "items": items,
        "warnings": [],
    }
    return Alignment(fit.similarity, record, _bound(fit.similarity, fit.uncertainty, box))


def _statistics(residual: FloatArray, unit: str) -> dict[str, float]:
    return {
        f"rms_{unit}": float(np.sqrt((residual**2).mean())),
        f"median_{unit}": float(np.median(residual)),
        f"max_{unit}": float(residual.max()),
    }


def _bound(similarity: Similarity, uncertainty: Uncertainty, box: tuple[FloatArray, FloatArray]) -> float:
    return uncertainty.position_error(mapped_corners(similarity, *box))


def _by_distances(distances: Sequence[Distance], threshold: float, corners: FloatArray) -> Alignment:
    """Scale by least squares of metres = scale * length."""
    start, end = np.array([d[0] for d in distances]), np.array([d[1] for d in distances])
    metres = np.array([d[2] for d in distances])
    length = np.linalg.norm(end - start, axis=1)
    spread = float(length @ length)
    scale = float(length @ metres) / spread
    residual = metres - scale * length
    found: dict[str, Any] = {
        "method": "distance",
        "count": len(metres),
        "inliers": int((np.abs(residual) <= threshold).sum()),
        "threshold_m": threshold,
        "rms_m": float(np.sqrt((residual**2).mean())),
        "median_m": float(np.median(np.abs(residual))),
        "max_m": float(np.abs(residual).max()),
        "items": [
            {"item": f"distance {i + 1}", "residual_m": float(abs(r)), "inlier": bool(abs(r) <= threshold)}
            for i, r in enumerate(residual)
        ],
        "scale_sigma": None,
        "unmeasured": ["rotation", "translation"],
        "warnings": ["one distance: the error of the scale is unknown"],
    }
    freedom, error = len(metres) - 1, None
    if freedom:
        sigma = float(np.sqrt((residual @ residual) / freedom / spread))
        half = student_quantile(freedom, (1 + CONFIDENCE) / 2) * sigma
        error = half * float(np.linalg.norm(corners, axis=1).max())
        without = (float(length @ metres) - length * metres) / (spread - length * length)
        found |= {
            "scale_sigma": sigma,
            "scale_interval": [scale - half, scale + half],
            "freedom": float(freedom),
            "scale_leave_one_out": [float(without.min()), float(without.max())],
            "warnings": [],
        }
    return Alignment(scale_only(scale), found, error)


def _given(config: ScaleAlignConfig, given: Given) -> Alignment:
    if (config.max_rms_m, config.max_scale_sigma, config.min_inliers) != (None, None, None):
        raise UsageError(
            "--max-rms, --max-scale-sigma and --min-inliers need measurements; a given similarity has none"
        )
    record = {
        "method": given.method,
        "scale_sigma": None,
        **given.facts,
        "warnings": list(given.warnings),
    }
    return Alignment(given.similarity, record)
