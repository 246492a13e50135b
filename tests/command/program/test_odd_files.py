"""Devices and pipes instead of files, odd names, and files that change during reading."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from alula.cli.main import run


def alula(*words, **options):
    command = [sys.executable, "-P", "-m", "alula.cli", *words]
    return subprocess.run(command, capture_output=True, check=False, timeout=60, **options)


@pytest.fixture
def splat(tmp_path, pipeline):
    return Path(shutil.copy(pipeline / "tiny.ply", tmp_path))


@pytest.mark.parametrize("words", [["import-splat", "-o", "x.scene.npz"], ["info"]])
def test_a_pipe_is_refused_at_once_and_not_waited_for(tmp_path, capsys, words):
    pipe = tmp_path / "pipe.ply"
    os.mkfifo(pipe)  # without a writer, opening it would wait forever
    words = [str(tmp_path / word) if word.endswith(".npz") else word for word in words]
    assert run([words[0], str(pipe), *words[1:]]) == 3
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "is a pipe or a device" in said
    assert "import-splat reads -" in said
    assert [path.name for path in tmp_path.iterdir()] == ["pipe.ply"]


def test_an_output_replaces_no_device(tmp_path, splat, capsys):
    """As root, renaming a file to /dev/null would replace the device for the whole machine."""
    pipe = tmp_path / "pipe.scene.npz"
    os.mkfifo(pipe)
    words = ["import-splat", str(splat), "-f", "-o"]
    assert run([*words, str(pipe)]) == 3
    assert "is a device or a pipe; outputs are files" in capsys.readouterr().err
    assert run([*words, str(tmp_path / "s.scene.npz"), "--depfile", str(pipe)]) == 3
    assert "is a device or a pipe; outputs are files" in capsys.readouterr().err
    assert pipe.is_fifo()
    assert not (tmp_path / "s.scene.npz").exists()


@pytest.mark.skipif(sys.platform == "darwin", reason="names of files are UTF-8 there")
def test_a_name_that_is_not_utf8(tmp_path, splat):
    odd = os.fsencode(tmp_path) + b"/\xff odd.ply"
    splat.rename(os.fsdecode(odd))
    output, rules = tmp_path / "s.scene.npz", tmp_path / "s.d"
    done = alula(b"import-splat", odd, "-o", str(output), "--depfile", str(rules))
    assert (done.returncode, done.stderr) == (0, b"")
    assert rules.read_bytes().endswith(b"/\xff\\ odd.ply\n")
    facts = json.loads(alula(b"info", b"--json", odd).stdout)
    assert facts["file"] == "\\xff odd.ply"
    again = alula(b"import-splat", odd, "-o", str(output))
    assert b"unchanged" in again.stdout


def test_an_input_that_changes_while_it_is_read(tmp_path, splat, capsys, monkeypatch):
    """Its hash would not be that of what was read."""
    from alula.stages.reconstruction.formats.registry import SplatFile

    decode = SplatFile.decode

    def slow(self, progress=None):
        splats = decode(self, progress)
        with splat.open("r+b") as file:
            file.seek(-4, os.SEEK_END)
            file.write(b"\0\0\0\0")
        os.utime(splat, ns=(1, 1))
        return splats

    monkeypatch.setattr(SplatFile, "decode", slow)
    assert run(["import-splat", str(splat), "-o", str(tmp_path / "s.scene.npz")]) == 3
    assert "tiny.ply: changed while it was read" in capsys.readouterr().err
    assert not (tmp_path / "s.scene.npz").exists()


@pytest.mark.parametrize("name", ["ply", "compressed-ply", "splat", "ksplat", "spz", "json"])
def test_a_folder_where_the_format_is_a_file(tmp_path, capsys, name):
    folder = tmp_path / "folder"
    folder.mkdir()
    words = ["import-splat", str(folder), "--format", name, "-o", str(tmp_path / "s.scene.npz")]
    assert run(words) == 3
    said = capsys.readouterr().err
    assert said == f"alula: {folder}: is a folder, but that format is a file; name the file in it\n"


@pytest.mark.parametrize(
    "raw",
    [
        b'{"means": ' + b"[" * 50_000,
        b'{"means": [[0,0,0]], "x": ' + b"[" * 20_000 + b"]" * 20_000 + b"}",
        b'{"means": [[0,0,0]], "x": "\xff\xfe"}',
        b'{"means": [[0,0,0]], "provenance": {"schema": 3}}',
        b'{"means": [[0,0,0]], "provenance": "\xff"}',
    ],
)
@pytest.mark.parametrize("command", ["import-splat", "info"])
def test_json_that_cannot_be_decoded_is_bad_input(tmp_path, capsys, raw, command):
    """Also where only the provenance is looked for."""
    path = tmp_path / "a.json"
    path.write_bytes(raw)
    words = ["-o", str(tmp_path / "s.scene.npz")] if command == "import-splat" else []
    assert run([command, str(path), *words]) == 3
    said = capsys.readouterr().err
    assert "a.json: JSON" in said
    assert said.count("\n") == 1
