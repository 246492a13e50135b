"""Logs after a flight: an earlier log is replaced, the writer dies, the disk is full."""

import functools
import os
import signal
import time

import pytest

from alula.cli.shell.options import Common
from alula.cli.verbs.fly import flight as fly_run
from alula.schemas.artifacts.provenance import Provenance
from alula.schemas.errors import CheckError, ExitCode, LinkError, OutputError
from alula.schemas.log.cut import read_logged
from alula.schemas.log.run import RUN_SCHEMA, RUN_VERSION, read_run
from alula.stages.flight.links.protocol import Order
from alula.stages.flight.loop import control_loop
from alula.stages.flight.loop.supervisor import Event, State, Taken
from alula.stages.flight.loop.supervisor_table import TABLE
from alula.stages.flight.recorder import log as flight_log
from alula.stages.flight.recorder.log import FlightRecorder
from support.flights.flight_logs import head_of, sample
from support.flights.flights import START, mission
from support.vehicles.fake_vehicle import FakeClock, FakeVehicle

OLD = b"an old log"


@pytest.fixture
def fly(tmp_path, monkeypatch):
    """Fly a fake vehicle by the steps of the command; return the log."""
    recorders = []

    class Kept(FlightRecorder):
        def __init__(self, *arguments, **keywords):
            super().__init__(*arguments, **keywords)
            recorders.append(self)

    monkeypatch.setattr(flight_log, "FlightRecorder", Kept)

    def flown(on_poll=lambda vehicle, now, recorder: None, *, force=True, old=True):
        clock = FakeClock()
        loop = functools.partial(control_loop.ControlLoop, clock=clock, sleep=clock.sleep)
        monkeypatch.setattr(control_loop, "ControlLoop", loop)
        link = FakeVehicle(clock, (START[0], START[1], 0.0))
        link.on_poll = lambda vehicle, now: on_poll(vehicle, now, recorders[-1])
        log = tmp_path / "f.run.mcap"
        if old:
            log.write_bytes(OLD)
            log.with_suffix(".json").write_bytes(b"{}")
        provenance = Provenance.now(RUN_SCHEMA, RUN_VERSION, {}, None, [])
        fly_run.fly(mission(), link, provenance, Common(log, force=force, quiet=True, jobs=1))

    flown.log = tmp_path / "f.run.mcap"
    flown.record = tmp_path / "f.run.json"
    flown.left = lambda: sorted(path.name for path in tmp_path.iterdir())
    return flown


def test_a_refused_flight_leaves_the_old_log_as_it_was(fly):
    def low(vehicle, now, recorder):
        vehicle.status.battery_share = 0.1

    with pytest.raises(CheckError, match="battery"):
        fly(low)
    assert (fly.log.read_bytes(), fly.record.read_bytes()) == (OLD, b"{}")
    assert fly.left() == ["f.run.json", "f.run.mcap"]


def test_an_error_before_take_off_leaves_the_old_log_as_it_was(fly):
    def broken(vehicle, now, recorder):
        if Order.ARM in vehicle.orders:
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fly(broken)
    assert fly.log.read_bytes() == OLD
    assert fly.left() == ["f.run.json", "f.run.mcap"]


def test_a_flight_replaces_the_old_log(fly):
    fly()
    (trial,) = read_run(fly.log).trials
    assert trial.outcome == "reached"
    assert read_run(fly.log).timing["ticks"] > 100
    assert fly.left() == ["f.run.json", "f.run.mcap"]


def test_the_log_of_a_take_off_is_kept_though_nobody_can_judge_it(fly):
    def blow(vehicle, now, recorder):
        if vehicle.orders and vehicle.orders[-1] is Order.TAKE_OFF and vehicle.x[2] > 0.1:
            vehicle.x[0] += 0.004
            vehicle.hold_at[0] += 0.004

    with pytest.raises(LinkError, match="ended early: off the climb path"):
        fly(blow)
    found = read_logged(fly.log)
    assert "in the state done" in found.damage
    assert len(found.flights.by_trial[0].time_s) > 200
    assert fly.left() == ["f.run.mcap"]  # the record of the earlier flight does not belong to this one


@pytest.mark.every(2)
@pytest.mark.parametrize("old", [True, False])
@pytest.mark.parametrize("seconds", [-1.0, 2.0])
def test_a_writer_that_dies_is_told_after_a_flight_that_went_well(fly, old, seconds):
    def kill(vehicle, now, recorder):
        first = vehicle.sent[0][0] if vehicle.sent else 1e9
        is_due = now > 100.5 if seconds < 0 else now - first > seconds
        if is_due and not hasattr(vehicle, "killed"):
            vehicle.killed = True
            wait_for(lambda: seconds < 0 or recorder.where.stat().st_size > 20_000)
            os.kill(recorder.pid, signal.SIGKILL)

    with pytest.raises(OutputError, match=r"went well, but .*f.run.mcap: the log was cut") as caught:
        fly(kill, force=old, old=old)
    assert caught.value.exit_code == ExitCode.INPUT
    if seconds > 0:
        assert "cut" in read_logged(fly.log).damage
    assert fly.log.read_bytes()[:5] != OLD[:5]
    text = fly.record.read_text()
    assert '"outcome": "reached"' in text
    assert "the log is not complete" in text
    assert fly.left() == ["f.run.json", "f.run.mcap"]


@pytest.mark.slow
def test_a_record_that_cannot_be_written_is_told_after_the_flight(fly, monkeypatch, capsys):
    def full(record, timing):
        raise OutputError(f"{fly.record}: cannot write: No space left on device")

    monkeypatch.setattr("alula.cli.shell.run_files.record_text", full)
    with pytest.raises(OutputError, match=r"the flight went well, but .*f.run.json: cannot write: No space"):
        fly()
    assert read_run(fly.log).trials[0].outcome == "reached"

    def low(vehicle, now, recorder):  # the message is then a line of its own
        if vehicle.sent:
            vehicle.status.battery_share = 0.1

    with pytest.raises(LinkError, match="battery low"):
        fly(low)
    assert "No space left" in capsys.readouterr().err


def begin(log):
    recorder = FlightRecorder(log, head_of(mission()), replaces=True, echo=False)
    for i in range(100):
        recorder.tick(sample(i))
    return recorder


def take_off(recorder):
    step = TABLE[State.ARMING][Event.ARMED]
    recorder.step(1.0, Taken(State.ARMING, Event.ARMED, step))


def wait_for(what):
    end = time.monotonic() + 20
    while not what():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_the_writer_takes_the_old_logs_place_at_take_off_so_that_a_crash_leaves_the_new_one(tmp_path):
    log = tmp_path / "f.run.mcap"
    log.write_bytes(OLD)
    recorder = begin(log)
    assert log.read_bytes() == OLD
    assert recorder.where != log
    take_off(recorder)
    wait_for(lambda: recorder.where == log)
    os.kill(recorder.pid, signal.SIGKILL)
    recorder.finish(None)
    recorder.discard()
    assert read_logged(log).record.filter == "polytope-cbf"
    assert list(tmp_path.iterdir()) == [log]


def test_a_log_that_cannot_be_replaced_is_kept_beside_and_named(tmp_path):
    log = tmp_path / "f.run.mcap"
    log.mkdir()  # nothing replaces a folder
    recorder = begin(log)
    take_off(recorder)
    assert recorder.finish(None)
    assert recorder.where != log
    assert read_logged(recorder.where).damage


def test_a_record_without_its_log_does_not_become_that_of_a_flight_that_crashes(tmp_path):
    log, record = tmp_path / "f.run.mcap", tmp_path / "f.run.json"
    record.write_bytes(b"{}")
    refused = begin(log)
    refused.finish(None)
    refused.discard()
    assert list(tmp_path.iterdir()) == [record]  # no flight, and nothing is changed
    recorder = begin(log)
    take_off(recorder)
    wait_for(lambda: recorder.where == log)
    os.kill(recorder.pid, signal.SIGKILL)
    recorder.finish(None)
    recorder.discard()
    assert list(tmp_path.iterdir()) == [log]
