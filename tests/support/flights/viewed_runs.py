"""Runs of straight flights for tests of views."""

import numpy as np

from alula.schemas.log.flights import Flight
from alula.stages.reporting.material import Run
from support.scenes.fabricate import make_record


def flight(start=0.0, n=51, **fields):
    time = start + np.linspace(0, 5, n)
    position = np.column_stack([time - start, np.zeros(n), np.ones(n)])
    return Flight(time, position, np.ones(n), time, 0.5 + time, "m", ("ok",) * n, **fields)


def run_of(trials, label="a", **fields):
    return Run(label, make_record(trials), {t.index: flight(**fields) for t in trials})
