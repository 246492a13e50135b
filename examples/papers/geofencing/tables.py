"""Tables of the geofencing paper from runs of flights in a fence, further tables, and a summary of all.

Approaches to a barrier, many flights in all fences, filters side by side, passed commands, the reserve
against disturbances, and random pilots. Runs of one folder fly the same trials, as far as their starts are
safe for each filter. The module is long because it is one page: each table is one function and its note.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.log.run import FenceResult, RunRecord
from alula.stages.reporting.fenced import fence_distance
from alula.stages.reporting.statistics import Rate, rate
from alula.stages.reporting.table import HIGH, LOW, Table, flat, text
from alula.stages.vehicles.fence import fence_faces
from papers.geofencing.pendulum import Swing, gains_in_short, times_in_short
from papers.geofencing.ticks import Ticks
from papers.published import GEOFENCING

KM_H = 3.6  # of 1 m/s
FREE, BASE, PROGRAM = "none", "geofence", "backup-qp"
ROBUSTNESS, PILOTS = "robustness", "pilots"  # folders
_REGULATED = ("passed", "blended", "backup")  # statuses with a regulation function lambda
_STATUSES = ("passed", "blended", "backup", "no_pilot", "hand_over")


@dataclass(frozen=True, slots=True)
class Fenced:
    """One run: flights of one variant in one scenario (its folder's name); ticks of the first flight."""

    scenario: str
    variant: str
    record: RunRecord
    ticks: Ticks | None = None

    @property
    def file(self) -> str:
        """Its log below the example's output folder."""
        return f"{self.scenario}/{self.variant}.run.mcap"

    @property
    def flights(self) -> int:
        """Number of flights."""
        return len(self.record.trials)

    @property
    def results(self) -> list[FenceResult]:
        """Results of all flights for their fence."""
        return [trial.fence for trial in self.record.trials if trial.fence is not None]

    @property
    def left(self) -> Rate:
        """Percentage of flights that left the fence; without an interval where all are the same flight."""
        found = rate(trial.collision for trial in self.record.trials)
        if "success_interval" not in (summary := self.record.summary):
            return found
        interval = summary["success_interval"]
        low, high = (None, None) if interval is None else (100 * (1 - end) for end in reversed(interval))
        return replace(found, low=low, high=high)

    @property
    def least_m(self) -> float:
        """Minimum distance to the fence over all flights [m]."""
        return min(map(fence_distance, self.record.trials))

    @property
    def parameters(self) -> dict[str, Any]:
        """Parameters of the run, one level of dotted keys."""
        return flat(self.record.provenance.parameters)

    @property
    def radius_m(self) -> float:
        """Radius of the vehicle's sphere [m]."""
        changed = self.parameters.get("vehicle.radius_m")
        return float(self.parameters["vehicle_file.body.radius_m"] if changed is None else changed)

    @property
    def reserve_m(self) -> float:
        """Distance that the filter keeps in addition to its margin [m]."""
        return float(self.of_filter("reserve_m") or 0.0)

    def of_filter(self, name: str) -> Any:
        """A parameter of the filter, from its table; without a filter, of the geofence that judges."""
        return self.parameters.get(f"safety.{BASE}.{name}")

    def steps(self, *names: str) -> int:
        """Number of ticks with one of some statuses, over all flights."""
        return sum(getattr(result, f"{name}_steps") for result in self.results for name in names)

    def timing(self, key: str) -> float | None:
        """A measured time [s] or count; None where it was not measured."""
        found = (self.record.timing or {}).get(key)
        return None if found is None else float(found)


def select(runs: Iterable[Fenced], scenario: str, variants: Sequence[str] | None = None) -> list[Fenced]:
    """Select the runs of a scenario: those of the variants, in their order, or all."""
    here = [run for run in runs if run.scenario == scenario]
    return here if variants is None else [run for name in variants for run in here if run.variant == name]


def find(runs: Iterable[Fenced], scenario: str, variant: str) -> Fenced | None:
    """Find the run of a variant; None when there is none."""
    return next(iter(select(runs, scenario, [variant])), None)


@dataclass(frozen=True, slots=True)
class Approach:
    """One flight against a barrier, from its ticks; distances are those of the sphere.

    Attributes:
        peak_km_h: maximum speed.
        braking_m: distance at the maximum speed, where braking begins, from the face that is flown at.
        halved_m: the same where lambda first falls below 1/2; None where it does not.
        tilt_deg: maximum tilt after the maximum speed.
        least_m: minimum distance from any face.
        rest_m: distance from any face at the end.
        min_lambda: minimum of the regulation function.
        backup_s: total time of the backup controller u_B alone, without outages of radio and navigation.
        engagements: number of times that lambda falls below 1/2 from above 9/10.
    """

    peak_km_h: float
    braking_m: float
    halved_m: float | None
    tilt_deg: float
    least_m: float
    rest_m: float
    min_lambda: float
    backup_s: float
    engagements: int


def approach(ticks: Ticks, faces: FloatArray | None = None, radius_m: float = 0.0) -> Approach:
    """Summarise a flight against a barrier; its samples are the filter's ticks, at equal intervals.

    Args:
        ticks: of the flight.
        faces: of the fence, shape (L, 4), rows (n, d) with unit n; without them, the distances where braking
            begins are those from the nearest face.
        radius_m: of the sphere [m].
    """

    def distance(at: int) -> float:
        if faces is None:
            return float(ticks.distance_m[at])
        return distance_ahead(faces, ticks.position[at], ticks.velocity[at]) - radius_m

    speed = np.linalg.norm(ticks.velocity, axis=1)
    fastest = int(np.argmax(speed))
    is_regulated = np.array([status in _REGULATED for status in ticks.status])
    regulation = np.where(is_regulated & np.isfinite(ticks.regulation), ticks.regulation, 1.0)
    low = np.flatnonzero(regulation < 0.5)
    tick_s = float(ticks.time_s[1] - ticks.time_s[0]) if len(ticks.time_s) > 1 else 0.0
    return Approach(
        peak_km_h=KM_H * float(speed[fastest]),
        braking_m=distance(fastest),
        halved_m=distance(int(low[0])) if len(low) else None,
        tilt_deg=math.degrees(float(ticks.tilt_rad[fastest:].max())),
        least_m=float(ticks.distance_m.min()),
        rest_m=float(ticks.distance_m[-1]),
        min_lambda=float(regulation.min()),
        backup_s=tick_s * ticks.status.count("backup"),
        engagements=engagements(regulation),
    )


def distance_ahead(faces: FloatArray, position: FloatArray, velocity: FloatArray) -> float:
    """Distance of a point from the face that a straight flight meets first, else from the nearest face.

    Args:
        faces: shape (L, 4), rows (n, d) with unit n and n . p <= d inside.
        position: shape (3,) [m].
        velocity: shape (3,) [m/s].
    """
    distance, speed = faces[:, 3] - faces[:, :3] @ position, faces[:, :3] @ velocity
    time = np.where(speed > 0, distance / np.where(speed > 0, speed, 1.0), np.inf)
    return float(distance[np.argmin(time)] if np.isfinite(time).any() else distance.min())


def approach_of(run: Fenced) -> Approach | None:
    """Summarise the first flight of a run; None without its ticks."""
    if run.ticks is None:
        return None
    box, rows = run.parameters.get("world.fence.box_m"), run.parameters.get("world.fence.faces") or ()
    faces = fence_faces(box, rows) if box is not None or len(rows) else None
    return approach(run.ticks, faces, run.radius_m)


def engagements(regulation: Sequence[float] | np.ndarray[Any, Any]) -> int:
    """Count how often lambda falls below 1/2 after it was above 9/10; it counts as above at the start.

    Args:
        regulation: lambda by tick, shape (n,).
    """
    count, free = 0, True
    for value in regulation:
        if value < 0.5 and free:
            count, free = count + 1, False
        free = free or value > 0.9
    return count


def approach_table(runs: Sequence[Fenced], scenario: str, title: str, note: str) -> Table | None:
    """Compare flights against one barrier with the published ones; None without runs.

    Args:
        runs: all runs; those of the scenario with logged ticks count.
        scenario: a key of `GEOFENCING`, `wall` or `fall`.
        title: of the table.
        note: of the table.
    """
    rows: list[tuple[Any, ...]] = []
    for run in select(runs, scenario):
        a = approach_of(run)
        if a is None:
            continue
        values = (a.halved_m, a.min_lambda, 1e3 * a.backup_s)  # other filters have no lambda
        halved, min_lambda, backup_ms = values if run.record.filter == BASE else (None, None, None)
        rows.append(
            (
                *(run.variant, changed(run), a.peak_km_h, a.braking_m + run.radius_m),
                *(None if halved is None else halved + run.radius_m, a.tilt_deg, run.least_m),
                *(run.least_m + run.radius_m, a.rest_m + run.radius_m, min_lambda, backup_ms),
                "left" if run.left.value else "held",
            )
        )
    if not rows:
        return None
    for name, published in GEOFENCING[scenario].items():
        keys = ("peak_km_h", "braking_m", None, "tilt_deg", None, "least_m", "rest_m", None)
        rows.append(
            (f"published, {name}", "", *(published.get(key) if key else None for key in keys), None, "held")
        )
    columns = (
        *("variant", "changed", "peak speed [km/h]", "brakes at [m]", "λ below 1/2 at [m]", "tilt [°]"),
        *("minimum distance [m]", "minimum, centre [m]", "at the end, centre [m]", "minimum λ"),
        *("λ = 0 [ms]", "fence"),
    )
    return Table(scenario, title, columns, tuple(rows), note)


WALL_NOTE = (
    "Distances are those of the centre, as the published ones are assumed to be; only the column of the "
    "minimum distance is that of the sphere. Brakes at: distance at the peak speed from the face that is "
    "flown at; λ below 1/2: the same where λ first falls below 1/2; tilt: maximum after the peak. The model "
    "has no drag, like the paper's; `drag` flies with drag that the filter does not model. `rule-10`: "
    "regulation (10) without the scaling by the speed (19)."
)
_PLUNGE_M_S = GEOFENCING["fall"]["simulation"]["peak_km_h"] / KM_H
FALL_NOTE = (
    f"As above. A fall without drag that peaks at {KM_H * _PLUNGE_M_S:.0f} km/h is one of "
    f"{_PLUNGE_M_S**2 / (2 * 9.81):.1f} m, so the published filter brakes far above its barrier. Ours, with "
    "the published gains, brakes later, where braking still suffices; `gentle` has a slower regulation, "
    "`drag` some drag. `radio`: not even a command of no throttle arrives; the filter treats this as a lost "
    "link and hovers."
)


def changed(run: Fenced) -> str:
    """List in words the parameters of vehicle, filter and start that differ from their defaults."""
    words = []
    for key, value in run.parameters.items():
        table, _, name = key.rpartition(".")
        is_own = table == "vehicle.disturbance" or key in ("vehicle.radius_m", "estimation.delay_s")
        if is_own and value is not None:
            words.append(f"{name} {_listed(value)}")
        elif table == "vehicle" and key.endswith("_scale") and value != 1:
            words.append(f"{name} {text(value)}")
        elif key in _OUTAGES and value is not None:
            lasts = run.parameters.get(key.replace("_from_", "_for_"))
            words.append(f"no {_OUTAGES[key]} from {text(value)} s")
            words[-1] += "" if lasts is None else f" for {text(lasts)} s"
    words += [] if run.record.filter == BASE else [f"filter {run.record.filter}"]
    given = {name: run.of_filter(name) for name in _PUBLISHED}
    words += [
        f"{name} {text(value)}" for name, value in given.items() if value not in (None, _PUBLISHED[name])
    ]
    return ", ".join(words)


_PUBLISHED = {"beta": 1.5, "fast_m_s": 10.0, "reserve_m": 0.0, "latency_s": 0.0}
_OUTAGES = {"estimation.lost_from_s": "navigation", "mission.pilot.radio_from_s": "radio"}


def _listed(value: Any) -> str:
    return f"({text(list(value))})" if isinstance(value, list | tuple) else text(value)


def flights_table(runs: Sequence[Fenced], name: str, title: str, scenarios: Sequence[str]) -> Table | None:
    """Tabulate many flights of each run: how many left the fence, and ticks by status; None without runs.

    Args:
        runs: all runs.
        name: of the table.
        title: of the table.
        scenarios: scenarios to include, in their order.
    """
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
                *(100 * run.steps(status) / total for status in _STATUSES),
                max((result.longest_backup_s for result in found), default=None),
            )
        )
    columns = (
        *("fence", "variant", "changed", "flights", "left the fence [%]", LOW, HIGH),
        *("minimum distance [m]", "peak speed [km/h]", "engagements per flight", "passed [%]", "blended [%]"),
        *("u_B alone [%]", "no pilot [%]", "handed over [%]", "longest u_B alone [s]"),
    )
    note = (
        "Distances are computed at every step of the plant, in double precision, along the chord from the "
        "step before. An engagement begins where λ falls below 1/2 after it was above 9/10. Passed: the "
        "pilot's command, bit for bit. Intervals are Wilson intervals; flights "
        "without a random number have none, because they would repeat themselves."
    )
    return Table(name, title, columns, tuple(rows), note) if rows else None


def filters_table(runs: Sequence[Fenced], scenario: str, names: Sequence[str]) -> Table | None:
    """Compare filters on the same flights; None without runs.

    Args:
        runs: all runs.
        scenario: scenario with one run per filter.
        names: its variants, in the order of the rows.
    """
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
        *("filter", "flights", "left the fence [%]", LOW, HIGH, "minimum distance [m]"),
        *("passed [%]", "changed [%]", "u_B alone [%]", "tick p50 [µs]", "tick p99 [µs]"),
    )
    note = (
        "The same pilots from the same starts. u_B alone: h_I is not positive, or the program has no "
        "solution. Times were measured during the flights, on a machine that also ran other programs; the "
        "program has our rows, without those that cannot become active."
    )
    return Table("filters", "Filters side by side", columns, tuple(rows), note) if rows else None


def _scaled(value: float | None, by: float) -> float | None:
    return None if value is None else value * by


def passes_table(runs: Sequence[Fenced]) -> Table | None:
    """Count by fence the passed commands that differ from the pilot's in a bit; None without runs."""
    guarded = [run for run in runs if run.record.filter == BASE]
    rows: list[tuple[Any, ...]] = []
    for scenario in dict.fromkeys(run.scenario for run in guarded):
        rows.append((scenario, *_passes(select(guarded, scenario))))
    if not rows:
        return None
    rows.append(("all", *_passes(guarded)))
    columns = ("fence", "flights", "ticks", "passed: λ rounds to 1", "altered", "outside the limits")
    note = (
        "A command passes only where 1 - exp(-x) rounds to 1 in single precision, far from the fence. "
        "Closer, where λ is almost 1, the command is rounded. Altered: passed commands that differ from the "
        "pilot's in a bit, counted during the flight. Outside the limits: commands outside the range of the "
        "throttle or the rates, or λ outside 0 to 1."
    )
    return Table("passes", "Passed commands, bit for bit", columns, tuple(rows), note)


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


@dataclass(frozen=True, slots=True)
class Disturbed:
    """Runs of one disturbance, by increasing reserve.

    `enough` is the run with the smallest reserve at which, and at all larger ones, no flight left the fence;
    None when there is none.
    """

    name: str
    runs: tuple[Fenced, ...]
    enough: Fenced | None


def disturbed(runs: Sequence[Fenced]) -> list[Disturbed]:
    """Group the runs of the folder by disturbance; a variant is named DISTURBANCE_RESERVE."""
    groups: dict[str, list[Fenced]] = {}
    for run in select(runs, ROBUSTNESS):
        groups.setdefault(run.variant.rpartition("_")[0], []).append(run)
    found = []
    for name, members in groups.items():
        ordered = sorted(members, key=lambda run: run.reserve_m)
        enough = None
        for run in reversed(ordered):
            if run.left.value:
                break
            enough = run
        found.append(Disturbed(name, tuple(ordered), enough))
    return found


def robustness_table(runs: Sequence[Fenced]) -> Table | None:
    """Tabulate each disturbance without a reserve and with the smallest sufficient one; None without runs."""
    rows: list[tuple[Any, ...]] = []
    for group in disturbed(runs):
        bare, enough = group.runs[0], group.enough
        words = [w for w in changed(bare).split(", ") if not w.startswith("reserve_m")]
        row: list[Any] = [group.name, ", ".join(words), bare.left.n, *bare.left.cells, bare.least_m]
        row += [None] * 5 if enough is None else [enough.reserve_m, *enough.left.cells, enough.least_m]
        rows.append(tuple(row))
    if not rows:
        return None
    columns = (
        *("disturbance", "changed parameters", "flights", "no reserve: left [%]"),
        *(LOW, HIGH, "no reserve: minimum distance [m]", "sufficient reserve [m]"),
        *("with it: left [%]", LOW, HIGH, "with it: minimum distance [m]"),
    )
    grid = sorted({run.reserve_m for run in select(runs, ROBUSTNESS)})
    note = (
        f"Aggressive pilots in the box, each with reserves of {text(grid)} m. Sufficient is the smallest of "
        "these at which, and at all larger ones, no flight left the fence. None of n flights is no proof: "
        "the interval gives the rates that n flights cannot exclude. Starts are safe for the filter with "
        "its reserve, so they differ slightly. `delay-known`: the filter models the delay (latency_s)."
    )
    title = "Robustness: the reserve that compensates each disturbance"
    return Table(ROBUSTNESS, title, columns, tuple(rows), note)


def pilots_rate(runs: Sequence[Fenced], name: str) -> Rate | None:
    """Percentage of the flights of all pilots with a filter that left the fence; None without flights."""
    here = [run for run in select(runs, PILOTS) if run.record.filter == name]
    return rate(t.collision for run in here for t in run.record.trials) if here else None


def pilots_table(runs: Sequence[Fenced]) -> Table | None:
    """Tabulate all pilots together by filter; None without runs."""
    rows = []
    for name in (BASE, PROGRAM, FREE):
        here = [run for run in select(runs, PILOTS) if run.record.filter == name]
        found = pilots_rate(runs, name)
        if not here or found is None:
            continue
        kinds = dict.fromkeys(run.variant.removesuffix(f"-{name}") for run in here)
        rows.append(
            (
                *(name, len(kinds), found.n, sum(t.collision for run in here for t in run.record.trials)),
                *(*found.cells, min(run.least_m for run in here)),
                sum(result.interventions for run in here for result in run.results),
                sum(result.altered_passes for run in here for result in run.results),
            )
        )
    if not rows:
        return None
    columns = (
        *("filter", "kinds of pilots", "flights", "left the fence", "left [%]", LOW, HIGH),
        *("minimum distance [m]", "engagements", "altered passed commands"),
    )
    note = (
        "Vehicle as modelled, random starts in the safe set; fewer flights without a filter and with the "
        "program."
    )
    return Table(PILOTS, "Random pilots from random safe starts", columns, tuple(rows), note)


def in_short(runs: Sequence[Fenced], swings: Sequence[Swing], measured: Mapping[str, Any]) -> dict[str, str]:
    """Summarise the experiments, one line per subject.

    Args:
        runs: all runs.
        swings: pendulum flights.
        measured: times measured by examples/geofencing/pendulum.py.
    """
    facts = {
        "flown": f"{sum(len(run.record.trials) for run in runs):,} flights in {len(runs)} runs",
        "pendulum, time": times_in_short(measured),
        "pendulum, gains": gains_in_short(swings),
    }
    for scenario, variant, what in (("wall", "from-40", "wall, 40 m"), ("fall", "fall", "fall, 70 m")):
        run = find(runs, scenario, variant)
        if run is not None and (a := approach_of(run)) is not None:
            facts[what] = _approached(run, a, GEOFENCING[scenario])
    facts |= _fastest(runs)
    for run in select(runs, "engaged"):
        if run.record.filter == BASE:
            facts[f"repeated engagement, {run.variant}"] = _engaged(run)
    for scenario in ("box", "faces", "cover", "combined"):
        whole = [run for run in select(runs, scenario) if run.steps("hand_over") == 0]
        if whole:
            n = sum(run.left.n for run in whole)
            out = sum(t.collision for run in whole for t in run.record.trials)
            minimum = text(min(run.least_m for run in whole))
            facts[f"fence {scenario}"] = f"{out} of {n:,} flights left it, minimum distance {minimum} m"
    for group in disturbed(runs):
        enough = "none of the grid" if group.enough is None else f"{text(group.enough.reserve_m)} m"
        facts[f"disturbance {group.name}"] = (
            f"without reserve {group.runs[0].left} left; sufficient reserve: {enough}"
        )
    for name in (BASE, "backup-qp", "none"):
        found_rate = pilots_rate(runs, name)
        if found_rate is not None:
            facts[f"random pilots, {name}"] = f"{found_rate} of {found_rate.n:,} flights left"
    guarded = [run for run in runs if run.record.filter == BASE]
    passed = sum(run.steps("passed") for run in guarded)
    altered = sum(result.altered_passes for run in guarded for result in run.results)
    facts["passed commands"] = f"{altered} of {passed:,} differ from the pilot's in a bit"
    return facts


def _approached(run: Fenced, a: Approach, published: Mapping[str, Mapping[str, float]]) -> str:
    """Compare a flight against a barrier with the published ones, in words."""
    names = {
        "peak_km_h": "peak speed {} km/h",
        "braking_m": "brakes at {} m",
        "least_m": "minimum distance {} m",
        "rest_m": "at rest {} m",
    }
    theirs = "; ".join(
        f"{kind} {', '.join(form.format(text(value[key])) for key, form in names.items() if key in value)}"
        for kind, value in published.items()
    )
    return (
        f"peak speed {text(a.peak_km_h)} km/h, brakes at {text(a.braking_m + run.radius_m)} m, tilt "
        f"{text(a.tilt_deg)}°, minimum distance {text(a.least_m)} m of the sphere and "
        f"{text(a.least_m + run.radius_m)} m of its centre, at rest {text(a.rest_m + run.radius_m)} m; "
        f"minimum λ {text(a.min_lambda)}, λ = 0 for {text(1e3 * a.backup_s)} ms (published: {theirs})"
    )


def _engaged(run: Fenced) -> str:
    """Summarise many engagements, and whether lambda ever fell to 0."""
    found = run.results
    lost = sum(r.backup_steps > 0 for r in found)
    speed = KM_H * max(t.max_speed_m_s for t in run.record.trials)
    longest = max(r.longest_backup_s for r in found)
    return (
        f"{sum(r.interventions for r in found):,} engagements in {len(found)} flights at up to {text(speed)} "
        f"km/h, {sum(t.collision for t in run.record.trials)} left the fence; λ falls to 0 in {lost} of them"
        f"{f', for at most {text(longest)} s at a time' if lost else ''} (published: never)"
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
    count = sum(one.record.filter == BASE for one in select(runs, "wall"))
    words = f"{text(speed)} km/h ({run.variant}), minimum distance {text(run.least_m)} m; {len(held)} of "
    words += f"{count} approaches held" + (f"; λ above 0 up to {text(max(free))} km/h" if free else "")
    return {"wall, fastest": words}
