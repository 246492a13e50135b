"""What ArduPilot and PX4 call things: modes, parameters, messages."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from alula.schemas.errors import LinkError
from alula.stages.flight.links.protocol import (
    AccelerationSetpoint,
    RatesSetpoint,
    Setpoint,
    VelocitySetpoint,
)

_MULTICOPTERS = (2, 13, 14, 15, 29, 35)  # MAV_TYPE
_CUSTOM_MODE = 1  # of base_mode
ALL_SETPOINTS: frozenset[type[Setpoint]] = frozenset({RatesSetpoint, AccelerationSetpoint, VelocitySetpoint})


@dataclass(frozen=True, slots=True)
class Parameter:
    """One that flights need to have a certain value.

    Attributes:
        name: of at most 16 characters.
        wanted: from its present value.
        why: in words, for the person whose vehicle it is.
        is_required: whether a vehicle without it is refused.
    """

    name: str
    wanted: Callable[[float], float]
    why: str
    is_required: bool = True


@dataclass(frozen=True, slots=True)
class Autopilot:
    """A family of autopilots.

    Attributes:
        parameters: changed before flights and put back afterwards.
        fixed: those that must have a value with motion capture, and are not changed: they need a restart.
        ground_station: names of the parameter that says which system's heartbeats are watched.
        hover: parameter with the throttle that carries the weight.
        is_bytewise: whether integers travel bit by bit in the place of a float.
        control, landing: main and sub mode.
        streams_first: whether set-points must already come before it obeys.
        takes_off_by_command: otherwise by a set-point of position.
        mode_of: from custom_mode to main mode, sub mode and name.
    """

    name: str
    parameters: tuple[Parameter, ...]
    fixed: tuple[tuple[str, tuple[float, ...]], ...]
    ground_station: tuple[str, ...]
    hover: str
    is_bytewise: bool
    control: tuple[int, int]
    landing: tuple[int, int]
    streams_first: bool
    takes_off_by_command: bool
    has_odometry: bool
    mode_of: Callable[[int], tuple[int, int, str]]
    accepts: frozenset[type[Setpoint]] = ALL_SETPOINTS

    def intervals(self, rate_hz: float) -> dict[int, float]:
        """How often each message is asked for [Hz]."""
        rates = {
            dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: rate_hz,
            dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: rate_hz,
            dialect.MAVLINK_MSG_ID_HEARTBEAT: 5.0,  # with it comes the mode that a pilot has chosen
            dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 5.0,
            dialect.MAVLINK_MSG_ID_SYS_STATUS: 2.0,
        }
        if self.has_odometry:
            return rates | {
                dialect.MAVLINK_MSG_ID_ODOMETRY: rate_hz,
                dialect.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 5.0,
            }
        return rates | {dialect.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 5.0}


def _copter_mode(custom: int) -> tuple[int, int, str]:
    entry = dialect.enums["COPTER_MODE"].get(custom)
    return custom, 0, f"mode {custom}" if entry is None else entry.name.removeprefix("COPTER_MODE_")


_PX4_MAIN = {1: "MANUAL", 2: "ALTCTL", 3: "POSCTL", 4: "AUTO", 5: "ACRO", 6: "OFFBOARD", 7: "STABILIZED"}
_PX4_AUTO = {1: "READY", 2: "TAKEOFF", 3: "LOITER", 4: "MISSION", 5: "RTL", 6: "LAND", 9: "PRECLAND"}


def _px4_mode(custom: int) -> tuple[int, int, str]:
    main, sub = custom >> 16 & 0xFF, custom >> 24 & 0xFF
    name = _PX4_MAIN.get(main, f"mode {main}")
    return main, sub, f"{name}.{_PX4_AUTO.get(sub, sub)}" if main == 4 else name


def _with_bit(bit: int) -> Callable[[float], float]:
    return lambda value: float(round(value) | bit)


def _always(value: float) -> Callable[[float], float]:
    return lambda _: value


ARDUPILOT = Autopilot(
    name="ArduPilot",
    parameters=(
        Parameter("GUID_OPTIONS", _with_bit(8), "thrust in SET_ATTITUDE_TARGET is thrust, not a climb rate"),
        Parameter("ATC_ANGLE_BOOST", _always(0.0), "thrust is not divided by the cosine of the tilt"),
        Parameter("GUID_TIMEOUT", _always(0.3), "silence ends a set-point after 0.3 s"),
        Parameter("FS_GCS_ENABLE", _always(5.0), "it lands when our heartbeats end"),
    ),
    fixed=(
        *((f"EK3_SRC1_{each}", (6.0,)) for each in ("POSXY", "VELXY", "POSZ", "VELZ", "YAW")),
        ("VISO_TYPE", (1.0,)),
    ),
    ground_station=("MAV_GCS_SYSID", "SYSID_MYGCS"),
    hover="MOT_THST_HOVER",
    is_bytewise=False,
    control=(4, 0),
    landing=(9, 0),
    streams_first=False,
    takes_off_by_command=True,
    has_odometry=False,
    mode_of=_copter_mode,
)

PX4 = Autopilot(
    name="PX4",
    parameters=(
        Parameter("COM_OF_LOSS_T", _always(0.3), "silence ends offboard control after 0.3 s"),
        Parameter("COM_OBL_RC_ACT", _always(4.0), "it lands then", is_required=False),
        Parameter("COM_RCL_EXCEPT", _with_bit(4), "offboard control needs no radio", is_required=False),
        Parameter("COM_RC_OVERRIDE", _with_bit(2), "the pilot's sticks end it", is_required=False),
    ),
    fixed=(("EKF2_EV_CTRL", tuple(map(float, (9, 11, 13, 15)))),),
    ground_station=(),
    hover="MPC_THR_HOVER",
    is_bytewise=True,
    control=(6, 0),
    landing=(4, 6),
    streams_first=True,
    takes_off_by_command=False,
    has_odometry=True,
    mode_of=_px4_mode,
)

_BY_NUMBER = {dialect.MAV_AUTOPILOT_ARDUPILOTMEGA: ARDUPILOT, dialect.MAV_AUTOPILOT_PX4: PX4}


def autopilot_of(heartbeat: Any) -> Autopilot:
    """The family of the vehicle that sent a HEARTBEAT.

    Raises:
        LinkError: it is neither ArduPilot nor PX4, or no multicopter.
    """
    autopilot = _BY_NUMBER.get(heartbeat.autopilot)
    if autopilot is None:
        raise LinkError(f"the vehicle's autopilot is number {heartbeat.autopilot}, neither ArduPilot nor PX4")
    if heartbeat.type not in _MULTICOPTERS:
        kind = dialect.enums["MAV_TYPE"].get(heartbeat.type)
        name = str(heartbeat.type) if kind is None else kind.name
        raise LinkError(f"the vehicle is a {name}, not a multicopter")
    return autopilot


def mode_command(mode: tuple[int, int]) -> tuple[int, tuple[float, ...]]:
    """MAV_CMD_DO_SET_MODE and its parameters."""
    return dialect.MAV_CMD_DO_SET_MODE, (float(_CUSTOM_MODE), float(mode[0]), float(mode[1]))
