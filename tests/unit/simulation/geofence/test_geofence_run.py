"""Runs in a fence: kept samples, times, logs, the drawing of the fence."""

import io
import pickle

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from alula import _core
from alula.schemas.errors import UsageError
from alula.schemas.geofence import FenceScenario, GeofenceParameters
from alula.schemas.vehicle import read_vehicle
from alula.stages.runlog.geofence import write_fence_log
from alula.stages.runlog.maps import SHOWN_BEYOND_M, fence_shell
from alula.stages.runlog.schemas import FENCE_CHANNELS, SCHEMAS
from alula.stages.simulation.chunks import TrialJournal
from alula.stages.simulation.geofence import simulate as stage
from alula.stages.simulation.geofence.flights import fly_trials
from alula.stages.simulation.geofence.simulate import FlownChunk, Times, fly_in_fence, worst_trial
from alula.stages.simulation.geofence.summary import fence_guarantee, fence_summary, fence_timing
from alula.stages.simulation.geofence.world import native_world
from alula.stages.simulation.result import FenceFlight
from alula.stages.vehicles.fence import fence_faces
from alula.stages.vehicles.racer import racer_model
from support.paths import VEHICLES

RACER = read_vehicle(VEHICLES / "racer7.toml")
ROOM = {
    "fence": {"box_m": [-20, -20, 0.5, 20, 20, 40]},
    "vehicle": {"file": "racer7.toml"},
    "pilot": {"kind": "aggressive"},
    "trials": {"count": 10, "seed": 5, "start_box_m": [-15, -15, 3, 15, 15, 35]},
    "run": {"duration_s": 1.5, "traces": 2, "log_rate_hz": 50},
}


def scenario(**tables):
    merged = {key: ROOM.get(key, {}) | tables.get(key, {}) for key in ROOM.keys() | tables.keys()}
    return msgspec.convert(merged, FenceScenario)


@pytest.fixture(scope="module")
def room():
    return fly_in_fence(scenario(), RACER, jobs=2)


def test_the_parameters_of_a_file_are_those_of_the_onboard_code():
    fence = _core.Fence(box=((-1.0, -1, -1), (1.0, 1, 1)))
    onboard = _core.Geofence(fence, racer_model(RACER)).parameters
    written = msgspec.structs.asdict(GeofenceParameters())
    assert onboard.keys() - written.keys() == {"radius_m"}
    assert written.keys() - onboard.keys() == {"alpha"}
    for key in onboard.keys() & written.keys():
        assert np.float32(written[key]) == np.float32(onboard[key]), key


def test_a_motion_that_diverges_is_no_flight():
    for drag in (1e4, 1e300):
        with pytest.raises(UsageError, match=r"vehicle.*diverges"):
            fly_in_fence(scenario(vehicle={"linear_drag_n_s_m": (drag,) * 3}), RACER, jobs=1)


def test_trials_are_those_of_the_native_flights(room):
    world = native_world(scenario(), RACER, None)
    logs = fly_trials(world.spec, world.filter, seed=5, count=10)
    assert [t.map_clearance_m for t in room.trials] == [log["min_distance_m"] for log in logs]
    assert [t.fence.interventions for t in room.trials] == [log["interventions"] for log in logs]
    assert all(t.steps == 600 for t in room.trials)
    for trial, log in zip(room.trials, logs, strict=True):
        fence = trial.fence
        assert trial.duration_s == pytest.approx(1.5)
        assert fence.passed_steps + fence.blended_steps + fence.backup_steps == trial.steps
        assert trial.filtered_steps == trial.steps - log["passed"]


def test_path_and_jerk_are_those_of_the_states():
    world = native_world(scenario(), RACER, None)
    log = fly_trials(world.spec, world.filter, seed=5, keeps_ticks=True)[0]
    states = log["state"]
    length = np.linalg.norm(np.diff(states[:, :3], axis=0), axis=1).sum()
    assert log["path_length_m"] == pytest.approx(length, rel=5e-3)
    jerk = (
        np.linalg.norm(np.diff(states[:, 3:6], n=2, axis=0), axis=1) / world.filter.parameters["tick_s"] ** 2
    )
    assert log["mean_jerk_m_s3"] == pytest.approx(jerk.mean(), rel=1e-9)
    assert log["max_jerk_m_s3"] == pytest.approx(jerk.max(), rel=1e-9)
    box = scenario().fence.box_m
    room = np.minimum(states[:, :3] - box[:3], np.array(box[3:]) - states[:, :3]).min(axis=1) - 0.25
    assert log["distance"] == pytest.approx(
        room, abs=0.02
    )  # of the chord that ends there: less by its length
    assert (log["distance"] <= room + 1e-9).all()


def test_the_first_flights_and_the_worst_are_shown(room):
    worst = worst_trial(room.trials)
    assert worst.map_clearance_m == min(trial.map_clearance_m for trial in room.trials)
    assert [flight.trial for flight in room.flights] == [0, 1, worst.index]
    assert worst.index >= 2  # else nothing is flown again
    again = room.flights[-1]
    assert again.rows("distance").min() == pytest.approx(worst.map_clearance_m, abs=5e-3)
    alone = fly_in_fence(scenario(run={"traces": 0}), RACER, jobs=1)
    assert [flight.trial for flight in alone.flights] == [worst.index]
    assert alone.flights[0] == again
    assert alone.trials == room.trials
    whole = fly_in_fence(scenario(run={"traces": 10}), RACER)
    assert [flight.trial for flight in whole.flights] == list(range(10))
    assert whole.flights[worst.index] == again


def test_flights_that_cannot_differ_are_flown_once():
    fixed = {"trials": {"count": 3, "start_m": [0, 0, 10]}, "pilot": {"kind": "straight"}}
    with pytest.raises(UsageError, match="all 3 flights would be the same"):
        fly_in_fence(scenario(**fixed), RACER)
    once = fixed | {"trials": {"count": 1, "start_m": [0, 0, 10]}}
    assert len(fly_in_fence(scenario(**once), RACER).trials) == 1
    gusty = fixed | {"vehicle": {"linear_drag_n_s_m": [0.1, 0.1, 0.1], "gust_m_s": [1, 1, 1]}}
    ends = [trial.goal_m for trial in fly_in_fence(scenario(**gusty), RACER).trials]
    assert ends[0] != ends[1] != ends[2]


def test_no_more_than_one_chunk_of_traces_is_flown_at_once(monkeypatch):
    asked = []
    flies = stage.fly_trials

    def counted(*args, **how):
        asked.append((how["keeps_ticks"], how["count"]))
        return flies(*args, **how)

    monkeypatch.setattr(stage, "fly_trials", counted)
    run = fly_in_fence(scenario(trials={"count": 30}, run={"duration_s": 0.1}), RACER, jobs=1)
    assert sum(count for traced, count in asked if traced) == len(run.flights) <= 3
    assert sum(count for _, count in asked) == 31 - (worst_trial(run.trials).index < 2)
    assert max(count for _, count in asked) <= stage.CHUNK


def log_of(run, scene):
    from alula.schemas.manifest import producer
    from alula.schemas.provenance import Provenance
    from alula.schemas.run import RunRecord

    summary = fence_summary(scene, run)
    made = Provenance(
        schema="alula/run",
        version="1.0",
        producer=producer(),
        parameters={},
        seed=0,
        inputs=[],
        summary=summary,
    )
    record = RunRecord(
        schema="alula/run", version="1.0", provenance=made, name="r", filter=scene.filter.name, vehicle="v",
        trials=run.trials, summary=summary, guarantee=fence_guarantee(scene, run),
    )  # fmt: skip
    out = io.BytesIO()
    write_fence_log(
        out,
        record,
        run.flights,
        run.world.faces,
        run.world.hulls,
        "world",
        tick_s=scene.filter.parameters.tick_s,
    )
    return out.getvalue()


def test_results_do_not_depend_on_jobs_or_on_what_a_journal_brings(room):
    serial = fly_in_fence(scenario(), RACER, jobs=1)
    assert serial.trials == room.trials
    assert log_of(serial, scenario()) == log_of(room, scenario())
    journal = TrialJournal(FlownChunk)
    seen = []
    fly_in_fence(scenario(), RACER, journal=journal, progress=lambda done, total: seen.append((done, total)))
    assert seen == [(4, 10), (8, 10), (10, 10)]
    del journal.chunks[4]
    taken = TrialJournal(FlownChunk, journal.snapshot())
    assert len(taken) == 6
    resumed = fly_in_fence(scenario(), RACER, journal=taken)
    assert log_of(resumed, scenario()) == log_of(room, scenario())
    assert resumed.times.calls == 6000
    with pytest.raises(ValueError):
        TrialJournal(FlownChunk, b"\x00\x01")


def test_the_log_says_what_was_flown(room):
    from mcap.reader import make_reader

    topics = {}
    for _, channel, message in make_reader(io.BytesIO(log_of(room, scenario()))).iter_messages():
        topics.setdefault(channel.topic, []).append(msgspec.json.decode(message.data))
    assert topics.keys() == {"/map", "/path", "/pose", "/state", "/safety", "/log"}
    assert [entity["id"] for entity in topics["/map"][0]["entities"]] == ["fence"]
    safety = [m for m in topics["/safety"] if m["trial"] == 0]
    assert len(safety) == len(room.flights[0].status) == 76
    shares = room.flights[0].rows("figure")[:, 0]
    assert [m["lambda"] for m in safety] == pytest.approx(shares, abs=1e-6)
    blend = next(m for m in safety if m["status_name"] == "blended")
    assert 0 < blend["lambda"] < 1
    assert blend["throttle_nom"] != blend["throttle_safe"]
    assert blend["h_m"] > 0
    assert blend["allowance_m"] > 0
    for topic, schema in FENCE_CHANNELS.items():
        for message in topics[topic]:
            assert message.keys() <= SCHEMAS[schema]["properties"].keys()
    state = topics["/state"][0]
    assert state["attitude"] == topics["/pose"][0]["pose"]["orientation"]
    assert sum(value**2 for value in state["attitude"].values()) == pytest.approx(1, abs=1e-5)


def test_a_chunk_can_be_sent_elsewhere():
    scene = scenario(trials={"count": 3})
    chunk = stage._Chunk(scene, RACER, None, 0, 3)
    there = stage.fly_chunk(pickle.loads(pickle.dumps(chunk)))
    here = stage.fly_chunk(chunk, native_world(scene, RACER, None))
    assert (there.trials, there.flights) == (here.trials, here.flights)


def test_long_flights_are_flown_one_by_one():
    assert stage._chunk_size(scenario(run={"duration_s": 600})) == 1
    assert stage._chunk_size(scenario(run={"duration_s": 20})) == 2
    assert stage._chunk_size(scenario()) == stage.CHUNK


def test_a_silent_pilot_has_no_command_in_the_log():
    scene = scenario(pilot={"kind": "silent", "silent_after_s": 0.2}, trials={"count": 1})
    run = fly_in_fence(scene, RACER)
    text = log_of(run, scene)
    assert b"no-pilot" in text or run.trials[0].fence.no_pilot_steps > 0
    rows = run.flights[0]
    silent = np.frombuffer(rows.status, np.uint8) == 3
    assert silent.any()
    assert np.isnan(rows.rows("pilot")[silent]).all()


@given(st.lists(st.floats(1e-7, 1e-2), min_size=1, max_size=60), st.lists(st.floats(1e-7, 1e-2), max_size=60))
def test_quantiles_of_times_are_close_however_they_are_joined(a, b):
    seconds = np.array(a + b, np.float32)
    parts = [Times.of(np.array(part, np.float32), 0.0025) for part in (a, b)]
    times = Times.joined(parts)
    assert times.calls == len(seconds)
    assert times.max_s == float(seconds.max())
    assert times.overruns == int((seconds > 0.0025).sum())
    for share in (0.01, 0.5, 0.99, 1.0):
        exact = float(np.sort(seconds)[max(0, int(np.ceil(share * len(seconds))) - 1)])
        assert exact * (1 - 1e-6) <= times.quantile(share) <= exact * 1.0117


def test_times_are_told_of_every_tick(room):
    said = fence_timing(room.times)
    assert said["filter_calls"] == 6000
    assert 1e-7 < said["filter_p50_s"] <= said["filter_p99_s"] <= said["filter_max_s"]
    assert said["filter_total_s"] == pytest.approx(said["filter_mean_s"] * 6000)


def test_what_the_filter_does_not_know_makes_it_leave_and_is_said():
    heavy = scenario(vehicle={"mass_scale": 1.5}, trials={"count": 8}, run={"duration_s": 3})
    run = fly_in_fence(heavy, RACER)
    summary = fence_summary(heavy, run)
    assert summary["violations"] == sum(trial.outcome == "outside" for trial in run.trials) > 0
    assert summary["min_distance_m"] == run.trials[summary["worst_trial"]].map_clearance_m < 0
    said = fence_guarantee(heavy, run)
    assert "mass_scale 1.5" in said.statement
    assert said.claims["as_modelled"] is False
    careful = scenario(
        vehicle={"mass_scale": 1.5}, trials={"count": 8}, run={"duration_s": 3},
        filter={"parameters": {"reserve_m": 6.0}},
    )  # fmt: skip
    assert fence_summary(careful, fly_in_fence(careful, RACER))["violations"] == 0


def test_notes_say_when_nothing_is_promised():
    out = {"stale_from_s": 0.2, "traces": 0, "duration_s": 1}
    gone = scenario(run=out, trials={"count": 2})
    notes = fence_summary(gone, fly_in_fence(gone, RACER))["notes"]
    assert any("stale_limit_s" in note for note in notes)
    blind = scenario(run=out | {"stale_from_s": 0}, trials={"count": 1})
    assert any("refused" in note for note in fence_summary(blind, fly_in_fence(blind, RACER))["notes"])
    start = {"start_box_m": None, "start_m": [15, 0, 5], "start_velocity_m_s": [30, 0, 0], "count": 1}
    fast = scenario(trials=start, run={"duration_s": 0.5})
    run = fly_in_fence(fast, RACER)
    assert run.world.start_h_i_m < 0
    assert any("braking from there is not known" in note for note in fence_summary(fast, run)["notes"])


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        (
            {"trials": {"start_box_m": None, "start_m": [19.9, 0, 5]}},
            r"`\$\.trials\.start_m`: is 0\.15 m outside",
        ),
        (
            {"trials": {"start_box_m": [30, 0, 1, 31, 1, 2]}},
            r"`\$\.trials\.start_box_m`: no start in the box",
        ),
        ({"vehicle": {"wind_m_s": [1, 0, 0]}}, r"`\$\.vehicle`: wind and gusts act through drag"),
        ({"vehicle": {"radius_m": 200}}, r"`\$\.filter\.parameters`, or the model"),
    ],
)
def test_numbers_that_mean_nothing_together_name_their_key(tables, words):
    with pytest.raises(UsageError, match=words):
        fly_in_fence(scenario(**tables), RACER)


@given(st.integers(2, 400), st.floats(20, 400))
def test_samples_hold_the_least_distance_since_the_one_before(ticks, rate_hz):
    rng = np.random.default_rng(ticks)
    flown = {
        "state": rng.normal(size=(ticks, 13)), "pilot": rng.normal(size=(ticks, 4)),
        "command": rng.normal(size=(ticks, 4)), "figure": rng.normal(size=(ticks, 5)),
        "distance": rng.normal(size=ticks), "status": np.zeros(ticks, np.uint8),
    }  # fmt: skip
    flight = FenceFlight.of(3, flown, 0.0025, rate_hz)
    sample = np.frombuffer(flight.tick, np.int64)
    assert sample[0] == 0
    assert sample[-1] == ticks - 1
    begins = np.append(0, sample[:-1])
    expected = [flown["distance"][a : b + 1].min() for a, b in zip(begins, sample, strict=True)]
    np.testing.assert_array_equal(flight.rows("distance"), expected)
    np.testing.assert_array_equal(flight.rows("state"), flown["state"][sample])


def volume(corners, triangles):
    a, b, c = (corners[triangles[:, i]] for i in range(3))
    return np.einsum("ij,ij->i", np.cross(a, b), c).sum() / 6


def test_a_box_is_drawn_whole_and_cut_by_faces():
    box = (-1, -2, -3, 4, 5, 6)
    corners, triangles = fence_shell(fence_faces(box, ()), [])
    assert len(corners) == 8
    assert len(triangles) == 12
    assert volume(corners, triangles) == pytest.approx(5 * 7 * 9)  # turned outwards
    corners, triangles = fence_shell(fence_faces(box, [(2, 0, 0, 4)]), [np.zeros((1, 3))])
    assert corners[:, 0].max() == pytest.approx(2)
    assert volume(corners, triangles) == pytest.approx(3 * 7 * 9)


def test_an_open_fence_is_drawn_near_the_paths_without_walls_that_are_not_there():
    path = np.array([[0.0, 0, 0], [10, 0, 5]])
    corners, triangles = fence_shell(fence_faces(None, [(1, 0, 0, 12), (0, 0, -1, 3)]), [path])
    center = corners[triangles].mean(axis=1)
    assert ((np.abs(center[:, 0] - 12) < 1e-6) | (np.abs(center[:, 2] + 3) < 1e-6)).all()
    assert np.ptp(corners[:, 1]) == pytest.approx(2 * SHOWN_BEYOND_M)
    nothing = fence_shell(fence_faces((0, 0, 0, 1, 1, 1), [(1, 0, 0, -1)]), [path])
    assert [len(part) for part in nothing] == [0, 0]
