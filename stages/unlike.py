"""Differences between two runs beside their filters: vehicle, map and conditions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol

from alula.schemas.artifacts.manifest import InputRef
from alula.schemas.artifacts.provenance import Provenance

MAPS = ("cover", "scene", "seen", "within", "tiles", "map")  # roles of inputs that are obstacles
_VEHICLE, _MAP = ("vehicle", "vehicle_file"), ("world",)  # tables of a run's parameters
_CONDITIONS = ("mission", "estimation", "rules")
_APART = frozenset(  # of the draw of pairs and of the log: no flight depends on them
    {
        *("rules.trials", "rules.logged", "rules.log_rate_hz"),
        *("mission.which", "mission.separation", "mission.bounds_m"),
    }
)
_NAMED = 6  # maximum number of values that are named


@dataclass(frozen=True, slots=True)
class Unlike:
    """One difference.

    Attributes:
        what: vehicle, map, or conditions of the flights.
        first, second: of each run, as a person reads it; empty where it has none.
    """

    what: Literal["vehicle", "map", "conditions"]
    name: str
    first: str
    second: str

    def words(self, first: str, second: str) -> str:
        """The difference in words."""
        return f"{self.name} ({first}: {self.first or 'none'}; {second}: {self.second or 'none'})"


class Setup(Protocol):
    """A run, or what is known of it before it has a record."""

    @property
    def vehicle(self) -> str:
        """The vehicle in words."""
        ...

    @property
    def provenance(self) -> Provenance:
        """Parameters and inputs."""
        ...


@dataclass(frozen=True, slots=True)
class Flown:
    """A run without a record, see `Setup`."""

    vehicle: str
    provenance: Provenance


def unlike(first: Setup, second: Setup) -> list[Unlike]:
    """How two runs differ, apart from their filters: a comparison of filters compares this, too."""
    ours, theirs = first.provenance, second.provenance
    found = []
    if first.vehicle != second.vehicle:
        found.append(Unlike("vehicle", "vehicle", first.vehicle, second.vehicle))
    else:
        found += _values("vehicle", _VEHICLE, ours.parameters, theirs.parameters)
    for role in MAPS:
        a, b = (_of_role(each.inputs, role) for each in (ours, theirs))
        if (a and a.sha256) != (b and b.sha256):
            found.append(Unlike("map", role, _file(a, b), _file(b, a)))
    found += _values("map", _MAP, ours.parameters, theirs.parameters)
    return found + _values("conditions", _CONDITIONS, ours.parameters, theirs.parameters)


def unlike_words(found: Sequence[Unlike], first: str, second: str) -> str:
    """State all differences in one sentence; empty where there are none.

    Args:
        found: from `unlike`.
    """
    if not found:
        return ""
    shown = [one.words(first, second) for one in found[:_NAMED]]
    shown += [f"{len(found) - _NAMED} more values"] * (len(found) > _NAMED)
    return f"{second} and {first} also differ in {', '.join(shown)}: differences may come from these."


def _of_role(inputs: Sequence[InputRef], role: str) -> InputRef | None:
    return next((ref for ref in inputs if ref.role == role), None)


def _file(one: InputRef | None, other: InputRef | None) -> str:
    """Name of a file; with its hash where the other one has the same name."""
    if one is None:
        return ""
    name = one.name or "in memory"
    return f"{name}, sha256 {one.sha256[:12]}…" if other is not None and other.name == one.name else name


def _values(
    what: Literal["vehicle", "map", "conditions"],
    tables: Sequence[str],
    first: Mapping[str, Any],
    second: Mapping[str, Any],
) -> list[Unlike]:
    """Values of some tables that both runs have and that differ."""
    ours, theirs = (dict(_flat({name: each.get(name) for name in tables})) for each in (first, second))
    return [
        Unlike(what, key, str(value), str(theirs[key]))
        for key, value in ours.items()
        if key in theirs and theirs[key] != value and key not in _APART
    ]


def _flat(table: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{before}{key}.")
        elif value is not None or before:
            yield f"{before}{key}", value
