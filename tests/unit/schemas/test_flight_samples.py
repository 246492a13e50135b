"""Attitudes, inputs, statuses and moving obstacles of a flight in a log."""

import json

import numpy as np
import pytest

from alula.schemas.flights import flights_of


def vector(x, y, z):
    return {"x": x, "y": y, "z": z}


def sphere(place, size):
    return {"pose": {"position": vector(*place)}, "size": vector(size, size, size)}


def log(times, **fields):
    """Messages of one flight; the states are not in order of time."""
    for k, time in enumerate(times):
        state = {
            "trial": 4,
            "time_s": time,
            "position_m": vector(time, 0, 1),
            "velocity_m_s": vector(1, 0, 0),
        }
        yield "/state", state | fields.get("state", {})
        command = {"u_nom_m_s": vector(1, 0, 0), "u_safe_m_s": vector(None, 0, 0.5)}
        yield "/safety", {"trial": 4, "time_s": time, "status_name": "ok"} | command
        for name, status in fields.get("each", {}).items():
            yield f"/safety/{name}", {"trial": 4, "status_name": status}
        tracks = [sphere((time, 2, 1), 0.8)] if k else []
        true = [sphere((time, 5, 1), 0.4), sphere((0, 0, time), 0.6)]
        yield (
            "/obstacles",
            {"entities": [{"id": "obstacles", "spheres": true}, {"id": "tracks", "spheres": tracks}]},
        )


def flight_of(messages):
    return flights_of((topic, json.dumps(fields).encode()) for topic, fields in messages).by_trial[4]


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
    turned = {"attitude": {"x": 0.0, "y": 0.0, "z": 0.70711, "w": 0.70711}}
    found = flight_of(log([0.0, 1.0], state=turned))
    assert np.linalg.norm(found.quat_world_body_wxyz, axis=1) == pytest.approx(1, abs=1e-12)
    zero = {"attitude": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 0.0}}
    assert flight_of(log([0.0], state=zero)).quat_world_body_wxyz.tolist() == [[1, 0, 0, 0]]
    assert flight_of(log([0.0])).quat_world_body_wxyz is None


def test_inputs_and_the_status_of_each_filter_are_read():
    found = flight_of(log([0.0, 1.0], each={"a": "ok", "b": "filtered"}))
    assert found.commands.quantity == "velocity [m/s]"
    assert found.commands.nominal.tolist() == [[1, 0, 0]] * 2
    assert np.isnan(found.commands.filtered[0, 0])
    assert found.each_status == {"a": ("ok", "ok"), "b": ("filtered", "filtered")}


def test_a_place_beyond_measurement_is_refused():
    messages = list(log([0.0]))
    messages[-1][1]["entities"][0]["spheres"][0]["pose"]["position"]["x"] = 1e13
    with pytest.raises(ValueError, match="too large"):
        flight_of(messages)
