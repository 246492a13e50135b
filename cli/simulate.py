"""`alula simulate`."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from alula.cli import completion, grouped, options
from alula.cli.missions import MAPS, Mission, names_of, scenario_of
from alula.cli.runner import run
from alula.cli.set_values import settings_of
from alula.schemas.errors import CheckError, UsageError

if TYPE_CHECKING:
    from alula.schemas.artifact import Artifact
    from alula.schemas.progress import Progress
    from alula.schemas.provenance import Provenance
    from alula.schemas.run import TrialResult
    from alula.schemas.world import WorldScenario
    from alula.stages.simulation.world.simulate import WorldRun

EXAMPLES = """\b
Examples:
  alula simulate room.cover.npz -o room.run.mcap --trials 100 --set vehicle.radius_m=0.1
  alula simulate loop.plan.npz --map room.cover.npz --scene room.scene.npz -o loop.run.mcap
  alula simulate room.scene.npz -o fast.run.mcap --speed 3 --set safety.cone-backup.horizon_s=2
  alula simulate room.toml -o both.run.mcap --filter dr-acbf,shield --trials 10000
"""


@grouped.command(epilog=EXAMPLES)
@click.argument("source", type=options.input_path())
@click.option("--map", "map_path", type=options.input_path(), help="Cover, tiles or scene to fly in.")
@grouped.option(
    "--key",
    "key_path",
    group="Maps in tiles",
    type=options.input_path(),
    help="Key that must have signed the tiles.",
)
@click.option("--scene", "scene_path", type=options.input_path(), help="Scene, beside a cover.")
@click.option(
    "--vehicle",
    metavar="NAME|FILE",
    help="Built-in vehicle, or vehicle file (.toml).",
    shell_complete=completion.vehicles,
)
@click.option("--pairs-from", "pairs_path", type=options.input_path(), help="Run whose pairs to fly.")
@click.option("--planned", is_flag=True, help="Plan each pair first, for the vehicle and the filters.")
@click.option(
    "--filter",
    "filters",
    metavar="NAME,…",
    help="Safety filters in their order, or none.",
    shell_complete=completion.filters,
)
@click.option("--speed", type=options.FINITE_FLOAT, help="Speed of the mission [m/s].")
@click.option("--trials", type=options.Whole(1), help="Number of flights.")
@options.settings("Set any other value; may be repeated.")
@options.scheduler("Fly on")
@options.output(".run.mcap")
@click.pass_context
def command(
    context: click.Context,
    source: Path,
    map_path: Path | None,
    key_path: Path | None,
    scene_path: Path | None,
    vehicle: str | None,
    pairs_path: Path | None,
    planned: bool,
    filters: str | None,
    speed: float | None,
    trials: int | None,
    settings: tuple[str, ...],
    scheduler: str | None,
    common: options.Common,
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
    from alula.cli.run_files import check_log_name
    from alula.schemas.world import TEXTS

    check_log_name(common.output)
    scenario = scenario_of(
        source,
        map_path=map_path,
        scene_path=scene_path,
        vehicle=vehicle,
        pairs_path=pairs_path,
        planned=planned,
        filters=None if filters is None else names_of(filters),
        speed_m_s=speed,
        trials=trials,
        seed=common.seed if options.is_given(context, "seed") else None,
        given=settings_of(settings, TEXTS),
    )
    _fly(scenario, source, key_path, scheduler, common)


def _fly(
    scenario: WorldScenario,
    source: Path,
    key_path: Path | None,
    scheduler: str | None,
    common: options.Common,
) -> None:
    """Fly all trials, and write log and record."""
    from alula.cli.journal import JournalFile
    from alula.cli.sources import read_tiles_of
    from alula.schemas.journal import TRIALS
    from alula.schemas.run import RUN_SCHEMA, RUN_VERSION
    from alula.stages.simulation.chunks import TrialJournal
    from alula.stages.simulation.world.chunks import FlownChunk
    from alula.stages.simulation.world.simulate import simulate_world

    mission = Mission.of(scenario, source)
    tiles = read_tiles_of(mission.paths, key_path)
    kept = JournalFile(common, TRIALS, partial(TrialJournal, FlownChunk))

    def make(provenance: Provenance, progress: Progress) -> tuple[Any, dict[str, Any]]:
        read = {role: found for role in MAPS if (found := mission.read(role)) is not None}
        note = mission.note_of_map(read["plan"].manifest, provenance.inputs) if "plan" in read else None
        kept.begin(provenance)
        start = time.monotonic()
        journal, watched = kept.kept(progress)
        already = len(journal)
        try:
            flown = simulate_world(
                scenario,
                mission.vehicle,
                **read,
                tiles=tiles,
                pairs=mission.pairs,
                journal=journal,
                jobs=common.jobs,
                scheduler=scheduler,
                progress=watched,
            )
        except UsageError as error:
            is_key = "`$." in str(error)
            raise UsageError(f"{source}: {error}" if is_key else str(error)) from error
        timing = {"wall_s": time.monotonic() - start, "trials_flown": len(flown.trials) - already}
        flown.notes.extend([note] if note is not None else [])
        summary = mission.summary_of(flown, provenance, read.get("cover"))
        return lambda: write_flights(common.output, provenance, flown, summary, timing, read), summary

    with kept.until_written():
        run(common, RUN_SCHEMA, RUN_VERSION, mission.parameters, mission.paths, make, seed=mission.seed)
    kept.remove()
    if not common.dry_run:
        from alula.schemas.run import read_run

        check_trials(common.output, scenario, read_run(common.output).trials)


def write_flights(
    output: Path,
    provenance: Provenance,
    flown: WorldRun,
    summary: dict[str, Any],
    timing: dict[str, Any],
    read: Mapping[str, Artifact],
) -> None:
    """Write the log, and the record beside it.

    Args:
        output: file of the log.
        provenance: of the run.
        flown: all trials.
        summary: of them.
        timing: measured times by name [s].
        read: maps by role.

    Raises:
        OutputError: a file cannot be written.
    """
    from alula.cli.run_files import write_run
    from alula.schemas.run import RunRecord
    from alula.stages.runlog.world import write_world_log
    from alula.stages.simulation.world.summary import world_guarantee, world_timing, world_words

    scenario = flown.scenario
    frame = next((one.manifest.frame for one in read.values()), "world")
    record = RunRecord.of(
        provenance,
        name=scenario.name,
        filter=" + ".join(scenario.safety.filters) or "none",
        vehicle=world_words(scenario, flown.vehicle),
        trials=flown.trials,
        summary=summary,
        guarantee=world_guarantee(flown, read.get("cover"), provenance.inputs),
    )
    interface = scenario.vehicle.interface
    assert interface is not None
    guide = scenario.mission.controller.guide
    write_run(
        output,
        record,
        timing | world_timing(flown),
        lambda log: write_world_log(
            log,
            record,
            flown.flights,
            frame,
            dt_s=scenario.rules.dt_s,
            interface=interface,
            filters=[*([guide] if guide != "none" else []), *scenario.safety.filters],
            radii_m=[one.radius_m for one in scenario.world.moving],
            radius_m=flown.world.radius_m,
            hulls=flown.world.hulls,
            scene=read.get("scene"),
            sigma=flown.world.sigma,
            faces=flown.world.faces,
        ),
    )


def check_trials(name: Path | str, scenario: WorldScenario, trials: list[TrialResult]) -> None:
    """Refuse flights behind filters that touched what does not move, and plans that were not flown.

    Args:
        name: of the run, for the message.
        scenario: that was flown.
        trials: verdicts.

    Raises:
        CheckError: there is one.
    """
    from alula.schemas.run import PLAN_OUTCOMES
    from alula.stages.planning.adherence import complaint
    from alula.stages.simulation.world.certificate import uncertified_words
    from alula.stages.simulation.world.judge import hits_static, static_clearance
    from alula.stages.simulation.world.summary import good_outcomes

    hits = [trial for trial in trials if hits_static(trial)]
    if hits and scenario.safety.filters:
        deepest = min(hits, key=static_clearance)
        start = " ".join(f"{value:.3f}" for value in deepest.start_m)
        beyond = uncertified_words(scenario, hits)
        raise CheckError(
            f"{name}: {len(hits)} of {len(trials)} filtered flights touched a static obstacle or left the "
            f"fence; the deepest is trial {deepest.index} from ({start}), {-static_clearance(deepest):.4g} m"
            + (f"; {beyond}" if beyond else "")
        )
    good = good_outcomes(scenario.mission)
    missed = [trial for trial in trials if trial.plan is not None and trial.outcome not in good]
    if missed:
        first, ends = missed[0], Counter(trial.outcome for trial in missed)
        words = complaint(first.plan) if first.outcome in PLAN_OUTCOMES else None
        words = words or f"the flight of the plan ended as {first.outcome}"
        if len(trials) > 1:
            counts = ", ".join(f"{count} {end}" for end, count in ends.items())
            words = f"{len(missed)} of {len(trials)} plans were not flown as planned: {counts}; " + (
                f"trial {first.index}: {words}"
            )
        raise CheckError(f"{name}: {words}")
