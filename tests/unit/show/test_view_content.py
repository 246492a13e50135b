"""Content of views: which parts, how many Gaussians, colours, names, and what is cut."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from alula.schemas.log.samples import Commands, Moving
from alula.schemas.parameters.configs.view import MOST_GAUSSIANS
from alula.stages.reporting.material import Run
from alula.stages.reporting.palette import COLORS
from alula.stages.rotation import matrix_from_quat_wxyz
from alula.stages.show.drawing.content import CUT, Body, Gaussians, Lines, rgb, tree_name
from alula.stages.show.drawing.sight import FIELD_RAD
from alula.stages.show.drawing.solids import edges, largest, solids_of_cover, voxel_surface
from alula.stages.show.drawing.splat import chosen, contribution, gaussians
from alula.stages.show.viewing.camera import fitted
from alula.stages.show.viewing.compose import Shown, content_of
from alula.stages.show.viewing.cut import find_cut
from alula.stages.show.viewing.flown import body_of, play_of, worst_first
from alula.stages.show.viewing.nearest import solid_obstacles, to_balls, to_faces, to_obstacles
from alula.stages.show.viewing.shapes import ball_mesh, disc_mesh, frame_mesh, rotors_of
from support.flights.viewed_runs import flight, run_of
from support.scenes.fabricate import (
    box,
    exact_hull,
    make_cover,
    make_plan,
    make_record,
    make_scene,
    make_trial,
    make_voxels,
)

BOXES = make_cover([box((0, 0, 0), (10, 10, 10)), box((20, 0, 0), (30, 5, 2))])


def named(content):
    return {part.name: part for part in content.parts}


def test_a_small_splat_is_shown_whole_with_its_own_covariances():
    scene = make_scene(300)
    content = content_of(Shown(title="t", scenes=[("s", scene)]))
    (part,) = content.parts
    assert (part.name, content.gaussians, content.notes) == ("Splat", 300, ())
    apart = np.linalg.norm(part.mean[:, None] - np.asarray(scene["mean"])[None], axis=2)
    order, own = apart.argmin(axis=1), np.arange(300)
    assert len(np.unique(order)) == 300
    half = matrix_from_quat_wxyz(scene["quat_wxyz"].astype(float)) * np.asarray(scene["scale"])[:, None]
    expected = half @ half.transpose(0, 2, 1)
    assert np.abs(part.mean[own] - np.asarray(scene["mean"])[order]).max() < 1e-3
    assert np.allclose(part.covariance[own], expected[order], rtol=1e-4, atol=1e-9)
    assert (part.color[own] == scene["color"][order]).all()


def test_gaussians_are_chosen_by_contribution_and_grow_for_those_left_out():
    scene = make_scene(2000)
    choice = chosen(scene, 500)
    weight = contribution(scene)
    assert len(np.unique(choice.row)) == len(choice.row)
    assert 495 <= len(choice.row) <= 500
    top = np.argsort(-weight)[:50]
    assert np.isin(top, choice.row).mean() > 0.6
    assert weight[choice.row].mean() > 1.3 * weight.mean()
    assert (choice.grown >= 1).all()
    assert choice.grown.max() > 1.5
    shown = gaussians("s", scene, choice)
    least = np.linalg.eigvalsh(shown.covariance.astype(float))[:, 0]
    own = np.asarray(scene["scale"], float)[choice.row].min(axis=1) ** 2
    assert np.allclose(least, own, rtol=1e-3)  # the shortest axis does not grow


def test_the_number_of_gaussians_is_bounded_over_all_scenes_and_said():
    scenes = [("a", make_scene(400)), ("b", make_scene(800, seed=5))]
    content = content_of(Shown(title="t", scenes=scenes), most_gaussians=300)
    assert {part.name for part in content.parts} == {"Splat a", "Splat b"}
    assert 290 <= content.gaussians <= 300
    assert len(content.notes) == 2
    assert content.notes[0].startswith("Splat a: 100 of 400 Gaussians")
    assert MOST_GAUSSIANS == 200_000


def test_hulls_have_translucent_faces_and_only_their_own_edges():
    parts = named(content_of(Shown(title="t", covers=[("c", BOXES)])))
    assert parts["Hulls/faces"].opacity < 0.5
    assert len(parts["Hulls/edges"].segments) == 24  # of two boxes: no diagonals
    assert len(parts["Hulls/faces"].triangles) == 24
    assert not parts["Hulls/faces"].far_only
    both = named(content_of(Shown(title="t", covers=[("c", BOXES)], scenes=[("s", make_scene(20))])))
    assert both["Hulls/faces"].far_only  # near sides would hide the Gaussians inside


def test_the_smallest_hulls_are_left_out_when_there_are_too_many():
    small = exact_hull([(40, 0, 0), (41, 0, 0), (40, 1, 0), (40, 0, 1)])
    solids = solids_of_cover(make_cover([small, box((0, 0, 0), (10, 10, 10))]))
    assert largest(solids).tolist() == [True, True]
    keep = largest(solids, maximum=12)
    assert keep.tolist() == [False, True]
    corners, triangles = solids.of(keep)
    assert (len(corners), len(triangles), triangles.max()) == (8, 12, 7)
    assert corners.max() == pytest.approx(0.5)


def test_voxels_show_their_outer_faces_and_join_when_there_are_too_many():
    index = np.array([(x, y, z) for x in range(4) for y in range(4) for z in range(4)])
    corners, triangles, step = voxel_surface(index, 0.5)
    assert (len(triangles), step, corners.max()) == (2 * 6 * 16, 1, 2.0)
    assert len(edges(corners, triangles)) < 200
    corners, triangles, step = voxel_surface(index, 0.5, maximum=60)
    assert (len(triangles), step, corners.max()) == (2 * 6 * 4, 2, 2.0)
    a, b, c = (corners[triangles[:, i]] for i in range(3))
    outward = (np.cross(b - a, c - a) * ((a + b + c) / 3 - corners.mean(axis=0))).sum(axis=1)
    assert (outward > 0).all()


def test_a_plan_has_curve_start_and_goal():
    parts = named(content_of(Shown(title="t", plans=[("p", make_plan())])))
    assert set(parts) == {"Plan/curve", "Plan/start", "Plan/goal"}
    assert parts["Plan/goal"].position[0] == pytest.approx((3, 0, 1))


def test_flights_are_named_and_coloured_by_outcome_and_by_run():
    trials = [make_trial(0), make_trial(1, "stuck"), make_trial(2, clearance=-0.1, collision=True)]
    runs = [run_of(trials), run_of(trials[:1], "b/c")]
    content = content_of(Shown(title="t", runs=runs))
    parts = named(content)
    assert parts["Flights/reached (2)/paths"].color == rgb(COLORS["reached"])
    assert parts["Flights/collision (1)/paths"].color == rgb(COLORS["collision"])
    assert content.legend == {name: COLORS[name] for name in ("reached", "stuck", "collision")}
    by_run = [part for name, part in parts.items() if name.startswith("Flights by run/")]
    assert [part.name for part in by_run] == ["Flights by run/a", "Flights by run/b∕c"]
    assert not any(part.visible for part in by_run)
    assert by_run[0].color != by_run[1].color
    assert len(parts["Contacts"].position) == 1
    assert "Flights by run/a" not in named(content_of(Shown(title="t", runs=runs[:1])))


def test_the_worst_flights_are_played_first_and_only_so_many():
    trials = [make_trial(0), make_trial(1, "stuck"), make_trial(2, clearance=-0.1, collision=True)]
    trials.append(make_trial(3, clearance=0.01))
    runs = [run_of(trials)]
    assert worst_first(runs) == [(0, 2), (0, 1), (0, 3), (0, 0)]
    plays = content_of(Shown(title="t", runs=runs), most_played_s=11.0).plays
    assert [play.outcome for play in plays] == ["collision", "stuck"]
    assert "overlapping by 10.0 cm" in plays[0].words
    (only,) = content_of(Shown(title="t", runs=runs), flights={(0, 0)}).plays
    assert (only.label, only.outcome) == ("flight 0", "reached")


def test_a_played_flight_begins_at_zero_and_knows_what_is_nearest():
    moving = Moving(np.full((51, 1, 3), (2.0, 1.0, 1.0)), np.full((51, 1, 3), np.nan), np.array([0.25]))
    run = run_of([make_trial(0)], start=7.0, moving=moving)
    tree = solid_obstacles(solids_of_cover(make_cover([box((40, 20, 0), (60, 30, 40))])))  # 2..3, 1..1.5
    play = play_of(run, 0, {"hulls": tree}, several=False)
    assert (play.time_s[0], play.time_s[-1]) == pytest.approx((0, 5))
    radius = play.body.radius_m
    curves = {one.label: one for one in play.series}
    assert set(curves) >= {"speed", "hulls", "moving obstacles"}
    row = int(np.abs(play.time_s - 2.0).argmin())
    assert curves["hulls"].value[row] == pytest.approx(1.0 - radius, abs=1e-6)
    assert curves["moving obstacles"].value[row] == pytest.approx(0.75 - radius)
    assert play.nearest_world[row] == pytest.approx((2, 0.75, 1), abs=1e-4)
    assert play.nearest_world[-1] == pytest.approx((3, 1, 1), abs=1e-3)  # an edge of the box
    assert play.marked_s == pytest.approx(2.0)


def test_a_log_with_a_gap_of_years_is_played_by_its_samples():
    run = run_of([make_trial(0)])
    long = np.concatenate([run.flights[0].time_s[:-1], [2e9]])
    play = play_of(replace(run, flights={0: replace(run.flights[0], time_s=long)}), 0, {}, several=False)
    assert play.time_s[-1] == 2e9
    assert len(play.time_s) <= 51


def test_a_filter_of_several_acts_and_the_command_has_its_limit():
    m = 51
    nominal, sent = np.tile((1.0, 0, 0), (m, 1)), np.tile((0.5, 0, 0), (m, 1))
    each = {"a": ("ok",) * m, "b": ("ok",) * 30 + ("filtered",) * 21}
    commands = Commands(nominal, sent, "velocity [m/s]")
    run = run_of([make_trial(0)], commands=commands, each_status=each)
    parameters = {"vehicle": {"v_max_m_s": 1.5, "radius_m": 0.1}}
    made = msgspec.structs.replace(run.record.provenance, parameters=parameters)
    run = replace(run, record=msgspec.structs.replace(run.record, provenance=made))
    play = play_of(run, 0, {}, several=False)
    assert not play.acts[play.time_s < 2.9].any()
    assert play.acts[play.time_s > 3.1].all()
    assert play.status[-1] == "a ok, b filtered"
    curves = {one.label: one for one in play.series}
    assert curves["nominal"].plot == curves["sent"].plot == "command: velocity [m/s]"
    assert (curves["nominal"].value[0], curves["sent"].value[0], curves["sent"].limit) == (1.0, 0.5, 1.5)


def test_distances_to_solids_balls_and_faces_agree_with_closed_forms():
    points = np.array([[-1.0, 0.25, 0.25], [0.25, 0.25, 0.6]])
    tree = solid_obstacles(solids_of_cover(make_cover([box((0, 0, 0), (10, 10, 10))])))
    distance, nearest = to_obstacles(points, tree)
    assert distance == pytest.approx((1.0, 0.1))
    assert nearest[0] == pytest.approx((0, 0.25, 0.25), abs=1e-6)
    assert nearest[1] == pytest.approx((0.25, 0.25, 0.5), abs=1e-6)
    distance, nearest = to_faces(points, np.array([[1.0, 0, 0, 2.0], [0, 0, 1.0, 0.5]]))
    assert distance == pytest.approx((0.25, -0.1))
    assert nearest[1] == pytest.approx((0.25, 0.25, 0.5))
    distance, nearest = to_balls(points, np.array([[[0, 0.25, 0.25]], [[np.nan] * 3]]), np.array([0.5]))
    assert distance[0] == pytest.approx(0.5)
    assert nearest[0] == pytest.approx((-0.5, 0.25, 0.25))
    assert np.isnan(nearest[1]).all()


def room(roof):
    """Points of four walls and a floor, 4 by 4 by 2 m, and of a ceiling."""
    side = np.linspace(0, 4, 21)
    x, y = (axis.ravel() for axis in np.meshgrid(side, side))
    up = x / 2
    walls = [np.column_stack(columns) for columns in ((x, 0 * x, y / 2), (x, 0 * x + 4, y / 2))]
    walls += [np.column_stack(columns) for columns in ((0 * x, x, y / 2), (0 * x + 4, x, y / 2))]
    flat = [np.column_stack((x, y, 0 * up))] + ([np.column_stack((x, y, 0 * up + 2))] if roof else [])
    return np.concatenate([*walls, *flat])


@pytest.mark.parametrize("flown", [np.empty((0, 3)), np.array([[1.0, 1, 1], [3, 3, 1.2]])])
def test_ceiling_and_near_walls_are_apart_and_hidden_only_in_a_closed_space(flown):
    solid = room(roof=True)
    cut = find_cut(solid, flown)
    gone = cut.removes(solid, solid)
    assert gone[solid[:, 2] == 2].all()
    inner = (solid[:, 2] > 0.3) & (solid[:, 2] < 1)
    assert gone[inner & (solid[:, 1] == 0)].all()
    assert not gone[inner & (solid[:, 1] == 4) & (solid[:, 0] > 1)].any()
    assert not gone[solid[:, 2] == 0].any()
    assert find_cut(room(roof=False), flown) is None


def test_what_is_cut_has_a_node_of_its_own():
    hulls = [box((0, 0, 0), (80, 80, 1)), box((0, 0, 40), (80, 80, 41)), box((0, 0, 0), (80, 1, 40))]
    runs = [Run("a", make_record([make_trial(0)]), {0: flight()})]
    inside = replace(runs[0].flights[0], position_world=np.array([[1.0, 1, 1]] * 51))
    runs = [replace(runs[0], flights={0: inside})]
    content = content_of(Shown(title="t", covers=[("c", make_cover(hulls))], runs=runs))
    parts = named(content)
    assert len(parts[f"{CUT}/Hulls/faces"].triangles) == 24
    assert len(parts["Hulls/faces"].triangles) == 12
    assert "hidden at first" in content.notes[-1]


@pytest.mark.parametrize("up", ["+z", "-y"])
def test_the_first_camera_sees_all_of_a_flight_in_a_large_world(up):
    flown = np.random.default_rng(1).uniform(-2, 2, (50, 3))
    solid = np.random.default_rng(2).uniform(-125, 125, (5000, 3))
    camera = fitted(solid, flown, up)
    ahead = camera.look_at - camera.position
    assert np.linalg.norm(ahead) < 12  # not of the 250 m around it
    assert camera.far_m > 250
    towards = flown - camera.position
    cosine = towards @ ahead / np.linalg.norm(towards, axis=1) / np.linalg.norm(ahead)
    assert np.arccos(cosine).max() < 0.75 * FIELD_RAD
    assert fitted(solid, np.empty((0, 3))).far_m > 250


def test_a_vehicle_has_its_true_size_and_rotors():
    body = Body(
        radius_m=0.3, rotors_m=np.array([[0.2, 0.2, 0], [-0.2, 0.2, 0], [-0.2, -0.2, 0], [0.2, -0.2, 0]])
    )
    corners, _ = frame_mesh(body)
    assert np.linalg.norm(corners[:, :2], axis=1).max() == pytest.approx(0.2 * 2**0.5, rel=0.05)
    discs, triangles = disc_mesh(body)
    assert len(triangles) == 4 * 16
    assert np.abs(discs[:, :2]).max() == pytest.approx(0.2 + 0.45 * 0.4, rel=0.01)
    assert np.linalg.norm(rotors_of(Body(radius_m=0.1)), axis=1).max() < 0.1
    ball, _ = ball_mesh()
    assert np.linalg.norm(ball, axis=1) == pytest.approx(1)
    parameters = {"vehicle": {"body": {"radius_m": 0.2}, "rotors": {"positions_m": [[0.1, 0.1]]}}}
    record = make_record([make_trial(0)])
    made = msgspec.structs.replace(record.provenance, parameters=parameters)
    found = body_of(Run("a", msgspec.structs.replace(record, provenance=made)))
    assert (found.radius_m, found.rotors_m.tolist()) == (0.2, [[0.1, 0.1, 0.0]])


def test_names_of_the_tree_have_no_slash_and_differ():
    assert tree_name("a/b\n c") == "a∕b c"
    parts = content_of(Shown(title="t", voxels=[("v", make_voxels()), ("v", make_voxels())])).parts
    assert len({part.name for part in parts}) == len(parts)
    assert all(not isinstance(part, Gaussians) for part in parts)
    assert any(isinstance(part, Lines) for part in parts)
