"""Check of the frame by hand over MAVLink: a vehicle is carried before take-off, in wrong frames too."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from alula.stages.flight.loop.supervisor import Event, State
from support.flights.flights import mission
from support.vehicles.lockstep import Flight

MOVES_M, MOVE_S, REST_S = 0.4, 0.6, 0.4


def carried(seconds):
    """True displacement and velocity of the carried vehicle, x east: along +x, +y, +z, and straight back."""
    place, speed = np.zeros(3), np.zeros(3)
    for axis in range(3):
        done = (seconds - axis * (MOVE_S + REST_S)) / MOVE_S
        place[axis] = MOVES_M * min(1.0, max(0.0, done))
        speed[axis] = MOVES_M / MOVE_S if 0 < done < 1 else 0.0
    if seconds > 3 * (MOVE_S + REST_S):
        place = np.zeros(3)
    return place, speed


def in_frame(matrix):
    """Displacement and velocity as reported in another frame."""

    def begin(flight):
        def change(message):
            at = flight.entered.get(State.CHECKS)
            place, speed = carried(-1.0 if at is None else flight.time() - at - 0.5)
            message.y, message.x, message.z = matrix @ place * (1, 1, -1)
            message.vy, message.vx, message.vz = matrix @ speed * (1, 1, -1)

        flight.changes["LOCAL_POSITION_NED"] = change

    return begin


def about_z(degrees):
    return Rotation.from_euler("z", degrees, degrees=True).as_matrix()


WRONG = {
    "x mirrored": np.diag([-1.0, 1, 1]),
    "y mirrored": np.diag([1.0, -1, 1]),
    "z mirrored": np.diag([1.0, 1, -1]),
    "x and y swapped": np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, 1]]),
    "turned by 36 degrees": about_z(36),
    "turned by a right angle": about_z(-90),
    "turned about": about_z(180),
}


def fly(matrix, *, dry_run=False):
    flight = Flight(mission(rate_hz=50.0), loop_words={"by_hand": True, "dry_run": dry_run})
    in_frame(matrix)(flight)
    return flight.fly()


@pytest.mark.every(4)
@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_frame_is_refused_before_the_motors_start(name):
    flight = fly(WRONG[name])
    assert flight.cause is Event.CHECK_FAILED
    assert "frame: a move along" in flight.loop.checks.failure()
    assert State.ARMING not in flight.entered
    flight.judge()


def test_the_maps_frame_passes_even_a_little_askew():
    flight = fly(about_z(15), dry_run=True)
    assert flight.cause is Event.CHECKS_PASSED_DRY, flight.loop.checks.failure()
    assert {v.name: v.words for v in flight.loop.checks.verdicts}["frame"] == "as moved by hand"
