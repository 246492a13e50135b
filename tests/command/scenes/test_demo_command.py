"""`alula demo`: the example of the built-in room in a folder of one's own, run by make."""

import json
import os

import pytest

from alula.cli.main import run
from support.paths import EXAMPLES

MAKE = """#!/bin/sh
printf '%s\\n' "$@" > "$CALLS"
exit "$ENDS"
"""


@pytest.fixture
def calls(tmp_path, monkeypatch):
    """The words that a make of ours was called with, which ends with the code $ENDS."""
    place = tmp_path / "bin"
    place.mkdir()
    (place / "make").write_text(MAKE)
    (place / "make").chmod(0o755)
    monkeypatch.setenv("PATH", f"{place}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("CALLS", str(tmp_path / "calls"))
    monkeypatch.setenv("ENDS", "0")
    monkeypatch.chdir(tmp_path)
    return tmp_path / "calls"


def test_the_demo_runs_the_example_of_the_room_in_a_folder(calls, tmp_path, capfd):
    assert run(["demo", "-o", "room", "--json"]) == 0
    for name in ("Makefile", "scenario.toml"):
        assert (tmp_path / "room" / name).read_text() == (EXAMPLES / "room" / name).read_text()
    words = calls.read_text().splitlines()
    assert words[words.index("-C") + 1] == "room"
    assert words[-1].startswith("ALULA=")
    assert json.loads(capfd.readouterr().out)["output"] == "room/out/room.report.html"


def test_the_demo_keeps_a_scenario_that_was_changed(calls, tmp_path):
    (tmp_path / "alula-demo").mkdir()
    (tmp_path / "alula-demo/scenario.toml").write_text("name = 'mine'\n")
    assert run(["demo", "-q"]) == 0
    assert (tmp_path / "alula-demo/scenario.toml").read_text() == "name = 'mine'\n"
    assert (tmp_path / "alula-demo/Makefile").exists()


def test_a_demo_that_fails_says_so_in_one_line(calls, monkeypatch, capsys):
    monkeypatch.setenv("ENDS", "2")
    assert run(["demo"]) == 1
    assert (
        capsys.readouterr().err
        == "alula: alula-demo: the demo ended before its report, for the reason above\n"
    )


def test_the_demo_needs_make(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert run(["demo"]) == 2
    assert capsys.readouterr().err == "alula: the program make is missing: sudo apt-get install make\n"
    assert list(tmp_path.iterdir()) == []


def test_the_folder_of_the_demo_can_be_made(calls, tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert run(["demo", "-o", "file"]) == 3
    assert len(capsys.readouterr().err.splitlines()) == 1
