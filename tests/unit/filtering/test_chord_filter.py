"""Filters of velocities on the chord: recorded numbers of the Python version before it, lag 0, failures."""

import json
from pathlib import Path

import numpy as np
import pytest

from alula import _core
from alula.schemas.errors import InputError
from alula.stages.compression.hulls import Hulls
from alula.stages.filtering.bridge import native_velocity_filter
from alula.stages.filtering.polytope_cbf import NativeFilter
from alula.stages.filtering.protocol import FilterResult, FilterStatus, World
from support import chord_scenes
from support.chord_scenes import SPEED_M_S, scenes
from support.small_scenes import box_cover

# Of the scenes of seed 7: status, active hull, calls of the filter, margin, velocity.
VECTORS = json.loads(Path(chord_scenes.__file__).with_name("vectors_chord.json").read_text())
BOX = Hulls.from_cover(box_cover([((0, 0, 0), (10, 10, 10))]))  # from 0 to 1 m
WORLD = World(hulls=BOX, radius_m=0.1, speed_m_s=2.0, dt_s=0.01, extent_m=9.0)


def filtered(native, p, v, u):
    return native.filter([*p, 0, 0, 0, *v, 0, 0, 0], [0, 0, 0], velocity=list(u))


def test_the_numbers_are_those_of_the_python_version():
    """Among random hulls, with short and long chords: the same points, statuses and velocities."""
    seen = set()
    for (hulls, p, v, u, lag), recorded in zip(scenes(len(VECTORS), 7), VECTORS, strict=True):
        status, active, calls, margin, *velocity = recorded
        asked = []

        def counted(x, w, hulls=hulls, asked=asked):
            asked.append(x)
            return hulls(x, w)

        found = filtered(native_velocity_filter(counted, lag_s=lag, max_speed_m_s=SPEED_M_S), p, v, u)
        assert (found["status"], found["active"], len(asked)) == (status, active, calls)
        np.testing.assert_allclose(found["velocity"], velocity, rtol=0, atol=1e-9)
        assert margin is None or found["margin"] == pytest.approx(margin, abs=1e-9)
        seen.add((FilterStatus(status).name, lag > 0))
    assert len(seen) == 8  # each of four outcomes, at p alone and along a chord


def test_without_a_lag_it_is_the_filter_itself_bit_by_bit():
    made = NativeFilter(WORLD, {})
    chord, bare = native_velocity_filter(made, max_speed_m_s=2.0), _core.VelocityFilter(made.native)
    rng = np.random.default_rng(1)
    for _ in range(200):
        p, v, u = rng.uniform(-0.5, 1.5, 3), rng.normal(size=3), rng.normal(size=3)
        assert filtered(chord, p, v, u) == filtered(bare, p, v, u)


def test_bare_only_the_margin_is_reported():
    bare = native_velocity_filter(NativeFilter(WORLD, {}, enabled=False), lag_s=0.5, max_speed_m_s=2.0)
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
    native = native_velocity_filter(lambda x, u: result, lag_s=0.5, max_speed_m_s=2.0)
    with pytest.raises((ValueError, InputError), match=words):
        filtered(native, (0, 0, 0), (1, 0, 0), (0, 0, 0))


def test_only_filters_of_velocities_have_a_chord():
    native = _core.PythonFilter("acceleration", object())
    with pytest.raises(ValueError, match="velocities"):
        _core.ChordFilter(native, lag_s=0.5, max_speed_m_s=1.0)
    for lag, speed in ((-0.1, 1.0), (np.nan, 1.0), (0.5, 0.0)):
        with pytest.raises(ValueError, match="lag"):
            native_velocity_filter(lambda x, u: None, lag_s=lag, max_speed_m_s=speed)
