"""Messages of logs against the message classes of foxglove-sdk, and their times."""

import msgspec
import numpy as np
import pytest

from alula.stages.flight.recorder.channels import CHANNELS, FlightChannels, LineSample, StepSample
from alula.stages.runlog.foxglove_schemas import FOXGLOVE_SCHEMAS
from alula.stages.runlog.maps import world_message
from alula.stages.runlog.messages import obstacle_message, verdict_message
from alula.stages.runlog.schemas import FLIGHT_CHANNELS
from support.fabricate import make_scene
from support.flight_logs import head_of, sample
from support.flights import mission

pytest.importorskip("foxglove", reason="foxglove-sdk is needed: pip install 'alula[foxglove]'")
from support.foxglove_messages import encoded

START = 1_777_636_800_123_456_000  # 2026-05-01T12:00:00.123456Z
BOX = np.column_stack([np.vstack([np.eye(3), -np.eye(3)]), [4.0] * 6])


def test_schemas_have_the_fields_of_foxglove():
    from foxglove import messages

    for name in FOXGLOVE_SCHEMAS:
        assert getattr(messages, name.removeprefix("foxglove.")).get_schema().name == name


def test_maps_obstacles_and_verdicts_are_messages_of_foxglove():
    scene = make_scene(5, low=(0, 0, 0), high=(1, 1, 1))
    map_ = world_message(None, scene, 1.0, BOX, [np.zeros((1, 3))], "world", START)
    assert [one["id"] for one in map_["entities"]] == ["fence", "ellipsoids"]
    assert encoded("foxglove.SceneUpdate", map_)
    two, lost = np.ones((2, 3)), np.array([[0.0, 0.0, 0.0], [np.nan] * 3])
    assert encoded("foxglove.SceneUpdate", obstacle_message(two, lost, [0.1, 0.2], "world", START))
    for good in (True, False):
        assert encoded("foxglove.Log", verdict_message("w", START, is_good=good, collided=not good))


def test_messages_of_a_flight_are_of_foxglove_and_have_the_time_of_the_wall_clock():
    head = msgspec.structs.replace(head_of(mission()), plan=[(0.0, 0.0, 1.0), (1.0, 0.0, 1.0)])
    channels = FlightChannels(head, START)
    found = [
        *channels.first(),
        *channels.step(StepSample(0.0, "checks", "start", "none", "")),
        *(one for i in range(3) for one in channels.tick(sample(i))),
        *channels.line(LineSample(1.5, 3, "words")),
        *channels.path(),
    ]
    assert {topic for topic, *_ in found} == set(CHANNELS) - {"/replay"}
    expected = {"/state": 0.01, "/map": 0.0, "/vehicle": 0.0, "/plan": 0.0, "/log": 1.5, "/path": 0.02}
    for topic, time_ns, message in found:
        name = CHANNELS[topic]
        if name.startswith("foxglove."):
            encoded(name, message)
            stamped = message["entities"][0] if name == "foxglove.SceneUpdate" else message
            stamp = stamped["timestamp"]
            assert stamp["sec"] * 10**9 + stamp["nsec"] == time_ns
    for topic, after_s in expected.items():
        assert START + round(1e9 * after_s) in [time_ns for each, time_ns, _ in found if each == topic]
    pose, moved = (next(m for topic, _, m in found if topic == each) for each in ("/pose", "/tf"))
    assert (moved["translation"], moved["rotation"]) == tuple(pose["pose"].values())
    assert (moved["parent_frame_id"], moved["child_frame_id"]) == ("world", "body")


def test_channels_with_a_type_of_foxglove_use_it():
    for topic, name in {**FLIGHT_CHANNELS, **CHANNELS}.items():
        own = topic in ("/state", "/safety", "/supervisor", "/replay")
        assert name.startswith("alula." if own else "foxglove."), topic
