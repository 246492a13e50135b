"""Upgrade of the three kinds of scenarios of version 1 to version 2.0."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec

from alula.schemas.encounters import Encounters, is_encounters, read_encounters
from alula.schemas.errors import UsageError
from alula.schemas.filter_options import FILTERS, MovingFilterParameters
from alula.schemas.flight_defaults import NO_FILTER
from alula.schemas.foreign_filters import foreign_filter, foreign_names, kind_of
from alula.schemas.geofence import FenceScenario, RacerTable, is_fence_scenario, read_fence_scenario
from alula.schemas.scenario import DEFAULT_FILTER, SCENARIO_SCHEMA, Scenario, read_scenario
from alula.schemas.toml_file import read_tree
from alula.schemas.vehicle import FASTBRIDGE, Vehicle, read_vehicle
from alula.schemas.vehicles import DEFAULT_SPEED_M_S, point_limits
from alula.schemas.world_tables import DisturbanceTable

_AMONG_ELLIPSOIDS = ("safer-splat", "cone-di", "cone-ecbf", "cone-backup", "shield")
_MOVING = [name for name, kind in FILTERS.items() if kind is MovingFilterParameters]  # all have the same ones
_WITHOUT_FILTER = "dr-acbf"
_PAIRS = 100  # default number of random pairs of version 1

Tree = dict[str, Any]


def upgraded_tree(path: Path, filters: Sequence[str] = ()) -> Tree:
    """Convert a scenario of version 1 to the plain values of version 2.0.

    Values carry over exactly, and defaults of version 1 that version 2.0 does not share are written out. Not
    carried over exactly, because version 2.0 has other rules and not other values:

    - All parts of the world are obstacles of the judge. Version 1 reported the clearance to the hulls of a
      cover without judging it where a filter avoided the ellipsoids of a scene, and judged the scene of a
      flight among hulls at the level of the cover instead of `map.sigma`.
    - Measurements are stale after `estimation.stale_s`, except in outages of a fence's scenario, where the
      limit is switched off; version 1 flew on measurements of any age.
    - Without a filter, the parameters of the moving filters and of the geofence go to the tables of dr-acbf
      and geofence, as they also set the window of the mission's risk and what is reported.
    - A quadrotor's file flown as a double integrator becomes the built-in double integrator with the file's
      radius, velocity gain, catch-up speed, noise and delay; a file with another position gain is refused.
    - Speed limit and radius of a plan flown by a single integrator without a file are those of the plan now.

    Args:
        path: the file.
        filters: that will be flown instead of the file's: version 1 had the same parameters for all filters
            among moving obstacles.

    Returns:
        Plain values, as from TOML.

    Raises:
        InputError, VersionError, UsageError: as the readers of version 1; InputError also where a plan is
            needed and cannot be read.
    """
    if is_fence_scenario(path):
        tree = _of_fence(read_fence_scenario(path), read_tree(path))
    elif is_encounters(path):
        tree = _of_encounters(read_encounters(path), read_tree(path), filters)
    else:
        tree = _of_pairs(path, read_scenario(path))
    found: Tree = _given({"schema": SCENARIO_SCHEMA, "version": "2.0"} | tree)
    return found


def _given(value: Any) -> Any:
    """Leave out keys without a value and tables without keys; tuples become lists."""
    if isinstance(value, dict):
        found = {key: _given(item) for key, item in value.items()}
        return {key: item for key, item in found.items() if item is not None and item != {}}
    return [_given(item) for item in value] if isinstance(value, list | tuple) else value


def _of_pairs(path: Path, scenario: Scenario) -> Tree:
    name = scenario.filter.name or DEFAULT_FILTER
    table, run, trials = scenario.map, scenario.run, scenario.trials
    parameters = dict(scenario.filter.parameters)
    onboard = parameters.pop("onboard", None) if name == DEFAULT_FILTER else None
    count = trials.count or (_PAIRS if table.plan is None else 1)
    splat = _is_among_ellipsoids(name, table.cover)
    vehicle, more = _point(path, scenario) if not splat else _rigid(path, scenario)
    catch_up = more.pop("catch_up_m_s", None)
    if scenario.controller.catch_up_m_s is not None:
        catch_up = scenario.controller.catch_up_m_s
    speed = scenario.vehicle.v_max_m_s
    if splat and table.plan is None and speed is None:
        speed = DEFAULT_SPEED_M_S
    return {
        "name": scenario.name,
        "vehicle": vehicle,
        "world": {
            "cover": table.cover,
            "onboard": onboard,
            "scene": table.scene,
            "sigma": table.sigma,
            "confidence": table.confidence,
            "inflation_m": table.inflation_m,
        },
        "mission": {
            "kind": "pairs" if table.plan is None else "plan",
            "plan": table.plan,
            "speed_m_s": speed if splat else None,
            "bounds_m": trials.bounds_m if table.plan is None else None,
            "margin_m": trials.margin_m if table.plan is None else None,
            "separation": trials.separation if table.plan is None else None,
            "which": trials.pairs,
            "planned": trials.planned,
            "stop_fraction": trials.stop_fraction,
            "via_tolerance_m": run.via_tolerance_m,
            "allow_tight": run.allow_tight,
            "controller": {
                "gain_per_s": scenario.controller.gain,
                "guide": scenario.controller.guide,
                "guide_parameters": scenario.controller.guide_parameters,
                "catch_up_m_s": catch_up,
            },
        },
        "estimation": more,
        "safety": {"filters": [] if name == NO_FILTER else [name], name: parameters},
        "rules": {
            "dt_s": run.dt_s,
            "controller_ticks": run.controller_ticks,
            "filter_ticks": run.filter_ticks,
            "trials": count,
            "seed": trials.seed,
            "max_time_s": run.max_time_s,
            "logged": count,
            "log_rate_hz": run.log_rate_hz,
        },
        "fly": None if scenario.fly is None else msgspec.structs.asdict(scenario.fly),
    }


def _is_among_ellipsoids(name: str, cover: str | None) -> bool:
    """Whether `simulate` of version 1 flew a scenario among ellipsoids, and not among hulls."""
    if cover is None or name in _AMONG_ELLIPSOIDS:
        return True
    return name in foreign_names() and kind_of(name, foreign_filter(name)) != "velocity"


def _point(path: Path, scenario: Scenario) -> tuple[Tree, Tree]:
    """Single integrator of a scenario among hulls, and what it knows of its state."""
    table = scenario.vehicle
    own: Tree = {"radius_m": table.radius_m, "max_speed_m_s": table.v_max_m_s}
    if table.file is not None:
        return {"file": table.file} | own, {}
    plan = None if scenario.map.plan is None else path.parent / scenario.map.plan
    own = point_limits(plan, radius_m=table.radius_m, speed_m_s=table.v_max_m_s)
    return {"type": "single-integrator"} | own, {}


def _rigid(path: Path, scenario: Scenario) -> tuple[Tree, Tree]:
    """Vehicle of a scenario among ellipsoids, and what it knows of its state."""
    table = scenario.vehicle
    own: Tree = {"type": "fastbridge"} if table.file is None else {"file": table.file}
    own |= {"interface": table.interface, "radius_m": table.radius_m}
    if table.plant != "double-integrator":
        return own, {}
    vehicle = FASTBRIDGE if table.file is None else read_vehicle(path.parent / table.file)
    if vehicle.model == "double-integrator":
        return own | {"interface": None}, {}
    return _as_double_integrator(path, table.radius_m, vehicle)


def _as_double_integrator(path: Path, radius_m: float | None, vehicle: Vehicle) -> tuple[Tree, Tree]:
    if vehicle.tracking.kp_per_s2 != FASTBRIDGE.tracking.kp_per_s2:
        raise UsageError(
            f"{path}: `$.vehicle.plant`: version 2.0 flies files as they are; write one of a double "
            f"integrator with the gains of {vehicle.name}"
        )
    own = {
        "type": "double-integrator",
        "radius_m": vehicle.body.radius_m if radius_m is None else radius_m,
        "max_acceleration_m_s2": float("inf"),
        "velocity_gain_per_s": vehicle.tracking.kv_per_s,
    }
    noise = vehicle.disturbance
    known = {
        "position_noise_m": noise.position_noise_m or None,
        "velocity_noise_m_s": noise.velocity_noise_m_s or None,
        "delay_s": noise.delay_s or None,
        "catch_up_m_s": vehicle.tracking.catch_up_m_s,
    }
    return own, known


def _of_encounters(scenario: Encounters, tree: Tree, filters: Sequence[str]) -> Tree:
    encounter, body, run = scenario.encounter, scenario.vehicle, scenario.run
    hovers = encounter.hovers
    speed = encounter.start_speed_m_s
    name, parameters = scenario.filter.name, tree.get("filter", {}).get("parameters")
    flown = [other for other in filters if other in _MOVING]
    return {
        "name": scenario.name,
        "vehicle": {
            "type": "double-integrator",
            "radius_m": body.radius_m,
            "max_speed_m_s": body.v_max_m_s,
            "max_acceleration_m_s2": body.a_max_m_s2,
            "max_jerk_m_s3": body.j_max_m_s3,
            "actuation_delay_s": body.actuation_delay_s or None,
        },
        "world": {
            "cover": scenario.map.cover,
            "moving": tree.get("obstacles"),
            "walls": tree.get("walls"),
        },
        "mission": {
            "kind": "hover" if hovers else "goal",
            "start_m": encounter.start_m,
            "goal_m": None if hovers else encounter.goal_m,
            "start_speed_m_s": (0.0 if hovers else encounter.cruise_m_s) if speed is None else speed,
            "speed_m_s": encounter.cruise_m_s,
            "receded_s": encounter.receded_s,
            "controller": {"gain_per_s": encounter.gain_per_s},
        },
        "estimation": {
            "sensor": tree.get("sensor", {}) | {"yaw_rate_rad_s": body.yaw_rate_rad_s},
            "tracker": tree.get("tracker"),
        },
        "safety": {
            "filters": [] if name == NO_FILTER else [name],
            **dict.fromkeys(flown or [name if name in _MOVING else _WITHOUT_FILTER], parameters),
        },
        "rules": {
            "dt_s": run.dt_s,
            "plant_steps": run.plant_steps,
            "trials": scenario.trials.count,
            "seed": scenario.trials.seed,
            "max_time_s": run.max_time_s,
            "logged": scenario.trials.logged,
            "log_rate_hz": run.log_rate_hz,
        },
    }


def _of_fence(scenario: FenceScenario, tree: Tree) -> Tree:
    body, run, trials = scenario.vehicle, scenario.run, scenario.trials
    values: Tree = msgspec.structs.asdict(body)
    disturbed = {item.name for item in msgspec.structs.fields(DisturbanceTable)}
    scales = ("mass_scale", "thrust_scale", "rate_gain_scale")
    default = RacerTable()
    name = scenario.filter.name
    parameters = dict(tree.get("filter", {}).get("parameters", {}))
    parameters.pop("tick_s", None)
    boxed = trials.start_box_m is not None
    fence = {"box_m": scenario.fence.box_m, "faces": scenario.fence.faces or None}
    moves = any(trials.start_velocity_m_s)
    return {
        "name": scenario.name,
        "vehicle": {
            "file": body.file,
            "interface": "sticks",
            "radius_m": body.radius_m,
            **{key: values[key] for key in scales if values[key] != getattr(default, key)},
            "disturbance": {key: value for key, value in values.items() if key in disturbed},
        },
        "world": {"cover": scenario.fence.cover, "fence": fence},
        "mission": {
            "kind": "pilot",
            "start_m": trials.start_m,
            "start_box_m": trials.start_box_m,
            "start_velocity_m_s": trials.start_velocity_m_s if moves and not boxed else None,
            "start_yaw_deg": trials.start_yaw_deg or None,
            "start_speed_m_s": trials.start_speed_m_s if boxed else None,
            "start_tilt_deg": trials.start_tilt_deg if boxed else None,
            "pilot": tree.get("pilot", {})
            | {"radio_from_s": run.radio_from_s, "radio_for_s": run.radio_for_s},
        },
        "estimation": {
            "delay_s": body.delay_s,
            "lost_from_s": run.stale_from_s,
            "lost_for_s": run.stale_for_s,
            "stale_s": None if run.stale_from_s is None else float("inf"),
        },
        "safety": {
            "filters": [] if name == NO_FILTER else [name],
            "geofence" if name == NO_FILTER else name: parameters,
        },
        "rules": {
            "dt_s": scenario.filter.parameters.tick_s,
            "plant_steps": run.plant_steps,
            "trials": trials.count,
            "seed": trials.seed,
            "max_time_s": run.duration_s,
            "logged": run.traces,
            "log_rate_hz": run.log_rate_hz,
        },
    }
