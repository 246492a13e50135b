"""Flights along plans behind filters: arrivals, saturated rotors, tracking, interventions.

Start, a point on the way and goal are random points that a fine grid proves connected (see `plan.py`), with a
barrier psi of `polytope-cbf` of at least 0.2 m. Each chain is planned for the vehicle and the filter (`plan
--filter`), and the plan is flown in `simulate`.

- `vias_passed`: flights that passed all of their points or gates; `gates_passed`: gates, of six a flight;
- `margin_m`: what the plan keeps beyond the vehicle's radius, which the filter keeps;
- `tracking_*_m`: distance of the vehicle from the plan's point of that time;
- `longest_saturation_ticks`: successive ticks in which the rotors cannot give the commanded wrench;
- `intervened_share`: ticks in which the filter changes the command;
- `time_over_fastest`: duration of the plan over that of the fastest plan, for no filter: median and 95 %
  quantile, which is that of narrow places;
- `plan_median_s`: processor seconds of one thread, with the flights behind the filter that planning makes.

    python benchmarks/planned_flights.py --quick --json   # the built-in room
    python benchmarks/planned_flights.py                  # and three real scenes of ALULA_DATA
    python benchmarks/planned_flights.py --gates          # two laps through three gates instead of a point
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).resolve().parent))

import numpy as np
from measure import FloatArray
from plan import World, built_in, connected_chains, random_gate, real_worlds, table

from alula import _core
from alula.schemas.parameters.configs.plan import PlanConfig, Point
from alula.schemas.scenarios.scenario import decoded
from alula.schemas.scenarios.vehicles import VEHICLES
from alula.stages.compression.hulls import Hulls
from alula.stages.planning.plan import plan
from alula.stages.planning.space import plan_space
from alula.stages.simulation.judge import LIMITED
from alula.stages.simulation.prepare import prepare
from alula.stages.world.world import behind_filters

VEHICLE_NAMES = ("crazyflie21", "fastbridge")
FILTERS = ("cone-backup", "polytope-cbf")
LEAST_PSI_M = 0.2


def chains(world: World, count: int, seed: int) -> list[list[Point]]:
    """Start, point on the way and goal of each plan."""
    hulls = Hulls.from_cover(world.cover)
    among = _core.PolytopeCbf(
        *(np.ascontiguousarray(each) for each in (hulls.normal_world, hulls.offset_m, hulls.plane_start)),
        extent_m=1e4,
    )
    space = plan_space(PlanConfig(radius_m=world.radius_m), world.cover)
    drawn = connected_chains(space, 3, 4 * count, seed)
    clear = [chain for chain in drawn if among.psi(np.array(chain), jobs=1)[1].min() >= LEAST_PSI_M]
    return clear[:count]


def courses(world: World, count: int, seed: int) -> list[dict[str, Any]]:
    """Missions of two laps through three random gates, whose centres are as clear as the points of chains."""
    space = plan_space(PlanConfig(radius_m=world.radius_m), world.cover)
    clear = chains(world, 4 * count, seed)
    grid, rng = np.concatenate([np.array(chain) for chain in clear]), np.random.default_rng(seed)
    return [
        {
            "start": chain[0],
            "goal": chain[2],
            "gate": tuple(random_gate(space, grid, rng) for _ in range(3)),
            "loops": 2,
        }
        for chain in clear[:count]
    ]


def longest_run(marks: FloatArray) -> int:
    """Length of the longest run of true values."""
    edge = np.flatnonzero(np.diff(np.concatenate([[0], marks, [0]])))
    return int((edge[1::2] - edge[::2]).max(initial=0))


def flown(
    world: World, vehicle: str, name: str, speed: float, missions: list[dict[str, Any]]
) -> list[dict[str, Any]]:
    """Plan and fly each mission; the figures of each flight."""
    base = {"radius_m": world.radius_m, "speed_m_s": speed}
    body, space = VEHICLES[vehicle], plan_space(PlanConfig(**base), world.cover)
    behind = behind_filters(PlanConfig(filter=name, **base), body, cover=world.cover, jobs=1)
    scenario = {
        "vehicle": {"type": vehicle},
        "world": {"cover": "cover"},
        "mission": {"kind": "plan", "plan": "plan"},
        "safety": {"filters": [name]},
    }
    rows = []
    for mission in missions:
        config = PlanConfig(**mission, filter=name, **base)
        fastest = plan(config, world.cover, vehicle=body, space=space, jobs=1)
        begin = time.process_time()
        made = plan(config, world.cover, vehicle=body, behind=behind, space=space, jobs=1)
        planned_s = time.process_time() - begin
        run = prepare(decoded(dict(scenario)), cover=world.cover, plan=made, jobs=1)
        (log,) = run.fly(0, 1, jobs=1)
        trial = run.judged(0, log)
        curve = run.missions.curves[0]
        assert curve is not None
        assert trial.plan is not None
        reference = curve.at(np.arange(trial.steps + 1) * run.scenario.rules.dt_s)[:, :3]
        rows.append(
            {
                "reached": trial.outcome == "reached",
                "via": not trial.plan.missed,
                "gates": sum(each.passed for each in trial.plan.passes) if "gate" in mission else 0,
                "collision": trial.collision,
                "saturated": longest_run((log["mark"] & LIMITED > 0).astype(np.int64)),
                "error_m": np.linalg.norm(log["state"][:, :3] - reference, axis=1),
                "acting": trial.filtered_steps,
                "steps": trial.steps,
                "clearance_m": trial.map_clearance_m,
                "slower": made["time"][-1] / fastest["time"][-1],
                "planned_s": planned_s,
            }
        )
    return rows


def figures(vehicle: str, name: str, margins: list[float], rows: list[dict[str, Any]]) -> dict[str, Any]:
    """All flights of a vehicle behind a filter."""
    errors = np.concatenate([row["error_m"] for row in rows])
    return {
        "vehicle": vehicle,
        "filter": name,
        "plans": len(rows),
        "reached": sum(row["reached"] for row in rows),
        "vias_passed": sum(row["via"] for row in rows),
        "gates_passed": sum(row["gates"] for row in rows),
        "collisions": sum(row["collision"] for row in rows),
        "longest_saturation_ticks": max(row["saturated"] for row in rows),
        "margin_m": min(margins),
        "tracking_p95_m": float(np.quantile(errors, 0.95)),
        "tracking_max_m": float(errors.max()),
        "min_clearance_m": min(row["clearance_m"] for row in rows),
        "intervened_share": sum(row["acting"] for row in rows) / sum(row["steps"] for row in rows),
        "flights_intervened": sum(row["acting"] > 0 for row in rows),
        "time_over_fastest": float(np.median([row["slower"] for row in rows])),
        "time_over_fastest_p95": float(np.quantile([row["slower"] for row in rows], 0.95)),
        "plan_median_s": float(np.median([row["planned_s"] for row in rows])),
    }


def main() -> int:
    """Print a table, or JSON; return 1 if a flight misses what it must keep."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="the built-in room alone, 5 plans")
    parser.add_argument("--plans", type=int, default=100, help="of each vehicle behind each filter: 100")
    parser.add_argument("--speed", type=float, default=1.0, help="limit of the plans: 1 [m/s]")
    parser.add_argument("--gates", action="store_true", help="fly two laps through three gates instead")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write the table as a page")
    given = parser.parse_args()
    worlds = [built_in()] if given.quick else [built_in(), *real_worlds()]
    count = 5 if given.quick else -(-given.plans // len(worlds))
    missions = [
        courses(world, count, given.seed)
        if given.gates
        else [
            {"start": start, "via": (via,), "goal": goal}
            for start, via, goal in chains(world, count, given.seed)
        ]
        for world in worlds
    ]
    found = []
    for vehicle in VEHICLE_NAMES:
        margins = [world.radius_m - VEHICLES[vehicle].body.radius_m for world in worlds]
        for name in FILTERS:
            rows = [
                row
                for world, chosen in zip(worlds, missions, strict=True)
                for row in flown(world, vehicle, name, given.speed, chosen)
            ]
            found.append(figures(vehicle, name, margins, rows))
            sys.stderr.write(f"{vehicle} {name}\n")
    sys.stdout.write(json.dumps(found, indent=2) + "\n" if given.json else table(found))
    if given.markdown is not None:
        preface = (
            "# Planned flights, measured\n\n"
            "Look up here whether flights along plans arrive behind their filters, and how often a filter "
            "intervenes.\n"
            "Written by `python benchmarks/planned_flights.py --markdown FILE`.\n\n"
        )
        given.markdown.write_text(f"{preface}{__doc__}\n{table(found)}")
    return int(not all(_holds(each) for each in found))


def _holds(each: dict[str, Any]) -> bool:
    arrives = each["plans"] == each["reached"] == each["vias_passed"] and not each["collisions"]
    tracks = each["longest_saturation_ticks"] <= 1 and each["tracking_max_m"] < each["margin_m"]
    return bool(arrives and tracks and each["intervened_share"] < 0.01)


if __name__ == "__main__":
    sys.exit(main())
