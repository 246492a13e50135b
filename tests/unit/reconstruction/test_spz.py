"""SPZ: all versions are read according to the specification, for all writers."""

import gzip
import io
import struct
from itertools import pairwise

import numpy as np
import pytest

from alula.stages.reconstruction.formats import spz
from alula.stages.reconstruction.formats.registry import read_splats
from alula.stages.reconstruction.formats.splats import SH_C0
from alula.stages.reconstruction.formats.spz import decode_spz, encode_spz
from alula.stages.reconstruction.import_splat import turned
from support.files.spz_files import (
    agrees,
    arrays_of,
    data,
    file_of,
    random_scene,
    read,
    record,
    within,
)


def expected_row(version, arrays, i, bits):
    """One Gaussian, field by field, without NumPy."""
    if version == 1:
        mean = struct.unpack_from("<3e", arrays["positions"], 6 * i)
    else:
        coded = [arrays["positions"][9 * i + 3 * k : 9 * i + 3 * k + 3] for k in range(3)]
        mean = [int.from_bytes(c, "little", signed=True) / 2**bits for c in coded]
    scale = [np.exp(u / 16 - 10) for u in arrays["scales"][3 * i : 3 * i + 3]]
    sh0 = [(u / 255 - 0.5) / 0.15 for u in arrays["colors"][3 * i : 3 * i + 3]]
    color = [round(255 * min(1, max(0, 0.5 + SH_C0 * c))) for c in sh0]
    if version < 3:
        xyz = [u / 127.5 - 1 for u in arrays["rotations"][3 * i : 3 * i + 3]]
        quat = [*xyz, max(0.0, 1 - sum(v * v for v in xyz)) ** 0.5]
    else:
        code = int.from_bytes(arrays["rotations"][4 * i : 4 * i + 4], "little")
        largest, quat = code >> 30, [0.0] * 4
        for place in (3, 2, 1, 0):
            if place != largest:
                quat[place] = 0.5**0.5 * (code & 511) / 511 * (-1 if code >> 9 & 1 else 1)
                code >>= 10
        quat[largest] = max(0.0, 1 - sum(v * v for v in quat)) ** 0.5
    return mean, scale, color, [quat[3], *quat[:3]], arrays["alphas"][i] / 255


@pytest.mark.parametrize("degree", range(5))
@pytest.mark.parametrize("version", [1, 2, 3, 4])
def test_every_version_is_read_field_by_field(version, degree):
    rng = np.random.default_rng(10 * version + degree)
    arrays = arrays_of(rng, version, 50, degree)
    splats = read(file_of(version, 50, arrays, degree=degree, bits=9, flags=degree % 2))
    for i in range(50):
        mean, scale, color, quat, alpha = expected_row(version, arrays, i, 9)
        np.testing.assert_array_equal(splats.mean[i], np.float32(mean))
        np.testing.assert_allclose(splats.scale[i], scale, rtol=1e-7)
        np.testing.assert_array_equal(splats.color[i], color)
        np.testing.assert_allclose(splats.quat_wxyz[i], quat, atol=1e-7)
        assert splats.opacity[i] == np.float32(alpha)
    assert splats.tags["antialiased"] == str(degree % 2)
    assert splats.tags["frame"] == "RUB by the specification; writers differ"
    assert "--turn x" in splats.notes[0]


def test_rows_are_the_same_whatever_the_chunks(monkeypatch):
    raw = file_of(3, 1000, arrays_of(np.random.default_rng(0), 3, 1000))
    whole, seen = read(raw), []
    monkeypatch.setattr(spz, "_CHUNK", 64)
    parts = decode_spz(memoryview(raw), lambda done, total: seen.append((done, total)))
    for name in ("mean", "scale", "quat_wxyz", "opacity", "color"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(parts, name))
    np.testing.assert_array_equal(whole.loss.bound, parts.loss.bound)
    assert seen[0] == (64, 1000)
    assert seen[-1] == (1000, 1000)


FRAMES = [
    "LDB",
    "RDB",
    "LUB",
    "RUB",
    "LDF",
    "RDF",
    "LUF",
    "RUF",
    "LFD",
    "RFD",
    "LFU",
    "RFU",
    "LBD",
    "RBD",
    "LBU",
    "RBU",
]


@pytest.mark.parametrize("version", [2, 3, 4])
def test_the_frame_that_a_file_names_is_told(version):
    arrays = arrays_of(np.random.default_rng(0), version, 3, 1)
    for value in range(18):
        extensions = record(0xDEAD0001, b"unknown") + record(0xADBE0003, struct.pack("<I", value))
        raw = file_of(version, 3, arrays, degree=1, flags=2, extensions=extensions)
        found = read(raw)
        if 1 <= value <= 16:
            assert found.tags["frame"] == FRAMES[value - 1]
            assert not found.notes[: -len(found.loss.unbounded) or None]
        else:
            assert found.tags["frame"].startswith("RUB by")
            assert "a frame that the format does not have" in found.notes[1]


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize(
    "extensions", [b"EXTBYTES", record(0xADBE0003, b"\4\0\0\0")[:-1], record(0xADBE0003, b"\4"), b"\1\2\3"]
)
def test_broken_extensions_are_passed_over_with_a_note(version, extensions):
    found = read(
        file_of(version, 3, arrays_of(np.random.default_rng(0), version, 3), flags=2, extensions=extensions)
    )
    assert found.tags["frame"].startswith("RUB by")
    assert any("not read" in note or "does not have" in note for note in found.notes)


def test_the_stream_may_have_members_and_an_end():
    arrays = arrays_of(np.random.default_rng(0), 2, 40)
    raw = file_of(2, 40, arrays, container="raw")
    expected = read(gzip.compress(raw))
    for cuts in ([300], [0, 3, 16, 16, 700], list(range(0, len(raw), 7))):
        ends = [0, *cuts, len(raw)]
        members = b"".join(gzip.compress(raw[a:b]) for a, b in pairwise(ends))
        for tail in (b"", b"tail", gzip.compress(b"more")):
            found = read(members + tail)
            np.testing.assert_array_equal(found.mean, expected.mean)
            np.testing.assert_array_equal(found.quat_wxyz, expected.quat_wxyz)
            said = [note for note in found.notes if "bytes follow the data" in note]
            assert said == (
                [f"{len(tail)} bytes follow the data that the header announces; they were not read"]
                if tail
                else []
            )
    with_name = io.BytesIO()
    with gzip.GzipFile("a name " * 1000, "wb", fileobj=with_name) as file:
        file.write(raw)
    np.testing.assert_array_equal(read(with_name.getvalue()).mean, expected.mean)
    assert "6 bytes follow the data" in read(gzip.compress(raw + b"EXTRA!")).notes[1]
    found = read(raw)
    np.testing.assert_array_equal(found.mean, expected.mean)
    assert "not compressed" in found.notes[1]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("version", [2, 3, 4])
@pytest.mark.parametrize("degree", [0, 3])
def test_gsply_reads_the_same(tmp_path, version, degree):
    gsply_spz = pytest.importorskip("gsply.spz")
    rng = np.random.default_rng(version)
    path = tmp_path / "a.spz"
    path.write_bytes(file_of(version, 3000, arrays_of(rng, version, 3000, degree), degree=degree))
    agrees(read_splats(path), gsply_spz.read_spz(path))
    path.write_bytes(b"".join(encode_spz(random_scene(rng, 3000), version, "text " * 100)))
    agrees(read_splats(path), gsply_spz.read_spz(path))


@pytest.mark.every(2)
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    ("name", "count", "lower", "upper"),
    [
        ("cc0-corpus/leica-sofort-top8192", 8_192, [-0.2480, -0.2493, -0.2417], [0.2417, 0.0884, 0.1460]),
        ("fourth-st-spz/fourth_st", 131_199, [-0.1248, -0.1563, -0.0793], [0.1245, 0.1382, 0.0791]),
        ("tiny-conformance/gsplat-rs-minimal_v4_degree0", 8, [0, -0.875, 1], [1.75, 0, 1.4375]),
        ("tiny-conformance/adobe-SanitySplats", 10, [0, 0, 0], [1.6001, 1.6001, 1.6001]),
    ],
)
def test_public_files_are_read_as_gsply_does(name, count, lower, upper):
    path = data(name + ".spz")
    found = read_splats(path)
    assert len(found) == count
    np.testing.assert_allclose(found.mean.min(0), lower, atol=6e-5)
    np.testing.assert_allclose(found.mean.max(0), upper, atol=6e-5)
    assert not found.loss.unbounded
    agrees(found, pytest.importorskip("gsply.spz").read_spz(path))
    again = read(b"".join(encode_spz(found)))
    within(found, again)


def test_the_same_scene_in_other_formats_agrees():
    stem = "tiny-conformance/splat-transform-minimal"
    exact = read_splats(data(stem + ".splat"))
    for name in ("-v2", "-raw", "-v3", "-v4"):
        found = read_splats(data(f"{stem}{name}.spz"))
        found = turned(found, "x" if name in ("-v3", "-v4") else "none")  # these writers turned it
        nearest = np.linalg.norm(exact.mean[:, None] - found.mean, axis=2).argmin(axis=1)
        assert sorted(nearest) == [0, 1, 2, 3]
        np.testing.assert_array_equal(exact.mean, found.mean[nearest])
        assert np.abs(exact.scale / found.scale[nearest] - 1).max() <= spz.SCALE_LOSS
        np.testing.assert_allclose(exact.opacity, found.opacity[nearest], atol=1e-6)
    train = "tiny-conformance/test-splat.3-points-from-train"
    exact, found = read_splats(data(train + ".ply")), read_splats(data(train + ".spz"))
    off = [
        np.linalg.norm(exact.mean[:, None] - turned(found, turn).mean, axis=2).min(axis=1).max()
        for turn in ("none", "x")
    ]
    assert min(off) <= found.loss.bound[0, 0]
