"""glTF 2.0 with `KHR_gaussian_splatting`, as `.gltf` or `.glb`."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
from msgspec import Raw, Struct
from numpy.typing import NDArray

from alula.schemas.errors import ArtifactError
from alula.schemas.progress import Progress
from alula.stages.reconstruction.formats.gltf_accessors import (
    FLOAT,
    Column,
    Document,
    Primitive,
    Tables,
    item,
)
from alula.stages.reconstruction.formats.gltf_nodes import NAME, Placed, check_still, placed_primitives
from alula.stages.reconstruction.formats.properties import judged
from alula.stages.reconstruction.formats.source import Source
from alula.stages.reconstruction.formats.splats import (
    Loss,
    Properties,
    Splats,
    color_from_sh0,
    exp,
    growth,
    rounded_up,
)
from alula.stages.rotation import multiply_quat_wxyz

_KNOWN = (NAME, "KHR_mesh_quantization")
_CHUNK = 2**16
_UNIT = 2.0**-22  # four times the rounding to single precision

_SIGNED = ("i8", "i8n", "i16", "i16n")
_UNSIGNED = ("u8", "u8n", "u16", "u16n")
_KINDS = {
    "POSITION": (("VEC3",), (FLOAT, *_SIGNED, *_UNSIGNED)),
    f"{NAME}:ROTATION": (("VEC4",), (FLOAT, "i8n", "i16n")),
    f"{NAME}:SCALE": (("VEC3",), (FLOAT, *_UNSIGNED, *_SIGNED)),
    f"{NAME}:OPACITY": (("SCALAR",), (FLOAT, "u8n", "u16n")),
}
_SH0 = f"{NAME}:SH_DEGREE_0_COEF_0"


class Splatting(Struct, rename="camel"):
    """The extension of a primitive."""

    kernel: str | None = None
    color_space: str | None = None
    extensions: dict[str, Raw] = {}


@dataclass(frozen=True, slots=True)
class _Gaussians:
    """The resolved columns of one primitive."""

    mean: Column
    quat: Column
    scale: Column
    opacity: Column
    color: Column
    color_is_sh0: bool

    def __len__(self) -> int:
        return len(self.mean.stored)


def is_gltf(source: Source) -> bool:
    """Test whether a source is glTF, in JSON or binary."""
    if source.head[:4] == b"glTF":
        return True
    start = source.head.removeprefix(b"\xef\xbb\xbf").lstrip()
    return start[:1] == b"{" and (
        source.suffix == ".gltf" or re.match(rb'\{\s*"asset"\s*:', start) is not None
    )


def members_of_gltf(source: Source) -> Sequence[str]:
    """Names of the file itself and of those that hold its buffers."""
    tables = Tables(source)
    document = tables.document
    names: dict[str, None] = {}
    for placed in placed_primitives(document, []):
        for accessor in _primitive(document, placed.primitive).attributes.values():
            for index in tables.views_of(accessor):
                view = item(document.buffer_views, index, "buffer view")
                name = tables.external(view.buffer)
                if name is not None:
                    names[name] = None
    return (source.path.name, *names)


def decode_gltf(source: Source, progress: Progress | None = None) -> Splats:
    """Decode the Gaussians of the default scene, in its frame.

    The nodes' matrices are applied: rotations, shifts and scales that are positive and equal along all axes
    (to 1e-5); others are refused. Values follow the specification's release candidate: linear scale and
    opacity, quaternions x, y, z, w. Its review drafts, and writers that followed them until mid-2026, stored
    natural logarithms of scales, and a file does not state which. But logarithms of scales below one unit
    are negative, and scales never are. So signed integers or a negative value anywhere mean logarithms in
    the whole file. Because exp(v) > v, this never reads a Gaussian as smaller.

    Error bounds, for any rounding or truncation, with d the step between codes (1 / largest code if
    normalised, else 1): d sqrt(3) times the scale of its node for a centre; d for a linear scale; exp(d) - 1
    for a scale stored as a logarithm; 2 d for a quaternion m, which is an angle of 2 asin(2 d / |m|). The
    bound of linear scales is recorded relative to the longest semi-axis; the others are raised, by less than
    d, so that this bound suffices for them. A node that is not the identity adds the rounding of its products
    to single precision.

    Args:
        source: the `.gltf` or `.glb` file.

    Raises:
        ArtifactError: the file is damaged, has no Gaussians, or uses an unknown feature.
        InputError: a file cannot be read.
    """
    tables = Tables(source)
    document, notes = tables.document, list(tables.notes)
    for name in document.extensions_required:
        if name not in _KNOWN:
            raise ArtifactError(f"glTF: requires {name[:100]}, which is not supported")
    placed = placed_primitives(document, notes)
    seen: dict[str, None] = {}  # notes of primitives, each once
    parts = {place: _gaussians(tables, place, seen) for place in dict.fromkeys(p.primitive for p in placed)}
    count = sum(len(parts[p.primitive]) for p in placed)
    if count == 0:
        raise ArtifactError("glTF: has no Gaussians (accessors of 0 rows)")
    if count > tables.size:
        raise ArtifactError(f"glTF: {count} Gaussians in {tables.size} bytes of buffers")
    negative = sum(_negative_rows(part.scale) for part in parts.values())
    logarithms = negative > 0 or any(part.scale.kind in _SIGNED for part in parts.values())
    if logarithms:
        notes.append(
            f"scales are logarithms, as in drafts of the format: signed integers, or {negative} rows "
            "with a negative one"
        )
    notes += seen
    if document.animations:
        check_still(document)
        notes.append(f"{len(document.animations)} animations do not move Gaussians; they were not read")
    primitives = [_primitive(document, place) for place in parts]
    others = dict.fromkeys(name for one in primitives for name in one.attributes if not _is_known(name))
    unknown = judged(name.removeprefix("_").removeprefix(f"{NAME}:") for name in others)
    notes.append("glTF is y up; some writers turn PLY data by 180 degrees about z, which --turn z undoes")

    out = _Output(count, logarithms, not all(p.exact and _is_float(parts[p.primitive]) for p in placed))
    start = 0
    for place in placed:
        part = parts[place.primitive]
        for first in range(0, len(part), _CHUNK):
            rows = slice(first, min(first + _CHUNK, len(part)))
            out.put(slice(start + rows.start, start + rows.stop), part, place, rows)
            if progress is not None:
                progress(start + rows.stop, count)
        start += len(part)
    tags = {"frame": "glTF, y up"}
    if document.asset.generator:
        tags["generator"] = document.asset.generator[:200]
    return out.splats(tags, tuple(notes), Properties(unknown=unknown))


class _Output:
    """The arrays being filled."""

    def __init__(self, count: int, logarithms: bool, lossy: bool) -> None:
        self.logarithms = logarithms
        self.mean, self.scale = np.empty((count, 3), np.float32), np.empty((count, 3), np.float32)
        self.quat, self.color = np.empty((count, 4), np.float32), np.empty((count, 3), np.uint8)
        self.alpha = np.empty(count, np.float32)
        self.bound = np.zeros((count, 3), np.float32) if lossy else None
        self.opacity_loss = 0.0
        self.saturated = 0

    def put(self, to: slice, part: _Gaussians, place: Placed, rows: slice) -> None:
        """Decode some rows of a primitive."""
        with np.errstate(over="ignore", invalid="ignore", under="ignore"):
            mean, quat = part.mean.values(rows), part.quat.values(rows)[:, [3, 0, 1, 2]]
            scale, scale_loss = self._scale(part.scale, rows)
            if not place.exact:
                mean = mean.astype(np.float64) @ place.linear.T + place.shift
                quat = multiply_quat_wxyz(place.quat, quat)
                scale = scale * place.scale
            self.mean[to], self.quat[to], self.scale[to] = mean, quat, scale
            self.alpha[to] = part.opacity.values(rows)[:, 0]
            color = part.color.values(rows)[:, :3]
            self.color[to] = color_from_sh0(color) if part.color_is_sh0 else _bytes(color)
            self.opacity_loss = max(self.opacity_loss, part.opacity.step)
            self.saturated += int(part.scale.saturated(rows).sum())
            if self.bound is None:
                return
            position = np.full(len(mean), 3**0.5 * part.mean.step * place.scale)
            rotation = np.zeros(len(mean))
            if part.quat.step:
                length = np.linalg.norm(quat, axis=1)
                ratio = np.divide(2 * part.quat.step, length, out=np.ones_like(length), where=length > 0)
                rotation = 2.0 * np.arcsin(np.minimum(ratio, 1.0)) * (1 + 1e-12)
            if not place.exact:
                # Relative rounding errors: 2^-53 for terms of the sum, 2^-24 for the sum.
                terms = np.abs(part.mean.values(rows)).sum(axis=1) * place.scale + np.abs(place.shift).sum()
                position += 2.0**-50 * terms + 2.0**-23 * np.linalg.norm(mean, axis=1)
                # With the polar factors R (I + S) of the node, |S| <= s, each pair of semi-axes is sheared
                # by at most s: to first order a rotation by s and a stretch by 2 s. In addition every axis
                # is stretched by s.
                scale_loss = scale_loss + (1 + scale_loss) * (6 * place.defect + _UNIT)
                rotation += 2 * place.defect + _UNIT
            position[~np.isfinite(position)] = 0.0  # a row with a centre that is not finite is no Gaussian
            for column, values in enumerate((position, scale_loss, np.minimum(rotation, np.pi))):
                self.bound[to, column] = rounded_up(values)

    def _scale(self, column: Column, rows: slice) -> tuple[NDArray[Any], NDArray[np.float64]]:
        """Scales, and the relative bounds of their excess."""
        stored, step = column.values(rows), column.step
        if self.logarithms:
            return exp(stored), np.full(len(stored), growth(step))
        if not step:
            return stored, np.zeros(len(stored))
        longest = np.maximum(stored.max(axis=1, keepdims=True), step)
        loss = step / longest
        scale = np.maximum(stored, rounded_up((stored + step) / (1.0 + loss)))
        return scale, loss[:, 0]

    def splats(self, tags: dict[str, str], notes: tuple[str, ...], properties: Properties) -> Splats:
        """Gaussians that were read, with their loss."""
        unbounded = {}
        if self.saturated:
            unbounded["scale"] = f"{self.saturated} rows hold the largest code there is"
        loss = None
        if self.bound is not None or self.opacity_loss:
            bound = self.bound if self.bound is not None else np.zeros((len(self.mean), 3), np.float32)
            loss = Loss(bound, self.opacity_loss, unbounded)
        return Splats(
            format="gltf",
            mean=self.mean,
            scale=self.scale,
            quat_wxyz=self.quat,
            opacity=self.alpha,
            color=self.color,
            loss=loss,
            tags=tags,
            notes=notes,
            properties=properties,
        )


def _is_known(attribute: str) -> bool:
    """Test whether an attribute is read, or belongs to ordinary meshes and only shades."""
    return (
        attribute in _KINDS
        or attribute.startswith(f"{NAME}:SH_")
        or re.fullmatch(r"NORMAL|TANGENT|(COLOR|TEXCOORD)_[0-9]+", attribute) is not None
    )


def _primitive(document: Document, place: tuple[int, int]) -> Primitive:
    return document.meshes[place[0]].primitives[place[1]]


def _gaussians(tables: Tables, place: tuple[int, int], notes: dict[str, None]) -> _Gaussians:
    """Check a primitive and find its tables."""
    name = f"mesh {place[0]} primitive {place[1]}"
    primitive = _primitive(tables.document, place)
    try:
        splatting = msgspec.json.decode(primitive.extensions[NAME], type=Splatting)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ArtifactError(f"glTF: {name}: {NAME}: {error}") from error
    if splatting.kernel is None:
        notes["no kernel is named; read as ellipse"] = None
    elif splatting.kernel != "ellipse":
        raise ArtifactError(f"glTF: {name}: kernel {splatting.kernel[:50]!r} is not known, only 'ellipse'")
    for extension in splatting.extensions:
        if "compression" in extension:
            raise ArtifactError(f"glTF: {name}: compressed by {extension[:100]}, which is not supported")
        notes[f"{extension[:100]} is not known and was not read"] = None
    if primitive.mode != 0 or primitive.indices is not None or primitive.targets:
        raise ArtifactError(f"glTF: {name}: Gaussians must be plain points (mode 0, no indices, no targets)")
    if splatting.color_space == "lin_rec709_display":
        notes["colours are linear and kept so (lin_rec709_display)"] = None

    columns = {}
    for attribute, (types, kinds) in _KINDS.items():
        if attribute not in primitive.attributes:
            raise ArtifactError(f"glTF: {name}: Gaussians need attribute {attribute}, which is missing")
        what = f"{name}: {attribute}"
        columns[attribute] = tables.column(primitive.attributes[attribute], what, types, kinds)
    _check_sh(tables, primitive, name, columns)
    color = columns.get(_SH0)
    if color is None:
        if "COLOR_0" not in primitive.attributes:
            raise ArtifactError(f"glTF: {name}: Gaussians need attribute {_SH0}, which is missing")
        index = primitive.attributes["COLOR_0"]
        color = tables.column(index, f"{name}: COLOR_0", ("VEC3", "VEC4"), (FLOAT, "u8n", "u16n"))
        columns["COLOR_0"] = color
        notes["no spherical harmonics: colours of COLOR_0"] = None
    count = len(columns["POSITION"].stored)
    for attribute, column in columns.items():
        if len(column.stored) != count:
            raise ArtifactError(f"glTF: {name}: {attribute} has {len(column.stored)} rows, POSITION {count}")
    mean, quat, scale, opacity = (columns[attribute] for attribute in _KINDS)
    return _Gaussians(mean, quat, scale, opacity, color, _SH0 in columns)


def _check_sh(tables: Tables, primitive: Primitive, name: str, columns: dict[str, Column]) -> None:
    """Add the harmonics to the columns; each degree must be whole and have all lower ones."""
    degrees: dict[int, set[int]] = {}
    for attribute, index in primitive.attributes.items():
        if not attribute.startswith(f"{NAME}:SH_"):
            continue
        match = re.fullmatch(r"SH_DEGREE_([0-3])_COEF_([0-6])", attribute[len(NAME) + 1 :])
        if match is None or int(match[2]) > 2 * int(match[1]):
            raise ArtifactError(f"glTF: {name}: {attribute[:100]} is no spherical-harmonic coefficient")
        degrees.setdefault(int(match[1]), set()).add(int(match[2]))
        columns[attribute] = tables.column(index, f"{name}: {attribute}", ("VEC3",), (FLOAT,))
    for degree in range(max(degrees, default=-1) + 1):
        lacking = set(range(2 * degree + 1)) - degrees.get(degree, set())
        if lacking:
            raise ArtifactError(f"glTF: {name}: SH_DEGREE_{degree}_COEF_{min(lacking)} is missing")


def _negative_rows(column: Column) -> int:
    if column.kind in _UNSIGNED:
        return 0
    chunks = range(0, len(column.stored), _CHUNK)
    with np.errstate(invalid="ignore"):
        return sum(int((column.stored[i : i + _CHUNK] < 0).any(axis=1).sum()) for i in chunks)


def _is_float(part: _Gaussians) -> bool:
    return not (part.mean.step or part.quat.step or part.scale.step)


def _bytes(color: NDArray[Any]) -> NDArray[np.uint8]:
    exact = np.nan_to_num(np.asarray(color, np.float64), nan=0.0)
    return np.rint(np.clip(exact, 0.0, 1.0) * 255.0).astype(np.uint8)
