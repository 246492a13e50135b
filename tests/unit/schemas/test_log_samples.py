"""Attitudes, inputs, statuses and moving obstacles of a flight in a log."""

import msgspec
import numpy as np
import pytest

from alula.schemas.log.channels import Safety, State
from alula.schemas.log.flights import flights_of
from alula.schemas.log.foxglove import (
    Color,
    Pose,
    Quaternion,
    SceneEntity,
    SceneUpdate,
    SpherePrimitive,
    Time,
    Vector3,
)

ONE = Vector3(1.0, 0.0, 0.0)


def balls(name, *each):
    spheres = [
        SpherePrimitive(Pose(Vector3(*place)), Vector3(size, size, size), Color(1, 1, 1, 1))
        for place, size in each
    ]
    return SceneEntity(timestamp=Time(0, 0), frame_id="world", id=name, spheres=spheres)


def log(times, *, each=None, **of_state):
    """Messages of one flight; the states are not in order of time."""
    for k, time in enumerate(times):
        known = {"trial": 4, "time_s": time}
        yield "/state", State(**known, position_m=Vector3(time, 0, 1), velocity_m_s=ONE, **of_state)
        sent = Vector3(None, 0, 0.5)
        yield "/safety", Safety(**known, status=0, status_name="ok", u_nom_m_s=ONE, u_safe_m_s=sent)
        for name, status in (each or {}).items():
            yield f"/safety/{name}", Safety(trial=4, status=0, status_name=status)
        tracks = [((time, 2, 1), 0.8)] if k else []
        true = [((time, 5, 1), 0.4), ((0, 0, time), 0.6)]
        yield "/obstacles", SceneUpdate(entities=[balls("obstacles", *true), balls("tracks", *tracks)])


def flight_of(messages):
    return flights_of((topic, msgspec.json.encode(message)) for topic, message in messages).by_trial[4]


def test_obstacles_belong_to_the_state_before_them_in_order_of_time():
    found = flight_of(log([1.0, 0.5, 2.0]))
    assert found.time_s.tolist() == [0.5, 1.0, 2.0]
    moving = found.moving
    assert moving.position_world[:, 0].tolist() == [[0.5, 5, 1], [1, 5, 1], [2, 5, 1]]
    assert moving.radius_m.tolist() == [0.2, 0.3]
    assert np.isnan(moving.track_world[1]).all()  # the first message of the log
    assert moving.track_world[2, 0].tolist() == [2, 2, 1]
    assert np.isnan(moving.track_world[2, 1]).all()


def test_attitudes_are_unit_and_bad_ones_repeat_the_one_before():
    found = flight_of(log([0.0, 1.0], attitude=Quaternion(0.0, 0.0, 0.70711, 0.70711)))
    assert np.linalg.norm(found.quat_world_body_wxyz, axis=1) == pytest.approx(1, abs=1e-12)
    zero = Quaternion(0.0, 0.0, 0.0, 0.0)
    assert flight_of(log([0.0], attitude=zero)).quat_world_body_wxyz.tolist() == [[1, 0, 0, 0]]
    assert flight_of(log([0.0])).quat_world_body_wxyz is None


def test_inputs_and_the_status_of_each_filter_are_read():
    found = flight_of(log([0.0, 1.0], each={"a": "ok", "b": "filtered"}))
    assert found.commands.quantity == "velocity [m/s]"
    assert found.commands.nominal.tolist() == [[1, 0, 0]] * 2
    assert np.isnan(found.commands.filtered[0, 0])
    assert found.each_status == {"a": ("ok", "ok"), "b": ("filtered", "filtered")}


def test_a_place_beyond_measurement_is_refused():
    far = SceneUpdate(entities=[balls("obstacles", ((1e13, 0, 0), 0.4))])
    with pytest.raises(ValueError, match="too large"):
        flight_of([*log([0.0]), ("/obstacles", far)])


def test_a_flight_without_a_place_a_time_or_with_a_wrong_obstacle_is_refused():
    unknown = State(trial=4, time_s=0.0, position_m=Vector3(0, None, 0), velocity_m_s=ONE)
    untimed = Safety(trial=4, status=0, status_name="ok")
    wrong = Safety(trial=4, time_s=0.0, status=0, status_name="ok", active=2**41)
    for topic, message in (("/state", unknown), ("/safety", untimed), ("/safety", wrong)):
        with pytest.raises(ValueError, match=r"missing|out of range"):
            flight_of([*log([0.0]), (topic, message)])
