"""A plan as a curve, and samples of it that a controller tracks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.errors import UsageError
from alula.stages.planning.trajectory import evaluate


@dataclass(frozen=True, slots=True)
class Reference:
    """Position and velocity at times 0, dt, 2 dt, ...; shapes (K, 3), world frame [m, m/s].

    The last row is the plan's end; from then on the velocity is zero.
    """

    position_world: FloatArray
    velocity_world: FloatArray


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


def sample_plan(plan: Artifact, dt_s: float) -> Reference:
    """Evaluate a plan's polynomials every `dt_s`, and once at its end.

    On segment k position is sum_j c_kj (t - t_k)^j, velocity its derivative.

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
    position, velocity = (evaluate(knots, coefficient, time, derivative) for derivative in (0, 1))
    return Reference(position, velocity)
