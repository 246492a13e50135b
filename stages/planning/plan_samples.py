"""A plan as a curve, and points along it."""

from __future__ import annotations

import numpy as np

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.errors import UsageError
from alula.stages.planning.trajectory import evaluate

MOST_SAMPLES = 2_000_000
_DRAWN = 500


def curve_of(plan: Artifact) -> _core.ReferenceCurve:
    """The native curve of a plan."""
    time, coefficient = (np.ascontiguousarray(plan[name], np.float64) for name in ("time", "coefficient"))
    return _core.ReferenceCurve(time, coefficient)


def path_of(curve: _core.ReferenceCurve) -> list[tuple[float, float, float]]:
    """Points of a plan about every 0.1 s, at most 500, to draw it, world frame [m]."""
    count = min(max(2, round(10 * curve.duration_s) + 1), _DRAWN)
    rows = curve.at(np.linspace(0, curve.duration_s, count))[:, :3].tolist()
    return [(x, y, z) for x, y, z in rows]


def sample_plan(plan: Artifact, dt_s: float) -> FloatArray:
    """Positions of a plan every `dt_s`, and once at its end, shape (K, 3), world frame [m].

    Raises:
        UsageError: that would be more than `MOST_SAMPLES`.
    """
    knots = np.asarray(plan["time"], np.float64)
    coefficient = np.asarray(plan["coefficient"], np.float64)[:, :3]
    steps = int(np.ceil(knots[-1] / dt_s - 1e-9))
    if steps > MOST_SAMPLES:
        raise UsageError(
            f"the plan of {knots[-1]:g} s has {steps} ticks, more than {MOST_SAMPLES}; raise --dt"
        )
    time = np.minimum(np.arange(steps + 1) * dt_s, knots[-1])
    return evaluate(knots, coefficient, time)
