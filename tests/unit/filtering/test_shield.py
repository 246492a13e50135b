"""Certified manoeuvres to rest, and flights that return only inputs which leave one."""

import numpy as np
import pytest

from alula import _core
from alula.schemas.scenarios.vehicle import read_vehicle
from alula.stages.vehicles.bodies import quadrotor
from support.models import backup_model as model
from support.models.wrench_flight import (
    BACKUP,
    VEHICLE,
    Flight,
    Scene,
    admissible_start,
    attitude_controlled,
    empty_scene,
    moving,
    random_scene,
    shield_of,
    wall_scene,
)
from support.paths import VEHICLES


@pytest.mark.every(3)
@pytest.mark.parametrize("kind", ["heading-invariant", "hover", "brake"])
def test_certificates_agree_with_manoeuvres_flown_in_the_model(kind):
    """Safe: the flown path keeps the margin. Not safe though at rest: it does not, but for the sag."""
    numpy, margin, verdicts = model.MODELS[kind](), 0.02, []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        scene = random_scene(rng, 40)
        shield = shield_of(scene, kind)
        for _ in range(4):
            x = np.concatenate(
                [rng.uniform(-3, 3, 3), 0.2 * rng.normal(size=3), rng.normal(size=3), rng.normal(size=3)]
            )
            first = np.array([4.0, *rng.uniform(-0.03, 0.03, 3)]) if rng.random() < 0.5 else None
            got = shield.certify(x, first=None if first is None else tuple(first), thorough=True)
            assert got["rests"]
            ticks = round(got["time_s"] / 0.01)
            positions, states = model.manoeuvre(VEHICLE, numpy, x, 0.01, ticks, first=first)
            assert np.linalg.norm(states[-1, 6:9]) < 0.1
            clearance = scene.clearance(positions)
            verdicts.append(got["safe"])
            if got["safe"]:
                assert clearance >= margin
            else:
                assert clearance < margin + 2e-3
                assert got["clearance_m"] < margin + 1e-9
    assert any(verdicts)
    assert not all(verdicts)


def test_an_escape_is_flown_for_its_ticks_and_then_rests():
    shield, x = shield_of(empty_scene(), "cone-escape"), moving((3, 0, 0))
    hold = np.array([0, 3.0, 0.5])
    got = shield.certify(x, hold=hold, hold_ticks=60)
    _, states = model.manoeuvre(
        VEHICLE, model.Brake(), x, 0.01, round(got["time_s"] / 0.01), hold=hold, hold_ticks=60
    )
    assert got["safe"]
    assert states[60, 7] > 2
    assert np.linalg.norm(states[-1, 6:9]) < 0.1


def test_at_rest_little_is_left_to_drift():
    scene = empty_scene()
    for kind in ("hover", "heading-invariant", "brake"):
        shield, numpy = shield_of(scene, kind), model.MODELS[kind]()
        got = shield.certify(moving((2, -1, 0.5)))
        positions, _ = model.manoeuvre(
            VEHICLE, numpy, moving((2, -1, 0.5)), 0.01, round(got["time_s"] / 0.01) + 300
        )
        rest = positions[10 * round(got["time_s"] / 0.01) :]
        assert np.linalg.norm(rest - rest[0], axis=1).max() < 0.01  # half the margin


def test_what_does_not_rest_in_time_is_not_safe():
    shield = shield_of(empty_scene(), "hover", max_time_s=2.0)
    got = shield.certify(moving((5, 0, 0)))
    assert not got["rests"]
    assert not got["safe"]


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e200])
def test_states_without_meaning_are_not_safe(bad):
    shield = shield_of(empty_scene())
    for i in range(12):
        x = np.zeros(12)
        x[i] = bad
        got = shield.certify(x)
        assert not got["safe"] or (bad == 1e200 and i < 3)


def test_a_thin_obstacle_between_ticks_is_seen():
    """A needle across the path at 12 m/s, 12 cm from tick to tick."""
    for offset in np.linspace(0, 0.12, 9):
        needle = Scene([[1 + offset, 0, 0]], [[1e-3, 3.0, 1e-3]], [[1, 0, 0, 0]], radius=0.01)
        assert not shield_of(needle).certify(moving((12, 0, 0)))["safe"]


def test_the_margin_is_kept_to_the_wall():
    scene, shield = wall_scene(), None
    shield = shield_of(scene)
    far = [x for x in np.linspace(-3, 2.8, 117) if shield.certify(moving((4, 0, 0), (x, 0, 0)))["safe"]]
    positions, _ = model.manoeuvre(VEHICLE, model.Brake(), moving((4, 0, 0), (max(far), 0, 0)), 0.01, 250)
    assert 0.02 - 0.01 <= scene.clearance(positions) < 0.02 + 0.06  # steps of 5 cm


def swinging(rng, yaw):
    """A slow, nearly level state; sigma = tan(yaw / 4) e3 composed with a small tilt in the body's axes."""
    a, b = 0.0249 * rng.normal(size=2) * np.exp(rng.uniform(-4, 0))
    q0, q1 = np.array([np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)]), np.array([1, a, b, 0])
    w = q0[0] * q1[0] - q0[1:] @ q1[1:]
    v = q0[0] * q1[1:] + q1[0] * q0[1:] + np.cross(q0[1:], q1[1:])
    sigma = v / (w + np.sqrt(w * w + v @ v))
    speed, rate = np.exp(rng.uniform(-4, 0, 2))
    return np.array([0, 0, 0, *sigma, *0.05 * speed * rng.normal(size=3), *0.1 * rate * rng.normal(size=3)])


@pytest.mark.parametrize("kind", ["hover", "heading-invariant", "brake"])
@pytest.mark.parametrize("tick", [0.01, 0.05])
def test_what_counts_as_rest_stays_within_half_the_margin(kind, tick):
    """Also where the drift is nothing because the vehicle swings out and back, and with any heading."""
    shield, policy = shield_of(empty_scene(), kind, tick_s=tick), _core.BackupPolicy(VEHICLE, kind)
    rng, rests = np.random.default_rng(1), 0
    for _ in range(3000):
        yaw = rng.uniform(-3.1, 3.1) * (np.exp(rng.uniform(-6, 0)) if kind == "hover" else 1)
        x = swinging(rng, yaw)
        got = shield.certify(x)
        if not got["safe"] or got["time_s"] > 0:
            continue
        rests += 1
        for _ in range(round(1.0 / tick)):
            x = np.array(shield.after(x, tuple(policy(x))))
            assert np.linalg.norm(x[:3]) < 0.01
        if rests == 25:
            break
    assert rests > 10


@pytest.mark.parametrize("kind", ["hover", "heading-invariant", "brake"])
def test_states_near_rest_go_little_beyond_their_excursion(kind):
    """The shield takes twice that as free when it ends a rollout at four times what counts as rest."""
    policy, rng, worst = _core.BackupPolicy(VEHICLE, kind), np.random.default_rng(2), 0.0
    for _ in range(60):
        yaw = rng.uniform(-3.1, 3.1) if kind != "hover" else rng.uniform(-0.05, 0.05)
        x = swinging(rng, yaw)
        x[6:9] *= 0.4 * rng.uniform(0.7, 1) / np.linalg.norm(x[6:9])
        x[9:] *= 0.8 * rng.uniform(0, 1) / np.linalg.norm(x[9:])
        bound, farthest = policy.excursion(x), 0.0
        for _ in range(150 if kind == "brake" else 400):
            x = VEHICLE.step(x[None], np.array(policy(x))[None], dt_s=0.01)[0]
            farthest = max(farthest, np.linalg.norm(x[:3]))
        worst = max(worst, farthest / bound)
    assert 0.5 < worst < 1.3


@pytest.mark.parametrize(
    ("gains", "ends_early"),
    [
        ({}, True),
        ({"full_tilt_speed_m_s": 5.0}, True),
        ({"torque_share": 0.05}, False),  # goes 14 times as far as the loop without caps would
        ({"attitude_rad_s": 5.0}, False),
        ({"tilt_rad": 0.1, "full_tilt_speed_m_s": 0.1}, False),
    ],
)
def test_rollouts_end_early_only_where_caps_let_them(gains, ends_early):
    policy = _core.BackupPolicy(VEHICLE, "brake", _core.BackupGains(**gains))
    assert _core.Shield(policy, empty_scene().index).ends_early == ends_early


@pytest.mark.parametrize("name", ["fastbridge", "crazyflie21", "racer7"])
def test_rollouts_of_our_vehicles_end_early(name):
    body = quadrotor(read_vehicle(VEHICLES / f"{name}.toml"))
    index = empty_scene().index
    assert _core.Shield(_core.BackupPolicy(body, "brake"), index).ends_early
    lagging = _core.ShieldOptions(motor_time_constant_s=0.03)
    assert not _core.Shield(_core.BackupPolicy(body, "brake"), index, lagging).ends_early


def test_rollouts_need_not_end_early():
    policy = _core.BackupPolicy(VEHICLE, "brake")
    assert not _core.Shield(policy, empty_scene().index, _core.ShieldOptions(early_end=False)).ends_early


@pytest.mark.every(2)
@pytest.mark.parametrize("early_end", [True, False])
def test_certified_flights_keep_half_the_margin_and_not_all_of_it(early_end):
    """A new manoeuvre keeps the margin, but at rest it drifts, and one that is flown keeps half."""
    least = np.inf
    for seed in range(8):
        rng = np.random.default_rng(seed)
        scene = random_scene(rng)
        policy, options = _core.BackupPolicy(VEHICLE, "brake"), _core.ShieldOptions(early_end=early_end)
        shield = _core.Shield(policy, scene.index, options)
        flown = _core.ConeBackup(policy, scene.index, _core.ConeBackupOptions(shield_options=options))
        for _ in range(6):
            flown.reset()
            flight = Flight(scene, VEHICLE, flown, admissible_start(rng, shield), wild(rng), 80)
            assert all(report["certified"] for report in flight.reports)
            least = min(least, flight.clearance)
    assert 0.01 <= least < 0.02


def test_to_hover_turned_away_is_no_rest():
    """The regulator's spring on the heading makes it turn, and sway meanwhile."""
    turned = np.array([0, 0, 0, 0, 0, np.tan(3 / 4), 0, 0, 0, 0, 0, 0])
    assert shield_of(empty_scene(), "hover").certify(turned)["time_s"] > 0.5
    assert shield_of(empty_scene(), "heading-invariant").certify(turned)["time_s"] == 0


def test_a_policy_too_quick_for_the_tick_is_refused():
    """Gains for half a kilogram on a body of 29 g: stable, but not when held for 10 ms."""
    small = _core.Quadrotor(
        mass=0.029,
        inertia=(16.6e-6, 16.6e-6, 29.3e-6),
        rotor_x=(0.0325, -0.0325, -0.0325, 0.0325),
        rotor_y=(-0.0325, -0.0325, 0.0325, 0.0325),
        spin=(-1, 1, -1, 1),
        torque_ratio=0.006,
        f_min=(0.02,) * 4,
        f_max=(0.1125,) * 4,
    )
    index = empty_scene().index
    for kind in ("hover", "heading-invariant"):
        with pytest.raises(ValueError, match="do not settle"):
            _core.Shield(_core.BackupPolicy(small, kind), index, _core.ShieldOptions())
    _core.Shield(_core.BackupPolicy(small, "brake"), index, _core.ShieldOptions())


def test_a_tick_of_a_fast_turn_is_what_the_plant_flies():
    shield = shield_of(empty_scene(), tick_s=0.05)
    x, u = moving((2, 0, 0)), (8.0, 0.05, -0.03, 0.004)
    for rates in ((0, 0, 0), (12, -5, 3)):
        x[9:] = rates
        flown = x[None]
        for _ in range(50):
            flown = VEHICLE.step(flown, np.array([u]), dt_s=0.001)
        np.testing.assert_allclose(shield.after(x, u), flown[0], atol=2e-6)
    x[9:] = (0, 0, 25)
    assert not shield.certify(x)["safe"]  # more than a radian in a tick


@pytest.mark.parametrize("kind", ["hover", "heading-invariant", "brake", "cone-escape"])
@pytest.mark.parametrize("size", [1e155, 1e200, 1e308])
def test_policies_are_admissible_for_absurd_states(kind, size):
    policy = _core.BackupPolicy(VEHICLE, kind)
    for i in range(12):
        for sign in (1.0, -1.0):
            x = np.full(12, 0.1)
            x[i] = sign * size
            assert VEHICLE.admissible(np.array([policy(x)]), tolerance_n=1e-9)[0]


@pytest.mark.parametrize(
    "options",
    [
        {"tick_s": 0.0},
        {"margin_m": 0.01},
        {"substeps": 0},
        {"max_time_s": float("nan")},
        {"rest_tilt_rad": 0.0},
        {"escape_time_s": 10.0},
    ],
)
def test_options_without_meaning_are_refused(options):
    with pytest.raises(ValueError):
        shield_of(empty_scene(), **options)


def test_escape_velocities_leave_every_cone_at_the_same_speed():
    for seed in range(10):
        rng = np.random.default_rng(seed)
        scene = random_scene(rng, 60)
        p, v = rng.uniform(-3, 3, 3), 2 * rng.normal(size=3)
        velocities, turn = _core.escape_velocities(scene.index, p, v, reach=2.0, count=64)
        items, _ = scene.index.nearest(p, p, reach=2.0, count=64)
        centres, matrices = scene.index.grown()
        assert list(turn) == sorted(turn)
        for u, angle in zip(velocities, turn, strict=True):
            assert np.linalg.norm(u) == pytest.approx(np.linalg.norm(v))
            cosine = u @ v / (v @ v)
            assert np.arccos(min(cosine, 1)) == pytest.approx(angle, abs=1e-7)
            for i in items:
                r, a = centres[i] - p, matrices[i]
                if r @ a @ r < 1:
                    continue
                h = (u @ a @ u) * (r @ a @ r - 1) - (r @ a @ u) ** 2
                assert h > 0 or r @ a @ u <= 0


def test_one_sphere_ahead_is_passed_by_its_tangent():
    scene = Scene([[3, 0, 0]], [[0.5] * 3], [[1, 0, 0, 0]])
    velocities, turn = _core.escape_velocities(
        scene.index, (0, 0, 0), (2, 0, 0), reach=5.0, slack_rad=0.0 + 1e-9
    )
    assert len(turn) == 8
    np.testing.assert_allclose(turn, np.arcsin(0.65 / 3), atol=1e-6)  # the ball grows by the radius exactly
    assert velocities[0, 1] > 0  # left first
    assert len(_core.escape_velocities(scene.index, (0, 0, 0), (0.1, 0, 0), reach=5.0)[1]) == 0


FILTERS = {
    "ecbf": lambda policy, index: _core.ConeEcbf(policy, index),
    "ecbf by differences": lambda policy, index: _core.ConeEcbf(
        policy, index, _core.ConeEcbfOptions(cascade="difference")
    ),
    "backup": lambda policy, index: _core.ConeBackup(policy, index),
    "interpolation": lambda policy, index: _core.ConeBackup(
        policy, index, _core.ConeBackupOptions(solver="interpolation")
    ),
    # So few rows that the program knows next to nothing of the map: safe all the same.
    "blind": lambda policy, index: _core.ConeEcbf(
        policy, index, _core.ConeEcbfOptions(pruning=_core.Pruning(count=1, floor_m=0.01))
    ),
}
LOOPS = [
    ("ecbf", "brake"),
    ("ecbf", "cone-escape"),
    ("ecbf", "hover"),
    ("ecbf by differences", "heading-invariant"),
    ("backup", "brake"),
    ("backup", "cone-escape"),
    ("interpolation", "brake"),
    ("blind", "brake"),
]


def wild(rng):
    """Random rotor thrusts, or full thrust in one direction."""
    if rng.random() < 0.5:
        return lambda tick, x: VEHICLE.allocation @ rng.uniform(0, 4.25, 4)
    direction = rng.normal(size=3)
    direction *= 14 / np.linalg.norm(direction)
    return lambda tick, x: attitude_controlled(VEHICLE, x, direction)


@pytest.mark.every(2)
@pytest.mark.parametrize(("name", "kind"), LOOPS)
def test_no_nominal_input_makes_the_vehicle_touch_an_obstacle(name, kind):
    backups = 0
    for seed in range(5):
        rng = np.random.default_rng(seed)
        scene = random_scene(rng)
        policy = _core.BackupPolicy(VEHICLE, kind)
        shield, flown = _core.Shield(policy, scene.index), FILTERS[name](policy, scene.index)
        for _ in range(5):
            flown.reset()
            flight = Flight(scene, VEHICLE, flown, admissible_start(rng, shield), wild(rng), 50)
            assert all(report["certified"] for report in flight.reports)
            assert flight.clearance >= 0.01  # half the margin
            backups += flight.count(BACKUP)
    assert backups > 0


def test_full_thrust_at_a_wall_ends_at_rest_before_it():
    scene = wall_scene()
    policy = _core.BackupPolicy(VEHICLE, "brake")
    flown = _core.ConeBackup(policy, scene.index)

    def at_the_wall(tick, x):
        return attitude_controlled(VEHICLE, x, (14, 0, 0))

    flight = Flight(scene, VEHICLE, flown, moving((0, 0, 0), (-2, 0, 0)), at_the_wall, 400)
    assert flight.clearance >= 0.01
    assert flight.state[0] > 1.0  # it came close


def test_without_a_shield_the_same_nominal_input_is_not_certified():
    scene = wall_scene()
    flown = _core.ConeEcbf(
        _core.BackupPolicy(VEHICLE, "brake"), scene.index, _core.ConeEcbfOptions(shield=False)
    )
    report = flown.filter(moving((1, 0, 0)), (0, 0, 0), wrench=(VEHICLE.hover_thrust, 0, 0, 0), thrust=4.5)
    assert not report["certified"]
