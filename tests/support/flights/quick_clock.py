"""Flights of `sim:` by a command in this process, on a clock that jumps where they would wait."""

import math
import signal

import pytest

from support.vehicles.mavlink_peer import Time


class QuickClock(Time):
    """A clock that moves when somebody sleeps; it interrupts this program after `interrupt_s`."""

    interrupt_s = math.inf

    def __init__(self):
        super().__init__(start_s=0.0)

    def sleep(self, seconds):
        super().sleep(seconds)
        if self() >= self.interrupt_s:
            self.interrupt_s = math.inf
            signal.raise_signal(signal.SIGINT)


@pytest.fixture
def quick_clock(monkeypatch):
    """The clock of links and of control loops, in place of this machine's."""
    from alula.stages.flight.links.options import LinkOptions
    from alula.stages.flight.loop.control_loop import ControlLoop

    clock = QuickClock()
    for made in (LinkOptions, ControlLoop):
        defaults = made.__init__.__kwdefaults__
        monkeypatch.setitem(defaults, "clock", clock)
        monkeypatch.setitem(defaults, "sleep", clock.sleep)
    return clock
