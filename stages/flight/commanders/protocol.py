"""Interface of commanders, which compute one set-point per tick from a state and the reference."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from alula.schemas.arrays import FloatArray
from alula.stages.filtering.protocol import FilterStatus
from alula.stages.flight.links.protocol import VehicleState
from alula.stages.vehicles.setpoints import Setpoint


@dataclass(frozen=True, slots=True)
class TickInputs:
    """All that the native flight got for a tick, in full precision: the log holds it for a replay.

    Attributes:
        measured: position, attitude (MRP), velocity and body rates, shape (12,), world frame, SI units.
        age_s: age of these, with the latency of the link [s].
        slip_m: see `Commander.decide`.
        target: reference, shape (18,), see `Commander.decide`.
        number: of the tick since the flight was reset; 0 right after that.
        repeats: ticks before this one that were left out, in which the vehicle kept the last set-point.
    """

    measured: FloatArray
    age_s: float
    slip_m: float
    target: FloatArray
    number: int
    repeats: int


@dataclass(slots=True)
class Decision:
    """Result of a commander for one tick.

    Attributes:
        setpoint: to send; None when the filter has no safe input.
        margin: value of the filter's barrier; among hulls a distance [m].
        nominal, safe: command before and after the filter, shape (3,), world frame: velocities [m/s] or
            accelerations [m/s^2].
        error_m: distance from the reference [m].
        active: index of the obstacle that determines the command, -1 for none.
        thrust_nominal_n: thrust of the controller [N]; None for velocity set-points.
        inputs: of the native flight; None of other commanders.
        disturbance: estimated acceleration that the model leaves out, shape (3,), world frame [m/s^2]; None
            if it is not estimated.
        disturbance_bound: bound on what the estimate does not contain yet [m/s^2].
        added_margin_m: what the filter's margin grows by because of that bound and of the slip [m].
    """

    setpoint: Setpoint | None
    status: FilterStatus
    margin: float
    nominal: FloatArray
    safe: FloatArray
    error_m: float
    active: int = -1
    infeasible: bool = False
    certified: bool = False
    thrust_nominal_n: float | None = None
    inputs: TickInputs | None = None
    disturbance: FloatArray | None = None
    disturbance_bound: float = 0.0
    added_margin_m: float = 0.0


class Commander(Protocol):
    """Controller and filter that turn a state and a row of the reference into a set-point."""

    @property
    def setpoint(self) -> type[Setpoint]:
        """Kind of set-point that it computes."""
        ...

    def reset(self) -> None:
        """Forget what was flown; called before the first set-point and after each hold."""
        ...

    def decide(self, state: VehicleState, age_s: float, target: FloatArray, slip_m: float = 0.0) -> Decision:
        """Compute the set-point of a tick.

        Args:
            target: reference, a row of `ReferenceCurve.at`, shape (1, 18), world frame.
            slip_m: distance by which position and velocity contradict each other, see `SlipWatch` [m].
        """
        ...

    def sent(self, setpoint: Setpoint) -> None:
        """Register the set-point that was sent; the geofence may have replaced the computed one."""
        ...
