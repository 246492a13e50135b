"""`alula plan`."""

from __future__ import annotations

import dataclasses
from collections.abc import Container, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from alula.cli import grouped, options, runner
from alula.schemas.configs.plan import PlanConfig
from alula.schemas.progress import Progress

if TYPE_CHECKING:
    from alula.schemas.artifact import Artifact
    from alula.schemas.mission import Mission
    from alula.schemas.vehicle import Vehicle


@grouped.command(
    "plan",
    epilog="""Examples:

\b
  alula plan room.cover.npz --free-points 6
  alula plan room.cover.npz -o room.plan.npz --start "-1 0 1" --goal "3 2 1.2"
  alula plan room.cover.npz -o fast.plan.npz --start "0 0 1" --goal "6 4 1" --via "3 2 1.5" --speed 3
  alula plan room.cover.npz -o laps.plan.npz --start "0 0 1" --goal "0 0 1" --gate "3 2 1 1 0 0 0.5" --loops 2
  alula plan room.cover.npz -o course.plan.npz --mission course.toml --speed 2
  alula plan room.cover.npz -o small.plan.npz --start "-1 0 1" --goal "3 2 1.2" --vehicle crazyflie21
  alula plan room.scene.npz -o among.plan.npz --start "-1 0 1" --goal "3 2 1.2" --confidence 0.99 --snap
  alula plan room.cover.npz -o seen.plan.npz --start "-1 0 1" --goal "3 2 1.2" --within room.seen.npz""",
)
@click.argument("map_path", metavar="MAP", type=options.input_path())
@grouped.option(
    "--scene",
    "scene_path",
    group="Obstacles of a scene",
    type=options.input_path(),
    help="Scene, beside a cover or onboard map.",
)
@options.vehicle(
    "Built-in vehicle, or vehicle file (.toml), that will fly the plan; default: the quadrotor of FastBridge."
)
@click.option(
    "--mission",
    "mission_path",
    type=options.input_path(),
    help="Waypoints, gates, laps and zones (.toml), in place of --via, --gate, --loops and --yaw.",
)
@grouped.option(
    "--within",
    group="Search",
    type=options.input_path(),
    help="Seen space (.seen.npz) that the flight must stay in.",
)
@grouped.option(
    "--free-points",
    "count",
    group="Search",
    type=options.Whole(1, 1000),
    metavar="N",
    help="Only print N free points, far from one another, to choose start and goal from.",
)
@options.from_config(PlanConfig)
@options.output(".plan.npz", required=False)
@click.pass_context
def command(
    context: click.Context,
    common: options.Common,
    config: PlanConfig,
    map_path: Path,
    scene_path: Path | None,
    vehicle_name: str | None,
    mission_path: Path | None,
    within: Path | None,
    count: int | None,
) -> None:
    """Find a smooth collision-free trajectory through a map.

    It takes minimum time, and stays within the limits of speed, acceleration, thrust, tilt and body rates at
    every instant. Limits that are not given follow from the vehicle, of whose limits 0.8 are used: the rest
    is left to its controller.

    MAP is a cover, a scene or an onboard map (.bin); with --scene the plan keeps away from both. Without a
    path exit code 5 says which radius would pass, and where the narrowest place is.
    """
    from alula.schemas.errors import UsageError
    from alula.schemas.kinds import PLAN
    from alula.schemas.vehicles import vehicle_named

    if config.radius_m is not None and vehicle_name is not None:
        raise UsageError("--radius is the whole distance to keep; leave out --vehicle")
    if config.confidence is not None and options.is_given(context, "sigma"):
        raise UsageError("give --sigma or --confidence, not both")
    paths = _maps(map_path, scene_path) | ({} if within is None else {"within": within})
    vehicle, file = vehicle_named(vehicle_name)
    mission = None if mission_path is None else _mission(context, mission_path)
    if mission is not None:
        start, goal = config.start or mission.start_m, config.goal or mission.goal_m
        config = dataclasses.replace(config, start=start, goal=goal)
    config = resolved(config, vehicle, paths)
    if count is not None:
        _print_free_points(common, config, paths, count)
        return
    if not options.is_given(context, "output"):
        raise UsageError("missing option -o, the file to write; only --free-points writes none")
    if config.start is None or config.goal is None:
        raise UsageError("--start and --goal are needed; alula plan MAP --free-points 6 prints free points")

    check_filter(config, paths)

    def build(progress: Progress) -> Artifact:
        return find_plan(config, _read(paths), vehicle, mission, jobs=common.jobs, progress=progress)

    inputs = paths | file | ({} if mission_path is None else {"mission": mission_path})
    runner.run_stage(common, PLAN, config, inputs, build)


def resolved(config: PlanConfig, vehicle: Vehicle, roles: Container[str]) -> PlanConfig:
    """Complete what follows from the vehicle, the filters and the maps.

    Args:
        config: as given by the user.
        vehicle: that will fly the plan.
        roles: of the maps.

    Raises:
        UsageError: parameters do not go together, or there is no such filter.
    """
    from alula.schemas.errors import UsageError
    from alula.schemas.flight_defaults import filter_in, planned_interface
    from alula.stages.filtering.registry import filter_kind
    from alula.stages.planning.plan import resolve_plan

    is_guided = vehicle.model == "quadrotor" and not config.straight and "image" not in roles
    if config.filter is None and is_guided:
        config = dataclasses.replace(config, filter=filter_in(roles))
    if config.interface is None:
        names = [name.strip() for name in (config.filter or "").split(",") if name.strip()]
        try:
            interface = planned_interface(names, filter_kind, roles)
        except UsageError as error:
            raise UsageError(f"--filter {config.filter}: {error}") from error
        config = dataclasses.replace(config, interface=interface)
    return resolve_plan(config, vehicle)


def check_filter(config: PlanConfig, roles: Container[str]) -> None:
    """Refuse filters that the plan cannot be flown behind.

    Args:
        config: of the plan.
        roles: of its maps.

    Raises:
        UsageError: there is one.
    """
    from alula.schemas.errors import UsageError

    if config.filter is not None and config.straight:
        raise UsageError("--straight flies lines as they are, whatever a filter does; leave out --filter")
    if config.filter is not None and "image" in roles:
        raise UsageError("--filter flies the plan in a cover or a scene, not in an onboard map")


def find_plan(
    config: PlanConfig,
    maps: Mapping[str, Any],
    vehicle: Vehicle,
    mission: Mission | None = None,
    *,
    jobs: int = 0,
    progress: Progress | None = None,
) -> Artifact:
    """Find the plan, behind the filters of the configuration if it names some.

    Args:
        config: see `resolved`.
        maps: `cover`, `scene`, `image` and `within`.
        vehicle: that will fly it.
        mission: waypoints, gates and zones.
        jobs: threads; 0 is all processors.
        progress: called with (done, total).

    Raises:
        InfeasibleError: there is no plan.
        UsageError, InputError: parameters and maps do not go together.
    """
    from alula.stages.planning.plan import plan
    from alula.stages.simulation.world.parts import behind_filters

    behind = None if config.filter is None else behind_filters(config, vehicle, **maps, jobs=jobs)
    known: dict[str, Any] = {"mission": mission, "vehicle": vehicle, "behind": behind}
    return plan(config, **maps, **known, jobs=jobs, progress=progress)


def _mission(context: click.Context, path: Path) -> Mission:
    from alula.schemas.errors import UsageError
    from alula.schemas.mission import read_mission

    for name in ("via", "gate", "loops", "yaw"):
        if options.is_given(context, name):
            raise UsageError(f"--{name} and --mission: the file says this; give one of the two")
    return read_mission(path)


def _maps(map_path: Path, scene_path: Path | None) -> dict[str, Path]:
    """Paths of the maps by role: cover, scene or image."""
    from alula.cli.sources import map_role
    from alula.schemas.errors import UsageError
    from alula.stages.compression.onboard.image import is_map

    role = "image" if map_path.is_file() and is_map(_first_bytes(map_path)) else map_role(map_path)
    if role == "scene" and scene_path is not None:
        raise UsageError(f"{map_path} is a scene; --scene is for covers and onboard maps")
    return {role: map_path} | ({} if scene_path is None else {"scene": scene_path})


def _first_bytes(path: Path) -> bytes:
    from alula.schemas.errors import InputError

    try:
        with path.open("rb") as file:
            return file.read(4)
    except OSError as error:
        raise InputError(f"{path}: cannot read: {error.strerror}") from error


def _read(paths: dict[str, Path]) -> dict[str, Any]:
    """The maps by role."""
    from alula.schemas.kinds import COVER, SCENE, SEEN
    from alula.schemas.parts_join import read_whole

    kinds = {"cover": COVER, "scene": SCENE, "within": SEEN}
    return {
        role: path.read_bytes() if role == "image" else read_whole(path, kinds[role])
        for role, path in paths.items()
    }


def _print_free_points(
    common: options.Common, config: PlanConfig, paths: dict[str, Path], count: int
) -> None:
    """Print free points on stdout, a line each, or as JSON."""
    from alula.cli.present import echo, print_json
    from alula.stages.planning.endpoints import free_points
    from alula.stages.planning.space import plan_space

    space = plan_space(config, **_read(paths), jobs=common.jobs)
    points = free_points(config, space, count, seed=common.seed).tolist()
    if common.json:
        print_json({"points_m": points, "radius_m": space.keep_m, "frame": space.frame})
        return
    for point in points:
        echo(" ".join(f"{x:g}" for x in point))
