"""Random flights behind a shield, judged by distances of its own.

Of flights with nothing left out of the model, two kinds contradict the certificate: one that was certified in
every tick and came nearer to what was certified than the certificate says, and one that began certified and
lost that.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, nnls

from alula.schemas.artifacts.artifact import Artifact, make_artifact
from alula.schemas.artifacts.kinds import SCENE
from alula.schemas.errors import InfeasibleError, UsageError
from alula.schemas.scenarios.scenario import Scenario, decoded
from alula.schemas.scenarios.vehicle import FASTBRIDGE, Vehicle
from alula.schemas.scenarios.vehicles import VEHICLES
from alula.stages.durations import Times
from alula.stages.simulation.left_out import left_out
from alula.stages.simulation.prepare import prepare
from alula.stages.simulation.prepared_run import PreparedRun
from alula.stages.simulation.simulate import WorldRun
from alula.stages.simulation.summary import world_guarantee
from support.attack.outcome import Outcome
from support.scenes.fabricate import exact_hull, make_cover

CLAIM = (
    "flights that begin certified, with nothing left out of the model, stay certified and keep their distance"
)
CERTIFIED = 4  # bit of the flags of a native log
GRID_M = 0.1
SIDES = np.vstack([np.eye(3), -np.eye(3)])  # normals of a box
ROOM_M = np.array([6.0, 5.0, 3.0])
MOST_CALLS = 1000  # of a filter in a flight
NEAR_M = 1e-5  # sag of the path between steps of the plant, and rounding

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Case:
    """A scenario with the obstacles that it names, as arrays for the judge.

    Attributes:
        scenario, vehicle, cover, scene: to fly.
        hulls: vertices of each [m].
        planes: unit normals and offsets of each, rows (n, d) [m].
    """

    scenario: Scenario
    vehicle: Vehicle
    cover: Artifact | None
    scene: Artifact | None
    hulls: list[Floats]
    planes: list[Floats]


def search(seconds: float, seed: int) -> Outcome:
    """Fly random cases for a time.

    Args:
        seconds: to search for.
        seed: of the cases.
    """
    found = Outcome(CLAIM)
    end, number, longest = time.monotonic() + seconds, 0, 1.0
    while time.monotonic() + longest < end or number == 0:
        begin = time.monotonic()
        try_case(seed, number, found)
        longest = max(longest, time.monotonic() - begin)
        number += 1
    return found


def try_case(seed: int, number: int, found: Outcome) -> None:
    """Fly one case and count what it shows.

    Args:
        seed, number: of the case.
        found: is added to.
    """
    try:
        case = drawn(np.random.default_rng([seed, number]))
        ready = prepare(case.scenario, case.vehicle, cover=case.cover, scene=case.scene, jobs=1)
        logs = ready.fly(0, len(ready.missions.tasks), jobs=1)
    except (UsageError, InfeasibleError):
        found.counts["refused configurations"] += 1
        return
    run = run_of(ready, logs)
    claims = world_guarantee(run, case.cover).claims
    left, against = left_out(ready.scenario), claims["certified_against"]
    assert against, "every case has a shield"
    nearest = [clearance(case, ready, log["path"], against) for log in logs]
    for index, log in enumerate(logs):
        certified = log["flags"][:, -1] & CERTIFIED > 0
        found.tried += 1
        found.counts["ticks"] += len(certified)
        found.counts["certified ticks"] += int(certified.sum())
        if left:
            found.counts["with something left out"] += 1
            continue
        if not certified[0]:
            found.counts["not certified at the start"] += 1
            continue
        found.counts["certified in every tick"] += bool(certified.all())
        where = f"seed {seed}, case {number}, flight {index}: {summary_of(case)}"
        kept_m = ready.world.keeps_m(*against)
        if nearest[index] < kept_m - NEAR_M and certified.all():
            found.contradictions.append(f"{where}: {nearest[index] - kept_m:.4f} m")
        elif not certified.all():
            lost = int(np.argmin(certified))
            found.contradictions.append(f"{where}: not certified from tick {lost} of {len(certified)}")
    chain = claims.get("chain")
    if chain and chain["holds"] and min(nearest) < ready.world.radius_m - NEAR_M:
        found.contradictions.append(f"seed {seed}, case {number}: the chain holds, and a flight touches")


def run_of(ready: PreparedRun, logs: list[dict[str, Any]]) -> WorldRun:
    """The run of which `simulate` would write the guarantee."""
    times = Times.of(np.empty(0, np.float32), 1.0)
    return WorldRun(
        scenario=ready.scenario,
        vehicle=ready.vehicle,
        trials=[ready.judged(index, log) for index, log in enumerate(logs)],
        flights=[],
        world=ready.world,
        counts=ready.missions.counts,
        notes=[],
        start_h_i_m=None,
        filter_kind="native",
        filter_times=times,
        tick_times=times,
        command_s=np.empty((len(logs), 0)),
        reaction_s=np.empty((len(logs), 0)),
    )


def summary_of(case: Case) -> str:
    """What matters of a case, to read."""
    table, rules, known = case.scenario.vehicle, case.scenario.rules, case.scenario.estimation
    name = case.scenario.safety.filters[-1]
    return (
        f"{'+'.join(case.scenario.safety.filters)} {case.scenario.safety.parameters(name).policy} "  # type: ignore[union-attr]
        f"{case.vehicle.name} {table.interface} dt {rules.dt_s:g} x {rules.filter_ticks} lag "
        f"{table.assumed.motor_time_constant_s:g} delay {known.delay_s:g} "
        f"speed {case.scenario.mission.speed_m_s:.2f}"
    )


def drawn(rng: np.random.Generator) -> Case:
    """Draw a case.

    Args:
        rng: of the case.
    """

    def one(*values: Any) -> Any:
        return values[rng.integers(len(values))]

    def often(share: float) -> bool:
        return bool(rng.random() < share)

    vehicle = drawn_vehicle(rng)
    parts = one(("hulls",), ("ellipsoids",), ("fence",), ("hulls", "ellipsoids"), ("hulls", "fence"))
    cover, hulls, planes = drawn_cover(rng) if "hulls" in parts else (None, [], [])
    walls = drawn_walls(rng) if "hulls" in parts and often(0.3) else []
    hulls += [np.array(list(itertools.product(*zip(*wall, strict=True)))) for wall in walls]
    planes += [np.column_stack([SIDES, [*high, *(-value for value in low)]]) for low, high in walls]
    scene = drawn_scene(rng) if "ellipsoids" in parts else None
    tick_s = one(0.002, 0.004, 0.005, 0.01, 0.01, 0.0125, 0.02, 1 / 240, 0.03)
    most = max(1, int(0.1 / tick_s))
    ticks = 1 if often(0.3) else int(rng.integers(1, min(10, most) + 1))
    lag = 0.0 if often(0.35) else float(rng.uniform(0.003, 0.1))
    delay = 0.0 if often(0.5) else float(rng.uniform(0, 0.08))
    if often(0.5):
        delay = tick_s * round(delay / tick_s)
    name = one("shield", "shield", "cone-backup", "cone-ecbf") if hulls or scene else "shield"
    policies = ["brake", "brake", "heading-invariant", "hover"]
    policies += ["cone-escape"] if scene is not None and name != "shield" else []
    margin = float(rng.uniform(0.012, 0.05))
    parameters: dict[str, Any] = {
        "margin_m": margin,
        "rest_drift_m": float(rng.uniform(0.2, 0.499)) * margin,
        "early_end": often(0.7),
        "policy": one(*policies),
        "shield_map": "ellipsoids" if scene is not None and not hulls else "both" if scene else "hulls",
        "line_search": int(rng.integers(0, 4)),
    }
    steering = ["safer-splat", "dr-acbf"] if hulls or scene is not None else ["dr-acbf"]
    steering += ["cone-di"] if scene is not None else []
    steering += ["polytope-cbf"] if hulls else []
    before = one(*steering) if often(0.3) else None
    disturbance: dict[str, Any] = {"motor_time_constant_s": lag}
    estimation: dict[str, Any] = {"delay_s": delay}
    table: dict[str, Any] = {"interface": one("wrench", "body-rates"), "disturbance": disturbance}
    table["assumed"] = {"motor_time_constant_s": lag, "delay_s": delay}
    rules: dict[str, Any] = {
        "dt_s": tick_s,
        "filter_ticks": ticks,
        "controller_ticks": int(rng.integers(1, 4)) if often(0.3) else 1,
        "trials": 3,
        "seed": int(rng.integers(2**31)),
        "max_time_s": min(float(rng.uniform(2, 6)), MOST_CALLS * tick_s * ticks),
        "logged": 0,
    }
    if often(0.1):
        rules["plant_steps"] = int(rng.integers(1, 21))
    if often(0.04):
        table["mass_scale"] = float(rng.uniform(0.8, 1.25))
    if often(0.04):
        table["rate_gain_scale"] = float(rng.uniform(0.7, 1.4))
    if often(0.04):
        table["assumed"]["motor_time_constant_s"] = float(rng.uniform(0, 0.1))
    if often(0.04):
        estimation["disturbance_time_s"] = float(rng.uniform(0.05, 1))
    if often(0.04):
        estimation["sensor"] = {"own_position_sigma_m": 0.02}
    world: dict[str, Any] = {"inflation_m": float(rng.uniform(0, 0.05)) if often(0.3) else 0.0}
    world["walls"] = [{"lower_m": low, "upper_m": high} for low, high in walls]
    if before == "dr-acbf":
        ball = {"motion": "ballistic", "radius_m": 0.1, "distance_m": 3.0, "aims_at_vehicle": True}
        world["moving"] = [ball | {"azimuth_rad": (-3.1, 3.1), "speed_m_s": (2.0, 8.0)}]
    world |= {"cover": "x.cover.npz"} if cover is not None else {}
    world |= {"scene": "x.scene.npz", "sigma": float(rng.uniform(0.5, 3))} if scene is not None else {}
    if "fence" in parts:
        world["fence"] = drawn_fence(rng)
    room = [*(0.5, 0.5, 0.5), *(ROOM_M - 0.5)] if "fence" in parts else [*(-0.5,) * 3, *(ROOM_M + 0.5)]
    mission = {
        "kind": "pairs",
        "bounds_m": [float(value) for value in room],
        "beyond_map_m": 10.0,
        "speed_m_s": float(rng.uniform(0.5, 6)),
        "margin_m": float(rng.uniform(0.02, 0.2)),
        "which": "blocked" if (hulls or scene) and often(0.6) else "any",
        "separation": float(rng.uniform(0.1, 0.5)),
    }
    tree = {"vehicle": table, "world": world, "mission": mission, "estimation": estimation, "rules": rules}
    tree["safety"] = {"filters": [name] if before is None else [before, name], name: parameters}
    scenario = decoded(tree, "attack")
    return Case(scenario, vehicle, cover, scene, hulls, planes)


def drawn_fence(rng: np.random.Generator) -> dict[str, Any]:
    """A box within the room, and a slanted face in half of the cases."""
    low, high = rng.uniform(0, 0.4, 3), ROOM_M - rng.uniform(0, 0.4, 3)
    normal = rng.normal(size=3)
    normal /= np.linalg.norm(normal)
    face = [*normal.tolist(), float(normal @ (ROOM_M / 2) + rng.uniform(0.8, 2))]
    return {"box_m": [*low.tolist(), *high.tolist()], "faces": [face] if rng.random() < 0.5 else []}


def drawn_walls(rng: np.random.Generator) -> list[tuple[list[float], list[float]]]:
    """Lower and upper corners of boxes that are thin along one axis."""
    walls = []
    for _ in range(1 + rng.integers(3)):
        low, size = rng.uniform(0, ROOM_M - 1), rng.uniform(0.3, 2, 3)
        size[rng.integers(3)] = rng.uniform(0.01, 0.1)
        walls.append((low.tolist(), (low + size).tolist()))
    return walls


def drawn_vehicle(rng: np.random.Generator) -> Vehicle:
    """A known quadrotor, or one of another mass, inertia, strength and rate loop."""
    if rng.random() < 0.4:
        return VEHICLES[("fastbridge", "crazyflie21")[rng.integers(2)]]
    body, rotors = FASTBRIDGE.body, FASTBRIDGE.rotors
    assert body.mass_kg is not None
    assert body.inertia_kg_m2 is not None
    assert rotors is not None
    inertia = tuple(float(value * rng.uniform(0.7, 1.3)) for value in body.inertia_kg_m2)
    mass = float(body.mass_kg * rng.uniform(0.7, 1.5))
    hover = mass * 9.81 / 4
    most, least = (float(hover * rng.uniform(*range_)) for range_ in ((1.7, 4), (0, 0.3)))
    tau = [float(value) for value in rng.uniform(0.01, 0.05, 3)]
    replace = msgspec.structs.replace
    return replace(
        FASTBRIDGE,
        name="drawn",
        body=replace(body, radius_m=float(rng.uniform(0.05, 0.25)), mass_kg=mass, inertia_kg_m2=inertia),
        rotors=replace(rotors, max_thrust_n=(most,) * 4, min_thrust_n=(least,) * 4),
        rates=replace(
            FASTBRIDGE.rates,
            axis_time_constant_s=(tau[0], tau[1], 4 * tau[2]),
            max_rad_s=(float(rng.uniform(3, 12)), float(rng.uniform(3, 12)), float(rng.uniform(1, 6))),
        ),
    )


def drawn_cover(rng: np.random.Generator) -> tuple[Artifact, list[Floats], list[Floats]]:
    """Hulls of random lattice points, thin, long and large ones among them."""
    parts = []
    while len(parts) < 3 + rng.integers(12):
        low = rng.integers(0, (ROOM_M / GRID_M).astype(int))
        size = rng.integers(1, 12, 3)
        points = low + rng.integers(0, size + 1, (int(rng.integers(4, 14)), 3))
        if np.linalg.matrix_rank(points - points[0]) == 3:
            parts.append(exact_hull(points))
    hulls = [GRID_M * np.asarray(vertices, float) for vertices, _ in parts]
    planes = []
    for _, rows in parts:
        length = np.linalg.norm(rows[:, :3], axis=1)
        planes.append(np.column_stack([rows[:, :3], GRID_M * rows[:, 3]]) / length[:, None])
    return make_cover(parts, g=GRID_M), hulls, planes


def drawn_scene(rng: np.random.Generator) -> Artifact:
    """Ellipsoids from needles to balls."""
    count = int(rng.integers(3, 40))
    quat = rng.normal(size=(count, 4))
    scale = np.exp(rng.uniform(np.log(0.01), np.log(0.3), (count, 3)))
    return make_artifact(
        SCENE,
        {
            "mean": rng.uniform(0, ROOM_M, (count, 3)),
            "scale": scale,
            "quat_wxyz": quat / np.linalg.norm(quat, axis=1, keepdims=True),
            "opacity": np.ones(count),
            "color": np.zeros((count, 3)),
        },
        frame="world",
        unit="m",
        parameters={},
        summary={},
        source={},
    )


def clearance(case: Case, ready: PreparedRun, path: Floats, against: list[str]) -> float:
    """Minimum distance of the path's points from the parts that were certified [m]."""
    found = [np.inf]
    enough = ready.world.most_keep_m + 0.05
    if "hulls" in against:
        found += [distance_to_hull(path, *hull, enough) for hull in zip(case.hulls, case.planes, strict=True)]
    if "ellipsoids" in against:
        assert case.scene is not None
        found += [
            distance_to_ellipsoid(path, np.asarray(mean, float), ready.world.sigma * axes, turn, enough)
            for mean, axes, turn in zip(
                case.scene["mean"],
                np.asarray(case.scene["scale"], np.float32).astype(float),
                np.asarray(case.scene["quat_wxyz"], np.float32).astype(float),
                strict=True,
            )
        ]
    fence = case.scenario.world.fence
    if "fence" in against and fence is not None:
        if fence.box_m is not None:
            box = np.array(fence.box_m)
            found += [(path - box[:3]).min(), (box[3:] - path).min()]
        found += [(d - path @ np.array(n)).min() for *n, d in fence.faces]
    return float(min(found))


def least_of(distance: Callable[[Floats], float], path: Floats, bound: Floats, enough: float) -> float:
    """Minimum of a distance along a path [m].

    Args:
        distance: of a point, which changes by at most the way to another point [m].
        path: points, shape (N, 3) [m].
        bound: of their distances from below, shape (N,) [m].
        enough: distances beyond this need not be exact [m].
    """
    least, arc = enough, np.concatenate([[0], np.linalg.norm(np.diff(path, axis=0), axis=1).cumsum()])
    index = 0
    while index < len(path):
        here = float(bound[index])
        if here < least:
            here = distance(path[index])
            least = min(least, here)
        index = max(index + 1, int(np.searchsorted(arc, arc[index] + here - least, "right")))
    return least


def distance_to_hull(path: Floats, vertices: Floats, planes: Floats, enough: float) -> float:
    """Minimum distance of a path from a convex hull, 0 inside; at most `enough` [m]."""
    weight = 1e3  # of the row that makes the shares of the vertices sum to 1

    def distance(point: Floats) -> float:
        system = np.vstack([(vertices - point).T, np.full(len(vertices), weight)])
        share, _ = nnls(system, np.array([0.0, 0, 0, weight]))
        return float(np.linalg.norm((vertices - point).T @ (share / share.sum())))

    return least_of(distance, path, (path @ planes[:, :3].T - planes[:, 3]).max(axis=1), enough)


def distance_to_ellipsoid(path: Floats, mean: Floats, axes: Floats, quat: Floats, enough: float) -> float:
    """Minimum distance of a path from an ellipsoid, 0 inside; at most `enough` [m]."""
    w, x, y, z = quat / np.linalg.norm(quat)
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    squares = axes**2

    def distance(point: Floats) -> float:
        # The nearest point is squares p / (squares + t), with the t >= 0 that puts it on the surface.
        def outside(t: float) -> float:
            return float((squares * point**2 / (squares + t) ** 2).sum() - 1)

        if outside(0) <= 0:
            return 0.0
        t = brentq(outside, 0, float(axes.max() * np.linalg.norm(point)), xtol=1e-14)
        return float(np.linalg.norm(point - squares * point / (squares + t)))

    local = (path - mean) @ turn
    return least_of(distance, local, np.linalg.norm(np.maximum(np.abs(local) - axes, 0), axis=1), enough)
