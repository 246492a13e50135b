"""A plan is flown and proven in the map that it was made in, or where the user insists in another."""

import shutil

import pytest

from alula.cli.main import run
from alula.schemas.artifacts.artifact import read_artifact
from alula.schemas.log.run import read_run


@pytest.fixture(scope="module")
def folder(pipeline, tmp_path_factory):
    """The pipeline's files, other maps of its scene, and a cover of the same splat in other metres."""
    made = tmp_path_factory.mktemp("maps")
    for path in pipeline.iterdir():
        if path.is_file():
            shutil.copy(path, made)
    f = lambda name: str(made / name)  # noqa: E731
    for words in (
        ["voxelize", f("tiny.metric.scene.npz"), "-o", f("coarse.voxels.npz"), "--size", "0.25"],
        ["merge", f("coarse.voxels.npz"), "-o", f("coarse.cover.npz"), "--hulls", "8"],
        ["merge", f("tiny.cover.npz"), "-o", f("fewer.cover.npz"), "--hulls", "10"],
        ["export", f("tiny.cover.npz"), "-o", f("tiny.tiles"), "--tiles", "4", "--reach", "1.5"],
        ["plan", f("tiny.map.bin"), "-o", f("image.plan.npz"), "--start", "0.5 1.5 1", "--goal", "3.5 1.5 1"],
        ["scale-align", f("tiny.scene.npz"), "-o", f("other.scene.npz"), "--scale", "1.01"],
        ["voxelize", f("other.scene.npz"), "-o", f("other.voxels.npz"), "--size", "0.2"],
        ["merge", f("other.voxels.npz"), "-o", f("other.cover.npz"), "--hulls", "12"],
    ):
        assert run([*words, "-q"]) == 0, words
    return made


def flown(folder, plan, map_name, *more):
    words = ["simulate", str(folder / plan), "--map", str(folder / map_name), "-q", "-f"]
    return run([*words, "-o", str(folder / "a.run.mcap"), "--set", "mission.allow_tight=true", *more])


@pytest.mark.parametrize(
    ("plan", "map_name"),
    [
        ("tiny.plan.npz", "tiny.cover.npz"),
        ("tiny.plan.npz", "tiny.tiles"),
        ("image.plan.npz", "tiny.cover.npz"),
    ],
)
def test_the_own_map_is_recognised_also_as_tiles_and_by_its_onboard_map(folder, plan, map_name, capsys):
    assert flown(folder, plan, map_name) == 0, capsys.readouterr().err
    assert not any("was made in" in note for note in read_run(folder / "a.run.mcap").summary.get("notes", []))


@pytest.mark.parametrize("map_name", ["coarse.cover.npz", "fewer.cover.npz", "tiny.metric.scene.npz"])
def test_maps_of_the_same_aligned_scene_are_flown_with_a_note(folder, map_name, capsys):
    assert flown(folder, "tiny.plan.npz", map_name) == 0, capsys.readouterr().err
    (note,) = [n for n in read_run(folder / "a.run.mcap").summary["notes"] if "was made in" in n]
    assert "tiny.plan.npz was made in tiny.cover.npz" in note
    assert "is of the same scene" in note


@pytest.mark.slow
def test_another_map_needs_insistence_in_simulate_fly_and_verify(folder, capsys):
    """The splat is the same, but not its metres: no hash shows that the plan fits."""
    plan, other, log = (str(folder / n) for n in ("tiny.plan.npz", "other.cover.npz", "b.run.mcap"))
    shows = "nothing shows that other.cover.npz"
    assert flown(folder, "tiny.plan.npz", "other.cover.npz") == 3
    err = capsys.readouterr().err
    assert shows in err
    assert err.count("\n") == 1
    assert "insist with --set mission.allow_other_map=true" in err
    assert flown(folder, "tiny.plan.npz", "other.cover.npz", "--set", "mission.allow_other_map=true") == 0
    assert any(shows in note for note in read_run(folder / "a.run.mcap").summary["notes"])
    fly = [
        "fly",
        plan,
        "--map",
        other,
        "--link",
        "sim:?start=0.5,1.5,0.8",
        "-o",
        log,
        "--dry-run",
        "-q",
        "--allow-tight",
    ]
    capsys.readouterr()
    assert run(fly) == 3
    assert "insist with --allow-other-map" in capsys.readouterr().err
    assert run([*fly, "--allow-other-map"]) == 0, capsys.readouterr().err
    capsys.readouterr()
    assert run(["verify", plan, "--map", other]) == 3
    assert shows in capsys.readouterr().err
    assert run(["verify", plan, "--map", other, "--allow-other-map", "-q"]) in (0, 4)
    assert run(["verify", plan, "--map", str(folder / "tiny.cover.npz"), "-q"]) == 0


def test_the_scene_of_a_plan_is_known_without_the_files_between(folder, tmp_path, capsys):
    """A plan records what its cover was made from; covers record it, too."""
    shutil.copy(folder / "tiny.plan.npz", tmp_path)
    for name, new in (("coarse.cover.npz", "a.cover.npz"), ("tiny.metric.scene.npz", "b.scene.npz")):
        shutil.copy(folder / name, tmp_path / new)
        assert flown(tmp_path, "tiny.plan.npz", new) == 0, capsys.readouterr().err
    shutil.copy(folder / "other.cover.npz", tmp_path)
    assert flown(tmp_path, "tiny.plan.npz", "other.cover.npz") == 3


@pytest.mark.slow
def test_fly_and_simulate_refuse_a_plan_that_leaves_the_mapped_box(folder, capsys):
    """The plan says itself how far; a map of another size does not have that space."""
    made, cover = str(folder / "above.plan.npz"), str(folder / "tiny.cover.npz")
    points = ["--start", "0.5 1.5 1", "--goal", "0.5 1.5 4", "--speed", "2"]
    assert run(["plan", cover, "-o", made, *points, "-q"]) == 5
    assert "the goal (0.5 1.5 4) is " in capsys.readouterr().err
    assert run(["plan", cover, "-o", made, *points, "-q", "--beyond-map", "3"]) == 0
    assert read_artifact(folder / "above.plan.npz").manifest.beyond_map_m == 3
    assert flown(folder, "above.plan.npz", "tiny.cover.npz") == 0
    low = str(folder / "low.cover.npz")
    for words in (
        [
            *("voxelize", str(folder / "tiny.metric.scene.npz"), "-o", str(folder / "low.voxels.npz")),
            *("--size", "0.2", "--crop", "-1", "-1", "-1", "5", "4", "0.3"),
        ],
        ["merge", str(folder / "low.voxels.npz"), "-o", low, "--hulls", "12"],
    ):
        assert run([*words, "-q"]) == 0, capsys.readouterr().err
    assert flown(folder, "above.plan.npz", "low.cover.npz") == 2
    err = capsys.readouterr().err
    assert "outside of the mapped box" in err
    assert "--set mission.beyond_map_m=" in err
    fly = ["fly", made, "--map", low, "--link", "sim:", "-o", str(folder / "c.run.mcap"), "--dry-run", "-q"]
    assert run(fly) == 4
    assert "outside of the mapped box" in capsys.readouterr().err
