"""PlayCanvas's SOG: lossless images of codes beside a `meta.json`, in a folder or a ZIP archive."""

from __future__ import annotations

import io
import math
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.errors import ArtifactError
from alula.schemas.progress import Progress
from alula.stages.reconstruction.formats.rotations import chart_rotation_error, smallest_three
from alula.stages.reconstruction.formats.sog_meta import SogMeta, parse_json, parse_meta
from alula.stages.reconstruction.formats.source import Source
from alula.stages.reconstruction.formats.splats import (
    Loss,
    Properties,
    Splats,
    color_from_sh0,
    exp,
    growth,
    logistic,
    rounded_up,
)
from alula.stages.reconstruction.formats.webp import decode_webp, webp_size

META = "meta.json"
META_LIMIT = 2**22  # bytes
_FREE_PIXELS = 2**22  # allowed for any image, however few its bytes are
_PIXELS_PER_BYTE = 1024  # of all images; lossless WebP alone sets no limit
_CHUNK = 2**17

# Writers truncate codes (PlayCanvas) or round them (sogs), so the error of a value is up to a whole step.
# Some compute in single precision, which adds 1e-4 of a step to a code of 8 bits and 0.02 of a step to one of
# 16 bits. The error of ln(1 + |p|) also has a unit in its last place and the rounding error of 1 + |p|, which
# far from the origin is many steps.
_STEP, _FINE_STEP = 1.0 + 1e-4, 1.02
_LOGARITHM = 2.0**-22
ROTATION_STEP = _STEP * math.sqrt(2.0) / 255.0
OPACITY_LOSS = 1.0 / 255.0
_SINGLE = 2.0**-24  # half a unit in the last place: the rounding error of decoding

Read = Callable[[str], "bytes | memoryview"]


def is_sog(source: Source) -> bool:
    """Test whether a source is a folder with a `meta.json` of SOG, such a file, or an archive with one."""
    if source.is_folder:
        return source.has(META) and _says_sog(Source(source.folder / META))
    if source.head.startswith(b"PK\x03\x04"):
        if source.suffix == ".sog":
            return True
        try:
            with archive_of(source.data) as archive:
                return META in archive.namelist()
        except ArtifactError:
            return False
    return source.suffix in (".json", "") and _says_sog(source)


def _says_sog(source: Source) -> bool:
    try:
        if not source.head.lstrip().startswith(b"{") or len(source.data) > META_LIMIT:
            return False
        found = parse_json(bytes(source.data))
    except ArtifactError:
        return False
    return {"means", "scales", "quats", "sh0"} <= set(found)


def sog_members(source: Source) -> Sequence[str]:
    """Names of all files to read: the archive alone, or `meta.json` and its images.

    Raises:
        ArtifactError: `meta.json` is damaged.
    """
    if not source.is_folder and source.head.startswith(b"PK\x03\x04"):
        return (source.path.name,)
    meta = parse_meta(_meta(source))
    return (META if source.is_folder else source.path.name, *meta.files)


def decode_sog(source: Source, progress: Progress | None = None) -> Splats:
    """Decode SOG version 1 or 2, bundled or not.

    Positions are 16-bit codes of sign(p) ln(1 + |p|) between limits. Their error is at most
    (1 + |p|) (exp(h) - 1) per axis, where h is a step of the codes plus the rounding error of the logarithm
    in single precision. Rotations have three components of 8 bits.
    Log scales of version 1 are 8-bit codes between limits, with an error of a step. Those of version 2 are
    indices of a table, which has no bound of the values behind its entries. The bound assumes that the
    writer took the nearest entry: the value is below the middle to the next larger entry, and the error above
    the largest entry is no larger than that below it. Of higher harmonics only the size is checked.

    Args:
        source: a `.sog` archive, a `meta.json`, or the folder of one.

    Raises:
        ArtifactError: a file is missing or damaged, or `meta.json` is not valid.
    """
    try:
        if not source.is_folder and source.head.startswith(b"PK\x03\x04"):
            with archive_of(source.data) as archive:
                read = partial(_member, archive, len(source.data))
                return _decode(parse_meta(read(META)), read, progress)
        return _decode(parse_meta(_meta(source)), source.member, progress)
    except ArtifactError as error:
        raise ArtifactError(str(error) if str(error).startswith("SOG") else f"SOG: {error}") from error


def _meta(source: Source) -> bytes:
    """Contents of `meta.json`, where it is a file of its own."""
    raw = source.member(META) if source.is_folder else source.data
    if len(raw) > META_LIMIT:
        raise ArtifactError(f"SOG: {META} has {len(raw)} bytes, more than {META_LIMIT}")
    return bytes(raw)


def _decode(meta: SogMeta, read: Read, progress: Progress | None) -> Splats:
    raw = {name: read(name) for name in meta.files}
    _check_sizes(meta, raw)
    count = meta.count

    def pixels(name: str) -> NDArray[np.uint8]:
        try:
            return decode_webp(raw[name])[:count]
        except ArtifactError as error:
            raise ArtifactError(f"{name} {error}") from error

    mean, scale = np.empty((count, 3), np.float32), np.empty((count, 3), np.float32)
    quat, color = np.empty((count, 4), np.float32), np.empty((count, 3), np.uint8)
    bound = np.zeros((count, 3), np.float32)
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        _means(meta, pixels(meta.means[0]), pixels(meta.means[1]), mean, bound[:, 0])
        unbounded = _scales(meta, pixels(meta.scales), scale, bound[:, 1])
        without = _rotations(pixels(meta.quats), quat, bound[:, 2], progress)
        codes = pixels(meta.sh0)
        for axis in range(3):
            color[:, axis] = color_from_sh0(meta.sh0_values[axis])[codes[:, axis]]
        alpha = logistic(meta.logits) if meta.logits is not None else np.arange(256) / 255.0
        opacity = alpha.astype(np.float32)[codes[:, 3]]
    steps = float(np.diff(alpha).max()) if meta.logits is not None else OPACITY_LOSS
    notes = []
    if without:
        notes.append(f"{without} rows without a rotation, read as none; `loss` has half a turn for them")
    return Splats(
        format="sog",
        mean=mean,
        scale=scale,
        quat_wxyz=quat,
        opacity=opacity,
        color=color,
        loss=Loss(bound, steps, unbounded),
        tags=meta.tags,
        notes=(*meta.notes, *notes),
        properties=Properties(unknown=meta.unknown),
    )


def _means(
    meta: SogMeta,
    low: NDArray[np.uint8],
    high: NDArray[np.uint8],
    mean: NDArray[np.float32],
    bound: NDArray[np.float32],
) -> None:
    """Centres, and the norm of the error bounds of their axes, by tables of all 65536 codes."""
    places, squares = [], []
    for lower, upper in zip(meta.mins, meta.maxs, strict=True):
        extent = (upper - lower) or 1.0
        t = lower + extent * (np.arange(65536) / 65535.0)
        place = np.sign(t) * (exp(np.abs(t)) - 1.0)
        step = _FINE_STEP * extent / 65535.0 + _LOGARITHM * (1.0 + np.abs(t))
        lost = (1.0 + np.abs(place)) * growth(np.minimum(step, 700.0))
        places.append(place.astype(np.float32))
        squares.append((lost + np.abs(place) * _SINGLE) ** 2)
    for start in range(0, meta.count, _CHUNK):
        part = slice(start, start + _CHUNK)
        code = low[part, :3] | high[part, :3].astype(np.uint16) << 8
        total = np.zeros(len(code))
        for axis in range(3):
            mean[part, axis] = places[axis][code[:, axis]]
            total += squares[axis][code[:, axis]]
        bound[part] = rounded_up(np.sqrt(total) * (1.0 + 1e-12))


def _scales(
    meta: SogMeta, codes: NDArray[np.uint8], scale: NDArray[np.float32], bound: NDArray[np.float32]
) -> dict[str, str]:
    """Scales and their error bounds, by tables; returns the quantities with an uncertain bound."""
    largest = np.zeros(meta.count, np.bool_)
    for axis, values in enumerate(meta.log_scales):
        scale[:, axis] = exp(values).astype(np.float32)[codes[:, axis]]
        gap = _STEP * (values[-1] - values[0]) / 255.0 if meta.version == 1 else _half_gaps(values)
        lost = rounded_up(growth(gap + 4.0 * _SINGLE) * np.ones(256))
        np.maximum(bound, lost[codes[:, axis]], out=bound)
        if meta.version != 1:
            largest |= (values == values.max())[codes[:, axis]]
    if meta.version == 1:
        return {}
    return {
        "scale": "the file has a table of scales and not how far the scales were from its entries; the "
        f"bound assumes the nearest entry, and for the {int(largest.sum())} Gaussians with the largest "
        "entry no more above it than below"
    }


def _half_gaps(entries: NDArray[np.float64]) -> NDArray[np.float64]:
    """Half the distance of each entry to the next larger one; for the largest, to the next smaller one."""
    order = np.unique(entries)
    if len(order) == 1:
        return np.zeros(len(entries))
    half = np.diff(order) / 2.0
    gaps: NDArray[np.float64] = np.append(half, half[-1])[np.searchsorted(order, entries)]
    return gaps


def _rotations(
    codes: NDArray[np.uint8],
    quat: NDArray[np.float32],
    bound: NDArray[np.float32],
    progress: Progress | None,
) -> int:
    """Rotations and their error bounds; returns the number of rows without a rotation."""
    without = 0
    for start in range(0, len(codes), _CHUNK):
        part = slice(start, min(start + _CHUNK, len(codes)))
        chunk = codes[part]
        missing = chunk[:, 3] < 252
        stored = (chunk[:, :3] / 127.5 - 1.0) * math.sqrt(0.5)
        stored[missing] = 0.0
        largest = np.where(missing, 0, chunk[:, 3].astype(np.intp) - 252)
        quat[part] = smallest_three(stored, largest)
        angle = chart_rotation_error(stored, math.sqrt(3.0) * ROTATION_STEP)
        bound[part] = rounded_up(np.where(missing, np.pi, angle))
        without += int(missing.sum())
        if progress is not None:
            progress(part.stop, len(codes))
    return without


def _check_sizes(meta: SogMeta, raw: dict[str, bytes | memoryview]) -> None:
    """Check that each image has enough pixels, and not so many that decoding would exhaust the memory."""
    bytes_there = sum(len(data) for data in raw.values())
    for name, data in raw.items():
        try:
            width, height = webp_size(data)
        except ArtifactError as error:
            raise ArtifactError(f"{name} {error}") from error
        pixels = width * height
        what = f"{name} has {width} x {height} pixels"
        if meta.harmonics is not None and name == meta.harmonics.centroids:
            meta.harmonics.check(what, width, height)
            continue
        if pixels < meta.count:
            raise ArtifactError(f"{what}, fewer than the {meta.count} Gaussians")
        if pixels > 4 * meta.count + 65536:
            raise ArtifactError(f"{what}, far more than the {meta.count} Gaussians need")
        if pixels > max(_FREE_PIXELS, _PIXELS_PER_BYTE * bytes_there):
            raise ArtifactError(f"{what}, far more than {bytes_there} bytes can hold")


class _View(io.RawIOBase):
    """File object over bytes in memory, without a copy of all of them."""

    def __init__(self, data: memoryview) -> None:
        self._data = data
        self._at = 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def tell(self) -> int:
        return self._at

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        at = offset + (0, self._at, len(self._data))[whence]
        if at < 0:
            raise ValueError("negative position")
        self._at = at
        return at

    def readinto(self, target: Any) -> int:
        part = self._data[self._at : self._at + len(target)]
        target[: len(part)] = part
        self._at += len(part)
        return len(part)


@contextmanager
def archive_of(data: memoryview) -> Iterator[zipfile.ZipFile]:
    """Context with the members of a ZIP archive.

    Raises:
        ArtifactError: it is damaged.
    """
    try:
        archive = zipfile.ZipFile(_View(data))
    except _ZIP_ERRORS as error:
        raise ArtifactError(f"SOG: damaged ZIP archive: {error}") from error
    with archive:
        yield archive


_ZIP_ERRORS = (
    zipfile.BadZipFile, zlib.error, RuntimeError, EOFError, ValueError, OSError, OverflowError, MemoryError
)  # fmt: skip


def _member(archive: zipfile.ZipFile, total: int, name: str) -> bytes:
    """Content of one file of an archive of `total` bytes, never more than its directory entry states."""
    found = [info for info in archive.infolist() if info.filename == name]
    if len(found) != 1:
        raise ArtifactError(f"{name} is {'twice' if found else 'not'} in the archive")
    info = found[0]
    if info.flag_bits & 0x1:
        raise ArtifactError(f"{name} is encrypted")
    if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ArtifactError(f"{name} is compressed by method {info.compress_type}; SOG has 0 and 8")
    if info.header_offset + info.compress_size > total:
        raise ArtifactError(f"{name} is truncated")
    limit = META_LIMIT if name == META else 8 * info.compress_size + 2**20  # images do not shrink again
    if info.file_size > limit:
        raise ArtifactError(f"{name} has {info.file_size} bytes, more than {limit}")
    try:
        with archive.open(info) as file:
            raw = file.read(info.file_size)
            if file.read(1) or len(raw) != info.file_size:
                raise ArtifactError(f"{name} has not the {info.file_size} bytes that it is said to have")
    except _ZIP_ERRORS as error:
        raise ArtifactError(f"{name} is damaged: {error}") from error
    return raw
