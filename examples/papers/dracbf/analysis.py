"""Analysis of DR-ACBF beyond its published tables.

Closing speeds up to which its rows alone are recursively feasible, calibration of its risk over a whole run,
conditions in which the simple trigger fails, and a summary of all runs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.log.run import TrialResult
from alula.stages.reporting.statistics import Rate, mean_of, rate
from alula.stages.reporting.table import HIGH, LOW, Table, flat
from papers.dracbf.tables import (
    BASE,
    FREE,
    METHODS,
    Flown,
    find,
    select,
    success,
)
from papers.published import DRACBF

_STEP = 5e-4  # integration step of a stop, in horizons: the error of the undershoot is below 1 %
_SPAN = 12.0  # duration of a stop, in horizons
_COLLAPSED = 50.0  # runs that succeed [%]: maximum with the simple trigger, while
_HOLDS = 82.5  # minimum with the other trigger, as published
_SEES = 0.9  # detection probability at which most obstacles are seen
_AXES = (
    *("estimation.sensor.delay_s", "vehicle.actuation_delay_s", "estimation.sensor.noise_scale"),
    *("estimation.sensor.rate_hz", "estimation.sensor.detection_probability"),
)


@dataclass(frozen=True, slots=True)
class Stop:
    """Range less all clearance, D, while an obstacle closes in along one axis and only its row acts.

    Attributes:
        time_s: shape (n,), from the first tick in which the row is active, D = v0 H [s].
        range_m: D, shape (n,) [m].
        command_m_s2: flown acceleration, positive towards the obstacle, shape (n,) [m/s^2].
    """

    time_s: FloatArray
    range_m: FloatArray
    command_m_s2: FloatArray

    @property
    def undershoot_m(self) -> float:
        """Depth by which D falls below 0 [m]."""
        return max(0.0, -float(self.range_m.min()))


def stop(speed_m_s: float, horizon_s: float, a_max: float = math.inf) -> Stop:
    """Follow the row of the native filter along one axis from D = v0 H, within the box of accelerations.

    D'' = -a with a = max(-a_max, b(H)) while D decreases. Without a box D(t) = v0 H exp(-t/H) cos(t/H), which
    falls to -exp(-3 pi/4) sqrt(1/2) v0 H = -0.067 v0 H. Integrated with constant accelerations over steps of
    `_STEP` horizons.

    Args:
        speed_m_s: closing speed v0 at the start.
        horizon_s: H.
        a_max: half-width of the box [m/s^2].

    Raises:
        ValueError: a speed or horizon is not positive.
    """
    if not (speed_m_s > 0 and horizon_s > 0):
        raise ValueError("speed and horizon must be positive")
    bare = {"latency_s": 0.0, "j_max": 0.0}
    steps, h = round(_SPAN / _STEP), _STEP * horizon_s
    # b is linear in D and v: values of the native function give its coefficients.
    of_range = _row(1.0, 0.0, horizon_s, bare) - _row(0.0, 0.0, horizon_s, bare)
    of_speed = _row(1.0, 1.0, horizon_s, bare) - _row(1.0, 0.0, horizon_s, bare)
    d, v = speed_m_s * horizon_s, speed_m_s
    found = np.empty((steps, 2))
    used = steps
    for i in range(steps):
        a = max(-a_max, min(0.0, of_range * d + of_speed * v))
        found[i] = d, a
        d, v = d - v * h - 0.5 * a * h * h, v + a * h
        if v <= 0:  # the obstacle recedes: no row any more
            used = i + 1
            break
    time = np.arange(used, dtype=np.float64) * h
    return Stop(np.asarray(time, np.float64), found[:used, 0], found[:used, 1])


def _row(distance: float, closing: float, horizon: float, options: dict[str, float]) -> float:
    found: float = _core.row_bound(
        distance, closing, horizon, 0.0, radius_m=0.0, envelope=0.0, options=options
    )
    return found


def recursion_table(flown: Sequence[Flown], a_max: float = 6.0) -> Table:
    """Tabulate by horizon the closing speed up to which rows alone suffice, and the slower warnings.

    Args:
        flown: runs whose warnings are counted.
        a_max: half-width of the box of accelerations [m/s^2].
    """
    fastest = [
        m.closing_m_s
        for f in flown
        if f.variant == BASE and f.scenario in ("scenario-1", "scenario-2")
        for i in range(f.obstacles)
        for m in f.met(i)
        if m.closing_m_s is not None
    ]
    rows = []
    for horizon in (0.15, 0.2, 0.3, 0.4, 0.6, 0.8):
        limit = _core.recursive_speed(a_max, horizon)
        free = stop(limit, horizon)
        row = [horizon, limit, float(-free.command_m_s2.min()), free.undershoot_m]
        row += [stop(speed, horizon, a_max).undershoot_m for speed in (5.0, 8.0, 11.0)]
        slow = sum(speed <= limit for speed in fastest)
        rows.append((*row, 100.0 * slow / len(fastest) if fastest else None))
    columns = (
        *("H [s]", "maximum v_0 [m/s]", "deceleration at v_0 [m/s²]", "undershoot at v_0 [m]"),
        *(f"undershoot within the limit from {speed} m/s [m]" for speed in (5, 8, 11)),
        "warnings in scenarios 1 and 2 up to v_0 [%]",
    )
    note = (
        f"Along one axis, |a| at most {a_max:g} m/s², from D = v_0 H. A row that is followed exactly "
        "requires 0.645 v_0/H and still lets D fall to -0.067 v_0 H, so it keeps the range less that amount. "
        "Above the maximum v_0 it requires more than the limit; there only the manoeuvre avoids the obstacle."
    )
    return Table("recursion", "Where the rows alone are recursively feasible", columns, tuple(rows), note)


@dataclass(frozen=True, slots=True)
class RiskBin:
    """Trials of similar risk: minimum, maximum and mean estimate, mean bound of rows, and collision rate."""

    low: float
    high: float
    estimate: float
    bound: float | None
    observed: Rate


def risk_bins(trials: Sequence[TrialResult], count: int = 6) -> list[RiskBin]:
    """Sort trials by min(1, `mission_risk`) into `count` bins of equal numbers.

    The estimate takes, for each window of 0.4 s and each track, the largest bound of the probability that the
    object comes within the radii while command and velocity are kept, and adds these up. The bound of rows
    (`risk_spent`) adds up all ticks (Boole). Neither includes obstacles without a track.
    """
    risks = np.array([trial.mission_risk or 0.0 for trial in trials])
    hits = np.array([trial.collision for trial in trials])
    order = np.argsort(risks, kind="stable")
    bins = []
    for part in np.array_split(order, min(count, len(order))):
        value = np.minimum(1.0, risks[part])
        spent = [trials[i].risk_spent for i in part.tolist()]
        bound = mean_of(None if each is None else min(1.0, each) for each in spent)
        low, high, mean = float(value.min()), float(value.max()), float(value.mean())
        bins.append(RiskBin(low, high, mean, bound, rate(hits[part].tolist())))
    return bins


def risk_table(flown: Sequence[Flown]) -> Table | None:
    """Compare the estimated risk of a whole run and its bound with the observed rate; None without runs."""
    groups: dict[tuple[str, str], list[TrialResult]] = {}
    for scenario in ("scenario-1", "scenario-2"):
        for f in select(flown, scenario, METHODS):
            groups[scenario, f.variant] = list(f.record.trials)
    for f in select(flown, "collapse"):  # where many collide: all conditions together
        trigger = str(flat(f.record.provenance.parameters)[f"safety.{BASE}.trigger"])
        groups.setdefault(("collapse", trigger), []).extend(f.record.trials)
    rows = []
    for (scenario, variant), trials in groups.items():
        parts = risk_bins(trials) if variant == BASE or scenario == "collapse" else []
        for each in [*risk_bins(trials, 1), *parts]:
            rows.append(
                (
                    *(scenario, variant, f"{each.low:.3g} to {each.high:.3g}", each.observed.n),
                    *(100 * each.estimate, None if each.bound is None else 100 * each.bound),
                    *each.observed.cells,
                    "holds" if 100 * each.estimate >= each.observed.ends[0] else "TOO SMALL",
                )
            )
    if not rows:
        return None
    columns = (
        *("scenario", "variant", "risk estimate of a run", "trials", "mean estimate [%]"),
        *("mean bound of rows [%]", "collided [%]", LOW, HIGH, "estimate"),
    )
    note = (
        "A budget of alpha per tick says little about a mission: over K ticks the union bound is K alpha. "
        "The bound of rows adds up the risk that the flown commands leave, var / (var + slack²), over all "
        "ticks and obstacles with a row (Boole, Cantelli). It bounds the probability that any row of the "
        "flight fails, not that of a collision, and counts neighbouring ticks, which fail together, each "
        "time. The risk estimate of a run takes, for each 0.4 s and track, only the largest bound of the "
        "probability that the object comes within the radii while command and velocity are kept, for errors "
        "with one mode. It is no bound, because other ticks of the 0.4 s might fail too. Both are capped at "
        "1, assume that the covariance of the tracks is right, and omit obstacles without a track. First all "
        "trials, then bins of equal numbers. Collapse: all conditions together; the filters do not model the "
        "delays."
    )
    return Table("risk", "Risk of a whole run: estimate, bound and observed", columns, tuple(rows), note)


@dataclass(frozen=True, slots=True)
class Cell:
    """Success of runs with either trigger in one condition of sensing and latency."""

    delay_s: float
    lag_s: float
    noise_scale: float
    rate_hz: float
    detection: float
    distributional: Rate
    simple: Rate
    always: Rate | None  # the simple trigger, with rows in every tick


def collapse_cells(flown: Sequence[Flown]) -> list[Cell]:
    """Conditions that were flown with both triggers, the worst for the simple trigger first."""
    found: dict[tuple[float, float, float, float, float], dict[str, Rate]] = {}
    for f in select(flown, "collapse"):
        values = flat(f.record.provenance.parameters)
        delay, lag, noise, hertz, detection = (float(values[axis] or 0.0) for axis in _AXES)
        key = (delay, lag, noise, hertz, detection)
        trigger = str(values[f"safety.{BASE}.trigger"])
        is_always = trigger == "simple" and values.get(f"safety.{BASE}.rows_before_warning") is not False
        found.setdefault(key, {})["always" if is_always else trigger] = success(f)
    cells = [
        Cell(*key, each["cvar"], each["simple"], each.get("always"))
        for key, each in found.items()
        if "cvar" in each and "simple" in each
    ]
    return sorted(cells, key=lambda c: (c.simple.value or 0.0, c.delay_s, c.lag_s, c.noise_scale))


def has_collapsed(cell: Cell) -> bool:
    """Return whether the simple trigger fails in most runs where the other keeps the published success."""
    return (cell.simple.value or 0.0) <= _COLLAPSED and (cell.distributional.value or 0.0) >= _HOLDS


def collapse_table(flown: Sequence[Flown]) -> Table | None:
    """Compare the triggers over both delays, noise, rate and detection probability; None without runs."""
    cells = collapse_cells(flown)
    if not cells:
        return None
    rows = tuple(
        (
            *(c.delay_s, c.lag_s, c.noise_scale, c.rate_hz, c.detection),
            *(*c.distributional.cells, *c.simple.cells),
            *((None, None, None) if c.always is None else c.always.cells),
            (c.distributional.value or 0.0) - (c.simple.value or 0.0),
            "collapses" if has_collapsed(c) else "",
        )
        for c in cells
    )
    columns = (
        *("sensor delay [s]", "actuation delay [s]", "noise scale", "rate [Hz]", "detection probability"),
        *("DR-CVaR: runs [%]", LOW, HIGH, "simple: runs [%]", LOW, HIGH),
        *("simple, rows always: runs [%]", LOW, HIGH),
        *("difference [points]", "simple trigger"),
    )
    on, off = DRACBF["trigger"][BASE], DRACBF["trigger"]["trigger-simple"]
    note = (
        f"Scenario 2. Published: {(on['success_1'] + on['success_2']) / 2:.1f} % on, "
        f"{(off['success_1'] + off['success_2']) / 2:.1f} % off, by obstacle. Collapses: at most "
        f"{_COLLAPSED:g} % of runs succeed with the simple trigger where DR-CVaR keeps {_HOLDS:g} %. Simple "
        "trigger as printed: rows are active only in a manoeuvre; with DR-CVaR, and in the columns of rows "
        "always, they are active in every tick. The filters do not model the delays."
    )
    return Table("collapse", "Where the simple trigger collapses", columns, rows, note)


def in_short(flown: Sequence[Flown]) -> dict[str, str]:
    """Summarise the runs, one line per subject."""
    facts = {}
    for scenario, target in (("scenario-1", 99.6), ("scenario-2", _HOLDS)):
        base = find(flown, scenario, BASE)
        if base is None:
            continue
        per = [success(base, i) for i in range(base.obstacles)]
        words = [f"obstacle {i + 1} {r}" for i, r in enumerate(per)]
        worst = min(r.value or 0.0 for r in per)
        facts[f"{BASE}, {scenario}"] = (
            f"{', '.join(words)}, runs {success(base)}; the worse obstacle is "
            f"{'at least' if worst >= target else 'BELOW'} {target:g} %"
        )
        free = find(flown, scenario, FREE)
        if free is not None:
            each = ", ".join(f"obstacle {i + 1} {success(free, i)}" for i in range(free.obstacles))
            facts[f"without a filter, {scenario}"] = each
        others = [f for f in select(flown, scenario, METHODS) if f.variant not in (FREE, BASE)]
        if others:
            facts[f"others, {scenario}, runs"] = ", ".join(f"{f.variant} {success(f)}" for f in others)
    cells = collapse_cells(flown)
    if cells:
        gone = [c for c in cells if has_collapsed(c)]
        late = sum(c.lag_s > 0 for c in gone)
        blind = sum(c.lag_s == 0 and c.detection < _SEES for c in gone)
        fine = [c.simple for c in cells if c.lag_s == 0 and c.detection >= _SEES]
        worst_cell = cells[0]
        where = (
            f"sensor delay {worst_cell.delay_s:g} s, actuation delay {worst_cell.lag_s:g} s, noise × "
            f"{worst_cell.noise_scale:g}, {worst_cell.rate_hz:g} Hz, detection probability "
            f"{worst_cell.detection:g}"
        )
        facts["simple trigger"] = (
            f"collapses in {len(gone)} of {len(cells)} conditions: {late} with an actuation delay, {blind} "
            f"without it but with half of all detections missed, {len(gone) - late - blind} others; worst "
            f"({where}): {worst_cell.simple} against {worst_cell.distributional}"
        )
        if worst_cell.always is not None:
            facts["simple trigger"] += f", {worst_cell.always} with rows in every tick"
        if fine:
            minimum = min(fine, key=lambda r: r.value or 0.0)
            facts["simple trigger without actuation delay"] = (
                f"detection probability of at least {_SEES:g}: at least {minimum}"
            )
    whole = find(flown, "scenario-1", BASE)
    if whole is not None:
        bins = risk_bins(whole.record.trials, 1)[0]
        rows_bound = "–" if bins.bound is None else f"{100 * bins.bound:.3g} %"
        facts["risk of a run, scenario-1"] = (
            f"mean estimate {100 * bins.estimate:.3g} %, mean bound of rows {rows_bound}, "
            f"collided {bins.observed}"
        )
    walls = [f for f in select(flown, "wall") if f.variant == BASE]
    if walls:
        touched = sum((t.map_clearance_m or 0.0) < 0 for t in walls[0].record.trials)
        facts["between walls"] = (
            f"{touched} of {len(walls[0].record.trials)} runs touch a wall, obstacle {success(walls[0], 0)}"
        )
    return facts
