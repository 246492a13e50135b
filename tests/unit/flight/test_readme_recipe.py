"""README.md's lines plan and fly with their own defaults, in lock-step with the simulated autopilot."""

import shlex

import numpy as np
import pytest

from alula.cli.main import run
from alula.schemas.artifacts.artifact import read_artifact
from alula.stages.flight.loop.supervisor import Event
from alula.stages.planning.adherence import outcome_of_plan
from support.files.doc_files import DocFiles
from support.paths import ROOT
from support.vehicles.lockstep import Flight

if not (ROOT / "README.md").is_file():
    pytest.skip("not a checkout", allow_module_level=True)


def line_of(begin):
    """Words of the first command line of README.md that begins so, without `alula`."""
    lines = (ROOT / "README.md").read_text().splitlines()
    return shlex.split(next(line for line in lines if line.startswith(begin)), comments=True)[1:]


def missions_of(monkeypatch):
    """Missions that `alula fly` would fly; it flies none."""
    found = []
    monkeypatch.setattr("alula.cli.verbs.fly.flight.fly", lambda mission, *_: found.append(mission))
    return found


def outcome_of(flight):
    """Outcome of a flight in its record."""
    flown = [each for each in flight.recorder.samples if each.safety is not None]
    places = np.array([each.state.position_m.tuple for each in flown])
    times = np.array([each.supervisor.time_s for each in flown])
    followed = flight.made.along.result(places, times, [])
    return outcome_of_plan("reached" if flight.cause is Event.PLAN_FINISHED else "stopped", followed)


@pytest.fixture(scope="module")
def garden(tmp_path_factory):
    return DocFiles(tmp_path_factory.mktemp("garden"))


def test_the_recipe_of_the_readme_flies_to_its_goal_as_planned(garden, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    garden.put("garden.cover.npz", tmp_path / "garden.cover.npz", "garden")
    assert run(line_of("alula plan garden.cover.npz -o")) == 0
    missions = missions_of(monkeypatch)
    assert run(line_of("alula fly garden.plan.npz")) == 0
    flight = Flight(missions[0], parameters={"LAND_SPEED": 50.0}).fly()
    assert outcome_of(flight) == "reached"
    flight.judge()
    parameters = read_artifact(tmp_path / "garden.plan.npz").manifest.parameters
    assert (parameters["interface"], missions[0].config.filter) == ("velocity", "polytope-cbf")
