"""The command `alula voxelize`: exit codes, files, messages."""

import json

import numpy as np
import pytest

from alula.cli.main import run
from alula.schemas.artifacts.artifact import make_artifact, read_artifact, write_artifact
from alula.schemas.artifacts.kinds import SCENE, VOXELS


def write_scene(path, **fields):
    rng = np.random.default_rng(8)
    quat = rng.normal(size=(200, 4))
    arrays = {
        "mean": rng.uniform(-1, 1, (200, 3)),
        "scale": rng.uniform(0.01, 0.2, (200, 3)),
        "quat_wxyz": quat / np.linalg.norm(quat, axis=1, keepdims=True),
        "opacity": np.ones(200),
        "color": np.zeros((200, 3)),
    }
    keywords = {"frame": "world", "unit": "m", "parameters": {}, "summary": {}, "source": {}} | fields
    write_artifact(path, make_artifact(SCENE, arrays, **keywords))
    return path


@pytest.fixture
def scene(tmp_path):
    return write_scene(tmp_path / "a.scene.npz", suggested_inflation_m=0.02)


def test_voxels_are_written_once_and_then_left_alone(scene, tmp_path, capsys):
    output = tmp_path / "a.voxels.npz"
    words = ["voxelize", str(scene), "-o", str(output), "--size", "0.1", "--min-overlap", "2", "--json"]
    assert run(words) == 0
    record = json.loads(capsys.readouterr().out)
    voxels = read_artifact(output, VOXELS)
    assert record["status"] == "written"
    assert record["summary"]["voxels"] == len(voxels["index"]) > 100
    assert (voxels["overlap"] >= 2).all()
    assert voxels.manifest.inflation_m == 0.02
    assert voxels.manifest.parameters["min_overlap"] == 2
    assert [ref.role for ref in voxels.manifest.inputs] == ["scene"]
    before = output.read_bytes()
    assert run([*words, "--jobs", "3"]) == 0
    assert json.loads(capsys.readouterr().out)["status"] == "unchanged"
    assert run([*words[:-1], "-f", "--inflate", "0"]) == 0
    assert output.read_bytes() != before
    assert run([*words, "-f", "--jobs", "1"]) == 0
    assert output.read_bytes() == before
    assert run([*words, "--tile", "0.5"]) == 0
    assert '"status": "unchanged"' in capsys.readouterr().out
    output.unlink()
    assert run([*words, "--tile", "0.5"]) == 0
    assert output.read_bytes() == before


def test_a_dry_run_writes_nothing(scene, tmp_path, capsys):
    assert run(["voxelize", str(scene), "-o", str(tmp_path / "b.voxels.npz"), "--size", "0.1", "-n"]) == 0
    assert "dry-run" in capsys.readouterr().out
    assert [p.name for p in tmp_path.iterdir()] == ["a.scene.npz"]


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["--min-overlap", "0"], 2, "--min-overlap must be at least 1"),
        (["--crop", "0", "0", "0", "1", "1", "0"], 2, "--crop needs XMIN < XMAX"),
        (["--confidence", "1.5"], 2, "--confidence must be above 0 and below 1"),
        (["--size", "nan"], 2, "not finite"),
        (["--min-opacity", "2"], 2, "--min-opacity must be between 0 and 1"),
        (["--tile", "0"], 2, "--tile must be more than 0"),
        (["--scheduler", "nowhere"], 2, "--scheduler must be an address like tcp://host:8786"),
        (["--scheduler", "tcp://10.0.0.7:8786"], 2, "10.0.0.7 is not this machine; pass --allow-remote"),
        (["--size", "0.0001"], 3, "a.scene.npz: voxels of 0.0001 m: "),
        (["--size", "0.0001", "--max-voxels", "134217728"], 3, "a.scene.npz: the scene would need at least"),
        (["--max-voxels", "0"], 2, "--max-voxels must be at least 1"),
        (["--min-overlap", "199", "--size", "0.1"], 5, "no voxel is touched by 199 Gaussians"),
        (["--crop", "8", "8", "8", "9", "9", "9"], 5, "no Gaussian touches the crop"),
    ],
)
def test_what_cannot_be_done_is_said_in_one_line(scene, tmp_path, capsys, words, code, message):
    output = tmp_path / "c.voxels.npz"
    assert run(["voxelize", str(scene), "-o", str(output), "--sigma", "3", *words]) == code
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not output.exists()


def test_a_scene_without_metric_scale_is_refused(tmp_path, capsys):
    scene = write_scene(tmp_path / "raw.scene.npz", frame="scene", unit="arbitrary")
    assert run(["voxelize", str(scene), "-o", str(tmp_path / "c.voxels.npz")]) == 3
    assert "run scale-align first" in capsys.readouterr().err


def test_help_shows_two_examples(capsys):
    assert run(["voxelize", "-h"]) == 0
    assert capsys.readouterr().out.count("alula voxelize ") >= 3
