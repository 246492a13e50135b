"""`alula simulate` for scenarios with a fence."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from alula.cli import options
from alula.cli.simulate.chunks import ScenarioOptions, replaced_keys, run_trials
from alula.schemas.configs.simulate import SimulateConfig
from alula.schemas.errors import CheckError

if TYPE_CHECKING:
    from alula.schemas.geofence import FenceScenario
    from alula.schemas.provenance import Provenance
    from alula.stages.simulation.geofence.simulate import FenceRun

_OPTIONS = ScenarioOptions(
    keys={
        "name": "name",
        "filter": "filter.name",
        "radius_m": "vehicle.radius_m",
        "trials": "trials.count",
        "max_time_s": "run.duration_s",
        "log_rate_hz": "run.log_rate_hz",
    },
    tables=("fence", "vehicle", "filter", "pilot", "trials", "run"),
    others={"scene_path": "--scene", "pairs_path": "--pairs-from"},
    meant_for="flights without a fence",
)
_FILES = {"vehicle": "vehicle.file", "cover": "fence.cover"}  # by role


def simulate_geofence(
    context: click.Context,
    source: Path,
    files: Mapping[str, Path | None],
    config: SimulateConfig,
    settings: Mapping[str, Any],
    scheduler: str | None,
    common: options.Common,
) -> None:
    """Fly the trials of a scenario with a fence, and write its log and record.

    Args:
        context: tells which options were given.
        source: the scenario.
        files: vehicle and cover of the command line, which replace those of the scenario.
        config: of `simulate`.
        settings: names and values of --set.
        scheduler: address of a `dask.distributed` scheduler.
        common: the shared options.

    Raises:
        UsageError: an option does not apply, or the scenario is wrong.
        CheckError: a filtered flight left the fence.
    """
    import msgspec

    from alula.schemas.geofence import read_fence_scenario
    from alula.schemas.run import read_run
    from alula.schemas.vehicle import contents, read_vehicle
    from alula.stages.simulation.geofence.simulate import FlownChunk, fly_in_fence
    from alula.stages.simulation.geofence.summary import fence_summary

    given = {role: path for role, path in files.items() if path is not None}
    named = {_FILES[role]: str(path) for role, path in given.items()}
    changes = named | replaced_keys(context, config, settings, common.seed, _OPTIONS)
    scenario = read_fence_scenario(source, changes)
    paths = {"scenario": source, "vehicle": source.parent / scenario.vehicle.file}
    if scenario.fence.cover is not None:
        paths["cover"] = source.parent / scenario.fence.cover
    paths |= given
    vehicle = read_vehicle(paths["vehicle"])
    # The content of files is hashed; their names have no influence on results.
    parameters = msgspec.json.decode(msgspec.json.encode(scenario), type=dict[str, Any])
    for key in _FILES.values():
        table, name = key.split(".")
        del parameters[table][name]
    parameters["vehicle_file"] = contents(vehicle)
    run_trials(
        common,
        parameters,
        paths,
        chunk=FlownChunk,
        fly=partial(fly_in_fence, scenario, vehicle, scheduler=scheduler),
        summarize=partial(fence_summary, scenario),
        write=partial(_write, common.output, scenario, vehicle.name),
    )
    if not common.dry_run and scenario.filter.name != "none":
        summary = read_run(common.output).summary
        if summary["violations"]:
            raise CheckError(
                f"{common.output}: {summary['violations']} of {summary['trials']} filtered flights left the "
                f"fence; the farthest in trial {summary['worst_trial']}, {-summary['min_distance_m']:.4g} m"
            )


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
    """Write the log, and the record beside it."""
    from alula.cli.run_files import write_run
    from alula.schemas.run import RunRecord
    from alula.stages.runlog.geofence import write_fence_log
    from alula.stages.simulation.geofence.summary import fence_guarantee, fence_timing

    record = RunRecord.of(
        provenance,
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
        lambda log: write_fence_log(
            log, record, flown.flights, flown.world.faces, flown.world.hulls, frame, tick_s=tick_s
        ),
    )
