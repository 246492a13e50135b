"""Commander of velocities: a velocity filter for a vehicle that follows its set-points with a lag.

A velocity filter assumes a point whose velocity is its input. A vehicle follows a set-point u with a lag; to
first order dv/dt = (u - v) / tau. Its lead point

    q = p + tau v,     dq/dt = v + tau dv/dt = u,

is such a point. Since p + tau dp/dt = q, p is a low-pass of q, dp/dt = (q - p) / tau, whatever the vehicle
does. While u = 0, p comes to rest along the chord from p to q. Therefore the whole chord must be clear. It is
not sufficient to keep p clear, because p alone does not contain the speed, nor to keep q clear, because p
follows q around corners by a shorter path. With psi_k(s) = max_l a_kl(s) for hull k and
a_kl(s) = n_kl . s - d_kl, let

    D_k = min over s on the chord of psi_k(s),   attained at s* = p + theta (q - p).

By the minimax theorem (a linear program and its dual) there are facet weights lambda_l >= 0 of sum 1 such
that a = sum lambda_l a_kl is at least D_k on the whole chord and equals D_k at s*. Let n be the gradient of
a. Then n . (q - p) is zero for 0 < theta < 1, not negative for theta = 0, and not positive for theta = 1. At
the ends of the chord

    da(p)/dt = n . (q - p) / tau   and   da(q)/dt = n . u.

The former is not negative where it matters (theta < 1), so n . u >= -beta (D_k - r) implies dD_k/dt >= -beta
(D_k - r): a chord with distance r to the hull keeps it, and so does its end p. This is the condition of the
filter itself, at s* instead of p. It is evaluated at p and at points of the chord up to q. The velocity u
passes through the filter at each point in turn, at most three times, the point nearest to a hull last, until
no point changes it; if they do not agree it is shortened until they do. The step from a point to the next is
half of psi - r there, or a twelfth of the chord (0.02 to 0.2 m) if that is more. Along a step of the first
kind psi - r stays at least half of its value, because it changes by at most 1 m per m.

Where the chord has entered the margin of a hull, q is driven back behind the point of entry, towards p. The
shortest path out of the hull is not taken, because it may lead through a thin wall.

If the vehicle is not of first order, dv/dt = (u - v) / tau + e, q moves with u + tau e, and the guarantee is
D >= r - tau max|e| / beta. Too large a tau is safe; too small a tau is not. With a true lag tau_0 and q at a
distance h from a wall, dh/dt = v + (tau / tau_0) (u - v) and u = -beta h have real poles, and do not
oscillate, unless 1 + beta tau < 2 sqrt(beta tau_0). Near a wall at a distance h_p the speed is then about
h_p / (1 / beta + tau), and the deceleration at most the speed divided by that time. A vehicle that cannot
decelerate as fast requires a larger tau or a lower speed.

Source: the chord and its condition are new here; input-to-state safety: Kolathaya and Ames 2019.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.stages.filtering.protocol import Filter, FilterResult, FilterStatus
from alula.stages.flight.commanders.protocol import Decision
from alula.stages.flight.links.protocol import Setpoint, VehicleState, VelocitySetpoint

_SPEED_TOLERANCE = 1.01  # times the speed limit, for filters in single precision
_POINTS = 12  # the minimum step along the chord is its length divided by this
_MIN_STEP_M, _MAX_STEP_M = 0.02, 0.2  # limits of that minimum step: a thin hull must not fit between points
_SWEEPS = 3  # maximum number of passes over the points until none changes the velocity
_FRACTIONS = (1.0, 0.5)  # of the velocity, tried in turn if the points do not agree; after them 0
_TOLERANCE = 1e-3  # times the speed limit: a smaller change of a velocity is rounding
_HALVINGS = 4  # steps of the bisection for the point where the chord enters a hull
_RETURN_GAIN = 2.0  # times 1 / tau: gain that drives q out of a hull
_HISTORY_S = 3.0  # of sent set-points: the maximum age of a state and the maximum delay


@dataclass(slots=True)
class VelocityCommander:
    """Nominal velocity v_ref + c/2 (p_ref - p), limited in speed, behind a filter on the vehicle's chord.

    p and v are predicted over age and delay with the set-points sent meanwhile; see the module. With `lag_s`
    0 the filter is evaluated at p alone. The geofence reacts to a velocity only after it is flown. Therefore
    a velocity above the speed limit counts as a failure of the filter (ValueError).

    Attributes:
        filter: its result must depend on its arguments alone; it is evaluated several times a tick.
        gain: c [1/s].
        speed_m_s: maximum speed of set-points [m/s].
        lag_s: tau, time constant of the loop that follows set-points [s].
        delay_s: assumed age of a state when it arrives; a longer measured latency replaces it [s].
        dt_s: duration of a tick, for which each set-point is flown [s].
        setpoint: kind of set-point to send.

    Source: PolyMerge (arXiv 2606.16232), eq. 16, for the nominal velocity.
    """

    filter: Filter
    gain: float
    speed_m_s: float
    lag_s: float = 0.0
    delay_s: float = 0.0
    dt_s: float = 0.01
    setpoint: type[Setpoint] = VelocitySetpoint
    _sent: deque[FloatArray | None] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Start without sent set-points."""
        self._sent = deque(maxlen=math.ceil(_HISTORY_S / self.dt_s))

    def reset(self) -> None:
        """See `Commander`."""
        self._sent.clear()

    def sent(self, setpoint: Setpoint) -> None:
        """See `Commander`; the prediction uses velocities only."""
        velocity = setpoint.velocity if isinstance(setpoint, VelocitySetpoint) else None
        self._sent.appendleft(velocity)

    def decide(self, state: VehicleState, age_s: float, target: FloatArray) -> Decision:
        """See `Commander`."""
        row = target[0]
        p, v = self._predict(state, age_s + max(self.delay_s, state.latency_s))
        error = row[:3] - p
        u_nominal = row[3:6] + 0.5 * self.gain * error
        speed = math.sqrt(float(u_nominal @ u_nominal))
        if speed > self.speed_m_s:
            u_nominal *= self.speed_m_s / speed
        result = self._filtered(p, self.lag_s * v, u_nominal)
        refused = result.status is FilterStatus.REFUSED
        return Decision(
            setpoint=None if refused else VelocitySetpoint(result.u, float(row[15])),
            status=result.status,
            margin=float(result.margin),
            nominal=u_nominal,
            safe=result.u,
            error_m=math.sqrt(float(error @ error)),
            active=int(result.active),
        )

    def _predict(self, state: VehicleState, age_s: float) -> tuple[FloatArray, FloatArray]:
        """Position and velocity predicted by `age_s`, each of shape (3,); v is constant where u is unknown.

        While u is constant for a time t: v = u + (v_0 - u) exp(-t / tau), and p + tau v moves by u t.
        """
        p, v = np.array(state.position, np.float64), np.array(state.velocity, np.float64)
        ticks = math.ceil(age_s / self.dt_s - 1e-9)
        unknown_s = max(0.0, age_s - len(self._sent) * self.dt_s)
        p += unknown_s * v
        left = age_s - unknown_s
        for i in range(min(ticks, len(self._sent)) - 1, -1, -1):
            held = left - i * self.dt_s  # the oldest one for less than a tick of that time
            left -= held
            u = self._sent[i]
            if u is None or self.lag_s <= 0:
                p += held * v
                continue
            slower = u + (v - u) * math.exp(-held / self.lag_s)
            p += held * u + self.lag_s * (v - slower)
            v = slower
        return p, v

    def _evaluate(self, x: FloatArray, u: FloatArray) -> FilterResult:
        """Result of the filter at a point, validated."""
        result = self.filter(x, u.copy())
        u_safe = np.asarray(result.u, np.float64)
        if u_safe.shape != (3,) or not np.isfinite(u_safe).all():
            raise ValueError(f"the filter returned {result.u!r}, which is not a velocity")
        if math.sqrt(float(u_safe @ u_safe)) > _SPEED_TOLERANCE * self.speed_m_s:
            raise ValueError(f"the filter returned {u_safe.tolist()}, faster than {self.speed_m_s:g} m/s")
        status, margin = FilterStatus(result.status), float(result.margin)
        if math.isnan(margin) and status is not FilterStatus.REFUSED:  # the margin determines the next point
            raise ValueError("the filter returned a margin that is not a number")
        return FilterResult(u_safe, status, margin, int(result.active), float(result.solve_time))

    def _filtered(self, p: FloatArray, chord: FloatArray, u_nominal: FloatArray) -> FilterResult:
        """Nominal velocity after the filter at all points of the chord.

        Where the chord enters the margin of a hull, q is driven out on the side of p. The filter at q would
        not do so: q may be nearer to the far side of a thin wall. Where only points near p are in a margin
            and
        the margin increases towards q, they are left out, because no u moves p out faster.
        """
        evaluated = self._along(p, chord, u_nominal)
        for _, result in evaluated:
            if result.status is FilterStatus.REFUSED:
                return result
        inside = next((i for i, (_, found) in enumerate(evaluated) if not _is_inside(found)), len(evaluated))
        margins = [found.margin for _, found in evaluated[: inside + 1]]
        if all(a <= b for a, b in itertools.pairwise(margins)):  # p moves out
            if inside == len(evaluated):
                return evaluated[-1][1]
            del evaluated[:inside]
        blocked = next((i for i, (_, found) in enumerate(evaluated) if _is_inside(found)), None)
        if blocked is not None:
            clear = evaluated[blocked - 1][0] if blocked else evaluated[0][0]
            return self._driven_out(clear, evaluated[blocked], p, chord, u_nominal)
        worst = min((result for _, result in evaluated), key=_margin)
        if len(evaluated) == 1 or all(result.status is FilterStatus.OK for _, result in evaluated):
            return worst
        return self._agreed(evaluated, worst, u_nominal)

    def _agreed(
        self, evaluated: list[tuple[FloatArray, FilterResult]], worst: FilterResult, u: FloatArray
    ) -> FilterResult:
        """Velocity that the filter leaves unchanged at each point; the point nearest to a hull is last.

        If the points do not agree after some passes, the velocity is shortened: with u = 0 the chord shrinks
        towards p and remains within the former chord.
        """
        order, status = sorted(evaluated, key=lambda each: -each[1].margin), FilterStatus.OK
        for _ in range(_SWEEPS):
            is_settled = True
            for x, _first in order:
                result = self._evaluate(x, u)
                if result.status is FilterStatus.REFUSED:
                    return result
                if result.status is not FilterStatus.OK:
                    is_settled, u = False, result.u
                    status = max(status, result.status)
            if is_settled:
                return FilterResult(u, status, worst.margin, worst.active)
        for fraction in _FRACTIONS:
            results = [self._evaluate(x, fraction * u) for x, _ in order]
            for result in results:
                if result.status is FilterStatus.REFUSED:
                    return result
            max_change = max(float(np.abs(result.u - fraction * u).max()) for result in results)
            if max_change <= _TOLERANCE * self.speed_m_s:
                return FilterResult(fraction * u, status, worst.margin, worst.active)
        return FilterResult(np.zeros(3), status, worst.margin, worst.active)

    def _driven_out(
        self,
        clear: FloatArray,
        blocked: tuple[FloatArray, FilterResult],
        p: FloatArray,
        chord: FloatArray,
        u: FloatArray,
    ) -> FilterResult:
        """Velocity out of the hull that the chord enters after `clear`, along the normal there.

        The speed is that of the filter, or `_RETURN_GAIN` / tau times the depth of q behind the point of
        entry if that is more.
        """
        x, result = blocked
        for _ in range(_HALVINGS):
            middle = 0.5 * (clear + x)
            found = self._evaluate(middle, u)
            if found.status is FilterStatus.REFUSED:
                return found
            if _is_inside(found):
                x, result = middle, found
            else:
                clear = middle
        back = -chord / math.sqrt(float(chord @ chord))
        speed = math.sqrt(float(result.u @ result.u))
        normal = result.u / speed if speed > 0 else back
        if normal @ back < 0:
            normal = back
        depth = float(normal @ (x - p - chord))
        size = min(max(speed, _RETURN_GAIN / self.lag_s * depth), self.speed_m_s)
        return FilterResult(size * normal, FilterStatus.RECOVERING, result.margin, result.active)

    def _along(
        self, p: FloatArray, chord: FloatArray, u: FloatArray
    ) -> list[tuple[FloatArray, FilterResult]]:
        """Points of the chord from p to q, or to the first inside a hull after a clear one, with results."""
        length = math.sqrt(float(chord @ chord))
        if length <= _MIN_STEP_M:
            x = p + chord
            return [(x, self._evaluate(x, u))]
        min_step = max(min(length / _POINTS, _MAX_STEP_M), _MIN_STEP_M)
        theta, evaluated, was_clear = 0.0, [], False
        while True:
            x = p + theta * chord
            result = self._evaluate(x, u)
            evaluated.append((x, result))
            is_inside = _is_inside(result)
            if theta >= 1.0 or (is_inside and was_clear) or result.status is FilterStatus.REFUSED:
                return evaluated
            was_clear = was_clear or not is_inside
            theta = min(1.0, theta + max(0.5 * result.margin, min_step) / length)


def _is_inside(result: FilterResult) -> bool:
    return result.status is FilterStatus.RECOVERING


def _margin(result: FilterResult) -> float:
    return result.margin
