"""antimatter15's `.splat`: 32-byte records without a header."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from alula.schemas.errors import ArtifactError
from alula.schemas.progress import Progress
from alula.stages.reconstruction.formats.rotations import whole_rotation_error
from alula.stages.reconstruction.formats.source import let_go
from alula.stages.reconstruction.formats.splats import Loss, Splats, loss_bound, rounded_up

RECORD = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("quat", "u1", 4)])
_CHUNK = 2**18

LEAST = 8
"""Minimum number of records that tell whether a file is one; fewer show too little."""

FARTHEST, LARGEST, SMALLEST = 1e7, 1e6, 1e-12  # plausible positions, and scales; the least of both unless 0
_SPREAD = 256  # records that are looked at

# Writers truncate or round, with 128 or 127.5 as the middle: apart from a common factor of at most 256/255,
# which normalisation removes, a component read as b / 127.5 - 1 has an error of at most 2/255 for every
# writer, and a vector of four components one of at most 4/255.
QUATERNION_LOSS = 4.0 / 255.0
OPACITY_LOSS = 1.0 / 255.0


def count_splat(buffer: memoryview) -> int:
    """Number of Gaussians of a `.splat` file.

    Raises:
        ArtifactError: the file is empty, not a whole number of records, or of sizes that no scene has.
    """
    if len(buffer) == 0:
        raise ArtifactError(".splat: is empty")
    if len(buffer) % RECORD.itemsize:
        raise ArtifactError(
            f".splat: truncated, or of another format: {len(buffer)} bytes are no whole number of "
            f"{RECORD.itemsize}-byte records"
        )
    _check_sizes(buffer)
    return len(buffer) // RECORD.itemsize


def has_plausible_size(rows: NDArray[np.void]) -> NDArray[np.bool_]:
    """Test each record: position and scale are finite, neither huge nor tiny, and some scale is not 0.

    Args:
        rows: of the type `RECORD`, shape (N,).
    """
    mean, scale = np.abs(rows["mean"]), np.abs(rows["scale"])  # comparisons with NaN are false
    plausible: NDArray[np.bool_] = (
        ((mean == 0) | ((mean >= SMALLEST) & (mean <= FARTHEST))).all(axis=1)
        & ((scale == 0) | ((scale >= SMALLEST) & (scale <= LARGEST))).all(axis=1)
        & (scale > 0).any(axis=1)
    )
    return plausible


def _check_sizes(buffer: memoryview) -> None:
    """Check that at least half of a sample of the records are plausible; the format has no magic number."""
    count = len(buffer) // RECORD.itemsize
    if count < LEAST:
        return
    rows = np.frombuffer(buffer, RECORD)[np.unique(np.linspace(0, count - 1, _SPREAD).astype(np.int64))]
    with np.errstate(invalid="ignore"):
        finite = np.isfinite(rows["mean"]).all(axis=1) & np.isfinite(rows["scale"]).all(axis=1)
        wild = finite & ~has_plausible_size(rows)
    if np.count_nonzero(wild) > 0.5 * np.count_nonzero(finite):
        raise ArtifactError(
            f".splat: {np.count_nonzero(wild)} of {len(rows)} records have positions or sizes that no scene "
            f"has (above {FARTHEST:g} or below {SMALLEST:g} file units): of another format, or damaged"
        )


def decode_splat(buffer: memoryview, progress: Progress | None = None, window: slice = slice(None)) -> Splats:
    """Decode a `.splat` file: position, linear scale, colour with alpha, quaternion bytes w, x, y, z.

    Position and scale are exact; the loss of rotation and opacity is recorded. Some writers do not normalise
    quaternions; the error bound of one shorter than 1 grows as its length decreases. A negative scale renders
    like its absolute value and is read as such.

    Args:
        window: rows to decode.

    Raises:
        ArtifactError: the file is empty, or not a whole number of records.
    """
    first, end, _ = window.indices(count_splat(buffer))
    rows = np.frombuffer(buffer, RECORD)[first:end]
    count = len(rows)
    mean, scale = np.empty((count, 3), np.float32), np.empty((count, 3), np.float32)
    quat, color = np.empty((count, 4), np.float32), np.empty((count, 3), np.uint8)
    opacity, bound = np.empty(count, np.float32), loss_bound(count)
    negative = 0
    for start in range(0, count, _CHUNK):
        part = slice(start, min(start + _CHUNK, count))
        chunk = rows[part]
        mean[part] = chunk["mean"]
        scale[part] = np.abs(chunk["scale"])
        negative += int((chunk["scale"] < 0).any(axis=1).sum())
        quat[part] = chunk["quat"] / 127.5 - 1.0
        bound[part, 2] = rounded_up(np.minimum(whole_rotation_error(quat[part], QUATERNION_LOSS), np.pi))
        color[part] = chunk["rgba"][:, :3]
        opacity[part] = chunk["rgba"][:, 3] / 255.0
        let_go(buffer, (first + part.start) * RECORD.itemsize, (first + part.stop) * RECORD.itemsize)
        if progress is not None:
            progress(part.stop, count)
    return Splats(
        format="splat",
        mean=mean,
        scale=scale,
        quat_wxyz=quat,
        opacity=opacity,
        color=color,
        loss=Loss(bound, OPACITY_LOSS),
        notes=(f"{negative} rows with a negative scale, read as positive",) if negative else (),
    )


def encode_splat(splats: Splats) -> Iterator[bytes]:
    """Encode a `.splat` file, in parts; inverse of `decode_splat`, rounding to nearest.

    Positions and scales are exact; quaternions are normalised and stored as (q + 1) 127.5, opacities as
    255 alpha, both rounded. The format stores nothing else.

    Args:
        splats: the Gaussians to write, file frame and units.
    """
    for start in range(0, len(splats), _CHUNK):
        part = slice(start, min(start + _CHUNK, len(splats)))
        rows = np.empty(part.stop - start, RECORD)
        rows["mean"], rows["scale"] = splats.mean[part], splats.scale[part]
        rows["rgba"][:, :3] = splats.color[part]
        rows["rgba"][:, 3] = np.rint(np.clip(splats.opacity[part], 0, 1) * 255.0)
        quat = splats.quat_wxyz[part].astype(np.float64)
        rows["quat"] = np.rint((quat / np.linalg.norm(quat, axis=1, keepdims=True) + 1.0) * 127.5)
        yield rows.tobytes()
