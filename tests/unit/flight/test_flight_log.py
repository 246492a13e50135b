"""Log of a flight: its contents, that it never waits, and its readable part after a crash."""

import dataclasses
import os
import signal
import subprocess
import sys
import time

import msgspec
import numpy as np
import pytest
from mcap.reader import make_reader

from alula.schemas.errors import ArtifactError, DamagedError, OutputError
from alula.schemas.log.cut import read_logged, salvage_run
from alula.schemas.log.flights import count_messages, flights_of
from alula.schemas.log.mcap import messages, metadata
from alula.schemas.log.run import FLIGHT_METADATA, read_run
from alula.schemas.log.start_time import utc_text
from alula.stages.flight.judge import guarantee_of, timing_of
from alula.stages.flight.recorder.log import FlightRecorder
from support.flights.flight_logs import head_of, record_of, sample
from support.flights.flights import fly, mission


def test_a_flight_is_logged_as_simulate_logs_one(tmp_path):
    log, made = (
        tmp_path / "f.run.mcap",
        mission(velocity_lag_s=0.0),
    )  # as the model's, so that it keeps up with the plan
    recorder = FlightRecorder(log, head_of(made), echo=False)
    loop, _ = fly(made, recorder=recorder)
    assert recorder.finish(record_of(made, loop, recorder))
    assert recorder.dropped == 0
    found = read_logged(log)
    assert found.damage == ""
    (trial,) = found.record.trials
    assert (trial.outcome, trial.collision) == ("reached", False)
    assert trial.map_clearance_m > 0
    guarantee = found.record.guarantee
    what = "the hulls of the cover, made for every ellipsoid of the scene at 1 sigma (19.8 % of a Gaussian's"
    assert f"it kept its radius from {what}" in guarantee.statement
    assert guarantee.claims["map"]["cover"]["sigma"] == 1.0
    thin = msgspec.structs.replace(made.cover.manifest, min_opacity=0.5)
    part = dataclasses.replace(made, cover=dataclasses.replace(made.cover, manifest=thin))
    claimed = guarantee_of(part, trial)
    assert "not included: Gaussians of opacity below 0.5" in claimed.statement
    assert claimed.claims["map"]["cover"]["omits"] == ["Gaussians of opacity below 0.5"]
    assert trial.max_tracking_error_m < 0.3
    counts, complete = count_messages(log)
    assert complete
    ticks = len(loop.counters.tick_s)
    assert (counts["/map"], counts["/path"], counts["/state"]) == (1, 1, ticks)
    assert counts["/safety"] == len(loop.counters.filter_s) == trial.steps
    assert counts["/supervisor"] == ticks + len(loop.taken)
    flight = found.flights.by_trial[0]
    assert found.flights.hulls == 1
    assert len(flight.time_s) == ticks
    assert np.isfinite(flight.margin).all()
    assert flight.margin_unit == "m"
    timing = timing_of(loop.counters, recorder.dropped, 100.0)
    assert timing["ticks"] == ticks
    assert timing["overruns"] == 0


def test_log_times_are_those_of_the_wall_clock_or_count_from_the_start_that_is_given(tmp_path):
    head, logs = head_of(mission()), []
    before = time.time_ns()
    for name, start_ns in (("a", None), ("b", 10**18), ("c", 10**18)):
        logs.append(tmp_path / f"{name}.run.mcap")
        recorder = FlightRecorder(logs[-1], head, echo=False, start_ns=start_ns)
        for i in range(3, 103):
            recorder.tick(sample(i))
        recorder.say(1.1, 2, "words")
        assert recorder.finish(None)
    after = time.time_ns()
    assert logs[1].read_bytes() == logs[2].read_bytes()
    starts = []
    for log in logs:
        with log.open("rb") as file:
            times = {c.topic: m.log_time for _, c, m in make_reader(file).iter_messages()}  # the last ones
            file.seek(0)
            (noted,) = metadata(file, FLIGHT_METADATA)
        starts.append(times["/map"])
        assert times["/tf"] - times["/map"] == 1_020_000_000
        assert times["/log"] - times["/map"] == 1_100_000_000
        assert noted["start_time"] == utc_text(times["/map"])
        supervised = [("/supervisor", b'{"time_s": 0.03, "state": 4, "state_name": "fly"}')]
        with log.open("rb") as file:
            course = flights_of([*messages(file, ("/map", "/log")), *supervised]).course
        assert course.lines[0].time_s == pytest.approx(1.1, abs=1e-9)
    assert before - 30_000_000 <= starts[0] <= after - 30_000_000  # the first tick is at 0.03 s
    assert starts[1:] == [10**18] * 2


def test_a_new_plan_is_logged_at_the_time_from_which_it_was_flown(tmp_path):
    log, made = tmp_path / "f.run.mcap", mission()
    recorder = FlightRecorder(log, head_of(made), echo=False)
    points = [(0.0, 0.0, 1.0), (0.5, 1.0, 1.0), (2.0, 0.0, 1.0)]
    for i in range(100):
        recorder.tick(sample(i, 0.01 * i))
        if i == 50:
            recorder.plan(0.5, points)
    assert recorder.finish(None)
    with log.open("rb") as file:
        course = flights_of(messages(file)).course
    (new,) = course.plans
    assert new.time_s == pytest.approx(0.5)
    assert new.position_world.tolist() == [list(point) for point in points]


def test_an_existing_log_is_left_alone(tmp_path):
    log = tmp_path / "f.run.mcap"
    log.write_bytes(b"mine")
    with pytest.raises(OutputError, match="cannot write"):
        FlightRecorder(log, head_of(mission()), echo=False)
    assert log.read_bytes() == b"mine"


def _wait_for(what, seconds=20.0):
    end = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < end
        time.sleep(0.05)


def test_a_log_is_read_to_its_last_whole_chunk_when_its_writer_is_killed(tmp_path):
    log, made = tmp_path / "f.run.mcap", mission()
    recorder = FlightRecorder(log, head_of(made), echo=False)
    begun = time.monotonic()
    while log.stat().st_size < 30_000 and time.monotonic() < begun + 20:
        for i in range(200):
            recorder.tick(sample(i))
        time.sleep(0.05)
    os.kill(recorder.pid, signal.SIGKILL)
    recorder.finish(None)
    with pytest.raises(DamagedError):
        read_run(log)
    found = read_logged(log)
    assert "cut" in found.damage
    assert "in the state fly" in found.damage
    assert found.record.filter == "polytope-cbf"
    assert found.record.trials == []
    assert len(found.flights.by_trial[0].time_s) > 50
    assert found.flights.hulls == 1
    whole = log.read_bytes()
    before = len(found.flights.by_trial[0].time_s)
    log.write_bytes(whole[: len(whole) // 2])  # a power cut with a greater loss
    assert 0 < len(read_logged(log).flights.by_trial[0].time_s) < before
    log.write_bytes(whole[:100])
    with pytest.raises(ArtifactError):
        read_logged(log)


def test_a_log_of_a_killed_flight_is_closed_by_its_writer(tmp_path):
    log = tmp_path / "f.run.mcap"
    code = f"""
import os, signal, sys
sys.path[:0] = {sys.path!r}
from pathlib import Path
from support.flights.flight_logs import head_of, sample
from support.flights.flights import mission
from alula.stages.flight.recorder.log import FlightRecorder
recorder = FlightRecorder(Path({str(log)!r}), head_of(mission()), echo=False)
for i in range(100):
    recorder.tick(sample(i, x=0.01 * i))
recorder.say(1.0, 3, "about to die")
os.kill(os.getpid(), signal.SIGKILL)
"""
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True)
    assert done.returncode == -signal.SIGKILL, done.stderr
    _wait_for(lambda: log.read_bytes().endswith(b"\x89MCAP0\r\n") and log.stat().st_size > 100)
    counts, complete = count_messages(log)
    assert complete
    assert (counts["/state"], counts["/log"]) == (100, 1)
    found = read_logged(log)
    assert "0.99 s" in found.damage
    assert found.flights.by_trial[0].position_world[-1, 0] == pytest.approx(0.99)


def test_a_log_of_simulate_that_was_cut_is_not_taken_for_a_flight(tmp_path):
    log = tmp_path / "f.run.mcap"
    log.write_bytes(b"\x89MCAP0\r\n" + b"\x01" + (100).to_bytes(8, "little") + b"x" * 20)
    assert salvage_run(log) is None
    with pytest.raises(DamagedError):
        read_logged(log)


def test_a_writer_that_hangs_or_dies_costs_samples_and_no_time(tmp_path):
    recorder = FlightRecorder(tmp_path / "f.run.mcap", head_of(mission()), echo=False)
    os.kill(recorder.pid, signal.SIGSTOP)
    for i in range(20_000):  # more than a pipe holds
        recorder.tick(sample(i))
    assert 0 < recorder.dropped < 20_000
    assert len(recorder.rows) == 20_000
    os.kill(recorder.pid, signal.SIGKILL)
    recorder.tick(sample(0))
    assert not recorder.finish(None, timeout_s=5.0)


@pytest.mark.slow
def test_a_writer_that_hangs_is_given_up_at_the_end(tmp_path):
    loop, _ = fly(made := mission())
    recorder = FlightRecorder(tmp_path / "f.run.mcap", head_of(made), echo=False)
    recorder.tick(sample(0))
    os.kill(recorder.pid, signal.SIGSTOP)
    for i in range(20_000):
        recorder.tick(sample(i))
    assert not recorder.finish(record_of(made, loop, recorder), timeout_s=0.5)


def writer_of(path, *, limit="", stderr=subprocess.PIPE, seconds=0.0):
    """Run a process that logs 3000 ticks and a message; return its output."""
    code = f"""
import resource, sys, time
sys.path[:0] = {sys.path!r}
from pathlib import Path
from support.flights.flight_logs import head_of, sample
from support.flights.flights import mission
from alula.stages.flight.recorder.log import FlightRecorder
{limit}
recorder = FlightRecorder({path and f"Path({str(path)!r})"}, head_of(mission()), echo=True)
for i in range(3000):
    recorder.say(0.01 * i, 1, "a line")
    recorder.tick(sample(i))
    time.sleep({seconds} / 3000)
print("written", recorder.finish(None))
"""
    return subprocess.run(
        [sys.executable, "-P", "-c", code], stdout=subprocess.PIPE, stderr=stderr, text=True
    )


@pytest.mark.slow
def test_a_full_disk_costs_the_log_and_is_said_in_one_line(tmp_path):
    small = "resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))"
    done = writer_of(tmp_path / "f.run.mcap", limit=small)
    assert done.stdout == "written False\n"
    assert "Traceback" not in done.stderr
    assert [line for line in done.stderr.splitlines() if "the log ends here: File too large" in line]
    assert len(read_logged(tmp_path / "f.run.mcap").flights.by_trial[0].time_s) > 50


@pytest.mark.slow
def test_a_terminal_that_is_closed_costs_no_log(tmp_path):
    read, write = os.pipe()
    os.close(read)
    done = writer_of(tmp_path / "f.run.mcap", stderr=write)
    os.close(write)
    assert done.stdout == "written True\n"
    assert count_messages(tmp_path / "f.run.mcap")[0]["/log"] > 1000


@pytest.mark.slow
def test_a_dry_run_of_some_seconds_has_no_log_to_sync():
    done = writer_of(None, seconds=1.5)
    assert done.stdout == "written True\n"
    assert "Traceback" not in done.stderr
