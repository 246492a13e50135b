"""`alula fly`."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from alula.cli import grouped, options
from alula.cli.fly.contact import Route, of_link
from alula.cli.present import echo
from alula.cli.set_values import settings_of
from alula.schemas.configs.fly import FlyConfig
from alula.schemas.errors import UsageError

if TYPE_CHECKING:
    from alula.schemas.vehicle import Vehicle
    from alula.schemas.world import Read

EXAMPLES = """\b
Examples:
  alula fly room.plan.npz --map room.cover.npz --link udpin:127.0.0.1:14550 -o first.run.mcap --dry-run
  alula fly room.plan.npz --map room.metric.scene.npz --filter cone-backup --link sim: -o fast.run.mcap
"""


@grouped.command(epilog=EXAMPLES)
@click.argument("source", type=options.input_path())
@click.option(
    "--map",
    "map_path",
    type=options.input_path(),
    help="Cover, tiles or scene to fly in; required with a plan.",
)
@grouped.option(
    "--key",
    "tiles_key",
    group="Maps in tiles",
    type=options.input_path(),
    help="Key that must have signed the tiles.",
)
@click.option("--scene", "scene_path", type=options.input_path(), help="Metric scene, if --map is a cover.")
@grouped.option(
    "--within",
    group="Flight",
    type=options.input_path(),
    help="Seen space (.seen.npz) to stay in, beside a cover; unseen space counts like hulls.",
)
@options.vehicle("Built-in vehicle, or vehicle file (.toml); default: the quadrotor of FastBridge.")
@click.option(
    "--link",
    "address",
    metavar="ADDRESS",
    help="Link to the vehicle: udpin:HOST:PORT, udpout:…, tcp:…, serial:DEVICE:BAUD, or sim: for a simulated "
    "one.",
)
@of_link
@options.settings("Parameter of a filter among ellipsoids; may be repeated.", "Filter")
@click.option(
    "--live",
    type=options.Whole(1, 65535),
    is_flag=False,
    flag_value=8080,
    metavar="[PORT]",
    help="Show the flight in a browser, at this port of this machine only (8080).",
)
@grouped.option(
    "--foxglove",
    group="Log",
    type=options.Whole(1, 65535),
    is_flag=False,
    flag_value=8765,
    metavar="[PORT]",
    help="Serve the live channels to Foxglove, at this port of this machine only (8765); requires "
    "alula[foxglove].",
)
@grouped.option(
    "--start-time",
    group="Log",
    metavar="TIME",
    help="Time of the start in the log, such as 2026-05-01T12:00:00Z; default: by the clock of this machine.",
)
@options.from_config(FlyConfig)
@options.output(".run.mcap")
@click.pass_context
def command(
    context: click.Context,
    source: Path,
    map_path: Path | None,
    tiles_key: Path | None,
    scene_path: Path | None,
    within: Path | None,
    vehicle_name: str | None,
    address: str | None,
    route: Route,
    settings: tuple[str, ...],
    live: int | None,
    foxglove: int | None,
    start_time: str | None,
    config: FlyConfig,
    common: options.Common,
) -> None:
    """Fly a plan on a real vehicle, behind a safety filter.

    SOURCE is a plan, with --map and --link, or a scenario (.toml) with a plan. The table [fly] of a scenario
    sets the link and options of this command. After the pre-flight checks the vehicle arms, takes off to the
    height of the plan's start, flies the plan and lands. docs/guide/fly.md describes all other courses.
    --dry-run runs the checks and does not arm. Ctrl-C lands the vehicle; a second Ctrl-C stops the motors,
    but only on the ground. The pilot can take control at any time; this command then sends nothing more.

    The log is written during the flight; R.run.json beside it holds the summary and the measured times. Exit
    code 3: an input cannot be read, or the flight went well, but its log or record is not complete; 4: a
    check does not hold, the plan was not finished, or the flight came closer to the map than the vehicle's
    radius; 6: the link or the vehicle failed.
    """
    from alula.cli.fly.flight import fly
    from alula.cli.fly.inputs import inputs_of, is_among_ellipsoids
    from alula.cli.run_files import check_log_name
    from alula.cli.runner import check_output, input_ref
    from alula.cli.sources import read_tiles_of
    from alula.schemas.extras import require
    from alula.schemas.flight_defaults import filter_in
    from alula.schemas.kinds import COVER, PLAN, SCENE, SEEN
    from alula.schemas.lineage import require_own_map
    from alula.schemas.parts_join import read_whole
    from alula.schemas.provenance import Provenance, parameters_of
    from alula.schemas.run import RUN_SCHEMA, RUN_VERSION, record_path
    from alula.schemas.start_time import start_time_ns
    from alula.schemas.vehicle import contents
    from alula.schemas.vehicles import vehicle_named
    from alula.stages.flight.mission import Mission, make_mission
    from alula.stages.vehicles.ground import ground_of

    if foxglove is not None:
        require("foxglove")
    if live is not None:
        require("viser")
    start_ns = None if start_time is None else start_time_ns(start_time)
    check_log_name(common.output)
    named, file = vehicle_named(vehicle_name)
    paths, scenario = inputs_of(source, map_path, scene_path, file.get("vehicle"), within)
    tiles = read_tiles_of(paths, tiles_key)
    vehicle = named if vehicle_name is not None else vehicle_named(paths.get("vehicle"))[0]
    if not options.is_given(context, "filter"):
        config = dataclasses.replace(config, filter=filter_in(paths))
    if scenario is not None:
        config, address, vehicle = _from_scenario(
            context, source, scenario, config, address, None if vehicle_name is None else vehicle
        )
    if address is None:
        raise UsageError("--link is needed: the address of a vehicle, or sim: for a simulated one")
    config = dataclasses.replace(
        config, filter_parameters={**config.filter_parameters, **settings_of(settings)}
    )
    is_splat = is_among_ellipsoids(config.filter, paths)
    mission: Mission  # made below; the link asks for its ground when it is opened
    link = route.link(
        address,
        vehicle,
        state_rate_hz=config.rate_hz,
        flies_rates=is_splat,
        ground=lambda: ground_of(mission.cover, mission.scene, mission.config.sigma),
    )
    check_output(common.output, paths)
    check_output(record_path(common.output), paths)
    for old in (common.output, record_path(common.output)):
        if old.exists() and not (common.force or common.dry_run):
            raise UsageError(f"{old}: exists; a flight is not continued; use -f to replace it")
    mission = make_mission(
        config,
        read_whole(paths["plan"], PLAN),
        vehicle,
        cover=read_whole(paths["cover"], COVER) if "cover" in paths else None,
        scene=read_whole(paths["scene"], SCENE) if "scene" in paths else None,
        is_splat=is_splat,
        tiles=tiles,
        within=None if within is None else read_whole(within, SEEN),
        jobs=common.jobs,
    )
    unused = ("filter_parameters",) if not mission.config.filter_parameters else ()
    parameters = {key: value for key, value in parameters_of(mission.config).items() if key not in unused}
    parameters |= {"vehicle": contents(vehicle)} | route.parameters(address)
    provenance = Provenance.now(
        RUN_SCHEMA, RUN_VERSION, parameters, None, [input_ref(role, path) for role, path in paths.items()]
    )
    note = require_own_map(
        paths["plan"],
        mission.plan.manifest,  # type: ignore[arg-type]
        provenance.inputs,
        [path.parent for path in paths.values()],
        allow_other=config.allow_other_map,
        insist="--allow-other-map",
    )
    if note is not None:
        mission.notes.append(note)
        if not common.quiet:
            echo(f"note: {note}", err=True)
    fly(mission, link, provenance, common, live, foxglove, start_ns, paths)


def _from_scenario(
    context: click.Context,
    source: Path,
    read: Read,
    config: FlyConfig,
    address: str | None,
    vehicle: Vehicle | None,
) -> tuple[FlyConfig, str | None, Vehicle]:
    """Configuration, link and vehicle of the scenario; options on the command line take precedence."""
    from alula.schemas.world_defaults import vehicle_of
    from alula.schemas.world_fly import flown_filter, flown_settings, flown_vehicle
    from alula.stages.compression.voxelize import sigma_of_confidence

    given = {
        item.name: getattr(config, item.name)
        for item in dataclasses.fields(config)
        if options.is_given(context, item.name)
    }
    try:
        name = given.get("filter") or flown_filter(read) or config.filter
        settings: dict[str, Any] = {"filter": name} | flown_settings(read, name)
        if (confidence := read.scenario.world.confidence) is not None:
            settings["sigma"] = sigma_of_confidence(confidence)
        link = settings.pop("link", None)
        config = FlyConfig(**(settings | given))
        vehicle = flown_vehicle(read.scenario, vehicle or vehicle_of(read.scenario, source.parent))
    except UsageError as error:
        raise UsageError(f"{source}: {error}") from error
    return config, address or link, vehicle
