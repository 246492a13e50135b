"""Runs as bags of ROS 2, read by rosbags and by mcap's own decoder of ROS 2, and layouts for Foxglove."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from mcap.writer import Writer
from scipy.spatial.transform import Rotation

from alula.cli.main import run
from alula.schemas.artifacts.provenance import read_provenance
from alula.stages.export.ros_messages import RosMessages
from alula.stages.flight.recorder.log import FlightRecorder
from support.flights.flight_logs import head_of, record_of
from support.flights.flights import fly, mission

SCENARIO = """
schema = "alula/scenario"
version = "2.0"
name = "small"
[vehicle]
type = "double-integrator"
radius_m = 0.15
max_speed_m_s = 12.0
max_acceleration_m_s2 = 6.0
max_jerk_m_s3 = 60.0
[[world.moving]]
motion = "accelerating"
position_m = [60, 1, 10]
velocity_m_s = [-6, 0, 0]
acceleration_m_s2 = [0, 1e-09]
radius_m = 0.2
[[world.walls]]
lower_m = [20, 5, 9]
upper_m = [21, 8, 11]
[mission]
kind = "goal"
start_m = [0.0, 0.0, 10.0]
goal_m = [100.0, 0.0, 10.0]
start_speed_m_s = 4.0
speed_m_s = 4.0
receded_s = 1.0
[estimation.sensor]
kind = "ideal"
position_sigma_m = 0.01
[safety]
filters = ["dr-acbf"]
[rules]
plant_steps = 10
trials = 2
max_time_s = 14.0
logged = 2
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    pytest.importorskip("rosbags", reason="rosbags is needed: pip install 'alula[ros2]'")
    folder = tmp_path_factory.mktemp("runs")
    (folder / "s.toml").write_text(SCENARIO)
    assert run(["simulate", str(folder / "s.toml"), "-o", str(folder / "s.run.mcap"), "-q"]) == 0
    assert run(["export", str(folder / "s.run.mcap"), "-o", str(folder / "bag"), "--ros2", "-q"]) == 0
    return folder


@pytest.fixture(scope="module")
def logged(folder):
    """Messages of the log by topic: pairs of log time and fields."""
    found = {}
    with (folder / "s.run.mcap").open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            found.setdefault(channel.topic, []).append((message.log_time, json.loads(message.data)))
    return found


@pytest.fixture(scope="module")
def bag(folder):
    """Messages of the bag by topic: pairs of time and message."""
    from rosbags.rosbag2 import Reader
    from rosbags.typesys import Stores, get_typestore

    store, found = get_typestore(Stores.ROS2_HUMBLE), {}
    with Reader(folder / "bag") as reader:
        for connection, time_ns, raw in reader.messages():
            message = store.deserialize_cdr(raw, connection.msgtype)
            found.setdefault(connection.topic, []).append((time_ns, message))
    return found


def of(vector):
    return [vector.x, vector.y, vector.z]


def ns(stamp):
    return stamp.sec * 10**9 + stamp.nanosec


def pairs(logged, bag, topic, name=None):
    """Messages of the log with those of the bag, of equal number and times."""
    ours, theirs = logged[topic], bag[name or topic]
    assert [time for time, _ in ours] == [time for time, _ in theirs]
    return [(time, a, b) for (time, a), (_, b) in zip(ours, theirs, strict=True)]


def test_poses_and_transforms_are_those_of_the_log(logged, bag):
    for time, ours, theirs in pairs(logged, bag, "/pose"):
        assert ns(theirs.header.stamp) == time
        assert theirs.header.frame_id == "world"
        assert of(theirs.pose.position) == list(ours["pose"]["position"].values())
        assert [*of(theirs.pose.orientation), theirs.pose.orientation.w] == list(
            ours["pose"]["orientation"].values()
        )
    for time, ours, theirs in pairs(logged, bag, "/tf"):
        (moved,) = theirs.transforms
        assert (ns(moved.header.stamp), moved.header.frame_id, moved.child_frame_id) == (
            time,
            "world",
            "body",
        )
        assert of(moved.transform.translation) == list(ours["translation"].values())


def test_states_become_odometry_and_velocity(logged, bag):
    velocities = [message for _, message in bag["/velocity"]]
    found = pairs(logged, bag, "/state", "/odom")
    for (time, ours, theirs), velocity in zip(found, velocities, strict=True):
        header = theirs.header
        assert (ns(header.stamp), header.frame_id, theirs.child_frame_id) == (time, "world", "body")
        assert of(theirs.pose.pose.position) == list(ours["position_m"].values())
        assert of(velocity.twist.linear) == list(ours["velocity_m_s"].values())


def test_odometry_has_the_twist_in_the_body_frame_and_velocity_that_of_the_world():
    from rosbags.typesys import Stores, get_typestore

    body_to_world = Rotation.from_euler("ZYX", [2.0, 0.3, -0.5])
    v_world, omega_body = np.array([1.0, -2.0, 0.5]), np.array([0.1, 0.2, -0.3])
    state = {
        **{"trial": 0, "time_s": 0.0, "position_m": dict.fromkeys("xyz", 1.0)},
        "velocity_m_s": dict(zip("xyz", v_world.tolist(), strict=True)),
        "attitude": dict(zip("xyzw", body_to_world.as_quat().tolist(), strict=True)),
        "omega_body_rad_s": dict(zip("xyz", omega_body.tolist(), strict=True)),
    }
    converter = RosMessages(get_typestore(Stores.ROS2_HUMBLE).types)
    found = {topic: message for topic, _, message in converter.of("/state", json.dumps(state).encode(), 0)}
    twist, velocity = found["/odom"].twist.twist, found["/velocity"].twist
    np.testing.assert_allclose(of(twist.linear), body_to_world.inv().apply(v_world), atol=1e-12)
    assert of(twist.angular) == omega_body.tolist()
    assert of(velocity.linear) == v_world.tolist()
    np.testing.assert_allclose(of(velocity.angular), body_to_world.apply(omega_body), atol=1e-12)


def test_paths_commands_and_margins_are_those_of_the_log(logged, bag):
    for _, ours, theirs in pairs(logged, bag, "/path"):
        assert [of(each.pose.position) for each in theirs.poses] == [
            list(pose["position"].values()) for pose in ours["poses"]
        ]
    for _, ours, theirs in pairs(logged, bag, "/safety", "/command/safe_acceleration"):
        assert of(theirs.accel.linear) == list(ours["a_safe_m_s2"].values())
    margins = [(time, fields["margin"]) for time, fields in logged["/safety"] if "margin" in fields]
    assert [(time, message.data) for time, message in bag["/safety/margin"]] == margins
    assert len(margins) > 50
    for time, ours, theirs in pairs(logged, bag, "/log", "/rosout"):
        assert (ns(theirs.stamp), theirs.msg, theirs.name) == (time, ours["message"], "alula.simulate")
        assert theirs.level == {2: 20, 3: 30, 4: 40}[ours["level"]]


def test_own_channels_are_complete_as_text(logged, bag):
    for topic in ("/state", "/safety"):
        for _, ours, theirs in pairs(logged, bag, topic, f"/alula{topic}"):
            assert json.loads(theirs.data) == ours


def test_hulls_and_obstacles_are_markers(logged, bag):
    (_, ours, theirs), *_ = pairs(logged, bag, "/map")
    first, *solids = theirs.markers
    assert first.action == first.DELETEALL
    (entity,) = ours["entities"]
    assert len(solids) == len(entity["triangles"]) == 1
    for hull, marker in zip(entity["triangles"], solids, strict=True):
        assert (marker.type, marker.action, marker.ns) == (marker.TRIANGLE_LIST, marker.ADD, "map")
        corners = [list(hull["points"][i].values()) for i in hull["indices"]]
        assert [of(point) for point in marker.points] == corners
        assert marker.color.a == pytest.approx(hull["color"]["a"])
        assert of(marker.scale) == [1, 1, 1]
    for time, ours, theirs in pairs(logged, bag, "/obstacles"):
        balls = [(one["id"], ball) for one in ours["entities"] for ball in one["spheres"]]
        shown = theirs.markers[1:]
        for (name, ball), marker in zip(balls, shown, strict=True):
            assert (marker.type, marker.ns, ns(marker.header.stamp)) == (marker.SPHERE, name, time)
            assert of(marker.pose.position) == list(ball["pose"]["position"].values())
            assert of(marker.scale) == list(ball["size"].values())
        assert len({(marker.ns, marker.id) for marker in shown}) == len(shown)


def test_a_decoder_of_another_project_reads_the_same(folder, logged):
    from mcap_ros2.decoder import DecoderFactory

    with (folder / "bag" / "bag.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        found = [
            (message.log_time, of(odometry.pose.pose.position), odometry.pose.covariance[35])
            for _, _, message, odometry in reader.iter_decoded_messages(topics=["/odom"])
        ]
    assert found == [(time, list(m["position_m"].values()), 0.0) for time, m in logged["/state"]]


def test_metadata_counts_and_has_the_provenance(folder, logged):
    text = (folder / "bag" / "metadata.yaml").read_text()
    facts = yaml.safe_load(text)["rosbag2_bagfile_information"]
    assert (facts["storage_identifier"], facts["relative_file_paths"]) == ("mcap", ["bag.mcap"])
    assert facts["starting_time"]["nanoseconds_since_epoch"] == logged["/map"][0][0] == 946684800 * 10**9
    counts = {
        each["topic_metadata"]["name"]: each["message_count"] for each in facts["topics_with_message_count"]
    }
    assert counts["/odom"] == len(logged["/state"])
    assert sum(counts.values()) == facts["message_count"]
    recorded = read_provenance(folder / "bag" / "metadata.yaml")
    assert (recorded.parameters, recorded.inputs[0].name) == ({"format": "rosbag2"}, "s.run.mcap")


def test_the_same_run_gives_the_same_bytes_and_an_unchanged_bag_stays(folder, tmp_path, capsys):
    words = ["export", str(folder / "s.run.mcap"), "-o", str(tmp_path / "bag"), "--ros2", "--json"]
    assert run([*words, "--dry-run"]) == 0
    assert not list(tmp_path.iterdir())
    planned = json.loads(capsys.readouterr().out)["summary"]
    for status in ("written", "unchanged"):
        assert run(words) == 0
        answer = json.loads(capsys.readouterr().out)
        assert answer["status"] == status
        assert status == "unchanged" or answer["summary"] == planned
        for name in ("bag.mcap", "metadata.yaml"):
            assert (tmp_path / "bag" / name).read_bytes() == (folder / "bag" / name).read_bytes()
    assert [path.name for path in tmp_path.iterdir()] == ["bag"]


@pytest.mark.slow
def test_a_real_flight_becomes_a_bag_even_if_its_log_was_cut(tmp_path, folder, capsys):
    from rosbags.rosbag2 import Reader

    log, made = tmp_path / "f.run.mcap", mission()
    recorder = FlightRecorder(log, head_of(made), echo=False, start_ns=10**18)
    loop, _ = fly(made, recorder=recorder)
    assert recorder.finish(record_of(made, loop, recorder))
    assert run(["export", str(log), "-o", str(tmp_path / "bag"), "--ros2", "-q"]) == 0
    with Reader(tmp_path / "bag") as reader:
        counts = {connection.topic: connection.msgcount for connection in reader.connections}
        assert reader.start_time == 10**18
    assert counts["/odom"] == counts["/tf"] == len(loop.counters.tick_s)
    assert counts["/alula/supervisor"] == counts["/odom"] + len(loop.taken)

    cut = tmp_path / "cut.run.mcap"
    cut.write_bytes(log.read_bytes()[: log.stat().st_size // 2])
    capsys.readouterr()
    assert run(["export", str(cut), "-o", str(tmp_path / "cut"), "--ros2", "--json"]) == 0
    (note,) = json.loads(capsys.readouterr().out)["summary"]["notes"]
    assert note.startswith("the log of this flight was cut: it ends after ")
    with Reader(tmp_path / "cut") as reader:
        odometry = [one for one in reader.connections if one.topic == "/odom"]
        times = [time_ns for _, time_ns, _ in reader.messages(odometry)]
    assert 0.2 * counts["/odom"] < len(times) < counts["/odom"]


def refused(words, code, capsys):
    assert run(["export", *map(str, words)]) == code
    (line,) = capsys.readouterr().err.splitlines()
    return line


def test_folders_of_other_files_are_never_replaced(folder, tmp_path, capsys):
    log, other = folder / "s.run.mcap", tmp_path / "other"
    other.mkdir()
    (other / "mine.txt").write_text("mine")
    line = refused([log, "-o", other, "--ros2", "-f"], 2, capsys)
    assert "other files" in line
    line = refused([log, "-o", other / "mine.txt", "--ros2", "-f"], 3, capsys)
    assert "not a folder" in line
    assert "by its name" in refused([log, "-o", tmp_path / "other" / "..", "--ros2"], 2, capsys)
    assert [path.name for path in tmp_path.rglob("*")] == ["other", "mine.txt"]
    (other / "mine.txt").unlink()
    assert (
        run(["export", str(log), "-o", str(other), "--ros2", "-q"]) == 0
    )  # an empty folder has nothing to lose
    (other / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
    assert "not a file of alula" in refused([log, "-o", other, "--ros2"], 2, capsys)
    assert run(["export", str(log), "-o", str(other), "--ros2", "-q", "-f"]) == 0
    assert (other / "other.mcap").stat().st_size > 1000


@pytest.mark.parametrize(
    "bad", [b"{}", b"[", b'{"timestamp": {"sec": 4294967296, "nsec": 0}, "frame_id": "w", "pose": {}}']
)
def test_a_message_that_is_no_pose_leaves_the_earlier_bag(folder, tmp_path, capsys, bad):
    log, out = tmp_path / "r.run.mcap", tmp_path / "bag"
    with (folder / "s.run.mcap").open("rb") as file, log.open("wb") as stream:
        reader, writer, channels = make_reader(file), Writer(stream), {}
        writer.start()
        for _, channel, message in reader.iter_messages():
            if channel.topic not in channels:
                channels[channel.topic] = writer.register_channel(channel.topic, "json", 0)
            writer.add_message(channels[channel.topic], message.log_time, message.data, message.log_time)
        writer.add_message(channels["/pose"], message.log_time, bad, message.log_time)
        for note in reader.iter_metadata():
            writer.add_metadata(note.name, note.metadata)
        writer.finish()
    assert run(["export", str(folder / "s.run.mcap"), "-o", str(out), "--ros2", "-q"]) == 0
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    assert "truncated or corrupt" in refused([log, "-o", out, "--ros2", "-f"], 3, capsys)
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bag", "r.run.mcap"]


def test_bad_input_leaves_no_bag(folder, tmp_path, capsys, monkeypatch):
    log = (folder / "s.run.mcap").read_bytes()
    cut, out = tmp_path / "cut.run.mcap", tmp_path / "bag"
    cut.write_bytes(log[: len(log) // 2])
    refused([cut, "-o", out, "--ros2"], 3, capsys)
    refused([folder / "s.toml", "-o", out, "--ros2"], 3, capsys)
    assert "--ros2" in refused([folder / "s.run.mcap", "-o", tmp_path / "x.glb"], 2, capsys)
    assert "INPUT is missing" in refused(["-o", tmp_path / "x.glb"], 2, capsys)
    assert "neither" in refused([cut, "-o", out, "--ros2", "--format", "glb"], 2, capsys)
    monkeypatch.setitem(sys.modules, "rosbags", None)
    assert "pip install 'alula[ros2]'" in refused([folder / "s.run.mcap", "-o", out, "--ros2"], 2, capsys)
    assert [path.name for path in tmp_path.iterdir()] == ["cut.run.mcap"]
