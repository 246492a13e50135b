"""What one tick of a real flight leaves behind, and who takes it."""

from __future__ import annotations

from typing import Protocol

import msgspec

from alula.stages.flight.loop.supervisor import Event, State, Taken

INFO, WARNING, ERROR = 2, 3, 4  # levels as Foxglove counts them

_BAD = frozenset(
    {Event.CHECK_FAILED, Event.LINK_LOST, Event.FAILSAFE, Event.FILTER_FAILED, Event.FRAME_WRONG}
    | {Event.ESTIMATOR_BAD, Event.FENCE, Event.FAILSAFE_IDLE, Event.OFF_WAY, Event.DRIFTS, Event.UNTOLD}
)
_FINE = frozenset(
    {Event.START, Event.CHECKS_PASSED, Event.CHECKS_PASSED_DRY, Event.ARMED, Event.AIRBORNE}
    | {Event.PLAN_FINISHED, Event.LANDED, Event.RECOVERED}
)

Three = tuple[float, float, float]


class FilterSample(msgspec.Struct, array_like=True, gc=False):
    """What controller, filter and fence did in a tick; see `Decision` and `Guarded`."""

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


class TickSample(msgspec.Struct, array_like=True, gc=False):
    """A tick: `time_s` since the start, the state with its age, and what was done; None outside of flying.

    Attributes:
        time_s: when the tick began; late_s: how much too late; tick_s: how long the one before took.
        state: of the supervisor.
        age_s: of the vehicle's state; None without one, as are the next four.
        mode, armed, landed, battery_share: as the vehicle says.
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
    """Takes what happens; returns at once, whatever becomes of it."""

    def tick(self, sample: TickSample) -> None:
        """A tick."""
        ...

    def step(self, time_s: float, taken: Taken) -> None:
        """A step of the supervisor."""
        ...

    def say(self, time_s: float, level: int, words: str) -> None:
        """A line for people."""
        ...


def level_of(taken: Taken) -> int:
    """How bad it is that this step was taken."""
    is_fine = taken.event in _FINE or taken[:2] == (State.LAND, Event.DISARMED)
    return ERROR if taken.event in _BAD else INFO if is_fine else WARNING
