"""Proposition 3 of FastBridge measured: how often the backup policy meets the rows of its own program."""

from __future__ import annotations

import numpy as np

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.scenarios.vehicle import FASTBRIDGE as VEHICLE
from alula.stages.reporting.table import HIGH, LOW, Table
from alula.stages.vehicles.bodies import quadrotor
from alula.stages.verdict import wilson_interval

WEIGHTS = {
    "(2, 3, 0.3, 0.05), as printed": (2.0, 3.0, 0.3, 0.05),
    "(2, 0.3, 0.3, 0.05)": (2.0, 0.3, 0.3, 0.05),
}
ALPHAS = (2.0, 3.0, 10.0, 20.0)  # alpha_R [1/s]
ALPHA_TERMINAL = 5.0  # alpha_T [1/s]
HORIZON_S, NODES = 3.0, 40
SLOW_M_S = 0.1  # speed below which the filter leaves a node without running rows
_STATES = 200  # safe ones, for each row of the table
_STEPS = 8  # of RK4 between nodes
_STEP_S = 1e-4
_ROUNDING = 1e-6


def feasibility_table(states: int = _STATES, seed: int = 0) -> Table:
    """Count the safe states in which u = pi_b meets the proposition's condition, and all rows (21) and (22).

    A state is safe when h_b >= 0 and the terminal residual is not negative, as the proposition supposes.

    Args:
        states: number of safe states that are drawn for each row.
        seed: of the draw.
    """
    rows = []
    for words, weight in WEIGHTS.items():
        gains = _core.BackupGains(weight=weight)
        policy = _core.BackupPolicy(quadrotor(VEHICLE), "hover", gains)
        for alpha in ALPHAS:
            condition, every_row, far_rows = _counted(policy, alpha, states, seed)
            rows.append(
                (words, alpha, states, condition, every_row, *wilson_interval(every_row, states), far_rows)
            )
    columns = (
        *("weights d", "α_R [1/s]", "safe states", "ḣ_b + α h_b ≥ 0", "all rows (21), (22)", LOW, HIGH),
        f"all rows but those below {SLOW_M_S:g} m/s",
    )
    note = (
        "Number of random safe states (one ellipsoid, up to 3 m/s, tilted and turning) in which u = π_b "
        "meets the condition of Proposition 3, and in which it is a feasible point of the program (23); "
        f"T = {HORIZON_S:g} s, N = {NODES}, α_T = {ALPHA_TERMINAL:g}/s. As the flow comes to rest, h "
        "falls as |v|², so late rows reject the policy unless α_R is well above twice its slowest pole."
    )
    return Table(
        "proposition-3", "Proposition 3: the backup policy in its own program", columns, tuple(rows), note
    )


def _counted(policy: _core.BackupPolicy, alpha: float, states: int, seed: int) -> tuple[int, int, int]:
    """Safe states that meet the condition, all rows, and all rows but those of slow nodes."""
    rng = np.random.default_rng(seed)
    flow = _core.BackupFlow(policy, horizon_s=HORIZON_S, nodes=NODES, steps=_STEPS)
    tick = _core.BackupFlow(policy, horizon_s=_STEP_S, nodes=1)
    condition = every_row = fast_rows = found = 0
    while found < states:
        x, centre, a = _drawn(rng)
        flow.run(x)
        nodes = flow.states()
        now = _barrier(nodes, centre, a)
        u = policy(x)
        at = centre.tolist()
        held = [_holds(flow.running_row(at, a, k, alpha), u) for k in range(NODES + 1)]
        meets = np.array([*held, _holds(flow.clear_row(at, a, NODES, ALPHA_TERMINAL), u)], np.bool_)
        if now < 0 or not meets[-1]:  # at u = pi_b the last row is the terminal residual
            continue
        found += 1
        tick.run(x)
        flow.run(tick.states()[-1])
        rate = (_barrier(flow.states(), centre, a) - now) / _STEP_S
        condition += rate + max(alpha, ALPHA_TERMINAL) * now >= -_ROUNDING * max(1.0, now)
        is_slow = np.append(np.linalg.norm(nodes[:, 6:9], axis=1) < SLOW_M_S, False)
        every_row += bool(meets.all())
        fast_rows += bool((meets | is_slow).all())
    return condition, every_row, fast_rows


def _drawn(rng: np.random.Generator) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A state of the vehicle, and centre and matrix of an ellipsoid 1 to 4 m away."""
    x = np.zeros(12)
    x[3:6] = rng.uniform(-0.08, 0.08, 3)  # MRP: up to 0.3 rad about each axis
    x[6:9] = rng.uniform(-1, 1, 3) * (3.0, 3.0, 1.0)
    x[9:12] = rng.uniform(-1, 1, 3)
    way = rng.normal(size=3)
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    a = axes @ np.diag(rng.uniform(0.2, 0.6, 3) ** -2) @ axes.T
    return x, rng.uniform(1, 4) * way / np.linalg.norm(way), np.ascontiguousarray(a)


def _barrier(nodes: FloatArray, centre: FloatArray, a: FloatArray) -> float:
    """h_b at the nodes: the minimum of h, and gamma at the last."""
    r, v = centre - nodes[:, :3], nodes[:, 6:9]
    beta, delta = np.einsum("ki,ij,kj->k", v, a, v), np.einsum("ki,ij,kj->k", r, a, v)
    gamma = np.einsum("ki,ij,kj->k", r, a, r) - 1
    return float(min((beta * gamma - delta**2).min(), gamma[-1]))


def _holds(row: tuple[list[float], float], u: FloatArray) -> bool:
    """Whether a . u >= b, up to rounding."""
    a, b = np.array(row[0]), row[1]
    return bool(a @ u - b >= -_ROUNDING * (np.abs(a) @ np.abs(u) + abs(b)))
