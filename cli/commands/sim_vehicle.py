"""`alula sim-vehicle`."""

from __future__ import annotations

import math
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import click

from alula.cli.shell import grouped, options
from alula.cli.shell.present import echo
from alula.schemas.errors import UsageError

if TYPE_CHECKING:
    from alula.stages.sim_vehicle.common.endpoint import Vehicle
    from alula.stages.vehicles.ground import Ground

_CRTP = "udp://"


@grouped.command(
    "sim-vehicle",
    epilog="""Examples:

\b
  alula sim-vehicle --link udpout:127.0.0.1:14550
  alula sim-vehicle --link tcpin:127.0.0.1:5760 --boot-time 5 --param GUID_OPTIONS=8
  alula sim-vehicle --autopilot px4 --link udpout:127.0.0.1:14540
  alula sim-vehicle --link udp://127.0.0.1:19850 --vehicle crazyflie21
  alula sim-vehicle --link udpin:127.0.0.1:14551 --fault drop:since=airborne,start=5,duration=2""",
)
@click.option(
    "--link",
    required=True,
    metavar="KIND:HOST:PORT",
    help="udpout: send to HOST:PORT, as ArduPilot's simulation does; udpin, tcpin: listen there; "
    "udp://HOST:PORT: simulate a Crazyflie there.",
)
@click.option(
    "--autopilot",
    type=click.Choice(["ardupilot", "px4"]),
    default="ardupilot",
    show_default=True,
    help="Firmware to simulate.",
)
@options.vehicle("Built-in vehicle, or vehicle file (.toml); default: the quadrotor of FastBridge.")
@click.option(
    "--boot-time",
    "boot_time_s",
    type=options.FINITE_FLOAT,
    default=36.0,
    show_default=True,
    help="Time from boot until the estimator has settled, with satellites [s].",
)
@click.option(
    "--param",
    "parameters",
    multiple=True,
    metavar="NAME=VALUE",
    help="Value of a parameter at boot; may be repeated.",
)
@click.option(
    "--fault",
    "faults",
    multiple=True,
    metavar="KIND[:KEY=VALUE,...]",
    help="Fault to inject; keys: start, duration, probability, amount, way, since. May be repeated.",
)
@grouped.option(
    "--mocap",
    "mocap_address",
    group="Motion capture",
    metavar="udp:HOST:PORT",
    help="Send the true pose to this address as motion capture, for fly --mocap.",
)
@grouped.option(
    "--mocap-start",
    group="Motion capture",
    type=options.POINT,
    cls=options.NumbersOption,
    default="0 0 0",
    show_default=True,
    help="Initial position in the map, and in the frame of motion capture, east north up [m].",
)
@grouped.option(
    "--hand",
    group="Motion capture",
    is_flag=True,
    help="Simulate a hand that moves the vehicle, for fly --frame-check hand.",
)
@click.option(
    "--ground",
    "ground_path",
    type=options.PATH,
    help="Cover whose height below the vehicle is the ground, with --mocap-start; default: a flat floor.",
)
@click.option(
    "--heading",
    "heading_deg",
    type=options.FINITE_FLOAT,
    default=0.0,
    show_default=True,
    help="Initial heading, clockwise from north [degrees].",
)
@grouped.option(
    "--signing-key",
    group="Signatures and other machines",
    type=options.PATH,
    help="File with the key for MAVLink 2 signatures; unsigned packets are then refused.",
)
@grouped.option(
    "--console",
    group="Signatures and other machines",
    is_flag=True,
    help="Simulate the console port, which accepts unsigned packets even with --signing-key.",
)
@click.option("--duration", "duration_s", type=options.FINITE_FLOAT, help="Stop after this time [s].")
@grouped.option(
    "--allow-remote",
    group="Signatures and other machines",
    is_flag=True,
    help="Allow a link to another machine.",
)
@options.common(
    "--seed", type=options.Whole(0), default=0, show_default=True, help="Seed of noise and faults."
)
@options.reporting
def command(
    link: str,
    autopilot: str,
    vehicle_name: str | None,
    boot_time_s: float,
    parameters: tuple[str, ...],
    faults: tuple[str, ...],
    mocap_address: str | None,
    mocap_start: tuple[float, float, float],
    hand: bool,
    ground_path: Path | None,
    heading_deg: float,
    signing_key: Path | None,
    console: bool,
    seed: int,
    duration_s: float | None,
    allow_remote: bool,
    json: bool,
    quiet: bool,
    verbose: int,
) -> None:
    """Simulate a MAVLink vehicle that behaves like ArduPilot Copter or PX4."""
    import json as json_module
    import time

    from alula.schemas.artifacts.kinds import COVER
    from alula.schemas.artifacts.parts_join import read_whole
    from alula.stages.sim_vehicle.common.endpoint import open_endpoint, open_mocap, serve
    from alula.stages.vehicles.ground import ground_of

    if not 0 < boot_time_s <= 3600:
        raise UsageError("--boot-time must be in 0..3600 s")
    if duration_s is not None and duration_s <= 0:
        raise UsageError("--duration must be positive")
    if mocap_address is None and ground_path is None and any(mocap_start):
        raise UsageError("--mocap-start needs --mocap or --ground")
    values = dict(_parameter(text) for text in parameters)
    ground = None if ground_path is None else ground_of(read_whole(ground_path, COVER))
    vehicle: Vehicle
    if link.startswith(_CRTP):
        if faults or signing_key is not None or console or hand or autopilot != "ardupilot":
            raise UsageError(
                "a simulated Crazyflie has no --fault, --signing-key, --console, --hand or --autopilot"
            )
        name, vehicle = _crazyflie(
            vehicle_name,
            values,
            yaw_rad=-math.radians(heading_deg),
            poses=mocap_address is not None,
            start=mocap_start,
            ground=ground,
            seed=seed,
        )
        link = f"udpin:{link.removeprefix(_CRTP)}"
    else:
        from alula.schemas.artifacts.signing_key import read_key
        from alula.schemas.scenarios.vehicles import vehicle_named
        from alula.stages.sim_vehicle.common.airframe import Terrain
        from alula.stages.sim_vehicle.common.estimator import EstimatorOptions
        from alula.stages.sim_vehicle.common.faults import parse_fault
        from alula.stages.sim_vehicle.common.hand import Hand
        from alula.stages.sim_vehicle.simulator import FIRMWARES, SimulatedVehicle

        firmware = FIRMWARES[autopilot]
        copter = firmware.copter(
            vehicle_named(vehicle_name)[0],
            parameters=values,
            options=EstimatorOptions(boot_time_s=boot_time_s),
            heading_rad=math.radians(heading_deg),
            seed=seed,
            hand=Hand() if hand else None,
            terrain=None if ground is None else Terrain(ground, mocap_start),
        )
        name, vehicle = (
            copter.name,
            SimulatedVehicle(
                copter,
                faults=tuple(parse_fault(text, firmware.switch) for text in faults),
                seed=seed,
                channel=0 if console or signing_key is None else 1,
                key=None if signing_key is None else read_key(signing_key),
                epoch_s=time.time(),
                camera_start=mocap_start,
            ),
        )
    with ExitStack() as opened:
        endpoint = open_endpoint(link, allow_remote=allow_remote)
        opened.callback(endpoint.close)
        mocap = None if mocap_address is None else open_mocap(mocap_address, allow_remote=allow_remote)
        if mocap is not None:
            opened.callback(mocap.close)
        if json:
            ready = {"link": endpoint.name, "vehicle": name, "boot_time_s": boot_time_s, "seed": seed}
            echo(json_module.dumps(ready))
        elif not quiet:
            echo(f"{name} is on {endpoint.name}")
        sys.stdout.flush()
        lost_s = serve(vehicle, endpoint, mocap=mocap, duration_s=duration_s)
        if lost_s and not quiet:
            echo(f"alula: the machine was too slow; {lost_s:.1f} s were not simulated", err=True)


def _crazyflie(
    vehicle_name: str | None,
    values: dict[str, float],
    *,
    yaw_rad: float,
    poses: bool,
    start: tuple[float, float, float],
    ground: Ground | None,
    seed: int,
) -> tuple[str, Vehicle]:
    from alula.schemas.scenarios.vehicles import vehicle_named
    from alula.stages.sim_vehicle.crazyflie.vehicle import CrazyflieOptions, SimulatedCrazyflie

    if vehicle_name is None:
        raise UsageError("a simulated Crazyflie needs --vehicle, such as crazyflie21")
    vehicle, _ = vehicle_named(vehicle_name)
    has_app = any(name.startswith("alula.") for name in values)
    crazyflie = SimulatedCrazyflie(
        vehicle,
        CrazyflieOptions(
            start=start, yaw_rad=yaw_rad, arms_itself=True, needs_poses=poses, has_app=has_app, seed=seed
        ),
    )
    if ground is not None:
        crazyflie.body.stand_on(ground)
    crazyflie.set_parameters(values)
    return f"{vehicle.name}, a simulated Crazyflie,", crazyflie


def _parameter(text: str) -> tuple[str, float]:
    name, equals, value = text.partition("=")
    if not equals:
        raise UsageError(f"--param {text!r}: write NAME=VALUE")
    try:
        return name.strip(), float(value)
    except ValueError:
        raise UsageError(f"--param {text!r}: {value!r} is not a number") from None
