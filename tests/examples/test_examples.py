"""The examples run, and their Makefiles behave as Make users expect."""

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from support.paths import ROOT

EXAMPLES = ROOT / "examples"
FILES = [
    *("room.ply", "room.scene.npz", "room.metric.scene.npz", "room.voxels.npz", "room.cover.npz"),
    *("room.certificate.json", "room.plan.npz", "hoops.run.mcap", "pairs.run.mcap", "room.report.html"),
]


def make(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    alula = f"{sys.executable} -P -m alula.cli"
    command = [
        "make",
        "-C",
        str(folder),
        f"ALULA={alula}",
        "GAUSSIANS=30000",
        "VOXEL=0.1",
        "TRIALS=5",
        *words,
    ]
    return subprocess.run(command, capture_output=True, text=True)


def commands_in(done: subprocess.CompletedProcess[str]) -> list[str]:
    """The alula commands that make ran."""
    assert done.returncode == 0, done.stderr + done.stdout
    lines = [line for line in done.stdout.splitlines() if " -m alula.cli " in line]
    lines = [line for line in lines if not line.startswith("  ")]  # what it advises to try next
    return [line.split(" -m alula.cli ")[1].split()[0] for line in lines]


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    """The room example, built once in a copy of its folder with two jobs."""
    folder = tmp_path_factory.mktemp("example") / "room"
    shutil.copytree(EXAMPLES / "room", folder, ignore=shutil.ignore_patterns("out"))
    done = make(folder, "-j2")
    assert len(commands_in(done)) == 10
    assert "report: " in done.stdout
    return folder


@pytest.fixture
def room(built, tmp_path) -> Path:
    """A private copy of the built example with its file times."""
    return Path(shutil.copytree(built, tmp_path / "room"))


def test_everything_is_there_and_nothing_half_made(built):
    found = {file.name for file in (built / "out").iterdir()}
    assert found >= set(FILES)
    assert not [name for name in found if name.endswith(".tmp")]


def test_the_second_time_nothing_is_done_but_the_result_is_shown(room):
    done = make(room)
    assert commands_in(done) == []
    assert "report: " in done.stdout
    assert "- obstacles covered: yes" in done.stdout


@pytest.mark.parametrize(
    ("touched", "rerun"),
    [
        ("scenario.toml", ["simulate", "report"]),
        ("out/room.plan.npz", ["simulate", "report"]),
        ("out/room.cover.npz", ["verify", "plan", "simulate", "simulate", "report"]),
    ],
)
def test_touching_a_file_reruns_what_depends_on_it_and_that_finds_itself_current(room, touched, rerun):
    before = {name: (room / "out" / name).stat().st_ino for name in FILES}
    time.sleep(0.01)
    (room / touched).touch()
    done = make(room)
    assert sorted(commands_in(done)) == sorted(rerun)
    assert done.stdout.count(": unchanged") >= len(rerun) - 1  # verify prints its table instead
    assert {name: (room / "out" / name).stat().st_ino for name in FILES} == before
    assert commands_in(make(room)) == []


@pytest.mark.parametrize(
    ("word", "rerun"),
    [
        ("TRIALS=3", ["simulate", "report"]),
        ("HULLS=250", ["merge", "verify", "plan", "simulate", "simulate", "report"]),
    ],
)
def test_a_changed_variable_reruns_what_depends_on_it(room, word, rerun):
    done = make(room, word)
    assert sorted(commands_in(done)) == sorted(rerun)
    assert commands_in(make(room, word)) == []
    record = json.loads((room / "out/pairs.run.json").read_text())
    assert len(record["trials"]) == (3 if word == "TRIALS=3" else 5)


def test_an_interrupted_run_leaves_whole_files_and_resumes(room):
    for name in FILES[1:]:
        (room / "out" / name).unlink()
    alula = f"{sys.executable} -P -m alula.cli"
    process = subprocess.Popen(
        ["make", "-C", str(room), f"ALULA={alula}", "GAUSSIANS=30000", "VOXEL=0.1", "TRIALS=5"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # background jobs ignore it
    )
    while not (room / "out/room.metric.scene.npz").exists():
        assert process.poll() is None
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGINT)
    assert process.wait(60) != 0
    assert not [file for file in (room / "out").iterdir() if file.suffix == ".tmp"]
    rest = commands_in(make(room))
    assert "import-splat" not in rest
    assert rest[-1] == "report"


def test_the_library_script_flies_a_scene(built):
    script = EXAMPLES / "library/fly_a_scene.py"
    words = [sys.executable, "-P", str(script), str(built / "out/room.ply"), "2.7", "0.1"]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "hulls" in done.stdout


def test_a_rehearsal_flies_in_the_map_that_the_room_example_makes(tmp_path):
    done = make(EXAMPLES / "rehearsal", "-n", f"OUT={tmp_path}/out", "FILTER=cone-backup", "HULLS=20")
    made = ["demo-scene", "import-splat", "scale-align", "voxelize", "merge", "plan", "sim-vehicle", "report"]
    assert commands_in(done) == made
    assert (
        f"merge -f {tmp_path}/out/room.voxels.npz -o {tmp_path}/out/room.cover.npz --hulls 20" in done.stdout
    )
    assert f"fly {tmp_path}/out/room.plan.npz --map {tmp_path}/out/room.metric.scene.npz" in done.stdout
    assert not (tmp_path / "out/room.ply").exists()


ALULA_OF_ONES_OWN = """#!/bin/sh
# Writes the requested output; a flight is logged and ends as $ENDS gives: with a code, or by Ctrl-C to all.
command=$1
while [ $# -gt 0 ]; do
  [ "$1" = -o ] && out=$2
  shift
done
echo "$command" >> "$CALLS"
[ "$command" = sim-vehicle ] && exec sleep 60
[ -n "$out" ] && echo "$command" > "$out"
[ "$command" = fly ] || exit 0
echo flown > "${out%.run.mcap}.run.json"
[ "$ENDS" = interrupt ] && kill -INT 0
exit "$ENDS"
"""


@pytest.mark.parametrize("ends", ["4", "interrupt"])
def test_a_rehearsal_that_fails_keeps_log_and_record_and_is_flown_again(tmp_path, ends):
    alula, out, calls = tmp_path / "alula", tmp_path / "out", tmp_path / "calls"
    alula.write_text(ALULA_OF_ONES_OWN)
    alula.chmod(0o755)

    def rehearse(ends):
        calls.write_text("")
        command = ["make", "-C", str(EXAMPLES / "rehearsal"), f"ALULA={alula}", f"OUT={out}"]
        surroundings = os.environ | {"CALLS": str(calls), "ENDS": ends}
        code = subprocess.run(
            command, env=surroundings, capture_output=True, start_new_session=True
        ).returncode
        return code, calls.read_text().split()

    assert {"fly", "report"} <= set(rehearse("0")[1])
    assert rehearse("0")[1] == []
    (out / "room.plan.npz").touch()
    for _ in range(2):  # and a failed one does not count as flown
        code, called = rehearse(ends)
        assert code != 0
        assert "fly" in called
        assert "report" not in called
        assert (out / "polytope-cbf.run.mcap").read_text() == "fly\n"
        assert (out / "polytope-cbf.run.json").read_text() == "flown\n"
    assert {"fly", "report"} <= set(rehearse("0")[1])
    (out / "polytope-cbf.run.mcap").unlink()
    assert "fly" in rehearse("0")[1]


def test_polymerge_sets_our_maps_beside_the_published_ones(tmp_path):
    folder = tmp_path / "polymerge"
    shutil.copytree(EXAMPLES / "polymerge", folder, ignore=shutil.ignore_patterns("out"))
    words = [f"PYTHON={sys.executable} -P", "VOXEL=0.15", "COUNTS=10 30", "FLIGHTS=10 30", "HULLS=40"]
    words += ["TRIALS=2", "COACD=", "ALULA_DATA=", "ALULA_CRAZYFLIE=", "PAGE=page.md", "-j2"]
    done = make(folder, *words)
    assert commands_in(done).count("merge") == 6
    assert "- room: " in done.stdout
    assert "ellipsoids → " in done.stdout
    out = folder / "out"
    table = (out / "table-1.csv").read_text().splitlines()
    assert len(table) == 1 + 1 + 9
    assert table[2].startswith("published: Bicycle,1500000,671.1,")
    rows = [line.split(",") for line in (out / "figure-4a.csv").read_text().splitlines()[1:]]
    assert [row[1] for row in rows] == ["ours", "paper's rule"]
    for row in rows:
        assert float(row[4]) >= 1
        assert float(row[5]) == pytest.approx(1, abs=1e-9)  # every voxel is inside
        assert row[6] == "0"
    assert (out / "figure-4b.png").read_bytes().startswith(b"\x89PNG")
    assert "Figure 4b" in (out / "polymerge.html").read_text()
    verdicts = [line.split(",") for line in (out / "verdicts.csv").read_text().splitlines()[1:]]
    assert {row[0] for row in verdicts} >= {"Table I", "Figure 4a", "Figure 4b", "Figure 5a", "Figure 5b"}
    flown = [line.split(",") for line in (out / "table-2.csv").read_text().splitlines()[1:]]
    assert [row[:5] for row in flown] == [
        ["10", "500.0", "0.7", "0.268", "2"],
        ["30", "250.0", "0.8", "0.253", "2"],
    ]
    methods = [line.split(",")[1] for line in (out / "figure-5.csv").read_text().splitlines()[1:]]
    assert methods[:3] == ["ours", "paper's rule", "safer-splat"]
    page = make(folder, *words, "page")
    assert commands_in(page) == []
    assert (
        "| Figure 4a | fraction of the occupied voxels inside the hulls | 1.0 | 1 | exact | reproduced |"
        in (folder / "page.md").read_text()
    )
    again = make(folder, *words)
    assert commands_in(again) == []
    assert "- room: " in again.stdout


def test_fastbridge_flies_every_filter_over_the_same_pairs(tmp_path):
    folder = tmp_path / "fastbridge"
    shutil.copytree(EXAMPLES / "fastbridge", folder, ignore=shutil.ignore_patterns("out"))
    swept = "ideal-di cone-di safer-splat safer-splat-gated cone-ecbf cone-backup cone-ecbf-tuned"
    paper = "none printed-backup-d printed-ecbf-14-clf printed-backup-split"
    words = [f"PYTHON={sys.executable} -P", "GAUSSIANS=20000", "TRIALS=2", "SPEEDS=2.1", "FLIGHT_SPEEDS=2.1"]
    words += [f"SWEPT={swept}", f"PAPER_VARIANTS={paper}"]
    words += [
        "ABLATION_SPEED=2.1",
        "ABLATIONS=ecbf-inflate-5cm backup-no-shield",
        "OTHERS=cone-backup-escape",
    ]
    words += ["LOOP_SPEEDS=1.1", "OTHER_SPEEDS=2.1", "PAGE=out/page.md", "ABLATIONS_PAGE=out/ours.md"]
    words += ["TUNE_TRIALS=1", "TUNE_SETTINGS=2", "ALULA_DATA=", "-j2"]
    make(folder, *words, "tune")
    with (folder / "tuning.csv").open(newline="") as file:
        tried = list(csv.DictReader(file))
    methods = {row["method"] for row in tried}
    assert {"safer-splat", "cone-di", "cone-ecbf", "cone-backup"} < methods
    for method in methods:  # the same search for all
        rows = [row for row in tried if row["method"] == method]
        assert [row["setting"] for row in rows] == ["0", "1"]
        assert [row["best"] for row in rows].count("yes") == 1
        worse = min(rows, key=lambda row: row["best"])
        best = max(rows, key=lambda row: row["best"])
        assert (int(best["collided"]), -int(best["reached"])) <= (
            int(worse["collided"]),
            -int(worse["reached"]),
        )
    done = make(folder, *words)
    assert "cone-ecbf against safer-splat (a row for every ellipsoid in the second): mean jerk" in done.stdout
    out = folder / "out"
    flown = {path.name.split("@")[0] for path in (out / "room").glob("*.run.mcap")}
    assert flown == {*swept.split(), *paper.split()}
    best = next(row for row in tried if (row["method"], row["best"]) == ("cone-ecbf", "yes"))
    tuned = json.loads((out / "room/cone-ecbf-tuned@2.1.run.json").read_text())
    parameters = tuned["provenance"]["parameters"]["safety"]["cone-ecbf"]
    for word in best["gains"].split():
        name, value = word.split("=")
        assert parameters[name] == float(value)
    split = json.loads((out / "room/printed-backup-split@1.1.run.json").read_text())
    assert split["timing"]["filter_calls"] < 0.21 * sum(t["steps"] for t in split["trials"])
    starts = set()
    for path in (out / "room").glob("*.run.json"):
        trials = json.loads(path.read_text())["trials"]
        starts.add(json.dumps([[t["start_m"], t["goal_m"]] for t in trials]))
        if path.name.startswith(("cone-ecbf@", "cone-backup@")):
            assert not any(t["collision"] for t in trials), path.name
            assert all(t["certified_steps"] == t["steps"] for t in trials), path.name
    assert len(starts) == 1
    rows = (out / "figure-4.csv").read_text().splitlines()
    assert rows[-1].startswith("published")
    of_the_paper = {"printed-backup-d", "printed-ecbf-14-clf", "printed-backup-split"}
    assert len(rows) == 1 + len(flown - {"ideal-di"} - of_the_paper) + 1
    assert "Figure 3" in (out / "fastbridge.html").read_text()
    verdicts = (out / "verdicts.csv").read_text().splitlines()
    assert len(verdicts) > 30
    make(folder, *words, "page")
    page = (out / "page.md").read_text()
    assert page.index("Proposition 3") < page.index("Gains found by the search") < page.index("## Figure 2")
    assert commands_in(make(folder, *words)) == []
    make(folder, *words, "ablations")
    ablations = (out / "ablations.csv").read_text().splitlines()
    assert [line.rsplit(",", 1)[1] for line in ablations] == [
        *("changed", "policy cone-escape", "–", "shield no", "–", "world.inflation_m 0.05"),
    ]
    assert len({*starts, *_starts(out)}) == 1  # also with another inflation


def _starts(out):
    """The pairs of all runs."""
    records = [json.loads(path.read_text()) for path in (out / "room").glob("*.run.json")]
    return {json.dumps([[t["start_m"], t["goal_m"]] for t in record["trials"]]) for record in records}
