"""What a vehicle says to people: STATUSTEXT, of which long ones come in pieces."""

from __future__ import annotations

from typing import Any

_PIECE = 50  # characters; a shorter piece is the last
_MOST_PIECES = 8
_MOST_OPEN = 4
_PATIENCE_S = 1.0


class Texts:
    """Joins pieces; what a terminal could take for a command is left out."""

    def __init__(self) -> None:
        self._open: dict[int, tuple[float, dict[int, str]]] = {}

    def take(self, message: Any, now_s: float) -> list[str]:
        """Texts that a message completes."""
        piece = _printable(message.text)
        if message.id == 0:
            return [piece] if piece else []
        done = []
        if message.id not in self._open and len(self._open) >= _MOST_OPEN:
            done += self._finish(min(self._open, key=lambda each: self._open[each][0]))
        _, pieces = self._open.setdefault(message.id, (now_s, {}))
        if message.chunk_seq < _MOST_PIECES:
            pieces[message.chunk_seq] = piece
        last = max(pieces, default=0)
        is_ended = len(str_of(message.text)) < _PIECE or last == _MOST_PIECES - 1
        if is_ended and len(pieces) == last + 1:
            done += self._finish(message.id)
        return done

    def flush(self, now_s: float) -> list[str]:
        """Texts of which a piece is missing for too long, with a gap."""
        late = [each for each, (since_s, _) in self._open.items() if now_s - since_s > _PATIENCE_S]
        return [text for each in late for text in self._finish(each)]

    def _finish(self, number: int) -> list[str]:
        _, pieces = self._open.pop(number)
        text = "".join(pieces.get(each, "...") for each in range(max(pieces, default=-1) + 1))
        return [text] if text else []


def str_of(text: bytes | str) -> str:
    """Pymavlink gives either."""
    return text.decode("utf-8", "replace") if isinstance(text, bytes | bytearray) else text


def _printable(text: bytes | str) -> str:
    return "".join(each for each in str_of(text) if each.isprintable())
