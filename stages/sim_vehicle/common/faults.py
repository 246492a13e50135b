"""Injected faults: kind, start, duration and probability."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import Literal

from alula.schemas.errors import UsageError

Since = Literal["boot", "arm", "airborne"]
Way = Literal["out", "in"]

# Each kind: default, minimum and maximum of `amount`.
KINDS: dict[str, tuple[float, float, float]] = {
    "drop": (0, 0, 0),  # packets are lost
    "delay": (0.2, 0, 60),  # packets arrive that much later [s]
    "duplicate": (0, 0, 0),  # packets arrive twice
    "reorder": (0, 0, 0),  # a packet arrives after the next one
    "freeze": (0, 0, 0),  # motion messages repeat the last one
    "nan": (0, 0, 0),  # motion messages contain NaN
    "wrong-system": (42, 1, 255),  # packets have that system id
    "bad-crc": (0, 0, 0),  # packets are damaged
    "jump": (2, -1000, 1000),  # offset of the estimate to the north [m]
    "mode": (5, 0, 255),  # the pilot's mode switch, by number or name; by default 5, LOITER of ArduPilot
    "battery": (0.05, 0, 1),  # remaining fraction of the charge
    "mocap-loss": (0, 0, 0),  # external navigation does not arrive
    "fixes": (3.3, -1000, 1000),  # offset of the receiver's fixes to the north [m]; the estimate follows
    "compass": (0, 0, 0),  # the compass is 400 mG off
    "satellites": (0, 0, 0),  # the receiver has no fix
    "estimator": (0, 0, 0),  # the estimator fails
    "rotors": (0, 0, 0),  # the rotors give no thrust
    "radio-loss": (0, 0, 0),  # the receiver has no signal of the remote control
}
BOTH_WAYS = frozenset({"drop", "delay", "duplicate", "reorder"})


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """An injected fault.

    Attributes:
        start: when it begins, after `since` [s].
        duration: how long it lasts [s].
        probability: probability for each packet; for a fault of the vehicle itself, that it occurs at all.
        amount: size of the fault, with the meaning and limits of `KINDS`; None for the default.
        way: direction of the packets; "out" for those that the vehicle sends.
        since: the event that `start` counts from.

    Raises:
        UsageError: a value is unknown or out of range.
    """

    kind: str
    start: float = 0.0
    duration: float = math.inf
    probability: float = 1.0
    amount: float | None = None
    way: Way = "out"
    since: Since = "boot"

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise UsageError(f"fault {self.kind!r}: not one of {', '.join(KINDS)}")
        if not (math.isfinite(self.start) and self.start >= 0 and self.duration > 0):
            raise UsageError(f"fault {self.kind}: start must be >= 0 and duration > 0")
        if not 0 < self.probability <= 1:
            raise UsageError(f"fault {self.kind}: probability must be in (0, 1]")
        low, high = KINDS[self.kind][1:]
        if self.amount is not None and not low <= self.amount <= high:
            allowed = f"in {low:g}..{high:g}" if high > low else "left out"
            raise UsageError(f"fault {self.kind}: amount must be {allowed}")
        if self.way not in ("out", "in") or (self.way == "in" and self.kind not in BOTH_WAYS):
            raise UsageError(f"fault {self.kind}: way must be out{', or in' * (self.kind in BOTH_WAYS)}")
        if self.since not in ("boot", "arm", "airborne"):
            raise UsageError(f"fault {self.kind}: since must be boot, arm or airborne")

    @property
    def size(self) -> float:
        """The amount, or its default."""
        return KINDS[self.kind][0] if self.amount is None else self.amount


def parse_fault(text: str, modes: Mapping[str, int] = MappingProxyType({})) -> Fault:
    """Parse a fault written as `kind` or `kind:key=value,key=value`.

    Args:
        modes: positions of the mode switch by name, for the kind `mode`.

    Raises:
        UsageError: the text is not a fault.
    """
    kind, _, rest = text.partition(":")
    values: dict[str, object] = {}
    known = [field.name for field in fields(Fault) if field.name != "kind"]
    for part in filter(None, rest.split(",")):
        key, equals, value = part.partition("=")
        if not equals or key not in known:
            raise UsageError(f"fault {text!r}: {part!r} is not KEY=VALUE with one of {', '.join(known)}")
        if key in ("way", "since"):
            values[key] = value
        elif kind == "mode" and key == "amount" and value.upper() in modes:
            values[key] = float(modes[value.upper()])
        else:
            try:
                values[key] = float(value)
            except ValueError:
                raise UsageError(f"fault {text!r}: {value!r} is not a number") from None
    return Fault(kind=kind, **values)  # type: ignore[arg-type]


class Schedule:
    """The faults of one vehicle and their timing."""

    def __init__(self, faults: tuple[Fault, ...] = ()) -> None:
        self._faults = list(faults)
        self._began = {"boot": 0.0}

    def __bool__(self) -> bool:
        return bool(self._faults)

    def add(self, fault: Fault) -> None:
        """Add a fault."""
        self._faults.append(fault)

    def mark(self, event: Since, now_s: float) -> None:
        """Record an event that faults wait for; only its first occurrence counts."""
        self._began.setdefault(event, now_s)

    def acting(self, now_s: float) -> list[Fault]:
        """Faults that act at `now_s` [s], in the order in which they were added."""
        if not self._faults:
            return []
        found = []
        for fault in self._faults:
            began = self._began.get(fault.since)
            if began is not None and 0 <= now_s - began - fault.start < fault.duration:
                found.append(fault)
        return found
