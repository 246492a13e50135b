"""Runs by a pilot in a fence: many trials, chunks, the log and its samples, times."""

import io

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from alula.schemas.artifacts.manifest import producer
from alula.schemas.artifacts.provenance import Provenance
from alula.schemas.errors import UsageError
from alula.schemas.log.channels import CHANNELS
from alula.schemas.log.json_schema import json_schema
from alula.schemas.log.run import RunRecord
from alula.stages.filtering.protocol import FilterStatus
from alula.stages.runlog.world import write_world_log
from alula.stages.simulation import simulate as stage
from alula.stages.simulation.chunks import TrialJournal
from alula.stages.simulation.judge import worst_clearance
from alula.stages.simulation.prepare import prepare
from alula.stages.simulation.result import WorldFlight
from alula.stages.simulation.simulate import chunk_size
from alula.stages.simulation.summary import world_guarantee, world_summary, world_timing
from support.flights.fence_flights import STATUSES
from support.flights.piloted_runs import RACER, fly, scenario


@pytest.fixture(scope="module")
def room():
    return fly(jobs=2)


def test_the_first_flights_and_the_worst_are_shown(room):
    order = sorted(room.trials, key=worst_clearance)
    again = {trial.index for trial in order[: stage.WORST]} - {0, 1}
    assert [flight.trial for flight in room.flights] == [0, 1, *sorted(again)]
    worst = order[0]
    assert world_summary(room)["worst_trial"] == worst.index >= 2  # else nothing is flown again
    shown = {flight.trial: flight for flight in room.flights}
    assert shown[worst.index].rows("distance").min() == pytest.approx(worst.fence_clearance_m, abs=5e-3)
    whole = fly({"rules.logged": 10})
    assert whole.trials == room.trials
    assert [flight.trial for flight in whole.flights] == list(range(10))
    assert whole.flights[worst.index] == shown[worst.index]


def test_flights_that_cannot_differ_are_flown_once():
    fixed, start = {"mission.pilot.kind": "straight", "rules.trials": 3}, {"start_m": (0.0, 0.0, 10.0)}
    with pytest.raises(UsageError, match="all 3 flights would be the same"):
        fly(fixed, start)
    assert len(fly(fixed | {"rules.trials": 1}, start).trials) == 1
    gusty = {
        "vehicle.disturbance.linear_drag_n_s_m": (0.1, 0.1, 0.1),
        "vehicle.disturbance.gust_m_s": (1, 1, 1),
    }
    ends = [trial.goal_m for trial in fly(fixed | gusty, start).trials]
    assert ends[0] != ends[1] != ends[2]
    once = world_summary(fly(fixed | {"rules.trials": 1}, start))
    assert (once["success_rate"], once["success_interval"]) == (1.0, None)
    assert world_summary(fly({"rules.trials": 1, "rules.max_time_s": 0.1}))["success_interval"] is not None


def test_no_more_than_one_chunk_is_in_memory_and_long_flights_are_flown_one_by_one(monkeypatch):
    asked = []
    flies = stage.PreparedRun.fly

    def counted(self, first, count, **how):
        asked.append(count)
        return flies(self, first, count, **how)

    monkeypatch.setattr(stage.PreparedRun, "fly", counted)
    run = fly({"rules.trials": 40, "rules.max_time_s": 0.1})
    again = sum(flight.trial >= 2 for flight in run.flights)
    assert sum(asked) == 40 + again
    assert max(asked) == stage.CHUNK
    for duration, size in ((600.0, 1), (20.0, 12), (1.5, stage.CHUNK)):
        assert chunk_size(prepare(scenario({"rules.max_time_s": duration}), RACER)) == size


def log_of(run):
    scene, summary = run.scenario, world_summary(run)
    made = Provenance(
        schema="alula/run",
        version="1.0",
        producer=producer(),
        parameters={},
        seed=0,
        inputs=[],
        summary=summary,
    )
    record = RunRecord.of(
        made,
        name="r",
        filter="geofence",
        vehicle="v",
        trials=run.trials,
        summary=summary,
        guarantee=world_guarantee(run, None),
    )
    out = io.BytesIO()
    write_world_log(
        out,
        record,
        run.flights,
        "world",
        dt_s=scene.rules.dt_s,
        interface=scene.vehicle.interface,
        filters=list(scene.safety.filters),
        radii_m=[],
        radius_m=run.world.radius_m,
        hulls=run.world.hulls,
        scene=None,
        sigma=run.world.sigma,
        faces=run.world.faces,
    )
    return out.getvalue()


def test_results_do_not_depend_on_jobs_or_on_what_a_journal_brings(room, monkeypatch):
    monkeypatch.setattr(stage, "CHUNK", 4)
    serial = fly()
    assert serial.trials == room.trials
    assert log_of(serial) == log_of(room)
    journal = TrialJournal()
    seen = []
    fly(journal=journal, progress=lambda done, total: seen.append((done, total)))
    assert seen == [(4, 10), (8, 10), (10, 10)]
    del journal.chunks[4]
    taken = TrialJournal(journal.snapshot())
    assert len(taken) == 6
    resumed = fly(journal=taken)
    assert log_of(resumed) == log_of(room)
    assert resumed.filter_times.calls == 6000
    with pytest.raises(ValueError):
        TrialJournal(b"\x00\x01")


def topics_of(run):
    from mcap.reader import make_reader

    topics = {}
    for _, channel, message in make_reader(io.BytesIO(log_of(run))).iter_messages():
        topics.setdefault(channel.topic, []).append(msgspec.json.decode(message.data))
    return topics


def test_the_log_says_what_was_flown(room):
    topics = topics_of(room)
    assert topics.keys() == {"/map", "/vehicle", "/path", "/pose", "/tf", "/state", "/safety", "/log"}
    assert [entity["id"] for entity in topics["/map"][0]["entities"]] == ["fence"]
    safety = [m for m in topics["/safety"] if m["trial"] == 0]
    flight = room.flights[0]
    assert len(safety) == len(flight.status) == 76
    assert [m["lambda"] for m in safety] == pytest.approx(flight.rows("figure")[:, 0], abs=1e-6)
    assert [m["fence_distance_m"] for m in safety] == pytest.approx(flight.rows("distance")[:, 0], abs=1e-6)
    assert [m["status_name"] for m in safety] == [
        STATUSES[i] for i in flight.of_filters("fence_status")[:, 0]
    ]
    assert {m["margin_unit"] for m in safety} == {"of the filter's barrier"}
    blend = next(m for m in safety if m["status_name"] == "blended")
    assert 0 < blend["lambda"] < 1
    assert blend["throttle_nom"] != blend["throttle_safe"]
    assert blend["h_m"] == blend["margin"]
    assert blend["h_m"] > 0
    assert blend["allowance_m"] > 0
    for topic, channel in CHANNELS.items():
        for message in topics.get(topic, ()):
            assert message.keys() <= json_schema(channel.struct)["properties"].keys()
    state = topics["/state"][0]
    assert state["attitude"] == topics["/pose"][0]["pose"]["orientation"]
    assert sum(value**2 for value in state["attitude"].values()) == pytest.approx(1, abs=1e-5)
    assert all(line["message"].endswith(" interventions") for line in topics["/log"])


def test_a_flight_without_a_filter_is_logged_with_its_distance():
    run = fly({"safety.filters": [], "rules.trials": 2, "rules.max_time_s": 0.3})
    safety = [m for m in topics_of(run)["/safety"] if m["trial"] == 0]
    assert {m["status_name"] for m in safety} == {"passed"}
    assert {m["lambda"] for m in safety} == {1.0}
    assert not any("h_m" in m or "margin" in m for m in safety)
    assert all(m["throttle_nom"] == m["throttle_safe"] for m in safety)
    assert safety[-1]["fence_distance_m"] > 0


def test_a_silent_pilot_has_no_command_in_the_log():
    run = fly({"mission.pilot.kind": "silent", "mission.pilot.silent_after_s": 0.2, "rules.trials": 1})
    assert run.trials[0].fence.no_pilot_steps > 0
    flight = run.flights[0]
    silent = flight.of_filters("fence_status")[:, 0] == 3
    assert silent.any()
    assert (np.frombuffer(flight.status, np.uint8)[silent] == FilterStatus.BACKUP).all()
    assert np.isnan(flight.rows("sticks")[silent]).all()
    messages = [m for m in topics_of(run)["/safety"] if m["status_name"] == "no-pilot"]
    assert len(messages) == silent.sum()
    assert not any("throttle_nom" in m for m in messages)


@given(st.integers(2, 400), st.floats(20, 400), st.sampled_from([1, 3]))
def test_samples_hold_the_least_distance_since_the_one_before(ticks, rate_hz, filter_ticks):
    rng = np.random.default_rng(ticks)
    rows = -(-ticks // filter_ticks)
    log = {
        "figure": rng.normal(size=(rows, 5)),
        "distance": rng.normal(size=rows),
        "status": rng.integers(0, 6, rows).astype(np.uint8),
    }
    shapes = {"state": 12, "estimate": 12, "nominal": 3, "command": 11, "sticks": 4, "margin": 1}
    flown = {name: rng.normal(size=(ticks + (name == "state"), size)) for name, size in shapes.items()}
    flown |= {"obstacle": np.empty((ticks, 0, 3)), "track": np.empty((ticks, 0, 3)), "fence": log}
    flown |= {"status": np.zeros((ticks, 1), np.uint8), "flags": np.zeros((ticks, 1), np.uint8)}
    more = {"u_nominal": 4, "a_command": 3, "rotor_thrust": 4, "gate_m": 1}
    flown |= {name: np.zeros((ticks, size)) for name, size in more.items()}
    flown |= {name: np.zeros((ticks, 1), int) for name in ("active", "candidates", "rows", "iterations")}
    flown |= {"a_error": np.zeros(ticks), "mark": np.zeros(ticks, np.uint8)}
    flight = WorldFlight.of(3, flown, 0.0025, rate_hz, filter_ticks)
    sample = np.frombuffer(flight.tick, np.int64)
    assert sample[0] == 0
    assert sample[-1] == ticks  # the end of the flight
    held = np.minimum(sample, ticks - 1)
    at = held // filter_ticks
    begins = np.append(0, at[:-1])
    expected = [log["distance"][a : b + 1].min() for a, b in zip(begins, at, strict=True)]
    np.testing.assert_array_equal(flight.rows("distance")[:, 0], expected)
    np.testing.assert_array_equal(flight.rows("figure"), log["figure"][at])
    np.testing.assert_array_equal(flight.of_filters("fence_status")[:, 0], log["status"][at])
    np.testing.assert_array_equal(flight.rows("sticks"), flown["sticks"][held])


def test_times_are_told_of_every_tick(room):
    said = world_timing(room)
    assert said["filter_calls"] == said["ticks"] == 6000
    assert 1e-7 < said["filter_p50_s"] <= said["filter_p99_s"] <= said["filter_max_s"] <= said["tick_max_s"]
    assert said["filter_total_s"] == pytest.approx(said["filter_mean_s"] * 6000)
    assert "filter_calls" not in world_timing(fly({"safety.filters": [], "rules.trials": 1}))
