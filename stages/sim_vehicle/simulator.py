"""The simulated MAVLink vehicle with either firmware: bytes in and out, on the caller's clock."""

from __future__ import annotations

from dataclasses import dataclass, replace

import msgspec
import numpy as np

from alula.stages.sim_vehicle.ardupilot.copter import ArduCopter
from alula.stages.sim_vehicle.ardupilot.dialogue import Dialogue
from alula.stages.sim_vehicle.ardupilot.modes import Mode
from alula.stages.sim_vehicle.ardupilot.telemetry import Telemetry
from alula.stages.sim_vehicle.common.airframe import Motion
from alula.stages.sim_vehicle.common.copter import Copter
from alula.stages.sim_vehicle.common.faults import Fault, Schedule
from alula.stages.sim_vehicle.common.line import Line
from alula.stages.sim_vehicle.common.packets import Codec, Message
from alula.stages.sim_vehicle.common.quaternions import Vector
from alula.stages.sim_vehicle.px4.modes import SWITCH
from alula.stages.sim_vehicle.px4.protocol import Px4Dialogue, Px4Telemetry
from alula.stages.sim_vehicle.px4.vehicle import Px4Copter
from alula.stages.vehicles.frames import LocalFrame

_SIGNING_EPOCH_S = 1420070400  # 2015-01-01, the epoch of signature time stamps
_MOCAP_PERIOD_S = 0.01
_MOCAP_NOISE_M = 0.0005


@dataclass(frozen=True, slots=True)
class Firmware:
    """Classes of a firmware; body, estimator and control loops are the same for all.

    Attributes:
        copter: modes, arming, failsafes and names of parameters.
        telemetry: messages and their default rates.
        dialogue: commands, encodings, and accepted set-points.
        switch: positions of the pilot's mode switch by name, for the fault `mode`.
    """

    copter: type[Copter]
    telemetry: type[Telemetry]
    dialogue: type[Dialogue]
    switch: dict[str, int]


FIRMWARES: dict[str, Firmware] = {
    "ardupilot": Firmware(ArduCopter, Telemetry, Dialogue, {mode.name: int(mode) for mode in Mode}),
    "px4": Firmware(Px4Copter, Px4Telemetry, Px4Dialogue, SWITCH),
}


def signing_time(epoch_s: float) -> int:
    """Signature time stamp of a Unix time [s], in units of 10 us since 2015."""
    return max(0, int((epoch_s - _SIGNING_EPOCH_S) * 1e5))


class SimulatedVehicle:
    """A `Copter` on a MAVLink channel, with faults.

    It uses neither sockets nor the system's clock: `receive` takes bytes, `advance` simulates up to a time
    and returns the packets to send. Tests may access `copter`, call `inject`, and move the remote control's
    sticks by `copter.pilot`.

    Args:
        seed: seed of the faults and of the noise of motion capture.
        channel: number of the serial port; channel 0 accepts unsigned packets even with a key.
        key: 32 bytes for signatures, or None.
        epoch_s: Unix time at boot for SYSTEM_TIME and signatures [s]; 0 if unknown.
        camera_start: initial position in the frame of motion capture, east north up [m].
    """

    def __init__(
        self,
        copter: Copter,
        *,
        faults: tuple[Fault, ...] = (),
        seed: int = 0,
        channel: int = 0,
        key: bytes | None = None,
        epoch_s: float = 0.0,
        camera_start: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> None:
        self.copter = copter
        self.codec = Codec(
            copter.parameters.whole("MAV_SYSID"),
            channel=channel,
            key=key,
            time_10us=signing_time(epoch_s),
        )
        self._schedule = Schedule(faults)
        self._line = Line(self.codec, self._schedule, seed)
        firmware = FIRMWARES[copter.AUTOPILOT]
        self.telemetry = firmware.telemetry(copter, epoch_s)
        self._dialogue = firmware.dialogue(copter, self.telemetry, self.codec, signing_time(epoch_s))
        self._random = np.random.default_rng([seed, 10])
        self._begun: dict[int, bool] = {}  # faults of the vehicle that were drawn: whether they act
        self._outbox: list[bytes] = []
        self._camera = Camera(seed, camera_start)
        self._datagrams = 0

    @property
    def time_s(self) -> float:
        """Time since boot [s]."""
        return self.copter.time_s

    def inject(self, fault: Fault) -> None:
        """Inject a fault `fault.start` seconds from now."""
        self._schedule.add(replace(fault, start=self.time_s + fault.start, since="boot"))

    def receive(self, data: bytes) -> None:
        """Process received bytes; the next `advance` returns the answers."""
        for message in self._line.receive(data, self.time_s):
            self._answer(message)

    def advance(self, to_s: float) -> list[bytes]:
        """Simulate up to a time since boot.

        Returns:
            The packets to send, each in a datagram of its own.
        """
        copter, line, schedule = self.copter, self._line, self._schedule
        while copter.time_s < to_s - 1e-9:
            self._fail()
            copter.tick()
            now_s = copter.time_s
            if copter.is_armed:
                schedule.mark("arm", now_s)
            if not copter.is_landed:
                schedule.mark("airborne", now_s)
            for message in line.late_messages(now_s):
                self._answer(message)
            for message in self._dialogue.due():
                self._send(message)
            self._outbox += line.late_packets(now_s)
        packets, self._outbox = self._outbox, []
        return packets

    def mocap(self) -> bytes | None:
        """Datagram of motion capture, 100 times a second; None between them and during its loss."""
        if self.time_s < self._datagrams * _MOCAP_PERIOD_S - 1e-9:
            return None
        self._datagrams = int(self.time_s / _MOCAP_PERIOD_S + 1e-6) + 1
        if self.copter.estimator.is_mocap_lost:
            return None
        return self._camera.datagram(self.time_s, self.copter.airframe.truth)

    def _answer(self, message: Message) -> None:
        for reply in self._dialogue.answer(message):
            self._send(reply)

    def _send(self, message: Message) -> None:
        self._outbox += self._line.send(message, self.time_s)

    def _fail(self) -> None:
        """Apply faults of the vehicle itself; each is drawn once, when it begins."""
        if not self._schedule:
            return
        estimator, copter = self.copter.estimator, self.copter
        acting: dict[str, Fault] = {}
        for fault in self._schedule.acting(self.time_s):
            fresh = id(fault) not in self._begun
            if fresh:
                self._begun[id(fault)] = fault.probability >= 1 or self._random.random() < fault.probability
            if not self._begun[id(fault)]:
                continue
            acting[fault.kind] = fault
            if fresh and fault.kind == "mode":
                copter.switch_to(fault.amount)
            elif fresh and fault.kind == "battery":
                copter.battery.drain_to(fault.size)
        jump = acting.get("jump")
        estimator.offset = (0.0, 0.0, 0.0) if jump is None else (jump.size, 0.0, 0.0)
        fixes = acting.get("fixes")
        estimator.fix_offset = (0.0, 0.0, 0.0) if fixes is None else (fixes.size, 0.0, 0.0)
        copter.spoil_compass(is_bad="compass" in acting)
        estimator.is_mocap_lost = "mocap-loss" in acting
        estimator.are_satellites_lost = "satellites" in acting
        copter.airframe.are_rotors_dead = "rotors" in acting
        estimator.has_failed = "estimator" in acting
        copter.pilot.is_lost = "radio-loss" in acting


class Camera:
    """Motion capture: the true pose with noise of 0.5 mm, in east-north-up with body forward-left-up.

    Args:
        start: initial position of the vehicle in the camera's frame [m].
    """

    def __init__(self, seed: int, start: Vector = (0.0, 0.0, 0.0)) -> None:
        x, y, z = start
        self._frame = LocalFrame(0.0, (-x, -y, -z))
        self._random = np.random.default_rng([seed, 11])

    def datagram(self, time_s: float, truth: Motion) -> bytes:
        """Datagram for `alula fly --mocap`: time [s], position [m], attitude (w, x, y, z) as JSON."""
        position = self._frame.position_from_ned(np.array(truth.position))
        position += _MOCAP_NOISE_M * self._random.standard_normal(3)
        attitude = self._frame.attitude_from_ned(np.array(truth.attitude))
        return msgspec.json.encode(
            {"time_s": time_s, "position_m": position.tolist(), "attitude_wxyz": attitude.tolist()}
        )
