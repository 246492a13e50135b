"""Alignment of scenes in parts: the same similarity and the same Gaussians as of the whole."""

import json

import numpy as np
import pytest

from alula.cli import main
from alula.schemas.artifacts.artifact import read_artifact, write_artifact
from alula.schemas.artifacts.kinds import SCENE
from alula.schemas.artifacts.parts import open_parts
from alula.schemas.artifacts.parts_join import read_whole
from alula.stages.alignment import scale_align
from support.scenes.parted import scene_of, write_parts


def run(*words):
    return main.run([str(word) for word in words])


def floor_scene(rng, x, rows=400, loss=None):
    """A floor of z = 1 and something above it, from x to x + 2 scene units."""
    mean = rng.uniform([x, 0, 0], [x + 2, 2, 0.002], (rows, 3))
    mean[:, 2] += 1
    mean[: rows // 5, 2] += rng.uniform(0.1, 1, rows // 5)
    return scene_of(mean, 0.01, loss, frame="scene", unit="arbitrary")


@pytest.fixture
def city(tmp_path):
    rng = np.random.default_rng(4)
    scenes = [floor_scene(rng, x, loss=[1e-3, 0.01, 0.02] if x else None) for x in (0, 2, 4)]
    path = write_parts(tmp_path / "city.scene", scenes)
    write_artifact(tmp_path / "one.scene.npz", read_whole(path))
    return path


POINTS = [(0, 0, 0, 0.01), (6, 0, 0, 0), (0, 2, 0, -0.01), (0, 0, 3, 0), (5, 1, 1, 0.01), (3, 2, 2, 0)]
PAIRS = "sx,sy,sz,wx,wy,wz\n" + "".join(
    f"{x},{y},{z},{2 * x + 100 + e},{2 * y},{2 * z - e}\n" for x, y, z, e in POINTS
)


@pytest.mark.parametrize("evidence", ["pairs", "scale", "floor"])
def test_parts_are_mapped_like_the_whole(tmp_path, city, evidence):
    (tmp_path / "pairs.csv").write_text(PAIRS)
    words = {
        "pairs": ["--correspondences", tmp_path / "pairs.csv"],
        "scale": ["--scale", 3],
        "floor": ["--scale", 3, "--up", "0 0 1", "--floor"],
    }[evidence]
    assert run("scale-align", tmp_path / "one.scene.npz", "-o", tmp_path / "m.scene.npz", "-q", *words) == 0
    assert run("scale-align", city, "-o", tmp_path / "m.scene", "-q", *words) == 0
    parts, one = open_parts(tmp_path / "m.scene", SCENE), read_artifact(tmp_path / "m.scene.npz")
    parts.check()
    assert [ref.file for ref in parts.refs] == [ref.file for ref in open_parts(city).refs]
    whole = read_whole(parts.path)
    for name in one.arrays:
        expected = one[name]
        rows = slice(400 if name == "loss" else 0, None)  # the first part has none, so nothing grows in it
        np.testing.assert_array_equal(whole[name][rows], expected[rows], strict=True)
    assert parts.manifest.world_from_scene == one.manifest.world_from_scene
    mine, theirs = parts.manifest.alignment, one.manifest.alignment
    assert mine["rounding_m"] >= theirs["rounding_m"]
    assert mine["rounding_m"] <= 4 * theirs["rounding_m"] + 1e-9
    loose = {"rounding_m", "position_error_m"}
    assert {k: v for k, v in mine.items() if k not in loose} == {
        k: v for k, v in theirs.items() if k not in loose
    }
    assert parts.manifest.suggested_inflation_m == pytest.approx(one.manifest.suggested_inflation_m, abs=1e-4)
    assert parts.manifest.suggested_inflation_m >= one.manifest.suggested_inflation_m
    for number, part in enumerate(parts):
        assert part.manifest.suggested_inflation_m == parts.manifest.suggested_inflation_m
        assert [ref.sha256 for ref in part.manifest.inputs] == [open_parts(city).refs[number].sha256]
        moved = np.abs(np.float64(part["mean"]))
        assert mine["rounding_m"] >= float(np.spacing(np.float32(moved.max())) / 2)


def test_the_floor_is_found_from_an_even_sample_and_the_record_says_so(tmp_path, city, monkeypatch):
    monkeypatch.setattr(scale_align, "MOST_POINTS", 500)
    words = ["--scale", 1, "--up", "0 0 1", "--floor"]
    assert run("scale-align", city, "-o", tmp_path / "m.scene", "-q", *words) == 0
    manifest = open_parts(tmp_path / "m.scene").manifest
    assert manifest.alignment["every_gaussian"] == 3
    assert manifest.world_from_scene.translation_m[2] == pytest.approx(-1, abs=0.01)
    aligner = scale_align.Aligner.__new__(scale_align.Aligner)
    aligner._scene, aligner._step = open_parts(city), 3
    every = np.concatenate([part["mean"] for part in aligner._scene])[::3]
    np.testing.assert_array_equal(aligner._sampled(0.0), np.float64(every))


def test_one_file_from_parts_parts_from_one_file_and_json(tmp_path, city, capsys):
    assert run("scale-align", city, "-o", tmp_path / "a.scene.npz", "--scale", 2, "-q") == 0
    assert run("scale-align", tmp_path / "one.scene.npz", "-o", tmp_path / "b.scene", "--scale", 2, "-q") == 0
    parts = open_parts(tmp_path / "b.scene")
    assert len(parts) == 1
    for name in ("mean", "scale", "quat_wxyz"):
        np.testing.assert_array_equal(parts[0][name], read_artifact(tmp_path / "a.scene.npz")[name])
    capsys.readouterr()
    assert run("scale-align", city, "-o", tmp_path / "c.scene", "--scale", 2, "--json") == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["summary"]["parts"] == 3
    assert answer["alignment"]["scale"] == 2
    assert run("scale-align", city, "-o", tmp_path / "c.scene", "--scale", 2) == 0
    assert "unchanged" in capsys.readouterr().out
    words = ["--correspondences", tmp_path / "pairs.csv", "--max-rms", 1e-6]
    (tmp_path / "pairs.csv").write_text(PAIRS)
    assert run("scale-align", city, "-o", tmp_path / "d.scene", *words) == 4
    assert not list(tmp_path.glob("d.scene*"))
