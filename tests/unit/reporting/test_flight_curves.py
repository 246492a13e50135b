"""Curves of a single flight: clearances from the map and the log, limits, statuses, the worst moment."""

import dataclasses
import json

import msgspec
import numpy as np
import pytest
from matplotlib.axes import Axes

from alula.schemas.log.flights import Flight, flights_of
from alula.schemas.log.samples import Commands, Moving
from alula.stages.reporting.flight_curves import worst_flights
from alula.stages.reporting.flight_figures import flight_figures
from alula.stages.reporting.material import Material, Run
from alula.stages.reporting.palette import variables
from support.scenes.fabricate import box, make_cover, make_record, make_trial

COVER = make_cover([box((20, -20, 0), (40, 20, 40))])  # a block from x = 1 m to 2 m
PARAMETERS = {"vehicle": {"radius_m": 0.1, "max_speed_m_s": 2.0}, "safety": {}}


def flight(**fields):
    """Towards the block along x, to 0.5 m before it, and back."""
    time = np.linspace(0, 4, 41)
    x = 0.5 - 0.5 * np.abs(time - 2)
    known = {
        "time_s": time,
        "position_world": np.column_stack([x, 0 * x, 0 * x + 1]),
        "speed_m_s": np.full(41, 0.5),
        "margin_time_s": time,
        "margin": 1 - x - 0.1,
        "margin_unit": "m",
        "status": tuple("filtered" if 15 < i < 25 else "ok" for i in range(41)),
    }
    return Flight(**(known | fields))


def run_of(shown, **fields):
    record = make_record([make_trial(0, clearance=0.4, **fields)])
    made = msgspec.structs.replace(record.provenance, parameters=PARAMETERS)
    return Run("a", msgspec.structs.replace(record, provenance=made), {0: shown})


def test_clearance_over_time_is_the_distance_to_the_hulls_less_the_radius():
    (found,) = worst_flights(Material("t", (run_of(flight()),), cover=COVER))
    (hulls,) = found.clearances
    assert hulls.name == "hulls"
    assert hulls.value.min() == pytest.approx(0.4)
    assert found.worst_s == pytest.approx(2.0, abs=0.11)
    # of each stretch between two samples the minimum, which is that of its nearer end
    np.testing.assert_allclose(hulls.value[:20], 0.9 - flight().position_world[1:21, 0])
    assert (found.speed_limit_m_s, found.closest_m, found.outcome) == (2.0, 0.4, "reached")


def test_a_map_that_was_not_flown_through_gives_no_clearance():
    from alula.schemas.artifacts.manifest import InputRef

    run = run_of(flight())
    ref = InputRef("cover", "alula/cover", "1.0", "a" * 64, "c")
    made = msgspec.structs.replace(run.record.provenance, inputs=[ref])
    other = Run("a", msgspec.structs.replace(run.record, provenance=made), run.flights)
    shown = msgspec.structs.replace(ref, sha256="b" * 64)
    (found,) = worst_flights(Material("t", (other,), cover=COVER, inputs=(shown,)))
    assert found.clearances == ()
    assert found.margin is not None
    assert found.worst_s == pytest.approx(2.0)


def test_moving_obstacles_and_commands_are_those_of_the_log():
    ball = np.tile([0.5, 3.0, 1.0], (41, 1, 1))
    ball[:, 0, 1] = 3 - 0.5 * flight().time_s
    moving = Moving(ball, np.full((41, 1, 3), np.nan), np.array([0.2]))
    commands = Commands(
        np.tile([3.0, 4.0, 0.0], (41, 1)), np.tile([0.6, 0.8, 0.0], (41, 1)), "velocity [m/s]"
    )
    (found,) = worst_flights(Material("t", (run_of(flight(moving=moving, commands=commands)),)))
    (apart,) = found.clearances
    assert apart.name == "moving obstacles"
    at = flight().position_world - ball[:, 0]
    np.testing.assert_allclose(apart.value, np.linalg.norm(at, axis=1) - 0.3)
    assert [(curve.name, curve.value[0]) for curve in found.commands] == [("nominal", 5.0), ("sent", 1.0)]
    assert found.limit == 2.0
    assert found.margin is None  # the log's margin is the same clearance


def test_a_log_tells_what_each_of_several_filters_did():
    def message(topic, **fields):
        return topic, json.dumps({"trial": 0} | fields).encode()

    zero = {"x": 0.0, "y": 0.0, "z": 0.0}
    found = []
    for at, (first, second) in enumerate([("ok", "ok"), ("filtered", "ok"), ("filtered", "backup")]):
        found += [
            message("/state", time_s=0.1 * at, position_m=zero, velocity_m_s=zero),
            message("/safety", time_s=0.1 * at, status=0, status_name=second),
            message("/safety/dr-acbf", status=0, status_name=first),
            message("/safety/shield", status=0, status_name=second),
        ]
    run = run_of(flights_of(found).by_trial[0])
    (curves,) = worst_flights(Material("t", (run,)))
    assert [(one.name, one.status) for one in curves.filters] == [
        ("dr-acbf", ("ok", "filtered", "filtered")),
        ("shield", ("ok", "ok", "backup")),
    ]
    np.testing.assert_allclose(curves.filters[1].time_s, [0, 0.1, 0.2])
    (figure,) = flight_figures(Material("t", (run,)))
    assert "dr-acbf: command unchanged in 33 %, changed in 67 %." in figure.alt
    assert "shield" in figure.svg


def test_a_status_that_changes_in_every_tick_is_drawn_at_once(monkeypatch):
    """One call for each change took minutes for flights past a street."""
    calls, draw = [], Axes.broken_barh
    monkeypatch.setattr(
        Axes, "broken_barh", lambda *words, **more: [calls.append(words[1]), draw(*words, **more)]
    )
    changing = flight()
    changing = dataclasses.replace(
        changing, status=tuple(("ok", "filtered")[i % 2] for i in range(len(changing.status)))
    )
    (figure,) = flight_figures(Material("t", (run_of(changing),)))
    assert [len(spans) for spans in calls] == [len(changing.status)]
    assert "changed in 49 %" in figure.alt


def test_the_figure_marks_the_worst_moment_and_every_colour_has_one_for_the_dark():
    (figure,) = flight_figures(Material("t", (run_of(flight()),), cover=COVER))
    assert "worst moment" in figure.svg
    assert "The dashed line marks the minimum clearance" in figure.alt
    light, dark = variables(dark=False), variables(dark=True)
    assert light.count("--c") == dark.count("--c") > 8
    assert light != dark


def test_a_flight_without_answers_or_a_radius_is_drawn_all_the_same():
    empty = np.empty(0)
    bare = flight(margin_time_s=empty, margin=empty, status=())
    run = run_of(bare)
    made = msgspec.structs.replace(run.record.provenance, parameters={})
    material = Material(
        "t", (Run("a", msgspec.structs.replace(run.record, provenance=made), run.flights),), cover=COVER
    )
    (found,) = worst_flights(material)
    assert (found.clearances, found.margin, found.worst_s, found.filters) == ((), None, None, ())
    assert len(flight_figures(material)) == 1
