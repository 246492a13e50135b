"""Times of the filters among moving obstacles, their projections and programs, and trials of scenario 1.

Trials of scenario 1 (examples/dr-acbf) are flown with DR-ACBF, and their active ticks recorded: the state,
every track, the nominal command. Each filter then replays the same ticks of the same trials, in turns and in
one run; every active tick is timed on copies of the filter, and their median counts.

`general_qp` figures are those of the rows of `dr-acbf` in a general QP solver: ours, and Clarabel and
quadprog where they are installed, called from Python, set-up included. `exact_projection` and `gs_projection`
are the projections alone on rows like those of these ticks.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import platform
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import msgspec
import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.scenarios.defaults import vehicle_of
from alula.schemas.scenarios.scenario import Scenario, read_scenario
from alula.stages.filtering.moving_filters import moving_options
from alula.stages.filtering.qp import clarabel_backend
from alula.stages.reporting.statistics import ratio_estimate
from alula.stages.simulation.prepare import prepare
from alula.stages.simulation.prepared_run import PreparedRun
from alula.stages.simulation.simulate import simulate_world
from alula.stages.verdict import wilson_interval

FloatArray = NDArray[np.float64]
Figures = dict[str, Any]

SCENARIO = Path(__file__).resolve().parents[1] / "examples/dr-acbf/scenario-1.toml"
METHODS = ("dr_acbf", "dr_acbf_qp", "mpc", "cbf_qp", "rp_cbf")
_KEYS = {
    "dr_acbf": "tick",
    "dr_acbf_qp": "general_qp_tick",
    "mpc": "mpc_tick",
    "cbf_qp": "cbf_qp_tick",
    "rp_cbf": "rp_cbf_tick",
}
_RATIOS = {
    "tick_over_general_qp": ("tick_p50_us", "general_qp_tick_p50_us"),
    "tick_over_quadprog": ("tick_p50_us", "general_qp_quadprog_tick_p50_us"),
    "tick_over_clarabel": ("tick_p50_us", "general_qp_clarabel_tick_p50_us"),
    "tick_over_mpc": ("tick_p50_us", "mpc_tick_p50_us"),
    "tick_over_cbf_qp": ("tick_p50_us", "cbf_qp_tick_p50_us"),
    "tick_over_rp_cbf": ("tick_p50_us", "rp_cbf_tick_p50_us"),
    "exact_over_general_qp": ("exact_projection_us", "general_qp_projection_us"),
    "exact_over_gs": ("exact_projection_us", "gs_projection_us"),
    "workers_2_over_1": ("trials_per_s_2_workers", "trials_per_s_1_worker"),
}
_ROWS = 10  # of the projections that are timed
_LIMIT = 6.0
_NO_WALLS = np.empty((0, 4))


@dataclass(frozen=True, slots=True)
class Tick:
    """Inputs of a filter in a tick; `tracks` as in `MovingFilter.filter`."""

    position: list[float]
    velocity: list[float]
    tracks: FloatArray
    nominal: list[float]
    is_active: bool


def record(scenario: Scenario, count: int, seed: int) -> list[list[Tick]]:
    """Record all ticks of some trials, flown with DR-ACBF.

    Positions of tracks are those of the flight. Velocities and covariances are not recorded: velocities are
    the true ones over ten ticks, covariances follow roughly from the sensor's noise at that distance.
    """
    ready = prepared(scenario, trials=count, seed=seed)
    return [list(_ticks(log, scenario)) for log in ready.fly(0, count)]


def prepared(scenario: Scenario, **rules: int) -> PreparedRun:
    """Make all parts of a run with other rules."""
    changed = msgspec.structs.replace(scenario, rules=msgspec.structs.replace(scenario.rules, **rules))
    return prepare(changed, vehicle_of(changed, SCENARIO.parent))


def filter_options(scenario: Scenario) -> dict[str, float]:
    """All options of the native filter."""
    return moving_options(prepared(scenario, trials=1).told, scenario.safety.dr_acbf)


def _ticks(log: dict[str, Any], scenario: Scenario) -> Iterator[Tick]:
    vehicle, tracks, sensor = log["state"], log["track"], scenario.estimation.sensor
    back, dt = 10, scenario.rules.dt_s
    for k in range(back, len(tracks)):
        rows = []
        for i in range(tracks.shape[1]):
            now, before = tracks[k, i], tracks[k - back, i]
            if not (np.isfinite(now).all() and np.isfinite(before).all()):
                continue
            velocity = (log["obstacle"][k, i] - log["obstacle"][k - back, i]) / (back * dt)
            across = float(np.linalg.norm(now - vehicle[k, :3])) * sensor.sigma_azimuth_rad
            variance = np.diag([*[0.25 * (sensor.sigma_range_m**2 + across**2)] * 3, *[0.25] * 3])
            rows.append(
                [i, *now, *velocity, *variance[np.tril_indices(6)], scenario.world.moving[i].radius_m]
            )
        yield Tick(
            position=vehicle[k, :3].tolist(),
            velocity=vehicle[k, 6:9].tolist(),
            tracks=np.array(rows, np.float64).reshape(-1, 29),
            nominal=log["nominal"][k].tolist(),
            is_active=bool(log["flags"][k, -1] >> 4),
        )


def through(native: Any, ticks: list[Tick], repeats: int) -> list[float]:
    """Times of a filter in a trial's active ticks [s], medians over copies; other ticks are not timed."""
    native.reset()
    found = []
    for tick in ticks:
        timed = repeats if tick.is_active and len(tick.tracks) else 0
        _, took = native.filter(
            tick.position, tick.velocity, tick.tracks, _NO_WALLS, tick.nominal, repeats=timed
        )
        if timed:
            found.append(took)
    return found


def quadprog_backend(
    hessian: FloatArray, gradient: FloatArray, rows: FloatArray, bounds: FloatArray
) -> tuple[int, list[float], list[int], list[float]]:
    """Solve the program with quadprog, as a backend of `_core.QpSolver`."""
    import quadprog

    try:
        x, _, _, _, multipliers, active = quadprog.solve_qp(hessian, -gradient, rows.T.copy(), bounds)
    except ValueError:  # infeasible
        return 1, [0.0] * len(gradient), [], []
    kept = [int(i) - 1 for i in active if i > 0]
    return 0, x.tolist(), kept, multipliers[kept].tolist()


def backends() -> dict[str, Any]:
    """Find the other installed solvers for the rows of `dr-acbf`."""
    found: dict[str, Any] = {}
    if importlib.util.find_spec("quadprog") is not None:
        found["quadprog"] = quadprog_backend
    if importlib.util.find_spec("clarabel") is not None:
        found["clarabel"] = clarabel_backend
    return found


def ticks_side_by_side(scenario: Scenario, trials: list[list[Tick]], repeats: int, seconds: float) -> Figures:
    """Measure percentiles of every filter over the same active ticks, trial by trial in turns."""
    options = filter_options(scenario)
    filters = {_KEYS[name]: _core.moving_filter(name, options) for name in METHODS}
    filters |= {
        f"general_qp_{name}_tick": _core.moving_filter("dr_acbf_qp", options, backend)
        for name, backend in backends().items()
    }
    times: dict[str, list[float]] = {name: [] for name in filters}
    typical: dict[str, list[float]] = {name: [] for name in filters}  # median of each trial
    end = time.perf_counter() + seconds
    for number, ticks in enumerate(trials):
        names = list(filters) if number % 2 == 0 else list(filters)[::-1]
        for name in names:
            took = through(filters[name], ticks, repeats if "_qp_" not in name else 1)
            times[name] += took
            if took:
                typical[name].append(float(np.median(took)))
        if time.perf_counter() > end:
            break
    figures: Figures = {"active_ticks": len(times["tick"])}
    for name, taken in times.items():
        for key, value in zip(("p50", "p99"), np.percentile(taken, [50, 99]), strict=True):
            figures[f"{name}_{key}_us"] = 1e6 * float(value)
        figures[f"{name}_mean_us"] = 1e6 * float(np.mean(taken))
    figures["saved"] = {name: saving(typical["tick"], of) for name, of in typical.items() if name != "tick"}
    for name in ("quadprog", "clarabel"):
        figures.setdefault(f"general_qp_{name}_tick_p50_us", None)
    return figures


def saving(ours: list[float], theirs: list[float]) -> dict[str, float | None]:
    """Fraction of another filter's time per active tick that `dr-acbf` saves, with its 95 % interval.

    Medians of trials are compared, because a mean has the ticks in which another program took the processor.

    Args:
        ours: median time of each trial's active ticks [s].
        theirs: of the other filter, in the same trials.
    """
    found = ratio_estimate(ours, theirs)
    assert found is not None
    low, high = (None if end is None else 1 - end for end in (found.high, found.low))
    return {"value": 1 - found.value, "low": low, "high": high}


def crowd(scenario: Scenario, obstacles: int, repeats: int, seed: int) -> float:
    """Median time of a tick with a warning among many approaching obstacles [us]."""
    rng = np.random.default_rng(seed)
    native = _core.moving_filter("dr_acbf", filter_options(scenario))
    variance = np.diag([0.02] * 3 + [0.25] * 3)[np.tril_indices(6)]
    found = []
    for _ in range(5):
        native.reset()
        direction = rng.normal(size=(obstacles, 3)) * [1, 0.6, 0.2]
        direction /= np.linalg.norm(direction, axis=1)[:, None]
        place = direction * rng.uniform(3, 38, (obstacles, 1))
        velocity = -direction * rng.uniform(1, 9, (obstacles, 1)) + rng.normal(0, 0.5, (obstacles, 3))
        for _ in range(5):
            rows = [[i, *place[i], *velocity[i], *variance, 0.15] for i in range(obstacles)]
            _, took = native.filter(
                [0.0, 0, 0], [4.0, 0, 0], np.array(rows), _NO_WALLS, [0.0, 0, 0], repeats=repeats
            )
            found.append(took)
            place += 0.01 * velocity
    return 1e6 * float(np.median(found))


def projections(count: int, seed: int) -> Figures:
    """Median times of both projections alone, on `_ROWS` rows (about one violated), and on two."""
    rng = np.random.default_rng(seed)
    figures: Figures = {}
    for size, suffix in ((_ROWS, ""), (2, "_2_rows")):
        took: dict[str, list[float]] = {"exact": [], "gs": []}
        programs: list[tuple[FloatArray, list[float]]] = []
        for _ in range(count):
            normal = rng.normal([1.5, 0.0, 0.0], 1.0, (size, 3))
            normal /= np.linalg.norm(normal, axis=1)[:, None]
            rows = np.column_stack([normal, rng.uniform(-3, 12, size)])
            start = rng.uniform(-_LIMIT, _LIMIT, 3).tolist()
            programs.append((rows, start))
            for solver, times in took.items():
                times.append(_core.half_space_projection(rows, start, solver, limit=_LIMIT, repeats=500)[-1])
        for solver, times in took.items():
            figures[f"{solver}_projection{suffix}_us"] = 1e6 * float(np.median(times))
        figures[f"general_qp_projection{suffix}_us"] = 1e6 * _by_qp(programs)
    return figures


def _by_qp(programs: list[tuple[FloatArray, list[float]]], runs: int = 15) -> float:
    """The same projections by our general QP solver, the box as rows: the median run, per program [s]."""
    box = np.vstack([np.eye(3), -np.eye(3)])
    normals = np.array([np.vstack([rows[:, :3], box]) for rows, _ in programs])
    bounds = np.array([np.append(rows[:, 3], np.full(6, _LIMIT)) for rows, _ in programs])
    hessian = np.repeat(np.eye(3)[None], len(programs), axis=0)
    nominal = np.array([start for _, start in programs])
    solver, took = _core.QpSolver(), []
    for _ in range(runs):
        start = time.perf_counter()
        solver.solve_many(hessian, -nominal, -normals, -bounds)
        took.append((time.perf_counter() - start) / len(programs))
    return float(np.median(took))


def flights(scenario: Scenario, size: int, rounds: int, seconds: float) -> Figures:
    """Measure trials per second with one and with two workers in turns, and the success of all trials."""
    wall = {1: 0.0, 2: 0.0}
    flown = 0
    hits = np.zeros(len(scenario.world.moving), np.int64)
    good = 0
    end = time.perf_counter() + seconds
    for number in range(rounds):
        if number >= 2 and time.perf_counter() > end:
            break
        table = msgspec.structs.replace(
            scenario.rules, trials=size, seed=scenario.rules.seed + number, logged=0
        )
        block = msgspec.structs.replace(scenario, rules=table)
        for jobs in (1, 2) if number % 2 == 0 else (2, 1):
            start = time.perf_counter()
            trials = simulate_world(block, vehicle_of(block, SCENARIO.parent), jobs=jobs).trials
            wall[jobs] += time.perf_counter() - start
        flown += size
        good += sum(not trial.collision for trial in trials)
        hits += np.array([[met.collision for met in trial.obstacles or []] for trial in trials]).sum(axis=0)
    per = [100 * (1 - int(h) / flown) for h in hits]
    low, high = wilson_interval(good, flown)
    return {
        "trials": flown,
        "trials_per_s_1_worker": flown / wall[1],
        "trials_per_s_2_workers": flown / wall[2],
        "success_pct": float(np.mean(per)),
        **{f"success_obstacle_{i + 1}_pct": value for i, value in enumerate(per)},
        "success_run_pct": 100 * good / flown,
        "success_run_low_pct": 100 * low,
        "success_run_high_pct": 100 * high,
        "seconds_for_3000_trials_2_workers": 3000 * wall[2] / flown,
    }


def run(options: argparse.Namespace) -> Figures:
    """Measure all figures."""
    start = time.perf_counter()
    scenario = read_scenario(SCENARIO, {"rules.seed": options.seed})
    recorded = record(scenario, options.recorded, options.seed)
    figures = ticks_side_by_side(scenario, recorded, options.repeats, options.tick_seconds)
    if options.ticks_only:
        return {"machine": f"{platform.machine()}, {os.cpu_count()} processors", **figures}
    figures["tick_100_obstacles_p50_us"] = crowd(scenario, 100, 9, options.seed)
    figures |= projections(options.projections, options.seed)
    figures |= flights(scenario, options.trials, options.rounds, options.flight_seconds)
    ratios = {
        name: None if not figures[a] or not figures[b] else figures[a] / figures[b]
        for name, (a, b) in _RATIOS.items()
    }
    return {
        "quick": options.quick,
        "machine": f"{platform.machine()}, {os.cpu_count()} processors",
        "python": platform.python_version(),
        **figures,
        "ratios": ratios,
        "total_s": time.perf_counter() - start,
    }


def table(found: Figures) -> str:
    """Format the figures as Markdown."""

    def cell(name: str) -> str:
        value = found.get(name)
        return "" if value is None else f"{value:,.0f}" if value >= 100 else f"{value:.3g}"

    lines = ["| filter, µs per active tick | p50 | p99 | mean |", "| --- | --- | --- | --- |"]
    names = {
        "dr-acbf, exact projection": "tick",
        "the same rows, our QP solver": "general_qp_tick",
        "the same rows, quadprog": "general_qp_quadprog_tick",
        "the same rows, Clarabel": "general_qp_clarabel_tick",
        "mpc": "mpc_tick",
        "cbf-qp": "cbf_qp_tick",
        "rp-cbf": "rp_cbf_tick",
    }
    for label, name in names.items():
        lines.append(f"| {label} | {' | '.join(cell(f'{name}_{k}_us') for k in ('p50', 'p99', 'mean'))} |")
    lines += [
        "",
        f"{found['active_ticks']:,} active ticks of scenario 1, the same for all, in one run. Among 100 "
        f"obstacles "
        f"{cell('tick_100_obstacles_p50_us')} µs. The projection alone, {_ROWS} rows: exact "
        f"{cell('exact_projection_us')} µs, Gauss–Southwell {cell('gs_projection_us')} µs, QP solver "
        f"{cell('general_qp_projection_us')} µs; two rows: {cell('exact_projection_2_rows_us')}, "
        f"{cell('gs_projection_2_rows_us')} and {cell('general_qp_projection_2_rows_us')} µs.",
        "",
        f"Scenario 1: {cell('trials_per_s_1_worker')} trials a second with one worker, "
        f"{cell('trials_per_s_2_workers')} with two. Success over {found['trials']:,} trials: "
        f"{found['success_pct']:.2f} % by obstacle ({found['success_obstacle_1_pct']:.2f} and "
        f"{found['success_obstacle_2_pct']:.2f} %), {found['success_run_pct']:.2f} % with both avoided "
        f"({found['success_run_low_pct']:.2f} to {found['success_run_high_pct']:.2f}).",
    ]
    return "\n".join(lines) + "\n"


_PREFACE = """# Filters among moving obstacles, measured

Look up here how long a tick of each filter among moving obstacles takes.
Written by `python benchmarks/dracbf.py --markdown FILE` on {machine}, Python {python}.

"""


def main() -> int:
    """Run everything."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer trials, half a minute")
    parser.add_argument("--ticks-only", action="store_true", help="only the filters' times, as JSON")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of tables")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="also write the tables to FILE")
    parser.add_argument("--seed", type=int, default=0)
    sizes = {
        "recorded": (30, 200, "trials whose ticks are replayed"),
        "repeats": (5, 9, "copies of a tick, of which the median counts"),
        "projections": (200, 2000, "problems for each projection"),
        "trials": (200, 500, "trials of a round"),
        "rounds": (5, 6, "rounds with either number of workers"),
        "tick-seconds": (12, 120, "maximum time for the ticks of all filters"),
        "flight-seconds": (12, 600, "maximum time for the trials"),
    }
    for name, (quick, full, text) in sizes.items():
        parser.add_argument(f"--{name}", type=int, metavar="N", help=f"{text}: {full:,}, quick {quick:,}")
    options = parser.parse_args()
    for name, (quick, full, _) in sizes.items():
        key = name.replace("-", "_")
        if getattr(options, key) is None:
            setattr(options, key, quick if options.quick else full)
    found = run(options)
    if options.ticks_only:
        print(json.dumps(found, indent=1))
        return 0
    if options.markdown is not None:
        options.markdown.write_text(_PREFACE.format(**found) + table(found))
    print(json.dumps(found, indent=1) if options.json else table(found).rstrip("\n"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
