"""Differences between ArduPilot and PX4: modes, parameters, messages."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from alula.schemas.errors import LinkError
from alula.stages.flight.links.mavlink.ardupilot_failsafes import ARDUPILOT_SAFETY, ardupilot_safety
from alula.stages.flight.links.mavlink.px4_failsafes import PX4_SAFETY, px4_safety
from alula.stages.flight.links.own_safety import OwnSafety
from alula.stages.vehicles.own_limits import RESPONSES
from alula.stages.vehicles.setpoints import AccelerationSetpoint, RatesSetpoint, Setpoint, VelocitySetpoint

_MULTICOPTERS = (2, 13, 14, 15, 29, 35)  # MAV_TYPE
_THROTTLE_HZ = 25.0
_CUSTOM_MODE = 1  # bit of base_mode
ALL_SETPOINTS: frozenset[type[Setpoint]] = frozenset({RatesSetpoint, AccelerationSetpoint, VelocitySetpoint})


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter that must have a certain value in flight.

    Attributes:
        name: name of at most 16 characters.
        required: the required value as a function of the present one.
        since: its name in later versions; empty if it is the same.
    """

    name: str
    required: Callable[[float], float]
    why: str
    is_required: bool = True
    since: str = ""

    @property
    def names(self) -> tuple[str, ...]:
        """Its possible names."""
        return (self.name, self.since) if self.since else (self.name,)


@dataclass(frozen=True, slots=True)
class Autopilot:
    """A family of autopilots.

    Attributes:
        parameters: parameters that are set before a flight and restored afterwards.
        for_rates: those that are also set for flights by body rates.
        fixed: parameters with their allowed values for motion capture; they are only checked, because a
            change needs a restart.
        ground_station: possible names of the parameter with the system id of the monitored ground station.
        watched: names of further parameters that flights rely on; they are watched in flight with those that
            were set.
        responses: names, in all its versions, of parameters that limit how set-points are followed; they are
            watched, too.
        position_source: name of the parameter that selects the source of the horizontal position, and
            whether by a value of it the position depends on satellites, unless it comes by `--mocap`.
        external_source: value of that parameter for external navigation, of which then nothing else gives the
            position, and the frame needs an origin; None if other parameters select that.
        yaw_filter: name of the parameter with the cutoff of the filter of the yaw rate's error [Hz]; empty if
            there is none.
        settling: parameter that lets it lean less in a landing, so that it notices the ground; None if there
            is none.
        own_safety: as `ardupilot_safety`, from the values of `safety_parameters`.
        is_bytewise: whether an integer parameter is sent as the bits of a float instead of its value.
        stopping: main and sub mode in which it comes to rest before it lands; None if it stops as fast while
            it lands.
        streams_first: whether set-points must arrive before the vehicle enters the control mode.
        takes_off_by_command: whether it takes off by MAV_CMD_NAV_TAKEOFF; otherwise by a position set-point.
        reports_arming: whether SYS_STATUS says, in any mode, if its checks before arming hold.
        reports_thrust: whether ATTITUDE_TARGET has the throttle of body rates too; else it repeats that of
            the last attitude, with its time.
        has_odometry: whether it sends ODOMETRY and ESTIMATOR_STATUS, and takes motion capture as ODOMETRY.
        mode_of: function from custom_mode to main mode, sub mode and name.
        custom_of: function from main and sub mode to custom_mode.
    """

    name: str
    parameters: tuple[Parameter, ...]
    for_rates: tuple[Parameter, ...]
    fixed: tuple[tuple[str, tuple[float, ...]], ...]
    ground_station: tuple[str, ...]
    watched: tuple[str, ...]
    responses: tuple[str, ...]
    position_source: tuple[str, Callable[[float], bool]]
    external_source: float | None
    hover: str
    yaw_filter: str
    settling: Parameter | None
    own_safety: Callable[..., OwnSafety]
    safety_parameters: tuple[str, ...]
    is_bytewise: bool
    control: tuple[int, int]
    landing: tuple[int, int]
    stopping: tuple[int, int] | None
    streams_first: bool
    takes_off_by_command: bool
    reports_arming: bool
    reports_thrust: bool
    has_odometry: bool
    mode_of: Callable[[int], tuple[int, int, str]]
    custom_of: Callable[[tuple[int, int]], int]
    accepts: frozenset[type[Setpoint]] = ALL_SETPOINTS

    @property
    def relied_on(self) -> tuple[str, ...]:
        """Names of all parameters whose values must not change in flight."""
        set_or_checked = (
            *(name for each in self.needed(flies_rates=True) for name in each.names),
            *(name for name, _ in self.fixed),
        )
        settling = "" if self.settling is None else self.settling.name  # a landing changes it
        responses = (name for name in self.responses if name != settling)
        named = (*self.ground_station, self.position_source[0], *self.watched, *responses)
        return tuple(dict.fromkeys((*set_or_checked, *named)))

    def needed(self, *, flies_rates: bool) -> tuple[Parameter, ...]:
        """Parameters that a flight needs."""
        return self.parameters + (self.for_rates if flies_rates else ())

    def intervals(self, rate_hz: float, *, flies_rates: bool = False) -> dict[int, float]:
        """Requested rate of each message [Hz] by its number.

        Args:
            rate_hz: rate of the state messages [Hz].
            flies_rates: set-points are body rates and thrust: also the throttle that the vehicle commands.
        """
        rates = {
            dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: rate_hz,
            dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: rate_hz,
            dialect.MAVLINK_MSG_ID_HEARTBEAT: 5.0,  # it contains the mode that a pilot has chosen
            dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 5.0,
            dialect.MAVLINK_MSG_ID_SYS_STATUS: 2.0,
        }
        if flies_rates:
            rates[dialect.MAVLINK_MSG_ID_ATTITUDE_TARGET] = _THROTTLE_HZ
        rates |= {dialect.MAVLINK_MSG_ID_GPS_RAW_INT: 5.0, dialect.MAVLINK_MSG_ID_GPS2_RAW: 5.0}
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


_SETTLING_DEG = 10.0

ARDUPILOT = Autopilot(
    name="ArduPilot",
    parameters=(
        Parameter("GUID_OPTIONS", _with_bit(8), "thrust in SET_ATTITUDE_TARGET is thrust, not a climb rate"),
        Parameter("ATC_ANGLE_BOOST", _always(0.0), "thrust is not divided by the cosine of the tilt"),
        Parameter("GUID_TIMEOUT", _always(0.3), "a set-point expires after 0.3 s"),
        Parameter("FS_GCS_ENABLE", _always(5.0), "the vehicle lands when this program's heartbeats end"),
    ),
    for_rates=(
        Parameter("FS_GCS_TIMEOUT", lambda value: min(value, 0.5), "it lands 0.5 s after the last heartbeat"),
        *(
            Parameter(
                f"ATC_ACCEL_{axis}_MAX",
                _always(0.0),
                "rates are followed at once",
                is_required=False,
                since=f"ATC_ACC_{axis}_MAX",
            )
            for axis in "RP"
        ),
    ),
    fixed=(
        *((f"EK3_SRC1_{each}", (6.0,)) for each in ("POSXY", "VELXY", "POSZ", "VELZ", "YAW")),
        ("VISO_TYPE", (1.0,)),
    ),
    ground_station=("MAV_GCS_SYSID", "SYSID_MYGCS"),
    watched=("FS_EKF_ACTION", "FS_EKF_THRESH", "FS_GCS_TIMEOUT", "FS_OPTIONS", "FS_THR_ENABLE"),
    responses=RESPONSES,
    position_source=("EK3_SRC1_POSXY", lambda value: value == 3.0),
    external_source=6.0,
    hover="MOT_THST_HOVER",
    yaw_filter="ATC_RAT_YAW_FLTE",
    settling=Parameter(
        "PSC_ANGLE_MAX",
        lambda value: min(value or _SETTLING_DEG, _SETTLING_DEG),
        "it takes the ground for the air while it leans by more than 15 degrees",
        is_required=False,
    ),
    own_safety=ardupilot_safety,
    safety_parameters=ARDUPILOT_SAFETY,
    is_bytewise=False,
    control=(4, 0),
    landing=(9, 0),
    stopping=None,  # LAND stops sooner: from 2.0 m/s within 1.8 m, BRAKE from 1.9 m/s within 2.9 m
    streams_first=False,
    takes_off_by_command=True,
    reports_arming=True,
    reports_thrust=True,
    has_odometry=False,
    mode_of=_copter_mode,
    custom_of=lambda mode: mode[0],
)

PX4 = Autopilot(
    name="PX4",
    parameters=(
        Parameter("COM_OF_LOSS_T", _always(0.3), "offboard control ends 0.3 s after the last set-point"),
        Parameter("COM_OBL_RC_ACT", _always(4.0), "the vehicle then lands", is_required=False),
        Parameter("COM_RCL_EXCEPT", _with_bit(4), "offboard control needs no radio", is_required=False),
        Parameter(
            "COM_RC_OVERRIDE", _with_bit(2), "the pilot's sticks end offboard control", is_required=False
        ),
    ),
    for_rates=(),
    fixed=(("EKF2_EV_CTRL", tuple(map(float, (9, 11, 13, 15)))),),
    ground_station=(),
    watched=(),
    responses=(
        *("MPC_ACC_HOR", "MPC_ACC_UP_MAX", "MPC_ACC_DOWN_MAX", "MPC_JERK_MAX", "MPC_TILTMAX_AIR"),
        *("MPC_XY_VEL_MAX", "MPC_Z_VEL_MAX_UP", "MPC_Z_VEL_MAX_DN"),
        *("MC_ROLLRATE_MAX", "MC_PITCHRATE_MAX", "MC_YAWRATE_MAX"),
    ),
    position_source=("EKF2_GPS_CTRL", lambda value: bool(round(value) & 1)),
    external_source=None,
    hover="MPC_THR_HOVER",
    yaw_filter="",
    settling=None,
    own_safety=px4_safety,
    safety_parameters=PX4_SAFETY,
    is_bytewise=True,
    control=(6, 0),
    landing=(4, 6),
    stopping=(4, 3),  # AUTO.LOITER
    streams_first=True,
    takes_off_by_command=False,
    reports_arming=False,
    reports_thrust=False,
    has_odometry=True,
    mode_of=_px4_mode,
    custom_of=lambda mode: mode[0] << 16 | mode[1] << 24,
)

_BY_NUMBER = {dialect.MAV_AUTOPILOT_ARDUPILOTMEGA: ARDUPILOT, dialect.MAV_AUTOPILOT_PX4: PX4}


def autopilot_of(heartbeat: Any) -> Autopilot:
    """Family of the autopilot that sent a HEARTBEAT.

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
