"""Sets of voxels of blocks, and merges of them, as work for processes and machines."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from alula.schemas.artifacts.artifact import Artifact, make_artifact
from alula.schemas.artifacts.kinds import COVER
from alula.schemas.artifacts.manifest import Manifest, level_fields
from alula.schemas.parameters.configs.merge import MergeConfig
from alula.stages.compression.merge import merge, merge_sets

Ints = NDArray[Any]
Floats = NDArray[np.float64]
_SETS = ("member_index", "member_start")


@dataclass(frozen=True, slots=True)
class BlockTask:
    """A merge for a worker: of the voxels of a block, or of the sets of several cubes together.

    Attributes:
        index: voxels, shape (M, 3); None where there are sets.
        sets: of each cube the members, the first member of each set, and the merges to do first.
        begin: limits of a merge of voxels before the one that is recorded.
    """

    config: MergeConfig
    manifest: Manifest
    index: Ints | None = None
    sets: tuple[tuple[Ints, Ints, Floats], ...] = ()
    begin: MergeConfig | None = None
    jobs: int = 1


def last_cover(task: BlockTask) -> Artifact:
    """Cover of a region; runs in a worker.

    Raises:
        InputError, InfeasibleError: see `merge`.
    """
    return merge(task.config, _source(task), jobs=task.jobs)


def sets_of(task: BlockTask) -> Artifact:
    """Sets to merge, and their merges up to a limit; runs in a worker.

    Returns:
        The sets in the form of a cover without vertices and planes. Its `history` has the increase of the sum
        of W by each merge as the weight, and its summary the sum before the first one, `excess_voxels`.

    Raises:
        InputError: see `merge`.
    """
    source = _source(task)
    if task.begin is not None:
        found = merge_sets(task.begin, source, jobs=task.jobs)
        manifest = msgspec.structs.replace(source.manifest, schema=COVER.name)
        source = Artifact(manifest, {name: found[name] for name in _SETS})
    found = merge_sets(task.config, source, jobs=task.jobs)
    excess = found["curve"][:, 1]
    history = np.column_stack([found["history"][:, :2], np.diff(excess)])
    n = len(source["member_start"])
    none = {"vertex": np.empty((0, 3)), "plane_normal": np.empty((0, 3)), "plane_offset": np.empty(0)}
    arrays = {name: source[name] for name in _SETS} | none
    arrays |= {"history": history, "vertex_start": np.zeros(n), "plane_start": np.zeros(n)}
    fields = {name: getattr(source.manifest, name) for name in ("frame", "unit", "guarantee")}
    fields |= level_fields(source.manifest)  # type: ignore[arg-type]
    summary = {"excess_voxels": float(excess[0])}
    return make_artifact(
        COVER, arrays, **fields, parameters={}, summary=summary, conservativeness=1.0, certificate={}
    )


def _source(task: BlockTask) -> Artifact:
    """Voxels, or the sets after their first merges."""
    if task.index is not None:
        return Artifact(task.manifest, {"index": task.index})
    index, size = [], [np.zeros(1, np.int64)]
    for members, start, history in task.sets:
        label = _merged(len(start) - 1, history)
        row = np.repeat(label, np.diff(start))
        order = np.lexsort((*members.T[::-1], row))
        rows = np.column_stack([row[order], members[order]])
        rows = rows[np.r_[True, (rows[1:] != rows[:-1]).any(axis=1)]]  # sets may share voxels
        index.append(rows[:, 1:].astype(np.int32))
        size.append(np.unique(rows[:, 0], return_counts=True)[1])
    starts = np.cumsum(np.concatenate(size))
    return Artifact(task.manifest, {"member_index": np.concatenate(index), "member_start": starts})


def _merged(sets: int, history: Floats) -> Ints:
    """Number of the element that each set belongs to after merges (left, right), shape (sets,)."""
    above = np.arange(sets + len(history))
    made = np.arange(sets, sets + len(history))
    above[history[:, 0].astype(np.int64)] = made
    above[history[:, 1].astype(np.int64)] = made
    while (above != (above := above[above])).any():
        pass
    return above[:sets]
