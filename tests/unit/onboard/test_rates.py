"""Sticks for commands, against Betaflight's published formula in double precision."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula import _core

CENTER = np.radians(200)
PULSES = np.arange(1000, 2001, dtype=np.uint16)
PROFILES = st.tuples(st.floats(0.01, 2.55), st.floats(0, 1), st.floats(0, 1))


def rate(x, rc_rate, super_rate, expo):
    """The formula, in double precision."""
    slope = rc_rate + (14.54 * (rc_rate - 2) if rc_rate > 2 else 0)
    shaped = x * np.abs(x) ** 3 * expo + x * (1 - expo)
    return CENTER * slope * shaped / np.clip(1 - super_rate * np.abs(x), 0.01, 1)


def profile(rc_rate=1.0, super_rate=0.7, expo=0.0, **more):
    return _core.Rates(rc_rate=(rc_rate,) * 3, super_rate=(super_rate,) * 3, expo=(expo,) * 3, **more)


@settings(deadline=None)
@given(PROFILES)
def test_rates_are_those_of_the_formula(numbers):
    numbers = tuple(float(np.float32(n)) for n in numbers)
    x = np.linspace(-1, 1, 401).astype(np.float32)
    got = profile(*numbers).rate(0, x)
    expected = rate(x.astype(float), *numbers)
    # 1 - s |x| is off by 2 ulp of 1, and counts for more where little is left of it
    room = np.clip(1 - numbers[1] * np.abs(x.astype(float)), 0.01, 1)
    np.testing.assert_array_less(np.abs(got - expected), 1e-6 * np.abs(expected) * (1 + 0.3 / room) + 1e-30)
    assert np.array_equal(got, -profile(*numbers).rate(0, -x))


@settings(deadline=None)
@given(PROFILES, st.floats(-40, 40))
def test_the_deflection_of_a_rate_gives_it_back(numbers, wanted):
    numbers = tuple(float(np.float32(n)) for n in numbers)
    rates = profile(*numbers)
    x = float(rates.deflection(2, np.array([wanted], np.float32))[0])
    assert -1 <= x <= 1
    reach = rate(1.0, *numbers)
    target = np.clip(np.float32(wanted), -reach, reach)
    below, above = (rate(np.clip(x + d, -1, 1), *numbers) for d in (-4e-7, 4e-7))
    assert below - 1e-5 * abs(target) - 1e-6 <= target <= above + 1e-5 * abs(target) + 1e-6


def test_the_closed_inverse_is_the_specified_one():
    wanted = np.linspace(-11.6, 11.6, 1001).astype(np.float32)
    got = profile().deflection(0, wanted)
    expected = wanted / (CENTER + 0.7 * np.abs(wanted.astype(float)))
    np.testing.assert_allclose(got, expected, rtol=3e-7, atol=1e-9)


def test_expo_and_no_expo_meet():
    wanted = np.linspace(-11, 11, 101).astype(np.float32)
    np.testing.assert_allclose(
        profile(expo=1e-7).deflection(1, wanted), profile().deflection(1, wanted), rtol=3e-6, atol=1e-7
    )


@pytest.mark.parametrize("numbers", [(1, 0.7, 0), (1, 0.7, 0.3), (1.8, 0.5, 0), (2.4, 0, 0.9), (0.4, 1, 0)])
def test_every_pulse_comes_back(numbers):
    rates = profile(*numbers)
    channels = np.stack([PULSES, PULSES[::-1], PULSES, np.roll(PULSES, 300)], axis=1)
    commands, refused = rates.commands(channels)
    assert not refused.any()
    back, refused = rates.channels(commands)
    assert not refused.any()
    low = np.maximum(channels[:, 2], 1050)
    assert np.array_equal(back[:, 2], low)
    assert np.array_equal(np.delete(back, 2, axis=1), np.delete(channels, 2, axis=1))


def test_a_stick_is_half_a_microsecond_from_the_command():
    rng = np.random.default_rng(0)
    commands = np.column_stack([rng.uniform(0, 1, 2000), rng.uniform(-11.5, 11.5, (2000, 3))])
    channels, _ = profile().channels(commands)
    sticks = (channels[:, [0, 1, 3]].astype(float) - 1500) / 500 * [1, 1, -1]
    slack = 0.5001 / 500
    below, above = (rate(sticks + d, 1, 0.7, 0) for d in (-slack, slack))
    assert ((below <= commands[:, 1:]) & (commands[:, 1:] <= above)).all()
    assert np.abs(channels[:, 2] - (1050 + 950 * commands[:, 0])).max() <= 0.5001


def test_signs_and_ends():
    rates = profile()
    channels, refused = rates.channels(
        np.array([[0.5, 1, 0, 0], [0, 0, 1, 0], [1, 0, 0, 1], [2, 99, -99, 99], [-1, -99, 99, -99]], float)
    )
    assert not refused.any()
    assert channels[0, 0] > 1500  # right: rolls right
    assert channels[1, 1] > 1500  # forward: pitches down
    assert channels[2, 3] < 1500  # left: turns left
    assert channels[3].tolist() == [2000, 1000, 2000, 1000]
    assert channels[4].tolist() == [1000, 2000, 1050, 2000]


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("at", range(4))
def test_what_is_not_finite_is_no_pulse(bad, at):
    command = np.array([[0.5, 1.0, 2.0, 3.0]])
    command[0, at] = bad
    channels, refused = profile().channels(command)
    assert refused.tolist() == [1]
    assert channels.tolist() == [[0, 0, 0, 0]]


def test_nan_stays_nan_and_infinity_is_full_stick():
    for expo in (0.0, 0.5):
        rates = profile(expo=expo)
        odd = np.array([np.nan, np.inf, -np.inf], np.float32)
        assert np.array_equal(rates.deflection(0, odd), [np.nan, 1, -1], equal_nan=True)
        assert np.isnan(rates.rate(0, odd[:1]))[0]


@pytest.mark.parametrize("pulse", [0, 884, 2116, 65535])
@pytest.mark.parametrize("at", range(4))
def test_what_is_no_pulse_is_no_command(pulse, at):
    channels = np.array([[1600, 1400, 1700, 1550]], np.uint16)
    channels[0, at] = pulse
    command, refused = profile().commands(channels)
    assert refused.tolist() == [1]
    assert not command.any()


@pytest.mark.parametrize(
    "numbers",
    [
        {"rc_rate": (1, 1, 0.0)},
        {"rc_rate": (2.6, 1, 1)},
        {"super_rate": (0.7, -0.1, 0.7)},
        {"super_rate": (0.7, 1.1, 0.7)},
        {"expo": (np.nan, 0, 0)},
        {"middle_us": 1300},
        {"throttle_low_us": 1950, "throttle_high_us": 2000},
        {"throttle_high_us": np.inf},
    ],
)
def test_profiles_that_mean_nothing_are_refused(numbers):
    with pytest.raises(ValueError, match="out of range"):
        _core.Rates(**numbers)
