"""Rows of verdicts on FastBridge, with the runs that they are made from, and what several rows need."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from alula.schemas.run import TrialResult
from alula.stages.reporting.statistics import Estimate, mean_estimate
from alula.stages.verdict import wilson_interval
from papers.fastbridge.sweeps import Sweep, succeeded
from papers.verdicts import PaperRow, exact


def row_of(
    item: str,
    quantity: str,
    published: str,
    ours: str,
    verdict: str,
    why: str,
    interval: str = "",
    *,
    flown: Iterable[Sweep] = (),
) -> PaperRow:
    """A row with the runs that it is made from."""
    row = PaperRow(item, quantity, published, ours, interval, verdict, why)
    sweeps = list(flown)
    if not sweeps:
        return row
    files = [f"{s.scene}/{s.variant}@{s.speed_m_s:g}.run.mcap" for s in sweeps]
    return row.made_from(files, sum(len(s.run.record.trials) for s in sweeps))


def outcomes(here: Sequence[Sweep], variant: str) -> str:
    """Goals and collisions of a variant by speed, in words; empty where it was not flown."""
    parts = []
    for sweep in sorted((s for s in here if s.variant == variant), key=lambda s: s.speed_m_s):
        good, count = goals(sweep)
        hits = sum(t.collision for t in sweep.run.record.trials)
        parts.append(f"{good} reached and {hits} collided of {count} at {sweep.speed_m_s:g} m/s")
    return ", ".join(parts)


def runs_of(here: Sequence[Sweep], variants: str | Sequence[str], *speeds: float) -> list[Sweep]:
    """Runs of variants, at all speeds or at some."""
    names = (variants,) if isinstance(variants, str) else variants
    return [s for s in here if s.variant in names and (not speeds or s.speed_m_s in speeds)]


def goals(sweep: Sweep) -> tuple[int, int]:
    """Count the flights that reach their goal in time without a collision, and all."""
    trials = sweep.run.record.trials
    return sum(succeeded(t) for t in trials), len(trials)


def ends_of(
    here: Sequence[Sweep], variant: str, get: Callable[[TrialResult], float | None]
) -> tuple[tuple[float, Estimate], tuple[float, Estimate]] | None:
    """Mean of a value at the lowest and the highest speed of a variant."""
    flown = sorted((s for s in here if s.variant == variant), key=lambda s: s.speed_m_s)
    found = []
    for sweep in flown[:1] + flown[-1:]:
        values = sweep.values(get)
        mean = mean_estimate(values[np.isfinite(values)])
        if mean is None:
            return None
        found.append((sweep.speed_m_s, mean))
    return (found[0], found[1]) if len(found) == 2 and found[0][0] < found[1][0] else None


def above(high: Estimate, low: Estimate) -> bool:
    """Return whether the interval of one mean lies above that of another."""
    return (high.value if high.low is None else high.low) > (low.value if low.high is None else low.high)


def span(found: Estimate) -> str:
    """Write an interval with three digits; empty where it is unknown."""
    if found.low is None or found.high is None:
        return ""
    return f"{exact(found.low, '.3g')} to {exact(found.high, '.3g')}"


def share(good: int, of: int) -> str:
    """Write the Wilson interval of a share in percent."""
    low, high = wilson_interval(good, of)
    return f"{exact(100 * low, '.1f')} to {exact(100 * high, '.1f')} %"


def flights_span(shares: Sequence[float]) -> str:
    """Write the interval of the mean of flights' shares in percent."""
    found = mean_estimate(np.array(shares), bounds=(0.0, 1.0))
    if found is None or found.low is None or found.high is None:
        return ""
    return f"{exact(100 * found.low, '.1f')} to {exact(100 * found.high, '.1f')} % (flights)"
