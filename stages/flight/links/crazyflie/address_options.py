"""What the address of a Crazyflie says: its controller, what that flies, and parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass

from alula.schemas.errors import UsageError
from alula.stages.flight.links.addresses import Address
from alula.stages.flight.links.protocol import AccelerationSetpoint, Setpoint, VelocitySetpoint

# Numbers of stabilizer.controller, and what its controller flies. PID leaves accelerations out; Mellinger
# takes a velocity for the order to go down to height 0, and Lee for one to stop the motors.
CONTROLLERS: dict[str, tuple[int, type[Setpoint]]] = {
    "mellinger": (2, AccelerationSetpoint),
    "lee": (5, AccelerationSetpoint),
    "pid": (1, VelocitySetpoint),
    "oot": (6, VelocitySetpoint),
}
_SETPOINTS: dict[str, type[Setpoint]] = {"full-state": AccelerationSetpoint, "velocity": VelocitySetpoint}


@dataclass(frozen=True, slots=True)
class Choice:
    """Number of the controller, the set-points that it flies, parameters, and whether the watchdog is fed."""

    controller: int
    kind: type[Setpoint]
    parameters: dict[str, float]
    watches: bool


def read_choice(address: Address) -> Choice:
    """The options of an address.

    Raises:
        UsageError: one is unknown or means nothing, or the place of `udp:` is none.
    """
    named = {name: _number(name, value) for name, value in address.options.items() if "." in name}
    given = {name: value for name, value in address.options.items() if name not in named}
    Address(address.scheme, address.place, given).only("controller", "setpoints", "watchdog")
    if address.scheme == "udp":
        address.host_port()
    number, kind = _controller(given.get("controller", "mellinger"), given.get("setpoints"))
    return Choice(number, kind, named, _flag(given.get("watchdog", "0"), "watchdog"))


def _controller(name: str, setpoints: str | None) -> tuple[int, type[Setpoint]]:
    if setpoints is not None and setpoints not in _SETPOINTS:
        raise UsageError(f"setpoints={setpoints}: known are {' and '.join(_SETPOINTS)}")
    if name in CONTROLLERS:
        number, kind = CONTROLLERS[name]
        if setpoints is not None and _SETPOINTS[setpoints] is not kind:
            raise UsageError(f"setpoints={setpoints}: the controller {name} does not fly them")
        return number, kind
    if not name.isdecimal() or not 0 < int(name) < 256 or setpoints is None:
        raise UsageError(
            f"controller={name}: known are {', '.join(CONTROLLERS)}; "
            "or a number, with setpoints=full-state or velocity"
        )
    return int(name), _SETPOINTS[setpoints]


def _flag(text: str, name: str) -> bool:
    if text not in ("0", "1"):
        raise UsageError(f"{name}={text}: 0 or 1")
    return text == "1"


def _number(name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UsageError(f"{name}={text}: expected a number")
    return value
