"""Verdicts on what FastBridge proves: statements that a test or a computation checks, without a flight."""

from __future__ import annotations

import numpy as np

from alula import _core
from alula.stages.reporting.table import Table
from papers.fastbridge.rows import row_of, share
from papers.verdicts import PaperRow


def equations() -> list[PaperRow]:
    """Statements that a test checks, without a flight."""
    return [
        row_of(
            "III-B",
            "thrust and torque reach the position at its fourth derivative",
            "dynamic feedback linearization",
            "the rows over thrust and torque are the derivatives of the flight that they cause",
            "reproduced",
            "checked against flights by finite differences",
        ),
        row_of(
            "III-C, eqs. 8 and 9",
            "a ray meets an ellipsoid exactly when the cone says so",
            "necessary and sufficient",
            "agrees with the intersection of ray and ellipsoid",
            "reproduced",
            "a test with random ellipsoids and velocities",
        ),
        row_of(
            "III-D, eq. 15",
            "the barrier has relative degree three; its row is affine in thrust and torque",
            "derived",
            "gradients and derivatives agree with complex steps and power series",
            "reproduced",
            "",
        ),
        _at_rest(),
        row_of(
            "III-A",
            "the reference is a septic polynomial, rest to rest",
            "7th degree",
            "the same; its peak speed is 2.1875 L/T",
            "reproduced",
            "",
        ),
        row_of(
            "III-E1",
            "states whose backup flow stays safe and ends at rest are control invariant",
            "derived",
            "holds along the flow, to the error of its integration",
            "bounded",
            "between the nodes nothing is checked in the paper; ours certifies every tick by the whole flow",
        ),
        row_of(
            "III-E2, eq. 20",
            "the sensitivity of the backup flow is integrated beside it",
            "RK4",
            "equals the derivative of the discrete flow",
            "reproduced",
            "",
        ),
        row_of(
            "VI-A, eq. 24",
            "the torque of the policy brakes the horizontal motion",
            "derived at σ = 0",
            "equals an independent model of the policy",
            "reproduced",
            "",
        ),
    ]


def _at_rest(ellipsoids: int = 100) -> PaperRow:
    """Evaluate both barriers at rest beside random ellipsoids."""
    rng = np.random.default_rng(0)
    rest = (0.0, 0.0, 0.0)
    cones = [
        _core.collision_cone(
            rng.uniform(2, 5, 3).tolist(),
            np.diag(rng.uniform(1, 100, 3)),
            rest,
            rest,
            acceleration=rest,
            jerk=rest,
        )
        for _ in range(ellipsoids)
    ]
    vanish, stay = sum(c["h"] == 0 for c in cones), sum(c["gamma"] > 0 for c in cones)
    return row_of(
        "III-E",
        "at rest the barrier of the cone vanishes, the terminal barrier does not",
        "h = 0 at v = 0",
        f"h is 0 beside {vanish} and γ above 0 beside {stay} of {ellipsoids} random ellipsoids",
        "reproduced" if vanish == stay == ellipsoids else "refuted",
        "evaluated for this page",
    )


def propositions(feasibility: Table) -> list[PaperRow]:
    """Judge the propositions, the lemma and the convergence to hover."""
    printed = [row for row in feasibility.rows if "printed" in row[0]]
    states = sum(row[2] for row in printed)
    condition = sum(row[3] for row in printed)
    rows = [
        row_of(
            "Proposition 1",
            "ḣ_real - ḣ_DI = ∇_v h · e_a",
            "an identity",
            "holds to 1e-9 in 200 random states",
            "reproduced",
            "a test with another derivation of both rates",
        ),
        row_of(
            "Proposition 2",
            "π_b within the rotors' limits",
            "for every state",
            "every random state",
            "reproduced",
            "a test; both readings of d",
        ),
        row_of(
            "Proposition 3",
            "π_b meets ḣ_b + α h_b ≥ 0 in a safe state",
            "always",
            f"{condition:,} of {states:,} states",
            "reproduced" if condition == states else "refuted",
            "h_b of the discrete flow, by finite differences",
            share(condition, states),
        ),
    ]
    for row in printed:
        _, alpha, count, _, every, *_ = row
        rows.append(
            row_of(
                "Proposition 3, eqs. 21-22",
                f"π_b is a feasible point of the program, α_R = {alpha:g}/s",
                "whenever the flow is safe",
                f"{every} of {count} safe states",
                "reproduced" if every == count else "refuted",
                "the rows at the nodes ask more than the proposition proves; the paper does not print α_R",
                share(every, count),
            )
        )
    rows.append(
        row_of(
            "Lemma 1",
            "Lipschitz constant κ (m k_vz + K_σ + K_ω + k_vh)",
            "global",
            "exceeded at 200 m/s, held at 5 m/s",
            "refuted",
            "the slope of S R(σ) v by σ grows with v; at flown speeds the bound holds",
        )
    )
    rows.append(
        row_of(
            "VI-C",
            "the policy converges to hover",
            "locally exponentially",
            "to yaw zero",
            "reproduced",
            "from a heading of 3 rad it turns and drifts 0.9 m sideways",
        )
    )
    return rows
