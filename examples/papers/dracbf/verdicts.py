"""What was measured for every row of DR-ACBF, with a verdict.

Success and separation come from the runs of the example. Fractions of computing time come from replaying the
same ticks through all filters in turns (`benchmarks/dracbf.py --ticks-only`): absolute times of MATLAB on a
laptop compare with nothing.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from alula import _core
from alula.schemas.log.run import ObstacleResult
from alula.schemas.parameters.filter_options import MovingFilterParameters
from alula.schemas.scenarios.tables import SensorTable
from alula.stages.reporting.statistics import Rate, mean_estimate, mean_of
from alula.stages.reporting.table import HIGH, LOW, Table, flat
from papers.claims import shown
from papers.compared import VERDICTS, File, Measured, Verdict, measured
from papers.dracbf.analysis import collapse_cells, has_collapsed, stop
from papers.dracbf.cells import HARDWARE
from papers.dracbf.difficulty import PUBLISHED, crossing, levels, mean_success, paired
from papers.dracbf.tables import (
    BASE,
    SWEEP,
    Flown,
    detection_time,
    find,
    milli,
    reaction_in_ticks,
    success,
)
from papers.papers import DRACBF
from papers.published import DRACBF as PUBLISHED_BY_VARIANT
from papers.published import DRACBF_PRINTED
from papers.verdicts import above, holds, settings, stated

Times = Mapping[str, Any]
_Get = Callable[[ObstacleResult], float | None]
_TIMED = {
    "tick": "dr-acbf, exact projection",
    "general_qp_tick": "the same rows, our QP solver",
    "general_qp_quadprog_tick": "the same rows, quadprog",
    "general_qp_clarabel_tick": "the same rows, Clarabel",
    "mpc_tick": "mpc",
    "cbf_qp_tick": "cbf-qp",
    "rp_cbf_tick": "rp-cbf",
}
_TIMES = File("times.json")
_RECORDED = 1e-6  # relative difference of a recorded setting to the printed one


def verdict_rows(flown: Sequence[Flown], times: Times) -> list[Measured]:
    """Make all rows, in the paper's order.

    Args:
        flown: runs of the example; rows of runs that are missing say so.
        times: what `benchmarks/dracbf.py --ticks-only` measured; may be empty.
    """
    return [
        *_settings(),
        *_flown_settings(flown),
        *_claims(flown, times),
        *_equations(flown),
        *_table_1(flown),
        *_table_2(flown),
        *_table_3(flown),
        *_projection(flown, times),
        *_hardware(flown),
    ]


def counted(rows: Sequence[Measured]) -> dict[str, str]:
    """Summarise the verdicts: how many of each, and what is refuted."""
    words = ", ".join(f"{sum(row.verdict == name for row in rows)} {name}" for name in VERDICTS)
    said = [shown(DRACBF.row(row.row)[1], row) for row in rows if row.verdict == "refuted"]
    refuted = "; ".join(f"{row.quantity} ({row.published}; ours {row.ours})" for row in said)
    return {"published values": f"{len(rows)} rows: {words}"} | ({"refuted": refuted} if refuted else {})


def saving_table(times: Times) -> Table | None:
    """Tabulate the times of all filters in the same ticks, and what `dr-acbf` saves; None without times."""
    saved = times.get("saved")
    if not saved:
        return None
    rows = []
    for key, name in _TIMED.items():
        if f"{key}_mean_us" not in times:
            continue
        fraction = [saved[key][k] if key in saved else None for k in ("value", "low", "high")]
        rows.append(
            (
                name,
                *(times[f"{key}_{of}_us"] for of in ("mean", "p50", "p99")),
                *(None if x is None else 100 * x for x in fraction),
            )
        )
    columns = ("filter", "mean [µs]", "p50 [µs]", "p99 [µs]", "saved by dr-acbf [%]", LOW, HIGH)
    note = (
        f"{times['active_ticks']:,} active ticks of scenario 1, the same for all, each timed on copies of "
        "the filter, trial by trial in turns. Saved: medians of trials, bootstrap interval over trials. "
        "Published: 31 % against RP-CBF, 38 % against CBF-QP, 54 % against MPC and, in scenario 2, 38 % "
        "against a QP with the same rows (31 % in the abstract)."
    )
    return Table("saved", "Computing time in the same ticks", columns, tuple(rows), note)


def _missing(row: str) -> Measured:
    """A row whose run is missing."""
    return measured(row, "not available here", why="not flown in this run")


def _printed_saving(method: str) -> float:
    """Fraction of computing time that DR-ACBF saves against a method in Table I."""
    ours, theirs = (DRACBF_PRINTED["table-1"][name]["t_cp"][0] for name in (BASE, method))
    return float(1 - ours / theirs)


def _settings() -> list[Measured]:
    own, sensor = MovingFilterParameters(), SensorTable()
    field = [math.degrees(2 * angle) for angle in (sensor.half_azimuth_rad, sensor.half_elevation_rad)]
    budget = [own.alpha, own.h_min_s, own.h_max_s, own.clearance_m, own.hold_s, own.stop_s, own.brake]
    return [
        settings(DRACBF, "mpc-setting", [20 * own.mpc.step_s]),
        settings(DRACBF, "rp-cbf-setting", [own.rp_cbf.horizon_s, own.rp_cbf.samples]),
        settings(DRACBF, "cbf-qp-setting", [own.cbf_qp.horizon_s]),
        settings(DRACBF, "radar", [*field, sensor.max_range_m]),
        settings(DRACBF, "settings", budget),
        settings(DRACBF, "southwell/setting", [own.iterations, own.relaxation]),
        settings(DRACBF, "trigger-settings", [own.tail, own.latency_s, own.wasserstein_m]),
        measured("differentiator", "not comparable", l1=own.l1, l2=own.l2),
        *stated(DRACBF, "directions"),
    ]


def _flown_settings(flown: Sequence[Flown]) -> list[Measured]:
    """Settings of the scenarios from the records of the flights; one whose run is missing is left out."""
    vehicle = ("vehicle.radius_m", "vehicle.max_acceleration_m_s2")
    manoeuvre = [f"safety.{BASE}.{name}" for name in ("clearance_m", "hold_s", "stop_s", "brake")]

    def first(p: Mapping[str, Any]) -> list[Any]:
        return [p[vehicle[0]], p["world.moving"][0]["radius_m"], p[vehicle[1]]]

    def distances(p: Mapping[str, Any]) -> list[Any]:
        return [moving["distance_m"] for moving in p["world.moving"]]

    def of_scenario(p: Mapping[str, Any]) -> list[Any]:
        return [*first(p), p["rules.dt_s"], min(m["speed_m_s"][0] for m in p["world.moving"])]

    rows = []
    for row, scenario, variant, get in (
        ("vehicle", "scenario-1", BASE, of_scenario),
        ("scenario-1", "scenario-1", BASE, distances),
        ("scenario-2", "scenario-2", BASE, distances),
        ("crazyflie", "thrown", "as-printed", lambda p: [*first(p), *(p[key] for key in manoeuvre)]),
    ):
        f = find(flown, scenario, variant)
        if f is None:
            continue
        try:
            ours = [float(value) for value in get(flat(f.record.provenance.parameters))]
        except KeyError:  # a record without these keys
            continue
        rows.append(settings(DRACBF, row, ours, [f], _RECORDED))
    return rows


def _claims(flown: Sequence[Flown], times: Times) -> list[Measured]:
    rows = [_saved("saved-qp", times, "general_qp_tick", DRACBF.limit("saved-qp"))]
    for name in ("rp-cbf", "cbf-qp", "mpc"):
        key = f"{name.replace('-', '_')}_tick"
        rows.append(_saved(f"saved-{name}", times, key, _printed_saving(name)))
    base = find(flown, "scenario-1", BASE)
    others = [f for name in ("mpc", "cbf-qp", "rp-cbf") if (f := find(flown, "scenario-1", name)) is not None]
    if base is not None and others:
        mine = _command_time(base)
        ratios = [(f.variant, _command_time(f)) for f in others]
        saved = [[name, 100 * (1 - mine / other)] for name, other in ratios if mine and other]
        rows.append(measured("saved-command", "not comparable", [base, *others], saved=saved))
    return [*rows, *stated(DRACBF, "figures-1-2")]


def _saved(row: str, times: Times, key: str, published: float) -> Measured:
    """Judge a fraction of computing time saved: refuted when the interval lies below the published one."""
    found = times.get("saved", {}).get(key)
    if found is None or found["value"] is None:
        return _missing(row)
    value, low, high = (None if found[k] is None else 100 * found[k] for k in ("value", "low", "high"))
    verdict: Verdict = "reproduced"
    if low is None or high is None:
        verdict = "not comparable"
    elif high < 100 * published - 0.5:
        verdict = "refuted"
    elif low > 100 * published + 0.5:
        verdict = "better"
    return measured(row, verdict, [_TIMES], (low, high), value=value)


def _equations(flown: Sequence[Flown]) -> list[Measured]:
    horizon = 0.4
    limit = _core.recursive_speed(6.0, horizon)
    undershoot = stop(limit, horizon).undershoot_m
    fast = stop(8.0, horizon, 6.0).undershoot_m
    rows = [
        measured("invariance", "refuted", percent=100 * undershoot / (limit * horizon), fast_m=fast),
        *stated(DRACBF, "cantelli", "envelope/differentiator", "trigger", "southwell/reaches"),
    ]
    printed = DRACBF_PRINTED["table-1"][BASE]["s"][2]
    for claim, variant in (
        ("risk-shares", "eq-19"),
        ("envelope", "eq-24"),
        ("tracker", "safe-imm-on"),
        ("as-printed", "all-as-printed"),
    ):
        for scenario in ("scenario-1", "scenario-2"):
            row = f"{claim}/{scenario}"
            f, reference = (find(flown, scenario, name) for name in (variant, BASE))
            if f is None or reference is None:
                rows.append(_missing(row))
                continue
            now, gap = success(f), paired(f, reference)
            low, high = now.ends
            is_same = scenario == "scenario-1" and low <= printed <= high
            verdict = "refuted" if (now.value or 0.0) < PUBLISHED[0] else holds(is_same, "bounded")
            apart = {} if gap is None else {"gap": gap.value, "gap_low": gap.low, "gap_high": gap.high}
            rows.append(measured(row, verdict, [f, reference], now, value=now.value, **apart))
    return rows


def _command_time(flown: Flown) -> float | None:
    """Mean command time of the obstacles [s]; None where it was not measured."""
    return mean_of(flown.timing("command_mean_s", i) for i in range(flown.obstacles))


def _of_obstacles(f: Flown) -> Rate:
    """Mean of the obstacles' success [%]; its interval resamples trials, because their obstacles depend."""
    each = [mean_of(not m.collision for m in trial.obstacles or []) or 0.0 for trial in f.record.trials]
    found = mean_estimate(each, bounds=(0.0, 1.0))
    assert found is not None
    assert found.low is not None
    assert found.high is not None
    return Rate(100 * found.value, 100 * found.low, 100 * found.high, found.n)


def _success(row: str, f: Flown, obstacle: int | None) -> Measured:
    """Judge a published success of one obstacle, or of the mean of all obstacles."""
    now = _of_obstacles(f) if obstacle is None else success(f, obstacle)
    low, high = now.ends
    verdict: Verdict = "reproduced"
    if not low <= DRACBF.limit(row) <= high:
        verdict = "not comparable" if DRACBF.limit(row) < low else "refuted"
    return measured(row, verdict, [f], now, value=now.value)


def _mean(row: str, f: Flown, get: _Get, obstacle: int | None, published: float) -> Measured:
    """Judge a published mean of a value over the obstacles with a warning."""
    every = [trial.obstacles or [] for trial in f.record.trials]
    each = [mean_of(get(m) for m in (met if obstacle is None else [met[obstacle]])) for met in every]
    found = mean_estimate(values) if (values := [value for value in each if value is not None]) else None
    if found is None:
        return _missing(row)
    inside = found.low is not None and found.high is not None and found.low <= published <= found.high
    return measured(row, holds(inside, "not comparable"), [f], found, value=found.value)


def _reaction(row: str, f: Flown, obstacle: int | None) -> Measured:
    """Judge a reaction time: simulated time to the end of the first tick with another command."""
    dt, published = f.dt_s, DRACBF.limit(row)

    def reaction(m: ObstacleResult) -> float | None:
        return None if m.reaction_s is None else 1e3 * (round(m.reaction_s / dt) + 1) * dt

    found = _mean(row, f, reaction, obstacle, published)
    mean = milli(reaction_in_ticks(f))
    if mean is None or not found.runs:
        return _missing(row)
    verdict: Verdict = "bounded"
    if abs(mean - published) < 500 * dt:  # less than half a tick
        verdict = "reproduced"
    elif published > mean + 1e3 * dt:
        verdict = "refuted"
    return measured(row, verdict, [f], (found.low, found.high), **found.values)


def _cell(row: str, f: Flown, obstacle: int | None) -> Measured:
    """A cell of Tables I to III; the symbol is a part of its name."""
    symbol = row.split("/")[2]
    if symbol == "s":
        return _success(row, f, obstacle)
    if symbol == "t_r":
        return _reaction(row, f, obstacle)
    if symbol == "t_cm":
        time = _command_time(f) if obstacle is None else f.timing("command_mean_s", obstacle)
        return measured(row, "not comparable", [f], value=milli(time))
    if symbol == "t_cp":
        mean, std = (milli(f.timing(f"filter_{key}_s")) for key in ("mean", "std"))
        return measured(row, "not comparable", [f], value=mean, std=std)
    gets: dict[str, _Get] = {"v_cl": lambda m: m.closing_m_s, "d_s": lambda m: m.separation_m}
    return _mean(row, f, gets[symbol], obstacle, DRACBF.limit(row))


_OBSTACLES = {"1": 0, "2": 1, "mean": None}
_EACH = ("s", "v_cl", "t_r", "t_cm", "d_s")  # symbols of Tables I and III


def _of_each(table: str, f: Flown | None) -> list[Measured]:
    """The cells of Tables I and III: for each of the two obstacles, and their mean."""
    if f is None:
        return [_missing(f"{table}/{symbol}/mean") for symbol in _EACH]
    return [_cell(f"{table}/{s}/{name}", f, i) for name, i in _OBSTACLES.items() for s in _EACH]


def _table_1(flown: Sequence[Flown]) -> list[Measured]:
    """Every method in scenario 1."""
    rows = []
    for name in DRACBF_PRINTED["table-1"]:
        table, f = f"table-1/{name}", find(flown, "scenario-1", name)
        rows += _of_each(table, f)
        if f is None:
            rows.append(_missing(f"{table}/t_cp"))
            continue
        every = [m.reaction_s for trial in f.record.trials for m in trial.obstacles or []]
        ticks = [(round(r / f.dt_s) + 1) * f.dt_s for r in every if r is not None]
        spread = 1e3 * statistics.pstdev(ticks) if ticks else None
        rows += [
            measured(f"{table}/t_r/spread", "not comparable", [f], value=spread),
            measured(f"{table}/t_cm/spread", "not available here"),
            _cell(f"{table}/t_cp", f, None),
        ]
    return rows


def _table_2(flown: Sequence[Flown]) -> list[Measured]:
    """Every setting in scenario 2, and what the text says of all of them."""
    rows = []
    order = ("s", "v_cl", "t_r", "t_cm", "t_cp", "d_s")
    for name in SWEEP:
        f = find(flown, "scenario-2", name)
        names = [f"table-2/{name}/{symbol}" for symbol in (order if f is not None else (*_EACH, "t_cp"))]
        rows += [_missing(row) if f is None else _cell(row, f, None) for row in names]
    detection = [level for level in levels(flown) if level.axis == "detection"]
    published = DRACBF_PRINTED["table-2"][BASE]["values"][0]
    at = crossing(detection, BASE, published) if detection else None
    if at is not None:
        near = min(detection, key=lambda level: abs(mean_success(level.runs[BASE]) - published))
        now = _of_obstacles(near.runs[BASE])
        made_of = [level.runs[BASE] for level in detection]
        rows.append(measured("difficulty", "bounded", made_of, now, at=at, near=near.value, value=now.value))
    sweep = [f for name in SWEEP if (f := find(flown, "scenario-2", name)) is not None]
    if sweep:
        lowest = min(sweep, key=mean_success)
        now = _of_obstacles(lowest)
        row = "every-configuration"
        verdict = above(now, PUBLISHED[0], "bounded")
        rows.append(measured(row, verdict, sweep, now, value=now.value, lowest=lowest.variant))
        rows.append(_over_sweep("steady-reaction", sweep, lambda m: m.reaction_s, 1e3))
        rows.append(_over_sweep("steady-separation", sweep, lambda m: m.separation_m, 1.0))
    return rows


def _over_sweep(row: str, sweep: Sequence[Flown], get: _Get, factor: float) -> Measured:
    """Judge that a value stays the same in every setting of Table II."""
    found = []
    for f in sweep:
        values = [factor * v for t in f.record.trials for m in t.obstacles or [] if (v := get(m)) is not None]
        if values and (mean := mean_estimate(values)) is not None:
            found.append(mean)
    if not found:
        return _missing(row)
    low, high = min(found, key=lambda e: e.value), max(found, key=lambda e: e.value)
    apart = low.high is not None and high.low is not None and low.high < high.low
    return measured(
        row,
        holds(not apart),
        sweep,
        least=low.value,
        least_low=low.low,
        least_high=low.high,
        most=high.value,
        most_low=high.low,
        most_high=high.high,
    )


def _table_3(flown: Sequence[Flown]) -> list[Measured]:
    """Either trigger in scenario 2."""
    late_rows = "trigger-simple-rows-late"
    rows = [
        *_of_each("table-3/on", find(flown, "scenario-2", BASE)),
        *_of_each("table-3/off", find(flown, "scenario-2", late_rows)),
    ]
    gone = [cell for cell in collapse_cells(flown) if has_collapsed(cell)]
    if gone:
        on, off = gone[0].distributional, gone[0].simple
        rows.append(
            measured(
                "collapse",
                "bounded",
                with_trigger=on.value,
                with_low=on.low,
                with_high=on.high,
                without=off.value,
                without_low=off.low,
                without_high=off.high,
                lag=gone[0].lag_s,
                late=sum(cell.lag_s > 0 for cell in gone),
                of=len(gone),
            )
        )
    usual, longer = (find(flown, "scenario-2", name) for name in (late_rows, "trigger-simple-long"))
    if usual is not None and longer is not None:
        gap = paired(longer, usual)
        verdict = above(gap, 0, "not comparable")
        value = None if gap is None else gap.value
        rows.append(measured("longer-horizons", verdict, [longer, usual], gap, gap=value))
    return rows


def _projection(flown: Sequence[Flown], times: Times) -> list[Measured]:
    ours_ms, qp_ms = (PUBLISHED_BY_VARIANT["solver"][f"dr-acbf-{name}"]["tick"] for name in ("gs", "qp"))
    saved = 1 - ours_ms / qp_ms
    rows = [_saved("projection-time", times, "general_qp_tick", saved), *stated(DRACBF, "projection-command")]
    ours, other = (find(flown, "scenario-2", name) for name in ("dr-acbf-gs", "dr-acbf-qp"))
    gap = None if ours is None or other is None else paired(ours, other)
    if gap is not None and gap.low is not None and gap.high is not None:
        similar = gap.low <= 0 <= gap.high
        rows.append(measured("projection-success", holds(similar), [ours, other], gap, gap=gap.value))
    return rows


def _hardware(flown: Sequence[Flown]) -> list[Measured]:
    """Tables IV and V, whose flights are simulated here."""
    values: tuple[tuple[str, _Get, float], ...] = (
        ("v_cl", lambda m: m.closing_m_s, 1.0),
        ("t_a", lambda m: m.avoid_s, 1e3),
        ("t_d", detection_time, 1e3),
        ("d_s", lambda m: m.separation_m, 1.0),
    )
    rows = []
    for key in DRACBF_PRINTED["hardware"]:
        scenario, number = key.split("/")
        f, i = find(flown, scenario, "as-printed"), int(number) - 1
        for symbol, get, factor in values:
            rows.append(_simulated(f"hardware/{key}/{symbol}", f, i, get, factor))
        rows += stated(DRACBF, f"hardware/{key}/t_r", f"hardware/{key}/t_cm")
        if f is not None:
            row, now = f"hardware/{key}/safe", success(f, i)
            verdict: Verdict = "bounded" if now.ends[1] >= DRACBF.limit(row) else "refuted"
            rows.append(measured(row, verdict, [f], now, value=now.value))
    return [*rows, *stated(DRACBF, "hardware-setup")]


def _simulated(row: str, f: Flown | None, obstacle: int, get: _Get, factor: float) -> Measured:
    """A mean of the simulated counterpart of a flight of hardware, which is no such flight."""

    def scaled(met: ObstacleResult) -> float | None:
        value = get(met)
        return None if value is None else factor * value

    if f is None:
        return _missing(row)
    found = _mean(row, f, scaled, obstacle, math.nan)
    values = {name: value for name, value in found.values.items() if name != "why"}
    return measured(
        row, "not available here", [f] if found.runs else [], (found.low, found.high), **values, why=HARDWARE
    )
