"""The stage `verify`: prove that a cover contains the ellipsoids of a scene, without `merge` and `voxelize`.

The checks share no code with those stages.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.certificate import Certificate, Check
from alula.schemas.artifacts.manifest import (
    LEVEL,
    CoverManifest,
    InputRef,
    LevelManifest,
    Manifest,
    SceneManifest,
    VoxelsManifest,
)
from alula.schemas.artifacts.parts import Parts
from alula.schemas.errors import UsageError
from alula.schemas.progress import Progress
from alula.stages.compression.cover_checks import (
    LATTICE_LIMIT,
    MEMBERS,
    POLYTOPES,
    fault_check,
    files_agree,
    history_check,
    hull_faults,
    hull_words,
    no_hull,
    occupied_check,
    scene_check,
    unclaimed,
    volume_check,
)
from alula.stages.compression.ellipsoids import excluded_errors, recorded_lacks, removed_from, retained
from alula.stages.compression.imported import ImportedSource
from alula.stages.compression.level import (
    obstacle_of,
    obstacles_words,
    omissions,
    outside_words,
    recorded_level,
    without,
)
from alula.stages.compression.limits import VERIFY_VOXELS, require_at_most
from alula.stages.compression.verify_imported import imported_checks
from alula.stages.progress import share
from alula.stages.proof import check

_VOLUME_BEGINS, _SCENE_BEGINS = 0.1, 0.5  # approximate fractions of the time at which these checks begin


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
        voxels: the `alula/voxels` that the cover must contain; without it, the union of its members.
        source: the mesh, cloud or octree that the voxels must contain, instead of a scene.
        sha256: hashes of the files "voxels" and "scene"; a difference from the inputs that the manifests
            record becomes a note.

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
    index = None if voxels is None else voxels["index"]
    require_at_most(VERIFY_VOXELS, 0 if index is None else len(index), "alula/voxels lists")
    checks = [files_agree(cover, voxels, scene), history_check(cover)]
    proof = [
        *_hull_checks(cover, jobs, share(progress, 0, _VOLUME_BEGINS)),
        occupied_check(cover, index),
    ]
    measured = 1.0 if scene is None and source is None else _SCENE_BEGINS
    if all(one.ok for one in proof) and np.abs(cover["vertex"]).max() <= LATTICE_LIMIT:
        checks.append(volume_check(cover, jobs, share(progress, _VOLUME_BEGINS, measured)))
    checks += proof
    occupied = cover["member_index"] if index is None else index
    if scene is not None:
        checks.append(scene_check(manifest, scene, occupied, jobs, share(progress, measured, 1)))
    if source is not None:
        checks += imported_checks(
            manifest, source, occupied, jobs=jobs, progress=share(progress, measured, 1)
        )
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
    checks = [check("files agree", len(LEVEL), offences, "size, level, frame and unit")]
    checks += imported_checks(level, source, voxels["index"], jobs=jobs, progress=progress)
    files = {"voxels": voxels, "source": source}
    return certificate_of(level, files, checks, "", _source_notes(level, sha256 or {}))


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
        files: by role; None where a file was not given.
        proven: what holds without a scene, in words.
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
    covered = all(one.ok for one in checks)
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


def _hull_checks(cover: Artifact, jobs: int, progress: Progress | None) -> list[Check]:
    found = hull_faults(cover, jobs, progress)
    hulls, members = len(cover["plane_start"]) - 1, len(cover["member_index"])
    words = hull_words(cover)
    exact = fault_check(cover, words[0], hulls, found, POLYTOPES, words[1])
    if hulls == 0:  # an empty cover proves nothing: neither voxelize nor merge writes an empty file
        exact = no_hull(exact)
    return [exact, fault_check(cover, words[2], members, found, MEMBERS, words[3])]


def _source_notes(level: Manifest, sha256: Mapping[str, str]) -> list[str]:
    """Note about a source that is not the recorded one."""
    made_from = [ref for ref in level.inputs if ref.role == "source"]
    if not made_from or sha256.get("source", made_from[0].sha256) == made_from[0].sha256:
        return []
    return [f"the voxels were made from another source file, {made_from[0].name}"]


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
    cover: Artifact | Parts,
    voxels: Artifact | Parts | None,
    scene: Artifact | Parts | None,
    sha256: Mapping[str, str],
) -> list[str]:
    """Notes about files that are not the recorded inputs, and about what changed the ellipsoids."""
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
