"""PLY of polygons, strips or points. Every row and every byte is read, or the file is refused."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import IntArray
from alula.schemas.errors import ArtifactError, InputError
from alula.stages.compression.imported import Cloud, Mesh
from alula.stages.compression.polygons import check_indices, mesh_of, strip
from alula.stages.reconstruction.formats.ply_header import HEADER_LIMIT, Header, parse_header
from alula.stages.reconstruction.formats.ply_rows import Lists, ply_rows, positions

_CORNERS = ("vertex_indices", "vertex_index")
_NO_SHAPES = ("material", "camera", "range_grid", "multi_texture_vertex", "multi_texture_face")
_SPLAT = ("scale_0", "scale_1", "rot_0", "rot_1")


def read_ply(raw: bytes) -> Mesh | Cloud:
    """Read the polygons of a PLY file, or its points where it has none; see `polygons.mesh_of`.

    Raises:
        ArtifactError: the file is damaged.
        InputError: it has elements whose meaning is not known, or is a Gaussian splat.
    """
    header = parse_header(raw[:HEADER_LIMIT])
    shapes = [e.name for e in header.elements if e.name in ("face", "tristrips") and e.count]
    _check(header)
    rows = ply_rows(header, memoryview(raw))
    points = positions(rows["vertex"])
    if not shapes:
        return Cloud(points)
    lengths, corner = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    for name in shapes:
        lists = [rows[name].lists[c] for c in _CORNERS if c in rows[name].lists]
        if len(lists) != 1 or lists[0].values.dtype.kind not in "iu":
            have = ", ".join(rows[name].lists) or "no list"
            raise InputError(f"PLY: element {name} needs one list {' or '.join(_CORNERS)}, it has {have}")
        one, other = _faces(lists[0]) if name == "face" else _strips(lists[0])
        lengths.append(one)
        corner.append(other)
    index = np.concatenate(corner)
    check_indices(index, len(points))
    return mesh_of(points, np.concatenate(lengths), index)


def _check(header: Header) -> None:
    vertex = header.element("vertex")
    if vertex is None:
        raise ArtifactError("PLY: no element vertex")
    if all(vertex.column(name) is not None for name in _SPLAT) or header.element("chunk") is not None:
        raise InputError("PLY: a Gaussian splat; its points alone are not its surface: use import-splat")
    for element in header.elements:
        if element.name not in ("vertex", "face", "tristrips", *_NO_SHAPES) and element.count:
            raise InputError(
                f"PLY: element {element.name[:40]!r} is not known, so it may be a shape that would be missed"
            )


def _faces(lists: Lists) -> tuple[IntArray, IntArray]:
    short = np.flatnonzero(lists.lengths < 3)
    if len(short):
        raise InputError(
            f"PLY: face {short[0]} has {lists.lengths[short[0]]} corners, and only polygons can be marked"
        )
    return lists.lengths, lists.values.astype(np.int64)


def _strips(lists: Lists) -> tuple[IntArray, IntArray]:
    """Triangles of strips, which -1 separates."""
    found: list[NDArray[np.int64]] = []
    for part in np.split(lists.values.astype(np.int64), np.cumsum(lists.lengths)[:-1]):
        for one in np.split(part, np.flatnonzero(part == -1)):
            one = one[1:] if len(one) and one[0] == -1 else one
            if len(one) in (1, 2):
                raise InputError(f"PLY: a triangle strip has {len(one)} corners")
            if len(one):
                found.append(strip(one).reshape(-1))
    corner = np.concatenate([np.empty(0, np.int64), *found])
    return np.full(len(corner) // 3, 3, np.int64), corner
