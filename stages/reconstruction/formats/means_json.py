"""JSON files of SAFER-Splat and Splat-Nav: lists of means, rotations, scalings, opacities and colours."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from alula.schemas.errors import ArtifactError
from alula.schemas.progress import Progress
from alula.stages.reconstruction.formats.properties import judged
from alula.stages.reconstruction.formats.source import Source
from alula.stages.reconstruction.formats.splats import (
    Loss,
    Properties,
    Splats,
    exp,
    growth,
    logistic,
    loss_bound,
)
from alula.stages.rotation import matrix_from_quat_wxyz, quat_wxyz_from_matrix

_KEYS = ("means", "rotations", "scalings", "opacities", "colors")
_CHUNK = 2**15
_SCAN = 2**22
_NOT_ORTHOGONAL = 1e-3  # matrices farther from a rotation than this are refused
_COARSE = 1e-5  # larger angles mean that they were rounded to fewer digits than single precision has
_SINGLE = 2.0**-24  # half a unit in the last place
_ROW = list[float | None]
_DECODERS: dict[int, Callable[[bytes], list[Any]]] = {  # by the brackets that a list of rows begins with
    0: msgspec.json.Decoder(_ROW).decode,
    1: msgspec.json.Decoder(_ROW).decode,
    2: msgspec.json.Decoder(list[_ROW]).decode,
    3: msgspec.json.Decoder(list[list[_ROW]]).decode,
}


def is_means_json(source: Source) -> bool:
    """Test whether a source is JSON with one of the lists within its first bytes and `means` anywhere."""
    start = source.head.removeprefix(b"\xef\xbb\xbf").lstrip()
    if start[:1] != b"{":
        return False
    if re.search(rb'"(?:means|rotations|scalings)"\s*:\s*\[', start) is not None:
        return True
    other = re.search(rb'"(?:opacities|colors)"\s*:\s*\[', start)
    return other is not None and re.search(rb'"means"\s*:\s*\[', source.data) is not None


def decode_means_json(buffer: memoryview, progress: Progress | None = None) -> Splats:
    """Decode a JSON file of SAFER-Splat, in either of its two dialects.

    SAFER-Splat's loader reads `rotations` as quaternions w, x, y, z of any length, `scalings` as natural
    logarithms and `opacities` as logits. Its script `write_gaussians.py` writes rotation matrices and plain
    scales and opacities instead. So quaternions mean logarithms and logits. Matrices mean plain values,
    unless a scaling is negative or an opacity outside of [0, 1], which plain values never are. Quaternions
    with plain values cannot be distinguished from logarithms of large scales. They are read like the loader
    does; because exp(v) > v, no Gaussian becomes smaller by that. A note names such files.

    Colours are red, green, blue from 0 to 1, or to 255 if one is above 2 and none above 255. `null`, `NaN`
    and `Infinity` become non-finite numbers; import_splat handles those rows.

    The error bound of numbers that single precision rounds is the largest rounding error among them.

    A matrix M means the nearest rotation R. The error bound is the angle of twice |M - R| plus 1e-6, which
    exceeds the rounding to single precision. Matrices with errors above 1e-5 have no certain bound.

    Raises:
        ArtifactError: not JSON, a list is missing, or rows are not of one length.
    """
    data: bytes | memoryview = buffer[3:] if bytes(buffer[:3]) == b"\xef\xbb\xbf" else buffer
    try:
        found = _parts(data)
    except ArtifactError:
        if not re.search(rb"NaN|Infinity", data):
            raise
        # Python writes these words, which are not JSON; 9e307 is infinite in single precision.
        found = _parts(re.sub(rb"\bNaN\b", b"null", re.sub(rb"\bInfinity\b", b"9e307", data)))
    for key in _KEYS[:4]:
        if key not in found:
            raise ArtifactError(f"JSON: Gaussians need {key!r}, which is missing")
    unknown = judged(key for key in found if key not in _KEYS)
    lists = {key: np.frombuffer(memoryview(found[key]), np.uint8) for key in _KEYS if key in found}
    count = len(_row_ends(lists["means"], "means"))
    if count == 0:
        raise ArtifactError("JSON: has no Gaussians ('means' is empty)")

    done = 0

    rounded: dict[str, float] = {}

    def read(key: str, shapes: tuple[tuple[int, ...], ...]) -> NDArray[np.float32]:
        nonlocal done
        rows, rounded[key] = _table(lists[key], key, count, shapes)
        done += 1
        if progress is not None:
            progress(count * done // len(lists), count)
        return rows

    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        mean = read("means", ((3,),))
        rotation = read("rotations", ((4,), (3, 3)))
        scale = read("scalings", ((3,),))
        opacity = read("opacities", ((1,), ()))
        if opacity.ndim == 2:
            opacity = opacity[:, 0]
        color, notes = _colors(read("colors", ((3,),)) if "colors" in lists else None, count)
        plain = not (scale < 0).any() and not ((opacity < 0) | (opacity > 1)).any()
        angle, why = np.zeros(count), {}
        if rotation.ndim == 3:
            rotation, angle = _from_matrices(rotation)
            coarse = float(angle.max(initial=0.0))
            why = {"rotation": "the matrices are rounded, by an unknown amount"} if coarse > _COARSE else {}
            notes.append("rotation matrices: scalings and opacities are plain")
            if not plain:
                notes[-1] = (
                    "rotation matrices, but a scaling is negative or an opacity outside of [0, 1]: "
                    "read as logarithms and logits"
                )
        else:
            notes.append(
                "quaternions: scalings are logarithms, opacities logits, as SAFER-Splat's loader reads"
            )
            if plain:
                notes[-1] += "; all could be plain values as well, and then Gaussians are smaller than read"
            plain = False
        if not plain:
            for start in range(0, count, _CHUNK):
                part = slice(start, start + _CHUNK)
                scale[part] = exp(scale[part])
                opacity[part] = logistic(opacity[part])
    position = 3**0.5 * rounded["means"]
    longer = 0.0 if not rounded["scalings"] else _SINGLE if plain else float(growth(rounded["scalings"]))
    lossy = angle.any() or position or longer
    return Splats(
        format="json",
        mean=mean,
        scale=scale,
        quat_wxyz=rotation,
        opacity=opacity,
        color=color,
        loss=Loss(loss_bound(count, position=position, scale=longer, rotation=angle), unbounded=why)
        if lossy
        else None,
        notes=tuple(notes),
        properties=Properties(unknown=unknown),
    )


def _parts(data: bytes | memoryview) -> dict[str, msgspec.Raw]:
    """Values of a JSON object, checked but not decoded."""
    try:
        return msgspec.json.decode(data, type=dict[str, msgspec.Raw])
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise ArtifactError(f"JSON: {error}") from error
    except RecursionError as error:
        raise ArtifactError("JSON: nested too deeply") from error


def _row_ends(text: NDArray[np.uint8], key: str) -> NDArray[np.int64]:
    """Ends of the rows of a list: at their closing brackets if the first row has any, else at commas.

    Lists that mix both are cut at wrong positions; the pieces are then not of the type of a row.
    """
    if text[0] != ord("["):
        raise ArtifactError(f"JSON: {key!r} is not a list")
    begin = bytes(text[1:64]).lstrip()[:1]
    if begin == b"]":
        return np.empty(0, np.int64)
    ends, depth = [], 0
    for at in range(0, len(text), _SCAN):
        part = text[at : at + _SCAN]
        if begin == b"[":
            # The brackets, and the letters Y and _, which differ from them in the same two bits.
            brackets = np.flatnonzero((part & 0xF9) == 0x59)
            kinds = part[brackets]
            after = depth + np.cumsum((kinds == ord("[")).astype(np.int64) - (kinds == ord("]")))
            ends.append(at + 1 + brackets[(kinds == ord("]")) & (after == 1)])
            depth = int(after[-1]) if len(after) else depth
        else:
            ends.append(at + np.flatnonzero(part == ord(",")))
    if begin != b"[":
        ends.append(np.array([len(text) - 1]))
    return np.concatenate(ends)


def _table(
    text: NDArray[np.uint8], key: str, count: int, shapes: tuple[tuple[int, ...], ...]
) -> tuple[NDArray[np.float32], float]:
    """Numbers of a list in single precision, and the maximum rounding error of one of them.

    All rows must have the shape of the first one, which must be one of the given shapes.
    """
    ends = _row_ends(text, key)
    if len(ends) != count:
        raise ArtifactError(f"JSON: {key!r} has {len(ends)} rows, 'means' {count}")
    table: NDArray[np.float32] | None = None
    start, moved = 1, 0.0
    for row in range(0, count, _CHUNK):
        stop = min(row + _CHUNK, count)
        end = int(ends[stop - 1])
        values = _rows(b"[" + text[start:end].tobytes().lstrip(b", \t\r\n") + b"]", key, row)
        start = end
        shape = values.shape[1:]
        if table is None:
            if shape not in shapes:
                names = " or ".join(" by ".join(map(str, s)) or "one" for s in shapes)
                raise ArtifactError(f"JSON: {key!r}, row 0 is of shape {shape}, not of {names} numbers")
            table = np.empty((count, *shape), np.float32)
        if shape != table.shape[1:] or len(values) != stop - row:
            raise ArtifactError(f"JSON: {key!r}, row {row} is of shape {shape}, row 0 of {table.shape[1:]}")
        table[row:stop] = values
        away = np.abs(table[row:stop] - values)
        moved = max(moved, float(away.max(where=np.isfinite(away), initial=0.0)))
    assert table is not None  # there is a row
    return table, moved


def _rows(piece: bytes, key: str, first: int) -> NDArray[np.float64]:
    """Numbers of a list of rows of one shape; `first` is the index of the first row."""
    depth = len(re.match(rb"(?:\[\s*){0,3}", piece)[0].split(b"[")) - 1  # type: ignore[index]  # always matches
    try:
        rows = _DECODERS[depth](piece)
    except msgspec.DecodeError as error:
        place = re.search(r"\$\[([0-9]+)\]", str(error))
        where = f", row {first + int(place[1])}" if place is not None else ""
        raise ArtifactError(f"JSON: {key!r}{where}: {error}") from error
    try:
        return np.array(rows, np.float64)
    except ValueError as error:
        for row, values in enumerate(rows):
            if [*_lengths(values)] != [*_lengths(rows[0])]:
                raise ArtifactError(
                    f"JSON: {key!r}, row {first + row} has {len(values)} numbers, row {first} {len(rows[0])}"
                ) from error
        raise


def _lengths(values: Any) -> Iterator[int]:
    yield len(values)
    for value in values:
        if isinstance(value, list):
            yield len(value)


def _from_matrices(matrices: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Quaternions of rotation matrices (NaN for matrices that are not finite), and their error bounds."""
    count = len(matrices)
    quat, angle = np.full((count, 4), np.nan, np.float32), np.zeros(count)
    for start in range(0, count, _CHUNK):
        exact = matrices[start : start + _CHUNK].astype(np.float64)
        finite = np.flatnonzero(np.isfinite(exact).all(axis=(1, 2)))
        exact = exact[finite]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            nearest = quat_wxyz_from_matrix(exact)
            off = np.linalg.norm(exact - matrix_from_quat_wxyz(nearest), axis=(1, 2))
        wrong = ~(off <= _NOT_ORTHOGONAL)
        if wrong.any():
            row = start + finite[int(np.argmax(wrong))]
            raise ArtifactError(f"JSON: 'rotations', row {row} is no rotation matrix")
        quat[start + finite] = nearest
        # Rotations by an angle t are 2 sqrt(2) sin(t / 2) apart in this norm.
        angle[start + finite] = 2.0 * np.arcsin((2.0 * off + 1e-6) / 8.0**0.5)
    return quat, angle


def _colors(stored: NDArray[np.float32] | None, count: int) -> tuple[NDArray[np.uint8], list[str]]:
    """Colours as bytes, and notes."""
    if stored is None:
        return np.full((count, 3), 128, np.uint8), ["no colours: grey"]
    notes = []
    most = float(np.nanmax(stored, initial=0.0))
    if 2.0 < most <= 255.0:
        stored = stored / np.float32(255.0)
        notes.append("colours from 0 to 255")
    with np.errstate(invalid="ignore"):
        return np.rint(np.clip(np.nan_to_num(stored, nan=0.0), 0.0, 1.0) * 255.0).astype(np.uint8), notes
