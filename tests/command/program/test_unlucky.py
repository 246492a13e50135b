"""Signals, pipes, full disks and files that shrink while they are read."""

import errno
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from alula.cli.main import run
from alula.schemas.artifacts.artifact import read_artifact
from alula.schemas.atomic import atomic_outputs
from alula.schemas.errors import OutputError
from support.paths import ROOT

ALULA = [sys.executable, "-P", "-m", "alula.cli"]


def test_an_interruption_while_modules_are_imported_ends_with_one_line():
    """The signal comes when `click` is imported, long before the command line is read."""
    script = (
        "import os, signal, sys\n"
        "class Interrupting:\n"
        "    def find_spec(self, name, path, target=None):\n"
        "        if name == 'click':\n"
        "            os.kill(os.getpid(), getattr(signal, sys.argv[1]))\n"
        "sys.meta_path.insert(0, Interrupting())\n"
        "from alula.cli.start import main\n"
        "main()\n"
    )
    for name in ("SIGINT", "SIGTERM"):
        words = [sys.executable, "-P", "-c", script, name]
        done = subprocess.run(words, capture_output=True, text=True)
        assert (done.returncode, done.stderr) == (130, "alula: interrupted\n")


def test_the_program_starts_where_interruptions_are_handled():
    assert 'alula = "alula.cli.start:main"' in (ROOT / "pyproject.toml").read_text()
    light = "import sys; import alula.cli.start; print([m for m in ('click', 'msgspec') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-P", "-c", light], capture_output=True, text=True)
    assert done.stdout == "[]\n"


def test_a_library_of_colmap_does_not_take_the_signals_away():
    pytest.importorskip("pycolmap")
    script = (
        "import os, signal\n"
        "from alula.cli.shell.interruption import Interruption, handlers_kept\n"
        "Interruption().install()\n"
        "with handlers_kept():\n"
        "    import pycolmap\n"
        "for number in (signal.SIGTERM, signal.SIGINT):\n"
        "    try:\n"
        "        os.kill(os.getpid(), number)\n"
        "    except KeyboardInterrupt:\n"
        "        print('interrupted')\n"
    )
    done = subprocess.run([sys.executable, "-P", "-c", script], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "interrupted\n" * 2, "")


@pytest.mark.slow
def test_sigterm_while_a_colmap_model_is_read_ends_with_one_line(pipeline, tmp_path):
    """The reference is a file that has the program busy for seconds; the model is never finished."""
    pytest.importorskip("pycolmap")
    model = tmp_path / "model"
    model.mkdir()
    for name in ("cameras.txt", "images.txt", "points3D.txt"):
        (model / name).write_text("")
    rows = "".join(f"a{i},{i},0,0\n" for i in range(1_500_000))
    (tmp_path / "reference.csv").write_text("image,x,y,z\n" + rows)
    words = ["scale-align", str(pipeline / "tiny.scene.npz"), "-o", str(tmp_path / "o.scene.npz")]
    words += ["--colmap", str(model), "--reference", str(tmp_path / "reference.csv")]
    with subprocess.Popen([*ALULA, *words], stderr=subprocess.PIPE, text=True) as process:
        maps = Path(f"/proc/{process.pid}/maps")
        end = time.monotonic() + 60
        while "pycolmap" not in maps.read_text() and time.monotonic() < end:
            time.sleep(0.05)
        time.sleep(1.0)
        process.send_signal(signal.SIGTERM)
        said = process.stderr.read()
        assert (process.wait(60), said.strip()) == (130, "alula: interrupted")  # click begins a line
    assert not (tmp_path / "o.scene.npz").exists()


@pytest.mark.parametrize(
    "words",
    [
        ["verify", "{pipe}"],
        ["verify", "{cover}", "--voxels", "{pipe}"],
        ["verify", "{cover}", "--scene", "{pipe}"],
        ["verify", "{map}", "--cover", "{pipe}"],
        ["info", "{pipe}"],
        ["plan", "{pipe}", "--start", "0 0 1", "--goal", "1 1 1", "-o", "{out}.npz"],
        ["simulate", "{pipe}", "-o", "{out}.mcap"],
        ["simulate", "{cover}", "--pairs-from", "{pipe}", "-o", "{out}.mcap"],
        ["simulate", "{cover}", "--scene", "{pipe}", "-o", "{out}.mcap"],
        ["simulate", "{scene}", "--filter", "cone-ecbf", "--vehicle", "{pipe}", "-o", "{out}.mcap"],
        ["simulate", "{plan}", "--map", "{pipe}", "-o", "{out}.mcap"],
        ["report", "{pipe}", "-o", "{out}.html"],
        ["report", "--cover", "{cover}", "--certificate", "{pipe}", "-o", "{out}.html"],
        ["scale-align", "{scene}", "--reference", "{pipe}", "--cameras", "{pipe}", "-o", "{out}.npz"],
        ["fly", "{plan}", "--map", "{cover}", "--link", "udpin:127.0.0.1:0", "--signing-key", "{pipe}"],
        ["fly", "{pipe}", "--map", "{cover}", "--link", "udpin:127.0.0.1:0"],
        ["sim-vehicle", "--link", "udpout:127.0.0.1:9", "--signing-key", "{pipe}"],
    ],
    ids=lambda words: " ".join(words[:4]),
)
def test_no_command_waits_for_a_pipe(pipeline, tmp_path, capsys, words):
    os.mkfifo(tmp_path / "pipe.npz")
    files = {name: str(pipeline / f"tiny.{name}.npz") for name in ("cover", "scene", "plan")}
    files |= {"map": str(pipeline / "tiny.map.bin"), "pipe": str(tmp_path / "pipe.npz")}
    if words[0] == "fly":
        words = [*words, "-o", "{out}.mcap"]

    def late(number, frame):
        raise TimeoutError("waits for the pipe")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(60)
    try:
        code = run([word.format(out=tmp_path / "o", **files) for word in words])
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    said = capsys.readouterr().err
    assert (code, "is a pipe or a device" in said) == (3, True), said
    assert sorted(path.name for path in tmp_path.iterdir()) == ["pipe.npz"]


def test_a_full_disk_replaces_none_of_several_files(tmp_path, monkeypatch):
    one, two = tmp_path / "a.bin", tmp_path / "a.h"
    for path in (one, two):
        path.write_bytes(b"old")
    real, calls = os.fsync, []

    def full(descriptor):
        calls.append(descriptor)
        if len(calls) == failing:
            raise OSError(errno.ENOSPC, "No space left on device")
        real(descriptor)

    monkeypatch.setattr(os, "fsync", full)

    def write():
        with atomic_outputs(one, two) as files:
            for file in files:
                file.write(b"new")

    for number in (1, 2):
        failing = number
        calls.clear()
        with pytest.raises(OutputError, match="cannot write: No space left"):
            write()
        assert (one.read_bytes(), two.read_bytes()) == (b"old", b"old")
        assert len(list(tmp_path.iterdir())) == 2


def test_an_export_for_a_target_replaces_both_files_or_none(pipeline, tmp_path, monkeypatch):
    words = ["export", str(pipeline / "tiny.cover.npz"), "--target", "crazyflie", "-f", "-q"]
    words += ["-o", str(tmp_path / "o.bin")]
    assert run(words) == 0
    made = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert sorted(made) == ["o.bin", "o.h"]
    for path in tmp_path.iterdir():
        path.write_bytes(b"other")
    real, count = os.fsync, 0

    def full(descriptor):
        nonlocal count
        count += 1
        if count == 2:
            raise OSError(errno.ENOSPC, "No space left on device")
        real(descriptor)

    monkeypatch.setattr(os, "fsync", full)
    assert run(words) == 3
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == dict.fromkeys(made, b"other")
    assert run(words) == 0
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == made


def test_an_artifact_that_is_cut_after_it_was_read_stays_readable(pipeline, tmp_path):
    path = Path(shutil.copy(pipeline / "tiny.scene.npz", tmp_path))
    found = read_artifact(path)
    wanted = {name: array.copy() for name, array in found.arrays.items()}
    os.truncate(path, 100)
    for name, array in found.arrays.items():
        assert np.array_equal(array, wanted[name])
        assert not array.flags.writeable
