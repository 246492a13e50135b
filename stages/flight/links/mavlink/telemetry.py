"""Reported status of a vehicle besides its state: mode, battery, health, texts; old values are unknown."""

from __future__ import annotations

import math
import re
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from alula.stages.flight.links.mavlink.autopilots import Autopilot
from alula.stages.flight.links.mavlink.satellites import KINDS, Satellites
from alula.stages.flight.links.protocol import VehicleStatus

_OLD_S = {"HEARTBEAT": 5.0, "SYS_STATUS": 10.0, "EXTENDED_SYS_STATE": 3.0, "ESTIMATOR": 3.0}
_MAX_TEXTS = 100
# Bits of EKF_STATUS_REPORT (ArduPilot) and ESTIMATOR_STATUS (PX4).
_FLAGS_NEEDED = {1: "attitude", 2: "horizontal velocity", 4: "vertical velocity", 32: "height"}
_FLAGS_EITHER = 8 | 16  # position, relative or absolute
_CONSTANT = "constant position mode"
_FLAGS_BAD = {  # each bit makes an estimate useless unless one of the bits beside its name is set, too
    "EKF_STATUS_REPORT": {
        128: (_CONSTANT, 0),
        1024: ("not initialised", 0),
        1 << 15: ("satellites are not accurate", 0),
    },
    # PX4 sets 128 whenever it rests on the ground; 256 says that it measures its horizontal motion
    "ESTIMATOR_STATUS": {128: (_CONSTANT, 256), 1024: ("a jump of satellites", 0)},
}
# Innovations of EKF_STATUS_REPORT, divided by their gates: above 1 the estimate refuses what is measured.
# In ArduPilot's simulation a sound compass gives 0.02, and one that is 400 mG off 0.75.
_RATIOS = {
    "compass_variance": ("compass", 0.5),
    "pos_horiz_variance": ("horizontal positions", 1.0),
    "velocity_variance": ("velocities", 1.0),
}
_REFUSED_S = 1.0  # a gust or a turn may make it refuse some for a moment
_NO_VOLTAGE = 0xFFFF
_LANDED = {
    dialect.MAV_LANDED_STATE_ON_GROUND: True,
    dialect.MAV_LANDED_STATE_IN_AIR: False,
    dialect.MAV_LANDED_STATE_TAKEOFF: False,
    dialect.MAV_LANDED_STATE_LANDING: False,
}
_FAILSAFE = re.compile(r"failsafe|breach|^Crash: ", re.IGNORECASE)
_OVER = re.compile(r"clear|deactivated|resolved", re.IGNORECASE)
_REASON = re.compile(r"Battery \d+ is |EKF variance|Dead Reckoning (started|timeout)|GPS Glitch")
_OF_ARMING = re.compile(r"(Pre)?Arm:|Preflight|Mode change", re.IGNORECASE)
_REASON_S = 2.0  # a failsafe is reported this long after its reason at most
_PREARM = dialect.MAV_SYS_STATUS_PREARM_CHECK
_REFUSAL = "PreArm: "
_REFUSAL_S = 35.0  # ArduPilot repeats the reasons every 30 s
_PIECE = 50  # characters of a STATUSTEXT; a shorter piece is the last
_MAX_PIECES = 8
_MAX_OPEN = 4
_PATIENCE_S = 1.0


class Telemetry:
    """Updates a `VehicleStatus` from messages.

    Attributes:
        heartbeat: the newest HEARTBEAT; None before the first.
        mode: its main and sub mode; None if unknown or old.
        autopilot: the family that defines the modes; None before it is known.
    """

    def __init__(self) -> None:
        self.status = VehicleStatus()
        self.heartbeat: Any = None
        self.mode: tuple[int, int] | None = None
        self.autopilot: Autopilot | None = None
        self.satellites = Satellites()
        self._flags: tuple[str, int] | None = None  # newest kind of message with its flags
        self._refused_s: dict[str, float] = {}  # since when the estimate contradicts it, by name
        self._judged_s = -math.inf  # newest message with flags
        self._texts = Texts()
        self._reason = (-math.inf, "")
        self._refusals: dict[str, float] = {}  # reasons not to arm, and when they were given last
        self._arrived_s: dict[str, float] = {}  # by kind of message

    @property
    def beat_s(self) -> float:
        """Arrival time of the newest HEARTBEAT; minus infinity if it is old [s]."""
        return self._arrived_s.get("HEARTBEAT", -math.inf)

    def take(self, message: Any, now_s: float) -> list[str]:
        """Process a message that arrived at `now_s` [s]; returns the texts that it completes."""
        kind, status = message.get_type(), self.status
        if kind == "STATUSTEXT":
            texts = self.say(*self._texts.take(message, now_s))
            for text in texts:
                self._read_failsafe(text, now_s)
                if text.startswith(_REFUSAL):
                    self._refusals[text.removeprefix(_REFUSAL)] = now_s
            self._judge_arming(now_s)
            return texts
        if kind == "HEARTBEAT":
            self.heartbeat = message
            self.read_mode()
        elif kind == "SYS_STATUS":
            voltage, percent = message.voltage_battery, message.battery_remaining
            status.battery_v = voltage * 1e-3 if 0 < voltage < _NO_VOLTAGE else None
            if self.autopilot is not None and self.autopilot.reports_arming:
                is_made = message.onboard_control_sensors_enabled & _PREARM
                status.can_arm = bool(message.onboard_control_sensors_health & _PREARM) if is_made else None
                self._judge_arming(now_s)
            status.battery_share = percent * 1e-2 if 0 <= percent <= 100 else None
        elif kind == "EXTENDED_SYS_STATE":
            status.landed = _LANDED.get(message.landed_state)
        elif kind in _FLAGS_BAD:
            self._read_ratios(message, now_s)
            self._flags, kind = (kind, message.flags), "ESTIMATOR"
            self._judge_estimator(now_s)
        elif kind in KINDS:
            self.satellites.take(message, now_s)
            status.strayed_m = self.satellites.strayed_m
            return []
        elif kind == "LOCAL_POSITION_NED":
            self.satellites.estimated((message.vx, message.vy), (message.x, message.y))
            return []
        else:
            return []
        self._arrived_s[kind] = now_s
        return []

    def read_mode(self) -> None:
        """Update the status from the newest heartbeat."""
        if self.autopilot is None or self.heartbeat is None:
            return
        status, beat = self.status, self.heartbeat
        main, sub, status.mode = self.autopilot.mode_of(beat.custom_mode)
        self.mode = main, sub
        control_main, control_sub = self.autopilot.control
        status.obeys = main == control_main and (control_sub in (0, sub))
        status.armed = bool(beat.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED)
        status.is_failsafe = beat.system_status in (
            dialect.MAV_STATE_CRITICAL,
            dialect.MAV_STATE_EMERGENCY,
            dialect.MAV_STATE_FLIGHT_TERMINATION,
        )

    def _judge_estimator(self, now_s: float) -> None:
        status = self.status
        if self._flags is None:
            status.is_estimator_ready, status.estimator = None, ""
            return
        refused = [name for name, since in self._refused_s.items() if self._judged_s - since >= _REFUSED_S]
        status.estimator = _trouble_of(*self._flags) or self.satellites.trouble(now_s)
        if refused and not status.estimator:
            status.estimator = f"it contradicts what it measures: {', '.join(refused)}"
        status.is_estimator_ready = not status.estimator

    def _read_ratios(self, message: Any, now_s: float) -> None:
        self._judged_s = now_s
        for field, (name, most) in _RATIOS.items():
            if getattr(message, field, 0.0) > most:
                self._refused_s.setdefault(name, now_s)
            else:
                self._refused_s.pop(name, None)

    def _judge_arming(self, now_s: float) -> None:
        recent = [reason for reason, at_s in self._refusals.items() if now_s - at_s <= _REFUSAL_S]
        self.status.arming = "; ".join(recent) if self.status.can_arm is False else ""
        if self.status.can_arm:
            self._refusals.clear()

    def _read_failsafe(self, text: str, now_s: float) -> None:
        """Keep a text that names a failsafe, with the reason that the vehicle gave just before."""
        if _OF_ARMING.match(text):
            return
        if _REASON.match(text):
            self._reason = now_s, text
        elif _FAILSAFE.search(text):
            at_s, reason = self._reason
            recent = reason if now_s - at_s <= _REASON_S else ""
            self.status.failsafe = "" if _OVER.search(text) else "; ".join(filter(None, (text, recent)))

    def say(self, *texts: str) -> list[str]:
        """Append texts for the user; beyond 100 the oldest are dropped."""
        self.status.texts += texts
        del self.status.texts[:-_MAX_TEXTS]
        return list(texts)

    def poll(self, now_s: float) -> None:
        """Mark old values as unknown."""
        self.say(*self._texts.flush(now_s))
        status = self.status
        self._judge_estimator(now_s)
        for kind in [kind for kind, at in self._arrived_s.items() if now_s - at > _OLD_S[kind]]:
            del self._arrived_s[kind]
            if kind == "HEARTBEAT":
                status.armed, status.obeys, status.mode, self.mode = None, False, "", None
            elif kind == "SYS_STATUS":
                status.battery_v = status.battery_share = status.can_arm = None
            elif kind == "EXTENDED_SYS_STATE":
                status.landed = None
            else:
                self._flags = None
                self._judge_estimator(now_s)


def _trouble_of(kind: str, flags: int) -> str:
    """What an estimate lacks by the flags of a kind of message; empty if it is good enough to fly."""
    missing = [name for bit, name in _FLAGS_NEEDED.items() if not flags & bit]
    missing += [] if flags & _FLAGS_EITHER else ["position"]
    bad = _FLAGS_BAD[kind]
    found = [name for bit, (name, unless) in bad.items() if flags & bit and not flags & unless]
    return "; ".join([f"no {', '.join(missing)}"] * bool(missing) + found)


class Texts:
    """Joins the pieces of long STATUSTEXTs and removes characters that a terminal could execute."""

    def __init__(self) -> None:
        self._open: dict[int, tuple[float, dict[int, str]]] = {}

    def take(self, message: Any, now_s: float) -> list[str]:
        """Process a STATUSTEXT that arrived at `now_s` [s]; returns the texts that it completes."""
        piece = _printable(message.text)
        if message.id == 0:
            return [piece] if piece else []
        done = []
        if message.id not in self._open and len(self._open) >= _MAX_OPEN:
            done += self._finish(min(self._open, key=lambda each: self._open[each][0]))
        _, pieces = self._open.setdefault(message.id, (now_s, {}))
        if message.chunk_seq < _MAX_PIECES:
            pieces[message.chunk_seq] = piece
        last = max(pieces, default=0)
        is_ended = len(_str_of(message.text)) < _PIECE or last == _MAX_PIECES - 1
        if is_ended and len(pieces) == last + 1:
            done += self._finish(message.id)
        return done

    def flush(self, now_s: float) -> list[str]:
        """Incomplete texts whose missing piece is overdue, with a gap in its place."""
        late = [each for each, (since_s, _) in self._open.items() if now_s - since_s > _PATIENCE_S]
        return [text for each in late for text in self._finish(each)]

    def _finish(self, number: int) -> list[str]:
        _, pieces = self._open.pop(number)
        text = "".join(pieces.get(each, "...") for each in range(max(pieces, default=-1) + 1))
        return [text] if text else []


def _str_of(text: bytes | str) -> str:
    """Decode a text; pymavlink returns either type."""
    return text.decode("utf-8", "replace") if isinstance(text, bytes | bytearray) else text


def _printable(text: bytes | str) -> str:
    return "".join(each for each in _str_of(text) if each.isprintable())
