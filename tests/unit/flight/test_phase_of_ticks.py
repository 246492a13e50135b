"""A flight by rates ends alike, whenever in a period of the loop the vehicle's states arrive."""

import pytest

from alula.schemas.scenarios.vehicle import read_vehicle
from alula.stages.flight.loop.supervisor import Event
from support.effort import some
from support.flights.flights import BALL, mission
from support.flights.watched_flights import Watched, clearance, flight, true_path
from support.paths import VEHICLES

COPTER = read_vehicle(VEHICLES / "arducopter.toml")
PHASES_S = [1e-3 * phase for phase in range(10)]


class Shifted(Watched):
    """It boots a little later, and sends all of its messages later."""

    def __init__(self, shift_s):
        super().__init__()
        self.shift_s = shift_s

    def tick(self, now):
        super().tick(now - self.shift_s)


@pytest.mark.slow
@pytest.mark.parametrize("shift_s", some(PHASES_S[5:] + PHASES_S[:5], 10))
def test_a_ball_is_passed(shift_s):
    """With ArduPilot's default limit of the angular acceleration, half of these flights turned over."""
    made = mission("cone-backup", scene=BALL, is_clear=True, vehicle=COPTER)
    served = Shifted(shift_s)
    with flight(made, served) as loop:
        pass
    assert loop.supervision.cause is Event.PLAN_FINISHED, loop.ending
    assert clearance(made, true_path(loop, served, "fly")) > 0
