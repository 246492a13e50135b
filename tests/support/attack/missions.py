"""Random missions over all features: what is planned must be proven by `verify`, and by dense evaluation."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np

from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.errors import AlulaError
from alula.schemas.parameters.configs.plan import PlanConfig
from alula.schemas.scenarios.mission import Mission, PassTable, ZoneTable
from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.stages.planning.plan import plan
from alula.stages.planning.verify import verify_plan
from support.attack.outcome import Outcome
from support.attack.plan_judge import faults_of
from support.scenes.covers import SIZE_M, boxes_cover

FLOOR, CEILING = [0, 0, 0, 40, 40, 1], [0, 0, 25, 40, 40, 26]


def world(rng: np.random.Generator) -> list[list[int]]:
    """A room of 4 x 4 x 2.4 m with up to four boxes in it, in voxels of 0.1 m."""
    boxes = [FLOOR, CEILING]
    for _ in range(rng.integers(0, 5)):
        low, size = rng.integers((4, 4, 1), (30, 30, 12)), rng.integers(2, 10, 3)
        boxes.append([*low.tolist(), *(low + size).tolist()])
    return boxes


def _point(rng: np.random.Generator) -> tuple[float, float, float]:
    x, y, z = np.round(rng.uniform((0.3, 0.3, 0.4), (3.7, 3.7, 2.2)), int(rng.integers(1, 12))).tolist()
    return x, y, z


def _heading(rng: np.random.Generator) -> dict[str, Any]:
    kinds = [{}, {}, {"yaw": "along"}, {"yaw_rad": float(rng.uniform(-6, 6))}, {"look_at_m": _point(rng)}]
    return kinds[rng.integers(len(kinds))]


def _pass(rng: np.random.Generator) -> PassTable:
    if rng.random() < 0.4:
        normal = rng.normal(size=3) * (1, 1, 0.3)
        if rng.random() < 0.3:
            normal = np.eye(3)[rng.integers(2)] * rng.choice([-2.0, 1.0])
        return PassTable(
            gate_m=_point(rng),
            normal=tuple(normal.tolist()),
            radius_m=float(rng.choice([0.2, 0.3, 0.6])),
            **_heading(rng),
        )
    return PassTable(
        point_m=_point(rng),
        tolerance_m=[None, 0.01, 0.1, 0.5][rng.integers(4)],
        hold_s=float(rng.choice([0, 0, 0, 1e-4, 0.3, 2.0])),
        **_heading(rng),
    )


def case(seed: int) -> tuple[list[list[int]], PlanConfig, Mission]:
    """World, configuration and mission of a seed."""
    rng = np.random.default_rng(seed)
    boxes = world(rng)
    ends = [_point(rng), _point(rng)]
    if rng.random() < 0.3:  # in or beside a box
        x, y, z = (
            np.mean([boxes[-1][:3], boxes[-1][3:]], axis=0) * SIZE_M + rng.normal(size=3) * 0.2
        ).tolist()
        ends[rng.integers(2)] = x, y, z
    passes = tuple(_pass(rng) for _ in range(rng.integers(0, 4)))
    zones = []
    for _ in range(rng.integers(0, 3) if rng.random() < 0.4 else 0):
        low = rng.uniform(0, 3, 3)
        zones.append(ZoneTable(box_m=(*low, *(low + rng.uniform(0.2, 1.5, 3))), speed_m_s=0.3))
    whole = rng.random() < 0.2
    straight = not passes and not zones and rng.random() < 0.5
    config = PlanConfig(
        start=ends[0],
        goal=ends[1],
        **({"radius_m": 0.15} if whole else {"margin_m": float(rng.choice([0.0, 0.03, 0.1]))}),
        speed_m_s=float(rng.choice([0.3, 1.0, 3.0])),
        acceleration_m_s2=float(rng.choice([1.0, 3.0, 8.0])),
        smooth=float(rng.choice([1.0, 1.0, 1.5])),
        nearest_free=bool(rng.random() < 0.5),
        straight=straight,
        interface=str(rng.choice(["body-rates", "acceleration"])),
        bounds=(0.1, 0.1, 0.15, 3.9, 3.9, 2.4) if rng.random() < 0.3 else None,
    )
    heading = {} if straight else _heading(rng)
    loops = int(rng.integers(1, 4)) if passes else 1
    return boxes, config, Mission(loops=loops, passes=passes, zones=tuple(zones), **heading)


def planned(seed: int) -> tuple[Artifact, list[list[int]]]:
    """The plan of a seed, and its boxes.

    Raises:
        AlulaError: it is refused.
    """
    boxes, config, mission = case(seed)
    return plan(config, boxes_cover(boxes), mission=mission, vehicle=FASTBRIDGE, jobs=1), boxes


def disagreements(seed: int) -> tuple[list[str], Artifact]:
    """What contradicts that the plan of a seed is proven.

    Raises:
        AlulaError: it is refused.
    """
    made, boxes = planned(seed)
    certificate = verify_plan(made, cover=boxes_cover(boxes), jobs=1)
    found = [f"verify: {offence.fault}" for check in certificate.checks for offence in check.first]
    ends = {"start": made["coefficient"][0, :3, 0], "goal": made["waypoint"][-1, :3]}
    given = ends if made.manifest.parameters["nearest_free"] else {}
    return found + faults_of(made, boxes, **given), made


def search(seconds: float, seed: int) -> Outcome:
    """Plan, prove and judge random missions."""
    found = Outcome("every plan of a random mission is proven by `verify` and judged to fly it")
    end = time.monotonic() + seconds
    number = 1_000_000 * seed
    while time.monotonic() < end:
        number += 1
        found.tried += 1
        try:
            wrong, made = disagreements(number)
        except AlulaError:
            found.counts["refused"] += 1
            continue
        found.counts["proven"] += not wrong
        for name, has in features(made).items():
            found.counts[f"with {name}"] += has
        found.contradictions += [f"missions.case({number}): {each}" for each in wrong[:3]]
    return found


def features(made: Artifact) -> dict[str, bool]:
    """Which features a plan has."""
    manifest, passes = made.manifest, made.manifest.passes
    yaw = np.asarray(made["coefficient"])[:, 3, 1:]
    asked = [manifest.parameters[name] for name in ("start", "goal")]
    ends = [made["coefficient"][0, :3, 0], made["waypoint"][-1, :3]]
    return {
        "gates": any(each.kind == "gate" for each in passes),
        "rests": any(each.hold_s for each in passes),
        "tolerances": any(each.tolerance_m for each in passes),
        "laps": any(each.lap > 1 for each in passes),
        "zones": bool(manifest.zones),
        "turns": bool(yaw.any()),
        "moved ends": any(math.dist(a, b) > 1e-6 for a, b in zip(asked, ends, strict=True)),
    }
