"""Store of the parameters of a simulated vehicle, whose names and defaults each firmware gives."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from enum import IntEnum

from alula.schemas.errors import UsageError


class ParamType(IntEnum):
    """MAV_PARAM_TYPE; values of all types are sent as floats."""

    INT8 = 2
    INT16 = 4
    INT32 = 6
    FLOAT = 9


Table = Mapping[str, tuple[ParamType, float]]
_BITS = {ParamType.INT8: 8, ParamType.INT16: 16, ParamType.INT32: 32}


class Parameters:
    """The parameters of one vehicle.

    The control loops read them by ArduPilot's names. A firmware with other names has a table of its own and
    derives the values under ArduPilot's names from it; clients can neither read nor set those.

    Args:
        changed: values by name that replace defaults.
        table: names, types and defaults.
        derived: for names that the table does not hold, functions of the values in the table.

    Raises:
        UsageError: a name is unknown or a value is not finite.
    """

    def __init__(
        self,
        changed: Mapping[str, float] | None = None,
        *,
        table: Table,
        derived: Mapping[str, Callable[[Mapping[str, float]], float]] | None = None,
    ) -> None:
        self._table, self._derived = table, derived or {}
        self._followers: list[Callable[[], None]] = []
        self._values = {name: float(default) for name, (_, default) in table.items()}
        self._derive()
        self._names = tuple(sorted(table))
        self._index = {name: i for i, name in enumerate(self._names)}
        for name, value in (changed or {}).items():
            if not self.set(name, value):
                unknown = name not in table
                raise UsageError(
                    f"no parameter is called {name!r}" if unknown else f"{name}: {value} has no meaning"
                )

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def __len__(self) -> int:
        return len(self._names)

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __contains__(self, name: str) -> bool:
        return name in self._table

    def get(self, name: str, default: float) -> float:
        """Value of a parameter, or a default for an unknown name."""
        return self._values.get(name, default)

    def whole(self, name: str) -> int:
        """Value of an integer parameter."""
        return int(self._values[name])

    def name_at(self, index: int) -> str | None:
        """Name at an index of the sorted list; None beyond its end."""
        return self._names[index] if 0 <= index < len(self._names) else None

    def index_of(self, name: str) -> int:
        """Index of a name in the sorted list."""
        return self._index[name]

    def type_of(self, name: str) -> ParamType:
        """Type of a parameter."""
        return self._table[name][0]

    def set(self, name: str, value: float) -> bool:
        """Set a parameter; integers are rounded and clipped to their range.

        Returns:
            False if the name is unknown or the value is not finite.
        """
        if name not in self._table or not math.isfinite(value):
            return False
        kind = self._table[name][0]
        if kind is not ParamType.FLOAT:
            limit = 2 ** (_BITS[kind] - 1)
            value = float(max(-limit, min(limit - 1, round(value))))
        self._values[name] = value
        self._derive()
        for tune in self._followers:
            tune()
        return True

    def follow(self, tune: Callable[[], None]) -> None:
        """Call a function now and after each change, which computes something from the values."""
        self._followers.append(tune)
        tune()

    def _derive(self) -> None:
        for name, value_of in self._derived.items():
            self._values[name] = value_of(self._values)
