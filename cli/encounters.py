"""`alula simulate` for scenarios with moving obstacles."""

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
    from alula.cli.runner import Progress
    from alula.schemas.encounters import Encounters
    from alula.schemas.provenance import Provenance
    from alula.stages.flight.encounters import EncounterRun

# Fields of `SimulateConfig` that mean something here, and the keys of the scenario that they replace.
_KEYS = {
    "name": "name",
    "filter": "filter.name",
    "radius_m": "vehicle.radius_m",
    "speed_m_s": "vehicle.v_max_m_s",
    "gain": "encounter.gain_per_s",
    "trials": "trials.count",
    "dt_s": "run.dt_s",
    "max_time_s": "run.max_time_s",
    "log_rate_hz": "run.log_rate_hz",
}
_TABLES = ("encounter", "vehicle", "obstacles", "sensor", "tracker", "filter", "walls", "trials", "run")


def simulate_encounters(
    context: click.Context,
    source: Path,
    map_path: Path | None,
    config: SimulateConfig,
    settings: Mapping[str, Any],
    scheduler: str | None,
    common: options.Common,
) -> None:
    """Fly the trials of a scenario with moving obstacles, and write the log and the record beside it."""
    import msgspec

    from alula.cli.journal import JournalFile
    from alula.schemas.artifact import read_artifact
    from alula.schemas.encounters import read_encounters
    from alula.schemas.journal import TRIALS
    from alula.schemas.kinds import COVER
    from alula.schemas.run import RUN_SCHEMA, RUN_VERSION, read_run
    from alula.stages.flight.encounter_summary import encounter_summary
    from alula.stages.flight.encounters import FlownChunk, fly_encounters
    from alula.stages.flight.trial_chunks import TrialJournal

    scenario = read_encounters(source, _changes(context, config, settings, common.seed))
    paths = {"scenario": source}
    if scenario.map.cover is not None or map_path is not None:
        paths["cover"] = map_path or source.parent / str(scenario.map.cover)
    kept = JournalFile(common, TRIALS, partial(TrialJournal, FlownChunk))

    def make(provenance: Provenance, progress: Progress) -> tuple[Any, dict[str, Any]]:
        cover = read_artifact(paths["cover"], COVER) if "cover" in paths else None
        kept.begin(provenance)
        start = time.monotonic()
        with kept.kept(progress) as (journal, watched):
            already = len(journal)
            try:
                flown = fly_encounters(
                    scenario,
                    cover=cover,
                    journal=journal,
                    jobs=common.jobs,
                    scheduler=scheduler,
                    progress=watched,
                )
            except UsageError as error:
                raise UsageError(f"{source}: {error}" if "`$." in str(error) else str(error)) from error
        wall_s = time.monotonic() - start
        timing = {"wall_s": wall_s, "trials_flown": len(flown.trials) - already}
        summary = encounter_summary(scenario, flown.trials)
        frame = "world" if cover is None else cover.manifest.frame
        return lambda: _write(common.output, scenario, provenance, flown, summary, timing, frame), summary

    # What a scenario is called in a file matters no more than how its tables are ordered.
    parameters = msgspec.json.decode(msgspec.json.encode(scenario), type=dict[str, Any])
    seed = parameters["trials"].pop("seed")
    for key in ("schema", "version"):
        del parameters[key]
    run(common, RUN_SCHEMA, RUN_VERSION, parameters, paths, make, seed=seed)
    kept.remove()
    if not common.dry_run and scenario.filter.name != "none":
        hits = read_run(common.output).summary["wall_collisions"]
        if hits:
            raise CheckError(f"{common.output}: {hits} of {scenario.trials.count} trials flew into a wall")


def _changes(
    context: click.Context, config: SimulateConfig, settings: Mapping[str, Any], seed: int
) -> dict[str, Any]:
    """What the command line replaces, by the keys of the scenario."""
    changes: dict[str, Any] = {}
    for field in dataclasses.fields(config):
        if field.name == "seed" or not options.is_given(context, field.name):
            continue
        if field.name not in _KEYS:
            name = field.metadata.get("option", "--" + field.name.replace("_", "-"))
            raise UsageError(f"{name} is for flights among static obstacles, which these are not")
        changes[_KEYS[field.name]] = getattr(config, field.name)
    for name in ("scene_path", "vehicle_path"):
        if options.is_given(context, name):
            option = "--" + name.removesuffix("_path")
            raise UsageError(f"{option} is for flights among static obstacles, which these are not")
    if options.is_given(context, "seed"):
        changes["trials.seed"] = seed
    for name, value in settings.items():
        first = name.partition(".")[0]
        changes[name if first in _TABLES and "." in name else f"filter.parameters.{name}"] = value
    return changes


def _write(
    output: Path,
    scenario: Encounters,
    provenance: Provenance,
    flown: EncounterRun,
    summary: dict[str, Any],
    timing: dict[str, Any],
    frame: str,
) -> None:
    """The log, then the record beside it."""
    import msgspec

    from alula.cli.run_files import write_run
    from alula.schemas.run import RUN_SCHEMA, RUN_VERSION, RunRecord
    from alula.stages.flight.encounter_log import write_encounter_log
    from alula.stages.flight.encounter_summary import encounter_guarantee, encounter_timing

    body = scenario.vehicle
    record = RunRecord(
        schema=RUN_SCHEMA,
        version=RUN_VERSION,
        provenance=msgspec.structs.replace(provenance, summary=summary),
        name=scenario.name,
        filter=scenario.filter.name,
        vehicle=f"sphere of radius {body.radius_m:g} m, double integrator up to {body.v_max_m_s:g} m/s, "
        f"{body.a_max_m_s2:g} m/s^2 and {body.j_max_m_s3:g} m/s^3",
        trials=flown.trials,
        summary=summary,
        guarantee=encounter_guarantee(scenario, flown.trials),
    )
    write_run(
        output,
        record,
        timing | encounter_timing(scenario, flown),
        lambda log: write_encounter_log(
            log,
            record,
            flown.flights,
            flown.walls,
            frame,
            dt_s=scenario.run.dt_s,
            radii_m=[obstacle.radius_m for obstacle in scenario.obstacles],
            radius_m=body.radius_m,
        ),
    )
