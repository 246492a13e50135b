"""The subdivision that proves the clearance of a curve, on curves whose clearance is known."""

import numpy as np
import pytest

from alula import _core

PLANES = np.vstack([np.eye(3), -np.eye(3)])
CORNERS = np.array([[x, y, z] for x in (0.0, 1) for y in (0.0, 1) for z in (-1.0, 0)])
BOX = _core.HullMap(
    _core.PolytopeSet(PLANES, np.array([1.0, 1, 0, 0, 0, 1]), np.array([0, 6]), CORNERS, np.array([0, 8]))
)
# its top is the plane z = 0


def straight(height_m):
    """Control points of a line over the box, parallel to its top, shape (1, 8, 3) [m]."""
    x = np.linspace(0.2, 0.8, 8)
    return np.stack([x, np.full(8, 0.5), np.full(8, height_m)], axis=1)[None]


def proof(height_m, radius_m, depth):
    proven, clearance, _, reached = _core.check_curves(
        BOX, straight(height_m), np.array([1e-12]), radius_m, depth, 1
    )
    return bool(np.ravel(proven)[0]), float(np.ravel(clearance)[0]), int(np.max(reached))


def test_a_curve_far_enough_is_proven_at_once():
    proven, clearance, depth = proof(0.3, 0.2, 6)
    assert proven
    assert depth == 0
    assert clearance == pytest.approx(0.3, abs=1e-6)
    assert clearance <= 0.3


def test_a_curve_at_the_very_radius_is_not_proven_and_the_search_ends():
    proven, clearance, depth = proof(0.25, 0.25, 6)
    assert not proven
    assert depth == 6
    assert clearance == pytest.approx(0.25, abs=1e-6)
    assert clearance <= 0.25


@pytest.mark.parametrize(("height_m", "clearance_m"), [(0.1, 0.1), (-0.1, 0.0)])
def test_of_a_curve_too_near_the_clearance_is_told(height_m, clearance_m):
    proven, clearance, _ = proof(height_m, 0.2, 6)
    assert not proven
    assert clearance == pytest.approx(clearance_m, abs=1e-6)
    assert 0 <= clearance <= clearance_m
