"""The backup policies: the paper's numbers, admissibility for every state, Jacobians, and flights."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from alula import _core
from support.models import backup_model as model
from support.models import quadrotor_model as body

KINDS = ["hover", "heading-invariant", "brake"]
NUMBER = st.floats(-1e3, 1e3) | st.floats(-1e60, 1e60)


def policy(kind, **gains):
    return _core.BackupPolicy(body.fastbridge(), kind, _core.BackupGains(**gains))


def case_state(case):
    return np.concatenate([case["inp"][name] for name in ("p", "sigma", "v", "omega")]).astype(float)


@pytest.mark.parametrize("case", body.VECTORS["cases"])
def test_hover_is_the_policy_of_the_paper(case):
    hover, x = policy("hover"), case_state(case)
    for got, expected in [
        (hover.raw(x), case["pi_raw"]),
        (hover(x), case["pi_b"]),
        (hover.closed_loop(x), case["f_cl"]),
        (hover.jacobian(x), case["J_cl"]),
    ]:
        np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def test_the_cone_escape_regulates_as_the_brake():
    escape, brake = policy("cone-escape"), policy("brake")
    for x in body.random_states(20, seed=9):
        np.testing.assert_array_equal(escape(x, (1, 2, -1)), brake(x, (1, 2, -1)))


def test_caps_of_hover_are_those_of_the_paper():
    hover = policy("hover")
    np.testing.assert_allclose([hover.cap_up, *hover.torque_cap], body.PARAMETERS["caps"], rtol=1e-12)
    assert hover.cap_down == hover.cap_up


@pytest.mark.every(3)
@pytest.mark.parametrize("kind", KINDS)
def test_policies_and_their_jacobians_agree_with_the_model(kind):
    native, numpy = policy(kind), model.MODELS[kind]()
    rng = np.random.default_rng(3)
    for i, x in enumerate(body.random_states(1000, seed=1)):
        hold, direction = rng.normal(size=3), rng.normal(size=12)

        def flow(y, hold=hold):
            return model.closed_loop(numpy, y, hold)

        value, jacobian = flow(x), native.jacobian(x, hold)
        np.testing.assert_allclose(
            native.closed_loop(x, hold), value, rtol=1e-11, atol=1e-11 * np.abs(value).max()
        )
        expected, scale = model.along(flow, x, direction), np.abs(jacobian).max()
        np.testing.assert_allclose(jacobian @ direction, expected, rtol=1e-9, atol=1e-11 * scale)
        if i < 50:
            np.testing.assert_allclose(jacobian, body.jacobian(flow, x), rtol=1e-9, atol=1e-12 * scale)


@pytest.mark.parametrize("kind", KINDS)
@given(x=st.lists(NUMBER, min_size=12, max_size=12), hold=st.lists(NUMBER, min_size=3, max_size=3))
def test_every_state_gets_an_admissible_wrench(kind, x, hold):
    vehicle = body.fastbridge()
    u = _core.BackupPolicy(vehicle, kind)(np.array(x), hold)
    slack = 0.05 * min(model.F_MAX - model.HOVER, model.HOVER)  # 1 - eta_frac of the margin
    rotors = vehicle.rotor_thrust(u[None])[0]
    assert rotors.min() >= slack - 1e-9
    assert rotors.max() <= model.F_MAX - slack + 1e-9


def test_the_brake_uses_all_that_its_rotors_may_give():
    brake, numpy = policy("brake"), model.Brake()
    np.testing.assert_allclose([brake.cap_up, brake.cap_down], [numpy.up, numpy.down], rtol=1e-12)
    assert brake.cap_up > 3 * brake.cap_down > 3 * policy("hover").cap_down
    corner = np.array([model.MASS * model.GRAVITY - brake.cap_down, *brake.torque_cap])
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    rotors = np.array([model.INVERSE @ (corner * [1, *s]) for s in signs])
    assert rotors.min() == pytest.approx(0.05 * model.HOVER)


@pytest.mark.parametrize("kind", ["heading-invariant", "brake"])
def test_neither_the_shadow_nor_the_heading_changes_what_is_flown(kind):
    flown = policy(kind)
    for x in body.random_states(100, seed=2):
        shadow = x.copy()
        shadow[3:6] /= -(x[3:6] @ x[3:6])
        np.testing.assert_allclose(flown(shadow), flown(x), rtol=1e-10, atol=1e-12)
        # The same motion seen in a frame turned about the vertical.
        turned = x.copy()
        turn = np.array([[np.cos(1), -np.sin(1), 0], [np.sin(1), np.cos(1), 0], [0, 0, 1]])
        turned[6:9] = turn @ x[6:9]
        inertial = turn @ body.body_to_inertial(x[3:6])
        turned[3:6] = sigma_of(inertial)
        np.testing.assert_allclose(flown(turned), flown(x), rtol=1e-8, atol=1e-10)


def sigma_of(inertial_from_body):
    q0 = np.sqrt(max(0, 1 + np.trace(inertial_from_body))) / 2
    m = inertial_from_body
    q = np.array([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]]) / (4 * q0)
    return q / (1 + q0)


def test_unstable_braking_is_refused():
    # kappa K_omega K_sigma > 4 J g k_vh with the larger J of roll and pitch
    limit = 0.02 * 0.3 / (4 * 6.9e-4 * 9.81)
    policy("hover", k_vh=0.999 * limit)
    with pytest.raises(ValueError, match="not stable"):
        policy("hover", k_vh=1.001 * limit)
    with pytest.raises(ValueError, match="not stable"):
        policy("brake", full_tilt_speed_m_s=0.15)


@pytest.mark.parametrize("kind", ["hover", "heading-invariant", "brake"])
def test_gains_that_do_not_settle_when_held_for_a_tick_are_refused(kind):
    """Against the nonlinear model, disturbed a little and flown for some seconds."""
    index = _core.EllipsoidIndex(np.full((1, 3), 50.0), np.ones((1, 3)), np.eye(4)[:1], sigma=1.0, radius=0.1)
    made_for = body.fastbridge()
    made = _core.BackupPolicy(made_for, kind)
    verdicts = set()
    for tick in (0.005, 0.01, 0.02, 0.035, 0.05, 0.08, 0.12):
        x = np.array([0, 0, 0, 1e-4, -2e-4, 1e-4, 1e-3, 0, 1e-3, 0, 1e-3, 1e-3])
        for _ in range(int(40 / tick)):
            u = made(x)
            for _ in range(8):
                x = made_for.step(x[None], u[None], dt_s=tick / 8)[0]
        settles = np.linalg.norm(x[6:]) < 1e-3
        verdicts.add(settles)
        if settles:
            _core.Shield(made, index, _core.ShieldOptions(tick_s=tick))
        else:
            with pytest.raises(ValueError, match="do not settle"):
                _core.Shield(made, index, _core.ShieldOptions(tick_s=tick))
    assert verdicts == {True, False}


@pytest.mark.parametrize(
    "gains", [{"k_vz": 0}, {"eta_frac": 1}, {"kappa": float("nan")}, {"weight": (1, 1, 0, 1)}]
)
def test_gains_without_meaning_are_refused(gains):
    with pytest.raises(ValueError):
        policy("hover", **gains)


@pytest.mark.parametrize("gains", [{"torque_share": 1}, {"tilt_rad": 1.5}, {"attitude_damping": 0}])
def test_gains_of_the_brake_without_meaning_are_refused(gains):
    with pytest.raises(ValueError):
        policy("brake", **gains)


def test_a_vehicle_that_cannot_hover_and_an_unknown_kind_are_refused():
    with pytest.raises(ValueError, match="hover"):
        _core.BackupPolicy(body.fastbridge(f_max=(1.1,) * 4), "brake")
    with pytest.raises(ValueError, match="backup policy"):
        policy("stop")


def fly(kind, x, seconds):
    """States every 10 ms."""
    return model.flow(model.MODELS[kind](), x, 0.01, round(seconds / 0.01))


def test_the_brake_stops_within_three_metres_where_hover_needs_six():
    x = np.zeros(12)
    x[6] = 5
    brake, hover = fly("brake", x, 3), fly("hover", x, 6)
    assert brake[-1, 0] < 3 < 6 < hover[-1, 0]
    assert np.linalg.norm(brake[-1, 6:9]) < 1e-2
    tilt = [np.arccos(body.body_to_inertial(s)[2, 2]) for s in brake[:, 3:6]]
    assert max(tilt) < 0.61
    assert np.abs(brake[:, 2]).max() < 0.05  # holds its height while tilted
    assert hover[:, 2].min() < -0.2


@pytest.mark.every(3)
@pytest.mark.parametrize("kind", ["hover", "heading-invariant", "brake"])
def test_drift_is_what_the_linear_loop_still_moves(kind):
    flown = policy(kind)
    for x in body.random_states(2, seed=4):
        near = 1e-4 * x
        near[5] = near[11] = 0  # yaw turns the frame of the rates
        end = model.flow(model.MODELS[kind](), near, 0.02, 150 if kind == "brake" else 450)[-1]
        np.testing.assert_allclose(end[:3] - near[:3], flown.drift(near), rtol=2e-3, atol=1e-7)
