"""A constant disturbance in the shield's rollouts: what it certifies is what a body in that wind flies."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from alula import _core
from support.models import quadrotor_model as model
from support.models.wrench_flight import VEHICLE, moving, shield_of, wall_scene

G = VEHICLE.gravity
INERTIA = np.array(VEHICLE.inertia)
TICK = 0.01


def level_of(disturbance):
    """The turn S that makes g e3 - d vertical, and the scale of the thrust."""
    up = np.array([0, 0, G]) - disturbance
    axis = np.cross(up, [0, 0, 1])
    sine = np.linalg.norm(axis)
    angle = np.arctan2(sine, up[2])
    return Rotation.from_rotvec(angle * axis / sine if sine else np.zeros(3)), np.linalg.norm(up) / G


def flown_to_rest(level_state, disturbance, policy, seconds=3.0):
    """Positions of the body in the wind, flown by the policy that sees levelled attitudes, shape (T, 3)."""
    turn, scale = level_of(disturbance)
    attitude = turn.inv() * Rotation.from_mrp(level_state[3:6])
    y = np.concatenate([level_state[:3], level_state[6:9], attitude.as_matrix().ravel(), level_state[9:]])

    def rate(_, y, thrust, torque):
        matrix, omega = y[6:15].reshape(3, 3), y[15:]
        force = scale * thrust / VEHICLE.mass * matrix[:, 2]
        return np.concatenate(
            [
                y[3:6],
                force - [0, 0, G] + disturbance,
                (matrix @ model.hat(omega)).ravel(),
                (torque - np.cross(omega, INERTIA * omega)) / INERTIA,
            ]
        )

    path = [y[:3]]
    for _ in range(round(seconds / TICK)):
        seen = (turn * Rotation.from_matrix(y[6:15].reshape(3, 3))).as_mrp()
        wrench = policy(np.concatenate([y[:3], seen, y[3:6], y[15:]]))
        solved = solve_ivp(
            rate, (0, TICK), y, args=(wrench[0], wrench[1:]), rtol=1e-9, atol=1e-10, max_step=TICK
        )
        y = solved.y[:, -1]
        path.append(y[:3])
    return np.array(path)


def farthest(is_safe):
    """The largest place before the wall that is safe [m]."""
    low, high = -1.0, 3.0
    while high - low > 5e-4:
        middle = (low + high) / 2
        low, high = (middle, high) if is_safe(middle) else (low, middle)
    return low


@pytest.mark.parametrize("axis", [0, 1])  # upwards other manoeuvres are certified beyond where braking is
@pytest.mark.parametrize("disturbance", [(2.7, 0.0, 0.0), (1.5, -2.0, 0.4), (-2.7, 0.5, 0.0)], ids=str)
def test_what_is_certified_is_what_the_body_flies_in_the_wind(disturbance, axis):
    """The wall, the flight and the wind are turned together."""
    scene, policy = wall_scene(axis), _core.BackupPolicy(VEHICLE, "brake")
    x, along, wind = moving(np.roll((2.5, 0.3, 0), axis)), np.eye(3)[axis], np.roll(disturbance, axis)
    x[3:6] = 0.05, -0.08, 0.0
    path = flown_to_rest(x, wind, policy)
    shield = shield_of(scene)

    def certified(start):
        x[:3] = start * along
        return shield.certify(x)["safe"]

    true = farthest(lambda start: float(scene.clearance(path + start * along)) > 0.02)
    without = farthest(certified)
    shield.see(disturbance_m_s2=tuple(wind))
    assert farthest(certified) == pytest.approx(true, abs=1e-3)
    assert abs(without - true) > 0.01  # wrong, if the wind is ignored


def test_a_manoeuvre_that_only_the_wind_makes_touch_a_wall_is_not_certified():
    scene = wall_scene()
    policy = _core.BackupPolicy(VEHICLE, "brake")
    wind = np.array([0.0, 0.0, -2.7])  # downwards: thrust that brakes the fall is scaled, and so is the tilt
    verdicts = []
    for start in np.arange(0.9, 2.3, 0.02):
        x = moving((2.5, 0, 0), p=(start, 0, 0))
        shield = shield_of(scene)
        still = shield.certify(x)["safe"]
        shield.see(disturbance_m_s2=tuple(wind))
        windy = shield.certify(x)["safe"]
        clear = float(scene.clearance(flown_to_rest(x, wind, policy, 2.0))) if still != windy else None
        verdicts.append((still, windy, clear))
    changed = [(windy, clear) for still, windy, clear in verdicts if still != windy]
    assert changed  # the wind decides somewhere
    for windy, clear in changed:
        assert windy == (clear > 0.015)
