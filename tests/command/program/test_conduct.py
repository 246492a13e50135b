"""Behaviour of the program towards others: streams, exit codes, file names, Makefiles."""

import json
import os
import subprocess
import sys
from pathlib import Path

import click
import pytest

from alula.cli.main import COMMANDS, cli, run
from alula.cli.shell.present import plain, print_sections
from alula.schemas.artifacts.artifact import write_artifact
from support.scenes.fabricate import make_scene

ALULA = [sys.executable, "-P", "-m", "alula.cli"]


@pytest.fixture
def here(tmp_path, monkeypatch) -> Path:
    write_artifact(tmp_path / "a.scene.npz", make_scene(30))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def shell(command: str, **environment: str) -> subprocess.CompletedProcess[str]:
    line = command.replace("alula", " ".join(f"'{word}'" for word in ALULA))
    env = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)} | environment
    return subprocess.run(["bash", "-c", line], capture_output=True, text=True, env=env, errors="replace")


@pytest.mark.parametrize("words", ["info a.scene.npz", "--version", "voxelize -h"])
def test_a_closed_pipe_is_no_error_of_ours(here, words):
    done = shell(f"alula {words} | true; exit ${{PIPESTATUS[0]}}")
    assert (done.returncode, done.stderr) == (141, "")


def test_closed_streams_lead_nowhere(here):
    for words in ("info a.scene.npz", "voxelize a.scene.npz -o b.voxels.npz --size 1"):
        for streams in (">&-", ">&- 2>&- <&-"):
            done = shell(f"alula {words} {streams}")
            assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert run(["info", "b.voxels.npz", "-q"]) == 0


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_is_said_in_one_line(here):
    done = shell("alula info a.scene.npz > /dev/full")
    assert (done.returncode, done.stderr) == (3, "alula: cannot write the result: No space left on device\n")


def test_a_terminal_that_cannot_show_a_character_shows_another(here):
    (here / "a.scene.npz").rename(here / "ä漢.scene.npz")
    done = shell("alula info *.scene.npz", PYTHONIOENCODING="latin-1")
    assert (done.returncode, done.stderr) == (0, "")
    assert "?.scene.npz" in done.stdout


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["voxelise"], "no command is called 'voxelise'; did you mean 'voxelize'? (see 'alula -h')"),
        (["info"], "Missing argument 'FILE' (see 'alula info -h')"),
        (["info", ""], "the name of the file is empty"),
        (["info", "-"], "artifacts are files, not streams"),
        (["voxelize", "a.scene.npz", "-o", "-"], "artifacts are files, not streams"),
        (["voxelize", "a.scene.npz", "-o", "x\ny.npz"], "has a line break"),
        (["merge", "a.scene.npz", "-o", "b.npz", "--hulls", "9" * 30], "is out of range"),
        (["merge", "a.scene.npz", "-o", "b.npz", "--jobs", "257"], "257 is not between 0 and 256"),
        (["merge", "a.scene.npz", "-o", "b.npz", "--cluster-radius", "1.5"], "'1.5' is not a whole number"),
        (["voxelize", "a.scene.npz", "-o", "b.npz", "--sigma", "2", "--confidence", "0.9"], "give one"),
        (["voxelize", "a.scene.npz", "-o", "b.npz", "--depfile", "a.scene.npz"], "is also an input"),
        (["voxelize", "a.scene.npz", "-o", "b.npz", "--depfile", "b.npz"], "is also the output"),
        (["verify", "a.scene.npz", "--depfile", "b.d"], "--depfile needs a certificate"),
        (["demo-scene", "-o", "b.foo"], "must end in .ply"),
        (["demo-scene", "-o", "b.ply", "--colmap", "b.ply"], "--colmap is a folder"),
    ],
)
def test_wrong_usage_is_explained_and_leaves_nothing(here, capsys, words, message):
    assert run(words) == 2
    assert message in capsys.readouterr().err
    assert [path.name for path in here.iterdir()] == ["a.scene.npz"]


def test_no_word_at_all_shows_the_help_as_a_complaint(capsys):
    assert run([]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("Usage: alula")
    assert "import-splat" in err


def test_json_is_one_object_whatever_happens(here, capsys):
    assert run(["info", "none.npz", "--json"]) == 3
    out, err = capsys.readouterr()
    assert json.loads(out) == {"error": err.removeprefix("alula: ").strip(), "exit_code": 3}
    assert run(["zzz", "--json"]) == 2
    assert json.loads(capsys.readouterr().out)["exit_code"] == 2
    raw = (here / "a.scene.npz").read_bytes()
    (here / "a.scene.npz").write_bytes(raw[:-90])
    assert run(["info", "a.scene.npz", "--json"]) == 3
    assert json.loads(capsys.readouterr().out)["undamaged"] is False
    assert run(["info", "--", "--json"]) == 3
    assert capsys.readouterr().out == ""


def test_a_traceback_is_shown_on_request_only(here, capsys):
    assert run(["info", "none.npz", "-vv"]) == 3
    assert "Traceback" in capsys.readouterr().err
    assert run(["info", "none.npz", "-v"]) == 3
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.parametrize(
    "name", ["a b", "a:b", "a%b", "a#b", "a$b", r"a\ b", r"a\b", "a[b]", "*?", "é", "-a"]
)
def test_make_reads_the_names_in_a_depfile_back(here, name):
    scene, voxels = here / f"{name}.scene.npz", here / f"{name}.voxels.npz"
    (here / "a.scene.npz").rename(scene)
    words = ["voxelize", str(scene), "-o", f"./{voxels.name}", "--size", "1", "--depfile", "x.d", "-q"]
    assert run(words) == 0
    rule = (here / "x.d").read_text().rstrip()
    (here / "Makefile").write_text(f"{rule}\n\t@echo made\n")
    make = ["make", "-r", f"./{voxels.name}"]
    os.utime(scene, (1, 1))
    assert "up to date" in subprocess.run(make, capture_output=True, text=True).stdout
    os.utime(voxels, (0, 0))
    assert subprocess.run(make, capture_output=True, text=True).stdout == "made\n"


def test_common_options_come_last_and_in_one_order():
    top = click.Context(cli, info_name="alula")
    common = ["output", "force", "dry_run", "seed", "jobs", "depfile", "json", "quiet", "verbose"]
    for name in COMMANDS:
        command = cli.get_command(top, name)
        options = [p.name for p in command.params if isinstance(p, click.Option)]
        shared = [option for option in options if option in common]
        assert (
            options[len(options) - len(shared) :]
            == shared
            == [option for option in common if option in shared]
        ), name
        for option in (p for p in command.params if isinstance(p, click.Option)):
            assert (option.help or "").endswith("."), (name, option.name)


def test_long_sequences_are_printed_in_brief(capsys):
    assert plain([1.0, 2.5, 3]) == "1 2.5 3"
    assert plain([[1, 2], [3, 4]]) == "1 2; 3 4"
    assert plain(list(range(100, 0, -1))) == "100 numbers from 100 to 1, within 1 and 100"
    assert plain([{"a": 1}] * 60) == "60 entries"
    print_sections({"kind": "x", "deep": {"curve": {"excess": [0.5] * 999, "none": None}, "n": 1}})
    out = capsys.readouterr().out
    assert "  curve.excess  999 numbers from 0.5 to 0.5, within 0.5 and 0.5\n  n             1\n" in out
    assert "none" not in out
    print_sections({"map_origin_m": [4512345.25, 0.0], "size_m": 4512345.25})
    assert capsys.readouterr().out == "map_origin_m  4512345.25 0\nsize_m        4.51235e+06\n"


def test_an_interruption_is_one_word_however_other_code_words_it(here, monkeypatch, capsys):
    from alula.cli.verbs.results import File

    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt("decoding with 'cp437' codec failed")

    monkeypatch.setattr(File, "parts", interrupted)
    assert run(["voxelize", "a.scene.npz", "-o", "v.voxels.npz"]) == 130
    assert capsys.readouterr().err.split("\n")[-2:] == ["alula: interrupted", ""]
