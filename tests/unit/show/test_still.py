"""The still picture: what is left out of it so that one sees inside, and the colours of paths."""

import numpy as np

from alula.schemas.log.flights import Flight
from alula.stages.reporting.fenced import FenceShape
from alula.stages.reporting.material import Material, Run
from alula.stages.reporting.palette import BLUE, ORANGE, VERMILLION, run_color, themed
from alula.stages.show.still import faces_near, still
from support.scenes.fabricate import box, make_cover, make_plan, make_record, make_scene, make_trial

FLOOR, CEILING = box((0, 0, 0), (100, 100, 1)), box((0, 0, 59), (100, 100, 60))
FAR, NEAR = box((0, 0, 1), (1, 100, 59)), box((99, 0, 1), (100, 100, 59))


def flown(label, outcomes, clearance=0.2):
    trials = [make_trial(i, outcome, clearance) for i, outcome in enumerate(outcomes)]
    time = np.linspace(0, 3, 20)
    paths = {}
    for i in range(len(trials)):
        place = np.column_stack([1 + time, np.full(20, 1.0 + i), np.full(20, 1.0)])
        paths[i] = Flight(time, place, np.ones(20), time[:0], time[:0], "m", ())
    return Run(label, make_record(trials), paths)


def test_ceiling_and_the_wall_before_the_viewer_are_left_out():
    picture = still(Material("t", (flown("a", ["reached"]),), cover=make_cover([FLOOR, CEILING, FAR, NEAR])))
    assert "2 of 4 hulls" in picture.alt
    assert "1 flown path." in picture.alt
    assert "Ceiling and near walls are left out." in picture.alt


def test_a_splat_is_drawn_below_what_is_left_out():
    picture = still(Material("t", scene=make_scene(300)))
    count = int(picture.alt.split(": ")[1].split()[0])
    assert 100 < count < 300
    assert "data:image/png;base64" in picture.svg
    assert "Circles" not in picture.alt


def test_paths_have_the_colours_of_outcomes_and_of_several_runs_those_of_the_runs():
    one = flown("a", ["reached", "stuck"])
    picture = still(Material("t", (one,)))
    assert BLUE in picture.svg
    assert ORANGE in picture.svg
    both = still(Material("t", (one, flown("b", ["reached"], -0.1))))
    assert run_color(0) in both.svg
    assert run_color(1) in both.svg
    assert VERMILLION not in both.svg
    assert "a (2)" in both.svg
    assert VERMILLION in still(Material("t", (flown("b", ["reached"], -0.1),))).svg


def test_a_wide_fence_is_cut_to_the_flights():
    """A wall of 200 m and a flight of 5 m towards it: what is shown of the wall is about as large."""
    corners = np.array([[6, -100, -100], [6, 100, -100], [6, 100, 100], [6, -100, 100]], np.float64)
    shape = FenceShape(corners, np.array([[0, 1, 2], [0, 2, 3]]))
    path = np.column_stack([np.linspace(1, 5.9, 30), np.zeros(30), np.ones(30)])
    ((face, normal),) = faces_near(shape, [path])
    assert len(face) == 4
    np.testing.assert_allclose(normal, [1, 0, 0])
    np.testing.assert_allclose([face.min(axis=0), face.max(axis=0)], [[6, -1, 0], [6, 1, 2]])
    sides = np.linalg.norm(face - np.roll(face, 1, axis=0), axis=1)
    np.testing.assert_allclose(sides, 2)  # around it, not across
    assert faces_near(shape, [path - [50, 0, 0]]) == []  # too far to see


def test_a_plan_alone_is_drawn_and_nothing_is_not():
    assert still(Material("t", plan=make_plan())).alt.startswith("Seen from above at an angle: the plan.")
    assert still(Material("t", (Run("a", make_record([make_trial(0)])),))) is None
    assert still(Material("t")) is None


def test_only_colours_of_a_style_are_those_of_the_page():
    svg = f'<path style="fill: {BLUE}; stroke: #abcdef"/><text>{BLUE}</text>'
    assert themed(svg) == f'<path style="fill: var(--c0072b2); stroke: #abcdef"/><text>{BLUE}</text>'
