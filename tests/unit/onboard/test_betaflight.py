"""The geofence through Betaflight's own firmware, stepped in our time: the same figures in every run."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from support.paths import ROOT

if not (ROOT / "benchmarks/betaflight.py").is_file():
    pytest.skip("not a checkout", allow_module_level=True)
sys.path.append(str(ROOT / "benchmarks"))  # last: there is a file with the name of the package

import firmware

if missing := firmware.missing():
    pytest.skip(missing, allow_module_level=True)

RUN = [sys.executable, "-P", str(ROOT / "benchmarks/betaflight.py"), "--quick", "--json"]
LONGEST_S = 280  # a quarter of a minute when nothing else runs


@pytest.fixture(scope="module")
def figures():
    ended = subprocess.run(RUN, capture_output=True, text=True, timeout=LONGEST_S)
    assert ended.returncode == 0, ended.stderr
    return json.loads(ended.stdout)


@pytest.fixture(scope="module")
def flights(figures):
    return {flight["name"]: flight for flight in figures["flights"]}


def test_sticks_command_the_rates_that_the_mapping_says(figures):
    """Sticks are rounded to a microsecond; the firmware settles at what they say."""
    for step in figures["steps"]:
        assert step["commanded_rad_s"] == pytest.approx(step["asked_rad_s"], rel=0.004)
        assert step["settled_rad_s"] == pytest.approx(step["commanded_rad_s"], rel=0.01)
        assert step["overshoot"] < 0.25


def test_the_rate_loop_is_one_that_the_filter_can_count_with(figures):
    assert 40 < figures["rate_gain_per_s"] < 120
    assert 0 < figures["latency_s"] <= figures["filter_latency_s"] <= 0.015


def test_time_is_ours(figures, flights):
    """The same bits again, and one set of motor signals for each step of the body."""
    assert figures["repeats_bit_by_bit"]
    for flight in flights.values():
        assert flight["firmware"]["motor_packets_per_step"] == pytest.approx(1, abs=0.01)


def test_every_flight_stays_inside(flights):
    assert set(flights) == {"wall", "fall", "radio loss", "aggressive"}
    for name, flight in flights.items():
        assert flight["firmware"]["min_distance_m"] > 0.1, name
        assert flight["ideal"]["min_distance_m"] >= flight["reserve_m"], name


def test_the_firmware_takes_little_of_the_reserve(flights):
    """The rest is for what a real drone does otherwise than this one."""
    for flight in flights.values():
        assert flight["firmware"]["min_distance_m"] > flight["reserve_m"] - 0.1


def test_they_were_as_fast_as_published(flights):
    assert flights["wall"]["firmware"]["peak_km_h"] > 100
    assert flights["fall"]["firmware"]["peak_km_h"] > 100
    for flight in flights.values():
        assert flight["firmware"]["peak_km_h"] == pytest.approx(flight["ideal"]["peak_km_h"], rel=0.1)


def test_the_filter_did_it(flights):
    """The pilot's command goes through far from the fence, and does not at it."""
    for name in ("wall", "fall"):
        ticks = flights[name]["firmware"]["ticks"]
        assert ticks["passed"] > 50
        assert ticks["backup"] > 0
        assert flights[name]["firmware"]["min_lambda"] == 0
    assert flights["radio loss"]["firmware"]["ticks"]["no-pilot"] > 1000


def test_rates_follow_the_model(flights):
    for flight in flights.values():
        assert flight["firmware"]["rate_error_rms_rad_s"] < 0.6
        assert (
            flight["firmware"]["rate_error_free_rms_rad_s"]
            <= flight["firmware"]["rate_error_rms_rad_s"] + 0.05
        )


def processes():
    """Ids of the running firmware."""
    found = set()
    for folder in Path("/proc").iterdir():
        try:
            if folder.name.isdigit() and (folder / "exe").readlink().name == firmware.program().name:
                found.add(int(folder.name))
        except OSError:
            continue
    return found


def wait_for(condition):
    limit = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < limit
        time.sleep(0.02)


def test_no_process_outlives_it(tmp_path):
    before = processes()
    running = subprocess.Popen(
        RUN,
        env=os.environ | {"TMPDIR": str(tmp_path)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        wait_for(lambda: processes() - before)
    finally:
        running.send_signal(signal.SIGKILL)
        running.wait(timeout=60)
    wait_for(lambda: processes() <= before)
