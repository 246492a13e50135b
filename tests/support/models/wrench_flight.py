"""Closed loops of wrench filters in the model, judged on the continuous path."""

import numpy as np

from alula import _core
from support.models import quadrotor_model as body

OK, FILTERED, RECOVERING, REFUSED, BACKUP = 0, 1, 3, 4, 5
RADIUS = 0.15
VEHICLE = body.fastbridge()
HOVER = VEHICLE.hover_thrust
RANGES = np.abs(VEHICLE.allocation) @ np.full(4, 4.25)  # of thrust and torque, what rows are scaled by


def tick(flown, x, wrench, thrust=HOVER, thrust_rate=0.0, **nominal):
    """One call of a filter that the controller asks for a wrench."""
    return flown.filter(x, (0, 0, 0), wrench=tuple(wrench), thrust=thrust, thrust_rate=thrust_rate, **nominal)


def shield_of(scene, kind="brake", **options):
    """A shield of the test vehicle."""
    return _core.Shield(_core.BackupPolicy(VEHICLE, kind), scene.index, _core.ShieldOptions(**options))


def moving(v, p=(0, 0, 0)):
    """A level state."""
    return np.array([*p, 0, 0, 0, *v, 0, 0, 0], float)


def random_case(rng, count):
    """A scene of so many Gaussians, a state among them, and a wrench to ask for."""
    scene = random_scene(rng, count, size=2.5)
    x = np.concatenate(
        [0.3 * rng.normal(size=3), 0.1 * rng.normal(size=3), rng.normal(size=3), rng.normal(size=3)]
    )
    return scene, x, np.array([HOVER + rng.normal(), *rng.normal(0, 0.02, 3)])


class Scene:
    """Gaussians at level 1."""

    def __init__(self, mean, scale, quat_wxyz, radius=RADIUS):
        rows = [np.ascontiguousarray(a, np.float32) for a in (mean, scale, quat_wxyz)]
        self.radius = radius
        self.index = _core.EllipsoidIndex(*rows, sigma=1.0, radius=radius)
        self.exact = _core.EllipsoidSet(*rows, 1.0)

    def clearance(self, positions):
        """Least distance of the polyline through positions (N, 3) to an ellipsoid, less the radius."""
        rows = np.ascontiguousarray(positions)
        return self.exact.clearance(rows[:-1], rows[1:], 10.0, 1).min() - self.radius


def random_scene(rng, count=150, size=4.0):
    quat = rng.normal(size=(count, 4))
    return Scene(rng.uniform(-size, size, (count, 3)), rng.uniform(0.05, 0.4, (count, 3)), quat)


def empty_scene():
    return Scene([[1e3, 1e3, 1e3]], [[0.1, 0.1, 0.1]], [[1, 0, 0, 0]])


def wall_scene(axis=0):
    """A wall at x = 3, or y or z, flat to 2 cm, made of overlapping discs."""
    y, z = np.meshgrid(np.arange(-3, 3.1, 0.5), np.arange(-3, 3.1, 0.5))
    mean = np.stack([np.full(y.size, 3.0), y.ravel(), z.ravel()], axis=1)
    scale = np.roll([0.02, 0.5, 0.5], axis)
    return Scene(np.roll(mean, axis, axis=1), np.tile(scale, (y.size, 1)), np.tile([1, 0, 0, 0], (y.size, 1)))


def attitude_controlled(vehicle, x, acceleration):
    """The wrench that turns the thrust towards an acceleration, within the rotors' limits."""
    f = vehicle.mass * (np.asarray(acceleration, float) + vehicle.gravity * body.E3)
    inertial = body.body_to_inertial(x[3:6])
    axis = inertial.T @ (f / np.linalg.norm(f))
    torque = 0.26 * np.array([-axis[1], axis[0], 0]) - 0.025 * x[9:12] * [1, 1, 0.5]
    return vehicle.limited(np.array([[f @ inertial[:, 2], *torque]]))[0]


class Flight:
    """What a closed loop did; inputs held for 10 ms on a plant stepped at 1 kHz."""

    def __init__(self, scene, vehicle, flown, x, nominal, ticks):
        positions, self.reports = [x[:3]], []
        thrust, rate = vehicle.hover_thrust, 0.0
        for tick in range(ticks):
            u = nominal(tick, x)
            report = flown.filter(x, (0, 0, 0), wrench=tuple(u), thrust=thrust, thrust_rate=rate)
            self.reports.append(report)
            wrench = np.array([report["wrench"]])
            assert vehicle.admissible(wrench, tolerance_n=1e-7)[0]
            if report["status"] == OK:
                assert report["wrench"] == [float(value) for value in u]
            thrust, rate = wrench[0, 0], report["thrust_rate"]
            row = x[None]
            for _ in range(10):
                row = vehicle.step(row, wrench, dt_s=0.001)
                positions.append(row[0, :3])
            x = row[0]
            x[3:6] = _core.shadowed(np.ascontiguousarray(x[None, 3:6]))[0]
        self.state, self.positions = x, np.array(positions)
        self.clearance = scene.clearance(self.positions)

    def count(self, status):
        return sum(report["status"] == status for report in self.reports)


def admissible_start(rng, shield, tries=1000):
    """A random state with a safe manoeuvre to rest."""
    for _ in range(tries):
        x = np.concatenate(
            [
                rng.uniform(-3, 3, 3),
                0.1 * rng.normal(size=3),
                1.5 * rng.normal(size=3),
                0.5 * rng.normal(size=3),
            ]
        )
        if shield.certify(x)["safe"]:
            return x
    raise AssertionError("no start is safe in this scene")
