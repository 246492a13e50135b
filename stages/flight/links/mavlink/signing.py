"""Signatures of MAVLink 2: they prove that the sender has the key and that a packet is not a replay.

A signed frame ends with a link number (1 byte), a time stamp (6 bytes, units of 10 us since 2015-01-01 UTC)
and the first 6 bytes of sha256(key, frame up to there). Source: MAVLink guide, "Message Signing".
"""

from __future__ import annotations

import hashlib
import hmac
import math
import re
from collections.abc import Callable
from pathlib import Path

from alula.schemas.artifacts.signing_key import KEY_BYTES
from alula.schemas.errors import LinkError

SIGNATURE_BYTES = 13

_UNITS_PER_S = 100_000
_EPOCH_S = 1_420_070_400  # 2015-01-01 in seconds since 1970
_STAMP_BYTES = 6
_LARGEST_STAMP = 2 ** (8 * _STAMP_BYTES) - 1
_LATE = 60 * _UNITS_PER_S  # maximum lag of a new stream
_KEPT_AHEAD = 60 * _UNITS_PER_S  # the file is that far ahead, so that it is not written at every packet
_PACKETS = _UNITS_PER_S  # more packets, of one stamp each, than are sent between two writes of the file
_MAX_STREAMS = 256
_SAVED_S = 5.0  # between two writes of the senders' stamps
_STAMP = re.compile(r"[0-9]{1,20}")


class Signer:
    """A key and strictly increasing time stamps, within a run and through `file` between runs.

    After a run that was killed, the file is ahead of the time of day. Stamps then continue from the file in
    steps of one until the time has caught up, so that repeated kills do not move the stamps ever further
    ahead of those of the vehicle.

    The file also holds the newest stamp of each sender, so that packets of an earlier run are refused. It is
    written when a sender is new, at the end, and at least every 5 s in between: after a run that was killed,
    packets of its last 5 s pass once more. A sender without an entry may be late by a minute.

    Args:
        key: 32 bytes.
        file: stores a stamp above all that were used, and the newest stamp of each sender; without it,
            packets are refused after the clock was set back, and packets of an earlier run may pass.
        wall_clock: time since 1970 [s], read once; `clock` continues from there.
        link: number of this link, so that several may share a key.

    Attributes:
        has_heard_late: whether a frame had a right signature and a time stamp that is too old.

    Raises:
        LinkError: the file cannot be read or written, or the key does not have 32 bytes.
    """

    def __init__(
        self,
        key: bytes,
        *,
        file: Path | None,
        clock: Callable[[], float],
        wall_clock: Callable[[], float],
        link: int = 0,
    ) -> None:
        if len(key) != KEY_BYTES:
            raise LinkError(f"a signing key has {KEY_BYTES} bytes, not {len(key)}")
        self.key, self.link = key, link
        self._file, self._clock = file, clock
        kept, self._streams = (0, {}) if file is None else _read_stamps(file)
        today = round((wall_clock() - _EPOCH_S) * _UNITS_PER_S)
        if not 0 <= max(kept, today) < _LARGEST_STAMP:
            raise LinkError("the time of day is before 2015 or far beyond: no packet can be signed")
        self._is_new = self.has_heard_late = False
        self._zero = today - round(clock() * _UNITS_PER_S)
        self._last = max(kept, today)
        self._before = kept - _KEPT_AHEAD  # earlier runs came this far, whatever the present time of day is
        self._kept = kept
        self._saved_s = -math.inf
        self.save(_KEPT_AHEAD)

    @property
    def newest(self) -> int:
        """The newest time stamp that was used or accepted."""
        return self._last

    def next_stamp(self) -> int:
        """A time stamp larger than all before it."""
        self._last = max(self._now(), self._last + 1)
        return self._last

    def accepts(self, frame: bytes, system: int, component: int) -> bool:
        """Return whether a frame is signed with the key and newer than all before it from its sender.

        Args:
            frame: the whole frame with its signature.
        """
        expected = hashlib.sha256(self.key + frame[:-_STAMP_BYTES]).digest()[:_STAMP_BYTES]
        if not hmac.compare_digest(expected, frame[-_STAMP_BYTES:]):
            return False
        link = frame[-SIGNATURE_BYTES]
        stamp = int.from_bytes(frame[-SIGNATURE_BYTES + 1 : -_STAMP_BYTES], "little")
        stream = (system, component, link)
        before = self._streams.get(stream)
        if before is None:
            is_late = stamp < max(self._now(), self._before) - _LATE
            if is_late or len(self._streams) >= _MAX_STREAMS:
                self.has_heard_late |= is_late
                return False
        elif stamp <= before:
            self.has_heard_late = True
            return False
        self._streams[stream] = stamp
        self._is_new = self._is_new or before is None
        self._last = max(self._last, stamp)  # the next packet must not look old to the other side
        return True

    def keep_up(self) -> None:
        """Write the file when half of its reserve is used, a sender is new, or 5 s have passed."""
        is_used = self._last > self._kept - _PACKETS // 2 or self._now() > self._kept - _KEPT_AHEAD // 2
        if is_used or self._is_new or self._clock() - self._saved_s >= _SAVED_S:
            self.save(_KEPT_AHEAD)

    def save(self, ahead: int = 0) -> None:
        """Write the file.

        Args:
            ahead: how far it is ahead of the time and of the last stamp, units of 10 us.

        Raises:
            LinkError: it cannot be written.
        """
        self._kept = min(max(self._last + min(ahead, _PACKETS), self._now() + ahead), _LARGEST_STAMP)
        self._saved_s, self._is_new = self._clock(), False
        if self._file is None:
            return
        part = self._file.with_name(self._file.name + ".part")
        senders = "".join(f"{a} {b} {c} {stamp}\n" for (a, b, c), stamp in sorted(self._streams.items()))
        try:
            part.write_text(f"{self._kept}\n{senders}")
            part.replace(self._file)
        except OSError as error:
            raise LinkError(f"{self._file}: {error.strerror or error}") from error

    def _now(self) -> int:
        return self._zero + round(self._clock() * _UNITS_PER_S)


def _read_stamps(file: Path) -> tuple[int, dict[tuple[int, int, int], int]]:
    """Stamp above all that were used, then one line per sender: system, component, link, newest stamp."""
    try:
        text = file.read_text()
    except FileNotFoundError:
        return 0, {}
    except (OSError, UnicodeDecodeError) as error:
        raise LinkError(f"{file}: cannot be read: {error}") from error
    first, *rest = [line.split() for line in text.splitlines()] or [[]]
    words = [first, *rest]
    is_good = len(first) == 1 and len(rest) <= _MAX_STREAMS and all(len(line) == 4 for line in rest)
    if not is_good or not all(_STAMP.fullmatch(word) for line in words for word in line):
        raise LinkError(f"{file}: holds no time stamp for signatures")
    return int(first[0]), {(int(a), int(b), int(c)): int(stamp) for a, b, c, stamp in rest}
