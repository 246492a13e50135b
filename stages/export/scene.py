"""Export of Gaussians to the splat formats of other programs, and the loss of each format."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator

import numpy as np

from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.provenance import Provenance
from alula.stages.reconstruction.formats.ply import decode_ply, encode_ply
from alula.stages.reconstruction.formats.splat import decode_splat, encode_splat
from alula.stages.reconstruction.formats.splats import Splats
from alula.stages.reconstruction.formats.spz import decode_spz, encode_spz

COPIED = "A copy for other programs; sizes computed from it are not certified."
_LOGIT_MARGIN = 2.0**-24  # an opacity of exactly 0 or 1 has no finite logit
_CHUNK = 2**16

Encoder = Callable[[Artifact, Provenance], Iterator[bytes]]


def written_losses(scene: Artifact, format_name: str, written: bytes) -> dict[str, float]:
    """Measure the maximum difference between the Gaussians of a file and the scene it was written from.

    The file is decoded again, as a reader does, in the order of the scene.

    Args:
        format_name: `ply`, `splat` or `spz`.

    Returns:
        `position_error` [unit of the scene], the distance between centres; `scale_shorter` and
        `scale_longer`, the relative shortening and lengthening of a semi-axis; `rotation_error_rad`;
        `opacity_error`; `color_error`, on a scale of 255.
    """
    found = _DECODERS[format_name](memoryview(written), None)
    worst = dict.fromkeys(
        (
            "position_error", "scale_shorter", "scale_longer", "rotation_error_rad", "opacity_error",
            "color_error",
        ),
        0.0,
    )  # fmt: skip

    def note(name: str, values: np.ndarray) -> None:
        worst[name] = max(worst[name], float(values.max()))

    for start in range(0, len(found), _CHUNK):
        part = slice(start, start + _CHUNK)
        true = {name: scene[name][part].astype(np.float64) for name in ("mean", "scale", "quat_wxyz")}
        note("position_error", np.linalg.norm(found.mean[part] - true["mean"], axis=1))
        ratio = found.scale[part] / true["scale"]
        note("scale_shorter", 1.0 - ratio)
        note("scale_longer", ratio - 1.0)
        before, after = true["quat_wxyz"], found.quat_wxyz[part].astype(np.float64)
        before /= np.linalg.norm(before, axis=1, keepdims=True)
        after /= np.linalg.norm(after, axis=1, keepdims=True)
        after *= np.where((before * after).sum(axis=1) < 0, -1.0, 1.0)[:, None]
        chord = np.linalg.norm(before - after, axis=1)
        note("rotation_error_rad", 4.0 * np.arcsin(np.minimum(chord / 2.0, math.sqrt(0.5))))
        note("opacity_error", np.abs(found.opacity[part].astype(np.float64) - scene["opacity"][part]))
        note("color_error", np.abs(found.color[part].astype(np.float64) - scene["color"][part]))
    return worst


def _gaussians(scene: Artifact) -> Splats:
    return Splats(
        format="scene",
        mean=np.asarray(scene["mean"]),
        scale=np.asarray(scene["scale"]),
        quat_wxyz=np.asarray(scene["quat_wxyz"]),
        opacity=np.asarray(scene["opacity"]),
        color=np.asarray(scene["color"]),
    )


def _ply(scene: Artifact, provenance: Provenance) -> Iterator[bytes]:
    splats = _gaussians(scene)
    opacity = np.clip(splats.opacity, _LOGIT_MARGIN, 1 - _LOGIT_MARGIN).astype(np.float32)
    finite = dataclasses.replace(splats, opacity=opacity)
    return encode_ply(finite, [provenance.line(), COPIED])


def _splat(scene: Artifact, provenance: Provenance) -> Iterator[bytes]:
    return encode_splat(_gaussians(scene))


def _spz(scene: Artifact, provenance: Provenance) -> Iterator[bytes]:
    return encode_spz(_gaussians(scene), int(provenance.parameters["spz_version"]), provenance.line())


SCENE_ENCODERS: dict[str, Encoder] = {"ply": _ply, "splat": _splat, "spz": _spz}
_DECODERS: dict[str, Callable[..., Splats]] = {"ply": decode_ply, "splat": decode_splat, "spz": decode_spz}
