"""Table of the flight modes of ArduPilot Copter: numbers, names and requirements."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum


class Mode(IntEnum):
    """The modes that the simulated vehicle flies."""

    STABILIZE = 0
    ALT_HOLD = 2
    GUIDED = 4
    LOITER = 5
    RTL = 6
    LAND = 9
    BRAKE = 17
    GUIDED_NOGPS = 20


@dataclass(frozen=True, slots=True)
class ModeRow:
    """Properties of a mode.

    Attributes:
        needs_position: without a position estimate it cannot be entered while armed nor armed in, and losing
            it triggers a failsafe.
        takes_setpoints: it follows SET_ATTITUDE_TARGET and SET_POSITION_TARGET_LOCAL_NED.
        is_piloted: sticks control it, so it needs a remote control.
    """

    needs_position: bool
    can_arm: bool
    takes_setpoints: bool = False
    is_piloted: bool = False


MODES: dict[Mode, ModeRow] = {
    Mode.STABILIZE: ModeRow(needs_position=False, can_arm=True, is_piloted=True),
    Mode.ALT_HOLD: ModeRow(needs_position=False, can_arm=True, is_piloted=True),
    Mode.GUIDED: ModeRow(needs_position=True, can_arm=True, takes_setpoints=True),
    Mode.LOITER: ModeRow(needs_position=True, can_arm=True, is_piloted=True),
    Mode.RTL: ModeRow(needs_position=True, can_arm=False),
    Mode.LAND: ModeRow(needs_position=False, can_arm=False),
    Mode.BRAKE: ModeRow(needs_position=True, can_arm=False),
    Mode.GUIDED_NOGPS: ModeRow(needs_position=False, can_arm=True, takes_setpoints=True),
}

# Modes of ArduPilot Copter that the simulation refuses, by name.
ABSENT = {
    1: "ACRO",
    3: "AUTO",
    7: "CIRCLE",
    11: "DRIFT",
    13: "SPORT",
    14: "FLIP",
    15: "AUTOTUNE",
    16: "POSHOLD",
    18: "THROW",
    19: "AVOID_ADSB",
    21: "SMART_RTL",
    22: "FLOWHOLD",
    23: "FOLLOW",
    24: "ZIGZAG",
    25: "SYSTEMID",
    26: "AUTOROTATE",
    27: "AUTO_RTL",
    28: "TURTLE",
}


def refusal(number: int, *, has_position: bool) -> str | None:
    """Reason why a mode cannot be entered, in ArduPilot's words; None if it can.

    Args:
        number: custom_mode.
        has_position: whether there is a valid position estimate, or none is needed because it is disarmed.
    """
    if number not in Mode._value2member_map_:
        if number in ABSENT:
            return f"Mode change to {ABSENT[number]} failed: not simulated"
        return f"No such mode {number}"
    mode = Mode(number)
    if MODES[mode].needs_position and not has_position:
        return f"Mode change to {mode.name} failed: requires position"
    return None
