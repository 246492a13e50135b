"""Options in the address of a Crazyflie: controller, kind of set-points, watchdog, parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass

from alula.schemas.errors import UsageError
from alula.stages.flight.links.addresses import Address
from alula.stages.vehicles.setpoints import AccelerationSetpoint, Setpoint, VelocitySetpoint

# Values of stabilizer.controller, and the set-points that each controller can fly. PID ignores accelerations.
# Given a velocity, Mellinger descends to height 0 and Lee stops the motors.
CONTROLLERS: dict[str, tuple[int, type[Setpoint]]] = {
    "mellinger": (2, AccelerationSetpoint),
    "lee": (5, AccelerationSetpoint),
    "pid": (1, VelocitySetpoint),
    "oot": (6, VelocitySetpoint),
}
_SETPOINTS: dict[str, type[Setpoint]] = {"full-state": AccelerationSetpoint, "velocity": VelocitySetpoint}


@dataclass(frozen=True, slots=True)
class AddressOptions:
    """Options in the address of a Crazyflie.

    Attributes:
        kind: set-points that this controller follows.
    """

    controller: int
    kind: type[Setpoint]
    parameters: dict[str, float]
    has_watchdog: bool


def read_address_options(address: Address) -> AddressOptions:
    """Read and check the options of an address.

    Args:
        address: the parsed address; names with a dot are parameters of the vehicle.

    Raises:
        UsageError: an option is unknown or has an invalid value, or `udp:` has no HOST:PORT.
    """
    named = {name: _number(name, value) for name, value in address.options.items() if "." in name}
    given = {name: value for name, value in address.options.items() if name not in named}
    Address(address.scheme, address.place, given).only("controller", "setpoints", "watchdog")
    if address.scheme == "udp":
        address.host_port()
    number, kind = _controller(given.get("controller", "mellinger"), given.get("setpoints"))
    return AddressOptions(number, kind, named, _flag(given.get("watchdog", "0"), "watchdog"))


def _controller(name: str, setpoints: str | None) -> tuple[int, type[Setpoint]]:
    if setpoints is not None and setpoints not in _SETPOINTS:
        raise UsageError(f"setpoints={setpoints}: must be {' or '.join(_SETPOINTS)}")
    if name in CONTROLLERS:
        number, kind = CONTROLLERS[name]
        if setpoints is not None and _SETPOINTS[setpoints] is not kind:
            raise UsageError(f"setpoints={setpoints}: the controller {name} does not follow them")
        return number, kind
    if not name.isdecimal() or not 0 < int(name) < 256 or setpoints is None:
        raise UsageError(
            f"controller={name}: must be {', '.join(CONTROLLERS)}, "
            "or a number with setpoints=full-state or velocity"
        )
    return int(name), _SETPOINTS[setpoints]


def _flag(text: str, name: str) -> bool:
    if text not in ("0", "1"):
        raise UsageError(f"{name}={text}: must be 0 or 1")
    return text == "1"


def _number(name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UsageError(f"{name}={text}: expected a number")
    return value
