"""Live view in a browser: dropped samples are counted, and its end does not affect the flight."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import numpy as np
import pytest

from alula.schemas.errors import UsageError
from alula.schemas.log.foxglove import Vector3
from alula.schemas.log.run import read_run
from alula.stages.flight.recorder.live_view import ViewHead, open_view
from alula.stages.flight.recorder.log import FlightRecorder
from alula.stages.flight.recorder.pipe import FlightPipe
from alula.stages.flight.recorder.samples import BeginSample, PlanSample, TickSample, decoded, encoded
from alula.stages.runlog.maps import map_message
from support.files.browser import drawn, near, opened
from support.flights.flight_logs import head_of, sample
from support.flights.flights import BALL, mission

SIM = "sim:?start=0.5,1.5,0"


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def page(port):
    with urllib.request.urlopen(f"http://127.0.0.1:{port}", timeout=10) as answer:
        return answer.read()


def view_head(made):
    return ViewHead(
        name="flight",
        filter="none",
        vehicle="v",
        radius_m=0.1,
        map_message=map_message(made.map, {"sigma": 1.0}, [np.zeros((1, 3))], "world", 0),
        plan=[(0.0, 0.0, 1.0), (1.0, 0.0, 1.0)],
    )


def children(pid):
    """Child processes of a process, by their code."""
    found = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return {int(child): Path(f"/proc/{child}/cmdline").read_text() for child in found}


def test_a_view_that_does_not_read_loses_its_samples_and_the_log_none(tmp_path):
    view = FlightPipe("import os, time; os.read(0, 10); time.sleep(60)", ())
    view.put(b"begins")
    while view.offer(b"x" * 4000) or view.offer(b"x"):
        pass
    recorder = FlightRecorder(tmp_path / "f.run.mcap", head_of(mission()), echo=False, views=[view])
    for i in range(100):
        recorder.tick(sample(i))
    recorder.say(1.0, 2, "words")
    assert (recorder.dropped, recorder.unseen) == (0, 26)
    view.process.kill()
    view.process.wait()
    recorder.say(1.1, 2, "words")
    assert (recorder.dropped, recorder.unseen) == (0, 27)
    assert recorder.finish(None)
    assert not view.close(1.0)


def test_a_flight_offers_a_view_some_25_ticks_a_second(tmp_path):
    view = FlightPipe("import sys; sys.stdin.buffer.read()", ())
    view.put(b"begins")
    for rate, expected in ((100.0, 25), (20.0, 100)):
        recorder = FlightRecorder(None, head_of(mission()), echo=False, views=[view], rate_hz=rate)
        offered, offer = [], view.offer
        view.offer = offered.append
        for i in range(100):
            recorder.tick(sample(i))
        view.offer = offer
        assert [type(decoded(message)) for message in offered] == [BeginSample] + [TickSample] * expected
        recorder.finish(None)
    assert view.close(10.0)


def test_it_is_seen_on_loopback_only_and_ends_with_the_pipe():
    made, port = mission("cone-backup", scene=BALL, is_clear=True), free_port()
    pipe, address = open_view(port, view_head(made))
    assert address == f"http://127.0.0.1:{port}"
    assert b"<html" in page(port).lower()
    places = [line.split()[1] for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    assert {place.split(":")[0] for place in places if place.endswith(f":{port:04X}")} == {"0100007F"}
    wide = Path("/proc/net/tcp6").read_text() if Path("/proc/net/tcp6").exists() else ""
    assert f":{port:04X} 0000" not in wide
    with pytest.raises(UsageError, match="in use"):
        open_view(port, view_head(made))
    for i in range(200):
        pipe.offer(encoded(sample(i, 0.01 * i)))
    assert pipe.close(10.0)


def test_a_killed_view_does_not_disturb_the_flight(pipeline, tmp_path):
    log, port = tmp_path / "f.run.mcap", free_port()
    command = [sys.executable, "-P", "-m", "alula.cli", "fly", str(pipeline / "tiny.plan.npz")]
    command += ["--map", str(pipeline / "tiny.cover.npz"), "--link", SIM, "-o", str(log), "--live", str(port)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True) as process:
        for line in process.stderr:
            if "flying the plan" in line:
                break
        assert b"<html" in page(port).lower()
        (view,) = [pid for pid, what in children(process.pid).items() if "live_view" in what]
        time.sleep(0.3)
        os.kill(view, signal.SIGKILL)
        rest = process.stderr.read()
        assert process.wait(60) == 0, rest
    assert read_run(log).trials[0].outcome == "reached"
    timing = json.loads((tmp_path / "f.run.json").read_text())["timing"]
    assert timing["unseen_samples"] > 10
    assert timing["dropped_samples"] == 0


def test_its_page_shows_the_map_the_vehicle_and_a_new_plan(browser):
    made, port = mission("polytope-cbf", is_clear=True), free_port()
    pipe, address = open_view(port, view_head(made))
    path = np.linspace((0.3, 2.0, 1.0), (3.0, 2.0, 1.0), 60).tolist()
    new = [(x, y + 0.4, z) for x, y, z in path]
    allowed = (f"ws://127.0.0.1:{port}", f"{address}/")
    with opened(browser, f"{address}/", width=900, height=520, allowed=allowed) as shown:
        shown.page.wait_for_selector("canvas")
        shown.until(lambda: drawn(left_of(shown)) > 0.01, "the canvas stays blank")
        pipe.offer(encoded(PlanSample(0.1, new)))
        for i, point in enumerate(path):
            seen = sample(i)
            seen.state.position_m = Vector3(*point)
            pipe.offer(encoded(seen))
            shown.page.wait_for_timeout(20)
        shown.page.get_by_text("GUIDED, armed").wait_for()
        shown.until(lambda: near(left_of(shown), (231, 41, 138)) > 0.0005, "the new plan is not seen")
    assert pipe.close(10.0)


def left_of(shown):
    """The canvas beside the panel."""
    return shown.pixels()[:, :480]
