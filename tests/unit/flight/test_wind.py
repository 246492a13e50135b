"""Wind on flights by body rates: estimated, countered, and a reason to hold where it is too strong."""

import numpy as np
import pytest

from alula.schemas.scenarios.vehicle import read_vehicle
from alula.stages.flight.loop.supervisor import Event, State
from support.flights.flights import PILLAR, mission
from support.paths import VEHICLES
from support.scenes.small_scenes import box_cover, line_plan
from support.vehicles.lockstep import Flight, Upset, blow

COPTER = read_vehicle(VEHICLES / "arducopter.toml")
START, GOAL = (0.4, 2.05, 1.0), (3.6, 2.05, 1.0)  # 0.4 m beside the pillar, less the radius
TO_PILLAR = (0.0, -6.0, 0.0)


def past_the_pillar(name="cone-backup", **words):
    return mission(name, cover=box_cover(PILLAR), plan=line_plan(START, GOAL, 8.0), vehicle=COPTER, **words)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cone-backup", "shield", "cone-ecbf"])
@pytest.mark.parametrize("wind", [TO_PILLAR, (4.0, -4.0, 1.0)], ids=str)
def test_a_wind_that_rises_on_the_way_blows_it_into_nothing(name, wind):
    flight = Flight(past_the_pillar(name), [Upset(State.FLY, 2.0, blow(*wind))]).fly()
    assert flight.cause is Event.PLAN_FINISHED
    assert flight.clearance(State.FLY, State.HOLD) > 0.1
    flight.judge()
    found = [s.safety for s in flight.recorder.samples if s.safety is not None]
    estimate = np.array([f.disturbance_m_s2.tuple for f in found[-50:]]).mean(axis=0)
    # Drag of the simulated vehicle at rest: 0.242 w + 0.034 |w| w by component.
    drag = np.array([0.242 * w + 0.034 * abs(w) * w for w in wind])
    np.testing.assert_allclose(estimate[:2], drag[:2], atol=0.35)
    assert max(f.disturbance_bound_m_s2 for f in found) > 1.0  # while it rose
    assert found[-1].disturbance_bound_m_s2 < 0.5


@pytest.mark.slow
def test_a_wind_that_is_too_strong_holds_and_lands():
    flight = Flight(past_the_pillar(), [Upset(State.FLY, 2.0, blow(0.0, 9.0, 0.0))]).fly()
    assert (State.FLY, Event.MODEL_WRONG) in flight.rows
    assert flight.cause is not Event.PLAN_FINISHED
    said = "\n".join(words for _, words in flight.recorder.lines)
    assert "m/s^2 that the model leaves out, at most 4 are allowed" in said
    assert flight.clearance(State.FLY, State.HOLD) > 0


def test_the_wind_that_blows_before_take_off_is_known_at_once():
    made = past_the_pillar()
    flight = Flight(made, [Upset(State.TAKE_OFF, 0.5, blow(0.0, -3.0, 0.0))]).fly()
    assert flight.cause is Event.PLAN_FINISHED
    first = next(s.safety for s in flight.recorder.samples if s.safety is not None)
    assert first.disturbance_m_s2.y == pytest.approx(-1.032, abs=0.4)  # from the lean with which it hovers
    off = np.abs(flight.path(State.FLY)[:, 2] - START[1])
    assert off.max() < off[0] + 0.05  # the vehicle's own take-off was blown aside
