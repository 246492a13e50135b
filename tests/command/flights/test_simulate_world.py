"""`alula simulate` on scenarios of version 2: files, exit codes, --set, refusals, interruption, report."""

from pathlib import Path

import msgspec
import pytest

from alula.cli.main import run
from alula.cli.shell import journal as file
from alula.cli.shell.set_values import settings_of
from alula.schemas.artifacts.artifact import write_artifact
from alula.schemas.errors import UsageError
from alula.schemas.log.flights import read_flights
from alula.schemas.log.run import RunRecord, read_run
from alula.stages.simulation import simulate as stage
from support.scenes.small_scenes import box_cover, line_plan, with_vias

ROOM = """
schema = "alula/scenario"
version = "2.0"
name = "two pillars"
[vehicle]
type = "crazyflie21"
interface = "body-rates"
[world]
cover = "room.cover.npz"
[world.fence]
box_m = [-0.5, -2.5, 0.1, 4.5, 2.5, 2.6]
[[world.moving]]
motion = "ballistic"
radius_m = 0.1
distance_m = 3.0
azimuth_rad = [-1.0, 1.0]
speed_m_s = [4.0, 6.0]
[mission]
bounds_m = [0, -2, 0.5, 4, 2, 2]
beyond_map_m = 10.0
[estimation]
position_noise_m = 0.002
[safety]
filters = ["dr-acbf", "shield"]
[rules]
trials = 4
max_time_s = 0.5
logged = 1
"""
WALL = """
schema = "alula/scenario"
version = "2.0"
[vehicle]
type = "single-integrator"
radius_m = 0.1
[world]
cover = "room.cover.npz"
[mission]
kind = "goal"
start_m = [0, 0.5, 1]
goal_m = [2, 0.5, 1]
beyond_map_m = 10.0
"""
PLAN = """
schema = "alula/scenario"
version = "2.0"
[vehicle]
type = "fastbridge"
radius_m = 0.1
[world]
cover = "room.cover.npz"
[mission]
kind = "plan"
plan = "way.plan.npz"
allow_other_map = true
"""
WORDS = ["simulate", "room.toml", "-o", "r.run.mcap"]


@pytest.fixture
def here(tmp_path, monkeypatch) -> Path:
    cover = box_cover([((12, 3, 0), (15, 8, 25)), ((22, -8, 0), (25, -2, 25))])
    write_artifact(tmp_path / "room.cover.npz", cover)
    plan = with_vias(line_plan((0, 0, 1), (1.0, -0.4, 1.2), 3.0), [[0.5, 0.2, 1.1]], 1.5)
    write_artifact(tmp_path / "way.plan.npz", plan)
    for name, text in (("room.toml", ROOM), ("wall.toml", WALL), ("plan.toml", PLAN)):
        (tmp_path / name).write_text(text)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def record(path="r.run.mcap") -> RunRecord:
    return read_run(Path(path))


def only_inputs(here):
    return {path.name for path in here.iterdir()} == {
        *("room.cover.npz", "way.plan.npz", "room.toml", "wall.toml", "plan.toml")
    }


def test_a_run_has_a_log_and_a_record_and_can_be_reported(here, capsys):
    assert run([*WORDS, "-q"]) == 0
    found = record()
    assert (found.name, found.filter) == ("two pillars", "dr-acbf + shield")
    assert found.vehicle == (
        "crazyflie21: quadrotor of 0.029 kg in a sphere of radius 0.075 m, commanded by thrust and body "
        "rates, with noise"
    )
    assert len(found.trials) == 4
    assert [one.name for one in found.trials[0].filters] == ["dr-acbf", "shield"]
    assert found.summary["static_collisions"] == 0
    flights = read_flights(Path("r.run.mcap"))
    worst = found.summary["worst_trial"]
    assert {0, worst} <= set(flights.by_trial)
    assert run(["report", "r.run.mcap", "-o", "r.html", "-q"]) == 0
    text = Path("r.html").read_text()
    assert "two pillars" in text
    assert run(["info", "r.run.mcap", "-q"]) == 0
    assert "Traceback" not in capsys.readouterr().err


def test_the_same_command_gives_the_same_bytes(here):
    assert run([*WORDS, "-q", "--jobs", "1"]) == 0
    assert run([*WORDS[:3], "again.run.mcap", "-q", "--jobs", "2"]) == 0
    assert Path("r.run.mcap").read_bytes() == Path("again.run.mcap").read_bytes()


def test_set_reaches_nested_keys_and_options_their_own(here):
    words = [
        *("--set", "vehicle.mass_scale=1.2", "--set", "world.moving.0.radius_m=0.3"),
        *("--set", "safety.filters=cone-backup", "--set", "safety.cone-backup.horizon_s=0.5"),
        *(
            "--set",
            "world.fence.box_m=-1,-3,0.1,5,3,3",
            "--trials",
            "2",
            "--seed",
            "7",
            "--set",
            "name=other",
        ),
    ]
    assert run([*WORDS, *words, "-q"]) == 0
    found = record()
    given = found.provenance.parameters
    assert given["vehicle"]["mass_scale"] == 1.2
    assert given["world"]["moving"][0]["radius_m"] == 0.3
    assert given["world"]["fence"]["box_m"] == [-1, -3, 0.1, 5, 3, 3]
    assert given["safety"]["filters"] == ["cone-backup"]
    assert given["safety"]["cone-backup"]["horizon_s"] == 0.5
    assert (found.name, len(found.trials), found.provenance.seed) == ("other", 2, 7)
    assert all(len(trial.filters) == 1 for trial in found.trials)


def test_lists_of_set_may_be_written_as_in_toml():
    for text, value in (
        ("a.b=[0, -1.5,2]", [0, -1.5, 2]),
        ("a.b=0,-1.5,2", [0, -1.5, 2]),
        ("a.b=[[1,0,0,4],[0,1,0,3]]", [[1, 0, 0, 4], [0, 1, 0, 3]]),
        ("a.b=[true]", [True]),
        ("a.b=[]", []),
    ):
        assert settings_of([text]) == {"a.b": value}
    with pytest.raises(UsageError, match="neither a list nor a list of lists"):
        settings_of(["a.b=[[1],2]"])


def test_exit_code_4_says_that_a_filtered_flight_hit_something_or_a_plan_was_not_flown(here, capsys):
    assert (
        run(["simulate", "wall.toml", "-o", "r.run.mcap", "-q"]) == 0
    )  # without a filter nothing was promised
    assert record().trials[0].collision
    words = ["--set", "world.fence.box_m=-1,-1,0.5,1,1,2", "--filter", "polytope-cbf", "-f", "-q"]
    assert run(["simulate", "wall.toml", "-o", "r.run.mcap", *words]) == 4
    error = capsys.readouterr().err
    words = (
        "1 of 1 filtered flights touched a static obstacle or left the fence; the deepest is trial 0 from "
    )
    assert f"{words}(0.000 0.500 1.000), 0.182 m" in error
    assert run(["simulate", "plan.toml", "-o", "p.run.mcap", "-q"]) == 4
    assert record("p.run.mcap").trials[0].outcome == "missed-via"
    assert "p.run.mcap: " in capsys.readouterr().err
    mended = ["-q", "-f", "--set", "mission.via_tolerance_m=0.5"]
    assert run(["simulate", "plan.toml", "-o", "p.run.mcap", *mended]) == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["--set", "vehicle.interface=velocity"],
            "`$.safety.filters`: dr-acbf is for commands of acceleration",
        ),
        (["--set", "vehicle.masss_scale=1.2"], "masss_scale"),
        (["--set", "safety.polytop.beta=1"], "no filter is called 'polytop'"),
        (["--set", "rules.trials=0"], "rules.trials"),
        (
            ["--set", "estimation.stale_s=100", "--set", "estimation.lost_share=0.1"],
            "set estimation.stale_s=9",
        ),
        (["--set", "mission.bounds_m=1,2,3"], "mission.bounds_m"),
        (["--set", "world.moving.0.motion=falling"], "world.moving"),
        (["--filter", "geofence"], "geofence is for commands of sticks"),
        (["--separation", "0.2"], "No such option '--separation'"),
        (["--set", "separation=0.2"], "needs the whole path of a key; is it mission.separation?"),
        (["--scheduler", "elsewhere"], "--scheduler"),
    ],
)
def test_what_makes_no_sense_is_one_line_with_exit_code_2_and_no_file(here, capsys, words, message):
    assert run([*WORDS, *words]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.strip().count("\n") == 0
    assert only_inputs(here)


def test_files_that_are_missing_or_of_another_kind_are_refused(here, capsys):
    assert run([*WORDS, "--set", "world.cover=no.cover.npz"]) == 3
    assert "no.cover.npz" in capsys.readouterr().err
    assert run([*WORDS, "--set", "world.cover=way.plan.npz"]) == 3
    assert "Traceback" not in capsys.readouterr().err
    assert only_inputs(here)


def test_a_dry_run_writes_nothing(here, capsys):
    assert run([*WORDS, "-n"]) == 0
    assert only_inputs(here)
    assert "Traceback" not in capsys.readouterr().err


def test_an_interrupted_run_goes_on_and_ends_in_the_same_bytes(here, monkeypatch, capsys):
    short = ["--trials", "20", "--set", "rules.max_time_s=0.1"]
    assert run([*WORDS[:3], "whole.run.mcap", *short, "-q"]) == 0
    monkeypatch.setattr(file, "MIN_RUN_S", 0.0)
    flown = stage.fly_chunk

    def stopping(ready, jobs, chunk):
        if chunk.first:
            raise KeyboardInterrupt
        return flown(ready, jobs, chunk)

    with monkeypatch.context() as patched:
        patched.setattr(stage, "fly_chunk", stopping)
        assert run([*WORDS, *short]) == 130
    assert "the same command continues from r.run.mcap.journal, 16 trials" in capsys.readouterr().err
    assert not Path("r.run.mcap").exists()
    assert run([*WORDS, *short]) == 0
    assert "continuing from r.run.mcap.journal: 16 of its trials" in capsys.readouterr().err
    assert Path("r.run.mcap").read_bytes() == Path("whole.run.mcap").read_bytes()
    timing = msgspec.json.decode(Path("r.run.json").read_bytes())["timing"]
    assert timing["trials_flown"] == 4
