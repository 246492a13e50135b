"""`alula simulate`."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Set
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from alula.cli import options
from alula.cli.runner import run
from alula.schemas.configs.simulate import ELLIPSOIDS_ONLY, HULLS_ONLY, SAMPLING_ONLY, SimulateConfig
from alula.schemas.errors import CheckError, UsageError, WrongKindError
from alula.schemas.provenance import parameters_of

if TYPE_CHECKING:
    from alula.schemas.progress import Progress
    from alula.schemas.provenance import Provenance
    from alula.stages.simulation.pairs import Pairs
    from alula.stages.simulation.result import RunResult

EXAMPLES = """\b
Examples:
  alula simulate room.cover.npz -o room.run.mcap --trials 100 --radius 0.1
  alula simulate loop.plan.npz --map room.cover.npz --scene room.scene.npz -o loop.run.mcap
  alula simulate room.scene.npz -o fast.run.mcap --filter cone-backup --speed 3 --set horizon_s=2
  alula simulate room.scene.npz -o bent.run.mcap --filter cone-ecbf --guide cone-di --pairs-from fast.run.mcap
  alula simulate two.toml -o two.run.mcap --trials 3000 --set clearance_m=3
  alula simulate fence.toml -o fence.run.mcap --trials 10000 --set vehicle.mass_scale=1.2 --set reserve_m=2.5
"""


_GUIDE = "guide."  # before the name of a parameter of the guide


@click.command(epilog=EXAMPLES)
@click.argument("source", type=options.input_path())
@click.option(
    "--map", "map_path", type=options.input_path(), help="Cover or scene to fly in; needed with a plan."
)
@click.option(
    "--scene",
    "scene_path",
    type=options.input_path(),
    help="Metric scene; also judge against its ellipsoids.",
)
@click.option(
    "--vehicle",
    "vehicle_path",
    type=options.input_path(),
    help="What flies (.toml); default: among ellipsoids the quadrotor of FastBridge.",
)
@click.option(
    "--pairs-from",
    "pairs_path",
    type=options.input_path(),
    help="Another run (.run.mcap), whose starts and goals are flown instead of random ones.",
)
@click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="NAME=VALUE",
    help="Parameter of a filter among ellipsoids or moving obstacles or in a fence, guide.NAME=VALUE of its "
    "guide; may be repeated.",
)
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Send trials among moving obstacles or in a fence to this dask.distributed scheduler, tcp://host:port.",
)
@options.from_config(SimulateConfig)
@options.output(".run.mcap")
@click.pass_context
def command(
    context: click.Context,
    source: Path,
    map_path: Path | None,
    scene_path: Path | None,
    vehicle_path: Path | None,
    pairs_path: Path | None,
    settings: tuple[str, ...],
    scheduler: str | None,
    config: SimulateConfig,
    common: options.Common,
) -> None:
    """Fly start-goal pairs or a plan behind a safety filter.

    SOURCE is a scenario (.toml), a plan with --map, or a cover or a scene, in which random pairs are flown.
    Among the hulls of a cover flies a single integrator, a point with velocities as input (none,
    polytope-cbf); among the ellipsoids of a scene a quadrotor with rotors, or a double integrator, a point
    with accelerations as input (none, cone-di, safer-splat, and with rotors cone-ecbf, cone-backup).
    Options given here replace those of the scenario. A scenario with [[obstacles]] has moving ones
    (none, dr-acbf, dr-acbf-qp, mpc, cbf-qp, rp-cbf): --set replaces any of its keys, as in
    --set sensor.rate_hz=40, or a parameter of the filter; --trials of them are flown, an interrupted run
    leaves OUTPUT.journal, and the same command again continues from it. So it is with a scenario with
    [fence]: a racing drone and a simulated pilot, whose commands a geofence keeps inside (geofence,
    backup-qp, none).

    Beside R.run.mcap, R.run.json holds the same summary and the measured times. Exit code 4: a filtered
    flight collided with its map, or left its fence.
    """
    from alula.cli.run_files import check_log_name
    from alula.schemas.artifact import read_artifact
    from alula.schemas.encounters import is_encounters
    from alula.schemas.geofence import is_fence_scenario
    from alula.schemas.kinds import COVER, PLAN, SCENE
    from alula.schemas.run import RUN_SCHEMA, RUN_VERSION, read_run
    from alula.schemas.vehicle import FASTBRIDGE, contents, read_vehicle

    check_log_name(common.output)
    if source.suffix == ".toml" and is_fence_scenario(source):
        from alula.cli.simulate.geofence import simulate_geofence

        changes = dict(setting_of(word) for word in settings)
        files = {"vehicle": vehicle_path, "cover": map_path}
        simulate_geofence(context, source, files, config, changes, scheduler, common)
        return
    if source.suffix == ".toml" and is_encounters(source):
        from alula.cli.simulate.encounters import simulate_encounters

        changes = dict(setting_of(word) for word in settings)
        simulate_encounters(context, source, map_path, config, changes, scheduler, common)
        return
    if scheduler is not None:
        raise UsageError("--scheduler is for scenarios with moving obstacles or a fence")
    paths = inputs_of(source, map_path, scene_path, vehicle_path)
    config, given = _configured(context, source, config, common.seed, settings)
    splat = is_among_ellipsoids(config.filter, paths)
    _check_options(config, given, splat=splat)
    plan = read_artifact(paths["plan"], PLAN) if "plan" in paths else None
    pairs: Pairs | None = None
    if pairs_path is not None:
        from alula.stages.simulation.pairs import pairs_flown

        _check_pairs_from(context, plan is not None)
        paths["pairs"] = pairs_path
        pairs = pairs_flown(read_run(pairs_path).trials, config.trials)
        config = dataclasses.replace(config, trials=len(pairs.start))
    vehicle = read_vehicle(paths["vehicle"]) if "vehicle" in paths else FASTBRIDGE if splat else None
    if splat:
        from alula.stages.simulation.ellipsoids.simulate import resolve_splat, simulate_splat

        assert vehicle is not None
        config = resolve_splat(config, vehicle, plan)
    else:
        from alula.stages.simulation.hulls.simulate import resolve, simulate

        config = resolve(config, plan, vehicle)

    def make(provenance: Provenance, progress: Progress) -> tuple[Any, dict[str, Any]]:
        cover = read_artifact(paths["cover"], COVER) if "cover" in paths else None
        scene = read_artifact(paths["scene"], SCENE) if "scene" in paths else None
        if splat:
            assert scene is not None
            assert vehicle is not None
            result = simulate_splat(
                config,
                scene,
                vehicle,
                plan=plan,
                cover=cover,
                given=pairs,
                jobs=common.jobs,
                progress=progress,
            )
        else:
            assert cover is not None
            result = simulate(
                config,
                cover,
                plan=plan,
                scene=scene,
                vehicle=vehicle,
                given=pairs,
                jobs=common.jobs,
                progress=progress,
            )
        frame = result.map.manifest.frame
        return lambda: _write(common.output, config, provenance, result, frame), result.summary

    unused = ("seed", *(HULLS_ONLY if splat else ELLIPSOIDS_ONLY), *(SAMPLING_ONLY if pairs else ()))
    parameters = {key: value for key, value in parameters_of(config).items() if key not in unused}
    if vehicle is not None:
        parameters["vehicle"] = contents(vehicle)
    run(common, RUN_SCHEMA, RUN_VERSION, parameters, paths, make, seed=config.seed)
    if not common.dry_run and config.filter != "none":
        _check(common.output, read_run(common.output).trials, splat=splat)


def inputs_of(
    source: Path, map_path: Path | None, scene: Path | None, vehicle: Path | None
) -> dict[str, Path]:
    """All files to read, by role; those of a scenario are relative to its folder."""
    from alula.schemas.artifact import read_manifest
    from alula.schemas.kinds import COVER, PLAN, SCENE
    from alula.schemas.scenario import read_scenario

    paths: dict[str, Path | None]
    if source.suffix == ".toml":
        scenario = read_scenario(source)
        table = scenario.map
        files = {
            "cover": table.cover,
            "scene": table.scene,
            "plan": table.plan,
            "vehicle": scenario.vehicle.file,
        }
        paths = {role: None if name is None else source.parent / name for role, name in files.items()}
        paths["scenario"] = source
    else:
        found = read_manifest(source).schema
        if found not in (COVER.name, PLAN.name, SCENE.name):
            raise WrongKindError(
                f"{source}: is {found}, but a scenario, {PLAN.name}, {COVER.name} or {SCENE.name} is needed"
            )
        role = found.removeprefix("alula/")
        if role != "plan" and map_path is not None:
            raise UsageError(f"{source} is a {role} already; --map is for plans and scenarios")
        if role == "plan" and map_path is None:
            raise UsageError("a plan needs --map, the cover or the scene to fly it in")
        if role == "scene" and scene is not None:
            raise UsageError(f"{source} is a scene already; --scene is for covers")
        paths = {role: source}
    if map_path is not None:
        found = read_manifest(map_path).schema
        if found not in (COVER.name, SCENE.name):
            raise WrongKindError(f"{map_path}: is {found}, but {COVER.name} or {SCENE.name} is needed")
        paths[found.removeprefix("alula/")] = map_path
    if scene is not None:
        paths["scene"] = scene
    if vehicle is not None:
        paths["vehicle"] = vehicle
    return {role: path for role, path in paths.items() if path is not None}


def is_among_ellipsoids(name: str, paths: Mapping[str, Path]) -> bool:
    """Whether the filter sees the ellipsoids of the scene; `none` flies what the map is for.

    Raises:
        UsageError: there is no such filter, or not the map that it sees.
    """
    from alula.stages.filtering.registry import NO_FILTER, filter_names, splat_filter_names

    hulls, ellipsoids = filter_names(), splat_filter_names()
    if name not in hulls and name not in ellipsoids:
        known = list(dict.fromkeys([*hulls, *ellipsoids]))
        raise UsageError(f"no filter is called {name!r}; known: {', '.join(known)}")
    if name == NO_FILTER:
        return "cover" not in paths
    if name in ellipsoids:
        if "scene" not in paths:
            raise UsageError(f"{name} sees the ellipsoids of a scene; give one, with --scene beside a cover")
        return True
    if "cover" not in paths:
        others = [other for other in ellipsoids if other != NO_FILTER]
        raise UsageError(
            f"{name} sees the hulls of a cover, not a scene; --filter may be {', '.join(others)} or none"
        )
    return False


def _check_options(config: SimulateConfig, given: Set[str], *, splat: bool) -> None:
    """Refuse options that the flights to be do not have."""
    wrong = [name for name in (HULLS_ONLY if splat else ELLIPSOIDS_ONLY) if name in given]
    if wrong:
        whom = "hulls of a cover" if splat else "ellipsoids of a scene"
        raise UsageError(f"{_option_of(wrong[0])} is for flights among the {whom}, which these are not")
    if not splat and config.filter_parameters and config.filter in ("none", "polytope-cbf"):
        known = (
            "no parameters"
            if config.filter == "none"
            else "the options --beta, --kappa, --smoothing and --onboard"
        )
        raise UsageError(f"--set: the filter {config.filter} has {known}")


def _check_pairs_from(context: click.Context, has_plan: bool) -> None:
    """Refuse options that say which pairs to draw, where another run's are flown."""
    if has_plan:
        raise UsageError("--pairs-from: a plan is flown as it is")
    for name in SAMPLING_ONLY:
        if options.is_given(context, name):
            raise UsageError(
                f"{_option_of(name)} is for random pairs; those of --pairs-from are flown as they are"
            )


def _option_of(name: str) -> str:
    """How a field of the configuration is called on the command line."""
    return options.option_of(next(f for f in dataclasses.fields(SimulateConfig) if f.name == name))


def _configured(
    context: click.Context, source: Path, config: SimulateConfig, seed: int, settings: tuple[str, ...]
) -> tuple[SimulateConfig, set[str]]:
    """The scenario's settings, replaced by what was given on the command line; and which fields were set."""
    from alula.schemas.scenario import read_scenario

    given: dict[str, Any] = {
        f.name: getattr(config, f.name)
        for f in dataclasses.fields(config)
        if options.is_given(context, f.name)
    }
    parameters = dict(setting_of(word) for word in settings)
    guides = {name: parameters.pop(name) for name in list(parameters) if name.startswith(_GUIDE)}
    guides = {name.removeprefix(_GUIDE): value for name, value in guides.items()}
    if {"sigma", "confidence"} <= given.keys():
        raise UsageError("--confidence sets sigma: give one of the two, not both")
    if source.suffix != ".toml":
        config = dataclasses.replace(config, seed=seed, filter_parameters=parameters, guide_parameters=guides)
        return config, given.keys() | ({"guide_parameters"} if guides else set())
    if options.is_given(context, "seed"):
        given["seed"] = seed
    found = read_scenario(source).settings()
    if "sigma" in given and "confidence" not in given:
        found.pop("confidence", None)  # the same level in other words
    if parameters:
        given["filter_parameters"] = {**found.get("filter_parameters", {}), **parameters}
    if guides:
        given["guide_parameters"] = {**found.get("guide_parameters", {}), **guides}
    try:
        return SimulateConfig(**{**found, **given}), found.keys() | given.keys()
    except UsageError as error:
        raise UsageError(f"{source}: {error}") from error


def setting_of(word: str) -> tuple[str, Any]:
    """NAME=VALUE: a whole number, a number, numbers with commas, true or false, else a word."""
    name, equals, text = word.partition("=")
    if not (equals and name and text):
        raise UsageError(f"--set needs NAME=VALUE, not {word!r}")
    if "," in text:
        return name, [setting_of(f"{name}={part}")[1] for part in text.split(",")]
    if text in ("true", "false"):
        return name, text == "true"
    for convert in (int, float):
        with suppress(ValueError):
            value = convert(text)
            if isinstance(value, float) and not math.isfinite(value):
                raise UsageError(f"--set {name}: {text!r} is not finite")
            return name, value
    return name, text


def _write(
    output: Path, config: SimulateConfig, provenance: Provenance, result: RunResult, frame: str
) -> None:
    """The log, then the record beside it."""
    import msgspec

    from alula.cli.run_files import flight_timing, write_run
    from alula.schemas.run import RUN_SCHEMA, RUN_VERSION, RunRecord
    from alula.stages.runlog.runs import write_log

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
    write_run(
        output,
        record,
        flight_timing(result, config.dt_s),
        lambda log: write_log(log, record, result.flights, result.map, frame),
    )


def _check(output: Path, trials: list[Any], *, splat: bool) -> None:
    """Fail when a flight behind a filter came closer to what it sees than the vehicle's radius."""
    from alula.stages.clearance import COLLISION_TOLERANCE_M

    def clearance(trial: Any) -> float:
        found = trial.scene_clearance_m if splat else trial.map_clearance_m
        return math.inf if found is None else found

    hits = [trial for trial in trials if clearance(trial) < -COLLISION_TOLERANCE_M]
    if hits:
        worst = min(hits, key=clearance)
        start = " ".join(f"{value:.3f}" for value in worst.start_m)
        raise CheckError(
            f"{output}: {len(hits)} of {len(trials)} filtered flights collided with the map; deepest in "
            f"trial {worst.index} from ({start}), {-clearance(worst):.4g} m"
        )
