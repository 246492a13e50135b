"""The backup filter: its program against another solver, the closed form, its edges and its flights."""

import numpy as np
import pytest

from alula import _core
from support.models import backup_model as model
from support.models import quadrotor_model as body
from support.models import splat_filter_model as filters
from support.models.wrench_flight import (
    BACKUP,
    FILTERED,
    HOVER,
    OK,
    RANGES,
    RECOVERING,
    REFUSED,
    VEHICLE,
    Flight,
    Scene,
    attitude_controlled,
    empty_scene,
    random_case,
    random_scene,
    tick,
)

ALL_NEAR = {"sweep": False, "count": 0}


def policy(kind="brake"):
    return _core.BackupPolicy(VEHICLE, kind)


def backup(scene, kind="brake", **options):
    return _core.ConeBackup(policy(kind), scene.index, _core.ConeBackupOptions(**options))


def rows_of(
    scene, x, kind, first_node=1, nodes=20, steps=2, alpha_running=10.0, alpha_terminal=5.0, min_speed=0.1
):
    """(a, b) of a . u >= b of the ellipsoids near, and h_b."""
    speed = np.linalg.norm(x[6:9])
    reach = max(0.5, speed**2 / 12 + 0.3 * speed + scene.radius)
    centres, matrices = scene.index.grown()
    flow = _core.BackupFlow(policy(kind), horizon_s=1.5, nodes=nodes, steps=steps)
    flow.run(x)
    phi, rows, least = flow.states(), [], np.inf
    for i in scene.index.nearest(x[:3], x[:3], reach=reach, count=len(scene.index))[0]:
        mu, a = centres[i], matrices[i]
        _, gamma, delta, _ = filters.cone(mu, a, x[:3], x[6:9])
        if delta < 0 and gamma >= 0:
            continue
        for k in range(nodes + 1):
            _, gamma_k, delta_k, h = filters.cone(mu, a, phi[k, :3], phi[k, 6:9])
            if gamma < 0 or np.linalg.norm(phi[k, 6:9]) < min_speed or (delta_k < 0 and gamma_k > 0):
                continue
            if k >= first_node:
                rows.append(flow.running_row(mu, a, k, alpha_running))
            least = min(least, h)
        rows.append(flow.clear_row(mu, a, nodes, alpha_terminal))
        least = min(least, filters.cone(mu, a, phi[-1, :3], phi[-1, 6:9])[1])
    return rows, least


def scaled(rows):
    a = np.array([row for row, _ in rows]).reshape(-1, 4) * RANGES
    length = np.linalg.norm(a, axis=1)
    return a / length[:, None], np.array([bound for _, bound in rows]) / length


def nearest_input(rows, wrench):
    import cvxpy

    z = cvxpy.Variable(4)
    f = VEHICLE.inverse_allocation @ cvxpy.multiply(z, RANGES)
    limits = [f >= 0, f <= 4.25]
    if rows:
        a, b = scaled(rows)
        limits.append(a @ z >= b)
    problem = cvxpy.Problem(cvxpy.Minimize(cvxpy.sum_squares(z - wrench / RANGES)), limits)
    problem.solve(solver=cvxpy.CLARABEL, tol_gap_abs=1e-11, tol_gap_rel=1e-11, tol_feas=1e-11)
    return None if problem.status == "infeasible" else z.value * RANGES


def steps_of(kind):
    gain = {"hover": 0.02, "heading-invariant": 0.02}.get(kind)
    rates = gain / model.INERTIA if gain else np.array([36.0, 36.0, 8.0])
    return int(np.ceil(1.5 / 20 * rates.max()))


@pytest.mark.every(2)
@pytest.mark.filterwarnings("ignore:Solution may be inaccurate")
@pytest.mark.parametrize(
    ("kind", "first_node"), [("hover", 0), ("hover", 1), ("heading-invariant", 1), ("brake", 1)]
)
def test_the_nearest_input_agrees_with_another_solver(kind, first_node):
    seen = {OK: 0, FILTERED: 0, BACKUP: 0}
    for seed in range(40):
        scene, x, wrench = random_case(np.random.default_rng(seed), 25)
        flown = backup(
            scene,
            kind,
            first_node=first_node,
            shield=False,
            lateral_bias=0.0,
            pruning=_core.Pruning(**ALL_NEAR),
        )
        report = tick(flown, x, wrench)
        rows, h_b = rows_of(scene, x, kind, first_node, steps=steps_of(kind))
        assert report["rows"] == len(rows)
        assert report["margin"] == pytest.approx(h_b, rel=1e-9)
        expected = nearest_input(rows, wrench)
        if expected is None:
            assert report["infeasible"]
            np.testing.assert_array_equal(report["wrench"], policy(kind)(x))
        else:
            assert not report["infeasible"]
            np.testing.assert_allclose(report["wrench"], expected, rtol=1e-5, atol=1e-6)
            if report["status"] != OK:
                assert report["status"] == RECOVERING or h_b >= 0
        status = report["status"] if report["status"] in seen else FILTERED
        seen[status] += 1
    assert min(seen.values()) > 0


@pytest.mark.parametrize("kind", ["hover", "brake"])
def test_the_interpolation_takes_the_largest_share_that_holds(kind):
    found = 0
    for seed in range(40):
        scene, x, wrench = random_case(np.random.default_rng(seed), 25)
        wrench = VEHICLE.limited(wrench[None])[0]
        flown = backup(scene, kind, shield=False, solver="interpolation", pruning=_core.Pruning(**ALL_NEAR))
        report = tick(flown, x, wrench)
        rows, _ = rows_of(scene, x, kind, steps=steps_of(kind))
        if not rows:
            continue
        a, b = scaled(rows)
        base = policy(kind)(x)

        def holds(share, a=a, b=b, base=base, wrench=wrench):
            return (a @ ((base + share * (wrench - base)) / RANGES) - b).min()

        shares = np.linspace(0, 1, 20001)
        good = [s for s in shares if holds(s) >= 0]
        if report["infeasible"]:
            assert not good
            np.testing.assert_array_equal(report["wrench"], base)
            continue
        share = (np.array(report["wrench"]) - base) @ (wrench - base) / ((wrench - base) @ (wrench - base))
        np.testing.assert_allclose(report["wrench"], base + share * (wrench - base), atol=1e-9)
        assert share == pytest.approx(max(good), abs=1e-4)
        found += 0 < share < 1
    assert found > 0


def test_a_nominal_that_holds_all_rows_comes_back_bit_by_bit():
    rng = np.random.default_rng(0)
    for solver in ("active-set", "interpolation"):
        flown = backup(empty_scene(), solver=solver)
        for x in body.random_states(10, seed=1, speed=1.0, rate=0.5):
            x[3:6] *= 0.1
            wrench = [HOVER + 0.1 * rng.normal(), *rng.normal(0, 1e-2, 3)]
            report = tick(flown, x, wrench, nominal_thrust_rate=0.5)
            assert report["status"] == OK
            assert report["wrench"] == wrench
            assert report["thrust_rate"] == 0.5
            assert report["certified"]


@pytest.mark.parametrize("bad", [np.nan, -np.inf])
def test_numbers_that_are_not_finite_are_refused_with_hover(bad):
    flown = backup(random_scene(np.random.default_rng(0), 10))
    for i in range(16):
        values = np.concatenate([np.zeros(12), [HOVER, 0, 0, 0]])
        values[i] = bad
        report = tick(flown, values[:12], values[12:])
        assert report["status"] == REFUSED
        assert report["wrench"] == [HOVER, 0, 0, 0]


def test_between_walls_without_a_way_out_the_backup_is_flown():
    """Two plates 70 cm apart, fast towards one: no input holds the rows."""
    plates = Scene([[0.35, 0, 0], [-0.35, 0, 0]], [[0.01, 2, 2]] * 2, [[1, 0, 0, 0]] * 2, radius=0.05)
    x = np.zeros(12)
    x[6] = 4.0
    report = tick(backup(plates, shield=False), x, (HOVER, 0, 0, 0))
    assert report["infeasible"]
    assert report["status"] == BACKUP
    assert report["margin"] < 0
    np.testing.assert_array_equal(report["wrench"], policy()(x))


@pytest.mark.slow
def test_a_solution_and_a_safe_flow_are_different_things():
    """The rows can have a solution while h_b < 0, and h_b >= 0 while they have none."""
    seen = set()
    for seed in range(300):
        scene, x, wrench = random_case(np.random.default_rng(seed), 25)
        report = tick(backup(scene, "hover", shield=False, alpha_running=2.0), x, wrench)
        if report["rows"]:
            seen.add((report["infeasible"], report["margin"] >= 0))
    assert {(False, False), (False, True), (True, False)} <= seen


def test_rows_far_from_the_boundary_may_be_left_out():
    fewer_rows = 0
    for seed in range(20):
        scene, x, wrench = random_case(np.random.default_rng(seed), 25)
        everything = tick(backup(scene, shield=False), x, wrench)
        fewer = tick(backup(scene, shield=False, far=3.0), x, wrench)
        assert fewer["rows"] <= everything["rows"]
        assert fewer["margin"] == everything["margin"]
        fewer_rows += fewer["rows"] < everything["rows"]
    assert fewer_rows > 0


def test_the_cone_escape_keeps_moving_where_the_brake_stops():
    """Towards a sphere off the course, with a nominal input that does not give way."""
    scene = Scene([[6, 0.25, 0]], [[0.6] * 3], [[1, 0, 0, 0]])
    reached = {}

    def onward(_, x):
        a = np.clip([2 * (4 - x[6]), -2 * x[7], -3 * x[8] - 2 * x[2]], -4, 4)
        return attitude_controlled(VEHICLE, x, a)

    for kind in ("brake", "cone-escape"):
        x = np.zeros(12)
        x[6] = 4.0
        flown = _core.ConeBackup(
            policy(kind), scene.index, _core.ConeBackupOptions(pruning=_core.Pruning(count=0, floor_m=0.3))
        )
        flight = Flight(scene, VEHICLE, flown, x, onward, 300)
        assert flight.clearance >= 0.01
        assert all(report["certified"] for report in flight.reports)
        reached[kind] = flight.state[0]
    assert reached["cone-escape"] > reached["brake"]


def test_a_tracking_row_gives_way_to_the_rows_of_obstacles():
    x, u = np.zeros(12), (HOVER, 0, 0, 0)
    errors = {"position_error": (0, 0, -1.0), "velocity_error": (0, 0, -0.5)}
    plain = tick(backup(empty_scene()), x, u, **errors)
    tracked = tick(backup(empty_scene(), clf_weight=1e3), x, u, **errors)
    assert plain["status"] == OK
    assert tracked["status"] == FILTERED
    # V' + V <= 0 asks for T from y T / m + y (-g) + e_v (P_11 e_p + P_12 e_v) + V <= 0 along z.
    p, v = -1.0, -0.5
    y = p / 6 + v / 3
    value = 0.5 * (4 / 3 * p * p + p * v / 3 + v * v / 3)
    thrust = (y * 9.81 - v * (4 / 3 * p + v / 6) - value) * model.MASS / y
    assert tracked["wrench"][0] == pytest.approx(min(thrust, 17.0), rel=1e-2)


@pytest.mark.parametrize(
    "options",
    [
        {"horizon_s": 0.0},
        {"nodes": 0},
        {"first_node": 21},
        {"alpha_running": 0.0},
        {"alpha_terminal": float("inf")},
        {"far": 0.0},
        {"solver": "other"},
        {"lateral_bias": 1.0},
    ],
)
def test_options_without_meaning_are_refused(options):
    with pytest.raises(ValueError):
        backup(empty_scene(), **options)


@pytest.mark.parametrize("kind", ["brake", "cone-escape"])
def test_clones_and_repetitions_give_the_same_bits(kind):
    scene, x, wrench = random_case(np.random.default_rng(3), 25)
    flown = backup(scene, kind)
    first = tick(flown, x, wrench)
    flown.reset()
    assert tick(flown, x, wrench) == first == tick(backup(scene, kind).clone(), x, wrench)
