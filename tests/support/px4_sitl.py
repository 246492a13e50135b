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
from support.sim_vehicle_process import free_port

# Positions by motion capture instead of satellites, which its simulation lets wander by a metre.
MOCAP = {"EKF2_EV_CTRL": 15, "EKF2_GPS_CTRL": 0, "EKF2_HGT_REF": 3, "EKF2_EV_DELAY": 20}
# No sticks; below a ceiling it must not fly home when its battery is critical.
INDOORS = {"COM_RC_IN_MODE": 4, "COM_LOW_BAT_ACT": 2}
# UDP ports of instance 0: it has one and sends to the others
_OWN, _COMPANION, _OTHER, _TRUTH = 14580, 14540, 14030, 19410
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


def _free_instance():
    for number in range(_INSTANCES):
        with suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", _OWN + number))
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
                other.bind(("127.0.0.1", _COMPANION + number))
                return number
    pytest.fail("no ports are free")


class Px4:
    """The running simulation.

    Attributes:
        port: where it sends, for `alula fly`.
        truth: true motion: time of this machine [s]; east, north, up from the start [m].
        flags: time of this machine [s] and flags of each ESTIMATOR_STATUS.
        mocap_port: port that the true motion is sent to, as motion capture for `alula fly --mocap`.
    """

    def __init__(self, instance):
        self.port = _COMPANION + instance
        self._instance = instance
        self.mocap_port = free_port()
        self._line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.truth, self.flags = [], []
        self._home = None
        self._lives = True
        ports = (_TRUTH + instance, _OTHER + instance)
        self._threads = [threading.Thread(target=self._read, args=(port,), daemon=True) for port in ports]
        for each in self._threads:
            each.start()

    def _read(self, port):
        parser = mavlink.MAVLink(None)
        parser.robust_parsing = True
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
            line.bind(("127.0.0.1", port))
            line.settimeout(0.5)
            while self._lives:
                with suppress(TimeoutError):
                    for message in parser.parse_buffer(line.recv(4096)) or []:
                        self._take(message)

    def _take(self, message):
        now = time.monotonic()
        if message.get_type() == "ESTIMATOR_STATUS":
            self.flags.append((now, message.flags))
        elif message.get_type() == "HIL_STATE_QUATERNION":
            lat, lon, alt = message.lat * 1e-7, message.lon * 1e-7, message.alt * 1e-3
            self._home = self._home or (lat, lon, alt)
            east = math.radians(lon - self._home[1]) * _EARTH_M * math.cos(math.radians(lat))
            north = math.radians(lat - self._home[0]) * _EARTH_M
            self.truth.append((now, east, north, alt - self._home[2]))
            w, x, y, z = message.attitude_quaternion  # from north-east-down to forward-right-down
            half = math.sqrt(0.5)  # to east-north-up and forward-left-up
            sample = {
                "time_s": message.time_usec * 1e-6,
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

    def close(self):
        """Stop reading."""
        self._lives = False
        for each in self._threads:
            each.join(5)
        self._line.close()


@contextmanager
def px4(folder, parameters=None, *, start=INDOORS):
    """A running simulation in a folder of its own."""
    path = program()
    instance = _free_instance()
    work = folder / "px4"
    work.mkdir()
    values = {f"PX4_PARAM_{name}": str(value) for name, value in (start | (parameters or {})).items()}
    words = [path, "-d", "-i", str(instance), "-w", work, path.parents[1] / "etc"]
    environment = os.environ | {"PX4_SIM_MODEL": "sihsim_quadx"} | values
    running = Px4(instance)
    with (
        (folder / "px4.txt").open("wb") as log,
        subprocess.Popen(words, cwd=work, env=environment, stdout=log, stderr=log) as process,
    ):
        try:
            yield running
        finally:
            process.kill()
            running.close()
