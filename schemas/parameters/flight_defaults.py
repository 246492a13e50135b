"""Filter and interface of a flight where none is chosen, one for `plan`, `simulate` and `fly`."""

from __future__ import annotations

from collections.abc import Callable, Container, Sequence
from typing import Literal

NO_FILTER = "none"

PlannedInterface = Literal["body-rates", "acceleration", "velocity"]
IN_A_COVER, IN_A_SCENE = "polytope-cbf", "cone-backup"
"""Filters where none is chosen, see `filter_in`."""

FILTERS = (
    *("polytope-cbf", "shield", "cone-backup", "cone-ecbf", "safer-splat", "cone-di", "dr-acbf", "geofence"),
)
"""Built-in filters to fly behind."""
COMPARATORS = ("dr-acbf-qp", "mpc", "cbf-qp", "rp-cbf", "backup-qp")
"""Built-in filters for research: those that others are compared with."""


def filter_in(roles: Container[str]) -> str:
    """Filter of `simulate` and `fly` where none is chosen.

    Args:
        roles: of the maps: `cover`, `tiles`, `image`, `scene`.
    """
    return IN_A_COVER if any(each in roles for each in ("cover", "tiles", "image")) else IN_A_SCENE


def planned_interface(
    filters: Sequence[str] | None, kind_of: Callable[[str], str], roles: Container[str]
) -> PlannedInterface:
    """What `fly` commands a quadrotor by, and what `plan` makes a plan for where nothing else is said.

    Args:
        filters: names; None: as `filter_in`, also for `none` alone.
        kind_of: kind of command of a filter, by its name.

    Raises:
        UsageError: there is no such filter.
    """
    names = [name for name in filters or () if name != NO_FILTER] or [filter_in(roles)]
    kinds = {kind_of(name) for name in names}
    if "velocity" in kinds:
        return "velocity"
    return "acceleration" if kinds == {"acceleration"} else "body-rates"
