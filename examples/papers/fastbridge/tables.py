"""Figures 2 to 4 of FastBridge as tables, from runs of many filters over the same start-goal pairs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.log.run import TrialResult
from alula.stages.reporting.statistics import Estimate, mean_estimate
from alula.stages.reporting.table import HIGH, LOW, Table
from alula.stages.verdict import wilson_interval
from papers.fastbridge.sweeps import (
    Comparison,
    Sweep,
    changed_parameters,
    compare,
    filter_parameters,
    find,
    realisation_error,
    scenes_of,
    speeds_of,
    succeeded,
)
from papers.published import FASTBRIDGE

GAP_VARIANTS = ("ideal-di", "cone-di", "cone-ecbf", "cone-backup", "safer-splat", "safer-splat-gated")
BASELINE, OURS = "safer-splat", "cone-ecbf"
# The methods of Figure 3, in the order of its table, and whose settings they fly.
SETTINGS = {
    "safer-splat": "published",
    "safer-splat-gated": "published, gate 2 s ahead",
    "safer-splat-gated-3m": "published, gate 3 m",
    "safer-splat-gated-cones": "published, gate of the cones",
    "safer-splat-tuned": "tuned",
    "safer-splat-gated-tuned": "tuned",
    "cone-di": "ours",
    "cone-di-tuned": "tuned",
    "cone-ecbf": "ours",
    "ecbf-gate-3m": "ours, gate 3 m",
    "cone-ecbf-tuned": "tuned",
    "cone-backup": "ours",
    "cone-backup-tuned": "tuned",
}
COMPARED = tuple(SETTINGS)
# Pairs that are compared, and whose ellipsoids have rows. Times compare only filters with rows within a gate.
SAME_RADIUS, TUNED = ("ecbf-gate-3m", "safer-splat-gated-3m"), ("cone-ecbf-tuned", "safer-splat-gated-tuned")
PAIRED = {
    SAME_RADIUS: "the same radius of 3 m, as in the paper",
    ("cone-ecbf", "safer-splat-gated"): "each its own gate",
    ("cone-ecbf", "safer-splat-gated-cones"): "the gate of the cones",
    TUNED: "each tuned, its own gate",
    ("cone-backup-tuned", "safer-splat-gated-tuned"): "each tuned, its own gate",
    ("cone-di-tuned", "safer-splat-gated-tuned"): "each tuned, its own gate",
    ("cone-ecbf", "safer-splat"): "a row for every ellipsoid in the second",
    ("cone-ecbf-tuned", "safer-splat-tuned"): "each tuned, a row for every ellipsoid in the second",
    ("cone-backup-tuned", "safer-splat-tuned"): "each tuned, a row for every ellipsoid in the second",
}


def gap_table(sweeps: Sequence[Sweep]) -> Table:
    """Tabulate Figure 2: realisation error and minimum gamma by reference speed."""
    rows: list[tuple[Any, ...]] = []
    for scene in scenes_of(sweeps):
        for variant in GAP_VARIANTS:
            for sweep in sorted(
                (s for s in sweeps if s.scene == scene and s.variant == variant), key=lambda s: s.speed_m_s
            ):
                error = _finite(sweep.values(realisation_error))
                gamma = _finite(sweep.values(lambda t: t.min_gamma))
                rows.append(
                    (
                        *(scene, variant, sweep.speed_m_s, *_ends(sweep.run.record.trials)),
                        *_of(mean_estimate(error)),
                        float(error.max()) if len(error) else None,
                        float(np.median(gamma)) if len(gamma) else None,
                        float(gamma.min()) if len(gamma) else None,
                    )
                )
    columns = (
        *("scene", "filter", "reference speed [m/s]", *_ENDS),
        *("peak |e_a|, mean [m/s²]", LOW, HIGH, "maximum"),
        *("minimum γ, median", "minimum γ of all"),
    )
    note = (
        "e_a is the realisation error of eqs. 11 and 12, its peak over a flight: the acceleration of "
        "the body minus the commanded one, which is held for a tick. For a filter of accelerations the "
        "command is its own; for one of wrenches (cone-ecbf, cone-backup) it is -g e3 + T/m R'e3 of its "
        "thrust along the axis that it saw, so the turn of the axis within the tick, rotors and air "
        "count. γ is r'Ar - 1 of the ellipsoids as grown for the filter, below 0 inside one; the "
        "vehicle's sphere may still be clear there. ideal-di flies a double integrator, the others the "
        f"rigid body. {_ENDS_NOTE}"
    )
    return Table("figure-2", "Figure 2: the realisation gap", columns, tuple(rows), note)


def comparison_table(sweeps: Sequence[Sweep]) -> Table:
    """Tabulate Figure 3: the filters by reference speed, and the published speeds."""
    rows: list[tuple[Any, ...]] = []
    for scene in scenes_of(sweeps):
        flown = _compared_in(sweeps, scene)
        for speed in speeds_of(sweeps, scene, flown):
            for variant in flown:
                sweep = find(sweeps, scene, variant, speed)
                assert sweep is not None
                rows.append((scene, variant, SETTINGS[variant], speed, *_flown(sweep)))
    published, unknown = FASTBRIDGE["comparison"], (None,) * 12
    rows += [
        ("published", variant, "published", *unknown, published[key], None)
        for variant, key in ((BASELINE, "baseline_top_speed_m_s"), (OURS, "top_speed_m_s"))
    ]
    columns = (
        *("scene", "filter", "settings", "reference speed [m/s]", *_ENDS),
        *("goal rate", LOW, HIGH, "mean jerk [m/s³]", LOW, HIGH),
        *("max jerk [m/s³]", "top speed [m/s]", "filter, mean [µs]"),
    )
    note = (
        "Same pairs, references, tracking gains, rate and plant. Max jerk is the mean of the flights' "
        f"maxima, top speed the maximum of all flights. {BASELINE} has a row for every ellipsoid, as "
        "published, safer-splat-gated for those within a gate, as the paper compares; the paper does "
        "not print its radius. Settings: published by the method's authors, ours (the defaults of "
        f"alula), or tuned by the search below. {_ENDS_NOTE}"
    )
    return Table("figure-3", "Figure 3: cone and distance, by reference speed", columns, tuple(rows), note)


def ratio_table(sweeps: Sequence[Sweep]) -> Table:
    """Compare the filters of Figure 3 pairwise over the same pairs, and add the published ratios."""
    rows: list[tuple[Any, ...]] = []
    for scene in scenes_of(sweeps):
        for pair, words in PAIRED.items():
            speeds = speeds_of(sweeps, scene, pair)
            for at in ([speeds] if speeds else []) + [[speed] for speed in speeds if len(speeds) > 1]:
                ours, theirs = (_at_all(sweeps, scene, variant, at) for variant in pair)
                for flights, only in (("all", None), ("both reached", succeeded)):
                    found = compare(ours, theirs, only)
                    speed = at[0] if len(at) == 1 else "all"
                    rows.append((scene, " : ".join(pair), words, speed, flights, *_compared(found, pair)))
    p = FASTBRIDGE["comparison"]
    faster = p["top_speed_m_s"] - p["baseline_top_speed_m_s"]
    rows.append(
        (
            *("published", f"{OURS} : {BASELINE}", "the same radius, not printed", "all", "all", None),
            *(p["mean_jerk_ratio"], None, None),
            *(p["max_jerk_ratio"], p["time_ratio"], faster, None, None, None, None, None),
        )
    )
    columns = (
        *(
            "scene",
            "filters",
            "maps",
            "reference speed [m/s]",
            "flights",
            "pairs",
            "mean jerk, ratio",
            LOW,
            HIGH,
        ),
        *("max jerk, ratio", "filter time, ratio", "top speed, difference [m/s]", LOW, HIGH),
        *("goal rate, difference", LOW, HIGH),
    )
    note = (
        "Ratio or difference of the first filter to the second, at all reference speeds together and at "
        "each: a ratio below 1 is smoother, or faster to compute. A pair of start and goal with all its "
        "speeds is one draw of the bootstrap. The interval of equal values is unknown (–); that of a "
        "goal rate includes what this number of pairs cannot exclude. Both reached: only flights in "
        "which both filters reached the goal. The filter's time is compared only where both have rows "
        "within a gate: the time of a filter that bounds every ellipsoid of the map buys something "
        "else."
    )
    return Table("figure-3-ratios", "Figure 3: cone against distance", columns, tuple(rows), note)


def _compared_in(sweeps: Sequence[Sweep], scene: str) -> list[str]:
    return [v for v in COMPARED if any(s.scene == scene and s.variant == v for s in sweeps)]


def _at_all(sweeps: Sequence[Sweep], scene: str, variant: str, speeds: Sequence[float]) -> list[Sweep]:
    return [s for v in speeds if (s := find(sweeps, scene, variant, v)) is not None]


def _flown(sweep: Sweep) -> tuple[Any, ...]:
    trials = sweep.run.record.trials
    good = sum(succeeded(t) for t in trials)
    jerk = mean_estimate(_finite(sweep.values(lambda t: t.mean_jerk_m_s3)))
    total, calls = sweep.timing("filter_total_s"), sweep.timing("filter_calls")
    return (
        *_ends(trials),
        *(good / len(trials), *wilson_interval(good, len(trials))),
        *_of(jerk),
        float(np.mean(sweep.values(lambda t: t.max_jerk_m_s3))),
        max(t.max_speed_m_s for t in trials),
        1e6 * total / calls if total is not None and calls else None,
    )


def is_alike(pair: Sequence[str]) -> bool:
    """Return whether the rows of both filters are of ellipsoids within a gate, so that times compare."""
    return not any(variant in (BASELINE, f"{BASELINE}-tuned") for variant in pair)


def _compared(found: Comparison, pair: Sequence[str]) -> tuple[Any, ...]:
    return (
        found.top_speed.n if found.top_speed is not None else 0,
        *_of(found.mean_jerk),
        found.max_jerk.value if found.max_jerk is not None else None,
        found.filter_time if is_alike(pair) else None,
        *_of(found.top_speed),
        *_of(found.goals),
    )


def _of(found: Estimate | None) -> tuple[float | None, ...]:
    return (None, None, None) if found is None else (found.value, found.low, found.high)


_ENDS = ("trials", "reached", "collided", "neither")
_ENDS_NOTE = (
    "Reached: reached the goal without a collision; collided: came closer to an ellipsoid than the vehicle's "
    "radius, wherever the flight ended; neither: stuck, out of time, or refused."
)


def _ends(trials: Sequence[TrialResult]) -> tuple[int, int, int, int]:
    """Count the flights and how they ended; each flight counts once."""
    reached, collided = sum(succeeded(t) for t in trials), sum(t.collision for t in trials)
    return len(trials), reached, collided, len(trials) - reached - collided


def flight_tables(
    sweeps: Sequence[Sweep],
    name: str,
    title: str,
    *,
    published: bool = False,
    bases: Sequence[Sweep] = (),
) -> tuple[Table, Table]:
    """Tabulate Figure 4, one row per run and the published row: first the flights, then the control loop.

    Args:
        sweeps: runs, in the order of the rows.
        name: of the first table; the second is NAME-loop.
        title: start of both titles.
        published: add the published row.
        bases: runs to compare with; a column lists the parameters that differ from those of the run with the
            same filter, scene and speed.
    """
    flights: list[tuple[Any, ...]] = []
    loops: list[tuple[Any, ...]] = []
    for sweep in sweeps:
        trials = sweep.run.record.trials
        ticks = sum(t.steps for t in trials)
        infeasible = sum(t.infeasible_steps for t in trials)
        good = sum(succeeded(t) for t in trials)
        clearance = _finite(sweep.values(lambda t: t.scene_clearance_m))
        seconds = sum(t.duration_s for t in trials)
        which = (sweep.scene, sweep.variant, sweep.speed_m_s)
        parameters = filter_parameters(sweep.run)
        backup, certified = (
            sum(t.backup_steps or 0 for t in trials),
            sum(t.certified_steps or 0 for t in trials),
        )
        flights.append(
            (
                *(*which, *_ends(trials), good / len(trials), *wilson_interval(good, len(trials))),
                float(clearance.min()) if len(clearance) else None,
                sum(t.path_length_m for t in trials) / seconds if seconds > 0 else None,
                max(t.max_speed_m_s for t in trials),
                float(np.mean(sweep.values(lambda t: t.mean_jerk_m_s3))),
                *([_changed(sweep, bases)] if bases else []),
            )
        )
        loops.append(
            (
                *(*which, ticks, infeasible, _fraction(ticks - infeasible, ticks)),
                _fraction(backup, ticks) if "policy" in parameters else None,
                _fraction(certified, ticks) if parameters.get("shield") else None,
                *(_micro(sweep.timing(f"tick_{key}_s")) for key in ("mean", "p99", "max")),
                sweep.timing("overruns"),
                _micro(sweep.timing("filter_p99_s")),
            )
        )
    if published:
        f, hardware = FASTBRIDGE["flight"], ("published (hardware)", "cone-backup", None)
        flights.append(
            (
                *(*hardware, 1, None, 0, None, None, None, None),
                *(f["min_clearance_m"], f["mean_speed_m_s"], f["max_speed_m_s"], None),
            )
        )
        loops.append(
            (
                *(*hardware, f["ticks"], f["infeasible"], f["feasible"], None, None),
                *(f["loop_mean_us"], f["loop_p99_us"], f["loop_max_us"], f["overruns"], None),
            )
        )
    columns = (
        *("scene", "filter", "reference speed [m/s]", *_ENDS, "goal rate", LOW, HIGH),
        *("minimum clearance [m]", "mean speed [m/s]", "top speed [m/s]", "mean jerk [m/s³]"),
        *(["changed"] if bases else []),
    )
    loop_columns = (
        *("scene", "filter", "reference speed [m/s]", "ticks", "infeasible", "feasible, fraction"),
        *("on the backup, fraction", "certified, fraction"),
        *("loop mean [µs]", "loop p99 [µs]", "loop max [µs]", "overruns", "filter p99 [µs]"),
    )
    note = f"Clearance is that of the vehicle's sphere over all flights, below 0 in a collision. {_ENDS_NOTE}"
    loop_note = (
        "The loop is controller and filter together, measured on this machine; an overrun took longer than a "
        "tick. Feasible: the program of the tick has a solution. Certified: a safe backup manoeuvre was "
        "proven to remain after the tick. On the backup: the input of the backup policy was flown, or a "
        "blend of it with the nominal input. Both are unknown (–) for a filter without a policy or a shield."
    )
    return (
        Table(name, f"{title}: flights", columns, tuple(flights), note),
        Table(f"{name}-loop", f"{title}: loop and program", loop_columns, tuple(loops), loop_note),
    )


def _changed(sweep: Sweep, bases: Sequence[Sweep]) -> str | None:
    same = [b for b in bases if b.run.record.filter == sweep.run.record.filter]
    base = next((b for b in same if (b.scene, b.speed_m_s) == (sweep.scene, sweep.speed_m_s)), None)
    return None if base is None else changed_parameters(sweep, base) or "–"


def _micro(seconds: float | None) -> float | None:
    return None if seconds is None else 1e6 * seconds


def _fraction(count: int, of: int) -> float | None:
    return count / of if of else None


def _finite(values: FloatArray) -> FloatArray:
    return values[np.isfinite(values)]


def in_short(sweeps: Sequence[Sweep]) -> dict[str, str]:
    """Summarise the comparison, one line per scene and pair of filters."""
    lines = {}
    for scene in scenes_of(sweeps):
        for pair, words in PAIRED.items():
            speeds = speeds_of(sweeps, scene, pair)
            if not speeds:
                continue
            ours, theirs = (_at_all(sweeps, scene, variant, speeds) for variant in pair)
            found = compare(ours, theirs)
            parts = []
            if (jerk := found.mean_jerk) is not None:
                parts.append(f"mean jerk × {jerk.value:.2f}{_interval(jerk, '.2f')}")
            if found.filter_time and is_alike(pair):
                parts.append(f"filter time × {found.filter_time:.2f}")
            if (goals := found.goals) is not None:
                parts.append(f"goal rate {100 * goals.value:+.1f} points{_interval(goals, '+.1f', 100)}")
            if (speed := found.top_speed) is not None:
                parts.append(f"top speed {speed.value:+.2f} m/s{_interval(speed, '+.2f')}")
            hits = [
                sum(sum(t.collision for t in s.run.record.trials) for s in _at_all(sweeps, scene, v, speeds))
                for v in pair
            ]
            parts.append(f"collisions {hits[0]} against {hits[1]}")
            lines[f"{scene}, {pair[0]} against {pair[1]} ({words})"] = ", ".join(parts)
    return lines


def _interval(found: Estimate, digits: str, factor: float = 1.0) -> str:
    """The interval in brackets, or the reason why there is none."""
    if found.low is None or found.high is None:
        return f" (equal in all {found.n} pairs)" if found.n > 1 else " (one pair)"
    return f" ({factor * found.low:{digits}} to {factor * found.high:{digits}})"
