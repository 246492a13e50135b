"""The stage `import-splat`: turn the Gaussians of a splat file into a checked scene."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.artifacts.artifact import Artifact, make_artifact
from alula.schemas.artifacts.kinds import SCENE
from alula.schemas.artifacts.manifest import SPLAT_LOSS, Guarantee
from alula.schemas.artifacts.provenance import parameters_of
from alula.schemas.decimals import at_most
from alula.schemas.errors import InputError
from alula.schemas.parameters.configs.import_splat import DRAWN, ImportSplatConfig
from alula.stages.coordinates import single_rounding, spacing
from alula.stages.reconstruction.faint import FAINT, MarkedVolume, marked_volume
from alula.stages.reconstruction.floaters import NEIGHBOUR, REACH, SMALLEST_GROUP, floaters
from alula.stages.reconstruction.formats.capture import lacking, level_facts, missing_files
from alula.stages.reconstruction.formats.properties import unknown_words
from alula.stages.reconstruction.formats.splats import LOSSES, Level, Loss, Splats, loss_bound

_NOT_FINITE = ("not_a_number", "infinite_mean", "infinite_scale", "infinite_rotation")
_ZERO = "zero_rotation"
_MOST_ZERO = 0.1  # fraction of the rows without a rotation above which the file is refused
_ON_DEMAND = ("crop", "crop_sphere", "max_scale")
_REASONS = (*_NOT_FINITE, _ZERO, "min_opacity", *_ON_DEMAND)  # 1, 2, ... of `_core.screen_rows`
NOTABLE = 0.02  # fraction of the volume that is worth a note
_FINE = 0.2  # of the median of the largest semi-axes: a larger spacing of coordinates counts as a loss
_PART = 2**16  # rows whose temporary arrays stay in the cache
SCALE_FLOOR = 1e-9  # file units; minimum thickness of a flat disc


@dataclass(frozen=True, slots=True)
class Screened:
    """Gaussians of a decoded file with what a configuration keeps of them, before any of them is copied.

    Attributes:
        splats: all Gaussians, turned as the configuration says.
        removal: 0 for rows that are kept, shape (N,).
        removed: number of rows that each rule removed.
        rules: of the floaters, for the manifest.
        volume: that the rows mark, see `marked_volume`.
    """

    config: ImportSplatConfig
    splats: Splats
    removal: NDArray[np.uint8]
    removed: dict[str, int]
    rules: dict[str, Any]
    volume: MarkedVolume | None

    @property
    def kept(self) -> int:
        """Number of rows that are kept."""
        return int(np.count_nonzero(self.removal == 0))


def import_splat(config: ImportSplatConfig, splats: Splats) -> Artifact:
    """Keep the valid Gaussians that the configuration selects, and count the others by reason.

    Invalid are a NaN and an infinite mean, scale or rotation, which are an error unless `drop_nan` is set,
    and a quaternion of length zero, which no viewer draws; more than a tenth of such rows are an error too.
    The configuration removes further Gaussians. A row counts for the first reason that applies, in the order
    of `summary["removed"]`. Scales below 1e-9 file units become 1e-9, quaternions are normalised, and with
    `turn` the frame is turned by 180 degrees, which changes signs alone. Nothing else changes, so the
    ellipsoids of the scene are those of the file.
    The scene's array `loss` bounds the precision that the file's format may have lost. Some files of a level
    of detail without the others are refused unless `part` is set; the guarantee names what is lacking.

    Args:
        splats: the Gaussians of a decoded file, file frame and units.

    Returns:
        An `alula/scene`, frame `scene`, unit `arbitrary`, rows in the order of the file.

    Raises:
        InputError: no Gaussian is left, one has a value that is not finite, many have no rotation, or files
            of a level of detail are lacking.
    """
    return scene_of(screened(config, splats))


@np.errstate(invalid="ignore")  # files may hold signalling NaNs, which are dropped and counted like others
def screened(config: ImportSplatConfig, splats: Splats) -> Screened:
    """Find the Gaussians that a configuration keeps.

    Args:
        splats: the Gaussians of a decoded file, file frame and units.

    Raises:
        InputError: see `import_splat`.
    """
    check_whole(config, splats.levels)
    splats = with_rounding(turned(splats, config.turn))
    given = _columns(splats)
    removal = np.empty(len(splats), np.uint8)
    counts, first_bad = _core.screen_rows(
        *given[:4],
        removal,
        min_opacity=config.min_opacity,
        crop=config.crop,
        crop_sphere=config.crop_sphere,
        max_scale=config.max_scale,
    )
    wanted = {"min_opacity", *(name for name in _ON_DEMAND if getattr(config, name) is not None)}
    removed = {
        reason: count for reason, count in zip(_REASONS, counts[1:], strict=True) if count or reason in wanted
    }
    if first_bad < len(splats) and not config.drop_nan:
        bad = {reason: removed[reason] for reason in _NOT_FINITE if reason in removed}
        reasons = ", ".join(f"{reason} {count}" for reason, count in bad.items())
        raise InputError(
            f"{sum(bad.values())} of {len(splats)} Gaussians have values that are not finite ({reasons}), "
            f"the first in row {first_bad}; --drop-nan leaves them out"
        )
    zero = removed.get(_ZERO, 0)
    if zero > _MOST_ZERO * len(splats) and not config.drop_nan:
        raise InputError(
            f"{zero} of {len(splats)} Gaussians have a quaternion of length zero, the first in row "
            f"{int(np.argmax(removal == 1 + _REASONS.index(_ZERO)))}: the file is damaged, or was not "
            "written to its end; --drop-nan leaves them out"
        )
    if removal.all():
        raise nothing_left(removed)

    volume = _volume(config, splats, removal)
    rules: dict[str, Any] = {}
    if config.drop_floaters:
        removed["floaters"], rules["floaters"] = _drop_floaters(splats, removal)
        if removal.all():
            raise nothing_left(removed)
    return Screened(config, splats, removal, removed, rules, volume)


@np.errstate(invalid="ignore")
def scene_of(screened: Screened) -> Artifact:
    """Scene of the Gaussians that are kept; see `import_splat`."""
    config, splats, volume = screened.config, screened.splats, screened.volume
    removal, removed, kept = screened.removal, screened.removed, screened.kept
    arrays, figures = _kept(_columns(splats), removal, kept)
    loss = _loss(splats, removal, kept)
    if loss["bound"] is not None:
        arrays["loss"] = loss["bound"]
    lossy, properties = loss["figures"], splats.properties
    source = {
        "format": splats.format,
        "rows": len(splats),
        "kept": kept,
        "removed": removed,
        "rules": screened.rules,
        "opacity": None if volume is None else dataclasses.asdict(volume),
        "levels_of_detail": level_facts(splats.levels),
        "lacks": lacking(splats.levels),
        "applied": list(properties.applied),
        "unknown_properties": list(properties.unknown),
        "scale_floor": SCALE_FLOOR,
        "scale_floored": figures["floored"],
        "bounds": {"lower": list(figures["lower"]), "upper": list(figures["upper"])},
        "loss": lossy,
        "frame": {"file": splats.tags.get("frame", "unnamed"), "turn": config.turn},
        "comments": list(splats.comments),
        "tags": splats.tags,
        "notes": list(splats.notes),
    }
    notes = [
        *zero_notes(source),
        *_opacity_notes(config, volume, removed, len(splats)),
        *property_notes(source),
        *splats.notes,
        *loss_notes(lossy),
    ]
    medians = {name: figures[name] for name in ("opacity_median", "scale_median", "scale_max")}
    fields = scene_fields(config, source, medians, notes, is_lossy="loss" in arrays)
    return make_artifact(SCENE, arrays, parameters=parameters_of(config), **fields)


def scene_fields(
    config: ImportSplatConfig,
    source: dict[str, Any],
    figures: dict[str, Any],
    notes: list[str],
    *,
    is_lossy: bool,
    parts: int | None = None,
) -> dict[str, Any]:
    """Fields of the manifest of a scene that follow from the record of its source.

    Args:
        source: `source` of the manifest.
        figures: further figures of the summary, such as `scale_max`.
        notes: all but that on what the scene lacks.
        is_lossy: whether the scene has an array `loss`.
    """
    turned = f"turned by 180 degrees about {config.turn}" if config.turn != "none" else "unchanged"
    summary = {
        "gaussians": source["kept"],
        **({} if parts is None else {"parts": parts}),
        **{key: source[key] for key in ("rows", "removed", "format")},
        "frame": f"that of the file ({source['frame']['file']}), {turned}",
        **source["bounds"],
        **figures,
    }
    if is_lossy:
        summary["loss"] = {key: source["loss"][key] for key in LOSSES}
    if lacks := source["lacks"]:
        notes = [f"the scene is not the whole capture: it lacks {'; '.join(lacks)}", *notes]
        summary["lacks"] = lacks
    if notes:
        summary["notes"] = notes
    return {
        "frame": "scene",
        "unit": "arbitrary",
        "summary": summary,
        "guarantee": _guarantee(config, source),
        "requires": [SPLAT_LOSS] if is_lossy else [],
        "source": source,
    }


def check_whole(config: ImportSplatConfig, levels: Sequence[Level]) -> None:
    """Refuse some files of a level of detail without the others, unless `part` is set.

    Raises:
        InputError: files are lacking.
    """
    missing = missing_files(levels)
    if missing and not config.part:
        first = next(one for one in levels if one.number is None or len(one.files) < len(one.of))
        raise InputError(
            f"only a part of a capture, without {'; '.join(missing)}; import {first.index} --lod "
            f"{first.number or 0}, which reads all files of the level, or pass --part to import the part"
        )


class NothingLeftError(InputError):
    """No Gaussian is left."""

    def __init__(self, text: str, removed: dict[str, int]) -> None:
        super().__init__(text)
        self.removed = removed


class _Columns(NamedTuple):
    """Contiguous arrays in the types of a scene."""

    mean: NDArray[np.float32]
    scale: NDArray[np.float32]
    quat_wxyz: NDArray[np.float32]
    opacity: NDArray[np.float32]
    color: NDArray[np.uint8]


def _columns(splats: Splats) -> _Columns:
    return _Columns(
        np.ascontiguousarray(splats.mean, np.float32),
        np.ascontiguousarray(splats.scale, np.float32),
        np.ascontiguousarray(splats.quat_wxyz, np.float32),
        np.ascontiguousarray(splats.opacity, np.float32),
        np.ascontiguousarray(splats.color, np.uint8),
    )


def _kept(
    given: _Columns, removal: NDArray[np.uint8], kept: int
) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Arrays of the kept rows, and figures for the summary; only arrays that change are copied."""
    arrays: dict[str, NDArray[Any]] = given._asdict()
    changed = {"quat_wxyz"}
    if kept < len(removal):
        changed |= set(arrays)
    elif given.scale.min() < SCALE_FLOOR:
        changed.add("scale")
    outputs = {name: np.empty((kept, *arrays[name].shape[1:]), arrays[name].dtype) for name in changed}
    figures = _core.keep_rows(
        *given,
        removal,
        scale_floor=SCALE_FLOOR,
        out_mean=outputs.get("mean"),
        out_scale=outputs.get("scale"),
        out_quat=outputs["quat_wxyz"],
        out_opacity=outputs.get("opacity"),
        out_color=outputs.get("color"),
    )
    return arrays | outputs, figures


def _volume(config: ImportSplatConfig, splats: Splats, removal: NDArray[np.uint8]) -> MarkedVolume | None:
    """Volume that the rows mark that no rule but the opacity removes; None where no limit removes any."""
    limits = {config.min_opacity, FAINT}
    rows = (removal == 0) | (removal == 1 + _REASONS.index("min_opacity"))
    if not (splats.opacity[rows] < np.float32(max(limits))).any():
        return None
    mean, scale, quat, opacity = splats.mean, splats.scale, splats.quat_wxyz, splats.opacity
    if not rows.all():
        mean, scale, quat, opacity = mean[rows], scale[rows], quat[rows], opacity[rows]
    return marked_volume(mean, scale, quat, opacity, sorted(limits))


def _opacity_notes(
    config: ImportSplatConfig, volume: MarkedVolume | None, removed: dict[str, int], rows: int
) -> list[str]:
    """Note about the volume that the minimum opacity removes; else about that of the faint Gaussians kept."""
    if volume is None:
        return []
    by_limit = {one.limit: one for one in volume.limits}
    at, faint = by_limit[config.min_opacity], by_limit[FAINT]
    limit = at if at.gaussians and config.min_opacity > DRAWN else faint
    words = (
        f"{limit.gaussians} of {rows} Gaussians ({limit.gaussians / rows:.0%}), which alone mark "
        f"{volume.share(limit):.0%} of the volume ({limit.cells} of {volume.cells} cells of "
        f"{volume.edge:.3g} file units)"
    )
    if limit is at:
        return [cut_note(at.limit, words)]
    return [faint_note(words)] if faint.gaussians > at.gaussians and volume.share(faint) >= NOTABLE else []


def cut_note(limit: float, words: str) -> str:
    """Note about Gaussians, in words, that a minimum opacity removed."""
    return (
        f"--min-opacity {limit:g} removed {words}; obstacles are missing unless all of it is haze: "
        f"--min-opacity {DRAWN:g} keeps all that renderers draw"
    )


def faint_note(words: str) -> str:
    """Note about Gaussians, in words, of an opacity below `FAINT`."""
    return (
        f"an opacity below {FAINT:g} have {words}; they count as obstacles, and if they are haze, "
        f"--min-opacity {FAINT:g} removes them"
    )


def with_rounding(splats: Splats) -> Splats:
    """Gaussians whose loss bounds the rounding of centres far from the origin, where that is not negligible.

    The file rounded them to single precision, or a reader did, whose loss bounds it already.

    Args:
        splats: file frame and units.
    """
    finite, longest, largest = np.empty(len(splats), np.bool_), np.empty(len(splats), splats.scale.dtype), 0.0
    for start in range(0, len(splats), _PART):
        part = slice(start, start + _PART)
        mean, (x, y, z) = splats.mean[part], splats.scale[part].T
        finite[part] = np.all([np.isfinite(column) for column in (*mean.T, x, y, z)], axis=0)
        longest[part] = np.maximum(np.maximum(x, y), z)
        largest = max(largest, float(np.abs(mean[finite[part]]).max(initial=0.0)))
    sizes, typical = longest[finite], 0.0
    if len(sizes):  # their median, which np.median computes with an overflow near the largest number
        middle = np.array([(len(sizes) - 1) // 2, len(sizes) // 2])
        sizes.partition(middle)
        typical = float(sizes[middle].mean(dtype=np.float64))
    most = float(np.finfo(np.float32).max)
    if spacing(np.array(min(largest, most), np.float32)) <= _FINE * typical:
        return splats
    rounding = np.zeros(len(splats))
    rounding[finite] = single_rounding(splats.mean[finite])
    note = (
        f"coordinates as large as {largest:.6g} are rounded by up to {at_most(float(rounding.max()))} file "
        f"units, where half of the Gaussians have semi-axes below {typical:.2g}: each grows by its own "
        "rounding, so that none is lost; subtract an offset from the coordinates, before the training if the "
        "file has single precision"
    )
    loss = splats.loss or Loss(loss_bound(len(splats), position=rounding))
    return dataclasses.replace(splats, loss=loss, notes=(*splats.notes, note))


def _drop_floaters(splats: Splats, removal: NDArray[np.uint8]) -> tuple[int, dict[str, Any]]:
    """Mark the floaters among the kept rows; return their number and the rule."""
    rows = np.flatnonzero(removal == 0)
    drop, edge = floaters(splats.mean, splats.scale, splats.quat_wxyz, rows)
    removal[rows[drop]] = len(_REASONS) + 1
    rule = {"cell": edge, "smallest_group": SMALLEST_GROUP, "neighbour": NEIGHBOUR, "reach_sigma": REACH}
    return int(np.count_nonzero(drop)), rule


def turned(splats: Splats, axis: str) -> Splats:
    """Turn the frame of Gaussians by 180 degrees, exactly.

    Args:
        splats: file frame and units.
        axis: `x`, `y` or `z`; `none` returns the input.
    """
    if axis == "none":
        return splats
    number = "xyz".index(axis)
    sign = -np.ones(3, np.float32)
    sign[number] = 1
    # For the axis z, the half turn's quaternion k times w + x i + y j + z k is -z - y i + x j + w k; the
    # other axes follow by cyclic permutation.
    order, second, third = [1 + number, 0, 0, 0], 1 + (number + 1) % 3, 1 + (number + 2) % 3
    order[second], order[third] = third, second
    quat = np.take(splats.quat_wxyz, order, axis=1)
    quat[:, [0, second]] *= -1
    quat += np.float32(0)  # no -0
    return dataclasses.replace(splats, mean=splats.mean * sign, quat_wxyz=quat)


def _loss(splats: Splats, removal: NDArray[np.uint8], kept: int) -> dict[str, Any]:
    """Loss bounds of the kept rows (None where all are zero), and the maximum of each kind."""
    figures: dict[str, Any] = dict.fromkeys((*LOSSES, "opacity"), 0.0) | {"unbounded": {}}
    if splats.loss is None:
        return {"bound": None, "figures": figures}
    bound = splats.loss.bound if kept == len(removal) else splats.loss.bound[removal == 0]
    if not np.isfinite(bound).all() or (bound < 0).any():
        raise InputError("a bound of the format's loss is negative or not finite")
    figures |= {name: float(column.max()) for name, column in zip(LOSSES, bound.T, strict=True)}
    figures |= {"opacity": splats.loss.opacity, "unbounded": dict(splats.loss.unbounded)}
    return {"bound": bound if bound.any() else None, "figures": figures}


def _guarantee(config: ImportSplatConfig, source: dict[str, Any]) -> Guarantee:
    removed, loss, lacks = source["removed"], source["loss"], source["lacks"]
    unknown = source["unknown_properties"]
    left_out = {reason: count for reason, count in removed.items() if count}
    removals = ", ".join(f"{count} by {reason}" for reason, count in left_out.items()) or "none"
    figures = ", ".join(f"{name} {at_most(loss[name])}" for name in (*LOSSES, "opacity") if loss[name])
    lossy = (
        f" The format loses precision; `loss` bounds the loss of each Gaussian, at most {figures}."
        if figures
        else ""
    )
    for quantity, why in loss["unbounded"].items():
        lossy += f" The bound of {quantity} is not certain: {why}."
    whole = f" The files are not the whole capture, which also has {'; '.join(lacks)}." if lacks else ""
    ellipsoids = "".join(f" Of the file, {sentence}." for sentence in source["applied"])
    if unknown:
        ellipsoids += f" Not read: {unknown_words(unknown)}."
    return Guarantee(
        statement="Every Gaussian of the file is in the scene with its own ellipsoid, except those left "
        f"out: {removals}.{lossy}{ellipsoids}{whole}",
        claims={
            "lacks": lacks,
            "applied": source["applied"],
            "unknown_properties": unknown,
            "left_out": left_out,
            "min_opacity": config.min_opacity,
            "crop": list(config.crop) if config.crop is not None else None,
            "crop_sphere": list(config.crop_sphere) if config.crop_sphere is not None else None,
            "max_scale": config.max_scale,
            "drop_floaters": config.drop_floaters,
            "turn": config.turn,
            "loss": loss,
        },
    )


def zero_notes(source: dict[str, Any]) -> list[str]:
    """Note about rows without a rotation, which are left out."""
    if not (zero := source["removed"].get(_ZERO, 0)):
        return []
    return [
        f"{zero} of {source['rows']} Gaussians have a quaternion of length zero and were left out; no viewer "
        "draws them, but what they stood for is missing"
    ]


def property_notes(source: dict[str, Any]) -> list[str]:
    """Notes about further properties of the files."""
    if not (unknown := source["unknown_properties"]):
        return list(source["applied"])
    words = unknown_words(unknown)
    note = f"{words}; not read: if one of them changes the shape of Gaussians, the scene is wrong"
    return [*source["applied"], note]


def loss_notes(loss: dict[str, Any]) -> list[str]:
    """Notes about losses without a bound."""
    return [f"no certain bound of {what}: {why}" for what, why in loss["unbounded"].items()]


def nothing_left(removed: dict[str, int]) -> NothingLeftError:
    """Error where each row was removed by a rule."""
    reasons = ", ".join(f"{count} by {reason}" for reason, count in removed.items() if count)
    rows = sum(removed.values())
    return NothingLeftError(f"no Gaussian is left of {rows}: removed {reasons or 'none'}", removed)
