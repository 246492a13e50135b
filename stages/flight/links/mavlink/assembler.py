"""Vehicle state from the vehicle's own estimate: LOCAL_POSITION_NED with an attitude, or ODOMETRY."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray
from alula.stages.flight.links.protocol import VehicleState
from alula.stages.flight.links.vehicle_clock import VehicleClock
from alula.stages.rotation import matrix_from_quat_wxyz, multiply_quat_wxyz
from alula.stages.vehicles.frames import LocalFrame, flipped_body

_MAX_APART_S = 0.05  # between position and attitude of one state
_LARGEST = (1e5, 1e3, 1e2)  # [m], [m/s], [rad/s]: larger values are invalid
_WRAP_MS = 1 << 32
_LOCAL_NED, _BODY_FRD, _LOCAL_FRD = 1, 12, 20  # MAV_FRAME


@dataclass(frozen=True, slots=True)
class _Half:
    stamp_s: float
    arrival_s: float
    first: FloatArray  # position, or attitude
    second: FloatArray  # velocity, or body rates


class StateAssembler:
    """Assembler of states; it drops values that are not finite, not newer, or implausibly large.

    Position and attitude arrive separately. The older of the two is extrapolated to the time of the newer,
    p + v dt or q exp(omega dt), over at most 50 ms. If they are further apart there is no new state, so a
    state ages as soon as either stops. `VehicleState.received_s` is the arrival time with the smallest
    delay so far: a delayed packet is already old when it arrives. `VehicleState.latency_s` bounds that
    smallest delay by the answers to time requests.

    Args:
        is_open: function of the time; while it returns False, states are not renewed.

    Attributes:
        dropped: number of messages with invalid values.
    """

    def __init__(self, frame: LocalFrame, is_open: Callable[[float], bool] = lambda _: True) -> None:
        self.frame = frame
        self.dropped = 0
        self._is_open = is_open
        self._clocks = {"boot": VehicleClock(), "odometry": VehicleClock()}
        self._parts: dict[str, _Half] = {}
        self._has_odometry = self._has_quaternion = False
        self._state: VehicleState | None = None
        self._is_new = False
        self._boot_ms: int | None = None

    @property
    def jumps(self) -> int:
        """Number of jumps of the vehicle's clock."""
        return sum(clock.jumps for clock in self._clocks.values())

    @property
    def runs_fast(self) -> bool:
        """Whether the vehicle's clock runs faster than the local one."""
        return any(clock.runs_fast for clock in self._clocks.values())

    @property
    def state(self) -> VehicleState | None:
        """The newest state; None before the first."""
        if self._is_new:
            self._is_new = False
            self._state = self._assembled() or self._state
        return self._state

    def synchronise(self, clock_s: float, requested_s: float) -> None:
        """Use the answer to a time request.

        Args:
            clock_s: vehicle's time since boot in the answer [s].
            requested_s: when the request was sent, local clock [s].
        """
        for clock in self._clocks.values():
            clock.synchronise(clock_s, requested_s)

    def take(self, message: Any, now_s: float) -> None:
        """Process a message; messages without a part of the state are ignored.

        Args:
            now_s: when it arrived, local clock [s].
        """
        kind = message.get_type()
        boot_s = self._since_boot(getattr(message, "time_boot_ms", None))
        if kind == "ODOMETRY":
            self._take_odometry(message, now_s)
        elif kind == "LOCAL_POSITION_NED":
            position = (message.x, message.y, message.z)
            velocity = (message.vx, message.vy, message.vz)
            self._keep("position", "boot", boot_s, now_s, position, velocity)
        elif kind == "ATTITUDE_QUATERNION":
            quat = (message.q1, message.q2, message.q3, message.q4)
            rates = (message.rollspeed, message.pitchspeed, message.yawspeed)
            if self._keep("attitude", "boot", boot_s, now_s, quat, rates):
                self._has_quaternion = True
        elif kind == "ATTITUDE" and not self._has_quaternion:
            quat = quat_from_euler(message.roll, message.pitch, message.yaw)
            rates = (message.rollspeed, message.pitchspeed, message.yawspeed)
            self._keep("attitude", "boot", boot_s, now_s, quat, rates)

    def _since_boot(self, stamp_ms: int | None) -> float:
        """Time since boot [s]; 32 bits of milliseconds wrap around after 49.7 days, which is no restart."""
        if stamp_ms is None:
            return math.nan
        if self._boot_ms is not None:
            stamp_ms = self._boot_ms + (stamp_ms - self._boot_ms + _WRAP_MS // 2) % _WRAP_MS - _WRAP_MS // 2
        self._boot_ms = stamp_ms
        return stamp_ms * 1e-3

    def _take_odometry(self, message: Any, now_s: float) -> None:
        child = message.child_frame_id
        if message.frame_id not in (_LOCAL_NED, _LOCAL_FRD) or child not in (_BODY_FRD, message.frame_id):
            self.dropped += 1
            return
        quat = tuple(message.q)
        velocity = (message.vx, message.vy, message.vz)
        if child == _BODY_FRD and _is_quaternion(quat) and _is_within(velocity, _LARGEST[1]):
            velocity = tuple(matrix_from_quat_wxyz(_unit(quat)) @ velocity)
        stamp = message.time_usec * 1e-6
        rates = (message.rollspeed, message.pitchspeed, message.yawspeed)
        position = (message.x, message.y, message.z)
        parts = dict(self._parts)
        if not self._has_odometry:
            self._parts.clear()  # a state never mixes two sources
        if self._keep("position", "odometry", stamp, now_s, position, velocity) and self._keep(
            "attitude", "odometry", stamp, now_s, quat, rates
        ):
            self._has_odometry = True
        else:
            self._parts = parts

    def _keep(self, part: str, clock: str, stamp_s: float, now_s: float, first: Any, second: Any) -> bool:
        """Store a part; returns whether it was new and valid."""
        if self._has_odometry and clock != "odometry":
            return False
        is_good = (
            _is_within(first, _LARGEST[0]) and _is_within(second, _LARGEST[1])
            if part == "position"
            else _is_quaternion(first) and _is_within(second, _LARGEST[2])
        )
        if not is_good or not math.isfinite(stamp_s):
            self.dropped += 1
            return False
        jumps = self.jumps
        arrival_s = self._clocks[clock].arrival(stamp_s, now_s)
        if arrival_s is None:
            return False
        if self.jumps != jumps:
            self._parts.clear()
            self._state = None
        before = self._parts.get(part)
        if before is not None and stamp_s <= before.stamp_s:
            return False
        values = np.array(first, np.float64) if part == "position" else _unit(first)
        self._parts[part] = _Half(stamp_s, arrival_s, values, np.array(second, np.float64))
        self._is_new = self._is_new or self._is_open(now_s)
        return True

    def _assembled(self) -> VehicleState | None:
        translation, attitude = self._parts.get("position"), self._parts.get("attitude")
        if translation is None or attitude is None:
            return None
        ahead = attitude.stamp_s - translation.stamp_s
        if abs(ahead) > _MAX_APART_S:
            return None
        position, quat = translation.first, attitude.first
        if ahead > 0:
            position = position + ahead * translation.second
        elif ahead < 0:
            quat = multiply_quat_wxyz(quat, _turn(-ahead * attitude.second))
        return VehicleState(
            received_s=max(translation.arrival_s, attitude.arrival_s),
            position=self.frame.position_from_ned(position),
            velocity=self.frame.vector_from_ned(translation.second),
            attitude_wxyz=self.frame.attitude_from_ned(quat),
            omega=flipped_body(attitude.second),
            latency_s=self._clocks["odometry" if self._has_odometry else "boot"].latency_s,
        )


def quat_from_euler(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Quaternion w, x, y, z of yaw, then pitch, then roll about the body's own axes.

    Args:
        roll: angle about x [rad].
        pitch: angle about y [rad].
        yaw: angle about z [rad].

    Returns:
        The unit quaternion; NaN if an angle is not finite.
    """
    half = (0.5 * roll, 0.5 * pitch, 0.5 * yaw)
    if not all(map(math.isfinite, half)):
        return (math.nan,) * 4
    (cr, cp, cy), (sr, sp, sy) = map(math.cos, half), map(math.sin, half)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def euler_from_quat(quat: NDArray[Any]) -> tuple[float, float, float]:
    """Roll, pitch and yaw [rad] of a quaternion; the inverse of `quat_from_euler`.

    Args:
        quat: unit quaternion w, x, y, z, shape (4,).
    """
    w, x, y, z = map(float, quat)
    return (
        math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x)))),
        math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
    )


def _is_within(values: Any, largest: float) -> bool:
    return all(-largest < value < largest for value in values)  # False for NaN


def _is_quaternion(values: Any) -> bool:
    return bool(0.9 < sum(value * value for value in values) < 1.1)


def _unit(quat: Any) -> FloatArray:
    values = np.array(quat, np.float64)
    unit: FloatArray = values / np.linalg.norm(values)
    return unit


def _turn(vector: FloatArray) -> FloatArray:
    """Quaternion of a rotation vector (exponential map)."""
    angle = float(np.linalg.norm(vector))
    scale = 0.5 * float(np.sinc(angle / (2 * math.pi)))
    return np.array([math.cos(0.5 * angle), *(scale * vector)])
