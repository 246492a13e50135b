"""Artifacts in parts: round trips, selection by a box, what is refused, and interrupted writing."""

import hashlib
import json

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from alula.schemas import errors
from alula.schemas.artifacts import parts_join
from alula.schemas.artifacts.artifact import file_hash, read_artifact, write_artifact
from alula.schemas.artifacts.kinds import SCENE, VOXELS
from alula.schemas.artifacts.parts import INDEX, PartRef, Parts, described, open_parts
from alula.schemas.artifacts.parts_join import read_whole
from alula.schemas.artifacts.parts_output import (
    kept_part,
    part_name,
    partial_folder,
    parts_output,
    write_part,
)
from alula.schemas.artifacts.provenance import read_provenance
from support.effort import examples
from support.scenes.parted import provenance_of, scene_of, voxels_of, write_parts

TWO = ([[0, 0, 0], [1, 0, 0]], [[10, 0, 0]])


@pytest.fixture
def city(tmp_path):
    return write_parts(tmp_path / "city.scene", [scene_of(mean) for mean in TWO])


def rewritten(path, edit):
    """Change an index and give it the hash that it should have."""
    index = json.loads((path / INDEX).read_text())
    edit(index)
    index["sha256"] = ""
    text = json.dumps(index, indent=2, sort_keys=True)
    digest = hashlib.sha256(text.encode()).hexdigest()
    (path / INDEX).write_text(text.replace('\n  "sha256": ""', f'\n  "sha256": "{digest}"'))
    return path


def test_parts_are_ordinary_artifacts_and_the_whole_has_the_sums(city):
    parts = open_parts(city, SCENE)
    assert len(parts) == 2
    assert parts.count == 3
    assert parts.is_folder
    assert parts.manifest.arrays["mean"].shape == [3, 3]
    for number, mean in enumerate(TWO):
        np.testing.assert_array_equal(read_artifact(parts.file(number), SCENE)["mean"], np.float32(mean))
        np.testing.assert_array_equal(parts[number]["mean"], np.float32(mean))
        assert parts.refs[number].sha256 == file_hash(parts.file(number))
    parts.check()
    hashes = "".join(part.manifest.arrays["mean"].sha256 for part in parts)
    assert parts.manifest.arrays["mean"].sha256 == hashlib.sha256(hashes.encode()).hexdigest()


def test_a_single_file_is_one_part(tmp_path):
    path = tmp_path / "a.scene.npz"
    write_artifact(path, scene_of(TWO[0]))
    parts = open_parts(path, SCENE)
    assert (len(parts), parts.count, parts.is_folder) == (1, 2, False)
    assert parts.manifest == parts[0].manifest
    assert parts.refs[0].upper == [1.0, 0.0, 0.0]
    assert parts.touching([5, 0, 0], [6, 0, 0]) == [0]  # it is in memory, and its box need not be known
    assert parts.file(0) == path


def test_equal_content_gives_equal_bytes(tmp_path):
    first, second = (write_parts(tmp_path / name, [scene_of(mean) for mean in TWO]) for name in "ab")
    assert {f.name: f.read_bytes() for f in first.iterdir()} == {
        f.name: f.read_bytes() for f in second.iterdir()
    }


def test_the_provenance_of_the_whole_is_that_of_the_index(city):
    found = read_provenance(city, verify=True)
    assert found == provenance_of(scene_of(TWO[0]))
    (city / "part-00001.scene.npz").write_bytes(b"PK\x03\x04")
    assert read_provenance(city) is None


@settings(deadline=None, max_examples=examples(60))
@given(
    st.lists(st.tuples(*[st.floats(-100, 100, width=32)] * 3), min_size=1, max_size=6),
    st.floats(2**-10, 5, width=32),
    st.tuples(st.floats(0, 1, width=32), st.floats(0, 0.5, width=32), st.floats(0, 3, width=32)),
    st.floats(0.1, 5),
    st.floats(0, 2),
    st.tuples(*[st.floats(-1, 1)] * 3),
)
def test_no_part_that_an_ellipsoid_touches_is_left_out(mean, scale, loss, sigma, inflation, direction):
    """The farthest point of any Gaussian along a direction, at its own loss, is a box that must be found."""

    scene = scene_of(mean, scale, loss)
    blank = PartRef(
        file="part-0.scene.npz", sha256="0" * 64, bytes=1, count=1, lower=[0.0] * 3, upper=[0.0] * 3
    )
    parts = Parts(None, SCENE, scene.manifest, [described(scene, blank)], scene)
    length = np.linalg.norm(direction)
    unit = np.asarray(direction) / length if length > 1e-6 else np.array([1.0, 0, 0])
    moved, grown, _ = map(float, np.float32(loss))
    reach = sigma * float(np.float32(scale)) * (1 + grown) + inflation + moved
    for centre in np.float64(scene["mean"]):
        point = centre + unit * reach
        assert parts.touching(point, point, sigma=sigma, inflation=inflation) == [0]


def test_parts_far_from_a_box_are_left_out(city):
    parts = open_parts(city)
    assert parts.touching([9, -1, -1], [11, 1, 1]) == [1]
    assert parts.touching([1.2, 0, 0], [1.3, 0, 0], sigma=3) == []
    assert parts.touching([1.2, 0, 0], [1.3, 0, 0], sigma=4) == [0]
    assert parts.touching([1.2, 0, 0], [1.3, 0, 0], inflation=100) == [0, 1]


def test_the_whole_is_the_parts_in_their_order(tmp_path):
    loss = [0.1, 0.0, 0.0]
    path = write_parts(tmp_path / "a.scene", [scene_of(TWO[0], loss=loss), scene_of(TWO[1])])
    whole = read_whole(path, SCENE)
    np.testing.assert_array_equal(whole["mean"], np.float32([*TWO[0], *TWO[1]]))
    np.testing.assert_array_equal(whole["loss"], np.float32([loss, loss, [0, 0, 0]]))
    write_artifact(tmp_path / "whole.npz", whole)
    assert read_artifact(tmp_path / "whole.npz").manifest == whole.manifest


def test_voxels_of_parts_are_sorted_in_the_whole(tmp_path):
    high, low = [[0, 0, 3], [4, 0, 0]], [[-9, 1, 1], [0, 0, 2]]
    path = write_parts(tmp_path / "a.voxels", [voxels_of(high, 2), voxels_of(low, 7)])
    whole = read_whole(path)
    assert whole["index"].tolist() == [[-9, 1, 1], [0, 0, 2], [0, 0, 3], [4, 0, 0]]
    assert whole["overlap"].tolist() == [7, 7, 2, 2]
    parts = open_parts(path)
    assert parts.touching([0.25, 0.05, 0.45], [9, 9, 9]) == []
    assert parts.touching([0, 0, 0.4], [0, 0, 9]) == [0]
    both = write_parts(tmp_path / "b.voxels", [voxels_of(high), voxels_of(high)])
    with pytest.raises(errors.DamagedError, match="two parts have the same voxel"):
        read_whole(both)


def test_a_whole_beyond_the_memory_is_refused(city, monkeypatch):
    monkeypatch.setitem(parts_join.MOST, SCENE.name, 2)
    with pytest.raises(errors.InputError, match="3 Gaussians; this command needs all of them in memory"):
        read_whole(city)
    assert read_whole(open_parts(city).file(0)).manifest.schema == SCENE.name


def change(**values):
    return lambda index: index["parts"][0].update(values)


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (change(file="../city.scene/part-00000.scene.npz"), "is not valid"),
        (change(file="part-00000.scene.npz/../../x"), "is not valid"),
        (change(file="part-00000.cover.npz"), "is not named like"),
        (change(file="part-00001.scene.npz"), "listed twice"),
        (change(file="part-00009.scene.npz"), "part-00009.scene.npz is missing"),
        (change(count=10**15), "is not valid"),
        (change(count=10**12), "elements, the whole 3"),
        (change(count=0), "is not valid"),
        (change(lower=[0.0, 0.0]), "is not valid"),
        (change(lower=[2.0, 0.0, 0.0]), "above `upper`"),
        (change(bytes=10), "bytes long"),
        (change(sha256="z" * 64), "is not valid"),
        (lambda index: index["parts"].clear(), "is not valid"),
        (lambda index: index["parts"].pop(), "the whole 3"),
        (lambda index: index.update(of="alula/plan"), "is not valid"),
        (lambda index: index.update(of="alula/cover"), "is not valid"),
        (lambda index: index.update(schema="alula/scene"), "not alula/parts"),
        (lambda index: index.update(version="2.0"), "newer"),
        (lambda index: index.update(requires=["teleport"]), "teleport"),
        (lambda index: index["whole"].update(requires=["teleport"]), "teleport"),
        (lambda index: index["whole"].update(version="9.0"), "newer"),
        (lambda index: index["whole"]["arrays"].pop("mean"), "lacks the array mean"),
        (lambda index: index["whole"]["arrays"]["mean"].update(shape=[]), "another type or shape"),
        (lambda index: index["whole"]["arrays"].update(x=index["whole"]["arrays"]["mean"]), "unknown array"),
    ],
)
def test_a_hostile_index_is_refused(city, edit, words):
    with pytest.raises(errors.InputError, match=words) as raised:
        open_parts(rewritten(city, edit))
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (change(sha256="0" * 64), "does not match its SHA-256"),
        (change(upper=[0.5, 0.0, 0.0]), "count or box"),
        (change(reach=0.01), "count or box"),
        (lambda index: index["whole"].update(frame="elsewhere"), "its frame is not"),
        (lambda index: index["whole"]["arrays"]["mean"].update(sha256="0" * 64), "arrays of the parts"),
    ],
)
def test_an_index_that_contradicts_a_part_is_refused_when_the_part_is_read(city, edit, words):
    parts = open_parts(rewritten(city, edit))
    with pytest.raises(errors.DamagedError, match=words):
        parts.check()


STRANGE = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(2**70), 2**70),
    st.floats(),
    st.text(max_size=3),
    st.just("../part-00000.scene.npz"),
    st.lists(st.integers(-3, 3), max_size=4),
    st.dictionaries(st.text(max_size=2), st.integers(), max_size=2),
)


def places(value, path=()):
    """Paths of all values in nested tables and lists."""
    yield path
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in items:
        yield from places(item, (*path, key))


@settings(
    deadline=None, max_examples=examples(150), suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(st.data())
def test_an_index_with_any_other_value_is_read_or_refused_with_one_line(city, data):
    text = (city / INDEX).read_text()
    index = json.loads(text)
    *where, last = data.draw(st.sampled_from([path for path in places(index) if path]))
    table = index
    for key in where:
        table = table[key]
    if data.draw(st.booleans()):
        table[last] = data.draw(STRANGE)
    else:
        del table[last]
    index["sha256"] = ""
    raw = json.dumps(index, indent=2, sort_keys=True)
    digest = hashlib.sha256(raw.encode()).hexdigest()
    (city / INDEX).write_text(raw.replace('\n  "sha256": ""', f'\n  "sha256": "{digest}"'))
    refusal = refused(city)
    (city / INDEX).write_text(text)
    assert "\n" not in refusal
    assert refusal.startswith(str(city))


def refused(path):
    """Why an artifact in parts is refused; its path where it is read."""
    try:
        parts = open_parts(path)
        parts.check()
        parts.touching([0, 0, 0], [1, 1, 1], sigma=1)
        read_whole(path)
    except errors.InputError as error:
        return str(error)
    return str(path)


def test_a_flipped_byte_of_the_index_is_noticed(city):
    raw = bytearray((city / INDEX).read_bytes())
    at = raw.index(b'"upper"') + 20
    raw[at : at + 1] = b"7"
    (city / INDEX).write_bytes(raw)
    with pytest.raises(errors.DamagedError, match=r"does not match its own SHA-256|is not valid"):
        open_parts(city)


def test_foreign_and_exchanged_parts_are_refused(city):
    (city / "notes.txt").write_text("mine")
    open_parts(city).check()
    (city / "part-7.scene.npz").write_bytes(b"x")
    with pytest.raises(errors.DamagedError, match=r"'part-7\.scene\.npz' is no part"):
        open_parts(city)
    (city / "part-7.scene.npz").unlink()
    write_artifact(city / "part-00001.scene.npz", scene_of([[11, 0, 0]]))
    with pytest.raises(errors.DamagedError, match="does not match its SHA-256"):
        open_parts(city).check()


def test_voxels_outside_of_their_domain_are_refused(tmp_path):
    index = [[0, 0, 0], [3, 3, 3]]
    good = write_parts(tmp_path / "a.voxels", [voxels_of(index)], [[(0, 0, 0), (3, 3, 3)]])
    open_parts(good).check()
    bad = write_parts(tmp_path / "b.voxels", [voxels_of(index)], [[(0, 0, 0), (3, 2, 3)]])
    with pytest.raises(errors.DamagedError, match="outside of its domain"):
        open_parts(bad).check()


def test_folders_and_files_of_other_kinds_are_refused(city, tmp_path):
    with pytest.raises(errors.WrongKindError, match="alula/voxels is needed"):
        open_parts(city, VOXELS)
    with pytest.raises(errors.InputError, match="is in parts, but one file is needed"):
        read_artifact(city)
    with pytest.raises(errors.InputError, match=r"without index\.json"):
        open_parts(tmp_path)


def ended(path, scene, error):
    """Begin to write a scene in parts, and end with an error after the first."""

    def write():
        with parts_output(path, SCENE, provenance_of(scene)) as writer:
            writer.take(write_part(writer.folder, part_name(SCENE, 0), scene))
            raise error

    with pytest.raises(error):
        write()


def test_an_interrupted_run_leaves_parts_that_the_same_run_uses_again(tmp_path):
    path, scenes = tmp_path / "city.scene", [scene_of(mean) for mean in TWO]
    wanted = provenance_of(scenes[0])
    ended(path, scenes[0], KeyboardInterrupt)
    left = partial_folder(path, wanted)
    assert not path.exists()
    assert [file.name for file in left.iterdir()] == ["part-00000.scene.npz"]
    with pytest.raises(errors.InputError, match=r"without index\.json"):
        open_parts(left)
    (left / ".part-00001.scene.npz.abc.tmp").write_bytes(b"half")
    assert partial_folder(path, provenance_of(scenes[0], lod=1)) != left
    with parts_output(path, SCENE, wanted) as writer:
        assert kept_part(writer.folder, part_name(SCENE, 1), SCENE) is None
        writer.take(kept_part(writer.folder, part_name(SCENE, 0), SCENE))
        writer.take(write_part(writer.folder, part_name(SCENE, 1), scenes[1]))
        writer.finish(writer.whole(wanted, frame="world", unit="m", summary={}, source={}))
    assert sorted(file.name for file in tmp_path.iterdir()) == ["city.scene"]
    open_parts(path).check()
    assert len(list(path.iterdir())) == 3


def test_a_damaged_part_of_an_interrupted_run_is_not_used(tmp_path):
    scene = scene_of(TWO[0])
    write_artifact(tmp_path / "part-00000.scene.npz", scene)
    raw = (tmp_path / "part-00000.scene.npz").read_bytes()
    (tmp_path / "part-00000.scene.npz").write_bytes(raw[:-200])
    assert kept_part(tmp_path, "part-00000.scene.npz", SCENE) is None


def test_an_error_leaves_nothing_and_a_dry_run_writes_nothing(tmp_path):
    path, scene = tmp_path / "city.scene", scene_of(TWO[0])
    ended(path, scene, errors.InputError)
    with parts_output(path, SCENE, provenance_of(scene), dry_run=True) as writer:
        writer.take(write_part(writer.folder, part_name(SCENE, 0), scene))
        writer.finish(writer.whole(provenance_of(scene), frame="world", unit="m", summary={}, source={}))
    with pytest.raises(KeyboardInterrupt), parts_output(path, SCENE, provenance_of(scene)):
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []


def test_a_new_folder_replaces_an_old_one_completely(city):
    write_parts(city, [scene_of(TWO[1])])
    assert sorted(file.name for file in city.iterdir()) == [INDEX, "part-00000.scene.npz"]
    assert sorted(file.name for file in city.parent.iterdir()) == ["city.scene"]
