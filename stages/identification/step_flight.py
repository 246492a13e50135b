"""Flight of steps: what the control loop calls instead of a plan's clock, and instead of a filter."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.stages.filtering.protocol import FilterStatus
from alula.stages.flight.commanders.protocol import Decision
from alula.stages.flight.links.protocol import VehicleState
from alula.stages.flight.loop.plan_clock import heading_of
from alula.stages.identification.recording import Phase, Tape
from alula.stages.identification.steps import MAX_LEAN_RAD, Step
from alula.stages.vehicles.setpoints import RatesSetpoint, Setpoint, VelocitySetpoint

_DAMPED = 0.5  # gain of the position times the lag: a damping of 0.71
_GO_M_S = 1.0  # speed between steps
_NEAR_M, _SLOW_M_S, _SETTLED_S = 0.25, 0.12, 0.7
_REST_S = 1.0  # of zero velocity before a step
_REACTS_S = 0.1  # of rotation that follows when a step of a rate ends
_LEVEL_S = 0.1  # of zero rates before a doublet, so that the vehicle follows rates when it begins


class StepFlight:
    """Commander and clock of a flight of steps.

    Between steps the vehicle is led to the start of the next one by a velocity in proportion to the distance,
    and comes to rest there. A velocity step ends early where the room ahead is only that of its stop. A step
    that tilts ends early where the vehicle could lean more than `MAX_LEAN_RAD`, and its way back takes as
    long as the way out did. After a hold a step begins again.

    Args:
        centre: where the flight ends, shape (3,), world frame [m].
        half_m: half of the box without radius and reserve, shape (3,) [m].
        lag_s: longest lag of velocities [s].
        stop_m: distance of a stop from a speed along an axis [m].
        throttle: throttle that the vehicle commands, a fraction; NaN if unknown.
        say: receives the time, monotonic clock [s], and the name of each step that begins.

    Attributes:
        tape: what was flown.
        time_s, rate: steps done, and 1: what a log shows of a plan.
    """

    setpoint: type[Setpoint] = VelocitySetpoint
    rate = 1.0

    def __init__(
        self,
        steps: Sequence[Step],
        centre: FloatArray,
        half_m: FloatArray,
        *,
        lag_s: float,
        stop_m: Callable[[float, int], float],
        gravity_m_s2: float,
        throttle: Callable[[], float] = lambda: math.nan,
        say: Callable[[float, str], None] = lambda now_s, words: None,
    ) -> None:
        self.tape = Tape()
        self._steps, self._centre, self._half_m, self._stop_m = list(steps), centre, half_m, stop_m
        self._gain, self._gravity = _DAMPED / lag_s, gravity_m_s2
        self._throttle, self._say = throttle, say
        self._next, self._back_s = 0, 0.0
        self._phase, self._since_s, self._near_s = Phase.GO, math.inf, math.inf
        self._heading: float | None = None
        self._row = np.zeros((1, 18))
        self._row[0, :3] = centre

    # as a clock of a plan

    @property
    def time_s(self) -> float:
        """Number of steps that were flown."""
        return float(self._next)

    @property
    def is_over(self) -> bool:
        """True when all steps were flown."""
        return self._next >= len(self._steps)

    def pause(self, heading_rad: float) -> None:
        """Begin the present step again; the first heading is kept."""
        if self._heading is None:
            self._heading = heading_rad
            self._row[0, 15] = heading_rad
        self._enter(Phase.GO, math.inf)

    def advance(self, dt_s: float, error_m: float) -> None:
        """See `PlanClock`; time advances with the states."""

    def target(self) -> FloatArray:
        """Reference, the box's centre, a row of `ReferenceCurve.at`, shape (1, 18)."""
        return self._row

    # as a commander

    def reset(self) -> None:
        """See `Commander`."""
        self._enter(Phase.GO, math.inf)

    def sent(self, setpoint: Setpoint) -> None:
        """See `Commander`."""

    def decide(self, state: VehicleState, age_s: float, target: FloatArray, slip_m: float = 0.0) -> Decision:
        """See `Commander`; a target other than its own is a hold.

        Args:
            target: reference, shape (1, 18), world frame.
        """
        yaw = float(target[0, 15])
        if target is not self._row or self.is_over:
            setpoint: Setpoint = VelocitySetpoint(self._towards(state, target[0, :3]), yaw)
        else:
            setpoint = self._fly(state, state.received_s + age_s, yaw)
        shown = setpoint.velocity if isinstance(setpoint, VelocitySetpoint) else np.zeros(3)
        away = state.position - target[0, :3]
        return Decision(
            setpoint=setpoint,
            status=FilterStatus.OK,
            margin=math.inf,
            nominal=shown,
            safe=shown,
            error_m=math.sqrt(float(away @ away)),
        )

    def _enter(self, phase: Phase, now_s: float) -> None:
        self._phase, self._since_s, self._near_s = phase, now_s, math.inf
        if phase is not Phase.GO:
            self.tape.enter(phase, now_s)

    def _towards(self, state: VehicleState, point: FloatArray) -> FloatArray:
        """Velocity to a point in proportion to the distance, shape (3,) [m/s]."""
        velocity = self._gain * (point - state.position)
        speed = math.sqrt(float(velocity @ velocity))
        result: FloatArray = velocity if speed <= _GO_M_S else velocity * (_GO_M_S / speed)
        return result

    def _fly(self, state: VehicleState, now_s: float, yaw: float) -> Setpoint:
        """Set-point of the present step, which is recorded from its rest on."""
        step = self._steps[self._next]
        if self._phase is Phase.GO and self._has_settled(state, now_s, step, yaw):
            self.tape.begin(step)
            self._say(now_s, step.name)
            self._enter(Phase.REST, now_s)
        passed_s = now_s - self._since_s
        if self._phase is Phase.REST and passed_s >= _REST_S - 1e-6:
            self._enter(Phase.OUT, now_s)
        elif self._phase is Phase.OUT and (passed_s >= step.out_s - 1e-6 or self._must_stop(state, step)):
            self._back_s = step.back_s if step.kind == "velocity" else min(step.back_s, passed_s)
            self._enter(Phase.BACK, now_s)
        elif self._phase is Phase.BACK and (passed_s >= self._back_s - 1e-6 or self._leans(state, step)):
            self._next += 1
            self._enter(Phase.GO, now_s)
        if self._phase is Phase.GO:
            return VelocitySetpoint(self._towards(state, step.start), yaw)
        self.tape.add(state, self._throttle(), self._phase)
        return self._of(step, now_s - self._since_s, yaw)

    def _of(self, step: Step, passed_s: float, yaw: float) -> Setpoint:
        """Set-point of a step, a time after its phase began."""
        out = self._sign(step)
        values = np.zeros(3)
        if step.kind == "velocity":
            values[step.axis] = out * step.size
            return VelocitySetpoint(values, yaw)
        if self._phase is Phase.REST and passed_s < _REST_S - _LEVEL_S:
            return VelocitySetpoint(values, yaw)
        if step.kind == "rate":
            values[step.axis] = out * step.size
            return RatesSetpoint(self._gravity, values)
        return RatesSetpoint(self._gravity * (1 + out * step.size), values)

    def _has_settled(self, state: VehicleState, now_s: float, step: Step, yaw: float) -> bool:
        """Whether the vehicle has been at rest near the step's start for some time."""
        away, speed = state.position - step.start, math.sqrt(float(state.velocity @ state.velocity))
        turn = (heading_of(state.attitude_wxyz) - yaw + math.pi) % (2 * math.pi) - math.pi
        is_there = math.sqrt(float(away @ away)) < _NEAR_M and speed < _SLOW_M_S and abs(turn) < 0.2
        self._near_s = min(self._near_s, now_s) if is_there else math.inf
        return now_s - self._near_s >= _SETTLED_S

    def _sign(self, step: Step) -> float:
        """Set-point of the present phase by that of the step."""
        return {Phase.OUT: 1.0, Phase.BACK: step.back}.get(self._phase, 0.0)

    def _leans(self, state: VehicleState, step: Step) -> bool:
        """Whether a rotation that tilts must end now, lest the vehicle lean too much."""
        if step.kind != "rate" or step.axis == 2:
            return False
        w, x, y, z = state.attitude_wxyz
        lean = (
            math.atan2(2 * (y * z + w * x), 1 - 2 * (x * x + y * y))
            if step.axis == 0
            else math.asin(max(-1.0, min(1.0, 2 * (w * y - x * z))))
        )
        rate = self._sign(step) * step.size
        sign = math.copysign(1.0, rate)
        fastest = max(abs(rate), sign * float(state.omega[step.axis]))
        return sign * lean + fastest * _REACTS_S >= MAX_LEAN_RAD

    def _must_stop(self, state: VehicleState, step: Step) -> bool:
        """Whether the room ahead of a velocity step is that of its stop, or a lean must end."""
        if step.kind != "velocity":
            return self._leans(state, step)
        sign = math.copysign(1.0, step.size)
        ahead = float(self._half_m[step.axis] - sign * (state.position[step.axis] - self._centre[step.axis]))
        return ahead <= self._stop_m(abs(float(state.velocity[step.axis])), step.axis)
