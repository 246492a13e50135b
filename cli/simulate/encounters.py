"""`alula simulate` for scenarios with moving obstacles."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from alula.cli import options
from alula.cli.simulate.chunks import ScenarioOptions, replaced_keys, run_trials
from alula.schemas.configs.simulate import SimulateConfig
from alula.schemas.decimals import exact
from alula.schemas.errors import CheckError

if TYPE_CHECKING:
    from alula.schemas.encounters import Encounters
    from alula.schemas.provenance import Provenance
    from alula.stages.simulation.encounters.simulate import EncounterRun

_OPTIONS = ScenarioOptions(
    keys={
        "name": "name",
        "filter": "filter.name",
        "radius_m": "vehicle.radius_m",
        "speed_m_s": "vehicle.v_max_m_s",
        "gain": "encounter.gain_per_s",
        "trials": "trials.count",
        "dt_s": "run.dt_s",
        "max_time_s": "run.max_time_s",
        "log_rate_hz": "run.log_rate_hz",
    },
    tables=("encounter", "vehicle", "obstacles", "sensor", "tracker", "filter", "walls", "trials", "run"),
    others={"scene_path": "--scene", "vehicle_path": "--vehicle"},
    meant_for="flights among static obstacles",
)


def simulate_encounters(
    context: click.Context,
    source: Path,
    map_path: Path | None,
    config: SimulateConfig,
    settings: Mapping[str, Any],
    scheduler: str | None,
    common: options.Common,
) -> None:
    """Fly the trials of a scenario with moving obstacles, and write its log and record.

    Args:
        context: tells which options were given.
        source: the scenario.
        map_path: cover with static obstacles, in place of the scenario's.
        config: of `simulate`.
        settings: names and values of --set.
        scheduler: address of a `dask.distributed` scheduler.
        common: the shared options.

    Raises:
        UsageError: an option does not apply, or the scenario is wrong.
        CheckError: a filtered flight hit a wall.
    """
    import msgspec

    from alula.schemas.encounters import read_encounters
    from alula.schemas.run import read_run
    from alula.stages.simulation.encounters.simulate import FlownChunk, fly_encounters
    from alula.stages.simulation.encounters.summary import encounter_summary

    changes = replaced_keys(context, config, settings, common.seed, _OPTIONS)
    scenario = read_encounters(source, changes)
    paths = {"scenario": source}
    if scenario.map.cover is not None or map_path is not None:
        paths["cover"] = map_path or source.parent / str(scenario.map.cover)
    run_trials(
        common,
        msgspec.json.decode(msgspec.json.encode(scenario), type=dict[str, Any]),
        paths,
        chunk=FlownChunk,
        fly=partial(fly_encounters, scenario, scheduler=scheduler),
        summarize=lambda flown: encounter_summary(scenario, flown.trials),
        write=partial(_write, common.output, scenario),
    )
    if not common.dry_run and scenario.filter.name != "none":
        hits = read_run(common.output).summary["wall_collisions"]
        if hits:
            raise CheckError(f"{common.output}: {hits} of {scenario.trials.count} trials flew into a wall")


def _write(
    output: Path,
    scenario: Encounters,
    provenance: Provenance,
    flown: EncounterRun,
    summary: dict[str, Any],
    timing: dict[str, Any],
    frame: str,
) -> None:
    """Write the log, and the record beside it."""
    from alula.cli.run_files import write_run
    from alula.schemas.run import RunRecord
    from alula.stages.runlog.encounters import write_encounter_log
    from alula.stages.simulation.encounters.summary import encounter_guarantee, encounter_timing

    body = scenario.vehicle
    record = RunRecord.of(
        provenance,
        name=scenario.name,
        filter=scenario.filter.name,
        vehicle=f"sphere of radius {exact(body.radius_m)} m, double integrator up to "
        f"{exact(body.v_max_m_s)} m/s, {exact(body.a_max_m_s2)} m/s^2 and {exact(body.j_max_m_s3)} m/s^3",
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
