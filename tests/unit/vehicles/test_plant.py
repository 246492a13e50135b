"""Plants: without disturbances the bare body bit by bit; each disturbance follows its formula."""

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

from alula._core import DoubleIntegrator, Plant, PlantOptions, SensorOptions
from support.models.quadrotor_model import (
    GRAVITY,
    MASS,
    body_to_inertial,
    derivative,
    fastbridge,
    random_states,
    rk4,
    row,
)

BODY = fastbridge()
HOVER = row(MASS * GRAVITY, 0, 0, 0)


def plant(seed=0, trial=0, start=None, sensor=None, **options):
    flown = Plant(BODY, PlantOptions(**options, sensor=sensor or SensorOptions()), seed=seed, trial=trial)
    flown.reset(random_states(1, seed=21)[0] if start is None else start)
    return flown


def commands(count, seed=22):
    """Admissible wrenches."""
    rotors = np.random.default_rng(seed).uniform(0.1, 4.1, (count, 4))
    return BODY.wrench(rotors)


def test_off_is_the_bare_body_bit_by_bit():
    flown, x = plant(), random_states(1, seed=21)
    for u in commands(300):
        flown.step(0.001, u)
        x = BODY.step(x, u[None], dt_s=0.001)
        assert (flown.state == x[0]).all()
        assert (flown.measured == x[0]).all()
        assert (flown.wrench == u).all()
    assert flown.steps == 300
    assert flown.time_s == pytest.approx(0.3)


def test_rotors_are_cut_off_at_their_limits_and_keep_a_meaningful_command():
    flown = plant()
    flown.step(0.001, np.array([16.0, 1.0, 0.0, 0.0]))
    assert flown.wrench == pytest.approx(BODY.saturated(row(16, 1, 0, 0))[0])
    assert BODY.admissible(flown.wrench[None], tolerance_n=1e-9)[0]
    assert flown.thrust < 16
    before = flown.wrench
    flown.step(0.001, np.array([np.nan, 0, 0, 0]))
    assert (flown.wrench == before).all()
    assert np.isfinite(flown.state).all()
    fresh = plant()
    fresh.step(0.001, np.full(4, np.inf))
    assert fresh.wrench == pytest.approx(HOVER[0])


@pytest.mark.parametrize("lag", [0.004, 0.05])
def test_a_motor_lag_is_the_exact_exponential(lag):
    flown, u = plant(motor_time_constant_s=lag), commands(1)[0]
    goal, start = BODY.rotor_thrust(u[None])[0], BODY.rotor_thrust(HOVER)[0]
    x = flown.state
    for i in range(200):
        flown.step(0.002, u)
        rotors = goal + np.exp(-0.002 * (i + 1) / lag) * (start - goal)
        assert np.abs(BODY.rotor_thrust(flown.wrench[None])[0] - rotors).max() < 1e-12

        def law(t, y, i=i):
            now = goal + np.exp(-(0.002 * i + t) / lag) * (start - goal)
            return derivative(y, BODY.wrench(now[None])[0])

        x = rk4(law, x, 0.002)
    assert np.abs(flown.state - x).max() < 1e-9 * np.abs(x).max()


def test_drag_pushes_against_the_air_along_the_bodys_axes():
    linear, quadratic, wind = (0.1, 0.2, 0.4), (0.02, 0.01, 0.05), (1.0, -2.0, 0.5)
    for x in random_states(50, seed=23):
        flown = plant(start=x, linear_drag=linear, quadratic_drag=quadratic, wind_m_s=wind)
        body = body_to_inertial(x[3:6])
        air = body.T @ (x[6:9] - wind)
        force = -body @ ((np.array(linear) + np.linalg.norm(air) * np.array(quadratic)) * air)
        assert flown.acceleration == pytest.approx(derivative(x, HOVER[0], force=force)[6:9], abs=1e-12)
        assert flown.wind == pytest.approx(wind)


def test_falling_with_drag_ends_at_the_terminal_speed():
    flown = plant(start=np.zeros(12), linear_drag=(0, 0, 0.2), quadratic_drag=(0, 0, 0.05))
    flown.fly(0.002, np.zeros((5000, 4)))
    speed = -flown.state[8]
    assert 0.2 * speed + 0.05 * speed**2 == pytest.approx(MASS * GRAVITY, rel=1e-6)


def test_wind_without_drag_and_without_gusts_is_nothing():
    calm, windy = plant(), plant(wind_m_s=(9, 9, 9), gust_m_s=(3, 3, 3))
    u = commands(50)
    assert (calm.fly(0.002, u) == windy.fly(0.002, u)).all()


def test_gusts_are_a_stationary_gauss_markov_process():
    deviation, time, dt, steps = np.array([1.0, 2.0, 0.5]), 0.2, 0.1, 20000
    flown = plant(
        seed=5, start=np.zeros(12), linear_drag=(1e-9,) * 3, gust_m_s=deviation.tolist(), gust_time_s=time
    )
    gusts = []
    for _ in range(steps):
        gusts.append(flown.wind)
        flown.step(dt, HOVER[0])
    gusts = np.array(gusts) / deviation
    kept = np.exp(-dt / time)
    # Correlated samples carry (1 - kept^2) / (1 + kept^2) of the information of independent ones.
    sure = 5 * np.sqrt((1 + kept**2) / (1 - kept**2) / steps)
    assert np.abs((gusts**2).mean(axis=0) - 1).max() < 1.5 * sure
    assert np.abs((gusts[1:] * gusts[:-1]).mean(axis=0) - kept).max() < 1.5 * sure
    assert np.abs(gusts.mean(axis=0)).max() < 1.5 * sure
    innovation = (gusts[1:] - kept * gusts[:-1]) / np.sqrt(1 - kept**2)
    assert stats.kstest(innovation.ravel(), "norm").pvalue > 1e-4
    assert np.abs(np.corrcoef(innovation.T) - np.eye(3)).max() < 5 / np.sqrt(steps)


@pytest.mark.slow
def test_noise_is_white_normal_and_of_the_given_size():
    sensor = SensorOptions(
        position_noise_m=0.01, velocity_noise_m_s=0.2, attitude_noise_rad=0.03, rate_noise_rad_s=0.5
    )
    flown, rows = plant(seed=7, start=np.zeros(12), sensor=sensor), []
    for _ in range(5000):
        x, seen = flown.state, flown.measured
        assert (flown.measured == seen).all()
        apart = Rotation.from_matrix(body_to_inertial(x[3:6]).T @ body_to_inertial(seen[3:6]))
        rows.append(np.concatenate([seen[:3] - x[:3], apart.as_rotvec(), seen[6:] - x[6:]]))
        flown.step(0.001, HOVER[0])
    noise = np.array(rows) / np.repeat([0.01, 0.03, 0.2, 0.5], 3)
    for channel in noise.T:
        assert stats.kstest(channel, "norm").pvalue > 1e-4
    assert np.abs(np.corrcoef(noise.T) - np.eye(12)).max() < 5 / np.sqrt(len(noise))
    assert np.abs((noise[1:] * noise[:-1]).mean(axis=0)).max() < 5 / np.sqrt(len(noise))


def philox(counter, key):
    """Philox 4x32-10 in integers of any size."""
    for _ in range(10):
        a, b = 0xD2511F53 * counter[0], 0xCD9E8D57 * counter[2]
        counter = (
            (b >> 32) ^ counter[1] ^ key[0],
            b & 0xFFFFFFFF,
            (a >> 32) ^ counter[3] ^ key[1],
            a & 0xFFFFFFFF,
        )
        key = ((key[0] + 0x9E3779B9) & 0xFFFFFFFF, (key[1] + 0xBB67AE85) & 0xFFFFFFFF)
    return counter


def test_noise_is_the_documented_function_of_seed_trial_and_step():
    # The published answers for the generator itself.
    assert philox((0,) * 4, (0,) * 2) == (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)
    ones = 0xFFFFFFFF
    assert philox((ones,) * 4, (ones,) * 2) == (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)
    seed, trial = 0x123456789ABCDEF, 77
    flown = plant(seed=seed, trial=trial, start=np.zeros(12), sensor=SensorOptions(velocity_noise_m_s=1.0))
    for step in range(5):
        bits = philox((step, 0, trial, 1), (seed & ones, seed >> 32))
        u = (np.array(bits) + 0.5) / 2**32
        size = np.sqrt(-2 * np.log(u[[0, 2]]))
        expected = np.array(
            [
                size[0] * np.cos(2 * np.pi * u[1]),
                size[0] * np.sin(2 * np.pi * u[1]),
                size[1] * np.cos(2 * np.pi * u[3]),
            ]
        )
        assert flown.measured[6:9] - flown.state[6:9] == pytest.approx(expected, abs=1e-13)
        flown.step(0.01, HOVER[0])


def test_flights_repeat_and_differ_by_seed_and_trial():
    def flight(seed, trial):
        flown = plant(
            seed=seed,
            trial=trial,
            linear_drag=(0.1,) * 3,
            gust_m_s=(1, 1, 1),
            sensor=SensorOptions(position_noise_m=0.01, delay_s=0.01),
        )
        way = flown.fly(0.002, commands(100))
        return np.concatenate([way.ravel(), flown.measured])

    first = flight(1, 2)
    assert (flight(1, 2) == first).all()
    assert (flight(1, 3) != first).any()
    assert (flight(2, 2) != first).any()
    assert (flight(1 << 40, 2) != first).any()


@pytest.mark.parametrize("late", [0, 1, 7, 40])
def test_a_delay_of_whole_steps_is_exact(late):
    flown = plant(sensor=SensorOptions(delay_s=late * 0.001))
    past = [flown.state]
    for u in commands(150):
        flown.step(0.001, u)
        past.append(flown.state)
        assert (flown.measured == past[max(0, len(past) - 1 - late)]).all()
    flown.reset(np.ones(12))
    assert (flown.measured == 1).all()
    assert flown.steps == 0
    assert flown.time_s == 0


def test_a_delay_between_steps_measures_the_state_of_that_time():
    flown, fine = plant(sensor=SensorOptions(delay_s=0.0025)), plant()
    past = [fine.state]  # every half step
    for u in commands(20):
        flown.step(0.001, u)
        for _ in range(2):
            fine.step(0.0005, u)
            past.append(fine.state)
        error = np.abs(flown.measured - past[max(0, len(past) - 1 - 5)])
        assert error[:9].max() < 1e-6
        assert error[9:].max() < 1e-3  # torques jump at each step


def test_the_shadow_switch_keeps_the_attitude():
    x = random_states(1, seed=24)[0]
    x[3:6] *= 3 / np.linalg.norm(x[3:6])
    flown = plant(start=x)
    flown.switch_shadow()
    assert np.abs(body_to_inertial(flown.state[3:6]) - body_to_inertial(x[3:6])).max() < 1e-13
    assert np.linalg.norm(flown.state[3:6]) == pytest.approx(1 / 3)


def test_a_double_integrator_steps_exactly_and_scales_what_is_too_much():
    flown = DoubleIntegrator(max_acceleration_m_s2=5.0, sensor=SensorOptions(delay_s=0.02))
    flown.reset(np.concatenate([[1.0, 2, 3], np.ones(3), [4.0, 5, 6], np.ones(3)]))
    for _ in range(100):
        flown.step(0.01, (3.0, 0.0, -4.0))
    p, v = flown.state[:3], flown.state[6:9]
    assert p == pytest.approx([1 + 4 + 1.5, 2 + 5, 3 + 6 - 2])
    assert v == pytest.approx([7, 5, 2])
    assert not flown.state[3:6].any()
    assert not flown.state[9:].any()
    assert flown.measured[6:9] == pytest.approx(v - 0.02 * np.array([3, 0, -4]))
    flown.step(0.01, (30.0, 0.0, -40.0))
    assert flown.acceleration == pytest.approx([3, 0, -4])
    flown.step(0.01, (np.nan, 0.0, 0.0))
    assert flown.acceleration == pytest.approx([3, 0, -4])
    assert flown.steps == 102


@pytest.mark.parametrize(
    "wrong",
    [
        {"motor_time_constant_s": -1.0},
        {"linear_drag": (0, -1, 0)},
        {"quadratic_drag": (0, 0, np.nan)},
        {"wind_m_s": (np.inf, 0, 0)},
        {"gust_m_s": (0, -1, 0)},
        {"gust_time_s": 0.0},
    ],
)
def test_disturbances_without_meaning_are_refused(wrong):
    with pytest.raises(ValueError, match=r"must|need"):
        PlantOptions(**wrong)


@pytest.mark.parametrize(
    "wrong",
    [{"position_noise_m": -1.0}, {"delay_s": -0.1}, {"delay_s": np.nan}, {"rate_noise_rad_s": np.inf}],
)
def test_sensors_without_meaning_are_refused(wrong):
    with pytest.raises(ValueError, match=r"must|need"):
        SensorOptions(**wrong)
    with pytest.raises(ValueError, match="acceleration"):
        DoubleIntegrator(max_acceleration_m_s2=0.0)
