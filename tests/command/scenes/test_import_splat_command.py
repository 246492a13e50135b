"""The command `alula import-splat`: files, folders, streams, filters, and notes about frames."""

import json
import subprocess
import sys

import numpy as np
import pytest

from alula.cli.main import run
from alula.schemas.artifacts.artifact import read_artifact
from alula.schemas.artifacts.kinds import SCENE

RECORD = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("quat", "u1", 4)])


def splat_bytes(count=40, seed=0):
    rng = np.random.default_rng(seed)
    raw = np.zeros(count, RECORD)
    raw["mean"], raw["scale"] = rng.uniform(-2, 2, (count, 3)), rng.uniform(0.01, 0.1, (count, 3))
    raw["rgba"], raw["quat"] = 200, rng.integers(0, 256, (count, 4))
    return raw.tobytes()


def alula(*words, stdin=b""):
    command = [sys.executable, "-P", "-m", "alula.cli", *map(str, words)]
    return subprocess.run(command, input=stdin, capture_output=True, check=False)


def test_a_stream_is_read_like_the_file(tmp_path):
    file = tmp_path / "a.splat"
    file.write_bytes(splat_bytes())
    assert run(["import-splat", str(file), "-o", str(tmp_path / "file.scene.npz"), "-q"]) == 0
    words = ["import-splat", "-", "-o", tmp_path / "stream.scene.npz", "--format", "splat"]
    done = alula(*words, stdin=splat_bytes())
    assert done.returncode == 0, done.stderr
    one, other = (read_artifact(tmp_path / f"{name}.scene.npz", SCENE) for name in ("file", "stream"))
    assert [ref.name for ref in other.manifest.inputs] == ["stdin"]
    assert other.manifest.inputs[0].sha256 == one.manifest.inputs[0].sha256
    for name in one.arrays:
        np.testing.assert_array_equal(one[name], other[name])
    again = alula(*words, stdin=splat_bytes())
    assert b"unchanged" in again.stdout
    other_content = alula(*words, stdin=splat_bytes(seed=1))
    assert other_content.returncode == 2
    assert b"-f replaces it" in other_content.stderr


def test_a_stream_of_splat_records_is_recognised_by_its_content(tmp_path):
    rows = np.frombuffer(splat_bytes(), RECORD).copy()
    assert (
        b"--format splat" in alula("import-splat", "-", "-o", tmp_path / "s.npz", stdin=splat_bytes()).stderr
    )
    rows["quat"] = 255, 128, 128, 128  # those of `splat_bytes` are not normalised
    done = alula("import-splat", "-", "-o", tmp_path / "s.scene.npz", stdin=rows.tobytes())
    assert done.returncode == 0, done.stderr
    assert read_artifact(tmp_path / "s.scene.npz", SCENE).manifest.source["format"] == "splat"


@pytest.mark.every(2)
@pytest.mark.parametrize(
    ("stdin", "options", "code", "words"),
    [
        (b"", [], 3, "standard input: is empty"),
        (b"nothing known", [], 3, "standard input: not a splat file that this version recognises"),
        (b"ply\nformat ascii 1.0\n", [], 3, "standard input: PLY: truncated"),
        (splat_bytes()[:-1], ["--format", "splat"], 3, "standard input: .splat: truncated"),
        (splat_bytes(), ["--depfile", "x.d"], 2, "--depfile names files, but the input is a stream"),
    ],
)
def test_a_bad_stream_is_one_line_and_no_file(tmp_path, stdin, options, code, words):
    done = alula("import-splat", "-", "-o", tmp_path / "s.scene.npz", *options, stdin=stdin)
    assert done.returncode == code
    assert words in done.stderr.decode()
    assert done.stderr.count(b"\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_the_frame_and_the_losses_are_printed(tmp_path, capsys):
    file = tmp_path / "a.splat"
    file.write_bytes(splat_bytes())
    words = ["import-splat", str(file), "-o", str(tmp_path / "s.scene.npz"), "--json"]
    assert run(words) == 0
    summary = json.loads(capsys.readouterr().out)["summary"]
    assert summary["frame"] == "that of the file (unnamed), unchanged"
    assert 0.031 < summary["loss"]["rotation_rad"] < np.pi  # the quaternions have any length
    assert run([*words, "-f", "--turn", "x"]) == 0
    summary = json.loads(capsys.readouterr().out)["summary"]
    assert summary["frame"] == "that of the file (unnamed), turned by 180 degrees about x"


def test_each_filter_is_undone_by_leaving_it_out(tmp_path, capsys):
    """And each is recorded: its parameter and its count."""
    file = tmp_path / "a.splat"
    file.write_bytes(splat_bytes(200))
    base = [
        "import-splat",
        str(file),
        "-o",
        str(tmp_path / "s.scene.npz"),
        "-f",
        "--json",
        "--min-opacity",
        "0",
    ]
    assert run(base) == 0
    plain = read_artifact(tmp_path / "s.scene.npz", SCENE)
    bare = {name: np.array(plain[name]) for name in plain.arrays}
    filters = {
        "min_opacity": ["--min-opacity", "0.9"],
        "crop": ["--crop-box", "-1", "-1", "-1", "1", "1", "1"],
        "crop_sphere": ["--crop-sphere", "0", "0", "0", "1.5"],
        "max_scale": ["--max-scale", "0.05"],
        "floaters": ["--drop-floaters"],
    }
    for reason, options in filters.items():
        capsys.readouterr()
        code = run([*base, *options])
        if reason == "min_opacity":
            assert code == 3
            continue
        summary = json.loads(capsys.readouterr().out)["summary"]
        assert summary["gaussians"] + summary["removed"][reason] == 200
        if reason.startswith("crop") or reason == "max_scale":
            assert 0 < summary["removed"][reason] < 200
    assert run(base) == 0
    again = read_artifact(tmp_path / "s.scene.npz", SCENE)
    assert set(again.manifest.source["removed"]) == {"min_opacity"}
    for name, array in bare.items():
        np.testing.assert_array_equal(again[name], array)


def test_notes_reach_stderr_but_not_a_program(tmp_path, capsys):
    raw = bytearray(splat_bytes(3))
    raw[12:16] = np.float32(-0.5).tobytes()
    file = tmp_path / "a.splat"
    file.write_bytes(raw)
    words = ["import-splat", str(file), "-o", str(tmp_path / "s.scene.npz"), "-f"]
    assert run(words) == 0
    assert "note: 1 rows with a negative scale" in capsys.readouterr().err
    (tmp_path / "s.scene.npz").unlink()
    assert run([*words, "--json"]) == 0
    assert capsys.readouterr().err == ""
