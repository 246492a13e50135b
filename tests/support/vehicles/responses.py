"""Measurement of an ArduPilot Copter's responses through MAVLink, on the real program or the simulated one.

`measure` flies the manoeuvres and returns the table; `Stepped` and `Wired` are the two lines to a vehicle.
Truth is SIM_STATE, which ArduPilot's own simulation and `alula sim-vehicle` both send.
"""

from __future__ import annotations

import math
import select
import socket
import statistics
import time

from pymavlink.dialects.v20 import ardupilotmega as m

GUIDED, REST = 4, (0.0, 0.0, 0.0)
_VELOCITY = 7 | 448 | 2048  # mask: velocity and heading
_ATTITUDE, _RATES = 7, 128  # masks: an attitude and thrust, rates and thrust
_PERIOD_S = 0.02  # of set-points
_TRUTH_HZ = 200.0
_FALLEN = 1 - math.exp(-1)  # 63 %

# Measured by `measure` on ArduPilot Copter 4.7-dev in its own simulation (model quad, the defaults of
# copter.parm), medians: times of 63 % [s], peaks over commands, and speeds [m/s].
MEASURED = {
    "stop_1_s": 0.737,
    "stop_2_s": 0.880,
    "stop_3_s": 1.086,
    "stop_up_1_s": 0.784,
    "stop_down_1_s": 0.780,
    "stop_up_2_s": 1.354,
    "stop_down_2_s": 0.955,
    "roll_s": 0.031,
    "roll_peak": 1.048,
    "pitch_s": 0.032,
    "pitch_peak": 1.044,
    "yaw_s": 0.277,
    "yaw_peak": 1.227,
    "climb_m_s": 3.963,
    "coast_m_s": 0.816,
    "forced_m_s": 1.006,
}
# The answers of the same program before it has a position.
ANSWERS = {
    "GUIDED": m.MAV_RESULT_ACCEPTED,
    "arming": m.MAV_RESULT_FAILED,
    "interval": m.MAV_RESULT_DENIED,
    "text": True,
    "MAV_GCS_SYSID": 255.0,
    "SYSID_MYGCS": None,
}


_TICK_S = 0.0025


class Stepped:
    """A simulated vehicle in this process, on its own clock; a message takes a tick to it."""

    CLOCK = ()  # messages that its clock needs

    def __init__(self, vehicle):
        self.vehicle = vehicle
        self._sent = []
        self.mav = m.MAVLink(None, srcSystem=255, srcComponent=190)

    @property
    def now(self):
        return self.vehicle.time_s

    def send(self, message):
        self._sent.append(message.pack(self.mav))

    def listen(self, seconds):
        """Let time pass; the messages that arrive, with their times [s]."""
        found, end = [], self.now + seconds
        while self.now < end - 1e-6:
            sent, self._sent = self._sent, []
            for packet in self.vehicle.advance(self.now + _TICK_S):
                found += [(self.now, message) for message in self.mav.parse_buffer(packet) or ()]
            for packet in sent:
                self.vehicle.receive(packet)
        return found


class Wired:
    """A vehicle that sends to a UDP port of this machine.

    Times are those of the vehicle, from the newest message with one: a busy machine slows it, too.
    """

    CLOCK = ("ATTITUDE",)

    def __init__(self, port=0):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", port))
        self.port = self.socket.getsockname()[1]
        self.mav = m.MAVLink(None, srcSystem=255, srcComponent=190)
        self.mav.robust_parsing = True
        self.peer = None
        self._boot_s = self._offset_s = None
        self._beat_s = -math.inf

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.socket.close()

    @property
    def now(self):
        return time.monotonic() if self._boot_s is None else self._boot_s + self._offset_s

    def send(self, message):
        if self.peer is not None:
            self.socket.sendto(message.pack(self.mav), self.peer)

    def listen(self, seconds):
        found, end, silent_s = [], self.now + seconds, time.monotonic() + max(seconds, 5.0)
        if time.monotonic() - self._beat_s > 0.5:
            self._beat_s = time.monotonic()
            self.send(m.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
        while self.now < end and time.monotonic() < silent_s:
            if not select.select([self.socket], [], [], min(0.02, max(seconds, 0.001)))[0]:
                continue
            data, self.peer = self.socket.recvfrom(65536)
            silent_s = time.monotonic() + max(seconds, 5.0)
            for message in self.mav.parse_buffer(data) or ():
                if message.get_type() == "ATTITUDE":
                    self._boot_s = message.time_boot_ms / 1000
                    if self._offset_s is None:
                        self._offset_s = time.monotonic() - self._boot_s
                found.append((self.now, message))
        return found


class Measurer:
    """A client that flies a vehicle and keeps its true motion.

    Attributes:
        truth: rows of time [s], velocity (NED) and body rates (FRD).
        texts: STATUSTEXTs heard so far.
        hover: throttle of hovering, as the vehicle reports it.
    """

    def __init__(self, line):
        self.line = line
        self.truth, self.texts, self._thrust = [], [], []
        self.hover = math.nan

    def listen(self, seconds):
        heard = self.line.listen(seconds)
        for at, message in heard:
            match message.get_type():
                case "SIM_STATE":
                    rates = message.xgyro, message.ygyro, message.zgyro
                    self.truth.append((at, message.vn, message.ve, message.vd, *rates))
                case "STATUSTEXT":
                    self.texts.append(message.text)
                case "ATTITUDE_TARGET":
                    self._thrust.append(message.thrust)
        return [message for _, message in heard]

    def await_message(self, kind, seconds=5.0, accept=lambda message: True):
        """The first message of a kind that is accepted; None if none arrives in time."""
        end = self.line.now + seconds
        while self.line.now < end:
            for message in self.listen(0.02):
                if message.get_type() == kind and accept(message):
                    return message
        return None

    def command(self, number, *params):
        """Send a command; its result, None without an answer."""
        values = [*params, *[0.0] * (7 - len(params))]
        self.line.send(m.MAVLink_command_long_message(1, 1, number, 0, *values))
        ack = self.await_message("COMMAND_ACK", 3.0, lambda message: message.command == number)
        return None if ack is None else ack.result

    def parameter(self, name):
        """Value of a parameter; None if there is none of that name."""
        self.line.send(m.MAVLink_param_request_read_message(1, 1, name.encode(), -1))
        value = self.await_message("PARAM_VALUE", 1.0, lambda message: message.param_id == name)
        return None if value is None else value.param_value

    def set_parameter(self, name, value):
        for _ in range(5):
            self.line.send(m.MAVLink_param_set_message(1, 1, name.encode(), value, 9))
            accept = lambda message: message.param_id == name  # noqa: E731
            answer = self.await_message("PARAM_VALUE", 1.0, accept)
            if answer is not None and answer.param_value == value:
                return
        raise AssertionError(f"{name} was not set")

    def interval(self, name, hertz):
        number = getattr(m, f"MAVLINK_MSG_ID_{name}")
        assert self.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, number, 1e6 / hertz) == 0, name

    def velocity(self, seconds, v=REST, bits=0):
        """Stream a velocity, NED [m/s], with the heading north and more bits in the mask."""
        message = m.MAVLink_set_position_target_local_ned_message
        self._stream(seconds, lambda: message(0, 1, 1, 1, _VELOCITY | bits, *REST, *v, *REST, 0.0, 0.0))

    def attitude(self, seconds, thrust):
        """Stream the level attitude with the heading north."""
        message = m.MAVLink_set_attitude_target_message
        self._stream(seconds, lambda: message(0, 1, 1, _ATTITUDE, [1.0, 0.0, 0.0, 0.0], *REST, thrust))

    def rates(self, seconds, omega, thrust):
        """Stream body rates [rad/s]."""
        message = m.MAVLink_set_attitude_target_message
        self._stream(seconds, lambda: message(0, 1, 1, _RATES, [1.0, 0.0, 0.0, 0.0], *omega, thrust))

    def _stream(self, seconds, make):
        end = self.line.now + seconds
        while (left := end - self.line.now) > 1e-6:
            self.line.send(make())
            self.listen(min(_PERIOD_S, left))

    def greet(self):
        """Answers to a client before there is a position."""
        assert self.await_message("HEARTBEAT", 30.0) is not None, "no vehicle"
        answers = {
            "GUIDED": self.command(m.MAV_CMD_DO_SET_MODE, 1, GUIDED),
            "arming": self.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 1),
            "interval": self.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, 9999, 1000),
        }
        self.listen(0.2)
        answers["text"] = "No ap_message for mavlink id (9999)" in self.texts
        return answers | {name: self.parameter(name) for name in ("MAV_GCS_SYSID", "SYSID_MYGCS")}

    def take_off(self, height_m=12.0):
        """Arm in GUIDED, climb and hover."""
        assert self.await_message("HEARTBEAT", 30.0) is not None, "no vehicle"
        for name in (*self.line.CLOCK, "SIM_STATE"):
            self.interval(name, _TRUTH_HZ)
        self.interval("ATTITUDE_TARGET", 20.0)
        for name, value in (("GUID_OPTIONS", 8.0), ("ATC_ANGLE_BOOST", 0.0), ("GUID_TIMEOUT", 3.0)):
            self.set_parameter(name, value)
        for _ in range(60):
            if self.command(m.MAV_CMD_DO_SET_MODE, 1, GUIDED) == 0 and self.command(400, 1) == 0:
                break
            self.listen(1.0)
        else:
            raise AssertionError(f"not armed: {self.texts[-3:]}")
        for _ in range(10):
            if self.command(m.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, height_m) == 0:
                break
            self.listen(0.5)
        self.listen(6.0)
        while max(abs(v) for v in self.truth[-1][1:4]) > 0.1:
            self.listen(0.2)
        self.velocity(6.0)
        del self._thrust[:]
        self.velocity(2.0)
        self.hover = statistics.fmean(self._thrust)

    def after(self, start, column):
        """Times since a start [s] and one column of the truth."""
        rows = [row for row in self.truth if row[0] >= start - 1 / _TRUTH_HZ]
        return [row[0] - start for row in rows], [row[column] for row in rows]

    def stop_s(self, v, column):
        """Time until a flown velocity has fallen by 63 % after the order to stop [s]."""
        self.velocity(5.0, v)
        begin = self.truth[-1][column]
        assert abs(begin) > 0.9 * max(map(abs, v)), "the velocity is not reached"
        start = self.line.now
        self.velocity(4.0)
        times, values = self.after(start, column)
        return crossing(times, [1 - value / begin for value in values])

    def turn(self, axis, rate, seconds):
        """63 % time [s] and largest share of a step of one body rate."""
        self.velocity(3.0)
        self.attitude(0.5, self.hover)
        omega = tuple(rate if i == axis else 0.0 for i in range(3))
        self.rates(0.1, REST, self.hover)
        start = self.line.now
        self.rates(seconds, omega, self.hover)
        times, values = self.after(start, 4 + axis)
        shares = [value / rate for value in values]
        return crossing(times, shares), max(shares)


def crossing(times, shares):
    """When a step response first passes 63 %, interpolated [s]."""
    for i in range(1, len(times)):
        if shares[i] >= _FALLEN > shares[i - 1]:
            part = (_FALLEN - shares[i - 1]) / (shares[i] - shares[i - 1])
            return times[i - 1] + part * (times[i] - times[i - 1])
    raise AssertionError(f"only {max(shares):.2f} of the step")


def measure(client, repeats=1):
    """Fly the manoeuvres; the table, each row the median of its repetitions."""
    client.take_off()
    found = stops(client, repeats)
    rows = {}
    for axis, (name, seconds) in enumerate((("roll", 0.3), ("pitch", 0.3), ("yaw", 1.5))):
        turns = [client.turn(axis, sign * 0.5, seconds) for sign in (1.0, -1.0) for _ in range(repeats)]
        rows[f"{name}_s"] = [each for each, _ in turns]
        rows[f"{name}_peak"] = [peak for _, peak in turns]
    rows["climb_m_s"] = [_climb(client) for _ in range(repeats)]
    rows["coast_m_s"] = [_coast(client) for _ in range(repeats)]
    client.velocity(3.0)
    client.velocity(3.0, (1.0, 0.0, 0.0), m.POSITION_TARGET_TYPEMASK_FORCE_SET)
    rows["forced_m_s"] = [client.truth[-1][1]]
    return found | _medians(rows)


def stops(client, repeats=1):
    """Times until velocities have fallen by 63 % after a stop, each the median of its repetitions [s]."""
    rows = {}
    for speed in (1.0, 2.0, 3.0):
        rows[f"stop_{speed:g}_s"] = [
            client.stop_s((sign * speed, 0.0, 0.0), 1) for sign in (1.0, -1.0) for _ in range(repeats)
        ]
    for speed in (1.0, 2.0):
        rows[f"stop_up_{speed:g}_s"] = [client.stop_s((0.0, 0.0, -speed), 3) for _ in range(repeats)]
        rows[f"stop_down_{speed:g}_s"] = [client.stop_s((0.0, 0.0, speed), 3) for _ in range(repeats)]
    return _medians(rows)


def _medians(rows):
    return {name: statistics.median(values) for name, values in rows.items()}


def _climb(client):
    """Speed after a second of 1.5 times the hover thrust, from rest, level [m/s]."""
    client.velocity(4.0)
    client.attitude(0.1, client.hover)
    start = client.line.now
    client.attitude(1.05, 1.5 * client.hover)
    times, values = client.after(start, 3)
    client.velocity(4.0)
    client.velocity(3.0, (0.0, 0.0, 1.0))
    return -min(zip(times, values, strict=True), key=lambda row: abs(row[0] - 1.0))[1]


def _coast(client):
    """Speed 4 s after the last set-point, of zero rates at 2 m/s, level [m/s]."""
    client.velocity(5.0, (2.0, 0.0, 0.0))
    client.attitude(0.3, client.hover)
    client.rates(0.1, REST, client.hover)
    begin = client.truth[-1][1]
    client.listen(4.0)
    return 2.0 * client.truth[-1][1] / begin
