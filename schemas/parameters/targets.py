"""Microcontrollers that onboard maps are exported for: their memory and their speed."""

from __future__ import annotations

from dataclasses import dataclass

CODE_BYTES = 64_000
"""Flash that is reserved for the filters' code; `make onboard` checks that all filters fit."""


APP_STATE_BYTES = 19_300
STACK_STATE_BYTES = 1_200
OBSTACLE_STATE_BYTES = 270
"""RAM of the Crazyflie's app, of fence and obstacles in it, and of each obstacle (`make onboard`)."""


@dataclass(frozen=True, slots=True)
class Target:
    """A microcontroller with its firmware.

    Attributes:
        name: value of `export --target`.
        flash_bytes: flash that the firmware leaves free, 0 for no limit.
        ram_bytes: RAM that the firmware leaves free, 0 for no limit.
        clock_hz: clock of the core, 0 where it is not known.
        cycles_per_instruction: upper bound; a tick takes its instructions times this over the clock.
        rates_hz: rates at which the control loop may call a filter.
        rate_hz: rate at which its firmware calls the filter by default, 0 where it is not known.
        follows_late: its firmware calls the chord filter of a vehicle that lags, not polytope-cbf.
    """

    name: str
    flash_bytes: int
    ram_bytes: int
    clock_hz: float
    cycles_per_instruction: float
    rates_hz: tuple[int, ...]
    rate_hz: float = 0.0
    follows_late: bool = False

    @property
    def map_room(self) -> int:
        """Maximum size of a map [bytes]; 0 also where there is no limit."""
        return max(self.flash_bytes - CODE_BYTES, 0)

    def state_bytes(self, obstacles: int) -> int:
        """RAM of the firmware's app with at most this many moving obstacles [bytes]."""
        if obstacles == 0:
            return APP_STATE_BYTES
        return APP_STATE_BYTES + STACK_STATE_BYTES + OBSTACLE_STATE_BYTES * obstacles


TARGETS = {
    target.name: target
    for target in (
        Target("crazyflie", 724_000, 36_000, 168e6, 2.0, (1000, 500, 250, 125, 100, 50), 100.0, True),
        Target("teensy", 7_900_000, 480_000, 600e6, 2.0, (1000, 500, 250, 100)),
        Target("c", 0, 0, 0.0, 2.0, ()),
    )
}
