"""Random start-goal pairs: clear, apart, uniform and counted; the box that they are drawn in."""

import numpy as np
import pytest

from alula.stages.compression.hulls import Hulls
from alula.stages.simulation.pairs import central_box, sample_pairs
from support.scenes.small_scenes import box_cover


def test_pairs_are_clear_apart_uniform_and_counted():
    def psi(points):
        return np.abs(points[:, 0] - 0.5) - 0.1  # a slab in the middle

    pairs = sample_pairs(400, 7, (np.zeros(3), np.ones(3)), 0.5, psi, lambda points, hard: hard >= 0.05)
    assert (np.linalg.norm(pairs.goal - pairs.start, axis=1) >= 0.5).all()
    for points in (pairs.start, pairs.goal):
        assert (psi(points) >= 0.05).all()
        assert ((points >= 0) & (points <= 1)).all()
    assert abs(pairs.start[:, 1].mean() - 0.5) < 0.06  # 4 standard errors
    share = pairs.sampled_inside_hulls / pairs.sampled
    assert share == pytest.approx(0.2, abs=0.05)


def test_pairs_are_the_same_whether_few_or_all_points_are_asked_for():
    asked = []

    def psi(points):
        return np.abs(points[:, 0] - 0.5) - 0.1

    def is_inside(points):
        asked.append(len(points))
        return points[:, 1] > 0.6

    def drawn(is_wanted):
        rules = lambda points, hard: hard >= 0.05  # noqa: E731
        return sample_pairs(100, 7, (np.zeros(3), np.ones(3)), 0.3, psi, rules, is_wanted, is_inside)

    few = drawn(None)
    number_of_few = sum(asked)
    every = drawn(lambda start, goal: np.ones(len(start), bool))
    for name in ("start", "goal", "sampled", "sampled_inside_hulls", "candidates"):
        np.testing.assert_array_equal(getattr(few, name), getattr(every, name))
    assert (few.start[:, 1] > 0.6).all()
    assert number_of_few < 0.5 * (sum(asked) - number_of_few)


def test_default_bounds_leave_out_far_vertices():
    blocks = [((i, 0, 0), (i + 1, 1, 1)) for i in range(199)] + [((5000, 0, 0), (5001, 1, 1))]
    _, upper = central_box(Hulls.from_cover(box_cover(blocks)).vertices_world, None, "hulls")
    assert upper[0] < 20.1
