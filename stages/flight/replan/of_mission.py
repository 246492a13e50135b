"""New plans of a real flight, from its mission."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.parameters.flight_defaults import planned_interface
from alula.stages.filtering.registry import filter_kind
from alula.stages.flight.mission import PlannedFlight
from alula.stages.flight.replan.process import Planner, PlannerProcess
from alula.stages.flight.replan.replanner import Replanner, ReplanOptions
from alula.stages.flight.replan.task import KeptMap, ReplanFacts
from alula.stages.planning.plan_samples import sample_plan

_FENCE_ROOM_M = (
    0.25  # that plans keep from the fence beyond radius and reserve, for the fence to let them pass
)
_STEP_S = 0.02  # of the plan, whose lowest point is looked for
_FOOT = 1.5  # of radius and margin: the last part of a way home, as in the checks before the flight


def replan_facts(mission: PlannedFlight) -> ReplanFacts | None:
    """What all new plans of a flight have in common; None if no new plans are to be made.

    Plans keep to what the vehicle's autopilot follows where it is flown by velocities or accelerations. They
    keep from each map what the filter keeps from it; a map that it does not see counts with radius and
    margin. Without a margin there is no room to join a plan. New plans pass points and have one heading: a
    mission with gates, rests, zones or a heading that turns has none.
    """
    config, radius = mission.config, mission.world.vehicle.body.radius_m
    if config.replan_after_s == 0 or config.filter == "none" or _has_more(mission.plan):
        return None
    assert config.fence is not None
    assert config.speed_m_s is not None
    world = mission.world.static
    keep, hulls = world.radius_m, world.keeps_m("hulls")
    maps = []
    if mission.cover is not None:
        maps.append(KeptMap(role="cover", keep_m=hulls if mission.sees_hulls else keep))
    if world.scene is not None:
        maps.append(KeptMap(role="scene", keep_m=world.keeps_m("ellipsoids"), sigma=config.sigma))
    if world.seen is not None:
        maps.append(KeptMap(role="within", keep_m=hulls))
    join = min(each.keep_m for each in maps) - radius
    if join <= 0:
        return None
    manifest = mission.plan.manifest
    speed = manifest.speed_m_s  # type: ignore[attr-defined]
    x, y, z = mission.goal.tolist()
    yaw = repr(float(mission.plan["coefficient"][0, 3, 0]))
    # The vehicle itself, which may be beside the plan, stays within what the plan takes for free.
    beyond = max(config.beyond_map_m, manifest.beyond_map_m) + join  # type: ignore[attr-defined]
    own = {"yaw": yaw, "beyond_map_m": beyond}
    return ReplanFacts(
        parameters={"speed_m_s": speed, **manifest.parameters, **own} | _interface(mission),
        goal=(x, y, z),
        maps=tuple(maps),
        fence=config.fence,
        lowest_m=float(sample_plan(mission.plan, _STEP_S)[:, 2].min()),
        fence_room_m=radius + config.fence_reserve_m + _FENCE_ROOM_M,
        join_m=join,
        foot_m=_FOOT * keep,
        speed_m_s=config.speed_m_s,
    )


def _has_more(plan: Artifact) -> bool:
    """Whether a plan has more than via points and one heading."""
    yaw = np.asarray(plan["coefficient"])[:, 3]
    turns = bool(yaw[:, 1:].any() or (yaw[:, 0] != yaw[0, 0]).any())
    manifest: Any = plan.manifest
    more = any(each.kind == "gate" or each.hold_s > 0 for each in manifest.passes)
    return turns or bool(manifest.zones) or more


def _interface(mission: PlannedFlight) -> dict[str, str]:
    roles = ("scene",) if mission.is_splat else ("cover",)
    return {"interface": planned_interface([mission.config.filter], filter_kind, roles)}


def maps_of(mission: PlannedFlight) -> dict[str, Artifact]:
    """Maps of a flight by role."""
    maps = {"cover": mission.cover, "scene": mission.world.static.scene, "within": mission.world.static.seen}
    return {role: each for role, each in maps.items() if each is not None}


def make_planner(mission: PlannedFlight, paths: Mapping[str, Path]) -> PlannerProcess | None:
    """Start the process that makes new plans; None if no new plans are to be made.

    Raises:
        InputError: the process does not run.
    """
    facts = replan_facts(mission)
    return None if facts is None else PlannerProcess(facts, mission.world.vehicle, maps_of(mission), paths)


def make_replanner(mission: PlannedFlight, planner: Planner) -> Replanner:
    """Decide when new plans are asked for, and join them.

    Args:
        mission: of the flight, for which there are `replan_facts`.
    """
    facts, config = replan_facts(mission), mission.config
    assert facts is not None
    options = ReplanOptions(
        after_s=config.replan_after_s,
        most=config.replans,
        join_m=facts.join_m,
        margin_m=config.margin_m,
        via_tolerance_m=mission.along.tolerance_m,
    )
    return Replanner(planner, mission.along.via, options)
