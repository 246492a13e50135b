"""Velocities for a vehicle that follows them late, behind a filter for one that follows at once.

A filter of velocities knows a point whose velocity is its input. A vehicle takes a set-point u up with a lag,
in first order dv/dt = (u - v) / tau. Its lead point

    q = p + tau v,     dq/dt = v + tau dv/dt = u,

is the point that the filter knows, and p + tau dp/dt = q, whatever the vehicle does: p is a low-pass of q and
follows it, dp/dt = (q - p) / tau. While u = 0 it comes to rest along the chord from p to q. So that is what must be
clear: not p alone, which says nothing of how fast it is, nor q alone, which p follows around corners by a
shorter way. With psi_k(s) = max_l a_kl(s) of hull k, a_kl(s) = n_kl . s - d_kl, and

    D_k = min over s on the chord of psi_k(s),   attained at s* = p + theta (q - p),

there are weights of facets, lambda_l >= 0 of sum 1, whose a = sum lambda_l a_kl is at least D_k on the whole chord
and D_k at s* (minimax: a linear program and its dual). With n its gradient: n . (q - p) is zero for
0 < theta < 1, at least zero for theta = 0, and at most zero for theta = 1. Of the ends of the chord

    da(p)/dt = n . (q - p) / tau   and   da(q)/dt = n . u

the former does not fall where it counts (theta < 1), so n . u >= -beta (D_k - r) gives dD_k/dt >= -beta (D_k - r):
a chord that keeps r goes on to, and p, its end, with it. That is the filter's own condition, at s* instead of
p. It is asked for at q and at points of the chord up to p, and `u` is passed on until all of them let it
through: between them psi, which changes by at most a metre per metre, is at least half of what it is at
the nearer one, or they are an eighth of the chord apart.

Where the vehicle is not of first order, dv/dt = (u - v) / tau + e, q moves with u + tau e, and what is kept is
D >= r - tau max|e| / beta. Too large a tau is on the safe side: with lag tau_0 < tau near a wall at distance h of
q, dh/dt = v + (tau / tau_0) (u - v) and u = -beta h have real poles, so h does not swing through zero; too small a tau
swings from beta (tau_0 - tau) of some tenths on. Near a wall the speed is then about h_p / (1 / beta + tau), and it is
braked by 1 / (1 / beta + tau) times the speed at most: beyond what the vehicle can, it must fly slower.

Source: the chord and its condition are ours; input-to-state safety: Kolathaya and Ames 2019.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from alula.stages.filtering.protocol import Filter, FilterResult, FilterStatus
from alula.stages.flight.commanders import Decision
from alula.stages.flight.links.protocol import Setpoint, VehicleState, VelocitySetpoint

FloatArray = NDArray[np.float64]

_FASTER = 1.01  # of the speed limit, for filters in single precision
_POINTS = 8  # of the chord, at most, beside its lead end
_LEAST_M = 0.02  # between them
_SWEEPS = 4  # over them, until all let the same velocity through
_KNOWN_TICKS = 200  # of what was sent


@dataclass(slots=True)
class VelocityCommander:
    """v_ref + c/2 (p_ref - p), at most `speed_m_s`, behind a filter of velocities on the vehicle's chord.

    p and v are taken on by age and delay, with what was sent meanwhile; see the module. With `lag_s` 0 the
    filter sees p alone. The geofence underneath sees a velocity only once it is flown, so a filter that answers
    with a faster one has failed (ValueError).

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
        self._sent = deque(maxlen=_KNOWN_TICKS)

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
        return FilterResult(answer, status, margin, int(result.active), float(result.solve_time))

    def _filtered(self, p: FloatArray, chord: FloatArray, u_nominal: FloatArray) -> FilterResult:
        """The nominal velocity as all of the chord lets it through.

        Where q or the chord before p is too near to a hull already, the filter drives out there, and q with
        it. Where p alone is, it is on its way out, to q, and cannot be sooner there by any u.
        """
        asked = self._along(p, chord, u_nominal)
        if len(asked) == 1 or all(result.status is FilterStatus.OK for _, result in asked):
            return min((result for _, result in asked), key=_margin)
        if any(result.status is FilterStatus.REFUSED for _, result in asked):
            return next(result for _, result in asked if result.status is FilterStatus.REFUSED)
        while len(asked) > 1 and asked[-1][1].status is FilterStatus.RECOVERING:
            if asked[-1][1].margin > asked[-2][1].margin:
                break
            asked.pop()
        x, worst = min(asked, key=lambda each: each[1].margin)
        if worst.status is FilterStatus.RECOVERING:
            return worst
        order = sorted((x for x in asked), key=lambda each: -each[1].margin)  # the nearest has the last word
        u, status = u_nominal, FilterStatus.OK
        for _ in range(_SWEEPS):
            is_settled = True
            for x, _result in order:
                result = self._ask(x, u)
                if result.status is not FilterStatus.OK:
                    is_settled, u = False, result.u
                    status = max(status, result.status)
            if is_settled:
                break
        return FilterResult(u, status, worst.margin, worst.active)

    def _along(
        self, p: FloatArray, chord: FloatArray, u: FloatArray
    ) -> list[tuple[FloatArray, FilterResult]]:
        """Points of the chord from q on towards p, and what the filter answers there."""
        length = math.sqrt(float(chord @ chord))
        least = max(length / _POINTS, _LEAST_M)
        share, asked = 1.0, []
        while True:
            x = p + share * chord
            result = self._ask(x, u)
            asked.append((x, result))
            if share <= 0.0 or length <= _LEAST_M:
                return asked
            share = max(0.0, share - max(0.5 * result.margin, least) / length)


def _margin(result: FilterResult) -> float:
    return result.margin
