"""`alula simulate` as a user runs it: files, logs, exit codes, errors."""

import itertools
import json
import subprocess
import sys
from collections import Counter

import msgspec
import numpy as np
import pytest
from mcap.reader import make_reader

from alula.cli.main import run
from alula.cli.shell.runner import input_ref
from alula.schemas.artifacts.artifact import make_artifact, write_artifact
from alula.schemas.artifacts.kinds import COVER, PLAN, VOXELS
from alula.schemas.artifacts.manifest import Guarantee
from alula.schemas.artifacts.provenance import read_provenance
from alula.schemas.log.run import RunRecord, read_run, record_path

BLOCKS = np.array([((10, 10, 0), (14, 30, 20)), ((24, 0, 0), (28, 20, 20))])
FAST = ["--set", "mission.bounds_m=0,0,0,4,4,2", "--trials", "3"]


def write_cover(path, blocks=BLOCKS):
    n = len(blocks)
    pick = np.array(list(itertools.product([0, 1], repeat=3)))
    arrays = {
        "vertex": np.array([[b[pick[j], range(3)] for j in range(8)] for b in blocks]).reshape(-1, 3),
        "vertex_start": 8 * np.arange(n + 1),
        "plane_normal": np.tile(np.vstack([np.eye(3), -np.eye(3)]), (n, 1)),
        "plane_offset": np.hstack([blocks[:, 1], -blocks[:, 0]]).ravel(),
        "plane_start": 6 * np.arange(n + 1),
        "member_index": blocks[:, 0],
        "member_start": np.arange(n + 1),
        "history": np.empty((0, 3)),
    }
    fields = {"voxel_size_m": 0.1, "sigma": 1.0, "min_overlap": 1, "conservativeness": 1.0, "certificate": {}}
    common = {"frame": "world", "unit": "m", "parameters": {}, "summary": {}}
    write_artifact(path, make_artifact(COVER, arrays, guarantee=Guarantee("test"), **common, **fields))
    return path


def write_plan(path, start, end, made_in):
    """Straight at constant speed for four seconds, made in a cover."""
    coefficient = np.zeros((1, 4, 8))
    coefficient[0, :3, 0], coefficient[0, :3, 1] = start, np.subtract(end, start) / 4
    arrays = {"time": np.array([0.0, 4.0]), "coefficient": coefficient, "waypoint": np.zeros((2, 4))}
    common = {"frame": "world", "unit": "m", "parameters": {}, "summary": {}}
    common["inputs"] = [input_ref("cover", made_in)]
    write_artifact(path, make_artifact(PLAN, arrays, radius_m=0.1, speed_m_s=1.0, certificate={}, **common))
    return path


@pytest.fixture
def cover(tmp_path):
    return write_cover(tmp_path / "two.cover.npz")


def messages(path):
    with path.open("rb") as file:
        return [
            (channel.topic, schema.name, message.log_time, json.loads(message.data))
            for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages()
        ]


def test_a_run_is_written_twice_with_the_same_bytes(cover, tmp_path, capsys):
    a, b = tmp_path / "a.run.mcap", tmp_path / "b.run.mcap"
    assert run(["simulate", str(cover), "-o", str(a), *FAST, "--jobs", "1"]) == 0
    assert "success_rate" in capsys.readouterr().out
    assert run(["simulate", str(cover), "-o", str(b), *FAST, "--jobs", "2"]) == 0
    assert a.read_bytes() == b.read_bytes()
    first, second = (msgspec.json.decode(record_path(p).read_bytes(), type=RunRecord) for p in (a, b))
    assert first.timing["filter_calls"] == first.summary["steps"]
    assert 0 < first.timing["filter_p50_s"] <= first.timing["filter_p99_s"] <= first.timing["filter_max_s"]
    assert msgspec.structs.replace(first, timing=None) == msgspec.structs.replace(second, timing=None)
    assert read_run(a) == first
    assert b"filter_p50_s" not in a.read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "a.run.json",
        "a.run.mcap",
        "b.run.json",
        "b.run.mcap",
        "two.cover.npz",
    ]


def test_the_log_holds_what_the_record_says(cover, tmp_path):
    out = tmp_path / "r.run.mcap"
    assert run(["simulate", str(cover), "-o", str(out), *FAST, "--set", "name=two blocks"]) == 0
    record = read_run(out)
    assert (record.name, record.filter, len(record.trials)) == ("two blocks", "polytope-cbf", 3)
    found = messages(out)
    counts = Counter((topic, name) for topic, name, _, _ in found)
    samples = sum(-(-t.steps // 5) + 1 for t in record.trials)  # 20 Hz of 100 Hz, and the last one
    assert counts == {
        ("/map", "foxglove.SceneUpdate"): 1,
        ("/vehicle", "foxglove.SceneUpdate"): 1,
        ("/path", "foxglove.PosesInFrame"): 3,
        ("/pose", "foxglove.PoseInFrame"): samples,
        ("/tf", "foxglove.FrameTransform"): samples,
        ("/state", "alula.State"): samples,
        ("/safety", "alula.Safety"): samples,
        ("/log", "foxglove.Log"): 3,
    }
    times = [time for _, _, time, _ in found]
    assert times[0] == 946_684_800 * 10**9  # 2000-01-01T00:00:00Z
    assert times == sorted(times)
    for trial in record.trials:
        states = [m for topic, *_, m in found if topic == "/state" and m["trial"] == trial.index]
        assert list(states[0]["position_m"].values()) == pytest.approx(trial.start_m, abs=1e-6)
        poses = [m["pose"] for topic, _, time, m in found if topic == "/pose"]
        assert states[0]["position_m"] in [pose["position"] for pose in poses]
        assert all(pose["orientation"] == {"x": 0, "y": 0, "z": 0, "w": 1} for pose in poses)
        assert states[-1]["time_s"] == pytest.approx(trial.duration_s)
        end = list(states[-1]["position_m"].values())
        if trial.outcome == "reached":
            assert np.linalg.norm(np.subtract(end, trial.goal_m)) <= 0.01 * trial.straight_length_m + 1e-6
        safety = [m for topic, *_, m in found if topic == "/safety" and m["trial"] == trial.index]
        assert all(m["status_name"] in ("ok", "filtered", "shortened") for m in safety)
        assert any(m["status"] for m in safety) <= (trial.filtered_steps > 0)


def test_the_map_in_the_log_is_the_closed_surface_of_every_hull(cover, tmp_path):
    out = tmp_path / "r.run.mcap"
    assert run(["simulate", str(cover), "-o", str(out), *FAST]) == 0
    (entity,) = messages(out)[0][3]["entities"]
    assert len(entity["triangles"]) == 2
    for block, mesh in zip(BLOCKS, entity["triangles"], strict=True):
        points = np.array([list(p.values()) for p in mesh["points"]])
        triangles = np.array(mesh["indices"]).reshape(-1, 3)
        volume = np.einsum(
            "ij,ij->", points[triangles[:, 0]], np.cross(*points[triangles[:, 1:]].swapaxes(0, 1))
        )
        assert volume / 6 == pytest.approx(np.prod(block[1] - block[0]) * 1e-3)  # outward
        edges = Counter(tuple(t[[i, (i + 1) % 3]]) for t in triangles for i in range(3))
        assert all(edges[b, a] == n == 1 for (a, b), n in edges.items())


def test_the_output_is_left_when_nothing_changed_and_kept_when_something_did(cover, tmp_path, capsys):
    out = tmp_path / "r.run.mcap"
    command = ["simulate", str(cover), "-o", str(out), *FAST]
    assert run(command) == 0
    before = out.read_bytes()
    capsys.readouterr()
    assert run(command) == 0
    assert "unchanged" in capsys.readouterr().out
    assert run([*command, "--seed", "1"]) == 2
    assert "seed was 0, now 1" in capsys.readouterr().err
    assert out.read_bytes() == before
    assert run([*command, "--seed", "1", "-f"]) == 0
    assert out.read_bytes() != before
    assert read_provenance(out).seed == 1


def test_a_dry_run_writes_nothing(cover, tmp_path):
    assert run(["simulate", str(cover), "-o", str(tmp_path / "r.run.mcap"), *FAST, "-n"]) == 0
    assert [p.name for p in tmp_path.iterdir()] == ["two.cover.npz"]


def test_a_scenario_flies_and_options_replace_its_values(cover, tmp_path, capsys):
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    scenario = folder / "s.toml"
    scenario.write_text(
        'schema = "alula/scenario"\nversion = "2.0"\nname = "mine"\n[world]\ncover = "../two.cover.npz"\n'
        '[vehicle]\ntype = "single-integrator"\nradius_m = 0.15\n[mission]\nbounds_m = [0, 0, 0, 4, 4, 2]\n'
        '[safety]\nfilters = ["polytope-cbf"]\n[safety.polytope-cbf]\nbeta = 4.0\n'
        "[rules]\ntrials = 2\nseed = 5\n"
    )
    out = tmp_path / "r.run.mcap"
    assert (
        run(["simulate", str(scenario), "-o", str(out), "--set", "vehicle.radius_m=0.05", "--trials", "1"])
        == 0
    )
    record = read_run(out)
    parameters = record.provenance.parameters
    assert (record.name, len(record.trials), record.provenance.seed) == ("mine", 1, 5)
    assert parameters["vehicle"]["radius_m"] == 0.05
    assert parameters["safety"]["polytope-cbf"]["beta"] == 4.0
    assert parameters["mission"]["controller"]["gain_per_s"] == 2.0
    assert [ref.role for ref in record.provenance.inputs] == ["cover", "scenario"]
    scenario.write_text('version = "2.0"\n[world]\ncover = "../two.cover.npz"\n[rules]\ndt_s = 0\n')
    assert run(["simulate", str(scenario), "-o", str(out), "-f"]) == 2
    error = capsys.readouterr().err
    assert f"{scenario}: " in error
    assert "`$.rules.dt_s`" in error


def test_a_filtered_collision_is_written_and_exits_with_4(cover, tmp_path, capsys):
    plan = write_plan(tmp_path / "close.plan.npz", [0.95, 2.0, 1.0], [0.2, 2.0, 1.0], cover)
    out = tmp_path / "r.run.mcap"
    command = ["simulate", str(plan), "--map", str(cover), "-o", str(out)]
    command += ["--set", "mission.beyond_map_m=1"]
    assert run(command) == 2
    assert "mission.allow_tight" in capsys.readouterr().err
    command += ["--set", "mission.allow_tight=true"]
    for _ in range(2):  # also when the output is there already
        assert run(command) == 4
        error = capsys.readouterr().err
        assert "1 of 1 filtered flights touched a static obstacle or left the fence" in error
        assert "trial 0 from (0.950 2.000 1.000), 0.05 m" in error
    assert read_run(out).summary["collisions"] == 1
    # a collision without a filter is only reported
    through = write_plan(tmp_path / "through.plan.npz", [0.2, 2.0, 1.0], [3.8, 2.0, 1.0], cover)
    none = ["simulate", str(through), "--map", str(cover), "--filter", "none"]
    none += ["--set", "mission.beyond_map_m=2"]
    assert run([*none, "-o", str(tmp_path / "n.run.mcap")]) == 0
    assert read_run(tmp_path / "n.run.mcap").trials[0].map_clearance_m == pytest.approx(-0.3, abs=1e-3)


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["COVER", "-o", "r.npz"], 2, "must end in .mcap"),
        (["COVER", "--map", "COVER"], 2, "is a cover; --map is for plans"),
        (["COVER", "--set", "mission.allow_tight=true"], 2, "`$.mission.allow_tight`"),
        (
            ["COVER", "--set", "radius_m=0.1"],
            2,
            "--set radius_m: needs the whole path of a key; is it vehicle.radius_m",
        ),
        (["COVER", "--set", "beta=1"], 2, "is it safety.polytope-cbf.beta"),
        (["COVER", "--set", "bteta=1"], 2, "alula scenario --keys lists all"),
        (["COVER", "--filter", ""], 2, "--filter needs names of filters, or only none, not ''"),
        (["COVER", "--filter", "none,polytope-cbf"], 2, "--filter needs names of filters, or only none"),
        (["COVER", "--filter", "nome"], 2, "no filter is called 'nome'; known: none, polytope-cbf"),
        (["COVER", "--set", "safety.polytope-cbf.beta=101"], 2, "`$.safety.polytope-cbf.beta`"),
        (["COVER", "--set", "rules.dt_s=1"], 2, "`$.safety.polytope-cbf.beta`"),
        (["COVER", "--set", "mission.bounds_m=0,0,0,1,0,1"], 2, "`$.mission.bounds_m`"),
        (["COVER", "--set", "vehicle.radius_m=3"], 5, "trial 0: no start and goal"),
        (["COVER", "--scene", "COVER"], 3, "is alula/cover, but alula/scene is needed"),
        (["PLAN"], 2, "needs --map"),
        (["PLAN", "--map", "COVER", "--trials", "2"], 2, "all 2 flights would be the same"),
        (["PLAN", "--map", "PLAN"], 3, "is alula/plan, but alula/cover or"),
        (["VOXELS"], 3, "is alula/voxels, but a scenario"),
        (["absent.npz"], 3, "does not exist"),
        (["absent.toml"], 3, "cannot read"),
        (["COVER", "-o", "no/such/r.run.mcap"], 3, "does not exist"),
    ],
)
def test_errors_are_one_line_and_leave_nothing(
    tmp_path, capsys, monkeypatch, cover, arguments, code, message
):
    monkeypatch.chdir(tmp_path)
    plan = write_plan(tmp_path / "p.plan.npz", [0.2, 2, 1], [0.9, 2, 1], cover)
    voxels = tmp_path / "v.voxels.npz"
    arrays = {"index": np.zeros((1, 3)), "overlap": np.ones(1)}
    fields = {"voxel_size_m": 0.1, "sigma": 1.0, "min_overlap": 1, "parameters": {}, "summary": {}}
    write_artifact(voxels, make_artifact(VOXELS, arrays, frame="world", unit="m", **fields))
    before = sorted(tmp_path.iterdir())
    names = {"COVER": str(cover), "PLAN": str(plan), "VOXELS": str(voxels)}
    words = ["simulate", *(names.get(word, word) for word in arguments)]
    if "-o" not in words:
        words += ["-o", "r.run.mcap"]
    assert run(words) == code
    output = capsys.readouterr()
    assert output.out == ""
    assert message in output.err
    assert output.err.count("\n") == 1
    assert sorted(tmp_path.iterdir()) == before


def test_as_a_program_it_prints_json(cover, tmp_path):
    out = tmp_path / "r.run.mcap"
    done = subprocess.run(
        [sys.executable, "-P", "-m", "alula.cli", "simulate", str(cover), "-o", str(out), *FAST, "--json"],
        capture_output=True,
        text=True,
        check=True,
    )
    result = json.loads(done.stdout)
    assert done.stderr == ""
    assert result["status"] == "written"
    assert result["summary"]["trials"] == 3


def test_a_plan_that_jumps_is_refused(cover, tmp_path, capsys):
    path, out = tmp_path / "jumps.plan.npz", tmp_path / "r.run.mcap"
    coefficient = np.zeros((2, 4, 8))
    coefficient[:, :3, 0], coefficient[:, 0, 1] = [0.5, 2.0, 1.0], 0.125  # back to the start
    arrays = {"time": np.array([0.0, 4.0, 8.0]), "coefficient": coefficient, "waypoint": np.zeros((2, 4))}
    common = {"frame": "world", "unit": "m", "parameters": {}, "summary": {}}
    write_artifact(path, make_artifact(PLAN, arrays, radius_m=0.1, speed_m_s=1.0, certificate={}, **common))
    insist = ["--set", "mission.allow_other_map=true"]
    assert run(["simulate", str(path), "--map", str(cover), "-o", str(out), *insist]) == 3
    assert "the plan is no motion: at 4 s the position jumps by 0.5 after piece 0" in capsys.readouterr().err
    assert not out.exists()
