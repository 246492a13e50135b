"""Niantic's `.spz`: fixed-point centres, logarithmic scales, and quaternions without one component."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from alula.schemas.errors import InputError
from alula.schemas.progress import Progress
from alula.stages.coordinates import spacing
from alula.stages.reconstruction.formats.rotations import chart_rotation_error, smallest_three
from alula.stages.reconstruction.formats.splats import (
    Loss,
    Properties,
    Splats,
    color_from_sh0,
    exp,
    loss_bound,
    rounded_up,
    sh0_from_color,
)
from alula.stages.reconstruction.formats.spz_container import Header, Packed, pack, unpack

_CHUNK = 2**16
COLOR_SCALE = 0.15  # of the constant harmonic, in place of SH_C0
_BITS = 12  # fractional bits, as of other writers
_MIN_STEPS = 2**15  # from the origin to the farthest coordinate
_ROOT_HALF = math.sqrt(0.5)  # no component but the largest of a unit quaternion exceeds it

# All known writers (Niantic's own and its ports, Spark, gsply) round to nearest, so the error of a code is at
# most 0.5. They compute in single precision, with sums of at most 256, which adds less than 2e-6 to a
# logarithm and less than 1e-6 to components of quaternions. Positions times a power of two are exact.
SCALE_LOSS = math.expm1(1.0 / 32.0 + 2e-6)
OPACITY_LOSS = 1.0 / 510.0 + 1e-6
BYTE_LOSS = math.sqrt(3.0) * (1.0 / 255.0 + 1e-6)  # of the vector x, y, z, versions 1 and 2
THREE_LOSS = math.sqrt(3.0) * (_ROOT_HALF / 1022.0 + 1e-6)  # of the three that versions 3 and 4 store

FRAME_UNKNOWN = "RUB by the specification; writers differ"
_FRAME_NOTE = (
    "the file does not name its frame: the specification says RUB (right, up, back), but some writers store "
    "the .ply's unchanged; where the writer turned it, --turn x gives the frame of the .ply again"
)


def decode_spz(buffer: memoryview, progress: Progress | None = None) -> Splats:
    """Decode an SPZ file of version 1 to 4; higher harmonics are skipped, and the frame does not change.

    centre = code / 2^fractionalBits (half precision in version 1), scale = exp(u / 16 - 10), opacity =
    u / 255; the component of the quaternion that is not stored is not negative. The bounds of rounding errors
    are recorded: one number each for centres and scales, and one per Gaussian for rotations, because the
    error of the missing component grows as it becomes smaller.

    Raises:
        ArtifactError: damaged, truncated, of another version, or not SPZ.
    """
    packed = unpack(buffer)
    count, version = packed.header.count, packed.header.version
    mean, scale = np.empty((count, 3), np.float32), np.empty((count, 3), np.float32)
    quat, color = np.empty((count, 4), np.float32), np.empty((count, 3), np.uint8)
    opacity = np.empty(count, np.float32)
    fixed = 3**0.5 * 2.0 ** -(packed.header.fractional_bits + 1)
    bound = loss_bound(count, position=0.0 if version == 1 else fixed, scale=SCALE_LOSS)
    code = np.arange(256)
    scale_of = exp(code / 16.0 - 10.0).astype(np.float32)
    color_of = color_from_sh0((code / 255.0 - 0.5) / COLOR_SCALE)
    far = longest = 0
    for start in range(0, count, _CHUNK):
        part = slice(start, min(start + _CHUNK, count))
        if version == 1:
            mean[part], bound[part, 0], outer = _half_positions(packed, part)
        else:
            mean[part], outer = _fixed_positions(packed, part)
        far += outer
        codes = packed.rows("scales", part)
        longest += int((codes == 255).any(axis=1).sum())
        scale[part] = scale_of[codes]
        opacity[part] = packed.rows("alphas", part)[:, 0] / 255.0
        color[part] = color_of[packed.rows("colors", part)]
        quat[part], angle = (_byte_rotations if version < 3 else _three_rotations)(packed, part)
        bound[part, 2] = rounded_up(np.minimum(angle, np.pi))
        if progress is not None:
            progress(part.stop, count)

    frame = packed.frame
    unbounded = {}
    if far:
        unbounded["position"] = (
            f"{far} centres lie in the outer half of what the format can hold, and writers move those "
            "that it cannot hold"
        )
    if longest:
        unbounded["scale"] = (
            f"{longest} Gaussians have a semi-axis of {scale_of[255]:.4g}, the longest that the format can "
            "hold; theirs may have been longer"
        )
    return Splats(
        format="spz",
        mean=mean,
        scale=scale,
        quat_wxyz=quat,
        opacity=opacity,
        color=color,
        loss=Loss(bound, OPACITY_LOSS, unbounded),
        tags={
            "antialiased": str(packed.header.flags & 1),
            "frame": frame if frame is not None else FRAME_UNKNOWN,
        },
        notes=(*(() if frame is not None else (_FRAME_NOTE,)), *packed.notes),
        properties=Properties(unknown=packed.unknown),
    )


def _fixed_positions(packed: Packed, part: slice) -> tuple[NDArray[np.float32], int]:
    """Centres, and the number of those beyond half of the range.

    In Niantic's writer, codes beyond 23 bits wrap around; other writers clamp them to the range. Neither can
    be detected with certainty, but a scene with all centres within half of the range is far from both.
    """
    low, middle, high = packed.rows("positions", part).reshape(-1, 3, 3).transpose(2, 0, 1)
    code = low.astype(np.int32) | middle.astype(np.int32) << 8 | high.view(np.int8).astype(np.int32) << 16
    outer = int((np.abs(code) > 2**22).any(axis=1).sum())
    return np.ldexp(code.astype(np.float32), -packed.header.fractional_bits), outer


def _half_positions(packed: Packed, part: slice) -> tuple[NDArray[np.float32], NDArray[np.float32], int]:
    """Centres, their error bounds, and the number of those at the limit of half precision.

    Writers round to half precision or truncate, so the error is less than one unit in the last place.
    """
    half = packed.rows("positions", part).view("<f2").reshape(-1, 3)
    with np.errstate(invalid="ignore"):
        unit = spacing(half.astype(np.float16))
        off = np.sqrt((unit * unit).sum(axis=1))
    outer = int((np.abs(half) >= 32768).any(axis=1).sum())
    return half.astype(np.float32), rounded_up(np.where(np.isfinite(off), off, 0.0)), outer


def _byte_rotations(packed: Packed, part: slice) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Quaternions w, x, y, z and their error bounds: x, y, z are bytes, w completes the length to 1."""
    vector = packed.rows("rotations", part) / 127.5 - 1.0
    w = np.sqrt(np.maximum(0.0, 1.0 - (vector * vector).sum(axis=1)))
    return np.column_stack([w, vector]), chart_rotation_error(vector, BYTE_LOSS)


def _three_rotations(packed: Packed, part: slice) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """As `_byte_rotations`, for the index of the largest component in 2 bits and the others in 10, x to w."""
    word = packed.rows("rotations", part).view("<u4")[:, 0].astype(np.int64)
    field = word[:, None] >> np.array([20, 10, 0])
    stored = (field & 511) * (_ROOT_HALF / 511.0) * np.where(field & 512, -1.0, 1.0)
    quat = smallest_three(stored, word >> 30)
    return np.roll(quat, 1, axis=1), chart_rotation_error(stored, THREE_LOSS)


def encode_spz(splats: Splats, version: int = 3, comment: str = "") -> Iterator[bytes]:
    """Encode an SPZ file without higher harmonics, in parts; inverse of `decode_spz`, rounding to nearest.

    Version 3 is the latest that nearly all readers support. Version 2 is older, with errors of rotations up
    to about 18 degrees; version 4 is newer. Centres have 12 fractional bits; fewer where the scene extends
    beyond 1024 units, so that all lie within half of the range, and more where it extends less than 8
    units. Semi-axes below exp(-10) become exp(-10).

    Args:
        splats: the Gaussians to write, file frame and units; no value is NaN or infinite.
        version: 2, 3 or 4.

    Raises:
        InputError: a centre or a semi-axis is too large for the format.
    """
    bits = _fractional_bits(splats)
    count = len(splats)
    longest = math.exp(255.5 / 16.0 - 10.0)
    if large := int((splats.scale >= longest).any(axis=1).sum()):
        raise InputError(
            f"{large} Gaussians have a semi-axis longer than the {longest:.4g} units that SPZ can hold; "
            "import with --max-scale leaves them out, .ply and .splat can hold them"
        )
    alphas = (np.rint(splats.opacity[part] * 255.0) for part in _parts(count))
    colors = (
        np.rint((sh0_from_color(splats.color[part]).astype(np.float64) * COLOR_SCALE + 0.5) * 255.0)
        for part in _parts(count)
    )
    rotations = _three_codes if version > 2 else _byte_codes
    with_codes = {
        "positions": (_fixed_codes(splats.mean[part], bits) for part in _parts(count)),
        "alphas": (_bytes_of(values) for values in alphas),
        "colors": (_bytes_of(values) for values in colors),
        "scales": (_scale_codes(splats.scale[part]) for part in _parts(count)),
        "rotations": (rotations(splats.quat_wxyz[part].astype(np.float64)) for part in _parts(count)),
    }
    return pack(Header(version, count, 0, bits, 0), with_codes, comment)


def _parts(count: int) -> Iterator[slice]:
    return (slice(start, min(start + _CHUNK, count)) for start in range(0, count, _CHUNK))


def _fractional_bits(splats: Splats) -> int:
    """Fractional bits for a scene, with all centres within half of the range of 24 bits."""
    farthest = float(np.abs(splats.mean).max(initial=0.0))
    extent = math.ceil(math.log2(max(farthest, 1e-9)))
    bits = min(max(_BITS, _MIN_STEPS.bit_length() - 1 - extent), 22 - max(extent, 0))
    if bits < 0:
        raise InputError(f"a centre is {farthest:.4g} units away from the origin; SPZ holds at most {2**22}")
    return bits


def _bytes_of(values: NDArray[np.floating]) -> bytes:
    return bytes(np.clip(values, 0, 255).astype(np.uint8))


def _fixed_codes(mean: NDArray[np.float32], bits: int) -> bytes:
    code = np.rint(np.ldexp(mean.astype(np.float64), bits)).astype("<i4")
    return bytes(np.ascontiguousarray(code.view(np.uint8).reshape(-1, 4)[:, :3]))


def _scale_codes(scale: NDArray[np.float32]) -> bytes:
    with np.errstate(divide="ignore"):  # of no thickness: the thinnest there is
        return _bytes_of(np.rint((np.log(scale.astype(np.float64)) + 10.0) * 16.0))


def _byte_codes(quat: NDArray[np.float64]) -> bytes:
    quat = quat / np.linalg.norm(quat, axis=1, keepdims=True)
    vector = quat[:, 1:] * np.where(quat[:, :1] < 0, -1.0, 1.0)
    return _bytes_of(np.rint((vector + 1.0) * 127.5))


def _three_codes(quat: NDArray[np.float64]) -> bytes:
    xyzw = np.roll(quat / np.linalg.norm(quat, axis=1, keepdims=True), -1, axis=1)
    largest = np.abs(xyzw).argmax(axis=1)
    xyzw *= np.where(xyzw[np.arange(len(xyzw)), largest] < 0, -1.0, 1.0)[:, None]
    others = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])[largest]
    stored = np.take_along_axis(xyzw, others, axis=1)
    magnitude = np.minimum(np.rint(np.abs(stored) * (511.0 / _ROOT_HALF)), 511).astype(np.uint32)
    field = magnitude | (stored < 0).astype(np.uint32) << np.uint32(9)
    word = largest.astype(np.uint32) << np.uint32(30) | field[:, 0] << np.uint32(20)
    word |= field[:, 1] << np.uint32(10) | field[:, 2]
    return bytes(word.astype("<u4"))
