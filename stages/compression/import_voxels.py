"""The stage `import-voxels`: mark the voxels that a mesh, a cloud or an octree occupies."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.artifact import Artifact, make_artifact
from alula.schemas.artifacts.kinds import VOXELS
from alula.schemas.artifacts.manifest import IMPORTED_MAP, Guarantee, ImportedMap
from alula.schemas.artifacts.provenance import parameters_of
from alula.schemas.decimals import at_most, exact
from alula.schemas.errors import ArtifactError, InfeasibleError, InputError, UsageError
from alula.schemas.parameters.configs.import_voxels import ImportVoxelsConfig
from alula.schemas.progress import Progress
from alula.stages.compression.imported import (
    NAMES,
    OCTREE_HALF,
    Cloud,
    ImportedSource,
    Mesh,
    Octree,
    decimal,
    in_world,
    lattice_range,
    require_watertight,
)
from alula.stages.compression.level import imported_words
from alula.stages.compression.limits import LATTICE_LIMIT
from alula.stages.compression.voxelize import SURE, rounded, too_many
from alula.stages.coordinates import nearer_origin, single_rounding

_ALL = 2**32 - 1  # a minimum count that no voxel has: only their number is wanted
_COARSE = 32  # voxels along the longest edge of the box when the estimate begins
_CERTAIN = 4.0  # multiple of the limit above which a rough estimate ends the command
_ROOM = 0.8  # fraction of the limit that a remedy aims at
_FINE = 0.1  # of a voxel: a larger rounding of the file's numbers is refused unless --margin covers it
_NEAR = 0.5  # of the lattice that merge can take
_UNKNOWN, _FREE, _OCCUPIED = 0, 1, 2
_ONLY = {"margin_m": (Mesh, Cloud), "solid": (Mesh,), "min_points": (Cloud,), "unknown": (Octree,)}

Voxels = tuple[NDArray[np.int32], NDArray[np.uint32], int, int]
"""Index, count, number below the minimum count, highest count, as the native functions return them."""


@dataclass(frozen=True, slots=True)
class _Marked:
    voxels: Voxels
    facts: dict[str, Any]  # for the summary
    left_out: dict[str, Any]  # for the guarantee


def import_voxels(
    config: ImportVoxelsConfig, source: ImportedSource, *, jobs: int = 0, progress: Progress | None = None
) -> Artifact:
    """Mark every voxel that a mesh or a cloud, grown by a ball, touches, or that an octree occupies.

    The closed cube [i g, (i + 1) g] is marked when its distance to a triangle, or to at least `min_points`
    points, is at most `margin_m`. With `solid` all that a watertight mesh encloses is marked, too: the points
    with a winding number other than 0. Of an octree the voxels that share more than their surface with an
    occupied leaf are marked, so that they contain it; with `unknown` "occupied" also those of cubes that
    nothing is known of, within the box of all leaves. Edges of octree and voxels count as the decimals that
    the file and the configuration state. Rounding is outward (see `touch.hpp`).

    Returns:
        An `alula/voxels` in the frame "world". `overlap` is the number of triangles, points or cubes that
        touch the voxel; 0 where only the inside of a mesh does.

    Raises:
        UsageError: a parameter is not for this kind of source.
        InputError: the mesh is not watertight, or there are more voxels than `max_voxels` or memory allows.
        ArtifactError: the octree is damaged.
        InfeasibleError: no voxel is marked.
    """
    imported = imported_of(config, source)
    try:
        if isinstance(source, Octree):
            marked = _mark_octree(config, source, jobs, progress)
        else:
            marked = _mark_touched(config, source, imported, jobs, progress)
    except OverflowError as error:
        raise InputError(f"{error}; use --crop or a larger --size") from error
    index, overlap, below, most = marked.voxels
    if len(index) > config.max_voxels:
        raise InputError(too_many(config.size_m, len(index), config.max_voxels, []))
    if len(index) + below == 0:
        raise InfeasibleError(
            f"nothing of the {imported.kind} touches the crop, so there is no voxel to mark"
        )
    if len(index) == 0:
        raise InfeasibleError(f"no voxel is touched by {config.min_points} points; the maximum is {most}")
    size = config.size_m
    moved: dict[str, Any] = {}
    if any(imported.map_origin_m):
        moved["map_origin_m"] = imported.map_origin_m
        if config.map_origin is None:
            moved["notes"] = [
                "coordinates are too large for merge, so that the map has its origin at "
                f"({' '.join(f'{c:.12g}' for c in imported.map_origin_m)}) m of the file (--map-origin)"
            ]
    summary = (
        marked.facts
        | moved
        | {
            "voxels": len(index),
            "dropped_by_min_overlap": below,
            "volume_m3": len(index) * size**3,
            "mean_overlap": float(overlap.mean(dtype=np.float64)),
            "max_overlap": int(overlap.max()),
            "lower_m": (index.min(axis=0) * size).tolist(),
            "upper_m": ((index.max(axis=0).astype(np.float64) + 1) * size).tolist(),
            "inflation_m": config.margin_m,
        }
    )
    return make_artifact(
        VOXELS,
        {"index": index, "overlap": overlap},
        parameters=parameters_of(config),
        summary=summary,
        frame="world",
        unit="m",
        guarantee=_guarantee(config, imported, marked.left_out | {"voxels_below_min_overlap": below}),
        voxel_size_m=size,
        sigma=None,
        min_overlap=config.min_points,
        inflation_m=config.margin_m,
        crop=None if config.crop is None else list(config.crop),
        imported=imported,
        requires=[IMPORTED_MAP],
    )


def imported_of(config: ImportVoxelsConfig, source: ImportedSource) -> ImportedMap:
    """Definition of the obstacles of a source.

    Raises:
        UsageError: a parameter is not for this kind of source.
        InputError: the numbers of the source are coarser than the voxels.
    """
    names = {"margin_m": "--margin", "solid": "--solid", "min_points": "--min-points", "unknown": "--unknown"}
    for field, kinds in _ONLY.items():
        default = ImportVoxelsConfig.__dataclass_fields__[field].default
        if getattr(config, field) != default and not isinstance(source, kinds):
            words = " and ".join(f"{NAMES[kind]}s" for kind in kinds)
            raise UsageError(f"{names[field]} is for {words}, and this is {_article(source)}")
    if isinstance(source, Octree) and config.map_origin is not None:
        raise UsageError("--map-origin is for meshes and clouds, and this is an octree")
    if isinstance(source, Octree) and config.up == "y":
        raise UsageError("--up is for meshes and clouds, and this is an octree")
    up = source.up if isinstance(source, Mesh) and config.up == "auto" else config.up
    return ImportedMap(
        kind=NAMES[type(source)],  # type: ignore[arg-type]
        scale=config.scale,
        up="y" if up == "y" else "z",
        solid=config.solid,
        unknown=config.unknown,
        map_origin_m=list(_map_origin(config, source, up)),
    )


def _map_origin(
    config: ImportVoxelsConfig, source: ImportedSource, up: Literal["auto", "y", "z"]
) -> tuple[float, float, float]:
    """Origin of the map, chosen where voxels would lie too far from that of the file for `merge`.

    Raises:
        InputError: the file's numbers are coarser than the voxels, or the crop is in a frame that moves.
    """
    if isinstance(source, Octree):
        return 0.0, 0.0, 0.0
    points = source.surface.reshape(-1, 3) if isinstance(source, Mesh) else source.points
    rounding = config.scale * float(single_rounding(points).max(initial=0.0))
    if rounding > max(config.margin_m, _FINE * config.size_m):
        raise InputError(
            f"its coordinates are single-precision numbers as large as {np.abs(points).max():.6g}, which are "
            f"rounded by up to {at_most(rounding)} m: walls may be lost; write it in double precision or "
            f"from a local origin, or grow it by --margin {at_most(rounding)}"
        )
    if config.map_origin is not None:
        return config.map_origin
    found = in_world(points, config.scale, "y" if up == "y" else "z")
    far = _NEAR * LATTICE_LIMIT * config.size_m
    origin = nearer_origin(found.min(axis=0), found.max(axis=0), far) if len(found) else (0.0, 0.0, 0.0)
    if any(origin) and config.crop is not None:
        words = " ".join(f"{c:.12g}" for c in origin)
        raise InputError(
            f"it reaches more than {far:g} m from its origin, too far for merge; give --map-origin, such as "
            f'"{words}", and --crop relative to it'
        )
    return origin


def _article(source: ImportedSource) -> str:
    return f"{'an' if isinstance(source, Octree) else 'a'} {NAMES[type(source)]}"


def _mark_touched(
    config: ImportVoxelsConfig,
    source: Mesh | Cloud,
    imported: ImportedMap,
    jobs: int,
    progress: Progress | None,
) -> _Marked:
    if isinstance(source, Mesh):
        found = in_world(source.surface, config.scale, imported.up, imported.map_origin_m)
        facts: dict[str, Any] = {"triangles": len(source.corners)}
        if len(source.bent):
            facts["triangles_of_polygons_that_are_not_flat"] = len(source.bent)
        native: Callable[..., Voxels] = _core.touched_by_triangles
    else:
        found = in_world(source.points, config.scale, imported.up, imported.map_origin_m)
        facts, native = {"points": len(found)}, _core.touched_by_points
    crop = None if config.solid else config.crop
    inside = 0.0
    if isinstance(source, Mesh) and config.solid:
        closed = in_world(source.corners, config.scale, imported.up, imported.map_origin_m)
        require_watertight(closed)
        inside = abs(float(np.linalg.det(closed).sum()) / 6) if config.crop is None else 0.0
    common = {"radius": config.margin_m, "crop": crop, "jobs": jobs}

    def number(size: float) -> float:
        return native(found, voxel_size=size, min_count=_ALL, **common)[2] + inside / size**3

    _require_few(config, found, number)
    voxels = native(found, voxel_size=config.size_m, min_count=config.min_points, progress=progress, **common)
    if isinstance(source, Mesh) and config.solid:
        surface = len(voxels[0])
        index, count, *rest = _core.with_inside(
            *voxels[:2], closed, config.size_m, config.crop, jobs, progress
        )
        voxels = (index, count, rest[0], rest[1])
        facts["voxels_of_the_surface"] = surface
    left_out = {"points_of_no_triangle": source.loose} if isinstance(source, Mesh) and source.loose else {}
    return _Marked(voxels, facts, left_out)


def _require_few(config: ImportVoxelsConfig, points: FloatArray, number: Callable[[float], float]) -> None:
    """Refuse far more voxels than `max_voxels` before the work.

    They are counted at 2^k times the size, from few large voxels on. The growth from one size to the next, at
    most 8, gives an estimate at the size itself.
    """
    box = np.ptp(points.reshape(-1, 3), axis=0)
    if config.crop is not None:
        box = np.minimum(box, np.subtract(config.crop[3:], config.crop[:3]))
    longest = (float(box.max()) + 2 * config.margin_m) / config.size_m
    previous = None
    for k in range(math.ceil(math.log2(max(longest / _COARSE, 1))), 1, -1):
        size = config.size_m * 2**k
        found = number(size)
        if found * 8**k <= config.max_voxels:
            return
        if previous:
            growth = min(max(found / previous, 1.5), 8.0)
            about = found * growth**k
            if about > config.max_voxels * (SURE if k == 2 else _CERTAIN):
                fits = size * (found / (_ROOM * config.max_voxels)) ** (1 / math.log2(growth))
                remedy = f"--size {at_most(fits, 2)} makes about {rounded(_ROOM * config.max_voxels)}"
                raise InputError(too_many(config.size_m, about, config.max_voxels, [remedy]))
        previous = found


def _mark_octree(config: ImportVoxelsConfig, source: Octree, jobs: int, progress: Progress | None) -> _Marked:
    try:
        lower, edge, state, nodes = _core.octree_leaves(source.body, source.is_binary, source.payload)
    except ValueError as error:
        raise ArtifactError(f"is damaged: {error}") from error
    if nodes != source.nodes:
        raise ArtifactError(f"is damaged: it has {nodes} nodes, but its header says {source.nodes}")
    upper = lower + edge[:, None]
    known, marked = state != _UNKNOWN, state == _OCCUPIED
    facts = {"leaves_occupied": int(marked.sum()), "leaves_free": int((state == _FREE).sum())}
    if config.unknown == "occupied" and known.any():
        low, high = lower[known].min(axis=0), upper[known].max(axis=0)
        lower = np.where(known[:, None], lower, np.maximum(lower, low))
        upper = np.where(known[:, None], upper, np.minimum(upper, high))
        within = ~known & (lower < upper).all(axis=1)
        facts["cubes_unknown"] = int(within.sum())
        marked = marked | within
    if not marked.any():
        raise InfeasibleError("the octree has no occupied leaf, so there is no voxel to mark")
    ratio = source.edge * decimal(config.scale) / decimal(config.size_m)
    assert np.abs(lower).max() <= OCTREE_HALF
    first, last = lattice_range(lower[marked], upper[marked], ratio)
    sides = (upper[marked].astype(np.int64) - lower[marked]) * float(ratio)
    about = _at_least(first, last, config)[(sides >= 1).all(axis=1)].sum() / 8  # at most eight share a voxel
    if about > config.max_voxels:
        raise InputError(too_many(config.size_m, float(about), config.max_voxels, []))
    voxels = _core.voxels_of_blocks(first, last, config.size_m, config.crop, jobs, progress)
    return _Marked(voxels, facts, {})


def _at_least(first: NDArray[np.int32], last: NDArray[np.int32], config: ImportVoxelsConfig) -> FloatArray:
    """Voxels of boxes first ... last that lie in the crop, shape (N,)."""
    low, high = first.astype(np.float64), last.astype(np.float64)
    if config.crop is not None:
        low = np.maximum(low, np.ceil(np.array(config.crop[:3]) / config.size_m))
        high = np.minimum(high, np.floor(np.array(config.crop[3:]) / config.size_m) - 1)
    found: FloatArray = np.maximum(high - low + 1, 0).prod(axis=1)
    return found


def _guarantee(config: ImportVoxelsConfig, imported: ImportedMap, left_out: dict[str, Any]) -> Guarantee:
    what = imported_words(imported, config.margin_m)
    if imported.kind == "octree":
        statement = f"The marked voxels contain {what}"
    elif config.min_points > 1:
        statement = (
            f"Every voxel that {what} touches is marked if at least {config.min_points} of them touch it; "
            f"{left_out['voxels_below_min_overlap']} touched voxels are left out"
        )
    else:
        statement = f"Every voxel that {what} touches is marked"
    if config.crop is not None:
        statement += f", as far as it touches the crop {exact(config.crop)} m"
    claims = {
        "obstacles": imported.kind,
        "solid": imported.solid,
        "unknown": imported.unknown,
        "inflation_m": config.margin_m,
        "voxel_size_m": config.size_m,
        "min_overlap": config.min_points,
        "crop": None if config.crop is None else list(config.crop),
        "left_out": left_out,
    }
    return Guarantee(statement=statement + ".", claims=claims)
