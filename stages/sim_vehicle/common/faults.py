"""Faults on purpose: what goes wrong, when, for how long, and how likely."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import Literal

from alula.schemas.errors import UsageError

Since = Literal["boot", "arm", "airborne"]
Way = Literal["out", "in"]

# Each kind: what `amount` is unless given, and its limits.
KINDS: dict[str, tuple[float, float, float]] = {
    "drop": (0, 0, 0),  # packets are lost
    "delay": (0.2, 0, 60),  # packets come that much later [s]
    "duplicate": (0, 0, 0),  # packets come twice
    "reorder": (0, 0, 0),  # a packet comes after the next one
    "freeze": (0, 0, 0),  # messages of motion repeat the last one
    "nan": (0, 0, 0),  # messages of motion hold no numbers
    "wrong-system": (42, 1, 255),  # packets come from that system
    "bad-crc": (0, 0, 0),  # packets are damaged
    "jump": (2, -1000, 1000),  # the estimate is that far off, to the north [m]
    "mode": (5, 0, 255),  # the pilot's mode switch, by number or name; by default 5, LOITER of ArduPilot
    "battery": (0.05, 0, 1),  # that share of the charge is left
    "mocap-loss": (0, 0, 0),  # external navigation does not arrive
    "estimator": (0, 0, 0),  # the estimator gives up
    "radio-loss": (0, 0, 0),  # the receiver hears no pilot
}
BOTH_WAYS = frozenset({"drop", "delay", "duplicate", "reorder"})


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """One of `KINDS`.

    Attributes:
        kind: what goes wrong.
        start: when it begins, after `since` [s].
        duration: how long it goes on [s].
        probability: of each packet; of faults of the vehicle that it happens at all.
        amount: as `KINDS` says; None for its default.
        way: of packets; "out" leave the vehicle.
        since: what `start` counts from.

    Raises:
        UsageError: something of it means nothing.
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
        """The amount, or what it is unless given."""
        return KINDS[self.kind][0] if self.amount is None else self.amount


def parse_fault(text: str, modes: Mapping[str, int] = MappingProxyType({})) -> Fault:
    """A fault written as `kind` or `kind:key=value,key=value`; modes may be named.

    Raises:
        UsageError: it is not one.
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
    """The faults of one vehicle, and which of them act now."""

    def __init__(self, faults: tuple[Fault, ...] = ()) -> None:
        self._faults = list(faults)
        self._began = {"boot": 0.0}

    def __bool__(self) -> bool:
        return bool(self._faults)

    def add(self, fault: Fault) -> None:
        """One more."""
        self._faults.append(fault)

    def mark(self, event: Since, now_s: float) -> None:
        """The event that faults wait for has happened; only the first time counts."""
        self._began.setdefault(event, now_s)

    def acting(self, now_s: float) -> list[Fault]:
        """Those whose time it is, in the order they were given."""
        if not self._faults:
            return []
        found = []
        for fault in self._faults:
            began = self._began.get(fault.since)
            if began is not None and 0 <= now_s - began - fault.start < fault.duration:
                found.append(fault)
        return found
