"""PX4's own simulation (SIH), which ALULA_PX4 names. Nothing of PX4 is built or kept here.

It serves a companion computer on one port; on another it sends the true motion (HIL_STATE_QUATERNION).
"""

import json
import math
import os
import socket
import subprocess
import threading
import time
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from alula.stages.sim_vehicle.common.packets import mavlink
from support.vehicles.sim_vehicle_process import free_port

# Positions by motion capture instead of satellites, which its simulation lets wander by a metre.
MOCAP = {"EKF2_EV_CTRL": 15, "EKF2_GPS_CTRL": 0, "EKF2_HGT_REF": 3, "EKF2_EV_DELAY": 20}
# The most noise that its estimator can be told; in flight its simulation has up to 1.7 m/s^2 and 0.14 rad/s.
TOLD = {"EKF2_ACC_NOISE": 1.0, "EKF2_GYR_NOISE": 0.1}
# No sticks; below a ceiling it must not fly home when its battery is critical.
INDOORS = {"COM_RC_IN_MODE": 4, "COM_LOW_BAT_ACT": 2}
# UDP ports of instance 0: it has one and sends to the others
_OWN, _COMPANION, _OTHER, _TRUTH = 14580, 14540, 14030, 19410
_PAYLOAD = 14280  # where it listens for another station
_STATION = 254
_INSTANCES = 10
_EARTH_M = 6378100.0


def program():
    """The program; the test is skipped without it."""
    name = os.environ.get("ALULA_PX4")
    if not name:
        pytest.skip("ALULA_PX4 does not name PX4's program (tests/sitl/README.md)")
    path = Path(name).expanduser().resolve()
    if not path.is_file():
        pytest.skip(f"ALULA_PX4 names no file: {name}")
    if not (path.parents[1] / "etc/init.d-posix/rcS").is_file():
        pytest.skip(f"{path} does not lie in a build of PX4, so etc/init.d-posix/rcS is not found")
    return path


def _bound(port):
    """A socket that holds a UDP port."""
    line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        line.bind(("127.0.0.1", port))
    except OSError:
        line.close()
        raise
    line.settimeout(0.5)
    return line


def _free_instance():
    """Number of an instance whose ports are free, and the sockets of the truth and of another station."""
    for number in range(_INSTANCES):
        with suppress(OSError), _bound(_OWN + number), _bound(_COMPANION + number):
            truth = _bound(_TRUTH + number)  # holds the number from now on
            return number, (truth, _bound(_OTHER + number))
    pytest.fail("no ports are free")


class Px4:
    """The running simulation.

    Attributes:
        port: where it sends, for `alula fly`.
        truth: true motion: time of this machine [s]; east, north, up from the start [m].
        flags: time of this machine [s] and flags of each ESTIMATOR_STATUS.
        modes: time of this machine [s], main and sub mode of each heartbeat.
        mocap_port: port that the true motion is sent to, as motion capture for `alula fly --mocap`.
    """

    def __init__(self, instance, lines):
        self.port = _COMPANION + instance
        self._instance = instance
        self.mocap_port = free_port()
        self._line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.truth, self.flags, self.modes = [], [], []
        self._home = None
        self._lives = True
        self._writer = mavlink.MAVLink(None, _STATION, 190)
        self._threads = [threading.Thread(target=self._read, args=(each,), daemon=True) for each in lines]
        for each in self._threads:
            each.start()

    def _read(self, line):
        parser = mavlink.MAVLink(None)
        parser.robust_parsing = True
        with line:
            while self._lives:
                with suppress(TimeoutError):
                    for message in parser.parse_buffer(line.recv(4096)) or []:
                        self._take(message)

    def _take(self, message):
        now = time.monotonic()
        if message.get_type() == "ESTIMATOR_STATUS":
            self.flags.append((now, message.flags))
        elif message.get_type() == "HEARTBEAT" and message.get_srcComponent() == 1:
            self.modes.append((now, message.custom_mode >> 16 & 0xFF, message.custom_mode >> 24))
        elif message.get_type() == "HIL_STATE_QUATERNION":
            lat, lon, alt = message.lat * 1e-7, message.lon * 1e-7, message.alt * 1e-3
            self._home = self._home or (lat, lon, alt)
            east = math.radians(lon - self._home[1]) * _EARTH_M * math.cos(math.radians(lat))
            north = math.radians(lat - self._home[0]) * _EARTH_M
            self.truth.append((now, east, north, alt - self._home[2]))
            w, x, y, z = message.attitude_quaternion  # from north-east-down to forward-right-down
            half = math.sqrt(0.5)  # to east-north-up and forward-left-up
            sample = {
                "time_s": now,  # cameras have a clock of their own
                "position_m": self.truth[-1][1:],
                "attitude_wxyz": [half * (w + z), half * (x + y), half * (x - y), half * (w - z)],
                "velocity_m_s": [message.vy * 1e-2, message.vx * 1e-2, -message.vz * 1e-2],
            }
            self._line.sendto(json.dumps(sample).encode(), ("127.0.0.1", self.mocap_port))

    def set(self, **parameters):
        """Set parameters of the vehicle or of its simulation, as its console does."""
        for name, value in parameters.items():
            command = [program().parent / "px4-param", "--instance", str(self._instance)]
            subprocess.run([*command, "set", name, str(value)], check=True, capture_output=True, timeout=10)

    def send(self, message):
        """Send a message as another station."""
        self._line.sendto(message.pack(self._writer), ("127.0.0.1", _PAYLOAD + self._instance))

    def mode(self, main, sub=0):
        """Order a mode as another station."""
        values = (1.0, float(main), float(sub), *[0.0] * 4)
        self.send(
            mavlink.MAVLink_command_long_message(
                self._instance + 1, 1, mavlink.MAV_CMD_DO_SET_MODE, 0, *values
            )
        )

    @contextmanager
    def sticks(self):
        """A pilot with centred sticks, until the end."""
        ended = threading.Event()

        def hold():
            while not ended.wait(0.05):
                self.send(mavlink.MAVLink_manual_control_message(self._instance + 1, 0, 0, 500, 0, 0))

        thread = threading.Thread(target=hold, daemon=True)
        thread.start()
        try:
            yield
        finally:
            ended.set()
            thread.join(5)

    def close(self):
        """Stop reading."""
        self._lives = False
        for each in self._threads:
            each.join(5)
        self._line.close()


@contextmanager
def px4(folder, parameters=None, *, start=INDOORS, key=None):
    """A running simulation in a folder of its own, with a key of 32 bytes for signatures."""
    path = program()
    instance, lines = _free_instance()
    work = folder / "px4"
    (work / "mavlink").mkdir(parents=True)
    if key is not None:  # and the time stamp
        (work / "mavlink/mavlink-signing-key.bin").write_bytes(key + bytes(8))
    values = {f"PX4_PARAM_{name}": str(value) for name, value in (start | (parameters or {})).items()}
    words = [path, "-d", "-i", str(instance), "-w", work, path.parents[1] / "etc"]
    environment = os.environ | {"PX4_SIM_MODEL": "sihsim_quadx"} | values
    running = Px4(instance, lines)
    with (
        (folder / "px4.txt").open("wb") as log,
        subprocess.Popen(words, cwd=work, env=environment, stdout=log, stderr=log) as process,
    ):
        try:
            yield running
        finally:
            process.kill()
            running.close()
