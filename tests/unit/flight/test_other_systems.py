"""What only Linux has is optional: without it flights run, with later wake-ups and smaller pipes."""

import fcntl
import os

from alula.cli.verbs.fly.conduct import priority
from alula.stages.flight.recorder.pipe import FlightPipe
from alula.stages.flight.watchdog import companion


def test_a_system_without_scheduling_calls_still_runs_the_flight(monkeypatch):
    monkeypatch.delattr(os, "sched_setscheduler")
    monkeypatch.delattr(os, "sched_getscheduler")
    asked = []
    monkeypatch.setattr(os, "setpriority", lambda *words: asked.append(words))
    with priority():
        pass
    companion._run_first()
    assert asked == [(os.PRIO_PROCESS, 0, -15)]


def test_a_system_without_pipe_sizes_still_sends(monkeypatch):
    monkeypatch.delattr(fcntl, "F_SETPIPE_SZ")
    pipe = FlightPipe("import sys; sys.exit(len(sys.stdin.buffer.read()) - 4)", [])
    pipe.put(b"12345")
    pipe.process.stdin.close()
    assert pipe.process.wait(10) == 5
