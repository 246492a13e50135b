"""ArduPilot's own simulation of Copter, for the tests of `tests/sitl`."""

from __future__ import annotations

import os
import subprocess
from contextlib import contextmanager
from pathlib import Path

import pytest

from support.responses import Wired

DEFAULTS = Path("Tools/autotest/default_params/copter.parm")


def program():
    """The program and its default parameters; skip the test without them."""
    name = os.environ.get("ALULA_ARDUCOPTER")
    if not name:
        pytest.skip("ArduPilot's simulation: set ALULA_ARDUCOPTER to the program arducopter")
    path = Path(name).resolve()
    if not path.is_file():
        pytest.skip(f"ALULA_ARDUCOPTER names no file: {name}")
    folder = next((each for each in path.parents if (each / DEFAULTS).is_file()), None)
    if folder is None:
        pytest.skip(f"{path} does not lie in ArduPilot's source tree, so {DEFAULTS} is not found")
    return path, folder / DEFAULTS


@contextmanager
def arducopter(folder, instance=7, *words):
    """Run the simulation in an empty folder; yield the line that it sends to."""
    path, defaults = program()
    with Wired() as line:
        command = [path, "--model", "quad", "--speedup", "1", "-w", "-I", str(instance)]
        command += ["--defaults", defaults, f"--serial0=udpclient:127.0.0.1:{line.port}", *words]
        with (
            (folder / "arducopter.log").open("wb") as log,
            subprocess.Popen(command, cwd=folder, stdout=log, stderr=log) as process,
        ):
            try:
                yield line
            finally:
                process.kill()
