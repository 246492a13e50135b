"""Channels of logs: a Struct is all that writer, readers, schema, pipe, ROS 2 and Foxglove need of one."""

import io
import json
import math

import msgspec
import pytest
from mcap.reader import make_reader

from alula.schemas.log import channels
from alula.schemas.log.channels import CHANNELS, Channel, Replay, Safety, decoded, schema_name
from alula.schemas.log.foxglove import Quaternion, Vector3
from alula.schemas.log.json_schema import json_schema
from alula.stages.export.foxglove_layout import foxglove_layout
from alula.stages.export.ros_messages import RosMessages
from alula.stages.flight.recorder import samples
from alula.stages.runlog.messages import rounded
from alula.stages.runlog.writer import LogWriter
from support.flights.flight_logs import sample
from support.paths import ROOT


class MapCheck(msgspec.Struct, kw_only=True, omit_defaults=True):
    """Fractions of rays against the map."""

    time_s: float
    nearer: channels._Margin = None
    at: Vector3 | None = None


def test_a_new_channel_needs_its_struct_and_one_entry(monkeypatch):
    monkeypatch.setitem(CHANNELS, "/map_check", Channel(MapCheck))
    told = MapCheck(time_s=1.0, nearer=0.25, at=Vector3(1.0, None, 0.0))
    stream = io.BytesIO()
    log = LogWriter(stream, ["/map_check"])
    log.send("/map_check", 10**9, told)
    log.close()
    stream.seek(0)
    ((named, _, message),) = make_reader(stream).iter_messages()
    raw = message.data
    assert raw == b'{"time_s":1.0,"nearer":0.25,"at":{"x":1.0,"y":null,"z":0.0}}'
    assert decoded("/map_check", raw) == told
    schema = json.loads(named.data)
    assert schema == json_schema(MapCheck)
    assert schema["title"] == "alula.MapCheck"
    assert schema["properties"]["at"]["title"] == "foxglove.Vector3"
    assert schema["description"] == "Fractions of rays against the map."
    pytest.importorskip("rosbags", reason="rosbags is needed: pip install 'alula[ros2]'")
    from rosbags.typesys import Stores, get_typestore

    converter = RosMessages(get_typestore(Stores.ROS2_HUMBLE).types)
    ((topic, _, text),) = converter.of("/map_check", raw, 10**9)
    assert (topic, text.data.encode()) == ("/alula/map_check", raw)
    plot = foxglove_layout("world")["configById"]["Plot!margin"]
    assert "/map_check.nearer" in [path["value"] for path in plot["paths"]]


def test_the_guide_names_all_channels_and_their_schemas():
    formats = (ROOT / "docs/guide/formats.md").read_text()
    for topic, channel in CHANNELS.items():
        assert f"| `{topic}` | `{schema_name(channel.struct)}` |" in formats


def test_what_a_flight_logs_is_rounded_and_what_is_unknown_is_left_out():
    told = Safety(
        trial=0,
        status=0,
        status_name="ok",
        h_m=math.inf,
        gate_m=0.12345678912,
        u_nom_m_s=Vector3(0.12345678, -1e-9, math.nan),
        sent_values=[0.12345678912, math.nan],
    )
    assert msgspec.json.encode(rounded(told)) == (
        b'{"trial":0,"status":0,"status_name":"ok","gate_m":0.123456789,'
        b'"u_nom_m_s":{"x":0.123457,"y":0.0,"z":null},"sent_values":[0.123456789,null]}'
    )
    assert rounded(Quaternion(0.0, 0.0, 0.70710678, 0.70710678)).z == 0.707107


def test_a_tick_goes_through_the_pipe_bit_by_bit_and_in_one_piece():
    tick = sample(7, 1 / 3)
    values = tuple((i + 1) / 7 for i in range(18))
    tick.replay = Replay(
        time_s=0.07,
        number=7,
        repeats=0,
        age_s=1 / 3,
        measured=values[:12],
        target=values,
        decided="rates",
        decided_values=values[:4],
        is_own=True,
        sent="rates",
        sent_values=values[:4],
    )
    tick.safety.margin = math.inf
    message = samples.encoded(tick)
    assert len(message) < 1200  # a pipe holds 8 s of such ticks, and takes at most 4092 bytes at once
    assert samples.decoded(message) == tick
    assert samples.decoded(samples.encoded(samples.TickSample(tick.supervisor))).state is None
