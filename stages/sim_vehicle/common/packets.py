"""MAVLink messages and packets; the only module of the simulator that imports the generated dialect."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import ardupilotmega

# The generated module has no types; its objects are Any, declared only here.
mavlink: Any = ardupilotmega
Message = Any

COMPONENT = 1  # MAV_COMP_ID_AUTOPILOT1


class Codec:
    """Encoder and decoder of the packets of one channel; counts, checks and signs them.

    With a key every sent packet is signed. Channel 0 still accepts unsigned packets, as ArduPilot's USB port
    does; any other channel then accepts only signed ones.

    Args:
        channel: number of the serial port; 0 is the console.
        key: 32 bytes shared with the other side, or None.
        time_10us: present time for signatures, in units of 10 us since 2015.
    """

    def __init__(
        self, system: int, *, channel: int = 0, key: bytes | None = None, time_10us: int = 0
    ) -> None:
        self._mav = mavlink.MAVLink(None, srcSystem=system, srcComponent=COMPONENT)
        self._mav.robust_parsing = True
        self.channel = channel
        self.bad_packets = 0
        if key is not None:
            self.set_key(key, time_10us)

    @property
    def system(self) -> int:
        """System id of the vehicle."""
        return int(self._mav.srcSystem)

    @system.setter
    def system(self, value: int) -> None:
        self._mav.srcSystem = value

    @property
    def unsigned_refused(self) -> int:
        """Number of packets refused because they were not signed with the key."""
        signing = self._mav.signing
        return int(signing.badsig_count + signing.reject_count)

    def set_key(self, key: bytes, time_10us: int) -> None:
        """Start to sign packets.

        Args:
            key: 32 bytes; all zero ends signing.
            time_10us: present time for signatures, in units of 10 us since 2015.
        """
        signing = self._mav.signing
        signing.secret_key = key if any(key) else None
        signing.sign_outgoing = any(key)
        signing.timestamp = max(signing.timestamp, time_10us)
        signing.link_id = self.channel
        signing.allow_unsigned_callback = (lambda _mav, _id: True) if self.channel == 0 else self._refuse

    def decode(self, data: bytes) -> list[Message]:
        """Messages that these bytes complete; damaged and refused ones are counted."""
        good = []
        for message in self._mav.parse_buffer(data) or ():
            if message.get_msgId() < 0 or message.get_type() == "BAD_DATA":
                self.bad_packets += 1
            else:
                good.append(message)
        return good

    def encode(self, message: Message, system: int | None = None) -> bytes:
        """Packet of a message.

        Args:
            system: system id in the packet; None for that of the vehicle.
        """
        own = self._mav.srcSystem
        self._mav.srcSystem = own if system is None else system
        try:
            packet = bytes(message.pack(self._mav))
        finally:
            self._mav.srcSystem = own
        self._mav.seq = (self._mav.seq + 1) % 256
        return packet

    @staticmethod
    def _refuse(_mav: Any, message_id: int) -> bool:
        return bool(message_id == mavlink.MAVLINK_MSG_ID_RADIO_STATUS)  # radios cannot sign
