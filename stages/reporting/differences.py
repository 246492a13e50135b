"""Direct comparison of runs: each against the first, with 95 % intervals of the differences.

Runs are paired when they have the same trials: the same numbers, starts and goals; or when one of them lacks
some, as a run of plans does where the planner found no way. Then each trial is compared with its own: the
interval resamples pairs, and the sign test counts in how many pairs the one is higher. Other runs
are compared as two samples, and the report says so.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import msgspec
import numpy as np

from alula.schemas.log.run import TrialResult
from alula.stages.reporting import plain
from alula.stages.reporting.headline import successful
from alula.stages.reporting.material import Material, Run
from alula.stages.reporting.statistics import (
    difference_estimate,
    rate_difference,
    sign_test,
    two_sample_estimate,
)
from alula.stages.reporting.table import HIGH, LOW, Table
from alula.stages.unlike import unlike, unlike_words
from alula.stages.verdict import clearance_of, path_ratio

_SAME_PLACE_M = 1e-6
_PERCENT = 100.0
PAIRED_NOTE = (
    "{n} trials of both runs have the same starts and goals, so each is compared with its own. "
    "Intervals: percentile bootstrap of the pairs (95 %). p: exact two-sided sign test of the pairs that "
    "differ; of reached goals and touched obstacles it is McNemar's exact test. No correction for many rows."
)
LEFT_NOTE = " {left} trials that only one of the runs has are left out."
UNPAIRED_NOTE = (
    "The trials of these runs differ in their numbers, starts or goals, so they are compared as two samples, "
    "which shows less than pairs would. Intervals (95 %): of rates by Newcombe from Wilson's, of means by "
    "bootstrap of both samples. No correction for several rows."
)


@dataclass(frozen=True, slots=True)
class _Quantity:
    """Values by trial, where it has one. `is_rate` marks yes or no, compared in percent."""

    name: str
    of: Callable[[Run], dict[int, float]]
    is_rate: bool = False


def _each(get: Callable[[TrialResult], float | None]) -> Callable[[Run], dict[int, float]]:
    def of(run: Run) -> dict[int, float]:
        known = ((trial.index, get(trial)) for trial in run.record.trials)
        return {index: float(value) for index, value in known if value is not None}

    return of


def _when_successful(get: Callable[[TrialResult], float | None]) -> Callable[[Run], dict[int, float]]:
    def of(run: Run) -> dict[int, float]:
        good = successful(run)
        return {index: value for index, value in _each(get)(run).items() if index in good}

    return of


def _is_successful(run: Run) -> dict[int, float]:
    good = successful(run)
    return {trial.index: float(trial.index in good) for trial in run.record.trials}


def _changed(trial: TrialResult) -> float | None:
    return _PERCENT * trial.filtered_steps / trial.steps if trial.steps else None


QUANTITIES = (
    _Quantity("successful flights [%]", _is_successful, is_rate=True),
    _Quantity("touched an obstacle [%]", _each(lambda trial: trial.collision), is_rate=True),
    _Quantity("minimum clearance of a flight [m]", _each(clearance_of)),
    _Quantity("duration of successful flights [s]", _when_successful(lambda trial: trial.duration_s)),
    _Quantity("path / straight line of successful flights", _when_successful(path_ratio)),
    _Quantity("top speed of a flight [m/s]", _each(lambda trial: trial.max_speed_m_s)),
    _Quantity("commands changed by the filter [%]", _each(_changed)),
)


_SAID: dict[str, tuple[str, str, str, Callable[[float], str]]] = {
    "successful flights [%]": ("success rate", "higher", "lower", lambda value: f"{value:.0f} points"),
    "touched an obstacle [%]": ("rate of collisions", "higher", "lower", lambda value: f"{value:.0f} points"),
    "minimum clearance of a flight [m]": ("mean of the minimum clearances", "more", "less", plain.length),
    "duration of successful flights [s]": (
        "mean time of a successful flight",
        "more",
        "less",
        plain.duration,
    ),
}


def difference_tables(material: Material) -> list[Table]:
    """Compare each run with the first one; none of fewer than two with several trials."""
    runs = [run for run in material.runs if len(run.record.trials) > 1]
    several = len(runs) > 2
    return [
        _table(runs[0], other, f"differences-{number}" if several else "differences")
        for number, other in enumerate(runs[1:], 2)
    ]


def difference_words(table: Table) -> list[str]:
    """State the differences of a table in words, each as clear or not; first what else the runs differ in.

    Args:
        table: from `difference_tables`.
    """
    found = [table.before] if table.before else []
    first, second = table.columns[1:3]
    for name, _, _, value, low, high, *_ in table.rows:
        if low is None or high is None or name not in _SAID:
            continue
        subject, more, less, write = _SAID[name]
        if low <= 0 <= high:
            found.append(f"{second}: {subject} not clearly different from {first}.")
            continue
        ends = " to ".join(write(end) for end in sorted((abs(low), abs(high))))
        word = more if value > 0 else less
        found.append(f"{second}: {subject} {write(abs(value))} {word} than {first} (95 %: {ends}).")
    return found


def is_paired(first: Run, second: Run) -> bool:
    """Whether two runs have the same trials: the same numbers, starts and goals."""
    ours, theirs = ({t.index: t for t in run.record.trials} for run in (first, second))
    return ours.keys() == theirs.keys() and all(
        np.abs(np.subtract(trial.start_m, theirs[index].start_m)).max() <= _SAME_PLACE_M
        and np.abs(np.subtract(trial.goal_m, theirs[index].goal_m)).max() <= _SAME_PLACE_M
        for index, trial in ours.items()
    )


def _shared(first: Run, second: Run) -> tuple[Run, Run] | None:
    """Both runs with the trials of equal starts and goals, numbered alike; None where these are no pairs."""
    if is_paired(first, second):
        return first, second
    ours, theirs = (
        {(*trial.start_m, *trial.goal_m): trial for trial in run.record.trials} for run in (first, second)
    )
    lacks = ours.keys() <= theirs.keys() or theirs.keys() <= ours.keys()
    both = [place for place in ours if place in theirs]
    repeats = len(ours) < len(first.record.trials) or len(theirs) < len(second.record.trials)
    if repeats or not lacks or len(both) < 2:
        return None
    same = [msgspec.structs.replace(theirs[place], index=ours[place].index) for place in both]
    return _of_trials(first, [ours[place] for place in both]), _of_trials(second, same)


def _of_trials(run: Run, trials: list[TrialResult]) -> Run:
    return replace(run, record=msgspec.structs.replace(run.record, trials=trials))


def _table(first: Run, second: Run, name: str) -> Table:
    shared = _shared(first, second)
    paired, total = shared is not None, len(first.record.trials) + len(second.record.trials)
    first, second = shared or (first, second)
    tests = ("n", "higher in", "lower in", "p") if paired else ("n",)
    columns = ("", first.label, second.label, "difference", LOW, HIGH, *tests)
    rows = [row for one in QUANTITIES if (row := _row(one, first, second, paired=paired)) is not None]
    note = PAIRED_NOTE.format(n=len(first.record.trials)) if paired else UNPAIRED_NOTE
    if left := total - len(first.record.trials) - len(second.record.trials):
        note += LEFT_NOTE.format(left=left)
    note += f" Difference: {second.label} less {first.label}."
    title = f"{second.label} against {first.label}"
    others = unlike_words(unlike(first.record, second.record), first.label, second.label)
    return Table(name, title, columns, tuple(rows), note, others)


def _row(one: _Quantity, first: Run, second: Run, *, paired: bool) -> tuple[Any, ...] | None:
    a, b = one.of(first), one.of(second)
    shared = [index for index in a if index in b]
    ours = [a[index] for index in shared] if paired else list(a.values())
    theirs = [b[index] for index in shared] if paired else list(b.values())
    if not ours or not theirs or (not any(ours) and not any(theirs)):
        return None
    factor = _PERCENT if one.is_rate else 1.0
    if paired:
        found = difference_estimate(theirs, ours, bounds=(-1.0, 1.0) if one.is_rate else None)
    elif one.is_rate:
        found = rate_difference([value > 0 for value in theirs], [value > 0 for value in ours])
    else:
        found = two_sample_estimate(theirs, ours)
    if found is None:
        return None
    ends = [None if end is None else factor * end for end in (found.value, found.low, found.high)]
    row = (one.name, factor * _mean(ours), factor * _mean(theirs), *ends, found.n)
    if not paired:
        return row
    higher = sum(y > x for x, y in zip(ours, theirs, strict=True))
    lower = sum(y < x for x, y in zip(ours, theirs, strict=True))
    return (*row, higher, lower, sign_test(higher, lower))


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values))
