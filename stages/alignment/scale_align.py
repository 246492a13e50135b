"""The stage `scale-align`: map a scene from its arbitrary frame to metres in a world frame."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.artifact import Artifact, make_artifact
from alula.schemas.artifacts.kinds import SCENE
from alula.schemas.artifacts.manifest import Guarantee, SceneManifest, Similarity, map_origin
from alula.schemas.artifacts.provenance import parameters_of
from alula.schemas.decimals import at_most, exact
from alula.schemas.errors import CheckError, InputError, UsageError
from alula.schemas.parameters.configs.scale_align import ScaleAlignConfig
from alula.stages.alignment.cloud import Cloud
from alula.stages.alignment.estimates import VISIBLE, Estimate, Evidence, Given, estimate, scale_only
from alula.stages.alignment.evidence import Correspondences
from alula.stages.alignment.levelling import level_by_direction, level_by_floor
from alula.stages.alignment.model_frame import ModelFrame, model_frame
from alula.stages.alignment.similarity import compose, transform_points
from alula.stages.alignment.uncertainty import CONFIDENCE, mapped_corners
from alula.stages.coordinates import nearer_origin
from alula.stages.reconstruction.formats.splats import rounded_up
from alula.stages.rotation import quat_wxyz_from_matrix

__all__ = ["Evidence", "Given", "scale_align", "scale_only"]

_CHUNK = 2**15  # rows; their temporary arrays stay in the cache
_SAME_SCALE = 1e-6  # a larger change of the scale of a scene in metres causes a warning
_CORRECTION = 0.05  # a larger one is taken for a mistake
_FAR_M = 8192.0  # coordinates up to it are rounded by less than a millimetre
_COARSE_M = 1e-3  # a larger rounding of positions causes a warning
_BOUNDED_SIGMA = 3.0  # the error bound holds for all points of the ellipsoids of this level
_SINGLE = 1.2e-7  # just over 2^-23, twice the rounding to single precision


def scale_align(
    config: ScaleAlignConfig,
    scene: Artifact,
    evidence: Evidence | None,
    seed: int,
    report: Callable[[dict[str, Any]], None] | None = None,
) -> Artifact:
    """Estimate the similarity, check it against the gates, and map the scene with it.

    mean' = s R mean + t, scale' = s scale, q' = q_R q; opacity and colour stay. All are rounded to single
    precision. `alignment["rounding_m"]` bounds the shift of the means by this rounding. It is part of the
    suggested inflation where the error of positions is known, or where the shift exceeds a millimetre; a
    `loss` grows by all of it. Otherwise later stages refer to the rounded result, not to the original. A
    scene that is aligned already may be aligned again: `world_from_scene` is then the composition, and the
    suggested inflations add up.

    Args:
        evidence: correspondences of points or poses; a cloud; distances, which fix the scale alone; or
            the similarity itself. None only levels a scene that is in metres.
        report: called with the record of the alignment before the gates are applied.

    Returns:
        An `alula/scene`, frame `world`, unit `m`.

    Raises:
        InputError: the evidence does not determine a similarity, or the result overflows.
        CheckError: a gate does not hold (the message has the figure and the limit), a cloud does not overlap
            the scene, no floor is found, or the cameras are not in the scene's frame (see `model_frame`).
        UsageError: a gate needs a figure that the evidence does not provide, or levelling is requested
            although the evidence fixes the rotation.
    """
    manifest = scene.manifest
    assert isinstance(manifest, SceneManifest)
    box = bounds(scene["mean"], scene["scale"])

    def means() -> FloatArray:
        return np.asarray(scene["mean"], np.float64)

    def visible() -> FloatArray:
        return np.asarray(scene["mean"][scene["opacity"] >= VISIBLE], np.float64)

    found = solved(config, manifest, box, means, visible, evidence, seed)
    arrays, rounding = mapped(scene, found.similarity)
    return aligned(config, alignment_of(config, manifest, found, rounding, report), manifest, arrays)


def solved(
    config: ScaleAlignConfig,
    manifest: SceneManifest,
    box: tuple[FloatArray, FloatArray],
    means: Callable[[], FloatArray],
    visible: Callable[[], FloatArray],
    evidence: Evidence | None,
    seed: int,
) -> Estimate:
    """Estimate the similarity and level its frame.

    Args:
        means: function that returns centres, shape (n, 3), scene units; called for a floor.
        visible: the same of Gaussians with an opacity of at least `VISIBLE`; called for a cloud, or for the
            cameras of a model with 3D points.

    Raises:
        InputError, CheckError, UsageError: see `scale_align`.
    """
    if config.levels and isinstance(evidence, Correspondences | Cloud):
        raise UsageError("--up and --floor turn the frame, but the evidence fixes its rotation already")
    if evidence is None:
        if manifest.unit != "m":
            raise UsageError(
                "--up and --floor alone are for scenes in metres; give a way to align too (--scale ...)"
            )
        evidence = Given(scale_only(1.0), "level", ())
    evidence, frame = _in_scene_frame(config, evidence, visible)
    found = estimate(config, visible, evidence, seed, box)
    if found.position_error is not None:
        added = found.similarity.scale * frame.position_error(*box)
        found = dataclasses.replace(found, position_error=found.position_error + added)
        if frame.fit is not None:
            found.record["model_frame"]["position_error_m"] = added
    if config.levels:
        known = manifest.frame == "world" or isinstance(evidence, Similarity)
        found = _levelled(config, found, means, box, frame_is_known=known)
    if (former := map_origin(manifest)) is not None:
        words = " ".join(f"{c:.12g}" for c in former)
        found.record["warnings"] = [
            *found.record["warnings"],
            f"the map's origin of the former alignment, ({words}) m, is not kept: the new alignment moves "
            "the map; align once, with all options",
        ]
    return _from_map_origin(config, found, means, box)


def _from_map_origin(
    config: ScaleAlignConfig,
    found: Estimate,
    means: Callable[[], FloatArray],
    box: tuple[FloatArray, FloatArray],
) -> Estimate:
    """Estimate whose world has the origin of the map, chosen where single precision would be coarse."""
    origin, warnings = config.map_origin, list(found.record["warnings"])
    if origin is None:
        if np.abs(mapped_corners(found.similarity, *box)).max() <= _FAR_M:
            return found
        # floaters may be anywhere
        low, high = np.percentile(transform_points(found.similarity, means()), [1, 99], axis=0)
        origin = nearer_origin(low, high, _FAR_M)
        if any(origin):
            words = " ".join(f"{c:.12g}" for c in origin)
            warnings.append(
                f"coordinates are too large for single precision, so that the map's origin is ({words}) "
                "m of the world (--map-origin)"
            )
    if not any(origin):
        return found
    similarity = found.similarity
    moved = [t - o for t, o in zip(similarity.translation_m, origin, strict=True)]
    return dataclasses.replace(
        found,
        similarity=Similarity(similarity.scale, similarity.rotation, moved),
        record={**found.record, "map_origin_m": list(origin), "warnings": warnings},
    )


def _in_scene_frame(
    config: ScaleAlignConfig, evidence: Evidence, visible: Callable[[], FloatArray]
) -> tuple[Evidence, ModelFrame]:
    """Evidence whose cameras are in the frame of the scene, and how that is known; see `model_frame`."""
    if isinstance(evidence, Cloud):
        if not isinstance(evidence.initial, Correspondences):
            return evidence, ModelFrame()
        initial, frame = _in_scene_frame(config, evidence.initial, visible)
        assert isinstance(initial, Correspondences)
        return dataclasses.replace(evidence, initial=initial), ModelFrame()
    if not isinstance(evidence, Correspondences) or evidence.landmarks is None:
        return evidence, ModelFrame()
    frame = model_frame(evidence.landmarks, visible, config.min_near)
    if frame.scene_from_model is not None:
        evidence = evidence.moved(frame.scene_from_model)
    facts = {**evidence.facts, "model_frame": dict(frame.facts)} if frame.facts else evidence.facts
    return dataclasses.replace(evidence, facts=facts, warnings=(*evidence.warnings, *frame.warnings)), frame


@dataclass(frozen=True, slots=True)
class Alignment:
    """A checked alignment of a scene.

    Attributes:
        record: as the manifest holds it.
        world_from_scene: composition with earlier alignments.
        inflation: suggested radius [m].
        error: bound of the error of positions [m]; None where it is not known.
    """

    record: dict[str, Any]
    world_from_scene: Similarity
    inflation: float
    error: float | None


def alignment_of(
    config: ScaleAlignConfig,
    manifest: SceneManifest,
    found: Estimate,
    rounding: float,
    report: Callable[[dict[str, Any]], None] | None = None,
) -> Alignment:
    """Record an estimate and check it against the gates.

    Args:
        rounding: bound of the shift of a centre by its rounding to single precision [m].
        report: called with the record before the gates are applied.

    Raises:
        CheckError: a gate does not hold, or a scene in metres would have another scale.
    """
    similarity = found.similarity
    matrix = np.eye(4)
    matrix[:3, :3] = similarity.scale * np.array(similarity.rotation)
    matrix[:3, 3] = similarity.translation_m
    q_world_scene = quat_wxyz_from_matrix(np.array(similarity.rotation))
    error = None if found.position_error is None else found.position_error + rounding
    warnings = list(found.record["warnings"])
    if rounding > _COARSE_M:
        warnings.append(
            f"coordinates are so large that single precision moves Gaussians by up to {rounding:.2g} m; put "
            "the map's origin nearer to the scene (--map-origin)"
        )
    scale = similarity.scale
    if manifest.unit == "m" and abs(scale - 1.0) > _SAME_SCALE:
        warnings.append(f"the scene was in metres already; a metre of it becomes {scale:.6g} m")
    alignment = {
        "from_frame": manifest.frame,
        "from_unit": manifest.unit,
        "to_frame": "world",
        "to_unit": "m",
        "scale": similarity.scale,
        "q_world_scene_wxyz": q_world_scene.tolist(),
        "translation_m": list(similarity.translation_m),
        "matrix": matrix.tolist(),
        "determinant": float(np.linalg.det(np.array(similarity.rotation))),
        "rounding_m": rounding,
        "position_error_m": error,
        **found.record,
        "warnings": warnings,
    }
    if report is not None:
        report(alignment)
    _check_gates(config, alignment)

    whole = similarity
    inflation = error if error is not None else rounding if rounding > _COARSE_M else 0.0
    if manifest.world_from_scene is not None:
        whole = compose(similarity, manifest.world_from_scene)
        inflation += similarity.scale * manifest.suggested_inflation_m
        alignment["previous"] = manifest.alignment
    return Alignment(alignment, whole, inflation, error)


def aligned(
    config: ScaleAlignConfig, alignment: Alignment, manifest: SceneManifest, arrays: dict[str, Any]
) -> Artifact:
    """Aligned scene."""
    columns = arrays["mean"].T  # several times as fast as extremes along an axis
    lower, upper = [float(column.min()) for column in columns], [float(column.max()) for column in columns]
    summary = align_summary(alignment, len(arrays["mean"]), lower, upper)
    return make_artifact(
        SCENE,
        arrays,
        parameters=parameters_of(config),
        **aligned_fields(alignment, manifest),
        summary=summary,
    )


def align_summary(
    alignment: Alignment, gaussians: int, lower: list[float], upper: list[float]
) -> dict[str, Any]:
    """Summary of an aligned scene.

    Args:
        lower: lowest coordinates of centres [m].
        upper: highest ones [m].
    """
    record = alignment.record
    figures = (
        *("method", "scale", "scale_sigma", "scale_interval", "map_origin_m", "count", "inliers", "fitness"),
        *("rms_m", "max_m", "rms_deg", "position_error_m"),
    )
    summary = {
        "gaussians": gaussians,
        **{key: record[key] for key in figures if record.get(key) is not None},
        "lower_m": lower,
        "upper_m": upper,
        "suggested_inflation_m": alignment.inflation,
    }
    if record["warnings"]:
        summary["warnings"] = record["warnings"]
    return summary


def aligned_fields(alignment: Alignment, manifest: SceneManifest) -> dict[str, Any]:
    """Fields of the manifest of an aligned scene that follow from the alignment."""
    return {
        "frame": "world",
        "unit": "m",
        "guarantee": _guarantee(manifest, alignment.error, alignment.inflation),
        "source": manifest.source,
        "requires": manifest.requires,
        "world_from_scene": alignment.world_from_scene,
        "alignment": alignment.record,
        "suggested_inflation_m": alignment.inflation,
    }


def bounds(mean: NDArray[np.floating[Any]], scale: NDArray[np.float32]) -> tuple[FloatArray, FloatArray]:
    """Bounding box of the ellipsoids that the error bound covers.

    Args:
        mean: centres, shape (n, 3).
        scale: one-sigma semi-axes, shape (n, 3).
    """
    lower, upper = np.full(3, np.inf), np.full(3, -np.inf)
    for start in range(0, len(mean), _CHUNK):
        part = slice(start, start + _CHUNK)
        x, y, z = scale[part].T
        reach = _BOUNDED_SIGMA * np.maximum(np.maximum(x, y), z).astype(np.float64)
        for axis, centre in enumerate(mean[part].T):
            lower[axis] = min(lower[axis], (centre - reach).min())
            upper[axis] = max(upper[axis], (centre + reach).max())
    return lower, upper


def _levelled(
    config: ScaleAlignConfig,
    found: Estimate,
    means: Callable[[], FloatArray],
    box: tuple[FloatArray, FloatArray],
    *,
    frame_is_known: bool,
) -> Estimate:
    """Estimate followed by a motion that levels its frame; the record holds it as `level`."""
    up = np.array([0.0, 0.0, 1.0])
    if config.up is None and not frame_is_known:
        raise UsageError(
            "--floor needs --up, roughly, because the scene's own frame is arbitrary (nerfstudio trains with "
            "0 0 1; models of COLMAP often have 0 -1 0)"
        )
    if config.up is not None:
        up = np.array(found.similarity.rotation) @ np.array(config.up)
    if config.floor:
        level = level_by_floor(transform_points(found.similarity, means()), up, config.threshold_m)
    else:
        level = level_by_direction(up)
    similarity = compose(level.motion, found.similarity)
    error = found.position_error
    if error is not None and config.floor:
        error = None if level.error is None else (
            error + level.error.position_error(mapped_corners(similarity, *box)))  # fmt: skip
    warnings = [*found.record["warnings"], *level.warnings]
    return Estimate(similarity, {**found.record, "level": level.facts, "warnings": warnings}, error)


def _guarantee(manifest: SceneManifest, known: float | None, inflation: float) -> Guarantee:
    """Guarantee of the input scene, with the error bound of the alignment."""
    before = manifest.guarantee or Guarantee(statement="")
    if known is None:
        error = "its error is not known."
    else:
        error = (
            f"with {CONFIDENCE:.0%} confidence no point of a {exact(_BOUNDED_SIGMA)}-sigma ellipsoid has an "
            f"error above {at_most(inflation)} m, if the errors of the correspondences are independent."
        )
    return Guarantee(
        statement=f"{before.statement} It was mapped by one similarity; {error}".strip(),
        claims=before.claims
        | {"position_error_m": None if known is None else inflation, "confidence": CONFIDENCE},
    )


def _check_gates(config: ScaleAlignConfig, alignment: dict[str, Any]) -> None:
    scale = alignment["scale"]
    if alignment["from_unit"] == "m" and abs(scale - 1.0) > _CORRECTION and not config.rescale:
        raise CheckError(
            f"the scene is in metres already, and this would make {scale:.6g} m of each; align the scene of "
            "import-splat instead, or pass --rescale if the metres are wrong"
        )
    if "rms_m" not in alignment:
        return
    count, inliers, rms = alignment["count"], alignment["inliers"], alignment["rms_m"]
    needed = config.min_inliers
    if needed is None:  # of a cloud the overlap is required instead
        needed = 0 if alignment["method"] == "cloud" else count // 2 + 1
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


def mapped(scene: Artifact, similarity: Similarity) -> tuple[dict[str, Any], float]:
    """Arrays in the new frame, and the largest shift of a mean by its rounding [m].

    Args:
        similarity: new from old frame.

    Raises:
        InputError: a value does not fit single precision.
    """
    made = {name: np.empty(scene[name].shape, np.float32) for name in ("mean", "scale", "quat_wxyz")}
    rotation = np.array(similarity.rotation)
    moved = np.empty(len(scene["mean"])) if "loss" in scene.arrays else None
    rounding, *bad = _core.map_rows(
        scene["mean"],
        scene["scale"],
        scene["quat_wxyz"],
        factor=similarity.scale,
        rotation=rotation.tolist(),
        translation=similarity.translation_m,
        quat_wxyz=quat_wxyz_from_matrix(rotation).tolist(),
        out_mean=made["mean"],
        out_scale=made["scale"],
        out_quat=made["quat_wxyz"],
        out_moved=moved,
    )
    for name, row in zip(("mean", "scale"), bad, strict=True):
        if row < len(made[name]):
            raise InputError(f"the {name} of Gaussian {row} does not fit single precision in metres")
    arrays = made | {"opacity": scene["opacity"], "color": scene["color"]}
    if moved is not None:  # column 0, of the centre, is a length; all columns grow by the rounding here
        before = np.asarray(scene["loss"], np.float64)
        now = np.stack([similarity.scale * before[:, 0] + moved, before[:, 1], before[:, 2]], axis=1)
        now[:, 1:] += _SINGLE * (1 + now[:, 1:])  # a unit quaternion turns by twice its own error
        arrays["loss"] = rounded_up(now)
    return arrays, rounding
