"""mkkellogg's `.ksplat`: sections of records of 44, 24 or more bytes, positions relative to buckets."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from alula.schemas.errors import ArtifactError
from alula.schemas.progress import Progress
from alula.stages.coordinates import spacing
from alula.stages.reconstruction.formats.source import Source
from alula.stages.reconstruction.formats.splats import Loss, Splats, loss_bound

HEADER = 4096
SECTION_HEADER = 1024
_CHUNK = 2**17
_CENTRE = np.dtype("<f4")
_SH_VALUES = (0, 9, 24)
_NUMBERS = (("<f4", "<f4", "<f4"), ("<u2", "<f2", "<f4"), ("<u2", "<f2", "u1"))  # centre, others, SH

# The reference writer truncates to half precision, never above 65504. So a normal number is too small by at
# most 2^-10 of itself, and one below 2^-14 by at most 2^-24.
SCALE_LOSS = 2.0**-10
SUBNORMAL = 2.0**-14
SUBNORMAL_STEP = 2.0**-24
_LARGEST_HALF = 65504.0
OPACITY_LOSS = 1.0 / 255.0
_SINGLE = 2.0**-24


def is_ksplat(source: Source) -> bool:
    """Test the suffix of a file; the format has no magic number."""
    return source.suffix == ".ksplat"


@dataclass(frozen=True, slots=True)
class _Section:
    """Layout of a section: offsets of its records, and the ranges of their centres."""

    count: int
    records: int  # offset
    centres: int  # offset of the buckets' centres
    full: int  # number of full buckets
    bucket_size: int
    partial: NDArray[np.int64]  # ends of the other buckets, counted in records behind the full ones
    block: float
    scale_range: int
    record: np.dtype[np.void]

    def owners(self, start: int, stop: int) -> NDArray[np.int64]:
        """Buckets of records."""
        rows = np.arange(start, stop, dtype=np.int64)
        whole = self.full * self.bucket_size
        behind = self.full + np.searchsorted(self.partial, rows - whole, side="right")
        return np.where(rows < whole, rows // max(self.bucket_size, 1), behind)


def decode_ksplat(buffer: memoryview, progress: Progress | None = None) -> Splats:
    """Decode a `.ksplat` file, version 0.1 and above, of compression level 0, 1 or 2.

    Level 0 is exact except for alpha. At levels 1 and 2 a position is (code - r) b / (2 r) + centre of the
    bucket, with b the edge of a bucket's block and r the range of codes, so its error is at most b / (4 r)
    per axis. Linear scales and rotations are truncated to half precision. A scale below 2^-14, where half
    precision has steps of 2^-24, is read one step larger, so that the whole ellipsoid need not grow for it.
    A negative scale renders like its absolute value and is read as such.

    Raises:
        ArtifactError: truncated, of another version, or counts that contradict each other.
    """
    level, sections, end = _sections(buffer)
    count = sum(section.count for section in sections)
    mean, scale = np.empty((count, 3), np.float32), np.empty((count, 3), np.float32)
    quat, color = np.empty((count, 4), np.float32), np.empty((count, 3), np.uint8)
    opacity = np.empty(count, np.float32)
    off, turn = np.zeros(count if level else 0), np.zeros(count if level else 0)
    negative = raised = largest = outside = done = 0
    with np.errstate(over="ignore", invalid="ignore"):
        for section in sections:
            rows = np.frombuffer(buffer, section.record, section.count, section.records)
            for start in range(0, section.count, _CHUNK):
                stop = min(start + _CHUNK, section.count)
                chunk, part = rows[start:stop], slice(done, done + stop - start)
                quat[part] = chunk["quat"]
                color[part] = chunk["rgba"][:, :3]
                opacity[part] = chunk["rgba"][:, 3] / 255.0
                sizes = chunk["scale"].astype(np.float32)
                negative += int((sizes < 0).any(axis=1).sum())
                sizes = np.abs(sizes)
                if level:
                    small = sizes < SUBNORMAL
                    raised += int(small.any(axis=1).sum())
                    largest += int((sizes == _LARGEST_HALF).any(axis=1).sum())
                    sizes[small] += np.float32(SUBNORMAL_STEP)
                    outside += int((chunk["mean"] > 2 * section.scale_range).any(axis=1).sum())
                    mean[part], off[part] = _positions(buffer, section, chunk["mean"], start, stop)
                    turn[part] = _turns(chunk["quat"])
                else:
                    mean[part] = chunk["mean"]
                scale[part] = sizes
                done = part.stop
                if progress is not None:
                    progress(done, count)

    notes, unbounded = [], {}
    if negative:
        notes.append(f"{negative} rows with a negative scale, read as positive")
    if raised:
        notes.append(
            f"{raised} Gaussians with a semi-axis below 2^-14, where half precision has steps of 6e-8; "
            "those were read one step longer"
        )
    if largest:
        unbounded["scale"] = f"half precision ends at 65504, which {largest} Gaussians have"
    if outside:
        unbounded["position"] = f"{outside} Gaussians are cut off at the edge of their block"
    if end < len(buffer):
        notes.append(f"{len(buffer) - end} bytes follow the sections; they were not read")
    bound = loss_bound(count, position=off, scale=SCALE_LOSS, rotation=turn) if level else loss_bound(count)
    return Splats(
        format="ksplat",
        mean=mean,
        scale=scale,
        quat_wxyz=quat,
        opacity=opacity,
        color=color,
        loss=Loss(bound, OPACITY_LOSS, unbounded),
        notes=tuple(notes),
    )


def _positions(
    buffer: memoryview, section: _Section, codes: NDArray[np.uint16], start: int, stop: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centres of the records and their error bounds."""
    buckets = section.full + len(section.partial)
    centres = np.frombuffer(buffer, _CENTRE, 3 * buckets, section.centres).reshape(buckets, 3)
    centre = centres[section.owners(start, stop)].astype(np.float64)
    half_step = section.block / (4.0 * section.scale_range)
    mean = (codes.astype(np.float64) - section.scale_range) * (2.0 * half_step) + centre
    # besides the codes, the writer rounds the centre and the block to single precision, and this sum is too
    rounded = (np.abs(centre) + np.abs(mean) + section.block) * _SINGLE
    return mean, np.linalg.norm(half_step + rounded, axis=1)


def _turns(quat: NDArray[np.float16]) -> NDArray[np.float64]:
    """Error bounds of rotations with quaternions truncated to half precision [rad].

    The error of each component is less than one unit in its last place. The error of the quaternion is at
    most the norm e of these units, and that of its direction at most asin(e / |q|), for any length.
    """
    stored = quat.astype(np.float64)
    unit = spacing(quat)
    ratio = np.linalg.norm(unit, axis=1) / np.maximum(np.linalg.norm(stored, axis=1), SUBNORMAL_STEP)
    angle: NDArray[np.float64] = 2.0 * np.arcsin(np.minimum(np.nan_to_num(ratio, nan=1.0), 1.0))
    return angle * (1.0 + 1e-12)


def _sections(buffer: memoryview) -> tuple[int, list[_Section], int]:
    """Compression level, sections, and the end of the last one; every count is checked here."""
    if len(buffer) < HEADER:
        raise ArtifactError(f"KSPLAT: truncated: the header has {HEADER} bytes, there are {len(buffer)}")
    major, minor = buffer[0], buffer[1]
    if major != 0 or minor < 1:
        raise ArtifactError(f"KSPLAT: version {major}.{minor} is not supported, only 0.1 and above")
    room, used, _, announced = struct.unpack_from("<4I", buffer, 4)
    (level,) = struct.unpack_from("<H", buffer, 20)
    if level > 2:
        raise ArtifactError(f"KSPLAT: compression level {level} is not known; there are 0, 1 and 2")
    if used > room:
        raise ArtifactError(f"KSPLAT: {used} sections where there is room for {room}")
    at = HEADER + SECTION_HEADER * room
    if at > len(buffer):
        raise ArtifactError(
            f"KSPLAT: truncated: the headers of {room} sections end at {at}, the file at {len(buffer)}"
        )
    sections = []
    for i in range(room):  # some writers leave the number in use at 0
        section, at = _section(buffer, i, level, at)
        sections.append(section)
    count = sum(section.count for section in sections)
    if count != announced:
        raise ArtifactError(f"KSPLAT: {announced} Gaussians announced, but {count} in the sections")
    if count == 0:
        raise ArtifactError("KSPLAT: has no Gaussians")
    return level, [section for section in sections if section.count], at


def _section(buffer: memoryview, i: int, level: int, at: int) -> tuple[_Section, int]:
    where = f"KSPLAT: section {i + 1}"
    header = HEADER + SECTION_HEADER * i
    count, room, bucket_size, buckets, block, centre_size = struct.unpack_from("<4IfH", buffer, header)
    scale_range, _, full, partial = struct.unpack_from("<4I", buffer, header + 24)
    (degree,) = struct.unpack_from("<H", buffer, header + 40)
    if degree >= len(_SH_VALUES):
        raise ArtifactError(f"{where}: spherical harmonics of degree {degree}; there are 0, 1 and 2")
    if count > room:
        raise ArtifactError(f"{where}: {count} Gaussians where there is room for {room}")
    centre, other, harmonic = _NUMBERS[level]
    record = np.dtype(
        [
            ("mean", centre, 3),
            ("scale", other, 3),
            ("quat", other, 4),
            ("rgba", "u1", 4),
            ("sh", harmonic if level != 1 else other, _SH_VALUES[degree]),
        ]
    )
    centres = at + 4 * partial
    records = centres + centre_size * buckets
    end = records + record.itemsize * room
    if end > len(buffer):
        raise ArtifactError(
            f"{where}: truncated: {room} records, {buckets} buckets and {partial} lengths end at {end}, "
            f"the file at {len(buffer)}"
        )
    ends = np.zeros(0, np.int64)
    if level and count:
        if centre_size != 3 * _CENTRE.itemsize:
            raise ArtifactError(f"{where}: {centre_size} bytes for the centre of a bucket, which needs 12")
        if full + partial > buckets:
            raise ArtifactError(f"{where}: {full} full and {partial} other buckets, but {buckets} in all")
        lengths = np.frombuffer(buffer, "<u4", partial, at).astype(np.int64)
        if partial and int(lengths.max()) > bucket_size:
            raise ArtifactError(
                f"{where}: a bucket holds {int(lengths.max())} Gaussians, more than {bucket_size}"
            )
        ends = np.cumsum(lengths)
        held = full * bucket_size + (int(ends[-1]) if partial else 0)
        if held < count:
            raise ArtifactError(f"{where}: {count} Gaussians, but its buckets hold {held}")
        if not (math.isfinite(block) and block > 0):
            raise ArtifactError(f"{where}: {block:g} is no edge of a block")
    return (
        _Section(
            count=count,
            records=records,
            centres=centres,
            full=full,
            bucket_size=bucket_size,
            partial=ends,
            block=block,
            scale_range=scale_range or 32767,
            record=record,
        ),
        end,
    )
