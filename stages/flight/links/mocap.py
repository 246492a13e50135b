"""Motion capture: datagrams with poses come in, vision estimates go out to the vehicle.

A datagram is one JSON object of at most 1 KiB, in the world frame (z up, body x forward, y left, z up):

    {"time_s": 12.345, "position_m": [1, 2, 0.5], "attitude_wxyz": [1, 0, 0, 0], "velocity_m_s": [0, 0, 0]}

`time_s` is the sender's clock and grows; `velocity_m_s` may be left out.
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
from alula.stages.flight.links.mavlink.estimate import euler_from_quat
from alula.stages.flight.links.mavlink.transport import find_udp
from alula.stages.flight.links.vehicle_clock import VehicleClock
from alula.stages.vehicles.frames import LocalFrame

STALE_S = 0.15
_PATIENCE_S = 2.0  # with a camera whose clock was set back a little
_PERIOD_S = 0.02
_POSE_PERIOD_S = 0.01
_MOST_BYTES = 1024
_MOST_READS = 64
_SLOPE_S = 0.1  # over which a velocity is fitted
_LARGEST_M, _LARGEST_M_S = 1e4, 1e2

Triple = tuple[float, float, float]


class MocapSample(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What a datagram says."""

    time_s: float
    position_m: Triple
    attitude_wxyz: tuple[float, float, float, float]
    velocity_m_s: Triple | None = None


class Mocap:
    """Listens, and forwards VISION_POSITION_ESTIMATE and VISION_SPEED_ESTIMATE at 50 Hz while samples come.

    A sample that is not finite, out of range, no unit attitude, late or a copy is as good as missing.

    Args:
        address: `udp:HOST:PORT`.
        frame: where the world lies in the vehicle's local frame.

    Attributes:
        bad: datagrams that were refused.
    """

    def __init__(self, address: str, frame: LocalFrame) -> None:
        parsed = parse_address(address)
        parsed.only()
        if parsed.scheme != "udp":
            raise UsageError(f"{address}: motion capture comes by udp:HOST:PORT")
        self._place = parsed.host_port()
        self._frame = frame
        self._socket: socket.socket | None = None
        self._decoder = msgspec.json.Decoder(MocapSample)
        self._clock = VehicleClock(_PATIENCE_S)
        self._recent: deque[tuple[float, MocapSample]] = deque(maxlen=256)
        self._arrival_s = -math.inf
        self._next_s = -math.inf
        self._sent_s = -math.inf
        self._resets = 0
        self.bad = 0

    def open(self) -> None:
        """Begin to listen.

        Raises:
            LinkError: the address is taken or not ours.
        """
        try:
            family, place = find_udp(*self._place)
            self._socket = socket.socket(family, socket.SOCK_DGRAM)
            self._socket.setblocking(False)
            self._socket.bind(place)
        except OSError as error:
            self.close()
            raise LinkError(f"udp:{self._place[0]}:{self._place[1]}: {error.strerror or error}") from error

    def is_fresh(self, now_s: float) -> bool:
        """Whether the newest sample came less than 0.15 s ago, as by the fastest way so far."""
        return now_s - self._arrival_s <= STALE_S

    def poll(self, now_s: float, start_s: float) -> list[Any]:
        """Take in what has come; messages that are due, with time since `start_s`."""
        self.take_all(now_s)
        if now_s < self._next_s or not self._recent or self._arrival_s <= self._sent_s:
            return []
        behind = now_s - self._next_s
        self._next_s = now_s + _PERIOD_S if behind > _PERIOD_S else self._next_s + _PERIOD_S
        self._sent_s = self._arrival_s
        return self._messages(round((self._arrival_s - start_s) * 1e6)) if self.is_fresh(now_s) else []

    def take_all(self, now_s: float) -> None:
        """The datagrams that have come, at most 64 of them at once."""
        assert self._socket is not None
        for _ in range(_MOST_READS):
            try:
                data = self._socket.recv(_MOST_BYTES + 1)
            except OSError:
                break
            self.take(data, now_s)

    def take(self, data: bytes, now_s: float) -> None:
        """A datagram."""
        sample = self._checked(data)
        if sample is None:
            self.bad += 1
            return
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
        if len(data) > _MOST_BYTES:
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

    def _messages(self, time_us: int) -> list[Any]:
        sample = self._recent[-1][1]
        position = self._frame.position_to_ned(np.array(sample.position_m))
        quat = np.array(sample.attitude_wxyz)
        euler = euler_from_quat(self._frame.attitude_to_ned(quat / np.linalg.norm(quat)))
        velocity = self._frame.vector_to_ned(self._velocity(sample))
        stamp = max(time_us, 0)
        return [
            dialect.MAVLink_vision_position_estimate_message(
                stamp, *position.tolist(), *euler, reset_counter=self._resets
            ),
            dialect.MAVLink_vision_speed_estimate_message(
                stamp, *velocity.tolist(), reset_counter=self._resets
            ),
        ]

    def _velocity(self, newest: MocapSample) -> Any:
        """The sample's own, or the slope of a line through the last tenth of a second."""
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
    """The newest fresh pose, in the vehicle's frame; datagrams are those of `mocap`."""

    def pose(self, now_s: float) -> tuple[FloatArray, FloatArray] | None:
        """Take in what has come; position and attitude (w, x, y, z) if a new one is due."""
        self.take_all(now_s)
        is_new = self._arrival_s > self._sent_s
        # Half a period early is in time: ticks of the loop are as long as the period.
        if not is_new or now_s < self._next_s - _POSE_PERIOD_S / 2 or not self.is_fresh(now_s):
            return None
        self._next_s = max(self._next_s + _POSE_PERIOD_S, now_s)
        self._sent_s = self._arrival_s
        return self.newest()

    def newest(self) -> tuple[FloatArray, FloatArray] | None:
        """The newest pose, whether it was taken or not."""
        if not self._recent:
            return None
        sample = self._recent[-1][1]
        quat = np.array(sample.attitude_wxyz)
        position = self._frame.position_to_local(np.array(sample.position_m))
        return position, self._frame.attitude_to_local(quat / math.sqrt(float(quat @ quat)))
