"""Tables I to V of DR-ACBF from runs of encounters, and tables of solvers, corridor and free choices.

Runs of one scenario fly the same trials: obstacles, sensor noise and clutter are functions of (seed, trial).
The module is long because it is one page: each table is one function and its note.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from alula.schemas.log.run import ObstacleResult, RunRecord, TrialResult
from alula.schemas.parameters.filter_options import TABLES
from alula.stages.reporting.statistics import Rate, mean_of, rate
from alula.stages.reporting.table import HIGH, LOW, Table, flat, text
from papers.published import DRACBF

FREE, BASE = "none", "dr-acbf"  # variants: without a filter, and as specified
METHODS = (FREE, BASE, "dr-acbf-gs", "dr-acbf-qp", "mpc", "cbf-qp", "rp-cbf")
SWEEP = (BASE, "h-max-0.2", "h-max-0.8", "clearance-1", "clearance-4", "hold-0.1", "hold-0.4")
TRIGGERS = (BASE, "trigger-simple", "rows-late", "trigger-simple-rows-late", "trigger-simple-long")
PRINTED = (BASE, "eq-19", "eq-24", "safe-imm-on", "all-as-printed")
HARDWARE = {
    "table-4": ("Table IV: a small vehicle and one obstacle", ("thrown", "moving")),
    "table-5": ("Table V: a small vehicle and two obstacles", ("both", "approaching")),
}
SOLVERS = ("dr-acbf-gs", BASE, "dr-acbf-qp")


@dataclass(frozen=True, slots=True)
class Flown:
    """One run: trials of one variant of a filter in one scenario; the scenario is the folder's name."""

    scenario: str
    variant: str
    record: RunRecord

    @property
    def file(self) -> str:
        """Its log below the example's output folder."""
        return f"{self.scenario}/{self.variant}.run.mcap"

    @property
    def flights(self) -> int:
        """Number of flights."""
        return len(self.record.trials)

    @property
    def obstacles(self) -> int:
        """Number of obstacles."""
        return len(self.record.trials[0].obstacles or [])

    def met(self, obstacle: int) -> list[ObstacleResult]:
        """Results of all trials for one obstacle."""
        return [(trial.obstacles or [])[obstacle] for trial in self.record.trials]

    def mean(self, obstacle: int, get: Callable[[ObstacleResult], float | None]) -> float | None:
        """Mean of a value over the trials that have it."""
        return mean_of(get(met) for met in self.met(obstacle))

    def timing(self, key: str, obstacle: int | None = None) -> float | None:
        """A measured time [s] or count; None where it was not measured."""
        found = (self.record.timing or {}).get(key)
        if obstacle is not None and found is not None:
            found = found[obstacle]
        return None if found is None else float(found)

    @property
    def dt_s(self) -> float:
        """Length of a tick [s]."""
        rules = self.record.provenance.parameters.get("rules", {})
        return float(rules.get("dt_s", 0.01))


def success(flown: Flown, obstacle: int | None = None) -> Rate:
    """Percentage of trials without a collision.

    Args:
        flown: the run.
        obstacle: index from 0; only collisions with it count. None: with any obstacle.
    """
    if obstacle is None:
        return rate(not trial.collision for trial in flown.record.trials)
    return rate(not met.collision for met in flown.met(obstacle))


def avoided(flown: Flown, free: Flown | None, obstacle: int) -> Rate | None:
    """Percentage without a collision among the trials that hit the obstacle without a filter.

    Args:
        flown: the run with a filter.
        free: the same trials without a filter; None where they were not flown.
        obstacle: index from 0.
    """
    if free is None:
        return None
    pairs = zip(flown.met(obstacle), free.met(obstacle), strict=False)
    return rate(not mine.collision for mine, other in pairs if other.collision)


def select(flown: Sequence[Flown], scenario: str, variants: Sequence[str] | None = None) -> list[Flown]:
    """Select the runs of a scenario: those of the variants, in their order, or all."""
    here = [f for f in flown if f.scenario == scenario]
    if variants is None:
        return here
    return [f for name in variants for f in here if f.variant == name]


def find(flown: Iterable[Flown], scenario: str, variant: str) -> Flown | None:
    """Find the run of a variant; None when there is none."""
    return next((f for f in flown if (f.scenario, f.variant) == (scenario, variant)), None)


def changed(flown: Flown, base: Flown | None) -> str:
    """List in words the parameters that differ from those of `base`."""
    if base is None:
        return ""
    ours, theirs = (flat(f.record.provenance.parameters) for f in (flown, base))
    keys = sorted(
        key for key in ours.keys() | theirs.keys() if key != "name" and ours.get(key) != theirs.get(key)
    )
    own = f"safety.{TABLES.get(flown.record.filter, flown.record.filter)}."
    return ", ".join(f"{key.removeprefix(own)} {text(ours.get(key))}" for key in keys)


def success_table(
    runs: Sequence[Flown],
    name: str,
    title: str,
    *,
    free: Flown | None = None,
    published: Mapping[str, Mapping[str, float]] | None = None,
) -> Table:
    """Compare the success of each run by obstacle and by trial [%] with the published values.

    Args:
        runs: one row each.
        name: of the table.
        title: of the table.
        free: the run without a filter; with it, columns for the hits that a filter avoids.
        published: values by variant and key, as in `DRACBF`.
    """
    count = max((f.obstacles for f in runs), default=0)
    keys = [f"success_{i + 1}" for i in range(count)] + ["success_mean"]
    printed = {} if published is None else published
    shown = [key for key in keys if any(key in values for values in printed.values())]
    rows = []
    for f in runs:
        per = [success(f, i) for i in range(f.obstacles)]
        row: list[Any] = [f.variant, len(f.record.trials)]
        for i, each in enumerate(per):
            row += each.cells
            if free is not None:
                found = avoided(f, free, i)
                row.append(None if found is None else found.value)
        row += [mean_of(each.value for each in per), *success(f).cells]
        row += [printed.get(f.variant, {}).get(key) for key in shown]
        rows.append(tuple(row))
    columns = ["variant", "trials"]
    for i in range(count):
        columns += [f"obstacle {i + 1} [%]", LOW, HIGH]
        columns += [f"unfiltered hits avoided, {i + 1} [%]"] if free is not None else []
    columns += ["mean of obstacles [%]", "runs [%]", LOW, HIGH]
    columns += [f"published: {key.removeprefix('success_')} [%]" for key in shown]
    note = (
        "Success for an obstacle: the true path never touches it, also between ticks. Success of a run: no "
        "obstacle is touched. Intervals are Wilson intervals. All variants fly the same trials."
    )
    return Table(name, title, tuple(columns), tuple(rows), note)


def time_table(
    runs: Sequence[Flown],
    name: str,
    title: str,
    published: Mapping[str, Mapping[str, float]] | None = None,
) -> Table:
    """Compare processing, command and reaction times [ms] with the published ones.

    Ratios are those to the first run.

    Args:
        runs: one row each.
        name: of the table.
        title: of the table.
        published: values by variant and key, as in `DRACBF`.
    """
    printed = {} if published is None else published
    first = milli(runs[0].timing("filter_p50_s")) if runs else None
    paper = printed.get(runs[0].variant, {}).get("tick") if runs else None
    rows = []
    for f in runs:
        ms = [milli(f.timing(f"filter_{key}_s")) for key in ("p50", "mean", "std", "p99")]
        command = mean_of(f.timing("command_mean_s", i) for i in range(f.obstacles))
        reaction = mean_of(f.timing("reaction_mean_s", i) for i in range(f.obstacles))
        values = printed.get(f.variant, {})
        rows.append(
            (
                *(f.variant, f.timing("filter_calls"), *ms, _over(ms[0], first)),
                *(milli(command), milli(reaction), milli(reaction_in_ticks(f))),
                *(values.get("tick"), values.get("tick_std"), _over(values.get("tick"), paper)),
                *(values.get("command"), values.get("reaction")),
            )
        )
    columns = (
        *("variant", "active ticks", "t_cp p50 [ms]", "t_cp mean [ms]", "t_cp std [ms]", "t_cp p99 [ms]"),
        *("p50 / first row", "t_cm [ms]", "t_r [ms]", "t_r in whole ticks [ms]"),
        *("published: t_cp mean", "published: std", "published: mean / first row"),
        *("published: t_cm", "published: t_r"),
    )
    note = (
        "t_cp: time of the filter in a tick with a warning or a manoeuvre; t_cm: in the tick of the warning; "
        "t_r: with the simulated time until the command differs from the nominal one. Measured during the "
        "trials, on a machine that also ran other programs; benchmarks/dracbf.py times the filters side by "
        "side."
    )
    return Table(name, title, columns, tuple(rows), note)


def reaction_in_ticks(flown: Flown) -> float | None:
    """Mean time from a warning to the end of the first tick with a changed command, in whole ticks [s]."""
    dt = flown.dt_s
    met = [m for i in range(flown.obstacles) for m in flown.met(i)]
    return mean_of(None if m.reaction_s is None else (round(m.reaction_s / dt) + 1) * dt for m in met)


def separation_table(
    runs: Sequence[Flown],
    name: str,
    title: str,
    published: Mapping[str, Mapping[str, float]] | None = None,
) -> Table:
    """Compare closing speed and separation per obstacle, over the avoidance window and over the run.

    Args:
        runs: one row per run and obstacle.
        name: of the table.
        title: of the table.
        published: values by variant and key, as in `DRACBF`.
    """
    printed = {} if published is None else published
    rows = []
    for f in runs:
        infeasible, worst = _missed(f)
        for i in range(f.obstacles):
            values = printed.get(f.variant, {})
            rows.append(
                (
                    *(f.variant, i + 1, sum(m.warned_s is not None for m in f.met(i))),
                    f.mean(i, lambda m: m.closing_m_s),
                    f.mean(i, lambda m: m.separation_m),
                    f.mean(i, lambda m: m.closest_m),
                    min(m.closest_m for m in f.met(i)),
                    infeasible,
                    worst,
                    values.get(f"closing_{i + 1}", values.get("closing_mean")),
                    values.get(f"separation_{i + 1}", values.get("separation_mean")),
                )
            )
    columns = (
        *("variant", "obstacle", "warnings", "v_cl at the warning [m/s]", "d_s, avoidance window [m]"),
        *("d_cpa, whole run [m]", "minimum distance [m]", "ticks with infeasible rows [%]"),
        *("worst violation [m/s²]", "published: v_cl", "published: d_s"),
    )
    note = (
        "d_s is the mean over trials with a warning of the minimum distance from an obstacle's first warning "
        "to the end of hovering; d_cpa is the mean over all trials of the minimum distance in the whole run. "
        "Published values of Table II are means of both obstacles. Infeasible rows: no command satisfies all "
        "of them; the percentage is of all ticks. The worst violation is that of the method's rows by the "
        "flown command, as an acceleration: for mpc the one that compensates its slack over the horizon, for "
        "cbf-qp the missed velocity divided by its time constant."
    )
    return Table(name, title, columns, tuple(rows), note)


def _missed(flown: Flown) -> tuple[float | None, float | None]:
    """Percentage of ticks with infeasible rows, and the worst violation [m/s^2]; None without rows."""
    if flown.variant == FREE:
        return None, None
    trials = flown.record.trials
    steps = sum(trial.steps for trial in trials)
    worst = max((trial.worst_violation_m_s2 or 0.0 for trial in trials), default=0.0)
    return _over(100.0 * sum(trial.infeasible_steps for trial in trials), steps or None), worst


def effort(flown: Sequence[Flown]) -> str:
    """State the number of trials and the time they took."""
    flights = [(f.timing("trials_flown"), f.timing("wall_s")) for f in flown]
    timed = [(count, seconds) for count, seconds in flights if count is not None and seconds]
    total = sum(len(f.record.trials) for f in flown)
    seconds = math.fsum(seconds for _, seconds in timed)
    if not seconds:
        return f"{total:,} trials in {len(flown)} runs"
    speed = sum(count for count, _ in timed) / seconds
    return (
        f"{total:,} trials in {len(flown)} runs, flown one thread each at {speed:.0f} trials a second: "
        f"{total / speed / 60:.0f} minutes of a core, about half of that with two at once"
    )


def group_tables(flown: Sequence[Flown]) -> list[Table]:
    """Make Tables I to III and those of the solvers, up to three parts each; skip those without runs."""
    scenarios = {
        "table-1": ("scenario-1", METHODS, "scenario-1", "Table I, scenario 1"),
        "table-2": ("scenario-2", SWEEP, "scenario-2", "Table II, scenario 2: sweep"),
        "table-2-methods": ("scenario-2", METHODS, None, "Scenario 2: all filters"),
        "table-3": ("scenario-2", TRIGGERS, "trigger", "Table III, scenario 2: trigger on and off"),
        "printed-1": ("scenario-1", PRINTED, None, "The printed equations and SAFE-IMM, scenario 1"),
        "printed-2": ("scenario-2", PRINTED, None, "The printed equations and SAFE-IMM, scenario 2"),
        "solvers-1": ("scenario-1", SOLVERS, "solver", "Projection against QP, scenario 1"),
        "solvers-2": ("scenario-2", SOLVERS, "solver", "Projection against QP, scenario 2"),
    }
    tables = []
    for name, (scenario, variants, paper, title) in scenarios.items():
        runs = select(flown, scenario, variants)
        if len(runs) < 2:
            continue
        published = DRACBF[paper] if paper is not None else None
        free = find(flown, scenario, FREE)
        timed = [f for f in runs if f.variant != FREE]
        tables.append(success_table(runs, name, f"{title}: success", free=free, published=published))
        tables.append(time_table(timed, f"{name}-times", f"{title}: times", published))
        if not name.startswith(("solvers", "printed")):
            tables.append(separation_table(runs, f"{name}-separation", f"{title}: separation", published))
    return tables


def sensitivity_table(flown: Sequence[Flown], scenario: str) -> Table | None:
    """Show the effect of each free choice, changed one at a time; None without runs."""
    runs = select(flown, scenario)
    base = find(runs, scenario, BASE)
    if base is None or len(runs) < 2:
        return None
    rows = []
    whole = success(base)
    for f in runs:
        per = [success(f, i) for i in range(f.obstacles)]
        now = success(f)
        apart = now.ends[0] > whole.ends[1] or now.ends[1] < whole.ends[0]
        rows.append(
            (
                *(f.variant, changed(f, base) or "as specified", now.n, *(each.value for each in per)),
                *(*now.cells, "apart" if apart else ""),
                mean_of(f.mean(i, lambda m: m.separation_m) for i in range(f.obstacles)),
                sum(m.warned_s is not None for i in range(f.obstacles) for m in f.met(i)) / now.n,
            )
        )
    columns = (
        *("variant", "changed", "trials", *(f"obstacle {i + 1} [%]" for i in range(base.obstacles))),
        *("runs [%]", LOW, HIGH, "against the first row", "mean d_s [m]", "warnings per run"),
    )
    note = "One choice changed at a time. Apart: the interval does not overlap that of the specified choice."
    return Table(scenario, f"Free choices one at a time, {scenario[-1:]}", columns, tuple(rows), note)


def hardware_tables(flown: Sequence[Flown]) -> list[Table]:
    """Make Tables IV and V, the small vehicle, per obstacle; those without runs are left out."""
    found = [_hardware_table(flown, name, *of) for name, of in HARDWARE.items()]
    return [table for table in found if table.rows]


def _hardware_table(flown: Sequence[Flown], name: str, title: str, scenarios: Sequence[str]) -> Table:
    rows = []
    for scenario in scenarios:
        for f in select(flown, scenario):
            for i in range(f.obstacles):
                key = f"{scenario}/{i + 1}"
                values = DRACBF["hardware"].get(key, {}) if f.variant == "as-printed" else {}
                dt = f.dt_s
                reaction = f.mean(i, lambda m: m.reaction_s)
                rows.append(
                    (
                        *(scenario, f.variant, i + 1, *success(f, i).cells),
                        f.mean(i, lambda m: m.closing_m_s),
                        milli(None if reaction is None else reaction + dt),
                        milli(f.timing("command_mean_s", i)),
                        milli(f.mean(i, lambda m: m.avoid_s)),
                        milli(f.mean(i, detection_time)),
                        f.mean(i, lambda m: m.separation_m),
                        min(m.closest_m for m in f.met(i)),
                        *(values.get(name) for name in ("closing", "reaction", "command", "avoid")),
                        *(values.get(name) for name in ("detection", "separation")),
                    )
                )
    columns = (
        *("scenario", "variant", "obstacle", "success [%]", LOW, HIGH, "v_cl [m/s]"),
        *(
            "t_r, to the next tick [ms]",
            "t_cm [ms]",
            "t_a [ms]",
            "t_d [ms]",
            "d_s [m]",
            "minimum distance [m]",
        ),
        *("published: v_cl", "published: t_r", "published: t_cm", "published: t_a", "published: t_d"),
        "published: d_s",
    )
    note = (
        "Simulated: 0.8 m/s², radii of 0.1 m, motion capture at 120 Hz. t_a: from the first avoidance "
        "command to the end of hovering; t_d: from the first detection to that command. Published: means of "
        "five flights each, all without collision (100 %, Wilson interval 57 to 100 %), thrown by hand and "
        "with a radio link, so only orders of magnitude compare; the delays of the scenario include any "
        "radio."
    )
    return Table(name, title, columns, tuple(rows), note)


def detection_time(met: ObstacleResult) -> float | None:
    """Time from the first detection to the avoidance command (t_d) [s]."""
    if met.detected_s is None or met.warned_s is None or met.reaction_s is None:
        return None
    return met.warned_s + met.reaction_s - met.detected_s


def wall_table(flown: Sequence[Flown]) -> Table | None:
    """Show avoidance between walls; None without runs."""
    runs = select(flown, "wall")
    if not runs:
        return None
    rows = []
    for f in runs:
        gaps = [t.map_clearance_m for t in f.record.trials if t.map_clearance_m is not None]
        rows.append(
            (
                *(f.variant, len(f.record.trials), *success(f, 0).cells),
                *(_touched(f.record.trials), min(gaps, default=None), mean_of(gaps), *success(f).cells),
            )
        )
    columns = (
        *("variant", "trials", "obstacle [%]", LOW, HIGH, "trials that touch a wall"),
        *("minimum clearance to walls [m]", "mean clearance to walls [m]"),
        *("runs [%]", LOW, HIGH),
    )
    note = "Walls are rows of the same projection; clearance is that of the vehicle's sphere."
    return Table("wall", "A corridor: avoidance without touching a wall", columns, tuple(rows), note)


def _touched(trials: Sequence[TrialResult]) -> int:
    return sum(t.map_clearance_m is not None and t.map_clearance_m < 0 for t in trials)


def milli(value: float | None) -> float | None:
    """Convert to thousandths."""
    return None if value is None else 1e3 * value


def _over(value: float | None, by: float | None) -> float | None:
    return value / by if value is not None and by else None
