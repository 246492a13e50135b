"""Samples of a real flight: their structures, how a tick of the loop fills them, and their receiver."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import msgspec
from msgspec.structs import astuple, fields

from alula.schemas.arrays import FloatArray
from alula.schemas.decode import msgpack_decoder
from alula.schemas.log.channels import OF_BARRIER, Replay, Safety, State, Supervisor
from alula.schemas.log.foxglove import ERROR, INFO, WARNING, Quaternion, Vector3
from alula.schemas.log.run import RunRecord
from alula.stages.flight.commanders.protocol import Decision
from alula.stages.flight.links.protocol import VehicleState, VehicleStatus
from alula.stages.flight.loop.fence_guard import Guarded
from alula.stages.flight.loop.supervisor import Event, Taken
from alula.stages.flight.loop.supervisor import State as Phase
from alula.stages.vehicles.setpoints import AccelerationSetpoint, RatesSetpoint, Setpoint

_BAD = frozenset(
    {Event.CHECK_FAILED, Event.LINK_LOST, Event.FAILSAFE, Event.FILTER_FAILED, Event.FRAME_WRONG}
    | {
        Event.ESTIMATOR_BAD,
        Event.FENCE,
        Event.FAILSAFE_IDLE,
        Event.OFF_CLIMB,
        Event.DRIFTS,
        Event.SLIPS,
        Event.HEALTH_UNKNOWN,
    }
)
_FINE = frozenset(
    {Event.START, Event.CHECKS_PASSED, Event.CHECKS_PASSED_DRY, Event.ARMED, Event.AIRBORNE}
    | {Event.PLAN_FINISHED, Event.LANDED, Event.RECOVERED}
)

NUMBERS = {phase: number for number, phase in enumerate(Phase)}  # of the supervisor's states, in the log

Three = tuple[float, float, float]


class TickSample(msgspec.Struct, gc=False):
    """Messages of one tick of the loop, in full precision.

    Attributes:
        state: of the vehicle; None without one.
        safety: result of controller, filter and geofence; None in a tick without a set-point.
        replay: inputs and set-points of the native flight; None of other commanders.
    """

    supervisor: Supervisor
    state: State | None = None
    safety: Safety | None = None
    replay: Replay | None = None


class BeginSample(msgspec.Struct, array_like=True, tag=True):
    """Start of the flight, from which all its times count: nanoseconds since 1970-01-01 UTC."""

    start_ns: int


class StepSample(msgspec.Struct, array_like=True, tag=True):
    """A step of the supervisor, and its words for the operator."""

    supervisor: Supervisor
    words: str


class LineSample(msgspec.Struct, array_like=True, tag=True):
    """A message for the operator."""

    time_s: float
    level: int
    words: str


class PlanSample(msgspec.Struct, array_like=True, tag=True):
    """A new plan that the flight continues along: its points, world frame [m]."""

    time_s: float
    points: list[Three]


class FileSample(msgspec.Struct, array_like=True, tag=True):
    """A file for the log."""

    time_s: float
    name: str
    data: bytes


class FinishSample(msgspec.Struct, array_like=True, tag=True):
    """End of the flight, with its record."""

    record: RunRecord


_Told = BeginSample | StepSample | LineSample | PlanSample | FileSample | FinishSample
Sample = TickSample | _Told

_PARTS: tuple[type[msgspec.Struct], ...] = (Supervisor, State, Safety, Replay)  # of a tick
# A tick without the names of its fields: the pipe holds half as many again.
_Packed: Any = msgspec.defstruct(
    "_Packed",
    [(part.__name__, tuple[tuple(one.type for one in fields(part))] | None) for part in _PARTS],  # type: ignore[misc]
    array_like=True,
    tag=True,
)
_encode = msgspec.msgpack.Encoder().encode


def encoded(sample: Sample) -> bytes:
    """Message of the flight to the processes beside it."""
    if not isinstance(sample, TickSample):
        return _encode(sample)
    return _encode(_Packed(*(None if part is None else astuple(part) for part in astuple(sample))))


def decoded(message: bytes) -> Sample:
    """Read a message of the flight; see `encoded`."""
    found: Any = msgpack_decoder(_Told | _Packed).decode(message)
    if not isinstance(found, _Packed):
        told: _Told = found
        return told
    parts: Any = (
        None if values is None else part(**dict(zip(part.__struct_fields__, values, strict=True)))
        for part, values in zip(_PARTS, astuple(found), strict=True)
    )
    return TickSample(*parts)


class Flown(NamedTuple):
    """Set-point of a tick: decision of the commander, result of the geofence, and time of the decision [s].

    `plan_s` and `plan_rate` are the time along the plan [s] and its rate.
    """

    decision: Decision
    guarded: Guarded
    plan_s: float
    plan_rate: float
    filter_s: float


class Recorder(Protocol):
    """Receiver of samples and messages; its methods never block and never raise."""

    def tick(self, sample: TickSample) -> None:
        """Record a tick."""
        ...

    def step(self, time_s: float, taken: Taken) -> None:
        """Record a step of the supervisor."""
        ...

    def plan(self, time_s: float, points: list[Three]) -> None:
        """Record a new plan that the flight continues along.

        Args:
            points: of the plan, world frame [m].
        """
        ...

    def say(self, time_s: float, level: int, words: str) -> None:
        """Record a message for the operator."""
        ...


def level_of(taken: Taken) -> int:
    """Log level of a step of the supervisor: `INFO`, `WARNING` or `ERROR`."""
    is_fine = taken.event in _FINE or taken[:2] == (Phase.LAND, Event.DISARMED)
    return ERROR if taken.event in _BAD else INFO if is_fine else WARNING


def tick_sample(
    times: tuple[float, float, float, float],
    phase: Phase,
    state: VehicleState | None,
    status: VehicleStatus,
    fence_m: float | None,
    flown: Flown | None,
    *,
    slip_m: float,
    is_velocity: bool,
) -> TickSample:
    """Build the sample of a tick.

    Args:
        times: time since the start of the flight, lateness, duration of the tick before, and age of the
            state [s].
        state: of the vehicle, world frame, if there is one.
        fence_m: distance to the fence [m], if it was computed.
        flown: the set-point, if there is one.
        slip_m: see `SlipWatch` [m].
    """
    now_s, late_s, spent_s, age_s = times
    supervisor = Supervisor(
        time_s=now_s,
        state=NUMBERS[phase],
        state_name=phase.value,
        mode=status.mode,
        armed=status.armed,
        landed=status.landed,
        battery_share=status.battery_share,
        state_age_s=None if state is None else age_s,
        late_s=late_s,
        tick_s=spent_s,
        fence_m=fence_m,
        slip_m=slip_m,
    )
    sample = TickSample(supervisor)
    if state is not None:
        w, x, y, z = state.attitude_wxyz.tolist()
        sample.state = State(
            trial=0,
            time_s=now_s,
            position_m=_vector(state.position),
            velocity_m_s=_vector(state.velocity),
            attitude=Quaternion(x, y, z, w),
            omega_body_rad_s=_vector(state.omega),
        )
    if flown is not None:
        guarded = flown.guarded
        supervisor.fence_h_m, supervisor.fence_share = guarded.h_m, guarded.regulation
        supervisor.fence_flies, supervisor.error_m = guarded.takes_over, flown.decision.error_m
        supervisor.plan_s, supervisor.plan_rate = flown.plan_s, flown.plan_rate
        sample.safety = _safety(now_s, flown, is_velocity=is_velocity)
        sample.replay = _replay(now_s, flown)
    return sample


def _safety(now_s: float, flown: Flown, *, is_velocity: bool) -> Safety:
    """Among hulls velocities and a distance in metres; among ellipsoids accelerations and the barrier."""
    decision = flown.decision
    kind, values = numbers_of(flown.guarded.setpoint)
    safety = Safety(
        trial=0,
        time_s=now_s,
        status=int(decision.status),
        status_name=decision.status.name.lower(),
        active=decision.active,
        infeasible=decision.infeasible,
        certified=decision.certified,
        sent=kind,
        sent_values=list(values),
        solve_time_s=flown.filter_s,
    )
    if decision.disturbance is not None:
        safety.disturbance_m_s2 = _vector(decision.disturbance)
        safety.disturbance_bound_m_s2 = decision.disturbance_bound
        safety.added_margin_m = decision.added_margin_m
    nominal, safe = _vector(decision.nominal), _vector(decision.safe)
    if is_velocity:
        safety.h_m, safety.u_nom_m_s, safety.u_safe_m_s = decision.margin, nominal, safe
    else:
        safety.margin, safety.margin_unit = decision.margin, OF_BARRIER
        safety.a_nom_m_s2, safety.a_safe_m_s2 = nominal, safe
        safety.thrust_nom_n = decision.thrust_nominal_n
    return safety


def _replay(now_s: float, flown: Flown) -> Replay | None:
    decision, setpoint = flown.decision, flown.guarded.setpoint
    if (inputs := decision.inputs) is None:
        return None
    decided, decided_values = numbers_of(decision.setpoint)
    sent, sent_values = numbers_of(setpoint)
    return Replay(
        time_s=now_s,
        number=inputs.number,
        repeats=inputs.repeats,
        age_s=inputs.age_s,
        slip_m=inputs.slip_m,
        measured=tuple(inputs.measured.tolist()),
        target=tuple(inputs.target.tolist()),
        decided=decided,
        decided_values=decided_values,
        is_own=setpoint is not None and setpoint is decision.setpoint,
        sent=sent,
        sent_values=sent_values,
    )


def _vector(vector: FloatArray) -> Vector3:
    x, y, z = vector.tolist()
    return Vector3(x, y, z)


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
