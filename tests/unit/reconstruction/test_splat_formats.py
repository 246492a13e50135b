"""Records of `.splat`, and recognition of formats."""

import gzip
import os
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula.schemas.errors import AlulaError, ArtifactError, InputError, UsageError
from alula.stages.reconstruction.formats import registry as formats
from alula.stages.reconstruction.formats.ply import encode_ply
from alula.stages.reconstruction.formats.registry import SplatFile, SplatFormat, read_splats
from alula.stages.reconstruction.formats.source import Source
from alula.stages.reconstruction.formats.splat import OPACITY_LOSS, RECORD, decode_splat
from support.effort import examples


def record(mean=(1, 2, 3), scale=(0.1, 0.2, 0.3), rgba=(10, 20, 30, 255), quat=(255, 128, 128, 128)):
    return struct.pack("<6f8B", *mean, *scale, *rgba, *quat)


def test_a_record_is_read_field_by_field():
    splats = decode_splat(memoryview(record() + record(rgba=(1, 2, 3, 51))))
    np.testing.assert_array_equal(splats.mean[0], [1, 2, 3])
    np.testing.assert_array_equal(splats.scale[0], np.float32([0.1, 0.2, 0.3]))
    np.testing.assert_array_equal(splats.color, [[10, 20, 30], [1, 2, 3]])
    np.testing.assert_allclose(splats.opacity, [1, 0.2], rtol=1e-7)
    assert splats.quat_wxyz[0, 0] == 1


def test_negative_scales_are_read_as_their_absolute_value():
    splats = decode_splat(memoryview(record(scale=(-0.1, 0.2, 0.3)) + record()))
    assert (splats.scale > 0).all()
    assert "1 rows with a negative scale" in splats.notes[0]


WRITERS = {
    "reference": lambda q: np.clip(np.floor(q * 128 + 128), 0, 255),
    "rounding": lambda q: np.clip(np.rint(q * 128 + 128), 0, 255),
    "whole range": lambda q: np.rint((q + 1) * 127.5),
}


@pytest.mark.parametrize("writer", WRITERS)
def test_the_rotation_is_lost_by_no_more_than_recorded(writer):
    rng = np.random.default_rng(0)
    q = rng.normal(size=(20_000, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    stored = WRITERS[writer](q).astype(np.uint8)
    splats = decode_splat(memoryview(b"".join(record(quat=row) for row in stored)))
    read = splats.quat_wxyz.astype(np.float64)
    read /= np.linalg.norm(read, axis=1, keepdims=True)
    angle = 2 * np.arccos(np.clip(np.abs((read * q).sum(axis=1)), 0, 1))
    bound = splats.loss.bound[:, 2]
    assert (angle <= bound).all()
    assert angle.max() > 0.3 * bound.max()
    assert (np.degrees(bound) < 1.83).all()


@settings(max_examples=examples(60), deadline=None)
@given(st.floats(0, 1))
def test_the_opacity_is_lost_by_no_more_than_recorded(alpha):
    for stored in (int(alpha * 255), round(alpha * 255)):
        read = decode_splat(memoryview(record(rgba=(0, 0, 0, stored)))).opacity[0]
        assert abs(read - alpha) <= OPACITY_LOSS + 1e-7


@settings(max_examples=examples(200), deadline=None)
@given(st.binary(max_size=200))
def test_any_bytes_are_records_or_refused(raw):
    try:
        splats = decode_splat(memoryview(raw))
    except AlulaError:
        assert len(raw) == 0 or len(raw) % 32
    else:
        assert len(splats) == len(raw) // 32


def some_ply():
    return b"".join(encode_ply(decode_splat(memoryview(record()))))


def zipped(path, member):
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(member, "{}")


def test_the_content_decides_before_the_suffix(tmp_path):
    path = tmp_path / "named.splat"
    path.write_bytes(some_ply())
    assert read_splats(path).format == "ply"
    path.write_bytes(record())
    assert read_splats(path).format == "splat"
    bare = tmp_path / "bare"
    bare.write_bytes(record())
    with pytest.raises(ArtifactError, match="--format forces one"):
        read_splats(bare)
    assert len(read_splats(bare, "splat")) == 1
    with pytest.raises(ArtifactError, match="not a PLY file"):
        read_splats(bare, "ply")


def test_what_is_no_splat_is_refused(tmp_path):
    zipped(tmp_path / "b.npz", "manifest.json")
    with pytest.raises(ArtifactError, match="not a splat file"):
        read_splats(tmp_path / "b.npz")
    for raw in (b"PK\x03\x04 broken", b"\x1f\x8b broken", gzip.compress(b"text"), b"{}", b"\x00"):
        (tmp_path / "c").write_bytes(raw)
        with pytest.raises(ArtifactError, match=r"not a splat file|SOG|SPZ|unpack it"):
            read_splats(tmp_path / "c")


def test_the_last_iteration_of_a_trainers_folder_is_taken(tmp_path):
    for iteration, x in ((7000, 1), (30000, 2), (800, 3)):
        place = tmp_path / f"run/point_cloud/iteration_{iteration}"
        place.mkdir(parents=True)
        (place / "point_cloud.ply").write_bytes(
            b"".join(encode_ply(decode_splat(memoryview(record((x, 0, 0))))))
        )
    found = SplatFile.find(tmp_path / "run")
    assert list(found.files()) == ["splat"]
    assert found.files()["splat"].parent.name == "iteration_30000"
    splats = found.decode()
    assert splats.mean[0, 0] == 2
    assert splats.notes[0] == "iteration 30000 of the folder, the last of 3"


@pytest.mark.parametrize("name", ["../a", "/etc/passwd", "a/../../b", "", "a\\b", "c:d", "x\0y"])
def test_names_inside_files_stay_in_the_folder(tmp_path, name):
    with pytest.raises(ArtifactError, match="no name of a file in the same folder"):
        Source(tmp_path / "meta.json").member(name)


def test_members_that_are_missing_or_empty_are_named(tmp_path):
    (tmp_path / "empty.webp").touch()
    with pytest.raises(ArtifactError, match=r"empty\.webp: is empty"):
        Source(tmp_path).member("empty.webp")
    with pytest.raises(ArtifactError, match=r"none\.webp: does not exist"):
        Source(tmp_path).member("none.webp")


def test_files_that_cannot_be_opened(tmp_path):
    (tmp_path / "empty.ply").touch()
    with pytest.raises(ArtifactError, match="is empty"):
        read_splats(tmp_path / "empty.ply")
    with pytest.raises(InputError, match="does not exist"):
        read_splats(tmp_path / "none.ply")
    with pytest.raises(InputError, match="is a folder, but of no kind"):
        read_splats(tmp_path)
    with pytest.raises(UsageError, match=r"--format must be auto, compressed-ply, ply, .*splat, not 'obj'"):
        read_splats(tmp_path / "empty.ply", "obj")


class Entry:
    def __init__(self, name, value):
        self.name, self.value = name, "somewhere"
        self.load = lambda: value


def test_other_packages_can_add_a_format(tmp_path, monkeypatch):
    added = SplatFormat(
        "tiny", lambda source: source.head[:4] == b"TINY", lambda source, p: decode_splat(source.data[4:])
    )
    monkeypatch.setattr(formats, "entry_points", lambda group: [Entry("tiny", added)])
    path = tmp_path / "x.splat"
    path.write_bytes(b"TINY" + record())
    np.testing.assert_array_equal(read_splats(path).mean, [[1, 2, 3]])
    assert len(read_splats(path, "tiny")) == 1
    monkeypatch.setattr(formats, "entry_points", lambda group: [Entry("bad", 3)])
    with pytest.raises(InputError, match="entry point bad"):
        read_splats(path)


def data(name):
    root = os.environ.get("ALULA_DATA")
    if not root:
        pytest.skip("ALULA_DATA is not set")
    return Path(root) / name


@pytest.mark.parametrize(
    ("name", "count", "lower", "upper", "opacity"),
    [
        ("tile_x000_y003", 53474, [-2.048, -17.717, -5.234], [39.735, 11.531, 11.124], 0.122),
        ("tile_x001_y000", 33620, [29.006, -101.669, -10.823], [77.854, -58.775, 14.309], 0.392),
        ("tile_x001_y001", 88325, [18.639, -77.511, -10.398], [70.004, -30.108, 14.309], 0.804),
    ],
)
def test_the_street_has_the_recorded_counts_and_bounds(name, count, lower, upper, opacity):
    splats = read_splats(data(f"istanbul-outdoor/{name}.splat"))
    assert len(splats) == count
    np.testing.assert_allclose(splats.mean.min(0), lower, atol=5.1e-4)
    np.testing.assert_allclose(splats.mean.max(0), upper, atol=5.1e-4)
    assert np.median(splats.opacity) == pytest.approx(opacity, abs=5.1e-4)


def test_ply_and_splat_of_one_scene_agree():
    stem = "tiny-conformance/test-splat.3-points-from-train"
    exact, lossy = read_splats(data(stem + ".ply")), read_splats(data(stem + ".splat"))
    nearest = np.linalg.norm(exact.mean[:, None] - lossy.mean, axis=2).argmin(axis=1)  # the order differs
    np.testing.assert_array_equal(exact.mean, lossy.mean[nearest])
    np.testing.assert_allclose(exact.scale, lossy.scale[nearest], rtol=1e-6)
    np.testing.assert_allclose(exact.opacity, lossy.opacity[nearest], atol=OPACITY_LOSS)
    q = exact.quat_wxyz / np.linalg.norm(exact.quat_wxyz, axis=1, keepdims=True)
    r = lossy.quat_wxyz[nearest]
    r = r / np.linalg.norm(r, axis=1, keepdims=True)
    angle = 2 * np.arccos(np.clip(np.abs((q * r).sum(axis=1)), 0, 1))
    assert (angle <= lossy.loss.bound[nearest, 2]).all()


@pytest.mark.parametrize("folder", ["tiny-conformance", "usd3dgs-fixtures-spz", "cc0-corpus"])
def test_every_other_public_file_is_read_or_refused_in_words(folder):
    for path in sorted(data(folder).iterdir()):
        try:
            assert len(read_splats(path)) > 0
        except AlulaError as error:
            message = str(error)
            assert message.startswith(str(path))


@pytest.mark.parametrize("length", [1.0, 0.5, 0.1, 0.02])
@pytest.mark.parametrize("middle", [128.0, 127.5])
@pytest.mark.parametrize("rounding", [np.floor, np.rint])
def test_a_short_quaternion_is_known_the_worse(length, middle, rounding):
    """Of writers that do not normalise: the same error of the bytes is a larger angle."""
    rng = np.random.default_rng(4)
    true = rng.normal(size=(20_000, 4))
    true *= length / np.linalg.norm(true, axis=1, keepdims=True)
    rows = np.zeros(len(true), RECORD)
    rows["scale"] = 0.1
    rows["quat"] = np.clip(rounding(true * middle + middle), 0, 255)
    splats = decode_splat(memoryview(rows.tobytes()))
    stored = splats.quat_wxyz / np.linalg.norm(splats.quat_wxyz, axis=1, keepdims=True)
    unit = true / length
    chord = np.minimum(np.linalg.norm(stored - unit, axis=1), np.linalg.norm(stored + unit, axis=1))
    angle = 4 * np.arcsin(np.minimum(chord / 2, 1))
    assert (angle <= splats.loss.bound[:, 2] + 4e-7).all()
