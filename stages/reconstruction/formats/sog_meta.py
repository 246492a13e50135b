"""Parser of the `meta.json` of SOG, with checks of its values."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from alula.schemas.errors import ArtifactError
from alula.stages.reconstruction.formats.properties import judged
from alula.stages.reconstruction.formats.source import relative_name

_SECTIONS = {"version", "count", "asset", "model", "antialias", "means", "scales", "quats", "sh0", "shN"}
_WIDTHS = {1: 64 * 3, 2: 64 * 8, 3: 64 * 15}  # of the texture of centroids, by bands


@dataclass(frozen=True, slots=True)
class Harmonics:
    """Higher harmonics: numbers of centroids and of bands; version 1 has neither."""

    centroids: str
    labels: str
    count: int | None
    bands: int | None

    def check(self, what: str, width: int, height: int) -> None:
        """Check the size of the texture of centroids."""
        expected = set(_WIDTHS.values()) if self.bands is None else {_WIDTHS[self.bands]}
        rows = 1 if self.count is None else -(-self.count // 64)
        if width not in expected or not rows <= height <= 1024:
            widths = " or ".join(str(w) for w in sorted(expected))
            raise ArtifactError(f"{what}; it must be {widths} wide and {rows} to 1024 high")


@dataclass(frozen=True, slots=True)
class SogMeta:
    """Checked contents; tables have 256 entries, one for each code.

    Attributes:
        version: 1 or 2.
        count: Gaussians.
        mins: of the logarithmic positions, by axis.
        maxs: likewise.
        means: images of the low and the high bytes.
        log_scales: values by axis.
        sh0_values: values by channel.
        logits: of alpha; None where the code is alpha.
        harmonics: None without any.
        unknown: names of sections of unknown meaning.
    """

    version: int
    count: int
    mins: tuple[float, ...]
    maxs: tuple[float, ...]
    means: tuple[str, str]
    scales: str
    quats: str
    sh0: str
    log_scales: tuple[NDArray[np.float64], ...]
    sh0_values: tuple[NDArray[np.float64], ...]
    logits: NDArray[np.float64] | None
    harmonics: Harmonics | None
    tags: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    unknown: tuple[str, ...] = ()

    @property
    def files(self) -> tuple[str, ...]:
        """Names of all images."""
        own = (*self.means, self.scales, self.quats, self.sh0)
        return own if self.harmonics is None else (*own, self.harmonics.centroids, self.harmonics.labels)


def parse_json(raw: bytes, name: str = "meta.json") -> dict[str, Any]:
    """Parse an object of strict JSON.

    Args:
        raw: the text in UTF-8.

    Raises:
        ArtifactError: the text is not JSON, or not an object.
    """

    def refuse(word: str) -> NoReturn:
        raise ValueError(f"{word} is no number of JSON")

    try:
        found = json.loads(raw, parse_constant=refuse)
    except (ValueError, RecursionError) as error:
        raise ArtifactError(f"SOG: {name} is no JSON: {error}") from error
    if not isinstance(found, dict):
        raise ArtifactError(f"SOG: {name} is no JSON object")
    return found


def parse_meta(raw: bytes) -> SogMeta:
    """Check and read `meta.json`, version 1 (which has no `version`) or 2.

    Raises:
        ArtifactError: a value is wrong; the message names it.
    """
    meta = parse_json(raw)
    version = meta.get("version", 1)
    if type(version) is not int or version not in (1, 2):
        raise ArtifactError(f"SOG: version {str(version)[:20]} is not supported, only 1 and 2")
    sections = {name: _object(meta, name) for name in ("means", "scales", "quats", "sh0")}
    means, scales, sh0 = sections["means"], sections["scales"], sections["sh0"]
    mins, maxs = _limits(means, "means", 3)
    notes: list[str] = []
    logits = None
    if version == 1:
        shape = means.get("shape")
        if not isinstance(shape, list) or not shape:
            raise ArtifactError("SOG: meta.json: means.shape is missing or no list")
        count = _count(shape[0], "means.shape[0]")
        log_scales = _linear(scales, "scales", 3)
        *colors, logits = _linear(sh0, "sh0", 4)
        sh0_values = tuple(colors)
    else:
        count = _count(meta.get("count"), "count")
        log_scales = (_codebook(scales, "scales", notes),) * 3
        sh0_values = (_codebook(sh0, "sh0", notes),) * 3
    low, high = _files(means, "means", 2)
    result = SogMeta(
        version=version,
        count=count,
        mins=mins,
        maxs=maxs,
        means=(low, high),
        scales=_files(scales, "scales", 1)[0],
        quats=_files(sections["quats"], "quats", 1)[0],
        sh0=_files(sh0, "sh0", 1)[0],
        log_scales=log_scales,
        sh0_values=sh0_values,
        logits=logits,
        harmonics=_harmonics(meta, version),
        tags=_tags(meta),
        notes=tuple(notes),
        unknown=judged((name for name in meta if name not in _SECTIONS), "section"),
    )
    if len(set(result.files)) < len(result.files):
        raise ArtifactError("SOG: meta.json names a file twice")
    return result


def _harmonics(meta: dict[str, Any], version: int) -> Harmonics | None:
    if meta.get("shN") is None:
        return None
    section = _object(meta, "shN")
    centroids, labels = _files(section, "shN", 2)
    if version == 1:
        return Harmonics(centroids, labels, None, None)
    bands = section.get("bands")
    if type(bands) is not int or bands not in _WIDTHS:
        raise ArtifactError("SOG: meta.json: shN.bands must be 1, 2 or 3")
    count = _count(section.get("count"), "shN.count")
    if count > 65536:
        raise ArtifactError(f"SOG: meta.json: shN.count is {count}; labels go to 65536")
    _codebook(section, "shN", [])
    return Harmonics(centroids, labels, count, bands)


def _tags(meta: dict[str, Any]) -> dict[str, str]:
    tags = {}
    asset = meta.get("asset")
    if isinstance(asset, dict) and isinstance(asset.get("generator"), str):
        tags["generator"] = asset["generator"][:200]
    if isinstance(meta.get("model"), str):
        tags["render_mode"] = meta["model"][:200]
    if isinstance(meta.get("antialias"), bool):
        tags["antialiased"] = str(int(meta["antialias"]))
    return tags


def _object(meta: dict[str, Any], name: str) -> dict[str, Any]:
    found = meta.get(name)
    if not isinstance(found, dict):
        raise ArtifactError(f"SOG: meta.json: {name} is missing or no object")
    return found


def _count(value: object, where: str) -> int:
    if type(value) is not int or not 0 <= value < 2**32:
        raise ArtifactError(f"SOG: meta.json: {where} is missing or no count")
    if value == 0:
        raise ArtifactError(f"SOG: has no Gaussians ({where} is 0)")
    return value


def _numbers(section: dict[str, Any], where: str, name: str, length: int) -> tuple[float, ...]:
    values = section.get(name)
    if not isinstance(values, list) or len(values) != length:
        raise ArtifactError(f"SOG: meta.json: {where}.{name} must have {length} numbers")
    for value in values:
        if type(value) not in (int, float) or not abs(value) < 1e300:
            raise ArtifactError(f"SOG: meta.json: {where}.{name} has {str(value)[:40]}, which is no number")
    return tuple(float(value) for value in values)


def _limits(section: dict[str, Any], where: str, length: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
    mins, maxs = (_numbers(section, where, name, length) for name in ("mins", "maxs"))
    for lower, upper in zip(mins, maxs, strict=True):
        if lower > upper:
            raise ArtifactError(f"SOG: meta.json: {where}.mins has {lower:g} above {upper:g} of maxs")
    return mins, maxs


def _linear(section: dict[str, Any], where: str, length: int) -> tuple[NDArray[np.float64], ...]:
    """Tables of 8-bit codes between limits."""
    t = np.arange(256) / 255.0
    return tuple(
        lower + (upper - lower) * t for lower, upper in zip(*_limits(section, where, length), strict=True)
    )


def _codebook(section: dict[str, Any], where: str, notes: list[str]) -> NDArray[np.float64]:
    """A table of values; early writers left the first entry null, which viewers extrapolate."""
    values = section.get("codebook")
    if isinstance(values, list) and len(values) == 256 and values[0] is None:
        rest = _numbers({"codebook": values[1:]}, where, "codebook", 255)
        notes.append(f"the first entry of {where}.codebook is null and was extrapolated")
        return np.array([rest[0] + (rest[0] - rest[-1]) / 255.0, *rest])
    return np.array(_numbers(section, where, "codebook", 256))


def _files(section: dict[str, Any], where: str, length: int) -> tuple[str, ...]:
    names = section.get("files")
    if not isinstance(names, list) or len(names) != length or not all(isinstance(n, str) for n in names):
        raise ArtifactError(f"SOG: meta.json: {where}.files must have {length} names")
    for name in names:
        try:
            relative_name(name)
        except ArtifactError as error:
            raise ArtifactError(f"SOG: meta.json: {where}.files: {error}") from error
    return tuple(names)
