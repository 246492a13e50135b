"""A flight with `--foxglove`: a client sees it from its checks to its end, and the log has the same times."""

import json
import socket
import subprocess
import sys
import threading

import pytest
from mcap.reader import make_reader

from alula.schemas.log.run import read_run

START = 1_777_636_800_000_000_000  # 2026-05-01T12:00:00Z


def test_a_client_sees_a_flight_from_its_checks_to_its_end(pipeline, tmp_path):
    pytest.importorskip("foxglove", reason="foxglove-sdk is needed: pip install 'alula[foxglove]'")
    from support.vehicles.foxglove_client import FoxgloveClient

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    log = tmp_path / "f.run.mcap"
    command = [sys.executable, "-P", "-m", "alula.cli", "fly", str(pipeline / "tiny.plan.npz")]
    command += ["--map", str(pipeline / "tiny.cover.npz"), "--link", "sim:?start=0.5,1.5,0", "-o", str(log)]
    command += ["--foxglove", str(port), "--start-time", "2026-05-01T12:00:00Z"]
    found = []
    with subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True) as process:
        said = iter(process.stderr.readline, "")
        assert any(line == f"Foxglove: ws://127.0.0.1:{port}\n" for line in said)
        client = FoxgloveClient(port)
        thread = threading.Thread(target=lambda: found.extend(client.messages()))
        thread.start()
        rest = "".join(said)
        assert process.wait(60) == 0, rest
        thread.join(10)
    assert read_run(log).trials[0].outcome == "reached"
    timing = json.loads((tmp_path / "f.run.json").read_text())["timing"]
    assert (timing["dropped_samples"], timing["unseen_samples"]) == (0, 0)
    states = [m["state_name"] for topic, _, m in found if topic == "/supervisor" and "event_name" in m]
    assert states[-1] == "done"
    assert "fly" in states
    assert {topic for topic, *_ in found} >= {"/map", "/plan", "/path", "/tf", "/state", "/safety", "/log"}
    with log.open("rb") as file:
        logged = [(c.topic, m.log_time, json.loads(m.data)) for _, c, m in make_reader(file).iter_messages()]
    assert min(time_ns for _, time_ns, _ in logged) == START
    seen = {(time_ns, m["time_s"]): m for topic, time_ns, m in found if topic == "/state"}
    own = {(time_ns, m["time_s"]): m for topic, time_ns, m in logged if topic == "/state"}
    assert seen.items() <= own.items()
    assert len(seen) > 15 * (max(time_s for _, time_s in own) - 1)  # some 25 in a second
