"""Every command takes a scene or voxels in parts, with the result of one file."""

import json

import numpy as np
import pytest

import alula
from alula.cli import main
from alula.schemas.artifacts import parts_join
from alula.schemas.artifacts.artifact import Artifact, make_artifact, read_artifact
from alula.schemas.artifacts.kinds import SCENE
from alula.schemas.artifacts.parts import open_parts
from alula.schemas.log.run import read_run
from support.scenes.parted import write_parts


def run(*words):
    return main.run([str(word) for word in words])


def pieces(artifact, count):
    """The rows of a scene or of voxels in `count` artifacts."""
    fields = {
        name: getattr(artifact.manifest, name)
        for name in artifact.manifest.__struct_fields__
        if name not in ("schema", "version", "producer", "inputs", "arrays")
    }
    rows = np.array_split(np.arange(len(artifact["mean" if artifact.kind is SCENE else "index"])), count)
    return [
        make_artifact(artifact.kind, {name: array[some] for name, array in artifact.arrays.items()}, **fields)
        for some in rows
    ]


@pytest.fixture(scope="module")
def parted(pipeline, tmp_path_factory):
    folder = tmp_path_factory.mktemp("parted")
    for name, kind in (("tiny.metric", "scene"), ("tiny", "voxels")):
        whole = read_artifact(pipeline / f"{name}.{kind}.npz")
        write_parts(folder / f"tiny.{kind}", pieces(whole, 3))
    return folder


def equal(one, other):
    one, other = read_artifact(one), read_artifact(other)
    assert one.arrays.keys() == other.arrays.keys()
    for name in one.arrays:
        np.testing.assert_array_equal(one[name], other[name], strict=True)


def both(tmp_path, pipeline, parted, name, *words):
    """Outputs of a command for one file and for parts."""
    made = []
    for number, scene in enumerate((pipeline / "tiny.metric.scene.npz", parted / "tiny.scene")):
        made.append(tmp_path / f"{number}{name}")
        given = [scene if word == "SCENE" else word for word in words]
        assert run(*given, "-o", made[-1], "-q") == 0
    return made


WAY = ["--start", "0.5 1.5 1", "--goal", "3.5 1.5 1", "--radius", "0.2"]


def test_plan_observe_and_export_take_parts(tmp_path, pipeline, parted):
    equal(*both(tmp_path, pipeline, parted, ".plan.npz", "plan", "SCENE", *WAY))
    words = ["observe", "SCENE", "--radius", 0.15, "--cameras", pipeline / "cameras.csv"]
    equal(*both(tmp_path, pipeline, parted, ".seen.npz", *words))
    one, other = both(tmp_path, pipeline, parted, ".splat", "export", "SCENE")
    assert one.read_bytes() == other.read_bytes()


def test_simulate_takes_parts_and_records_the_index(tmp_path, pipeline, parted):
    words = ["simulate", "SCENE", "--trials", "2"]
    one, other = (read_run(path) for path in both(tmp_path, pipeline, parted, ".run.mcap", *words))
    assert [trial.outcome for trial in one.trials] == [trial.outcome for trial in other.trials]
    assert one.summary["min_scene_clearance_m"] == other.summary["min_scene_clearance_m"]


def test_verify_takes_a_scene_and_voxels_in_parts(tmp_path, pipeline, parted, capsys):
    cover = pipeline / "tiny.cover.npz"
    answers = []
    for voxels, scene in (
        (pipeline / "tiny.voxels.npz", pipeline / "tiny.metric.scene.npz"),
        (parted / "tiny.voxels", parted / "tiny.scene"),
    ):
        assert run("verify", cover, "--voxels", voxels, "--scene", scene, "--json") == 0
        answers.append(json.loads(capsys.readouterr().out)["checks"])
    assert answers[0] == answers[1]


def test_merge_of_parts_says_what_it_takes(tmp_path, parted, capsys):
    assert run("merge", parted / "tiny.scene", "-o", tmp_path / "a.cover.npz") == 3
    assert capsys.readouterr().err.count("\n") == 1


def test_info_explains_parts_and_finds_damage(tmp_path, parted, capsys):
    assert run("info", parted / "tiny.scene", "--json") == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["kind"] == "alula/scene"
    assert facts["in parts"]["parts"] == 3
    assert facts["in parts"]["elements"] == 800
    scale = np.concatenate([part["scale"] for part in open_parts(parted / "tiny.scene")])
    assert facts["in parts"]["longest semi-axis"] == pytest.approx(scale.max(), rel=1e-6)
    assert facts["undamaged"] is True
    assert facts["bytes"] == sum(file.stat().st_size for file in (parted / "tiny.scene").iterdir())
    path = write_parts(tmp_path / "a.voxels", pieces(read_artifact_of(parted / "tiny.voxels"), 2))
    raw = bytearray((path / "part-00001.voxels.npz").read_bytes())
    raw[-1] ^= 1
    (path / "part-00001.voxels.npz").write_bytes(raw)
    assert run("info", path) == 3
    said = capsys.readouterr()
    assert "part-00001.voxels.npz: does not match its SHA-256 in index.json" in said.err
    assert "alula/voxels" in said.out


def read_artifact_of(path) -> Artifact:
    return parts_join.read_whole(path)


def test_view_draws_parts_and_thins_those_of_a_large_scene(tmp_path, parted, monkeypatch, capsys):
    page = tmp_path / "a.html"
    assert run("view", parted / "tiny.scene", parted / "tiny.voxels", "-o", page, "--json") == 0
    assert json.loads(capsys.readouterr().out)["summary"]["gaussians"] == 800
    monkeypatch.setattr("alula.stages.show.viewing.files.MOST_READ", 90)
    assert run("view", parted / "tiny.scene", "-o", page, "-f", "--json") == 0
    summary = json.loads(capsys.readouterr().out)["summary"]
    assert summary["gaussians"] in range(85, 91)
    assert f"{summary['gaussians']} of 800 Gaussians, by contribution" in summary["notes"][0]


def test_a_whole_beyond_the_memory_is_refused_by_each_command(tmp_path, parted, capsys, monkeypatch):
    monkeypatch.setitem(parts_join.MOST, SCENE.name, 799)
    for words in (
        ["plan", parted / "tiny.scene", *WAY, "-o", tmp_path / "a.plan.npz"],
        ["simulate", parted / "tiny.scene", "-o", tmp_path / "a.run.mcap"],
        ["export", parted / "tiny.scene", "-o", tmp_path / "a.ply"],
        ["scale-align", parted / "tiny.scene", "--scale", "1", "-o", tmp_path / "a.scene.npz"],
    ):
        assert run(*words) == 3, words
        (line,) = capsys.readouterr().err.splitlines()
        assert "has 800 Gaussians; this command needs all of them in memory and takes at most 799" in line
    assert list(tmp_path.iterdir()) == []


def test_no_command_replaces_its_own_input(parted, capsys):
    scene = parted / "tiny.scene"
    assert run("scale-align", scene, "-o", scene, "--scale", "2", "-f") == 2
    assert "is also an input" in capsys.readouterr().err
    assert run("info", scene, "-q") == 0


def test_functions_of_python_take_parts_and_write_the_bytes_of_the_commands(tmp_path, parted):
    scene, voxels = parted / "tiny.scene", parted / "tiny.voxels"
    made = alula.voxelize(scene, size_m=0.2).save(tmp_path / "a.voxels.npz")
    assert run("voxelize", scene, "-o", tmp_path / "b.voxels.npz", "--size", "0.2", "-q") == 0
    assert (tmp_path / "a.voxels.npz").read_bytes() == (tmp_path / "b.voxels.npz").read_bytes()
    assert made.summary["parts"] > 1
    block = {"block_m": 1.0, "hulls": 30, "jobs": 1}
    cover = alula.merge(voxels, **block).save(tmp_path / "a.cover.npz")
    words = ["--block", "1", "--hulls", "30", "--jobs", "1", "-q"]
    assert run("merge", voxels, "-o", tmp_path / "b.cover.npz", *words) == 0
    assert (tmp_path / "a.cover.npz").read_bytes() == (tmp_path / "b.cover.npz").read_bytes()
    assert alula.verify(cover, voxels=voxels, scene=scene).certificate.covered
    with pytest.raises(alula.UsageError, match="parts that are not joined; give a folder"):
        alula.merge(voxels, per_block=True, **block)
