"""The program of ArduPilot's own simulation of Copter, which ALULA_ARDUCOPTER names.

Nothing of ArduPilot is built or kept here.
"""

import os
import socket
import subprocess
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from support.vehicles.responses import Wired

DEFAULTS = Path("Tools/autotest/default_params/copter.parm")
_PORT, _STEP = 5760, 10  # TCP ports of an instance n: 5760 + 10 n and some above


def program():
    """The program and its default parameters; the test is skipped without them."""
    name = os.environ.get("ALULA_ARDUCOPTER")
    if not name:
        pytest.skip("ALULA_ARDUCOPTER does not name ArduPilot's program (tests/sitl/README.md)")
    path = Path(name).resolve()
    if not path.is_file():
        pytest.skip(f"ALULA_ARDUCOPTER names no file: {name}")
    folder = next((each for each in path.parents if (each / DEFAULTS).is_file()), None)
    if folder is None:
        pytest.skip(f"{path} does not lie in ArduPilot's source tree, so {DEFAULTS} is not found")
    return path, folder / DEFAULTS


def _free_instance():
    first = os.getpid() % 180  # tests of other processes may look at the same moment
    for number in (20 + (first + i) % 180 for i in range(180)):
        with suppress(OSError), socket.socket() as probe, socket.socket() as other:
            probe.bind(("127.0.0.1", second_port(number)))
            other.bind(("127.0.0.1", second_port(number) + 1))
            return number
    pytest.fail("no ports are free")


def second_port(instance):
    """TCP port on which an instance serves a second station."""
    return _PORT + 2 + _STEP * instance


@contextmanager
def arducopter(folder, port, parameters=None):
    """Run the program in an empty folder; it sends to a UDP port of this machine. Yields its instance."""
    path, defaults = program()
    own = folder / "own.parm"
    own.write_text("".join(f"{name} {value}\n" for name, value in (parameters or {}).items()))
    instance = _free_instance()
    command = [path, "--model", "quad", "--speedup", "1", "-w", "-I", str(instance)]
    command += ["--defaults", f"{defaults},{own}", f"--serial0=udpclient:127.0.0.1:{port}"]
    with (
        (folder / "arducopter.log").open("wb") as log,
        subprocess.Popen(command, cwd=folder, stdout=log, stderr=log) as process,
    ):
        try:
            yield instance
        finally:
            process.kill()


@contextmanager
def wired(folder):
    """Run the program; yields the line that it sends to."""
    with Wired() as line, arducopter(folder, line.port):
        yield line
