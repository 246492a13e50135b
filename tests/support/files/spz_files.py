"""SPZ files written from the text of the specification, and scenes compared."""

import gzip
import os
import struct
from pathlib import Path

import numpy as np
import pytest

from alula.stages.reconstruction.formats.splats import SH_C0, Splats
from alula.stages.reconstruction.formats.spz import decode_spz

ORDER = ("positions", "alphas", "colors", "scales", "rotations", "sh")
HARMONICS = (0, 3, 8, 15, 24)
WIDTH = {1: (6, 3), 2: (9, 3), 3: (9, 4), 4: (9, 4)}  # bytes of a position and of a rotation


def random_scene(rng, count, reach=100.0):
    quat = rng.normal(size=(count, 4))
    return Splats(
        format="random",
        mean=rng.uniform(-reach, reach, (count, 3)).astype(np.float32),
        scale=np.exp(rng.uniform(-9.9, 5.9, (count, 3))).astype(np.float32),
        quat_wxyz=(quat * rng.uniform(0.1, 10, (count, 1))).astype(np.float32),
        opacity=rng.uniform(0, 1, count).astype(np.float32),
        color=rng.integers(0, 256, (count, 3)).astype(np.uint8),
    )


def arrays_of(rng, version, count, degree=0):
    """Random bytes for each array; any are valid but for centres that are not numbers."""
    position, rotation = WIDTH[version]
    widths = (position, 1, 3, 3, rotation, 3 * HARMONICS[degree])
    arrays = {
        name: rng.integers(0, 256, width * count).astype(np.uint8).tobytes()
        for name, width in zip(ORDER, widths, strict=True)
    }
    if version == 1:
        arrays["positions"] = rng.normal(size=3 * count).astype("<f2").tobytes()
    return arrays


def file_of(
    version, count, arrays, *, degree=0, bits=12, flags=0, extensions=b"", container=None, magic=b"NGSP"
):
    """An SPZ file, written from the text of the specification."""
    short = struct.pack("<4sIIBBB", magic, version, count, degree, bits, flags)
    if container is None:
        container = "zstd" if version == 4 else "gzip"
    if container == "zstd":
        import zstandard

        used = [arrays[name] for name in ORDER if arrays[name]]
        frames = [zstandard.compress(raw) for raw in used]
        header = short + struct.pack("<BI12x", len(used), 32 + len(extensions))
        table = b"".join(struct.pack("<QQ", len(f), len(u)) for f, u in zip(frames, used, strict=True))
        return header + extensions + table + b"".join(frames)
    raw = short + b"\0" + b"".join(arrays[name] for name in ORDER) + extensions
    return gzip.compress(raw, mtime=0) if container == "gzip" else raw


def record(kind, payload):
    return struct.pack("<II", kind, len(payload)) + payload


def read(raw):
    return decode_spz(memoryview(raw))


def angles(q, r):
    q, r = (
        v.astype(np.float64) / np.linalg.norm(v.astype(np.float64), axis=1, keepdims=True) for v in (q, r)
    )
    r = r * np.where((q * r).sum(axis=1) < 0, -1, 1)[:, None]
    return 4 * np.arcsin(np.minimum(np.linalg.norm(q - r, axis=1) / 2, 0.5**0.5))


def differences(true, found):
    """Of each Gaussian, what `Loss.bound` is a bound of."""
    away = np.linalg.norm(true.mean.astype(np.float64) - found.mean, axis=1)
    longer = (true.scale.astype(np.float64) / found.scale - 1).max(axis=1)
    return np.column_stack([away, longer, angles(true.quat_wxyz, found.quat_wxyz)])


def within(true, found):
    off = differences(true, found)
    assert (off <= found.loss.bound).all()
    assert np.abs(true.opacity.astype(np.float64) - found.opacity).max() <= found.loss.opacity
    return (off / found.loss.bound).max(axis=0)


def agrees(ours, theirs):
    np.testing.assert_array_equal(ours.mean, theirs.means)
    np.testing.assert_allclose(ours.scale, np.exp(theirs.scales.astype(np.float64)), rtol=1e-6)
    np.testing.assert_allclose(ours.quat_wxyz, theirs.quats, atol=3e-5)  # a root of single precision
    np.testing.assert_allclose(
        ours.opacity, 1 / (1 + np.exp(-theirs.opacities.astype(np.float64))), atol=2e-6
    )
    color = np.clip(0.5 + SH_C0 * theirs.sh0.astype(np.float64), 0, 1) * 255
    assert np.abs(ours.color - color).max() <= 0.5 + 1e-4


def data(name):
    root = os.environ.get("ALULA_DATA")
    if not root:
        pytest.skip("ALULA_DATA is not set")
    return Path(root) / name
