"""ArduPilot's own simulation, which ALULA_ARDUCOPTER names, flown by `alula fly` in a process of its own.

A second connection is another station: it sets parameters, breaks
sensors, and reads the true motion (SIM_STATE) and all texts.
"""

import math
import socket
import struct
import threading
import time
from contextlib import contextmanager, suppress

from alula.stages.sim_vehicle.common.packets import mavlink
from support.scenes.small_scenes import box_cover, line_plan
from support.vehicles.arducopter import arducopter, second_port
from support.vehicles.fly_process import fly
from support.vehicles.sim_vehicle_process import free_port, until

START, GOAL = (0.0, 0.0, 1.5), (14.0, 0.0, 1.5)
WALLS = box_cover([((0, 60, 0), (140, 64, 30)), ((0, -64, 0), (140, -60, 30))])  # at y = 6 m and -6 m
STATION = 254
_EARTH_M = 6378100.0


class Sitl:
    """The running simulation and another station that is connected to it.

    Attributes:
        port: where it sends, for `alula fly`.
        texts: STATUSTEXTs, as the other station receives them.
        truth: true motion: time of this machine [s], east, north, up from the start [m], and the tilt [rad].
        estimates: estimated velocities: time of this machine [s], east, north, up [m/s].
        newest: newest message of each kind.
        modes: time of this machine [s] and custom_mode of each heartbeat.
    """

    def __init__(self, instance, port):
        self.port = port
        self._sticks_port = 5501 + 10 * instance
        self._socket = until(lambda: self._connected(second_port(instance)))
        self._parser, self._writer = mavlink.MAVLink(None), mavlink.MAVLink(None, STATION, 190)
        self._parser.robust_parsing = True
        self.texts, self.truth, self.estimates = [], [], []
        self.newest, self.modes = {}, []
        self._home = None
        self._lives = True
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()
        until(lambda: "HEARTBEAT" in self.newest)
        rates = {"SIM_STATE": 20, "EKF_STATUS_REPORT": 5, "SYS_STATUS": 5, "HEARTBEAT": 5}
        for name, rate_hz in (rates | {"LOCAL_POSITION_NED": 5}).items():
            number = getattr(mavlink, f"MAVLINK_MSG_ID_{name}")
            self.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, number, 1e6 / rate_hz)

    def _connected(self, port):
        with suppress(OSError):
            return socket.create_connection(("127.0.0.1", port), 1.0)
        return None

    def _read(self):
        self._socket.settimeout(0.5)
        beat_s = 0.0
        while self._lives:
            if time.monotonic() - beat_s > 1.0:
                beat_s = time.monotonic()
                with suppress(OSError):
                    self.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
            try:
                data = self._socket.recv(4096)
            except TimeoutError:
                continue
            except OSError:
                return
            for message in self._parser.parse_buffer(data) or []:
                if message.get_srcSystem() == 1:  # it forwards the heartbeats of `alula fly`, too
                    self._take(message)

    def _take(self, message):
        kind = message.get_type()
        if kind == "STATUSTEXT":
            self.texts.append(message.text)
        elif kind == "HEARTBEAT":
            self.modes.append((time.monotonic(), message.custom_mode))
        elif kind == "SIM_STATE":
            lat, lon, alt = message.lat_int * 1e-7, message.lon_int * 1e-7, message.alt
            self._home = self._home or (lat, lon, alt)
            east = math.radians(lon - self._home[1]) * _EARTH_M * math.cos(math.radians(lat))
            north = math.radians(lat - self._home[0]) * _EARTH_M
            tilt = math.acos(max(-1.0, min(1.0, math.cos(message.roll) * math.cos(message.pitch))))
            self.truth.append((time.monotonic(), east, north, alt - self._home[2], tilt))
        elif kind == "LOCAL_POSITION_NED":
            self.estimates.append((time.monotonic(), message.vy, message.vx, -message.vz))
        self.newest[kind] = message

    def send(self, message):
        """Send a message as the other station."""
        self._socket.sendall(message.pack(self._writer))

    def command(self, number, *values):
        """Send a COMMAND_LONG."""
        filled = [*map(float, values), *[0.0] * (7 - len(values))]
        self.send(mavlink.MAVLink_command_long_message(1, 1, number, 0, *filled))

    def set(self, **parameters):
        """Set parameters of the vehicle or of its simulation."""
        for name, value in parameters.items():
            self.send(mavlink.MAVLink_param_set_message(1, 1, name.encode(), float(value), 9))
            time.sleep(0.02)

    def sticks(self, throttle):
        """Put the pilot's throttle stick at a pulse width [us]; the other sticks and switches stay."""
        pulses = (1500, 1500, throttle, 1500, 1800, 1000, 1000, 1800)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
            line.sendto(struct.pack("<8H", *pulses), ("127.0.0.1", self._sticks_port))

    def close(self):
        """Disconnect the other station."""
        self._lives = False
        self._thread.join(5)
        self._socket.close()


@contextmanager
def sitl(folder, parameters=None):
    """A running simulation."""
    port = free_port()
    with arducopter(folder, port, parameters) as instance:
        running = Sitl(instance, port)
        try:
            yield running
        finally:
            running.close()


def flight(sim, folder, *more, plan=None, cover=WALLS):
    """A flight of `alula fly` with it; it is killed at the end."""
    plan = line_plan(START, GOAL, 24.0) if plan is None else plan
    return fly(f"udpin:127.0.0.1:{sim.port}", folder, *more, plan=plan, cover=cover)
