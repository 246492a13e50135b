"""`alula simulate`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from alula.cli.shell import completion, grouped, options
from alula.cli.shell.runner import run
from alula.cli.shell.set_values import settings_of
from alula.schemas.parameters.flight_defaults import COMPARATORS, FILTERS

if TYPE_CHECKING:
    from alula.schemas.artifacts.provenance import Provenance
    from alula.schemas.progress import Progress

EXAMPLES = """\b
Examples:
  alula simulate room.cover.npz -o room.run.mcap --trials 100 --set vehicle.radius_m=0.1
  alula simulate loop.plan.npz --map room.cover.npz --scene room.scene.npz -o loop.run.mcap
  alula simulate room.scene.npz -o fast.run.mcap --speed 3 --set safety.cone-backup.horizon_s=2
  alula simulate room.toml -o both.run.mcap --filter dr-acbf,shield --trials 10000
"""


@grouped.command(epilog=EXAMPLES)
@click.argument("source", type=options.PATH)
@click.option("--map", type=options.PATH, help="Cover, tiles or scene to fly in.")
@grouped.option(
    "--key", group="Maps in tiles", type=options.PATH, help="Key that must have signed the tiles."
)
@click.option("--scene", type=options.PATH, help="Scene, beside a cover.")
@click.option(
    "--vehicle",
    metavar="NAME|FILE",
    help="Built-in vehicle, or vehicle file (.toml).",
    shell_complete=completion.vehicles,
)
@click.option("--pairs-from", type=options.PATH, help="Run whose pairs to fly.")
@click.option("--planned", is_flag=True, help="Plan each pair first, for the vehicle and the filters.")
@click.option(
    "--filter",
    metavar="NAME,…",
    help=f"Safety filters in their order, or none: {', '.join(FILTERS)}. "
    f"For research, to compare with these: {', '.join(COMPARATORS)}.",
    shell_complete=completion.filters,
)
@click.option("--speed", "speed_m_s", type=options.FINITE_FLOAT, help="Speed of the mission [m/s].")
@click.option("--trials", type=options.Whole(1), help="Number of flights.")
@options.settings("Set any other value; may be repeated.")
@options.scheduler("Fly on")
@options.output(".run.mcap")
@click.pass_context
def command(
    context: click.Context, /, source: Path, settings: tuple[str, ...], common: options.Common, **given: Any
) -> None:
    """Fly missions through a world behind safety filters, and judge them.

    SOURCE is a scenario (.toml), which says everything; a cover, tiles or a scene, in which random start-goal
    pairs are flown; or a plan, flown in the --map. Options replace values of the scenario. Without one, a
    point moved by velocities flies behind polytope-cbf in a cover, a quadrotor behind cone-backup in a
    scene; other filters bring the vehicle that they are made for. alula scenario --keys lists all that
    --set can set.

    A pair is flown straight at its goal, and filters see no way around an obstacle: among walls most flights
    end in front of one, unless they are --planned. R.run.json beside R.run.mcap has the summary and measured
    times. An interrupted run leaves OUTPUT.journal; the same command continues from it. Exit code 4: a
    filtered flight touched what does not move, or a plan, also one of --planned, was not flown as planned to
    its goal. Exit code 5: no pair is clear, or none can be planned; single pairs without a plan are left out
    and named.
    """
    from alula.cli.shell.journal import JournalFile
    from alula.cli.shell.run_files import check_log_name
    from alula.cli.verbs.runs import check_trials
    from alula.cli.verbs.simulate import simulate
    from alula.schemas.artifacts.journal import TRIALS
    from alula.schemas.log.run import RUN_SCHEMA, RUN_VERSION, read_run
    from alula.schemas.scenarios.scenario import TEXTS
    from alula.stages.simulation.chunks import TrialJournal

    check_log_name(common.output)
    flights = simulate.step(
        source,
        **given,
        seed=common.seed if options.is_given(context, "seed") else None,
        settings=settings_of(settings, TEXTS),
        jobs=common.jobs,
    )
    mission = flights.mission
    kept = JournalFile(common, TRIALS, TrialJournal)

    def make(provenance: Provenance, progress: Progress) -> tuple[Any, dict[str, Any]]:
        kept.begin(provenance)
        flown = flights.make(progress, provenance, kept.kept)
        return lambda: flown.write(common.output, provenance), flown.summary

    with kept.until_written():
        run(common, RUN_SCHEMA, RUN_VERSION, mission.parameters, mission.paths, make, seed=mission.seed)
    kept.remove()
    if not common.dry_run:
        check_trials(common.output, mission.scenario, read_run(common.output).trials)
