"""Fly ten pairs of Table II of PolyMerge for each number of hulls by the app in the Crazyflie's firmware.

Usage: python crazyflie.py FOLDER SCENE TRIALS SEED FLIGHTS HULLS [HULLS ...]

ALULA_CRAZYFLIE names the program (tests/sitl/README.md). The pairs are the first FLIGHTS of the TRIALS that
flights.py flies in simulation to whose start a vehicle can climb straight up from the floor. It stands
there, climbs by the firmware's own commander, and then gets the goal as a position set-point. Judged is the
true motion after the climb. FOLDER/SCENE.table-2-crazyflie.json is written; flights that are known are not
flown again.
"""

import dataclasses
import json
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).resolve().parent))
sys.path.append(str(Path(__file__).resolve().parents[2] / "tests"))  # how the program is run

from flights import MARGIN_M, OURS, RADIUS_M, RATES_HZ, Scene

from alula.schemas.artifacts.artifact import read_artifact
from alula.schemas.atomic import write_text
from alula.stages.clearance import hull_obstacles, segment_clearance
from alula.stages.compression.hulls import Hulls
from alula.stages.compression.onboard.layout import encode_map
from alula.stages.filtering.polytope_cbf import barrier
from alula.stages.filtering.protocol import FilterWorld
from papers.polymerge.flights import Flights
from support.vehicles.crazyflie_goals import fly_to_goal

BODY_M = 0.075  # radius of the vehicle, examples/vehicles/crazyflie21.toml
WITHIN_M = 0.05
BASE_HZ = 500.0  # of the app's `divider`
FLOOR_M, STEP_M, FREE_M = 0.1, 0.02, 0.25  # highest floor; of the climb; below it the floor itself is near
JOBS = 2


def floor_below(scene: Scene, start: np.ndarray) -> float | None:
    """Height of the floor from which a vehicle can climb straight to `start` [m]; None without."""
    heights = np.arange(start[2], -0.5, -STEP_M)
    points = np.column_stack([np.tile(start[:2], (len(heights), 1)), heights])
    away = segment_clearance(points, points, scene.truth, 1, RADIUS_M + MARGIN_M)
    below = np.flatnonzero(away <= STEP_M)
    if len(below) == 0:
        return None
    floor = float(heights[below[0]])
    is_clear = (away[heights > floor + FREE_M] >= RADIUS_M + MARGIN_M).all()
    return floor if floor <= FLOOR_M and is_clear else None


def chosen(scene: Scene, count: int) -> list[tuple[int, float]]:
    """Numbers of the first pairs that begin above the floor, with its height [m]."""
    floors = [(number, floor_below(scene, start)) for number, start in enumerate(scene.pairs.start)]
    return [(number, floor) for number, floor in floors if floor is not None][:count]


def distances(hulls: Hulls, ends: np.ndarray) -> np.ndarray:
    """Distance of points to a map [m]."""
    extent = 2 * float(max(np.abs(ends).max(), np.abs(hulls.vertices_world).max())) + 2
    world = FilterWorld(hulls=hulls, radius_m=RADIUS_M, speed_m_s=1.0, dt_s=0.01, extent_m=extent, image=b"")
    return barrier(world).psi(ends, jobs=1)[1]


def main() -> None:
    """Fly what is missing."""
    folder, name = Path(sys.argv[1]), sys.argv[2]
    trials, seed, count = (int(word) for word in sys.argv[3:6])
    covers = {int(n): read_artifact(folder / f"{name}.default.{n}.cover.npz") for n in sys.argv[6:]}
    hulls = {n: Hulls.from_cover(cover) for n, cover in covers.items()}
    finest = hulls[max(hulls)]
    scene = Scene(folder, name, trials, seed, is_blocked=finest)
    pairs = chosen(scene, count)
    kept = folder / f"{name}.table-2-crazyflie.flights.json"
    known = json.loads(kept.read_text()) if kept.exists() else {}

    def fly(task: tuple[int, int, float]) -> None:
        n, number, floor = task
        start, goal = scene.pairs.start[number], scene.pairs.goal[number]
        image = encode_map(covers[n], indexed=True)
        divider = round(BASE_HZ / RATES_HZ[n])
        with tempfile.TemporaryDirectory() as place:
            path, times = fly_to_goal(
                Path(place),
                *(floor, start, goal, image, number + 1, WITHIN_M),
                radius=RADIUS_M,
                divider=divider,
            )
        known[f"{n}/{number}"] = {
            "left_m": float(np.linalg.norm(path - goal, axis=1).min()),
            "distance_m": scene.distances([path], scene.truth)[0],
            "map_distance_m": scene.distances([path], hull_obstacles(finest))[0],
            "path_m": float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()),
            "steps": round((times[-1] - times[0]) * BASE_HZ / divider),
        }
        write_text(kept, json.dumps(known, indent=1) + "\n")
        print(f"{n} hulls, pair {number}: {known[f'{n}/{number}']}", flush=True)

    tasks = [(n, *pair) for pair in pairs for n in hulls if f"{n}/{pair[0]}" not in known]
    with ThreadPoolExecutor(JOBS) as pool:
        list(pool.map(fly, tasks))
    records = []
    for n, cover in hulls.items():
        flown = [known[f"{n}/{number}"] for number, _ in pairs]
        ends = np.array([[scene.pairs.start[k], scene.pairs.goal[k]] for k, _ in pairs])
        inside = (distances(cover, ends.reshape(-1, 3)).reshape(-1, 2) < RADIUS_M).any(axis=1)
        records.append(
            Flights(
                scene=name,
                method=OURS,
                hulls=len(cover),
                rate_hz=BASE_HZ / round(BASE_HZ / RATES_HZ[n]),
                reached=tuple(each["left_m"] <= WITHIN_M for each in flown),
                distance_m=tuple(each["distance_m"] for each in flown),
                map_distance_m=tuple(each["map_distance_m"] for each in flown),
                path_m=tuple(each["path_m"] for each in flown),
                radius_m=BODY_M,
                inside=tuple(inside.tolist()),
                steps=tuple(each["steps"] for each in flown),
                filter_us=0.0,  # not measured
                tolerance=f"{100 * WITHIN_M:g} cm",
            )
        )
    text = json.dumps([dataclasses.asdict(f) for f in records], indent=1)
    write_text(folder / f"{name}.table-2-crazyflie.json", text + "\n")


if __name__ == "__main__":
    main()
