"""Joining of the parts of an artifact into one, for stages that need the whole in memory."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import msgspec
import numpy as np
from numpy.typing import NDArray

from alula.schemas.artifacts.artifact import Artifact, describe_arrays, read_artifact, write_members
from alula.schemas.artifacts.kinds import COVER, SCENE, VOXELS, Kind
from alula.schemas.artifacts.parts import Parts, open_parts
from alula.schemas.errors import DamagedError, InputError

# Maximum number of elements of a whole in memory: 1.2 GB of Gaussians, 1.1 GB of voxels.
MOST = {SCENE.name: 2**24, VOXELS.name: 2**26, COVER.name: 2**20}
_WORDS = {SCENE.name: "Gaussians", VOXELS.name: "voxels", COVER.name: "hulls"}


def read_whole(path: Path, kind: Kind | None = None) -> Artifact:
    """Read an artifact, in parts or a single file, into one artifact.

    Args:
        kind: the required kind; None for any.

    Raises:
        InputError: the whole has more elements than `MOST`; for the rest see `open_parts`.
    """
    return joined(open_parts(path, kind)) if path.is_dir() else read_artifact(path, kind)


def joined(parts: Parts) -> Artifact:
    """Join all parts in their order; voxels are sorted.

    A single file is returned as it is, whatever its size. Where only some parts of a scene have a `loss`, the
    Gaussians of the others have the loss 0. Merges of the hulls of a cover are recorded for each part alone,
    so the whole has no `history`.

    Raises:
        InputError: the whole has more elements than `MOST`, or a part cannot be read.
        DamagedError: two parts have the same voxel.
    """
    if not parts.is_folder:
        return parts[0]
    kind = parts.kind
    if parts.count > MOST[kind.name]:
        raise InputError(
            f"{parts.path}: has {parts.count:,} {_WORDS[kind.name]}; this command needs all of them in "
            f"memory and takes at most {MOST[kind.name]:,}; give it one part"
        )
    every = list(parts)
    names = [rule for rule in kind.arrays if any(rule.name in part.arrays for part in every)]
    arrays: dict[str, NDArray[Any]] = {}
    for rule in names:
        if rule.rule == "starts":
            ends = np.cumsum([0, *(part[rule.name][-1] for part in every)])
            starts = [part[rule.name][:-1] + end for part, end in zip(every, ends, strict=False)]
            arrays[rule.name] = np.concatenate([*starts, ends[-1:]]).astype(rule.dtype)
        elif rule.optional:
            main = kind.arrays[0].name
            blocks = []
            for part in every:
                shape = (len(part[main]), *(int(extent) for extent in rule.shape[1:]))
                blocks.append(part.arrays.get(rule.name, np.zeros(shape, rule.dtype)))
            arrays[rule.name] = np.concatenate(blocks)
        else:
            arrays[rule.name] = np.concatenate([part[rule.name] for part in every])
    if kind is VOXELS:
        arrays = _sorted(arrays, parts.path)
    if kind is COVER:
        arrays["history"] = np.zeros((0, 3))
    described = describe_arrays(kind, parts.manifest.frame, parts.manifest.unit, arrays)
    return Artifact(msgspec.structs.replace(parts.manifest, arrays=described), arrays)


def write_joined_cover(parts: Parts, file: BinaryIO) -> None:
    """Write the parts of a cover as the one file that `joined` would make, with one part in memory at a time.

    Args:
        file: empty; it is also read.

    Raises:
        DamagedError, InputError: a part cannot be read.
    """
    like: dict[str, NDArray[Any]] = {}
    for rule in COVER.arrays:
        shape = tuple(parts.manifest.arrays[rule.name].shape)
        shape = (0, 3) if rule.name == "history" else shape
        like[rule.name] = np.broadcast_to(np.zeros((), rule.dtype), shape)
    starts = {rule.name for rule in COVER.arrays if rule.rule == "starts"}

    def rows(name: str) -> Iterator[NDArray[Any]]:
        if name == "history":
            return
        end = np.zeros(1, np.int64)
        for part in parts:
            if name in starts:
                yield (part[name][:-1] + end[0]).astype(like[name].dtype)
                end = end + part[name][-1]
            else:
                yield part[name]
        if name in starts:
            yield end.astype(like[name].dtype)

    hashes = {}
    for name in like:
        digest = hashlib.sha256()
        for some in rows(name):
            digest.update(np.ascontiguousarray(some).reshape(-1).view(np.uint8).data)
        hashes[name] = digest.hexdigest()
    described = describe_arrays(COVER, parts.manifest.frame, parts.manifest.unit, like, hashes)
    write_members(file, msgspec.structs.replace(parts.manifest, arrays=described), like, rows)


def _sorted(arrays: dict[str, NDArray[Any]], path: Path) -> dict[str, NDArray[Any]]:
    """Voxels in lexicographic order."""
    order = np.lexsort(arrays["index"].T[::-1])
    index, overlap = arrays["index"][order], arrays["overlap"][order]
    if (index[1:] == index[:-1]).all(axis=1).any():
        raise DamagedError(f"{path}: two parts have the same voxel")
    return {"index": index, "overlap": overlap}
