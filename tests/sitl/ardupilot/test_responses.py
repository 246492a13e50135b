"""ArduPilot's own simulation has the responses that the simulated autopilot is compared with."""

import pytest

from support.vehicles.arducopter import wired
from support.vehicles.responses import ANSWERS, MEASURED, Measurer, measure

pytestmark = [pytest.mark.sitl, pytest.mark.slow]


def test_the_real_program_has_the_stored_answers_and_responses(tmp_path):
    with wired(tmp_path) as line:
        client = Measurer(line)
        assert client.greet() == ANSWERS
        found = measure(client)
    # On a busy machine a set-point takes some ms to the other process.
    assert found == {name: pytest.approx(value, rel=0.1, abs=0.006) for name, value in MEASURED.items()}
