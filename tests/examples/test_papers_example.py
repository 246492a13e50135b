"""`make papers`: an interruption costs one run, and every flight goes where it is sent."""

import shutil
import subprocess

import pytest

from support.paths import ROOT

NAMES = {
    "fastbridge": ("room", "room/cone-di@5.1.run.mcap", 60),
    "dr-acbf": ("scenario-1", "scenario-1/mpc.run.mcap", 55),
    "geofencing": ("wall", "wall/from-40.run.mcap", 39),
}


def make(folder, *words):
    command = ["make", "-C", str(folder), "QUICK=1", "ALULA=alula", "PYTHON=python", *words]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return [line for line in done.stdout.splitlines() if line.startswith("alula simulate ")]


@pytest.mark.parametrize(
    "name",
    ["fastbridge", *(pytest.param(name, marks=pytest.mark.slow) for name in ("dr-acbf", "geofencing"))],
)
def test_after_an_interruption_only_the_missing_run_is_made(tmp_path, name):
    group, missing, _ = NAMES[name]
    folder = tmp_path / "examples" / name
    shutil.copytree(ROOT / "examples" / name, folder, ignore=shutil.ignore_patterns("out"))
    page = f"out/quick/{name}.html"
    first = make(folder, "-n", page)
    for line in first:  # otherwise make touches folders as files
        output = folder / line.split(" -o ")[1].split()[0]
        output.parent.mkdir(parents=True, exist_ok=True)
    make(folder, "-t", page)
    (folder / "out/quick" / missing).unlink()
    (folder / page).unlink()
    again = make(folder, "-n", page, "SCHEDULER=tcp://127.0.0.1:8786")
    assert len(first) >= NAMES[name][2] - 3
    assert len(again) == 1
    assert f" -o out/quick/{missing} " in again[0]
    assert " --scheduler tcp://127.0.0.1:8786 " in again[0]
    assert not [line for line in first if "--scheduler" in line]
    assert group in again[0]
