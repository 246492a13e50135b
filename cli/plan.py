"""`alula plan`."""

from __future__ import annotations

from pathlib import Path

import click

from alula.cli import options, runner
from alula.schemas.configs.plan import PlanConfig
from alula.schemas.progress import Progress


@click.command(
    "plan",
    epilog="""Examples:

\b
  alula plan room.cover.npz -o room.plan.npz --start "-1 0 1" --goal "3 2 1.2"
  alula plan room.cover.npz -o fast.plan.npz --start "0 0 1" --goal "6 4 1" --via "3 2 1.5" --speed 3
  alula plan room.cover.npz -o small.plan.npz --start "-1 0 1" --goal "3 2 1.2" --vehicle crazyflie21.toml
  alula plan room.cover.npz -o seen.plan.npz --start "-1 0 1" --goal "3 2 1.2" --within room.seen.npz""",
)
@click.argument("cover", type=options.input_path())
@click.option(
    "--vehicle",
    "vehicle_path",
    type=options.input_path(),
    help="Vehicle (.toml) that will fly the plan; default: the quadrotor of FastBridge.",
)
@click.option(
    "--within", type=options.input_path(), help="Seen space (.seen.npz) that the flight must stay in."
)
@options.from_config(PlanConfig)
@options.output(".plan.npz")
def command(
    common: options.Common, config: PlanConfig, cover: Path, vehicle_path: Path | None, within: Path | None
) -> None:
    """Find a smooth collision-free trajectory through a cover."""
    from alula.schemas.artifact import Artifact, read_artifact
    from alula.schemas.errors import UsageError
    from alula.schemas.kinds import COVER, PLAN, SEEN
    from alula.schemas.vehicle import FASTBRIDGE, read_vehicle
    from alula.stages.planning.plan import plan, resolve_plan

    if config.radius_m is not None and vehicle_path is not None:
        raise UsageError("--radius is the whole distance to keep; leave out --vehicle")
    config = resolve_plan(config, FASTBRIDGE if vehicle_path is None else read_vehicle(vehicle_path))
    paths = {"cover": cover} | ({} if vehicle_path is None else {"vehicle": vehicle_path})

    paths |= {} if within is None else {"within": within}

    def build(progress: Progress) -> Artifact:
        seen = None if within is None else read_artifact(within, SEEN)
        return plan(config, read_artifact(cover, COVER), within=seen, jobs=common.jobs, progress=progress)

    runner.run_stage(common, PLAN, config, paths, build)
