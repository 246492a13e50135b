"""Telemetry messages of the simulated vehicle and their rates."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Mapping
from typing import ClassVar

from alula.stages.sim_vehicle.ardupilot.modes import MODES, Mode
from alula.stages.sim_vehicle.common.airframe import TICK_S, Motion
from alula.stages.sim_vehicle.common.copter import Copter
from alula.stages.sim_vehicle.common.packets import Message, mavlink
from alula.stages.sim_vehicle.common.quaternions import added, to_euler

# Groups of REQUEST_DATA_STREAM: the parameter with the rate at boot, and the messages.
STREAMS: dict[int, tuple[str, tuple[str, ...]]] = {
    mavlink.MAV_DATA_STREAM_RAW_SENSORS: ("SR0_RAW_SENS", ("SIM_STATE",)),
    mavlink.MAV_DATA_STREAM_EXTENDED_STATUS: (
        "SR0_EXT_STAT",
        ("SYS_STATUS", "GPS_RAW_INT", "POSITION_TARGET_LOCAL_NED"),
    ),
    mavlink.MAV_DATA_STREAM_RC_CHANNELS: ("SR0_RC_CHAN", ("RC_CHANNELS",)),
    mavlink.MAV_DATA_STREAM_POSITION: ("SR0_POSITION", ("GLOBAL_POSITION_INT", "LOCAL_POSITION_NED")),
    mavlink.MAV_DATA_STREAM_EXTRA1: ("SR0_EXTRA1", ("ATTITUDE",)),
    mavlink.MAV_DATA_STREAM_EXTRA2: ("SR0_EXTRA2", ("VFR_HUD",)),
    mavlink.MAV_DATA_STREAM_EXTRA3: (
        "SR0_EXTRA3",
        ("SYSTEM_TIME", "EKF_STATUS_REPORT", "BATTERY_STATUS"),
    ),
}
_SENSORS = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
    | mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | mavlink.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS
    | mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
    | mavlink.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
)
CAPABILITIES = (
    mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
    | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | mavlink.MAV_PROTOCOL_CAPABILITY_FLIGHT_TERMINATION
    | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
)
_VERSION = (4 << 24) | (7 << 16)  # 4.7.0, a development version


class Telemetry:
    """Builder and scheduler of the vehicle's messages.

    A message without valid content is not sent: no position before there is an estimate.

    Args:
        epoch_s: Unix time at boot [s]; 0 if unknown.
    """

    STREAMS: ClassVar[Mapping[int, tuple[str, tuple[str, ...]]]] = STREAMS
    MESSAGES: ClassVar[tuple[str, ...]] = (
        *("heartbeat", "sys_status", "system_time", "gps_raw_int", "attitude", "attitude_quaternion"),
        *("local_position_ned", "global_position_int", "rc_channels", "vfr_hud", "battery_status"),
        *("autopilot_version", "extended_sys_state", "home_position", "gps_global_origin"),
        *("ekf_status_report", "position_target_local_ned", "attitude_target", "sim_state"),
        "mission_current",
    )
    RATES_HZ: ClassVar[Mapping[str, float]] = {"HEARTBEAT": 1.0}  # default rates

    def __init__(self, copter: Copter, epoch_s: float = 0.0) -> None:
        self._copter = copter
        self._epoch_s = epoch_s
        self._interval_s: dict[str, float] = {}
        self._due: list[tuple[float, str]] = []
        self._builders: dict[str, Callable[[], Message | None]] = {
            name.upper(): getattr(self, f"_{name}") for name in self.MESSAGES
        }
        self.ids = {getattr(mavlink, f"MAVLINK_MSG_ID_{name}"): name for name in self._builders}
        for name in self.RATES_HZ:
            self.set_interval(name, self.usual_interval_s(name))
        for group, (parameter, _) in self.STREAMS.items():
            self.set_stream(group, copter.parameters[parameter])

    def build(self, name: str) -> Message | None:
        """Build a message by name; None if it has no valid content now."""
        return self._builders[name]()

    def interval_s(self, name: str) -> float | None:
        """Interval of a message [s]; None if it is not sent."""
        return self._interval_s.get(name)

    def usual_interval_s(self, name: str) -> float | None:
        """Default interval of a message [s]; None if it is not sent by default."""
        rate_hz = self.RATES_HZ.get(name)
        return None if rate_hz is None else 1 / rate_hz

    def set_interval(self, name: str, interval_s: float | None) -> None:
        """Set the interval of a message.

        Args:
            interval_s: the interval [s]; None stops it.
        """
        self._due = [(when, other) for when, other in self._due if other != name]
        heapq.heapify(self._due)
        self._interval_s.pop(name, None)
        if interval_s is not None:
            self._interval_s[name] = max(interval_s, TICK_S)
            heapq.heappush(self._due, (self._copter.time_s, name))

    def set_stream(self, group: int, rate_hz: float) -> None:
        """Process a REQUEST_DATA_STREAM.

        Args:
            group: the group of messages; 0 for all groups.
            rate_hz: the rate [Hz]; 0 stops them.
        """
        for key, (_, names) in self.STREAMS.items():
            if group in (key, mavlink.MAV_DATA_STREAM_ALL):
                for name in names:
                    self.set_interval(name, 1 / rate_hz if rate_hz > 0 else None)

    def due(self) -> list[Message]:
        """Messages that are due now, on a schedule without drift."""
        now, found = self._copter.time_s, []
        while self._due and self._due[0][0] <= now + 1e-9:
            when, name = heapq.heappop(self._due)
            heapq.heappush(self._due, (max(when, now - 0.1) + self._interval_s[name], name))
            if (message := self.build(name)) is not None:
                found.append(message)
        return found

    @property
    def _now_ms(self) -> int:
        return round(self._copter.time_s * 1000)

    @property
    def _motion(self) -> Motion:
        return self._copter.estimator.reported

    def _heartbeat(self) -> Message:
        copter = self._copter
        base = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
        base |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED if copter.is_armed else 0
        if MODES[copter.mode].takes_setpoints or copter.mode in (Mode.RTL, Mode.LAND, Mode.BRAKE):
            base |= mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
        if MODES[copter.mode].is_piloted:
            base |= mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
        state = mavlink.MAV_STATE_STANDBY
        if not copter.estimator.is_started:
            state = mavlink.MAV_STATE_CALIBRATING
        elif copter.failsafe:
            state = mavlink.MAV_STATE_CRITICAL
        elif copter.is_armed and not copter.is_landed:
            state = mavlink.MAV_STATE_ACTIVE
        return mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, base, copter.mode, state, 3
        )

    def _sys_status(self) -> Message:
        copter, battery = self._copter, self._copter.battery
        gps = mavlink.MAV_SYS_STATUS_SENSOR_GPS if copter.parameters.whole("GPS1_TYPE") else 0
        present = _SENSORS | gps | mavlink.MAV_SYS_STATUS_AHRS | mavlink.MAV_SYS_STATUS_PREARM_CHECK
        healthy = _SENSORS
        healthy |= gps if copter.estimator.has_fix else 0
        settled = copter.estimator.has_position and not copter.estimator.has_failed
        healthy |= mavlink.MAV_SYS_STATUS_AHRS if settled else 0
        can_arm = copter.is_armed or copter.check_refusal() is None
        healthy |= mavlink.MAV_SYS_STATUS_PREARM_CHECK if can_arm else 0
        return mavlink.MAVLink_sys_status_message(
            present,
            present,
            healthy,
            150,
            round(battery.voltage * 1000),
            round(battery.current_a * 100),
            round(battery.remaining * 100),
            *(0, 0, 0, 0, 0, 0),
        )

    def _system_time(self) -> Message:
        unix = int((self._epoch_s + self._copter.time_s) * 1e6) if self._epoch_s else 0
        return mavlink.MAVLink_system_time_message(unix, self._now_ms)

    def _gps_raw_int(self) -> Message:
        estimator = self._copter.estimator
        fixed = estimator.has_fix
        truth = self._copter.airframe.truth
        place = added(truth.position, estimator.fix_offset)
        lat, lon, alt = estimator.global_position(place) if fixed else (0.0, 0.0, 0.0)
        north, east, _ = truth.velocity
        speed = round(100 * math.hypot(north, east)) if fixed else 0
        course = round(100 * math.degrees(math.atan2(east, north)) % 36000) % 36000
        return mavlink.MAVLink_gps_raw_int_message(
            round(1e6 * (estimator.fix_s or 0.0)),
            6 if fixed else 1,
            *_degrees(lat, lon),
            round(alt * 1000),
            *(121 if fixed else 9999, 200 if fixed else 9999, speed, course, 10 if fixed else 0),
        )

    def _attitude(self) -> Message:
        return mavlink.MAVLink_attitude_message(
            self._now_ms, *to_euler(self._motion.attitude), *self._motion.omega
        )

    def _attitude_quaternion(self) -> Message:
        return mavlink.MAVLink_attitude_quaternion_message(
            self._now_ms, *self._motion.attitude, *self._motion.omega
        )

    def _local_position_ned(self) -> Message | None:
        if not self._copter.estimator.has_position:
            return None
        return mavlink.MAVLink_local_position_ned_message(
            self._now_ms, *self._motion.position, *self._motion.velocity
        )

    def _global_position_int(self) -> Message | None:
        estimator = self._copter.estimator
        if estimator.origin is None or not estimator.has_position:
            return None
        lat, lon, alt = estimator.global_position(self._motion.position)
        above = self._copter.flying.home[2] - self._motion.position[2]
        heading = math.degrees(to_euler(self._motion.attitude)[2]) % 360
        return mavlink.MAVLink_global_position_int_message(
            self._now_ms,
            *_degrees(lat, lon),
            round(alt * 1000),
            round(above * 1000),
            *(max(-32767, min(32767, round(100 * v))) for v in self._motion.velocity),
            round(100 * heading) % 36000,
        )

    def _rc_channels(self) -> Message:
        channels = self._copter.pilot.channels(self._copter.time_s)
        return mavlink.MAVLink_rc_channels_message(
            self._now_ms, len(channels), *channels, *(0, 0), 0 if self._copter.pilot.is_lost else 254
        )

    def _vfr_hud(self) -> Message:
        motion = self._motion
        speed = math.hypot(*motion.velocity[:2])
        heading = math.degrees(to_euler(motion.attitude)[2]) % 360
        alt = self._copter.estimator.global_position(motion.position)[2]
        throttle = round(100 * self._copter.attitude.throttle)
        return mavlink.MAVLink_vfr_hud_message(
            speed, speed, round(heading) % 360, throttle, alt, -motion.velocity[2]
        )

    def _battery_status(self) -> Message:
        battery = self._copter.battery
        volts = [round(battery.voltage * 1000)] + [65535] * 9
        return mavlink.MAVLink_battery_status_message(
            *(0, 0, 0, 32767, volts, round(battery.current_a * 100)),
            *(round(battery.used_mah), -1, round(battery.remaining * 100)),
        )

    def _autopilot_version(self) -> Message:
        return mavlink.MAVLink_autopilot_version_message(
            CAPABILITIES, _VERSION, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 0
        )

    def _extended_sys_state(self) -> Message:
        copter = self._copter
        landed = mavlink.MAV_LANDED_STATE_IN_AIR
        if copter.is_landed:
            landed = mavlink.MAV_LANDED_STATE_ON_GROUND
        elif copter.mode is Mode.LAND:
            landed = mavlink.MAV_LANDED_STATE_LANDING
        elif copter.mode is Mode.GUIDED and copter.flying.guided.is_taking_off(copter.estimator.motion):
            landed = mavlink.MAV_LANDED_STATE_TAKEOFF
        return mavlink.MAVLink_extended_sys_state_message(mavlink.MAV_VTOL_STATE_UNDEFINED, landed)

    def _home_position(self) -> Message | None:
        estimator, home = self._copter.estimator, self._copter.flying.home
        if estimator.origin is None:
            return None
        lat, lon, alt = estimator.global_position(home)
        return mavlink.MAVLink_home_position_message(
            *_degrees(lat, lon), round(alt * 1000), *home, [1.0, 0.0, 0.0, 0.0], *(0.0, 0.0, 0.0)
        )

    def _gps_global_origin(self) -> Message | None:
        origin = self._copter.estimator.origin
        if origin is None:
            return None
        return mavlink.MAVLink_gps_global_origin_message(*_degrees(*origin[:2]), round(origin[2] * 1000))

    def _ekf_status_report(self) -> Message:
        estimator = self._copter.estimator
        bad = estimator.variance
        return mavlink.MAVLink_ekf_status_report_message(
            estimator.flags, bad, bad, 0.05, estimator.compass_variance, 0.0
        )

    def _position_target_local_ned(self) -> Message | None:
        target = self._copter.flying.guided.target
        if self._copter.mode is not Mode.GUIDED or target is None:
            return None
        mask, point, velocity, acceleration = target
        return mavlink.MAVLink_position_target_local_ned_message(
            self._now_ms, mavlink.MAV_FRAME_LOCAL_NED, mask, *point, *velocity, *acceleration, 0.0, 0.0
        )

    def _attitude_target(self) -> Message:
        attitude = self._copter.attitude
        return mavlink.MAVLink_attitude_target_message(
            self._now_ms, 0, list(attitude.target), *attitude.rates, attitude.throttle_command
        )

    def _sim_state(self) -> Message:
        """True motion, as ArduPilot's simulation sends it."""
        truth = self._copter.airframe.truth
        lat, lon, alt = self._copter.estimator.global_position(truth.position)
        return mavlink.MAVLink_sim_state_message(
            *truth.attitude,
            *to_euler(truth.attitude),
            *truth.acceleration,
            *truth.omega,
            *(lat, lon, alt, 0.0, 0.0),
            *truth.velocity,
            *_degrees(lat, lon),
        )

    def _mission_current(self) -> Message:
        return mavlink.MAVLink_mission_current_message(0)


def _degrees(lat: float, lon: float) -> tuple[int, int]:
    return round(lat * 1e7), round(lon * 1e7)
