"""The microcontrollers that onboard maps are exported for: their room and their pace."""

from __future__ import annotations

from dataclasses import dataclass

CODE_BYTES = 48_000
"""Kept free of maps for the filters' code; `make onboard` checks that all of them fit."""


@dataclass(frozen=True, slots=True)
class Target:
    """Where a map goes.

    Attributes:
        name: of `export --target`.
        flash_bytes: beside its firmware, 0 for any number.
        ram_bytes: beside its firmware, 0 for any number.
        clock_hz: of its core, 0 where it is not known.
        cycles_per_instruction: an upper bound; what a tick takes is instructions times this over the clock.
        rates_hz: at which its control loop may call a filter.
    """

    name: str
    flash_bytes: int
    ram_bytes: int
    clock_hz: float
    cycles_per_instruction: float
    rates_hz: tuple[int, ...]

    @property
    def map_room(self) -> int:
        """Bytes of the largest map, 0 for any."""
        return max(self.flash_bytes - CODE_BYTES, 0)


TARGETS = {
    target.name: target
    for target in (
        Target("crazyflie", 724_000, 36_000, 168e6, 2.0, (1000, 500, 250, 125, 100, 50)),
        Target("teensy", 7_900_000, 480_000, 600e6, 2.0, (1000, 500, 250, 100)),
        Target("c", 0, 0, 0.0, 2.0, ()),
    )
}
