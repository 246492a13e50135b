"""When a flight gets a new plan, and how it joins it."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.log.foxglove import INFO, WARNING
from alula.stages.filtering.protocol import FilterStatus
from alula.stages.flight.commanders.protocol import Decision
from alula.stages.flight.links.protocol import VehicleState
from alula.stages.flight.loop.plan_clock import PlanClock, Reference, heading_of
from alula.stages.flight.replan.process import Planner
from alula.stages.flight.replan.task import ReplanAnswer, ReplanRequest, remaining, words_of
from alula.stages.planning.adherence import FINISHED_M, waits
from alula.stages.planning.plan_samples import curve_of

_SLOW = 0.1  # a plan whose time runs at less than this rate is held up
_CHANGED = 0.5  # the filter must have changed at least this part of the commands meanwhile
_ACCELERATION_S = 0.2  # over which the acceleration is measured
_MOVES_M_S = 0.05  # a slower plan is joined at rest
_JOINTS = 101  # points of a plan that the vehicle may join it at


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplanOptions:
    """Parameters of `Replanner`.

    Attributes:
        after_s: a flight that its filter holds up for so long gets a new plan [s].
        most: maximum number of requests in a flight.
        join_m: maximum distance of the vehicle from a plan at which it is joined [m].
        margin_m: additional distance from the end at which a filter may stop the vehicle [m].
    """

    after_s: float
    most: int
    join_m: float
    margin_m: float
    via_tolerance_m: float


@dataclass(frozen=True, slots=True)
class Joined:
    """A plan that was joined in flight."""

    time_s: float
    plan: Artifact


class HeldUp:
    """Notices that a filter holds a flight up: the time along its plan runs at less than a tenth of its rate.

    Only ticks with set-points along the plan count, so holds in between neither add nor interrupt.

    Args:
        after_s: for how long this must be so [s].
        near_m: a vehicle nearer to its reference is not held up [m].
    """

    def __init__(self, after_s: float, near_m: float) -> None:
        self.after_s, self.near_m = after_s, near_m
        self.restart(0.0)

    def restart(self, plan_s: float) -> None:
        """Begin anew."""
        self._from_s, self._for_s, self._changed_s = plan_s, 0.0, 0.0

    def update(self, dt_s: float, plan_s: float, error_m: float, *, is_changed: bool) -> bool:
        """Add a tick; True if the flight is held up."""
        if not 0 <= plan_s - self._from_s <= _SLOW * self.after_s or error_m <= self.near_m:
            self.restart(plan_s)
        self._for_s += dt_s
        self._changed_s += dt_s * is_changed
        if self._for_s < self.after_s:
            return False
        is_held_up = self._changed_s >= _CHANGED * self._for_s
        if not is_held_up:
            self.restart(plan_s)
        return is_held_up


class Replanner:
    """Asks for new plans while a flight is held up, and joins those that were made.

    A plan is joined at its point nearest to the vehicle, among those that it reaches in the time that the
    planning took, and at most `join_m` away: the plan keeps that much more than the vehicle's radius from
    the map, so the way to it is clear. The time along it begins with the rate at which its velocity is that
    of the vehicle. If there is no such plan the flight goes on along the one before.

    Args:
        via: via points of the flight, shape (V, 3) [m].
    """

    def __init__(self, planner: Planner, via: FloatArray, options: ReplanOptions) -> None:
        self._planner, self._via, self._options = planner, via, options
        self._held = HeldUp(options.after_s, FINISHED_M + options.margin_m)
        self._passed = 0
        self._velocities: deque[tuple[float, FloatArray]] = deque()
        self._asked_s: float | None = None
        self._is_over = False
        self.joined: list[Joined] = []
        self.asked = 0

    def tick(
        self,
        now_s: float,
        dt_s: float,
        state: VehicleState,
        plan: Reference,
        decision: Decision,
        home: FloatArray | None,
        say: Callable[[int, str], None],
    ) -> Reference | None:
        """Look at a tick along the plan, after its set-point was sent; return a plan to continue with.

        Args:
            home: position at take-off, shape (3,) [m].
        """
        self._watch(state)
        is_changed = decision.status is not FilterStatus.OK
        is_held_up = self._held.update(dt_s, plan.time_s, decision.error_m, is_changed=is_changed)
        if self._asked_s is not None:
            return self._answered(now_s, self._asked_s, state, plan, say)
        if is_held_up and not self._is_over:
            self._ask(now_s, state, plan, home, say)
        return None

    def close(self) -> None:
        """End the planner."""
        self._planner.close()

    def _watch(self, state: VehicleState) -> None:
        """Count the via points that were passed, and keep the last velocities."""
        while self._passed < len(self._via):
            if np.linalg.norm(state.position - self._via[self._passed]) > self._options.via_tolerance_m:
                break
            self._passed += 1
        kept = self._velocities
        if not kept or state.received_s > kept[-1][0]:
            kept.append((state.received_s, state.velocity))
        while kept[-1][0] - kept[0][0] > _ACCELERATION_S:
            kept.popleft()

    def _acceleration(self) -> FloatArray:
        (first_s, first), (last_s, last) = self._velocities[0], self._velocities[-1]
        duration = last_s - first_s
        return (last - first) / duration if duration > 0.5 * _ACCELERATION_S else np.zeros(3)

    def _ask(
        self,
        now_s: float,
        state: VehicleState,
        plan: Reference,
        home: FloatArray | None,
        say: Callable[[int, str], None],
    ) -> None:
        self._held.restart(plan.time_s)
        if self.asked == self._options.most:
            self._is_over = True
            say(WARNING, f"held up by the filter again; no more than {self.asked} new plans are asked for")
            return
        self.asked += 1
        acceleration = self._acceleration()
        velocity = state.velocity + acceleration * state.age_s(now_s)
        request = ReplanRequest(
            number=self.asked,
            position=_point(state.position + state.velocity * state.age_s(now_s)),
            velocity=_point(velocity),
            acceleration=_point(acceleration),
            via=remaining(self._via.tolist(), self._passed),
            home=None if home is None else _point(home),
        )
        if self._planner.has_ended:
            self._end(say)
            return
        if not self._planner.ask(request):
            say(
                WARNING,
                "no new plan (the request could not be sent); the flight goes on along the one before",
            )
            return
        self._asked_s = now_s
        say(INFO, f"held up by the filter for {self._options.after_s:g} s; a new plan is being made")

    def _end(self, say: Callable[[int, str], None]) -> None:
        self._is_over, self._asked_s = True, None
        say(WARNING, "the process that makes new plans has ended; the flight goes on without them")

    def _answered(
        self,
        now_s: float,
        asked_s: float,
        state: VehicleState,
        plan: Reference,
        say: Callable[[int, str], None],
    ) -> Reference | None:
        found = self._planner.answer()
        if found is None:
            if self._planner.has_ended:
                self._end(say)
            return None
        self._asked_s = None
        self._held.restart(plan.time_s)
        if found.reason:
            say(WARNING, f"no new plan ({found.reason}); the flight goes on along the one before")
            return None
        return self._join(now_s, now_s - asked_s, state, found, say)

    def _join(
        self,
        now_s: float,
        elapsed_s: float,
        state: VehicleState,
        found: ReplanAnswer,
        say: Callable[[int, str], None],
    ) -> Reference | None:
        made = found.plan
        curve = curve_of(made)
        times = np.linspace(0, min(elapsed_s, curve.duration_s), _JOINTS)
        rows = curve.at(times)
        position = state.position + state.velocity * state.age_s(now_s)
        away = np.linalg.norm(rows[:, :3] - position, axis=1)
        nearest = int(away.argmin())
        if not away[nearest] <= self._options.join_m:
            say(
                WARNING,
                f"the vehicle is {away[nearest]:.2f} m from its new plan, made in {elapsed_s:.2f} s; the "
                "flight goes on along the one before",
            )
            return None
        clock = PlanClock(curve, waits(made, 0.0, self._options.via_tolerance_m))
        rate = _rate(state.velocity, rows[nearest, 3:6])
        clock.enter(float(times[nearest]), rate, heading_of(state.attitude_wxyz))
        self._held.restart(clock.time_s)
        self.joined.append(Joined(now_s, made))
        say(
            WARNING,
            f"new plan {len(self.joined)}: {words_of(made)}; made in {elapsed_s:.2f} s, joined "
            f"{away[nearest]:.2f} m away",
        )
        return clock


def _rate(velocity: FloatArray, planned: FloatArray) -> float:
    """Rate of a plan's time at which its velocity is nearest to that of the vehicle, from 0 to 1."""
    square = float(planned @ planned)
    return min(max(float(velocity @ planned) / square, 0.0), 1.0) if math.sqrt(square) > _MOVES_M_S else 0.0


def _point(vector: FloatArray) -> tuple[float, float, float]:
    x, y, z = vector.tolist()
    return x, y, z
