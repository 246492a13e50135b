"""What a shield flies where nothing is certified, or where the margin is not kept already."""

import numpy as np
import pytest

from alula import _core
from support.models.wrench_flight import (
    BACKUP,
    RADIUS,
    RECOVERING,
    VEHICLE,
    Flight,
    Scene,
    attitude_controlled,
    moving,
    wall_scene,
)


def test_where_nothing_is_safe_the_least_bad_is_flown_and_said():
    scene = wall_scene()
    policy = _core.BackupPolicy(VEHICLE, "brake")
    x = moving((6, 0, 0), (2.2, 0, 0))
    for flown in (_core.ConeEcbf(policy, scene.index), _core.ConeBackup(policy, scene.index)):
        report = flown.filter(
            x, (0, 0, 0), wrench=(VEHICLE.hover_thrust, 0, 0, 0), thrust=VEHICLE.hover_thrust
        )
        assert report["status"] == 3
        assert not report["certified"]
        np.testing.assert_array_equal(report["wrench"], policy.urgent(x))
    assert scene.radius == RADIUS


def test_what_is_flown_when_nothing_is_safe_does_not_speed_up():
    """Turning on at 12 rad/s before a wall, as a brake does that overshoots its tilt by an unknown lag."""
    scene, policy, gentle = wall_scene(), _core.BackupPolicy(VEHICLE, "brake"), []
    for rate in (-12.0, -6.0, 6.0, 12.0):
        for speed in (1.5, 3.0):
            x = moving((speed, 0, 0), (2.75 - 0.06 * speed, 0, 0))
            x[10] = rate
            flown = _core.ConeEcbf(policy, scene.index)
            flight = Flight(
                scene, VEHICLE, flown, x, lambda tick, x: VEHICLE.allocation @ np.full(4, 4.25), 60
            )
            unsafe = next((i for i, r in enumerate(flight.reports) if r["status"] != 3), 60)
            assert unsafe > 5
            path = flight.positions[: 10 * unsafe + 1]
            path = path[path[:, 0] < 3]
            assert np.linalg.norm(np.diff(path, axis=0), axis=1).max() < 1.15e-3 * speed
            braked = x[None]
            for _ in range(60):
                braked = VEHICLE.step(braked, np.array([policy(braked[0])]), dt_s=0.01)
                gentle.append(np.linalg.norm(braked[0, 6:9]) / speed)
    assert max(gentle) > 1.5  # of the policy itself


@pytest.mark.parametrize("clearance", [0.008, 0.001, -0.004])
def test_a_rest_nearer_than_what_is_kept_can_be_left_too(clearance):
    """Only a disturbance brings it there. Nothing is certified until it has left; it flies no nearer."""
    scene, policy = wall_scene(), _core.BackupPolicy(VEHICLE, "brake")
    start = moving((0, 0, 0), (3 - 0.02 - RADIUS - clearance, 0, 0))
    for sign in (-1, 1):

        def along(tick, x, sign=sign):
            return attitude_controlled(
                VEHICLE, x, 2 * (np.array([0.5 * sign, 0, 0]) - x[6:9]) - [0, 0, 2 * x[2]]
            )

        flight = Flight(scene, VEHICLE, _core.ConeBackup(policy, scene.index), start, along, 150)
        assert not flight.reports[0]["certified"]
        assert flight.reports[0]["status"] == RECOVERING
        assert flight.clearance >= clearance - 1e-3
        assert flight.state[0] < start[0] + (-0.2 if sign < 0 else 1e-3)
        assert sign > 0 or flight.reports[-1]["certified"]


def test_many_slow_ticks_bring_a_vehicle_in_the_margin_no_nearer():
    """Held between two walls whose rows contradict each other, it is asked to creep into one of them."""
    clearance = 0.005
    far = 3 - 2 * (0.02 + RADIUS + clearance)
    mean = np.array(
        [[x, y, z] for x in (3, far) for y in np.arange(-3, 3.1, 0.5) for z in np.arange(-3, 3.1, 0.5)]
    )
    scene = Scene(mean, np.tile([0.02, 0.5, 0.5], (len(mean), 1)), np.tile([1, 0, 0, 0], (len(mean), 1)))
    start = moving((0, 0, 0), (3 - 0.02 - RADIUS - clearance, 0, 0))
    for kind in (_core.ConeEcbf, _core.ConeBackup):
        flown = kind(_core.BackupPolicy(VEHICLE, "brake"), scene.index)
        flight = Flight(
            scene,
            VEHICLE,
            flown,
            start,
            lambda tick, x: attitude_controlled(
                VEHICLE, x, 3 * (np.array([0.01, 0, 0]) - x[6:9]) - [0, 0, 2 * x[2]]
            ),
            200,
        )
        assert flight.count(RECOVERING) == 200
        assert flight.clearance >= clearance - 1e-3


def test_a_rest_inside_the_margin_can_be_left_but_not_towards_the_wall():
    """Where a last drift ends no path keeps the whole margin; what flies away is accepted all the same."""
    scene = wall_scene()
    policy = _core.BackupPolicy(VEHICLE, "brake")
    for clearance in (0.019, 0.0145, 0.012):
        start = moving((0, 0, 0), (3 - 0.02 - RADIUS - clearance, 0, 0))
        for sign in (-1, 1):
            flown = _core.ConeBackup(policy, scene.index)
            flight = Flight(
                scene,
                VEHICLE,
                flown,
                start,
                lambda tick, x, sign=sign: attitude_controlled(
                    VEHICLE, x, 2 * (np.array([0.5 * sign, 0, 0]) - x[6:9]) - [0, 0, 2 * x[2]]
                ),
                150,
            )
            assert all(report["certified"] for report in flight.reports)
            assert flight.clearance >= 0.01
            if sign < 0:
                assert flight.state[0] < start[0] - 0.2
                assert flight.count(BACKUP) < 20
