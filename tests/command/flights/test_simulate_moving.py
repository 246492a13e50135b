"""`alula simulate` on scenarios with moving obstacles: results, what is recorded, interruption, refusals."""

import json
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import msgspec
import pytest

from alula.cli.main import run
from alula.cli.shell import journal as file
from alula.schemas.artifacts.journal import TRIALS, unpack
from alula.schemas.artifacts.manifest import producer
from alula.schemas.log.flights import read_flights
from alula.schemas.log.mcap import messages
from alula.schemas.log.run import RunRecord, read_run
from alula.stages.simulation import simulate as stage
from alula.stages.simulation.chunks import TrialJournal

# What is random is too small to matter: what comes out can be reckoned.
SMALL = """
schema = "alula/scenario"
version = "2.0"
name = "small"
[vehicle]
type = "double-integrator"
radius_m = 0.15
max_speed_m_s = 12.0
max_acceleration_m_s2 = 6.0
max_jerk_m_s3 = 60.0
[[world.moving]]
motion = "accelerating"
position_m = [60, 1, 10]
velocity_m_s = [-6, 0, 0]
acceleration_m_s2 = [0, 1e-09]
radius_m = 0.2
[mission]
kind = "goal"
start_m = [0.0, 0.0, 10.0]
goal_m = [100.0, 0.0, 10.0]
start_speed_m_s = 4.0
speed_m_s = 4.0
receded_s = 1.0
[estimation.sensor]
kind = "ideal"
position_sigma_m = 0.01
[rules]
plant_steps = 10
trials = 6
max_time_s = 14.0
logged = 2
"""
LONG = """
schema = "alula/scenario"
version = "2.0"
[vehicle]
type = "double-integrator"
radius_m = 0.15
max_speed_m_s = 12.0
max_acceleration_m_s2 = 6.0
max_jerk_m_s3 = 60.0
[[world.moving]]
distance_m = 30
[[world.moving]]
distance_m = 35
azimuth_rad = [0.3, 0.6]
[mission]
kind = "goal"
start_m = [0.0, 0.0, 10.0]
goal_m = [200.0, 0.0, 10.0]
start_speed_m_s = 4.0
speed_m_s = 4.0
receded_s = 1.0
[safety]
filters = ["dr-acbf"]
[rules]
plant_steps = 10
trials = 800
max_time_s = 14.0
logged = 1
"""
EAGER = (
    "import sys; from alula.schemas.artifacts import manifest;"
    " manifest.native_commit = lambda: sys.argv.pop(1);"
    " manifest.producer();"
    " from alula.cli.shell import journal; journal.PERIOD_S, journal.MIN_RUN_S = 0.1, 0;"
    " journal.MAX_WRITING_FRACTION = 1e9; from alula.cli.main import main; main(sys.argv[1:])"
)
WORDS = ["simulate", "long.toml", "-o", "r.run.mcap", "--jobs", "1"]
JOURNAL = Path("r.run.mcap.journal")


@pytest.fixture
def here(tmp_path, monkeypatch) -> Path:
    (tmp_path / "small.toml").write_text(SMALL)
    (tmp_path / "long.toml").write_text(LONG)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def record(path="r.run.json") -> RunRecord:
    return msgspec.json.decode(Path(path).read_bytes(), type=RunRecord)


def test_a_small_run_says_what_geometry_says(here, capsys):
    assert run(["simulate", "small.toml", "-o", "r.run.mcap", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["status"] == "written"
    summary = said["summary"]
    assert (summary["trials"], summary["collisions"], summary["passed"]) == (6, 0, 6)
    assert summary["success_interval"] == pytest.approx([0.6096657, 1.0])
    (met,) = summary["obstacles"]
    assert met["success_rate"] == 1
    assert met["mean_closest_m"] == pytest.approx(1, abs=1e-6)
    found = record()
    assert (found.name, found.filter, len(found.trials)) == ("small", "none", 6)
    trial = found.trials[0]
    assert trial.outcome == "passed"
    assert trial.duration_s == pytest.approx(7.01, abs=0.02)  # they meet after 6 s, and recede for one
    assert trial.path_length_m == pytest.approx(4 * trial.duration_s, abs=1e-6)
    assert trial.obstacles[0].closest_m == pytest.approx(1, abs=1e-6)
    assert trial.obstacles[0].detected_s is not None
    assert read_run(Path("r.run.mcap")) == found
    parameters = found.provenance.parameters
    assert parameters["world"]["moving"][0]["velocity_m_s"] == [-6, 0, 0]
    assert parameters["estimation"]["sensor"]["rate_hz"] == 20
    assert parameters["safety"]["dr-acbf"]["h_max_s"] == 0.4
    assert [ref.role for ref in found.provenance.inputs] == ["scenario"]
    flights = read_flights(Path("r.run.mcap")).by_trial
    worst = sorted(found.trials, key=lambda trial: (trial.moving_clearance_m, trial.index))[:3]
    assert sorted(flights) == sorted({0, 1, *(trial.index for trial in worst)})
    assert flights[0].margin.min() == pytest.approx(1 - 0.35, abs=0.02)
    assert run(["simulate", "small.toml", "-o", "r.run.mcap"]) == 0
    assert "unchanged" in capsys.readouterr().out


def test_options_and_settings_replace_keys(here):
    words = [
        "simulate",
        "small.toml",
        "-o",
        "r.run.mcap",
        "--trials",
        "3",
        "--seed",
        "9",
        "--filter",
        "dr-acbf",
    ]
    sets = [
        "safety.dr-acbf.clearance_m=2",
        "safety.dr-acbf.solver=gs",
        "estimation.sensor.rate_hz=40",
        "safety.dr-acbf.rp_cbf.alpha=2",
        "world.moving.0.velocity_m_s=-5,0,0",
    ]
    assert run([*words, *(word for pair in sets for word in ("--set", pair)), "-q"]) == 0
    made = record().provenance
    assert made.seed == 9
    assert made.parameters["rules"]["trials"] == 3
    assert made.parameters["estimation"]["sensor"]["rate_hz"] == 40
    assert made.parameters["world"]["moving"][0]["velocity_m_s"] == [-5, 0, 0]
    chosen = made.parameters["safety"]
    assert chosen["filters"] == ["dr-acbf"]
    values = chosen["dr-acbf"]
    assert (values["clearance_m"], values["solver"], values["rp_cbf"]["alpha"]) == (2, "gs", 2)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--set", "safety.dr-acbf.clearance=2"], "unknown field `clearance` - at `$.safety.dr-acbf`"),
        (["--set", "estimation.sensor.rate_hz=-4"], "at `$.estimation.sensor.rate_hz`"),
        (["--filter", "mpc", "--set", "safety.dr-acbf.h_max_s=0.01"], "small.toml: `$.safety.dr-acbf`"),
        (["--set", "safety.mpc.h_max_s=0.4"], "the parameters of mpc stand in the table dr-acbf"),
        (["--set", "safety.dr-acbf.h_max_s=0.01"], "small.toml: `$.safety.dr-acbf`"),
        (["--filter", "cone-di"], "cone-di needs ellipsoids; set world.scene"),
        (["--beta", "3"], "No such option '--beta'"),
        (["--trials", "0"], "Invalid value for '--trials'"),
        (["--scheduler", "nowhere"], "--scheduler must be an address"),
    ],
)
def test_what_is_wrong_is_one_line(here, capsys, words, said):
    assert run(["simulate", "small.toml", "-o", "r.run.mcap", *words]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert said in error
    assert not list(Path().glob("r.run*"))


@pytest.mark.slow
def test_a_scheduler_that_does_not_answer_ends_the_run(here, capsys):
    assert run([*WORDS, "--scheduler", "tcp://127.0.0.1:1"]) == 6
    assert "tcp://127.0.0.1:1" in capsys.readouterr().err
    assert not Path("r.run.mcap").exists()


def test_the_run_can_be_explained_and_reported(here, capsys):
    assert run(["info", "small.toml", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["mission"]["goal_m"] == [100, 0, 10]
    assert facts["world"]["moving"][0]["radius_m"] == 0.2
    assert run(["simulate", "small.toml", "-o", "r.run.mcap", "-q"]) == 0
    assert run(["info", "r.run.mcap", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["summary"]["trials"] == 6
    assert run(["report", "r.run.mcap", "-o", "page.html", "-q"]) == 0
    assert "passed" in Path("page.html").read_text()


def test_flights_into_walls_fail_the_check(here, capsys):
    wall = "[[world.walls]]\nlower_m = [20, -1, 9]\nupper_m = [21, 1, 11]\n"
    Path("wall.toml").write_text(SMALL + wall)
    assert run(["simulate", "wall.toml", "-o", "r.run.mcap", "-q"]) == 0  # nothing was promised
    assert record().summary["static_collisions"] == 6
    assert record().trials[0].map_clearance_m == pytest.approx(-0.65, abs=2e-3)
    assert run(["simulate", "wall.toml", "-o", "r.run.mcap", "-q", "-f", "--filter", "dr-acbf"]) == 0
    assert record().summary["min_map_clearance_m"] > 0


def test_the_log_has_modes_obstacles_and_their_true_clearance(here):
    words = ["--filter", "dr-acbf", "--trials", "2"]
    assert run(["simulate", "small.toml", "-o", "r.run.mcap", "-q", *words]) == 0
    with Path("r.run.mcap").open("rb") as file:
        found = [
            (topic, json.loads(data)) for topic, data in messages(file, ("/safety", "/state", "/obstacles"))
        ]
    safety, state, seen = (
        [m for topic, m in found if topic == f"/{name}"] for name in ("safety", "state", "obstacles")
    )
    assert {message["mode_name"] for message in safety} >= {"nominal", "avoid"}
    assert len(safety) == len(state) == len(seen) > 100
    for answer, at, scene in zip(safety, state, seen, strict=True):
        (ball,) = next(each for each in scene["entities"] if each["id"] == "obstacles")["spheres"]
        apart = [ball["pose"]["position"][axis] - at["position_m"][axis] for axis in "xyz"]
        assert answer["moving_clearance_m"] == pytest.approx(math.hypot(*apart) - 0.35, abs=1e-5)
        assert answer["margin_unit"] == "of the filter's barrier"
    flight = read_flights(Path("r.run.mcap")).by_trial[0]
    assert flight.margin_unit == "m"
    assert flight.margin.min() >= record().trials[0].moving_clearance_m - 1e-6


def bare(path) -> RunRecord:
    return msgspec.structs.replace(record(path), timing=None)


@pytest.mark.slow
def test_an_interrupted_run_goes_on_and_ends_in_the_same_bytes(here, monkeypatch, capsys):
    assert run([*WORDS[:3], "whole.run.mcap", "-q"]) == 0
    monkeypatch.setattr(file, "MIN_RUN_S", 0.0)
    chunks = stage.fly_chunk

    def stopping(ready, jobs, chunk):
        if chunk.first == 160:
            raise KeyboardInterrupt
        return chunks(ready, jobs, chunk)

    with monkeypatch.context() as patched:
        patched.setattr(stage, "fly_chunk", stopping)
        assert run(WORDS) == 130
    error = capsys.readouterr().err.strip()
    assert error == "alula: interrupted; the same command continues from r.run.mcap.journal, 160 trials"
    assert not Path("r.run.mcap").exists()
    assert len(TrialJournal(unpack(JOURNAL.read_bytes(), TRIALS)[1])) == 160
    other = [*WORDS, "--seed", "1", "--dry-run"]
    assert run(other) == 0
    assert "ignoring r.run.mcap.journal: it is of another run: seed was 0, now 1" in capsys.readouterr().err
    assert run(WORDS) == 0
    assert "continuing from r.run.mcap.journal: 160 of its trials" in capsys.readouterr().err
    assert not JOURNAL.exists()
    assert Path("r.run.mcap").read_bytes() == Path("whole.run.mcap").read_bytes()
    assert bare("r.run.json") == bare("whole.run.json")
    assert record().timing["trials_flown"] == 640


@pytest.mark.parametrize("where", ["verbs.runs.write_run", "verbs.missions.Trials.summary_of"])
def test_an_interruption_after_the_last_flight_keeps_all_flights(here, where, monkeypatch, capsys):
    monkeypatch.setattr(file, "MIN_RUN_S", 0.0)
    words = [*WORDS, "--trials", "20"]

    def stopping(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(f"alula.cli.{where}", stopping)
        assert run(words) == 130
    assert "the same command continues from r.run.mcap.journal, 20 trials" in capsys.readouterr().err
    assert not Path("r.run.mcap").exists()
    assert run(words) == 0
    assert record().timing["trials_flown"] == 0
    assert not JOURNAL.exists()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["SIGINT", "SIGKILL"])
def test_a_run_that_is_killed_loses_little(here, name):
    env = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    process = subprocess.Popen(
        [sys.executable, "-P", "-c", EAGER, producer().commit, *WORDS, "--trials", "20000"],
        env=env, text=True, stderr=subprocess.PIPE,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # background jobs ignore it
    )  # fmt: skip
    while process.poll() is None and not JOURNAL.exists():
        time.sleep(0.01)
    process.send_signal(getattr(signal, name))
    error = process.communicate()[1]
    assert process.returncode == (130 if name == "SIGINT" else -signal.SIGKILL)
    assert ("the same command continues" in error) == (name == "SIGINT")
    assert not Path("r.run.mcap").exists()
    assert len(TrialJournal(unpack(JOURNAL.read_bytes(), TRIALS)[1])) >= 16
