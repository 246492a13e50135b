"""The pendulum's tables, and what the experiments say in short."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from alula.stages.reporting.papers.geofencing import BASE, KM_H, Approach, Fenced, approach, find, select
from alula.stages.reporting.papers.geofencing_robustness import disturbed, pilots_rate
from alula.stages.reporting.papers.pendulum import GAIN, PROGRAM, PUSH, REGULATION, Pendulum, Swing
from alula.stages.reporting.papers.published import GEOFENCING
from alula.stages.reporting.tables import Table, text

_MICRO = " [us]"
_SOLVER = "solver "
_CALM = 1.0  # of the chatter [rad/s^2 per s]


def time_table(measured: Mapping[str, Any]) -> Table:
    """Time of an evaluation: both rules natively, and the program through general solvers."""
    times = {name.removesuffix(_MICRO): float(value) for name, value in measured["times"].items()}
    base, program = times[REGULATION], times[PROGRAM]
    said = GEOFENCING["pendulum"][PROGRAM]["time_ratio"]
    rows: list[tuple[Any, ...]] = [
        ("regulation, no gradient", base, None, base, 1.0, 1.0),
        ("program, ours", program, None, program, program / base, said),
    ]
    for name, value in times.items():
        if name.startswith(_SOLVER):
            whole = program + value
            solver = name.removeprefix(_SOLVER)
            rows.append((f"program through {solver}", program, value, whole, whole / base, None))
    columns = (
        *("filter", "flow, rows, ours [µs]", "solver's call [µs]", "in all [µs]", "over the regulation"),
        "published, about",
    )
    note = (
        f"Native, over the {measured['states']:,} states of one flight. Our program costs little more than "
        "its flow with sensitivities: rows that no input within its limits can miss are dropped before an "
        f"active-set solver sees them. A general solver gets all {measured['rows']} rows, called from Python "
        "and set up anew in every tick, as one does without such a shortcut; the sum is an upper estimate, "
        "as it holds our own solve, too."
    )
    return Table("pendulum-time", "Figure 4: time of an evaluation", columns, tuple(rows), note)


def gains_table(swings: Sequence[Swing]) -> Table:
    """How each rule behaves at the boundary, by its gain."""
    rows = [
        (
            *(
                s.rule,
                1e3 * s.tick_s,
                f"{GAIN[s.rule]} {s.gain:g}",
                s.arrival_s,
                s.settled_rad,
                s.greatest_rad,
            ),
            *(1e3 * s.ripple_rad, s.chatter, 100 * s.unsolved / len(s.time_s)),
        )
        for s in swings
    ]
    columns = (
        *("rule", "tick [ms]", "gain", "95 % after [s]", "settles at [rad]", "greatest angle [rad]"),
        *("ripple [mrad]", "chatter [rad/s² per s]", "ticks without a solution [%]"),
    )
    note = (
        f"Pushed by {PUSH:g} rad/s² from rest against the largest angle, {Pendulum().largest_angle:g} rad. "
        "Ripple and chatter, the total variation of the input per second, are of the last third of a flight. "
        "Without a solution the backup controller flies for a tick. The regulation has a limit, too: with a "
        "gain far beyond the useful ones it switches between pilot and backup."
    )
    return Table("pendulum-gains", "Figure 4: at the boundary, by gain", columns, tuple(rows), note)


def in_short(runs: Sequence[Fenced], swings: Sequence[Swing], measured: Mapping[str, Any]) -> dict[str, str]:
    """What the experiments say."""
    facts = {
        "flown": f"{sum(len(run.record.trials) for run in runs):,} flights in {len(runs)} runs",
        "pendulum, time": _times(measured),
        "pendulum, gains": _gains(swings),
    }
    for scenario, variant, what in (("wall", "from-40", "wall, 40 m"), ("fall", "fall", "fall, 70 m")):
        run = find(runs, scenario, variant)
        if run is not None and run.ticks is not None:
            facts[what] = _approached(run, approach(run.ticks), GEOFENCING[scenario])
    facts |= _fastest(runs)
    for run in select(runs, "engaged"):
        if run.record.filter == BASE:
            facts[f"again and again, {run.variant}"] = _engaged(run)
    for scenario in ("box", "faces", "cover", "combined"):
        whole = [run for run in select(runs, scenario) if run.steps("hand_over") == 0]
        if whole:
            n = sum(run.left.n for run in whole)
            out = sum(t.collision for run in whole for t in run.record.trials)
            least = text(min(run.least_m for run in whole))
            facts[f"fence of {scenario}"] = f"{out} of {n:,} flights left it, least distance {least} m"
    for group in disturbed(runs):
        enough = "no reserve of the grid" if group.enough is None else f"{text(group.enough.reserve_m)} m"
        facts[f"unknown {group.name}"] = f"without reserve left {group.runs[0].left}; enough: {enough}"
    for name in (BASE, "backup-qp", "none"):
        found_rate = pilots_rate(runs, name)
        if found_rate is not None:
            facts[f"random pilots, {name}"] = f"of {found_rate.n:,} left {found_rate}"
    guarded = [run for run in runs if run.record.filter == BASE]
    passed = sum(run.steps("passed") for run in guarded)
    altered = sum(result.altered_passes for run in guarded for result in run.results)
    facts["passed commands"] = f"{altered} of {passed:,} are not the pilot's, bit by bit"
    return facts


def _times(measured: Mapping[str, Any]) -> str:
    times = {name.removesuffix(_MICRO): float(value) for name, value in measured["times"].items()}
    base, program = times[REGULATION], times[PROGRAM]
    others = ", ".join(
        f"{(program + value) / base:.3g} times through {name.removeprefix(_SOLVER)}"
        for name, value in times.items()
        if name.startswith(_SOLVER)
    )
    return (
        f"{base:.3g} µs without gradients; our program takes {program / base:.3g} times as long, all rows "
        f"through a general solver up to {others}"
    )


def _gains(swings: Sequence[Swing]) -> str:
    """How calm each rule is over its gains, at the shorter tick."""
    words = []
    tick = min((s.tick_s for s in swings), default=0.0)
    for rule in (REGULATION, PROGRAM):
        here = [s for s in swings if s.rule == rule and s.tick_s == tick and s.arrival_s is not None]
        calm = [s for s in here if s.chatter < _CALM]
        least = min(here, key=lambda s: s.chatter, default=None)
        if least is None:
            continue
        words.append(
            f"{rule} chatters by less than {_CALM:g} rad/s² per s at {len(calm)} of {len(here)} gains, "
            f"least by {text(least.chatter)} at {GAIN[rule]} {least.gain:g}, settled at "
            f"{text(least.settled_rad)} rad"
        )
    return "; ".join(words)


def _approached(run: Fenced, a: Approach, published: Mapping[str, Mapping[str, float]]) -> str:
    """A flight against a barrier beside the published ones."""
    names = {"peak_km_h": "km/h", "braking_m": "m of braking", "least_m": "m left", "rest_m": "m at rest"}
    said = "; ".join(
        f"{who} {', '.join(f'{text(value[key])} {unit}' for key, unit in names.items() if key in value)}"
        for who, value in published.items()
    )
    return (
        f"{text(a.peak_km_h)} km/h, brakes from {text(a.braking_m + run.radius_m)} m, tilt "
        f"{text(a.tilt_deg)}°, least distance {text(a.least_m)} m of the sphere and "
        f"{text(a.least_m + run.radius_m)} m of its centre, at rest {text(a.rest_m + run.radius_m)} m; "
        f"least λ {text(a.least_share)}, λ = 0 for {text(1e3 * a.helpless_s)} ms (published: {said})"
    )


def _engaged(run: Fenced) -> str:
    """Many engagements: whether the pilot ever lost all of his share."""
    found = run.results
    lost = sum(r.backup_steps > 0 for r in found)
    speed = KM_H * max(t.max_speed_m_s for t in run.record.trials)
    longest = max(r.longest_backup_s for r in found)
    return (
        f"{sum(r.interventions for r in found):,} engagements in {len(found)} flights at up to {text(speed)} "
        f"km/h, {sum(t.collision for t in run.record.trials)} left the fence; λ falls to 0 in {lost} of them"
        f"{f', for {text(longest)} s at a time at most' if lost else ''} (published: never)"
    )


def _fastest(runs: Sequence[Fenced]) -> dict[str, str]:
    held = [
        (KM_H * max(t.max_speed_m_s for t in run.record.trials), run)
        for run in select(runs, "wall")
        if run.record.filter == BASE and not run.left.value
    ]
    if not held:
        return {}
    speed, run = max(held, key=lambda pair: pair[0])
    free = [peak for peak, one in held if not one.steps("backup")]
    asked = sum(one.record.filter == BASE for one in select(runs, "wall"))
    words = f"{text(speed)} km/h ({run.variant}), held with {text(run.least_m)} m; {len(held)} of {asked} "
    words += "approaches held" + (f"; λ never 0 up to {text(max(free))} km/h" if free else "")
    return {"wall, fastest": words}
