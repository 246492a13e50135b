"""The loop that flies: at a fixed rate, from state to set-point, under the supervisor."""

from __future__ import annotations

import gc
import math
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.errors import LinkError
from alula.stages.filtering.protocol import FilterStatus
from alula.stages.flight.commanders.tracking import Commander, PlanClock, heading_of
from alula.stages.flight.links.protocol import Link, Order, Setpoint, VehicleState, refusal_words
from alula.stages.flight.loop.checks import FlightChecks
from alula.stages.flight.loop.fence_guard import FenceGuard, Guarded
from alula.stages.flight.loop.frame_check import Jump, MotionCheck
from alula.stages.flight.loop.mode_watch import HealthWatch, ModeWatch
from alula.stages.flight.loop.options import Counters, LoopOptions
from alula.stages.flight.loop.place_watch import PlaceWatch
from alula.stages.flight.loop.supervisor import (
    Action,
    Event,
    Facts,
    FilterHealth,
    State,
    Supervision,
    Taken,
    advance,
    begun,
    sends_setpoints,
)
from alula.stages.flight.recorder.samples import ERROR, INFO, WARNING, FilterSample, Recorder, level_of
from alula.stages.flight.recorder.sampling import filter_sample, tick_sample

_FALLBACKS = frozenset({FilterStatus.RECOVERING, FilterStatus.BACKUP})
_LAST_WORDS_S = 1.0  # for an order to land when the loop itself fails


class ControlLoop:
    """One flight over a link.

    A tick polls the link, looks at the facts, does what the supervisor's table says and, in `State.FLY`,
    sends one set-point. So it does in `State.HOLD` while the state is fresh and the filter well: the filter's
    answer to standing still; otherwise the vehicle holds by itself. Deadlines are absolute: a tick that
    overruns makes the next one late, and deadlines that have passed are left out, not made up for. Whatever a
    filter raises holds the vehicle.

    Args:
        link: opened and prepared.
        commander: makes set-points.
        guard: the fence.
        plan: the time along the plan.
        checks: before take-off.
        height_m: of the plan's start, in the world.
        recorder: takes samples and lines.
        options: see `LoopOptions`.
        interrupts: how often the operator has asked to end.
        clock, sleep: monotonic time [s], and waiting.
    """

    def __init__(
        self,
        link: Link,
        commander: Commander,
        guard: FenceGuard,
        plan: PlanClock,
        checks: FlightChecks,
        height_m: float,
        recorder: Recorder,
        options: LoopOptions,
        *,
        interrupts: Callable[[], int] = lambda: 0,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.link, self.commander, self.guard, self.plan, self.checks = link, commander, guard, plan, checks
        self.recorder, self.options = recorder, options
        self.supervision = Supervision()
        self.counters = Counters()
        self.taken: list[tuple[float, Taken]] = []
        self._start_height_m = height_m
        self._interrupts, self._clock, self._sleep = interrupts, clock, sleep
        self._begin_s = 0.0
        self._modes, self._health, self._places = ModeWatch(), HealthWatch(), PlaceWatch(height_m)
        self._motion, self._jump, self._jump_m = MotionCheck(), Jump(), 0.0
        self._ground_m: float | None = None
        self._filter = FilterHealth.GOOD
        self._fallback_from_s, self._overruns = math.inf, 0
        self._fence_m: float | None = None
        self._astray_m = self._drift_m = 0.0
        self._refused_s, self._refused = math.inf, (State.IDLE, "")
        self._jumps: int | None = None
        self._deaf = False
        self._was_there = False
        self._rested_s = 0.0
        self._place: FloatArray | None = None  # where the filter holds it, a row of the reference
        self._sent: Setpoint | None = None  # in this tick

    @property
    def state(self) -> State:
        """Of the supervisor."""
        return self.supervision.state

    def run(self) -> None:
        """Fly until the supervisor is done.

        Raises:
            Exception: what the loop itself failed with, after the vehicle was told to land.
        """
        gc.collect()
        gc.freeze()
        gc.disable()
        self._begin_s = self._clock()
        try:
            self._loop()
        except BaseException:
            self._last_words()
            raise
        finally:
            gc.enable()
            gc.unfreeze()

    def _loop(self) -> None:
        period, counters = 1 / self.options.rate_hz, self.counters
        self.supervision, taken = begun(self._begin_s)
        self._act(taken, self._begin_s)
        deadline, spent = self._begin_s, 0.0
        while self.state is not State.DONE:
            wait = deadline - self._clock()
            if wait > 0:
                self._sleep(min(wait, period))  # more only where a clock goes back
            now = self._clock()
            late = now - deadline
            self.tick(now, late, spent)
            spent = self._clock() - now
            counters.late_s.append(late)
            counters.tick_s.append(spent)
            has_overrun = late + spent > period
            counters.overruns += has_overrun
            self._overruns = self._overruns + 1 if has_overrun else 0
            deadline += period
            if (behind := self._clock() - deadline) >= period:
                missed = int(behind / period + 0.1) + 1  # the next one is not at once
                counters.skipped += missed
                deadline += missed * period
                if (still := self._sent) is not None:  # it is followed until the next one
                    for _ in range(missed):
                        self.commander.sent(still)

    def tick(self, now_s: float, late_s: float, spent_s: float) -> None:
        """One tick; `spent_s` is what the one before took."""
        self._sent = None
        self._poll(now_s)
        state = self.link.state
        self._look(state, now_s, late_s)
        self._supervise(now_s, late_s)
        sample = None
        if state is not None and (sends_setpoints(self.state) or self._stays(state, now_s)):
            sample = self._fly(state, now_s)
            if self._filter is not FilterHealth.GOOD or self._fence_m == -math.inf:
                self._supervise(now_s, late_s)
        self._record(state, now_s, late_s, spent_s, sample)

    def _poll(self, now_s: float) -> None:
        try:
            self.link.poll(now_s)
            self._deaf = False
        except LinkError as error:
            if not self._deaf:
                self.say(now_s, ERROR, str(error))
            self._deaf = True
        status = self.link.status
        while status.texts:
            self.say(now_s, INFO, f"vehicle: {status.texts.pop(0)}")
        while status.refusals:
            refused = self.state, refusal_words(*status.refusals.pop(0))
            if refused != self._refused:  # orders are given again and again
                self.say(now_s, WARNING, refused[1])
            self._refused = refused
            self._refused_s = min(self._refused_s, now_s)

    def _look(self, state: VehicleState | None, now_s: float, late_s: float) -> None:
        """What takes more than a glance: distances, the frame, the checks."""
        where = self.state
        if where is State.CHECKS:
            self.checks.look(self.link, now_s, late_s, partial(self.say, now_s))
        self._look_where(state)
        self._jump_m = 0.0 if state is None else self._jump.of(state)
        if state is not None and self.options.watch_frame and where in (State.TAKE_OFF, State.FLY):
            self._motion.update(state)

    def _look_where(self, state: VehicleState | None) -> None:
        where = self.state
        self._fence_m, self._astray_m, self._drift_m = None, 0.0, 0.0
        if state is None:
            return
        if where in (State.FLY, State.HOLD):
            self._fence_m = self.guard.distance(state)
        elif where is State.TAKE_OFF:  # the ground may be nearer than the fence allows
            self._fence_m = self.guard.distance(state, self._start_height_m)
        if where in (State.ARMING, State.TAKE_OFF):
            self._astray_m = self._places.astray_m(state)
        if where is State.HOLD:
            self._drift_m = self._places.drift_m(state)

    def _facts(self, now_s: float, late_s: float) -> Facts:
        state, status = self.link.state, self.link.status
        ground, start = self._ground_m, self._start_height_m
        silence = math.inf if status.heard_s is None or self._deaf else now_s - status.heard_s
        return Facts(
            now_s=now_s,
            state_age_s=math.inf if state is None else now_s - state.received_s,
            jump_m=self._jump_m,
            silence_s=silence,
            armed=status.armed,
            landed=status.landed,
            obeys=status.obeys,
            is_failsafe=status.is_failsafe,
            untold=self._health.is_untold(status, now_s),
            astray_m=self._astray_m,
            drift_m=self._drift_m,
            restarted=self._jumps is not None and status.clock_jumps > self._jumps,
            estimator_ready=status.is_estimator_ready,
            battery_share=status.battery_share,
            is_ours=self._modes.is_ours(status),
            order_refused=now_s - self._refused_s > 1.0,
            checks=self.checks.result,
            dry_run=self.options.dry_run,
            climbed_m=None if state is None or ground is None else float(state.position[2]) - ground,
            height_m=math.inf if ground is None else start - ground,
            frame_wrong=bool(self._motion.wrong),
            late_s=late_s,
            overruns=self._overruns,
            filter=self._filter,
            fallback_s=max(0.0, now_s - self._fallback_from_s),
            fence_m=self._fence_m,
            plan_done=self._was_there,
            interrupts=self._interrupts(),
        )

    def _supervise(self, now_s: float, late_s: float) -> None:
        facts = self._facts(now_s, late_s)
        self.supervision, taken = advance(self.supervision, facts, self.options.limits)
        if facts.order_refused:
            self._refused_s = math.inf
        self._act(taken, now_s)

    def _act(self, taken: list[Taken], now_s: float) -> None:
        for each in taken:
            is_new = not self.taken or self.taken[-1][1] != each
            self.taken.append((now_s - self._begin_s, each))
            self.recorder.step(now_s - self._begin_s, each)
            detail = self._motion.wrong if each.event is Event.FRAME_WRONG else ""
            if each.event in (Event.CHECK_FAILED, Event.TIMED_OUT) and each.state is State.CHECKS:
                detail = self.checks.failure()
            if is_new:
                self.say(now_s, level_of(each), f"{each.step.words}{f' ({detail})' if detail else ''}")
            self._try(each.step.action, now_s)

    def _try(self, action: Action, now_s: float) -> None:
        """Do it, or say why not, as if the vehicle had declined it."""
        try:
            self._do(action, now_s)
        except LinkError as error:
            self.say(now_s, ERROR, f"{action.value}: {error}")
            self._refused_s = min(self._refused_s, now_s)

    def _do(self, action: Action, now_s: float) -> None:
        state, status = self.link.state, self.link.status
        if action is Action.ARM:
            if self._jumps is None:
                self._jumps = status.clock_jumps
                self._health.armed(status)
                if self.checks.place is not None:
                    self._places.proven(self.checks.place, self.checks.room_m)
                    self._ground_m = float(self.checks.place[2])
            self._order(Order.ARM, now_s)
        elif action is Action.TAKE_OFF:
            if self._ground_m is None:
                raise LinkError("the vehicle has not said where it stands")
            self._order(Order.TAKE_OFF, now_s, self._start_height_m - self._ground_m)
        elif action is Action.ENGAGE:
            self._place = None
            self._places.moved()
            self.commander.reset()
            self.guard.reset()
            if state is not None:
                self.plan.pause(heading_of(state.attitude_wxyz))
            self._filter, self._fallback_from_s, self._overruns = FilterHealth.GOOD, math.inf, 0
            self._order(Order.TAKE_CONTROL, now_s)
        elif action is Action.HOLD:
            self._order(Order.HOLD, now_s)
        elif action is Action.LAND:
            self._order(Order.LAND, now_s)
        elif action is Action.DISARM and status.landed is not False:
            self.link.order(Order.DISARM, now_s)
        elif action is Action.LET_GO:
            self.link.order(Order.NOTHING, now_s)

    def _order(self, order: Order, now_s: float, height_m: float = 0.0) -> None:
        self._modes.ordered(order, self.link.status)
        self.link.order(order, now_s, height_m)

    def _stays(self, state: VehicleState, now_s: float) -> bool:
        """Whether a hold is the filter's; where it ceases to be, it is the vehicle's own again."""
        is_hold = self.state is State.HOLD
        is_well = self._filter is FilterHealth.GOOD and self.supervision.well_since_s < math.inf
        stays = is_hold and is_well and self.link.status.obeys
        if stays and self._place is None:
            self.commander.reset()
            self.guard.reset()
            self._place = np.zeros((1, 18))
            self._place[0, :3], self._place[0, 15] = state.position, heading_of(state.attitude_wxyz)
        elif not stays and self._place is not None:
            self._place = None
            if is_hold:
                self._try(Action.HOLD, now_s)
        return stays

    def _fly(self, state: VehicleState, now_s: float) -> FilterSample | None:
        """One set-point; what goes wrong on the way is for the supervisor."""
        age, before = max(0.0, now_s - state.received_s), self._clock()
        try:
            target = self.plan.target() if self._place is None else self._place
            decision = self.commander.decide(state, age, target)
            filter_s = self._clock() - before
            if not math.isfinite(decision.error_m):
                raise ArithmeticError("how far it is from the plan is not a number")
            guarded = Guarded(None, math.nan, 0.0, takes_over=False)
            if decision.setpoint is None:
                self._filter = FilterHealth.REFUSED
            else:
                guarded = self.guard.guard(state, age, decision.setpoint)
                if guarded.setpoint is None and self._place is not None:
                    self._filter = FilterHealth.REFUSED  # the vehicle's own hold is what the fence asks for
                elif guarded.setpoint is None:
                    self._fence_m = -math.inf
                else:
                    self.link.send(guarded.setpoint, now_s)
                    self._sent = guarded.setpoint
                    self.commander.sent(self._sent)
        except Exception as error:  # noqa: BLE001  whatever a filter raises must not leave the vehicle alone
            self._filter = FilterHealth.FAILED
            self.say(now_s, ERROR, f"no set-point: {type(error).__name__}: {error}")
            return None
        self.counters.filter_s.append(filter_s)
        period, is_fallback = 1 / self.options.rate_hz, decision.status in _FALLBACKS or guarded.takes_over
        self._fallback_from_s = min(self._fallback_from_s, now_s) if is_fallback else math.inf
        if self._place is None:
            self.plan.advance(period, decision.error_m)
            self._arrive(math.sqrt(float(state.velocity @ state.velocity)), decision.error_m, period)
        return filter_sample(decision, guarded, self.plan, filter_s)

    def _arrive(self, speed_m_s: float, error_m: float, period_s: float) -> None:
        """Whether it is at the end of the plan, or as near as its filter lets it."""
        options = self.options
        is_slow = self.plan.is_over and speed_m_s < options.stop_speed_m_s
        self._rested_s = self._rested_s + period_s if is_slow else 0.0
        near = options.stop_m + (options.margin_m if self._rested_s > options.rest_s else 0.0)
        self._was_there = self._was_there or (is_slow and error_m < near)

    def _record(
        self,
        state: VehicleState | None,
        now_s: float,
        late_s: float,
        spent_s: float,
        flown: FilterSample | None,
    ) -> None:
        times = (now_s - self._begin_s, late_s, spent_s, 0.0 if state is None else now_s - state.received_s)
        self.recorder.tick(
            tick_sample(times, self.state.value, state, self.link.status, self._fence_m, flown)
        )

    def say(self, now_s: float, level: int, words: str) -> None:
        """A line for people."""
        self.recorder.say(now_s - self._begin_s, level, words)

    def _last_words(self) -> None:
        """The loop itself failed: land, if it may be flying and is ours."""
        if self.state in (State.IDLE, State.CHECKS, State.HAND_OVER, State.DONE):
            return
        now, is_told = self._clock(), False
        until = now + _LAST_WORDS_S
        while now < until:
            with suppress(Exception):  # the first error is the one to see, and this the last that can be done
                if not is_told:
                    self.link.order(Order.LAND, now)
                    is_told = True
                self.link.poll(now)
            self._sleep(0.02)
            now = self._clock()
