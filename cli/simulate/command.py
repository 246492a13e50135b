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
from alula.schemas.configs.plan import AlongPlanConfig
from alula.schemas.configs.simulate import ELLIPSOIDS_ONLY, HULLS_ONLY, SAMPLING_ONLY, SimulateConfig
from alula.schemas.errors import CheckError, UsageError, WrongKindError
from alula.schemas.provenance import parameters_of

if TYPE_CHECKING:
    from alula.schemas.progress import Progress
    from alula.schemas.provenance import Provenance
    from alula.schemas.run import TrialResult
    from alula.stages.simulation.pairs import Pairs
    from alula.stages.simulation.result import RunResult

EXAMPLES = """\b
Examples:
  alula simulate room.cover.npz -o room.run.mcap --trials 100 --radius 0.1
  alula simulate room.cover.npz -o planned.run.mcap --planned
  alula simulate loop.plan.npz --map room.cover.npz --scene room.scene.npz -o loop.run.mcap
  alula simulate room.scene.npz -o fast.run.mcap --filter cone-backup --speed 3 --set horizon_s=2
  alula simulate room.cover.npz -o sure.run.mcap --filter shield --scene room.scene.npz --set shield_map=hulls
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
    help="Metric scene; flights are also judged against its ellipsoids.",
)
@click.option(
    "--vehicle",
    "vehicle_path",
    type=options.input_path(),
    help="Vehicle file (.toml); default in a scene: the quadrotor of FastBridge.",
)
@click.option(
    "--pairs-from",
    "pairs_path",
    type=options.input_path(),
    help="Run (.run.mcap) with the starts and goals to fly instead of random ones.",
)
@click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="NAME=VALUE",
    help="Set a parameter of the filter, or with guide.NAME=VALUE of the guide; may be repeated.",
)
@options.scheduler("Send trials of scenarios with moving obstacles or a fence")
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
    r"""Fly start-goal pairs or a plan behind a safety filter.

    SOURCE is a cover, a scene, a plan or a scenario (.toml). Random start-goal pairs are flown in a cover or
    a scene; a plan is flown in the --map. Options on the command line replace those of a scenario.

    A pair is flown straight at its goal, and a filter sees no way around an obstacle: among walls most such
    flights end in front of one, without a collision. Their success rate measures the filter alone. With
    --planned, each pair is planned first, as alula plan does, and its plan is flown; that needs a cover.

    The filters shield, cone-backup, cone-ecbf and safer-splat also fly in a cover without a scene. Their rows
    are then of its hulls, and shields certify every step against them, as they do with --set shield_map=hulls
    in a cover with its --scene.

    \b
    Vehicle and filters:
      cover          single integrator, commanded by velocity:
                     none, polytope-cbf; the others: safer-splat;
                     quadrotor: cone-ecbf, cone-backup, shield
      scene          double integrator, commanded by acceleration, or quadrotor:
                     none, cone-di, safer-splat; quadrotor: cone-ecbf, cone-backup, shield
      [[obstacles]]  double integrator among the moving obstacles of a scenario:
                     none, dr-acbf, dr-acbf-qp, mpc, cbf-qp, rp-cbf
      [fence]        racing drone with a simulated pilot in a scenario's geofence:
                     none, geofence, backup-qp

    Scenarios with [[obstacles]] or [fence] fly --trials trials. Their --set replaces any key, as in
    --set sensor.rate_hz=40, or a parameter of the filter. An interrupted run leaves OUTPUT.journal; the same
    command continues from it.

    The run's summary and measured times are also written to R.run.json, beside R.run.mcap. Exit code 4: a
    filtered flight collided with its map or left its fence, or did not fly its plan: to the goal, through all
    via points, and within the tube about the plan.
    """
    from alula.cli.run_files import check_log_name
    from alula.schemas.artifact import read_artifact
    from alula.schemas.encounters import is_encounters
    from alula.schemas.geofence import is_fence_scenario
    from alula.schemas.kinds import COVER, PLAN, SCENE
    from alula.schemas.run import RUN_SCHEMA, RUN_VERSION, read_run
    from alula.schemas.vehicle import FASTBRIDGE, contents, read_vehicle
    from alula.schemas.world import is_world

    check_log_name(common.output)
    if source.suffix == ".toml" and is_world(source):
        from alula.cli.simulate.world import simulate_scenario

        if scheduler is not None:
            raise UsageError("--scheduler is for scenarios of version 1; use --jobs")
        replaced = {"vehicle": vehicle_path, "scene": scene_path, "cover": map_path, "pairs": pairs_path}
        changes = dict(setting_of(word) for word in settings)
        simulate_scenario(context, source, replaced, config, changes, common)
        return
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
    _check_options(config, given, splat=splat, has_plan="plan" in paths)
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
        config = resolve_splat(config, vehicle, plan, has_scene="scene" in paths)

    def make(provenance: Provenance, progress: Progress) -> tuple[Any, dict[str, Any]]:
        cover = read_artifact(paths["cover"], COVER) if "cover" in paths else None
        scene = read_artifact(paths["scene"], SCENE) if "scene" in paths else None
        assert splat
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
        frame = result.map.manifest.frame
        return lambda: _write(common.output, config, provenance, result, frame), result.summary

    unused = ("seed", *(HULLS_ONLY if splat else ELLIPSOIDS_ONLY), *(SAMPLING_ONLY if pairs else ()))
    parameters = {key: value for key, value in parameters_of(config).items() if key not in unused}
    if vehicle is not None:
        parameters["vehicle"] = contents(vehicle)
    run(common, RUN_SCHEMA, RUN_VERSION, parameters, paths, make, seed=config.seed)
    if not common.dry_run and config.filter != "none":
        trials = read_run(common.output).trials
        _check(common.output, trials, splat=splat)
        if plan is not None:
            _check_plan(common.output, trials[0])


def inputs_of(
    source: Path, map_path: Path | None, scene: Path | None, vehicle: Path | None
) -> dict[str, Path]:
    """Paths of all files to read, by role; those in a scenario are relative to its folder.

    Args:
        source: scenario, plan, cover or scene.
        map_path: cover or scene of --map.
        scene: scene of --scene.
        vehicle: file of --vehicle.

    Raises:
        WrongKindError: a file is of another kind.
        UsageError: the files do not go together.
    """
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
            raise UsageError(f"{source} is a {role}; --map is for plans and scenarios")
        if role == "plan" and map_path is None:
            raise UsageError("a plan needs --map: a cover or a scene to fly it in")
        if role == "scene" and scene is not None:
            raise UsageError(f"{source} is a scene; --scene is for covers")
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
    """Decide by the filter between a quadrotor or double integrator (True) and a single integrator.

    The first two fly among the ellipsoids of a scene, and behind some filters among the hulls of a cover
    alone; a single integrator flies in a cover. The filter `none` takes the cover if there is one.

    Args:
        name: of the filter.
        paths: files by role.

    Raises:
        UsageError: there is no such filter, or its map is missing.
    """
    from alula.schemas.world_check import TRACKING
    from alula.stages.filtering.ellipsoid_filters import ELLIPSOID_FILTERS
    from alula.stages.filtering.registry import FLIES_AMONG_HULLS, NO_FILTER, filter_kind

    if name == NO_FILTER:
        return "cover" not in paths
    kind = filter_kind(name)
    if name in TRACKING or kind == "sticks":
        raise UsageError(
            f"{name} flies in a scenario of version 2.0, as its `safety.filters`; see alula scenario"
        )
    if kind != "velocity":
        if "scene" not in paths and not (name in FLIES_AMONG_HULLS and "cover" in paths):
            raise UsageError(f"{name} needs a scene, for its ellipsoids; add --scene to a cover")
        return True
    if "cover" not in paths:
        others = ", ".join(ELLIPSOID_FILTERS)
        raise UsageError(f"{name} needs a cover, for its hulls; in a scene --filter is {others} or none")
    return False


def _check_options(config: SimulateConfig, given: Set[str], *, splat: bool, has_plan: bool) -> None:
    """Refuse options that do not apply to these flights."""
    for field in dataclasses.fields(AlongPlanConfig):
        if field.name in given and not has_plan:
            raise UsageError(f"{_option_of(field.name)} is for flights of a plan")
    wrong = [name for name in (HULLS_ONLY if splat else ELLIPSOIDS_ONLY) if name in given]
    if wrong:
        others = "hulls of a cover" if splat else "ellipsoids of a scene"
        raise UsageError(f"{_option_of(wrong[0])} is for flights among the {others}")
    if not splat and config.filter_parameters and config.filter in ("none", "polytope-cbf"):
        known = (
            "no parameters"
            if config.filter == "none"
            else "the options --beta, --kappa, --smoothing and --onboard"
        )
        raise UsageError(f"--set: the filter {config.filter} has {known}")


def _check_pairs_from(context: click.Context, has_plan: bool) -> None:
    """Refuse options for random pairs, where those of another run are flown."""
    if has_plan:
        raise UsageError("--pairs-from: a plan has its own start and goal")
    for name in SAMPLING_ONLY:
        if options.is_given(context, name):
            raise UsageError(f"{_option_of(name)} is for random pairs; leave it out with --pairs-from")


def _option_of(name: str) -> str:
    """Option of a field of the configuration."""
    return options.option_of(next(f for f in dataclasses.fields(SimulateConfig) if f.name == name))


def _configured(
    context: click.Context, source: Path, config: SimulateConfig, seed: int, settings: tuple[str, ...]
) -> tuple[SimulateConfig, set[str]]:
    """Settings of the scenario, replaced by those of the command line, and the names of the fields given."""
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
        found.pop("confidence", None)  # it would set the same level
    if parameters:
        given["filter_parameters"] = {**found.get("filter_parameters", {}), **parameters}
    if guides:
        given["guide_parameters"] = {**found.get("guide_parameters", {}), **guides}
    try:
        return SimulateConfig(**{**found, **given}), found.keys() | given.keys()
    except UsageError as error:
        raise UsageError(f"{source}: {error}") from error


def setting_of(word: str) -> tuple[str, Any]:
    """Parse NAME=VALUE; the value is an integer, a number, a list with commas, true or false, else a word.

    Args:
        word: of --set.

    Raises:
        UsageError: name or value is missing, or the number is not finite.
    """
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
    """Write the log, and the record beside it."""
    from alula.cli.run_files import flight_timing, write_run
    from alula.schemas.run import RunRecord
    from alula.stages.runlog.runs import write_log

    record = RunRecord.of(
        provenance,
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
        flight_timing(result, config.dt_s * config.filter_ticks),
        lambda log: write_log(log, record, result.flights, result.map, frame),
    )


def _check_plan(output: Path, trial: TrialResult) -> None:
    """Raise CheckError when the flight of a plan did not do what the plan says."""
    from alula.schemas.run import PLAN_OUTCOMES
    from alula.stages.planning.adherence import complaint

    if trial.outcome == "reached":
        return
    words = complaint(trial.plan) if trial.outcome in PLAN_OUTCOMES else None
    raise CheckError(f"{output}: {words or f'the flight of the plan ended as {trial.outcome}'}")


def _check(output: Path, trials: list[Any], *, splat: bool) -> None:
    """Raise CheckError when a filtered flight came closer to the filter's map than the vehicle's radius."""
    from alula.stages.clearance import is_collision
    from alula.stages.verdict import minimum

    def clearance(trial: Any) -> Any:
        return minimum([trial.scene_clearance_m, trial.map_clearance_m]) if splat else trial.map_clearance_m

    hits = [trial for trial in trials if (trial.collision if splat else is_collision(clearance(trial)))]
    if hits:
        worst = min(hits, key=clearance)
        start = " ".join(f"{value:.3f}" for value in worst.start_m)
        raise CheckError(
            f"{output}: {len(hits)} of {len(trials)} filtered flights collided with the map; the deepest is "
            f"trial {worst.index} from ({start}), {-clearance(worst):.4g} m"
        )
