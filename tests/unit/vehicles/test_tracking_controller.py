"""The geometric controller: printed numbers, derivatives along closed loops, limits, odd demands."""

import numpy as np
import pytest

from alula._core import ReferenceCurve, TrackingGains, body_rates, realise, track, track_point
from support.models.quadrotor_model import (
    GRAVITY,
    INERTIA,
    MASS,
    VECTORS,
    body_to_inertial,
    derivative,
    fastbridge,
    hat,
    jacobian,
    random_states,
    rk4,
    row,
    vee,
)

BODY, GAINS = fastbridge(), TrackingGains()
WEIGHT = np.array([0, 0, GRAVITY])  # per mass
CASES = VECTORS["cases"]


def reference_of(case):
    r = case["geo"]["ref"]
    return row(r["p"], r["v"], r["a"], r["j"], r["s"], r["psi"], r["dpsi"], r["ddpsi"])


def state_of(case):
    at = case["inp"]
    return row(at["p"], at["sigma"], at["v"], at["omega"])


@pytest.mark.parametrize("case", CASES)
def test_printed_controller(case):
    terms, printed = track(BODY, GAINS, state_of(case), reference_of(case)), case["geo"]
    ours = {
        "fc": terms["force"],
        "fcdot": terms["force_rate"],
        "fcddot": terms["force_acceleration"],
        "omega_d": terms["omega_d"],
        "omegadot_d": terms["omega_d_rate"],
        "e_R": terms["e_r"],
        "e_omega": terms["e_omega"],
        "T": terms["wrench"][:, 0],
        "tau": terms["wrench"][:, 1:],
        "Tdot": terms["thrust_rate"],
    }
    for name, value in ours.items():
        expected = np.asarray(printed[name])
        assert np.abs(value[0] - expected).max() <= 1e-9 * max(np.abs(expected).max(), 1e-3), name


def lissajous(t):
    """Position and four derivatives, and yaw with two, of a 3-D figure; complex t too."""
    size, rate, phase = np.array([1.2, 0.9, 0.5]), np.array([1.1, 1.7, 0.8]), np.array([0.0, 0.4, 1.0])
    turns = [size * rate**k * np.sin(rate * t + phase + k * np.pi / 2) for k in range(5)]
    yaw = 0.6 * np.sin(0.9 * t), 0.54 * np.cos(0.9 * t), -0.486 * np.sin(0.9 * t)
    return np.concatenate([*turns, yaw])


def model_force(x, t, gains=(3.0, 2.0)):
    r = lissajous(t)
    return MASS * (r[6:9] + WEIGHT - gains[0] * (x[:3] - r[:3]) - gains[1] * (x[6:9] - r[3:6]))


def model_attitude(x, t):
    b3 = model_force(x, t)
    b3 = b3 / np.sqrt((b3 * b3).sum())
    yaw = lissajous(t)[15]
    side = np.cross(b3, np.array([np.cos(yaw), np.sin(yaw), 0 * yaw]))
    b2 = side / np.sqrt((side * side).sum())
    return np.stack([np.cross(b2, b3), b2, b3], axis=1)


def near_reference(t, seed):
    """A state off the reference by a little."""
    r, rng = lissajous(t), np.random.default_rng(seed)
    offset = rng.normal(size=12) * np.repeat([0.3, 0.15, 0.4, 0.8], 3)
    return np.concatenate([r[:3], np.zeros(3), r[3:6], np.zeros(3)]) + offset


def loop(x, t):
    """x' of the closed loop with the continuous law."""
    return derivative(x, track(BODY, GAINS, x[None], lissajous(t)[None])["wrench"][0])


def test_derivatives_of_force_and_attitude_follow_from_the_model_by_complex_steps():
    """f_c' and omega_d need only x' and t' = 1: a complex step of the model in that direction gives them."""
    for seed in range(1000):
        t = 0.37 * seed
        x = near_reference(t, seed)
        terms = track(BODY, GAINS, x[None], lissajous(t)[None])
        assert np.abs(terms["force"][0] - model_force(x, t)).max() < 1e-12
        xdot = derivative(x, terms["wrench"][0])
        rate = jacobian(lambda s, x=x, t=t, d=xdot: model_force(x + s[0] * d, t + s[0]), [0.0])[:, 0]
        assert np.abs(terms["force_rate"][0] - rate).max() < 1e-10 * max(1, np.abs(rate).max())
        spin = jacobian(lambda s, x=x, t=t, d=xdot: model_attitude(x + s[0] * d, t + s[0]).ravel(), [0.0])
        omega_d = vee(model_attitude(x, t).T @ spin.reshape(3, 3))
        assert np.abs(terms["omega_d"][0] - omega_d).max() < 1e-10 * max(1, np.abs(omega_d).max())
        thrust_rate = jacobian(
            lambda s, x=x, t=t, d=xdot: (
                model_force(x + s[0] * d, t + s[0]) @ body_to_inertial(x[3:6] + s[0] * d[3:6])[:, 2]
            )[None],
            [0.0],
        )[0, 0]
        assert terms["thrust_rate"][0] == pytest.approx(thrust_rate, rel=1e-9, abs=1e-9)


def test_torque_is_the_printed_law_of_its_own_terms():
    for seed in range(200):
        t = 0.37 * seed
        x = near_reference(t, seed)
        terms = {k: v[0] for k, v in track(BODY, GAINS, x[None], lissajous(t)[None]).items()}
        desired, body, omega = model_attitude(x, t), body_to_inertial(x[3:6]), x[9:]
        error = vee(desired.T @ body - body.T @ desired) / 2
        across = body.T @ desired
        assert np.abs(terms["e_r"] - error).max() < 1e-13
        assert np.abs(terms["e_omega"] - (omega - across @ terms["omega_d"])).max() < 1e-12
        feed = hat(omega) @ across @ terms["omega_d"] - across @ terms["omega_d_rate"]
        gains = np.array([0.35, 0.35, 0.12]), np.array([0.025, 0.025, 0.012])
        torque = (
            -gains[0] * error
            - gains[1] * terms["e_omega"]
            + np.cross(omega, INERTIA * omega)
            - INERTIA * feed
        )
        assert np.abs(terms["wrench"][1:] - torque).max() < 1e-12


def differences(gains, seconds=0.6, h=1e-3, start=None, reference=lissajous):
    """Rates along a closed loop, ours and by differences of fourth order."""
    x = near_reference(0.0, 5) if start is None else start
    rows = []

    def law(t, x):
        return track(BODY, gains, x[None], reference(t)[None])

    for i in range(round(seconds / h)):
        rows.append({k: v[0] for k, v in law(i * h, x).items()})
        x = rk4(lambda t, y, i=i: derivative(y, law(i * h + t, y)["wrench"][0]), x, h)
    columns = {k: np.array([r[k] for r in rows]) for k in rows[0]}

    def measured(v):
        return (8 * (v[3:-1] - v[1:-3]) - (v[4:] - v[:-4])) / (12 * h)

    columns["thrust"] = columns["wrench"][:, 0]
    return {
        (value, rate): (columns[rate][2:-2], measured(columns[value]))
        for value, rate in [
            ("force", "force_rate"),
            ("force_rate", "force_acceleration"),
            ("omega_d", "omega_d_rate"),
            ("thrust", "thrust_rate"),
            ("thrust_rate", "thrust_acceleration"),
        ]
    }


def test_second_derivatives_agree_with_differences_along_a_closed_loop():
    for names, (ours, measured) in differences(GAINS).items():
        assert np.abs(ours - measured).max() < 1e-6 * max(1, np.abs(measured).max()), names


def test_derivatives_of_a_limited_force_are_those_of_the_limited_force():
    """Far from the reference both limits act; their derivatives must still be true ones."""
    far = near_reference(0.0, 5)
    far[:3] += [4.0, -3.0, 1.0]
    gains = TrackingGains(max_tilt_rad=0.6, max_thrust_share=0.5, catch_up_m_s=2.0)
    free = track(BODY, GAINS, far[None], lissajous(0.0)[None])["force"][0]
    held = track(BODY, gains, far[None], lissajous(0.0)[None])["force"][0]
    assert np.linalg.norm(free[:2]) > 2 * np.linalg.norm(held[:2])
    for names, (ours, measured) in differences(gains, seconds=0.3, start=far).items():
        assert np.abs(ours - measured).max() < 1e-6 * max(1, np.abs(measured).max()), names


def test_a_moving_reference_is_flown_exactly():
    """From a consistent start the closed loop (RK4, 2 ms, continuous law) stays on the curve, for 2 s."""
    x = consistent_state()
    worst = 0.0
    for i in range(1000):
        t = 0.002 * i
        worst = max(worst, np.abs(x[:3] - lissajous(t)[:3]).max())
        x = rk4(lambda s, y, t=t: loop(y, t + s), x, 0.002)
    assert worst < 1e-9


def consistent_state():
    """State that flatness requires at t = 0."""
    from scipy.spatial.transform import Rotation

    r = lissajous(0.0)
    x = np.concatenate([r[:3], np.zeros(3), r[3:6], np.zeros(3)])
    q = Rotation.from_matrix(model_attitude(x, 0.0)).as_quat()
    x[3:6] = q[:3] / (1 + q[3])
    # Only then do e_a and e_j vanish, so that omega_d is the rate of the reference.
    x[9:] = track(BODY, TrackingGains(uses_acceleration=False), x[None], r[None])["omega_d"][0]
    return x


def test_without_estimates_the_errors_of_acceleration_and_jerk_are_dropped():
    gains = TrackingGains(uses_acceleration=False)
    for case in CASES:
        x, r = state_of(case), reference_of(case)
        terms = track(BODY, gains, x, r)
        e_v = x[0, 6:9] - r[0, 3:6]
        assert np.abs(terms["force_rate"][0] - MASS * (r[0, 9:12] - 3 * e_v)).max() < 1e-12
        assert np.abs(terms["force_acceleration"][0] - MASS * r[0, 12:15]).max() < 1e-12


def test_errors_of_acceleration_follow_the_applied_thrust():
    x, r = state_of(CASES[0]), reference_of(CASES[0])
    own = track(BODY, GAINS, x, r)
    same = track(BODY, GAINS, x, r, applied_thrust=own["wrench"][:, 0].copy())
    assert all((own[k] == same[k]).all() for k in own)
    other = track(BODY, GAINS, x, r, applied_thrust=own["wrench"][:, 0] + 0.5)
    axis = body_to_inertial(x[0, 3:6])[:, 2]
    expected = own["force_rate"][0] - 2.0 * 0.5 * axis
    assert np.abs(other["force_rate"][0] - expected).max() < 1e-12
    assert (other["force"] == own["force"]).all()


def test_a_point_is_tracked_like_the_translation_of_a_body():
    x, r = random_states(100, seed=19), np.random.default_rng(20).normal(size=(100, 18))
    for gains in (GAINS, TrackingGains(kp=5.0, kv=3.0, catch_up_m_s=1.0)):
        assert (track_point(gains, x, r) == track(BODY, gains, x, r)["acceleration"]).all()
    by_hand = r[:, 6:9] - 3 * (x[:, :3] - r[:, :3]) - 2 * (x[:, 6:9] - r[:, 3:6])
    assert np.abs(track_point(GAINS, x, r) - by_hand).max() < 1e-12


def test_a_held_vehicle_does_not_ask_for_ever_more():
    x, r = np.zeros((1, 12)), np.zeros((1, 18))
    x[0, 0] = -40.0
    pull = track(BODY, TrackingGains(catch_up_m_s=1.5), x, r)["acceleration"][0]
    assert pull == pytest.approx([1.5 * 2.0, 0, 0])
    assert track(BODY, GAINS, x, r)["acceleration"][0] == pytest.approx([120.0, 0, 0])


@pytest.mark.parametrize("tilt", [0.3, 1.0, np.inf])
@pytest.mark.parametrize("share", [0.5, 0.9, np.inf])
def test_the_commanded_force_keeps_its_limits(tilt, share):
    gains = TrackingGains(max_tilt_rad=tilt, max_thrust_share=share)
    x = random_states(500, seed=11, speed=20.0)
    x[:, :3] *= 10
    r = np.zeros((500, 18))
    terms = track(BODY, gains, x, r)
    force = terms["force"]
    assert (np.linalg.norm(force, axis=1) <= share * BODY.max_thrust * (1 + 1e-12)).all()
    if tilt < 2:
        assert (np.hypot(force[:, 0], force[:, 1]) <= np.tan(tilt) * force[:, 2] * (1 + 1e-12)).all()
    if np.isfinite(min(tilt, share)):
        assert (force[:, 2] >= 0.05 * MASS * GRAVITY - 1e-12).all()
        asked = terms["acceleration"] + WEIGHT
        assert np.abs(MASS * asked - force).max() < 1e-12 * np.abs(force).max()


def test_a_demand_without_direction_holds_the_attitude():
    x = random_states(100, seed=12, rate=0.0)
    x[:, 6:9] = 0
    r = np.zeros((100, 18))
    r[:, :3], r[:, 8] = x[:, :3], -GRAVITY  # free fall
    terms = track(BODY, GAINS, x, r)
    assert np.abs(terms["wrench"]).max() < 1e-12
    assert np.abs(terms["omega_d"]).max() == 0


def test_a_demand_along_the_heading_has_a_finite_attitude():
    """f_c within and around the direction of the heading: b2 stays left of it."""
    for angle in np.linspace(-0.1, 0.1, 21):
        x, r = np.zeros((1, 12)), np.zeros((1, 18))
        r[0, 6:9] = np.array([np.cos(angle), 0, np.sin(angle)]) * 12 - [0, 0, GRAVITY]
        terms = track(BODY, GAINS, x, r)
        assert all(np.isfinite(v).all() for v in terms.values())
        # With b2 = y the error turns the body about y alone.
        if angle >= 0:
            assert np.abs(terms["e_r"][0, [0, 2]]).max() < 1e-12


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_numbers_that_are_not_finite_come_back_as_such(bad):
    for place in range(12):
        x = state_of(CASES[0])
        x[0, place] = bad
        terms = track(BODY, GAINS, x, reference_of(CASES[0]))
        assert not np.isfinite(terms["wrench"]).all()


@pytest.mark.parametrize(
    "wrong",
    [{"kp": 0.0}, {"kv": np.inf}, {"k_r": (1, -1, 1)}, {"catch_up_m_s": np.nan}, {"max_tilt_rad": -1.0}],
)
def test_gains_without_meaning_are_refused(wrong):
    with pytest.raises(ValueError, match="must be positive"):
        TrackingGains(**wrong)


def test_realised_accelerations():
    x, r = random_states(200, seed=13), np.zeros((200, 18))
    r[:, :15] = np.random.default_rng(14).normal(size=(200, 15))
    r[:, :3] += x[:, :3]
    nominal = track(BODY, GAINS, x, r)
    same = realise(BODY, GAINS, x, r, nominal["acceleration"].copy())
    assert (same == nominal["wrench"]).all()
    asked = np.random.default_rng(15).normal(size=(200, 3)) * 4
    u = realise(BODY, GAINS, x, r, asked)
    axis = np.stack([body_to_inertial(s)[:, 2] for s in x[:, 3:6]])
    thrust = (MASS * (asked + WEIGHT) * axis).sum(axis=1)
    assert np.abs(u[:, 0] - thrust).max() < 1e-12
    # A correction of nothing, but not bit by bit, changes nothing but rounding.
    close = realise(BODY, GAINS, x, r, nominal["acceleration"] * (1 + 1e-13))
    assert np.abs(close - nominal["wrench"]).max() < 1e-8 * np.abs(nominal["wrench"]).max()


def test_body_rates_are_one_step_and_clipped():
    x = random_states(100, seed=16)
    u = np.random.default_rng(17).normal([4.5, 0, 0, 0], [0, 0.3, 0.3, 0.05], (100, 4))
    ours = body_rates(BODY, x, u, dt_s=0.005, max_rate_rad_s=(6.0, 5.0, 2.0))
    for state, command, rate in zip(x, u, ours, strict=True):
        free = rk4(lambda t, w, c=command: (c[1:] - np.cross(w, INERTIA * w)) / INERTIA, state[9:], 0.005)
        assert np.abs(rate - np.clip(free, [-6, -5, -2], [6, 5, 2])).max() < 1e-12
    u[:, 2] = np.nan
    assert (body_rates(BODY, x, u, dt_s=0.005, max_rate_rad_s=(6.0, 5.0, 2.0)) == 0).all()


def test_a_reference_curve_is_its_polynomials_and_rests_beyond():
    from alula.stages.planning.trajectory import evaluate

    rng = np.random.default_rng(18)
    time, coefficient = np.array([0.5, 1.0, 2.5, 2.75]), rng.normal(size=(3, 4, 8))
    curve = ReferenceCurve(time, coefficient)
    t = np.sort(rng.uniform(0.5, 2.75, 500))
    rows = curve.at(t)
    for order in range(5):
        expected = evaluate(time, coefficient, t, order)
        scale = np.abs(expected).max()
        assert np.abs(rows[:, 3 * order : 3 * order + 3] - expected[:, :3]).max() < 1e-12 * scale
        if order < 3:
            assert np.abs(rows[:, 15 + order] - expected[:, 3]).max() < 1e-12 * scale
    outside = curve.at(np.array([-1.0, 0.4999, 2.75, 9.0, np.inf, np.nan]))
    ends = evaluate(time, coefficient, [0.5, 2.75])
    assert np.abs(outside[:2, [0, 1, 2, 15]] - ends[0]).max() < 1e-12
    assert np.abs(outside[2:, [0, 1, 2, 15]] - ends[1]).max() < 1e-12
    assert not outside[:, 3:15].any()
    assert not outside[:, 16:].any()
    assert curve.duration_s == 2.25


@pytest.mark.parametrize(
    "time", [np.zeros(1), np.array([0.0, 0.0]), np.array([0.0, np.nan]), np.array([0.0, 1.0, 2.0])]
)
def test_curves_without_meaning_are_refused(time):
    with pytest.raises(ValueError, match=r"a reference|knots"):
        ReferenceCurve(time, np.zeros((1, 4, 8)))
