"""Filters among ellipsoids that are written in Python, as other packages would."""

import numpy as np

from alula.stages.filtering.protocol import FilterStatus
from alula.stages.filtering.splat_protocol import SplatFilterResult, SplatWorld


class Passing:
    """A filter from elsewhere: passes everything."""

    kind = "acceleration"

    def __init__(self, world=None, parameters=None):
        assert world is None or isinstance(world, SplatWorld)
        self.parameters = parameters or {}
        self.flights = 0

    def reset(self):
        self.flights += 1

    def __call__(self, state, nominal):
        u = nominal.acceleration if self.kind == "acceleration" else nominal.wrench
        return SplatFilterResult(u, FilterStatus.OK, margin=1.0, certified=True)


class Limiting(Passing):
    """Never more than 1 m/s^2; gives up beyond a plane."""

    def __call__(self, state, nominal):
        if state.position[0] > self.parameters.get("stop_x", np.inf):
            return SplatFilterResult(np.full(3, np.nan), FilterStatus.REFUSED)
        return SplatFilterResult(np.clip(nominal.acceleration, -1, 1), FilterStatus.FILTERED, margin=0.5)


class Broken(Passing):
    def __call__(self, state, nominal):
        return SplatFilterResult(np.full(3, np.nan), FilterStatus.OK)


class Holding(Passing):
    """Hovers at the start."""

    def __call__(self, state, nominal):
        return SplatFilterResult(-2 * state.velocity, FilterStatus.BACKUP)
