"""How many voxels a stage takes, so that it refuses at once what would not fit into memory."""

from __future__ import annotations

from alula.schemas.errors import InputError

# Peak memory, measured; the help of the commands states it, and a test holds it.
BASE_BYTES = 2**26  # Python, NumPy and the libraries
MERGE_BYTES = 2600  # per voxel; 600 of surfaces
VERIFY_BYTES = 250  # per voxel, or member of a hull where hulls share voxels
VERIFY_HULL_BYTES = 4000

MERGE_VOXELS = 2**24
VERIFY_VOXELS = 2**26


def require_at_most(most: int, voxels: int, what: str) -> None:
    """Refuse more voxels than a stage has memory for.

    Raises:
        InputError: saying how many there are and what to do.
    """
    if voxels > most:
        raise InputError(
            f"{what} {voxels:,} voxels, but more than {most:,} are refused for want of memory;"
            " crop the scene or take larger voxels"
        )
