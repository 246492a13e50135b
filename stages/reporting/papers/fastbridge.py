"""Figures 2 to 4 of FastBridge as tables, from runs of many filters over the same start-goal pairs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.run import TrialResult
from alula.stages.reporting.papers.published import FASTBRIDGE
from alula.stages.reporting.papers.sweeps import (
    Comparison,
    Sweep,
    changed_parameters,
    compare,
    find,
    realisation_error,
    scenes_of,
    speeds_of,
    succeeded,
)
from alula.stages.reporting.statistics import Estimate, mean_estimate
from alula.stages.reporting.table import HIGH, LOW, Table
from alula.stages.verdict import wilson_interval

GAP_VARIANTS = ("ideal-di", "cone-di", "cone-ecbf")
BASELINE, OURS = "safer-splat", "cone-ecbf"
GATED = (
    "safer-splat-gated"  # rows of the nearest ellipsoids only, within the gate of the cones, as in the paper
)
COMPARED = (BASELINE, GATED, OURS, "cone-backup")


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
        "e_a is the acceleration of the body minus the commanded one, its peak over a flight. For a filter "
        "of wrenches the commanded acceleration is that of its thrust along the true axis, so only rotors "
        "and air leave a gap. γ is r'Ar - 1 of the ellipsoids as grown for the filter, below 0 inside one; "
        "the vehicle's sphere may still be clear there. ideal-di flies a double integrator, the others the "
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
                rows.append((scene, variant, speed, *_flown(sweep)))
    published, unknown = FASTBRIDGE["comparison"], (None,) * 12
    rows += [
        ("published", variant, *unknown, published[key], None)
        for variant, key in ((BASELINE, "baseline_top_speed_m_s"), (OURS, "top_speed_m_s"))
    ]
    columns = (
        *("scene", "filter", "reference speed [m/s]", *_ENDS),
        *("goal rate", LOW, HIGH, "mean jerk [m/s³]", LOW, HIGH),
        *("max jerk [m/s³]", "top speed [m/s]", "filter, mean [µs]"),
    )
    note = (
        "Same pairs, references, gains, rate and plant. Max jerk is the mean of the flights' maxima, top "
        f"speed the maximum of all flights. {BASELINE} has a row for every ellipsoid, as published; {GATED} "
        f"for the nearest within the gate of the cones, as in the paper's comparison. {_ENDS_NOTE}"
    )
    return Table("figure-3", "Figure 3: cone and distance, by reference speed", columns, tuple(rows), note)


def ratio_table(sweeps: Sequence[Sweep]) -> Table:
    """Compare the filters of Figure 3 pairwise over the same pairs, and add the published ratios."""
    rows: list[tuple[Any, ...]] = []
    for scene in scenes_of(sweeps):
        flown = _compared_in(sweeps, scene)
        speeds = speeds_of(sweeps, scene, flown)
        for ours in (v for v in flown if v not in (BASELINE, GATED)):
            for theirs in (v for v in flown if v in (BASELINE, GATED)):
                for at in [speeds] + [[speed] for speed in speeds if len(speeds) > 1]:
                    pair = [_at_all(sweeps, scene, variant, at) for variant in (ours, theirs)]
                    for words, only in (("all", None), ("both reached", succeeded)):
                        found = compare(pair[0], pair[1], only)
                        speed = at[0] if len(at) == 1 else "all"
                        rows.append((scene, f"{ours} : {theirs}", speed, words, *_compared(found)))
    p = FASTBRIDGE["comparison"]
    faster = p["top_speed_m_s"] - p["baseline_top_speed_m_s"]
    rows.append(
        (
            *("published", f"{OURS} : {BASELINE}", "all", "all", None, p["mean_jerk_ratio"], None, None),
            *(p["max_jerk_ratio"], p["time_ratio"], faster, None, None, None, None, None),
        )
    )
    columns = (
        *(
            "scene",
            "filters",
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
        "speeds is one draw of the bootstrap. The interval of equal values is unknown (–); that of a goal "
        "rate includes what this number of pairs cannot exclude. Both reached: only flights in which both "
        "filters reached the goal."
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


def _compared(found: Comparison) -> tuple[Any, ...]:
    return (
        found.top_speed.n if found.top_speed is not None else 0,
        *_of(found.mean_jerk),
        found.max_jerk.value if found.max_jerk is not None else None,
        found.filter_time,
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
        parameters = sweep.run.record.provenance.parameters.get("filter_parameters", {})
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
    """Summarise the comparison, one line per scene and baseline."""
    lines = {}
    for scene in scenes_of(sweeps):
        for theirs in (BASELINE, GATED):
            speeds = speeds_of(sweeps, scene, (theirs, OURS))
            if not speeds:
                continue
            found = compare(_at_all(sweeps, scene, OURS, speeds), _at_all(sweeps, scene, theirs, speeds))
            parts = []
            if (jerk := found.mean_jerk) is not None:
                parts.append(f"mean jerk × {jerk.value:.2f}{_interval(jerk, '.2f')}")
            if found.filter_time:
                parts.append(f"filter time × {found.filter_time:.2f}")
            if (goals := found.goals) is not None:
                parts.append(f"goal rate {100 * goals.value:+.1f} points{_interval(goals, '+.1f', 100)}")
            if (speed := found.top_speed) is not None:
                parts.append(f"top speed {speed.value:+.2f} m/s{_interval(speed, '+.2f')}")
            lines[f"{scene}, {OURS} against {theirs}"] = ", ".join(parts)
    return lines


def _interval(found: Estimate, digits: str, factor: float = 1.0) -> str:
    """The interval in brackets, or the reason why there is none."""
    if found.low is None or found.high is None:
        return f" (equal in all {found.n} pairs)" if found.n > 1 else " (one pair)"
    return f" ({factor * found.low:{digits}} to {factor * found.high:{digits}})"
