"""Proof of the hulls of a part of a cover in one cell of its cube of the lattice."""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.certificate import Check, Offence
from alula.stages.compression.cover_checks import (
    LATTICE_LIMIT,
    MEMBERS,
    POLYTOPES,
    fault_check,
    hull_faults,
    hull_words,
    occupied_check,
)
from alula.stages.compression.hulls import ROWS, some_hulls
from alula.stages.proof import LISTED, check

CUBE_CHECK = "hulls lie in the part's cube"
Index = NDArray[np.int64]
_FACES = np.vstack([np.eye(3, dtype=np.int64), -np.eye(3, dtype=np.int64)])


@dataclass(frozen=True, slots=True)
class CellHulls:
    """Hulls that touch a cell, complete, with their numbers in the part.

    Attributes:
        numbers: of the hulls in the part, shape (n,).
        vertex_shift: row of the part's `vertex` minus row of this one's, for each hull.
        plane_shift: the same for planes.
        is_own: whether the hull counts in this cell; each counts in one cell of its cube.
        domain: lowest and highest voxel of the part's cube, shape (2, 3).
    """

    cover: Artifact
    numbers: Index
    vertex_shift: Index
    plane_shift: Index
    is_own: NDArray[np.bool_]
    domain: Index
    cube: Index

    @classmethod
    def of(cls, part: Artifact, boxes: Index, domain: Index, cube: Index) -> CellHulls:
        """Hulls of a part that touch a cell or count in it."""
        own = _own(boxes, domain, cube)
        touch = ((boxes[:, 0] <= cube[1] + 1) & (boxes[:, 1] >= cube[0])).all(axis=1)
        numbers = np.flatnonzero(own | touch)
        arrays, shift = some_hulls(part, numbers, tuple(ROWS))
        arrays["history"] = np.zeros((0, 3))
        cover = Artifact(msgspec.structs.replace(part.manifest, arrays={}), arrays)
        shifts = shift["vertex_start"], shift["plane_start"]
        return cls(cover, numbers, *shifts, own[numbers], domain, cube)


@dataclass(frozen=True, slots=True)
class HullProof:
    """Results for the hulls of a cell.

    Attributes:
        checks: that hulls lie in the cube, are exact, contain their members, and have all voxels here.
        excess: volume of the union of the hulls in the cell outside of the members [voxels]; None where it
            was not measured because a check fails or a vertex is too far from the origin.
        members: number of different members in the cell.
    """

    checks: list[Check]
    excess: float | None
    members: int


def boxes_of(part: Artifact, domain: Index) -> Index:
    """Boxes of the vertices of all hulls, shape (n, 2, 3); of a hull without any an empty one in the domain.

    Args:
        domain: lowest and highest voxel of its cube.
    """
    start = np.asarray(part["vertex_start"])
    some = np.flatnonzero(np.diff(start) > 0)
    found = np.repeat(np.stack([domain[0], domain[0] - 1])[None], len(start) - 1, axis=0)
    if len(some):
        vertex = np.asarray(part["vertex"])
        found[some, 0] = np.minimum.reduceat(vertex, start[:-1][some], axis=0)
        found[some, 1] = np.maximum.reduceat(vertex, start[:-1][some], axis=0)
    return found


def members_of_own(part: Artifact, boxes: Index, domain: Index, cube: Index) -> int:
    """Number of members of the hulls that count in a cell."""
    return int(np.diff(part["member_start"])[_own(boxes, domain, cube)].sum())


def _own(boxes: Index, domain: Index, cube: Index) -> NDArray[np.bool_]:
    """Whether the lowest corner, moved into the cube of the part if it is outside, is in the cell."""
    corner = np.clip(boxes[:, 0], domain[0], domain[1])
    is_here: NDArray[np.bool_] = ((corner >= cube[0]) & (corner <= cube[1])).all(axis=1)
    return is_here


def hull_proof(task: CellHulls, voxels: NDArray[np.int32] | None) -> HullProof:
    """Check the hulls of a cell, exactly as `verify` does.

    Args:
        voxels: all voxels of the cell, if they were given.
    """
    cover, own = task.cover, task.is_own
    found = hull_faults(cover, 1, None) if len(own) else np.empty((0, 4), np.int64)
    mine = found[own[found[:, 1]]]
    members = cover["member_index"]
    is_inside = ((members >= task.cube[0]) & (members <= task.cube[1])).all(axis=1)
    inside = Artifact(
        cover.manifest,
        {
            **cover.arrays,
            "member_index": np.ascontiguousarray(members[is_inside]),
            "member_start": np.concatenate([[0], np.cumsum(is_inside)])[cover["member_start"]],
        },
    )
    name, detail, of_members, within = hull_words(cover)
    held = int(np.diff(cover["member_start"])[own].sum())
    checks = [
        _in_domain(task),
        fault_check(cover, name, int(own.sum()), mine, POLYTOPES, detail),
        fault_check(cover, of_members, held, mine, MEMBERS, within),
        occupied_check(inside, voxels),
    ]
    unique = np.unique(inside["member_index"], axis=0)
    excess = None
    is_near = np.abs(cover["vertex"]).max(initial=0) <= LATTICE_LIMIT
    if len(found) == 0 and checks[-1].ok and is_near:
        excess = _excess(task, unique)
    checks[1:] = [_numbered(one, task) for one in checks[1:]]
    return HullProof(checks, excess, len(unique))


def _in_domain(task: CellHulls) -> Check:
    """Check that the hulls that count here, and so their members, lie in the cube of the part."""
    vertex, start = task.cover["vertex"], task.cover["vertex_start"]
    hull = np.repeat(np.arange(len(task.numbers)), np.diff(start))
    beyond = ((vertex < task.domain[0]) | (vertex > task.domain[1] + 1)).any(axis=1)
    wrong = np.flatnonzero(beyond & task.is_own[hull])
    first = [
        Offence(
            fault="vertex lies outside of the part's cube",
            hull=int(task.numbers[hull[v]]),
            vertex=int(v + task.vertex_shift[hull[v]]),
        )
        for v in wrong[:LISTED].tolist()
    ]
    count = int(np.diff(start)[task.is_own].sum())
    return check(CUBE_CHECK, count, first, "vertices", failed=len(wrong))


def _numbered(one: Check, task: CellHulls) -> Check:
    """The check with the numbers of hulls, vertices and planes in the part."""

    def numbered(at: Offence) -> Offence:
        if at.hull is None:
            return at
        vertex = None if at.vertex is None else int(at.vertex + task.vertex_shift[at.hull])
        plane = None if at.plane is None else int(at.plane + task.plane_shift[at.hull])
        return msgspec.structs.replace(at, hull=int(task.numbers[at.hull]), vertex=vertex, plane=plane)

    return msgspec.structs.replace(one, first=[numbered(at) for at in one.first])


def _excess(task: CellHulls, members: NDArray[np.int32]) -> float:
    """Volume of the union of the hulls outside of the members, both in the cell [voxels].

    A hull that leaves the cell is cut at its faces by further half-spaces.
    """
    cover, low, high = task.cover, task.cube[0], task.cube[1] + 1
    box = boxes_of(cover, task.domain)
    inner = np.stack([np.maximum(box[:, 0], low), np.minimum(box[:, 1], high)], axis=1)
    rows = np.flatnonzero((inner[:, 0] < inner[:, 1]).all(axis=1))
    if len(rows) == 0:
        return 0.0
    vertex, normal, offset = [], [], []
    for row in rows.tolist():
        begin, end = cover["vertex_start"][row : row + 2]
        vertex.append(cover["vertex"][begin:end])
        begin, end = cover["plane_start"][row : row + 2]
        normal.append(cover["plane_normal"][begin:end])
        offset.append(cover["plane_offset"][begin:end])
        if (inner[row] != box[row]).any():
            normal[-1] = np.vstack([normal[-1], _FACES])
            offset[-1] = np.concatenate([offset[-1], inner[row, 1], -inner[row, 0]])
    starts = [np.concatenate([[0], np.cumsum([len(some) for some in each])]) for each in (vertex, normal)]
    return _core.cover_excess(
        np.ascontiguousarray(members),
        np.concatenate(vertex),
        starts[0],
        np.concatenate(normal),
        np.concatenate(offset),
        starts[1],
        1,
        None,
    )
