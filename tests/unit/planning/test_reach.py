"""Where a ball goes on a lattice: against distances from brute force."""

import numpy as np
import pytest

from alula.stages.planning.reach import centres_of, components, is_line_clear, rim, touched


def distances(voxels, centre):
    """Distances from the centre of a voxel to closed cubes [voxels]."""
    gap = np.maximum(np.abs(voxels - centre) - 0.5, 0)
    return np.sqrt((gap**2).sum(axis=1))


@pytest.mark.parametrize("radius", [0.3, 0.5, 0.51, 1.0, 1.5, 2.5, 3.7])
def test_a_ball_touches_the_voxels_nearer_than_its_radius_and_no_others(radius):
    rng = np.random.default_rng(int(radius * 100))
    centres = rng.random((9, 10, 11)) < 0.004
    every = np.argwhere(np.ones_like(centres))
    expected = np.zeros(len(every), bool)
    for centre in np.argwhere(centres):
        expected |= distances(every, centre) < radius - 1e-12
    np.testing.assert_array_equal(touched(centres, radius).ravel(), expected)


@pytest.mark.parametrize("radius", [0.3, 0.5, 0.6, 1.5, 2.2])
def test_a_ball_has_room_where_no_other_voxel_is_nearer(radius):
    rng = np.random.default_rng(int(radius * 10))
    free = rng.random((8, 9, 10)) < 0.97
    outside = np.argwhere(np.pad(~free, 5, constant_values=True)) - 5
    room = centres_of(free, radius)
    for voxel in np.argwhere(np.ones_like(free)):
        assert room[tuple(voxel)] == (distances(outside, voxel).min() >= radius - 1e-12)
    inside = np.argwhere(~free)
    room = centres_of(free, radius, is_closed=False)
    for voxel in np.argwhere(np.ones_like(free)):
        assert room[tuple(voxel)] == (distances(inside, voxel).min() >= radius - 1e-12)


def test_a_ball_that_has_room_at_both_ends_of_a_step_has_room_on_the_way():
    rng = np.random.default_rng(2)
    free = rng.random((12, 12, 12)) < 0.98
    taken = np.argwhere(np.pad(~free, 4, constant_values=True)) - 4
    room = centres_of(free, 1.3)
    ends = np.argwhere(room[:-1] & room[1:])
    assert len(ends) > 20
    for voxel in ends:
        for part in np.linspace(0, 1, 9):
            assert distances(taken, voxel + np.array([part, 0, 0])).min() >= 1.3


def test_a_wall_separates_components_and_a_hole_joins_them_only_for_a_small_ball():
    free = np.ones((21, 11, 11), bool)
    free[10] = False
    free[10, 3:6, 3:6] = True  # 3 voxels wide
    small, large = (components(centres_of(free, radius)) for radius in (1.4, 1.7))
    assert small[4, 5, 5] == small[16, 5, 5] > 0
    assert 0 < large[4, 5, 5] != large[16, 5, 5] > 0


def test_the_rim_has_the_outermost_layers():
    assert rim((5, 6, 7), 1).sum() == 5 * 6 * 7 - 3 * 4 * 5
    assert rim((5, 6, 7), 3).all()
    assert not rim((5, 6, 7), 0).any()


def test_a_line_is_clear_exactly_when_it_crosses_no_blocked_voxel():
    rng = np.random.default_rng(4)
    blocked = rng.random((6, 7, 8)) < 0.1
    answers = []
    for _ in range(200):
        start, end = (rng.uniform(-2, 10, 3) for _ in range(2))
        samples = start + np.linspace(0, 1, 5001)[:, None] * (end - start)
        voxel = np.floor(samples).astype(int)
        inside = ((voxel >= 0) & (voxel < blocked.shape)).all(axis=1) & (voxel != np.floor(start)).any(axis=1)
        expected = not blocked[tuple(voxel[inside].T)].any()
        answers.append(is_line_clear(blocked, start, end))
        assert answers[-1] <= expected  # samples may miss a corner
    assert 20 < sum(answers) < 180
