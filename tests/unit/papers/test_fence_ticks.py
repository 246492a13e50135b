"""Logged ticks of flights in a fence equal those of the native filter; the example's scenarios are valid."""

import numpy as np
import pytest

from alula import _core
from alula.cli.main import run
from alula.schemas.errors import DamagedError
from alula.schemas.log.run import read_run
from alula.schemas.scenarios.scenario import read_scenario
from alula.schemas.scenarios.vehicle import read_vehicle
from alula.stages.vehicles.racer import racer_model, racer_options
from papers.geofencing.ticks import read_ticks
from support.flights.fence_flights import STATUSES, fly_in
from support.paths import ROOT

EXAMPLE = ROOT / "examples" / "geofencing"
WRITTEN = 1e-6  # digits of a log
TICK_S = float(np.float32(0.0025))  # as the native filter has it


def test_ticks_are_those_that_were_flown(tmp_path):
    log = tmp_path / "wall.run.mcap"
    words = ["--set", "mission.pilot.radio_from_s=2.5", "--set", "mission.pilot.radio_for_s=0.2"]
    words += ["--set", "rules.max_time_s=3", "--set", f"rules.dt_s={TICK_S}"]
    assert run(["simulate", str(EXAMPLE / "wall.toml"), "-o", str(log), "-q", *words]) == 0
    ticks = read_ticks(log)[0]
    vehicle = read_vehicle(EXAMPLE / "../vehicles/racer7.toml")
    box = read_scenario(EXAMPLE / "wall.toml").world.fence.box_m
    parameters = {"radius_m": vehicle.body.radius_m}
    geofence = _core.Geofence(_core.Fence(box=(box[:3], box[3:])), racer_model(vehicle), parameters)
    (flown,) = fly_in(
        geofence,
        model=racer_model(vehicle),
        options=racer_options(vehicle),
        pilot=_core.Pilot("straight", tilt_rad=np.radians(72)),
        duration_s=3,
        losses=_core.Losses(radio_from_s=2.5, radio_for_s=0.2),
        start=np.array([-40.0, 0, 130, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0]),
        keeps_ticks=True,
    )
    np.testing.assert_allclose(ticks.time_s, 0.0025 * np.arange(1200), atol=1e-9)
    np.testing.assert_allclose(ticks.position, flown["racer"][:, :3], atol=WRITTEN)
    np.testing.assert_allclose(ticks.velocity, flown["racer"][:, 3:6], atol=WRITTEN)
    _, x, y, _ = flown["racer"][:, 6:10].T
    np.testing.assert_allclose(np.cos(ticks.tilt_rad), 1 - 2 * (x**2 + y**2), atol=4 * WRITTEN)
    assert ticks.status == tuple(STATUSES[i] for i in flown["status"])
    assert {"passed", "blended", "no-pilot"} <= set(ticks.status)
    asked = flown["status"] < 3
    np.testing.assert_allclose(ticks.regulation[asked], flown["figure"][asked, 0], atol=WRITTEN)
    throttle = np.stack([flown["sticks"][:, 0], flown["command"][:, 7]], axis=1)
    np.testing.assert_allclose(ticks.throttle, throttle, atol=WRITTEN)
    assert np.isnan(ticks.throttle[~asked, 0]).all()
    least = read_run(log).trials[0].fence_clearance_m
    assert ticks.distance_m.min() == pytest.approx(least, abs=2e-3)


def test_states_without_answers_are_damage(tmp_path, monkeypatch):
    log = tmp_path / "wall.run.mcap"
    words = ["--set", "rules.max_time_s=0.05"]
    assert run(["simulate", str(EXAMPLE / "wall.toml"), "-o", str(log), "-q", *words]) == 0
    monkeypatch.setattr("papers.geofencing.ticks.SAFETY_TOPIC", "/nothing")
    with pytest.raises(DamagedError, match="have different times"):
        read_ticks(log)


@pytest.mark.parametrize("path", sorted(EXAMPLE.glob("*.toml")), ids=lambda path: path.stem)
def test_scenarios_of_the_example_are_scenarios_in_a_fence(path):
    assert read_scenario(path).vehicle.file == "../vehicles/racer7.toml"
