"""The command `alula plan`: outputs, exit codes, messages."""

import json
import subprocess
import sys

import numpy as np
import pytest

from alula.cli.commands.plan import command
from alula.cli.main import COMMANDS, run
from alula.schemas.artifacts.artifact import make_artifact, read_artifact, write_artifact
from alula.schemas.artifacts.kinds import COVER, PLAN
from support.paths import VEHICLES


@pytest.fixture
def cover(tmp_path):
    """One cube of 1 m between (0, 0, 0) and (1, 1, 1)."""
    corners = np.array([[i >> 2 & 1, i >> 1 & 1, i & 1] for i in range(8)]) * 10
    path = tmp_path / "cube.cover.npz"
    arrays = {
        "vertex": corners,
        "vertex_start": [0, 8],
        "plane_normal": np.vstack([np.eye(3), -np.eye(3)]),
        "plane_offset": [10, 10, 10, 0, 0, 0],
        "plane_start": [0, 6],
        "member_index": np.zeros((1, 3)),
        "member_start": [0, 1],
        "history": np.empty((0, 3)),
    }
    fields = {"voxel_size_m": 0.1, "sigma": 1.0, "min_overlap": 1, "conservativeness": 0.0, "certificate": {}}
    write_artifact(
        path, make_artifact(COVER, arrays, frame="world", unit="m", parameters={}, summary={}, **fields)
    )
    return path


def plan(cover, output, *words):
    return run(["plan", str(cover), "-o", str(output), "--beyond-map", "3", *words])


def test_a_plan_is_written_with_its_provenance(cover, tmp_path, capsys):
    output = tmp_path / "p.plan.npz"
    words = ["--start", "-1 0.5 0.5", "--goal", "2,-0.25,0.5", "--radius", "0.2", "--json"]
    assert plan(cover, output, *words) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["status"] == "written"
    assert report["summary"]["min_clearance_m"] >= 0.2
    assert report["summary"]["max_speed_m_s"] <= 1.0
    manifest = read_artifact(output, PLAN).manifest
    assert manifest.parameters["start"] == [-1.0, 0.5, 0.5]
    assert manifest.parameters["via"] == []
    assert manifest.radius_m == 0.2
    assert [ref.name for ref in manifest.inputs] == ["cube.cover.npz"]
    assert manifest.certificate["min_proven_clearance_m"] >= 0.2
    assert plan(cover, output, *words) == 0
    assert json.loads(capsys.readouterr().out)["status"] == "unchanged"


def test_a_straight_plan_through_an_obstacle_is_written_only_where_this_is_insisted_on(
    cover, tmp_path, capsys
):
    output = tmp_path / "s.plan.npz"
    words = ["--start", "-1 0.5 0.5", "--goal", "2 0.5 0.5", "--straight"]
    assert plan(cover, output, *words) == 5
    assert "leads through an obstacle" in capsys.readouterr().err
    assert not output.exists()
    assert plan(cover, output, *words, "--allow-blocked") == 0
    assert not read_artifact(output, PLAN).manifest.is_proven
    assert run(["verify", str(output), "--map", str(cover), "-q"]) == 4
    capsys.readouterr()
    log = tmp_path / "s.run.mcap"  # judged as a pair: it has no tube to leave
    assert (
        run(["simulate", str(output), "--map", str(cover), "-o", str(log), "--filter", "none", "--json"]) == 0
    )
    summary = json.loads(capsys.readouterr().out)["summary"]
    assert (summary["reached"], summary["collisions"], summary["off_plan"]) == (1, 1, 0)
    clear = tmp_path / "c.plan.npz"
    assert plan(cover, clear, "--start", "-1 2 0.5", "--goal", "2 2 0.5", "--straight") == 0
    assert run(["verify", str(clear), "--map", str(cover), "-q"]) == 0


def test_a_plan_for_a_filter_is_slower_where_it_would_act(cover, tmp_path, capsys):
    output = tmp_path / "p.plan.npz"
    words = ["--start", "-1.5 0.5 0.5", "--goal", "-0.35 0.4 0.5", "-f"]
    assert plan(cover, output, *words, "--filter", "none") == 0  # in a cover, by velocities as well
    fastest = read_artifact(output, PLAN).manifest
    assert plan(cover, output, *words) == 0
    manifest = read_artifact(output, PLAN).manifest
    assert (manifest.parameters["filter"], manifest.parameters["interface"]) == ("polytope-cbf", "velocity")
    assert manifest.summary["duration_s"] > 1.2 * fastest.summary["duration_s"]
    assert manifest.limits == fastest.limits
    assert "notes" not in manifest.summary
    assert run(["verify", str(output), "--map", str(cover)]) == 0
    assert plan(cover, output, *words, "--filter", "polytope-cbf") == 0
    assert read_artifact(output, PLAN).manifest.summary == manifest.summary
    capsys.readouterr()
    assert plan(cover, tmp_path / "q.plan.npz", *words, "--filter", "nonsense") == 2
    assert "--filter nonsense: no filter is called 'nonsense'" in capsys.readouterr().err
    assert not (tmp_path / "q.plan.npz").exists()


def test_a_built_in_vehicle_is_named_and_an_unknown_one_is_told(cover, tmp_path, capsys):
    words = ["--start", "-1.5 0.5 0.5", "--goal", "-1.5 2 0.5"]
    named, file = tmp_path / "named.plan.npz", tmp_path / "file.plan.npz"
    assert plan(cover, named, *words, "--vehicle", "crazyflie21") == 0
    assert plan(cover, file, *words, "--vehicle", str(VEHICLES / "crazyflie21.toml")) == 0
    one, other = read_artifact(named, PLAN), read_artifact(file, PLAN)
    assert (one["coefficient"] == other["coefficient"]).all()
    assert one.manifest.vehicle == "crazyflie21"
    assert [ref.role for ref in one.manifest.inputs] == ["cover"]
    capsys.readouterr()
    assert plan(cover, tmp_path / "q.plan.npz", *words, "--vehicle", "crazyfly") == 3
    assert (
        "crazyfly: no such file, and no built-in vehicle; these are crazyflie21, " in capsys.readouterr().err
    )
    assert not (tmp_path / "q.plan.npz").exists()


def test_via_points_and_threads(cover, tmp_path):
    words = ["--start", "-1 -1 -1", "--goal", "-1 -1 2", "--via", "0.5 0.5 1.5", "--via", "2 2 2"]
    one, four = tmp_path / "one.plan.npz", tmp_path / "four.plan.npz"
    assert plan(cover, one, *words, "--jobs", "1") == 0
    assert plan(cover, four, *words, "--jobs", "4") == 0
    assert one.read_bytes() == four.read_bytes()
    waypoints = read_artifact(one, PLAN)["waypoint"][:, :3].tolist()
    assert waypoints.index([0.5, 0.5, 1.5]) < waypoints.index([2, 2, 2])


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (
            ["--start", "0.5 0.5 0.5", "--goal", "2 2 2"],
            5,
            "the start (0.5 0.5 0.5) is inside an obstacle, 0.5 m deep",
        ),
        (
            ["--start", "2 2 2", "--goal", "1.1 0.5 0.5"],
            5,
            "the goal (1.1 0.5 0.5) is 0.1 m from an obstacle",
        ),
        (["--start", "2 2 2", "--goal", "2 2 2"], 2, "two consecutive points of the flight are the same"),
        (["--start", "2 2", "--goal", "2 2 2"], 2, 'write 3 words, or one in quotes: "x y z"'),
        (["--start", "2 2 nan", "--goal", "2 2 2"], 2, "not finite"),
        (["--goal", "2 2 2"], 2, "--start"),
        (["--start", "2 2 2", "--goal", "-1 0 0", "--radius", "0"], 2, "--radius must be between"),
        (["--start", "2 2 2", "--goal", "-1 0 0", "--resolution", "0.0002"], 2, "use a larger --resolution"),
        (
            ["--start", "2 2 2", "--goal", "-1 0 0", "--bounds", "0", "0", "0", "3", "3", "3"],
            2,
            "outside --bounds",
        ),
        (
            [
                "--start",
                "0.5 0.5 1.2",
                "--goal",
                "0.5 0.5 -0.3",
                "--radius",
                "0.15",
                "--bounds",
                "0",
                "0",
                "-1",
                "1",
                "1",
                "2",
            ],
            5,
            "no path from --start to --goal keeps 0.15 m: no radius above",
        ),
    ],
)
def test_failures_are_one_line_with_their_code_and_leave_nothing(
    cover, tmp_path, capsys, words, code, message
):
    output = tmp_path / "p.plan.npz"
    assert plan(cover, output, *words) == code
    captured = capsys.readouterr()
    assert message in captured.err
    assert captured.err.count("\n") == 1
    assert captured.out == ""
    assert sorted(path.name for path in tmp_path.iterdir()) == ["cube.cover.npz"]


def test_free_points_are_printed_without_an_output(cover, tmp_path, capsys):
    words = [
        "plan",
        str(cover),
        "--free-points",
        "3",
        "--radius",
        "0.2",
        "--bounds",
        "-1 -1 -1 2 2 2",
        "--beyond-map",
        "3",
    ]
    assert run(words) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 3
    assert run([*words, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["points_m"] == [[float(x) for x in line.split()] for line in lines]
    assert report["radius_m"] == 0.2
    for point in report["points_m"]:
        assert np.linalg.norm(np.maximum(np.maximum(-np.array(point), np.array(point) - 1), 0)) >= 0.2
    assert [path.name for path in tmp_path.iterdir()] == ["cube.cover.npz"]
    assert (
        plan(cover, tmp_path / "p.plan.npz", "--start", lines[0], "--goal", lines[1], "--radius", "0.2") == 0
    )


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--start", "2 2 2", "--goal", "-1 0 0"], "missing option -o"),
        (["--start", "2 2 2", "-o", "p.plan.npz"], "--start and --goal are needed"),
        (["--free-points", "3", "--sigma", "2", "--confidence", "0.9"], "not both"),
        (["--free-points", "3", "--radius", "0.2", "--inflate", "0.1"], "leave out --inflate"),
    ],
)
def test_options_that_do_not_go_together_are_refused(cover, capsys, words, message):
    assert run(["plan", str(cover), *words]) == 2
    assert message in capsys.readouterr().err


def test_a_moved_start_is_said_and_recorded(cover, tmp_path, capsys):
    output = tmp_path / "p.plan.npz"
    words = ["--start", "0.5 0.5 0.9", "--goal", "2 2 2", "--radius", "0.2", "--nearest-free"]
    assert plan(cover, output, *words) == 0
    assert "note: the start (0.5 0.5 0.9) is not free; the plan has (" in capsys.readouterr().err
    manifest = read_artifact(output, PLAN).manifest
    assert manifest.summary["notes"]
    (made_in,) = manifest.maps
    assert {k: made_in[k] for k in ("map", "inflation_m", "keep_m")} == {
        "map": "cover",
        "inflation_m": 0.0,
        "keep_m": 0.2,
    }


def test_an_onboard_map_is_planned_in(cover, tmp_path):
    image, output = tmp_path / "cube.map.bin", tmp_path / "p.plan.npz"
    assert run(["export", str(cover), "-o", str(image)]) == 0
    assert plan(image, output, "--start", "0.5 0.5 1.6", "--goal", "0.5 0.5 -0.6", "--radius", "0.2") == 0
    made = read_artifact(output, PLAN)
    assert made.manifest.maps[0]["map"] == "image"
    assert made.manifest.method == "minimum time in a corridor of convex cells"
    assert run(["verify", str(output), "--map", str(cover)]) == 0


def test_a_file_of_another_kind_is_refused(cover, tmp_path, capsys):
    output = tmp_path / "p.plan.npz"
    assert plan(cover, output, "--start", "2 2 2", "--goal", "-1 -1 -1") == 0
    assert plan(output, tmp_path / "q.plan.npz", "--start", "2 2 2", "--goal", "-1 -1 -1") == 3
    assert "alula/plan" in capsys.readouterr().err


def test_help_shows_the_line_of_the_command_list_and_examples():
    assert command.help.splitlines()[0] == COMMANDS["plan"]
    done = subprocess.run(
        [sys.executable, "-P", "-m", "alula.cli", "plan", "-h"], capture_output=True, text=True, check=True
    )
    assert done.stdout.count("alula plan room.cover.npz") == 7
    assert "--via" in done.stdout


GATES = ["--start", "-1 0.5 0.5", "--goal", "-1 0.5 0.5", "--gate", "2 0.5 1.5 1 0 0 0.5", "--loops", "2"]
MISSION = """
start_m = [-1, 0.5, 0.5]
goal_m = [-1, 0.5, 0.5]
loops = 2
yaw = "along"

[[pass]]
gate_m = [2, 0.5, 1.5]
normal = [1, 0, 0]
radius_m = 0.5

[[pass]]
point_m = [2, -1, 0.5]
tolerance_m = 0.3
"""


@pytest.mark.slow
def test_gates_of_options_and_of_a_mission_are_planned_and_proven_and_simulated(cover, tmp_path, capsys):
    by_options, by_file, mission = (tmp_path / name for name in ("a.plan.npz", "b.plan.npz", "m.toml"))
    mission.write_text(MISSION)
    assert plan(cover, by_options, *GATES) == 0
    assert [each.lap for each in read_artifact(by_options, PLAN).manifest.passes] == [1, 2]
    assert plan(cover, by_file, "--mission", str(mission), "--speed", "2") == 0
    made = read_artifact(by_file, PLAN)
    flown = [(each.kind, each.lap) for each in made.manifest.passes]
    assert flown == [("gate", 1), ("waypoint", 1), ("gate", 2), ("waypoint", 2)]
    assert made.manifest.parameters["start"] == [-1.0, 0.5, 0.5]
    assert {ref.role for ref in made.manifest.inputs} == {"cover", "mission"}
    assert np.ptp(made["coefficient"][:, 3, 0]) > 5
    assert run(["verify", str(by_file), "--map", str(cover)]) == 0
    capsys.readouterr()
    flight = ["simulate", str(by_file), "--map", str(cover), "--filter", "cone-backup"]
    assert run([*flight, "-o", str(tmp_path / "a.run.mcap")]) == 0
    large = ["-o", str(tmp_path / "b.run.mcap"), "--set", "vehicle.radius_m=0.45", "--filter", "none"]
    assert run([*flight[:4], *large]) == 4
    assert "gate 1 of lap 1 was missed: the vehicle" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        ([*GATES, "--via", "3 3 3"], 2, "give --via or --gate, not both: a --mission file has both"),
        ([*GATES[:4], "--loops", "2"], 2, "--loops: there is nothing to fly again"),
        ([*GATES[:4], "--gate", "2 0.5 1.5 0 0 0 0.5"], 2, "has no direction"),
        ([*GATES[:4], "--gate", "2 0.5 1.5"], 2, '"cx cy cz nx ny nz r"'),
        ([*GATES[:4], "--gate", "2 0.5 1.5 1 0 0 0.14"], 5, "it does not fit through"),
        ([*GATES[:4], "--gate", "0.5 0.5 0.5 1 0 0 0.4"], 5, "gate 1 at (0.5 0.5 0.5) is not free"),
        ([*GATES[:4], "--yaw", "up"], 2, "--yaw is an angle in radians, along, or towards:X,Y,Z, not 'up'"),
        ([*GATES[:4]], 2, "two consecutive points of the flight are the same"),
        ([*GATES, "--mission", "MISSION"], 2, "--gate and --mission: the file says this"),
        (["--mission", "NONE"], 3, "cannot read"),
        (["--mission", "WRONG"], 2, "unknown field `gates`"),
    ],
)
def test_missions_that_cannot_be_flown_are_refused_with_a_line(cover, tmp_path, capsys, words, code, message):
    (tmp_path / "m.toml").write_text(MISSION)
    (tmp_path / "w.toml").write_text("gates = 3\n")
    names = {"MISSION": "m.toml", "NONE": "n.toml", "WRONG": "w.toml"}
    words = [str(tmp_path / names[word]) if word in names else word for word in words]
    output = tmp_path / "p.plan.npz"
    assert plan(cover, output, *words) == code
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1 or "Usage" in error
    assert not output.exists()
