"""Heading along a curve: along its motion, towards a point, or constant, as a smooth function of time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.errors import InfeasibleError
from alula.schemas.scenarios.mission import Mission, PassTable
from alula.stages.planning.limits import Limits
from alula.stages.planning.trajectory import DEGREE, evaluate

_DEFAULT: tuple[str, Any] = ("yaw_rad", 0.0)  # of a mission that says nothing
_SPLINE_DEGREE = 5
_MULTIPLICITY = 3  # of its knots: two continuous derivatives
_WITHIN = 1 - 1e-6  # of the limits, for a solver in double precision
_LEAST_SAMPLES, _MOST_SAMPLES = 12, 64  # of the wanted heading, per piece
_SPACING_S = 0.05  # of these samples
_SLOW = 0.1  # of the speed limit: below it the heading along the motion remains that of before
_SLOW_M_S = 0.2  # at most
_FIRM = 30.0  # weight of errors at a pass with its own heading, and at rest
FIRM_S = 0.3  # time before such a pass, from which on its errors have that weight
_NEAR_M = 0.1  # from the point that it looks at, seen from above, the heading remains that of before
_SMOOTHING_S4 = 1e-4  # of the squared second derivative against the squared error


@dataclass(frozen=True, slots=True)
class Leg:
    """A part of a flight with one kind of heading.

    Attributes:
        table: of the mission or of a pass, with `yaw`, `yaw_rad` or `look_at_m`.
        firm_s: from when on the heading matters most: shortly before a pass with its own heading, and at rest
            [s].
    """

    end_s: float
    table: Mission | PassTable
    firm_s: float = math.inf


def is_turning(mission: Mission) -> bool:
    """Whether the heading of a mission is not one constant."""
    own = [_kind(table) for table in mission.passes]
    kinds = {_kind(mission) or _DEFAULT, *(kind for kind in own if kind is not None)}
    return len(kinds) > 1 or next(iter(kinds))[0] != "yaw_rad"


def constant_heading(mission: Mission) -> float:
    """The heading of a mission that does not turn [rad]."""
    return float((_kind(mission) or _DEFAULT)[1])


def has_heading(table: PassTable) -> bool:
    """Whether a pass has its own heading."""
    return _kind(table) is not None


def _kind(table: Mission | PassTable) -> tuple[str, Any] | None:
    for name in ("yaw", "yaw_rad", "look_at_m"):
        if getattr(table, name) is not None:
            return name, getattr(table, name)
    return None


def heading_along(
    time: FloatArray, coefficient: FloatArray, legs: Sequence[Leg], limits: Limits
) -> tuple[FloatArray, float]:
    """The heading that is nearest to the wanted one within limits of rate and acceleration.

    A spline of degree 5 with two continuous derivatives on the knots of the curve, at rest at both ends; its
    derivatives lie in the hull of their de Boor points, which keep the limits at every instant. Of these it
    has the least squared error at samples of the wanted heading, unwrapped.

    Args:
        time: knots, shape (K + 1,) [s].
        coefficient: of x, y, z, shape (K, 3, 8).
        legs: in their order; the last one ends at the end or later.

    Returns:
        Coefficients, shape (K, 8) [rad, s], and the largest error at the samples [rad].

    Raises:
        InfeasibleError: the program was not solved.
    """
    t, wanted, weight = _wanted(time, coefficient, legs, limits.speed_m_s)
    knots = np.concatenate(
        [
            np.full(_SPLINE_DEGREE + 1 - _MULTIPLICITY, time[0]),
            np.repeat(time, _MULTIPLICITY),
            np.full(_SPLINE_DEGREE + 1 - _MULTIPLICITY, time[-1]),
        ]
    )
    point = _fit(knots, t, wanted, weight, limits)
    return _coefficients(time, knots, point), float(np.abs(_values(knots, t, point) - wanted).max())


def _wanted(
    time: FloatArray, coefficient: FloatArray, legs: Sequence[Leg], speed_m_s: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Samples: times, the wanted heading, unwrapped, and the weights of its errors."""
    parts = []
    for begin, end in zip(time[:-1].tolist(), time[1:].tolist(), strict=True):
        count = min(max(_LEAST_SAMPLES, math.ceil((end - begin) / _SPACING_S)), _MOST_SAMPLES)
        parts.append(begin + (end - begin) * (np.arange(count) + 0.5) / count)
    t = np.concatenate(parts)
    p, v = (evaluate(time, coefficient, t, order)[:, :2] for order in (0, 1))
    leg = np.minimum(np.searchsorted([each.end_s for each in legs], t), len(legs) - 1)
    # A sample stands for the time about it.
    weight = np.gradient(t) * np.where(t >= np.array([each.firm_s for each in legs])[leg], _FIRM, 1.0)
    angle = np.full(len(t), np.nan)
    for i, each in enumerate(legs):
        here = leg == i
        kind, value = _kind(each.table) or _DEFAULT
        if kind == "yaw_rad":
            angle[here] = value
        else:
            way = v[here] if kind == "yaw" else np.array(value[:2]) - p[here]
            least = min(_SLOW * speed_m_s, _SLOW_M_S) if kind == "yaw" else _NEAR_M
            length = np.linalg.norm(way, axis=1)
            angle[here] = np.where(length >= least, np.arctan2(way[:, 1], way[:, 0]), np.nan)
    known = np.flatnonzero(np.isfinite(angle))
    if not len(known):
        return t, np.zeros(len(t)), weight
    unwrapped = np.unwrap(angle[known])
    before = np.maximum(np.searchsorted(known, np.arange(len(t)), side="right") - 1, 0)
    return t, unwrapped[before], weight


def _values(knots: FloatArray, t: FloatArray, point: FloatArray) -> FloatArray:
    from scipy.interpolate import BSpline

    return np.asarray(BSpline(knots, point, _SPLINE_DEGREE)(t))


def _fit(
    knots: FloatArray, t: FloatArray, wanted: FloatArray, weight: FloatArray, limits: Limits
) -> FloatArray:
    """De Boor points of the heading."""
    import clarabel
    from scipy import sparse
    from scipy.interpolate import BSpline

    count = len(knots) - _SPLINE_DEGREE - 1
    basis = BSpline.design_matrix(t, knots, _SPLINE_DEGREE).tocsc()
    first = _derivative(knots, count, 1)
    second = _derivative(knots, count, 2) @ first
    span = (knots[_SPLINE_DEGREE + 1 : -2] - knots[2 : -_SPLINE_DEGREE - 1]) / (_SPLINE_DEGREE - 1)
    middle = float(wanted.mean())
    least = basis.T @ sparse.diags(weight) @ basis
    least += _SMOOTHING_S4 * second.T @ sparse.diags(span[: second.shape[0]]) @ second
    linear = -(basis.T @ (weight * (wanted - middle)))
    rest = sparse.eye(count, format="csr")
    pins = [rest[i] - rest[j] for i, j in ((0, 1), (1, 2), (count - 2, count - 1), (count - 3, count - 2))]
    rate, acceleration = _WITHIN * limits.yaw_rate_rad_s, _WITHIN * limits.yaw_acceleration_rad_s2
    bounded = [first / rate, -first / rate, second / acceleration, -second / acceleration]
    rows = sparse.vstack([*pins, *bounded], format="csc")
    right = np.concatenate([np.zeros(len(pins)), np.ones(rows.shape[0] - len(pins))])
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    solver = clarabel.DefaultSolver(
        sparse.triu(least).tocsc(),
        linear,
        rows,
        right,
        [clarabel.ZeroConeT(len(pins)), clarabel.NonnegativeConeT(rows.shape[0] - len(pins))],
        settings,
    )
    solution = solver.solve()
    if str(solution.status) not in ("Solved", "AlmostSolved"):
        raise InfeasibleError(f"no heading was found ({solution.status}); use a constant --yaw")
    point = np.array(solution.x) + middle
    point[:3], point[-3:] = point[0], point[-1]
    return point


def _derivative(knots: FloatArray, count: int, order: int) -> Any:
    """Matrix from de Boor points of a derivative to those of the next; a sparse array."""
    from scipy import sparse

    degree = _SPLINE_DEGREE - order + 1
    rows = count - order
    i = np.arange(rows)
    gap = knots[i + order + degree] - knots[i + order]
    scale = degree / gap
    return sparse.csc_array(
        (np.concatenate([-scale, scale]), (np.concatenate([i, i]), np.concatenate([i, i + 1]))),
        shape=(rows, rows + 1),
    )


def _coefficients(time: FloatArray, knots: FloatArray, point: FloatArray) -> FloatArray:
    """Power coefficients of each piece, shape (K, 8)."""
    from scipy.interpolate import BSpline, PPoly

    pieces = PPoly.from_spline(BSpline(knots, point, _SPLINE_DEGREE))
    begins = np.flatnonzero(np.diff(pieces.x) > 0)
    result = np.zeros((len(time) - 1, DEGREE + 1))
    result[:, : _SPLINE_DEGREE + 1] = pieces.c[::-1, begins].T
    return result
