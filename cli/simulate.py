"""`alula simulate`."""

from __future__ import annotations

import time
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from alula.cli import completion, grouped, options
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
    filtered flight touched what does not move, or a plan was not flown as planned.
    """
    from alula.cli.run_files import check_log_name
    from alula.schemas.world import TEXTS, changed, read_world
    from alula.schemas.world_source import source_tree, vehicle_table

    check_log_name(common.output)
    names = None if filters is None else _names_of(filters)
    changes: dict[str, Any] = {}
    if planned:
        changes["mission.planned"] = True
    if pairs_path is not None:
        changes["mission.pairs_from"] = _relative(pairs_path, source)
    if trials is not None:
        changes["rules.trials"] = trials
    if options.is_given(context, "seed"):
        changes["rules.seed"] = common.seed
    given = settings_of(settings, TEXTS)
    _check_paths(given, names)
    scenario: WorldScenario
    if source.suffix == ".toml":
        from alula.cli.sources import map_files

        if map_path is not None:
            changes |= {
                f"world.{role}": _relative(path, source) for role, path in map_files(map_path).items()
            }
        if scene_path is not None:
            changes["world.scene"] = _relative(scene_path, source)
        if vehicle is not None:
            key, name = next(iter(vehicle_table(vehicle).items()))
            changes[f"vehicle.{key}"] = name if key == "type" else _relative(Path(name), source)
        if names is not None:
            changes["safety.filters"] = names
        if speed is not None:
            changes["mission.speed_m_s"] = speed
        scenario = read_world(source, changes | given)
    else:
        from alula.cli.sources import source_files
        from alula.stages.filtering.registry import filter_kind

        files = source_files(source, map_path, scene_path)
        chosen = given.pop("safety.filters", names)
        chosen = [chosen] if isinstance(chosen, str) else chosen
        tree = source_tree(files, filter_kind, filters=chosen, vehicle=vehicle, speed_m_s=speed)
        scenario = changed(tree, str(source), changes | given)
    _fly(scenario, source, key_path, scheduler, common)


def _names_of(filters: str) -> list[str]:
    """Names of filters in their order; only the single name `none` flies without any."""
    names = [name.strip() for name in filters.split(",")]
    if "" in names or ("none" in names and names != ["none"]):
        raise UsageError(f"--filter needs names of filters, or only none, not {filters!r}")
    return names


def _relative(path: Path, source: Path) -> str:
    """Name of a file as the scenario names it, relative to its folder; without a scenario, as it is."""
    inside = source.suffix == ".toml" and source.parent != Path()
    return str(path.resolve()) if inside and not path.is_absolute() else str(path)


def _check_paths(given: Mapping[str, Any], filters: list[str] | None) -> None:
    """Refuse names without a table, such as those of filters' parameters, and say their whole paths."""
    from alula.schemas.world_text import keys_of

    for path in given:
        if "." in path or path == "name":
            continue
        likely = [key.path for key in keys_of() if key.path.rpartition(".")[2] == path]
        own = [key for key in likely if key.split(".")[1] in (filters or ())] or likely
        hint = f"is it {' or '.join(own[:3])}?" if own else "alula scenario --keys lists all"
        raise UsageError(f"--set {path}: needs the whole path of a key; {hint}")


def _fly(
    scenario: WorldScenario,
    source: Path,
    key_path: Path | None,
    scheduler: str | None,
    common: options.Common,
) -> None:
    """Fly all trials, and write log and record."""
    import msgspec

    from alula.cli.journal import JournalFile
    from alula.cli.sources import read_tiles_of
    from alula.schemas.journal import TRIALS
    from alula.schemas.kinds import COVER, PLAN, SCENE, SEEN
    from alula.schemas.parts_join import read_whole
    from alula.schemas.run import RUN_SCHEMA, RUN_VERSION, read_run
    from alula.schemas.vehicle import contents
    from alula.schemas.world import FILES
    from alula.schemas.world_defaults import vehicle_of
    from alula.stages.simulation.chunks import TrialJournal
    from alula.stages.simulation.pairs import pairs_flown
    from alula.stages.simulation.world.chunks import FlownChunk
    from alula.stages.simulation.world.simulate import simulate_world
    from alula.stages.simulation.world.summary import world_summary

    folder = source.parent if source.suffix == ".toml" else Path()
    vehicle = vehicle_of(scenario, folder)
    # The content of files is hashed; their names have no influence on results.
    parameters = msgspec.json.decode(msgspec.json.encode(scenario), type=dict[str, Any])
    paths = {"scenario": source} if source.suffix == ".toml" else {}
    for key in FILES:
        table, name = key.split(".")
        if (file := parameters[table].pop(name)) is not None:
            paths[_ROLES.get(key, name)] = folder / file
    tiles = read_tiles_of(paths, key_path)
    pairs = None
    if "pairs" in paths:
        pairs = pairs_flown(read_run(paths["pairs"]).trials, scenario.rules.trials)
    kept = JournalFile(common, TRIALS, partial(TrialJournal, FlownChunk))

    def make(provenance: Provenance, progress: Progress) -> tuple[Any, dict[str, Any]]:
        read = {
            role: read_whole(paths[role], kind)
            for role, kind in (("cover", COVER), ("scene", SCENE), ("seen", SEEN), ("plan", PLAN))
            if role in paths
        }
        kept.begin(provenance)
        start = time.monotonic()
        with kept.kept(progress) as (journal, watched):
            already = len(journal)
            try:
                flown = simulate_world(
                    scenario,
                    vehicle,
                    cover=read.get("cover"),
                    scene=read.get("scene"),
                    seen=read.get("seen"),
                    plan=read.get("plan"),
                    tiles=tiles,
                    pairs=pairs,
                    journal=journal,
                    jobs=common.jobs,
                    scheduler=scheduler,
                    progress=watched,
                )
            except UsageError as error:
                is_key = "`$." in str(error)
                raise UsageError(f"{source}: {error}" if is_key else str(error)) from error
        timing = {"wall_s": time.monotonic() - start, "trials_flown": len(flown.trials) - already}
        summary = world_summary(flown)
        return lambda: _write(common.output, provenance, flown, summary, timing, read), summary

    parameters = {key: value for key, value in parameters.items() if key not in ("schema", "version", "fly")}
    parameters["vehicle_file"] = contents(vehicle)
    # Without filters, those two say how encounters and flights in a fence are measured.
    told = scenario.safety.filters or ("dr-acbf", "geofence")
    safety = parameters["safety"]
    parameters["safety"] = {name: safety[name] for name in ("filters", *told) if name in safety} | {
        name: safety["others"][name] for name in told if name in safety["others"]
    }
    seed = parameters["rules"].pop("seed")
    run(common, RUN_SCHEMA, RUN_VERSION, parameters, paths, make, seed=seed)
    kept.remove()
    if not common.dry_run:
        _check(common.output, scenario)


_ROLES = {"vehicle.file": "vehicle", "mission.pairs_from": "pairs"}  # of files whose keys are named otherwise


def _write(
    output: Path,
    provenance: Provenance,
    flown: WorldRun,
    summary: dict[str, Any],
    timing: dict[str, Any],
    read: Mapping[str, Artifact],
) -> None:
    """Write the log, and the record beside it."""
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
        guarantee=world_guarantee(flown, read.get("cover")),
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


def _check(output: Path, scenario: WorldScenario) -> None:
    """Raise CheckError when filtered flights touched what does not move, or a plan was not flown."""
    from alula.schemas.run import PLAN_OUTCOMES, read_run
    from alula.stages.planning.adherence import complaint
    from alula.stages.simulation.world.judge import hits_static, static_clearance

    trials: list[TrialResult] = read_run(output).trials
    hits = [trial for trial in trials if hits_static(trial)]
    if hits and scenario.safety.filters:
        deepest = min(hits, key=static_clearance)
        start = " ".join(f"{value:.3f}" for value in deepest.start_m)
        raise CheckError(
            f"{output}: {len(hits)} of {len(trials)} filtered flights touched a static obstacle or left the "
            f"fence; the deepest is trial {deepest.index} from ({start}), {-static_clearance(deepest):.4g} m"
        )
    if scenario.mission.kind == "plan":
        trial = trials[0]
        if trial.outcome != "reached":
            words = complaint(trial.plan) if trial.outcome in PLAN_OUTCOMES else None
            raise CheckError(f"{output}: {words or f'the flight of the plan ended as {trial.outcome}'}")
