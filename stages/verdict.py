"""Summaries and guarantee statements of judged trials: rates, intervals, extremes, means."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Sequence
from statistics import NormalDist
from typing import Any

import msgspec

from alula.schemas.errors import InputError
from alula.schemas.log.run import Outcome, TrialResult

UNFILTERED = "No filter was flown; nothing was guaranteed beforehand."
STATIC = ("map", "scene", "fence")  # parts of the world that do not move
FENCED = ("map", "fence")  # those that a geofence keeps out of
_CLOSED_SHARE = 0.005  # of the path: a course that ends so near to where it begins is closed


def wilson_interval(successes: int, n: int, confidence: float = 0.95) -> tuple[float, float]:
    """Confidence interval of a success rate by the score test; (0, 1) without trials.

    With z the normal quantile of (1 + confidence) / 2 and p = successes / n:
    (p + z^2/2n +- z sqrt(p (1 - p) / n + z^2/4n^2)) / (1 + z^2/n).

    Args:
        confidence: probability that the interval contains the rate, in (0, 1).

    Raises:
        InputError: not 0 <= successes <= n, or the confidence is not in (0, 1).

    Source: Wilson 1927.
    """
    if not (0 <= successes <= n) or not (0 < confidence < 1):
        raise InputError(f"no interval for {successes} of {n} at confidence {confidence}")
    if n == 0:
        return 0.0, 1.0
    z = NormalDist().inv_cdf((1 + confidence) / 2)
    p = successes / n
    centre = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n)) / (1 + z * z / n)
    lower = 0.0 if successes == 0 else max(0.0, centre - half)
    upper = 1.0 if successes == n else min(1.0, centre + half)
    return lower, upper


def success(good: int, n: int) -> dict[str, Any]:
    """Success rate with its 95 % Wilson interval, by the keys of a summary.

    Args:
        n: number of trials, at least one.
    """
    return {"success_rate": good / n, "success_interval": list(wilson_interval(good, n))}


def distinct(trials: Iterable[TrialResult]) -> list[TrialResult]:
    """The trials that differ in more than their index; the first of each kind.

    Trials with equal records are one flight, flown again: they add no evidence.
    """
    seen: dict[bytes, TrialResult] = {}
    for trial in trials:
        seen.setdefault(msgspec.json.encode(msgspec.structs.replace(trial, index=0)), trial)
    return list(seen.values())


def is_success(trial: TrialResult) -> bool:
    """True when the flight reached its goal without collision."""
    return trial.outcome == "reached" and not trial.collision


def head(
    trials: Collection[TrialResult],
    outcomes: Iterable[Outcome],
    is_good: Callable[[TrialResult], bool] = is_success,
) -> dict[str, Any]:
    """First keys of every summary: trials, success rate, collisions, and a count for each outcome.

    Where trials have identical records, `distinct_trials` counts the different ones and the interval is
    theirs; it is None where all are the same flight.

    Args:
        trials: verdicts, at least one.
    """
    found = success(sum(map(is_good, trials)), len(trials))
    different = distinct(trials)
    if len(different) < len(trials):
        of_them = success(sum(map(is_good, different)), len(different))
        found["success_interval"] = of_them["success_interval"] if len(different) > 1 else None
        found["distinct_trials"] = len(different)
    return {
        "trials": len(trials),
        **found,
        "collisions": sum(trial.collision for trial in trials),
        **{
            outcome.replace("-", "_"): sum(trial.outcome == outcome for trial in trials)
            for outcome in outcomes
        },
    }


def totals(trials: Iterable[TrialResult], names: Sequence[str]) -> dict[str, Any]:
    """Sums of fields over all trials; a missing field counts as 0."""
    each = list(trials)
    return {name: sum(getattr(trial, name) or 0 for trial in each) for name in names}


def mean_path_ratio(trials: Iterable[TrialResult]) -> float | None:
    """Mean path length over straight length of the successful trials; None without any."""
    return mean(ratio for t in trials if is_success(t) and (ratio := path_ratio(t)) is not None)


def path_ratio(trial: TrialResult) -> float | None:
    """Ratio of the length flown to the straight line from start to goal; None for a closed course."""
    straight = trial.straight_length_m
    is_closed = straight <= _CLOSED_SHARE * trial.path_length_m
    return None if is_closed else trial.path_length_m / straight


def clearance_of(trial: TrialResult, *parts: str) -> float | None:
    """Minimum clearance of a flight to some parts of the world [m]; None where none of them was judged.

    Args:
        parts: of "map", "scene", "fence" and "moving"; all by default.
    """
    return minimum(getattr(trial, f"{part}_clearance_m") for part in parts or (*STATIC, "moving"))


def minimum(values: Iterable[float | None]) -> float | None:
    """Minimum of the known values; None without any.

    Args:
        values: numbers, or None for an unknown one.
    """
    return min((value for value in values if value is not None), default=None)


def mean(values: Iterable[float | None]) -> float | None:
    """Mean of the known values; None without any.

    Args:
        values: numbers, or None for an unknown one.
    """
    known = [value for value in values if value is not None]
    return math.fsum(known) / len(known) if known else None


def statement(beforehand: str, judged: str, hits: int, trials: int, what: str, limits: str = "") -> str:
    """Guarantee of a run in words: what was guaranteed beforehand, what the judgement found, its limits.

    Args:
        beforehand: a sentence.
        judged: how the flights were judged, after "Judged".
        hits: number of trials that failed.
        trials: number of trials.
        what: the failure, after "... of 100".
        limits: sentences that follow.
    """
    return (
        f"{beforehand} Judged {judged}: {hits or 'none'} of {trials} {what}.{f' {limits}' if limits else ''}"
    )
