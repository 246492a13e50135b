"""Streamed SOG: a level of detail spread over several files, parts of it, and several inputs."""

import json

import numpy as np
import pytest

from alula.cli import main
from alula.schemas.artifacts.artifact import read_artifact
from alula.schemas.errors import ArtifactError, UsageError
from alula.stages.reconstruction.formats.registry import SplatFile, read_splats
from alula.stages.reconstruction.pieces import find_splats
from support.files.originals import originals
from support.files.sog_encoder import bundle, encode, folder
from support.files.splat_files import some_gaussians, splat

COLUMNS = ("mean", "scale", "quat_wxyz", "opacity", "color")
CENTRES = (-6.0, 0.0, 6.0)  # x of the three parts of level 0


def part(seed, x, count=60):
    scene = originals(count, seed=seed, span=1.0, spread=0.2)
    scene.mean[:, 0] += x
    scene.alpha[:] = 0.9
    return scene


def capture(path, *, change=None, environment=None):
    """A capture whose finest level has three files and whose level 1 has one."""
    path.mkdir()
    for k, x in enumerate(CENTRES):
        folder(path / f"0_{k}", encode(part(k, x)))
    folder(path / "1_0", encode(part(7, 0.0, 30)))
    names = ["0_0/meta.json", "1_0/meta.json", "0_1/meta.json", "0_2/meta.json"]
    leaves = [
        {"lods": {"0": {"file": 0, "offset": 0, "count": 60}, "1": {"file": 1, "offset": 0, "count": 10}}},
        {"lods": {"0": {"file": 2, "offset": 0, "count": 25}, "1": {"file": 1, "offset": 10, "count": 20}}},
        {"children": [{"lods": {"0": {"file": 2, "offset": 25, "count": 35}}}]},
        {"lods": {"0": {"file": 3, "offset": 0, "count": 60}}},
    ]
    index = {
        "version": 1,
        "lodLevels": 2,
        "environment": environment,
        "filenames": names,
        "tree": {"bound": {}, "children": leaves},
    }
    if change is not None:
        change(index)
    (path / "lod-meta.json").write_text(json.dumps(index))
    return path


def run(*words):
    return main.run([str(word) for word in words])


def parts_of(scene, *names):
    return np.concatenate([read_splats(scene / name).mean for name in names])


def test_a_level_is_all_of_its_files(tmp_path):
    scene = capture(tmp_path / "c")
    for path in (scene, scene / "lod-meta.json"):
        found = SplatFile.find(path)
        assert found.format.name == "streamed-sog"
        roles = found.files()
        assert roles["splat"] == scene / "lod-meta.json"
        assert len(roles) == 1 + 3 * 6
        splats = found.decode()
        np.testing.assert_array_equal(splats.mean, parts_of(scene, "0_0", "0_1", "0_2"))
        assert splats.loss.bound.shape == (180, 3)
    coarse = SplatFile.find(scene, level=1).decode()
    np.testing.assert_array_equal(coarse.mean, parts_of(scene, "1_0"))


def test_parts_may_be_archives(tmp_path):
    scene = capture(tmp_path / "c", change=lambda index: index["filenames"].__setitem__(3, "0_2.sog"))
    bundle(scene / "0_2.sog", encode(part(2, CENTRES[2])))
    assert len(read_splats(scene)) == 180


@pytest.mark.parametrize("name", ["0_1", "0_1/meta.json"])
def test_one_part_alone_is_refused(tmp_path, capsys, name):
    """A map of one part flies through the walls of the others."""
    scene = capture(tmp_path / "c")
    assert run("import-splat", scene / name, "-o", tmp_path / "a.scene.npz") == 3
    error = capsys.readouterr().err
    assert "2 of the 3 files of level of detail 0 (0_0/meta.json, 0_2/meta.json)" in error
    assert f"import {scene.resolve()}/lod-meta.json --lod 0" in error
    assert "--part" in error
    assert error.count("\n") == 1
    assert not (tmp_path / "a.scene.npz").exists()


def test_a_part_is_named_in_every_guarantee_after_it(tmp_path, capsys):
    scene = capture(tmp_path / "c")
    files = [tmp_path / f"a.{kind}.npz" for kind in ("scene", "metric", "voxels", "cover")]
    assert run("import-splat", scene / "0_1", "--part", "-o", files[0]) == 0
    words = "2 of the 3 files of level of detail 0 (0_0/meta.json, 0_2/meta.json)"
    assert f"not the whole capture: it lacks {words}" in capsys.readouterr().err
    made = read_artifact(files[0]).manifest
    assert made.source["lacks"] == [words]
    assert words in made.guarantee.statement
    assert run("scale-align", files[0], "--scale", 1, "-o", files[1]) == 0
    assert run("voxelize", files[1], "--size", 0.2, "-o", files[2]) == 0
    assert run("merge", files[2], "-o", files[3], "--hulls", 3) == 0
    for file in files[2:]:
        assert words in read_artifact(file).manifest.guarantee.statement
    capsys.readouterr()
    assert run("verify", files[3], "--voxels", files[2], "--scene", files[1]) == 0
    assert f"{words}, not imported" in capsys.readouterr().out
    assert run("verify", files[3]) == 0
    assert f"{words}, not imported" in capsys.readouterr().out


def test_all_parts_together_are_the_level(tmp_path):
    scene = capture(tmp_path / "c")
    some, whole = tmp_path / "some.scene.npz", tmp_path / "whole.scene.npz"
    assert run("import-splat", *(scene / f"0_{k}" for k in range(3)), "-o", some) == 0
    assert run("import-splat", scene, "-o", whole) == 0
    some, whole = read_artifact(some), read_artifact(whole)
    for name in (*COLUMNS, "loss"):
        np.testing.assert_array_equal(some.arrays[name], whole.arrays[name])
    for made in (some, whole):
        assert made.manifest.source["lacks"] == []
        assert made.manifest.source["levels_of_detail"] == [
            {"level": 0, "levels": 2, "files": 3, "files_of_level": 3}
        ]
    assert run("import-splat", *(scene / f"0_{k}" for k in range(2)), "-o", tmp_path / "two.scene.npz") == 3


def test_a_coarse_level_is_whole_but_lacks_what_finer_ones_show(tmp_path, capsys):
    scene = capture(tmp_path / "c")
    for words in (("lod-meta.json", "--lod", 1), ("1_0",)):
        out = tmp_path / f"{len(words)}.scene.npz"
        assert run("import-splat", scene / words[0], *words[1:], "-o", out) == 0
        assert "what levels of detail finer than 1 show" in capsys.readouterr().err
        assert "finer than 1" in read_artifact(out).manifest.guarantee.statement


def test_the_environment_is_not_read_and_is_named(tmp_path, capsys):
    scene = capture(tmp_path / "c", environment="env/meta.json")
    folder(scene / "env", encode(part(9, 0.0)))
    assert run("import-splat", scene, "-o", tmp_path / "a.scene.npz") == 0
    assert "the environment of the capture (env/meta.json)" in capsys.readouterr().err
    assert len(read_artifact(tmp_path / "a.scene.npz")["mean"]) == 180
    assert run("import-splat", scene / "env", "-o", tmp_path / "b.scene.npz") == 3
    assert "without everything but the environment" in capsys.readouterr().err
    assert run("import-splat", scene, scene / "env", "-o", tmp_path / "b.scene.npz") == 0
    assert read_artifact(tmp_path / "b.scene.npz").manifest.source["lacks"] == []


def test_a_missing_file_stops_the_level_and_others_are_named(tmp_path, capsys):
    scene = capture(tmp_path / "c")
    (scene / "0_1/meta.json").unlink()
    assert run("import-splat", scene, "-o", tmp_path / "a.scene.npz") == 3
    error = capsys.readouterr().err
    assert "1 of the 3 files of level of detail 0 are missing (0_1/meta.json)" in error
    assert "levels with all files: 1 (--lod 1)" in error
    assert run("import-splat", scene, "--lod", 2, "-o", tmp_path / "a.scene.npz") == 2
    assert "--lod must be between 0 and 1" in capsys.readouterr().err


def test_rows_that_only_another_level_lists_are_left_out(tmp_path):
    def shared(index):
        leaf = {"1": {"file": 0, "offset": 40, "count": 20}}
        index["tree"]["children"][0]["lods"]["0"]["count"] = 30  # rows 30 to 39 are of no level: kept
        index["tree"]["children"].append({"lods": leaf})

    scene = capture(tmp_path / "c", change=shared)
    own = read_splats(scene / "0_0").mean
    np.testing.assert_array_equal(read_splats(scene).mean[:40], own[:40])
    assert len(read_splats(scene)) == 160
    other = SplatFile.find(scene, level=1).decode().mean
    np.testing.assert_array_equal(other[:30], own[30:])
    assert len(other) == 30 + 30


def test_a_damaged_index_beside_a_part_is_told(tmp_path, capsys):
    scene = capture(tmp_path / "c")
    (scene / "lod-meta.json").write_text("{")
    assert run("import-splat", scene / "0_1", "-o", tmp_path / "a.scene.npz") == 0
    assert "may be a part of a level of detail" in capsys.readouterr().err
    (scene / "lod-meta.json").unlink()
    assert run("import-splat", scene / "0_1", "-o", tmp_path / "b.scene.npz") == 0
    assert "if it is one, the scene lacks the other parts" in capsys.readouterr().err


def set_to(*keys):
    *path, last, value = keys

    def change(index):
        at = index
        for key in path:
            at = at[key]
        at[last] = value

    return change


LEAF = ("tree", "children", 0, "lods", "0")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (set_to("version", 2), "version 2 is not supported"),
        (set_to("lodLevels", 0), "lodLevels must be"),
        (set_to("lodLevels", 1), "a level of lods must be"),
        (set_to("lodLevels", True), "lodLevels must be"),
        (set_to("filenames", "0_0/meta.json"), "filenames must be"),
        (set_to("filenames", 0, "../a.sog"), "no name of a file in the same folder"),
        (set_to("filenames", 0, "0_1/meta.json"), "twice"),
        (set_to("environment", 3), "environment is no name"),
        (set_to("tree", None), "a node that is no object"),
        (set_to("tree", "children", "ab"), "whose children are no list"),
        (set_to(*LEAF, "file", 4), "lods.file must be"),
        (set_to(*LEAF, "file", 1.0), "lods.file must be"),
        (set_to(*LEAF, "offset", -1), "lods.offset must be"),
        (set_to(*LEAF, "count", 61), "has 60 Gaussians, but the index lists rows 0 to 60"),
        (set_to("tree", "children", 0, "lods", []), None),
        (set_to("tree", "children", 0, "lods", [1]), "lods of a node"),
        (set_to("tree", "children", 0, "lods", {"x": {}}), "a level of lods must be"),
        (set_to("tree", "children", 0, "lods", {"0": 3}), "level 0 of a node"),
        (set_to("tree", "children", []), "level of detail 0 has no files; no level has all files"),
    ],
)
def test_a_wrong_index_is_refused(tmp_path, change, words):
    scene = capture(tmp_path / "c", change=change)
    if words is None:
        assert len(read_splats(scene)) >= 60
        return
    with pytest.raises(ArtifactError, match=words):
        read_splats(scene)


def test_levels_are_of_indices_alone(tmp_path):
    scene = capture(tmp_path / "c")
    with pytest.raises(UsageError, match="has no levels of detail"):
        find_splats([scene / "0_1"], level=0)


def test_a_level_and_the_environment_go_together(tmp_path, capsys):
    scene = capture(tmp_path / "c", environment="env/meta.json")
    folder(scene / "env", encode(part(9, 20.0, 40)))
    out = tmp_path / "a.scene.npz"
    words = ["import-splat", scene / "lod-meta.json", scene / "env", "--lod", "1", "--min-opacity", 0]
    assert run(*words, "-o", out) == 0
    np.testing.assert_array_equal(read_artifact(out)["mean"], parts_of(scene, "1_0", "env"))
    assert "without everything" not in (said := capsys.readouterr().err)
    assert "the environment of the capture" not in said
    assert "finer than 1" in said


def test_folders_with_splats_that_are_passed_over_are_named(tmp_path, capsys):
    place = tmp_path / "all"
    place.mkdir()
    bundle(place / "loose.sog", encode(part(3, 0.0, 40)))
    capture(place / "street")
    (place / "notes").mkdir()
    (place / "notes/readme.txt").write_text("no splat")
    folder(place / "deep/er/one", encode(part(4, 0.0, 40)))
    assert run("import-splat", place, "-o", tmp_path / "a.scene.npz") == 0
    said = capsys.readouterr().err
    assert "in the folder all, 2 folders with splats (deep, street) were not read" in said
    assert "notes" not in said.replace("note:", "")
    assert run("import-splat", place / "loose.sog", "-o", tmp_path / "b.scene.npz") == 0
    assert "were not read" not in capsys.readouterr().err
    (place / "loose.sog").unlink()
    assert run("import-splat", place, "-o", tmp_path / "c.scene.npz") == 3
    assert "2 folders with splats (deep, street) were not read: name them" in capsys.readouterr().err


def test_the_real_index_reads_the_levels_that_are_there(data):
    path = data / "playbot-lod-sog"
    with pytest.raises(ArtifactError, match=r"level of detail 0 are missing .* all files: 2, 3, 4, 5, 6"):
        read_splats(path)
    level = SplatFile.find(path, level=2).decode()
    np.testing.assert_array_equal(level.mean, read_splats(path / "2_0").mean)
    assert len(level) == 63549 + 61451


def test_tiles_become_one_scene_in_their_order(tmp_path, data):
    tiles = sorted((data / "istanbul-outdoor").glob("*.splat"))
    out = tmp_path / "a.scene.npz"
    assert run("import-splat", *tiles, "--min-opacity", 0, "-q", "-o", out) == 0
    scene = read_artifact(out)
    parts = [read_splats(tile) for tile in tiles]
    np.testing.assert_array_equal(scene["mean"], np.concatenate([one.mean for one in parts]))
    np.testing.assert_array_equal(scene["loss"], np.concatenate([one.loss.bound for one in parts]))
    assert [ref.role for ref in scene.manifest.inputs] == ["splat", "splat 2", "splat 3"]


def test_files_of_different_formats_are_joined(tmp_path, capsys):
    scene = capture(tmp_path / "c")
    other = folder(tmp_path / "o", splat(some_gaussians(20)))
    file = next(other.iterdir())
    out = tmp_path / "a.scene.npz"
    assert run("import-splat", scene / "1_0", file, "-o", out, "--min-opacity", 0) == 0
    made = read_artifact(out)
    assert made.manifest.source["format"] == "sog + splat"
    assert len(made["mean"]) == 30 + 20
    capsys.readouterr()
    for words, code in ((["-", file], 2), ([file, file], 2)):
        assert run("import-splat", *words, "-o", tmp_path / "b.scene.npz") == code
    assert "is named twice" in capsys.readouterr().err
