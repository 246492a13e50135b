"""`alula simulate` for scenarios with a fence."""

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
    from alula.schemas.geofence import FenceScenario
    from alula.schemas.provenance import Provenance
    from alula.stages.flight.geofence import FenceRun

# Fields of `SimulateConfig` that mean something here, and the keys of the scenario that they replace.
_KEYS = {
    "name": "name",
    "filter": "filter.name",
    "radius_m": "vehicle.radius_m",
    "trials": "trials.count",
    "max_time_s": "run.duration_s",
    "log_rate_hz": "run.log_rate_hz",
}
_TABLES = ("fence", "vehicle", "filter", "pilot", "trials", "run")


def simulate_geofence(
    context: click.Context,
    source: Path,
    files: Mapping[str, Path | None],
    config: SimulateConfig,
    settings: Mapping[str, Any],
    scheduler: str | None,
    common: options.Common,
) -> None:
    """Fly the trials of a scenario with a fence, and write the log and the record beside it.

    `files` given on the command line, a vehicle or a cover, replace those of the scenario.
    """
    import msgspec

    from alula.cli.journal import JournalFile
    from alula.schemas.artifact import read_artifact
    from alula.schemas.geofence import read_fence_scenario
    from alula.schemas.journal import TRIALS
    from alula.schemas.kinds import COVER
    from alula.schemas.run import RUN_SCHEMA, RUN_VERSION, read_run
    from alula.schemas.vehicle import contents, read_vehicle
    from alula.stages.flight.geofence import FlownChunk, fly_in_fence
    from alula.stages.flight.geofence_summary import fence_summary
    from alula.stages.flight.trial_chunks import TrialJournal

    given = {role: path for role, path in files.items() if path is not None}
    scenario = read_fence_scenario(source, _changes(context, config, settings, given, common.seed))
    paths = {"scenario": source, "vehicle": source.parent / scenario.vehicle.file}
    if scenario.fence.cover is not None:
        paths["cover"] = source.parent / scenario.fence.cover
    paths |= given
    vehicle = read_vehicle(paths["vehicle"])
    kept = JournalFile(common, TRIALS, partial(TrialJournal, FlownChunk))

    def make(provenance: Provenance, progress: Progress) -> tuple[Any, dict[str, Any]]:
        cover = read_artifact(paths["cover"], COVER) if "cover" in paths else None
        kept.begin(provenance)
        start = time.monotonic()
        with kept.kept(progress) as (journal, watched):
            already = len(journal)
            try:
                flown = fly_in_fence(
                    scenario,
                    vehicle,
                    cover=cover,
                    journal=journal,
                    jobs=common.jobs,
                    scheduler=scheduler,
                    progress=watched,
                )
            except UsageError as error:
                raise UsageError(f"{source}: {error}" if "`$." in str(error) else str(error)) from error
        timing = {"wall_s": time.monotonic() - start, "trials_flown": len(flown.trials) - already}
        summary = fence_summary(scenario, flown)
        frame = "world" if cover is None else cover.manifest.frame
        return lambda: _write(
            common.output, scenario, vehicle.name, provenance, flown, summary, timing, frame
        ), summary

    # Names of files do not matter, their content is hashed; nor does what a scenario is called in a file.
    parameters = msgspec.json.decode(msgspec.json.encode(scenario), type=dict[str, Any])
    seed = parameters["trials"].pop("seed")
    for table, key in ((None, "schema"), (None, "version"), ("vehicle", "file"), ("fence", "cover")):
        del (parameters if table is None else parameters[table])[key]
    parameters["vehicle_file"] = contents(vehicle)
    run(common, RUN_SCHEMA, RUN_VERSION, parameters, paths, make, seed=seed)
    kept.remove()
    if not common.dry_run and scenario.filter.name != "none":
        summary = read_run(common.output).summary
        if summary["violations"]:
            raise CheckError(
                f"{common.output}: {summary['violations']} of {summary['trials']} filtered flights left the "
                f"fence; farthest in trial {summary['worst_trial']}, {-summary['min_distance_m']:.4g} m"
            )


def _changes(
    context: click.Context,
    config: SimulateConfig,
    settings: Mapping[str, Any],
    files: Mapping[str, Path],
    seed: int,
) -> dict[str, Any]:
    """What the command line replaces, by the keys of the scenario."""
    changes: dict[str, Any] = {}
    for field in dataclasses.fields(config):
        if field.name == "seed" or not options.is_given(context, field.name):
            continue
        if field.name not in _KEYS:
            name = field.metadata.get("option", "--" + field.name.replace("_", "-"))
            raise UsageError(f"{name} is for other flights than those in a fence")
        changes[_KEYS[field.name]] = getattr(config, field.name)
    for name in ("scene_path", "pairs_path"):
        if options.is_given(context, name):
            option = "--" + name.removesuffix("_path").replace("pairs", "pairs-from")
            raise UsageError(f"{option} is for other flights than those in a fence")
    for role, key in (("vehicle", "vehicle.file"), ("cover", "fence.cover")):
        if role in files:
            changes[key] = str(files[role])
    if options.is_given(context, "seed"):
        changes["trials.seed"] = seed
    for name, value in settings.items():
        first = name.partition(".")[0]
        changes[name if first in _TABLES and "." in name else f"filter.parameters.{name}"] = value
    return changes


def _write(
    output: Path,
    scenario: FenceScenario,
    vehicle: str,
    provenance: Provenance,
    flown: FenceRun,
    summary: dict[str, Any],
    timing: dict[str, Any],
    frame: str,
) -> None:
    """The log, then the record beside it."""
    import msgspec

    from alula.cli.run_files import write_run
    from alula.schemas.run import RUN_SCHEMA, RUN_VERSION, RunRecord
    from alula.stages.flight.geofence_log import write_fence_log
    from alula.stages.flight.geofence_summary import fence_guarantee, fence_timing

    record = RunRecord(
        schema=RUN_SCHEMA,
        version=RUN_VERSION,
        provenance=msgspec.structs.replace(provenance, summary=summary),
        name=scenario.name,
        filter=scenario.filter.name,
        vehicle=f"{vehicle}, by throttle and rates, radius {flown.world.radius_m:g} m",
        trials=flown.trials,
        summary=summary,
        guarantee=fence_guarantee(scenario, flown),
    )
    tick_s = scenario.filter.parameters.tick_s
    write_run(
        output,
        record,
        timing | fence_timing(flown.times),
        lambda log: write_fence_log(log, record, flown.flights, flown.world, frame, tick_s=tick_s),
    )
