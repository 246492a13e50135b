"""Filters that are written in Python, as other packages would, and their entry points."""

import numpy as np

from alula.schemas.parameters import foreign_filters
from alula.stages.filtering.protocol import FilterResult, FilterStatus, FilterWorld


class EntryPoint:
    """An entry point that loads what it is given; None stands for a package that is absent."""

    def __init__(self, name, made):
        self.name, self.value, self.made = name, f"elsewhere:{name}", made

    def load(self):
        if self.made is None:
            raise ImportError("no module named 'elsewhere'")
        return self.made


def provide(monkeypatch, filters):
    """Let other packages provide filters, by their names."""
    points = {foreign_filters.ENTRY_POINTS: [EntryPoint(*item) for item in filters.items()]}
    monkeypatch.setattr(foreign_filters, "entry_points", lambda group: points[group])


class OfVelocities:
    """A filter of velocities: a function of position and nominal velocity."""

    kind = "velocity"

    def __init__(self, answer):
        self.answer = answer

    def reset(self):
        pass

    def __call__(self, state, nominal):
        return self.answer(state.position, nominal.velocity)


class Wrapped:
    """A filter of this package as one of another package."""

    def __init__(self, made):
        self.made, self.kind = made, made.kind

    def reset(self):
        self.made.reset()

    def __call__(self, state, nominal):
        return self.made(state, nominal)


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
