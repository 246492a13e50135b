"""What all commands that fly share: options of the link, signals, priority, and errors of early ends."""

from __future__ import annotations

import math
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from alula.cli import options
from alula.schemas.errors import AlulaError, CheckError, LinkError

if TYPE_CHECKING:
    from alula.schemas.vehicle import Vehicle
    from alula.stages.flight.links.options import LinkOptions
    from alula.stages.flight.loop.control_loop import ControlLoop

F = TypeVar("F", bound=Callable[..., Any])

OPEN_S = 15.0  # maximum time until the first message of the vehicle


def of_link(function: F) -> F:
    """Add the options of a link besides its address; the function gets them by name, see `link_options`."""
    for option in (
        click.option(
            "--origin",
            type=options.POINT,
            cls=options.NumbersOption,
            default="0 0 0",
            show_default=True,
            help="Origin of the map in the vehicle's local frame, east north up [m].",
        ),
        click.option(
            "--yaw",
            type=options.FINITE_FLOAT,
            default=0.0,
            show_default=True,
            help="Angle from east to the map's x axis, counter-clockwise [degrees].",
        ),
        click.option(
            "--signing-key",
            "key_path",
            type=options.input_path(),
            help="Key that signs packets: a file of 32 bytes, or of 64 hexadecimal digits.",
        ),
        click.option(
            "--mocap",
            metavar="ADDRESS",
            help="Address at which motion capture is received, udp:HOST:PORT; it is forwarded to the "
            "vehicle.",
        ),
        click.option("--allow-remote", is_flag=True, help="Allow links to other machines than this one."),
    ):
        function = option(function)
    return function


def link_options(
    vehicle: Vehicle,
    *,
    allow_remote: bool,
    mocap: str | None,
    key_path: Path | None,
    yaw: float,
    origin: tuple[float, float, float],
    **more: Any,
) -> LinkOptions:
    """Options of a link from those of the command line.

    Args:
        vehicle: the vehicle file.
        allow_remote: see `of_link`, as for the next four.
        mocap: address of motion capture.
        key_path: file with the key.
        yaw: of the map [degrees].
        origin: of the map [m].
        more: further fields of `LinkOptions`.
    """
    from alula.stages.flight.links.mavlink.signing import read_key
    from alula.stages.flight.links.options import LinkOptions
    from alula.stages.vehicles.frames import LocalFrame

    return LinkOptions(
        frame=LocalFrame(math.radians(yaw), origin),
        vehicle=vehicle,
        key=None if key_path is None else read_key(key_path),
        signing_file=None if key_path is None else key_path.with_name(key_path.name + ".stamp"),
        mocap=mocap,
        allow_remote=allow_remote,
        **more,
    )


def stop(number: int, frame: object) -> None:
    """Interrupt the program before the loop runs: parameters are restored, and nothing has to land.

    Args:
        number: of the signal.
        frame: unused.
    """
    raise KeyboardInterrupt


@contextmanager
def signals(handler: Any) -> Iterator[None]:
    """Handle Ctrl-C, SIGTERM and a closed terminal by a function.

    Args:
        handler: the function.
    """
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)


@contextmanager
def priority() -> Iterator[None]:
    """Give this thread real-time priority if the system allows it; otherwise wake-ups are late."""
    before, parameter = os.sched_getscheduler(0), os.sched_getparam(0)
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(1))
    try:
        yield
    finally:
        with suppress(OSError):
            os.sched_setscheduler(0, before & ~os.SCHED_RESET_ON_FORK, parameter)


def failed_checks(loop: ControlLoop) -> AlulaError:
    """Error of a flight whose pre-flight checks do not hold.

    Args:
        loop: that has ended.
    """
    from alula.stages.flight.loop.supervisor import Event

    words = f"pre-flight: {loop.checks.failure() or 'took too long'}"
    is_of_link = loop.checks.is_of_link or loop.supervision.cause is Event.LINK_LOST
    return LinkError(words) if is_of_link else CheckError(words)


def is_of_vehicle(loop: ControlLoop) -> bool:
    """Whether the vehicle or its link ended a flight.

    Args:
        loop: that has ended.
    """
    from alula.stages.flight.loop.supervisor import Event

    of_vehicle = (
        *(Event.LINK_LOST, Event.FAILSAFE, Event.NOT_OBEYED, Event.ORDER_REFUSED, Event.ESTIMATOR_BAD),
        *(Event.DISARMED, Event.BATTERY_LOW, Event.FAILSAFE_IDLE, Event.OFF_CLIMB, Event.DRIFTS),
        *(Event.HEALTH_UNKNOWN, Event.PARAMETER_CHANGED, Event.CRASHED, Event.TURNED_OVER, Event.FALLEN),
    )
    return loop.supervision.cause in of_vehicle or not loop.counters.filter_s
