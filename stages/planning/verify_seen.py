"""Proof of the geometric claims of an `alula/seen`, without the code of `observe`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.certificate import Certificate, Check, Offence
from alula.schemas.artifacts.manifest import LEVEL, SceneManifest, SeenManifest
from alula.schemas.decimals import exact
from alula.schemas.progress import Progress
from alula.stages.compression.ellipsoids import (
    UnprovenVoxels,
    excluded_errors,
    removed_from,
    retained,
    unproven_voxels,
)
from alula.stages.compression.level import (
    beyond_words,
    level_words,
    omissions,
    recorded_level,
    require_sigma,
    without,
)
from alula.stages.compression.limits import VERIFY_VOXELS, require_at_most
from alula.stages.proof import LISTED, at_voxel, check

Mask = NDArray[np.bool_]


def verify_seen(
    seen: Artifact,
    *,
    voxels: Artifact | None = None,
    scene: Artifact | None = None,
    sha256: Mapping[str, str] | None = None,
    jobs: int = 0,
    progress: Progress | None = None,
) -> Certificate:
    """Check that seen voxels touch no obstacle, and that the ball reaches each of them.

    With voxels, none of them is a voxel of the file, as sets. With a scene, each voxel of the file is proven
    by a separating plane per ellipsoid to be touched by fewer than `min_overlap` of them (see
    `unproven_voxels`). The reach is followed step by step from the voxels `started_from`: a ball is where no
    voxel outside of the file is nearer than its radius, tested offset by offset, and every voxel of the file
    must be touched by a ball on the way. What the cameras saw is not checked again.

    Args:
        voxels: the `alula/voxels` of the obstacles.
        scene: the `alula/scene` with the obstacles.
        sha256: hashes of the files "voxels" and "scene"; a difference from the recorded inputs becomes a
            note.

    Returns:
        The certificate; `covered` when every check holds.

    Raises:
        InputError: the box has more than `VERIFY_VOXELS` voxels.
    """
    manifest = seen.manifest
    assert isinstance(manifest, SeenManifest)
    require_at_most(VERIFY_VOXELS, math.prod(manifest.size), "the box of alula/seen has")
    files = {"voxels": voxels, "scene": scene}
    marked, outside = _marked(seen)
    checks = [_files_agree(manifest, files), outside, _reached(manifest, marked)]
    if voxels is not None:
        checks.append(_apart(manifest, marked, voxels))
    if scene is not None:
        checks.append(_untouched(manifest, marked, scene, jobs, progress))
    covered = all(one.ok for one in checks)
    given = [role for role, file in files.items() if file is not None]
    below = None
    if scene is not None:
        below = len(scene["mean"]) - len(retained(scene, manifest.min_opacity))
    omitted = omissions(manifest, below=below, is_cropped=False)  # nothing beyond the crop is marked as seen
    removed = [] if scene is None else removed_from(_manifest_of(scene))
    what = (
        f"touched by no {'retained ' * bool(omitted)}obstacle at {level_words(require_sigma(manifest))} of "
        f"the {' and the '.join(given)}"
    )
    statement = "free: every seen voxel is " + (f"{what}, and " if given else "")
    statement += f"reached by a ball of {exact(manifest.radius_m)} m"
    if not given:
        statement += " (neither voxels nor scene were given: no obstacle was checked)"
    if covered and scene is not None and omitted:
        touched = _touched_by_all(manifest, marked, scene, jobs)
        statement += (
            f"; obstacles that are not retained may touch {touched} of its {int(marked.sum())} voxels"
        )
    statement += without(omitted + removed) if given else ""
    beyond = [beyond_words(require_sigma(manifest)), *omitted]
    if scene is not None:
        beyond += excluded_errors(_manifest_of(scene), manifest.inflation_m, ignore_loss=manifest.ignore_loss)
    return Certificate(
        covered=covered,
        checks=checks,
        left_out="; ".join(
            ["what the cameras saw: the file says why its voxels were taken for free", *beyond]
        ),
        notes=_notes(manifest, files, sha256 or {}),
        statement=statement if covered else "not free",
        level=recorded_level(manifest),
        given=["seen", *given],
        not_checked=["what the cameras saw"] + ["that no obstacle touches the voxels"] * (not given),
        omits=omitted,
    )


def _manifest_of(scene: Artifact) -> SceneManifest:
    assert isinstance(scene.manifest, SceneManifest)
    return scene.manifest


def _offences(manifest: SeenManifest, fault: str, index: NDArray[Any]) -> list[Offence]:
    return [at_voxel(fault, voxel, manifest.voxel_size_m) for voxel in np.asarray(index)[:LISTED]]


def _files_agree(manifest: SeenManifest, files: Mapping[str, Artifact | None]) -> Check:
    offences = []
    for role, names in (("voxels", (*LEVEL, "frame", "unit")), ("scene", ("frame", "unit"))):
        other: Any = files[role]
        for name in names if other is not None else ():
            if (theirs := getattr(other.manifest, name)) != (mine := getattr(manifest, name)):
                offences.append(Offence(fault=f"{name} of the seen voxels is {mine}, of the {role} {theirs}"))
    return check("files agree", len(LEVEL) + 2, offences, "size, level, frame and unit")


def _notes(
    manifest: SeenManifest, files: Mapping[str, Artifact | None], sha256: Mapping[str, str]
) -> list[str]:
    recorded = {ref.role: ref for ref in manifest.inputs}
    return [
        f"the seen voxels were made from another {role} file, {recorded[role].name}"
        for role, file in files.items()
        if file is not None
        and role in recorded
        and recorded[role].sha256 != sha256.get(role, recorded[role].sha256)
    ]


def _marked(seen: Artifact) -> tuple[Mask, Check]:
    """The voxels of the file in its box, and the check that none lies outside of it."""
    manifest: Any = seen.manifest
    index = np.asarray(seen["index"], np.int64) - np.array(manifest.lower)
    inside = ((index >= 0) & (index < np.array(manifest.size))).all(axis=1)
    marked = np.zeros(tuple(manifest.size), np.bool_)
    marked[tuple(index[inside].T)] = True
    wrong = np.asarray(seen["index"])[~inside]
    offences = _offences(manifest, "a voxel lies outside of the box", wrong)
    return marked, check("voxels lie in the box", len(index), offences, "indices", failed=len(wrong))


def _apart(manifest: SeenManifest, marked: Mask, voxels: Artifact) -> Check:
    index = np.asarray(voxels["index"], np.int64) - np.array(manifest.lower)
    inside = index[((index >= 0) & (index < np.array(marked.shape))).all(axis=1)]
    both = inside[marked[tuple(inside.T)]] + np.array(manifest.lower)
    offences = _offences(manifest, "an obstacle's voxel is marked as seen", both)
    name, count = "no voxel is an obstacle's", int(marked.sum())
    return check(name, count, offences, "sets of indices", failed=len(both))


def _untouched(
    manifest: SeenManifest, marked: Mask, scene: Artifact, jobs: int, progress: Progress | None
) -> Check:
    """Prove that only voxels that are not seen, or outside of the box, touch a retained ellipsoid."""
    found = _unproven(
        manifest,
        marked,
        scene,
        jobs,
        progress,
        min_overlap=manifest.min_overlap,
        min_opacity=manifest.min_opacity,
        ignore_loss=manifest.ignore_loss,
    )
    offences = _offences(manifest, "a seen voxel may touch an ellipsoid", found.voxel)
    name, count = "no ellipsoid touches a voxel", int(marked.sum())
    return check(name, count, offences, "separating planes", failed=found.total)


def _touched_by_all(manifest: SeenManifest, marked: Mask, scene: Artifact, jobs: int) -> int:
    """Number of seen voxels that any ellipsoid of the scene may touch, also one that is not retained."""
    return _unproven(manifest, marked, scene, jobs, None).total


def _unproven(
    manifest: SeenManifest,
    marked: Mask,
    scene: Artifact,
    jobs: int,
    progress: Progress | None,
    **counted: Any,
) -> UnprovenVoxels:
    """Seen voxels that ellipsoids of the scene may touch; `counted` as of `unproven_voxels`."""
    g = manifest.voxel_size_m
    lower, size = np.array(manifest.lower), np.array(marked.shape)
    rest = np.argwhere(np.pad(~marked, 2, constant_values=True)) + lower - 2
    return unproven_voxels(
        scene,
        rest.astype(np.int32),
        voxel_size_m=g,
        sigma=require_sigma(manifest),
        inflation_m=manifest.inflation_m,
        crop=[*(lower * g).tolist(), *((lower + size) * g).tolist()],
        jobs=jobs,
        progress=progress,
        **counted,
    )


def _columns(radius_voxels: float) -> list[tuple[int, int, int]]:
    """Offsets a, b and the largest |c| of the cubes that an open ball around a cube's centre touches."""
    reach = math.ceil(radius_voxels) + 1
    near = [max(n - 0.5, 0.0) ** 2 for n in range(reach + 1)]
    most = radius_voxels**2 * (1 - 1e-12)
    span = range(-reach, reach + 1)
    runs = [
        (a, b, [c for c in range(reach + 1) if near[abs(a)] + near[abs(b)] + near[c] < most])
        for a in span
        for b in span
    ]
    return [(a, b, run[-1]) for a, b, run in runs if run]


def _reached(manifest: SeenManifest, marked: Mask) -> Check:
    """Follow the ball from its starts and collect what it touches."""
    from scipy import ndimage

    columns = _columns(manifest.radius_m / manifest.voxel_size_m)
    pad = max(length for _, _, length in columns) + 1
    padded = np.pad(marked, pad)
    spread = {"axis": 2, "mode": "constant", "cval": 0}
    has_room = np.ones_like(padded)
    for length in {length for _, _, length in columns}:
        free = ndimage.minimum_filter1d(padded.view(np.uint8), 2 * length + 1, **spread).view(np.bool_)
        for a, b, same in columns:
            if same == length:
                has_room &= np.roll(free, (a, b), axis=(0, 1))
    reached = np.zeros_like(padded)
    rows = has_room.ravel()
    strides = [s // has_room.itemsize for s in has_room.strides]
    flat, offences, front = reached.reshape(-1), [], np.empty(0, np.int64)
    for start in manifest.started_from:
        at = sum((i - a + pad) * s for i, a, s in zip(start, manifest.lower, strides, strict=True))
        if not rows[at]:
            offences += _offences(manifest, "the ball does not fit where it starts", np.array([start]))
        else:
            flat[at] = True
            front = np.append(front, at)
    steps = [sign * s for s in strides for sign in (1, -1)]
    while len(front):
        front = np.unique(np.concatenate([front + step for step in steps]))
        front = front[rows[front] & ~flat[front]]
        flat[front] = True
    covered = np.zeros_like(padded)
    for length in {length for _, _, length in columns}:
        balls = ndimage.maximum_filter1d(reached.view(np.uint8), 2 * length + 1, **spread).view(np.bool_)
        for a, b, same in columns:
            if same == length:
                covered |= np.roll(balls, (a, b), axis=(0, 1))
    missing = np.argwhere(padded != covered) - pad + np.array(manifest.lower)
    offences += _offences(manifest, "the ball does not reach a voxel", missing)
    detail = f"a ball of {exact(manifest.radius_m)} m, step by step"
    name, count = "the ball reaches every voxel", int(marked.sum())
    return check(name, count, offences, detail, failed=max(len(missing), len(offences)))
