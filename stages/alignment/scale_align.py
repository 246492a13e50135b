"""The stage `scale-align`: map a scene from its arbitrary frame to metres in a world frame."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.artifact import Artifact, make_artifact
from alula.schemas.artifacts.kinds import SCENE
from alula.schemas.artifacts.manifest import Guarantee, Manifest, SceneManifest, Similarity, map_origin
from alula.schemas.artifacts.parts import Parts
from alula.schemas.artifacts.provenance import parameters_of
from alula.schemas.decimals import at_most, exact
from alula.schemas.errors import CheckError, InputError, UsageError
from alula.schemas.parameters.configs.scale_align import ScaleAlignConfig
from alula.schemas.progress import Progress
from alula.stages.alignment.cloud import Cloud
from alula.stages.alignment.estimates import (
    VISIBLE,
    Alignment,
    Evidence,
    Given,
    estimate,
    scale_only,
)
from alula.stages.alignment.evidence import Correspondences
from alula.stages.alignment.levelling import level_by_direction, level_by_floor
from alula.stages.alignment.model_frame import ModelFrame, model_frame
from alula.stages.alignment.similarity import compose, transform_points
from alula.stages.alignment.uncertainty import CONFIDENCE, mapped_corners
from alula.stages.coordinates import nearer_origin, spacing
from alula.stages.distribute import distribute
from alula.stages.reconstruction.formats.splats import rounded_up
from alula.stages.rotation import quat_wxyz_from_matrix

__all__ = ["Evidence", "Given", "scale_align", "scale_only"]

MOST_POINTS = 2**22  # centres of several parts in memory at once: 100 MB
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
    return Aligner(config, Parts.of(scene), evidence, seed, report).part(0)


class Aligner:
    """Alignment of a scene of one or several parts by one similarity; see `scale_align`.

    A floor, or a cloud, is compared with every n-th Gaussian of several parts, where n keeps their number
    below `MOST_POINTS`; the record has n. The rounding of an only part is measured. That of several, which
    are mapped one by one, is bounded by the spacing of single precision at the farthest corner of their box.

    Args:
        report: called with the record of the alignment before the gates are applied.

    Raises:
        InputError, CheckError, UsageError: see `scale_align`.
    """

    def __init__(
        self,
        config: ScaleAlignConfig,
        scene: Parts,
        evidence: Evidence | None,
        seed: int,
        report: Callable[[dict[str, Any]], None] | None = None,
        jobs: int = 0,
        progress: Progress | None = None,
    ) -> None:
        assert isinstance(scene.manifest, SceneManifest)
        self._config, self._scene, self._manifest = config, scene, scene.manifest
        self._step = -(-scene.count // MOST_POINTS) if scene.is_folder else 1
        boxes, centres = [], []
        for done, (box, centre) in enumerate(distribute(self._boxes, range(len(scene)), jobs=jobs)):
            boxes.append(box)
            centres.append(centre)
            if progress is not None:
                progress(done + 1, len(scene))
        self._is_sampled = False
        found = self._solved(_around(boxes), evidence, seed)
        if self._is_sampled:
            found.record["every_gaussian"] = self._step
        self._similarity = found.similarity
        self._only = None if scene.is_folder else _mapped(scene[0], found.similarity)
        if self._only is None:
            farthest = np.abs(mapped_corners(found.similarity, *_around(centres))).max(axis=0)
            units = spacing(np.nextafter(farthest.astype(np.float32), np.float32(np.inf)))
            rounding = float(np.linalg.norm(units / 2))
        else:
            rounding = self._only[1]
        self._check(found, rounding, report)

    def part(self, number: int) -> Artifact:
        """Aligned part.

        Raises:
            InputError: the part is damaged, or a value does not fit single precision.
        """
        part = self._scene[number]
        assert isinstance(part.manifest, SceneManifest)
        arrays, _ = _mapped(part, self._similarity) if self._only is None else self._only
        columns = arrays["mean"].T  # several times as fast as extremes along an axis
        ends = [float(column.min()) for column in columns], [float(column.max()) for column in columns]
        summary = {"gaussians": len(arrays["mean"]), **self._figures(*ends)}
        fields = self._fields(part.manifest)
        return make_artifact(SCENE, arrays, parameters=parameters_of(self._config), **fields, summary=summary)

    def whole(self, parts: list[Manifest]) -> dict[str, Any]:
        """Fields of the manifest of the whole."""
        lower = np.min([part.summary["lower_m"] for part in parts], axis=0).tolist()
        upper = np.max([part.summary["upper_m"] for part in parts], axis=0).tolist()
        summary = {"gaussians": self._scene.count, "parts": len(parts), **self._figures(lower, upper)}
        return {**self._fields(self._manifest), "summary": summary}

    def _boxes(self, number: int) -> tuple[tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]:
        """Boxes of the ellipsoids and of the centres of a part."""
        mean = self._scene[number]["mean"]
        ends = mean.min(axis=0).astype(np.float64), mean.max(axis=0).astype(np.float64)
        return _bounds(mean, self._scene[number]["scale"]), ends

    def _sampled(self, min_opacity: float = 0.0) -> FloatArray:
        """Centres of every n-th Gaussian of all parts that is opaque enough, shape (k, 3), scene units."""
        self._is_sampled = self._step > 1
        found, first = [], 0
        for part in self._scene:
            rows = np.arange(-first % self._step, len(part["mean"]), self._step)
            rows = rows[part["opacity"][rows] >= np.float32(min_opacity)]
            found.append(np.asarray(part["mean"][rows], np.float64))
            first += len(part["mean"])
        return np.concatenate(found)

    def _solved(self, box: tuple[FloatArray, FloatArray], evidence: Evidence | None, seed: int) -> Alignment:
        """Estimate the similarity and level its frame."""
        config, manifest = self._config, self._manifest
        visible = partial(self._sampled, VISIBLE)
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
            found = _levelled(config, found, self._sampled, box, frame_is_known=known)
        if (former := map_origin(manifest)) is not None:
            words = " ".join(f"{c:.12g}" for c in former)
            found.record["warnings"] = [
                *found.record["warnings"],
                f"the map's origin of the former alignment, ({words}) m, is not kept: the new alignment "
                "moves the map; align once, with all options",
            ]
        return _from_map_origin(config, found, self._sampled, box)

    def _check(
        self, found: Alignment, rounding: float, report: Callable[[dict[str, Any]], None] | None
    ) -> None:
        """Record an estimate and check it against the gates."""
        similarity = found.similarity
        matrix = np.eye(4)
        matrix[:3, :3] = similarity.scale * np.array(similarity.rotation)
        matrix[:3, 3] = similarity.translation_m
        q_world_scene = quat_wxyz_from_matrix(np.array(similarity.rotation))
        error = None if found.position_error is None else found.position_error + rounding
        warnings = list(found.record["warnings"])
        if rounding > _COARSE_M:
            warnings.append(
                f"coordinates are so large that single precision moves Gaussians by up to {rounding:.2g} m; "
                "put the map's origin nearer to the scene (--map-origin)"
            )
        scale = similarity.scale
        if self._manifest.unit == "m" and abs(scale - 1.0) > _SAME_SCALE:
            warnings.append(f"the scene was in metres already; a metre of it becomes {scale:.6g} m")
        alignment = {
            "from_frame": self._manifest.frame,
            "from_unit": self._manifest.unit,
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
        _check_gates(self._config, alignment)

        whole = similarity
        inflation = error if error is not None else rounding if rounding > _COARSE_M else 0.0
        if self._manifest.world_from_scene is not None:
            whole = compose(similarity, self._manifest.world_from_scene)
            inflation += similarity.scale * self._manifest.suggested_inflation_m
            alignment["previous"] = self._manifest.alignment
        self._record, self._world_from_scene = alignment, whole
        self._inflation, self._error = inflation, error

    def _figures(self, lower: list[float], upper: list[float]) -> dict[str, Any]:
        """Summary of an aligned scene without its number of Gaussians; the box is that of the centres [m]."""
        record = self._record
        figures = (
            *("method", "scale", "scale_sigma", "scale_interval", "map_origin_m", "count", "inliers"),
            *("fitness", "rms_m", "max_m", "rms_deg", "position_error_m"),
        )
        summary = {
            **{key: record[key] for key in figures if record.get(key) is not None},
            "lower_m": lower,
            "upper_m": upper,
            "suggested_inflation_m": self._inflation,
        }
        if record["warnings"]:
            summary["warnings"] = record["warnings"]
        return summary

    def _fields(self, manifest: SceneManifest) -> dict[str, Any]:
        """Fields of the manifest of an aligned scene that follow from the alignment."""
        return {
            "frame": "world",
            "unit": "m",
            "guarantee": _guarantee(manifest, self._error, self._inflation),
            "source": manifest.source,
            "requires": manifest.requires,
            "world_from_scene": self._world_from_scene,
            "alignment": self._record,
            "suggested_inflation_m": self._inflation,
        }


def _from_map_origin(
    config: ScaleAlignConfig,
    found: Alignment,
    means: Callable[[], FloatArray],
    box: tuple[FloatArray, FloatArray],
) -> Alignment:
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


def _bounds(mean: NDArray[np.floating[Any]], scale: NDArray[np.float32]) -> tuple[FloatArray, FloatArray]:
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
    found: Alignment,
    means: Callable[[], FloatArray],
    box: tuple[FloatArray, FloatArray],
    *,
    frame_is_known: bool,
) -> Alignment:
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
    return Alignment(similarity, {**found.record, "level": level.facts, "warnings": warnings}, error)


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


def _mapped(scene: Artifact, similarity: Similarity) -> tuple[dict[str, Any], float]:
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


def _around(boxes: list[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray]:
    return np.min([low for low, _ in boxes], axis=0), np.max([high for _, high in boxes], axis=0)
