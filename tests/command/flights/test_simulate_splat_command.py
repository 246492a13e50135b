"""`alula simulate` among the ellipsoids of a scene, as a user runs it: files, logs, exit codes, errors."""

import hashlib
import json
import re
from collections import Counter

import msgspec
import numpy as np
import pytest
from mcap.reader import make_reader
from scipy.spatial.transform import Rotation

from alula.cli.main import run
from alula.cli.shell.runner import input_ref
from alula.schemas.artifacts.artifact import Artifact, make_artifact, write_artifact
from alula.schemas.artifacts.kinds import SCENE
from alula.schemas.artifacts.manifest import InputRef
from alula.schemas.log.flights import read_flights
from alula.schemas.log.run import RunRecord, read_run, record_path
from alula.stages.filtering.ellipsoid_filters import ELLIPSOID_FILTERS
from support.paths import VEHICLES
from support.scenes.fabricate import box, make_cover, make_scene
from support.scenes.small_scenes import rest_plan

FAST = ["--trials", "2", "--speed", "2"]
GUIDED = ["--filter", "cone-ecbf", "--set", "mission.controller.guide=cone-di"]
DI = ["SCENE", "--filter", "cone-di", "--set"]
LIGHT = ["--vehicle", str(VEHICLES / "crazyflie21.toml")]


@pytest.fixture(scope="session")
def scene(tmp_path_factory):
    path = tmp_path_factory.mktemp("splat") / "field.scene.npz"
    write_artifact(path, make_scene(60, low=(0, 0, 0), high=(6, 4, 3)))
    return path


def write_plan(path, made_in, start=(0, 0.5, 1), goal=(3, 0.5, 1), speed=1.5, frame="world"):
    plan = rest_plan(start, goal, speed, frame)
    manifest = msgspec.structs.replace(plan.manifest, inputs=[input_ref("scene", made_in)])
    write_artifact(path, Artifact(manifest, plan.arrays))
    return path


def messages(path, topic):
    with path.open("rb") as file:
        return [
            (schema.name, json.loads(message.data))
            for schema, _, message in make_reader(file, validate_crcs=True).iter_messages(topics=[topic])
        ]


@pytest.mark.parametrize("name", ["none", *ELLIPSOID_FILTERS])
def test_every_filter_flies_and_any_number_of_threads_writes_the_same_bytes(scene, tmp_path, name):
    a, b = tmp_path / "a.run.mcap", tmp_path / "b.run.mcap"
    words = ["simulate", str(scene), *FAST, "--filter", name, "-q"]
    codes = [run([*words, "-o", str(a), "--jobs", "1"]), run([*words, "-o", str(b), "--jobs", "2"])]
    first, second = (msgspec.json.decode(record_path(p).read_bytes(), type=RunRecord) for p in (a, b))
    hits = any(t.scene_clearance_m < -1e-6 for t in first.trials)
    assert codes == [4 if hits and name != "none" else 0] * 2
    assert a.read_bytes() == b.read_bytes()
    assert msgspec.structs.replace(first, timing=None) == msgspec.structs.replace(second, timing=None)
    assert (first.filter, len(first.trials), first.summary["sigma"]) == (name, 2, 1.0)
    assert [ref.role for ref in first.provenance.inputs] == ["scene"]
    timing = first.timing
    assert timing["ticks"] == first.summary["steps"]
    assert 0 < timing["tick_p50_s"] <= timing["tick_p99_s"] <= timing["tick_max_s"]
    assert 0 <= timing["overruns"] <= timing["ticks"]
    assert ("filter_p50_s" in timing) == (name != "none")
    assert (name == "cone-backup") <= (first.summary["certified_steps"] > 0)
    parameters = first.provenance.parameters
    assert (parameters["mission"]["speed_m_s"], parameters["vehicle"]["type"]) == (2.0, "fastbridge")
    assert parameters["vehicle_file"]["model"] == "quadrotor"
    assert parameters["vehicle_file"]["body"]["radius_m"] == 0.15
    assert parameters["safety"]["filters"] == ([] if name == "none" else [name])
    for trial in first.trials:
        assert trial.reference_speed_m_s == pytest.approx(2, rel=1e-3)
        assert trial.peak_realisation_error_m_s2 >= 0
        assert trial.map_clearance_m is None


def test_the_log_has_attitude_rotors_and_what_the_filter_did(scene, tmp_path):
    out = tmp_path / "r.run.mcap"
    words = ["simulate", str(scene), *FAST, "--filter", "cone-backup", "--set", "rules.log_rate_hz=50"]
    assert run([*words, "--seed", "3", "-o", str(out), "-q"]) == 0
    record = read_run(out)
    samples = sum(-(-t.steps // 2) + 1 for t in record.trials)
    counts = Counter()
    for topic in ("/map", "/vehicle", "/splat", "/path", "/pose", "/tf", "/state", "/safety", "/log"):
        counts |= Counter((topic, name) for name, _ in messages(out, topic))
    assert counts == {
        ("/map", "foxglove.SceneUpdate"): 1,
        ("/vehicle", "foxglove.SceneUpdate"): 1,
        ("/splat", "foxglove.PointCloud"): 1,
        ("/path", "foxglove.PosesInFrame"): 2,
        ("/pose", "foxglove.PoseInFrame"): samples,
        ("/tf", "foxglove.FrameTransform"): samples,
        ("/state", "alula.State"): samples,
        ("/safety", "alula.Safety"): samples,
        ("/log", "foxglove.Log"): 2,
    }
    states = [m for _, m in messages(out, "/state") if m["trial"] == 0]
    for state in states:
        assert sum(state["rotor_thrust_n"]) == pytest.approx(state["thrust_n"], abs=1e-5)
        assert np.linalg.norm(list(state["attitude"].values())) == pytest.approx(1, abs=1e-5)
    # the thrust axis of the first half is tilted towards the goal, as the body accelerates there
    way = np.subtract(record.trials[0].goal_m, record.trials[0].start_m)[:2]
    quat = list(states[len(states) // 5]["attitude"].values())
    assert Rotation.from_quat(quat).apply([0, 0, 1])[:2] @ way > 0
    heading = Rotation.from_quat(list(states[0]["attitude"].values())).as_euler("zyx")[0]
    assert heading == pytest.approx(np.arctan2(way[1], way[0]), abs=1e-5)
    safety = [m for _, m in messages(out, "/safety")]
    assert {m["status_name"] for m in safety} <= {"ok", "filtered", "recovering", "refused", "backup"}
    assert all(m["certified"] for m in safety)
    assert any(m["candidates"] > 0 for m in safety)
    assert max(m["gate_m"] for m in safety) >= 0.5
    pose = messages(out, "/pose")[5][1]
    assert pose["pose"]["orientation"] == messages(out, "/state")[5][1]["attitude"]
    (entity,) = messages(out, "/map")[0][1]["entities"]
    assert len(entity["spheres"]) == 60
    assert {pair["key"]: pair["value"] for pair in entity["metadata"]} == {"ellipsoids": "60", "shown": "60"}
    flights = read_flights(out)
    assert flights.hulls is None
    assert flights.by_trial[0].margin_unit == "of the filter's barrier"
    assert np.nanmin(flights.by_trial[0].margin) >= record.trials[0].min_margin - 1e-6
    assert flights.by_trial[0].speed_m_s.max() == pytest.approx(record.trials[0].max_speed_m_s, rel=0.05)


def test_a_map_of_many_ellipsoids_shows_those_near_the_paths(tmp_path):
    path, out = tmp_path / "many.scene.npz", tmp_path / "r.run.mcap"
    write_artifact(path, make_scene(5000, low=(-20, -20, 5), high=(20, 20, 30)))
    plan = write_plan(tmp_path / "p.plan.npz", path, (0, 0, 0), (2, 0, 0))
    words = ["simulate", str(plan), "--map", str(path), "--filter", "none", "-o", str(out), "-q"]
    assert run(words) == 0
    (entity,) = messages(out, "/map")[0][1]["entities"]
    metadata = {pair["key"]: pair["value"] for pair in entity["metadata"]}
    assert metadata == {"ellipsoids": "5000", "shown": "3000"}
    heights = [sphere["pose"]["position"]["z"] for sphere in entity["spheres"]]
    assert max(heights) < 29


def test_a_plan_flies_in_a_scene_and_a_report_is_made_of_it(scene, tmp_path):
    plan, out = write_plan(tmp_path / "p.plan.npz", scene), tmp_path / "r.run.mcap"
    words = [
        "simulate",
        str(plan),
        "--map",
        str(scene),
        "--filter",
        "cone-di",
        "--vehicle",
        "double-integrator",
        "--set",
        "vehicle.max_acceleration_m_s2=1000",
    ]
    assert run([*words, "--set", "world.confidence=0.5", "-o", str(out), "-q"]) in (0, 4)
    record = read_run(out)
    (trial,) = record.trials
    assert trial.start_m == [0.0, 0.5, 1.0]
    assert trial.goal_m == pytest.approx([3.0, 0.5, 1.0])
    assert trial.peak_realisation_error_m_s2 == 0
    assert record.summary["sigma"] == pytest.approx(1.5382, abs=1e-4)  # median of the chi law
    assert record.provenance.parameters["world"]["confidence"] == 0.5
    report = tmp_path / "report.html"
    assert run(["report", str(out), "-o", str(report), "-q"]) == 0
    tables = report.with_suffix(".md").read_text()
    assert "maximum realisation error" in tables
    assert "minimum γ" in tables
    assert run(["info", str(out), "-q"]) == 0


def test_a_cover_beside_a_scene_is_part_of_the_world(scene, tmp_path, capsys):
    cover, out = tmp_path / "c.cover.npz", tmp_path / "r.run.mcap"
    write_artifact(cover, make_cover([box((0, 0, 0), (120, 80, 60))]))
    words = ["simulate", str(cover), "--scene", str(scene), *FAST, "-o", str(out), "-q"]
    assert run([*words, "--filter", "cone-backup", "--set", "mission.bounds_m=0,0,0,6,4,3"]) == 5
    assert "no start and goal" in capsys.readouterr().err
    write_artifact(cover, make_cover([box((-90, -90, -90), (-80, -80, -80))]))
    assert run([*words, "--filter", "cone-backup"]) == 0
    record = read_run(out)
    assert all(t.map_clearance_m > 0 < t.scene_clearance_m for t in record.trials)
    assert record.guarantee.claims["certified_against"] == ["ellipsoids", "hulls"]
    assert [ref.role for ref in record.provenance.inputs] == ["cover", "scene"]


def test_a_cover_of_another_scene_or_level_is_said_at_once(scene, tmp_path, capsys):
    cover, out = tmp_path / "c.cover.npz", tmp_path / "r.run.mcap"
    made = make_cover([box((-90, -90, -90), (-80, -80, -80))])
    origin = InputRef("scene", "alula/scene", "1.0", "7" * 64, "other.scene.npz")
    named = msgspec.structs.replace(made.manifest, made_from=[origin], sigma=1.0)
    write_artifact(cover, Artifact(named, made.arrays))
    words = ["simulate", str(cover), "--scene", str(scene), *FAST, "-o", str(out)]
    assert run([*words, "--filter", "cone-backup", "--set", "world.sigma=1.5"]) == 0
    error = capsys.readouterr().err
    assert "note: The cover was made from another scene file, other.scene.npz (sha256 777777777777…)" in error
    assert (
        "note: The ellipsoids of the run are those at 1.5 sigma, and the cover contains those at 1." in error
    )
    chain = read_run(out).guarantee.claims["chain"]
    assert not chain["holds"]
    assert chain["inputs"]["scene"] == hashlib.sha256(scene.read_bytes()).hexdigest()


def test_a_scenario_names_scene_vehicle_and_parameters(scene, tmp_path):
    scenario, out = tmp_path / "s.toml", tmp_path / "r.run.mcap"
    (tmp_path / "f.scene.npz").write_bytes(scene.read_bytes())
    (tmp_path / "v.toml").write_bytes((VEHICLES / "fastbridge.toml").read_bytes())
    scenario.write_text(
        'version = "2.0"\nname = "mine"\n[world]\nscene = "f.scene.npz"\nsigma = 1.2\n'
        '[vehicle]\nfile = "v.toml"\nradius_m = 0.1\n[safety]\nfilters = ["cone-backup"]\n'
        "[safety.cone-backup]\nhorizon_s = 1.0\nnodes = 10\n"
        "[rules]\ntrials = 2\nseed = 5\nmax_time_s = 4\n"
    )
    assert run(["simulate", str(scenario), "-o", str(out), "--set", "safety.cone-backup.nodes=12", "-q"]) == 0
    record = read_run(out)
    parameters = record.provenance.parameters
    assert (record.name, len(record.trials), record.provenance.seed) == ("mine", 2, 5)
    assert (parameters["world"]["sigma"], parameters["vehicle"]["radius_m"]) == (1.2, 0.1)
    chosen = parameters["safety"]["cone-backup"]
    assert (chosen["horizon_s"], chosen["nodes"], chosen["alpha_terminal"]) == (1.0, 12, 5.0)
    assert [ref.role for ref in record.provenance.inputs] == ["scenario", "scene", "vehicle"]
    assert all(t.duration_s <= 4 for t in record.trials)
    before = out.read_bytes()
    assert run(["simulate", str(scenario), "-o", str(out), "--set", "safety.cone-backup.nodes=12", "-q"]) == 0
    assert out.read_bytes() == before
    assert run(["simulate", str(scenario), "-o", str(out), "--set", "safety.cone-backup.nodes=13", "-q"]) == 2


@pytest.mark.slow
def test_a_guide_is_recorded_and_reported_with_all_it_was_told(scene, tmp_path):
    a, b, report = tmp_path / "a.run.mcap", tmp_path / "b.run.mcap", tmp_path / "report.html"
    words = ["simulate", str(scene), *FAST, *GUIDED, "--set", "mission.which=blocked", "-q"]
    guide = "mission.controller.guide_parameters"
    for setting in (f"{guide}.alpha=3", f"{guide}.count=8"):
        words += ["--set", setting]
    for setting in ("lambda_=4", "solver=clarabel"):
        words += ["--set", f"safety.cone-ecbf.{setting}"]
    for path, jobs in ((a, "1"), (b, "2")):
        assert run([*words, "-o", str(path), "--jobs", jobs]) in (0, 4)
    assert a.read_bytes() == b.read_bytes()
    record = read_run(a)
    parameters, summary = record.provenance.parameters, record.summary
    controller, chosen = parameters["mission"]["controller"], parameters["safety"]["cone-ecbf"]
    assert controller["guide"] == "cone-di"
    assert controller["guide_parameters"] == {"alpha": 3, "count": 8}
    assert (chosen["lambda_"], chosen["solver"]) == (4.0, "clarabel")
    assert parameters["mission"]["which"] == "blocked"
    assert record.vehicle.endswith("guided by cone-di")
    assert "no proof depends on it" in record.guarantee.statement
    assert summary["blocked_pairs"] == 2 <= summary["sampled_pairs"]
    assert all(t.line_clearance_m < 0 for t in record.trials)
    assert run(["report", str(a), "-o", str(report), "-q"]) == 0
    page, tables = report.read_text(), report.with_suffix(".md").read_text()
    figures = re.findall(r'<div class="svg">.*?</svg>', page, re.DOTALL)
    (closest,) = [figure for figure in figures if ">of the filter's barrier<" in figure]
    assert "margin [m]" not in closest
    for row in ("| guide | cone-di |", "| pairs with a blocked line | 2 |", "| steps with qp infeasible |"):
        assert row in tables
    (head,) = [line for line in tables.splitlines() if "| qp infeasible |" in line]
    assert "| blocked | clearance of the straight line " in head


def test_a_scenario_names_guide_pairs_and_solver(scene, tmp_path):
    scenario, out = tmp_path / "s.toml", tmp_path / "r.run.mcap"
    (tmp_path / "f.scene.npz").write_bytes(scene.read_bytes())
    text = (
        'version = "2.0"\n[world]\nscene = "f.scene.npz"\n[safety]\nfilters = ["cone-backup"]\n'
        '[safety.cone-backup]\nsolver = "interpolation"\n[mission]\nwhich = "blocked"\n'
        '[mission.controller]\nguide = "safer-splat"\nguide_parameters = { alpha = 3, beta = 2 }\n'
        "catch_up_m_s = 0.4\n[rules]\ntrials = 1\nmax_time_s = 2\n"
    )
    scenario.write_text(text)
    words = ["simulate", str(scenario), "-o", str(out), "-q"]
    words += ["--set", "mission.controller.guide_parameters.beta=4"]
    assert run(words) in (0, 4)
    parameters = read_run(out).provenance.parameters
    controller = parameters["mission"]["controller"]
    assert controller["guide"] == "safer-splat"
    assert controller["guide_parameters"] == {"alpha": 3, "beta": 4}
    assert parameters["safety"]["cone-backup"]["solver"] == "interpolation"
    assert (controller["catch_up_m_s"], parameters["mission"]["which"]) == (0.4, "blocked")
    scenario.write_text(text.replace('guide = "safer-splat"\n', ""))
    assert run([*words, "-f"]) == 2


def test_a_filtered_collision_exits_with_4(tmp_path, capsys):
    path, out = tmp_path / "s.scene.npz", tmp_path / "r.run.mcap"
    write_artifact(path, make_scene(400, low=(1, 0, 0), high=(2, 1, 2)))
    plan = write_plan(tmp_path / "p.plan.npz", path, (1.5, 0.5, 1), (3, 0.5, 1))  # starts inside
    words = ["simulate", str(plan), "--map", str(path), "-o", str(out)]
    assert run([*words, "--filter", "cone-di", "-q", "--set", "mission.allow_tight=true"]) == 4
    assert "1 of 1 filtered flights touched a static obstacle" in capsys.readouterr().err
    assert read_run(out).summary["collisions"] == 1
    assert run([*words, "--filter", "none", "-q", "-f"]) == 0


def unaligned(path):
    scene = make_scene(20)
    manifest = msgspec.structs.replace(scene.manifest, unit="scene")
    write_artifact(path, Artifact(manifest, scene.arrays))


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["SCENE", "--filter", "polytope-cbf"], 2, "`$.safety.filters`: polytope-cbf needs hulls"),
        (["SCENE", "--filter", "nome"], 2, "no filter is called 'nome'; known: none, polytope-cbf, cone-di"),
        (
            ["COVER", "--filter", "cone-di"],
            2,
            "`$.safety.filters`: cone-di needs ellipsoids; set world.scene",
        ),
        ([*DI, "safety.cone-di.alhpa=1"], 2, "unknown field `alhpa` - at `$.safety.cone-di`"),
        ([*DI, "safety.cone-di.alpha=nan"], 2, "--set safety.cone-di.alpha: 'nan' is not finite"),
        ([*DI, "safety.cone-di.alpha=-1"], 2, "at `$.safety.cone-di.alpha`"),
        ([*DI, "alpha"], 2, "--set needs PATH=VALUE, not 'alpha'"),
        ([*DI, "alpha=1"], 2, "--set alpha: needs the whole path of a key; is it safety.cone-di.alpha?"),
        (["SCENE", "--set", "safety.cone-backup.policy=fly"], 2, "at `$.safety.cone-backup.policy`"),
        (["SCENE", "--set", "safety.cone-backup.weight=1,2"], 2, "at `$.safety.cone-backup.weight`"),
        (["COVER", "--set", "beta=1"], 2, "is it safety.polytope-cbf.beta or"),
        (["SCENE", "--set", "world.confidence=1"], 2, "at `$.world.confidence`"),
        (["SCENE", "--filter", "none", "--speed", "nan"], 2, "is not finite"),
        (
            ["SCENE", "--filter", "cone-ecbf", "--vehicle", "double-integrator"],
            2,
            "cone-ecbf is for commands of wrench",
        ),
        (["SCENE", "--filter", "none", "--set", "vehicle.radius_m=9"], 5, "trial 0: no start and goal"),
        (["SCENE", "--map", "SCENE", "--filter", "none"], 2, "is a scene; --map"),
        (["SCENE", "--scene", "SCENE", "--filter", "none"], 2, "is a scene; --scene"),
        (["UNALIGNED", "--filter", "none"], 3, "not metres; run scale-align first"),
        (["absent.scene.npz", "--filter", "none"], 3, "does not exist"),
        (["COVER", "--scene", "absent.npz", "--filter", "cone-di"], 3, "cannot read"),
        (
            ["PLAN", "--map", "SCENE", "--filter", "none", "--trials", "3"],
            2,
            "all 3 flights would be the same",
        ),
        (["PLAN", "--map", "VEHICLE", "--filter", "none"], 3, "is not an alula artifact"),
        (["ELSEWHERE", "--map", "SCENE", "--filter", "none"], 3, "in frame 'world', the plan in 'other'"),
        (["SCENE", *GUIDED, "--set", "mission.controller.guide=nome"], 2, "at `$.mission.controller.guide`"),
        (
            ["SCENE", *GUIDED, "--set", "mission.controller.guide=cone-backup"],
            2,
            "at `$.mission.controller.guide`",
        ),
        (
            ["SCENE", *GUIDED, "--set", "mission.controller.guide_parameters.alhpa=1"],
            2,
            "unknown parameter 'alhpa'; it has alpha",
        ),
        (
            ["SCENE", *GUIDED, "--set", "mission.controller.guide_parameters.alpha=-1"],
            2,
            "guide_parameters`: alpha must be above 0",
        ),
        ([*DI, "mission.controller.guide_parameters.alpha=1"], 2, "`$.mission.controller.guide_parameters`"),
        ([*DI, "safety.cone-di.solver=osqp"], 2, "Invalid enum value 'osqp' - at `$.safety.cone-di.solver`"),
        (["SCENE", "--set", "safety.safer-splat.solver=clarabel"], 2, "unknown field `solver`"),
        (
            ["PLAN", "--map", "SCENE", "--set", "mission.which=blocked"],
            2,
            "`$.mission.which` is for missions of kind pairs, and this one is plan",
        ),
        (
            ["COVER", "--set", "mission.controller.guide=cone-di"],
            2,
            "`$.mission.controller.guide`: cone-di changes accelerations, and the vehicle takes velocity",
        ),
        (
            ["SCENE", "--set", "mission.controller.catch_up_m_s=0"],
            2,
            "at `$.mission.controller.catch_up_m_s`",
        ),
        (["SCENE", "--vehicle", "BAD", "--filter", "none"], 2, "wings"),
        (["SCENE", "--vehicle", "absent.toml", "--filter", "none"], 3, "absent.toml: cannot read"),
        (
            ["SCENE", "--filter", "none", "--vehicle", "POINT", "--set", "vehicle.interface=body-rates"],
            2,
            "`$.vehicle.interface`: double-integrator is a double-integrator",
        ),
        ([*DI, "safety.cone-di.count=-1"], 2, "at `$.safety.cone-di.count`"),
        (["SCENE", *LIGHT, "--set", "safety.cone-backup.policy=hover"], 2, "they do not settle"),
    ],
)
def test_errors_are_one_line_and_leave_nothing(
    tmp_path, capsys, monkeypatch, scene, arguments, code, message
):
    monkeypatch.chdir(tmp_path)
    write_artifact(tmp_path / "c.cover.npz", make_cover([box((0, 0, 0), (10, 10, 10))]))
    unaligned(tmp_path / "u.scene.npz")
    (tmp_path / "bad.toml").write_bytes((VEHICLES / "fastbridge.toml").read_bytes() + b"\n[wings]\n")
    names = {
        "SCENE": str(scene),
        "COVER": "c.cover.npz",
        "UNALIGNED": "u.scene.npz",
        "PLAN": str(write_plan(tmp_path / "p.plan.npz", scene)),
        "ELSEWHERE": str(write_plan(tmp_path / "e.plan.npz", scene, frame="other")),
        "VEHICLE": str(VEHICLES / "fastbridge.toml"),
        "BAD": "bad.toml",
        "POINT": str(VEHICLES / "double-integrator.toml"),
    }
    before = sorted(tmp_path.iterdir())
    assert run(["simulate", *(names.get(word, word) for word in arguments), "-o", "r.run.mcap"]) == code
    output = capsys.readouterr()
    assert output.out == ""
    assert message in output.err
    assert output.err.count("\n") == 1
    assert sorted(tmp_path.iterdir()) == before


def test_numbers_without_meaning_in_a_scene_are_refused(tmp_path, capsys):
    path = tmp_path / "s.scene.npz"
    whole = make_scene(20)
    write_artifact(path, whole)
    data = bytearray(path.read_bytes())
    mean = np.asarray(whole["mean"]).tobytes()
    data[(at := data.find(mean)) : at + 4] = np.float32(np.nan).tobytes()
    path.write_bytes(data)
    assert run(["simulate", str(path), "--filter", "none", "-o", str(tmp_path / "r.run.mcap")]) == 3
    assert "mean" in capsys.readouterr().err


def test_a_scene_of_nothing_needs_bounds(tmp_path, capsys):
    empty = make_artifact(
        SCENE,
        {
            "mean": np.empty((0, 3)),
            "scale": np.empty((0, 3)),
            "quat_wxyz": np.empty((0, 4)),
            "opacity": np.empty(0),
            "color": np.empty((0, 3)),
        },
        frame="world",
        unit="m",
        parameters={},
        summary={},
        source={"format": "ply"},
    )
    path, out = tmp_path / "s.scene.npz", tmp_path / "r.run.mcap"
    write_artifact(path, empty)
    words = ["simulate", str(path), "--filter", "cone-backup", "--trials", "1", "-o", str(out), "-q"]
    assert run(words) == 2
    assert "no obstacles to take bounds from; set mission.bounds_m" in capsys.readouterr().err
    assert run([*words, "--set", "mission.bounds_m=0,0,0,3,3,3"]) == 0
    (trial,) = read_run(out).trials
    assert (trial.outcome, trial.scene_clearance_m, trial.min_gamma) == ("reached", None, None)
