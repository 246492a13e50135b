"""The backup flow, its sensitivities and its rows."""

import numpy as np
import pytest

from alula import _core
from support.models import backup_model as model
from support.models import quadrotor_model as body
from support.models import splat_filter_model as filters

KINDS = ["hover", "heading-invariant", "brake"]


def flow_of(kind, **options):
    return _core.BackupFlow(_core.BackupPolicy(body.fastbridge(), kind), **options)


def states(count, seed):
    return body.random_states(count, seed, speed=1.5, rate=1.0) * np.repeat([1, 0.5, 1, 1], 3)


@pytest.mark.parametrize("case", body.VECTORS["cases"])
def test_flow_and_rows_are_those_of_the_paper(case):
    inp, p = case["inp"], body.PARAMETERS
    x = np.concatenate([inp[name] for name in ("p", "sigma", "v", "omega")]).astype(float)
    flow = flow_of("hover", horizon_s=p["T"], nodes=p["N"])
    flow.run(x)
    mu, a = np.array(inp["mu"], float), np.array(case["A"])
    pairs = [(flow.states()[-1], case["Phi_N"]), (flow.sensitivities()[-1], case["W_N"])]
    for k, row in case["rows"].items():
        got, bound = flow.running_row(mu, a, int(k), p["alphaR"])
        pairs += [(got, row["a"]), (bound, row["b"])]
    got, bound = flow.clear_row(mu, a, p["N"], p["alphaT"])
    pairs += [(got, case["row_terminal"]["a"]), (bound, case["row_terminal"]["b"])]
    for got, expected in pairs:
        np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


@pytest.mark.every(3)
@pytest.mark.parametrize("kind", KINDS)
def test_the_discrete_sensitivity_is_the_derivative_of_the_discrete_flow(kind):
    numpy, flow = model.MODELS[kind](), flow_of(kind, horizon_s=1.0, nodes=10, steps=2, drift=True)
    rng = np.random.default_rng(0)
    for x in states(4, seed=5):
        hold = rng.normal(size=3)
        flow.run(x, hold, 7)

        def nodes(y, hold=hold):
            return model.flow(numpy, y, 0.05, 20, hold, 7)[::2]

        f, g = model.drift_and_control(x)
        np.testing.assert_allclose(flow.states(), nodes(x), rtol=1e-10, atol=1e-11)
        expected = np.stack([model.along(nodes, x, column) for column in g.T], axis=-1)
        scale = np.abs(expected).max()
        np.testing.assert_allclose(flow.sensitivities(), expected, rtol=1e-9, atol=1e-12 * scale)
        expected = model.along(nodes, x, f)
        np.testing.assert_allclose(flow.drifts(), expected, rtol=1e-9, atol=1e-11 * np.abs(expected).max())


@pytest.mark.parametrize("kind", KINDS)
def test_the_flow_identity_holds_to_the_error_of_integration(kind):
    x = states(1, seed=6)[0]
    errors = []
    for nodes in (40, 160):
        exact, identity = (flow_of(kind, horizon_s=1.0, nodes=nodes, drift=d) for d in (True, False))
        exact.run(x), identity.run(x)
        difference = np.abs(exact.drifts() - identity.drifts())[:: nodes // 40]
        errors.append((difference / np.abs(exact.drifts()).max()).max())
        np.testing.assert_array_equal(exact.sensitivities(), identity.sensitivities())
    assert errors[0] < 0.1
    assert errors[1] < errors[0] / 100  # fourth order: 256 for steps four times shorter


def test_a_held_velocity_needs_the_column_of_the_drift():
    with pytest.raises(RuntimeError, match="drift"):
        flow_of("brake").run(np.zeros(12), (1, 0, 0), 3)


@pytest.mark.parametrize(
    "options", [{"horizon_s": 0.0}, {"nodes": 0}, {"steps": 0}, {"horizon_s": float("nan")}]
)
def test_flows_without_meaning_are_refused(options):
    with pytest.raises(ValueError):
        flow_of("brake", **options)


def test_nodes_that_are_not_there_are_refused():
    flow = flow_of("brake", nodes=3)
    flow.run(np.zeros(12))
    with pytest.raises(IndexError):
        flow.running_row((1, 0, 0), np.eye(3), 4, 1.0)


def test_the_rows_are_the_rate_of_the_barrier_under_a_held_input():
    """d/dt of h(Phi_k(x(t))) with x flown under u, by a complex step, against a . u - b."""
    numpy, flow = model.Brake(), flow_of("brake", horizon_s=1.0, nodes=8, drift=True)
    rng = np.random.default_rng(1)
    for x in states(5, seed=7):
        root = rng.normal(size=(3, 3))
        mu, a, u = x[:3] + 2 * rng.normal(size=3), root @ root.T, np.array([5.0, *rng.normal(0, 0.02, 3)])
        flow.run(x)
        f, g = model.drift_and_control(x)

        def barriers(y, mu=mu, a=a):
            return np.array([filters.cone(mu, a, z[:3], z[6:9]) for z in model.flow(numpy, y, 0.125, 8)])

        rate, value = model.along(barriers, x, f + g @ u), barriers(x)
        for k in range(9):
            row, bound = flow.running_row(mu, a, k, 6.0)
            expected = rate[k, 3] + 6.0 * value[k, 3]
            assert row @ u - bound == pytest.approx(expected, rel=1e-7, abs=1e-7 * np.abs(rate).max())
            row, bound = flow.clear_row(mu, a, k, 2.0)
            expected = rate[k, 1] + 2.0 * value[k, 1]
            assert row @ u - bound == pytest.approx(expected, rel=1e-7, abs=1e-7 * np.abs(rate).max())


def test_late_rows_refuse_the_backup_itself_unless_alpha_is_well_above_the_slow_pole():
    """h ~ |v|^2 decays at twice the slow pole, 2.18 1/s for the gains of the paper."""
    policy = _core.BackupPolicy(body.fastbridge(), "hover")
    flow = _core.BackupFlow(policy, horizon_s=6.0, nodes=60)
    rng = np.random.default_rng(8)
    accepted, safe = {2.0: 0, 10.0: 0}, 0
    while safe < 100:
        x = np.concatenate(
            [rng.normal(size=3), 0.1 * rng.normal(size=3), rng.normal(size=3), 0.3 * rng.normal(size=3)]
        )
        root = rng.normal(size=(3, 3))
        mu, a = x[:3] + 3 * rng.normal(size=3), root @ root.T + np.eye(3)
        flow.run(x)
        phi = flow.states()
        if (
            min(filters.cone(mu, a, z[:3], z[6:9])[3] for z in phi) < 0
            or filters.cone(mu, a, x[:3], x[6:9])[1] < 0
        ):
            continue
        safe += 1
        u = policy(x)
        for alpha in accepted:
            rows = [flow.running_row(mu, a, k, alpha) for k in range(61)]
            accepted[alpha] += all(np.array(row) @ u >= bound for row, bound in rows)
    assert accepted[2.0] == 0
    assert accepted[10.0] >= 85


def test_deceleration_of_the_paper_is_slow():
    """The slowest pole of the (sigma, v, omega) block at rest."""
    poles = {}
    for kind in ("hover", "brake"):
        jacobian = _core.BackupPolicy(body.fastbridge(), kind).jacobian(np.zeros(12))
        keep = [3, 4, 6, 7, 8, 9, 10]  # without position and yaw
        poles[kind] = np.linalg.eigvals(jacobian[np.ix_(keep, keep)]).real.max()
    assert poles["hover"] == pytest.approx(-1.089, abs=2e-3)
    assert poles["brake"] < -3.5
