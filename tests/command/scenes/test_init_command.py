"""`alula init`: a project from a splat, which make takes to a report."""

import json
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import alula
from alula.cli.main import run
from alula.cli.verbs import plan as plans
from alula.cli.verbs.project import LEARN_SCALE, undisturbed_way
from alula.schemas.errors import InputError
from alula.schemas.parameters.configs.plan import PlanConfig
from alula.schemas.scenarios.scenario import read_scenario
from alula.stages.clearance import hull_obstacles, segment_clearance
from alula.stages.compression.hulls import Hulls
from alula.stages.planning.space import plan_space
from support.files.doc_files import write_garden
from support.scenes.pipeline import COLUMNS

# A street, a robot in a folder of SOG, a house in SPZ, a camera, and a part of an INRIA scene.
REAL = (
    "istanbul-outdoor/tile_x001_y000.splat",
    "playbot-lod-sog/4_0",
    "fourth-st-spz/fourth_st.spz",
    "cc0-corpus/leica-sofort-top8192.ply",
    "inria-ply/train-1000.ply",
)


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    """The garden in a folder with a blank in its name, and the project beside it."""
    place = tmp_path_factory.mktemp("a place")
    write_garden(place / "my garden.ply")
    assert run(["init", str(place / "my garden.ply"), "-o", str(place / "garden"), "-q"]) == 0
    return place / "garden"


def make(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    command = ["make", "-C", str(folder), f"ALULA={sys.executable} -P -m alula.cli", *words]
    return subprocess.run(command, capture_output=True, text=True)


def test_a_project_has_what_make_needs_and_says_what_was_assumed(project):
    assert {path.name for path in project.iterdir()} == {"Makefile", "scenario.toml", "README.md"}
    readme = (project / "README.md").read_text()
    for subject in ("left out", "up", "scale", "floor", "crop", "voxels", "start, goal", "vehicle"):
        assert f"- **{subject}**: " in readme, subject
    assert "ASSUMED, not known: 1 unit is 1 m" in readme
    assert LEARN_SCALE in readme
    assert "@" not in readme + (project / "scenario.toml").read_text()
    scenario = read_scenario(project / "scenario.toml")
    assert (scenario.world.cover, scenario.safety.filters) == ("out/map.cover.npz", ("polytope-cbf",))


def test_make_knows_each_step(project):
    steps = {
        "verify": ["import-splat", "scale-align", "voxelize", "merge", "verify"],
        "plan": ["import-splat", "scale-align", "voxelize", "merge", "plan"],
        "fly-rehearsal": ["import-splat", "scale-align", "voxelize", "merge", "plan", "fly"],
    }
    for target, commands in steps.items():
        done = make(project, "-n", target)
        assert done.returncode == 0, done.stderr
        assert re.findall(r"-m alula\.cli ([\w-]+)", done.stdout) == commands
    assert re.findall(r"-m alula\.cli ([\w-]+)", make(project, "-n").stdout)[-1] == "report"


@pytest.mark.slow
def test_start_and_goal_are_free_in_the_map_that_make_makes(project):
    done = make(project, "plan")
    assert done.returncode == 0, done.stderr
    plan = alula.read(project / "out/path.plan.npz")
    cover = alula.read(project / "out/map.cover.npz")
    assert repr(alula.verify(plan, map=cover)).startswith("Proof: proven")
    assert np.linalg.norm(plan.at(0.0)[:2] - plan.at(plan.time[-1])[:2]) > 3
    radius_m = plan.manifest.radius_m - plan.manifest.margin_m
    assert radius_m == read_scenario(project / "scenario.toml").vehicle.radius_m
    scene = alula.read(project / "out/metric.scene.npz")
    assert np.percentile(scene.mean[:, 2], 30) == pytest.approx(0, abs=0.1)  # the lawn


@pytest.mark.slow
def test_where_the_filter_acts_ends_with_more_room_are_chosen(project, monkeypatch):
    assert make(project, "out/map.cover.npz").returncode == 0
    cover = alula.read(project / "out/map.cover.npz")
    planned = plans.plan

    def plan(*maps, margin_m, **fields):
        found = planned(*maps, margin_m=margin_m, **fields)
        found.summary["notes"] = ["the filter acts"] * (margin_m < 0.2)
        return found

    monkeypatch.setattr(plans, "plan", plan)
    assumed = {}
    way = undisturbed_way(cover, 1.0, assumed, is_scale_known=True, jobs=0)
    assert way.margin_m == 0.2
    assert "keeps 0.35 m" in assumed["distance"]
    hulls = hull_obstacles(Hulls.from_cover(cover.artifact))
    ends = np.array([way.start_m, way.goal_m])
    assert segment_clearance(ends, ends, hulls).min() >= 0.35


@pytest.mark.slow
def test_a_height_or_a_scale_gives_metres(project, tmp_path, capsys):
    splat = project.parent / "my garden.ply"
    assert run(["init", str(splat), "-o", str(tmp_path / "a"), "--height", "6", "--up", "+z", "--json"]) == 0
    sentence = json.loads(capsys.readouterr().out)["assumed"]["scale"]
    found = float(re.match(r"1 unit is ([\d.]+) m, because", sentence)[1])
    assert found == pytest.approx(6 / 2.1, rel=0.05)
    assert f"--scale {found!r} " in (tmp_path / "a/Makefile").read_text()
    assert LEARN_SCALE not in (tmp_path / "a/README.md").read_text()


def test_the_folder_has_the_name_of_the_splat_and_the_scale_is_loud(project, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_garden(tmp_path / "garden.v2.ply")
    assert run(["init", "garden.v2.ply"]) == 0
    printed = capsys.readouterr()
    assert printed.out.startswith("garden: written\n")
    assert printed.out.endswith("next: make -C garden\n")
    assert printed.err == f"note: 1 unit is ASSUMED to be 1 m: {LEARN_SCALE}\n"
    same = (project / "scenario.toml").read_text()
    assert (tmp_path / "garden/scenario.toml").read_text() == same


@pytest.mark.slow
def test_tiles_of_one_frame_become_one_project_equal_to_that_of_the_whole(project, tmp_path, capsys):
    whole = project.parent / "my garden.ply"
    header, rows = whole.read_bytes().split(b"end_header\n", 1)
    splats = np.frombuffer(rows, [(name, "<f4") for name in COLUMNS])
    (tmp_path / "tiles").mkdir()
    for k, part in enumerate(np.split(splats, [len(splats) // 3])):
        text = re.sub(rb"element vertex \d+", b"element vertex %d" % len(part), header)
        (tmp_path / f"tiles/tile $ {k}.ply").write_bytes(text + b"end_header\n" + part.tobytes())
    tiles = sorted(map(str, (tmp_path / "tiles").iterdir()))
    for name, inputs in (("named", tiles), ("folder", [str(tmp_path / "tiles")])):
        assert run(["init", *inputs, "-o", str(tmp_path / name), "-q"]) == 0
        made = [(each / "Makefile").read_text() for each in (tmp_path / name, project)]
        ends = [re.search(r"--start .*--goal [-. \d]+", text) for text in made]
        assert ends[0][0] == ends[1][0]
    done = make(tmp_path / "named", "out/splat.scene.npz")
    assert done.returncode == 0, done.stderr
    scene = alula.read(tmp_path / "named/out/splat.scene.npz")
    assert 0.9 * len(splats) <= len(scene.mean) <= len(splats)
    assert [each.name for each in scene.artifact.manifest.inputs] == [Path(tile).name for tile in tiles]
    assert run(["init", tiles[0], tiles[0], "-o", str(tmp_path / "twice")]) == 2
    assert "is named twice" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "code", "text"),
    [
        (("--height", "2", "--metres-per-unit", "2"), 2, "give one of them"),
        (("--up", "+z", "--colmap", "x"), 2, "both tell up"),
        (("--height", "-2"), 2, "--height must be between"),
        (("--metres-per-unit", "0"), 2, "--metres-per-unit must be between"),
        (("-o", "full"), 2, "is a folder with files"),
        (("-o", "a-file"), 3, "is a file, not a folder"),
        (("-o", "no/where"), 3, "does not exist"),
        (("--colmap", "none"), 3, "none"),
    ],
)
def test_what_is_refused_leaves_nothing(words, code, text, project, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "full").mkdir()
    (tmp_path / "full/mine.txt").write_text("mine")
    (tmp_path / "a-file").write_text("mine")
    assert run(["init", str(project.parent / "my garden.ply"), *words]) == code
    assert text in capsys.readouterr().err
    assert {path.name for path in tmp_path.iterdir()} == {"full", "a-file"}
    assert [path.name for path in (tmp_path / "full").iterdir()] == ["mine.txt"]


def test_a_splat_without_free_space_is_refused(tmp_path, capsys):
    rows = np.zeros(60, [(name, "<f4") for name in COLUMNS])
    rows["opacity"], rows["rot_0"] = 3.0, 1.0
    for axis in range(3):
        rows[f"scale_{axis}"] = np.log(0.5)
    header = ["ply", "format binary_little_endian 1.0", "element vertex 60"]
    header += [f"property float {name}" for name in COLUMNS] + ["end_header", ""]
    (tmp_path / "dot.ply").write_bytes("\n".join(header).encode() + rows.tobytes())
    assert run(["init", str(tmp_path / "dot.ply"), "-o", str(tmp_path / "dot"), "--height", "1"]) == 3
    assert "is flat" in capsys.readouterr().err
    assert not (tmp_path / "dot").exists()


def dots(path, count, opacity=3.0, no_rotation=0):
    rows = np.zeros(count, [(name, "<f4") for name in COLUMNS])
    rows["x"], rows["y"], rows["z"] = np.random.default_rng(0).uniform(-2, 2, (3, count))
    rows["opacity"], rows["rot_0"] = opacity, 1.0
    rows["rot_0"][count - no_rotation :] = 0.0
    for axis in range(3):
        rows[f"scale_{axis}"] = -3.0
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {count}"]
    header += [f"property float {name}" for name in COLUMNS] + ["end_header", ""]
    path.write_bytes("\n".join(header).encode() + rows.tobytes())


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"count": 1, "opacity": -3.0}, "1 Gaussians are no scene"),
        ({"count": 60, "opacity": -9.0}, "no Gaussian is left of 60: removed 60 by min_opacity"),
        ({"count": 60, "no_rotation": 59}, "59 of 60 Gaussians have a quaternion of length zero"),
    ],
)
def test_a_file_of_which_nearly_nothing_is_left_makes_no_project(fields, text, tmp_path, capsys):
    dots(tmp_path / "dot.ply", **fields)
    assert run(["init", str(tmp_path / "dot.ply"), "-o", str(tmp_path / "dot")]) == 3
    printed = capsys.readouterr()
    assert text in printed.err
    assert len(printed.err.splitlines()) == 1
    assert not (tmp_path / "dot").exists()


def test_the_library_names_the_file_of_which_nothing_is_left(tmp_path):
    dots(tmp_path / "dot.ply", 3, opacity=-3.0)
    with pytest.raises(InputError, match=r"dot\.ply: no Gaussian is left of 3: removed 3 by min_opacity"):
        alula.import_splat(tmp_path / "dot.ply", min_opacity=0.5)


def test_start_and_goal_are_at_a_comfortable_height_with_room_above(project, tmp_path):
    """The garden's lawn is the floor; nothing is above either end within half a metre."""
    made = re.search(r"--start ([-\d. ]+?) --goal ([-\d. ]+?) --", (project / "Makefile").read_text())
    ends = np.array([[float(x) for x in words.split()] for words in made.groups()])
    assert ((ends[:, 2] >= 0.5) & (ends[:, 2] <= 2.5)).all()
    own = shutil.copytree(project.parent, tmp_path / "own") / project.name  # others find what they expect
    assert make(own, "out/map.cover.npz").returncode == 0
    cover = alula.read(own / "out/map.cover.npz")
    space = plan_space(PlanConfig(radius_m=0.25), cover.artifact)
    assert space.map.is_clear(ends, ends + np.array((0, 0, 0.5)), 0.25).all()
    assert not (project / "scenario.toml").read_text().count("bounds_m")


@pytest.mark.slow
def test_a_scene_too_small_for_the_vehicle_is_assumed_to_be_larger_and_this_is_said(tmp_path, capsys):
    write_garden(tmp_path / "garden.ply")
    assert run(["init", str(tmp_path / "garden.ply"), "-o", str(tmp_path / "a"), "--height", "0.05"]) == 0
    assert "it is hardly larger than the vehicle: is the scale right?" in capsys.readouterr().out
    rows = (tmp_path / "garden.ply").read_bytes().split(b"end_header\n")
    small = np.frombuffer(rows[1], [(name, "<f4") for name in COLUMNS]).copy()
    for axis in range(3):
        small["xyz"[axis]] *= 0.05
        small[f"scale_{axis}"] += np.log(0.05).astype(np.float32)
    (tmp_path / "small.ply").write_bytes(rows[0] + b"end_header\n" + small.tobytes())
    assert run(["init", str(tmp_path / "small.ply"), "-o", str(tmp_path / "b")]) == 0
    printed = capsys.readouterr()
    found = re.search(
        r"1 unit is (\d+) m, .*; at 1 m a unit it would be [\d.]+ m high, too small", printed.out
    )
    assert found is not None
    assert f"1 unit is ASSUMED to be {found[1]} m" in printed.err


@pytest.mark.slow
@pytest.mark.usefixtures("quick_clock")  # for the rehearsal
@pytest.mark.parametrize("splat", REAL)
def test_a_real_splat_becomes_a_report_and_a_rehearsal_without_a_question(
    splat, data, tmp_path, capsys, monkeypatch
):
    folder = tmp_path / "project"
    assert run(["init", str(data / splat), "-o", str(folder), "--trials", "5"]) == 0, capsys.readouterr().err
    done = make(folder)
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.search("- obstacles covered: (yes|in part)", done.stdout)  # in part: init may crop
    assert (folder / "out/report.html").is_file()
    for name in ("path", "pairs"):
        found = alula.read(folder / f"out/{name}.run.mcap")
        assert found.summary["static_collisions"] == 0
    assert found.summary["trials"] == 5
    monkeypatch.chdir(folder)
    (flight,) = re.findall(r"-m alula\.cli (fly .*)", make(folder, "-n", "fly-rehearsal").stdout)
    assert run(shlex.split(flight)) == 0, capsys.readouterr().err
    assert alula.read(folder / "out/rehearsal.run.mcap").summary["collisions"] == 0
