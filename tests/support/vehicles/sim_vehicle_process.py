"""`alula sim-vehicle` as a process of its own."""

import json
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager

import pytest

# Below a ceiling it must not fly home in an emergency.
INDOORS = ("--param", "FS_THR_ENABLE=3", "--param", "FS_DR_ENABLE=1")
QUICK = ("--boot-time", "1", "--param", "LAND_SPEED=120", "--param", "WPNAV_ACCEL_Z=250", *INDOORS)


@contextmanager
def vehicle(link="udpin:127.0.0.1:0", *options, quick=QUICK):
    """The command in a process of its own; its link as it says it."""
    command = [sys.executable, "-P", "-m", "alula.cli", "sim-vehicle", "--json", "--link", link]
    with subprocess.Popen([*command, *quick, *options], stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process, json.loads(process.stdout.readline())["link"]
        finally:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
            process.wait(10)


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def until(condition, timeout_s=30.0):
    end = time.monotonic() + timeout_s
    while time.monotonic() < end:
        if found := condition():
            return found
        time.sleep(0.05)
    pytest.fail("it did not happen in time")
