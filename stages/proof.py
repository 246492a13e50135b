"""Results of checks, as all proofs count, list and join them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from numpy.typing import NDArray

from alula.schemas.artifacts.certificate import Check, Offence

LISTED = 100  # maximum number of offences that a check lists


def check(
    name: str, checked: int, offences: Sequence[Offence], detail: str, *, failed: int | None = None
) -> Check:
    """Result of a check.

    Args:
        offences: failures; the first of them are listed.
        detail: method of the check, in a few words.
        failed: number of all failures; None for that of `offences`.
    """
    count = len(offences) if failed is None else failed
    listed = [*offences[:LISTED]]
    return Check(name=name, ok=count == 0, checked=checked, failed=count, detail=detail, first=listed)


def sum_of(checks: Sequence[Check]) -> Check:
    """One check of several parts of the same; name and detail are those of the first.

    Args:
        checks: at least one.
    """
    offences = [offence for one in checks for offence in one.first]
    checked, failed = (sum(getattr(one, name) for one in checks) for name in ("checked", "failed"))
    return check(checks[0].name, checked, offences, checks[0].detail, failed=failed)


def position_m(lattice: NDArray[Any], size_m: float) -> tuple[float, float, float]:
    """Position in metres.

    Args:
        lattice: shape (3,) [voxels].
    """
    x, y, z = (float(c) * size_m for c in lattice)
    return x, y, z


def at_voxel(fault: str, voxel: NDArray[Any], size_m: float, *, gaussian: int | None = None) -> Offence:
    """Offence at the centre of a voxel.

    Args:
        voxel: its lower corner, shape (3,) [voxels].
    """
    x, y, z = voxel.tolist()
    place = position_m(voxel + 0.5, size_m)
    return Offence(fault=fault, voxel=(x, y, z), place_m=place, gaussian=gaussian)
