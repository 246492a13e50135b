"""`alula import-splat` with a folder of parts as the output."""

import json

import msgspec
import numpy as np
import pytest
from unit.reconstruction.test_streamed_sog import capture

from alula.cli import main
from alula.cli.verbs import import_splat as verb
from alula.schemas.artifacts.artifact import file_hash, read_artifact
from alula.schemas.artifacts.kinds import SCENE
from alula.schemas.artifacts.parts import INDEX, open_parts
from alula.schemas.artifacts.parts_join import read_whole
from alula.schemas.artifacts.provenance import read_provenance
from support.files.splat_files import some_gaussians, splat
from support.scenes.pipeline import write_tiny_splat

COLUMNS = ("mean", "scale", "quat_wxyz", "opacity", "color")


def run(*words):
    return main.run([str(word) for word in words])


def said(capsys):
    return capsys.readouterr().err.splitlines()


@pytest.fixture
def tiles(tmp_path):
    """A folder with a .ply of 800 Gaussians and two .splat of 250 and 120."""
    folder = tmp_path / "tiles"
    folder.mkdir()
    write_tiny_splat(folder / "a.ply")
    for name, count in (("b", 250), ("c", 120)):
        (folder / f"{name}.splat").write_bytes(splat(some_gaussians(count, seed=count))["a.splat"])
    return folder


def equal(one, other):
    for name in one.arrays.keys() | other.arrays.keys():
        np.testing.assert_array_equal(one[name], other[name], strict=True)


@pytest.mark.parametrize("jobs", [1, 3])
def test_the_parts_are_the_rows_of_the_files_in_their_order(tmp_path, tiles, jobs):
    files = sorted(tiles.iterdir())
    assert run("import-splat", *files, "-o", tmp_path / "one.scene.npz", "-q") == 0
    words = ["import-splat", *files, "-o", f"{tmp_path / 'city.scene'}/", "--part-gaussians", 300, "-q"]
    assert run(*words, "--jobs", jobs) == 0
    parts = open_parts(tmp_path / "city.scene", SCENE)
    assert [ref.count for ref in parts.refs] == [300, 300, 200, 250, 120]
    parts.check()
    one = read_artifact(tmp_path / "one.scene.npz")
    equal(read_whole(parts.path), one)
    for key in ("gaussians", "rows", "removed", "format", "frame", "lower", "upper", "scale_max", "loss"):
        assert parts.manifest.summary[key] == one.manifest.summary[key], key
    assert parts.manifest.guarantee == one.manifest.guarantee
    assert parts.manifest.inputs == one.manifest.inputs
    assert [part.manifest.inputs[0].name for part in parts] == ["a.ply"] * 3 + ["b.splat", "c.splat"]
    assert all(len(part.manifest.inputs) == 1 for part in parts)
    assert parts[3].manifest.inputs[0].sha256 == file_hash(tiles / "b.splat")


def test_a_folder_stands_for_the_splats_in_it(tmp_path, tiles, capsys):
    (tiles / "readme.txt").write_text("no splat")
    assert run("import-splat", tiles, "-o", tmp_path / "city.scene", "-q") == 0
    assert open_parts(tmp_path / "city.scene").count == 1170
    assert run("import-splat", tiles, "-o", tmp_path / "one.scene.npz", "-q") == 0
    equal(read_whole(tmp_path / "city.scene"), read_artifact(tmp_path / "one.scene.npz"))
    assert run("import-splat", tiles, tiles / "b.splat", "-o", tmp_path / "x.scene") == 2
    assert "is named twice" in said(capsys)[0]
    (tmp_path / "empty").mkdir()
    assert run("import-splat", tmp_path / "empty", "-o", tmp_path / "x.scene") == 3
    assert "is a folder without a splat" in said(capsys)[0]


@pytest.mark.parametrize("level", [0, 1])
def test_a_level_of_detail_gives_a_part_per_file(tmp_path, level):
    scene = capture(tmp_path / "scene")
    words = ["import-splat", scene / "lod-meta.json", "--lod", level]
    assert run(*words, "-o", tmp_path / "one.scene.npz", "-q") == 0
    assert run(*words, "-o", tmp_path / "city.scene", "-q") == 0
    parts, one = open_parts(tmp_path / "city.scene"), read_artifact(tmp_path / "one.scene.npz")
    assert [ref.count for ref in parts.refs] == ([60, 60, 60] if level == 0 else [30])
    equal(read_whole(parts.path), one)
    for key in ("lacks", "levels_of_detail"):
        assert parts.manifest.source[key] == one.manifest.source[key]
        assert parts[0].manifest.source[key] == one.manifest.source[key]
    for name, part in zip(("0_0", "0_1", "0_2") if level == 0 else ("1_0",), parts, strict=True):
        roles = [ref.role for ref in part.manifest.inputs]
        assert roles[0] == "splat"
        assert len(roles) > 3
        assert all(f"{name}/" in role for role in roles[1:])


def test_some_files_of_a_level_of_detail_are_refused_before_the_work(tmp_path, capsys):
    scene = capture(tmp_path / "scene")
    words = ["import-splat", scene / "0_0", scene / "0_1", "-o", tmp_path / "city.scene"]
    assert run(*words) == 3
    assert "only a part of a capture, without 1 of the 3 files" in said(capsys)[0]
    assert run(*words, "--part", "-q") == 0
    manifest = open_parts(tmp_path / "city.scene").manifest
    assert "1 of the 3 files of level of detail 0" in manifest.guarantee.statement
    assert run("import-splat", *(scene / f"0_{k}" for k in range(3)), "-o", tmp_path / "all.scene", "-q") == 0
    assert open_parts(tmp_path / "all.scene").manifest.source["lacks"] == []


def test_pieces_without_a_gaussian_give_no_part_but_count(tmp_path, tiles, capsys):
    crop = [
        "--crop-box",
        *["-9", "-9", "-9", "9", "0.5", "9"],
    ]  # without a wall of a.ply
    words = ["import-splat", tiles, "-o", tmp_path / "city.scene", *crop, "--part-gaussians", 100]
    assert run(*words, "--json") == 0
    summary = json.loads(capsys.readouterr().out)["summary"]
    assert summary["rows"] == 1170
    assert summary["gaussians"] + summary["removed"]["crop"] == 1170
    far = ["--crop-box", *["90", "90", "90", "91", "91", "91"]]
    assert run("import-splat", tiles, "-o", tmp_path / "none.scene", *far) == 3
    assert "no Gaussian is left of 1170: removed 1170 by crop" in said(capsys)[0]
    half = ["--crop-box", *["-9", "-9", "2.5", "9", "9", "9"]]  # nothing of a.ply
    assert run("import-splat", tiles, "-o", tmp_path / "half.scene", *half, "--json") == 0
    parts = open_parts(tmp_path / "half.scene")
    assert {part.manifest.inputs[0].name for part in parts} == {"b.splat", "c.splat"}
    assert parts.manifest.source["removed"]["crop"] == 1170 - parts.count
    assert sorted(path.name for path in tmp_path.iterdir()) == ["city.scene", "half.scene", "tiles"]


def test_what_an_import_in_parts_refuses(tmp_path, tiles, capsys):
    assert run("import-splat", tiles, "-o", tmp_path / "a.scene", "--drop-floaters") == 2
    assert "--drop-floaters compares each Gaussian with its neighbours" in said(capsys)[0]
    assert run("import-splat", tiles, "-o", tmp_path / "a.scene.npz", "--part-gaussians", 500) == 2
    assert "--part-gaussians goes with a folder" in said(capsys)[0]
    (tmp_path / "mine.scene").mkdir()
    (tmp_path / "mine.scene/thesis.txt").write_text("mine")
    assert run("import-splat", tiles, "-o", tmp_path / "mine.scene", "-f") == 2
    assert "a folder with other files" in said(capsys)[0]
    (tmp_path / "file.scene").write_text("mine")
    assert run("import-splat", tiles, "-o", tmp_path / "file.scene", "-f") == 3
    assert "is a file, not a folder to write" in said(capsys)[0]
    assert run("import-splat", tiles, "-o", tmp_path / "a.splat.folder") == 2
    assert "or, for a folder of parts, .scene" in said(capsys)[0]


def test_a_damaged_file_is_one_line_and_leaves_nothing(tmp_path, tiles, capsys):
    (tiles / "b.splat").write_bytes((tiles / "b.splat").read_bytes()[:-1])
    assert run("import-splat", tiles, "-o", tmp_path / "city.scene") == 3
    (line,) = said(capsys)
    assert line.startswith(f"alula: {tiles / 'b.splat'}: .splat: truncated, or of another format: 7999 bytes")
    bad = np.frombuffer((tiles / "c.splat").read_bytes(), "<f4").copy()
    bad[8 * 7] = np.nan
    (tiles / "b.splat").write_bytes(bad.tobytes())
    assert run("import-splat", tiles, "-o", tmp_path / "city.scene") == 3
    (line,) = said(capsys)
    assert line.startswith(f"alula: {tiles / 'b.splat'}: 1 of 120 Gaussians have values that are not finite")
    assert [path.name for path in tmp_path.iterdir()] == ["tiles"]


def test_current_folders_stay_and_others_are_replaced_only_by_force(tmp_path, tiles, capsys):
    city = tmp_path / "city.scene"
    words = ["import-splat", tiles, "-o", city, "--depfile", tmp_path / "city.d"]
    assert run(*words, "-n") == 0
    assert not city.exists()
    assert run(*words, "-q") == 0
    assert (tmp_path / "city.d").read_text().startswith(f"{city}/index.json: {tiles}/a.ply ")
    before = {path.name: path.read_bytes() for path in city.iterdir()}
    capsys.readouterr()
    assert run(*words) == 0
    assert capsys.readouterr().out.startswith(f"{city}: unchanged\n")
    assert run(*words, "--turn", "x") == 2
    assert 'turn was "none", now "x"' in said(capsys)[0]
    raw = bytearray((city / "part-00001-000-000.scene.npz").read_bytes())
    raw[-100] ^= 1
    (city / "part-00001-000-000.scene.npz").write_bytes(raw)
    assert run(*words) == 2
    assert "not a file of alula's" in said(capsys)[0]
    assert run(*words, "-f", "-q") == 0
    assert {path.name: path.read_bytes() for path in city.iterdir()} == before


def test_an_interrupted_import_continues_with_its_parts(tmp_path, tiles, capsys, monkeypatch):
    city = tmp_path / "city.scene"
    words = ["import-splat", tiles, "-o", city, "--part-gaussians", 300, "--jobs", 1]
    assert run(*words, "-q") == 0
    whole = {path.name: path.read_bytes() for path in city.iterdir()}
    for path in city.iterdir():
        path.unlink()
    city.rmdir()
    work, made = verb._imported, []

    def interrupted(config, piece, *others):
        if len(made) == 3:
            raise KeyboardInterrupt
        made.append(piece)
        return work(config, piece, *others)

    monkeypatch.setattr(verb, "_imported", interrupted)
    capsys.readouterr()
    assert run(*words) == 130
    (left,) = tmp_path.glob("city.scene.*.partial")
    assert f"the same command continues from {left.name}, 3 parts" in said(capsys)[-1]
    assert run("info", left) == 3
    monkeypatch.undo()
    kept = {path.name: path.stat().st_mtime_ns for path in left.iterdir()}
    assert run(*words, "-q") == 0
    assert {path.name: path.read_bytes() for path in city.iterdir()} == whole
    assert kept == {name: (city / name).stat().st_mtime_ns for name in kept}
    assert not left.exists()


def test_the_provenance_is_that_of_one_scene_and_the_size_of_parts(tmp_path, tiles):
    assert run("import-splat", tiles, "-o", tmp_path / "city.scene", "-q") == 0
    assert run("import-splat", tiles, "-o", tmp_path / "one.scene.npz", "-q") == 0
    one, city = (read_provenance(tmp_path / name) for name in ("one.scene.npz", "city.scene"))
    assert city.parameters == one.parameters | {"part_gaussians": 2_000_000}
    same = msgspec.structs.replace(city, parameters=one.parameters, summary=one.summary)
    assert same == one
    text = (tmp_path / "city.scene" / INDEX).read_text()
    assert str(tmp_path) not in text
