"""Watches over what the vehicle reports: its mode, its health, its position while it flies by itself, jumps.

Each watch keeps what it needs of earlier reports and answers one question per tick. The supervisor turns the
answers into events.
"""

from __future__ import annotations

import math
from collections import deque

from alula.schemas.arrays import FloatArray
from alula.stages.flight.commanders.protocol import Decision
from alula.stages.flight.links.protocol import Order, VehicleState, VehicleStatus
from alula.stages.vehicles.setpoints import RatesSetpoint, Setpoint, VelocitySetpoint

_FAILSAFE_S = 1.0  # a failsafe changes the mode this long after it was reported at most
_UNKNOWN_S = 1.0  # a health value may be unknown for this long
_HEALTH = ("armed", "is_estimator_ready", "battery_share")
# A vehicle follows velocities with a lag between these: the shortest, and the one that filters assume [s].
_SHORTEST_LAG_S, _ROOM, _ROOM_M_S = 0.1, 0.3, 0.3
_AT_LIMIT = 0.99  # estimates of disturbances are cut at the limit
_OF_RESPONSE = 0.5  # part of the limit for velocities and accelerations
_SLIP_S, _SLIP_ROOM_M = 2.0, 0.1  # window, and what the noise of sound estimates makes in it
_LONGEST_S = 0.5  # between states; velocities are not integrated over more
_BRAKE_M_S2, _REACTION_S = 2.0, 0.5  # minimum deceleration of autopilots, and their maximum reaction time


class ModeWatch:
    """Distinguishes a mode change by the pilot from the effect of an order.

    The vehicle carries out all orders but LAND in a mode that follows set-points. The name of the landing
    mode contains "land" (`Order`). After the first order only these modes are allowed: the earlier one, until
    the vehicle follows set-points; then a mode that follows set-points; and, once landing was ordered, a
    landing mode. Any other mode means that somebody else took control, and this result is permanent.

    Attributes:
        by_failsafe: one of the vehicle's own failsafes took control: it triggered, or gave a new cause, at
            most 1 s before the change of the mode. An older one did not: a failsafe may have no action.
    """

    def __init__(self) -> None:
        self._before: str | None = None
        self._follows = self._may_land = self._lands = self._lost = False
        self._failsafe, self._failsafe_s = (False, ""), -math.inf  # the newest, and when it was first seen
        self.by_failsafe = False

    def ordered(self, order: Order, status: VehicleStatus) -> None:
        """Register an order that is about to be sent.

        Args:
            status: of the vehicle, before the order.
        """
        if self._before is None:
            self._before = status.mode
        self._may_land = self._may_land or order is Order.LAND

    def is_ours(self, status: VehicleStatus) -> bool:
        """Return True while nobody else has changed the mode.

        Args:
            status: of the vehicle, now. An unknown mode, "", counts as no change.
        """
        was_ours, now_s, failsafe = (
            not self._lost,
            status.heard_s or 0.0,
            (status.is_failsafe, status.failsafe),
        )
        if failsafe != self._failsafe:
            self._failsafe, self._failsafe_s = failsafe, now_s if any(failsafe) else -math.inf
        is_ours = self._keeps(status)
        if was_ours and not is_ours:
            self.by_failsafe = now_s - self._failsafe_s <= _FAILSAFE_S
        return is_ours

    def _keeps(self, status: VehicleStatus) -> bool:
        if self._before is None or self._lost or not status.mode:
            return not self._lost
        if self._may_land and "land" in status.mode.lower():
            self._lands = True
        elif self._may_land and status.armed is False:
            pass  # nobody flies it any more
        elif self._lands:
            self._lost = True
        elif status.obeys:
            self._follows = True
        elif self._follows or status.mode != self._before:
            self._lost = True
        return not self._lost


class HealthWatch:
    """Detects that the vehicle no longer reports a health value that it reported when it was armed.

    A link sets a value to unknown when no report has arrived for some seconds. Without this watch the flight
    would continue on the last good value.
    """

    def __init__(self) -> None:
        self._reported: tuple[str, ...] = ()
        self._since_s = math.inf

    def armed(self, status: VehicleStatus) -> None:
        """Store which health values the vehicle reports; called when it is about to be armed."""
        self._reported = tuple(name for name in _HEALTH if getattr(status, name) is not None)

    def is_unknown(self, status: VehicleStatus, now_s: float) -> bool:
        """Return True when a value that was reported has been unknown for more than 1 s."""
        is_unknown = any(getattr(status, name) is None for name in self._reported)
        self._since_s = min(self._since_s, now_s) if is_unknown else math.inf
        return now_s - self._since_s > _UNKNOWN_S


class PositionWatch:
    """Distance of the vehicle from the climb path that was proven clear, and from where a hold began.

    Args:
        top_m: height of the end of the climb, in the world [m].
    """

    def __init__(self, top_m: float) -> None:
        self.top_m = top_m
        self._foot: FloatArray | None = None
        self._room_m = 0.0
        self._held: VehicleState | None = None

    def proven(self, foot: FloatArray, room_m: float) -> None:
        """Store the climb path that the checks proved clear.

        Args:
            foot: start of the climb, which leads straight up, shape (3,), world frame [m].
            room_m: distance by which the vehicle may leave the path without touching anything [m].
        """
        self._foot, self._room_m = foot.copy(), room_m

    def off_climb_m(self, state: VehicleState) -> float:
        """Distance from the climb path, beside it or above its end, less the proven room; 0 within [m].

        A vehicle below the foot counts as being on the path: height above the ground is what estimators get
        wrong most. The result is infinite before `proven`, and NaN for a position that is not a number.
        """
        if self._foot is None:
            return math.inf
        x, y, z = (state.position - self._foot).tolist()
        above = z + float(self._foot[2]) - self.top_m
        off = math.sqrt(x * x + y * y + (0.0 if above < 0 else above) ** 2) - self._room_m
        return 0.0 if off <= 0 else off  # NaN stays NaN

    def crept_m(self, state: VehicleState) -> float:
        """Distance of the position from where the checks proved the climb path [m]; NaN before `proven`."""
        return math.nan if self._foot is None else math.dist(state.position, self._foot)

    def moved(self) -> None:
        """Forget the last hold: the vehicle flies again, and the next hold begins elsewhere."""
        self._held = None

    def drift_m(self, state: VehicleState) -> float:
        """Distance from where a hold began, less the distance needed to react and to brake; 0 within [m].

        A hold begins with the first state that is passed after `moved`. The result is NaN for a position that
        is not a number.
        """
        if self._held is None:
            self._held = state
        begin = self._held
        speed = math.sqrt(float(begin.velocity @ begin.velocity))
        away = state.position - begin.position
        off = math.sqrt(float(away @ away)) - speed * (_REACTION_S + 0.5 * speed / _BRAKE_M_S2)
        return 0.0 if off <= 0 else off


class JumpWatch:
    """Distance between a reported position and the one that the velocities predict from the state before.

    The distance that an acceleration of 20 m/s^2 can cover between the two states is subtracted.
    """

    def __init__(self) -> None:
        self._last: VehicleState | None = None

    def jump_m(self, state: VehicleState) -> float:
        """Jump from the last state to this one [m]; 0 for the same state, infinite if it is not a number."""
        last, self._last = self._last, state
        if last is None or last is state:
            return 0.0
        dt = max(0.0, state.received_s - last.received_s)
        away = state.position - last.position - 0.5 * dt * (state.velocity + last.velocity)
        jump = math.sqrt(float(away @ away)) - 10.0 * dt * dt
        return max(0.0, jump) if math.isfinite(jump) else math.inf


class SlipWatch:
    """Distance by which position and integrated velocity contradict each other.

    The slip is |p(t) - p(t - T) - int v dt| over the last T = 2 s, less 0.1 m: noise of 1 cm and of 1 cm/s
    with time constants of seconds makes up to 0.1 m. Either the position is wrong by as much since t - T,
    or the velocity by slip / T on average. Then a point of rest that is predicted over a lag of at most T is
    wrong by no more than the slip. So the margins of filters grow by it
    (`added_margin` in `alula/filters/safety_filter.hpp`).
    """

    def __init__(self) -> None:
        self._last: VehicleState | None = None
        self._gone = (0.0, 0.0, 0.0)  # position less the integrated velocity [m]
        self._past: deque[tuple[float, tuple[float, float, float]]] = deque()
        self._slip_m = 0.0

    def slip_m(self, state: VehicleState, *, is_resting: bool) -> float:
        """Slip up to this state [m]; infinite if it is not a number.

        Args:
            is_resting: the vehicle stands on the ground, so its velocity is zero, whatever it reports.
        """
        last = self._last
        if state is last:
            return self._slip_m
        self._last = state
        dt = math.inf if last is None else state.received_s - last.received_s
        if last is None or not 0.0 <= dt <= _LONGEST_S:
            self._past.clear()
        else:
            share = 0.0 if is_resting else 0.5 * dt
            away = state.position - last.position - share * (state.velocity + last.velocity)
            x, y, z = away.tolist()
            self._gone = self._gone[0] + x, self._gone[1] + y, self._gone[2] + z
        if not all(map(math.isfinite, self._gone)):
            self._last, self._gone = None, (0.0, 0.0, 0.0)
            self._past.clear()
            self._slip_m = math.inf
            return self._slip_m
        self._past.append((state.received_s, self._gone))
        while self._past[0][0] < state.received_s - _SLIP_S:
            self._past.popleft()
        self._slip_m = max(0.0, math.dist(self._gone, self._past[0][1]) - _SLIP_ROOM_M)
        return self._slip_m


class ModelWatch:
    """Compares the motion with the model by which controller and filter predict it.

    The native flight estimates the acceleration that the model leaves out, with a bound on what the estimate
    does not contain yet: for body rates from the thrust (`alula/dynamics/disturbance.hpp`), for velocities
    and accelerations from an interval of responses (`alula/dynamics/response.hpp`). Both must stay below
    `max_m_s2`, and below half of that where the vehicle's own controller follows set-points, because it
    counters most of a disturbance before it is seen. In addition each component of the velocity must lie
    between those of two first-order responses to velocity set-points, one with 0.1 s and one with `lag_s`,
    with room of 0.3 m/s and 0.3 times the limit of set-points: a vehicle that does not follow at all.

    Args:
        max_m_s2: largest acceleration that the model may leave out [m/s^2].
    """

    def __init__(self, lag_s: float, max_speed_m_s: float, max_m_s2: float) -> None:
        self.lag_s, self.max_m_s2 = max(lag_s, _SHORTEST_LAG_S), max_m_s2
        self.room_m_s = _ROOM_M_S + _ROOM * max_speed_m_s
        self.words = ""
        self._bounds: list[list[float]] | None = None  # of each component, by both responses
        self._last_s, self._since_s = 0.0, math.inf

    def reset(self) -> None:
        """Forget the motion so far: others flew the vehicle."""
        self._bounds, self._since_s = None, math.inf

    def update(self, now_s: float, state: VehicleState, decision: Decision, sent: Setpoint | None) -> None:
        """Compare the motion in a tick.

        Args:
            sent: set-point that was sent in this tick; None if none was.
        """
        is_off = isinstance(sent, VelocitySetpoint) and self._leaves(
            now_s, state.velocity.tolist(), sent.velocity.tolist()
        )
        if decision.disturbance is not None:
            left_out = math.sqrt(float(decision.disturbance @ decision.disturbance))
            worst = max(left_out, decision.disturbance_bound)
            most = self.max_m_s2 * (1.0 if isinstance(decision.setpoint, RatesSetpoint) else _OF_RESPONSE)
            if not worst < _AT_LIMIT * most:
                is_off = True
                self.words = f"{worst:.1f} m/s^2 that the model leaves out, at most {most:g} are allowed"
        self._since_s = min(self._since_s, now_s) if is_off else math.inf

    def off_s(self, now_s: float) -> float:
        """Time for which the motion has contradicted the model [s]; 0 if it does not."""
        return max(0.0, now_s - self._since_s)

    def _leaves(self, now_s: float, velocity: list[float], commanded: list[float]) -> bool:
        if self._bounds is None:
            self._bounds, self._last_s = [[v, v] for v in velocity], now_s
            return False
        dt_s, self._last_s = max(0.0, now_s - self._last_s), now_s
        shares = [-math.expm1(-dt_s / lag) for lag in (_SHORTEST_LAG_S, self.lag_s)]
        for v, u, bounds in zip(velocity, commanded, self._bounds, strict=True):
            for i, share in enumerate(shares):
                bounds[i] += share * (u - bounds[i])
            if not min(bounds) - self.room_m_s <= v <= max(bounds) + self.room_m_s:
                self.words = f"{v:.2f} m/s where {u:.2f} m/s are commanded"
                return True
        return False
