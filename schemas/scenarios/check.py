"""Which choices of parts make sense together: what a scenario cannot fly, in one sentence."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from alula.schemas.parameters.filter_options import ShieldParameters
from alula.schemas.parameters.flight_defaults import NO_FILTER
from alula.schemas.scenarios.defaults import completed
from alula.schemas.scenarios.moving import ObstacleTable, interval
from alula.schemas.scenarios.scenario import Scenario
from alula.schemas.scenarios.tables import COMMANDS
from alula.schemas.scenarios.vehicle import Vehicle

FILTER_COMMANDS = {
    "polytope-cbf": "velocity",
    **dict.fromkeys(("cone-di", "safer-splat"), "acceleration"),
    **dict.fromkeys(("dr-acbf", "dr-acbf-qp", "mpc", "cbf-qp", "rp-cbf"), "acceleration"),
    **dict.fromkeys(("cone-ecbf", "cone-backup", "shield"), "wrench"),
    **dict.fromkeys(("geofence", "backup-qp"), "sticks"),
}
"""The command that each filter of this package takes and gives."""
TRACKING = frozenset({"dr-acbf", "dr-acbf-qp", "mpc", "cbf-qp", "rp-cbf"})
"""Filters that see tracks of moving obstacles."""
RANDOM_PILOTS = frozenset({"sticks", "aggressive", "silent"})

_TAKEN = {
    "velocity": ("velocity",),
    "acceleration": ("velocity", "acceleration"),
    "wrench": ("velocity", "acceleration", "wrench"),
    "body-rates": ("velocity", "acceleration", "wrench"),
    "sticks": ("sticks",),
}
_INTERFACES = {
    "single-integrator": ("velocity",),
    "double-integrator": ("velocity", "acceleration"),
    "quadrotor": tuple(_TAKEN),
}
_ROTORS = ("mass_scale", "thrust_scale", "rate_gain_scale")
_NOISES = ("position_noise_m", "velocity_noise_m_s", "attitude_noise_rad", "rate_noise_rad_s")
_LONGEST_S = 9.0  # commands are kept so long, besides the delay of measurements, to predict with
_LIMITS = {
    "max_speed_m_s": ("single-integrator", "double-integrator"),
    **dict.fromkeys(("max_acceleration_m_s2", "max_jerk_m_s3", "actuation_delay_s"), ("double-integrator",)),
}


def refusal(scenario: Scenario, vehicle: Vehicle, others: Mapping[str, str] | None = None) -> str | None:
    """Say why a scenario makes no sense, and what would work instead; None where it does.

    Args:
        vehicle: of the scenario, without its deviations.
        others: command of filters of other packages, by name; a filter that is not named is not checked.

    Returns:
        One sentence that begins with the path of a key.
    """
    commands = FILTER_COMMANDS | dict(others or {})
    full = completed(scenario, vehicle)
    checks: tuple[Callable[[], str | None], ...] = (
        lambda: _wrong_interface(full, vehicle),
        lambda: _wrong_deviation(scenario, full, vehicle),
        lambda: _wrong_estimation(scenario, full),
        lambda: _wrong_mission(full, vehicle),
        lambda: _wrong_filters(full, vehicle, commands),
        lambda: _wrong_world(full, vehicle),
        lambda: _wrong_gain(full, vehicle),
        lambda: _same_trials(full, vehicle),
    )
    return next((words for check in checks if (words := check()) is not None), None)


def _wrong_interface(scenario: Scenario, vehicle: Vehicle) -> str | None:
    interface, known = scenario.vehicle.interface, _INTERFACES[vehicle.model]
    if interface not in known:
        others = " or ".join(known)
        return (
            f"`$.vehicle.interface`: {vehicle.name} is a {vehicle.model}, which takes {others}, not "
            f"{interface}; set vehicle.interface={known[-1]}, or fly a quadrotor, as vehicle.type=fastbridge"
        )
    if interface == "sticks" and vehicle.throttle is None:
        return (
            f"`$.vehicle.interface`: {vehicle.name} has no table [throttle], which sticks need; fly "
            "vehicle.type=racer7, or set vehicle.interface=body-rates"
        )
    return None


def _wrong_deviation(given: Scenario, full: Scenario, vehicle: Vehicle) -> str | None:
    table = given.vehicle
    for key, models in _LIMITS.items():
        if getattr(table, key) is not None and vehicle.model not in models:
            return (
                f"`$.vehicle.{key}`: is a limit of a {' or '.join(models)}, and {vehicle.name} is a "
                f"{vehicle.model}; leave it out, or set vehicle.type={models[-1]}"
            )
    if table.autopilot and vehicle.model != "quadrotor":
        return f"`$.vehicle.autopilot`: is for a quadrotor, and {vehicle.name} is none; leave it out"
    if table.autopilot and full.vehicle.interface not in ("velocity", "acceleration"):
        return (
            "`$.vehicle.autopilot`: it follows velocities and accelerations, and the vehicle takes "
            f"{full.vehicle.interface}; leave it out, or set vehicle.interface=velocity"
        )
    if table.autopilot and table.velocity_gain_per_s is not None:
        return (
            "`$.vehicle.velocity_gain_per_s`: an autopilot has none; leave it out, or set "
            "vehicle.autopilot=false"
        )
    rotor = "is for rotors, which {} has not; leave it out, or fly a quadrotor, as vehicle.type=fastbridge"
    if vehicle.model != "quadrotor":
        for name in ("disturbance", "assumed"):
            part = getattr(table, name)
            for key in part.__struct_fields__:
                if _is_set(getattr(part, key)):
                    return f"`$.vehicle.{name}.{key}`: {rotor.format(vehicle.name)}"
        for key in _ROTORS:
            if getattr(table, key) != 1:
                return f"`$.vehicle.{key}`: {rotor.format(vehicle.name)}"
        return None
    own = full.vehicle.disturbance
    if _is_set(table.disturbance.sag_share) and vehicle.throttle is None:
        return (
            f"`$.vehicle.disturbance.sag_share`: needs a table [throttle], which {vehicle.name} has not; "
            "leave it out, or fly vehicle.type=racer7"
        )
    moves = _is_set(own.wind_m_s) or _is_set(own.gust_m_s)
    if moves and not (_is_set(own.linear_drag_n_s_m) or _is_set(own.quadratic_drag_n_s2_m2)):
        return (
            "`$.vehicle.disturbance`: wind and gusts act through drag, but the drag is zero; set "
            "vehicle.disturbance.quadratic_drag_n_s2_m2 too"
        )
    return None


def _wrong_estimation(given: Scenario, full: Scenario) -> str | None:
    known = full.estimation
    if full.vehicle.interface != "sticks":
        loses = known.lost_share > 0 or known.lost_from_s is not None
        if loses and known.stale_s > _LONGEST_S:
            return (
                f"`$.estimation.stale_s`: lost measurements are predicted for at most {_LONGEST_S:g} s, not "
                f"{known.stale_s:g} s; set estimation.stale_s={_LONGEST_S:g}"
            )
        return None
    for key in _NOISES:
        if getattr(given.estimation, key):
            return (
                f"`$.estimation.{key}`: a vehicle by sticks is simulated with exact measurements; leave it "
                "out, or set vehicle.interface=body-rates"
            )
    return None


def _is_set(value: Any) -> bool:
    return any(value) if isinstance(value, tuple) else bool(value)


def _wrong_mission(scenario: Scenario, vehicle: Vehicle) -> str | None:
    mission, world, kind = scenario.mission, scenario.world, scenario.mission.kind
    if kind == "pilot":
        if vehicle.throttle is None:
            return (
                f"`$.mission.kind`: a pilot needs a vehicle with a table [throttle], which {vehicle.name} "
                "has not; fly vehicle.type=racer7, or mission.kind=goal"
            )
        if scenario.vehicle.interface not in ("sticks", "body-rates"):
            return (
                f"`$.mission.kind`: a pilot gives sticks, and the vehicle takes "
                f"{scenario.vehicle.interface}; set vehicle.interface=sticks, or fly mission.kind=goal"
            )
    needed: dict[str, tuple[tuple[str, bool], ...]] = {
        "goal": (("start_m", mission.start_m is not None), ("goal_m", mission.goal_m is not None)),
        "waypoints": (("start_m", mission.start_m is not None), ("waypoints_m", bool(mission.waypoints_m))),
        "hover": (("start_m", mission.start_m is not None),),
        "plan": (("plan", mission.plan is not None),),
        "pilot": (("start_m", mission.start_m is not None or mission.start_box_m is not None),),
    }
    missing = [key for key, has in needed.get(kind, ()) if not has]
    if missing:
        also = " or mission.start_box_m" if kind == "pilot" else ""
        return f"`$.mission.{missing[0]}`: a mission of kind {kind} needs it; set mission.{missing[0]}{also}"
    has_map = world.has_hulls or world.scene is not None
    if kind == "pairs" and not (has_map or mission.bounds_m is not None or mission.pairs_from is not None):
        return (
            "`$.mission.bounds_m`: random pairs need a box to be drawn in; set it, or world.cover or "
            "world.scene, or fly mission.kind=goal"
        )
    if mission.which == "blocked" and not has_map:
        return (
            "`$.mission.which`: no obstacle can block a pair, as there is none; set world.cover or "
            "world.scene, or mission.which=any"
        )
    if mission.planned and world.cover is None and world.scene is None:
        return (
            "`$.mission.planned`: plans are made in a cover or a scene; set world.cover or world.scene, or "
            "mission.planned=false"
        )
    return _wrong_guide(scenario)


def _wrong_guide(scenario: Scenario) -> str | None:
    guide, interface = scenario.mission.controller.guide, scenario.vehicle.interface
    if guide == NO_FILTER:
        return None
    if interface in ("velocity", "sticks"):
        return (
            f"`$.mission.controller.guide`: {guide} changes accelerations, and the vehicle takes "
            f"{interface}; set vehicle.interface=acceleration, or mission.controller.guide=none"
        )
    if scenario.world.scene is None and (guide == "cone-di" or not scenario.world.has_hulls):
        needed = "ellipsoids; set world.scene" if guide == "cone-di" else "obstacles; set world.cover"
        other = ", or mission.controller.guide=safer-splat" if scenario.world.has_hulls else ""
        return (
            f"`$.mission.controller.guide`: {guide} needs {needed}{other}, or mission.controller.guide=none"
        )
    return None


def _wrong_filters(scenario: Scenario, vehicle: Vehicle, commands: Mapping[str, str]) -> str | None:
    names = [name for name in scenario.safety.filters if name in commands]
    ordered = sorted(names, key=lambda name: COMMANDS.index(commands[name]))
    if names != ordered:
        return (
            "`$.safety.filters`: a filter gets the command of the one before, from the outer loop to the "
            f"inner: set safety.filters={','.join(ordered)}"
        )
    interface = scenario.vehicle.interface
    assert interface is not None
    taken = _TAKEN[interface]
    if interface == "body-rates" and vehicle.throttle is not None:
        taken = COMMANDS
    if scenario.mission.kind == "pilot":
        taken = ("sticks",)
    wrong = [name for name in names if commands[name] not in taken]
    if not wrong:
        return None
    name = wrong[0]
    fitting = [other for other, command in FILTER_COMMANDS.items() if command == taken[-1]]
    what = "the mission's pilot gives" if scenario.mission.kind == "pilot" else f"{vehicle.name} takes"
    instead = _interface_for(commands[name], vehicle, scenario)
    return (
        f"`$.safety.filters`: {name} is for commands of {commands[name]}, and {what} {' or '.join(taken)}; "
        f"fly {' or '.join(fitting)}{instead}"
    )


def _interface_for(command: str, vehicle: Vehicle, scenario: Scenario) -> str:
    """Say how the vehicle could be flown by a filter of a command."""
    if scenario.mission.kind == "pilot":
        return ", or another mission, as mission.kind=goal"
    if command == "sticks":
        if vehicle.throttle is None:
            return ", or a vehicle with a table [throttle], as vehicle.type=racer7"
        return ", or set vehicle.interface=sticks"
    if command not in _INTERFACES[vehicle.model]:
        return ", or a quadrotor, as vehicle.type=fastbridge"
    return f", or set vehicle.interface={command}"


def _wrong_world(scenario: Scenario, vehicle: Vehicle) -> str | None:
    world = scenario.world
    hulls, ellipsoids, fence = world.has_hulls, world.scene is not None, world.fence is not None
    ladder = "acceleration" if vehicle.model == "double-integrator" else "wrench"
    among = "safer-splat" if ladder == "acceleration" else "shield"
    if world.onboard and world.cover is None:
        return "`$.world.onboard`: the image is of a cover; set world.cover, or world.onboard=false"
    if world.onboard and not scenario.safety.filters:
        return "`$.world.onboard`: filters read the image, and there is none; set world.onboard=false"
    if words := _wrong_tiles(scenario, vehicle):
        return words
    for name in scenario.safety.filters:
        where = f"`$.safety.filters`: {name}"
        if name == "polytope-cbf" and not hulls:
            other = "" if vehicle.model == "single-integrator" else ", or fly cone-di in a scene"
            return f"{where} needs hulls; set world.cover or world.walls{other}"
        if name == "cone-di" and not ellipsoids:
            other = f", or fly {among} among the hulls" if hulls else ""
            return f"{where} needs ellipsoids; set world.scene{other}"
        if name in ("safer-splat", "cone-ecbf", "cone-backup") and not (ellipsoids or hulls):
            return f"{where} needs ellipsoids or hulls; set world.scene or world.cover"
        if name == "shield" and not world.is_static:
            return f"{where} needs static obstacles; set world.cover, world.scene, world.walls or world.fence"
        if name == "geofence" and not (fence or world.cover is not None):
            return f"{where} needs a region to stay in; set world.fence.box_m or world.cover"
        if name == "backup-qp" and not fence:
            other = ", or fly geofence, which keeps out of a cover" if world.cover is not None else ""
            return f"{where} needs a box or faces; set world.fence.box_m{other}"
        if words := _wrong_shield(scenario, name):
            return words
    return None


def _wrong_tiles(scenario: Scenario, vehicle: Vehicle) -> str | None:
    world, where = scenario.world, "`$.world.tiles`:"
    if world.tiles is None:
        unused = world.tile_load_s > 0
        return "`$.world.tile_load_s`: there are no tiles; set world.tiles" if unused else None
    if world.cover is None:
        return f"{where} tiles are of a cover, against which flights are judged; set world.cover"
    if world.has_boxes:
        return f"{where} tiles lack walls and unseen space; leave out world.walls and world.seen"
    if list(scenario.safety.filters) != ["polytope-cbf"] or scenario.mission.controller.guide != "none":
        return f"{where} only polytope-cbf reads tiles; set safety.filters=polytope-cbf and no guide"
    if world.tile_load_s > 0 and vehicle.model != "single-integrator":
        return (
            "`$.world.tile_load_s`: a vehicle that lags is filtered at several points per tick, so loading "
            "is not simulated; set vehicle.type=single-integrator, or world.tile_load_s=0"
        )
    return None


def _wrong_shield(scenario: Scenario, name: str) -> str | None:
    options: Any = scenario.safety.parameters(name)
    if not isinstance(options, ShieldParameters) or not getattr(options, "shield", True):
        return None
    world, against = scenario.world, options.shield_map
    others = world.has_hulls or world.fence is not None
    if against != "hulls" and world.scene is None:
        return (
            f"`$.safety.{name}.shield_map`: {against} needs world.scene; set it, or "
            f"safety.{name}.shield_map=hulls"
        )
    if against != "ellipsoids" and not others:
        return (
            f"`$.safety.{name}.shield_map`: {against} needs world.cover; set it, or "
            f"safety.{name}.shield_map=ellipsoids"
        )
    return None


def _wrong_gain(scenario: Scenario, vehicle: Vehicle) -> str | None:
    mission, limit = scenario.mission, scenario.vehicle.max_speed_m_s
    if vehicle.model == "quadrotor":
        return None
    if limit is not None and mission.speed_m_s is not None and mission.speed_m_s > limit:
        return (
            f"`$.mission.speed_m_s`: {vehicle.name} flies at most {limit:g} m/s; set it to that, or raise "
            "vehicle.max_speed_m_s"
        )
    rules = scenario.rules
    ticks = max(rules.controller_ticks, rules.filter_ticks)
    most = (2 if vehicle.model == "single-integrator" else 1) / (rules.dt_s * ticks)
    gain = mission.controller.gain_per_s
    if gain > most * (1 + 1e-12):
        return (
            f"`$.mission.controller.gain_per_s`: {gain:g} is unstable with "
            f"rules.dt_s={rules.dt_s:g}{f', held for {ticks} ticks' if ticks > 1 else ''}; set it to at most "
            f"{most:g}"
        )
    return None


def _same_trials(scenario: Scenario, vehicle: Vehicle) -> str | None:
    trials = scenario.rules.trials
    if trials is None or trials == 1 or is_random(scenario, vehicle):
        return None
    pilot = "a random pilot or start_box_m" if scenario.mission.kind == "pilot" else "mission.kind=pairs"
    gusts = "vehicle.disturbance.gust_m_s, " if vehicle.model == "quadrotor" else ""
    return (
        f"`$.rules.trials`: all {trials} flights would be the same, as nothing in them is random; set "
        f"rules.trials=1, or randomise: {pilot}, estimation.position_noise_m, estimation.lost_share, "
        f"{gusts}or moving obstacles drawn from ranges"
    )


def is_random(scenario: Scenario, vehicle: Vehicle) -> bool:
    """Whether the trials of a scenario can differ."""
    full = completed(scenario, vehicle)
    mission, known = full.mission, full.estimation
    count = 0 if full.vehicle.interface == "sticks" else 4 if vehicle.model == "quadrotor" else 2
    noise = [getattr(known, key) for key in _NOISES[:count]]
    sees = any(name in TRACKING or name not in FILTER_COMMANDS for name in full.safety.filters)
    return (
        mission.kind == "pairs"
        or mission.start_box_m is not None
        or (mission.kind == "pilot" and mission.pilot.kind in RANDOM_PILOTS)
        or any(noise)
        or known.lost_share > 0
        or _is_set(full.vehicle.disturbance.gust_m_s)
        or (bool(full.world.moving) and sees)
        or any(map(_is_drawn, full.world.moving))
    )


def _is_drawn(obstacle: ObstacleTable) -> bool:
    """Whether anything of an obstacle's motion is drawn for each trial."""
    ranges = [obstacle.acceleration_m_s2]
    moves = obstacle.position_m is not None and any(obstacle.velocity_m_s)
    if not moves:
        ranges += [obstacle.speed_m_s, obstacle.heading_rad]
    if obstacle.position_m is None:
        ranges += [obstacle.azimuth_rad, obstacle.elevation_rad]
    drawn = any(low < high for low, high in map(interval, ranges))
    return drawn or obstacle.either_side or any(obstacle.offset_sigma_m) or any(obstacle.meeting_sigma_m)
