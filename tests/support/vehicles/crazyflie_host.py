"""The Crazyflie's firmware as a program, which ALULA_CRAZYFLIE names (tests/sitl/README.md)."""

import json
import os
import shlex
import shutil
import socket
import subprocess
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

from support.vehicles.sim_vehicle_process import free_port, until


def program():
    """The words of the command; the test is skipped without it."""
    name = os.environ.get("ALULA_CRAZYFLIE")
    if not name:
        pytest.skip("ALULA_CRAZYFLIE names no program of the Crazyflie's firmware (tests/sitl/README.md)")
    words = shlex.split(name)
    if shutil.which(words[0]) is None:
        pytest.skip(f"ALULA_CRAZYFLIE names no program: {words[0]}")
    pytest.importorskip("cflib", reason="cflib, of the extra crazyflie, is not there")
    return words


class CrazyflieHost:
    """The running program.

    Attributes:
        port: UDP port of its radio.
        truth: true motion: time of this machine and of the program [s]; position [m]; velocity [m/s].
    """

    def __init__(self, process, port, line):
        self.process, self.port = process, port
        self.truth = []
        self._line = line
        self._lives = True
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()
        until(lambda: self.truth)

    def link(self, controller, **options):
        """Address of the link, with a controller and further options."""
        more = "".join(f"&{name}={value}" for name, value in options.items())
        return f"udp://127.0.0.1:{self.port}?controller={controller}{more}"

    def _read(self):
        self._line.settimeout(0.5)
        while self._lives:
            try:
                found = json.loads(self._line.recv(4096))
            except TimeoutError:
                continue
            motion = (*found["position_m"], *found["velocity_m_s"])
            self.truth.append((time.monotonic(), found["time_s"], *motion))

    def close(self):
        """Stop reading."""
        self._lives = False
        self._thread.join(5)


@contextmanager
def crazyflie(folder: Path, start=(0.0, 0.0, 0.0), *more, image: bytes = b""):
    """The running program, on the floor at `start`; its app has the map `image`."""
    words = program()
    port = free_port()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.bind(("127.0.0.1", 0))
        words += ["--port", str(port), "--truth", str(line.getsockname()[1])]
        words += ["--start", " ".join(map(str, start)), *more]
        if image:
            (folder / "cover_map.bin").write_bytes(image)
            words += ["--map", str(folder / "cover_map.bin")]
        with (
            (folder / "crazyflie.txt").open("wb") as log,
            subprocess.Popen(words, cwd=folder, stdout=log, stderr=log) as process,
        ):
            running = None
            try:
                running = CrazyflieHost(process, port, line)
                yield running
            finally:
                process.kill()
                if running is not None:
                    running.close()
