"""Velocities for a vehicle that follows them late, behind a filter for one that follows at once.

A filter of velocities knows a point whose velocity is its input. A vehicle takes a set-point u up with a
lag, in first order dv/dt = (u - v) / tau. Its lead point

    q = p + tau v,     dq/dt = v + tau dv/dt = u,

is the point that the filter knows, and p + tau dp/dt = q, whatever the vehicle does: p is a low-pass of q
and follows it, dp/dt = (q - p) / tau. While u = 0 it comes to rest along the chord from p to q. So that is
what must be clear: not p alone, which says nothing of how fast it is, nor q alone, which p follows around
corners by a shorter way. With psi_k(s) = max_l a_kl(s) of hull k, a_kl(s) = n_kl . s - d_kl, and

    D_k = min over s on the chord of psi_k(s),   attained at s* = p + theta (q - p),

there are weights of facets, lambda_l >= 0 of sum 1, whose a = sum lambda_l a_kl is at least D_k on the
whole chord and D_k at s* (minimax: a linear program and its dual). With n its gradient: n . (q - p) is zero
for 0 < theta < 1, at least zero for theta = 0, and at most zero for theta = 1. Of the ends of the chord

    da(p)/dt = n . (q - p) / tau   and   da(q)/dt = n . u

the former does not fall where it counts (theta < 1), so n . u >= -beta (D_k - r) gives dD_k/dt >= -beta
(D_k - r): a chord that keeps r goes on to, and p, its end, with it. That is the filter's own condition, at
s* instead of p. It is asked for at p and at points of the chord up to q, and `u` is passed round until all
of them let it through, three times at most, the point nearest to a hull last, then shortened until they do.
Between points psi - r, which changes by at most a metre per metre, is at least half of what it was, or they
are a twelfth of the chord apart, and 0.2 m at most.

Where the chord has come into a hull's margin, q is driven back behind the place where it enters: towards p,
not out of the hull by the shortest way, which may be through a thin wall.

Where the vehicle is not of first order, dv/dt = (u - v) / tau + e, q moves with u + tau e, and what is kept
is D >= r - tau max|e| / beta. Too large a tau is on the safe side, too small a one is not: with a lag tau_0
and q at h from a wall, dh/dt = v + (tau / tau_0) (u - v) and u = -beta h have real poles, and do not swing,
unless 1 + beta tau < 2 sqrt(beta tau_0). Near a wall at h_p the speed is then about h_p / (1 / beta + tau),
and what is braked with at most the speed over that time: who cannot brake so hard needs a longer tau, or a
lower speed.

Source: the chord and its condition are ours; input-to-state safety: Kolathaya and Ames 2019.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.stages.filtering.protocol import Filter, FilterResult, FilterStatus
from alula.stages.flight.commanders.tracking import Decision
from alula.stages.flight.links.protocol import Setpoint, VehicleState, VelocitySetpoint

_FASTER = 1.01  # of the speed limit, for filters in single precision
_POINTS = 12  # of the chord, at most, beside p
_LEAST_M, _MOST_M = 0.02, 0.2  # between them, near hulls: a thin one must not fit between two
_SWEEPS = 3  # over them, until all let the same velocity through
_SHORTER = (1.0, 0.5)  # parts of what is left where they do not agree; at last nothing
_ALIKE = 1e-3  # of the speed limit: so much is rounding
_HALVINGS = 4  # to where the chord enters a hull
_OUT = 2.0  # of 1 / tau: how fast q is driven out of one
_KNOWN_S = 3.0  # of what was sent: of the oldest state that may be flown on, and the longest delay


@dataclass(slots=True)
class VelocityCommander:
    """v_ref + c/2 (p_ref - p), at most `speed_m_s`, behind a filter of velocities on the vehicle's chord.

    p and v are taken on by age and delay, with what was sent meanwhile; see the module. With `lag_s` 0 the
    filter sees p alone. The geofence underneath sees a velocity only once it is flown, so a filter that
    answers with a faster one has failed (ValueError).

    Attributes:
        filter: its answer must depend on its arguments alone; it is asked several times a tick.
        gain: c [1/s].
        speed_m_s: limit of set-points.
        lag_s: tau: of the loop that follows set-points.
        delay_s: how old a state is when it arrives.
        dt_s: of a tick, which is how long each set-point is flown.

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
        """Nothing is sent yet."""
        self._sent = deque(maxlen=math.ceil(_KNOWN_S / self.dt_s))

    def reset(self) -> None:
        """See `Commander`."""
        self._sent.clear()

    def sent(self, setpoint: Setpoint) -> None:
        """What the vehicle follows from now on; of other kinds it is not known where they lead."""
        known = setpoint.velocity if isinstance(setpoint, VelocitySetpoint) else None
        self._sent.appendleft(known)

    def decide(self, state: VehicleState, age_s: float, target: FloatArray) -> Decision:
        """See `Commander`."""
        row = target[0]
        p, v = self._now(state, age_s + self.delay_s)
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

    def _now(self, state: VehicleState, age_s: float) -> tuple[FloatArray, FloatArray]:
        """Position and velocity, taken on by `age_s` by the lag and what was sent; else v stays.

        While u is held for t: v = u + (v_0 - u) exp(-t / tau), and p + tau v moves by u t.
        """
        p, v = np.array(state.position, np.float64), np.array(state.velocity, np.float64)
        ticks = math.ceil(age_s / self.dt_s - 1e-9)
        unknown_s = max(0.0, age_s - len(self._sent) * self.dt_s)
        p += unknown_s * v
        left = age_s - unknown_s
        for i in range(min(ticks, len(self._sent)) - 1, -1, -1):
            held = left - i * self.dt_s  # the oldest one was held for less than a tick of that time
            left -= held
            u = self._sent[i]
            if u is None or self.lag_s <= 0:
                p += held * v
                continue
            slower = u + (v - u) * math.exp(-held / self.lag_s)
            p += held * u + self.lag_s * (v - slower)
            v = slower
        return p, v

    def _ask(self, x: FloatArray, u: FloatArray) -> FilterResult:
        """The filter's answer, checked."""
        result = self.filter(x, u.copy())
        answer = np.asarray(result.u, np.float64)
        if answer.shape != (3,) or not np.isfinite(answer).all():
            raise ValueError(f"the filter returned {result.u!r}, which is no velocity")
        if math.sqrt(float(answer @ answer)) > _FASTER * self.speed_m_s:
            raise ValueError(f"the filter returned {answer.tolist()}, faster than {self.speed_m_s:g} m/s")
        status, margin = FilterStatus(result.status), float(result.margin)
        if math.isnan(margin) and status is not FilterStatus.REFUSED:  # how far to the next point?
            raise ValueError("the filter returned a margin that is not a number")
        return FilterResult(answer, status, margin, int(result.active), float(result.solve_time))

    def _filtered(self, p: FloatArray, chord: FloatArray, u_nominal: FloatArray) -> FilterResult:
        """The nominal velocity as all of the chord lets it through.

        Where the chord enters a hull's margin, q is driven out on the side of p, which the filter at q would
        not know: q may be nearer to the far side of a thin wall. Where p alone is too near, on its way out
        to q, no u gets it there sooner.
        """
        asked = self._along(p, chord, u_nominal)
        for _, result in asked:
            if result.status is FilterStatus.REFUSED:
                return result
        inside = next((i for i, (_, found) in enumerate(asked) if not _is_inside(found)), len(asked))
        margins = [found.margin for _, found in asked[: inside + 1]]
        if all(a <= b for a, b in itertools.pairwise(margins)):  # on its way out
            if inside == len(asked):
                return asked[-1][1]
            del asked[:inside]
        blocked = next((i for i, (_, found) in enumerate(asked) if _is_inside(found)), None)
        if blocked is not None:
            clear = asked[blocked - 1][0] if blocked else asked[0][0]
            return self._driven_out(clear, asked[blocked], p, chord, u_nominal)
        worst = min((result for _, result in asked), key=_margin)
        if len(asked) == 1 or all(result.status is FilterStatus.OK for _, result in asked):
            return worst
        return self._agreed(asked, worst, u_nominal)

    def _agreed(
        self, asked: list[tuple[FloatArray, FilterResult]], worst: FilterResult, u: FloatArray
    ) -> FilterResult:
        """A velocity that each of these points lets through; the one nearest to a hull has the last word.

        Where they do not agree soon, it is shortened: with u = 0 the chord shrinks towards p, and stays
        within what it was.
        """
        order, status = sorted(asked, key=lambda each: -each[1].margin), FilterStatus.OK
        for _ in range(_SWEEPS):
            is_settled = True
            for x, _first in order:
                result = self._ask(x, u)
                if result.status is FilterStatus.REFUSED:
                    return result
                if result.status is not FilterStatus.OK:
                    is_settled, u = False, result.u
                    status = max(status, result.status)
            if is_settled:
                return FilterResult(u, status, worst.margin, worst.active)
        for share in _SHORTER:
            answers = [self._ask(x, share * u) for x, _ in order]
            for result in answers:
                if result.status is FilterStatus.REFUSED:
                    return result
            most = max(float(np.abs(result.u - share * u).max()) for result in answers)
            if most <= _ALIKE * self.speed_m_s:
                return FilterResult(share * u, status, worst.margin, worst.active)
        return FilterResult(np.zeros(3), status, worst.margin, worst.active)

    def _driven_out(
        self,
        clear: FloatArray,
        blocked: tuple[FloatArray, FilterResult],
        p: FloatArray,
        chord: FloatArray,
        u: FloatArray,
    ) -> FilterResult:
        """Out of the hull that the chord enters after `clear`, along its normal there.

        As fast as the filter would, and by `_OUT` / tau times how deep q is behind that place.
        """
        x, result = blocked
        for _ in range(_HALVINGS):
            middle = 0.5 * (clear + x)
            found = self._ask(middle, u)
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
        size = min(max(speed, _OUT / self.lag_s * depth), self.speed_m_s)
        return FilterResult(size * normal, FilterStatus.RECOVERING, result.margin, result.active)

    def _along(
        self, p: FloatArray, chord: FloatArray, u: FloatArray
    ) -> list[tuple[FloatArray, FilterResult]]:
        """Points of the chord from p on towards q, or into a hull, and what the filter answers there."""
        length = math.sqrt(float(chord @ chord))
        if length <= _LEAST_M:
            x = p + chord
            return [(x, self._ask(x, u))]
        least = max(min(length / _POINTS, _MOST_M), _LEAST_M)
        share, asked, was_clear = 0.0, [], False
        while True:
            x = p + share * chord
            result = self._ask(x, u)
            asked.append((x, result))
            is_inside = _is_inside(result)
            if share >= 1.0 or (is_inside and was_clear) or result.status is FilterStatus.REFUSED:
                return asked
            was_clear = was_clear or not is_inside
            share = min(1.0, share + max(0.5 * result.margin, least) / length)


def _is_inside(result: FilterResult) -> bool:
    return result.status is FilterStatus.RECOVERING


def _margin(result: FilterResult) -> float:
    return result.margin
