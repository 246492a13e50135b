"""Messages of logs against the message classes of foxglove-sdk, and their times."""

import msgspec
import numpy as np
import pytest

from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.log.channels import CHANNELS, FLIGHT_TOPICS, Supervisor, schema_name
from alula.schemas.log.foxglove import SceneUpdate, Time
from alula.stages.export.ros_messages import RosMessages
from alula.stages.flight.recorder.channels import FlightChannels
from alula.stages.flight.recorder.samples import LineSample, StepSample
from alula.stages.runlog import cloud
from alula.stages.runlog.maps import world_message
from alula.stages.runlog.messages import obstacle_message, verdict_message
from support.flights.flight_logs import head_of, sample
from support.flights.flights import mission
from support.scenes.fabricate import make_scene

pytest.importorskip("foxglove", reason="foxglove-sdk is needed: pip install 'alula[foxglove]'")
pytest.importorskip("rosbags", reason="rosbags is needed: pip install 'alula[ros2]'")
from rosbags.typesys import Stores, get_typestore

from support.files.foxglove_messages import encoded

START = 1_777_636_800_123_456_000  # 2026-05-01T12:00:00.123456Z
BOX = np.column_stack([np.vstack([np.eye(3), -np.eye(3)]), [4.0] * 6])


def test_schemas_have_the_fields_of_foxglove():
    from foxglove import messages

    for channel in CHANNELS.values():
        if (name := schema_name(channel.struct)).startswith("foxglove."):
            assert getattr(messages, name.removeprefix("foxglove.")).get_schema().name == name


def test_maps_obstacles_and_verdicts_are_messages_of_foxglove():
    scene = make_scene(5, low=(0, 0, 0), high=(1, 1, 1))
    map_ = world_message(None, scene, 1.0, BOX, [np.zeros((1, 3))], "world", START)
    assert [one.id for one in map_.entities] == ["fence", "ellipsoids"]
    assert encoded(map_)
    two, lost = np.ones((2, 3)), np.array([[0.0, 0.0, 0.0], [np.nan] * 3])
    assert encoded(obstacle_message(two, lost, [0.1, 0.2], "world", START))
    for good in (True, False):
        assert encoded(verdict_message("w", START, is_good=good, collided=not good))


def test_the_cloud_has_the_nearest_gaussians_in_their_colours(monkeypatch):
    scene = make_scene(50, low=(0, 0, 0), high=(1, 1, 1))
    path = np.array([[0.2, 0.2, 0.2], [0.3, 0.2, 0.2]])
    monkeypatch.setattr(cloud, "SHOWN_POINTS", 20)
    message = cloud.cloud_message(scene, [path], "world", START)
    assert encoded(message)
    raw = np.frombuffer(message.data, np.uint8).reshape(-1, message.point_stride)
    offset = {field.name: field.offset for field in message.fields}
    apart = np.linalg.norm(scene["mean"][:, None] - path, axis=2).min(axis=1)
    shown = np.sort(np.argsort(apart)[:20])
    for i, axis in enumerate("xyz"):
        found = np.ascontiguousarray(raw[:, offset[axis] : offset[axis] + 4]).view("<f4")[:, 0]
        assert (found == scene["mean"][shown, i]).all()
    for i, name in enumerate(("red", "green", "blue")):
        assert (raw[:, offset[name]] == scene["color"][shown, i]).all()
    assert (np.abs(raw[:, offset["alpha"]] - 255 * scene["opacity"][shown]) <= 0.5).all()

    store = get_typestore(Stores.ROS2_HUMBLE)
    ((topic, kind, points),) = RosMessages(store.types).of("/splat", msgspec.json.encode(message), START)
    assert (topic, kind, points.width) == ("/splat", "sensor_msgs/msg/PointCloud2", 20)
    again = store.deserialize_cdr(store.serialize_cdr(points, kind), kind)
    assert [(field.name, field.offset, field.datatype) for field in again.fields] == [
        *(("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("rgb", 12, 7))
    ]
    packed = again.data.reshape(-1, again.point_step)[:, 12:].copy().view("<u4")[:, 0]
    red, green, blue = scene["color"][shown].astype(np.uint32).T
    assert (packed & 0xFFFFFF == red << 16 | green << 8 | blue).all()


def test_messages_of_a_flight_are_of_foxglove_and_have_the_time_of_the_wall_clock():
    head = msgspec.structs.replace(head_of(mission()), plan=[(0.0, 0.0, 1.0), (1.0, 0.0, 1.0)])
    channels = FlightChannels(head, START)
    found = [
        *channels.first(),
        *channels.of(StepSample(Supervisor(time_s=0.0, state=1, state_name="checks"), "")),
        *(one for i in range(3) for one in channels.of(sample(i))),
        *channels.of(LineSample(1.5, 3, "words")),
        *channels.path(),
    ]
    assert {topic for topic, *_ in found} == set(FLIGHT_TOPICS) - {"/splat", "/replay"}
    expected = {"/state": 0.01, "/map": 0.0, "/vehicle": 0.0, "/plan": 0.0, "/log": 1.5, "/path": 0.02}
    for topic, time_ns, message in found:
        assert type(message) is CHANNELS[topic].struct
        if schema_name(type(message)).startswith("foxglove."):
            encoded(message)
            stamped = message.entities[0] if isinstance(message, SceneUpdate) else message
            assert stamped.timestamp == Time.of(time_ns)
    for topic, after_s in expected.items():
        assert START + round(1e9 * after_s) in [time_ns for each, time_ns, _ in found if each == topic]
    pose, moved = (next(m for topic, _, m in found if topic == each) for each in ("/pose", "/tf"))
    assert (moved.translation, moved.rotation) == (pose.pose.position, pose.pose.orientation)
    assert (moved.parent_frame_id, moved.child_frame_id) == ("world", "body")


def test_channels_with_a_type_of_foxglove_use_it():
    for topic, channel in CHANNELS.items():
        own = topic in ("/state", "/safety", "/supervisor", "/replay")
        assert schema_name(channel.struct).startswith("alula." if own else "foxglove."), topic


@pytest.mark.parametrize("sigma", [0.0, 1.0])
def test_the_nearest_gaussians_are_those_of_all_pairs_of_points(monkeypatch, sigma):
    monkeypatch.setattr(cloud, "_CHUNK", 100)
    scene = make_scene(950, low=(0, 0, 0), high=(9, 3, 3))
    scale = np.array(scene["scale"])
    scale[::97] = 2.5  # a few huge ones
    scene = Artifact(scene.manifest, scene.arrays | {"scale": scale})
    path = np.random.default_rng(2).uniform((0, 0, 0), (2, 3, 3), (40, 3))
    mean = scene["mean"].astype(np.float64)
    apart = np.linalg.norm(mean[:, None] - path, axis=2).min(axis=1)
    apart -= sigma * scale.max(axis=1).astype(np.float64)
    for most in (1, 60, 949, 950):
        expected = np.sort(np.argsort(apart, kind="stable")[:most])
        assert (cloud.nearest(scene, sigma, [path[:15], path[15:]], most) == expected).all()
