"""`alula simulate` on a pilot's flights in a fence: results, records, interruption, refusals, report."""

import csv
import json
import shutil
from pathlib import Path

import msgspec
import pytest

from alula.cli.main import run
from alula.cli.shell import journal as file
from alula.schemas.log.flights import read_flights
from alula.schemas.log.run import RunRecord, read_run
from alula.schemas.parameters.filter_options import GeofenceParameters
from alula.schemas.scenarios.tables import DisturbanceChanges, FenceTable, PilotTable
from alula.stages.simulation import simulate as stage
from support.paths import VEHICLES

RACER = VEHICLES / "racer7.toml"
DOCUMENTATION = RACER.parents[2] / "docs/theory/geofence.md"
FASTBRIDGE = RACER.with_name("fastbridge.toml")
# The paper's flight: 40 m to a wall, pitched by 72 degrees.
WALL = """
schema = "alula/scenario"
version = "2.0"
name = "wall at 100 km/h"
[vehicle]
file = "vehicles/racer7.toml"
interface = "sticks"
[world.fence]
box_m = [-100.0, -100.0, 0.5, 40.0, 100.0, 100.0]
[mission]
kind = "pilot"
start_m = [0.0, 0.0, 20.0]
[safety]
filters = ["geofence"]
[safety.geofence]
reserve_m = 0.25
[rules]
dt_s = 0.0025
plant_steps = 4
trials = 1
max_time_s = 5.0
log_rate_hz = 50.0
"""
ROOM = """
schema = "alula/scenario"
version = "2.0"
[vehicle]
file = "vehicles/racer7.toml"
interface = "sticks"
[world.fence]
box_m = [-20.0, -20.0, 0.5, 20.0, 20.0, 40.0]
faces = [[1.0, 1.0, 0.0, 35.0]]
[mission]
kind = "pilot"
start_box_m = [-15.0, -15.0, 3.0, 15.0, 15.0, 35.0]
start_speed_m_s = 10.0
start_tilt_deg = 57.3
[mission.pilot]
kind = "aggressive"
[safety]
filters = ["geofence"]
[rules]
dt_s = 0.0025
plant_steps = 4
trials = 9
max_time_s = 1.0
logged = 2
log_rate_hz = 50.0
"""
WORDS = ["simulate", "room.toml", "-o", "r.run.mcap"]
JOURNAL = Path("r.run.mcap.journal")


@pytest.fixture
def here(tmp_path, monkeypatch) -> Path:
    (tmp_path / "vehicles").mkdir()
    shutil.copy(RACER, tmp_path / "vehicles")
    (tmp_path / "wall.toml").write_text(WALL)
    (tmp_path / "room.toml").write_text(ROOM)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def record(path="r.run.json") -> RunRecord:
    return msgspec.json.decode(Path(path).read_bytes(), type=RunRecord)


def test_the_wall_of_the_paper_as_a_golden_run(here, capsys):
    assert run(["simulate", "wall.toml", "-o", "wall.run.mcap", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["status"] == "written"
    figures = {
        "violations": 0, "min_distance_m": 0.28799, "max_speed_km_h": 108.602, "interventions": 1,
        "engaged_trials": 1, "passed": 88, "blended": 1912, "backup": 0, "no_pilot": 0, "hand_over": 0,
        "refused": 0, "altered_passes": 0, "out_of_range": 0, "longest_backup_s": 0, "min_lambda": 0.0098958,
        "min_h_i_m": 0.0292147, "brake_distance_m": 22.7283, "stop_distance_m": 0.306034,
        "start_h_i_m": 18.9962,
    }  # fmt: skip
    golden = {
        "trials": 1, "success_rate": 1, "collisions": 0, "worst_trial": 0, "steps": 2000, "held": 1,
        "static_collisions": 0, "min_fence_clearance_m": 0.28799, "filtered_steps": 1912,
    }  # fmt: skip
    summary = said["summary"]
    assert summary.pop("success_interval") is None  # a flight without random numbers repeats itself
    found = summary.pop("fence")
    assert found.keys() == figures.keys()
    assert found == pytest.approx(figures, rel=1e-3)
    assert {key: summary[key] for key in golden} == pytest.approx(golden, rel=1e-3)
    found = record("wall.run.json")
    assert (found.name, found.filter) == ("wall at 100 km/h", "geofence")
    assert found.vehicle == ("racer7: quadrotor of 0.9 kg in a sphere of radius 0.25 m, commanded by sticks")
    assert found.timing["filter_calls"] == 2000
    assert {"filter_p50_s", "filter_p99_s", "filter_max_s", "overruns"} < found.timing.keys()
    trial = found.trials[0]
    assert (trial.outcome, trial.collision, trial.steps) == ("held", False, 2000)
    assert trial.path_length_m == pytest.approx(39.96, abs=0.05)
    assert msgspec.structs.replace(found, timing=None) == msgspec.structs.replace(
        read_run(Path("wall.run.mcap")), timing=None
    )
    parameters = found.provenance.parameters
    assert parameters["safety"]["geofence"]["reserve_m"] == 0.25
    assert parameters["safety"]["geofence"]["beta"] == 1.5
    assert "file" not in parameters["vehicle"]
    assert parameters["vehicle_file"]["name"] == "racer7"
    assert sorted(ref.role for ref in found.provenance.inputs) == ["scenario", "vehicle"]
    flight = read_flights(Path("wall.run.mcap")).by_trial[0]
    assert flight.fence_distance_m.min() == pytest.approx(0.288, abs=2e-3)
    assert flight.margin.min() == pytest.approx(0.0292, abs=2e-3)  # h_I
    assert 0.0098 < flight.regulation.min() < 0.02  # of the samples
    assert run(["simulate", "wall.toml", "-o", "wall.run.mcap"]) == 0
    assert "unchanged" in capsys.readouterr().out


def test_the_documentation_flies_and_names_every_key(here):
    text = DOCUMENTATION.read_text()
    Path("doc.toml").write_text(text.split("```toml\n")[1].split("```")[0])
    vehicle = ["--vehicle", str(RACER)]
    assert run(["simulate", "doc.toml", "-o", "doc.run.mcap", "-q", *vehicle]) == 0
    summary = record("doc.run.json").summary["fence"]
    assert f"reaches {summary['max_speed_km_h']:.1f} km/h" in text
    assert f"brake {summary['brake_distance_m']:.1f} m before" in text
    assert f"within {summary['min_distance_m']:.2f} m" in text
    tables = (FenceTable, PilotTable, GeofenceParameters, DisturbanceChanges)
    named = {field.name for table in tables for field in msgspec.structs.fields(table)} | summary.keys()
    named |= {"start_m", "start_velocity_m_s", "start_yaw_deg", "start_box_m", "start_speed_m_s"}
    named |= {"start_tilt_deg", "cover", "file", "radius_m", "mass_scale", "thrust_scale", "rate_gain_scale"}
    named |= {"delay_s", "lost_from_s", "lost_for_s", "plant_steps", "max_time_s", "logged", "log_rate_hz"}
    not_told = {"altered_passes", "out_of_range", "motor_time_constant_s"}
    assert not [name for name in named - not_told if f"{name}`" not in text]


def test_files_do_not_depend_on_jobs(here):
    assert run([*WORDS, "--jobs", "1", "-q"]) == 0
    one = Path("r.run.mcap").read_bytes()
    assert run([*WORDS, "--jobs", "3", "-q", "-f"]) == 0  # unchanged: nothing is flown
    assert run(["simulate", "room.toml", "-o", "b.run.mcap", "--jobs", "3", "-q"]) == 0
    assert Path("b.run.mcap").read_bytes() == one
    bare = [msgspec.structs.replace(record(name), timing=None) for name in ("r.run.json", "b.run.json")]
    assert bare[0] == bare[1]


def test_options_and_settings_replace_keys(here):
    words = [
        "--trials",
        "3",
        "--seed",
        "9",
        "--set",
        "rules.max_time_s=0.5",
        "--set",
        "vehicle.radius_m=0.1",
        "--set",
        "rules.log_rate_hz=20",
    ]
    sets = ["safety.geofence.reserve_m=2.5", "vehicle.mass_scale=1.2", "mission.pilot.kind=sticks"]
    sets += ["world.fence.box_m=-20,-20,0,20,20,30"]
    assert run([*WORDS, *words, *(word for pair in sets for word in ("--set", pair)), "-q"]) == 0
    made = record().provenance
    assert made.seed == 9
    got = made.parameters
    assert (got["rules"]["trials"], got["rules"]["max_time_s"], got["vehicle"]["radius_m"]) == (3, 0.5, 0.1)
    assert (got["safety"]["geofence"]["reserve_m"], got["vehicle"]["mass_scale"]) == (2.5, 1.2)
    assert got["mission"]["pilot"]["kind"] == "sticks"
    assert got["world"]["fence"]["box_m"] == [-20, -20, 0, 20, 20, 30]


def test_a_fence_that_is_left_fails_the_check(here, capsys):
    heavy = [*WORDS, "-q", "--set", "vehicle.mass_scale=1.6", "--set", "rules.max_time_s=3"]
    assert run(heavy) == 4
    error = capsys.readouterr().err
    summary = record().summary
    words = "filtered flights touched a static obstacle or left the fence"
    assert f"{summary['fence']['violations']} of 9 {words}" in error
    assert f"the deepest is trial {summary['worst_trial']} from (" in error
    assert error.endswith(f"), {-summary['fence']['min_distance_m']:.4g} m\n")
    assert error.count("\n") == 1
    assert run(heavy) == 4  # the second time nothing is flown
    assert run([*WORDS[:3], "free.run.mcap", "-q", "--filter", "none", "--set", "rules.max_time_s=3"]) == 0
    free = record("free.run.json")
    assert free.summary["fence"]["violations"] > 0
    assert free.summary["fence"]["min_h_i_m"] is None  # never evaluated
    assert "nothing was guaranteed" in free.guarantee.statement
    assert run([*WORDS[:3], "qp.run.mcap", "-q", "--filter", "backup-qp", "--trials", "1"]) == 0


def test_a_cover_is_kept_out_of_and_recorded(here, pipeline, capsys):
    shutil.copy(pipeline / "tiny.cover.npz", here)
    text = """
schema = "alula/scenario"
version = "2.0"
[vehicle]
file = "vehicles/racer7.toml"
interface = "sticks"
radius_m = 0.1
[world]
cover = "tiny.cover.npz"
[mission]
kind = "pilot"
start_m = [2.0, 1.5, 1.0]
[mission.pilot]
heading_deg = 90
tilt_deg = 20
[safety]
filters = ["geofence"]
[rules]
dt_s = 0.0025
plant_steps = 4
trials = 1
max_time_s = 3.0
log_rate_hz = 50.0
"""
    Path("walls.toml").write_text(text)
    assert run(["simulate", "walls.toml", "-o", "r.run.mcap", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)["summary"]["fence"]
    assert 0 <= said["min_distance_m"] < 0.2
    assert said["interventions"] == 1
    assert said["brake_distance_m"] > 0.5
    inputs = {ref.role: ref for ref in record().provenance.inputs}
    assert inputs["cover"].schema == "alula/cover"
    assert read_flights(Path("r.run.mcap")).hulls == 12
    assert run(["simulate", "walls.toml", "-o", "free.run.mcap", "--filter", "none", "-q"]) == 0
    assert record("free.run.json").summary["fence"]["min_distance_m"] < -0.1
    # another cover, and another vehicle, on the command line
    words = ["--map", str(pipeline / "tiny.cover.npz"), "--vehicle", str(RACER), "-q"]
    assert run(["simulate", "walls.toml", "-o", "same.run.mcap", *words]) == 0
    assert record("same.run.json").trials == record().trials
    assert run(["report", "r.run.mcap", "--cover", "tiny.cover.npz", "-o", "page.html", "-q"]) == 0


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["--set", "safety.geofence.reserve=2"], 2, "unknown field `reserve` - at `$.safety.geofence`"),
        (["--set", "vehicle.mass_scale=0"], 2, "at `$.vehicle.mass_scale`"),
        (["--set", "world.fence.wall=3"], 2, "unknown field `wall` - at `$.world.fence`"),
        (["--set", "mission.pilot.kind=mad"], 2, "at `$.mission.pilot.kind`"),
        (
            ["--set", "mission.start_box_m=30,0,1,31,1,2"],
            2,
            "`$.mission.start_box_m`: no start in the box is safe",
        ),
        (
            ["--set", "vehicle.disturbance.gust_m_s=1,1,1"],
            2,
            "`$.vehicle.disturbance`: wind and gusts act through drag",
        ),
        (
            ["--set", "safety.geofence.beta=1000"],
            2,
            "beta = 1000 takes over too late: at most 5.61 with ticks of 0.0025 s",
        ),
        (
            ["--set", "safety.geofence.steps=10"],
            2,
            "the horizon of 0.3 s ends before the backup controller has stopped",
        ),
        (["--set", "world.cover=none.npz"], 3, "none.npz: cannot read"),
        (["--set", "vehicle.file=none.toml"], 3, "none.toml: cannot read"),
        (["--vehicle", str(FASTBRIDGE)], 2, "fastbridge has no table [throttle], which sticks need"),
        (["--filter", "cone-di"], 2, "`$.safety.filters`: cone-di is for commands of"),
        (["--trials", "0"], 2, "Invalid value for '--trials': 0 is out of range"),
        (["--pairs-from", "vehicles/racer7.toml"], 2, "mission.pairs_from"),
        (["--scene", "vehicles/racer7.toml"], 3, "racer7.toml"),
        (["--map", "vehicles/racer7.toml"], 3, "racer7.toml"),
    ],
)
def test_what_is_wrong_is_one_line(here, capsys, words, code, said):
    assert run([*WORDS, *words]) == code
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert said in error
    assert not list(Path().glob("r.run*"))


def test_the_printed_guarantee_names_its_conditions_and_that_it_is_no_proof(here):
    assert run([*WORDS, "--trials", "1", "-q"]) == 0
    said = record().guarantee.statement
    assert "the horizon reaches rest" in said
    assert "β D / v_c <= 1" in said
    assert "not a proof" in said
    # without a regulation function its condition does not matter
    late = ["--set", "safety.geofence.beta=1000", "--filter", "none"]
    assert run([*WORDS, "--trials", "1", "-q", "-f", *late]) in (0, 4)


def test_a_dry_run_writes_nothing(here, capsys):
    assert run([*WORDS, "-n", "--trials", "2"]) == 0
    assert "violations" in capsys.readouterr().out
    assert not list(Path().glob("r.run*"))


def test_notes_are_said_beside_the_result(here, capsys):
    assert run([*WORDS, "--trials", "1", "--set", "estimation.lost_from_s=0.1"]) in (0, 4)
    out, error = capsys.readouterr()
    assert "note: navigation was lost for longer than stale_limit_s" in error
    assert "notes" not in out
    assert record().summary["fence"]["hand_over"] > 0


@pytest.mark.slow
def test_an_interrupted_run_goes_on_and_ends_in_the_same_bytes(here, monkeypatch, capsys):
    monkeypatch.setattr(stage, "CHUNK", 4)
    assert run([*WORDS[:3], "whole.run.mcap", "-q"]) == 0
    monkeypatch.setattr(file, "MIN_RUN_S", 0.0)
    flown = stage.fly_chunk

    def stopping(ready, jobs, chunk):
        if chunk.first == 8:
            raise KeyboardInterrupt
        return flown(ready, jobs, chunk)

    with monkeypatch.context() as patched:
        patched.setattr(stage, "fly_chunk", stopping)
        assert run([*WORDS, "--jobs", "1"]) == 130
    assert "the same command continues from r.run.mcap.journal, 8 trials" in capsys.readouterr().err
    assert not Path("r.run.mcap").exists()
    assert run(WORDS) == 0
    assert "continuing from r.run.mcap.journal: 8 of its trials" in capsys.readouterr().err
    assert not JOURNAL.exists()
    assert Path("r.run.mcap").read_bytes() == Path("whole.run.mcap").read_bytes()
    assert record().timing["trials_flown"] == 1


@pytest.mark.slow
def test_the_run_can_be_explained_and_reported(here, capsys):
    assert run(["info", "room.toml", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["world"]["fence"]["faces"] == [[1, 1, 0, 35]]
    assert facts["safety"]["geofence"]["beta"] == 1.5
    assert run([*WORDS, "-q"]) == 0
    assert run(["simulate", "wall.toml", "-o", "wall.run.mcap", "-q"]) == 0
    assert run(["info", "r.run.mcap", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["summary"]["trials"] == 9
    assert run(["report", "r.run.mcap", "wall.run.mcap", "-o", "page.html", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)["summary"]
    assert said["flights"] == (
        "geofence (r): 9 of 9 stayed in the fence; geofence (wall): 1 of 1 stayed in the fence"
    )
    page, markdown = Path("page.html").read_text(), Path("page.md").read_text()
    for title in ("From above: r", "From the side: wall", "The closest flight: wall, trial 0"):
        assert title in page
    assert "dark lines are the outline of the fence" in page
    assert "Below 0 is outside." in page
    assert "| left the fence | 0 | 0 |" in markdown
    assert "reached" not in markdown.split("## Parameters")[0]
    rows = list(csv.DictReader(Path("page.csv").read_text().splitlines()))
    assert len(rows) == 10
    assert (rows[9]["run"], rows[9]["fence_interventions"], rows[9]["fence_passed_steps"]) == (
        "wall",
        "1",
        "88",
    )
    assert float(rows[9]["fence_brake_distance_m"]) == pytest.approx(22.7283, rel=1e-3)
