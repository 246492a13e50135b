"""What all commands that fly share: signals, priority, and errors of early ends."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

from alula.schemas.errors import AlulaError, CheckError, LinkError

if TYPE_CHECKING:
    from alula.stages.flight.loop.control_loop import ControlLoop


def stop(number: int, frame: object) -> None:
    """Interrupt the program before the loop runs: parameters are restored, and nothing has to land."""
    raise KeyboardInterrupt


class Interrupts:
    """Counter of signals that ask to end the flight; `count` is their handler, see `signals`."""

    def __init__(self) -> None:
        self.number = 0

    def count(self, number: int, frame: object) -> None:
        """Count a signal."""
        self.number += 1


@contextmanager
def signals(handler: Any) -> Iterator[None]:
    """Handle Ctrl-C, SIGTERM and a closed terminal by a function."""
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)


@contextmanager
def priority() -> Iterator[None]:
    """Give this thread real-time priority if the system has it and allows it; otherwise wake-ups are late."""
    if not hasattr(os, "sched_setscheduler"):  # macOS
        yield
        return
    before, parameter = os.sched_getscheduler(0), os.sched_getparam(0)
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(1))
    try:
        yield
    finally:
        with suppress(OSError):
            os.sched_setscheduler(0, before & ~os.SCHED_RESET_ON_FORK, parameter)


def failed_checks(loop: ControlLoop) -> AlulaError:
    """Error of a flight whose pre-flight checks do not hold."""
    from alula.stages.flight.loop.supervisor import Event

    words = f"pre-flight: {loop.checks.failure() or 'took too long'}"
    is_of_link = loop.checks.is_of_link or loop.supervision.cause is Event.LINK_LOST
    return LinkError(words) if is_of_link else CheckError(words)


def is_of_vehicle(loop: ControlLoop) -> bool:
    """Whether the vehicle or its link ended a flight."""
    from alula.stages.flight.loop.supervisor import Event

    of_vehicle = (
        *(Event.LINK_LOST, Event.FAILSAFE, Event.NOT_OBEYED, Event.ORDER_REFUSED, Event.ESTIMATOR_BAD),
        *(Event.DISARMED, Event.BATTERY_LOW, Event.FAILSAFE_IDLE, Event.OFF_CLIMB, Event.DRIFTS),
        *(Event.HEALTH_UNKNOWN, Event.PARAMETER_CHANGED, Event.CRASHED, Event.TURNED_OVER, Event.FALLEN),
    )
    return loop.supervision.cause in of_vehicle or not loop.counters.filter_s
