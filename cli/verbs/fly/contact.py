"""How all commands that fly reach the vehicle: opening and preparing the link, and the watchdog."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from alula.cli.shell.present import echo
from alula.schemas.errors import LinkError

if TYPE_CHECKING:
    from alula.stages.flight.links.protocol import Link
    from alula.stages.flight.watchdog.watchdog import Watchdog

NO_WATCHDOG = "none runs on this system; if this program ends or stalls, only the vehicle's own failsafes act"
OPEN_S = 15.0  # maximum time until the first message of the vehicle


class Contact(NamedTuple):
    """A vehicle that was reached.

    Attributes:
        said: description of the vehicle.
        changed: parameters that were set, a line each.
        trouble: why they could not be set; empty if they could.
        watchdog: of the flight, which runs; None for a link that has none, and where none is possible.
    """

    said: str
    changed: list[str]
    trouble: str
    watchdog: Watchdog | None


def reach(link: Link, address: str, *, quiet: bool) -> Contact:
    """Open a link, prepare the vehicle and start the watchdog; the checks judge a failure to prepare it.

    Args:
        link: to the vehicle; not yet open.

    Raises:
        LinkError: no vehicle answers, or it cannot be flown; or the watchdog does not run.
    """
    from alula.stages.flight.watchdog.watchdog import guard

    if not quiet and not address.startswith("sim:"):  # sim: needs no wait
        echo(f"link: waiting for the vehicle at {address}, at most {OPEN_S:g} s", err=True)
    said = link.open(OPEN_S)
    if not quiet:
        echo(f"link: {said}", err=True)
    changed, trouble = list[str](), ""
    try:
        changed = link.prepare()
    except LinkError as error:
        trouble = str(error)
    watchdog = guard(link)
    if watchdog is None and hasattr(link, "guarded") and not quiet:
        echo(f"watchdog: {NO_WATCHDOG}", err=True)
    return Contact(said, changed, trouble, watchdog)
