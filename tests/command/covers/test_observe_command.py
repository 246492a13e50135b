"""The command `alula observe`, and what other commands do with its file."""

import json
import shutil

import numpy as np
import pytest

import alula
from alula.cli.main import run
from alula.schemas.artifacts.artifact import read_artifact
from alula.schemas.artifacts.kinds import SEEN
from alula.schemas.errors import UsageError
from alula.schemas.log.run import read_run
from alula.schemas.parameters.configs.fly import FlyConfig
from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.stages.compression.level import level_words
from alula.stages.flight.mission import make_mission


@pytest.fixture
def words(pipeline, tmp_path):
    return [
        *("observe", str(pipeline / "tiny.metric.scene.npz"), "-o", str(tmp_path / "a.seen.npz")),
        *("--cameras", str(pipeline / "cameras.csv"), "--size", "0.2"),
    ]


def test_seen_space_is_written_once_and_then_left_alone(words, tmp_path, capsys):
    assert run([*words, "--radius", "0.15", "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["status"] == "written"
    assert record["summary"]["cameras_next_to_reached_space"] == 2
    found = read_artifact(tmp_path / "a.seen.npz", SEEN)
    assert found.manifest.method == "cameras"
    assert found.manifest.radius_m == 0.15
    assert [ref.role for ref in found.manifest.inputs] == ["cameras", "scene"]
    assert "at least 1 of 2 cameras saw it" in found.manifest.guarantee.statement
    before = (tmp_path / "a.seen.npz").read_bytes()
    assert run([*words, "--radius", "0.15", "--json", "--jobs", "3"]) == 0
    assert json.loads(capsys.readouterr().out)["status"] == "unchanged"
    assert run([*words, "-q", "-f", "--vehicle", "missing.toml"]) == 3
    assert (tmp_path / "a.seen.npz").read_bytes() == before


def test_the_function_writes_the_bytes_of_the_command(words, pipeline, tmp_path):
    assert run([*words, "--radius", "0.15", "-q"]) == 0
    scene, cameras = pipeline / "tiny.metric.scene.npz", pipeline / "cameras.csv"
    seen = alula.observe(alula.read(scene), cameras=cameras, size_m=0.2, radius_m=0.15)
    seen.save(tmp_path / "b.seen.npz")
    assert (tmp_path / "b.seen.npz").read_bytes() == (tmp_path / "a.seen.npz").read_bytes()
    with pytest.raises(UsageError, match="exactly one of --colmap, --cameras, --reach is needed"):
        alula.observe(scene)


def test_the_radius_is_that_of_the_vehicle(words, pipeline, tmp_path):
    assert run([*words, "--vehicle", str(pipeline / "tiny.vehicle.toml"), "-q"]) == 0
    assert read_artifact(tmp_path / "a.seen.npz").manifest.radius_m == 0.15


def test_a_colmap_model_of_the_same_cameras_gives_the_same_space(words, tmp_path, pipeline):
    pytest.importorskip("pycolmap")
    folder = tmp_path / "model"
    folder.mkdir()
    (folder / "cameras.txt").write_text("1 PINHOLE 200 200 100 100 100 100\n")
    (folder / "points3D.txt").write_text("")
    rows = []
    for number, (x, q) in enumerate(((0.3, (0.5, 0.5, -0.5, 0.5)), (3.7, (0.5, 0.5, 0.5, -0.5))), 1):
        w, i, j, k = q  # world to camera: the conjugate of that in the CSV
        R = np.array(
            [
                [1 - 2 * (j * j + k * k), 2 * (i * j - w * k), 2 * (i * k + w * j)],
                [2 * (i * j + w * k), 1 - 2 * (i * i + k * k), 2 * (j * k - w * i)],
                [2 * (i * k - w * j), 2 * (j * k + w * i), 1 - 2 * (i * i + j * j)],
            ]
        )
        t = -R @ [x, 1.5, 1]
        rows.append(f"{number} {w} {i} {j} {k} {t[0]} {t[1]} {t[2]} 1 {number}.jpg\n\n")
    (folder / "images.txt").write_text("".join(rows))
    assert run([*words, "--radius", "0.15", "-q"]) == 0
    other = [*words[:2], "-o", str(tmp_path / "b.seen.npz"), "--colmap", str(folder), "--size", "0.2"]
    assert run([*other, "--radius", "0.15", "-q"]) == 0
    one, two = (read_artifact(tmp_path / f"{name}.seen.npz") for name in "ab")
    np.testing.assert_array_equal(one["index"], two["index"])


@pytest.mark.parametrize(
    ("more", "code", "text"),
    [
        (
            ["--reach", "2 1.5 1"],
            2,
            "exactly one of --colmap, --cameras, --reach is needed, not --cameras and",
        ),
        (
            ["--radius", "0.1", "--vehicle", "x.toml"],
            2,
            "--radius is that of the vehicle; leave out --vehicle",
        ),
        (["--radius", "17"], 2, "--radius must be above 0 and at most 80 voxels (16 m), not 17"),
        (["--near", "9"], 2, "--near and --range need 0.001 <= near < range <= 10000 m, not 9 and 5"),
        (["--columns", "5"], 2, "--columns must be between 16 and 8192, not 5"),
        (["--min-views", "0"], 2, "--min-views must be between 1 and 65535, not 0"),
        (["--min-views", "3"], 5, "none of 2 cameras sees a voxel"),
        (["--radius", "1.4"], 5, "no camera has room for a ball of 1.4 m near it that was seen"),
    ],
)
def test_what_makes_no_sense_is_refused_in_one_line(words, tmp_path, capsys, more, code, text):
    assert run([*words, *more]) == code
    lines = capsys.readouterr().err.strip().splitlines()
    assert len([line for line in lines if line.startswith("alula: ")]) == 1
    assert text in lines[0]
    assert not (tmp_path / "a.seen.npz").exists()


def test_a_level_beside_voxels_and_voxels_of_another_scene_are_refused(words, pipeline, tmp_path, capsys):
    voxels = ["--voxels", str(pipeline / "tiny.voxels.npz")]
    assert run([*words, *voxels]) == 2
    assert "the level is that of --voxels; leave out --size" in capsys.readouterr().err
    scene = tmp_path / "other.scene.npz"
    made = ["scale-align", str(pipeline / "tiny.scene.npz"), "-o", str(scene), "--scale", "1.5", "-q"]
    assert run(made) == 0
    assert run(["observe", str(scene), *words[2:6], *voxels]) == 3
    assert "was made from another scene, tiny.metric.scene.npz" in capsys.readouterr().err


def test_cameras_without_intrinsics_are_refused(words, tmp_path, capsys):
    (tmp_path / "cameras.csv").write_text("image,x,y,z,qw,qx,qy,qz\na,0,0,0,1,0,0,0\n")
    words[words.index("--cameras") + 1] = str(tmp_path / "cameras.csv")
    assert run([*words, "--radius", "0.15"]) == 3
    assert "no column 'width'" in capsys.readouterr().err


def test_info_verify_and_plan_know_the_file(pipeline, tmp_path, capsys):
    seen, cover = str(pipeline / "tiny.seen.npz"), str(pipeline / "tiny.cover.npz")
    assert run(["info", seen]) == 0
    assert "seen to be free" in capsys.readouterr().out
    voxels, scene = str(pipeline / "tiny.voxels.npz"), str(pipeline / "tiny.metric.scene.npz")
    assert run(["verify", seen, "--voxels", voxels, "--scene", scene, "-o", str(tmp_path / "c.json")]) == 0
    assert capsys.readouterr().out.startswith("free: every seen voxel is touched by no obstacle at 1 sigma")
    assert json.loads((tmp_path / "c.json").read_text())["given"] == ["seen", "voxels", "scene"]
    planned = ["plan", cover, "-o", str(tmp_path / "a.plan.npz"), "--start", "1.2 1.5 1", "--radius", "0.2"]
    assert run([*planned, "--goal", "2.8 1.5 1", "--within", seen, "-q"]) == 0
    roles = [ref.role for ref in read_artifact(tmp_path / "a.plan.npz").manifest.inputs]
    assert roles == ["cover", "within"]
    proof = ["verify", str(tmp_path / "a.plan.npz"), "--map", cover]
    capsys.readouterr()
    assert run([*proof, "--within", seen]) == 0
    assert "within the space that was seen" in capsys.readouterr().out
    assert run([*planned, "-f", "--goal", "9 9 9", "--within", seen, "-q"]) == 5
    err = capsys.readouterr().err
    assert "the goal (9 9 9) is not in the space that was seen (--within)" in err
    assert run(["merge", seen, "-o", str(tmp_path / "x.npz"), "--hulls", "3"]) == 3


SCENARIO = """
schema = "alula/scenario"
version = "2.0"
[vehicle]
type = "single-integrator"
radius_m = 0.1
[world]
seen = "tiny.seen.npz"
[mission]
kind = "goal"
start_m = [1.2, 1.5, 1]
goal_m = [2, 1.5, 6]
beyond_map_m = 9.0
[safety]
filters = ["polytope-cbf"]
[rules]
max_time_s = 10.0
"""


def test_simulated_flights_stay_in_seen_space_and_are_judged_against_its_boundary(pipeline, tmp_path, capsys):
    (tmp_path / "tiny.seen.npz").write_bytes((pipeline / "tiny.seen.npz").read_bytes())
    scenario, out = tmp_path / "up.toml", tmp_path / "up.run.mcap"
    scenario.write_text(SCENARIO)
    words = ["simulate", str(scenario), "-o", str(out), "-f", "-q"]
    run(words)
    record = read_run(out)
    assert record.summary["collisions"] == 0
    assert record.trials[0].outcome != "reached"
    assert 0 <= record.summary["min_map_clearance_m"] < 0.2
    assert "all space that was not seen" in record.guarantee.statement
    assert [ref.role for ref in record.provenance.inputs] == ["scenario", "seen"]
    run([*words, "--filter", "none"])
    assert read_run(out).summary["collisions"] == 1
    capsys.readouterr()
    assert run([*words, "--set", "mission.start_m=1.2,1.5,9"]) == 2
    assert "(1.200 1.500 9.000) is not in the space that was seen" in capsys.readouterr().err
    assert run([*words, "--set", "world.seen=missing.seen.npz"]) == 3
    assert run([*words, "--planned"]) == 2
    assert "plans are made in a cover or a scene" in capsys.readouterr().err
    shutil.copy(pipeline / "tiny.cover.npz", tmp_path)
    inside = ["--set", "mission.goal_m=2.8,1.5,1", "--set", "world.cover=tiny.cover.npz"]
    assert run([*words, "--planned", *inside]) == 0
    assert read_run(out).trials[0].outcome == "reached"
    capsys.readouterr()
    assert run([*words, "--planned", *inside[2:]]) == 5  # its goal was not seen
    assert "the planner found no way for 1 of 1 pairs: pair 0 from" in capsys.readouterr().err


def test_a_real_flight_keeps_from_unseen_space_like_from_hulls(pipeline, tmp_path):
    cover, scene, seen = (
        read_artifact(pipeline / f"tiny.{name}.npz") for name in ("cover", "metric.scene", "seen")
    )
    words = ["plan", str(pipeline / "tiny.cover.npz"), "-o", str(tmp_path / "a.plan.npz"), "-q"]
    assert run([*words, "--start", "-1 1.5 1", "--goal", "2 1.5 1", "--beyond-map", "2"]) == 0
    plan = read_artifact(tmp_path / "a.plan.npz")
    config = FlyConfig(speed_m_s=1.0)
    free = make_mission(config, plan, FASTBRIDGE, cover=cover, scene=None, is_splat=False)
    assert free.is_clear[0]
    # the plan begins behind the first camera, where nobody looked
    with pytest.raises(UsageError, match=r"m from the map, and polytope-cbf keeps 0.25 m"):
        make_mission(config, plan, FASTBRIDGE, cover=cover, scene=None, is_splat=False, within=seen)
    tight = FlyConfig(speed_m_s=1.0, allow_tight=True)
    kept = make_mission(tight, plan, FASTBRIDGE, cover=cover, scene=None, is_splat=False, within=seen)
    assert not kept.is_clear[0]
    assert "the plan begins outside of the space that was seen" in kept.is_clear[1]
    assert len(kept.world.static.hulls) > len(free.world.static.hulls)
    assert len(kept.world.filters) == 1
    inside = read_artifact(pipeline / "tiny.plan.npz")
    good = make_mission(config, inside, FASTBRIDGE, cover=cover, scene=None, is_splat=False, within=seen)
    words = "proven to keep 0.15 m from all hulls made for every ellipsoid of the scene at "
    words += f"{level_words(cover.manifest.sigma)}, and from unseen space"
    assert good.is_clear == (True, words)
    with pytest.raises(UsageError, match="--within needs a cover"):
        make_mission(config, plan, FASTBRIDGE, cover=None, scene=scene, is_splat=True, within=seen)
