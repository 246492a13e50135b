"""Combinations of the parts of a scenario: each flies for a moment, or is refused in words."""

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple, get_args

import msgspec
import numpy as np

from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.errors import UsageError
from alula.schemas.log.run import Outcome, TrialResult
from alula.schemas.parameters.filter_options import FILTERS
from alula.schemas.scenarios.defaults import vehicle_of
from alula.schemas.scenarios.scenario import decoded
from alula.stages.simulation.judge import hits_static
from alula.stages.simulation.prepare import prepare
from support.scenes.small_scenes import ball_scene, box_cover, line_plan

TIME_S = 0.3  # of a flight
START, GOAL = (0.6, 0.6, 1.0), (3.4, 2.4, 1.2)
RADIUS_M = 0.1  # small enough for the gaps of the world

VEHICLES = {
    "single-integrator": ("velocity",),
    "double-integrator": ("acceleration", "velocity"),
    "crazyflie21": ("wrench", "body-rates", "velocity", "acceleration"),
    "fastbridge": ("wrench", "body-rates", "velocity", "acceleration"),
    "racer7": ("sticks", "body-rates"),
}
_COVER, _SCENE = {"cover": "room.cover.npz"}, {"scene": "room.scene.npz"}
_FENCE = {"fence": {"box_m": [0.0, 0.0, 0.2, 4.0, 3.0, 2.8]}}
_MOVING = {
    "moving": [
        {"motion": "ballistic", "radius_m": 0.1, "distance_m": 2.0, "speed_m_s": [3.0, 5.0]},
        {
            "motion": "constant-velocity",
            "radius_m": 0.1,
            "position_m": [2.0, 2.5, 1.0],
            "velocity_m_s": [0.0, -1.0, 0.0],
        },
    ]
}
WORLDS: dict[str, dict[str, Any]] = {
    "nothing": {},
    "cover": _COVER,
    "scene": _SCENE,
    "cover, scene": _COVER | _SCENE,
    "fence": _FENCE,
    "walls": {
        "walls": [
            {"lower_m": [1.6, 1.2, 0.0], "upper_m": [1.8, 2.9, 2.0]},
            {"lower_m": [0.0, 3.0, 0.0], "upper_m": [4.0, 3.2, 2.0]},
            {"lower_m": [0.0, -0.2, 0.0], "upper_m": [4.0, 0.0, 2.0]},
        ]
    },
    "moving": _MOVING,
    "cover, fence, moving": _COVER | _FENCE | _MOVING,
}
_FAR = {"beyond_map_m": 5.0}  # the worlds are a few obstacles
MISSIONS: dict[str, dict[str, Any]] = {
    "pairs": {"kind": "pairs", **_FAR},
    "pairs in a box": {"kind": "pairs", "bounds_m": [0.3, 0.3, 0.5, 3.7, 2.7, 2.4], **_FAR},
    "goal": {"kind": "goal", "start_m": START, "goal_m": GOAL, **_FAR},
    "waypoints": {"kind": "waypoints", "start_m": START, "waypoints_m": [(0.8, 2.0, 1.1), GOAL], **_FAR},
    "hover": {"kind": "hover", "start_m": START, **_FAR},
    "plan": {"kind": "plan", "plan": "room.plan.npz", "allow_tight": True, **_FAR},
    "pilot": {"kind": "pilot", "start_m": START, "pilot": {"kind": "sticks"}, **_FAR},
}
LISTS: list[tuple[str, ...]] = [
    (),
    *((name,) for name in FILTERS if name != "none"),
    ("polytope-cbf", "shield"),
    ("polytope-cbf", "dr-acbf"),
    ("dr-acbf", "shield"),
    ("dr-acbf", "cone-backup"),
    ("polytope-cbf", "dr-acbf", "shield"),
    ("polytope-cbf", "dr-acbf", "cone-backup", "geofence"),
    ("shield", "polytope-cbf"),
]
_SENSOR = {
    "sensor": {"kind": "mocap", "rate_hz": 100.0, "position_sigma_m": 0.002},
    "tracker": {"confirm_hits": 2, "confirm_scans": 3},
}
# A refusal says what would work instead by one of these.
_INSTEAD = ("set ", "fly ", "leave ", "give ", "raise ")


class Case(NamedTuple):
    """A combination: names of its parts, and the tables of its scenario."""

    name: str
    tree: dict[str, Any]


class Verdict(NamedTuple):
    """What became of a combination.

    Attributes:
        trial: verdict on the flight; None where it was refused.
        words: of the refusal; empty where it was flown.
        faults: what is wrong with the flight or with the refusal.
    """

    trial: TrialResult | None
    words: str
    faults: list[str]


def files() -> dict[str, Artifact]:
    """Cover, scene and plan of a small room: a pillar, a block and a beam, and a few ellipsoids."""
    hulls = [((15, 0, 0), (18, 12, 25)), ((24, 18, 0), (28, 22, 8)), ((8, 26, 20), (36, 28, 22))]
    return {
        "cover": box_cover(hulls),
        "scene": ball_scene([(1.65, 0.9, 1.0), (2.6, 2.0, 0.5), (2.2, 2.7, 2.1), (3.0, 1.2, 1.9)], 0.1),
        "plan": line_plan(START, (0.6, 2.4, 1.2)),
    }


def cases(vehicle: str, interface: str) -> Iterator[Case]:
    """All combinations of a vehicle.

    Args:
        vehicle: name of a built-in vehicle.
        interface: what it is commanded by.
    """
    for world, mission, filters in itertools.product(WORLDS, MISSIONS, LISTS):
        tree: dict[str, Any] = {
            "vehicle": {"type": vehicle, "interface": interface, "radius_m": RADIUS_M},
            "world": WORLDS[world],
            "mission": MISSIONS[mission],
            "safety": {"filters": filters},
            "rules": {"trials": 1, "max_time_s": TIME_S},
        }
        if "moving" in tree["world"]:
            tree["estimation"] = _SENSOR
        name = " | ".join((f"{vehicle} by {interface}", world, mission, " + ".join(filters) or "no filter"))
        yield Case(name, tree)


def tried(tree: dict[str, Any], made: dict[str, Artifact]) -> Verdict:
    """Fly a combination for a moment; anything but a usage error is raised.

    Args:
        tree: tables of the scenario.
        made: of `files`.
    """
    try:
        scenario = decoded(msgspec.msgpack.decode(msgspec.msgpack.encode(tree)), "case")
        vehicle = vehicle_of(scenario, Path())
        named = {"cover": scenario.world.cover, "scene": scenario.world.scene, "plan": scenario.mission.plan}
        ready = prepare(
            scenario,
            vehicle,
            **{role: made[role] for role, name in named.items() if name is not None},
            jobs=1,
        )
        (log,) = ready.fly(0, 1, jobs=1)
    except UsageError as error:
        return Verdict(None, str(error), _faults_of_words(str(error)))
    trial = ready.judged(0, log)
    return Verdict(trial, "", _faults_of_flight(log, trial, ready.names, len(ready.filters)))


def _faults_of_words(words: str) -> list[str]:
    faults = []
    if "`$." not in words:
        faults.append("no path of a key")
    if "\n" in words or words.endswith("."):
        faults.append("more than one sentence")
    if not any(word in words for word in _INSTEAD):
        faults.append("no alternative")
    return faults


def _faults_of_flight(log: dict[str, Any], trial: TrialResult, names: list[str], filters: int) -> list[str]:
    faults = [
        f"{key} is not finite"
        for key in ("path", "state", "estimate", "measured", "nominal", "command", "obstacle", "filter_s")
        if not np.isfinite(log[key]).all()
    ]
    ticks = len(log["mark"])
    if trial.outcome not in get_args(Outcome):
        faults.append(f"outcome {trial.outcome}")
    if not 1 <= ticks <= round(TIME_S / 0.01):
        faults.append(f"{ticks} ticks")
    if np.isnan(log["margin"]).any():
        faults.append("a margin is no number")
    if log["status"].shape != (ticks, filters):  # a pilot without a filter has one that only watches
        faults.append("a filter has no record")
    if not _is_finite(msgspec.to_builtins(trial)):
        faults.append("the verdict is not finite")
    shielded = bool(names) and names[-1] == "shield"
    if shielded and hits_static(trial):
        faults.append("a shielded flight touched a static obstacle")
    return faults


def _is_finite(value: Any) -> bool:
    if isinstance(value, dict):
        return all(map(_is_finite, value.values()))
    if isinstance(value, list | tuple):
        return all(map(_is_finite, value))
    return not isinstance(value, float) or bool(np.isfinite(value))
