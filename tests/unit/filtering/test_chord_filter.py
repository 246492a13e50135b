"""Filters of velocities on the chord: recorded numbers of the Python version before it, lag 0, failures."""

import json

import numpy as np
import pytest

from alula import _core
from alula.schemas.errors import InputError
from alula.stages.compression.hulls import Hulls
from alula.stages.filtering.bridge import native_filter
from alula.stages.filtering.polytope_cbf import without_filter
from alula.stages.filtering.protocol import FilterResult, FilterStatus, FilterWorld
from alula.stages.filtering.registry import make_filter
from support.paths import SUPPORT
from support.scenes.chord_scenes import SPEED_M_S, scenes
from support.scenes.small_scenes import box_cover

# Of the scenes of seed 7: status, active hull, calls of the filter, margin, velocity.
VECTORS = json.loads((SUPPORT / "vectors_chord.json").read_text())
BOX = Hulls.from_cover(box_cover([((0, 0, 0), (10, 10, 10))]))  # from 0 to 1 m
WORLD = FilterWorld(hulls=BOX, radius_m=0.1, speed_m_s=2.0, dt_s=0.01, extent_m=9.0)


class Calling:
    """A filter of velocities that calls a function."""

    kind = "velocity"

    def __init__(self, call):
        self.call = call

    def reset(self):
        pass

    def __call__(self, state, nominal):
        return self.call(state, nominal)


def chord_of(made, lag_s, max_speed_m_s):
    return _core.ChordFilter(native_filter(made), lag_s=lag_s, max_speed_m_s=max_speed_m_s)


def filtered(native, p, v, u):
    return native.filter([*p, 0, 0, 0, *v, 0, 0, 0], [0, 0, 0], velocity=list(u))


def test_the_numbers_are_those_of_the_python_version():
    """Among random hulls, with short and long chords: the same points, statuses and velocities."""
    seen = set()
    for (hulls, p, v, u, lag), recorded in zip(scenes(len(VECTORS), 7), VECTORS, strict=True):
        status, active, calls, margin, *velocity = recorded
        asked = []

        def counted(state, nominal, hulls=hulls, asked=asked):
            asked.append(state.position)
            return hulls(state, nominal)

        found = filtered(chord_of(Calling(counted), lag, SPEED_M_S), p, v, u)
        assert (found["status"], found["active"], len(asked)) == (status, active, calls)
        np.testing.assert_allclose(found["velocity"], velocity, rtol=0, atol=1e-9)
        assert margin is None or found["margin"] == pytest.approx(margin, abs=1e-9)
        seen.add((FilterStatus(status).name, lag > 0))
    assert len(seen) == 8  # each of four outcomes, at p alone and along a chord


def test_without_a_lag_it_is_the_filter_itself_bit_by_bit():
    made = make_filter("polytope-cbf", WORLD, {})
    chord, bare = chord_of(made, 0.0, 2.0), made.native
    rng = np.random.default_rng(1)
    for _ in range(200):
        p, v, u = rng.uniform(-0.5, 1.5, 3), rng.normal(size=3), rng.normal(size=3)
        assert filtered(chord, p, v, u) == filtered(bare, p, v, u)


def test_three_equal_lags_are_one_lag_bit_by_bit():
    rng = np.random.default_rng(2)
    made = make_filter("polytope-cbf", WORLD, {})
    one, three = chord_of(made, 0.6, 2.0), chord_of(made, [0.6, 0.6, 0.6], 2.0)
    for _ in range(200):
        p, v, u = rng.uniform(-0.5, 1.5, 3), rng.normal(size=3), rng.normal(size=3)
        assert filtered(one, p, v, u) == filtered(three, p, v, u)


def test_nearly_equal_lags_give_nearly_the_same():
    """What the curve adds is continuous: no jump where the lags become unequal."""
    rng = np.random.default_rng(3)
    made = make_filter("polytope-cbf", WORLD, {})
    one, three = chord_of(made, 0.6, 2.0), chord_of(made, [0.6, 0.6, 0.6 + 1e-9], 2.0)
    for _ in range(200):
        p, v, u = rng.uniform(-0.5, 1.5, 3), rng.normal(size=3), rng.normal(size=3)
        a, b = filtered(one, p, v, u), filtered(three, p, v, u)
        assert a["status"] == b["status"]
        np.testing.assert_allclose(a["velocity"], b["velocity"], rtol=0, atol=1e-5)


def test_bare_only_the_margin_is_reported():
    bare = chord_of(without_filter(WORLD, {}), 0.5, 2.0)
    found = filtered(bare, (-0.5, 0.5, 0.5), (0.4, 0, 0), (1.0, 0, 0))
    assert (found["status"], found["velocity"]) == (FilterStatus.OK, [1.0, 0.0, 0.0])
    assert 0.15 < found["margin"] <= 0.5 - 0.2 - 0.1  # at the lead point, by a smooth psi


@pytest.mark.parametrize(
    ("result", "words"),
    [
        (FilterResult(np.array([0, 0, 2.1]), FilterStatus.FILTERED, 1.0), "above the speed limit"),
        (FilterResult(np.zeros(3), FilterStatus.OK, float("nan")), "not a number"),
        (FilterResult(np.array([0, np.inf, 0]), FilterStatus.OK, 1.0), "no velocity"),
        (FilterResult(np.zeros(2), FilterStatus.OK, 1.0), "no velocity"),
    ],
)
def test_what_is_no_safe_velocity_is_an_error(result, words):
    native = chord_of(Calling(lambda state, nominal: result), 0.5, 2.0)
    with pytest.raises((ValueError, InputError), match=words):
        filtered(native, (0, 0, 0), (1, 0, 0), (0, 0, 0))


def test_only_filters_of_velocities_have_a_chord():
    native = _core.PythonFilter("acceleration", object())
    with pytest.raises(ValueError, match="velocities"):
        _core.ChordFilter(native, lag_s=0.5, max_speed_m_s=1.0)
    for lag, speed in ((-0.1, 1.0), (np.nan, 1.0), (0.5, 0.0), ([0.5, 0.5, 0.0], 1.0)):
        with pytest.raises(ValueError, match="lag"):
            chord_of(Calling(lambda state, nominal: None), lag, speed)
