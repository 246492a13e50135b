"""Artifacts: round trips, identical bytes, alignment, and all kinds of damage."""

import json
import os
import subprocess
import sys
import zipfile
from contextlib import suppress

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from alula.schemas import errors
from alula.schemas.artifacts import manifest
from alula.schemas.artifacts.artifact import (
    Artifact,
    artifact_hash,
    file_hash,
    in_memory,
    make_artifact,
    read_artifact,
    read_manifest,
    write_artifact,
)
from alula.schemas.artifacts.kinds import KINDS, SCENE, VOXELS
from alula.schemas.artifacts.mapping import let_go
from support.effort import examples


def voxels(index=((0, 0, 0), (0, 0, 1), (5, -2, 3)), **fields):
    index = np.array(index, np.int32).reshape(-1, 3)
    return make_artifact(
        VOXELS,
        {"index": index, "overlap": np.arange(1, len(index) + 1, dtype=np.uint32)},
        frame="world",
        unit="m",
        parameters={"size_m": 0.1},
        summary={"voxels": len(index)},
        voxel_size_m=0.1,
        sigma=1.0,
        min_overlap=1,
        **fields,
    )


@pytest.fixture
def path(tmp_path):
    file = tmp_path / "a.voxels.npz"
    write_artifact(file, voxels())
    return file


def test_what_is_written_is_read_again(path):
    found = read_artifact(path, VOXELS)
    expected = voxels()
    assert found.manifest == expected.manifest
    for name in expected.arrays:
        np.testing.assert_array_equal(found[name], expected[name])


@settings(
    deadline=None, max_examples=examples(40), suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(st.sets(st.tuples(*[st.integers(-(2**31), 2**31 - 1)] * 3), min_size=0, max_size=50))
def test_equal_content_is_equal_bytes_and_rewriting_changes_nothing(tmp_path, rows):
    first, second = tmp_path / "first.npz", tmp_path / "second.npz"
    write_artifact(first, voxels(sorted(rows)))
    write_artifact(second, read_artifact(first))
    assert first.read_bytes() == second.read_bytes()
    assert artifact_hash(read_artifact(first)) == file_hash(first)


def test_large_arrays_are_memory_mapped_at_multiples_of_64_bytes(path, monkeypatch):
    monkeypatch.setattr("alula.schemas.artifacts.artifact.READ_AT_ONCE", 0)
    for array in read_artifact(path).arrays.values():
        assert isinstance(array, np.memmap)
        assert array.offset % 64 == 0
        assert not array.flags.writeable


def test_mapped_arrays_that_were_let_go_are_read_again(path, monkeypatch):
    own = read_artifact(path)
    monkeypatch.setattr("alula.schemas.artifacts.artifact.READ_AT_ONCE", 0)
    mapped = read_artifact(path)
    copied = in_memory(mapped)
    for name, array in mapped.arrays.items():
        assert not np.shares_memory(copied[name], array)
        assert in_memory(copied)[name] is copied[name]
        let_go(array[:2], copied[name])
        for each in (array, copied[name]):
            np.testing.assert_array_equal(each, own[name])


def test_numpy_and_unzip_open_it_without_this_program(path):
    loaded = np.load(path, allow_pickle=False)
    np.testing.assert_array_equal(loaded["index"], voxels()["index"])
    with zipfile.ZipFile(path) as archive:
        assert archive.infolist()[0].filename == "manifest.json"
        manifest = json.loads(archive.read("manifest.json"))
    assert manifest["schema"] == "alula/voxels"
    assert manifest["arrays"]["index"]["shape"] == [3, 3]
    assert list(manifest) == sorted(manifest)


def test_every_prefix_of_a_file_is_refused(path, tmp_path):
    whole = path.read_bytes()
    cut = tmp_path / "cut.npz"
    for length in range(0, len(whole), 7):
        cut.write_bytes(whole[:length])
        with pytest.raises(errors.ArtifactError):
            read_artifact(cut)


def test_no_changed_byte_of_an_array_goes_unnoticed(path, tmp_path, monkeypatch):
    whole = bytearray(path.read_bytes())
    with monkeypatch.context() as mapped:
        mapped.setattr("alula.schemas.artifacts.artifact.READ_AT_ONCE", 0)
        offsets = [(a.offset, a.nbytes) for a in read_artifact(path).arrays.values()]
    changed = tmp_path / "changed.npz"
    for offset, size in offsets:
        for position in range(offset, offset + size):
            damaged = bytearray(whole)
            damaged[position] ^= 0x10
            changed.write_bytes(damaged)
            with pytest.raises(errors.DamagedError):
                read_artifact(changed)


@settings(
    deadline=None, max_examples=examples(300), suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(position=st.integers(0, 10**6), mask=st.integers(1, 255))
def test_a_changed_byte_anywhere_is_refused_or_harmless(path, tmp_path, position, mask):
    damaged = bytearray(path.read_bytes())
    damaged[position % len(damaged)] ^= mask
    changed = tmp_path / "changed.npz"
    changed.write_bytes(damaged)
    try:
        found = read_artifact(changed, VOXELS)
    except errors.InputError:
        return
    np.testing.assert_array_equal(found["index"], voxels()["index"])


def rewrite(path, edit):
    """Change the manifest of a file as `edit` does, leaving the arrays alone."""
    found = read_artifact(path)
    manifest = msgspec.to_builtins(found.manifest)
    edit(manifest)
    with zipfile.ZipFile(path) as archive:
        members = {info.filename: archive.read(info) for info in archive.infolist()}
    members["manifest.json"] = json.dumps(manifest).encode()
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)


@pytest.mark.parametrize(
    ("edit", "error", "words"),
    [
        (lambda m: m.update(version="2.0"), errors.VersionError, "newer"),
        (lambda m: m.update(version="one"), errors.DamagedError, "MAJOR.MINOR"),
        (lambda m: m.update(schema="alula/dream"), errors.WrongKindError, "alula/dream"),
        (lambda m: m.update(schema="alula/scene"), errors.DamagedError, "source"),
        (lambda m: m.update(requires=["colour-of-the-sky"]), errors.VersionError, "colour-of-the-sky"),
        (lambda m: m["arrays"]["index"].update(shape=[4, 3]), errors.DamagedError, "index"),
        (lambda m: m["arrays"].pop("overlap"), errors.DamagedError, "overlap"),
        (lambda m: m["arrays"]["index"].update(sha256="0" * 64), errors.DamagedError, "SHA-256"),
        (lambda m: m.pop("voxel_size_m"), errors.DamagedError, "voxel_size_m"),
    ],
)
def test_a_manifest_that_does_not_fit_is_refused_by_name(path, edit, error, words):
    rewrite(path, edit)
    with pytest.raises(error, match=words):
        read_artifact(path)


def test_a_higher_minor_version_with_unknown_keys_is_read(path):
    rewrite(path, lambda m: m.update(version="1.7", weather="fine"))
    assert read_artifact(path).manifest.version == "1.7"


def test_another_kind_is_refused_by_both_names(path):
    with pytest.raises(errors.WrongKindError, match=r"alula/voxels.*alula/scene"):
        read_artifact(path, SCENE)


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"mean": [[0, 0, np.nan]]}, "mean: not finite in row 0"),
        ({"scale": [[1, 0, 1]]}, "scale: not positive"),
        ({"quat_wxyz": [[1, 1, 0, 0]]}, "unit quaternion"),
        ({"opacity": [1.5]}, "opacity: outside"),
        ({"opacity": [0.5, 0.5]}, "N does not agree"),
        ({"mean": [[0, 0]]}, "shape"),
    ],
)
def test_values_out_of_range_are_refused_when_made_and_when_read(tmp_path, arrays, words):
    good = {
        "mean": np.zeros((1, 3), np.float32),
        "scale": np.ones((1, 3), np.float32),
        "quat_wxyz": np.array([[1, 0, 0, 0]], np.float32),
        "opacity": np.array([0.5], np.float32),
        "color": np.zeros((1, 3), np.uint8),
    }
    fields = {"frame": "scene", "unit": "arbitrary", "parameters": {}, "summary": {}, "source": {}}
    bad = good | {name: np.array(value, np.float32) for name, value in arrays.items()}
    with pytest.raises(errors.ArtifactError, match=words):
        make_artifact(SCENE, bad, **fields)
    honest = make_artifact(SCENE, good, **fields)
    from alula.schemas.artifacts.artifact import describe_arrays

    forged = msgspec.structs.replace(
        honest.manifest, arrays=describe_arrays(SCENE, "scene", "arbitrary", bad)
    )
    write_artifact(tmp_path / "forged.npz", Artifact(forged, bad))
    with pytest.raises(errors.DamagedError):
        read_artifact(tmp_path / "forged.npz")


def test_unsorted_or_repeated_voxels_are_refused():
    with pytest.raises(errors.ArtifactError, match="sorted and unique"):
        voxels(((0, 0, 1), (0, 0, 0)))
    with pytest.raises(errors.ArtifactError, match="sorted and unique"):
        voxels(((0, 0, 0), (0, 0, 0)))


def test_a_pickled_array_is_never_loaded(path, tmp_path):
    with zipfile.ZipFile(path) as archive:
        members = {info.filename: archive.read(info) for info in archive.infolist()}
    import io

    stream = io.BytesIO()
    np.save(stream, np.array([{"a": 1}], object), allow_pickle=True)
    members["overlap.npy"] = stream.getvalue()
    forged = tmp_path / "forged.npz"
    with zipfile.ZipFile(forged, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    with pytest.raises(errors.DamagedError):
        read_artifact(forged)


def test_a_failed_write_leaves_the_old_file_and_no_temporary_one(path):
    before = path.read_bytes()
    good = voxels()
    broken = Artifact(good.manifest, {"index": good["index"], "overlap": np.array([object()])})
    with pytest.raises(TypeError):
        write_artifact(path, broken)
    assert path.read_bytes() == before
    assert [file.name for file in path.parent.iterdir()] == [path.name]


def test_manifests_are_read_without_the_arrays(path):
    assert read_manifest(path).summary == {"voxels": 3}


def test_every_kind_has_a_schema_its_manifest_satisfies(path):
    schema = msgspec.json.schema(KINDS["alula/voxels"].manifest)
    assert "voxel_size_m" in schema["$defs"]["VoxelsManifest"]["required"]


def test_unzip_lists_only_plain_names(path):
    listing = subprocess.run(["python3", "-m", "zipfile", "-l", str(path)], capture_output=True, text=True)
    assert "index.npy" in listing.stdout


def npy(shape: str, data: bytes = b"") -> bytes:
    header = f"{{'descr': '<i4', 'fortran_order': False, 'shape': {shape}, }}".encode()
    header += b" " * (63 - (10 + len(header)) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + data


@pytest.mark.parametrize(
    "shape", ["(0, 1000000000000000000000000)", "(4000000000, 3)", "()", "(" + "0, " * 40 + ")"]
)
def test_a_shape_that_no_array_can_have_is_refused(path, shape):
    with zipfile.ZipFile(path) as archive:
        members = {info.filename: archive.read(info) for info in archive.infolist()}
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in {**members, "index.npy": npy(shape)}.items():
            archive.writestr(name, content)
    with pytest.raises(errors.DamagedError):
        read_artifact(path)


@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize("name", ["index.npy", "manifest.json"])
def test_a_member_that_is_there_twice_is_refused(path, name):
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr(name, archive.read(name))
    with pytest.raises(errors.DamagedError, match="twice"):
        read_artifact(path)


@pytest.mark.parametrize("offset", [0, 2**32 - 2, 2**62, 2**63 - 1, 2**64 - 1])
def test_a_member_that_lies_nowhere_is_refused(path, offset):
    """The second entry of the central directory, with a 64-bit offset."""
    raw = bytearray(path.read_bytes())
    entry = raw.index(b"PK\x01\x02", raw.index(b"PK\x01\x02") + 4)
    name = int.from_bytes(raw[entry + 28 : entry + 30], "little")
    extra = int.from_bytes(raw[entry + 30 : entry + 32], "little")
    wide = b"\x01\x00\x08\x00" + offset.to_bytes(8, "little")
    raw[entry + 42 : entry + 46] = b"\xff" * 4
    raw[entry + 30 : entry + 32] = (extra + len(wide)).to_bytes(2, "little")
    raw[entry + 46 + name : entry + 46 + name] = wide
    end = raw.rindex(b"PK\x05\x06")
    size = int.from_bytes(raw[end + 12 : end + 16], "little")
    raw[end + 12 : end + 16] = (size + len(wide)).to_bytes(4, "little")
    path.write_bytes(raw)
    with pytest.raises(errors.DamagedError):
        read_artifact(path)


@pytest.mark.parametrize(
    "edit",
    [
        {"voxel_size_m": 0.0},
        {"voxel_size_m": -0.1},
        {"sigma": 0.0},
        {"sigma": 1e300},
        {"min_overlap": 0},
        {"min_overlap": 2**32},
        {"inflation_m": -1.0},
        {"crop": []},
        {"crop": [1, 1, 1, -1, -1, -1]},
        {"unit": "furlong"},
    ],
)
def test_a_manifest_whose_numbers_mean_nothing_is_refused(path, edit):
    """Any of them would let a check of the obstacles pass because there is nothing to check."""
    rewrite(path, lambda m: m.update(edit))
    with pytest.raises(errors.DamagedError, match=next(iter(edit))):
        read_artifact(path)


def test_the_commit_of_a_checkout_is_read_without_a_lock_of_it(tmp_path, monkeypatch):
    def git(*words):
        command = ["git", "-C", str(tmp_path), "-c", "user.name=a", "-c", "user.email=a@b", *words]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()

    file, index = tmp_path / "file", tmp_path / ".git/index"
    git("init", "-q")
    file.write_text("1")
    git("add", "file")
    git("commit", "-qm", "first")
    commit, before = git("rev-parse", "HEAD")[:12], index.read_bytes()
    monkeypatch.setattr(manifest, "__file__", str(tmp_path / "schemas/artifacts/manifest.py"))
    monkeypatch.setattr(manifest, "native_commit", lambda: "")
    os.utime(file, (1, 1))  # a lock would be taken to write this into the index
    assert manifest.producer.__wrapped__().commit == commit
    assert index.read_bytes() == before
    file.write_text("22")
    assert manifest.producer.__wrapped__().commit == f"{commit}-dirty"


def test_an_archive_that_is_interrupted_is_not_completed_later(tmp_path, monkeypatch):
    def interrupt(archive):
        raise KeyboardInterrupt

    said = []
    monkeypatch.setattr(sys, "unraisablehook", said.append)
    monkeypatch.setattr(zipfile.ZipFile, "__enter__", interrupt)
    with suppress(KeyboardInterrupt):
        write_artifact(tmp_path / "a.voxels.npz", voxels())
    assert not said
    assert not list(tmp_path.iterdir())
