"""Registry of links by address scheme: the built-in ones and those of other packages' entry points."""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import entry_points
from typing import Any

from alula.schemas.errors import UsageError
from alula.schemas.extras import EXTRAS, missing
from alula.stages.flight.links.addresses import check_address, parse_address
from alula.stages.flight.links.options import LinkOptions
from alula.stages.flight.links.protocol import Link

ENTRY_POINTS = "alula.links"

_LINKS = "alula.stages.flight.links"
_MAVLINK = f"{_LINKS}.mavlink.link:make_link"
_BUILT_IN = {
    **dict.fromkeys(("udpin", "udpout", "tcp", "serial"), _MAVLINK),
    "sim": f"{_LINKS}.simulated:make_link",
    **dict.fromkeys(("radio", "usb", "udp"), f"{_LINKS}.crazyflie.link:make_link"),
}


def link_schemes() -> list[str]:
    """All address schemes, the built-in ones first."""
    others = {point.name for point in entry_points(group=ENTRY_POINTS)} - _BUILT_IN.keys()
    return [*_BUILT_IN, *sorted(others)]


def open_link(address: str, options: LinkOptions | None = None) -> Link:
    """Make the link for an address; it neither sends nor listens before its `open`.

    Another package provides a link by an entry point in the group `alula.links`. The entry point has the name
    of the scheme and refers to a callable (Address, LinkOptions) -> Link. It is imported only here.

    Args:
        address: the vehicle address, see `addresses`.

    Raises:
        UsageError: the address is wrong, or remote without `allow_remote`; no link has its scheme; or the
            package that provides it cannot be imported.
        LinkError: something that the link needs is missing.
    """
    options = LinkOptions() if options is None else options
    parsed = parse_address(address)
    factory = _factory(parsed.scheme)
    if options.mocap is not None and not options.mocap.startswith("udp:"):
        raise UsageError(f"{options.mocap}: motion capture needs an address udp:HOST:PORT")
    for each in (address, options.mocap):
        if each is not None:
            check_address(each, options.allow_remote)
    link: Link = factory(parsed, options)
    return link


def _factory(scheme: str) -> Any:
    try:
        if scheme in _BUILT_IN:
            module, _, name = _BUILT_IN[scheme].partition(":")
            return getattr(import_module(module), name)
        points = [point for point in entry_points(group=ENTRY_POINTS) if point.name == scheme]
        if points:
            return points[0].load()
    except ModuleNotFoundError as error:
        if error.name in EXTRAS:
            raise missing(error.name) from error
        raise UsageError(f"the link {scheme}: cannot be loaded: {error}") from error
    except (ImportError, AttributeError) as error:
        raise UsageError(f"the link {scheme}: cannot be loaded: {error}") from error
    raise UsageError(f"no link is called {scheme!r}; known: {', '.join(link_schemes())}")
