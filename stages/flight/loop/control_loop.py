"""Control loop of a real flight: from state to set-point at a fixed rate, under the supervisor.

This file is one thing and therefore long: the order of the steps within a tick is what makes it safe.
"""

from __future__ import annotations

import gc
import math
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.errors import LinkError
from alula.schemas.log.foxglove import ERROR, INFO, WARNING
from alula.stages.durations import Durations
from alula.stages.filtering.protocol import FilterStatus
from alula.stages.flight.commanders.protocol import Commander, Decision
from alula.stages.flight.links.protocol import Link, Order, VehicleState, refusal_words
from alula.stages.flight.loop.checks import FlightChecks
from alula.stages.flight.loop.crash_watch import CrashWatch
from alula.stages.flight.loop.fence_guard import FenceGuard, Guarded
from alula.stages.flight.loop.frame_check import MotionCheck
from alula.stages.flight.loop.plan_clock import Reference, heading_of
from alula.stages.flight.loop.supervisor import (
    Action,
    Event,
    Facts,
    FilterHealth,
    State,
    Supervision,
    SupervisorLimits,
    Taken,
    advance,
    begun,
    sends_setpoints,
)
from alula.stages.flight.loop.watches import (
    HealthWatch,
    JumpWatch,
    ModelWatch,
    ModeWatch,
    PositionWatch,
    SlipWatch,
)
from alula.stages.flight.recorder.samples import (
    Flown,
    Recorder,
    level_of,
    tick_sample,
)
from alula.stages.flight.replan.replanner import Replanner
from alula.stages.flight.watchdog.watchdog import Watchdog
from alula.stages.planning.adherence import FINISHED_M, FINISHED_M_S
from alula.stages.planning.plan_samples import curve_of, path_of
from alula.stages.vehicles.setpoints import Setpoint, VelocitySetpoint

_FALLBACKS = frozenset({FilterStatus.RECOVERING, FilterStatus.BACKUP})
_TOLD_LATE = frozenset({Event.FAILSAFE, Event.FAILSAFE_IDLE, Event.DISARMED})  # the vehicle gives the reason
_WATCHED = frozenset({State.TAKE_OFF, State.FLY, State.HOLD, State.LAND})
_CREEP_M = 0.05  # on the ground, which is worth a line
_EMERGENCY_S = 1.0  # for the order to land when the loop itself fails


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopOptions:
    """Parameters of the control loop.

    Attributes:
        dry_run: end after the pre-flight checks.
        watch_frame: compare motion with the frame from take-off on.
        stop_m, stop_speed_m_s: maximum distance from the end of the plan [m] and maximum speed [m/s] at which
            the end counts as reached.
        margin_m: additional distance at which a filter may stop the vehicle [m]; it is accepted after the
            vehicle has been at rest for `rest_s` [s].
        velocity_lag_s: longest lag with which the vehicle is assumed to follow velocities [s].
        max_disturbance_m_s2: largest acceleration that the vehicle's model may leave out [m/s^2].
    """

    rate_hz: float = 100.0
    limits: SupervisorLimits = field(default_factory=SupervisorLimits)
    dry_run: bool = False
    watch_frame: bool = True
    stop_m: float = FINISHED_M
    stop_speed_m_s: float = FINISHED_M_S
    margin_m: float = 0.0
    rest_s: float = 1.5
    velocity_lag_s: float = 1.0
    max_speed_m_s: float = 1.0
    max_disturbance_m_s2: float = 4.0


@dataclass(slots=True)
class Counters:
    """Measured times of a flight.

    Attributes:
        late_s, tick_s: lateness and duration of each tick, in all states [s].
        overruns: ticks that ended after the next deadline.
        skipped: deadlines that were left out.
    """

    late_s: Durations = field(default_factory=Durations)
    tick_s: Durations = field(default_factory=Durations)
    filter_s: Durations = field(default_factory=Durations)
    overruns: int = 0
    skipped: int = 0


class ControlLoop:
    """Control loop of one flight over a link.

    A tick polls the link, collects the facts, performs the actions of the supervisor's table and, in
    `State.FLY`, sends one set-point. In `State.HOLD` it also sends one while the state is fresh and the
    filter works: the filter's answer to a reference that stands still. Otherwise the vehicle holds by itself.

    Deadlines are absolute: a tick that overruns makes the next one late, and deadlines that have passed are
    left out. An exception of the filter leads to a hold.

    Args:
        height_m: height of the plan's start, world frame [m].
        watchdog: takes the vehicle over when this loop ends or stalls; `run` closes it. None for none.
        replanner: makes new plans where the filter holds the vehicle up; `run` closes it. None for none.
        interrupts: returns how often the operator has interrupted the program.
    """

    def __init__(
        self,
        link: Link,
        commander: Commander,
        guard: FenceGuard,
        plan: Reference,
        checks: FlightChecks,
        height_m: float,
        recorder: Recorder,
        options: LoopOptions,
        *,
        watchdog: Watchdog | None = None,
        replanner: Replanner | None = None,
        interrupts: Callable[[], int] = lambda: 0,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.link, self.commander, self.guard, self.plan, self.checks = link, commander, guard, plan, checks
        self.recorder, self.options, self._watchdog = recorder, options, watchdog
        self._replanner = replanner
        self.supervision = Supervision()
        self.counters = Counters()
        self.taken: list[tuple[float, Taken]] = []
        self._start_height_m = height_m
        self._interrupts, self._clock, self._sleep = interrupts, clock, sleep
        self._begin_s = 0.0
        self._modes, self._health, self._positions = ModeWatch(), HealthWatch(), PositionWatch(height_m)
        self._crash = CrashWatch()
        self._model = ModelWatch(options.velocity_lag_s, options.max_speed_m_s, options.max_disturbance_m_s2)
        self._motion, self._jumps, self._jump_m = MotionCheck(), JumpWatch(), 0.0
        self._slips, self._slip_m, self._free_m = SlipWatch(), 0.0, math.inf
        self._ground_m: float | None = None
        self._filter = FilterHealth.GOOD
        self._fallback_from_s, self._overruns = math.inf, 0
        self._fence_m: float | None = None
        self._off_climb_m = self._drift_m = 0.0
        self._refused_s, self._refused = math.inf, (State.IDLE, "")
        self._clock_jumps: int | None = None  # of the vehicle's clock, when arming was first ordered
        self._link_failed = False
        self._has_arrived = False
        self._rested_s = 0.0
        self._hold_row: FloatArray | None = None  # where the filter holds it, a row of the reference
        self._sent: Setpoint | None = None  # in this tick
        self._beat_s, self._gap_s, self._stalled_s, self._is_unwatched = 0.0, 0.0, 0.0, False
        self._taken_s: float | None = None  # when it was found that the watchdog had taken over
        self._cause: Event | None = None
        self._cause_detail = ""  # reason of the cause in words

    @property
    def state(self) -> State:
        """State of the supervisor."""
        return self.supervision.state

    @property
    def has_finished(self) -> bool:
        """True if the vehicle was at the end of the plan, whatever happened afterwards."""
        return self._has_arrived

    @property
    def ending(self) -> str:
        """Cause of the end of the flight in words, with the reason as far as it is known."""
        cause = self.supervision.cause
        if cause is None:
            return "no reason is known"
        late = self.link.status.failsafe if cause in _TOLD_LATE else ""
        detail = self._cause_detail or late  # the vehicle may give its reason after the change of its mode
        return f"{cause.value} ({detail})" if detail else cause.value

    @property
    def joined(self) -> list[tuple[float, Artifact]]:
        """Plans that the vehicle joined in flight, with the times since the start of the flight [s]."""
        found = [] if self._replanner is None else self._replanner.joined
        return [(each.time_s - self._begin_s, each.plan) for each in found]

    def run(self) -> None:
        """Fly until the supervisor is done.

        Raises:
            Exception: any error of the loop itself, after the order to land was sent.
        """
        gc.collect()
        gc.disable()
        self._begin_s = self._beat_s = self._clock()
        try:
            self._loop()
        except BaseException:
            self._emergency_land()
            raise
        finally:
            gc.enable()
            if self._watchdog is not None:
                self._watchdog.close()
            if self._replanner is not None:
                self._replanner.close()

    def _loop(self) -> None:
        period, counters = 1 / self.options.rate_hz, self.counters
        self.supervision, taken = begun(self._begin_s)
        self._act(taken, self._begin_s)
        deadline, spent = self._begin_s, 0.0
        while self.state is not State.DONE:
            wait = deadline - self._clock()
            if wait > 0:
                self._sleep(min(wait, period))  # a longer wait means that the clock went back
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
                missed = int(behind / period + 0.1) + 1  # so that the next tick is not immediate
                counters.skipped += missed
                deadline += missed * period
                if (active := self._sent) is not None:  # the vehicle follows it until the next set-point
                    for _ in range(missed):
                        self.commander.sent(active)

    def tick(self, now_s: float, late_s: float, spent_s: float) -> None:
        """Run one tick."""
        self._sent = None
        if self._watchdog is not None and self._taken_s is None and self._watchdog.has_taken_over:
            # What stops the program within a tick lets it beat once more before it sees what was done.
            self._taken_s, self._stalled_s = now_s, max(self._gap_s, now_s - self._beat_s)
            self._supervise(now_s, late_s)  # before an order that is still pending is repeated
        self._poll(now_s)
        state = self.link.state
        self._observe(state, now_s, late_s)
        self._supervise(now_s, late_s)
        sample = None
        if state is not None and (sends_setpoints(self.state) or self._filters_hold(state, now_s)):
            sample = self._fly(state, now_s)
            if self._filter is not FilterHealth.GOOD or self._fence_m == -math.inf:
                self._supervise(now_s, late_s)
        self._record(state, now_s, late_s, spent_s, sample)
        self._beat()

    def _beat(self) -> None:
        """Tell the watchdog that the loop lives, and whether the vehicle depends on it."""
        watchdog, status = self._watchdog, self.link.status
        if watchdog is None:
            return
        beat_s = self._clock()
        self._beat_s, self._gap_s = beat_s, beat_s - self._beat_s
        is_in_control = self.state in _WATCHED and (status.obeys or not status.mode)
        watchdog.beat(beat_s, is_in_control=is_in_control)
        if watchdog.has_ended and not self._is_unwatched:
            self._is_unwatched = True
            self.say(beat_s, WARNING, "the watchdog has ended; the vehicle's own failsafes remain")

    def _poll(self, now_s: float) -> None:
        try:
            self.link.poll(now_s)
            self._link_failed = False
        except LinkError as error:
            if not self._link_failed:
                self.say(now_s, ERROR, str(error))
            self._link_failed = True
        status = self.link.status
        while status.texts:
            self.say(now_s, INFO, f"vehicle: {status.texts.pop(0)}")
        while status.refusals:
            refused = self.state, refusal_words(*status.refusals.pop(0))
            if refused != self._refused:  # orders are repeated
                self.say(now_s, WARNING, refused[1])
            self._refused = refused
            self._refused_s = min(self._refused_s, now_s)

    def _observe(self, state: VehicleState | None, now_s: float, late_s: float) -> None:
        """Run the checks and update distances, jumps and the frame."""
        phase = self.state
        if phase is State.CHECKS:
            self.checks.look(self.link, now_s, late_s, partial(self.say, now_s))
        self._observe_distances(state)
        self._jump_m = 0.0 if state is None else self._jumps.jump_m(state)
        if state is not None and (phase is State.ARMING or phase in _WATCHED):
            self._slip_m = self._slips.slip_m(state, is_resting=phase is State.ARMING)
        if state is not None and phase in (State.TAKE_OFF, State.FLY, State.HOLD, State.LAND):
            self._watch_crash(state, phase)
        if state is not None and self.options.watch_frame and phase in (State.TAKE_OFF, State.FLY):
            self._motion.update(state)

    def _watch_crash(self, state: VehicleState, phase: State) -> None:
        height_m = math.inf if self._ground_m is None else float(state.position[2]) - self._ground_m
        is_flown = phase in (State.FLY, State.HOLD)
        plan_m = float(self.plan.target()[0, 2] - state.position[2]) if is_flown else -math.inf
        self._crash.update(state, height_m, plan_m, is_landing=phase is State.LAND)

    def _observe_distances(self, state: VehicleState | None) -> None:
        phase = self.state
        self._fence_m, self._off_climb_m, self._drift_m = None, 0.0, 0.0
        if state is None:
            return
        if phase in (State.FLY, State.HOLD):
            self._fence_m = self.guard.distance(state)
        elif phase is State.TAKE_OFF:  # the ground may be nearer than the fence allows
            self._fence_m = self.guard.distance(state, self._start_height_m)
        if phase in (State.ARMING, State.TAKE_OFF):
            self._off_climb_m = self._positions.off_climb_m(state)
        if phase is State.HOLD:
            self._drift_m = self._positions.drift_m(state)

    def _facts(self, now_s: float, late_s: float) -> Facts:
        state, status = self.link.state, self.link.status
        ground, start = self._ground_m, self._start_height_m
        silence = math.inf
        if status.heard_s is not None and not self._link_failed:  # until then the watchdog may have read all
            silence = now_s - max(status.heard_s, self._taken_s or -math.inf)
        return Facts(
            now_s=now_s,
            state_age_s=math.inf if state is None else state.age_s(now_s),
            jump_m=self._jump_m,
            slip_m=self._slip_m,
            free_m=self._free_m,
            silence_s=silence,
            armed=status.armed,
            landed=status.landed,
            obeys=status.obeys,
            is_failsafe=status.is_failsafe,
            health_unknown=self._health.is_unknown(status, now_s),
            parameter_changed=bool(status.changed),
            off_climb_m=self._off_climb_m,
            drift_m=self._drift_m,
            from_goal_m=self._from_goal_m(state),
            strayed_m=status.strayed_m,
            sinks=status.sinks,
            is_lying=self._crash.is_lying,
            is_over=self._crash.is_over,
            is_fallen=self._crash.is_down,
            is_still=self._crash.is_still and status.settles,
            restarted=self._clock_jumps is not None and status.clock_jumps > self._clock_jumps,
            estimator_ready=status.is_estimator_ready,
            battery_share=status.battery_share,
            is_ours=self._modes.is_ours(status),
            by_failsafe=self._modes.by_failsafe,
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
            model_off_s=self._model.off_s(now_s),
            fence_m=self._fence_m,
            plan_done=self._has_arrived,
            watchdog=self._taken_s is not None,
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
            detail = self._detail(each)
            if each.event is self.supervision.cause and each.event is not self._cause:
                self._cause, self._cause_detail = each.event, detail
            if is_new:
                self.say(now_s, level_of(each), f"{each.step.words}{f' ({detail})' if detail else ''}")
            self._try(each.step.action, now_s)

    def _detail(self, taken: Taken) -> str:
        """Reason of an event in words, as far as it is known; empty if the event's name says it all."""
        if taken.event is Event.FRAME_WRONG:
            return self._motion.wrong
        if taken.event is Event.WATCHDOG:
            return f"the loop stalled for {self._stalled_s:.2f} s"
        if taken.event in _TOLD_LATE:
            return self.link.status.failsafe
        if taken.event in (Event.CHECK_FAILED, Event.TIMED_OUT) and taken.state is State.CHECKS:
            return self.checks.failure()
        if taken.event in (Event.CRASHED, Event.TURNED_OVER, Event.FALLEN):
            return self._crash.words
        if taken.event is Event.MODEL_WRONG:
            return self._model.words
        if taken.event is Event.SLIPS:
            room = "" if math.isinf(self._free_m) else f", {max(0.0, self._free_m):.2f} m from obstacles"
            return f"by {self._slip_m:.2f} m{room}"
        if taken.event is Event.OFF_CLIMB:
            room_m = self.checks.room_m
            return f"by {self._off_climb_m + room_m:.2f} m, of which {room_m:.2f} m are proven clear"
        if taken.event is Event.PARAMETER_CHANGED:
            return self.link.status.changed
        if taken.event is Event.STATE_STALE:
            return self.link.status.clock
        if taken.event is Event.ESTIMATOR_BAD:
            return self.link.status.estimator
        if taken.event is Event.LANDED_AWAY:
            strayed_m = self.link.status.strayed_m
            words = f"; by the velocities of satellites up to {strayed_m:.2f} m elsewhere"
            return f"{self._from_goal_m(self.link.state):.2f} m{words if strayed_m > 0 else ''}"
        if taken.event is Event.TIMED_OUT and taken.state is State.LAND:
            return f"landing: the vehicle has not disarmed within {self.options.limits.landing_s:g} s"
        return ""

    def _from_goal_m(self, state: VehicleState | None) -> float:
        if state is None:
            return math.nan
        x, y, _ = (state.position - self.checks.needs.goal).tolist()
        return math.hypot(x, y)

    def _try(self, action: Action, now_s: float) -> None:
        """Perform an action; report a link error and treat it as a refusal by the vehicle."""
        try:
            self._do(action, now_s)
        except LinkError as error:
            self.say(now_s, ERROR, f"{action.value}: {error}")
            self._refused_s = min(self._refused_s, now_s)

    def _do(self, action: Action, now_s: float) -> None:
        state, status = self.link.state, self.link.status
        if action is Action.ARM:
            if self._clock_jumps is None:
                self._clock_jumps = status.clock_jumps
                self._health.armed(status)
                if self.checks.position is not None:
                    self._positions.proven(self.checks.position, self.checks.room_m)
                    self._ground_m = float(self.checks.position[2])
            self._order(Order.ARM, now_s)
        elif action is Action.TAKE_OFF:
            if self._ground_m is None:
                raise LinkError("the vehicle has not reported its position on the ground")
            crept_m = math.nan if state is None else self._positions.crept_m(state)
            if crept_m > _CREEP_M:
                self.say(
                    now_s, WARNING, f"its position moved by {crept_m:.2f} m on the ground since the checks"
                )
            self._order(Order.TAKE_OFF, now_s, self._start_height_m - self._ground_m)
        elif action is Action.ENGAGE:
            self._hold_row = None
            self._positions.moved()
            self._begin_to_fly()
            if state is not None:
                self.plan.pause(heading_of(state.attitude_wxyz))
            self._filter, self._fallback_from_s, self._overruns = FilterHealth.GOOD, math.inf, 0
            self._order(Order.TAKE_CONTROL, now_s)
        elif action is Action.HOLD:
            self._order(Order.HOLD, now_s)
        elif action is Action.LAND:
            self._order(Order.LAND, now_s)
        elif action is Action.STOP:
            self.link.order(Order.STOP, now_s)
        elif action is Action.SETTLE:
            self.link.order(Order.SETTLE, now_s)
        elif action is Action.DISARM and status.landed is not False:
            self.link.order(Order.DISARM, now_s)
        elif action is Action.LET_GO:
            self.link.order(Order.NOTHING, now_s)

    def _order(self, order: Order, now_s: float, height_m: float = 0.0) -> None:
        self._modes.ordered(order, self.link.status)
        self.link.order(order, now_s, height_m)

    def _begin_to_fly(self) -> None:
        self.commander.reset()
        self.guard.reset()
        self._model.reset()

    def _filters_hold(self, state: VehicleState, now_s: float) -> bool:
        """Decide whether the filter holds the vehicle; if no longer, order the vehicle to hold by itself."""
        is_hold = self.state is State.HOLD
        is_well = self._filter is FilterHealth.GOOD and self.supervision.well_since_s < math.inf
        is_filtered = is_hold and is_well and self.link.status.obeys
        if is_filtered and self._hold_row is None:
            self._begin_to_fly()
            self._hold_row = np.zeros((1, 18))
            self._hold_row[0, :3], self._hold_row[0, 15] = state.position, heading_of(state.attitude_wxyz)
        elif not is_filtered and self._hold_row is not None:
            self._hold_row = None
            self._model.reset()
            if is_hold:
                self._try(Action.HOLD, now_s)
        return is_filtered

    def _fly(self, state: VehicleState, now_s: float) -> Flown | None:
        """Compute and send one set-point; failures are left to the supervisor."""
        age, before = max(0.0, now_s - state.received_s), self._clock()
        try:
            target = self.plan.target() if self._hold_row is None else self._hold_row
            decision = self.commander.decide(state, age, target, self._slip_m)
            filter_s = self._clock() - before
            if not math.isfinite(decision.error_m):
                raise ArithmeticError("the distance from the plan is not a number")
            guarded = Guarded(None, math.nan, 0.0, takes_over=False)
            if decision.setpoint is None:
                self._filter = FilterHealth.REFUSED
            else:
                guarded = self.guard.guard(state, age, decision.setpoint)
                if guarded.setpoint is None and self._hold_row is not None:
                    self._filter = FilterHealth.REFUSED  # then the vehicle holds by itself
                elif guarded.setpoint is None:
                    self._fence_m = -math.inf
                else:
                    self.link.send(guarded.setpoint, now_s)
                    self._sent = guarded.setpoint
                    self.commander.sent(self._sent)
        except Exception as error:  # noqa: BLE001  no error of a filter may leave the vehicle without commands
            self._filter = FilterHealth.FAILED
            self.say(now_s, ERROR, f"no set-point: {type(error).__name__}: {error}")
            return None
        self.counters.filter_s.append(filter_s)
        if self.commander.setpoint is VelocitySetpoint:  # of others the margin is no distance
            self._free_m = decision.margin + self.options.margin_m
        self._model.update(now_s, state, decision, self._sent)
        period, is_fallback = 1 / self.options.rate_hz, decision.status in _FALLBACKS or guarded.takes_over
        self._fallback_from_s = min(self._fallback_from_s, now_s) if is_fallback else math.inf
        if self._hold_row is None:
            self.plan.advance(period, decision.error_m)
            self._arrive(math.sqrt(float(state.velocity @ state.velocity)), decision.error_m, period)
        flown = Flown(decision, guarded, self.plan.time_s, self.plan.rate, filter_s)
        if self._hold_row is None:
            self._replan(state, decision, now_s)
        return flown

    def _replan(self, state: VehicleState, decision: Decision, now_s: float) -> None:
        """Continue along a new plan, if there is one; no failure of it changes the flight."""
        replanner = self._replanner
        if replanner is None or self._has_arrived:
            return
        try:
            found = replanner.tick(
                now_s,
                1 / self.options.rate_hz,
                state,
                self.plan,
                decision,
                self.checks.position,
                partial(self.say, now_s),
            )
        except Exception as error:  # noqa: BLE001  the flight goes on along the plan that it has
            self._replanner = None
            replanner.close()
            self.say(now_s, ERROR, f"no more new plans: {type(error).__name__}: {error}")
            return
        if found is not None:
            self.plan, self._rested_s = found, 0.0
            self.recorder.plan(now_s - self._begin_s, path_of(curve_of(replanner.joined[-1].plan)))

    def _arrive(self, speed_m_s: float, error_m: float, period_s: float) -> None:
        """Detect that the vehicle is at the end of the plan, or as near to it as the filter allows."""
        options = self.options
        is_slow = self.plan.is_over and speed_m_s < options.stop_speed_m_s
        self._rested_s = self._rested_s + period_s if is_slow else 0.0
        near = options.stop_m + (options.margin_m if self._rested_s > options.rest_s else 0.0)
        self._has_arrived = self._has_arrived or (is_slow and error_m < near)

    def _record(
        self,
        state: VehicleState | None,
        now_s: float,
        late_s: float,
        spent_s: float,
        flown: Flown | None,
    ) -> None:
        times = (now_s - self._begin_s, late_s, spent_s, 0.0 if state is None else state.age_s(now_s))
        self.recorder.tick(
            tick_sample(
                times,
                self.state,
                state,
                self.link.status,
                self._fence_m,
                flown,
                slip_m=self._slip_m,
                is_velocity=self.commander.setpoint is VelocitySetpoint,
            )
        )

    def say(self, now_s: float, level: int, words: str) -> None:
        """Log a message for the operator."""
        self.recorder.say(now_s - self._begin_s, level, words)

    def _emergency_land(self) -> None:
        """Order a landing after the loop itself failed, if the vehicle may fly and nobody took control."""
        if self.state in (State.IDLE, State.CHECKS, State.HAND_OVER, State.DONE):
            return
        now, is_ordered = self._clock(), False
        until = now + _EMERGENCY_S
        while now < until:
            with suppress(Exception):  # the first error is the one to report
                if not is_ordered:
                    self.link.order(Order.LAND, now)
                    is_ordered = True
                self.link.poll(now)
                self._beat()
            self._sleep(0.02)
            now = self._clock()
