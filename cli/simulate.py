"""`alula simulate`."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from alula.cli import options
from alula.cli.runner import run
from alula.schemas.configs.simulate import SimulateConfig
from alula.schemas.errors import CheckError, UsageError, WrongKindError
from alula.schemas.provenance import parameters_of

if TYPE_CHECKING:
    from alula.cli.runner import Progress
    from alula.schemas.provenance import Provenance
    from alula.stages.flight.simulate import RunResult

EXAMPLES = """\b
Examples:
  alula simulate room.cover.npz -o room.run.mcap --trials 100 --radius 0.1
  alula simulate loop.plan.npz --map room.cover.npz --scene room.scene.npz -o loop.run.mcap
"""


@click.command(epilog=EXAMPLES)
@click.argument("source", type=options.input_path())
@click.option("--map", "cover_path", type=options.input_path(), help="Cover to fly in; needed with a plan.")
@click.option(
    "--scene",
    "scene_path",
    type=options.input_path(),
    help="Metric scene; also judge against its ellipsoids.",
)
@options.from_config(SimulateConfig)
@options.output(".run.mcap")
@click.pass_context
def command(
    context: click.Context,
    source: Path,
    cover_path: Path | None,
    scene_path: Path | None,
    config: SimulateConfig,
    common: options.Common,
) -> None:
    """Fly start-goal pairs or a plan behind a safety filter.

    SOURCE is a scenario (.toml), a plan with --map, or a cover, in which random pairs are flown.
    Options given here replace those of the scenario. Beside R.run.mcap, R.run.json holds the same
    summary and the measured times. Exit code 4: a filtered flight collided with its map.
    """
    from alula.schemas.artifact import read_artifact
    from alula.schemas.kinds import COVER, PLAN, SCENE
    from alula.schemas.run import RUN_SCHEMA, RUN_SUFFIX, RUN_VERSION, read_run
    from alula.stages.flight.simulate import resolve, simulate

    if not common.output.name.endswith(".mcap"):
        raise UsageError(f"{common.output}: the output must end in .mcap (usually {RUN_SUFFIX})")
    paths = _inputs(source, cover_path, scene_path)
    config = _configured(context, source, config, common.seed)
    plan = read_artifact(paths["plan"], PLAN) if "plan" in paths else None
    config = resolve(config, plan)

    def make(provenance: Provenance, progress: Progress) -> tuple[Any, dict[str, Any]]:
        cover = read_artifact(paths["cover"], COVER)
        scene = read_artifact(paths["scene"], SCENE) if "scene" in paths else None
        result = simulate(config, cover, plan=plan, scene=scene, jobs=common.jobs, progress=progress)
        frame = cover.manifest.frame
        return lambda: _write(common.output, config, provenance, result, frame), result.summary

    parameters = {key: value for key, value in parameters_of(config).items() if key != "seed"}
    run(common, RUN_SCHEMA, RUN_VERSION, parameters, paths, make, seed=config.seed)
    if not common.dry_run and config.filter != "none":
        _check(common.output, read_run(common.output).trials)


def _inputs(source: Path, cover: Path | None, scene: Path | None) -> dict[str, Path]:
    """All files to read, by role; those of a scenario are relative to its folder."""
    from alula.schemas.artifact import read_manifest
    from alula.schemas.kinds import COVER, PLAN
    from alula.schemas.scenario import read_scenario

    paths: dict[str, Path | None]
    if source.suffix == ".toml":
        table = read_scenario(source).map
        paths = {
            role: None if name is None else source.parent / name
            for role, name in (("cover", table.cover), ("scene", table.scene), ("plan", table.plan))
        }
        paths["scenario"] = source
    else:
        found = read_manifest(source).schema
        if found == COVER.name:
            if cover is not None:
                raise UsageError(f"{source} is a cover already; --map is for plans and scenarios")
            paths = {"cover": source}
        elif found == PLAN.name:
            if cover is None:
                raise UsageError("a plan needs --map, the cover to fly it in")
            paths = {"plan": source}
        else:
            raise WrongKindError(
                f"{source}: is {found}, but a scenario, {PLAN.name} or {COVER.name} is needed"
            )
    if cover is not None:
        paths["cover"] = cover
    if scene is not None:
        paths["scene"] = scene
    return {role: path for role, path in paths.items() if path is not None}


def _configured(context: click.Context, source: Path, config: SimulateConfig, seed: int) -> SimulateConfig:
    """The scenario's settings, replaced by what was given on the command line."""
    from alula.schemas.scenario import read_scenario

    if source.suffix != ".toml":
        return dataclasses.replace(config, seed=seed)
    given = {
        f.name: getattr(config, f.name)
        for f in dataclasses.fields(config)
        if options.is_given(context, f.name)
    }
    if options.is_given(context, "seed"):
        given["seed"] = seed
    try:
        return SimulateConfig(**{**read_scenario(source).settings(), **given})
    except UsageError as error:
        raise UsageError(f"{source}: {error}") from error


def _write(
    output: Path, config: SimulateConfig, provenance: Provenance, result: RunResult, frame: str
) -> None:
    """The log, then the record beside it."""
    import msgspec

    from alula.schemas.atomic import atomic_output
    from alula.schemas.run import RUN_SCHEMA, RUN_VERSION, RunRecord, record_path
    from alula.stages.flight.log import write_log

    record = RunRecord(
        schema=RUN_SCHEMA,
        version=RUN_VERSION,
        provenance=msgspec.structs.replace(provenance, summary=result.summary),
        name=config.name,
        filter=result.filter,
        vehicle=result.vehicle,
        trials=result.trials,
        summary=result.summary,
        guarantee=result.guarantee,
    )
    timed = msgspec.structs.replace(record, timing=_timing(result))
    text = msgspec.json.format(msgspec.json.encode(timed, order="sorted"), indent=2) + b"\n"
    with atomic_output(output) as log, atomic_output(record_path(output)) as beside:
        write_log(log, record, result.flights, result.cover, frame)
        beside.write(text)


def _timing(result: RunResult) -> dict[str, Any]:
    """Measured times of the filter and the machine they were measured on."""
    import os
    import platform

    import numpy as np

    timing: dict[str, Any] = {
        "cpu_count": os.cpu_count(),
        "machine": platform.machine(),
        "system": platform.system(),
    }
    if result.filter != "none":
        p50, p99, longest = np.percentile(result.filter_s, [50, 99, 100]).tolist()
        timing |= {
            "filter_calls": len(result.filter_s),
            "filter_p50_s": p50,
            "filter_p99_s": p99,
            "filter_max_s": longest,
            "filter_total_s": float(result.filter_s.sum(dtype=np.float64)),
        }
    return timing


def _check(output: Path, trials: list[Any]) -> None:
    """Fail when a flight behind a filter came closer to a hull than the vehicle's radius."""
    from alula.stages.flight.simulate import COLLISION_TOLERANCE_M

    hits = [t for t in trials if t.map_clearance_m is not None and t.map_clearance_m < -COLLISION_TOLERANCE_M]
    if hits:
        worst = min(hits, key=lambda t: t.map_clearance_m)
        start = " ".join(f"{value:.3f}" for value in worst.start_m)
        raise CheckError(
            f"{output}: {len(hits)} of {len(trials)} filtered flights collided with the map; deepest in "
            f"trial {worst.index} from ({start}), {-worst.map_clearance_m:.4g} m"
        )
