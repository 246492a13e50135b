"""The example of the geofencing paper runs at a small size."""

import csv
import json
import shutil
import subprocess
import sys
from pathlib import Path

from support.paths import ROOT

EXAMPLES = ROOT / "examples"
FEW = [
    *("TRIALS=2", "ENGAGED_TRIALS=1", "DISTANCES=40", "DISTURBANCES=nominal mass", "RESERVES=0 3"),
    *("ORDER=wall engaged box robustness", "FLOWN.wall=from-40 from-40-none"),
    *("FLOWN.engaged=geofence", "FLOWN.box=sticks stale-2s"),
    *("KINDS=sticks silent", "COMPARED=sticks-none", "PILOTS=20", "COMPARED_PILOTS=10"),
]


def make(folder: Path, *words: str) -> str:
    alula = [f"ALULA={sys.executable} -P -m alula.cli", f"PYTHON={sys.executable} -P"]
    done = subprocess.run(
        ["make", "-C", str(folder), *alula, *words], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr + done.stdout
    return done.stdout


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_every_table_is_made_of_runs_and_only_once(tmp_path):
    for name in ("geofencing", "vehicles"):
        shutil.copytree(EXAMPLES / name, tmp_path / name, ignore=shutil.ignore_patterns("out"))
    folder = tmp_path / "geofencing"
    printed = make(folder, *FEW, "-j2")
    assert "- passed commands: 0 of " in printed
    assert "- disturbance mass: without reserve " in printed
    out = folder / "out"
    tables = {"pendulum-time", "pendulum-gains", "wall", "engaged", "fences", "robustness"}
    assert {path.stem for path in out.glob("*.csv")} == tables | {"passes", "verdicts"}
    figures = {"pendulum", "chatter", "wall", "engaged", "robustness"}
    assert {path.stem for path in out.glob("*.svg")} == figures
    assert "Figure 8: repeated engagement of walls and floor" in (out / "geofencing.html").read_text()
    verdicts = {row["item"]: row["verdict"] for row in rows_of(out / "verdicts.csv")}
    assert verdicts["Figure 3"] == "reproduced"
    assert verdicts["Figure 6, V-A"] == "not available here"
    wall = {row["variant"]: row for row in rows_of(out / "wall.csv")}
    assert 104 < float(wall["from-40"]["peak speed [km/h]"]) < 115
    assert (wall["from-40"]["fence"], wall["from-40-none"]["fence"]) == ("held", "left")
    assert wall["published, flight"]["peak speed [km/h]"] == "104.0"
    left = {(row["fence"], row["variant"]): row["left the fence [%]"] for row in rows_of(out / "fences.csv")}
    assert {left.pop(("box", "stale-2s"))} <= {"0.0", "50.0", "100.0"}  # handed over: no fence is guarded
    assert set(left.values()) == {"0.0"}
    again = make(folder, *FEW)
    assert " simulate " not in again
    assert " compare.py" not in again
    changed = make(
        folder, *FEW, "VARIANT.mass_3=--set vehicle.mass_scale=1.1 --set safety.geofence.reserve_m=3"
    )
    assert changed.count(" simulate ") == 1
    # Pilots are flown beforehand; then the page includes them.
    make(folder, *FEW, "pilots", "PAGE_OUT=out", "-j2")
    records = [json.loads(path.read_text()) for path in out.glob("pilots/*.run.json")]
    assert len(records) == 3
    assert {len(record["trials"]) for record in records} == {1, 2}
    starts = [tuple(t["start_m"]) for r in records if r["filter"] == "geofence" for t in r["trials"]]
    assert len(set(starts)) == len(starts) == 4  # each kind has its own
    page = tmp_path / "geofencing.md"
    make(folder, *FEW, "written", f"DOCS={page}")
    assert "## Random pilots from random safe starts" in page.read_text()
    assert " simulate " not in make(folder, *FEW, "pilot-runs")


def test_the_page_is_one_of_the_page_sizes():
    """`page` flies more than the quick run, in a folder of its own."""
    done = subprocess.run(
        [
            "make",
            "-n",
            "-C",
            str(EXAMPLES / "geofencing"),
            "page",
            "ALULA=alula",
            "PYTHON=python",
            "PAGE_OUT=out/never",
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    flown = [line for line in done.stdout.splitlines() if "simulate" in line]
    assert len(flown) > 90
    assert all("-o out/never/" in line for line in flown)
    assert sum("--trials 200 " in line for line in flown) == 18
    assert sum("--trials 100 " in line for line in flown) == 49
    assert sum("--map out/never/room.cover.npz" in line for line in flown) == 5
    assert "--markdown ../../docs/results/geofencing.md" in done.stdout
