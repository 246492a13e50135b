"""MAVLink frames: from bytes to messages and back.

pymavlink's `mavutil` connections block, reconnect and print by themselves. Its parser discards a whole
frame's length after a damaged frame, passes unknown messages before it checks their signature, and keeps the
time stamps of wrong signatures. Frames are therefore found and checked here, from any bytes and without
blocking; pymavlink packs and unpacks the fields.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect
from pymavlink.generator.mavcrc import x25crc

from alula.stages.flight.links.mavlink.signing import SIGNATURE_BYTES, Signer

_V1, _V2 = 0xFE, 0xFD
_HEADER = {_V1: 6, _V2: 10}
_CRC = 2
_SIGNED = 1  # the only incompatibility flag
_MAX_BAD = 32  # bad frames in one call; the bytes after them are discarded


class Packet(NamedTuple):
    """A received frame.

    Attributes:
        message: the message; None if it is not wanted.
        is_checked: whether the checksum was checked; it cannot be for a message without a definition, which
            may come from any sender.
    """

    system: int
    component: int
    sequence: int
    message: Any
    is_checked: bool = True


class Wire:
    """Encoder and decoder at one end of a link; the decoder accepts any bytes and never raises.

    Args:
        signer: signs and checks packets; None without a key.

    Attributes:
        bad: number of frames, and runs of other bytes, that were refused.
        is_signed: whether an accepted frame had a signature.
    """

    def __init__(
        self, system: int, component: int, wanted: Iterable[int], signer: Signer | None = None
    ) -> None:
        self.bad = 0
        self.is_signed = False
        self._wanted = frozenset(wanted)
        self._signer = signer
        self._rest = b""
        self._reader = dialect.MAVLink(None)
        self._writer = dialect.MAVLink(None, srcSystem=system, srcComponent=component)
        if signer is not None:
            signing = self._writer.signing
            signing.secret_key, signing.link_id, signing.sign_outgoing = signer.key, signer.link, True

    def pack(self, message: Any) -> bytes:
        """Frame of a message, MAVLink 2, signed if there is a key."""
        if self._signer is not None:
            self._writer.signing.timestamp = self._signer.next_stamp()
        frame = bytes(message.pack(self._writer))
        self._writer.seq = (self._writer.seq + 1) % 256
        return frame

    @staticmethod
    def parts(message: Any) -> tuple[int, int, bytes]:
        """Number, CRC_EXTRA and payload of a message, from which another process makes frames."""
        frame = bytes(message.pack(dialect.MAVLink(None)))
        return message.id, message.crc_extra, frame[_HEADER[_V2] : -_CRC]

    def forget(self) -> None:
        """Drop an incomplete frame: the bytes that follow come from another sender."""
        self._rest = b""

    def take(self, data: bytes, *, is_datagram: bool = False) -> list[Packet]:
        """Decode all valid frames; an incomplete one is kept for the next call.

        An incomplete frame after bad bytes in a datagram is dropped. It is probably not a frame and would
        delay the next datagram.

        Args:
            data: received bytes.
        """
        buffer = self._rest + data
        self._rest = b""
        packets: list[Packet] = []
        at, bad_before = 0, self.bad
        while at < len(buffer):
            start = _next_frame(buffer, at)
            if start > at:
                self.bad += 1
            if self.bad - bad_before > _MAX_BAD or start == len(buffer):
                break
            length = _frame_length(buffer, start)
            if length is None or start + length > len(buffer):
                if not is_datagram or self.bad == bad_before:
                    self._rest = buffer[start:]
                break
            packet = self._check(buffer[start : start + length], buffer[start + length : start + length + 1])
            if packet is None:
                self.bad += 1
                at = start + 1
                # The bytes up to the next frame belong to the refused one and are not counted again.
                at = _next_frame(buffer, at)
            else:
                packets.append(packet)
                at = start + length
        return packets

    def _check(self, frame: bytes, following: bytes) -> Packet | None:
        header = _HEADER[frame[0]]
        signed = frame[0] == _V2 and frame[2] & _SIGNED
        if frame[0] == _V2:
            if frame[2] & ~_SIGNED:
                return None
            sequence, system, component = frame[4:7]
            number = int.from_bytes(frame[7:10], "little")
        else:
            sequence, system, component, number = frame[2:6]
        kind = dialect.mavlink_map.get(number)
        end = header + frame[1]
        if kind is not None:
            crc = x25crc(frame[1:end] + bytes([kind.crc_extra])).crc
            if crc != int.from_bytes(frame[end : end + _CRC], "little"):
                return None
        elif following and following[0] not in _HEADER:  # the only check without a definition of the message
            return None
        if self._signer is not None and not (signed and self._signer.accepts(frame, system, component)):
            return None
        self.is_signed = self.is_signed or bool(signed)
        if number not in self._wanted:
            return Packet(system, component, sequence, None, kind is not None)
        try:
            message = self._reader.decode(bytearray(frame))
        except dialect.MAVError:
            return None
        return Packet(system, component, sequence, message)


def _next_frame(buffer: bytes, at: int) -> int:
    starts = [start for start in (buffer.find(_V2, at), buffer.find(_V1, at)) if start >= 0]
    return min(starts, default=len(buffer))


def _frame_length(buffer: bytes, start: int) -> int | None:
    """Length of the frame; None while too few bytes are there."""
    if len(buffer) - start < 3:
        return None
    signature = SIGNATURE_BYTES if buffer[start] == _V2 and buffer[start + 2] & _SIGNED else 0
    return _HEADER[buffer[start]] + buffer[start + 1] + _CRC + signature
