"""Vehicle addresses, `scheme:place?name=value&...`, and the check that they stay on this machine.

udpin:127.0.0.1:14550             listen for a vehicle
udpout:127.0.0.1:14540            send to a vehicle first
tcp:127.0.0.1:5760
serial:/dev/ttyACM0:921600
radio://0/80/2M/E7E7E7E7E7        a Crazyflie
udp://127.0.0.1:19850             a simulated Crazyflie
sim:?delay_ms=20
"""

from __future__ import annotations

from dataclasses import dataclass, field
from urllib.parse import parse_qsl

from alula.schemas.errors import UsageError
from alula.stages.loopback import is_loopback

NETWORK_SCHEMES = ("udpin", "udpout", "udp", "tcp")
LOCAL_SCHEMES = ("serial", "sim", "radio", "usb")  # no network: cables, this process, a dedicated radio


@dataclass(frozen=True, slots=True)
class Address:
    """A parsed address.

    Attributes:
        scheme: the part before the first colon.
        place: the part between the scheme and the options.
        options: the values after `?` by name.
    """

    scheme: str
    place: str = ""
    options: dict[str, str] = field(default_factory=dict)

    def host_port(self) -> tuple[str, int]:
        """Host and port of a network address; an IPv6 host is written in brackets.

        Raises:
            UsageError: the address is not HOST:PORT.
        """
        host, _, port = self.place.removeprefix("//").rpartition(":")
        if not host or not port.isascii() or not port.isdigit() or not 0 < int(port) < 65536:
            raise UsageError(f"{self.scheme}:{self.place}: expected {self.scheme}:HOST:PORT")
        return host.strip("[]"), int(port)

    def device_baud(self) -> tuple[str, int]:
        """Device and baud rate of a serial line.

        Raises:
            UsageError: the address is not DEVICE:BAUD.
        """
        device, _, baud = self.place.rpartition(":")
        if not device or not baud.isascii() or not baud.isdigit():
            raise UsageError(f"{self.scheme}:{self.place}: expected {self.scheme}:DEVICE:BAUD")
        return device, int(baud)

    def only(self, *names: str) -> None:
        """Reject options with other names.

        Raises:
            UsageError: the address has another option.
        """
        for name in self.options:
            if name not in names:
                known = f"known: {', '.join(names)}" if names else "it has none"
                raise UsageError(f"{self.scheme}: has no option {name!r}; {known}")


def parse_address(text: str) -> Address:
    """Parse an address.

    Raises:
        UsageError: it has no scheme, or its options are not name=value.
    """
    scheme, colon, rest = text.partition(":")
    if not colon or not scheme.isidentifier():
        raise UsageError(f"{text!r} is not a vehicle address; examples: udpin:127.0.0.1:14550, sim:")
    place, _, query = rest.partition("?")
    try:
        pairs = parse_qsl(query, keep_blank_values=True, strict_parsing=True) if query else []
    except ValueError as error:
        raise UsageError(f"{text!r}: expected name=value pairs after ?, joined by &") from error
    options = dict(pairs)
    if len(options) < len(pairs):
        raise UsageError(f"{text!r}: an option is given twice")
    return Address(scheme, place, options)


def check_address(text: str, allow_remote: bool) -> None:
    """Reject an address that leaves this machine over a network, unless that is allowed.

    Addresses of `LOCAL_SCHEMES` always pass.

    Args:
        allow_remote: accept remote addresses and schemes that may be remote.

    Raises:
        UsageError: the address is remote, cannot be parsed, or has an unknown scheme.
    """
    address = parse_address(text)
    if allow_remote or address.scheme in LOCAL_SCHEMES:
        return
    if address.scheme in NETWORK_SCHEMES:
        host, _ = address.host_port()
        if is_loopback(host):
            return
        raise UsageError(f"{text}: {host} is not this machine; pass --allow-remote to allow it")
    raise UsageError(f"{text}: {address.scheme}: may leave this machine; pass --allow-remote to allow it")
