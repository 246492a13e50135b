"""Filters that are written in Python, as other packages would."""

import numpy as np

from alula.stages.filtering.protocol import FilterResult, FilterStatus, FilterWorld


class OfVelocities:
    """A filter of velocities: a function of position and nominal velocity."""

    kind = "velocity"

    def __init__(self, answer):
        self.answer = answer

    def reset(self):
        pass

    def __call__(self, state, nominal):
        return self.answer(state.position, nominal.velocity)


class Passing:
    """A filter from elsewhere: passes everything."""

    kind = "acceleration"

    def __init__(self, world=None, parameters=None):
        assert world is None or isinstance(world, FilterWorld)
        self.parameters = parameters or {}
        self.flights = 0

    def reset(self):
        self.flights += 1

    def __call__(self, state, nominal):
        u = nominal.acceleration if self.kind == "acceleration" else nominal.wrench
        return FilterResult(u, FilterStatus.OK, margin=1.0, certified=True)


class Limiting(Passing):
    """Never more than 1 m/s^2; gives up beyond a plane."""

    def __call__(self, state, nominal):
        if state.position[0] > self.parameters.get("stop_x", np.inf):
            return FilterResult(np.full(3, np.nan), FilterStatus.REFUSED)
        return FilterResult(np.clip(nominal.acceleration, -1, 1), FilterStatus.FILTERED, margin=0.5)


class Broken(Passing):
    def __call__(self, state, nominal):
        return FilterResult(np.full(3, np.nan), FilterStatus.OK)


class Holding(Passing):
    """Hovers at the start."""

    def __call__(self, state, nominal):
        return FilterResult(-2 * state.velocity, FilterStatus.BACKUP)
