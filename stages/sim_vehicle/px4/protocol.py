"""Protocol of PX4 where it differs: modes of two numbers, bytewise integers, altitudes above the sea."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from typing import ClassVar, cast

from alula.stages.sim_vehicle.ardupilot.commands import Command, Commands
from alula.stages.sim_vehicle.ardupilot.dialogue import Dialogue, parameter_name
from alula.stages.sim_vehicle.ardupilot.modes import Mode
from alula.stages.sim_vehicle.ardupilot.telemetry import CAPABILITIES, Telemetry
from alula.stages.sim_vehicle.common.copter import CRITICAL, Copter
from alula.stages.sim_vehicle.common.estimator import is_location
from alula.stages.sim_vehicle.common.packets import Codec, Message, mavlink
from alula.stages.sim_vehicle.common.parameters import ParamType
from alula.stages.sim_vehicle.common.quaternions import conjugate, rotate, to_euler
from alula.stages.sim_vehicle.px4.modes import ROWS, Px4Mode, custom_mode
from alula.stages.sim_vehicle.px4.vehicle import Px4Copter

_VERSION = (1 << 24) | (15 << 16) | (4 << 8) | 255  # 1.15.4, released
_SETTLED, _NO_POSITION = 0x37F, 0x65  # ESTIMATOR_STATUS.flags: all that are good; attitude and heights
_AT_REST = 128  # CONST_POS_MODE, which PX4 sets whenever it rests on the ground
_PRESSURE_HPA, _FALL_HPA_M = 1013.25, 0.1186
_MAGNETIC_GAUSS = (0.21, 0.01, 0.42)  # approximate field at Zurich, NED
_POSITION, _VELOCITY, _ACCELERATION = 0b111, 0b111 << 3, 0b111 << 6  # bits of type_mask
_FORCE, _ATTITUDE, _THRUST, _RATES = 1 << 9, 128, 64, 0b111
_RELATIVE = (mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT)
_BY_MODE = {Mode.LAND: Px4Mode.LAND, Mode.RTL: Px4Mode.RTL, Mode.LOITER: Px4Mode.HOLD}


class Px4Telemetry(Telemetry):
    """Telemetry of PX4: it streams the messages of a companion link without a request."""

    STREAMS: ClassVar[Mapping[int, tuple[str, tuple[str, ...]]]] = {}
    MESSAGES: ClassVar[tuple[str, ...]] = (
        *(name for name in Telemetry.MESSAGES if name not in ("ekf_status_report", "sim_state")),
        *("estimator_status", "highres_imu", "odometry"),
    )
    RATES_HZ: ClassVar[Mapping[str, float]] = {
        "HEARTBEAT": 1.0,
        "SYS_STATUS": 5.0,
        "SYSTEM_TIME": 1.0,
        "GPS_RAW_INT": 5.0,
        "ATTITUDE": 50.0,
        "ATTITUDE_QUATERNION": 50.0,
        "LOCAL_POSITION_NED": 30.0,
        "GLOBAL_POSITION_INT": 10.0,
        "ODOMETRY": 30.0,
        "HIGHRES_IMU": 50.0,
        "EXTENDED_SYS_STATE": 5.0,
        "ESTIMATOR_STATUS": 1.0,
        "BATTERY_STATUS": 0.5,
        "RC_CHANNELS": 10.0,
        "VFR_HUD": 10.0,
        "HOME_POSITION": 0.5,
    }

    def __init__(self, copter: Copter, epoch_s: float = 0.0) -> None:
        super().__init__(copter, epoch_s)
        self._px4 = cast(Px4Copter, copter)
        self._last_target = super()._attitude_target()

    def _attitude_target(self) -> Message:
        """Time, attitude and thrust of the last attitude, however old, and the newest rates."""
        newest, copter = super()._attitude_target(), self._px4
        if copter.flown is Px4Mode.OFFBOARD and copter.flying.guided.flies_rates:
            rates = newest.body_roll_rate, newest.body_pitch_rate, newest.body_yaw_rate
            last = self._last_target
            return mavlink.MAVLink_attitude_target_message(last.time_boot_ms, 0, last.q, *rates, last.thrust)
        self._last_target = newest
        return newest

    def _heartbeat(self) -> Message:
        copter, row = self._px4, ROWS[self._px4.flown]
        base = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
        base |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED if copter.is_armed else 0
        if row.is_piloted:
            base |= mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
        else:
            base |= mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
            if copter.flown is not Px4Mode.OFFBOARD:
                base |= mavlink.MAV_MODE_FLAG_AUTO_ENABLED
        state = mavlink.MAV_STATE_ACTIVE if copter.is_armed else mavlink.MAV_STATE_STANDBY
        if copter.failsafe:
            state = mavlink.MAV_STATE_CRITICAL
        return mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_PX4, base, copter.flown, state, 3
        )

    def _autopilot_version(self) -> Message:
        capabilities = CAPABILITIES & ~mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
        capabilities |= mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
        return mavlink.MAVLink_autopilot_version_message(
            capabilities, _VERSION, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 1
        )

    def _extended_sys_state(self) -> Message:
        by_mode = {
            Px4Mode.LAND: mavlink.MAV_LANDED_STATE_LANDING,
            Px4Mode.TAKEOFF: mavlink.MAV_LANDED_STATE_TAKEOFF,
        }
        landed = by_mode.get(self._px4.flown, mavlink.MAV_LANDED_STATE_IN_AIR)
        if self._px4.is_landed:
            landed = mavlink.MAV_LANDED_STATE_ON_GROUND
        return mavlink.MAVLink_extended_sys_state_message(mavlink.MAV_VTOL_STATE_UNDEFINED, landed)

    def _estimator_status(self) -> Message:
        estimator = self._px4.estimator
        flags = (_SETTLED if estimator.has_position else _NO_POSITION) if estimator.is_started else 0
        flags |= _AT_REST if self._px4.is_landed else 0
        bad = estimator.variance
        return mavlink.MAVLink_estimator_status_message(
            self._now_us, flags, *(bad, bad, 0.05, 0.05, 0.0, 0.0), *(0.1, 0.1)
        )

    def _odometry(self) -> Message | None:
        if not self._px4.estimator.has_position:
            return None
        motion = self._motion
        velocity = rotate(conjugate(motion.attitude), motion.velocity)  # in the body's axes
        unknown = [math.nan] + [0.0] * 20
        return mavlink.MAVLink_odometry_message(
            self._now_us,
            *(mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_BODY_FRD),
            *motion.position,
            list(motion.attitude),
            *velocity,
            *motion.omega,
            *(unknown, unknown, 0, mavlink.MAV_ESTIMATOR_TYPE_AUTOPILOT),
        )

    def _highres_imu(self) -> Message:
        copter, motion = self._px4, self._motion
        back = conjugate(motion.attitude)
        x, y, z = copter.airframe.truth.acceleration
        force = rotate(back, (x, y, z - copter.airframe.body.gravity))
        altitude = copter.estimator.global_position(motion.position)[2]
        pressure = _PRESSURE_HPA - _FALL_HPA_M * altitude
        return mavlink.MAVLink_highres_imu_message(
            self._now_us,
            *force,
            *motion.omega,
            *rotate(back, _MAGNETIC_GAUSS),
            *(pressure, 0.0, altitude, 25.0, 0x1FFF),
        )

    @property
    def _now_us(self) -> int:
        return round(self._copter.time_s * 1e6)


class Px4Commands(Commands):
    """Commands of PX4: temporary refusals, modes of two numbers, take-off altitudes above the sea."""

    REFUSED: ClassVar[int] = mavlink.MAV_RESULT_TEMPORARILY_REJECTED

    def __init__(self, copter: Copter, telemetry: Telemetry) -> None:
        super().__init__(copter, telemetry)
        self._px4 = cast(Px4Copter, copter)
        for number in (mavlink.MAV_CMD_CONDITION_YAW, mavlink.MAV_CMD_DO_CHANGE_SPEED):
            del self._table[number]

    def _enter(self, mode: Mode) -> int:
        return int(mavlink.MAV_RESULT_ACCEPTED if self._px4.set_mode(_BY_MODE[mode]) else self.REFUSED)

    def _set_mode(self, command: Command, _out: list[Message]) -> int:
        base, main, sub = command.params[:3]
        if not all(map(math.isfinite, (base, main))):
            return int(mavlink.MAV_RESULT_DENIED)
        if not int(base) & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            return int(mavlink.MAV_RESULT_DENIED)
        number = custom_mode(int(main), int(sub) if math.isfinite(sub) else 0)
        return int(mavlink.MAV_RESULT_ACCEPTED if self._px4.set_mode(number) else self.REFUSED)

    def _take_off(self, command: Command, _out: list[Message]) -> int:
        is_taken = self._px4.take_off(command.params[6])
        return int(mavlink.MAV_RESULT_ACCEPTED if is_taken else self.REFUSED)

    def _reposition(self, command: Command, _out: list[Message]) -> int:
        lat, lon, alt = command.params[4:]
        if command.frame in _RELATIVE:
            alt += self._px4.estimator.global_position(self._px4.flying.home)[2]
        if not is_location((lat, lon, alt)):
            return int(mavlink.MAV_RESULT_DENIED)
        return int(mavlink.MAV_RESULT_ACCEPTED if self._px4.go_to((lat, lon, alt)) else self.REFUSED)

    def _check(self, _command: Command, _out: list[Message]) -> int:
        if (reason := self._px4.arming_refusal()) is not None:
            self._px4.say(CRITICAL, f"Preflight Fail: {reason}")
        return int(mavlink.MAV_RESULT_ACCEPTED)


class Px4Dialogue(Dialogue):
    """Dialogue of PX4: bytewise integers; set-points count in every mode, but only documented kinds."""

    COMMANDS: ClassVar[type[Commands]] = Px4Commands

    def __init__(self, copter: Copter, telemetry: Telemetry, codec: Codec, time_10us: int = 0) -> None:
        super().__init__(copter, telemetry, codec, time_10us)
        self._px4 = cast(Px4Copter, copter)
        for name in ("REQUEST_DATA_STREAM", "VISION_SPEED_ESTIMATE"):
            del self._table[name]
        self._table["ODOMETRY"] = self._odometry

    def _heartbeat(self, message: Message) -> list[Message]:
        self._px4.note_client()
        if message.type == mavlink.MAV_TYPE_GCS:  # the heartbeat of a companion does not count
            self._px4.note_ground_station(message.get_srcSystem())
        return []

    def _odometry(self, message: Message) -> list[Message]:
        """Take an external pose and velocity, both NED; of motion capture it takes none."""
        if message.estimator_type == mavlink.MAV_ESTIMATOR_TYPE_MOCAP:
            return []
        place, velocity = (message.x, message.y, message.z), (message.vx, message.vy, message.vz)
        self._px4.estimator.vision_position(place, to_euler(tuple(message.q))[2])
        self._px4.estimator.vision_velocity(velocity)
        return []

    def _wire_value(self, name: str) -> float:
        value = self._copter.parameters[name]
        if self._copter.parameters.type_of(name) is ParamType.FLOAT:
            return value
        return float(struct.unpack("<f", struct.pack("<i", int(value)))[0])

    def _set_parameter(self, message: Message) -> list[Message]:
        """Set a parameter; the answer is its new value, none for an unknown name or a wrong type."""
        parameters, name = self._copter.parameters, parameter_name(message.param_id)
        if name not in parameters:
            return []
        kind = parameters.type_of(name)
        if message.param_type != kind:
            self._copter.say(CRITICAL, f"param types mismatch param: {name}")
            return []
        value = message.param_value
        if kind is not ParamType.FLOAT:
            value = float(struct.unpack_from("<i", bytes(message.get_msgbuf()), _header(message))[0])
        parameters.set(name, value)
        return [self._parameter(name)]

    def _attitude_target(self, message: Message) -> list[Message]:
        """Accept an attitude with thrust or all three rates with thrust; ignore other combinations."""
        mask, thrust = message.type_mask, message.thrust
        numbers = message.q if not mask & _ATTITUDE else _rates(message)
        is_whole = not mask & _THRUST and (not mask & _ATTITUDE or not mask & _RATES)
        if not is_whole or not all(map(math.isfinite, (*numbers, thrust))):
            return []
        if not mask & _ATTITUDE:
            message.type_mask = _RATES  # the attitude is followed; rates beside it are ignored
        if self._px4.note_setpoint():
            self._px4.flying.guided.attitude_target(message, self._px4.estimator.motion)
        return []

    def _position_target(self, message: Message) -> list[Message]:
        """Accept the documented combinations of position, velocity and acceleration; NaN omits a field."""
        mask = message.type_mask
        for bits, names in (
            (_POSITION, ("x", "y", "z")),
            (_VELOCITY, ("vx", "vy", "vz")),
            (_ACCELERATION, ("afx", "afy", "afz")),
        ):
            if not all(math.isfinite(getattr(message, name)) for name in names):
                mask |= bits
            if mask & bits not in (0, bits):
                return []  # single axes are not simulated
        frames = (mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_BODY_NED)
        everything = _POSITION | _VELOCITY | _ACCELERATION
        if mask & _FORCE or mask & everything == everything or message.coordinate_frame not in frames:
            return []
        if mask & everything == _VELOCITY:
            return []  # not a documented combination
        message.type_mask = mask
        if self._px4.note_setpoint():
            self._px4.flying.guided.position_target(message, self._px4.estimator.motion)
        return []


def _rates(message: Message) -> tuple[float, float, float]:
    return message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate


def _header(message: Message) -> int:
    """Number of bytes before the payload."""
    return 10 if bytes(message.get_msgbuf())[0] == 0xFD else 6
