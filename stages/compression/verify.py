"""The stage `verify`: prove that a cover contains the ellipsoids of a scene, without `merge` and `voxelize`.

The checks share no code with those stages. The file is long because it is one proof: its checks and the
certificate with their results belong together.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import msgspec
import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.artifact import Artifact
from alula.schemas.decimals import at_most, exact
from alula.schemas.errors import ArtifactError, InputError, UsageError
from alula.schemas.manifest import (
    LEVEL,
    CoverManifest,
    InputRef,
    LevelManifest,
    Manifest,
    SceneManifest,
    VoxelsManifest,
)
from alula.schemas.progress import Progress
from alula.stages.compression.ellipsoids import (
    excluded_errors,
    recorded_lacks,
    removed_from,
    retained,
    unproven_voxels,
)
from alula.stages.compression.hulls import is_outer
from alula.stages.compression.imported import ImportedSource
from alula.stages.compression.level import (
    obstacle_of,
    obstacles_words,
    omissions,
    outside_words,
    recorded_level,
    require_sigma,
    without,
)
from alula.stages.compression.limits import VERIFY_VOXELS, require_at_most
from alula.stages.compression.verify_imported import imported_checks
from alula.stages.progress import share

SCHEMA, VERSION = "alula/certificate", "1.3"
LISTED = 100  # maximum number of offences that a check lists

# Groups of the faults of native/core/include/alula/cover/cover_check.hpp.
_POLYTOPES = (0, 1, 2, 3, 4, 5, 6, 9, 12, 13, 14)
_MEMBERS = (7, 8)
_NOT_SOLID = (0, 3, 4, 5)
_NOT_BOUNDED = (0, 1, 3, 13, 14)  # of outer polytopes
_VERTEX_FAULTS, _PLANE_FAULTS = (3, 6, 9), (1, 4, 5, 12, 13)
_OTHER_IS_PLANE, _OTHER_IS_VERTEX = (3, 8), (12,)
_NOT_COVERED, _NOT_OCCUPIED = 10, 11
_LATTICE_LIMIT = 2**20  # maximum coordinate for the measurement of volumes; the other checks have no limit
_VOLUME_TOLERANCE = 1e-6  # of the volume; rounding errors are far smaller
_VOLUME_BEGINS, _SCENE_BEGINS = 0.1, 0.5  # approximate fractions of the time at which these checks begin
_GEOMETRY = (
    *("vertex", "vertex_start", "plane_normal", "plane_offset", "plane_start"),
    *("member_index", "member_start"),
)


class Described(Protocol):
    """An artifact, or one in parts."""

    @property
    def manifest(self) -> Manifest:
        """Manifest of the whole."""
        ...


class Offence(msgspec.Struct, frozen=True, kw_only=True):
    """One failure of a check.

    Attributes:
        fault: description of the failure.
        hull: number of the hull.
        place_m: position of the offending vertex, of a vertex of the hull of an offending plane, or of the
            centre of an offending voxel, in the cover's frame [m]; None for failures without a position.
        gaussian: row of the scene.
        plane: row of `plane_normal`.
        vertex: row of `vertex`.
        voxel: lower corner of the voxel on the lattice.
    """

    fault: str
    hull: int | None = None
    place_m: tuple[float, float, float] | None = None
    gaussian: int | None = None
    plane: int | None = None
    vertex: int | None = None
    voxel: tuple[int, int, int] | None = None

    def text(self) -> str:
        """One phrase: the fault and its location."""
        words = self.fault
        for name, row in (("hull", self.hull), ("plane", self.plane), ("Gaussian", self.gaussian)):
            if row is not None:
                words += f", {name} {row}"
        if self.place_m is not None:
            words += " at (" + ", ".join(f"{c:.10g}" for c in self.place_m) + ") m"
        return words


class Check(msgspec.Struct, frozen=True, kw_only=True):
    """Result of one check: numbers of items checked and failed, and the first offences."""

    name: str
    ok: bool
    checked: int
    failed: int
    detail: str
    first: list[Offence]


class Certificate(msgspec.Struct, frozen=True, kw_only=True):
    """Result of all checks of a cover.

    Attributes:
        covered: every check holds; `statement` says of what, for the files that were given.
        checks: the results, in the order of the report.
        left_out: obstacles and errors outside the proof, in words.
        notes: observations that do not affect the proof, such as files that are not the recorded inputs.
        statement: the verdict in words.
        level: definition of an obstacle that the proof used; `mass_fraction` is the fraction of a Gaussian's
            mass inside its ellipsoid at `sigma`. Of a plan among hulls and ellipsoids it is that of the
            hulls, and `scene` in it that of the ellipsoids.
        given: roles of the files that were checked.
        not_checked: links of the proof that the files do not suffice for.
        omits: what the level leaves out of the scene or map, in words, also named by `statement`.
    """

    covered: bool
    checks: list[Check]
    left_out: str
    notes: list[str] = []
    statement: str = ""
    level: dict[str, Any] = {}
    given: list[str] = []
    not_checked: list[str] = []
    omits: list[str] = []

    def complaint(self) -> str:
        """Message with the first check that fails and its first offence; empty when covered."""
        for check in self.checks:
            if not check.ok:
                place = check.first[0].text() if check.first else check.detail
                more = f" (and {check.failed - 1} more)" if check.failed > 1 else ""
                return f"not proven: {check.name}: {place}{more}"
        return ""


def verify(
    cover: Artifact,
    *,
    voxels: Artifact | None = None,
    scene: Artifact | None = None,
    source: ImportedSource | None = None,
    sha256: Mapping[str, str] | None = None,
    jobs: int = 0,
    progress: Progress | None = None,
) -> Certificate:
    """Check a cover against voxels and scene, using its arrays alone.

    Hulls are checked in integers, without tolerance and without the code that built them: vertices and
    planes must describe the same bounded polytope, each member voxel v must have normal . v + sum of positive
    normal components <= offset for all planes, and each vertex must be a corner of a member. For outer
    polytopes the vertices need not describe the polytope, but each plane must support them,
    offset = max normal . vertex, and the planes of the bounding box must be there. Every occupied voxel must
    be a member. Merges recorded in `history` must refer to earlier elements, and `conservativeness` must be
    the volume of the union, which is measured again. With a scene, each ellipsoid
    {x : (x - mean)' inv(Sigma) (x - mean) <= sigma^2}, grown by the inflation, must lie in the occupied
    voxels, except where the recorded crop, overlap and opacity exclude it. For the mesh, cloud or octree
    that the voxels were imported from see `imported_checks`.

    Args:
        cover: an `alula/cover`.
        voxels: the `alula/voxels` that the cover must contain; without it, the union of its members.
        scene: the `alula/scene` that the voxels must contain.
        source: the mesh, cloud or octree that the voxels must contain, instead of a scene.
        sha256: hashes of the files "voxels" and "scene"; a difference from the inputs that the manifests
            record becomes a note.
        jobs: threads, 0 for all processors; the result does not depend on it.
        progress: called with (done, total) from time to time.

    Returns:
        The certificate; `covered` when every check holds.

    Raises:
        InputError: there are more than `VERIFY_VOXELS` voxels or members of hulls, hulls with more
            half-planes and vertices than can be checked, or ellipsoids that `voxelize` would refuse; or the
            source is not of the kind that the voxels were made from.
        UsageError: a scene is given for voxels of another source, or a source for voxels of a scene.
    """
    manifest = cover.manifest
    assert isinstance(manifest, CoverManifest)
    require_at_most(VERIFY_VOXELS, len(cover["member_index"]), "alula/cover lists")
    require_at_most(VERIFY_VOXELS, 0 if voxels is None else len(voxels["index"]), "alula/voxels lists")
    checks = [_files_agree(cover, voxels, scene), _history_check(cover)]
    proof = [*_hull_checks(cover, jobs, share(progress, 0, _VOLUME_BEGINS)), _occupied_check(cover, voxels)]
    measured = 1.0 if scene is None and source is None else _SCENE_BEGINS
    if all(check.ok for check in proof) and np.abs(cover["vertex"]).max() <= _LATTICE_LIMIT:
        checks.append(_volume_check(cover, jobs, share(progress, _VOLUME_BEGINS, measured)))
    checks += proof
    if scene is not None:
        index = cover["member_index"] if voxels is None else voxels["index"]
        checks.append(_scene_check(manifest, scene, index, jobs, share(progress, measured, 1)))
    if source is not None:
        index = cover["member_index"] if voxels is None else voxels["index"]
        checks += source_checks(manifest, source, index, jobs, share(progress, measured, 1))
    return certificate_of(
        manifest,
        {"cover": cover, "voxels": voxels, "scene": scene, "source": source},
        checks,
        "members in hulls" if voxels is None else "every voxel in a hull",
        notes_of(cover, voxels, scene, sha256 or {})
        + ([] if voxels is None else _source_notes(voxels.manifest, sha256 or {})),
    )


def verify_voxels(
    voxels: Artifact,
    *,
    source: ImportedSource | None = None,
    sha256: Mapping[str, str] | None = None,
    jobs: int = 0,
    progress: Progress | None = None,
) -> Certificate:
    """Check voxels against the mesh, cloud or octree that they were imported from.

    Args:
        voxels: an `alula/voxels`.
        source: what they must contain.
        sha256: see `verify`.
        jobs: threads; the result does not depend on it.
        progress: called with (done, total) from time to time.

    Raises:
        UsageError: there is no source, or the voxels are those of a scene.
        InputError: there are more than `VERIFY_VOXELS` voxels, or see `imported_checks`.
    """
    level = voxels.manifest
    assert isinstance(level, VoxelsManifest)
    if source is None:
        raise UsageError("voxels alone are proven against --source; give it, or a cover to prove")
    require_at_most(VERIFY_VOXELS, len(voxels["index"]), "alula/voxels lists")
    offences = unclaimed(level, "voxels")
    checks = [_check("files agree", len(LEVEL), offences, len(offences), "size, level, frame and unit")]
    checks += source_checks(level, source, voxels["index"], jobs, progress)
    files = {"voxels": voxels, "source": source}
    return certificate_of(level, files, checks, "", _source_notes(level, sha256 or {}))


def source_checks(
    level: LevelManifest,
    source: ImportedSource,
    index: NDArray[np.int32],
    jobs: int,
    progress: Progress | None,
) -> list[Check]:
    """Results of `imported_checks`.

    Args:
        level: definition of an obstacle.
        source: the map that the voxels were made from.
        index: the voxels, shape (M, 3).
        jobs: threads.
        progress: called with (done, total).

    Raises:
        UsageError: the voxels are those of a scene.
        InputError: see `imported_checks`.
    """
    if level.imported is None:
        raise UsageError("the obstacles are those of a scene; give --scene instead of --source")
    return [
        _check(
            found.name,
            found.checked,
            [
                Offence(fault=fault, voxel=_voxel(v), place_m=_position_m(v + 0.5, level.voxel_size_m))
                for fault, v in zip(found.fault, found.voxel, strict=True)
            ],
            found.failed,
            found.detail,
        )
        for found in imported_checks(level, source, index, jobs=jobs, progress=progress)
    ]


def certificate_of(
    level: LevelManifest,
    files: Mapping[str, Any],
    checks: list[Check],
    proven: str,
    notes: list[str],
    below: int | None = None,
) -> Certificate:
    """Certificate with a verdict that names the level, the files and what they do not suffice for.

    Args:
        level: definition of an obstacle.
        files: by role; None where a file was not given.
        checks: all results.
        proven: what holds without a scene, in words.
        notes: see `Certificate`.
        below: number of Gaussians below the minimum opacity; None to count those of `scene`, of which else
            only the manifest is used.
    """
    voxels, scene = files.get("voxels"), files.get("scene")
    origin = "scene" if level.imported is None else "source"
    links, one = [], obstacle_of(level)
    if files.get(origin) is None:
        links.append(f"that the voxels contain the {'leaves' if one == 'leaf' else one + 's'}")
        if voxels is None:
            links.append("that the members of the hulls are all voxels")
    if scene is not None and below is None and level.min_opacity > 0:
        below = len(scene["mean"]) - len(retained(scene, level.min_opacity))
    left_out = omissions(level, below=below)
    removed = removed_from(scene.manifest) if scene is not None else []
    covered = all(check.ok for check in checks)
    if not covered:
        statement = "not covered"
    elif files.get(origin) is not None:
        inside = ", ".join((["voxels"] if voxels is not None else []) + ([proven] if proven else []))
        words = obstacles_words(level)
        statement = f"covered: {words}{',' * (', ' in words)} in {inside}{without(left_out + removed)}"
    elif voxels is not None:
        statement = f"covered: {proven} (the {origin} was not given: no {one} was checked)"
    else:
        statement = (
            f"covered: {proven} (neither voxels nor {origin} were given: no {one} was checked, nor whether "
            "the members are all voxels)"
        )
    return Certificate(
        covered=covered,
        checks=checks,
        left_out=_left_out(level, voxels, scene, left_out, has_source=files.get("source") is not None),
        notes=notes,
        statement=statement,
        level=recorded_level(level),
        given=[role for role, file in files.items() if file is not None],
        not_checked=links,
        omits=left_out,
    )


def require_solid_hulls(cover: Artifact, *, jobs: int = 0) -> None:
    """Refuse a cover with planes and vertices that do not describe the same bounded polytopes.

    Filters use the planes; planners and judges use the vertices, which for outer polytopes are computed from
    the planes. All of them rely on this check. It does not prove that the hulls contain all voxels; `verify`
    does.

    Args:
        cover: an `alula/cover`.
        jobs: threads, 0 for all processors.

    Raises:
        ArtifactError: a hull is wrong; the message names the first one and its fault.
    """
    found = _check_hulls(cover, jobs, None)
    if len(wrong := found[np.isin(found[:, 0], _NOT_BOUNDED if is_outer(cover) else _NOT_SOLID)]):
        first = _offence(cover, wrong[0].tolist(), None)
        raise ArtifactError(f"the cover is not sound: {first.text()}; make it again with merge")


def _files_agree(cover: Artifact, voxels: Artifact | None, scene: Artifact | None) -> Check:
    """Check that lattice, level, frame and unit of the cover equal those of its claims and other files."""
    mine = cover.manifest
    assert isinstance(mine, CoverManifest)
    offences = unclaimed(mine, "cover")
    names = ["frame", "unit"]
    if voxels is not None:
        assert isinstance(voxels.manifest, VoxelsManifest)
        offences += unclaimed(voxels.manifest, "voxels")
        names += LEVEL
        offences += [
            Offence(fault=f"{name} of the cover is {getattr(mine, name)}, of the voxels {theirs}")
            for name in names
            if (theirs := getattr(voxels.manifest, name)) != getattr(mine, name)
        ]
    if scene is not None:
        offences += [
            Offence(fault=f"{name} of the cover is {getattr(mine, name)}, of the scene {theirs}")
            for name in ("frame", "unit")
            if (theirs := getattr(scene.manifest, name)) != getattr(mine, name)
        ]
    return _check("files agree", len(names), offences, len(offences), "size, level, frame and unit")


def unclaimed(manifest: CoverManifest | VoxelsManifest, what: str) -> list[Offence]:
    """Differences between the level that a manifest's guarantee claims and its fields, which checks use.

    Args:
        manifest: with the claims.
        what: kind of the artifact, for the message.
    """
    claims = manifest.guarantee.claims if manifest.guarantee is not None else {}
    return [
        Offence(fault=f"{name} of the {what} is {value}, but its guarantee claims {claims[name]}")
        for name in LEVEL
        if name in claims and claims[name] != (value := getattr(manifest, name))
    ]


def _check_hulls(cover: Artifact, jobs: int, progress: Progress | None) -> NDArray[np.int64]:
    """Rows (fault, hull, row, other) of the native checker."""
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


def _hull_words(cover: Artifact) -> tuple[str, str, str, str]:
    """Names and details of the checks of hulls and of members."""
    detail = "planes support the vertices" if is_outer(cover) else "planes are the facets of vertices"
    return "hulls are exact polytopes", detail, "members lie in their hulls", "integer containment"


def _occupied_words(is_given: bool) -> tuple[str, str]:
    """Name and detail of the check of voxels."""
    detail = "members are the voxels of the file" if is_given else "no voxels file: its own members"
    return "every voxel is a member", detail


def _hull_checks(cover: Artifact, jobs: int, progress: Progress | None) -> list[Check]:
    found = _check_hulls(cover, jobs, progress)
    hulls, members = len(cover["plane_start"]) - 1, len(cover["member_index"])
    words = _hull_words(cover)
    exact = _fault_check(cover, words[0], hulls, found, _POLYTOPES, words[1])
    if hulls == 0:  # an empty cover proves nothing: neither voxelize nor merge writes an empty file
        exact = _no_hull(exact)
    return [exact, _fault_check(cover, words[2], members, found, _MEMBERS, words[3])]


def _no_hull(exact: Check) -> Check:
    return _check(exact.name, 0, [Offence(fault="there is no hull")], 1, exact.detail)


def _occupied_check(cover: Artifact, voxels: Artifact | None) -> Check:
    members = np.ascontiguousarray(cover["member_index"])
    occupied = members if voxels is None else np.ascontiguousarray(voxels["index"])
    found = _core.check_cover_occupied(members, np.ascontiguousarray(cover["member_start"]), occupied)
    name, detail = _occupied_words(voxels is not None)
    return _fault_check(cover, name, len(occupied), found, (_NOT_COVERED, _NOT_OCCUPIED), detail, occupied)


def _history_check(cover: Artifact) -> Check:
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
    detail = "merges join earlier elements"
    return _check("history is consistent", merges, offences[:LISTED], len(offences), detail)


def _volume_check(cover: Artifact, jobs: int, progress: Progress | None) -> Check:
    """Check the recorded conservativeness against the measured one."""
    voxels = np.unique(np.asarray(cover["member_index"], np.int32), axis=0)
    vertex, vertex_start, normal, offset, plane_start = (
        np.ascontiguousarray(cover[name]) for name in _GEOMETRY[:5]
    )
    excess = _core.cover_excess(voxels, vertex, vertex_start, normal, offset, plane_start, jobs, progress)
    return _volume_of(cover.manifest, excess, len(voxels))


def _volume_of(manifest: Manifest, excess: float, voxels: int) -> Check:
    """Check the recorded conservativeness of hulls around a number of voxels against the measured excess."""
    found = 1.0 + excess / voxels
    recorded: float = manifest.conservativeness  # type: ignore[attr-defined]
    offences = []
    if not abs(recorded - found) <= _VOLUME_TOLERANCE * found:
        offences.append(
            Offence(fault=f"conservativeness is {exact(found)}, but recorded as {exact(recorded)}")
        )
    return _check(
        "volume is as recorded", 1, offences, len(offences), f"conservativeness {at_most(found, 6)}"
    )


def _scene_check(
    manifest: LevelManifest, scene: Artifact, index: NDArray[np.int32], jobs: int, progress: Progress | None
) -> Check:
    missing = unproven_voxels(
        scene,
        index,
        voxel_size_m=manifest.voxel_size_m,
        sigma=require_sigma(manifest),
        inflation_m=manifest.inflation_m,
        crop=manifest.crop,
        min_overlap=manifest.min_overlap,
        min_opacity=manifest.min_opacity,
        ignore_loss=manifest.ignore_loss,
        jobs=jobs,
        progress=progress,
    )
    first = [
        Offence(
            fault="an ellipsoid may touch an unmarked voxel",
            gaussian=int(g),
            voxel=_voxel(np.asarray(v)),
            place_m=_position_m(np.asarray(v) + 0.5, manifest.voxel_size_m),
        )
        for v, g in zip(missing.voxel[:LISTED], missing.ellipsoid[:LISTED], strict=True)
    ]
    count = len(retained(scene, manifest.min_opacity))
    return _check("every ellipsoid lies in the voxels", count, first, missing.total, "separating planes")


def _source_notes(level: Manifest, sha256: Mapping[str, str]) -> list[str]:
    """Note about a source that is not the recorded one."""
    made_from = [ref for ref in level.inputs if ref.role == "source"]
    if not made_from or sha256.get("source", made_from[0].sha256) == made_from[0].sha256:
        return []
    return [f"the voxels were made from another source file, {made_from[0].name}"]


def _fault_check(
    cover: Artifact,
    name: str,
    checked: int,
    found: NDArray[np.int64],
    faults: tuple[int, ...],
    detail: str,
    occupied: NDArray[np.int32] | None = None,
) -> Check:
    mine = found[np.isin(found[:, 0], faults)]
    first = [_offence(cover, row, occupied) for row in mine[:LISTED].tolist()]
    return _check(name, checked, first, len(mine), detail)


def _check(name: str, checked: int, first: list[Offence], failed: int, detail: str) -> Check:
    return Check(name=name, ok=failed == 0, checked=checked, failed=failed, detail=detail, first=first)


def _offence(cover: Artifact, row: list[int], occupied: NDArray[np.int32] | None) -> Offence:
    """Offence for a row (fault, hull, row, other) of the native checker, with its position."""
    fault, hull, at, other = row
    plane = at if fault in _PLANE_FAULTS else other if fault in _OTHER_IS_PLANE else None
    vertex = at if fault in _VERTEX_FAULTS else other if fault in _OTHER_IS_VERTEX else None
    voxel: Any = None
    if fault == _NOT_COVERED:
        assert occupied is not None
        voxel = occupied[at]
    elif fault in (*_MEMBERS, _NOT_OCCUPIED):
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
        place_m=None if point is None else _position_m(point, size),
        plane=plane,
        vertex=vertex,
        voxel=None if voxel is None else _voxel(voxel),
    )


def _voxel(index: NDArray[np.int32]) -> tuple[int, int, int]:
    x, y, z = index.tolist()
    return x, y, z


def _position_m(lattice: NDArray[Any], size: float) -> tuple[float, float, float]:
    x, y, z = (float(c) * size for c in lattice)
    return x, y, z


def _left_out(
    manifest: LevelManifest,
    voxels: Artifact | None,
    scene: Artifact | None,
    left_out: list[str],
    *,
    has_source: bool,
) -> str:
    """Obstacles and errors that the files themselves exclude, in words."""
    parts = [outside_words(manifest), *left_out]
    if manifest.imported is not None:
        if not has_source:
            parts.append("the source itself, which was not given")
    elif scene is None:
        parts.append("the scene itself, which was not given")
        parts += recorded_lacks(manifest)
    else:
        assert isinstance(scene.manifest, SceneManifest)
        parts += excluded_errors(scene.manifest, manifest.inflation_m, ignore_loss=manifest.ignore_loss)
    if voxels is None:
        parts.append("voxels that the cover does not list, as no voxels file was given")
    return "; ".join(parts)


def notes_of(
    cover: Described, voxels: Described | None, scene: Described | None, sha256: Mapping[str, str]
) -> list[str]:
    """Notes about files that are not the inputs that the manifests record, and what changed the ellipsoids.

    Args:
        cover: an `alula/cover`.
        voxels: the voxels, if given.
        scene: the scene, if given.
        sha256: hashes of the files "voxels" and "scene".
    """
    notes, named = [], []
    for what, maker, role, given in (("cover", cover, "voxels", voxels), ("voxels", voxels, "scene", scene)):
        if maker is not None and given is not None and role in sha256:
            refs = [ref for ref in maker.manifest.inputs if ref.schema == given.manifest.schema]
            named.append((what, role, refs))
    if voxels is None and scene is not None and "scene" in sha256:
        origin: list[InputRef] = getattr(cover.manifest, "made_from", [])
        named.append(("cover", "scene", [ref for ref in origin if ref.schema == scene.manifest.schema]))
    for what, role, made_from in named:
        if made_from and sha256[role] not in {ref.sha256 for ref in made_from}:
            notes.append(f"the {what} was made from another {role} file, {made_from[0].name}")
    if scene is not None and isinstance(scene.manifest, SceneManifest):
        notes += [f"in the scene, {words}" for words in scene.manifest.source.get("applied") or []]
    return notes
