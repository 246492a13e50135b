"""The stage `scale-align` for scenes in parts: one similarity for all, mapped one part at a time."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.manifest import Manifest, SceneManifest
from alula.schemas.artifacts.parts import Parts
from alula.schemas.parameters.configs.scale_align import ScaleAlignConfig
from alula.schemas.progress import Progress
from alula.stages.alignment.estimates import VISIBLE, Evidence
from alula.stages.alignment.scale_align import (
    align_summary,
    aligned,
    aligned_fields,
    alignment_of,
    bounds,
    mapped,
    solved,
)
from alula.stages.alignment.uncertainty import mapped_corners
from alula.stages.coordinates import spacing
from alula.stages.distribute import distribute

MOST_POINTS = 2**22  # centres in memory at once: 100 MB


class PartsAligner:
    """Alignment of a scene in parts; see `scale_align`.

    The evidence is the same as for one scene. A floor, or a cloud, is compared with every n-th Gaussian of
    all parts, where n keeps their number below `MOST_POINTS`; the record has n. The bound of the rounding
    follows from the box of the scene, so it is that of the farthest corner.

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
        self._step = -(-scene.count // MOST_POINTS)
        boxes, centres = [], []
        for done, (box, centre) in enumerate(distribute(self._boxes, range(len(scene)), jobs=jobs)):
            boxes.append(box)
            centres.append(centre)
            if progress is not None:
                progress(done + 1, len(scene))
        box = _around(boxes)
        self._is_sampled = False
        every, visible = (partial(self._sampled, opacity) for opacity in (0.0, VISIBLE))
        found = solved(config, scene.manifest, box, every, visible, evidence, seed)
        if self._is_sampled:
            found.record["every_gaussian"] = self._step
        self._similarity = found.similarity
        farthest = np.abs(mapped_corners(found.similarity, *_around(centres))).max(axis=0)
        units = spacing(np.nextafter(farthest.astype(np.float32), np.float32(np.inf)))
        rounding = float(np.linalg.norm(units / 2))
        self._alignment = alignment_of(config, scene.manifest, found, rounding, report)

    def _boxes(self, number: int) -> tuple[tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]:
        """Boxes of the ellipsoids and of the centres of a part."""
        part = self._scene[number]
        mean = np.asarray(part["mean"], np.float64)
        return bounds(mean, part["scale"]), (mean.min(axis=0), mean.max(axis=0))

    def _sampled(self, min_opacity: float) -> FloatArray:
        """Centres of every n-th Gaussian of all parts that is opaque enough, shape (k, 3), scene units."""
        self._is_sampled = self._step > 1
        found, first = [], 0
        for part in self._scene:
            rows = np.arange(-first % self._step, len(part["mean"]), self._step)
            rows = rows[part["opacity"][rows] >= np.float32(min_opacity)]
            found.append(np.asarray(part["mean"][rows], np.float64))
            first += len(part["mean"])
        return np.concatenate(found)

    def part(self, number: int) -> Artifact:
        """Aligned part.

        Raises:
            InputError: the part is damaged, or a value does not fit single precision.
        """
        part = self._scene[number]
        assert isinstance(part.manifest, SceneManifest)
        arrays, _ = mapped(part, self._similarity)
        return aligned(self._config, self._alignment, part.manifest, arrays)

    def whole(self, parts: list[Manifest]) -> dict[str, Any]:
        """Fields of the manifest of the whole."""
        lower = np.min([part.summary["lower_m"] for part in parts], axis=0).tolist()
        upper = np.max([part.summary["upper_m"] for part in parts], axis=0).tolist()
        summary = align_summary(self._alignment, self._scene.count, lower, upper)
        return {
            **aligned_fields(self._alignment, self._manifest),
            "summary": {"gaussians": summary.pop("gaussians"), "parts": len(parts), **summary},
        }


def _around(boxes: list[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray]:
    return np.min([low for low, _ in boxes], axis=0), np.max([high for _, high in boxes], axis=0)
