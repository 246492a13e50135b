"""Runs of many filters over the same start-goal pairs, and paired comparison of two of them."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.errors import InputError
from alula.schemas.log.run import TrialResult
from alula.schemas.parameters.filter_options import TABLES
from alula.stages.reporting.material import Run
from alula.stages.reporting.statistics import Estimate, difference_estimate, ratio_estimate
from alula.stages.reporting.table import flat, text

_PREFIX = re.compile(r"^(safety\.(?!filters)[^.]*)\.")  # of a filter's parameter
_ROUNDING_M_S2 = 1e-9  # of an acceleration; the rounding error in flight is about 1e-15


@dataclass(frozen=True, slots=True)
class Sweep:
    """One run of a sweep: flights of one variant of a filter through one scene at one reference speed.

    Attributes:
        scene: name of the scene.
        variant: the filter, or a name for it with other parameters.
        speed_m_s: peak speed of the references [m/s].
        run: its record and flights; trial i has the same start and goal in all runs of a scene.
    """

    scene: str
    variant: str
    speed_m_s: float
    run: Run

    @property
    def file(self) -> str:
        """Its log below the example's output folder."""
        return f"{self.scene}/{self.variant}@{self.speed_m_s:g}.run.mcap"

    @property
    def flights(self) -> int:
        """Number of flights."""
        return len(self.run.record.trials)

    def values(self, get: Callable[[TrialResult], float | None]) -> FloatArray:
        """One value per trial, shape (trials,), NaN where there is none."""
        return np.array([get(trial) for trial in self.run.record.trials], np.float64)

    def timing(self, key: str) -> float | None:
        """A measured time of the run [s] or count; None where it was not measured."""
        found = (self.run.record.timing or {}).get(key)
        return float(found) if found is not None else None


def realisation_error(trial: TrialResult) -> float | None:
    """Peak realisation error of a flight [m/s^2]; rounding errors count as 0."""
    error = trial.peak_realisation_error_m_s2
    return 0.0 if error is not None and error < _ROUNDING_M_S2 else error


def filter_parameters(run: Run) -> dict[str, Any]:
    """Parameters of the last filter of a run, from its table.

    Args:
        run: any.
    """
    safety = run.record.provenance.parameters["safety"]
    names = safety.get("filters") or [None]
    return dict(safety.get(TABLES.get(names[-1], names[-1]), {}))


def changed_parameters(sweep: Sweep, base: Sweep) -> str:
    """List in words the parameters that differ from those of `base`, except the name."""
    ours, theirs = (flat(s.run.record.provenance.parameters) for s in (sweep, base))
    keys = sorted(key for key in ours.keys() | theirs.keys() if ours.get(key) != theirs.get(key))
    names = {key: _PREFIX.sub("", key) for key in keys if key != "name"}
    return ", ".join(f"{name} {text(ours.get(key))}" for key, name in names.items())


def find(sweeps: Iterable[Sweep], scene: str, variant: str, speed_m_s: float) -> Sweep | None:
    """Find the run of a variant; None when there is none."""
    for sweep in sweeps:
        if (sweep.scene, sweep.variant, sweep.speed_m_s) == (scene, variant, speed_m_s):
            return sweep
    return None


def scenes_of(sweeps: Sequence[Sweep]) -> list[str]:
    """Names of the scenes, in the order of the runs."""
    return list(dict.fromkeys(sweep.scene for sweep in sweeps))


def speeds_of(sweeps: Sequence[Sweep], scene: str, variants: Sequence[str]) -> list[float]:
    """Reference speeds at which all of the variants were flown in a scene, ascending [m/s]."""
    flown = [{s.speed_m_s for s in sweeps if s.scene == scene and s.variant == v} for v in variants]
    return sorted(set.intersection(*flown)) if flown else []


@dataclass(frozen=True, slots=True)
class Comparison:
    """Comparison of two filters over the same pairs; ratios are ours / baseline.

    Attributes:
        mean_jerk: ratio of the flights' mean jerk, by pairs.
        max_jerk: ratio of the flights' maximum jerk, by pairs.
        filter_time: ratio of the mean time of a filter call; None where not measured.
        top_speed: difference of the flights' maximum speeds [m/s].
        goals: difference of the rates of flights that reached the goal without a collision; None where only
            some of the flights are compared.
    """

    mean_jerk: Estimate | None
    max_jerk: Estimate | None
    filter_time: float | None
    top_speed: Estimate | None
    goals: Estimate | None


def compare(
    ours: Sequence[Sweep], theirs: Sequence[Sweep], only: Callable[[TrialResult], bool] | None = None
) -> Comparison:
    """Compare runs by pairs of trials.

    A pair of start and goal is one draw of the bootstrap with all of its speeds.

    Args:
        ours: runs of one filter, by speed.
        theirs: runs of the other filter, at the same speeds.
        only: condition that both trials of a pair must meet; by default all pairs count.

    Raises:
        InputError: trials of the same index do not have the same start and goal.
    """
    count = min(len(s.run.record.trials) for s in (*ours, *theirs))
    pairs = [[(t.start_m, t.goal_m) for t in s.run.record.trials[:count]] for s in (*ours, *theirs)]
    if any(pair != pairs[0] for pair in pairs):
        raise InputError("runs that are compared must fly the same pairs of start and goal")
    both = np.array(
        [
            [
                only is None or (only(a.run.record.trials[i]) and only(b.run.record.trials[i]))
                for i in range(count)
            ]
            for a, b in zip(ours, theirs, strict=True)
        ]
    )

    def summed(sweeps: Sequence[Sweep], get: Callable[[TrialResult], float | None]) -> FloatArray:
        values = np.array([s.values(get)[:count] for s in sweeps])
        return np.asarray(np.where(both, values, 0.0).sum(axis=0)[both.any(axis=0)])

    def ratio(get: Callable[[TrialResult], float | None]) -> Estimate | None:
        return ratio_estimate(summed(ours, get), summed(theirs, get))

    def difference(
        get: Callable[[TrialResult], float | None], bounds: tuple[float, float] | None = None
    ) -> Estimate | None:
        weight = both.sum(axis=0)[both.any(axis=0)]
        mine, other = (summed(sweeps, get) / weight for sweeps in (ours, theirs))
        return difference_estimate(mine, other, bounds=bounds)

    return Comparison(
        ratio(lambda t: t.mean_jerk_m_s3),
        ratio(lambda t: t.max_jerk_m_s3),
        _time_ratio(ours, theirs),
        difference(lambda t: t.max_speed_m_s),
        difference(lambda t: float(succeeded(t)), (-1.0, 1.0)) if only is None else None,
    )


def succeeded(trial: TrialResult) -> bool:
    """Return whether a flight reached its goal without a collision."""
    return trial.outcome == "reached" and not trial.collision


def _time_ratio(ours: Sequence[Sweep], theirs: Sequence[Sweep]) -> float | None:
    total = []
    for sweeps in (ours, theirs):
        seconds = [s.timing("filter_total_s") for s in sweeps]
        calls = [s.timing("filter_calls") for s in sweeps]
        if any(x is None for x in (*seconds, *calls)):
            return None
        total.append(sum(x or 0.0 for x in seconds) / max(1.0, sum(x or 0.0 for x in calls)))
    return total[0] / total[1] if total[1] > 0 else None
