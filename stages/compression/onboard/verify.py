"""Verification of an onboard map: proves from its bytes that it contains every voxel."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction

import msgspec
import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.certificate import Certificate, Check, Offence
from alula.schemas.artifacts.manifest import LEVEL, CoverManifest, LevelManifest, VoxelsManifest
from alula.schemas.artifacts.parts import Parts
from alula.schemas.decimals import at_most, exact
from alula.schemas.errors import UsageError
from alula.schemas.progress import Progress
from alula.stages.compression.cover_checks import scene_check, unclaimed
from alula.stages.compression.limits import VERIFY_VOXELS, require_at_most
from alula.stages.compression.onboard.image import MARGIN_OF_EXTENT, MapImage
from alula.stages.compression.verify import certificate_of
from alula.stages.progress import share
from alula.stages.proof import LISTED, check, position_m


def verify_map(
    image: MapImage,
    *,
    cover: Artifact | None = None,
    voxels: Artifact | None = None,
    scene: Artifact | None = None,
    sha256: Mapping[str, str] | None = None,
    jobs: int = 0,
    progress: Progress | None = None,
) -> Certificate:
    """Check a decoded map against the cover, the voxels and the scene behind it.

    The checks use integers, without tolerance and without the code that quantised. Each voxel v must lie in
    one hull: normal . v + sum of positive normal components <= offset for all its planes and faces. For each
    hull of the cover, a hull of the map with the same box must contain all its vertices. A map lists no
    members, so every hull is tested against every voxel in its box. With a scene, each ellipsoid must lie in
    the voxels, as in `verify` of a cover.

    Args:
        image: a decoded map; `decode_map` has checked lengths and CRC-32.
        cover: the `alula/cover` that the map was made from.
        voxels: the `alula/voxels` that the map must contain; without it, the members of the cover.
        sha256: hash of the file "cover"; a difference from the hash in the map becomes a note, not an error,
            because the proof uses the content alone.

    Returns:
        The certificate; `covered` when every check holds.

    Raises:
        UsageError: neither cover nor voxels are given.
    """
    level, occupied = occupied_by(cover, voxels)
    checks = [files_agree(image, cover, voxels, scene), margin_holds(image)]
    held = 1.0 if scene is None else 0.5
    checks.append(_voxels_held(image, occupied, jobs, share(progress, 0, held)))
    if cover is not None:
        checks.append(_hulls_held(image, cover))
    if scene is not None:
        checks.append(scene_check(level, scene, occupied, jobs, share(progress, held, 1)))
    found = certificate_of(
        level,
        {"cover": cover, "voxels": voxels, "scene": scene},
        checks,
        f"every {'member of the cover' if voxels is None else 'voxel'} in a hull of the map",
        notes_of(image, (sha256 or {}).get("cover")),
    )
    return msgspec.structs.replace(found, given=["map", *found.given])


def _arrays(
    image: MapImage,
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32], NDArray[np.int64], NDArray[np.int64]]:
    return image.lower, image.upper, image.normal, image.offset, image.plane_start


def files_agree(
    image: MapImage, cover: Artifact | None, voxels: Artifact | Parts | None, scene: Artifact | Parts | None
) -> Check:
    """Check that lattice, level, frame and unit of all files are equal and equal to their claims."""
    files = {"cover": cover, "voxels": voxels, "scene": scene}
    given = {name: file.manifest for name, file in files.items() if file is not None}
    offences = [
        Offence(fault=f"voxel_size_m of the map is {image.voxel_size_m}, of the {name} {theirs}")
        for name, manifest in given.items()
        if (theirs := getattr(manifest, "voxel_size_m", image.voxel_size_m)) != image.voxel_size_m
    ]
    for name, manifest in given.items():
        if isinstance(manifest, CoverManifest | VoxelsManifest):
            offences += unclaimed(manifest, name)
    (first, mine), *others = given.items()
    offences += [
        Offence(fault=f"{key} of the {first} is {getattr(mine, key)}, of the {name} {getattr(theirs, key)}")
        for name, theirs in others
        for key in (*LEVEL, "frame", "unit")
        if hasattr(theirs, key) and getattr(theirs, key) != getattr(mine, key)
    ]
    return check("files agree", len(given), offences, "size, level, frame and unit")


def margin_holds(image: MapImage) -> Check:
    """Check in exact arithmetic that the margin is at least 2^-18 of the largest coordinate."""
    largest = max(int(np.abs(edge.astype(np.int64)).max(initial=0)) for edge in (image.lower, image.upper))
    needed = Fraction(image.voxel_size_m) * largest * Fraction(MARGIN_OF_EXTENT)
    offences = []
    if Fraction(image.margin_m) < needed:
        offences = [
            Offence(
                fault=f"the margin is {exact(image.margin_m)} m, but {at_most(float(needed), 9)} m are needed"
            )
        ]
    detail = f"{exact(image.margin_m)} m, subtracted on board"
    return check("margin covers single precision", len(image), offences, detail)


def _voxels_held(image: MapImage, occupied: NDArray[np.int32], jobs: int, progress: Progress | None) -> Check:
    outside = _core.check_map_voxels(*_arrays(image), occupied, jobs, progress)
    first = [
        Offence(fault="voxel is in no hull", place_m=position_m(occupied[row] + 0.5, image.voxel_size_m))
        for row in outside[:LISTED].tolist()
    ]
    failed, name = len(outside), "every voxel lies in a hull"
    if len(occupied) == 0:  # an empty set proves nothing: neither voxelize nor merge writes an empty file
        first, failed = [Offence(fault="there is no voxel")], 1
    return check(name, len(occupied), first, "integer containment, after quantisation", failed=failed)


def _hulls_held(image: MapImage, cover: Artifact) -> Check:
    vertex, start = np.ascontiguousarray(cover["vertex"]), np.ascontiguousarray(cover["vertex_start"])
    outside = _core.check_map_polytopes(*_arrays(image), vertex, start)
    first = [
        Offence(
            fault="hull of the cover is in no hull of the map with its box",
            hull=hull,
            place_m=position_m(vertex[start[hull]], image.voxel_size_m)
            if start[hull] < len(vertex)
            else None,
        )
        for hull in outside[:LISTED].tolist()
    ]
    name, detail = "hulls contain the cover's", "all vertices, integers"
    return check(name, len(start) - 1, first, detail, failed=len(outside))


def occupied_by(cover: Artifact | None, voxels: Artifact | None) -> tuple[LevelManifest, NDArray[np.int32]]:
    """Level and voxels (M, 3) that an onboard map must contain: those of a file, or the members of a cover.

    Raises:
        UsageError: neither is given.
        InputError: there are more voxels than a proof takes.
    """
    source = voxels if voxels is not None else cover
    if source is None:
        raise UsageError("an onboard map is checked against --voxels or --cover; give one")
    level = source.manifest
    assert isinstance(level, LevelManifest)
    occupied = np.ascontiguousarray(source["index" if voxels is not None else "member_index"], np.int32)
    require_at_most(VERIFY_VOXELS, len(occupied), f"{level.schema} lists")
    return level, occupied


def notes_of(image: MapImage, cover_sha256: str | None) -> list[str]:
    """Note about a cover that is not the file that the map records.

    Args:
        cover_sha256: hash of the cover's file; None where it was not given.
    """
    if cover_sha256 is None or not any(image.cover_hash):
        return []
    same = bytes.fromhex(cover_sha256)[: len(image.cover_hash)] == image.cover_hash
    return [] if same else ["the map was made from another cover file"]
