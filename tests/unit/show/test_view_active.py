"""What a played flight shows of its filter and its plans: deciding obstacles, gates, new plans."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from alula.schemas.artifacts.manifest import PlanPass
from alula.schemas.log.flights import Course, NewPlan
from alula.stages import clearance
from alula.stages.reporting.material import Run
from alula.stages.rotation import matrix_from_quat_wxyz
from alula.stages.show.viewing.compose import Shown, content_of
from alula.stages.show.viewing.draw import record
from alula.stages.show.viewing.page import recording
from support.flights.viewed_runs import flight, run_of
from support.scenes.fabricate import box, make_cover, make_plan, make_record, make_scene, make_trial

BOXES = make_cover([box((0, 0, 0), (10, 10, 10)), box((20, 0, 0), (30, 5, 2))])
N = 51


def run(filters, active, status, **fields):
    flown = flight(active=active, **fields)
    flown = replace(flown, status=status)
    return Run("a", make_record([make_trial(0)], filter_name=filters), {0: flown})


def decides(run, **shown):
    (play,) = content_of(Shown(title="t", runs=[run], **shown)).plays
    return {one.name: one for one in play.decides}


def test_a_hull_decides_while_the_filter_changes_the_command():
    number = np.r_[np.full(20, 1), np.zeros(31, int)]
    status = ("ok",) * 10 + ("filtered",) * 15 + ("ok",) * 26
    found = decides(run("polytope-cbf", {"": number}, status), covers=[("c", BOXES)])
    assert np.flatnonzero(found["hull 1"].rows).tolist() == list(range(10, 20))
    assert np.flatnonzero(found["hull 0"].rows).tolist() == list(range(20, 25))
    assert found["hull 1"].corners.min(axis=0) == pytest.approx((1.0, 0, 0), abs=0.01)
    assert found["hull 1"].corners.max(axis=0) == pytest.approx((1.5, 0.25, 0.1), abs=0.01)


def test_numbers_count_ellipsoids_before_hulls_and_of_moving_obstacles_none():
    scene = make_scene(40)
    number = np.r_[np.full(20, 7), np.full(31, 41)]
    run_ = run("ellipsoid-cbf", {"": number}, ("filtered",) * N)
    found = decides(run_, covers=[("c", BOXES)], scenes=[("s", scene)])
    assert set(found) == {"ellipsoid 7", "hull 1"}
    turn = matrix_from_quat_wxyz(np.asarray(scene["quat_wxyz"], float)[7:8])[0]
    local = (found["ellipsoid 7"].corners - np.asarray(scene["mean"])[7]) @ turn
    assert np.linalg.norm(local / np.asarray(scene["scale"])[7], axis=1) == pytest.approx(1.02, abs=1e-5)
    assert decides(run("dr-acbf", {"": number}, ("filtered",) * N), covers=[("c", BOXES)]) == {}
    unknown = decides(run("ellipsoid-cbf", {"": number}, ("filtered",) * N), covers=[("c", BOXES)])
    assert unknown == {}  # without the scene nobody knows how many ellipsoids come first


def test_each_filter_of_several_has_its_own_obstacle():
    each = {"polytope-cbf": ("filtered",) * N, "dr-acbf": ("ok",) * N}
    active = {"polytope-cbf": np.zeros(N, int), "dr-acbf": np.ones(N, int)}
    found = decides(
        run("polytope-cbf, dr-acbf", active, ("ok",) * N, each_status=each), covers=[("c", BOXES)]
    )
    assert set(found) == {"hull 0"}


def test_gates_of_all_laps_are_drawn_once_with_their_direction():
    plan = make_plan()
    gate = {
        "kind": "gate",
        "number": 1,
        "time_s": 1.0,
        "point_m": [1.0, 0, 1],
        "normal": [1.0, 0, 0],
        "radius_m": 0.5,
    }
    passes = [PlanPass(**gate), PlanPass(**gate | {"lap": 2, "time_s": 2.0})]
    plan = replace(plan, manifest=msgspec.structs.replace(plan.manifest, passes=passes))
    (gates,) = [p for p in content_of(Shown(title="t", plans=[("p", plan)])).parts if p.name == "Plan/gates"]
    hoop, arrow = gates.segments[:32], gates.segments[32:]
    assert np.linalg.norm(hoop - (1.0, 0, 1), axis=2) == pytest.approx(0.5)
    assert hoop[..., 0] == pytest.approx(1.0)
    assert arrow.shape == (3, 2, 3)
    assert (arrow[:, 1, 0] > 1.2).all()


def test_a_new_plan_appears_when_the_flight_joins_it():
    points = np.array([(2.0, 0, 1), (3, 1, 1), (5, 0, 1)])
    plans = (NewPlan(2.0, points), NewPlan(99.0, points))  # the second joined after the log's end
    run_ = replace(run_of([make_trial(0)]), course=Course((), (), 5.0, plans))
    (play,) = content_of(Shown(title="t", runs=[run_])).plays
    ((time, drawn),) = play.plans
    assert (time, drawn.tolist()) == (2.0, points.tolist())
    with recording() as server:
        seen = []

        def sleep(_):
            node = server.scene._handle_from_node_name["/Playback/1. flight 0: reached/new plan 1"]
            seen.append(node.visible)

        record(server, [play], sleep)
    assert seen.index(True) == pytest.approx(N * 2 / 5, abs=1)
    assert not any(seen[: seen.index(True)])
    assert all(seen[seen.index(True) :])


def test_runs_in_one_scene_share_its_search_tree_also_when_the_view_is_made_again(monkeypatch):
    made = []
    tree_of = clearance.scene_obstacles
    monkeypatch.setattr(clearance, "scene_obstacles", lambda *given: made.append(given[1]) or tree_of(*given))
    each = []
    for label in "ab":
        record = make_record([make_trial(0)], summary={"sigma": 1.0})
        each.append(Run(label, record, {0: flight()}))
    shown = Shown(title="t", runs=each, scenes=[("s", make_scene(30))])
    for _ in range(2):
        plays = content_of(shown).plays
        assert [np.isfinite(play.nearest_world).all() for play in plays] == [True, True]
    assert made == [1.0]
