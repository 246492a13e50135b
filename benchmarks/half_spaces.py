"""Comparison of the onboard projection on half-spaces in a box with the proved QP solver.

The exit code is 1 if an empty set is reported feasible, a point reported feasible violates a row, or a set
reported infeasible contains a ball of the margin.

    python benchmarks/half_spaces.py --problems 100000
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))  # half_space_families

import numpy as np

from alula import _core
from support.models.half_space_families import KINDS, LIMIT, MARGIN, half_spaces, roomiest

_BATCH = 500


def main() -> int:
    """Compare and print; return 1 when a requirement is violated."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--problems", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    box = np.vstack([np.eye(3), -np.eye(3)])
    solver, wrong, missed, disputed, thickest, feasible_count, maximum = (
        _core.QpSolver(),
        0,
        0.0,
        0,
        0.0,
        0,
        0,
    )
    done = batch = 0
    while done < options.problems:
        rng = np.random.default_rng([options.seed, batch])
        kind, count = KINDS[batch % len(KINDS)], int(rng.integers(1, 13))
        size = min(_BATCH, options.problems - done)
        rows = np.stack([half_spaces(rng, kind, count) for _ in range(size)])
        a0 = rng.uniform(-LIMIT, LIMIT, (size, 3)).astype(np.float32).astype(float)
        a, feasible, _, iterations = _core.half_space_projections(rows, a0, LIMIT)
        normals = np.concatenate([rows[:, :, :3], np.broadcast_to(box, (size, 6, 3))], axis=1)
        bounds = np.concatenate([rows[:, :, 3], np.full((size, 6), LIMIT)], axis=1)
        hessian = np.broadcast_to(np.eye(3), (size, 3, 3)).copy()
        truth = solver.solve_many(hessian, -a0, -normals, -bounds)["status"]
        excess = ((normals @ a.astype(float)[:, :, None])[:, :, 0] - bounds).max(axis=1)
        held = feasible.astype(bool)
        wrong += int((held & (truth != 0)).sum())
        missed = max(missed, float(excess[held].max(initial=0.0)))
        for index in np.flatnonzero(~held & (truth == 0)):
            disputed += 1
            thickest = max(thickest, roomiest(rows[index]))
        feasible_count += int(held.sum())
        maximum = max(maximum, int(iterations.max()))
        done += size
        batch += 1
    print(f"{done} problems, {feasible_count} reported feasible, {wrong} of them wrongly")
    print(f"{disputed} sets reported infeasible are not empty; the largest contains a ball of {thickest:.2e}")
    print(f"maximum violation of a row {missed:.1e}; margin {MARGIN:.2e}; at most {maximum} steps")
    return 0 if wrong == 0 and missed < 3e-6 and thickest <= 1.05 * MARGIN else 1


if __name__ == "__main__":
    sys.exit(main())
