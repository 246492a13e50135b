"""Runs by a pilot in a fence: stored verdicts on the flights of an earlier stage."""

from typing import NamedTuple

import msgspec
import pytest

from alula.schemas.scenarios.scenario import read_scenario
from alula.stages.simulation.prepare import prepare
from alula.stages.verdict import FENCED, clearance_of
from support.flights.piloted_runs import RACER, TICK_S
from support.paths import EXAMPLES
from support.scenes.small_scenes import box_cover

EXAMPLE = EXAMPLES / "geofencing"

# Values stored from the stage that flew those scenarios alone; its tick was TICK_S.

OTHERS = {
    "vehicle.mass_scale": 1.2,
    "vehicle.thrust_scale": 0.85,
    "vehicle.rate_gain_scale": 0.7,
    "estimation.delay_s": 0.02,
    "safety.geofence.latency_s": 0.02,
    "safety.geofence.reserve_m": 1.0,
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
def test_flights_are_those_that_an_earlier_stage_flew(stored):
    has_cover = stored.file == "combined.toml"
    changes = {
        "safety.filters": [stored.filter] if stored.filter else [],
        "rules.max_time_s": 2.0 if has_cover else 4.0,
        "rules.trials": stored.trial + 1,
        "rules.seed": 3,
        "rules.dt_s": TICK_S,
    }
    read = read_scenario(EXAMPLE / stored.file, changes | stored.changes)
    ready = prepare(read, RACER, cover=box_cover(BLOCKS) if has_cover else None)
    (log,) = ready.fly(stored.trial, 1)
    trial = ready.judged(stored.trial, log)
    # The radius of that stage was rounded to single precision.
    assert clearance_of(trial, *FENCED) == pytest.approx(stored.distance_m, rel=1e-9, abs=1e-8)
    assert trial.max_speed_m_s == pytest.approx(stored.speed_m_s, rel=1e-9)
    assert trial.start_m == pytest.approx(stored.start_m, rel=1e-12)
    assert trial.goal_m == pytest.approx(stored.end_m, rel=1e-9)
    found = list(msgspec.structs.asdict(trial.fence).values())
    assert tuple(found[:9]) == stored.counts
    for value, expected in zip(found[9:], stored.figures, strict=True):
        assert value == (None if expected is None else pytest.approx(expected, rel=1e-6))
    assert (trial.outcome, trial.collision) == ("held", stored.distance_m < 0)
