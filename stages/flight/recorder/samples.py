"""Samples of a real flight: their structures, how a tick of the loop fills them, and their receiver."""

from __future__ import annotations

from typing import Protocol

import msgspec

from alula.schemas.arrays import FloatArray
from alula.stages.flight.commanders.protocol import Decision
from alula.stages.flight.links.protocol import (
    AccelerationSetpoint,
    RatesSetpoint,
    Setpoint,
    VehicleState,
    VehicleStatus,
)
from alula.stages.flight.loop.fence_guard import Guarded
from alula.stages.flight.loop.plan_clock import Reference
from alula.stages.flight.loop.supervisor import Event, State, Taken

INFO, WARNING, ERROR = 2, 3, 4  # levels of foxglove.Log

_BAD = frozenset(
    {Event.CHECK_FAILED, Event.LINK_LOST, Event.FAILSAFE, Event.FILTER_FAILED, Event.FRAME_WRONG}
    | {
        Event.ESTIMATOR_BAD,
        Event.FENCE,
        Event.FAILSAFE_IDLE,
        Event.OFF_CLIMB,
        Event.DRIFTS,
        Event.HEALTH_UNKNOWN,
    }
)
_FINE = frozenset(
    {Event.START, Event.CHECKS_PASSED, Event.CHECKS_PASSED_DRY, Event.ARMED, Event.AIRBORNE}
    | {Event.PLAN_FINISHED, Event.LANDED, Event.RECOVERED}
)

Three = tuple[float, float, float]


class ReplaySample(msgspec.Struct, array_like=True, gc=False):
    """Inputs and set-points of a tick in full precision, see `TickInputs`.

    Attributes:
        decided: kind of the set-point that was decided; empty for none.
        decided_values: its numbers, as those of `sent_values`.
        is_own: it was sent, not one of the geofence.
        sent, sent_values: kind and numbers of the set-point that was sent.
    """

    number: int
    repeats: int
    age_s: float
    measured: tuple[float, ...]
    target: tuple[float, ...]
    decided: str
    decided_values: tuple[float, ...]
    is_own: bool
    sent: str
    sent_values: tuple[float, ...]


class FilterSample(msgspec.Struct, array_like=True, gc=False):
    """Result of controller, filter and geofence in a tick; see `Decision` and `Guarded`."""

    status: int
    margin: float
    active: int
    infeasible: bool
    certified: bool
    nominal: Three
    safe: Three
    thrust_nominal_n: float | None
    error_m: float
    plan_s: float
    plan_rate: float
    filter_s: float
    fence_h_m: float
    fence_share: float
    fence_flies: bool
    sent: str
    sent_values: tuple[float, ...]
    replay: ReplaySample | None = None
    disturbance: Three | None = None
    disturbance_bound: float = 0.0
    added_margin_m: float = 0.0


class TickSample(msgspec.Struct, array_like=True, gc=False):
    """One tick of the loop.

    Attributes:
        time_s: start of the tick, since the start of the flight [s].
        late_s: time since the deadline of the tick [s].
        tick_s: duration of the tick before [s].
        state: name of the supervisor's state.
        age_s: age of the vehicle's state [s]; None without a state, as are the next four.
        position, velocity: world frame [m], [m/s].
        attitude_wxyz: unit quaternion that turns body vectors into the world frame.
        omega: angular velocity, body components [rad/s].
        mode, armed, landed, battery_share: as reported by the vehicle; the charge as a fraction.
        fence_m: distance of the vehicle's sphere to the fence [m]; None where it is not computed.
        filter: result of controller and filter; None in a tick without a set-point.
    """

    time_s: float
    late_s: float
    tick_s: float
    state: str
    age_s: float | None
    position: Three | None
    velocity: Three | None
    attitude_wxyz: tuple[float, float, float, float] | None
    omega: Three | None
    mode: str
    armed: bool | None
    landed: bool | None
    battery_share: float | None
    fence_m: float | None
    filter: FilterSample | None


class Recorder(Protocol):
    """Receiver of samples and messages; its methods never block and never raise."""

    def tick(self, sample: TickSample) -> None:
        """Record a tick.

        Args:
            sample: of the tick.
        """
        ...

    def step(self, time_s: float, taken: Taken) -> None:
        """Record a step of the supervisor.

        Args:
            time_s: time since the start of the flight [s].
            taken: the step.
        """
        ...

    def plan(self, time_s: float, points: list[Three]) -> None:
        """Record a new plan that the flight continues along.

        Args:
            time_s: time since the start of the flight [s].
            points: of the plan, world frame [m].
        """
        ...

    def say(self, time_s: float, level: int, words: str) -> None:
        """Record a message for the operator.

        Args:
            time_s: time since the start of the flight [s].
            level: `INFO`, `WARNING` or `ERROR`.
            words: the message.
        """
        ...


def level_of(taken: Taken) -> int:
    """Log level of a step of the supervisor: `INFO`, `WARNING` or `ERROR`.

    Args:
        taken: the step.
    """
    is_fine = taken.event in _FINE or taken[:2] == (State.LAND, Event.DISARMED)
    return ERROR if taken.event in _BAD else INFO if is_fine else WARNING


def tick_sample(
    times: tuple[float, float, float, float],
    phase: str,
    state: VehicleState | None,
    status: VehicleStatus,
    fence_m: float | None,
    flown: FilterSample | None,
) -> TickSample:
    """Build the sample of a tick.

    Args:
        times: time since the start of the flight, lateness, duration of the tick before, and age of the
            state [s].
        phase: name of the supervisor's state.
        state: of the vehicle, world frame, if there is one.
        status: of the vehicle.
        fence_m: distance to the fence [m], if it was computed.
        flown: result of controller and filter, if a set-point was computed.
    """
    now_s, late_s, spent_s, age_s = times
    position = velocity = omega = attitude = None
    if state is not None:
        position, velocity, omega = _three(state.position), _three(state.velocity), _three(state.omega)
        w, x, y, z = state.attitude_wxyz.tolist()
        attitude = (w, x, y, z)
    return TickSample(
        time_s=now_s,
        late_s=late_s,
        tick_s=spent_s,
        state=phase,
        age_s=None if state is None else age_s,
        position=position,
        velocity=velocity,
        attitude_wxyz=attitude,
        omega=omega,
        mode=status.mode,
        armed=status.armed,
        landed=status.landed,
        battery_share=status.battery_share,
        fence_m=fence_m,
        filter=flown,
    )


def filter_sample(decision: Decision, guarded: Guarded, plan: Reference, filter_s: float) -> FilterSample:
    """Build the sample of a decision and of the set-point that was sent after the geofence.

    Args:
        decision: of the commander.
        guarded: result of the geofence.
        plan: time along the plan.
        filter_s: duration of the decision [s].
    """
    kind, values = numbers_of(guarded.setpoint)
    replay = None
    if (inputs := decision.inputs) is not None:
        is_own = guarded.setpoint is not None and guarded.setpoint is decision.setpoint
        replay = ReplaySample(
            inputs.number,
            inputs.repeats,
            inputs.age_s,
            tuple(inputs.measured.tolist()),
            tuple(inputs.target.tolist()),
            *numbers_of(decision.setpoint),
            is_own,
            kind,
            values,
        )
    return FilterSample(
        status=int(decision.status),
        margin=decision.margin,
        active=decision.active,
        infeasible=decision.infeasible,
        certified=decision.certified,
        nominal=_three(decision.nominal),
        safe=_three(decision.safe),
        thrust_nominal_n=decision.thrust_nominal_n,
        error_m=decision.error_m,
        plan_s=plan.time_s,
        plan_rate=plan.rate,
        filter_s=filter_s,
        fence_h_m=guarded.h_m,
        fence_share=guarded.regulation,
        fence_flies=guarded.takes_over,
        sent=kind,
        sent_values=values,
        replay=replay,
        disturbance=None if decision.disturbance is None else _three(decision.disturbance),
        disturbance_bound=decision.disturbance_bound,
        added_margin_m=decision.added_margin_m,
    )


def _three(vector: FloatArray) -> Three:
    x, y, z = vector.tolist()
    return x, y, z


def numbers_of(setpoint: Setpoint | None) -> tuple[str, tuple[float, ...]]:
    """Kind and numbers of a set-point, for the log; without a set-point empty.

    Args:
        setpoint: thrust per mass and body rates; or acceleration, or velocity, each with the yaw.
    """
    if setpoint is None:
        return "", ()
    if isinstance(setpoint, RatesSetpoint):
        return "rates", (setpoint.thrust_m_s2, *setpoint.omega.tolist())
    if isinstance(setpoint, AccelerationSetpoint):
        return "acceleration", (*setpoint.acceleration.tolist(), setpoint.yaw_rad)
    return "velocity", (*setpoint.velocity.tolist(), setpoint.yaw_rad)
