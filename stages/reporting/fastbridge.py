"""FastBridge's figures 2 to 4 as tables, from runs of many filters over the same start-goal pairs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.errors import InputError
from alula.schemas.run import TrialResult
from alula.stages.reporting.material import Run
from alula.stages.reporting.metrics import wilson_interval
from alula.stages.reporting.published import FASTBRIDGE
from alula.stages.reporting.statistics import Estimate, difference_estimate, mean_estimate, ratio_estimate
from alula.stages.reporting.tables import Table

FloatArray = NDArray[np.float64]

GAP_VARIANTS = ("ideal-di", "cone-di", "cone-ecbf")
BASELINE, OURS = "safer-splat", "cone-ecbf"
GATED = (
    "safer-splat-gated"  # rows of the nearest ellipsoids only, within the gate of the cones, as in the paper
)
COMPARED = (BASELINE, GATED, OURS, "cone-backup")


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

    def values(self, get: Callable[[TrialResult], float | None]) -> FloatArray:
        """A figure of each trial, shape (trials,), NaN where there is none."""
        return np.array([get(trial) for trial in self.run.record.trials], np.float64)

    def timing(self, key: str) -> float | None:
        """A measured time of the run [s], or count."""
        found = (self.run.record.timing or {}).get(key)
        return float(found) if found is not None else None


def find(sweeps: Iterable[Sweep], scene: str, variant: str, speed_m_s: float) -> Sweep | None:
    """The run of a variant, if there is one."""
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


def gap_table(sweeps: Sequence[Sweep]) -> Table:
    """Figure 2 as numbers: realisation error and least gamma by reference speed."""
    rows: list[tuple[Any, ...]] = []
    for scene in scenes_of(sweeps):
        for variant in GAP_VARIANTS:
            for sweep in sorted(
                (s for s in sweeps if s.scene == scene and s.variant == variant), key=lambda s: s.speed_m_s
            ):
                error = _finite(sweep.values(lambda t: t.peak_realisation_error_m_s2))
                gamma = _finite(sweep.values(lambda t: t.min_gamma))
                found = mean_estimate(error)
                rows.append(
                    (
                        *(scene, variant, sweep.speed_m_s, len(sweep.run.record.trials)),
                        *_of(found),
                        float(error.max()) if len(error) else None,
                        float(np.median(gamma)) if len(gamma) else None,
                        float(gamma.min()) if len(gamma) else None,
                        sum(t.collision for t in sweep.run.record.trials),
                        sum(t.outcome == "reached" for t in sweep.run.record.trials),
                    )
                )
    columns = (
        *("scene", "filter", "reference speed [m/s]", "trials"),
        *("peak |e_a|, mean [m/s²]", "95 % low", "95 % high", "largest"),
        *("least γ, median", "least γ of all", "collisions", "reached"),
    )
    note = (
        "e_a is the acceleration of the body less the one that was commanded, its peak over a flight; of a "
        "filter of wrenches the commanded one is that of its thrust along the true axis, so that only rotors "
        "and air leave a gap; γ is r'Ar - 1 of the ellipsoids as grown for the filter, below 0 inside one. "
        "ideal-di flies a double integrator, the others the rigid body."
    )
    return Table("figure-2", "Figure 2: the realisation gap", columns, tuple(rows), note)


@dataclass(frozen=True, slots=True)
class Comparison:
    """One filter against another over the same pairs; ratios are ours / baseline.

    Attributes:
        mean_jerk: ratio of the flights' mean jerk, by pairs.
        max_jerk: the same of their largest jerk.
        filter_time: ratio of the mean time of a filter's call; None where not measured.
        top_speed: difference of the largest speeds of the flights [m/s].
        goals: difference of the shares that reached the goal without collision.
    """

    mean_jerk: Estimate | None
    max_jerk: Estimate | None
    filter_time: float | None
    top_speed: Estimate | None
    goals: Estimate | None


def compare(
    ours: Sequence[Sweep], theirs: Sequence[Sweep], only: Callable[[TrialResult], bool] | None = None
) -> Comparison:
    """Compare runs one by one, by pairs of trials of which both are `only`, or by all.

    A pair of start and goal is one draw of the bootstrap with all of its speeds.

    Raises:
        InputError: trials of the same number do not have the same start and goal.
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

    def difference(get: Callable[[TrialResult], float | None]) -> Estimate | None:
        weight = both.sum(axis=0)[both.any(axis=0)]
        return difference_estimate(summed(ours, get) / weight, summed(theirs, get) / weight)

    return Comparison(
        ratio(lambda t: t.mean_jerk_m_s3),
        ratio(lambda t: t.max_jerk_m_s3),
        _time_ratio(ours, theirs),
        difference(lambda t: t.max_speed_m_s),
        difference(lambda t: float(succeeded(t))),
    )


def succeeded(trial: TrialResult) -> bool:
    """Whether a flight reached its goal without a collision."""
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


def comparison_table(sweeps: Sequence[Sweep]) -> Table:
    """Figure 3 as numbers: the filters by reference speed, then their ratios with intervals."""
    rows: list[tuple[Any, ...]] = []
    for scene in scenes_of(sweeps):
        flown = [v for v in COMPARED if any(s.scene == scene and s.variant == v for s in sweeps)]
        speeds = speeds_of(sweeps, scene, flown)
        for speed in speeds:
            for variant in flown:
                sweep = find(sweeps, scene, variant, speed)
                assert sweep is not None
                rows.append((scene, variant, speed, *_flown(sweep)))
        for ours in (v for v in flown if v not in (BASELINE, GATED)):
            for theirs in (v for v in flown if v in (BASELINE, GATED)):
                pair = [_at_all(sweeps, scene, variant, speeds) for variant in (ours, theirs)]
                for words, only in (("all flights", None), ("both reached", succeeded)):
                    found = compare(pair[0], pair[1], only)
                    rows.append((scene, f"{ours} / {theirs}, {words}", "all", *_compared(found)))
    published = FASTBRIDGE["comparison"]
    rows.append(
        (
            "published",
            f"{OURS} / {BASELINE}",
            "all",
            *(None, None, None, published["mean_jerk_ratio"], None, None, published["max_jerk_ratio"]),
            *(published["top_speed_m_s"], published["time_ratio"], None),
        )
    )
    columns = (
        *("scene", "filter", "reference speed [m/s]", "goal rate", "95 % low", "95 % high"),
        *("mean jerk [m/s³]", "95 % low", "95 % high", "max jerk [m/s³]", "top speed [m/s]"),
        *("filter, mean [µs]", "collisions"),
    )
    note = (
        "Same pairs, references, gains, rate and plant. In the rows of ratios jerk and time are ours over "
        "the baseline's, goal rate and top speed differences; intervals are bootstrapped over pairs. "
        f"{BASELINE} has a row for every ellipsoid, as published; {GATED} for the nearest within the gate of "
        "the cones, as in the paper's comparison. Goal rate: reached the goal without a collision."
    )
    return Table(
        "figure-3", "Figure 3: cone against distance, by reference speed", columns, tuple(rows), note
    )


def _at_all(sweeps: Sequence[Sweep], scene: str, variant: str, speeds: Sequence[float]) -> list[Sweep]:
    return [s for v in speeds if (s := find(sweeps, scene, variant, v)) is not None]


def _flown(sweep: Sweep) -> tuple[Any, ...]:
    trials = sweep.run.record.trials
    good = sum(succeeded(t) for t in trials)
    jerk = mean_estimate(_finite(sweep.values(lambda t: t.mean_jerk_m_s3)))
    total, calls = sweep.timing("filter_total_s"), sweep.timing("filter_calls")
    return (
        *(good / len(trials), *wilson_interval(good, len(trials))),
        *_of(jerk),
        float(np.mean(sweep.values(lambda t: t.max_jerk_m_s3))),
        max(t.max_speed_m_s for t in trials),
        1e6 * total / calls if total is not None and calls else None,
        sum(t.collision for t in trials),
    )


def _compared(found: Comparison) -> tuple[Any, ...]:
    return (
        *_of(found.goals),
        *_of(found.mean_jerk),
        found.max_jerk.value if found.max_jerk is not None else None,
        found.top_speed.value if found.top_speed is not None else None,
        found.filter_time,
        None,
    )


def _of(found: Estimate | None) -> tuple[float | None, ...]:
    return (None, None, None) if found is None else (found.value, found.low, found.high)


def flight_table(sweeps: Sequence[Sweep], name: str, title: str, *, published: bool = False) -> Table:
    """Figure 4's table: loop timing, feasibility and motion, one row per run; and the published row."""
    rows: list[tuple[Any, ...]] = []
    for sweep in sweeps:
        trials = sweep.run.record.trials
        ticks = sum(t.steps for t in trials)
        infeasible = sum(t.infeasible_steps for t in trials)
        good = sum(succeeded(t) for t in trials)
        clearance = _finite(sweep.values(lambda t: t.scene_clearance_m))
        seconds = sum(t.duration_s for t in trials)
        jerk = float(np.mean(sweep.values(lambda t: t.mean_jerk_m_s3)))
        rows.append(
            (
                *(sweep.scene, sweep.variant, sweep.speed_m_s, len(trials)),
                *(good / len(trials), *wilson_interval(good, len(trials))),
                sum(t.collision for t in trials),
                float(clearance.min()) if len(clearance) else None,
                *(_micro(sweep.timing(f"tick_{key}_s")) for key in ("max", "p99", "mean")),
                _micro(sweep.timing("filter_p99_s")),
                sweep.timing("overruns"),
                ticks,
                1 - infeasible / ticks if ticks else None,
                infeasible,
                _share(sum(t.backup_steps or 0 for t in trials), ticks),
                _share(sum(t.certified_steps or 0 for t in trials), ticks),
                sum(t.path_length_m for t in trials) / seconds if seconds > 0 else None,
                max(t.max_speed_m_s for t in trials),
                jerk,
            )
        )
    columns = (
        *("scene", "filter", "reference speed [m/s]", "trials", "goal rate", "95 % low", "95 % high"),
        *("collisions", "least clearance [m]", "loop max [µs]", "loop p99 [µs]", "loop mean [µs]"),
        *("filter p99 [µs]", "overruns", "ticks", "feasible ticks", "infeasible"),
        *("on the backup", "certified", "mean speed [m/s]", "top speed [m/s]", "mean jerk [m/s³]"),
    )
    note = (
        "The loop is controller and filter together, measured on this machine; a tick is feasible when "
        "the program has a solution, certified when a safe backup manoeuvre was proven to remain after it."
    )
    return Table(name, title, columns, (*rows, *([_published_flight()] if published else [])), note)


def _published_flight() -> tuple[Any, ...]:
    f = FASTBRIDGE["flight"]
    return (
        *("published (hardware)", "cone-backup", None, 1, None, None, None, 0, f["min_clearance_m"]),
        *(f["loop_max_us"], f["loop_p99_us"], f["loop_mean_us"], None, f["overruns"], f["ticks"]),
        *(f["feasible"], f["infeasible"], None, None, f["mean_speed_m_s"], f["max_speed_m_s"], None),
    )


def _micro(seconds: float | None) -> float | None:
    return None if seconds is None else 1e6 * seconds


def _share(count: int, of: int) -> float | None:
    return count / of if of else None


def _finite(values: FloatArray) -> FloatArray:
    return values[np.isfinite(values)]


def in_short(sweeps: Sequence[Sweep]) -> dict[str, str]:
    """A line for each scene and baseline: what the comparison says."""
    lines = {}
    for scene in scenes_of(sweeps):
        for theirs in (BASELINE, GATED):
            speeds = speeds_of(sweeps, scene, (theirs, OURS))
            if not speeds:
                continue
            found = compare(_at_all(sweeps, scene, OURS, speeds), _at_all(sweeps, scene, theirs, speeds))
            parts = []
            if (jerk := found.mean_jerk) is not None:
                parts.append(f"mean jerk {jerk.value:.2f} times its ({jerk.low:.2f} to {jerk.high:.2f})")
            if found.filter_time:
                parts.append(f"filter {1 / found.filter_time:.1f} times as fast")
            if found.goals is not None:
                parts.append(
                    f"goal rate {100 * found.goals.value:+.1f} points ({100 * found.goals.low:+.1f} to "
                    f"{100 * found.goals.high:+.1f})"
                )
            if found.top_speed is not None:
                parts.append(f"top speed {found.top_speed.value:+.2f} m/s")
            lines[f"{scene}, {OURS} against {theirs}"] = ", ".join(parts)
    return lines
