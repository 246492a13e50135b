"""Chord points that do not agree, and a filter that fails at one of them: nothing unsafe is sent."""

import math

import numpy as np
import pytest

from alula.schemas.errors import InputError
from alula.stages.filtering.protocol import FilterResult, FilterStatus, FlightState, Nominal
from support.flights.velocity_worlds import ZERO, commander_around, seen, target_at, world


@pytest.mark.parametrize(
    ("p", "v", "nominal"),
    [
        ((0.18, 0.37, 1.09), (0.91, -0.24, 0.33), (-2.02, 2.12, 0.64)),
        ((1.6, 1.4, 1.09), (0.78, -1.04, -0.65), (1.02, 2.79, 0.43)),
        ((3.48, -0.19, 1.24), (-1.79, 0.53, -0.31), (2.9, -0.04, -0.77)),
    ],
)
def test_what_is_sent_is_let_through_at_all_points_of_the_chord(p, v, nominal):
    """This also holds where three passes do not suffice for an agreement."""
    _, safety = world(3.0, 0.6)
    asked = Failing(safety)
    commander = commander_around(asked, 8.0, 3.0, lag_s=0.6)
    target = target_at(np.array(p))
    target[0, 3:6] = nominal
    found = commander.decide(seen(np.array(p), np.array(v)), 0.0, target)
    assert found.status in (FilterStatus.FILTERED, FilterStatus.SHORTENED)
    for share in np.linspace(0, 1, 13):
        again = safety(FlightState(np.array(p) + share * 0.6 * np.array(v)), Nominal(found.safe))
        np.testing.assert_allclose(again.u, found.safe, atol=0.02)


class Failing:
    """Filter that counts its calls and fails at one of them."""

    kind = "velocity"

    def __init__(self, inner, how="", at=-1):
        self.inner, self.how, self.at, self.calls = inner, how, at, 0

    def reset(self):
        pass

    def __call__(self, state, nominal):
        self.calls += 1
        result = self.inner(state, nominal)
        if self.calls != self.at:
            return result
        if self.how == "raises":
            raise RuntimeError("no more")
        if self.how == "no number":
            return FilterResult(np.full(3, math.nan), result.status, result.margin)
        if self.how == "no margin":
            return FilterResult(result.u, result.status, math.nan)
        return FilterResult(ZERO, FilterStatus.REFUSED, math.nan)


# Clear everywhere; near walls, so that points must agree; into a pillar, so that its margin is located.
CHORDS = {
    "clear": ((2.0, 0.6, 1.5), (-0.5, 0.2, 0.0)),
    "near": ((0.5, 2.6, 1.5), (0.0, 1.0, 0.0)),
    "blocked": ((2.1, 2.4, 1.5), (2.5, 0.5, 0.0)),
}


@pytest.mark.parametrize("how", ["raises", "no number", "no margin", "refuses"])
@pytest.mark.parametrize("name", CHORDS)
def test_nothing_is_sent_whichever_point_of_the_chord_the_filter_fails_at(name, how):
    p, v = (np.array(part) for part in CHORDS[name])
    _, safety = world(3.0, 0.6)

    def decided(filtering):
        commander = commander_around(filtering, 8.0, 3.0, lag_s=0.6)
        return commander.decide(seen(p, v), 0.0, target_at((0.0, 5.0, 1.5)))

    sound = Failing(safety)
    assert decided(sound).setpoint is not None
    assert sound.calls >= 4
    for at in range(1, sound.calls + 1):
        if how == "refuses":
            found = decided(Failing(safety, how, at))
            assert found.setpoint is None, at
            assert found.status is FilterStatus.REFUSED
        else:
            with pytest.raises((RuntimeError, ValueError, InputError)):
                decided(Failing(safety, how, at))
