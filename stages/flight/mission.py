"""Parts of a real flight, built from its artifacts: obstacles, filter, commander, geofence and checks."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.manifest import map_origin
from alula.schemas.artifacts.tiles import TileFiles
from alula.schemas.decimals import at_least, exact
from alula.schemas.errors import LinkError, UsageError
from alula.schemas.parameters.configs.fly import FlyConfig
from alula.schemas.parameters.configs.plan import BEYOND_MAP
from alula.schemas.parameters.filter_options import FILTERS, TABLES
from alula.schemas.parameters.flight_defaults import IN_A_COVER, NO_FILTER
from alula.schemas.scenarios.scenario import Scenario
from alula.schemas.scenarios.tables import (
    ControllerTable,
    MissionTable,
    RulesTable,
    SafetyTable,
    VehicleTable,
    WorldTable,
)
from alula.schemas.scenarios.vehicle import Vehicle
from alula.schemas.scenarios.vehicles import PLAN_SPEED_FACTOR
from alula.stages.compression.level import (
    level_of,
    level_words,
    map_words,
    obstacles_words,
    omissions,
    without,
)
from alula.stages.filtering.ellipsoid_filters import keeps_from_hulls
from alula.stages.filtering.polytope_cbf import without_filter
from alula.stages.filtering.registry import complete_parameters
from alula.stages.flight.commanders.native import INTERFACES, FlightCommander
from alula.stages.flight.conditions import guard_of, limits_of, needs_of
from alula.stages.flight.loop.control_loop import LoopOptions
from alula.stages.flight.loop.departures import departures_of
from alula.stages.flight.loop.fence_guard import FenceGuard
from alula.stages.flight.loop.plan_clock import PlanClock
from alula.stages.flight.loop.preflight import Needs
from alula.stages.flight.loop.supervisor import SupervisorLimits
from alula.stages.planning.adherence import PlanJudge, require_fit, require_room, via_tolerance
from alula.stages.planning.curve_certificate import Certificate, certify_curve
from alula.stages.planning.joins import require_motion
from alula.stages.planning.limits import beyond_followed
from alula.stages.planning.mapped import Mapped
from alula.stages.planning.plan_samples import curve_of, sample_plan
from alula.stages.planning.space import scene_map
from alula.stages.planning.unseen import is_seen
from alula.stages.vehicles.bodies import quadrotor
from alula.stages.vehicles.fence import KeepOut, fence
from alula.stages.vehicles.setpoints import AccelerationSetpoint, RatesSetpoint, Setpoint, VelocitySetpoint
from alula.stages.vehicles.velocity_lag import filter_lags_s, max_speed_m_s, needed_deceleration_m_s2
from alula.stages.world.filters import flown_filter
from alula.stages.world.vehicle import catch_up_m_s
from alula.stages.world.world import World, make_world

Obstacles = list[tuple[str, _core.PolytopeSet | _core.EllipsoidSet]]

_ROOM_M = 2.0  # between the plan's box and the default fence
_DISTURBANCE_S = 0.1  # time constant with which wind and other disturbances are estimated
_RESPONSE_S = 0.2  # the same from the response to velocities and accelerations, which is known less well
_RESPONSE_ROOM_M_S2 = 0.3  # that such a response may differ from the model by, for noise alone
_MAX_DISTURBANCE_M_S2 = 4.0  # beyond it the model counts as wrong
_EXTRA_TIME_S = 10.0  # added to three durations of the plan
_CARRYING_S = 600.0  # maximum time of checks with moves by hand


@dataclass(frozen=True, slots=True)
class PlannedFlight:
    """Plan, vehicle and map of a real flight.

    Attributes:
        world: what `simulate` builds for the same vehicle, maps and filter.
        is_splat: a filter of the whole quadrotor flies, among the ellipsoids of the scene if there is one;
            else one of velocities among the hulls of the cover.
        start: first point of the plan, shape (3,), world frame [m].
        sees_hulls: whether the filter keeps from the hulls.
        fence: volume to fly in, world frame.
        is_clear: whether the plan keeps the vehicle's radius from the map, and how this was found, in words;
            true also for a plan that is flown although it is not proven.
        along: compares the flight with the plan.
    """

    config: FlyConfig
    plan: Artifact
    cover: Artifact | None
    world: World
    is_splat: bool
    curve: _core.ReferenceCurve
    start: FloatArray
    sees_hulls: bool
    fence: _core.Fence
    is_clear: tuple[bool, str]
    along: PlanJudge
    notes: list[str]

    @property
    def map(self) -> Artifact:
        """The artifact whose obstacles the filter uses."""
        scene = self.world.static.scene
        found = scene if self.is_splat and scene is not None else self.cover
        assert found is not None
        return found

    @property
    def obstacles(self) -> Obstacles:
        """All obstacles of the map by name, for checks and verdict, world frame."""
        world = self.world.static
        named = (("a hull", world.polytopes), ("an ellipsoid", world.ellipsoids))
        return [(name, each) for name, each in named if each is not None]

    @property
    def map_words(self) -> str:
        """The obstacles with their level, and what this leaves out."""
        world = self.world.static
        return map_words(self.cover, world.scene, self.config.sigma, is_within=world.seen is not None)

    @property
    def goal(self) -> FloatArray:
        """End of the plan, shape (3,), world frame [m]."""
        end: FloatArray = self.curve.at(np.array([self.curve.duration_s]))[0, :3]
        return end


def resolve_fly(
    config: FlyConfig,
    plan: Artifact,
    vehicle: Vehicle,
    *,
    is_splat: bool,
    has_scene: bool = True,
    has_cover: bool = False,
) -> FlyConfig:
    """Complete a configuration with values of the plan and the vehicle, and with defaults.

    Raises:
        UsageError: the vehicle has no rotors, or a parameter of the filter is unknown.
    """
    if vehicle.model != "quadrotor":
        raise UsageError(f"{vehicle.name} is a {vehicle.model}; real flights need the file of a quadrotor")
    speed = float(plan.manifest.speed_m_s)  # type: ignore[attr-defined]
    duration = float(plan["time"][-1])
    points = sample_plan(plan, 0.02)
    low, high = points.min(axis=0) - _ROOM_M, points.max(axis=0) + _ROOM_M
    parameters = dict(config.filter_parameters)
    if is_splat:
        parameters = complete_parameters(
            config.filter, parameters, has_ellipsoids=has_scene, has_hulls=has_cover
        )
    elif parameters and config.filter in ("none", "polytope-cbf"):
        raise UsageError(f"--set: {config.filter} takes no parameters; polytope-cbf has --beta and --kappa")
    limit = config.speed_m_s or PLAN_SPEED_FACTOR * speed
    return dataclasses.replace(
        config,
        speed_m_s=limit,
        velocity_lag_s=config.velocity_lag_s
        if config.velocity_lag_s is not None
        else filter_lags_s(vehicle.following, limit),
        fence=config.fence or (*low.tolist(), *high.tolist()),
        catch_up_m_s=catch_up_m_s(vehicle, speed, config.catch_up_m_s),
        max_time_s=config.max_time_s or 3 * duration + _EXTRA_TIME_S,
        filter_parameters=parameters,
    )


def _lags_s(config: FlyConfig) -> tuple[float, float, float]:
    """Lags along x, y, z of a complete configuration [s]."""
    lag = config.velocity_lag_s
    assert lag is not None
    return lag if isinstance(lag, tuple) else (lag, lag, lag)


def _require_deceleration(config: FlyConfig, vehicle: Vehicle, *, is_given: bool) -> None:
    """Refuse a speed from which the vehicle cannot decelerate as the filter requires.

    A lag that was given replaces the vehicle's; it is compared only with a deceleration of the file.
    """
    if config.filter != "polytope-cbf" or (is_given and vehicle.velocities is None):
        return
    assert config.speed_m_s is not None
    following, speed = vehicle.following, config.speed_m_s
    lag, most = _lags_s(config)[0], following.deceleration_m_s2
    needed = needed_deceleration_m_s2(speed, lag, config.beta)
    if needed <= most:
        return
    fastest = most * (1 / config.beta + lag) if is_given else max_speed_m_s(following, config.beta)
    raise UsageError(
        f"at {speed:g} m/s the filter needs a deceleration of {needed:.2f} m/s^2, and {vehicle.name} "
        f"sustains {most:g}; the margin can be kept up to --speed {at_least(fastest)}"
    )


def _beyond_identified(config: FlyConfig, vehicle: Vehicle) -> list[str]:
    """A note if the speed is above all at which the vehicle's lag was measured."""
    measured = () if vehicle.identified is None else vehicle.identified.speeds_m_s
    assert config.speed_m_s is not None
    if not measured or config.speed_m_s <= max(measured):
        return []
    return [
        f"the lag at {config.speed_m_s:g} m/s is extrapolated: it was measured up to {max(measured):g} m/s"
    ]


def _swinging(vehicle: Vehicle) -> list[str]:
    """A note if the vehicle file turns attitudes faster than the rate loop follows."""
    axes = vehicle.axes_beyond_rate_loop()
    if not axes:
        return []
    return [
        f"tracking.rate_n_m_s is faster than the rate loop of {vehicle.name} about {', '.join(axes)}: "
        "attitudes may swing; leave it and tracking.attitude_n_m out of the file for gains that fit"
    ]


def make_mission(
    config: FlyConfig,
    plan: Artifact,
    vehicle: Vehicle,
    *,
    cover: Artifact | None,
    scene: Artifact | None,
    is_splat: bool,
    tiles: TileFiles | None = None,
    within: Artifact | None = None,
    jobs: int = 0,
) -> PlannedFlight:
    """Build a mission from its artifacts, and prove again that the plan is clear of the map.

    The proof holds in continuous time, against hulls and against ellipsoids (`certify_curve`).

    Args:
        cover: map of hulls, if there is one.
        scene: map of ellipsoids, if there is one.
        is_splat: a filter of the whole quadrotor flies, else one of velocities among the hulls.
        tiles: the cover in tiles, which `polytope-cbf` then reads, two at a time.
        within: seen space to stay in, beside a cover; unseen space counts like hulls.

    Raises:
        UsageError: a parameter is invalid.
        InputError, ArtifactError: the artifacts do not match each other.
    """
    require_motion(plan)
    has_lag = config.velocity_lag_s is not None
    has_maps = {"has_scene": scene is not None, "has_cover": cover is not None}
    config = resolve_fly(config, plan, vehicle, is_splat=is_splat, **has_maps)
    if not is_splat:
        _require_deceleration(config, vehicle, is_given=has_lag)
    if not is_splat and config.fence_map and cover is None:
        raise UsageError("--fence-map needs a cover")
    is_unproven = not plan.manifest.is_proven  # type: ignore[attr-defined]
    if is_unproven and not config.allow_blocked:
        raise UsageError(
            "the plan says that it is not proven to be clear of the map; plan without --straight, or fly it "
            "behind the filter alone with --allow-blocked"
        )
    if is_unproven and config.filter == "none":
        raise UsageError("a plan that is not proven to be clear of the map is flown behind a filter only")
    radius = vehicle.body.radius_m
    proofs: list[tuple[bool, str]] = []
    if tiles is not None and (config.filter != "polytope-cbf" or within is not None):
        raise UsageError("only polytope-cbf reads tiles, which lack unseen space: leave out --within")
    if within is not None and cover is None:
        raise UsageError("--within needs a cover: its filter keeps from hulls and unseen space alike")
    assert config.speed_m_s is not None
    assert config.fence is not None
    low, high = config.fence[:3], config.fence[3:]
    roles = {"cover": cover, "scene": scene, "seen": within, "tiles": tiles, "plan": plan}
    built = make_world(
        _scenario(
            config, vehicle, {role for role, each in roles.items() if each is not None}, is_splat=is_splat
        ),
        vehicle,
        cover=cover,
        scene=scene,
        seen=within,
        plan=plan,
        tiles=tiles,
        ends=np.array([low, high]),
        max_speed_m_s=config.speed_m_s,
        lag_s=_lags_s(config),
        jobs=jobs,
    )
    world = built.static
    time, coefficient = plan["time"], plan["coefficient"]
    if cover is not None and world.polytopes is not None:
        level = level_of(cover)
        what = f"hulls made for {obstacles_words(level)}{without(omissions(level))}"
        what += "" if within is None else ", and from unseen space"
        found = certify_curve(time, coefficient, world.polytopes, radius, jobs=jobs)
        proofs.append(_proof(found, what, radius))
        if within is not None and not is_seen(within, curve_of(plan).at(np.zeros(1))[:, :3]).all():
            proofs.append((False, "the plan begins outside of the space that was seen"))
    if scene is not None:
        one = scene_map(scene, config.sigma, radius)
        found = certify_curve(time, coefficient, one.obstacles, radius, jobs=jobs, extent_m=one.extent_m)
        proofs.append(_proof(found, f"ellipsoids at {level_words(config.sigma)}", radius))
    proofs += _mapped(plan, world.mapped, radius)
    require_fit(plan, vehicle)
    curve = curve_of(plan)
    tolerance = via_tolerance(config.via_tolerance_m, radius)
    sets = [each for each in (world.polytopes, world.ellipsoids) if each is not None]
    along = PlanJudge(plan, sets, radius, tolerance, jobs)
    sees_hulls = not is_splat or keeps_from_hulls(
        config.filter, config.filter_parameters, has_ellipsoids=scene is not None
    )
    if within is not None and not sees_hulls:
        raise UsageError(
            f"--within: {config.filter} keeps from ellipsoids alone here; fly it with the cover alone, or "
            "with --set shield_map=hulls"
        )
    hull_keep, keep = world.keeps_m("hulls"), world.keeps_m("ellipsoids")
    keeps = [hull_keep if sees_hulls else None] * (world.polytopes is not None)
    keeps += [keep if is_splat else None] * (world.ellipsoids is not None)
    notes = require_room(
        along,
        keeps,
        config.filter,
        allow_tight=config.allow_tight,
    )
    if not is_splat and not has_lag:
        notes += _beyond_identified(config, vehicle)
    if RatesSetpoint in _setpoints(built, is_splat=is_splat)[:1]:
        notes += _swinging(vehicle)
    keep_out = KeepOut.of(cover, jobs=jobs) if config.fence_map and cover is not None else None
    return PlannedFlight(
        config=config,
        plan=plan,
        cover=cover,
        world=built,
        is_splat=is_splat,
        curve=curve,
        start=np.array(curve.at(np.zeros(1))[0, :3]),
        sees_hulls=sees_hulls,
        fence=fence(box=(low, high), cover=keep_out),
        is_clear=_clearness(proofs, is_unproven=is_unproven),
        along=along,
        notes=notes,
    )


def _clearness(proofs: list[tuple[bool, str]], *, is_unproven: bool) -> tuple[bool, str]:
    """Whether a plan may be flown by its proofs, and these in words."""
    words = "; ".join(words for _, words in proofs)
    if is_unproven:
        return True, f"{words}; flown behind the filter alone (--allow-blocked)"
    return all(holds for holds, _ in proofs), words


def _proof(found: Certificate, obstacles: str, radius_m: float) -> tuple[bool, str]:
    """Whether a plan is proven clear of obstacles, and that in words."""
    unproven = np.flatnonzero(~found.proven)
    words = f"proven to keep {exact(radius_m)} m from all {obstacles}"
    if not found.holds:
        words = f"piece {unproven[:1]} is not proven to keep {exact(radius_m)} m from {obstacles}"
    return found.holds, words


def _mapped(plan: Artifact, mapped: Mapped | None, radius_m: float) -> list[tuple[bool, str]]:
    """Whether a plan that leaves the mapped box may, and that in words; nothing of one that stays in it."""
    if mapped is None:
        return [(False, "the map has no obstacles, so nothing of it is known")]
    words = mapped.refusal_of_plan(plan, radius_m, BEYOND_MAP)
    if words is not None:
        return [(False, words)]
    if dataclasses.replace(mapped, beyond_m=0.0).refusal_of_plan(plan, radius_m, BEYOND_MAP) is None:
        return []
    return [(True, f"it leaves the mapped box, by at most {exact(mapped.beyond_m)} m (--beyond-map)")]


def _scenario(config: FlyConfig, vehicle: Vehicle, roles: set[str], *, is_splat: bool) -> Scenario:
    """The scenario of a flight: what `simulate` would be given for the same vehicle, maps and filter."""
    named = {role: role for role in roles}
    name, parameters = config.filter, config.filter_parameters
    if name == IN_A_COVER:
        parameters = {"beta": config.beta, "kappa_per_m": config.kappa_per_m, "smoothing": "sound"}
    own: dict[str, Any] = {"others": {name: dict(parameters)}}
    if name in FILTERS:
        own = {TABLES[name].replace("-", "_"): FILTERS[name](**parameters)}
    return Scenario(
        vehicle=VehicleTable(
            interface="body-rates" if is_splat else "velocity",
            autopilot=None if is_splat else True,
            radius_m=vehicle.body.radius_m + config.margin_m,
        ),
        world=WorldTable(
            cover=named.get("cover"),
            scene=named.get("scene"),
            seen=named.get("seen"),
            tiles=named.get("tiles"),
            sigma=config.sigma,
            inflation_m=config.inflation_m,
        ),
        mission=MissionTable(
            kind="plan",
            plan=named.get("plan"),
            beyond_map_m=config.beyond_map_m,
            controller=ControllerTable(catch_up_m_s=config.catch_up_m_s),
        ),
        safety=SafetyTable() if name == NO_FILTER else SafetyTable(filters=(name,), **own),
        rules=RulesTable(dt_s=1 / config.rate_hz),
    )


def flown_filters(mission: PlannedFlight) -> list[_core.SafetyFilter]:
    """Filters of a flight; by velocities one that changes nothing stands for none, and tells the margin.

    Raises:
        UsageError: the radius has no meaning for these hulls.
    """
    world = mission.world
    if world.filters or mission.is_splat:
        return world.filters
    bare = without_filter(
        world.told, {"beta": mission.config.beta, "kappa_per_m": mission.config.kappa_per_m}
    )
    return [flown_filter(bare, world.lag_s, world.max_speed_m_s)]


def wanted_setpoints(mission: PlannedFlight) -> tuple[type[Setpoint], ...]:
    """Kinds of set-points that can carry the filter's output, the best first."""
    return _setpoints(mission.world, is_splat=mission.is_splat)


def _setpoints(world: World, *, is_splat: bool) -> tuple[type[Setpoint], ...]:
    if not is_splat:
        return (VelocitySetpoint,)
    if not world.filters:
        return (RatesSetpoint, AccelerationSetpoint)
    takes_acceleration = world.filters[-1].kind == "acceleration"
    return (AccelerationSetpoint, RatesSetpoint) if takes_acceleration else (RatesSetpoint,)


def make_commander(mission: PlannedFlight, accepts: frozenset[type[Setpoint]]) -> FlightCommander:
    """Build the commander: the flight of `simulate`, with the vehicle, the filter and the controller.

    Raises:
        LinkError: the link accepts no kind of set-point that can carry the filter's output.
    """
    config, world = mission.config, mission.world
    kinds = wanted_setpoints(mission)
    kind = next((kind for kind in kinds if kind in accepts), None)
    if kind is None:
        names = " or ".join(kind.__name__ for kind in kinds)
        raise LinkError(f"the filter {config.filter} needs a link that accepts {names}; this link does not")
    filters = flown_filters(mission)
    body, dt = quadrotor(world.vehicle), 1 / config.rate_hz
    flown = _core.VehicleSpec(body, **world.known | {"interface": INTERFACES[kind]})
    options = _core.FlightOptions(
        dt_s=dt,
        stale_s=config.stale_s,
        has_losses=True,  # the age of a state varies
        disturbance_max_m_s2=_MAX_DISTURBANCE_M_S2,
        disturbance_time_s=_DISTURBANCE_S if kind is RatesSetpoint else 0.0,
        response_time_s=0.0 if kind is RatesSetpoint else _RESPONSE_S,
        response_room_m_s2=_response_room_m_s2(world.vehicle),
        response_max_m_s2=_MAX_DISTURBANCE_M_S2,
    )
    return FlightCommander(
        flight=_core.Flight(flown, options, _core.Mission.given(gain_per_s=config.gain), filters),
        setpoint=kind,
        body=body,
        delay_s=world.vehicle.assumed.delay_s,
        dt_s=dt,
        command=filters[-1].kind if filters else None,
    )


def _response_room_m_s2(vehicle: Vehicle) -> float:
    """Acceleration by which a response may differ from the model: as identified, at least noise [m/s^2]."""
    found = None if vehicle.identified is None else vehicle.identified.residual_m_s2
    return max(found or 0.0, _RESPONSE_ROOM_M_S2)


def make_guard(mission: PlannedFlight, accepts: frozenset[type[Setpoint]]) -> FenceGuard:
    """Build the geofence behind the filter."""
    return guard_of(
        mission.config,
        mission.world.vehicle,
        mission.fence,
        accepts,
        reserve_m=mission.config.fence_reserve_m,
    )


def make_needs(mission: PlannedFlight, setpoints: Iterable[type[Setpoint]]) -> Needs:
    """Requirements of the flight for the pre-flight checks.

    Args:
        setpoints: kinds of set-points; the link must accept one of them.
    """
    config = mission.config
    assert config.speed_m_s is not None
    setpoints = tuple(setpoints)
    return needs_of(
        config,
        mission.world.vehicle,
        setpoints=setpoints,
        ends=(mission.start, mission.goal),
        departures=departures_of(
            mission.plan, config.speed_m_s, mission.world.vehicle.following.horizontal_lag
        ),
        obstacles=mission.obstacles,
        map_origin_m=map_origin(mission.map.manifest),
        map_words=mission.map_words,
        margin_m=config.margin_m,
        fence=mission.fence,
        plan=_plan_verdict(mission, setpoints[0]),
        speed_m_s=config.speed_m_s,
    )


def _plan_verdict(mission: PlannedFlight, setpoint: type[Setpoint]) -> tuple[bool, str]:
    """Whether a plan can be flown by set-points of a kind, and how this was found, in words.

    Behind accelerations that the vehicle follows late it gets faster than planned, and no filter of
    accelerations stops it in time: such a plan is refused. By velocities it only lags.
    """
    holds, words = mission.is_clear
    asked = "" if setpoint is RatesSetpoint else beyond_followed(mission.plan, mission.world.vehicle)
    if not asked:
        return holds, words
    if setpoint is VelocitySetpoint:
        return holds, f"{words}; it {asked}: the vehicle will be late"
    if mission.config.allow_tight:
        return holds, f"{words}; it {asked}, as --allow-tight insists"
    return False, f"it {asked}: plan with --interface acceleration and this --vehicle, or fly by body rates"


def make_options(config: FlyConfig, *, dry_run: bool) -> LoopOptions:
    """Parameters of the control loop."""
    assert config.max_time_s is not None
    limits = limits_of(
        config,
        fallback_s=config.fallback_s,
        flight_s=config.max_time_s,
        checks_s=_CARRYING_S if config.frame_check == "hand" else SupervisorLimits.checks_s,
    )
    return LoopOptions(
        rate_hz=config.rate_hz,
        limits=limits,
        dry_run=dry_run,
        watch_frame=config.frame_check != "none",
        margin_m=config.margin_m,
        velocity_lag_s=max(_lags_s(config)),
        max_speed_m_s=config.speed_m_s or 0.0,
        max_disturbance_m_s2=_MAX_DISTURBANCE_M_S2,
    )


def make_clock(mission: PlannedFlight) -> PlanClock:
    """Build the clock along the plan."""
    return PlanClock(mission.curve, mission.along.waits)


def describe(mission: PlannedFlight) -> str:
    """Describe the vehicle in words, for log and record."""
    vehicle = mission.world.vehicle
    sphere = f"a sphere of radius {exact(vehicle.body.radius_m)} m"
    assert vehicle.body.mass_kg is not None
    return f"{vehicle.name}: a real quadrotor of {exact(vehicle.body.mass_kg)} kg in {sphere}"


def head_facts(mission: PlannedFlight) -> dict[str, Any]:
    """Fields of `FlightHead` that the mission determines."""
    return {
        "name": mission.config.name,
        "filter": mission.config.filter,
        "vehicle": describe(mission),
        "frame": mission.map.manifest.frame,
        "is_splat": mission.is_splat,
        "log_every": max(1, round(mission.config.rate_hz / mission.config.log_rate_hz)),
        "radius_m": mission.world.vehicle.body.radius_m,
    }
