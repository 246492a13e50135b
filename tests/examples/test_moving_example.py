"""The example of moving obstacles runs at a small size."""

import csv
import json
import shutil
import subprocess
import sys
from pathlib import Path

from support.paths import ROOT

EXAMPLE = ROOT / "examples/dr-acbf"
FEW = [
    *("TRIALS=3", "METHODS=none dr-acbf", "SWEEP=hold-0.1", "TRIGGERS=trigger-simple"),
    *(
        "CHOICES=jerk-20",
        "DELAYS=0",
        "NOISES=2",
        "RATES=20",
        "DETECTIONS=0.95",
        "WALLED=dr-acbf",
        "SMALL=none",
    ),
    *("PRINTED=eq-19", "COMPARED=dr-acbf mpc", "AXES=detection", "LEVELS.detection=0.5"),
    *("CONDITIONS_HARD=late", "SETTINGS=6-3-1 0-3-2", "TICKS=--recorded 2 --repeats 1 --tick-seconds 3"),
    f"BENCHMARK={ROOT / 'benchmarks/dracbf.py'}",
    "ORDER=scenario-1 scenario-2 difficulty tune hard thrown wall sensitivity-1 collapse",
]


def make(folder: Path, *words: str) -> str:
    alula = [f"ALULA={sys.executable} -P -m alula.cli", f"PYTHON={sys.executable} -P"]
    done = subprocess.run(
        ["make", "-C", str(folder), *alula, *words], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr + done.stdout
    return done.stdout


def test_every_table_is_made_from_runs_of_the_same_trials_and_only_once(tmp_path):
    folder = tmp_path / "dr-acbf"
    shutil.copytree(EXAMPLE, folder, ignore=shutil.ignore_patterns("out"))
    printed = make(folder, *FEW, "-j2")
    assert "- without a filter, scenario-1: " in printed
    assert "- simple trigger: collapses in " in printed
    out = folder / "out"
    names = {
        "verdicts",
        "difficulty",
        "tuning",
        "hard",
        "saved",
        "warning",
        "printed-1",
        "table-1",
        "table-2",
        "table-3",
        "collapse",
        "table-4",
        "wall",
        "recursion",
        "risk",
    }
    assert {path.stem for path in out.glob("*.csv")} > names | {"sensitivity-1"}
    assert "Where the simple trigger collapses" in (out / "dr-acbf.html").read_text()
    counts = {len(json.loads(p.read_text())["trials"]) for p in out.glob("*/*.run.json")}
    assert counts == {3}
    # Without a filter obstacle 2 of scenario 1, which comes straight ahead, always hits.
    with (out / "table-1.csv").open(newline="") as file:
        first = next(csv.DictReader(file))
    assert (first["variant"], first["obstacle 2 [%]"]) == ("none", "0.0")
    again = make(folder, *FEW)
    assert " simulate " not in again
    changed = make(folder, *FEW, "VARIANT.hold-0.1=--set safety.dr-acbf.hold_s=0.15")
    assert changed.count(" simulate ") == 1
