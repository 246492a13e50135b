"""Trackers and scans for them."""

import numpy as np

from alula import _core

SIGMA = 0.3  # of a position per axis, where a test does not say otherwise


def tracker(most=128, **options):
    """One with these options."""
    return _core.Tracker(_core.TrackerOptions(**options), most)


def scan(target, t, *positions, sigma=SIGMA, **doppler):
    """Detections at these positions."""
    position = np.array(positions, float).reshape(-1, 3)
    target.update(t, position, np.tile(sigma**2 * np.eye(3), (len(position), 1, 1)), **doppler)
