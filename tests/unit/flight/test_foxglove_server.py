"""Live channels for Foxglove: protocol, channels, late and slow clients, and that only loopback is served."""

import json
import socket
import sys
import threading
import time
from pathlib import Path

import msgspec
import pytest

from alula.cli.main import run
from alula.schemas.errors import UsageError
from alula.schemas.log.channels import FLIGHT_TOPICS, schema_name, struct_of
from alula.schemas.log.json_schema import json_schema
from alula.stages.flight.recorder.foxglove_server import open_foxglove
from alula.stages.flight.recorder.log import FlightRecorder
from support.flights.flight_logs import head_of, sample
from support.flights.flights import mission

START = 1_777_636_800_000_000_000


@pytest.fixture(scope="module")
def head():
    pytest.importorskip("foxglove", reason="foxglove-sdk is needed: pip install 'alula[foxglove]'")
    return msgspec.structs.replace(head_of(mission()), plan=[(0.0, 0.0, 1.0), (1.0, 0.0, 1.0)], log_every=50)


@pytest.fixture
def served(head):
    """Port of a server, and a recorder that feeds it."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    pipe, address = open_foxglove(port, head)
    assert address == f"ws://127.0.0.1:{port}"
    recorder = FlightRecorder(None, head, echo=False, views=[pipe], rate_hz=25.0, start_ns=START)
    yield port, recorder, pipe
    recorder.finish(None)
    pipe.close(10.0)


def listen(port, **how):
    from support.vehicles.foxglove_client import FoxgloveClient

    return FoxgloveClient(port, **how)


def collect(client, recorder):
    """Thread that reads all messages into a list; ticks at x = -1 are sent until it has some."""
    found = []

    def read():
        for message in client.messages():
            found.append(message)

    thread = threading.Thread(target=read)
    thread.start()
    end = time.monotonic() + 20
    while not any(topic == "/state" for topic, *_ in found) and time.monotonic() < end:
        recorder.tick(sample(0, -1.0))
        time.sleep(0.04)
    return thread, found


def test_a_client_gets_the_channels_of_the_log_and_their_messages(served, head):
    port, recorder, pipe = served
    places = [line.split()[1] for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    assert {place.split(":")[0] for place in places if place.endswith(f":{port:04X}")} == {"0100007F"}
    with pytest.raises(UsageError, match=f"--foxglove {port}: Address already in use"):
        open_foxglove(port, head)
    client = listen(port)
    assert client.subprotocol == "foxglove.sdk.v1"
    assert client.info["name"] == "alula fly: flight"
    assert client.info["capabilities"] == []  # it can send nothing
    assert set(client.channels) == set(FLIGHT_TOPICS) - {"/replay"}
    for topic, channel in client.channels.items():
        struct = struct_of(topic)
        assert channel["encoding"] == "json"
        assert channel["schemaName"] == schema_name(struct)
        assert json.loads(channel["schema"]) == json_schema(struct)
    thread, found = collect(client, recorder)
    for i in range(20):
        recorder.tick(sample(i, 0.1 * i))
    recorder.say(0.2, 3, "words")
    late_thread, of_late = collect(listen(port), recorder)
    recorder.tick(sample(20, 2.0))
    assert pipe.close(10.0)
    thread.join(10)
    late_thread.join(10)
    by_topic = {}
    for topic, time_ns, message in found:
        by_topic.setdefault(topic, []).append((time_ns, message))
    states = [(at, message) for at, message in by_topic["/state"] if message["position_m"]["x"] >= 0]
    assert [message["position_m"]["x"] for _, message in states] == pytest.approx(
        [0.1 * i for i in range(21)]
    )
    assert [time_ns for time_ns, _ in states] == [START + 10_000_000 * i for i in range(21)]
    for topic in ("/map", "/vehicle", "/plan"):
        assert by_topic[topic][0][0] == START
    assert by_topic["/log"][0][1]["message"] == "words"
    assert len(by_topic["/path"][-1][1]["poses"]) >= 21  # all of it, at the end
    assert {topic for topic, *_ in of_late} >= {"/map", "/vehicle", "/plan", "/path", "/state", "/tf"}
    x_of_late = [message["position_m"]["x"] for topic, _, message in of_late if topic == "/state"]
    assert x_of_late[-1] == 2.0
    assert recorder.unseen == 0


@pytest.mark.slow
def test_a_client_that_reads_nothing_loses_messages_and_others_do_not_notice(served):
    port, recorder, pipe = served
    slow = listen(port, reads=False)
    ticks = 6000
    for i in range(ticks):
        recorder.tick(sample(i))
        if i % 100 == 0:
            time.sleep(0.02)  # as fast as the processes read
    thread, found = collect(listen(port), recorder)
    recorder.tick(sample(ticks, 7.0))
    assert pipe.close(10.0)
    thread.join(10)
    assert 7.0 in [message["position_m"]["x"] for topic, _, message in found if topic == "/state"]
    assert sum(topic == "/state" for topic, *_ in slow.messages()) < ticks - 1000


def test_without_the_library_one_line_says_so_before_anything_else(pipeline, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "foxglove", None)
    words = ["fly", str(pipeline / "tiny.plan.npz"), "--map", str(pipeline / "tiny.cover.npz")]
    assert run([*words, "--link", "sim:", "-o", str(tmp_path / "f.run.mcap"), "--foxglove"]) == 2
    assert capsys.readouterr().err == (
        "alula: foxglove-sdk is not installed; fly --foxglove needs it: pip install 'alula[foxglove]'\n"
    )
    assert list(tmp_path.iterdir()) == []
