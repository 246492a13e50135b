"""Stored plans are proven again from their files; each kind of damage is found."""

import dataclasses

import msgspec
import numpy as np
import pytest

from alula.cli.main import run
from alula.schemas.artifacts.artifact import Artifact, make_artifact, write_artifact
from alula.schemas.artifacts.kinds import PLAN
from alula.schemas.artifacts.manifest import PlanPass
from alula.schemas.errors import UsageError
from alula.schemas.parameters.configs.plan import PlanConfig
from alula.stages.planning.plan import plan
from alula.stages.planning.verify import verify_plan
from alula.stages.show.viewing.corridor import corridor_mesh
from support.scenes.covers import box_distance, boxes_cover
from support.scenes.small_scenes import ball_scene

BOXES = [[10, 0, 0, 12, 14, 30], [18, 6, 0, 20, 30, 30]]
CONFIG = PlanConfig(
    beyond_map_m=3.0,
    start=(0.3, 0.3, 1.5),
    goal=(2.6, 2.5, 1.5),
    via=((1.5, 1.0, 1.4),),
    radius_m=0.2,
    speed_m_s=2.0,
)
ELSEWHERE = PlanPass(kind="waypoint", number=1, time_s=1.0, point_m=(1.5, 1.0, 1.5))


@pytest.fixture(scope="module")
def cover():
    return boxes_cover(BOXES)


@pytest.fixture(scope="module")
def good(cover):
    return plan(CONFIG, cover)


def altered(made: Artifact, manifest=None, **arrays) -> Artifact:
    """The plan with other arrays and fields."""
    changed = {name: np.array(array) for name, array in made.arrays.items()}
    for name, change in arrays.items():
        if change is None:
            del changed[name]
        else:
            change(changed[name])
    fields = {
        name: getattr(made.manifest, name)
        for name in (
            *("parameters", "radius_m", "speed_m_s", "certificate", "margin_m", "via_m", "passes", "limits"),
            *("method", "vehicle", "summary", "guarantee"),
        )
    }
    return make_artifact(PLAN, changed, frame=made.manifest.frame, unit="m", **(fields | (manifest or {})))


def failed(made, cover):
    return [check.name for check in verify_plan(made, cover=cover).checks if not check.ok]


def test_a_plan_is_proven_with_its_corridor_and_all_limits(good, cover):
    certificate = verify_plan(good, cover=cover)
    assert certificate.covered
    assert certificate.notes == []
    assert [check.name for check in certificate.checks] == [
        "clearance from hulls",
        "cells and hulls",
        "pieces in cells",
        "limits",
        "continuity",
        "start, vias, goal",
    ]
    assert all(check.checked > 0 for check in certificate.checks)
    pieces = len(good["time"]) - 1
    limits = next(check for check in certificate.checks if check.name == "limits")
    assert limits.checked == 7 * pieces == 7 * len(good.manifest.limits) / 8 * pieces


def scaled_time(factor):
    """Everything `factor` times as fast."""

    def time(array):
        array /= factor

    def coefficient(array):
        array[:, :3] *= factor ** np.arange(8)

    return {"time": time, "coefficient": coefficient}


def bump(piece, order, by):
    def change(array):
        array[piece, 0, order] += by

    return change


def moved_plane(array):
    array[6:] += 0.1


def moved_box(array):
    array[0] -= 2.0


@pytest.mark.parametrize(
    ("change", "found"),
    [
        (scaled_time(1.03), {"limits"}),
        ({"coefficient": bump(3, 0, 1e-3)}, {"continuity"}),
        ({"coefficient": bump(3, 4, 5.0)}, {"continuity"}),
        ({"cell_offset": moved_plane}, {"cells and hulls"}),
        ({"cell_offset": moved_box}, {"pieces in cells"}),
        ({"piece_cell": lambda array: array.__setitem__(0, array[-1])}, {"pieces in cells"}),
        ({"piece_cell": lambda array: array.__setitem__(0, 99)}, {"pieces in cells"}),
    ],
)
def test_damage_of_a_plan_is_found(good, cover, change, found):
    assert found <= set(failed(altered(good, **change), cover))


@pytest.mark.parametrize(
    ("fields", "found"),
    [
        ({"radius_m": 0.3}, {"clearance from hulls", "cells and hulls"}),
        ({"passes": [ELSEWHERE]}, {"start, vias, goal"}),
        ({"parameters": {"goal": [2.6, 2.5, 1.6]}}, {"start, vias, goal"}),
        ({"parameters": {"start": [2.6, 2.5, 1.5]}}, {"start, vias, goal"}),
        ({"limits": {"jerk_m_s3": 1.0}}, {"limits"}),
        ({"limits": {"speed_m_s": -9.0}}, {"limits"}),
        ({"limits": {"tilt_rad": 2.0}}, {"limits"}),
        ({"parameters": {"goal": "there"}}, {"start, vias, goal"}),
        ({"limits": {"tilt_rad": 0.01, "gravity_m_s2": 9.81}}, {"limits"}),
        ({"limits": {"least_thrust_m_s2": 9.8, "gravity_m_s2": 9.81}}, {"limits"}),
        ({"limits": {"most_thrust_m_s2": 9.82, "gravity_m_s2": 9.81}}, {"limits"}),
    ],
)
def test_claims_that_do_not_hold_are_found(good, cover, fields, found):
    assert set(failed(altered(good, fields), cover)) == found


def test_a_hull_in_the_way_is_found(good):
    middle = np.asarray(good["coefficient"])[len(good["time"]) // 2, :3, 0]
    low = np.floor(10 * middle).astype(int) - 1
    blocked = boxes_cover([*BOXES, [*low, *(low + 2)]])
    assert {"clearance from hulls", "cells and hulls"} <= set(failed(good, blocked))


def test_a_plan_without_corridor_or_limits_is_proven_as_far_as_it_goes(good, cover):
    cells = dict.fromkeys(("cell_normal", "cell_offset", "cell_start", "piece_cell"))
    bare = altered(good, {"limits": {}}, **cells)
    certificate = verify_plan(bare, cover=cover)
    assert certificate.covered
    assert [check.name for check in certificate.checks][0:2] == ["clearance from hulls", "limits"]
    assert failed(altered(bare, **scaled_time(1.2)), cover) == ["limits", "start, vias, goal"]


def test_a_plan_in_another_frame_is_refused(good, cover):
    other = make_artifact(
        PLAN,
        dict(good.arrays),
        frame="elsewhere",
        unit="m",
        radius_m=0.2,
        speed_m_s=1.0,
        certificate={},
        parameters={},
        summary={},
    )
    with pytest.raises(UsageError, match="the cover is in the frame"):
        verify_plan(other, cover=cover)


def test_with_smoothing_a_plan_takes_longer_with_less_snap_and_is_proven(good, cover):
    smooth = plan(dataclasses.replace(CONFIG, smooth=1.25), cover)
    assert verify_plan(smooth, cover=cover).covered
    assert smooth["time"][-1] == pytest.approx(1.25 * good["time"][-1], rel=1e-6)


def test_the_view_shows_the_cells_that_pieces_lie_in(good):
    corner, triangle = corridor_mesh(good)
    assert len(triangle) >= 4 * len(np.unique(good["piece_cell"]))
    clear = box_distance(corner, BOXES)
    assert clear.min() >= 0.2 - 1e-9
    assert len(corridor_mesh(altered(good, piece_cell=lambda array: array.fill(-1)))[1]) == 0


def test_the_command_proves_a_plan_and_exits_with_4_where_it_is_damaged(good, cover, tmp_path, capsys):
    def verify(made, *more):
        path = tmp_path / "a.plan.npz"
        write_artifact(path, made)
        return run(["verify", str(path), "--allow-other-map", *more])

    map_path = tmp_path / "a.cover.npz"
    write_artifact(map_path, cover)
    assert verify(good, "--map", str(map_path)) == 0
    assert "proven: every point of the plan is at least 0.2 m from every hull" in capsys.readouterr().out
    assert verify(altered(good, {"radius_m": 0.3}), "--map", str(map_path)) == 4
    captured = capsys.readouterr()
    assert "clearance from hulls: piece" in captured.err
    assert captured.err.count("\n") == 1
    assert verify(good) == 2
    assert "a plan is proven against the map of --map" in capsys.readouterr().err


AT_ONE = "every ellipsoid of the scene at 1 sigma (19.8 % of a Gaussian's mass)"


def test_verdict_and_guarantee_name_the_level_of_the_hulls_and_what_it_leaves_out(good, cover):
    certificate = verify_plan(good, cover=cover)
    distance = "every point of the plan is at least 0.2 m from every hull of the cover"
    assert certificate.statement == f"proven: {distance}, made for {AT_ONE}"
    assert (certificate.level["sigma"], certificate.level["min_overlap"]) == (1.0, 1)
    assert certificate.level["mass_fraction"] == pytest.approx(0.1987, abs=1e-4)
    assert certificate.omits == []
    assert "beyond 1 sigma (80.2 % of its mass)" in certificate.left_out
    assert f"made for {AT_ONE}" in good.manifest.guarantee.statement
    fields = {"sigma": 0.5, "min_overlap": 3, "min_opacity": 0.2}
    less = dataclasses.replace(cover, manifest=msgspec.structs.replace(cover.manifest, **fields))
    certificate = verify_plan(good, cover=less)
    left_out = ["voxels that fewer than 3 ellipsoids touch", "Gaussians of opacity below 0.2"]
    assert "made for every retained ellipsoid of the scene at 0.5 sigma (3.0" in certificate.statement
    assert certificate.statement.endswith("; not included: " + ", ".join(left_out))
    assert certificate.omits == left_out
    assert (certificate.level["sigma"], certificate.level["min_opacity"]) == (0.5, 0.2)
    made = plan(CONFIG, less)
    assert made.manifest.guarantee.statement.partition(" Space up to")[0].endswith(
        "; not included: " + ", ".join(left_out) + "."
    )
    (facts,) = made.manifest.maps
    assert (facts["level"]["sigma"], facts["level"]["min_overlap"]) == (0.5, 3)


def test_verdict_and_guarantee_name_the_level_of_the_ellipsoids(cover):
    ball = ball_scene([(1.0, 1.6, 1.5)], 0.5)
    for sigma, mass in ((1.0, "19.8"), (0.05, "0.003")):
        made = plan(dataclasses.replace(CONFIG, via=(), sigma=sigma), scene=ball)
        certificate = verify_plan(made, scene=ball)
        words = f"every ellipsoid of the scene at {sigma:g} sigma ({mass}"
        assert words in certificate.statement
        assert words in made.manifest.guarantee.statement
        assert certificate.level["sigma"] == sigma
        assert made.manifest.maps[0]["level"]["sigma"] == sigma
    both = plan(dataclasses.replace(CONFIG, via=(), sigma=0.7), cover, scene=ball)
    certificate = verify_plan(both, cover=cover, scene=ball)
    assert certificate.covered
    assert (certificate.level["sigma"], certificate.level["scene"]["sigma"]) == (1.0, 0.7)
    assert "at 1 sigma" in certificate.statement
    assert "at 0.7 sigma" in certificate.statement


def test_the_start_that_snap_moved_is_noted_and_one_that_is_elsewhere_is_not_passed(cover):
    snap = dataclasses.replace(CONFIG, start=(1.1, 0.3, 1.5), via=(), nearest_free=True)
    made = plan(snap, cover)
    certificate = verify_plan(made, cover=cover)
    assert certificate.covered
    assert any("the start of the plan is 0." in note for note in certificate.notes)
    parameters = made.manifest.parameters | {"nearest_free": False}
    assert failed(altered(made, {"parameters": parameters}), cover) == ["start, vias, goal"]


def test_a_speed_that_the_limits_do_not_name_is_checked(good, cover):
    limits = {name: value for name, value in good.manifest.limits.items() if name != "speed_m_s"}
    assert failed(altered(good, {"limits": limits, "speed_m_s": 1.0}), cover) == ["limits"]
