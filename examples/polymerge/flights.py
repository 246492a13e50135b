"""Fly the pairs of Figure 5 and of Table II of PolyMerge, and judge every flight by the ellipsoids.

Usage: python flights.py figure-5 FOLDER SCENE SPEED TRIALS SEED
       python flights.py table-2 FOLDER SCENE TRIALS SEED HULLS [HULLS ...]

FOLDER/SCENE.metric.scene.npz, SCENE.METHOD.N.cover.npz and SCENE.coacd.npz are read as compare.py does.
FOLDER/SCENE.figure-5.json or SCENE.table-2.json is written: a record of `polymerge_flights.Flights` per map.
Pairs are drawn clear of the ellipsoids, as in the paper, so a start or goal may lie inside a coarse hull.
"""

import dataclasses
import json
import math
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np

from alula import _core
from alula.schemas.artifacts.artifact import read_artifact
from alula.schemas.atomic import write_text
from alula.schemas.scenarios.scenario import decoded
from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.schemas.scenarios.vehicles import VEHICLES
from alula.stages.clearance import hull_obstacles, path_clearance, scene_obstacles, segment_clearance
from alula.stages.compression.hulls import Hulls
from alula.stages.filtering.polytope_cbf import barrier, polytope_cbf
from alula.stages.filtering.protocol import FilterWorld
from alula.stages.simulation.pairs import Pairs, central_box, sample_pairs
from alula.stages.simulation.prepare import prepare
from alula.stages.vehicles.bodies import quadrotor
from papers.polymerge.flights import COACD, OURS, RULE, SAFER, Flights
from papers.polymerge.measure import half_spaces

RADIUS_M, MARGIN_M, SEPARATION, GAIN, BETA, KAPPA = 0.1, 0.05, 0.3, 2.0, 2.0, 100.0
RATES_HZ = {10: 500.0, 30: 250.0, 50: 250.0, 100: 500 / 3, 150: 125.0}
# SAFER-Splat with its own gains, and with gains that let it arrive more often.
SAFER_GAINS = {SAFER: {}, f"{SAFER}, alpha 10, beta 4": {"alpha": 10.0, "beta": 4.0}}


def typical_us(seconds: np.ndarray) -> float:
    """Mean of the fastest 99 % of the measured times, without those in which another program ran [us]."""
    return 1e6 * float(np.sort(seconds)[: max(1, math.ceil(0.99 * len(seconds)))].mean())


def of_coacd(path: Path, size_m: float) -> Hulls | None:
    """Read the parts of CoACD in metres; None when there are none."""
    with np.load(path) as arrays:
        points, start = arrays["points"] * size_m, arrays["start"]
    parts = [points[a:b] for a, b in pairwise(start)]
    known = [(p, rows) for p, rows in zip(parts, map(half_spaces, parts), strict=True) if len(rows)]
    if not known:
        return None
    planes = np.concatenate([rows for _, rows in known])
    return Hulls(
        planes[:, :3],
        -planes[:, 3],
        np.cumsum([0, *(len(rows) for _, rows in known)]),
        np.concatenate([p for p, _ in known]),
        np.cumsum([0, *(len(p) for p, _ in known)]),
    )


class Scene:
    """Ellipsoids of a scene, with the pairs drawn in it."""

    def __init__(self, folder: Path, name: str, trials: int, seed: int, *, is_blocked: Hulls | None) -> None:
        """Draw pairs; with the finest cover only blocked ones that are clear of it."""
        self.name = name
        self.scene = read_artifact(folder / f"{name}.metric.scene.npz")
        self.truth = scene_obstacles(self.scene, 1.0)
        self.bounds = central_box(np.asarray(self.scene["mean"], np.float64), None, "Gaussians")
        self.diagonal_m = float(np.linalg.norm(self.bounds[1] - self.bounds[0]))
        finest = None if is_blocked is None else hull_obstacles(is_blocked)
        needed = RADIUS_M + MARGIN_M

        def is_clear(points: np.ndarray, _: np.ndarray) -> np.ndarray:
            clear = segment_clearance(points, points, self.truth, 1, needed) >= needed
            if finest is not None:
                clear &= segment_clearance(points, points, finest, 1, needed) >= needed
            return clear

        def is_wanted(start: np.ndarray, goal: np.ndarray) -> np.ndarray:
            return segment_clearance(start, goal, self.truth, 1, RADIUS_M) < RADIUS_M

        self.pairs: Pairs = sample_pairs(
            trials,
            seed,
            self.bounds,
            SEPARATION * self.diagonal_m,
            lambda points: np.full(len(points), math.inf),
            is_clear,
            None if finest is None else is_wanted,
        )

    def distances(self, paths: list[np.ndarray], obstacles: object) -> tuple[float, ...]:
        """Minimum distance of each path to obstacles [m]."""
        return tuple(float(path_clearance(path, obstacles, jobs=1).min()) for path in paths)

    def through(
        self,
        method: str,
        hulls: Hulls,
        speed_m_s: float,
        rate_hz: float,
        within_m: float | None,
        finest: Hulls | None,
    ) -> Flights:
        """Fly all pairs through a map of hulls, as a single integrator behind polytope-cbf."""
        ends = np.concatenate([self.pairs.start, self.pairs.goal])
        world = FilterWorld(
            hulls=hulls,
            radius_m=RADIUS_M,
            speed_m_s=speed_m_s,
            dt_s=1 / rate_hz,
            extent_m=2 * float(max(np.abs(ends).max(), np.abs(hulls.vertices_world).max())) + 2,
            image=b"",
        )
        safety_filter = polytope_cbf(world, {"beta": BETA, "kappa_per_m": KAPPA})
        psi = barrier(world).psi(ends, jobs=1)[1]
        far = np.linalg.norm(self.pairs.goal - self.pairs.start, axis=1)
        spec = _core.SimulationSpec(
            _core.VehicleSpec(
                quadrotor(FASTBRIDGE),  # a point uses nothing of it
                model="single-integrator",
                interface="velocity",
                gains=_core.TrackingGains(),
                max_speed_m_s=speed_m_s,
            ),
            options=_core.FlightOptions(dt_s=1 / rate_hz),
            rules=_core.SimulationRules(
                plant_steps=1, stuck_speed_m_s=1e-3 * speed_m_s, stuck_ticks=round(rate_hz)
            ),
        )
        tasks = [
            _core.Task(
                np.concatenate([start, np.zeros(9)]),
                _core.Mission.to(goal.tolist(), gain_per_s=GAIN, speed_m_s=speed_m_s),
                max_time_s=5 * self.diagonal_m / speed_m_s + 10,
                stop_distance_m=max(0.01 * d, 1e-3),
            )
            for start, goal, d in zip(self.pairs.start, self.pairs.goal, far, strict=True)
        ]
        flown = _core.simulate(spec, tasks, [safety_filter.native], jobs=1)
        paths = [flight["path"] for flight in flown]
        left = [
            float(np.linalg.norm(p - g, axis=1).min()) for p, g in zip(paths, self.pairs.goal, strict=True)
        ]
        limits = [within_m if within_m is not None else 0.01 * d for d in far]
        return Flights(
            scene=self.name,
            method=method,
            hulls=len(hulls),
            rate_hz=rate_hz,
            reached=tuple(bool(a <= b) for a, b in zip(left, limits, strict=True)),
            distance_m=self.distances(paths, self.truth),
            map_distance_m=() if finest is None else self.distances(paths, hull_obstacles(finest)),
            path_m=tuple(float(np.linalg.norm(np.diff(p, axis=0), axis=1).sum()) for p in paths),
            radius_m=RADIUS_M,
            inside=tuple((psi.reshape(2, -1) < RADIUS_M).any(axis=0).tolist()),
            steps=tuple(len(flight["mark"]) for flight in flown),
            filter_us=typical_us(np.concatenate([flight["filter_s"] for flight in flown])),
            tolerance="1 % of the distance" if within_m is None else f"{100 * within_m:g} cm",
        )

    def among(self, method: str, speed_m_s: float, gains: dict[str, float]) -> Flights:
        """Fly all pairs among the ellipsoids, as a double integrator behind safer-splat."""
        count = len(self.pairs.start)
        tree = {
            "vehicle": {"radius_m": RADIUS_M, "max_acceleration_m_s2": math.inf},
            "world": {"scene": "scene", "inflation_m": 0.0},
            "mission": {"speed_m_s": speed_m_s},
            "safety": {"filters": ["safer-splat"], "safer-splat": gains},
            "rules": {
                "trials": count,
                "max_time_s": 5 * self.diagonal_m / speed_m_s + 10,
                "logged": 0,
            },
        }
        scenario = decoded(tree, method)
        ready = prepare(scenario, VEHICLES["double-integrator"], scene=self.scene, pairs=self.pairs, jobs=1)
        logs = ready.fly(0, count, is_logged=False, jobs=1)
        trials = [ready.judged(i, log) for i, log in enumerate(logs)]
        return Flights(
            scene=self.name,
            method=method,
            hulls=None,
            rate_hz=1 / scenario.rules.dt_s,
            reached=tuple(t.outcome == "reached" for t in trials),
            distance_m=tuple(
                math.inf if t.scene_clearance_m is None else t.scene_clearance_m + RADIUS_M for t in trials
            ),
            map_distance_m=(),
            path_m=tuple(t.path_length_m for t in trials),
            radius_m=RADIUS_M,
            inside=(False,) * len(trials),
            steps=tuple(t.steps for t in trials),
            filter_us=typical_us(np.concatenate([ready.filter_seconds(log) for log in logs])),
            tolerance="1 % of the distance",
        )


def figure_5(folder: Path, name: str, speed_m_s: float, trials: int, seed: int) -> list[Flights]:
    """Fly every method over the same pairs."""
    scene = Scene(folder, name, trials, seed, is_blocked=None)
    voxels = read_artifact(folder / f"{name}.voxels.npz")
    maps = {
        OURS: Hulls.from_cover(read_artifact(folder / f"{name}.default.same.cover.npz")),
        RULE: Hulls.from_cover(read_artifact(folder / f"{name}.paper.same.cover.npz")),
        COACD: of_coacd(folder / f"{name}.coacd.npz", float(voxels.manifest.voxel_size_m)),
    }
    found = [
        scene.through(method, hulls, speed_m_s, 100.0, None, None)
        for method, hulls in maps.items()
        if hulls is not None
    ]
    return found + [scene.among(method, speed_m_s, gains) for method, gains in SAFER_GAINS.items()]


def table_2(folder: Path, name: str, trials: int, seed: int, counts: list[int]) -> list[Flights]:
    """Fly blocked pairs through covers of several numbers of hulls, at the published rates."""
    maps = {n: Hulls.from_cover(read_artifact(folder / f"{name}.default.{n}.cover.npz")) for n in counts}
    finest = maps[max(counts)]
    scene = Scene(folder, name, trials, seed, is_blocked=finest)
    return [
        scene.through(OURS, hulls, 1.0, RATES_HZ.get(n, 100.0), 0.05, finest) for n, hulls in maps.items()
    ]


def main() -> None:
    """Fly what the arguments name."""
    what, folder, name = sys.argv[1], Path(sys.argv[2]), sys.argv[3]
    if what == "figure-5":
        flights = figure_5(folder, name, float(sys.argv[4]), int(sys.argv[5]), int(sys.argv[6]))
    else:
        flights = table_2(folder, name, int(sys.argv[4]), int(sys.argv[5]), [int(n) for n in sys.argv[6:]])
    records = [dataclasses.asdict(f) for f in flights]
    write_text(folder / f"{name}.{what}.json", json.dumps(records, indent=1) + "\n")
    for f in flights:
        print(f"{name}, {what}, {f.method}: {sum(f.succeeded)} of {len(f.reached)} succeed")


if __name__ == "__main__":
    main()
