"""`alula simulate` for scenarios of version 2.0: any parts together, in one loop."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from alula.cli import options
from alula.cli.runner import run
from alula.schemas.configs.simulate import SimulateConfig
from alula.schemas.errors import CheckError, UsageError

if TYPE_CHECKING:
    from alula.schemas.artifact import Artifact
    from alula.schemas.progress import Progress
    from alula.schemas.provenance import Provenance
    from alula.schemas.world import WorldScenario
    from alula.stages.simulation.world.simulate import WorldRun

_KEYS = {
    "name": "name",
    "filter": "safety.filters",
    "radius_m": "vehicle.radius_m",
    "interface": "vehicle.interface",
    "speed_m_s": "mission.speed_m_s",
    "planned": "mission.planned",
    "bounds": "mission.bounds_m",
    "via_tolerance_m": "mission.via_tolerance_m",
    "allow_tight": "mission.allow_tight",
    "sigma": "world.sigma",
    "confidence": "world.confidence",
    "inflation_m": "world.inflation_m",
    "trials": "rules.trials",
    "dt_s": "rules.dt_s",
    "max_time_s": "rules.max_time_s",
    "log_rate_hz": "rules.log_rate_hz",
}
"""Key of the scenario by field of the configuration, for the options that apply."""
FILES = {
    "cover": "world.cover",
    "scene": "world.scene",
    "vehicle": "vehicle.file",
    "plan": "mission.plan",
    "pairs": "mission.pairs_from",
}
"""Key of the scenario by role of the file."""


def simulate_scenario(
    context: click.Context,
    source: Path,
    files: Mapping[str, Path | None],
    config: SimulateConfig,
    settings: Mapping[str, Any],
    common: options.Common,
) -> None:
    """Fly the trials of a scenario, and write its log and record.

    Args:
        context: tells which options were given.
        source: the scenario.
        files: files of the command line by role, which replace those of the scenario.
        config: of `simulate`.
        settings: paths and values of --set.
        common: the shared options.

    Raises:
        UsageError: an option does not apply, or the scenario is wrong or makes no sense.
        CheckError: a filtered flight touched a static obstacle, or a plan was not flown.
    """
    import msgspec

    from alula.cli.journal import JournalFile
    from alula.schemas.artifact import read_artifact
    from alula.schemas.journal import TRIALS
    from alula.schemas.kinds import COVER, PLAN, SCENE
    from alula.schemas.run import RUN_SCHEMA, RUN_VERSION, read_run
    from alula.schemas.vehicle import contents
    from alula.schemas.world import read_world
    from alula.schemas.world_defaults import vehicle_of
    from alula.stages.simulation.chunks import TrialJournal
    from alula.stages.simulation.pairs import pairs_flown
    from alula.stages.simulation.world.chunks import FlownChunk
    from alula.stages.simulation.world.simulate import simulate_world
    from alula.stages.simulation.world.summary import world_summary

    scenario = read_world(source, _changes(context, source, files, config, settings, common.seed))
    vehicle = vehicle_of(scenario, source.parent)
    paths = {"scenario": source}
    named = {
        "cover": scenario.world.cover,
        "scene": scenario.world.scene,
        "vehicle": scenario.vehicle.file,
        "plan": scenario.mission.plan,
        "pairs": scenario.mission.pairs_from,
    }
    paths |= {role: source.parent / name for role, name in named.items() if name is not None}
    pairs = None
    if "pairs" in paths:
        pairs = pairs_flown(read_run(paths["pairs"]).trials, scenario.rules.trials)
    kept = JournalFile(common, TRIALS, partial(TrialJournal, FlownChunk))

    def make(provenance: Provenance, progress: Progress) -> tuple[Any, dict[str, Any]]:
        read = {
            role: read_artifact(paths[role], kind)
            for role, kind in (("cover", COVER), ("scene", SCENE), ("plan", PLAN))
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
                    plan=read.get("plan"),
                    pairs=pairs,
                    journal=journal,
                    jobs=common.jobs,
                    progress=watched,
                )
            except UsageError as error:
                is_key = "`$." in str(error)
                raise UsageError(f"{source}: {error}" if is_key else str(error)) from error
        timing = {"wall_s": time.monotonic() - start, "trials_flown": len(flown.trials) - already}
        summary = world_summary(flown)
        return lambda: _write(common.output, provenance, flown, summary, timing, read), summary

    # The content of files is hashed; their names have no influence on results.
    parameters = msgspec.json.decode(msgspec.json.encode(scenario), type=dict[str, Any])
    for role in paths.keys() & FILES.keys():
        table, name = FILES[role].split(".")
        parameters[table].pop(name, None)
    parameters = {key: value for key, value in parameters.items() if key not in ("schema", "version", "fly")}
    parameters["vehicle_file"] = contents(vehicle)
    seed = parameters["rules"].pop("seed")
    run(common, RUN_SCHEMA, RUN_VERSION, parameters, paths, make, seed=seed)
    kept.remove()
    if not common.dry_run:
        _check(common.output, scenario)


def _changes(
    context: click.Context,
    source: Path,
    files: Mapping[str, Path | None],
    config: SimulateConfig,
    settings: Mapping[str, Any],
    seed: int,
) -> dict[str, Any]:
    """Keys of the scenario that the command line replaces, with their new values."""
    changes: dict[str, Any] = {}
    for field in dataclasses.fields(config):
        if field.name == "seed" or not options.is_given(context, field.name):
            continue
        if field.name not in _KEYS:
            raise UsageError(
                f"{options.option_of(field)} does not apply to a scenario of version 2; use --set, and "
                "alula scenario --keys for what there is"
            )
        changes[_KEYS[field.name]] = getattr(config, field.name)
    if options.is_given(context, "seed"):
        changes["rules.seed"] = seed
    for role, path in files.items():
        if path is not None:
            changes[FILES[role]] = _relative(path, source.parent)
    return changes | dict(settings)


def _relative(path: Path, folder: Path) -> str:
    """Path of a file as a scenario in a folder names it."""
    return str(path.resolve()) if not path.is_absolute() and folder != Path() else str(path)


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

    record = read_run(output)
    hits = record.summary["static_collisions"]
    if hits and scenario.safety.filters:
        raise CheckError(
            f"{output}: {hits} of {len(record.trials)} filtered flights touched a static obstacle or left "
            f"the fence; the worst is trial {record.summary['worst_trial']}"
        )
    if scenario.mission.kind == "plan":
        trial = record.trials[0]
        if trial.outcome != "reached":
            words = complaint(trial.plan) if trial.outcome in PLAN_OUTCOMES else None
            raise CheckError(f"{output}: {words or f'the flight of the plan ended as {trial.outcome}'}")
