"""`fly`: files and options of one flight, checked, and the flight."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from alula.cli.shell.options import Common
from alula.cli.shell.present import echo
from alula.cli.shell.route import Route
from alula.cli.verbs.keywords import configured
from alula.schemas.errors import UsageError
from alula.schemas.parameters.configs.fly import FlyConfig

if TYPE_CHECKING:
    from alula.schemas.scenarios.scenario import Read
    from alula.schemas.scenarios.vehicle import Vehicle


def fly(
    source: Path,
    common: Common,
    fields: Mapping[str, Any],
    *,
    route: Route,
    map: Path | None = None,
    key: Path | None = None,
    scene: Path | None = None,
    within: Path | None = None,
    vehicle_name: str | None = None,
    link: str | None = None,
    settings: Mapping[str, Any],
    live: int | None = None,
    foxglove: int | None = None,
    start_time: str | None = None,
) -> None:
    """Fly a plan on a vehicle, write its log and its record, and print the verdict.

    Args:
        fields: of `FlyConfig`, those that are given; they take precedence over those of the scenario.
        key: that must have signed the tiles.

    Raises:
        UsageError, InputError: files and options do not go together.
        CheckError, LinkError, OutputError: see `flight.fly`.
    """
    from alula.cli.shell.run_files import check_log_name
    from alula.cli.shell.runner import check_output, input_ref
    from alula.cli.verbs.fly import flight
    from alula.cli.verbs.fly.inputs import inputs_of, is_among_ellipsoids
    from alula.cli.verbs.sources import read_tiles_of
    from alula.schemas.artifacts.artifact import in_memory
    from alula.schemas.artifacts.kinds import COVER, PLAN, SCENE, SEEN
    from alula.schemas.artifacts.lineage import require_own_map
    from alula.schemas.artifacts.parts_join import read_whole
    from alula.schemas.artifacts.provenance import Provenance, parameters_of
    from alula.schemas.extras import require
    from alula.schemas.log.run import RUN_SCHEMA, RUN_VERSION, record_path
    from alula.schemas.log.start_time import start_time_ns
    from alula.schemas.parameters.flight_defaults import filter_in
    from alula.schemas.scenarios.vehicle import contents
    from alula.schemas.scenarios.vehicles import vehicle_named
    from alula.stages.flight.mission import PlannedFlight, make_mission
    from alula.stages.vehicles.ground import ground_of

    if foxglove is not None:
        require("foxglove")
    if live is not None:
        require("viser")
    config = configured("fly", FlyConfig, fields)
    start_ns = None if start_time is None else start_time_ns(start_time)
    check_log_name(common.output)
    named, file = vehicle_named(vehicle_name)
    paths, scenario = inputs_of(source, map, scene, file.get("vehicle"), within)
    tiles = read_tiles_of(paths, key)
    flown = named if vehicle_name is not None else vehicle_named(paths.get("vehicle"))[0]
    if "filter" not in fields:
        config = dataclasses.replace(config, filter=filter_in(paths))
    if scenario is not None:
        config, link, flown = _from_scenario(
            fields, source, scenario, config, link, None if vehicle_name is None else flown
        )
    if link is None:
        raise UsageError("--link is needed: the address of a vehicle, or sim: for a simulated one")
    config = dataclasses.replace(config, filter_parameters={**config.filter_parameters, **settings})
    is_splat = is_among_ellipsoids(config.filter, paths)
    mission: PlannedFlight  # made below; the link asks for its ground when it is opened
    to_vehicle = route.link(
        link,
        flown,
        state_rate_hz=config.rate_hz,
        flies_rates=is_splat,
        ground=lambda: ground_of(mission.cover, mission.world.static.scene, mission.config.sigma),
    )
    check_output(common.output, paths)
    check_output(record_path(common.output), paths)
    for old in (common.output, record_path(common.output)):
        if old.exists() and not (common.force or common.dry_run):
            raise UsageError(f"{old}: exists; a flight is not continued; use -f to replace it")
    mission = make_mission(
        config,
        read_whole(paths["plan"], PLAN),
        flown,
        cover=read_whole(paths["cover"], COVER) if "cover" in paths else None,
        scene=in_memory(read_whole(paths["scene"], SCENE)) if "scene" in paths else None,
        is_splat=is_splat,
        tiles=tiles,
        within=None if within is None else read_whole(within, SEEN),
        jobs=common.jobs,
    )
    unused = ("filter_parameters",) if not mission.config.filter_parameters else ()
    parameters = {key: value for key, value in parameters_of(mission.config).items() if key not in unused}
    parameters |= {"vehicle": contents(flown)} | route.parameters(link)
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
    flight.fly(mission, to_vehicle, provenance, common, live, foxglove, start_ns, paths)


def _from_scenario(
    fields: Mapping[str, Any],
    source: Path,
    read: Read,
    config: FlyConfig,
    address: str | None,
    vehicle: Vehicle | None,
) -> tuple[FlyConfig, str | None, Vehicle]:
    """Configuration, link and vehicle of the scenario; options on the command line take precedence."""
    from alula.schemas.scenarios.defaults import vehicle_of
    from alula.schemas.scenarios.fly import flown_filter, flown_settings, flown_vehicle
    from alula.stages.compression.voxelize import sigma_of_confidence

    given = {name: getattr(config, name) for name in fields}
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
