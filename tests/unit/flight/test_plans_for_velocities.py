"""Plans for velocities are flown in their tubes if they were made behind the filter that flies them."""

import numpy as np
import pytest

import alula
from alula.schemas.artifacts.artifact import write_artifact
from alula.stages.flight.judge import judge
from alula.stages.flight.loop.supervisor import Event
from alula.stages.flight.recorder.log import row_of
from support.flights.flights import mission
from support.scenes.small_scenes import SLALOM
from support.vehicles.lockstep import Flight


@pytest.mark.every(4)
@pytest.mark.parametrize("speed_m_s", [1.0, 2.0])
@pytest.mark.parametrize("behind", [{}, {"filter": "none"}])
def test_a_plan_is_flown_in_its_tube_if_it_was_made_behind_the_filter(tmp_path, speed_m_s, behind):
    """Behind `polytope-cbf` it is by default."""
    cover = tmp_path / "hall.cover.npz"
    write_artifact(cover, SLALOM)
    plan = alula.plan(cover, start=(1, 1, 1.2), goal=(11, 3, 1.2), speed_m_s=speed_m_s, **behind).artifact
    flight = Flight(mission(plan=plan, cover=SLALOM, rate_hz=50.0)).fly()
    flight.judge()
    assert flight.cause is Event.PLAN_FINISHED
    rows = np.array([row_of(s) for s in flight.recorder.samples if s.safety is not None])
    trial = judge(flight.made, rows, flight.cause, 1)
    assert (trial.outcome, trial.plan.outside_m > 0.1) == (
        ("off-plan", True) if behind else ("reached", False)
    )
