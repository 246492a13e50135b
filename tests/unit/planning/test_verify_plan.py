"""Stored plans are proven again from their files; each kind of damage is found."""

import dataclasses

import numpy as np
import pytest

from alula.cli.main import run
from alula.schemas.artifact import Artifact, make_artifact, write_artifact
from alula.schemas.configs.plan import PlanConfig
from alula.schemas.errors import UsageError
from alula.schemas.kinds import PLAN
from alula.stages.planning.plan import plan
from alula.stages.planning.verify import verify_plan
from alula.stages.viewing.corridor import corridor_mesh
from support.covers import box_distance, boxes_cover

BOXES = [[10, 0, 0, 12, 14, 30], [18, 6, 0, 20, 30, 30]]
CONFIG = PlanConfig(
    start=(0.3, 0.3, 1.5), goal=(2.6, 2.5, 1.5), via=((1.5, 1.0, 1.4),), radius_m=0.2, speed_m_s=2.0
)


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
            *("parameters", "radius_m", "speed_m_s", "certificate", "margin_m", "via_m", "limits", "method"),
            *("vehicle", "summary", "guarantee"),
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
        ({"via_m": [[1.5, 1.0, 1.5]]}, {"start, vias, goal"}),
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
    older = altered(good, {"limits": {}}, **cells)
    certificate = verify_plan(older, cover=cover)
    assert certificate.covered
    assert [check.name for check in certificate.checks][0:2] == ["clearance from hulls", "limits"]
    assert certificate.notes == ["an older plan: its limit of speed and three derivatives are checked"]
    assert failed(altered(older, **scaled_time(1.2)), cover) == ["limits"]


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
        return run(["verify", str(path), *more])

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
