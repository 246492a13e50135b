"""Maximum numbers of voxels per stage: inputs that would not fit into memory are refused at the start."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from alula.schemas.errors import InputError
from alula.schemas.parameters.configs.voxelize import MERGE_VOXELS as MERGE_VOXELS

# Measured peak memory; the help of the commands states it, and a test checks it.
BASE_BYTES = 2**26  # Python, NumPy and the libraries
MERGE_BYTES = 2600  # per voxel; about 200 where the voxels form surfaces
VERIFY_BYTES = 250  # per voxel, or member of a hull where hulls share voxels
VERIFY_HULL_BYTES = 4000

VERIFY_VOXELS = 2**26

LATTICE_LIMIT = (
    2**20
)  # maximum coordinate of a voxel corner, for which integer predicates are exact in 64 bits


def require_at_most(limit: int, voxels: int, what: str) -> None:
    """Refuse more voxels than a stage has memory for.

    Args:
        what: subject and verb of the message, such as "alula/cover lists".

    Raises:
        InputError: there are more; the message has both numbers and the remedy.
    """
    if voxels > limit:
        raise InputError(
            f"{what} {voxels:,} voxels, but memory limits them to {limit:,};"
            " crop the scene or take larger voxels"
        )


def require_near(index: NDArray[np.int32]) -> None:
    """Refuse voxels for which integer predicates are not exact in 64 bits.

    Args:
        index: lower corners of voxels, shape (M, 3), at least one.

    Raises:
        InputError: one lies more than `LATTICE_LIMIT` voxels from the origin, or from another.
    """
    if (
        index.min() < -LATTICE_LIMIT
        or index.max() >= LATTICE_LIMIT
        or np.ptp(index.astype(np.int64), axis=0).max() >= LATTICE_LIMIT
    ):
        raise InputError(
            f"voxels lie more than {LATTICE_LIMIT} voxels from the origin or from each other;"
            " crop the scene or take larger voxels"
        )
