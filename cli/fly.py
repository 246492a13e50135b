"""`alula fly`."""

from __future__ import annotations

import dataclasses
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from alula.cli import options
from alula.cli.interruption import InterruptedWithAdvice
from alula.schemas.configs.fly import FlyConfig
from alula.schemas.errors import CheckError, InputError, LinkError, UsageError

if TYPE_CHECKING:
    from alula.schemas.provenance import Provenance
    from alula.schemas.run import RunRecord
    from alula.schemas.scenario import Scenario
    from alula.stages.flight.control_loop import ControlLoop
    from alula.stages.flight.flight_log import FlightRecorder
    from alula.stages.flight.fly import Mission
    from alula.stages.flight.links.protocol import Link

EXAMPLES = """\b
Examples:
  alula fly room.plan.npz --map room.cover.npz --link udpin:127.0.0.1:14550 -o first.run.mcap --dry-run
  alula fly room.plan.npz --map room.metric.scene.npz --filter cone-backup --link sim: -o fast.run.mcap
"""

_OPEN_S = 15.0  # for the vehicle to be heard


@click.command(epilog=EXAMPLES)
@click.argument("source", type=options.input_path())
@click.option(
    "--map", "map_path", type=options.input_path(), help="Cover or scene to fly in; needed with a plan."
)
@click.option(
    "--scene", "scene_path", type=options.input_path(), help="Metric scene, beside a cover as --map."
)
@click.option(
    "--vehicle",
    "vehicle_path",
    type=options.input_path(),
    help="What flies (.toml); default: the quadrotor of FastBridge.",
)
@click.option(
    "--link",
    "address",
    metavar="ADDRESS",
    help="The vehicle: udpin:HOST:PORT, udpout:…, tcp:…, serial:DEVICE:BAUD, or sim: for a simulated one.",
)
@click.option("--allow-remote", is_flag=True, help="Speak to other machines than this one, too.")
@click.option(
    "--mocap", metavar="ADDRESS", help="Where motion capture is heard, udp:HOST:PORT, and passed on."
)
@click.option(
    "--signing-key",
    "key_path",
    type=options.input_path(),
    help="File of 32 bytes, or 64 hexadecimal digits, that packets are signed with.",
)
@click.option(
    "--yaw",
    type=options.FINITE_FLOAT,
    default=0.0,
    show_default=True,
    help="From east to the map's x axis, counter-clockwise [degrees].",
)
@click.option(
    "--origin",
    type=options.POINT,
    default="0 0 0",
    show_default=True,
    help="The map's origin in the vehicle's local frame, east north up [m].",
)
@click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="NAME=VALUE",
    help="Parameter of a filter among ellipsoids; may be repeated.",
)
@options.from_config(FlyConfig)
@options.output(".run.mcap")
@click.pass_context
def command(
    context: click.Context,
    source: Path,
    map_path: Path | None,
    scene_path: Path | None,
    vehicle_path: Path | None,
    address: str | None,
    allow_remote: bool,
    mocap: str | None,
    key_path: Path | None,
    yaw: float,
    origin: tuple[float, float, float],
    settings: tuple[str, ...],
    config: FlyConfig,
    common: options.Common,
) -> None:
    """Fly a plan on a real vehicle, behind a safety filter.

    SOURCE is a plan with --map and --link, or a scenario (.toml) with a plan, whose table [fly] has the link
    and options of this command. After the pre-flight checks the vehicle arms, takes off to the height of the
    plan's start, flies the plan and lands; docs/fly.md says what else may happen. --dry-run makes all checks
    and arms nothing. Ctrl-C lands; a second one stops the motors, on the ground only. The pilot may take the
    vehicle at any time, and keeps it.

    The log is written while it flies; R.run.json beside it holds the summary and the measured times. Exit
    code 4: a check does not hold, the plan was not finished, or the flight touched the map; 6: link or vehicle.
    """
    import math

    from alula.cli.runner import check_output, input_ref
    from alula.cli.simulate import is_among_ellipsoids, setting_of
    from alula.schemas.artifact import read_artifact
    from alula.schemas.kinds import COVER, PLAN, SCENE
    from alula.schemas.provenance import Provenance, parameters_of
    from alula.schemas.run import RUN_SCHEMA, RUN_SUFFIX, RUN_VERSION, record_path
    from alula.schemas.vehicle import FASTBRIDGE, contents, read_vehicle
    from alula.stages.flight.fly import make_mission
    from alula.stages.flight.frames import LocalFrame
    from alula.stages.flight.links.open_link import open_link
    from alula.stages.flight.links.options import LinkOptions

    if not common.output.name.endswith(".mcap"):
        raise UsageError(f"{common.output}: the output must end in .mcap (usually {RUN_SUFFIX})")
    paths, scenario = _inputs(source, map_path, scene_path, vehicle_path)
    if scenario is not None:
        config, address = _from_scenario(context, source, config, address, scenario)
    if address is None:
        raise UsageError("--link is needed: which vehicle to fly, or sim: for a simulated one")
    config = dataclasses.replace(
        config, filter_parameters={**config.filter_parameters, **dict(setting_of(word) for word in settings)}
    )
    is_splat = is_among_ellipsoids(config.filter, paths)
    vehicle = read_vehicle(paths["vehicle"]) if "vehicle" in paths else FASTBRIDGE
    link = open_link(
        address,
        LinkOptions(
            frame=LocalFrame(math.radians(yaw), origin),
            vehicle=vehicle,
            state_rate_hz=config.rate_hz,
            key=None if key_path is None else _key(key_path),
            signing_file=None if key_path is None else key_path.with_name(key_path.name + ".stamp"),
            mocap=mocap,
            allow_remote=allow_remote,
        ),
    )
    check_output(common.output, paths)
    check_output(record_path(common.output), paths)
    if common.output.exists() and not (common.force or common.dry_run):
        raise UsageError(f"{common.output}: exists; every flight is a new one; -f replaces it")
    mission = make_mission(
        config,
        read_artifact(paths["plan"], PLAN),
        vehicle,
        cover=read_artifact(paths["cover"], COVER) if "cover" in paths else None,
        scene=read_artifact(paths["scene"], SCENE) if "scene" in paths else None,
        is_splat=is_splat,
        jobs=common.jobs,
    )
    unused = ("filter_parameters",) if not mission.config.filter_parameters else ()
    parameters = {key: value for key, value in parameters_of(mission.config).items() if key not in unused}
    parameters |= {"vehicle": contents(vehicle), "link": address, "yaw_deg": yaw, "origin_m": list(origin)}
    provenance = Provenance.now(
        RUN_SCHEMA, RUN_VERSION, parameters, None, [input_ref(role, path) for role, path in paths.items()]
    )
    _fly(mission, link, provenance, common)


def _inputs(
    source: Path, map_path: Path | None, scene: Path | None, vehicle: Path | None
) -> tuple[dict[str, Path], Scenario | None]:
    """All files to read, by role, and the scenario if there is one."""
    from alula.cli.simulate import inputs_of
    from alula.schemas.scenario import read_scenario

    paths = inputs_of(source, map_path, scene, vehicle)
    if "plan" not in paths:
        raise UsageError(f"{source}: only a plan can be flown; make one with alula plan")
    if source.suffix != ".toml":
        return paths, None
    return paths, read_scenario(source)


def _from_scenario(
    context: click.Context, source: Path, config: FlyConfig, address: str | None, scenario: Scenario
) -> tuple[FlyConfig, str | None]:
    """What the scenario says, replaced by what the command line does."""
    found = scenario.fly_settings()
    link = found.pop("link", None)
    names = {f.name for f in dataclasses.fields(config)}
    given = {name: getattr(config, name) for name in names if options.is_given(context, name)}
    try:
        return FlyConfig(**{**found, **given}), address or link
    except UsageError as error:
        raise UsageError(f"{source}: {error}") from error


def _key(path: Path) -> bytes:
    """A signing key from a file."""
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot read: {error.strerror}") from error
    if len(raw) == 32:
        return raw
    try:
        key = bytes.fromhex(raw.decode("ascii").strip())
    except (UnicodeDecodeError, ValueError):
        key = b""
    if len(key) != 32:
        raise InputError(f"{path}: a signing key is 32 bytes, or 64 hexadecimal digits")
    return key


def _fly(mission: Mission, link: Link, provenance: Provenance, common: options.Common) -> None:
    """Open the link, fly, close it, and write what there is to write."""
    from alula.stages.flight.control_loop import ControlLoop
    from alula.stages.flight.flight_checks import FlightChecks
    from alula.stages.flight.flight_log import FlightHead, FlightRecorder
    from alula.stages.flight.fly import (
        head_facts,
        make_clock,
        make_commander,
        make_guard,
        make_needs,
        make_options,
    )
    from alula.stages.flight.log import map_message

    interrupts = 0

    def asked() -> int:
        return interrupts

    def count(number: int, frame: object) -> None:
        nonlocal interrupts
        interrupts += 1

    recorder: FlightRecorder | None = None
    try:
        what = link.open(_OPEN_S)
        if not common.quiet:
            click.echo(f"link: {what}", err=True)
        trouble, changed = "", list[str]()
        try:
            changed = link.prepare()
        except LinkError as error:
            trouble = str(error)
        commander, wanted = make_commander(mission, link.accepts, jobs=common.jobs)
        head = FlightHead(
            provenance=provenance,
            map_message=map_message(
                mission.map, {"sigma": mission.config.sigma}, [_points(mission)], mission.map.manifest.frame
            ),
            **head_facts(mission),
        )
        checks = FlightChecks(
            make_needs(mission, wanted),
            changed=changed,
            trouble=trouble,
            by_hand=mission.config.frame_check == "hand",
        )
        if common.force and not common.dry_run:
            common.output.unlink(missing_ok=True)
        recorder = FlightRecorder(None if common.dry_run else common.output, head, echo=not common.quiet)
        loop = ControlLoop(
            link,
            commander,
            make_guard(mission, link.accepts),
            make_clock(mission),
            checks,
            float(mission.start[2]),
            recorder,
            make_options(mission.config, dry_run=common.dry_run),
            interrupts=asked,
        )
        with _signals(count):
            loop.run()
            link.close()
            _finish(mission, loop, recorder, provenance, common)
    except BaseException:
        link.close()
        if recorder is not None:
            recorder.finish(None)
        raise
    _conclude(mission, loop, checks.is_of_link, checks.failure(), common)


def _points(mission: Mission) -> Any:
    """Points of the plan, shape (T, 3)."""
    from alula.stages.flight.reference import sample_plan

    return sample_plan(mission.plan, 0.1).position_world


@contextmanager
def _signals(handler: Any) -> Iterator[None]:
    """Ctrl-C, SIGTERM and a closed terminal are counted: what they mean is for the supervisor."""
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)


def _finish(
    mission: Mission,
    loop: ControlLoop,
    recorder: FlightRecorder,
    provenance: Provenance,
    common: options.Common,
) -> None:
    """The end of the log, and the record beside it; a flight that never flew leaves neither."""
    import platform

    import msgspec

    from alula.cli.runner import show
    from alula.schemas.run import RUN_SCHEMA, RUN_VERSION, RunRecord, record_path
    from alula.stages.flight.fly import describe
    from alula.stages.flight.fly_judge import guarantee_of, judge, summary_of, timing_of

    rows = recorder.rows
    timing = timing_of(loop.counters, recorder.dropped, mission.config.rate_hz)
    if len(rows) == 0:
        recorder.finish(None)
        if not common.dry_run:
            common.output.unlink(missing_ok=True)
        elif loop.checks.result:
            show(common, "dry-run", {v.name: v.words for v in loop.checks.verdicts} | timing)
        return
    trial = judge(mission, rows, loop.supervision.cause, common.jobs)
    summary = summary_of(trial, loop.supervision, loop.taken)
    record = RunRecord(
        schema=RUN_SCHEMA,
        version=RUN_VERSION,
        provenance=msgspec.structs.replace(provenance, summary=summary),
        name=mission.config.name,
        filter=mission.config.filter,
        vehicle=describe(mission),
        trials=[trial],
        summary=summary,
        guarantee=guarantee_of(mission, trial),
    )
    if not recorder.finish(record):
        summary = summary | {"notes": ["the log is not complete: its writer failed"]}
    timing = timing_of(loop.counters, recorder.dropped, mission.config.rate_hz)
    machine = {"cpu_count": os.cpu_count(), "machine": platform.machine(), "system": platform.system()}
    _write_record(record_path(common.output), msgspec.structs.replace(record, timing=machine | timing))
    show(common, "written", summary | {f"{key}": timing[key] for key in _SHOWN if key in timing})


_SHOWN = ("rate_hz", "ticks", "tick_p99_s", "lateness_p99_s", "overruns", "dropped_samples")


def _write_record(path: Path, record: RunRecord) -> None:
    import msgspec

    from alula.schemas.atomic import atomic_output

    with atomic_output(path) as beside:
        beside.write(msgspec.json.format(msgspec.json.encode(record, order="sorted"), indent=2) + b"\n")


def _conclude(
    mission: Mission, loop: ControlLoop, is_of_link: bool, failure: str, common: options.Common
) -> None:
    """Fail as the flight did.

    Raises:
        CheckError, LinkError, KeyboardInterrupt: how it ended, unless well.
    """
    from alula.schemas.run import read_run
    from alula.stages.flight.supervisor import Event

    cause = loop.supervision.cause
    if cause is Event.CHECKS_PASSED_DRY:
        return
    if cause in (Event.INTERRUPT, Event.INTERRUPT_IN_AIR, Event.INTERRUPT_ON_GROUND):
        raise InterruptedWithAdvice("the flight ended early")
    if loop.checks.result is not True:
        words = f"pre-flight: {failure or 'took too long'}"
        raise LinkError(words) if is_of_link or cause is Event.LINK_LOST else CheckError(words)
    of_vehicle = (
        *(Event.LINK_LOST, Event.FAILSAFE, Event.NOT_OBEYED, Event.ORDER_REFUSED, Event.ESTIMATOR_BAD),
        *(Event.DISARMED, Event.BATTERY_LOW),
    )
    said = "no reason is known" if cause is None else cause.value
    if cause in of_vehicle or not loop.counters.filter_s:
        raise LinkError(f"the flight ended early: {said}")
    if cause is not Event.PLAN_FINISHED:
        raise CheckError(f"{common.output}: the plan was not finished: {said}")
    trial = read_run(common.output).trials[0]
    if trial.collision:
        raise CheckError(f"{common.output}: the flight came closer to the map than the vehicle's radius")
