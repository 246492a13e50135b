"""Times of the filters among ellipsoids at every tick of closed-loop flights, and of QP solvers.

With each filter the FastBridge quadrotor (radius 0.12 m, ticks of 10 ms) flies straight septic references at
3.1 m/s between random pairs of points through a room of some 395,000 Gaussians at confidence 0.99, on one
thread. The figures of a filter cover all ticks of its own flights, and the whole tick: query of the index,
rows, program, for cone-backup the flow and its sensitivities, and the shield. The `tick` figures add the
controller.

The flights are deterministic, so they are flown several times and every tick is timed once in each.
`p50`, `p99` and `max` are taken over all these wall-clock times, including delays by other programs; `best`
figures use the minimum time of each tick, which excludes delays from outside but keeps ticks that are long
themselves. A repetition that is not the same flight bit for bit fails the run.

safer-splat is also replayed on some of its own ticks by measuring every ellipsoid instead of querying the
index: `brute` makes rows of those that can become active and must give the same answer; `published` makes
rows of all ellipsoids for the program, as the public implementation does. These ticks are so long that their
CPU time is measured. Ratios are given only like for like: of the same filter with and without the index, and
of filters whose rows are of ellipsoids within a gate.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import time
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.append(str(Path(__file__).resolve().parent))
sys.path.sort(key=sys.path[-1].__eq__)  # last: a module of the same name elsewhere comes first

import jax_peer
import numpy as np
import qp_problems
from flights import FLOWN, Arena, Replay, arena, fly_all

Figures = dict[str, float | None]

_MIN_BRUTE = 20
# Like for like only: the same filter with and without the index, or filters that have rows within a gate.
# Rows for every ellipsoid of the map have another effect than those within a gate.
_RATIOS = {
    "safer_published_over_safer": ("safer_splat_published_p50_us", "safer_splat_p50_us"),
    "safer_brute_over_safer": ("safer_splat_brute_p50_us", "safer_splat_p50_us"),
    "ecbf_over_safer_gated": ("cone_ecbf_p50_us", "safer_splat_gated_p50_us"),
    "ecbf_over_safer_same_gate": ("cone_ecbf_p50_us", "safer_splat_same_gate_p50_us"),
    "backup_over_safer_gated": ("cone_backup_p50_us", "safer_splat_gated_p50_us"),
    "clarabel_over_qp": ("clarabel_p50_us", "qp_p50_us"),
    "daqp_over_qp": ("daqp_p50_us", "qp_p50_us"),
    "daqp_over_qp_call": ("daqp_p50_us", "qp_call_p50_us"),
    "quadprog_over_qp_call": ("quadprog_p50_us", "qp_call_p50_us"),
    "cbfpy_over_di": ("cbfpy_tick_p50_us", "cbfpy_cone_di_p50_us"),
    "cbfpy_over_di_filtered": ("cbfpy_filtered_p50_us", "cbfpy_cone_di_filtered_p50_us"),
}
_OTHERS = ("daqp", "quadprog")  # solvers that may be missing


def brute(room: Arena, ticks: Replay, seconds: float) -> Figures:
    """Time safer-splat without the index on as many ticks as fit the time, a quarter of it for all rows."""
    found: Figures = {}
    indexed = room.filter("safer-splat", {}).native
    same = room.filter("safer-splat", {"brute": True}).native
    reports, took = ticks.through(same, seconds=0.75 * seconds, minimum=_MIN_BRUTE)
    expected, _ = Replay(ticks.state[: len(took)], ticks.acceleration[: len(took)]).through(indexed)
    found["safer_splat_brute_ticks"] = len(took)
    found["safer_splat_brute_p50_us"] = 1e6 * float(np.median(took))
    found["safer_splat_brute_differ"] = sum(
        a["status"] != b["status"] or not np.allclose(a["acceleration"], b["acceleration"], rtol=0, atol=1e-9)
        for a, b in zip(reports, expected, strict=True)
    )
    all_rows = room.filter("safer-splat", {"rows": "nearest", "brute": True, "gate": False}).native
    all_rows.filter(ticks.state[0].tolist(), ticks.acceleration[0].tolist())
    _, took = ticks.through(all_rows, seconds=0.25 * seconds, minimum=5)
    found["safer_splat_published_ticks"] = len(took)
    found["safer_splat_published_p50_us"] = 1e6 * float(np.median(took))
    return found


def run(options: argparse.Namespace) -> tuple[dict[str, Any], bool]:
    """Measure all figures; also return whether all checks passed."""
    start = time.perf_counter()
    laps: dict[str, float] = {}

    def lap(name: str) -> None:
        laps[f"{name}_s"] = time.perf_counter() - start - sum(laps.values())

    room = arena(options.splats, options.pairs, options.seed)
    figures: Figures = {
        "splats": room.splats,
        "scene_s": room.scene_s,
        "index_build_s": room.index_s,
        "repeats": options.repeats,
    }
    lap("lap_scene")
    flown = fly_all(room, options.repeats)
    for name, timed in flown.items():
        figures |= timed.figures(name)
    figures["repeats_that_differ"] = sum(timed.differs for timed in flown.values())
    lap("lap_flights")
    ticks = Replay.of(flown["safer_splat"].flights).spread(10**4, options.seed)
    figures |= brute(room, ticks, options.brute_seconds)
    lap("lap_brute")
    ticks = Replay.of(flown["cone_di"].flights).spread(10**4, options.seed)
    figures |= jax_peer.figures(room, ticks, options.cbfpy_ticks)
    lap("lap_cbfpy")
    figures |= {f"{name}_{part}_us": None for name in _OTHERS for part in ("p50", "p99")}
    figures |= qp_problems.run(options.qp_problems, options.seed, options.qp_seconds)
    lap("lap_qp")
    ratios = {name: _ratio(figures[a], figures[b]) for name, (a, b) in _RATIOS.items()}
    good = not any(
        figures[name]
        for name in ("repeats_that_differ", "safer_splat_brute_differ", "qp_wrong", "qp_infeasible_missed")
    )
    document: dict[str, Any] = {
        "quick": options.quick,
        "machine": f"{platform.machine()}, {os.cpu_count()} processors",
        "python": platform.python_version(),
        **figures,
        **laps,
        "total_s": time.perf_counter() - start,
        "ratios": ratios,
    }
    return document, good


def _ratio(a: float | None, b: float | None) -> float | None:
    return a / b if a is not None and b else None


def table(found: dict[str, Any]) -> str:
    """Format the figures as Markdown."""

    def cell(name: str) -> str:
        value = found.get(name)
        return "" if value is None else f"{value:,.0f}" if value >= 100 else f"{value:.3g}"

    def table_of(heads: list[str], rows: list[list[str]]) -> list[str]:
        lines = [heads, ["---"] * len(heads), *rows]
        return [f"| {' | '.join(line)} |" for line in lines] + [""]

    columns = ("p50", "p99", "max", "p50_best", "p99_best", "max_best")
    rows = []
    for name, kind, parameters in FLOWN:
        label = ", ".join([kind, *(f"{key}={value}" for key, value in parameters.items())])
        reached = f"{cell(f'{name}_reached')} of {cell(f'{name}_flights')}"
        times = [cell(f"{name}_{column}_us") for column in columns]
        rows.append([label, reached, cell(f"{name}_ticks"), *times, cell(f"{name}_tick_p99_best_us")])
    heads = ["filter, µs", "reached", "ticks", "p50", "p99", "max", "best p50", "best p99", "best max"]
    lines = table_of([*heads, "with controller, best p99"], rows)
    rows = [
        [label, cell(ticks), cell(name)]
        for label, ticks, name in (
            ("safer-splat, index", "safer_splat_ticks", "safer_splat_p50_us"),
            ("every ellipsoid measured", "safer_splat_brute_ticks", "safer_splat_brute_p50_us"),
            ("every ellipsoid a row", "safer_splat_published_ticks", "safer_splat_published_p50_us"),
            ("cbfpy, 64 given ellipsoids", "cbfpy_ticks", "cbfpy_tick_p50_us"),
            ("cone-di, with its query, Python call", "cbfpy_ticks", "cbfpy_cone_di_p50_us"),
            ("cbfpy where a row is violated", "cbfpy_filtered_ticks", "cbfpy_filtered_p50_us"),
            ("cone-di on these ticks", "cbfpy_filtered_ticks", "cbfpy_cone_di_filtered_p50_us"),
        )
    ]
    lines += table_of(["filter", "ticks", "p50, µs"], rows)
    rows = [
        [label, cell(f"{name}_p50_us"), cell(f"{name}_p99_us")]
        for label, name in (
            ("ours, native", "qp"),
            ("ours, Python call", "qp_call"),
            ("DAQP", "daqp"),
            ("quadprog", "quadprog"),
            ("Clarabel", "clarabel"),
        )
    ]
    lines += table_of(["4 variables, 70 rows, µs", "p50", "p99"], rows)
    lines += table_of(
        ["ratio of medians", ""],
        [
            [name.replace("_", " "), f"{value:,.3g}" if value < 1000 else f"{value:,.0f}"]
            for name, value in found["ratios"].items()
            if value is not None
        ],
    )
    lines.append(
        f"{cell('qp_problems')} random and adversarial programs against Clarabel and certificates: "
        f"{cell('qp_wrong')} wrong, {cell('qp_infeasible')} infeasible, {cell('qp_infeasible_missed')} of "
        "these missed."
    )
    return "\n".join(lines) + "\n"


_PREFACE = """# Filters among ellipsoids, measured

Look up here how long a tick of each filter among ellipsoids takes, beside other solvers.
Written by `python benchmarks/filters.py --markdown FILE` on {machine}, Python {python}: {splats:,} Gaussians
at confidence 0.99 (index built in {index_build_s:.2f} s), straight references at 3.1 m/s flown by the
FastBridge quadrotor, ticks of 10 ms, one thread. Times are those of the whole filter at every tick of its own
flights, flown {repeats} times: wall-clock times, and *best*, with the minimum over the repetitions of each
tick.

"""


def main() -> int:
    """Run everything; return 1 when a check fails, regardless of times."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer flights and programs, half a minute")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of tables")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="also write the tables to FILE")
    parser.add_argument("--seed", type=int, default=0)
    sizes = {
        "splats": (415_300, 415_300, "Gaussians of the room, before floaters are dropped"),
        "pairs": (8, 40, "flights with each filter"),
        "repeats": (3, 5, "repetitions of each flight"),
        "qp-problems": (100_000, 100_000, "maximum number of programs for the QP solver"),
        "cbfpy-ticks": (100, 500, "ticks through cbfpy"),
    }
    for name, (quick, full, text) in sizes.items():
        parser.add_argument(f"--{name}", type=int, metavar="N", help=f"{text}: {full:,}, quick {quick:,}")
    parser.add_argument(
        "--qp-seconds", type=float, metavar="S", help="maximum time for these programs; quick 8"
    )
    parser.add_argument("--brute-seconds", type=float, metavar="S", help="time for safer-splat without index")
    options = parser.parse_args()
    for name, (quick, full, _) in sizes.items():
        key = name.replace("-", "_")
        if getattr(options, key) is None:
            setattr(options, key, quick if options.quick else full)
    if options.qp_seconds is None and options.quick:
        options.qp_seconds = 8.0
    if options.brute_seconds is None:
        options.brute_seconds = 4.0 if options.quick else 30.0
    found, good = run(options)
    if options.markdown is not None:
        options.markdown.write_text(_PREFACE.format(**found) + table(found))
    print(json.dumps(found, indent=1) if options.json else table(found).rstrip("\n"))
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
