"""Table of PX4's flight modes: numbers, names, requirements and controllers."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from alula.stages.sim_vehicle.ardupilot.modes import Mode


def custom_mode(main: int, sub: int = 0) -> int:
    """HEARTBEAT.custom_mode of a main and a sub mode: main << 16 | sub << 24."""
    return main << 16 | sub << 24


class Px4Mode(IntEnum):
    """The modes that the simulated vehicle flies, by custom_mode."""

    ALTCTL = custom_mode(2)
    POSCTL = custom_mode(3)
    OFFBOARD = custom_mode(6)
    STABILIZED = custom_mode(7)
    TAKEOFF = custom_mode(4, 2)
    HOLD = custom_mode(4, 3)
    RTL = custom_mode(4, 5)
    LAND = custom_mode(4, 6)


@dataclass(frozen=True, slots=True)
class Px4Row:
    """Properties of a mode.

    Attributes:
        flown: mode of ArduPilot with the controller in `Flying` that it uses.
        needs_position: it is not entered without a position estimate.
        is_piloted: sticks control it.
    """

    name: str
    flown: Mode
    needs_position: bool = True
    can_arm: bool = True
    is_piloted: bool = False


ROWS: dict[Px4Mode, Px4Row] = {
    Px4Mode.STABILIZED: Px4Row("Stabilized", Mode.STABILIZE, needs_position=False, is_piloted=True),
    Px4Mode.ALTCTL: Px4Row("Altitude", Mode.ALT_HOLD, needs_position=False, is_piloted=True),
    Px4Mode.POSCTL: Px4Row("Position", Mode.LOITER, is_piloted=True),
    Px4Mode.OFFBOARD: Px4Row("Offboard", Mode.GUIDED),
    Px4Mode.TAKEOFF: Px4Row("Takeoff", Mode.GUIDED),
    Px4Mode.HOLD: Px4Row("Hold", Mode.BRAKE),
    Px4Mode.RTL: Px4Row("Return", Mode.RTL, can_arm=False),
    Px4Mode.LAND: Px4Row("Land", Mode.LAND, needs_position=False, can_arm=False),
}

# Values of COM_FLTMODE1 to 6, the positions of the pilot's mode switch.
SWITCH = {"ALTITUDE": 1, "POSITION": 2, "HOLD": 4, "RETURN": 5, "OFFBOARD": 7, "STABILIZED": 8, "LAND": 11}
SWITCHED = {
    1: Px4Mode.ALTCTL,
    2: Px4Mode.POSCTL,
    4: Px4Mode.HOLD,
    5: Px4Mode.RTL,
    7: Px4Mode.OFFBOARD,
    8: Px4Mode.STABILIZED,
    11: Px4Mode.LAND,
}
