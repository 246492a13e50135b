"""The racing drone's plant against an adaptive integration of an independent model."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from alula import _core
from alula.schemas.errors import UsageError
from alula.schemas.scenarios.vehicle import FASTBRIDGE, read_vehicle
from alula.stages.vehicles.fence import fence
from alula.stages.vehicles.racer import geofence, racer_model, racer_options
from support.models import racer_model as model
from support.paths import VEHICLES

RACER7 = VEHICLES / "racer7.toml"


def flown(x, u, dt, steps, **options):
    racer = _core.Racer(_core.RacerModel(), _core.RacerOptions(**options))
    racer.reset(x)
    for _ in range(steps):
        racer.step(dt, u)
    return racer.state


def same_attitude(a, b):
    return b if a @ b > 0 else -b


@pytest.mark.parametrize("seed", range(4))
def test_a_second_with_a_held_command_is_that_of_the_equations(seed):
    rng = np.random.default_rng(seed)
    x = model.random_states(1, seed)[0]
    u = np.array([rng.uniform(), *rng.uniform(-4, 4, 3)])
    expected = solve_ivp(lambda _, y: model.derivative(y, u), (0, 1), x, rtol=1e-10, atol=1e-11).y[:, -1]
    got = flown(x, u, 0.001, 1000)
    expected[6:10] = same_attitude(got[6:10], expected[6:10])
    np.testing.assert_allclose(got, expected, rtol=1e-5, atol=1e-5)


def test_rates_are_exact_whatever_the_step():
    x = np.r_[np.zeros(6), 1, 0, 0, 0, 3.0, -2.0, 1.0]
    u = np.array([0.3, 1.0, 2.0, -3.0])
    expected = u[1:] + (x[10:] - u[1:]) * np.exp(-50 * 0.12)
    for dt, steps in ((0.12, 1), (0.01, 12), (0.0005, 240)):
        np.testing.assert_allclose(flown(x, u, dt, steps)[10:], expected, rtol=1e-12, atol=1e-13)


def test_steps_are_of_fourth_order():
    x, u = model.random_states(1, 9)[0], np.array([0.6, 6.0, -5.0, 2.0])
    exact = flown(x, u, 0.4 / 4096, 4096)
    errors = [np.abs(flown(x, u, 0.4 / n, n) - exact).max() for n in (8, 16, 32)]
    assert errors[0] / errors[1] > 12
    assert errors[1] / errors[2] > 12


def test_drag_and_wind_meet_at_the_terminal_speed():
    """Falling level with linear drag: v' = -g + a(u) - (c/m)(v - w)."""
    x = np.r_[np.zeros(6), 1, 0, 0, 0, 0, 0, 0]
    got = flown(
        x,
        np.zeros(4),
        0.001,
        8000,
        mass=0.5,
        mass_scale=2,
        linear_drag=(1.0, 1.0, 2.0),
        wind_m_s=(3.0, 0, 1.0),
    )
    np.testing.assert_allclose(got[3:6], [3.0, 0, 1.0 - 9.81 / 2.0], atol=2e-3)
    fast = flown(x, np.zeros(4), 0.001, 8000, mass=1.0, quadratic_drag=(0.1, 0.1, 0.1))
    np.testing.assert_allclose(fast[5], -np.sqrt(9.81 / 0.1), rtol=1e-5)


def test_scales_sag_and_delay():
    x, u = np.r_[np.zeros(6), 1, 0, 0, 0, 0, 0, 0], np.array([1.0, 0, 0, 0])
    full = model.thrust(1.0)
    assert flown(x, u, 0.001, 1)[5] / 0.001 == pytest.approx(full - 9.81, rel=1e-5)
    scaled = flown(x, u, 0.001, 1, mass_scale=1.2, thrust_scale=0.85)[5] / 0.001
    assert scaled == pytest.approx(full * 0.85 / 1.2 - 9.81, rel=1e-5)
    sagged = (
        flown(x, u, 0.001, 3001, sag_share=0.2, sag_time_s=0.2)[5]
        - flown(x, u, 0.001, 3000, sag_share=0.2, sag_time_s=0.2)[5]
    )
    assert sagged / 0.001 == pytest.approx(0.8 * full - 9.81, rel=1e-4)
    assert np.abs(flown(x, u, 0.001, 20, delay_s=0.02)[5]) < 1e-9  # still hovering
    assert flown(x, u, 0.001, 21, delay_s=0.02)[5] == pytest.approx(flown(x, u, 0.001, 1)[5])
    turning = np.array([0.3, 2.0, 0, 0])
    assert flown(x, turning, 0.01, 1, rate_gain_scale=0.7)[10] == pytest.approx(2 * (1 - np.exp(-0.35)))


def test_commands_that_are_not_finite_are_ignored_and_others_cut():
    x = np.r_[np.zeros(6), 1, 0, 0, 0, 0, 0, 0]
    assert np.abs(flown(x, np.full(4, np.nan), 0.01, 10)).max() < 1 + 1e-9
    np.testing.assert_array_equal(
        flown(x, np.array([7.0, 99, -99, 99]), 0.01, 5), flown(x, np.array([1.0, 12, -12, 6]), 0.01, 5)
    )


@pytest.mark.parametrize(
    "options",
    [
        {"mass": 0.0},
        {"delay_s": -1.0},
        {"sag_share": 1.0},
        {"linear_drag": (-1.0, 0, 0)},
        {"thrust_scale": np.nan},
    ],
)
def test_options_without_meaning_are_refused(options):
    with pytest.raises(ValueError):
        _core.RacerOptions(**options)
    with pytest.raises(UsageError):
        racer_options(read_vehicle(RACER7), **options)


@pytest.mark.parametrize(
    "changed", [{"thrust": (0.0, 1.0, 1.0)}, {"rate_gain": 0.0}, {"thrust": (0.0, -1.0, 90.0)}]
)
def test_models_without_meaning_are_refused(changed):
    with pytest.raises(ValueError):
        _core.RacerModel(**changed)


def test_the_seven_inch_racer_is_that_of_the_paper():
    made = racer_model(read_vehicle(RACER7))
    for throttle in np.linspace(0, 1, 11):
        assert np.polyval(made.thrust[::-1], throttle) == pytest.approx(model.thrust(throttle), abs=1e-3)
    assert made.rate_gain == pytest.approx(50)
    assert made.throttle_for(9.81) == pytest.approx(model.HOVER, abs=1e-5)
    inside = geofence(read_vehicle(RACER7), fence(box=model.BOX))
    assert inside.hover_throttle == pytest.approx(made.throttle_for(9.81), abs=1e-6)


def test_other_vehicles_and_wind_without_drag_are_refused():
    with pytest.raises(UsageError, match="throttle"):
        racer_model(FASTBRIDGE)
    with pytest.raises(UsageError, match="throttle"):
        racer_options(FASTBRIDGE)
    with pytest.raises(UsageError, match="drag"):
        racer_options(read_vehicle(RACER7), wind_m_s=(8.0, 0.0, 0.0))
    with pytest.raises(UsageError, match="fence"):
        fence()
    with pytest.raises(UsageError, match="speed"):
        geofence(read_vehicle(RACER7), fence(box=model.BOX), {"speed": 1.0})
