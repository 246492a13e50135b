"""The shell of a fence as logs and reports draw it: whole boxes, cut boxes, open fences."""

import numpy as np
import pytest

from alula.stages.runlog.maps import SHOWN_BEYOND_M, fence_shell
from alula.stages.vehicles.fence import fence_faces


def volume(corners, triangles):
    a, b, c = (corners[triangles[:, i]] for i in range(3))
    return np.einsum("ij,ij->i", np.cross(a, b), c).sum() / 6


def test_a_box_is_drawn_whole_and_cut_by_faces():
    box = (-1, -2, -3, 4, 5, 6)
    corners, triangles = fence_shell(fence_faces(box, ()), [])
    assert len(corners) == 8
    assert len(triangles) == 12
    assert volume(corners, triangles) == pytest.approx(5 * 7 * 9)  # turned outwards
    corners, triangles = fence_shell(fence_faces(box, [(2, 0, 0, 4)]), [np.zeros((1, 3))])
    assert corners[:, 0].max() == pytest.approx(2)
    assert volume(corners, triangles) == pytest.approx(3 * 7 * 9)


def test_an_open_fence_is_drawn_near_the_paths_without_walls_that_are_not_there():
    path = np.array([[0.0, 0, 0], [10, 0, 5]])
    corners, triangles = fence_shell(fence_faces(None, [(1, 0, 0, 12), (0, 0, -1, 3)]), [path])
    center = corners[triangles].mean(axis=1)
    assert ((np.abs(center[:, 0] - 12) < 1e-6) | (np.abs(center[:, 2] + 3) < 1e-6)).all()
    assert np.ptp(corners[:, 1]) == pytest.approx(2 * SHOWN_BEYOND_M)
    nothing = fence_shell(fence_faces((0, 0, 0, 1, 1, 1), [(1, 0, 0, -1)]), [path])
    assert [len(part) for part in nothing] == [0, 0]
