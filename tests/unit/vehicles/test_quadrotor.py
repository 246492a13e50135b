"""Attitude, dynamics and rotors against an independent model and printed numbers."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula._core import (
    Quadrotor,
    inverse_rate_matrix,
    rate_jacobian,
    rate_matrix,
    rotation_of,
    shadowed,
    turned,
)
from support.effort import examples
from support.models.quadrotor_model import (
    GRAVITY,
    INERTIA,
    MASS,
    ROTORS,
    VECTORS,
    body_to_inertial,
    derivative,
    fastbridge,
    hat,
    jacobian,
    random_states,
    rk4,
    row,
    sigma_rate,
)

CASES = VECTORS["cases"]
ROUNDING = 1e-9  # relative to the largest number of a vector


def close(ours, theirs, tolerance=ROUNDING):
    theirs = np.asarray(theirs)
    return np.abs(ours - theirs).max() <= tolerance * max(np.abs(theirs).max(), 1e-3)


@pytest.mark.parametrize("case", CASES)
def test_printed_attitudes_and_dynamics(case):
    at = case["inp"]
    sigma, omega = row(at["sigma"]), row(at["omega"])
    rate = rate_matrix(sigma)[0]
    assert close(rotation_of(sigma)[0], case["R"])
    assert close(rate, case["Z"])
    assert close(rate @ omega[0], case["sigma_dot"])
    x = row(at["p"], at["sigma"], at["v"], at["omega"])
    assert close(fastbridge().derivative(x, np.zeros((1, 4)))[0], case["f"])
    thrust = fastbridge().derivative(x, row(MASS * at["uT"], 0, 0, 0))[0]
    assert close(thrust[6:9], case["a"])
    assert close(fastbridge().derivative(x, row(case["pi_b"]))[0], case["f_cl"])
    axis = rotation_of(sigma)[0].T @ np.array([0, 0, 1])
    turn = rotation_of(sigma)[0].T @ np.cross(at["omega"], [0, 0, 1])
    assert close(at["duT"] * axis + at["uT"] * turn, case["j"])


def test_closed_forms_agree_with_the_quaternion_on_random_states():
    states = random_states(1000, seed=1)
    sigma, omega = states[:, 3:6].copy(), states[:, 9:].copy()
    rotation, rate, inverse = rotation_of(sigma), rate_matrix(sigma), inverse_rate_matrix(sigma)
    by_sigma = rate_jacobian(sigma, omega)
    y = np.random.default_rng(2).normal(size=3)
    for i in range(len(states)):
        assert close(rotation[i], body_to_inertial(sigma[i]).T, 1e-13)
        assert close(rate[i] @ omega[i], sigma_rate(sigma[i], omega[i]), 1e-13)
        assert close(inverse[i] @ rate[i], np.eye(3), 1e-13)
        assert close(by_sigma[i], jacobian(lambda s, i=i: sigma_rate(s, omega[i]), sigma[i]), 1e-12)
        rotated = jacobian(lambda s: body_to_inertial(s).T @ y, sigma[i])
        assert close(hat(rotation[i] @ y) @ inverse[i], rotated, 1e-12)
        back = jacobian(lambda s: body_to_inertial(s) @ y, sigma[i])
        assert close(-rotation[i].T @ hat(y) @ inverse[i], back, 1e-12)
    short = shadowed(3 * sigma + 0.0)
    assert (np.linalg.norm(short, axis=1) <= 1 + 1e-15).all()
    assert close(rotation_of(short), rotation_of(3 * sigma), 1e-12)


def test_rotations_turn_with_omega():
    for x in random_states(200, seed=3):
        by_time = jacobian(
            lambda t, x=x: body_to_inertial(x[3:6] + t[0] * sigma_rate(x[3:6], x[9:])).ravel(), [0.0]
        )
        assert close(by_time.reshape(3, 3), body_to_inertial(x[3:6]) @ hat(x[9:]), 1e-12)


def test_turned_composes_rotations():
    from scipy.spatial.transform import Rotation

    sigma = random_states(500, seed=4)[:, 3:6].copy()
    turn = np.random.default_rng(5).normal(size=(500, 3)) * np.geomspace(1e-9, 2, 500)[:, None]
    expected = np.stack([body_to_inertial(s) for s in sigma]) @ Rotation.from_rotvec(turn).as_matrix()
    after = turned(sigma, turn)
    assert close(np.swapaxes(rotation_of(after), 1, 2), expected, 1e-13)
    assert (np.linalg.norm(after, axis=1) <= 1 + 1e-15).all()
    assert close(turned(sigma, np.zeros_like(sigma)), sigma, 1e-15)


def test_steps_are_rk4_of_the_model_and_converge_with_its_order():
    body, states = fastbridge(), random_states(50, seed=6)
    u = np.random.default_rng(7).normal([4.5, 0, 0, 0], [1, 0.02, 0.02, 0.005], (50, 4))
    after = body.step(states, u, dt_s=0.01)
    for x, command, ours in zip(states, u, after, strict=True):
        assert close(ours, rk4(lambda t, y, c=command: derivative(y, c), x, 0.01), 1e-13)

    def end(steps):
        x = states[:1]
        for _ in range(steps):
            x = body.step(x, u[:1], dt_s=0.4 / steps)
        return x

    exact = end(3200)
    errors = [np.abs(end(n) - exact).max() for n in (40, 80)]
    assert 14 < errors[0] / errors[1] < 18


def test_a_fall_keeps_its_energy_and_angular_momentum():
    body, x = fastbridge(), random_states(1, seed=8)
    x[:, 3:6] *= 0.3
    nothing = np.zeros((1, 4))

    def invariants(x):
        p, sigma, v, omega = np.split(x[0], 4)
        energy = MASS * (v @ v / 2 + GRAVITY * p[2]) + omega @ (INERTIA * omega) / 2
        return np.array([energy, *(body_to_inertial(sigma) @ (INERTIA * omega))])

    before = invariants(x)
    for _ in range(300):
        x = shadow(body.step(x, nothing, dt_s=0.001))
    assert np.abs(invariants(x) - before).max() < 1e-9


def shadow(x):
    x = x.copy()
    x[:, 3:6] = shadowed(x[:, 3:6].copy())
    return x


LAYOUTS = st.tuples(
    st.tuples(*[st.floats(0.08, 0.13)] * 4),
    st.tuples(*[st.floats(0.08, 0.13)] * 4),
    st.tuples(*[st.floats(0.0, 0.3)] * 4),
    st.tuples(*[st.floats(3.0, 5.0)] * 4),
)
WRENCHES = st.tuples(st.floats(-30, 30), *[st.floats(-3, 3)] * 3)
PRECISION = settings(max_examples=examples(300), deadline=None)


def uneven(layout):
    x, y, low, high = layout
    return fastbridge(
        rotor_x=np.multiply(x, (1, -1, 1, -1)).tolist(),
        rotor_y=np.multiply(y, (1, -1, -1, 1)).tolist(),
        f_min=low,
        f_max=high,
    )


@PRECISION
@given(layout=LAYOUTS, wanted=WRENCHES)
def test_a_limited_wrench_is_admissible_and_an_admissible_one_is_kept(layout, wanted):
    body, u = uneven(layout), row(wanted)
    flown = body.limited(u)
    assert body.admissible(flown, tolerance_n=1e-9)[0]
    assert np.abs(body.wrench(body.rotor_thrust(u)) - u).max() < 1e-9
    if body.admissible(u)[0]:
        assert (flown == u).all()
        assert (body.saturated(u) == u).all()
    cut = np.clip(body.rotor_thrust(u), body.f_min, body.f_max)
    assert close(body.saturated(u), body.wrench(cut), 1e-12)


@settings(max_examples=examples(100), deadline=None)
@given(layout=LAYOUTS, wanted=WRENCHES)
def test_torque_is_shared_as_a_linear_program_says(layout, wanted):
    from scipy.optimize import linprog

    body, u = uneven(layout), row(wanted)
    flown, inverse = body.limited(u)[0], body.inverse_allocation

    def largest_share(taken, part):
        """max s with f_min <= T pure + taken + s part <= f_max for some T."""
        columns = np.stack([inverse[:, 0], part], axis=1)
        limits = [np.subtract(body.f_max, taken), np.subtract(taken, body.f_min)]
        best = linprog(
            [0, -1],
            np.concatenate([columns, -columns]),
            np.concatenate(limits),
            bounds=[(None, None), (0, 1)],
        )
        assert best.status == 0
        return best.x[1]

    tilting = inverse[:, 1:3] @ wanted[1:3]
    tilt = largest_share(np.zeros(4), tilting)
    assert np.abs(flown[1:3] - tilt * np.array(wanted[1:3])).max() < 1e-7
    turn = largest_share(tilt * tilting, inverse[:, 3] * wanted[3])
    assert abs(flown[3] - turn * wanted[3]) < 1e-6


def test_thrust_gives_way_before_torque():
    body = fastbridge()
    wanted = row(17.0, 0.2, -0.1, 0.0)
    flown = body.limited(wanted)[0]
    assert np.abs(flown[1:] - wanted[0, 1:]).max() < 1e-12
    assert flown[0] == pytest.approx(17.0 - (0.2 + 0.1) / 0.078, abs=1e-9)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e308])
@pytest.mark.parametrize("place", range(4))
def test_a_command_without_meaning_hovers(bad, place):
    u = row(4.0, 0, 0, 0)
    u[0, place] = bad
    flown = fastbridge().limited(u)
    assert np.isfinite(flown).all()
    assert fastbridge().admissible(flown, tolerance_n=1e-9)[0]
    if not np.isfinite(bad):
        assert close(flown, row(MASS * GRAVITY, 0, 0, 0), 1e-12)
    assert not fastbridge().admissible(u)[0]


@pytest.mark.parametrize(
    "wrong",
    [
        {"mass": 0.0},
        {"mass": np.nan},
        {"gravity": -1.0},
        {"inertia": (1e-3, 0.0, 1e-3)},
        {"spin": (1, 1, 0, -1)},
        {"spin": (1, 1, 1, 1)},  # no yaw without thrust
        {"rotor_y": (0, 0, 0, 0)},  # no roll
        {"rotor_x": (0.3, 0.1, 0.3, 0.1)},  # all rotors in front of the center of mass
        {"torque_ratio": 0.0},
        {"f_min": (5,) * 4},
        {"f_min": (0, 0, 0, 4.2), "f_max": (1, 1, 1, 4.25)},
        {"f_max": (np.inf,) * 4},
    ],
)
def test_bodies_without_meaning_are_refused(wrong):
    with pytest.raises(ValueError, match=r"must|need|cannot|is -1 or 1|have no"):
        fastbridge(**wrong)


def test_an_allocation_is_the_one_of_the_vectors():
    body = Quadrotor(mass=MASS, inertia=INERTIA.tolist(), **ROTORS)
    assert (body.allocation == np.array(VECTORS["params"]["G"])).all()
    assert close(body.inverse_allocation @ body.allocation, np.eye(4), 1e-14)
    assert body.hover_thrust == MASS * GRAVITY
    assert body.max_thrust == 17.0
