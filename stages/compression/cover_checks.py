"""Checks of the hulls of a cover, in integers, without the code of `merge` and `voxelize`; see `verify`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.certificate import Check, Offence
from alula.schemas.artifacts.manifest import LEVEL, CoverManifest, LevelManifest, Manifest, VoxelsManifest
from alula.schemas.artifacts.parts import Parts
from alula.schemas.decimals import at_most, exact
from alula.schemas.errors import ArtifactError, InputError
from alula.schemas.progress import Progress
from alula.stages.compression.ellipsoids import retained, unproven_voxels
from alula.stages.compression.hulls import is_outer
from alula.stages.compression.level import require_sigma
from alula.stages.proof import LISTED, at_voxel, check, position_m

# Groups of the faults of native/core/include/alula/cover/cover_check.hpp.
POLYTOPES = (0, 1, 2, 3, 4, 5, 6, 9, 12, 13, 14)
MEMBERS = (7, 8)
_NOT_SOLID = (0, 3, 4, 5)
_NOT_BOUNDED = (0, 1, 3, 13, 14)  # of outer polytopes
_VERTEX_FAULTS, _PLANE_FAULTS = (3, 6, 9), (1, 4, 5, 12, 13)
_OTHER_IS_PLANE, _OTHER_IS_VERTEX = (3, 8), (12,)
_NOT_COVERED, _NOT_OCCUPIED = 10, 11
LATTICE_LIMIT = 2**20  # maximum coordinate for the measurement of volumes; the other checks have no limit
SCENE_CHECK = "every ellipsoid lies in the voxels"
VOLUME_TOLERANCE = 1e-6  # of the volume; rounding errors are far smaller
_GEOMETRY = (
    *("vertex", "vertex_start", "plane_normal", "plane_offset", "plane_start"),
    *("member_index", "member_start"),
)


def require_solid_hulls(cover: Artifact, *, jobs: int = 0) -> None:
    """Refuse a cover with planes and vertices that do not describe the same bounded polytopes.

    Filters use the planes; planners and judges use the vertices, which for outer polytopes are computed from
    the planes. All of them rely on this check. It does not prove that the hulls contain all voxels; `verify`
    does.

    Raises:
        ArtifactError: a hull is wrong; the message names the first one and its fault.
    """
    found = hull_faults(cover, jobs, None)
    if len(wrong := found[np.isin(found[:, 0], _NOT_BOUNDED if is_outer(cover) else _NOT_SOLID)]):
        first = _offence(cover, wrong[0].tolist(), None)
        raise ArtifactError(f"the cover is not sound: {first.text()}; make it again with merge")


def files_agree(cover: Artifact, voxels: Artifact | Parts | None, scene: Artifact | Parts | None) -> Check:
    """Check that lattice, level, frame and unit of the cover equal those of its claims and other files."""
    mine = cover.manifest
    assert isinstance(mine, CoverManifest)
    offences = unclaimed(mine, "cover")
    names = ["frame", "unit"]
    if voxels is not None:
        assert isinstance(voxels.manifest, VoxelsManifest)
        offences += unclaimed(voxels.manifest, "voxels")
        names += LEVEL
        offences += differences(names, "the cover", mine, "the voxels", voxels.manifest)
    if scene is not None:
        offences += differences(("frame", "unit"), "the cover", mine, "the scene", scene.manifest)
    return check("files agree", len(names), offences, "size, level, frame and unit")


def differences(
    names: Sequence[str], one: str, manifest: Manifest, other: str, theirs: Manifest
) -> list[Offence]:
    """Fields in which the manifest of one file differs from that of another."""
    return [
        Offence(fault=f"{name} of {one} is {getattr(manifest, name)}, of {other} {getattr(theirs, name)}")
        for name in names
        if getattr(manifest, name) != getattr(theirs, name)
    ]


def unclaimed(manifest: CoverManifest | VoxelsManifest, what: str) -> list[Offence]:
    """Differences between the level that a manifest's guarantee claims and its fields, which checks use."""
    claims = manifest.guarantee.claims if manifest.guarantee is not None else {}
    return [
        Offence(fault=f"{name} of the {what} is {value}, but its guarantee claims {claims[name]}")
        for name in LEVEL
        if name in claims and claims[name] != (value := getattr(manifest, name))
    ]


def hull_faults(cover: Artifact, jobs: int, progress: Progress | None) -> NDArray[np.int64]:
    """Rows (fault, hull, row, other) of the native checker, shape (K, 4).

    Raises:
        InputError: hulls have more half-planes and vertices than can be checked.
    """
    vertex, vertex_start, normal, offset, plane_start, member, member_start = (
        np.ascontiguousarray(cover[name]) for name in _GEOMETRY
    )
    try:
        return _core.check_cover_hulls(
            *(vertex, vertex_start, normal, offset, plane_start, member, member_start),
            is_outer(cover),
            jobs,
            progress,
        )
    except OverflowError as error:
        raise InputError(f"this is no cover that merge makes: {error}") from error


def hull_words(cover: Artifact) -> tuple[str, str, str, str]:
    """Names and details of the checks of hulls and of members."""
    detail = "planes support the vertices" if is_outer(cover) else "planes are the facets of vertices"
    return "hulls are exact polytopes", detail, "members lie in their hulls", "integer containment"


def occupied_words(*, is_given: bool) -> tuple[str, str]:
    """Name and detail of the check of voxels."""
    detail = "members are the voxels of the file" if is_given else "no voxels file: its own members"
    return "every voxel is a member", detail


def no_hull(exact: Check) -> Check:
    """The check that hulls are polytopes of a cover without any, which proves nothing.

    Args:
        exact: as of no hulls, which holds.
    """
    return check(exact.name, 0, [Offence(fault="there is no hull")], exact.detail)


def occupied_check(cover: Artifact, voxels: NDArray[np.int32] | None) -> Check:
    """Check that the members of the hulls are the occupied voxels.

    Args:
        cover: an `alula/cover`, of which only the members are used.
        voxels: shape (M, 3); None for the members themselves.
    """
    members = np.ascontiguousarray(cover["member_index"])
    occupied = members if voxels is None else np.ascontiguousarray(voxels)
    found = _core.check_cover_occupied(members, np.ascontiguousarray(cover["member_start"]), occupied)
    name, detail = occupied_words(is_given=voxels is not None)
    return fault_check(cover, name, len(occupied), found, (_NOT_COVERED, _NOT_OCCUPIED), detail, occupied)


def history_check(cover: Artifact) -> Check:
    """Check that each merge joins two elements that exist and were not joined before.

    Start elements are 0 .. N - 1 and merge k makes element N + k; N is `start_hulls` of the summary.
    """
    history = np.asarray(cover["history"], np.float64)
    merges, hulls = len(history), len(cover["plane_start"]) - 1
    start = cover.manifest.summary.get("start_hulls")
    offences = []
    if merges and not (isinstance(start, int) and start >= merges + hulls):
        offences.append(Offence(fault=f"{merges} merges of {start} elements do not leave {hulls} hulls"))
    else:
        joined = history[:, :2]
        last = (start or 0) + np.arange(merges)[:, None]
        known = (joined >= 0) & (joined < last) & (joined == np.floor(joined))
        _, first, number = np.unique(joined, return_index=True, return_inverse=True)
        again = first[number].reshape(joined.shape) != np.arange(joined.size).reshape(joined.shape)
        for fault, wrong in (
            ("joins an element that is not there yet", ~known.all(axis=1)),
            ("joins an element that was joined before", again.any(axis=1)),
            ("has a negative weight", history[:, 2] < 0),
        ):
            offences += [Offence(fault=f"merge {k} {fault}") for k in np.flatnonzero(wrong).tolist()]
    return check("history is consistent", merges, offences, "merges join earlier elements")


def volume_check(cover: Artifact, jobs: int, progress: Progress | None) -> Check:
    """Check the recorded conservativeness against the measured one.

    Args:
        cover: an `alula/cover` whose hulls are exact, with vertices of at most `LATTICE_LIMIT`.
    """
    voxels = np.unique(np.asarray(cover["member_index"], np.int32), axis=0)
    vertex, vertex_start, normal, offset, plane_start = (
        np.ascontiguousarray(cover[name]) for name in _GEOMETRY[:5]
    )
    excess = _core.cover_excess(voxels, vertex, vertex_start, normal, offset, plane_start, jobs, progress)
    return volume_of(cover.manifest, excess, len(voxels))


def volume_of(manifest: Manifest, excess: float, voxels: int) -> Check:
    """Check the recorded conservativeness of hulls around some voxels against the measured excess.

    Args:
        excess: volume of the union of the hulls outside of the voxels [voxels].
    """
    found = 1.0 + excess / voxels
    recorded: float = manifest.conservativeness  # type: ignore[attr-defined]
    offences = []
    if not abs(recorded - found) <= VOLUME_TOLERANCE * found:
        offences.append(
            Offence(fault=f"conservativeness is {exact(found)}, but recorded as {exact(recorded)}")
        )
    return check("volume is as recorded", 1, offences, f"conservativeness {at_most(found, 6)}")


def scene_check(
    level: LevelManifest,
    scene: Artifact,
    index: NDArray[np.int32],
    jobs: int,
    progress: Progress | None,
    *,
    crop: Sequence[float] | None = None,
    rows: NDArray[np.int64] | None = None,
    checked: int | None = None,
) -> Check:
    """Check that ellipsoids touch no voxel that is not occupied.

    Args:
        index: the occupied voxels, shape (M, 3).
        crop: box whose voxels are looked at [m]; None for that of the level.
        rows: number of each Gaussian in the whole scene, shape (N,); None where `scene` is the whole.
        checked: number of ellipsoids that count; None for those of at least the minimum opacity.
    """
    missing = unproven_voxels(
        scene,
        index,
        voxel_size_m=level.voxel_size_m,
        sigma=require_sigma(level),
        inflation_m=level.inflation_m,
        crop=level.crop if crop is None else crop,
        min_overlap=level.min_overlap,
        min_opacity=level.min_opacity,
        ignore_loss=level.ignore_loss,
        jobs=jobs,
        progress=progress,
    )
    fault, size = "an ellipsoid may touch an unmarked voxel", level.voxel_size_m
    first = [
        at_voxel(fault, np.asarray(voxel), size, gaussian=int(row if rows is None else rows[row]))
        for voxel, row in zip(missing.voxel[:LISTED], missing.ellipsoid[:LISTED], strict=True)
    ]
    count = len(retained(scene, level.min_opacity)) if checked is None else checked
    return check(SCENE_CHECK, count, first, "separating planes", failed=missing.total)


def fault_check(
    cover: Artifact,
    name: str,
    checked: int,
    found: NDArray[np.int64],
    faults: tuple[int, ...],
    detail: str,
    occupied: NDArray[np.int32] | None = None,
) -> Check:
    """Check that there is none of some faults.

    Args:
        found: rows (fault, hull, row, other) of the native checker, shape (K, 4).
        occupied: voxels that a row may number, shape (M, 3).
    """
    mine = found[np.isin(found[:, 0], faults)]
    first = [_offence(cover, row, occupied) for row in mine[:LISTED].tolist()]
    return check(name, checked, first, detail, failed=len(mine))


def _offence(cover: Artifact, row: list[int], occupied: NDArray[np.int32] | None) -> Offence:
    """Offence for a row (fault, hull, row, other) of the native checker, with its position."""
    fault, hull, at, other = row
    plane = at if fault in _PLANE_FAULTS else other if fault in _OTHER_IS_PLANE else None
    vertex = at if fault in _VERTEX_FAULTS else other if fault in _OTHER_IS_VERTEX else None
    voxel: Any = None
    if fault == _NOT_COVERED:
        assert occupied is not None
        voxel = occupied[at]
    elif fault in (*MEMBERS, _NOT_OCCUPIED):
        voxel = cover["member_index"][at]
    point = None if voxel is None else voxel + 0.5
    if vertex is not None:
        point = cover["vertex"][vertex]
    elif point is None and (first := int(cover["vertex_start"][hull])) < int(cover["vertex_start"][hull + 1]):
        point = cover["vertex"][first]
    size: float = cover.manifest.voxel_size_m  # type: ignore[attr-defined]
    return Offence(
        fault=_core.cover_fault(fault),
        hull=hull if hull >= 0 else None,
        place_m=None if point is None else position_m(point, size),
        plane=plane,
        vertex=vertex,
        voxel=None if voxel is None else tuple(voxel.tolist()),
    )
