"""The same flights through the built-in room on the real autopilot, on the simulated one, and in `simulate`.

Each filter flies a plan there and back at each speed. On the real program, which ALULA_ARDUCOPTER names,
`alula fly` runs in a process of its own, in real time, several vehicles at once. On the simulated autopilot
the same loop and link run in lock-step with it, with the default noise of its estimate. `alula simulate`
flies scenarios with that noise and the vehicle that `alula identify` measured. All are judged by the true
motion while set-points were sent: SIM_STATE at 20 Hz, or the simulated truth at 100 Hz, joined by segments.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
import os
import shutil
import sys
import tempfile
import threading
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).resolve().parent))
sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
sys.path.sort(key=lambda path: path in sys.path[-2:])  # last: modules of the same names come first

import numpy as np
from fly import GOAL, OTHERS, START, VIA, make_world
from measure import FloatArray
from real_autopilot import FlyProcess, fly_batches, timed, vehicle, with_section
from scipy.spatial import cKDTree

from alula.cli.main import run as alula
from alula.schemas.artifacts.artifact import read_artifact
from alula.schemas.artifacts.kinds import COVER, PLAN, SCENE
from alula.schemas.log.flights import read_flights
from alula.schemas.log.run import read_run
from alula.schemas.parameters.configs.plan import MARGIN_M
from alula.schemas.scenarios.vehicle import read_vehicle
from alula.schemas.toml_file import toml_value
from alula.stages.clearance import hull_obstacles, path_clearance, scene_obstacles
from alula.stages.compression.hulls import Hulls
from alula.stages.flight.loop.supervisor import Event, State
from alula.stages.planning.adherence import PlanJudge, via_tolerance
from alula.stages.planning.plan_samples import sample_plan

ROOT = Path(__file__).resolve().parents[1]
VEHICLE = ROOT / "examples" / "vehicles" / "arducopter.toml"
# Filters by the set-points that carry their output, and the map that they fly in.
FILTERS = {
    "polytope-cbf": ("velocities", "cover"),
    "cone-di": ("accelerations", "scene"),
    "safer-splat": ("accelerations", "scene"),
    "cone-ecbf": ("body rates", "scene"),
    "cone-backup": ("body rates", "scene"),
    "shield": ("body rates", "cover"),
}
_INTERFACES = {"velocities": "velocity", "accelerations": "acceleration", "body rates": "body-rates"}
REAL, SIMULATED, SCENARIO = "ArduPilot's own simulation", "sim-vehicle", "simulate"
# Where the first set-point of `fly` acts after the take-off: below the plan by this part of the height.
_BELOW, _CLIMB_M_S = 0.03, 0.4
_DELAY_S = 0.02  # age of a state on arrival, in `simulate`
AUTOPILOTS = {"real": REAL, "simulated": SIMULATED, "simulate": SCENARIO}
_AGREES = 0.2  # part by which `simulate` may differ from the real autopilot
_BATCH = 6  # flights of one vehicle before the next is started
_SAFE_S = 150.0  # a flight ends before


@dataclasses.dataclass(frozen=True)
class Cell:
    """One flight: where, behind which filter, at which speed, there (0) or back (1)."""

    autopilot: str
    name: str
    speed_m_s: float
    number: int

    @property
    def key(self) -> str:
        """Name of the flight in the file of results."""
        return f"{self.autopilot}/{self.name}/{self.speed_m_s:g}/{self.number}"

    def plan(self, folder: Path) -> Path:
        """Its plan."""
        return plan_path(folder, self.speed_m_s, self.number % 2, FILTERS[self.name][0])

    def map(self, folder: Path) -> Path:
        """Its map."""
        return folder / f"{FILTERS[self.name][1]}.npz"


def plan_path(folder: Path, speed_m_s: float, back: int, setpoints: str) -> Path:
    """Plan there (0) or back (1) for a kind of set-points."""
    return folder / f"{speed_m_s:g}.{back}.{_INTERFACES[setpoints]}.plan.npz"


def make_plans(folder: Path, speeds: list[float]) -> None:
    """Write the plans there and back; they keep the filters' radius and margin from all hulls."""
    for speed, back, setpoints in itertools.product(speeds, (0, 1), _INTERFACES):
        start, goal = ((START, GOAL), (GOAL, START))[back]
        path = plan_path(folder, speed, back, setpoints)
        words = ["plan", str(folder / "cover.npz"), "-o", str(path), "--vehicle", str(VEHICLE), "-f", "-q"]
        words += ["--speed", str(speed), "--interface", _INTERFACES[setpoints], "--beyond-map", "10"]
        for option, point in (("--start", start), ("--via", VIA), ("--goal", goal)):
            words += [option, "{} {} {}".format(*point)]
        if alula(words) != 0:
            raise SystemExit("there is no plan")


class Judge:
    """Judges true paths by the room's hulls and ellipsoids, and by their plan."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.hulls = hull_obstacles(Hulls.from_cover(read_artifact(folder / "cover.npz", COVER)))
        self.scene = scene_obstacles(read_artifact(folder / "scene.npz", SCENE), 1.0)
        self.radius_m = read_vehicle(VEHICLE).body.radius_m

    def __call__(self, cell: Cell, path: FloatArray) -> dict[str, Any]:
        """Figures of a path, shape (T, 3), world frame."""
        path = np.ascontiguousarray(path)
        plan = read_artifact(cell.plan(self.folder), PLAN)
        followed = PlanJudge(plan, [self.hulls], self.radius_m, via_tolerance(None, self.radius_m)).result(
            path
        )
        away = cKDTree(sample_plan(plan, 0.01)).query(path)[0]
        return {
            "hull_clearance_m": float(path_clearance(path, self.hulls).min()) - self.radius_m,
            "scene_clearance_m": float(path_clearance(path, self.scene).min()) - self.radius_m,
            "via_m": max(followed.closest_m),
            "via_missed": len(followed.missed),
            "outside_m": followed.outside_m,
            "away_p95_m": float(np.quantile(away, 0.95)),
            "away_max_m": float(away.max()),
        }


# The simulated autopilot.


def fly_simulated(folder: Path, cell: Cell) -> dict[str, Any]:
    """Fly a cell in lock-step."""
    from alula.stages.sim_vehicle.common.estimator import EstimatorOptions
    from support.flights.flights import mission
    from support.vehicles.lockstep import Flight

    kind = FILTERS[cell.name][1]
    given = {kind: read_artifact(cell.map(folder), COVER if kind == "cover" else SCENE)}
    plan = read_artifact(cell.plan(folder), PLAN)
    vehicle = read_vehicle(VEHICLE)
    made = mission(cell.name, plan=plan, vehicle=vehicle, allow_tight=False, **given)
    flight = Flight(
        made, noise=EstimatorOptions(boot_time_s=0.5), seed=cell.number, limits={"checks_s": 60.0}
    ).fly()
    cause = flight.cause
    path = flight.path(State.FLY, State.HOLD)
    return {
        "is_finished": cause is Event.PLAN_FINISHED,
        "ended_by": "nothing" if cause is None else cause.value,
        "flight_s": float(path[-1, 0] - path[0, 0]),
    } | Judge(folder)(cell, path[:, 1:])


# `alula simulate`, as a user flies it.


def scenario_of(
    folder: Path, vehicle: Path, cells: list[Cell], begin: list[float] | None, noise_m: float | None
) -> dict[str, Any]:
    """The scenario of the flights of a filter along a plan, with the noise of the simulated autopilot.

    They begin as a real flight did, or else a little below the plan's start on the climb to it. The noise of
    the position is that of real flights at this speed, if there are any.
    """
    from alula.stages.sim_vehicle.common.estimator import EstimatorOptions

    first, noise = cells[0], EstimatorOptions()
    kind = FILTERS[first.name][1]
    by_rates = FILTERS[first.name][0] == "body rates"
    x, y, z = (START, GOAL)[first.number % 2]
    begin = begin or [x, y, (1 - _BELOW) * z, 0.0, 0.0, _CLIMB_M_S]
    return {
        "schema": "alula/scenario",
        "version": "2.0",
        "name": first.key,
        "vehicle": {
            "file": str(vehicle),
            "interface": _INTERFACES[FILTERS[first.name][0]],
            "assumed": {"delay_s": _DELAY_S},
        },
        "world": {kind: str(first.map(folder)), "inflation_m": MARGIN_M},
        "mission": {
            "kind": "plan",
            "plan": str(first.plan(folder)),
            "start_m": tuple(begin[:3]),
            "start_velocity_m_s": tuple(begin[3:]),
        },
        "safety": {"filters": [first.name]},
        "estimation": {
            "position_noise_m": noise.position_noise_m if noise_m is None else noise_m,
            "velocity_noise_m_s": noise.velocity_noise_m_s,
            "noise_time_s": noise.noise_time_s,
            "attitude_noise_rad": noise.attitude_noise_rad,
            "rate_noise_rad_s": noise.rate_noise_rad_s,
            "delay_s": _DELAY_S,
            "disturbance_time_s": 0.1 if by_rates else 0.0,
        },
        "rules": {
            "trials": len(cells),
            "logged": len(cells),
            "log_rate_hz": 100.0,
            "seed": first.number,
        },
    }


def fly_scenario(
    folder: Path, vehicle: Path, cells: list[Cell], begin: list[float] | None, noise_m: float | None
) -> list[dict[str, Any]]:
    """Fly cells along the same plan behind the same filter by `alula simulate`."""
    judge = Judge(folder)
    with tempfile.TemporaryDirectory() as name:
        words, log = Path(name) / "flights.toml", Path(name) / "flights.run.mcap"
        tables = scenario_of(folder, vehicle, cells, begin, noise_m)
        heads = [
            f"{key} = {toml_value(value)}" for key, value in tables.items() if not isinstance(value, dict)
        ]
        words.write_text("\n".join([*heads, *_lines(tables)]) + "\n")
        code = alula(["simulate", str(words), "-o", str(log), "-q", "--jobs", "1"])
        if code not in (0, 4):  # 4: off the plan, or a via missed
            raise SystemExit(f"{cells[0].key}: simulate ends with {code}")
        flights, trials = read_flights(log).by_trial, read_run(log).trials
    return [
        {
            "is_finished": trial.outcome in ("reached", "missed-via", "off-plan"),
            "ended_by": trial.outcome,
            "flight_s": trial.duration_s,
        }
        | judge(cell, flights[trial.index].position_world)
        for cell, trial in zip(cells, trials, strict=True)
    ]


def _lines(tables: dict[str, Any], path: str = "") -> Iterator[str]:
    for key, table in tables.items():
        if isinstance(table, dict):
            values = {name: value for name, value in table.items() if not isinstance(value, dict)}
            yield from (
                "",
                f"[{path}{key}]",
                *(f"{name} = {toml_value(value)}" for name, value in values.items()),
            )
            yield from _lines(table, f"{path}{key}.")


# ArduPilot's own simulation.


class Vehicles:
    """Flies cells on the real program; each vehicle flies there and back until its batch is over."""

    def __init__(self, folder: Path, cells: list[Cell], jobs: int, keep: Path) -> None:
        self.folder, self.keep, self.judge = folder, keep, Judge(folder)
        even, odd = ([cell for cell in cells if cell.number % 2 == back] for back in (0, 1))
        alternating = [cell for pair in zip(even, odd, strict=False) for cell in pair]
        self.batches = [alternating[i : i + _BATCH] for i in range(0, len(alternating), _BATCH)]
        self.jobs = jobs
        self.lock = threading.Lock()

    def run(self) -> None:
        """Fly everything."""
        fly_batches(self.batches, self.jobs, self._fly)

    def _fly(self, batch: list[Cell]) -> None:
        with tempfile.TemporaryDirectory() as name, vehicle(Path(name)) as sim:
            for cell in batch:
                found = self._flight(Path(name), sim, cell)
                with self.lock, self.keep.open("a") as lines:
                    lines.write(json.dumps({"key": cell.key, **found}) + "\n")
                if not found["is_finished"]:
                    return  # the vehicle is not where the next plan begins

    def _flight(self, folder: Path, sim: Any, cell: Cell) -> dict[str, Any]:
        words = [str(cell.plan(self.folder)), "-f", "--map", str(cell.map(self.folder))]
        words += ["--filter", cell.name, "--vehicle", str(VEHICLE)]
        words += ["--link", f"udpin:127.0.0.1:{sim.port}", "--origin", f"{-START[0]} {-START[1]} 0"]
        words += ["--stale", "0.4", "--latency", "0.05", "-o", str(folder / "f.run.mcap")]
        with FlyProcess(*words) as process:
            code = process.end(_SAFE_S)
        lines = timed(process.heard)
        begin, first = next(((at, line) for at, line in lines if "flying the plan" in line), (None, ""))
        end = next(
            (at for at, line in lines if begin is not None and at > begin and ": landing" in line), None
        )
        last = lines[-1][1] if lines else ""
        ended = next((line.split("s  ")[-1] for at, line in lines if at == end), last)
        is_finished = ended.startswith("plan finished") and code in (0, 4)  # 4: off the plan, or a via missed
        figures: dict[str, Any] = {"is_finished": is_finished, "ended_by": ended, "code": code}
        if code != 0:
            figures["said"] = [line for _, line in lines][-12:]
        if begin is None:
            return figures
        end = time.monotonic() if end is None else end
        path = np.array([row[1:4] for row in list(sim.truth) if begin <= row[0] <= end])
        path += (START[0], START[1], 0.0)
        figures |= {"begin": begin_of(sim.truth, begin), "flight_s": end - begin} | self.judge(cell, path)
        figures["estimate_m"] = estimate_errors(
            folder / "f.run.mcap", sim.truth, (begin, end), begin - float(first.split(" s  ")[0])
        )
        if not is_finished or figures["hull_clearance_m"] <= 0:
            kept = self.keep.parent / cell.key.replace("/", " ")
            shutil.copy(folder / "f.run.mcap", f"{kept}.run.mcap")
            np.save(f"{kept}.npy", path)
        return figures


def begin_of(truth: Iterable[tuple[float, ...]], begin_s: float) -> list[float]:
    """True position and velocity, world frame, at the first set-point: fitted to half a second around it."""
    rows = np.array([row[:4] for row in list(truth) if abs(row[0] - begin_s) <= 0.25])
    fits = [np.polyfit(rows[:, 0] - begin_s, rows[:, i], 1) for i in (1, 2, 3)]
    east, north, up = (float(fit[1]) for fit in fits)
    return [START[0] + east, START[1] + north, up, *(float(fit[0]) for fit in fits)]


def estimate_errors(
    log: Path, truth: Iterable[tuple[float, ...]], during_s: tuple[float, float], zero_s: float
) -> list[list[float]]:
    """Mean and standard deviation of the estimated horizontal position's error, east and north [m].

    Times of the truth are those of its arrival; `zero_s` is the start of the log on the same clock.
    """
    rows = np.array([row[:3] for row in list(truth) if during_s[0] <= row[0] <= during_s[1]])
    flight = read_flights(log).by_trial[0]
    found = [np.interp(rows[:, 0] - zero_s, flight.time_s, flight.position_world[:, i]) for i in (0, 1)]
    errors = np.stack(found, axis=1) - rows[:, 1:3] - START[:2]
    return [errors.mean(axis=0).tolist(), errors.std(axis=0).tolist()]


def position_noise_m(found: Iterable[dict[str, Any]]) -> float | None:
    """Standard deviation per axis of the position's error in flights, less its mean over all of them [m].

    None without a flight that measured it.
    """
    measured = np.array([row["estimate_m"] for row in found if "estimate_m" in row])
    if len(measured) == 0:
        return None
    return float(np.sqrt((measured[:, 1] ** 2).mean() + measured[:, 0].var(axis=0).mean()))


Group = tuple[str, float, str]  # filter, speed, autopilot


def groups_of(found: dict[str, dict[str, Any]]) -> dict[Group, list[dict[str, Any]]]:
    """Flights of each filter, speed and autopilot, in the order of the table."""
    groups: dict[Group, list[dict[str, Any]]] = {}
    for key, figures in found.items():
        autopilot, name, speed, _ = key.split("/")
        if "via_m" in figures:
            groups.setdefault((name, float(speed), autopilot), []).append(figures)
    order = list(FILTERS)
    return dict(sorted(groups.items(), key=lambda item: (order.index(item[0][0]), *item[0][1:])))


def extremes(name: str, flights: list[dict[str, Any]]) -> tuple[float, float, float]:
    """Least clearance, median of the 95 % of distances from the plan, and the largest one [m]."""
    return (
        min(each[_clearance_key(name)] for each in flights),
        float(np.median([each["away_p95_m"] for each in flights])),
        max(each["away_max_m"] for each in flights),
    )


def agreement(found: dict[str, dict[str, Any]]) -> str:
    """How flights in `simulate` compare with the real ones that they begin as."""
    heads = ["filter", "plan, m/s", "pairs", "95 % from the plan", "least clearance", "differences, m"]
    lines = [[*heads, "within 20 %", "nearest of all, real", "simulate"], ["---"] * 9]
    pairs: dict[tuple[str, float], list[FloatArray]] = {}
    for key, mine in found.items():
        autopilot, name, speed, number = key.split("/")
        its = found.get(f"{REAL}/{name}/{speed}/{number}", {})
        if autopilot == SCENARIO and "via_m" in its:
            parts = ("away_p95_m", _clearance_key(name))
            pairs.setdefault((name, float(speed)), []).append(
                np.array([[mine[part], its[part]] for part in parts])
            )
    order = list(FILTERS)
    for name, speed in sorted(pairs, key=lambda group: (order.index(group[0]), group[1])):
        flown = np.array(pairs[name, speed])  # (pairs, figure, simulated or real)
        medians = np.median(flown, axis=0)
        ratios, apart = medians[:, 0] / medians[:, 1], medians[:, 0] - medians[:, 1]
        off = [
            part
            for part, ratio in zip(("95 %", "clearance"), ratios, strict=True)
            if not 1 - _AGREES <= round(ratio, 2) <= 1 + _AGREES
        ]
        row = [name, f"{speed:g}", str(len(flown)), *(f"{ratio:.2f}" for ratio in ratios)]
        row += [", ".join(f"{each:+.3f}" for each in apart), f"not {', '.join(off)}" if off else "yes"]
        lines.append([*row, f"{flown[:, 1, 1].min():.3f}", f"{flown[:, 1, 0].min():.3f}"])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def _clearance_key(name: str) -> str:
    """Clearance from the map that a filter flies among."""
    return f"{'hull' if FILTERS[name][1] == 'cover' else 'scene'}_clearance_m"


def table(found: dict[str, dict[str, Any]]) -> str:
    """Figures of the autopilots side by side, a row for each filter and speed."""
    heads = ["filter", "set-points", "plan, m/s", "autopilot", "flights", "plan finished", "contacts"]
    heads += [
        "via missed",
        "off the plan",
        "least clearance, m",
        "from the plan, m: 95 %",
        "max",
        "flight, s",
    ]
    lines = [heads, ["---"] * len(heads)]
    for (name, speed, autopilot), flights in groups_of(found).items():
        clear = _clearance_key(name)
        least, away, most = extremes(name, flights)
        lines.append(
            [
                name,
                FILTERS[name][0],
                f"{speed:g}",
                autopilot,
                str(len(flights)),
                str(sum(each["is_finished"] for each in flights)),
                str(sum(each[clear] <= 0 for each in flights)),
                str(sum(each["via_missed"] for each in flights)),
                str(sum(each["outside_m"] > 0 for each in flights)),
                f"{least:.3f}",
                f"{away:.3f}",
                f"{most:.3f}",
                f"{np.median([each['flight_s'] for each in flights]):.1f}",
            ]
        )
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


_PREFACE = """
The same plans through the built-in room, there and back, with `examples/vehicles/arducopter.toml`.
"{real}" is ArduPilot Copter in real time, "{simulated}" the simulated autopilot in lock-step with
the default noise of its estimate. "{scenario}" is `alula simulate` with that noise, states 0.02 s old, and
the file that `alula identify` wrote on the first of them (0.5, 1 and 2 m/s). Its noise of the position is the
error of the estimate in the real flights at each speed, less its mean over all: {noise}.
Its flights begin where the real flight of the same number did; without one, where `fly` takes over from the
take-off: below the plan by 0.03 of the height, when the first set-point acts, at a climb of 0.4 m/s.

Clearances are those of the true motion while set-points were sent, to the
hulls or the ellipsoids that the filter flies among, less the vehicle's radius; a contact is one of 0 or less.
Off the plan is a flight that left the tube about its plan (docs/guide/fly.md), which `fly` reports with exit
code 4. Made by:

    alula identify ... --speeds 0.5,1,2 --rates -o mine.toml
    ALULA_ARDUCOPTER=.../arducopter python benchmarks/autopilots.py --identified mine.toml \\
      --markdown docs/results/benchmarks-fly.md

"""
_COMPARED = """
`simulate` beside {real}, flight by flight: each pair begins alike. Ratios and differences
(simulated less real) are those of the medians over the pairs of a flight's 95 % of distances from the plan
and of its least clearance. The last columns are the nearest flights of all, which are extremes of few.

"""


def main() -> int:
    """Fly what is missing, and print the table; return 1 if there was a contact."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--flights", type=int, default=20, metavar="N", help="of each filter and speed: 20")
    parser.add_argument("--speeds", type=float, nargs="+", default=[0.5, 1.0, 2.0], metavar="M_S")
    parser.add_argument("--filters", nargs="+", default=list(FILTERS), choices=list(FILTERS))
    parser.add_argument(
        "--autopilots", nargs="+", default=["real", "simulated", "simulate"], choices=list(AUTOPILOTS)
    )
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="vehicles at once: 2")
    parser.add_argument(
        "--keep", type=Path, default=Path("build/autopilots"), help="folder of maps and results"
    )
    parser.add_argument(
        "--identified",
        type=Path,
        metavar="FILE",
        help="vehicle file that identify wrote, without which simulate is left out",
    )
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write the table into this page")
    options = parser.parse_args()
    folder: Path = options.keep
    folder.mkdir(parents=True, exist_ok=True)
    if not (folder / "cover.npz").exists():
        make_world(folder, 200_000, 0.1, 150)
    make_plans(folder, options.speeds)
    results = folder / "flights.jsonl"
    lines = results.read_text().splitlines() if results.exists() else []
    found = {row.pop("key"): row for row in map(json.loads, lines)}
    if "ALULA_ARDUCOPTER" not in os.environ:
        options.autopilots = [each for each in options.autopilots if each != "real"]
    if options.identified is None:
        options.autopilots = [each for each in options.autopilots if each != "simulate"]
    cells = [
        Cell(AUTOPILOTS[each], name, speed, number)
        for number in range(options.flights)
        for speed in options.speeds
        for name in options.filters
        for each in options.autopilots
    ]
    missing = [cell for cell in cells if cell.key not in found]
    simulated = [cell for cell in missing if cell.autopilot == SIMULATED]
    if simulated:
        with ProcessPoolExecutor(options.jobs) as pool, results.open("a") as kept:
            for cell, figures in zip(
                simulated, pool.map(fly_simulated, [folder] * len(simulated), simulated), strict=True
            ):
                kept.write(json.dumps({"key": cell.key, **figures}) + "\n")
                kept.flush()
    real = [cell for cell in missing if cell.autopilot == REAL]
    if real:
        Vehicles(folder, real, options.jobs, results).run()
    rows = list(map(json.loads, results.read_text().splitlines())) if results.exists() else []
    begins = {row["key"]: row["begin"] for row in rows if "begin" in row}
    noises = {
        speed: position_noise_m(row for row in rows if float(row["key"].split("/")[2]) == speed)
        for speed in options.speeds
    }
    groups: dict[tuple[str, float, int], list[Cell]] = {}
    for cell in missing:
        if cell.autopilot == SCENARIO:
            is_alone = dataclasses.replace(cell, autopilot=REAL).key in begins
            groups.setdefault(
                (cell.name, cell.speed_m_s, cell.number if is_alone else -1 - cell.number % 2), []
            ).append(cell)
    if groups:
        starts = [begins.get(dataclasses.replace(group[0], autopilot=REAL).key) for group in groups.values()]
        count = len(groups)
        noise = [noises[group[0].speed_m_s] for group in groups.values()]
        given = [folder] * count, [options.identified.resolve()] * count, groups.values(), starts, noise
        with ProcessPoolExecutor(options.jobs) as pool, results.open("a") as kept:
            for group, flown in zip(groups.values(), pool.map(fly_scenario, *given), strict=True):
                for cell, figures in zip(group, flown, strict=True):
                    kept.write(json.dumps({"key": cell.key, **figures}) + "\n")
                kept.flush()
    rows = [json.loads(line) for line in results.read_text().splitlines()]
    wanted = {cell.key for cell in cells}
    found = {row.pop("key"): row for row in rows if row["key"] in wanted}
    shown = table(found)
    compared = agreement(found)
    if compared.count("\n") > 2:
        shown += _COMPARED.format(real=REAL) + compared
    if options.markdown is not None:
        page = options.markdown.read_text() if options.markdown.exists() else ""
        noise = ", ".join(f"{value:.3f} m at {speed:g} m/s" for speed, value in noises.items() if value)
        preface = _PREFACE.format(
            real=REAL, simulated=SIMULATED, scenario=SCENARIO, noise=noise or "not measured"
        )
        options.markdown.write_text(with_section(page, f"{OTHERS}{preface}{shown}"))
    print(shown, end="")
    return int(any(row.get("scene_clearance_m", 1.0) <= 0 for row in found.values()))


if __name__ == "__main__":
    sys.exit(main())
