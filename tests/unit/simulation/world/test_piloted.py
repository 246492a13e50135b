"""Runs by a pilot in a fence: verdicts, also of scenarios of version 1.0, samples, times, logs, notes."""

import io
import math
from typing import NamedTuple

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from alula import _core
from alula.schemas.errors import UsageError
from alula.schemas.filter_options import GeofenceParameters
from alula.schemas.manifest import producer
from alula.schemas.provenance import Provenance
from alula.schemas.run import RunRecord
from alula.schemas.vehicle import read_vehicle
from alula.schemas.world import decoded, read_world
from alula.stages.filtering.protocol import FilterStatus
from alula.stages.runlog.schemas import FLIGHT_CHANNELS, SCHEMAS
from alula.stages.runlog.world import write_world_log
from alula.stages.simulation.chunks import TrialJournal
from alula.stages.simulation.result import WorldFlight
from alula.stages.simulation.world import simulate as stage
from alula.stages.simulation.world.chunks import FlownChunk
from alula.stages.simulation.world.judge import worst_clearance
from alula.stages.simulation.world.piloted import fence_distance
from alula.stages.simulation.world.prepare import prepare
from alula.stages.simulation.world.simulate import chunk_size, simulate_world
from alula.stages.simulation.world.summary import world_guarantee, world_summary, world_timing
from alula.stages.vehicles.racer import racer_model
from support.fence_flights import STATUSES, fly_in
from support.paths import ROOT, VEHICLES
from support.small_scenes import ball_scene, box_cover

RACER = read_vehicle(VEHICLES / "racer7.toml")
EXAMPLE = ROOT / "examples" / "geofencing"
TICK_S = float(np.float32(0.0025))  # as the native filter has it
BOX, STARTS = (-20, -20, 0.5, 20, 20, 40), (-15, -15, 3, 15, 15, 35)
ROOM = {
    "schema": "alula/scenario",
    "version": "2.0",
    "vehicle": {"type": "racer7"},
    "world": {"fence": {"box_m": BOX}},
    "mission": {
        "kind": "pilot",
        "start_box_m": STARTS,
        "start_speed_m_s": 10.0,
        "start_tilt_deg": 57.3,
        "pilot": {"kind": "aggressive"},
    },
    "safety": {"filters": ["geofence"]},
    "rules": {
        "dt_s": 0.0025,
        "plant_steps": 4,
        "max_time_s": 1.5,
        "trials": 10,
        "seed": 5,
        "logged": 2,
        "log_rate_hz": 50,
    },
}


def scenario(changes=None, start=None):
    """The room with other values by their paths, and with a given start instead of random ones."""
    tree = msgspec.msgpack.decode(msgspec.msgpack.encode(ROOM))
    for path, value in (changes or {}).items():
        *tables, key = path.split(".")
        at = tree
        for table in tables:
            at = at.setdefault(table, {})
        at[key] = value
    if start is not None:
        for key in ("start_box_m", "start_speed_m_s", "start_tilt_deg"):
            del tree["mission"][key]
        tree["mission"] |= start
    return decoded(tree, "test")


def fly(changes=None, start=None, jobs=1, **how):
    return simulate_world(scenario(changes, start), RACER, jobs=jobs, **how)


@pytest.fixture(scope="module")
def room():
    return fly(jobs=2)


# Values stored from the stage that flew scenarios of version 1.0 alone; its tick was TICK_S.


OTHERS = {
    "vehicle.mass_scale": 1.2,
    "vehicle.thrust_scale": 0.85,
    "vehicle.rate_gain_scale": 0.7,
    "estimation.delay_s": 0.02,
    "safety.backup-qp.latency_s": 0.02,
    "safety.backup-qp.reserve_m": 1.0,
}
GUSTS = {
    "vehicle.disturbance.quadratic_drag_n_s2_m2": [0.012, 0.012, 0.02],
    "vehicle.disturbance.wind_m_s": [8, 0, 0],
    "vehicle.disturbance.gust_m_s": [2, 2, 1],
}
RADIO = {"mission.pilot.radio_from_s": 0.5, "mission.pilot.radio_for_s": 0.5}
BLIND = {"estimation.lost_from_s": 0.4, "estimation.lost_for_s": 0.2}
SILENT = {"mission.pilot.kind": "silent", "mission.pilot.silent_after_s": 0.2}


class Stored(NamedTuple):
    """A flight of an example's scenario: distance, speed, first and last position, FenceResult's fields."""

    file: str
    filter: str | None
    changes: dict[str, object]
    trial: int
    distance_m: float
    speed_m_s: float
    start_m: tuple[float, ...]
    end_m: tuple[float, ...]
    counts: tuple[int, ...]
    figures: tuple[float | None, ...]


STORED = [
    Stored(
        "wall.toml",
        "geofence",
        {},
        0,
        0.04113585714493456,
        30.30111100895708,
        (-40.0, 0.0, 130.0),
        (-0.3013085874886121, 0.0, 129.35062102062795),
        (88, 1512, 0, 0, 0, 0, 1, 0, 0),
        (0.0, 0.009837031364440918, 0.027259916067123413, 22.563110413776013, 0.0564062681648147),
    ),
    Stored(
        "wall.toml",
        "backup-qp",
        OTHERS,
        0,
        1.3455281354350976,
        25.398227126534586,
        (-40.0, 0.0, 130.0),
        (-1.5955281354350976, 0.0, 105.57069034761702),
        (317, 1017, 266, 0, 0, 0, 4, 0, 0),
        (0.3474999922327697, 0.0, 0.30224117636680603, 34.57664480212876, None),
    ),
    Stored(
        "fall.toml",
        None,
        BLIND,
        0,
        -9.229996491671141,
        39.23999912291633,
        (0.0, 0.0, 70.0),
        (0.0, 0.0, -8.479996491671141),
        (1520, 0, 0, 0, 0, 80, 0, 0, 0),
        (0.0, 1.0, None, None, None),
    ),
    Stored(
        "box.toml",
        "geofence",
        RADIO,
        2,
        0.07078186634286254,
        6.203152892812737,
        (-34.647848774911836, 0.8337288640905172, 12.77571635087952),
        (-38.8818151414105, 2.0243344240439245, 20.22676867934701),
        (0, 1400, 0, 200, 0, 0, 1, 0, 0),
        (0.0, 0.056338369846343994, 0.03865840658545494, 4.42943089301361, None),
    ),
    Stored(
        "box.toml",
        "backup-qp",
        GUSTS,
        2,
        0.5193436346943585,
        18.070033504594562,
        (-34.647848774911836, 0.8337288640905172, 12.77571635087952),
        (-37.68257043355824, -4.415334907842128, 15.729587904682436),
        (382, 1218, 0, 0, 0, 0, 2, 0, 0),
        (0.0, 0.0, 0.06271319836378098, 5.052594064129735, None),
    ),
    Stored(
        "faces.toml",
        "geofence",
        {"mission.pilot.kind": "sticks"},
        2,
        0.2748411255499419,
        23.03571541463075,
        (-24.74846341065131, 0.5955206172075123, 9.01582544669509),
        (-9.684658494329563, -3.4338657128247285, 1.4031202954578144),
        (0, 1588, 12, 0, 0, 0, 1, 0, 0),
        (0.01749999960884452, 0.0, -0.842064380645752, 7.719439086863693, None),
    ),
    Stored(
        "engaged.toml",
        "geofence",
        SILENT,
        2,
        16.129945452092215,
        6.347070538025662,
        (-9.899385364260525, 0.2382082468830049, 16.879945452092215),
        (-13.962102280167727, 2.4858792198211304, 17.90469146872248),
        (102, 50, 0, 1448, 0, 0, 0, 0, 0),
        (0.0, 0.9999873042106628, 16.120426177978516, None, None),
    ),
    Stored(
        "combined.toml",
        "geofence",
        GUSTS,
        2,
        0.1363353335901012,
        1.8525102969368843,
        (0.33722741522360594, 3.0643162266584114, 0.7759890904184431),
        (0.993889209581209, 3.6946243028779726, 2.2661383229521994),
        (0, 800, 0, 0, 0, 0, 1, 0, 0),
        (0.0, 0.1774185299873352, 0.1302051693201065, 0.13722740926314148, 0.13722740926314148),
    ),
]
BLOCKS = (((30, 20, 0), (40, 30, 28)), ((55, 5, 0), (60, 20, 28)), ((-20, -20, -3), (100, 80, 0)))


@pytest.mark.parametrize("stored", STORED, ids=lambda row: f"{row.file}-{row.filter}")
def test_flights_are_those_that_scenarios_of_version_1_had(stored):
    has_cover = stored.file == "combined.toml"
    changes = {
        "safety.filters": [stored.filter] if stored.filter else [],
        "rules.max_time_s": 2.0 if has_cover else 4.0,
        "rules.trials": stored.trial + 1,
        "rules.seed": 3,
        "rules.dt_s": TICK_S,
    }
    read = read_world(EXAMPLE / stored.file, changes | stored.changes)
    ready = prepare(read, RACER, cover=box_cover(BLOCKS) if has_cover else None)
    (log,) = ready.fly(stored.trial, 1)
    trial = ready.judged(stored.trial, log)
    # The radius of that stage was rounded to single precision.
    assert fence_distance(trial) == pytest.approx(stored.distance_m, rel=1e-9, abs=1e-8)
    assert trial.max_speed_m_s == pytest.approx(stored.speed_m_s, rel=1e-9)
    assert trial.start_m == pytest.approx(stored.start_m, rel=1e-12)
    assert trial.goal_m == pytest.approx(stored.end_m, rel=1e-9)
    found = list(msgspec.structs.asdict(trial.fence).values())
    assert tuple(found[:9]) == stored.counts
    for value, expected in zip(found[9:], stored.figures, strict=True):
        assert value == (None if expected is None else pytest.approx(expected, rel=1e-6))
    assert (trial.outcome, trial.collision) == ("held", stored.distance_m < 0)


# Verdicts.


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
            fly({"vehicle.disturbance.linear_drag_n_s_m": (drag,) * 3})


@pytest.mark.parametrize("rule", ["geofence", "backup-qp", "none"])
def test_trials_are_those_of_native_flights_made_by_hand(rule):
    where = _core.Fence(box=(BOX[:3], BOX[3:]))
    geofence = _core.Geofence(where, racer_model(RACER), {"radius_m": RACER.body.radius_m})
    logs = fly_in(
        geofence,
        starts=(STARTS[:3], STARTS[3:]),
        tilt_rad=math.radians(57.3),
        pilot=_core.Pilot("aggressive"),
        model=racer_model(RACER),
        rule=rule,
        duration_s=1.5,
        seed=5,
        count=10,
    )
    names = [] if rule == "none" else [rule]
    run = fly({"rules.dt_s": TICK_S, "safety.filters": names})
    assert [t.fence_clearance_m for t in run.trials] == [log["min_distance_m"] for log in logs]
    assert [t.fence.interventions for t in run.trials] == [log["interventions"] for log in logs]
    assert all(t.steps == 600 for t in run.trials)
    for trial, log in zip(run.trials, logs, strict=True):
        fence = trial.fence
        assert trial.start_m == log["start"][:3].tolist()
        assert trial.goal_m == log["last"][:3].tolist()
        assert trial.duration_s == pytest.approx(1.5)
        assert fence.passed_steps + fence.blended_steps + fence.backup_steps == trial.steps
        assert trial.filtered_steps == (trial.steps - log["passed"] if names else 0)
        assert trial.path_length_m == pytest.approx(log["path_length_m"], rel=1e-12)
        assert [one.name for one in trial.filters or []] == names


def test_path_jerk_and_distance_are_those_of_the_states():
    ready = prepare(scenario(), RACER)
    (log,) = ready.fly(0, 1)
    trial, states = ready.judged(0, log), log["state"]
    length = np.linalg.norm(np.diff(states[:, :3], axis=0), axis=1).sum()
    assert trial.path_length_m == pytest.approx(length, rel=5e-3)
    jerk = np.linalg.norm(np.diff(states[:, 6:9], n=2, axis=0), axis=1) / 0.0025**2
    assert log["mean_jerk_m_s3"] == pytest.approx(trial.mean_jerk_m_s3, rel=1e-9)
    assert trial.mean_jerk_m_s3 == pytest.approx(jerk.mean(), rel=1e-9)
    assert trial.max_jerk_m_s3 == pytest.approx(jerk.max(), rel=1e-9)
    inside = np.minimum(states[:-1, :3] - BOX[:3], np.array(BOX[3:]) - states[:-1, :3]).min(axis=1) - 0.25
    distance = log["fence"]["distance"]
    assert distance == pytest.approx(inside, abs=0.02)  # of the chord that ends there: less by its length
    assert (distance <= inside + 1e-9).all()


def test_the_fence_of_a_pilot_without_a_filter_has_faces_and_hulls():
    cover = box_cover([((-20, -20, 0), (20, 20, 20))])  # 2 m below the start
    start = {"start_m": (0.0, 0.0, 4.0)}
    fall = {
        "safety.filters": [],
        "mission.pilot.kind": "fall",
        "world.cover": "x",
        "rules.trials": 1,
        "rules.max_time_s": 0.5,
    }
    run = fly(fall, start, cover=cover)
    (trial,) = run.trials
    height = 0.5 * 9.81 * 0.5**2  # of free fall
    assert trial.map_clearance_m == pytest.approx(2 - height - 0.25, abs=1e-3)
    assert trial.fence_clearance_m == pytest.approx(3.5 - height - 0.25, abs=1e-3)
    found = world_summary(run)["fence"]
    assert found["min_distance_m"] == trial.map_clearance_m
    assert (found["passed"], found["min_h_i_m"]) == (200, None)
    assert found["start_h_i_m"] > 0


def test_a_pilot_elsewhere_has_no_figures_of_a_fence():
    nowhere = {"world": {}, "rules.trials": 1, "rules.max_time_s": 0.1, "safety.filters": []}
    run = fly(nowhere)
    assert run.trials[0].fence is None
    assert "fence" not in world_summary(run)
    by_rates = fly({"vehicle.interface": "body-rates", "rules.trials": 1, "rules.max_time_s": 0.1})
    assert by_rates.trials[0].fence is None
    assert by_rates.trials[0].fence_clearance_m > 0


def test_random_starts_are_clear_of_what_is_no_part_of_the_fence():
    ball = ball_scene(np.array([[0.0, 0.0, 19.0]]), 14.0)  # most of the box of starts
    few = {"safety.filters": [], "world.scene": "x", "rules.trials": 12, "rules.max_time_s": 0.05}
    run = fly(few, scene=ball)
    free = fly({key: value for key, value in few.items() if key != "world.scene"})
    apart = np.linalg.norm(np.array([t.start_m for t in run.trials]) - (0, 0, 19.0), axis=1)
    assert apart.min() >= 14.25 - 1e-6
    before = np.linalg.norm(np.array([t.start_m for t in free.trials]) - (0, 0, 19.0), axis=1)
    kept = before > 14.5
    assert 0 < kept.sum() < 12
    same = [a.start_m == b.start_m for a, b in zip(run.trials, free.trials, strict=True)]
    assert np.array(same)[kept].all()
    with pytest.raises(UsageError, match=r"`\$\.mission\.start_box_m`: no start in the box is safe"):
        fly(few, scene=ball_scene(np.array([[0.0, 0.0, 19.0]]), 30.0))


# Runs of many trials.


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
    journal = TrialJournal(FlownChunk)
    seen = []
    fly(journal=journal, progress=lambda done, total: seen.append((done, total)))
    assert seen == [(4, 10), (8, 10), (10, 10)]
    del journal.chunks[4]
    taken = TrialJournal(FlownChunk, journal.snapshot())
    assert len(taken) == 6
    resumed = fly(journal=taken)
    assert log_of(resumed) == log_of(room)
    assert resumed.filter_times.calls == 6000
    with pytest.raises(ValueError):
        TrialJournal(FlownChunk, b"\x00\x01")


def topics_of(run):
    from mcap.reader import make_reader

    topics = {}
    for _, channel, message in make_reader(io.BytesIO(log_of(run))).iter_messages():
        topics.setdefault(channel.topic, []).append(msgspec.json.decode(message.data))
    return topics


def test_the_log_says_what_was_flown(room):
    topics = topics_of(room)
    assert topics.keys() == {"/map", "/path", "/pose", "/state", "/safety", "/log"}
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
    for topic, schema in FLIGHT_CHANNELS.items():
        for message in topics[topic]:
            assert message.keys() <= SCHEMAS[schema]["properties"].keys()
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


# Guarantees and notes.


HEAVY = {"vehicle.mass_scale": 1.5, "rules.trials": 8, "rules.max_time_s": 3.0}


def test_what_the_filter_does_not_know_makes_it_leave_and_is_said():
    run = fly(HEAVY)
    summary = world_summary(run)
    found = summary["fence"]
    assert found["violations"] == sum(trial.collision for trial in run.trials) > 0
    assert found["min_distance_m"] == run.trials[summary["worst_trial"]].fence_clearance_m < 0
    said = world_guarantee(run, None)
    assert "mass_scale 1.5" in said.statement
    assert "The vehicle differed from the filter's model" in said.statement
    assert said.claims["as_modelled"] is False
    assert said.claims["proven_by_filter"] is False
    careful = fly(HEAVY | {"safety.geofence.reserve_m": 6.0})
    assert world_summary(careful)["fence"]["violations"] == 0


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, None),
        ({"estimation.lost_from_s": 0.05}, None),  # the filter tells
        ({"vehicle.thrust_scale": 0.9}, "thrust_scale 0.9"),
        ({"vehicle.rate_gain_scale": 0.7}, "rate_gain_scale 0.7"),
        ({"estimation.delay_s": 0.02}, "delay_s 0.02"),
        ({"estimation.delay_s": 0.02, "safety.geofence.latency_s": 0.02}, None),
        ({"vehicle.disturbance.sag_share": 0.2}, "sag_share 0.2"),
        ({"vehicle.disturbance.linear_drag_n_s_m": (0.1, 0.1, 0.1)}, "drag"),
    ],
)
def test_the_guarantee_says_how_the_truth_differs_from_the_model(changes, words):
    said = world_guarantee(fly(changes | {"rules.trials": 1, "rules.max_time_s": 0.1}), None)
    assert said.claims["as_modelled"] is (words is None)
    assert said.statement.startswith("As long as the model is right, h_I > 0 at the start")
    assert ("differed" in said.statement) is (words is not None)
    assert words is None or words in said.statement


def test_notes_say_when_nothing_is_promised():
    lost = {"estimation.lost_from_s": 0.2, "rules.logged": 0, "rules.max_time_s": 1.0, "rules.trials": 2}
    assert any("stale_limit_s" in note for note in world_summary(fly(lost))["notes"])
    blind = lost | {"estimation.lost_from_s": 0.0, "rules.trials": 1}
    assert any("refused" in note for note in world_summary(fly(blind))["notes"])
    start = {"start_m": (15.0, 0.0, 5.0), "start_velocity_m_s": (30.0, 0.0, 0.0)}
    run = fly({"rules.max_time_s": 0.5, "rules.trials": 1}, start)
    assert run.start_h_i_m < 0
    summary = world_summary(run)
    assert summary["fence"]["start_h_i_m"] == run.start_h_i_m
    assert any("braking from there is not known" in note for note in summary["notes"])


@pytest.mark.parametrize(
    ("changes", "start", "words"),
    [
        (
            {},
            {"start_m": (19.9, 0.0, 5.0)},
            r"`\$\.mission\.start_m`: the start .* is 0\.15 m inside .* outside",
        ),
        (
            {"mission.start_box_m": (30, 0, 1, 31, 1, 2)},
            None,
            r"`\$\.mission\.start_box_m`: no start in the box",
        ),
        (
            {"vehicle.disturbance.wind_m_s": (1, 0, 0)},
            None,
            r"`\$\.vehicle.*`: wind and gusts act through drag",
        ),
        ({"vehicle.radius_m": 200.0}, None, r"`\$\.safety\.geofence`: "),
        ({"vehicle.radius_m": 200.0, "safety.filters": []}, None, r"`\$\.safety\.geofence`: "),
    ],
)
def test_numbers_that_mean_nothing_together_name_their_key(changes, start, words):
    with pytest.raises(UsageError, match=words):
        fly(changes | {"rules.trials": 1}, start)


def test_a_gain_that_is_too_high_matters_only_to_the_regulation_function():
    late = {"rules.trials": 1, "rules.max_time_s": 0.05}
    with pytest.raises(UsageError, match=r"beta = 1000 takes over too late"):
        fly(late | {"safety.geofence.beta": 1000.0})
    fly(late | {"safety.geofence.beta": 1000.0, "safety.filters": []})
    fly(late | {"safety.backup-qp.beta": 1000.0, "safety.filters": ["backup-qp"]})
