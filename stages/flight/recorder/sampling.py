"""How a tick of the loop becomes the samples that are logged."""

from __future__ import annotations

from alula.schemas.arrays import FloatArray
from alula.stages.flight.commanders.tracking import Decision, PlanClock
from alula.stages.flight.links.protocol import (
    AccelerationSetpoint,
    RatesSetpoint,
    Setpoint,
    VehicleState,
    VehicleStatus,
)
from alula.stages.flight.loop.fence_guard import Guarded
from alula.stages.flight.recorder.samples import FilterSample, Three, TickSample


def tick_sample(
    times: tuple[float, float, float, float],
    where: str,
    state: VehicleState | None,
    status: VehicleStatus,
    fence_m: float | None,
    flown: FilterSample | None,
) -> TickSample:
    """A tick; `times` are since the start, lateness, duration of the tick before, and the state's age."""
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
        state=where,
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


def filter_sample(decision: Decision, guarded: Guarded, plan: PlanClock, filter_s: float) -> FilterSample:
    """What was decided, and what the fence made of it."""
    kind, values = _numbers(guarded.setpoint)
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
        fence_share=guarded.share,
        fence_flies=guarded.takes_over,
        sent=kind,
        sent_values=values,
    )


def _three(vector: FloatArray) -> Three:
    x, y, z = vector.tolist()
    return x, y, z


def _numbers(setpoint: Setpoint | None) -> tuple[str, tuple[float, ...]]:
    """A set-point for the log: its kind and its numbers."""
    if setpoint is None:
        return "", ()
    if isinstance(setpoint, RatesSetpoint):
        return "rates", (setpoint.thrust_m_s2, *setpoint.omega.tolist())
    if isinstance(setpoint, AccelerationSetpoint):
        return "acceleration", (*setpoint.acceleration.tolist(), setpoint.yaw_rad)
    return "velocity", (*setpoint.velocity.tolist(), setpoint.yaw_rad)
