"""Sizes of arrays in compressed clouds, checked before they are decompressed."""

from __future__ import annotations

import zipfile
from math import prod
from pathlib import Path

import numpy as np

from alula.schemas.errors import ArtifactError, InputError

MAX_RATIO = 50  # of decompressed to compressed bytes; coordinates of real clouds compress 2 to 10 times
_ALWAYS_BYTES = 64 << 20  # decompressed arrays up to this size pass at any ratio


def check_member(archive: zipfile.ZipFile, name: str, path: Path) -> None:
    """Refuse an array of an .npz that is larger than its bytes can hold, or compressed beyond belief.

    Args:
        path: the file, for messages.

    Raises:
        InputError: the array's shape does not fit its size, or it would grow more than `MAX_RATIO` times.
    """
    member = archive.getinfo(name if name in archive.namelist() else f"{name}.npy")
    with archive.open(member) as stream:
        version = np.lib.format.read_magic(stream)
        read = (
            np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        )
        shape, _, dtype = read(stream)
    need = prod(shape) * dtype.itemsize
    if need > member.file_size:
        raise InputError(f"{path}: array {name} states {need} bytes, its entry has {member.file_size}")
    try:
        check_growth(need, member.compress_size)
    except ArtifactError as error:
        raise InputError(f"{path}: {error}") from error


def check_growth(need: int, held: int) -> None:
    """Refuse compressed data that would grow beyond belief.

    Raises:
        ArtifactError: more than `MAX_RATIO` times as many, and not few.
    """
    if need > max(_ALWAYS_BYTES, MAX_RATIO * held):
        raise ArtifactError(
            f"{held} compressed bytes would become {need}, more than {MAX_RATIO} times as many; store the "
            "points uncompressed if they are real"
        )
