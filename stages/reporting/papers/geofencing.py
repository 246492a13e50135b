"""The tables of the geofencing paper from runs of flights in a fence, and what goes beyond them.

Runs of one folder fly the same trials, as far as their starts are safe for each filter.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from alula.schemas.fence_ticks import Ticks
from alula.schemas.run import FenceResult, RunRecord
from alula.stages.reporting.papers.published import GEOFENCING
from alula.stages.reporting.statistics import Rate, rate
from alula.stages.reporting.tables import Table, flat, text

KM_H = 3.6  # of 1 m/s
FREE, BASE, PROGRAM = "none", "geofence", "backup-qp"
_ASKED = ("passed", "blended", "backup")  # statuses with a share of the pilot
_SHARES = ("passed", "blended", "backup", "no_pilot", "hand_over")


@dataclass(frozen=True, slots=True)
class Fenced:
    """One run: flights of one variant in one scenario, which is its folder's name; and its first's ticks."""

    scenario: str
    variant: str
    record: RunRecord
    ticks: Ticks | None = None

    @property
    def results(self) -> list[FenceResult]:
        """What each flight says of its fence."""
        return [trial.fence for trial in self.record.trials if trial.fence is not None]

    @property
    def left(self) -> Rate:
        """The share of flights that left the fence."""
        return rate(trial.collision for trial in self.record.trials)

    @property
    def least_m(self) -> float:
        """Least distance to the fence of all flights."""
        return min(math.inf if t.map_clearance_m is None else t.map_clearance_m for t in self.record.trials)

    @property
    def parameters(self) -> dict[str, Any]:
        """What was flown, one level of dotted keys."""
        return flat(self.record.provenance.parameters)

    @property
    def radius_m(self) -> float:
        """Of the vehicle."""
        changed = self.parameters.get("vehicle.radius_m")
        return float(self.parameters["vehicle_file.body.radius_m"] if changed is None else changed)

    @property
    def reserve_m(self) -> float:
        """What the filter keeps beyond its margin."""
        return float(self.parameters.get("filter.parameters.reserve_m") or 0.0)

    def steps(self, *names: str) -> int:
        """Ticks of some status, of all flights."""
        return sum(getattr(result, f"{name}_steps") for result in self.results for name in names)

    def timing(self, key: str) -> float | None:
        """A measured time [s], or count."""
        found = (self.record.timing or {}).get(key)
        return None if found is None else float(found)


def select(runs: Iterable[Fenced], scenario: str, variants: Sequence[str] | None = None) -> list[Fenced]:
    """Runs of a scenario: those of the variants, in their order, or all."""
    here = [run for run in runs if run.scenario == scenario]
    return here if variants is None else [run for name in variants for run in here if run.variant == name]


def find(runs: Iterable[Fenced], scenario: str, variant: str) -> Fenced | None:
    """The run of a variant, if there is one."""
    return next(iter(select(runs, scenario, [variant])), None)


@dataclass(frozen=True, slots=True)
class Approach:
    """One flight against a barrier, from its ticks.

    Distances are those of the sphere to the nearest face; `braking_m` is that when it was fastest, `halved_m`
    when the pilot's share first fell below 1/2, `rest_m` at the end. `tilt_deg` is the largest after it was
    fastest; `helpless_s` how long u_B flew alone in all, outages of radio and navigation aside;
    `engagements` how often it fell below 1/2 from above 9/10.
    """

    peak_km_h: float
    braking_m: float
    halved_m: float | None
    tilt_deg: float
    least_m: float
    rest_m: float
    least_share: float
    helpless_s: float
    engagements: int


def approach(ticks: Ticks) -> Approach:
    """What a flight was like; its samples are the filter's ticks, at equal times."""
    speed = np.linalg.norm(ticks.velocity, axis=1)
    fastest = int(np.argmax(speed))
    asked = np.array([word in _ASKED for word in ticks.status])
    share = np.where(asked & np.isfinite(ticks.regulation), ticks.regulation, 1.0)
    low = np.flatnonzero(share < 0.5)
    tick_s = float(ticks.time_s[1] - ticks.time_s[0]) if len(ticks.time_s) > 1 else 0.0
    return Approach(
        peak_km_h=KM_H * float(speed[fastest]),
        braking_m=float(ticks.distance_m[fastest]),
        halved_m=float(ticks.distance_m[low[0]]) if len(low) else None,
        tilt_deg=math.degrees(float(ticks.tilt_rad[fastest:].max())),
        least_m=float(ticks.distance_m.min()),
        rest_m=float(ticks.distance_m[-1]),
        least_share=float(share.min()),
        helpless_s=tick_s * ticks.status.count("backup"),
        engagements=engagements(share),
    )


def engagements(share: Sequence[float] | np.ndarray[Any, Any]) -> int:
    """How often a pilot's share falls below 1/2 after it was above 9/10; it begins above."""
    count, free = 0, True
    for value in share:
        if value < 0.5 and free:
            count, free = count + 1, False
        free = free or value > 0.9
    return count


def approach_table(runs: Sequence[Fenced], scenario: str, title: str, note: str) -> Table | None:
    """Flights against one barrier beside the published ones; None without runs."""
    rows: list[tuple[Any, ...]] = []
    for run in select(runs, scenario):
        if run.ticks is None:
            continue
        a = approach(run.ticks)
        shares = (a.halved_m, a.least_share, 1e3 * a.helpless_s)  # of the other filters there is no lambda
        halved, least_share, helpless = shares if run.record.filter == BASE else (None, None, None)
        rows.append(
            (
                *(run.variant, changed(run), a.peak_km_h, a.braking_m + run.radius_m),
                *(None if halved is None else halved + run.radius_m, a.tilt_deg, run.least_m),
                *(run.least_m + run.radius_m, a.rest_m + run.radius_m, least_share, helpless),
                "left" if run.left.value else "held",
            )
        )
    if not rows:
        return None
    for name, said in GEOFENCING[scenario].items():
        keys = ("peak_km_h", "braking_m", None, "tilt_deg", None, "least_m", "rest_m", "least_share")
        rows.append(
            (f"published, {name}", "", *(said.get(key) if key else None for key in keys), None, "held")
        )
    columns = (
        *("variant", "changed", "fastest [km/h]", "brakes from [m]", "λ below 1/2 from [m]", "tilt [°]"),
        *(
            "least distance [m]",
            "of the centre [m]",
            "centre at the end [m]",
            "least λ",
            "λ = 0 [ms]",
            "fence",
        ),
    )
    return Table(scenario, title, columns, tuple(rows), note)


WALL_NOTE = (
    "Distances are those of the centre, as the published ones are taken to be, but for the least distance, "
    "which is that of the sphere. Brakes from: where it was fastest; tilt: the largest after that. The model "
    "has no drag, like the paper's; `drag` flies with some that the filter does not know of. `rule-10`: the "
    "regulation (10) without the scaling by the speed (19)."
)
_PLUNGE_M_S = GEOFENCING["fall"]["simulation"]["peak_km_h"] / KM_H
FALL_NOTE = (
    f"As above. A fall without drag that is at its fastest with {KM_H * _PLUNGE_M_S:.0f} km/h is one of "
    f"{_PLUNGE_M_S**2 / (2 * 9.81):.1f} m, so the published filter brakes far above its barrier. Ours, with "
    "the published gains, brakes where braking still suffices, and so later; `gentle` has a slower "
    "regulation, `drag` some drag. `radio`: not even a silent throttle comes in, which the filter takes for "
    "a lost link, and hovers."
)


def changed(run: Fenced) -> str:
    """What a variant says of vehicle, filter and start that is not so by default, in words."""
    words = []
    for key, value in run.parameters.items():
        table, _, name = key.partition(".")
        if table == "vehicle" and not key.endswith("_scale") and value is not None:
            words.append(f"{name} {_listed(value)}")
        elif table == "vehicle" and key.endswith("_scale") and value != 1:
            words.append(f"{name} {text(value)}")
        elif key in ("filter.parameters.beta", "filter.parameters.fast_m_s"):
            words += [] if value == _PUBLISHED[key] else [f"{key.rpartition('.')[2]} {text(value)}"]
        elif key in ("filter.parameters.reserve_m", "filter.parameters.latency_s") and value:
            words.append(f"{key.rpartition('.')[2]} {text(value)}")
        elif key == "filter.name" and value != BASE:
            words.append(f"filter {value}")
        elif table == "run" and key.endswith("_from_s") and value is not None:
            lasts = run.parameters.get(key.replace("_from_", "_for_"))
            words.append(f"no {'navigation' if 'stale' in key else 'radio'} from {text(value)} s")
            words[-1] += "" if lasts is None else f" for {text(lasts)} s"
    return ", ".join(words)


_PUBLISHED = {"filter.parameters.beta": 1.5, "filter.parameters.fast_m_s": 10.0}


def _listed(value: Any) -> str:
    return f"({text(list(value))})" if isinstance(value, list | tuple) else text(value)


def flights_table(runs: Sequence[Fenced], name: str, title: str, scenarios: Sequence[str]) -> Table | None:
    """Many flights of each run: how many left the fence, and who flew; None without runs."""
    here = [run for scenario in scenarios for run in select(runs, scenario)]
    rows = []
    for run in here:
        total = sum(trial.steps for trial in run.record.trials)
        found = run.results
        rows.append(
            (
                *(run.scenario, run.variant, changed(run), run.left.n, *run.left.cells, run.least_m),
                KM_H * max(trial.max_speed_m_s for trial in run.record.trials),
                sum(result.interventions for result in found) / max(1, len(found)),
                *(100 * run.steps(status) / total for status in _SHARES),
                max((result.longest_backup_s for result in found), default=None),
            )
        )
    columns = (
        *("fence", "variant", "changed", "flights", "left the fence [%]", "95 % low", "95 % high"),
        *(
            "least distance [m]",
            "fastest [km/h]",
            "engagements per flight",
            "pilot's bits [%]",
            "blended [%]",
        ),
        *("u_B alone [%]", "no pilot [%]", "handed over [%]", "longest u_B alone [s]"),
    )
    note = (
        "Judged at every step of the plant, in double precision, along the chord since the last. An "
        "engagement begins where λ falls below 1/2 after it was above 9/10. Intervals are Wilson's."
    )
    return Table(name, title, columns, tuple(rows), note) if rows else None


def filters_table(runs: Sequence[Fenced], scenario: str, names: Sequence[str]) -> Table | None:
    """Filters on the same flights; None without runs."""
    rows = []
    for run in select(runs, scenario, names):
        total = sum(trial.steps for trial in run.record.trials)
        micro = [_scaled(run.timing(f"filter_{key}_s"), 1e6) for key in ("p50", "p99")]
        rows.append(
            (
                *(run.record.filter, run.left.n, *run.left.cells, run.least_m),
                *(100 * run.steps(status) / total for status in ("passed", "blended", "backup")),
                *(micro if run.record.filter != FREE else (None, None)),
            )
        )
    columns = (
        *("filter", "flights", "left the fence [%]", "95 % low", "95 % high", "least distance [m]"),
        *("pilot's bits [%]", "changed [%]", "u_B alone [%]", "tick p50 [µs]", "tick p99 [µs]"),
    )
    note = (
        "The same pilots from the same starts. u_B alone: h_I is not positive, or the program has no "
        "solution. Times are measured while the flights were flown, with whatever else the machine did; "
        "the program's rows are ours, pruned of those that cannot bind."
    )
    return Table("filters", "Filters beside each other", columns, tuple(rows), note) if rows else None


def _scaled(value: float | None, by: float) -> float | None:
    return None if value is None else value * by


def passes_table(runs: Sequence[Fenced]) -> Table | None:
    """Whether passed commands are the pilot's, bit by bit, per fence; None without runs."""
    guarded = [run for run in runs if run.record.filter == BASE]
    rows: list[tuple[Any, ...]] = []
    for scenario in dict.fromkeys(run.scenario for run in guarded):
        rows.append((scenario, *_passes(select(guarded, scenario))))
    if not rows:
        return None
    rows.append(("all", *_passes(guarded)))
    columns = ("fence", "flights", "ticks", "passed: λ rounds to 1", "of these altered", "beyond the limits")
    note = (
        "Passed only where 1 - exp(-x) rounds to 1 in single precision, so far from the fence; closer, where "
        "the pilot's share is almost 1, his command is rounded. Altered: a passed command of which a bit is "
        "not his, counted in the flight. Beyond the limits: commands outside of the throttle's or the rates' "
        "range, or λ outside of 0 to 1."
    )
    return Table("passes", "Passed commands, bit by bit", columns, tuple(rows), note)


def _passes(runs: Sequence[Fenced]) -> tuple[int, int, int, int, int]:
    def total(get: Callable[[FenceResult], int]) -> int:
        return sum(get(result) for run in runs for result in run.results)

    return (
        sum(len(run.record.trials) for run in runs),
        sum(trial.steps for run in runs for trial in run.record.trials),
        total(lambda r: r.passed_steps),
        total(lambda r: r.altered_passes),
        total(lambda r: r.out_of_range),
    )
