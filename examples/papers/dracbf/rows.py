"""Rows of verdicts on DR-ACBF's metrics: success, means of a value, reaction and computing times."""

from __future__ import annotations

import statistics
from collections.abc import Callable
from dataclasses import replace

from alula.schemas.run import ObstacleResult
from alula.stages.reporting.statistics import Rate, mean_estimate, mean_of
from papers.dracbf.tables import BASE, Flown, milli, reaction_in_ticks, success
from papers.verdicts import PaperRow, exact

MATLAB = "MATLAB on a laptop there, C here: only ratios compare"
COURSES = "the paper leaves out the speeds and courses that decide it; those here are our choice"
HARDWARE = "flights of a Crazyflie; ours is its simulated counterpart"
CEILING = (
    "the paper leaves out what lowers it (noise, missed detections, delays); see the table on difficulty"
)
NAMES = {"mpc": "MPC", "cbf-qp": "CBF-QP", "rp-cbf": "RP-CBF", BASE: "DR-ACBF"}


def span(low: float | None, high: float | None, unit: str = "") -> str:
    """Write an interval; empty where it is unknown."""
    return "" if low is None or high is None else f"{exact(float(low))} to {exact(float(high))}{unit}"


def made_of(row: PaperRow, *flown: Flown | None) -> PaperRow:
    """The row with the runs that it is made from."""
    runs = [f for f in flown if f is not None]
    if not runs:
        return row
    files = [f"{f.scenario}/{f.variant}.run.mcap" for f in runs]
    return row.made_from(files, sum(len(f.record.trials) for f in runs))


def missing(item: str, quantity: str, published: str) -> PaperRow:
    """A row of a value whose run is missing."""
    return PaperRow(item, quantity, published, "", "", "not available here", "not flown in this run")


def command_time(flown: Flown) -> float | None:
    """Mean command time of the obstacles [s]; None where it was not measured."""
    return mean_of(flown.timing("command_mean_s", i) for i in range(flown.obstacles))


def of_obstacles(f: Flown) -> Rate:
    """Mean of the obstacles' success [%]; its interval resamples trials, because their obstacles depend."""
    each = [mean_of(not m.collision for m in trial.obstacles or []) or 0.0 for trial in f.record.trials]
    found = mean_estimate(each, bounds=(0.0, 1.0))
    assert found is not None
    assert found.low is not None
    assert found.high is not None
    return Rate(100 * found.value, 100 * found.low, 100 * found.high, found.n)


def success_row(item: str, quantity: str, published: float, f: Flown, obstacle: int | None) -> PaperRow:
    """Judge a published success of one obstacle, or of the mean of all obstacles."""
    now = of_obstacles(f) if obstacle is None else success(f, obstacle)
    low, high = now.ends
    if low <= published <= high:
        verdict, why = "reproduced", ""
    elif published < low:
        verdict, why = "not comparable", CEILING
    else:
        verdict, why = "refuted", "lower than published, with our speeds, noise and courses"
    row = PaperRow(
        *(item, quantity, f"{published:g} %", f"{exact(now.value)} %", span(now.low, now.high, " %")),
        *(verdict, why),
    )
    return made_of(row, f)


def mean_row(
    item: str,
    quantity: str,
    published: float,
    f: Flown,
    get: Callable[[ObstacleResult], float | None],
    why: str = COURSES,
    obstacle: int | None = None,
    unit: str = "",
) -> PaperRow:
    """Judge a published mean of a value over the obstacles with a warning."""
    every = [trial.obstacles or [] for trial in f.record.trials]
    each = [mean_of(get(m) for m in (met if obstacle is None else [met[obstacle]])) for met in every]
    values = [value for value in each if value is not None]
    found = mean_estimate(values) if values else None
    if found is None:
        return missing(item, quantity, f"{published:g}{unit}")
    known = found.low is not None and found.high is not None
    inside = found.low is not None and found.high is not None and found.low <= published <= found.high
    verdict = "reproduced" if inside else "not comparable" if why != HARDWARE else "not available here"
    row = PaperRow(
        *(item, quantity, f"{published:g}{unit}", f"{exact(found.value)}{unit}"),
        span(found.low, found.high, unit) if known else "",
        *(verdict, "" if inside else why),
    )
    return made_of(row, f)


def reaction_row(
    item: str, quantity: str, published: float, f: Flown, obstacle: int | None = None
) -> PaperRow:
    """Judge a reaction time: simulated time to the end of the first tick with another command."""
    dt = f.dt_s

    def reaction(m: ObstacleResult) -> float | None:
        return None if m.reaction_s is None else 1e3 * (round(m.reaction_s / dt) + 1) * dt

    row = mean_row(item, quantity, published, f, reaction, obstacle=obstacle, unit=" ms")
    mean = milli(reaction_in_ticks(f)) or 0.0
    if abs(mean - published) < 500 * dt:  # less than half a tick
        verdict, why = "reproduced", "one tick; the rest of the published value is its computing time"
    elif published > mean + 1e3 * dt:
        verdict, why = (
            "refuted",
            "the first command after the warning differs, one tick later, as for the others",
        )
    else:
        verdict, why = "bounded", "within a tick"
    return replace(row, verdict=verdict, why=why)


def spread_row(item: str, quantity: str, published: str, f: Flown) -> PaperRow:
    """State the standard deviation of the reaction time over warnings."""
    every = [m.reaction_s for trial in f.record.trials for m in trial.obstacles or []]
    ticks = [(round(r / f.dt_s) + 1) * f.dt_s for r in every if r is not None]
    ours = f"{exact(1e3 * statistics.pstdev(ticks))} ms" if ticks else ""
    row = PaperRow(
        *(item, quantity, published, ours, "", "not comparable"),
        "theirs has the computing time in MATLAB, ours is in whole ticks; extreme outliers are removed there",
    )
    return made_of(row, f)


def time_row(
    item: str, quantity: str, published: str, mean: float | None, std: float | None, f: Flown
) -> PaperRow:
    """State a computing time [ms]: absolute times of MATLAB on a laptop compare with nothing."""
    ours = "" if mean is None else exact(mean) + ("" if std is None else f" ± {exact(std)}") + " ms"
    return made_of(PaperRow(item, quantity, published, ours, "", "not comparable", MATLAB), f)
