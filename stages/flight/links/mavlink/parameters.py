"""Parameters of a vehicle: read, set, verified and restored."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from alula.schemas.errors import LinkError
from alula.stages.flight.links.mavlink.autopilots import Parameter
from alula.stages.flight.links.mavlink.session import Session

_ANSWER_S = 3.0
_AGAIN_S = 0.5  # between attempts of a change in flight
_ROUND_S = 1.0  # all watched parameters are read once in this time
_FORMATS = {1: "B", 2: "b", 3: "H", 4: "h", 5: "I", 6: "i"}  # MAV_PARAM_TYPE of integers
_LEFT = struct.Struct("<f")


class Parameters:
    """Temporary changes to a vehicle's parameters.

    Args:
        is_bytewise: whether an integer is sent as the bits of a float (PX4) instead of its value.
    """

    def __init__(self, session: Session, is_bytewise: bool) -> None:
        self._session, self._is_bytewise = session, is_bytewise
        self._values: dict[str, float] = {}
        self._types: dict[str, int] = {}
        self._changed: dict[str, tuple[float, float]] = {}  # old value, value that was set
        self._watched: dict[str, float] = {}  # value that each must keep
        self._asked = self._answers = self._judged = 0
        self._asked_s = self._again_s = -math.inf
        self._started: tuple[str, float] | None = None  # a change that is sent until it is confirmed

    def take(self, message: Any) -> None:
        """Process a PARAM_VALUE."""
        name = str(message.param_id)
        value = float(message.param_value)
        format_ = _FORMATS.get(message.param_type)
        if self._is_bytewise and format_ is not None:
            frame = bytes(message.get_msgbuf())
            header = 10 if frame[0] == 0xFD else 6
            value = float(struct.unpack_from(f"<{format_}", frame, header)[0])
        if math.isfinite(value) and name in self._types:
            self._values[name], self._types[name] = value, message.param_type
            self._answers += 1

    def read(self, name: str, timeout_s: float = _ANSWER_S) -> float | None:
        """Read a parameter within `timeout_s` [s]; None if the vehicle does not report it."""
        return self._ask((name,), timeout_s, all).get(name)

    def read_all(self, names: Iterable[str], timeout_s: float = _ANSWER_S) -> dict[str, float]:
        """Read parameters together within `timeout_s` [s]; those that are not reported are left out."""
        return self._ask(tuple(names), timeout_s, all)

    def read_any(self, names: Iterable[str], timeout_s: float = _ANSWER_S) -> tuple[str, float] | None:
        """Name and value of the parameter that is reported first within `timeout_s` [s]; None if none is."""
        return next(iter(self._ask(tuple(names), timeout_s, any).items()), None)

    def _ask(
        self, names: tuple[str, ...], timeout_s: float, are_enough: Callable[[Iterable[bool]], bool]
    ) -> dict[str, float]:
        for name in names:
            self._types.setdefault(name, dialect.MAV_PARAM_TYPE_REAL32)
            self._values.pop(name, None)

        def ask() -> None:
            for name in names:
                if name not in self._values:
                    self._session.send(
                        dialect.MAVLink_param_request_read_message(*self._session.target, name.encode(), -1)
                    )

        self._session.wait(lambda: are_enough(name in self._values for name in names), timeout_s, again=ask)
        return {name: self._values[name] for name in names if name in self._values}

    def change(self, parameter: Parameter) -> str | None:
        """Set a parameter to the value that flights need; a line, or None if nothing was changed.

        Raises:
            LinkError: the vehicle does not have it, or does not accept the value.
        """
        found = self.read_any(parameter.names)
        if found is None:
            if parameter.is_required:
                raise LinkError(f"the vehicle does not report its parameter {parameter.name}")
            return None
        name, present = found
        required = parameter.required(present)
        if _is_same(present, required):
            return None
        # Remembered before writing: a value that may or may not have been accepted is restored too.
        self._changed.setdefault(name, (present, required))
        if not self._write(name, required, _ANSWER_S):
            raise LinkError(f"the vehicle did not take {name} = {required:g}")
        return f"{name}: {present:g} -> {required:g} ({parameter.why})"

    def start(self, parameter: Parameter) -> None:
        """Begin to set a parameter that was read before; `poll` repeats it until the vehicle confirms it.

        Without effect for a vehicle that does not report the parameter, or has the value.
        """
        present = self._values.get(parameter.name)
        if present is None or _is_same(present, parameter.required(present)):
            return
        required = parameter.required(present)
        self._changed.setdefault(parameter.name, (present, required))
        self._started = parameter.name, required

    def require(self, needed: tuple[tuple[str, tuple[float, ...]], ...]) -> None:
        """Check that parameters have allowed values.

        Raises:
            LinkError: some do not; the message lists all of them.
        """
        wrong = []
        for name, allowed in needed:
            value = self.read(name)
            if value not in allowed:
                shown = "missing" if value is None else f"{value:g}"
                wrong.append(f"{name} is {shown}, not {' or '.join(f'{each:g}' for each in allowed)}")
        if wrong:
            raise LinkError(f"for motion capture set these and restart the vehicle: {'; '.join(wrong)}")

    def watch(self, names: tuple[str, ...]) -> None:
        """Begin to watch parameters; those that were not read, or do not exist, are left out."""
        self._watched = {name: self._values[name] for name in names if name in self._values}

    def poll(self, now_s: float) -> str | None:
        """Ask for the next watched parameter if it is due; autopilots do not announce every change.

        Returns:
            Those that no longer have their value, in words; None if no value arrived since the last call.
        """
        interval_s = _ROUND_S / max(len(self._watched), 1)
        if self._watched and now_s - self._asked_s >= interval_s:
            self._asked_s = max(self._asked_s, now_s - 2 * interval_s) + interval_s  # on time on the average
            name = list(self._watched)[self._asked % len(self._watched)]
            self._asked += 1
            self._session.send(
                dialect.MAVLink_param_request_read_message(*self._session.target, name.encode(), -1)
            )
        if self._started is not None and now_s - self._again_s >= _AGAIN_S:
            self._again_s, (name, value) = now_s, self._started
            if _is_same(self._values.get(name, math.nan), value):
                self._started = None
            else:
                self._session.send(self._set(name, value))
        if self._answers == self._judged:
            return None
        self._judged = self._answers
        return "; ".join(
            f"{name} is {self._values[name]:g}, not {kept:g}"
            for name, kept in self._watched.items()
            if name in self._values and not _is_same(self._values[name], kept)
        )

    def restore(self, timeout_s: float) -> list[str]:
        """Restore all changes within `timeout_s` [s], the newest first; a line for each failure."""
        self._watched.clear()
        lines = []
        end_s = self._session.options.clock() + timeout_s
        for name, (before, ours) in reversed(self._changed.items()):
            present = self._values.get(name, ours)
            if not _is_same(present, ours) and not _is_same(present, before):
                lines.append(f"{name} was changed by others to {present:g} and stays so; it was {before:g}")
                continue
            left_s = max(end_s - self._session.options.clock(), 0.0)
            try:
                is_back = self._write(name, before, left_s)
            except LinkError:  # the connection is lost: each parameter is listed nevertheless
                is_back = False
            if not is_back:
                lines.append(f"{name} could not be put back: set it to {before:g}")
        self._changed.clear()
        return lines

    def leave(self) -> list[str]:
        """Leave all changes in place; a line for each."""
        lines = [
            f"{name} stays {ours:g}; it was {before:g}" for name, (before, ours) in self._changed.items()
        ]
        self._changed.clear()
        return lines

    def _write(self, name: str, value: float, timeout_s: float) -> bool:
        self._values.pop(name, None)
        message = self._set(name, value)
        return self._session.wait(
            lambda: name in self._values and _is_same(self._values[name], value),
            timeout_s,
            again=lambda: self._session.send(message),
        )

    def _set(self, name: str, value: float) -> Any:
        """PARAM_SET of a parameter that was read before."""
        kind = self._types[name]
        format_ = _FORMATS.get(kind)
        if self._is_bytewise and format_ is not None:
            (value,) = _LEFT.unpack(struct.pack(f"<{format_}", round(value)).ljust(4, b"\0"))
        return dialect.MAVLink_param_set_message(*self._session.target, name.encode(), value, kind)


def _is_same(a: float, b: float) -> bool:
    """Compare two values as single-precision floats, which is how they are sent."""
    return math.isclose(a, b, rel_tol=1e-6, abs_tol=1e-9)
