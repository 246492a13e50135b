"""Options of a link to a vehicle, for all commands that fly."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from alula.cli.shell import grouped, options

if TYPE_CHECKING:
    from alula.schemas.scenarios.vehicle import Vehicle
    from alula.stages.flight.links.protocol import Link

F = TypeVar("F", bound=Callable[..., Any])


class Route(NamedTuple):
    """Options of a link besides its address.

    Attributes:
        yaw: of the map [degrees].
        origin: of the map [m].
    """

    allow_remote: bool
    mocap: str | None
    key_path: Path | None
    yaw: float
    origin: tuple[float, float, float]

    def link(self, address: str, vehicle: Vehicle, **more: Any) -> Link:
        """Make the link to an address; nothing is sent yet.

        Args:
            more: further fields of `LinkOptions`.
        """
        from alula.schemas.artifacts.signing_key import read_key
        from alula.stages.flight.links.open_link import open_link
        from alula.stages.flight.links.options import LinkOptions
        from alula.stages.vehicles.frames import LocalFrame

        key = self.key_path
        of_link = LinkOptions(
            frame=LocalFrame(math.radians(self.yaw), self.origin),
            vehicle=vehicle,
            key=None if key is None else read_key(key),
            signing_file=None if key is None else key.with_name(key.name + ".stamp"),
            mocap=self.mocap,
            allow_remote=self.allow_remote,
            **more,
        )
        return open_link(address, of_link)

    def parameters(self, address: str) -> dict[str, Any]:
        """What a log or a file records of the link."""
        return {"link": address, "yaw_deg": self.yaw, "origin_m": list(self.origin)}


def of_link(function: F) -> F:
    """Add the options of a link besides its address; the function gets them as `route`."""

    @functools.wraps(function)
    def with_route(*args: Any, **given: Any) -> Any:
        return function(*args, route=Route(*(given.pop(name) for name in Route._fields)), **given)

    command: Any = with_route
    for option in (
        grouped.option(
            "--origin",
            group="Frame of the vehicle",
            type=options.POINT,
            cls=options.NumbersOption,
            default="0 0 0",
            show_default=True,
            help="Origin of the map in the vehicle's local frame, east north up [m].",
        ),
        grouped.option(
            "--yaw",
            group="Frame of the vehicle",
            type=options.FINITE_FLOAT,
            default=0.0,
            show_default=True,
            help="Angle from east to the map's x axis, counter-clockwise [degrees].",
        ),
        grouped.option(
            "--signing-key",
            "key_path",
            group="Link",
            type=options.PATH,
            help="Key that signs packets: a file of 32 bytes, or of 64 hexadecimal digits.",
        ),
        grouped.option(
            "--mocap",
            group="Link",
            metavar="ADDRESS",
            help="Address at which motion capture is received, udp:HOST:PORT; it is forwarded to the "
            "vehicle.",
        ),
        grouped.option(
            "--allow-remote", group="Link", is_flag=True, help="Allow links to other machines than this one."
        ),
    ):
        command = option(command)
    found: F = command
    return found
