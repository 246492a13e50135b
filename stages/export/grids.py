"""Voxels and distances for other mapping programs: OctoMap, point clouds, a distance field, a footprint."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.provenance import Provenance
from alula.schemas.errors import InputError, UsageError
from alula.stages.clearance import hull_obstacles
from alula.stages.compression.hulls import Hulls
from alula.stages.export.pieces import hull_name

_DEPTH = 16  # of OctoMap's trees
_HALF = 1 << (_DEPTH - 1)  # number of the voxel at the origin
_LEAF, _INNER = 0b10, 0b11  # the bits of a child in the order of the file: occupied leaf, inner node
_MOST_SAMPLES = 2**27  # of a distance field: 0.5 GB
_WGS84_A_M, _WGS84_F = 6378137.0, 1 / 298.257223563

IntArray = NDArray[np.int64]


def octomap(voxels: Artifact, provenance: Provenance) -> Iterator[bytes]:
    """Write OctoMap's binary tree (.bt): marked voxels are occupied, all others unknown.

    Voxel i is the cube [i g, (i + 1) g], the same lattice as OctoMap's. Eight occupied siblings are one leaf.

    Raises:
        InputError: a voxel lies more than 2^15 voxels from the origin, where OctoMap's tree ends.
    """
    key = np.asarray(voxels["index"], np.int64) + _HALF
    if len(key) and (key.min() < 0 or key.max() >= 1 << _DEPTH):
        raise InputError(f"a voxel lies more than {_HALF} voxels from the origin, where OctoMap's tree ends")
    edge = voxels.manifest.voxel_size_m  # type: ignore[attr-defined]
    body, nodes = _tree(_morton(key))
    yield b"# Octomap OcTree binary file\n"
    yield f"# {provenance.line()}\n".encode()
    yield f"id OcTree\nsize {nodes}\nres {edge!r}\ndata\n".encode()
    yield body


def _morton(key: IntArray) -> IntArray:
    """Path of each voxel from the root: three bits a level, x lowest; sorted."""
    found = np.zeros(len(key), np.int64)
    for level in range(_DEPTH):
        for axis in range(3):
            found |= ((key[:, axis] >> level) & 1) << (3 * level + axis)
    return np.sort(found)


def _tree(leaf: IntArray) -> tuple[bytes, int]:
    """Bytes of the nodes in depth-first order, and their number, the leaves included."""
    if len(leaf) == 0:
        return b"", 0
    # Of each level from the leaves up: the nodes, whether each is a full leaf, and the 16 bits of inner ones.
    levels: list[tuple[IntArray, NDArray[np.bool_], NDArray[np.uint16]]] = [
        (leaf, np.ones(len(leaf), np.bool_), np.zeros(len(leaf), np.uint16))
    ]
    for _ in range(_DEPTH):
        node, is_full, _ = levels[-1]
        parent, first = np.unique(node >> 3, return_index=True)
        bits = np.where(is_full, _LEAF, _INNER).astype(np.uint16) << (2 * (node & 7)).astype(np.uint16)
        packed = np.bitwise_or.reduceat(bits, first)
        full = np.add.reduceat(is_full.astype(np.int64), first) == 8
        levels.append((parent, full, packed.astype(np.uint16)))
    if levels[-1][1][0]:
        raise InputError("every voxel of OctoMap's tree is occupied")
    # Depth first: a parent before its children, these in order; a full leaf has no record.
    kept, depth, packed_bits = [], [], []
    count = 1
    for height, (node, is_full, bits) in enumerate(levels):
        inner = ~is_full
        kept.append(node[inner] << (3 * height))
        depth.append(np.full(int(inner.sum()), _DEPTH - height, np.int64))
        packed_bits.append(bits[inner])
        if height > 0:  # children that are written: of inner nodes
            count += int(sum(_children(b) for b in _chunks(bits[inner])))
    order = np.lexsort((np.concatenate(depth), np.concatenate(kept)))
    return np.concatenate(packed_bits)[order].astype("<u2").tobytes(), count


def _chunks(bits: NDArray[np.uint16]) -> Iterator[NDArray[np.uint16]]:
    for start in range(0, len(bits), 2**20):
        yield bits[start : start + 2**20]


def _children(bits: NDArray[np.uint16]) -> int:
    """Number of children in all nodes: each has its higher bit set, as occupied leaf or as inner node."""
    return sum(int(((bits >> (2 * child + 1)) & 1).sum()) for child in range(8))


def voxels_ply(voxels: Artifact, provenance: Provenance) -> Iterator[bytes]:
    """Write the centres of the voxels as a binary PLY point cloud in double precision [m]."""
    centre, edge = _centres(voxels)
    yield (
        f"ply\nformat binary_little_endian 1.0\ncomment {provenance.line()}\n"
        f"comment centres of voxels with an edge of {edge!r} m\nelement vertex {len(centre)}\n"
        "property double x\nproperty double y\nproperty double z\nend_header\n"
    ).encode()
    yield centre.astype("<f8").tobytes()


def voxels_pcd(voxels: Artifact, provenance: Provenance) -> Iterator[bytes]:
    """Write the centres of the voxels as a binary PCD point cloud in the usual single precision [m]."""
    centre, edge = _centres(voxels)
    yield (
        f"# .PCD v0.7 - centres of voxels with an edge of {edge!r} m\n# {provenance.line()}\nVERSION 0.7\n"
        f"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {len(centre)}\nHEIGHT 1\n"
        f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(centre)}\nDATA binary\n"
    ).encode()
    yield centre.astype("<f4").tobytes()


def _centres(voxels: Artifact) -> tuple[FloatArray, float]:
    edge = float(voxels.manifest.voxel_size_m)  # type: ignore[attr-defined]
    return (np.asarray(voxels["index"], np.float64) + 0.5) * edge, edge


def field(cover: Artifact, provenance: Provenance) -> Iterator[bytes]:
    """Write the signed distance to the cover on a grid, as an NPZ of arrays.

    Arrays: `distance_m` f32 (nx, ny, nz), negative inside of a hull, at the points `origin_m` f64 (3,) +
    (i, j, k) `spacing_m`; `error_m`: the distance is 1-Lipschitz, so trilinear interpolation between samples
    is at most sqrt(3) / 2 spacing off, and rounding to single precision is added. Subtract it, and what is
    still positive is free of hulls. Inside, the value is minus the depth in the deepest hull, which is at
    most the depth in the union.

    The parameters `spacing_m` and `pad_m` of the provenance give the spacing, and how far the grid reaches
    beyond the box of the cover.

    Raises:
        UsageError: the grid would have more than 2^27 samples.
        InputError: the cover has no hulls.
    """
    hulls = Hulls.from_cover(cover)
    if len(hulls) == 0:
        raise InputError("the cover has no hulls, so there is no distance to them")
    given: Any = provenance.parameters["spacing_m"]
    spacing = float(cover.manifest.voxel_size_m if given is None else given)  # type: ignore[attr-defined]
    pad = float(provenance.parameters["pad_m"])
    low, high = hulls.bounds()
    first = np.floor((low.min(axis=0) - pad) / spacing).astype(np.int64)
    size = np.ceil((high.max(axis=0) + pad) / spacing).astype(np.int64) - first + 1
    if math.prod(size.tolist()) > _MOST_SAMPLES:
        raise UsageError(
            f"a field of {' x '.join(map(str, size.tolist()))} samples is larger than {_MOST_SAMPLES}; "
            "give a larger --spacing"
        )
    obstacles = hull_obstacles(hulls)
    distance = np.empty(size, np.float32)
    axes = [(first[i] + np.arange(size[i])) * spacing for i in range(3)]
    for i, x in enumerate(axes[0]):
        y, z = np.meshgrid(axes[1], axes[2], indexing="ij")
        points = np.ascontiguousarray(np.column_stack([np.full(y.size, x), y.ravel(), z.ravel()]))
        distance[i] = obstacles.clearance(points, points, math.inf).reshape(y.shape)
    rounding = float(np.spacing(np.abs(distance).max()))
    arrays = {
        "distance_m": distance,
        "origin_m": first * spacing,
        "spacing_m": np.float64(spacing),
        "error_m": np.float64(math.sqrt(3) / 2 * spacing + rounding),
        "provenance": np.frombuffer(provenance.line().encode(), np.uint8),
    }
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    yield buffer.getvalue()


def geojson(cover: Artifact, provenance: Provenance) -> Iterator[bytes]:
    """Write the footprint of each hull as a polygon of GeoJSON (RFC 7946), with its heights.

    The cover's frame is taken as x east, y north, z up, at the geodetic origin that the parameter `origin` of
    the provenance gives: latitude, longitude [degree], and height above the WGS84 ellipsoid [m].

    Raises:
        UsageError: there is no origin.
    """
    origin = provenance.parameters.get("origin")
    if origin is None:
        raise UsageError("GeoJSON needs --origin LAT LON HEIGHT, of the origin of the cover's frame")
    hulls = Hulls.from_cover(cover)
    features = []
    for number in range(len(hulls)):
        corners = hulls.vertices_world[slice(*hulls.vertex_start[number : number + 2].tolist())]
        ring = _outline(corners)
        place = geodetic(np.array(origin, np.float64), np.column_stack([ring, np.zeros(len(ring))]))
        closed = place[[*range(len(ring)), 0]]
        features.append(
            {
                "type": "Feature",
                "id": hull_name(number),
                "geometry": {"type": "Polygon", "coordinates": [closed[:, 1::-1].tolist()]},
                "properties": {"bottom_m": float(corners[:, 2].min()), "top_m": float(corners[:, 2].max())},
            }
        )
    yield msgspec.json.encode(
        {"type": "FeatureCollection", "features": features, "provenance": provenance}, order="sorted"
    )


def _outline(points: FloatArray) -> FloatArray:
    """Corners of the convex hull of points seen from above, counter-clockwise, shape (k, 2) [m]."""
    from scipy.spatial import ConvexHull

    flat = np.unique(points[:, :2], axis=0)
    return np.asarray(flat[ConvexHull(flat).vertices], np.float64)


def geodetic(origin: FloatArray, p_enu: FloatArray) -> FloatArray:
    """Convert points east, north and up of an origin to latitude, longitude [degree] and height [m].

    The exact transform through Earth-centred coordinates, inverted by Bowring's method, whose error is below
    1 mm near the surface.

    Args:
        origin: latitude, longitude [degree], height above the WGS84 ellipsoid [m], shape (3,).
        p_enu: shape (n, 3) [m].

    Returns:
        Shape (n, 3).

    Source: Bowring 1976, Survey Review 23(181), 323-327.
    """
    lat, lon = np.deg2rad(origin[:2])
    e2 = _WGS84_F * (2 - _WGS84_F)
    n = _WGS84_A_M / math.sqrt(1 - e2 * math.sin(lat) ** 2)
    c, s, d, t = math.cos(lat), math.sin(lat), math.cos(lon), math.sin(lon)
    base = np.array([(n + origin[2]) * c * d, (n + origin[2]) * c * t, (n * (1 - e2) + origin[2]) * s])
    R_ecef_enu = np.array([[-t, -s * d, c * d], [d, -s * t, c * t], [0.0, c, s]])
    x, y, z = (base + p_enu @ R_ecef_enu.T).T
    b = _WGS84_A_M * (1 - _WGS84_F)
    p = np.hypot(x, y)
    theta = np.arctan2(z * _WGS84_A_M, p * b)
    found = np.arctan2(z + e2 / (1 - e2) * b * np.sin(theta) ** 3, p - e2 * _WGS84_A_M * np.cos(theta) ** 3)
    m = _WGS84_A_M / np.sqrt(1 - e2 * np.sin(found) ** 2)
    return np.column_stack([np.rad2deg(found), np.rad2deg(np.arctan2(y, x)), p / np.cos(found) - m])
