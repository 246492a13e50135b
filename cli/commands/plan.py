"""`alula plan`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from alula.cli.shell import grouped, options
from alula.cli.shell.present import echo, print_json
from alula.schemas.errors import UsageError
from alula.schemas.parameters.configs.plan import PlanConfig


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
  alula plan room.scene.npz -o among.plan.npz --start "-1 0 1" --goal "3 2 1" --sigma 2 --nearest-free
  alula plan room.cover.npz -o seen.plan.npz --start "-1 0 1" --goal "3 2 1.2" --within room.seen.npz""",
)
@click.argument("map_path", metavar="MAP", type=options.PATH)
@grouped.option(
    "--scene",
    "scene",
    group="Obstacles of a scene",
    type=options.PATH,
    help="Scene, beside a cover or onboard map.",
)
@options.vehicle(
    "Built-in vehicle, or vehicle file (.toml), that will fly the plan; default: the quadrotor of FastBridge."
)
@click.option(
    "--mission",
    "mission",
    type=options.PATH,
    help="Waypoints, gates, laps and zones (.toml), in place of --via, --gate, --loops and --yaw.",
)
@grouped.option(
    "--within", group="Search", type=options.PATH, help="Seen space (.seen.npz) that the flight must stay in."
)
@grouped.option(
    "--free-points",
    "count",
    group="Search",
    type=options.Whole(1, 1000),
    metavar="N",
    help="Only print N free points, far from one another, to choose start and goal from.",
)
@options.fields_of(PlanConfig)
@options.output(".plan.npz", required=False)
@click.pass_context
def command(
    context: click.Context,
    common: options.Common,
    fields: dict[str, Any],
    map_path: Path,
    scene: Path | None,
    vehicle_name: str | None,
    mission: Path | None,
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
    from alula.cli.verbs.plan import PlanInputs, plan
    from alula.cli.verbs.verb import run_step

    if count is not None:
        given = PlanInputs.of(map_path, scene, vehicle_name, mission, within, fields)
        found, space = given.free_points(count, seed=common.seed, jobs=common.jobs)
        if common.json:
            print_json({"points_m": found.tolist(), "radius_m": space.keep_m, "frame": space.frame})
            return
        for point in found.tolist():
            echo(" ".join(f"{x:g}" for x in point))
        return
    if not options.is_given(context, "output"):
        raise UsageError("missing option -o, the file to write; only --free-points writes none")
    known: dict[str, Any] = {"scene": scene, "vehicle": vehicle_name, "mission": mission, "within": within}
    run_step(common, plan.step(map_path, **known, jobs=common.jobs, **fields))
