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
  alula plan room.cover.npz -o fast.plan.npz --start "0 0 1" --goal "6 4 1" --via "3 2 1.5" --speed 3""",
)
@click.argument("cover", type=options.input_path())
@options.from_config(PlanConfig)
@options.output(".plan.npz")
def command(common: options.Common, config: PlanConfig, cover: Path) -> None:
    """Find a smooth collision-free trajectory through a cover."""
    from alula.schemas.artifact import Artifact, read_artifact
    from alula.schemas.kinds import COVER, PLAN
    from alula.stages.planning.plan import plan

    def build(progress: Progress) -> Artifact:
        return plan(config, read_artifact(cover, COVER), jobs=common.jobs, progress=progress)

    runner.run_stage(common, PLAN, config, {"cover": cover}, build)
