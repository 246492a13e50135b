"""Addresses of vehicles: `scheme:place?name=value&...`, and which of them stay on this machine.

udpin:127.0.0.1:14550             wait there for a vehicle
udpout:127.0.0.1:14540            speak to it first
tcp:127.0.0.1:5760
serial:/dev/ttyACM0:921600
radio://0/80/2M/E7E7E7E7E7        a Crazyflie
udp://127.0.0.1:19850             a simulated one
sim:?delay_ms=20
"""

from __future__ import annotations

import ipaddress
from dataclasses import dataclass, field
from urllib.parse import parse_qsl

from alula.schemas.errors import UsageError

NETWORK_SCHEMES = ("udpin", "udpout", "udp", "tcp")
LOCAL_SCHEMES = ("serial", "sim", "radio", "usb")  # cables, this process, or a radio of its own


@dataclass(frozen=True, slots=True)
class Address:
    """An address taken apart; `place` is what stands between the scheme and the options."""

    scheme: str
    place: str = ""
    options: dict[str, str] = field(default_factory=dict)

    def host_port(self) -> tuple[str, int]:
        """Of a network address; IPv6 hosts stand in brackets.

        Raises:
            UsageError: it is none.
        """
        host, _, port = self.place.removeprefix("//").rpartition(":")
        if not host or not port.isascii() or not port.isdigit() or not 0 < int(port) < 65536:
            raise UsageError(f"{self.scheme}:{self.place}: expected {self.scheme}:HOST:PORT")
        return host.strip("[]"), int(port)

    def device_baud(self) -> tuple[str, int]:
        """Of a serial line.

        Raises:
            UsageError: it is none.
        """
        device, _, baud = self.place.rpartition(":")
        if not device or not baud.isascii() or not baud.isdigit():
            raise UsageError(f"{self.scheme}:{self.place}: expected {self.scheme}:DEVICE:BAUD")
        return device, int(baud)

    def only(self, *names: str) -> None:
        """Refuse options of other names (UsageError)."""
        for name in self.options:
            if name not in names:
                known = f"known: {', '.join(names)}" if names else "it has none"
                raise UsageError(f"{self.scheme}: has no option {name!r}; {known}")


def parse_address(text: str) -> Address:
    """Take an address apart.

    Raises:
        UsageError: it has no scheme, or its options are not name=value.
    """
    scheme, colon, rest = text.partition(":")
    if not colon or not scheme.isidentifier():
        raise UsageError(f"{text!r} is no address of a vehicle; for example udpin:127.0.0.1:14550 or sim:")
    place, _, query = rest.partition("?")
    try:
        pairs = parse_qsl(query, keep_blank_values=True, strict_parsing=True) if query else []
    except ValueError as error:
        raise UsageError(f"{text!r}: after ? stand name=value, joined by &") from error
    options = dict(pairs)
    if len(options) < len(pairs):
        raise UsageError(f"{text!r}: an option is given twice")
    return Address(scheme, place, options)


def is_loopback(host: str) -> bool:
    """Whether packets to and from this host stay on this machine; of names only localhost does."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def check_address(text: str, allow_remote: bool) -> None:
    """Refuse what leaves this machine by a network unless that is allowed; serial and `sim:` always pass.

    Raises:
        UsageError: the address is remote, cannot be understood, or nothing is known of its scheme.
    """
    address = parse_address(text)
    if allow_remote or address.scheme in LOCAL_SCHEMES:
        return
    if address.scheme in NETWORK_SCHEMES:
        host, _ = address.host_port()
        if is_loopback(host):
            return
        raise UsageError(f"{text}: {host} is not this machine; give --allow-remote if it is meant")
    raise UsageError(
        f"{text}: {address.scheme}: may leave this machine; give --allow-remote if that is meant"
    )
