"""Memory of arrays that are mapped from files: pages that were read count as memory until they are let go."""

from __future__ import annotations

import mmap
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

_Value = TypeVar("_Value", bound=np.generic)


def let_go(*arrays: NDArray[Any]) -> None:
    """Release the memory of mapped arrays; they can still be read, from the file again.

    Args:
        arrays: others are left alone.
    """
    for array in arrays:
        mapped = _mapping(array)
        if mapped is not None and hasattr(mmap, "MADV_DONTNEED"):
            mapped.madvise(mmap.MADV_DONTNEED)


def owned(array: NDArray[_Value]) -> NDArray[_Value]:
    """A copy of a mapped array, whose memory is let go; another array itself."""
    if _mapping(array) is None:
        return array
    copy = np.array(array)
    let_go(array)
    return copy


def _mapping(array: NDArray[Any]) -> mmap.mmap | None:
    base: Any = array
    while isinstance(base, np.ndarray):
        base = base.base
    return base if isinstance(base, mmap.mmap) else None
