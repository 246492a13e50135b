"""Motion capture: poses received as datagrams and forwarded to the vehicle.

A datagram is one JSON object of at most 1 KiB, in the world frame (z up, body x forward, y left, z up):

    {"time_s": 12.345, "position_m": [1, 2, 0.5], "attitude_wxyz": [1, 0, 0, 0], "velocity_m_s": [0, 0, 0]}

`time_s` is the sender's clock and must increase; `velocity_m_s` is optional. A MAVLink vehicle gets the poses
as vision estimates (`Mocap`), a Crazyflie as external poses (`PoseFeed`).
"""

from __future__ import annotations

import math
import socket
from collections import deque
from typing import Any

import msgspec
import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from alula.schemas.arrays import FloatArray
from alula.schemas.errors import LinkError, UsageError
from alula.stages.flight.links.addresses import parse_address
from alula.stages.flight.links.mavlink.assembler import euler_from_quat
from alula.stages.flight.links.mavlink.transport import find_udp
from alula.stages.flight.links.vehicle_clock import VehicleClock
from alula.stages.vehicles.frames import LocalFrame

STALE_S = 0.15
_PATIENCE_S = 2.0  # after that long a camera clock that was set back a little is accepted
_DESERTED_S = 2.0  # another sender is accepted when the first was silent for so long
_PERIOD_S = 0.02
_POSE_PERIOD_S = 0.01
_MAX_BYTES = 1024
_MAX_READS = 64
_SLOPE_S = 0.1  # velocities are fitted over this time
_LARGEST_M, _LARGEST_M_S = 1e4, 1e2

Triple = tuple[float, float, float]


class MocapSample(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The content of a datagram."""

    time_s: float
    position_m: Triple
    attitude_wxyz: tuple[float, float, float, float]
    velocity_m_s: Triple | None = None


class Mocap:
    """Receiver of motion capture that makes VISION_POSITION_ and VISION_SPEED_ESTIMATE, or ODOMETRY: 50 Hz.

    It sends them while samples arrive. It drops a sample that is not finite, out of range, without a unit
    attitude, late or repeated. The sender of the first good sample is the only one until it has been silent
    for 2 s: samples from other addresses are refused. Nothing proves who it is, so the address belongs on
    this machine or in a network of its own.

    Args:
        address: `udp:HOST:PORT` to listen on.

    Attributes:
        bad: number of datagrams that were refused.

    Raises:
        UsageError: the address is not of this form.
    """

    def __init__(self, address: str, frame: LocalFrame) -> None:
        parsed = parse_address(address)
        parsed.only()
        if parsed.scheme != "udp":
            raise UsageError(f"{address}: motion capture needs an address udp:HOST:PORT")
        self._host_port = parsed.host_port()
        self._frame = frame
        self._socket: socket.socket | None = None
        self._decoder = msgspec.json.Decoder(MocapSample)
        self._clock = VehicleClock(_PATIENCE_S)
        self._recent: deque[tuple[float, MocapSample]] = deque(maxlen=256)
        self._sender: Any = None
        self._heard_s = -math.inf
        self._arrival_s = -math.inf
        self._next_s = -math.inf
        self._sent_s = -math.inf
        self._resets = 0
        self.bad = 0

    def open(self) -> None:
        """Start to listen.

        Raises:
            LinkError: the address is in use or does not belong to this machine.
        """
        try:
            family, local = find_udp(*self._host_port)
            self._socket = socket.socket(family, socket.SOCK_DGRAM)
            self._socket.setblocking(False)
            self._socket.bind(local)
        except OSError as error:
            self.close()
            raise LinkError(
                f"udp:{self._host_port[0]}:{self._host_port[1]}: {error.strerror or error}"
            ) from error

    def is_fresh(self, now_s: float) -> bool:
        """Return whether the newest sample is at most 0.15 s old, counting from the smallest delay so far."""
        return now_s - self._arrival_s <= STALE_S

    def poll(self, now_s: float, start_s: float, *, as_odometry: bool = False) -> list[Any]:
        """Receive datagrams and return the messages that are due.

        Args:
            start_s: zero of the time stamps in the messages, same clock [s].
            as_odometry: whether to make ODOMETRY.
        """
        self.take_all(now_s)
        if now_s < self._next_s or not self._recent or self._arrival_s <= self._sent_s:
            return []
        behind = now_s - self._next_s
        self._next_s = now_s + _PERIOD_S if behind > _PERIOD_S else self._next_s + _PERIOD_S
        self._sent_s = self._arrival_s
        if not self.is_fresh(now_s):
            return []
        return self._messages(max(round((self._arrival_s - start_s) * 1e6), 0), as_odometry)

    def take_all(self, now_s: float) -> None:
        """Receive the waiting datagrams, at most 64 in one call."""
        assert self._socket is not None
        for _ in range(_MAX_READS):
            try:
                data, sender = self._socket.recvfrom(_MAX_BYTES + 1)
            except OSError:
                break
            self.take(data, now_s, sender)

    def take(self, data: bytes, now_s: float, sender: Any = None) -> None:
        """Process a datagram.

        Args:
            now_s: when it arrived, monotonic clock [s].
        """
        is_stranger = sender != self._sender and now_s - self._heard_s < _DESERTED_S
        sample = None if is_stranger else self._checked(data)
        if sample is None:
            self.bad += 1
            return
        self._sender, self._heard_s = sender, now_s
        jumps = self._clock.jumps
        arrival_s = self._clock.arrival(sample.time_s, now_s)
        if self._clock.jumps != jumps:
            self._recent.clear()
            self._resets = (self._resets + 1) % 256
        if arrival_s is None or (self._recent and sample.time_s <= self._recent[-1][1].time_s):
            return
        self._arrival_s = arrival_s
        self._recent.append((arrival_s, sample))

    def close(self) -> None:
        """Stop listening."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _checked(self, data: bytes) -> MocapSample | None:
        if len(data) > _MAX_BYTES:
            return None
        try:
            sample = self._decoder.decode(data)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            return None
        norm = sum(each * each for each in sample.attitude_wxyz)
        velocity = sample.velocity_m_s or (0.0, 0.0, 0.0)
        is_good = (
            math.isfinite(sample.time_s)
            and 0.98 < norm < 1.02
            and all(abs(each) < _LARGEST_M for each in sample.position_m)
            and all(abs(each) < _LARGEST_M_S for each in velocity)
        )
        return sample if is_good else None

    def _messages(self, stamp: int, as_odometry: bool = False) -> list[Any]:
        sample = self._recent[-1][1]
        position = self._frame.position_to_ned(np.array(sample.position_m))
        quat = np.array(sample.attitude_wxyz)
        attitude = self._frame.attitude_to_ned(quat / np.linalg.norm(quat))
        velocity = self._frame.vector_to_ned(self._velocity(sample))
        if as_odometry:
            unknown = [math.nan] + [0.0] * 20
            return [
                dialect.MAVLink_odometry_message(
                    *(stamp, dialect.MAV_FRAME_LOCAL_NED, dialect.MAV_FRAME_LOCAL_NED),
                    *(*position.tolist(), attitude.tolist(), *velocity.tolist()),
                    *(math.nan, math.nan, math.nan, unknown, unknown),
                    *(self._resets, dialect.MAV_ESTIMATOR_TYPE_VISION),  # EKF2 does not take MOCAP
                )
            ]
        euler = euler_from_quat(attitude)
        return [
            dialect.MAVLink_vision_position_estimate_message(
                stamp, *position.tolist(), *euler, reset_counter=self._resets
            ),
            dialect.MAVLink_vision_speed_estimate_message(
                stamp, *velocity.tolist(), reset_counter=self._resets
            ),
        ]

    def _velocity(self, newest: MocapSample) -> Any:
        """The velocity in the sample, or the slope of a line fitted to the last tenth of a second."""
        if newest.velocity_m_s is not None:
            return np.array(newest.velocity_m_s)
        near = [each for _, each in self._recent if newest.time_s - each.time_s <= _SLOPE_S]
        time = np.array([each.time_s for each in near]) - newest.time_s
        time = time - time.mean()
        square = float(time @ time)
        if square == 0:
            return np.zeros(3)
        slope = time @ np.array([each.position_m for each in near]) / square
        return np.clip(slope, -_LARGEST_M_S, _LARGEST_M_S)


class PoseFeed(Mocap):
    """Receiver of motion capture that gives poses in the vehicle's frame at up to 100 Hz."""

    def pose(self, now_s: float) -> tuple[FloatArray, FloatArray] | None:
        """Receive datagrams; position [m] and attitude (w, x, y, z) if a new pose is due, else None."""
        self.take_all(now_s)
        is_new = self._arrival_s > self._sent_s
        # Half a period early counts as due, because the loop's ticks are as long as the period.
        if not is_new or now_s < self._next_s - _POSE_PERIOD_S / 2 or not self.is_fresh(now_s):
            return None
        self._next_s = max(self._next_s + _POSE_PERIOD_S, now_s)
        self._sent_s = self._arrival_s
        return self.newest()

    def newest(self) -> tuple[FloatArray, FloatArray] | None:
        """The newest pose, position [m] and attitude (w, x, y, z), even if it was already sent."""
        if not self._recent:
            return None
        sample = self._recent[-1][1]
        quat = np.array(sample.attitude_wxyz)
        position = self._frame.position_to_local(np.array(sample.position_m))
        return position, self._frame.attitude_to_local(quat / math.sqrt(float(quat @ quat)))
