"""Tables of the parameters and log variables of the simulated Crazyflie, as read over CRTP."""

from __future__ import annotations

import errno
import math
import struct
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

PARAMETER_TYPES = {"B": 0x08, "H": 0x09, "I": 0x0A, "b": 0x00, "h": 0x01, "i": 0x02, "f": 0x06}
LOG_TYPES = {"B": 1, "H": 2, "I": 3, "b": 4, "h": 5, "i": 6, "f": 7, "e": 8}
_LOG_FORMATS = {code: format_ for format_, code in LOG_TYPES.items()}

_ITEM, _INFO = 2, 3  # of the table of contents, with numbers of 16 bits
_TABLE = 0  # channel
_READ, _WRITE, _MISC = 1, 2, 3  # channels of parameters
_SETTINGS, _DATA = 1, 2  # channels of logs
_CREATE, _APPEND, _DELETE, _START, _STOP, _RESET = 6, 7, 2, 3, 4, 5
_MAX_BYTES, _MAX_BLOCKS, _MAX_VARIABLES = 26, 16, 128
_BEGIN_MS = 10

Reply = tuple[int, bytes]  # channel, data


def _table(data: bytes, names: list[str], codes: list[int], ending: bytes = b"") -> list[Reply]:
    entries = [
        bytes([code]) + name.replace(".", "\0").encode() + b"\0"
        for name, code in zip(names, codes, strict=True)
    ]
    if data[0] == _INFO:
        digest = zlib.crc32(b"".join(entries))
        return [(_TABLE, struct.pack("<BHI", _INFO, len(entries), digest) + ending)]
    if data[0] == _ITEM and len(data) >= 3:
        (number,) = struct.unpack_from("<H", data, 1)
        found = data[1:3] + entries[number] if number < len(entries) else b""
        return [(_TABLE, bytes([_ITEM]) + found)]
    return []


class ParameterTable:
    """Parameters by number and name.

    Args:
        values: by name, as `group.name`: `struct` format and initial value.

    Attributes:
        written: names that were written; the reader removes them.
    """

    def __init__(self, values: Mapping[str, tuple[str, float]]) -> None:
        self._names = list(values)
        self._formats = {name: format_ for name, (format_, _) in values.items()}
        self.values = {name: value for name, (_, value) in values.items()}
        self.written: list[str] = []

    def receive(self, channel: int, data: bytes) -> list[Reply]:
        """Answer a packet on the port of the parameters.

        Args:
            channel: CRTP channel.
            data: the packet without its header.
        """
        if not data:
            return []
        if channel == _TABLE:
            return _table(data, self._names, [PARAMETER_TYPES[self._formats[each]] for each in self._names])
        if channel == _MISC:
            return self._by_name(data)
        if channel not in (_READ, _WRITE) or len(data) < 2:
            return []
        (number,) = struct.unpack_from("<H", data)
        if number >= len(self._names):
            return [(channel, data[:2] + bytes([errno.ENOENT]))]
        name = self._names[number]
        if channel == _READ:
            return [(_READ, data[:2] + b"\0" + self._packed(name))]
        self._write(name, data[2:])
        return [(_WRITE, data[:2] + self._packed(name))]

    def set(self, name: str, value: float) -> None:
        """Write a parameter.

        Raises:
            KeyError: there is no such parameter.
            struct.error: its type cannot hold the value.
        """
        format_ = self._formats[name]
        self._write(name, struct.pack("<" + format_, value if format_ == "f" else int(value)))

    def _by_name(self, data: bytes) -> list[Reply]:
        """Command 0: group, name, type and value; the answer repeats the names."""
        parts = data[1:].split(b"\0", 2)
        if data[0] != 0 or len(parts) != 3 or len(parts[2]) < 2:
            return []
        name = b".".join(parts[:2]).decode("latin-1")
        is_known = name in self._formats and PARAMETER_TYPES[self._formats[name]] == parts[2][0]
        if is_known:
            self._write(name, parts[2][1:])
        status = 0 if is_known else errno.ENOENT
        return [(_MISC, data[: 3 + len(parts[0]) + len(parts[1])] + bytes([status]))]

    def _write(self, name: str, data: bytes) -> None:
        form = struct.Struct("<" + self._formats[name])
        if len(data) == form.size:
            (self.values[name],) = form.unpack(data)
            self.written.append(name)

    def _packed(self, name: str) -> bytes:
        format_, value = self._formats[name], self.values[name]
        return struct.pack("<" + format_, value if format_ == "f" else int(value))


@dataclass(slots=True)
class _Block:
    variables: list[tuple[str, str]] = field(default_factory=list)  # name, format it is sent in
    period_ms: int = 0  # 0: stopped
    due_ms: float = math.inf

    def size(self) -> int:
        return struct.calcsize("<" + "".join(format_ for _, format_ in self.variables))


class LogTable:
    """Log variables by number and name, and the blocks in which they are sent.

    Args:
        readers: by name, as `group.name`: `struct` format and function that returns the value.
    """

    def __init__(self, readers: Mapping[str, tuple[str, Callable[[], float]]]) -> None:
        self._names = list(readers)
        self._readers = dict(readers)
        self._blocks: dict[int, _Block] = {}

    def receive(self, channel: int, data: bytes, now_ms: float) -> list[Reply]:
        """Answer a packet on the port of the logs.

        Args:
            channel: CRTP channel.
            data: the packet without its header.
        """
        if not data:
            return []
        if channel == _TABLE:
            limits = bytes([_MAX_BLOCKS, _MAX_VARIABLES])
            return _table(
                data, self._names, [LOG_TYPES[self._readers[each][0]] for each in self._names], limits
            )
        if channel != _SETTINGS:
            return []
        number = data[1] if len(data) > 1 else 0
        return [(_SETTINGS, bytes([data[0], number, self._set(data[0], number, data[2:], now_ms)]))]

    def due(self, now_ms: float) -> list[Reply]:
        """Packets of the blocks that are due at `now_ms` [ms]."""
        replies = []
        for number, block in self._blocks.items():
            if now_ms < block.due_ms:
                continue
            block.due_ms = max(block.due_ms + block.period_ms, now_ms - block.period_ms)
            stamp = struct.pack("<I", int(now_ms) & 0xFFFFFF)[:3]
            values = b"".join(self._packed(name, format_) for name, format_ in block.variables)
            replies.append((_DATA, bytes([number]) + stamp + values))
        return replies

    def _set(self, command: int, number: int, rest: bytes, now_ms: float) -> int:
        """Execute a command on a block; returns 0 or an error number."""
        if command == _RESET:
            self._blocks.clear()
            return 0
        if command == _CREATE:
            if number in self._blocks:
                return errno.EEXIST
            if len(self._blocks) >= _MAX_BLOCKS:
                return errno.ENOMEM
            self._blocks[number] = _Block()
        block = self._blocks.get(number)
        if block is None:
            return errno.ENOENT
        if command in (_CREATE, _APPEND):
            return self._append(block, rest)
        if command == _START:
            block.period_ms = 10 * rest[0] if rest else 0
            block.due_ms = now_ms + _BEGIN_MS if block.period_ms else math.inf
        elif command == _STOP:
            block.period_ms, block.due_ms = 0, math.inf
        elif command == _DELETE:
            del self._blocks[number]
        else:
            return errno.ENOEXEC
        return 0

    def _append(self, block: _Block, rest: bytes) -> int:
        for kind, number in struct.iter_unpack("<BH", rest[: len(rest) // 3 * 3]):
            format_ = _LOG_FORMATS.get(kind & 0x0F)
            if format_ is None or number >= len(self._names):
                return errno.ENOENT
            block.variables.append((self._names[number], format_))
        if sum(len(each.variables) for each in self._blocks.values()) > _MAX_VARIABLES:
            return errno.ENOMEM
        return errno.E2BIG if block.size() > _MAX_BYTES else 0

    def _packed(self, name: str, format_: str) -> bytes:
        value = self._readers[name][1]()
        if format_ in "fe":
            return struct.pack("<" + format_, value)
        size = 8 * struct.calcsize(format_)
        whole = int(value) & (1 << size) - 1 if math.isfinite(value) else 0
        return whole.to_bytes(size // 8, "little")
