"""The stage `verify` for covers in parts: each part is proven alone, and one certificate lists all proofs."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

import msgspec
import numpy as np

from alula.schemas import merkle
from alula.schemas.artifact import Artifact
from alula.schemas.decimals import at_most
from alula.schemas.errors import ArtifactError, CheckError, InputError, UsageError
from alula.schemas.manifest import LEVEL, CoverManifest
from alula.schemas.parts import PartRef
from alula.schemas.progress import Progress
from alula.stages.compression.verify import (
    LISTED,
    Certificate,
    Check,
    Offence,
    certificate_of,
    notes_of,
    unclaimed,
)
from alula.stages.compression.verify_cubes import (
    SCENE_CHECK,
    VOXEL_CHECK,
    CubeTask,
    Index,
    Parted,
    check_of,
    outside_cells,
    proof_of,
    task_of,
)
from alula.stages.distribute import distribute

VERSION = "1.2"
OUTSIDE = "space without a part"
_TOLERANCE = 1e-6  # of the volume, as `verify` allows for each part


class PartProof(msgspec.Struct, frozen=True, kw_only=True):
    """Entry of the list of proofs.

    Attributes:
        name: of the part's file, or `OUTSIDE` for the space around all parts.
        sha256: of the file; empty for the space.
        domain: lowest and highest voxel of the part's cube; empty for the space.
        certificate: hash of the part's own certificate, a leaf of the Merkle tree.
    """

    name: str
    sha256: str
    domain: list[list[int]]
    certificate: str


class PartsCertificate(Certificate, frozen=True, kw_only=True):
    """Certificate of a cover in parts.

    Attributes:
        parts: the proofs of all parts, in their order.
        merkle_root: of their certificates' hashes.
    """

    parts: list[PartProof]
    merkle_root: str


def verify_parts(
    cover: Parted,
    *,
    voxels: Parted | None = None,
    scene: Parted | None = None,
    sha256: Mapping[str, str] | None = None,
    jobs: int = 0,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> PartsCertificate:
    """Check a cover in parts against voxels and scene, part by part, as strictly as `verify`.

    Each part has a cube of the lattice, its domain. The checks of `verify` hold for the part and the voxels
    in its cube, and its hulls lie in the cube. Cubes do not overlap, and no voxel lies outside of all. So
    the hulls contain all voxels, and their volumes add up. The ellipsoids that touch a cube are checked
    there, against the voxels in the cube; ellipsoids that may reach out of all cubes are checked in the space
    around, too.

    Args:
        cover: an `alula/cover` in parts that have domains, as `merge --block` makes it.
        voxels: the `alula/voxels` that the cover must contain; without it, the members of the hulls.
        scene: the `alula/scene` that the voxels must contain.
        sha256: see `verify`.
        jobs: processes, 0 for all processors; the result does not depend on it.
        scheduler: address of a `dask.distributed` scheduler, instead of processes of this machine.
        progress: called with (done, total) from time to time.

    Returns:
        The certificate with the list of the proofs of all parts.

    Raises:
        InputError: a part has no domain, or see `verify`.
        UsageError, LinkError: see `distribute`.
    """
    level = cover.manifest
    assert isinstance(level, CoverManifest)
    domains = domains_of(cover)
    steps = len(cover) + (scene is not None)
    tasks = (
        task_of(level, domain, cover[number], voxels or cover, voxels, scene)
        for number, domain in enumerate(domains)
    )
    proofs, parts = [], []
    for number, proof in enumerate(_run(tasks, jobs, scheduler)):
        ref = cover.refs[number]
        proofs.append(proof)
        parts.append(_entry(ref.file, ref.sha256, domains[number].tolist(), proof))
        if progress is not None:
            progress(number + 1, steps)
    counts = [_checked(proof, VOXEL_CHECK) for proof in proofs]
    if voxels is None:
        counts = [_unique(cover[number]) for number in range(len(cover))]
    checks = [_cubes(cover, domains, counts, voxels), _whole(cover, counts, scene)]
    if scene is not None:
        cells = outside_cells(level, domains, scene)
        around = (task_of(level, cell, None, voxels or cover, voxels, scene) for cell in cells)
        found = [check for proof in _run(around, jobs, scheduler) for check in proof.checks]
        none = check_of(SCENE_CHECK, 0, [], 0, "separating planes")
        proofs.append(_certificate(cover, voxels, scene, [_sum_of([none, *found])]))
        parts.append(_entry(OUTSIDE, "", [], proofs[-1]))
        if progress is not None:
            progress(steps, steps)
    names = dict.fromkeys(check.name for proof in proofs for check in proof.checks)
    checks += [_sum_of([c for proof in proofs for c in proof.checks if c.name == name]) for name in names]
    whole = _certificate(cover, voxels, scene, checks)
    fields = {name: getattr(whole, name) for name in Certificate.__struct_fields__}
    fields["notes"] = notes_of(cover, voxels, scene, sha256 or {})
    root = merkle.root([part.certificate for part in parts])
    return PartsCertificate(**fields, parts=parts, merkle_root=root)


def prove_part(
    whole: PartsCertificate, part: Artifact, sha256: str, voxels: Parted | None, scene: Parted | None
) -> Certificate:
    """Prove one part again, and compare the proof with the list of a certificate.

    Args:
        whole: the certificate of the cover in parts.
        part: of the cover.
        sha256: of its file.
        voxels: the whole voxels, if the certificate was made with them.
        scene: the whole scene, if the certificate was made with it.

    Returns:
        The certificate of the part.

    Raises:
        UsageError: other files were given than for the certificate.
        ArtifactError: the certificate contradicts itself.
        CheckError: the part is not in its list, or its proof is another.
    """
    given = ["cover", *(["voxels"] if voxels is not None else []), *(["scene"] if scene is not None else [])]
    if given != whole.given:
        raise UsageError(f"the certificate was made with {', '.join(whole.given)}; give the same files")
    if scene is not None and voxels is None:
        raise UsageError("the proof of one part against a scene needs voxels, whose certificate lists them")
    if merkle.root([entry.certificate for entry in whole.parts]) != whole.merkle_root:
        raise ArtifactError("the root of the certificate is not that of its list")
    entry = next((entry for entry in whole.parts if entry.sha256 == sha256), None)
    if entry is None:
        raise CheckError("the certificate does not list this part: no entry has its SHA-256")
    level, domain = part.manifest, np.array(entry.domain, np.int64)
    assert isinstance(level, CoverManifest)
    own = _Alone(part)
    proof = proof_of(task_of(level, domain, part, voxels or own, voxels, scene))
    if leaf_of(proof) != entry.certificate:
        why = proof.complaint().removeprefix("not proven: ") or "its proof is not the listed one"
        raise CheckError(f"not proven: {entry.name}: {why}")
    return proof


class _Alone:
    """A part without the others, as a source of voxels."""

    def __init__(self, part: Artifact) -> None:
        self.manifest, self._part = part.manifest, part
        self.refs: tuple[PartRef, ...] = ()

    def __len__(self) -> int:
        return 1

    def __getitem__(self, number: int) -> Artifact:
        return (self._part,)[number]

    def touching(
        self, lower: Sequence[float], upper: Sequence[float], *, sigma: float = 0.0, inflation: float = 0.0
    ) -> list[int]:
        """Number of the part."""
        return [0]


def leaf_of(proof: Certificate) -> str:
    """Leaf of a part's certificate.

    Args:
        proof: as `proof_of` returns it.
    """
    return merkle.leaf(msgspec.json.encode(proof, order="sorted"))


def domains_of(cover: Parted) -> list[Index]:
    """Cubes of all parts, each of shape (2, 3): lowest and highest voxel.

    Args:
        cover: in parts.

    Raises:
        InputError: a part has none.
    """
    for ref in cover.refs:
        if ref.domain is None:
            raise InputError(f"{ref.file}: has no domain, so it cannot be proven alone; join the parts")
    return [np.array(ref.domain, np.int64) for ref in cover.refs]


def _run(tasks: Iterable[CubeTask], jobs: int, scheduler: str | None) -> Iterator[Certificate]:
    if scheduler is None and jobs == 1:
        return map(proof_of, tasks)
    return distribute(proof_of, tasks, jobs=jobs, processes=True, scheduler=scheduler)


def _entry(name: str, sha256: str, domain: list[list[int]], proof: Certificate) -> PartProof:
    return PartProof(name=name, sha256=sha256, domain=domain, certificate=leaf_of(proof))


def _checked(proof: Certificate, name: str) -> int:
    """Number of items of a check."""
    return next(check.checked for check in proof.checks if check.name == name)


def _unique(part: Artifact) -> int:
    """Number of different members of all hulls."""
    index = part["member_index"]
    index = index[np.lexsort(index.T)]
    return int((index[1:] != index[:-1]).any(axis=1).sum()) + min(len(index), 1)


def _certificate(
    cover: Parted, voxels: Parted | None, scene: Parted | None, checks: list[Check]
) -> Certificate:
    """Certificate with the words for the whole files."""
    level = cover.manifest
    assert isinstance(level, CoverManifest)
    files: dict[str, Artifact | None] = {
        role: None if parts is None else Artifact(parts.manifest, {})
        for role, parts in (("cover", cover), ("voxels", voxels), ("scene", scene))
    }
    if scene is not None and level.min_opacity > 0:  # the words count the Gaussians that are left out
        opacity = np.concatenate([scene[number]["opacity"] for number in range(len(scene))])
        files["scene"] = Artifact(scene.manifest, {"mean": opacity, "opacity": opacity})
    proven = "members in hulls" if voxels is None else "every voxel in a hull"
    return certificate_of(level, files, checks, proven, [])


def _cubes(cover: Parted, domains: Sequence[Index], counts: Sequence[int], voxels: Parted | None) -> Check:
    """Check that no two cubes overlap, and that no voxel lies outside of all."""
    offences = []
    order = sorted(range(len(domains)), key=lambda number: domains[number][0].tolist())
    for at, one in enumerate(order):
        for other in order[at + 1 :]:
            if domains[other][0][0] > domains[one][1][0]:
                break
            if (domains[other][0] <= domains[one][1]).all() and (domains[one][0] <= domains[other][1]).all():
                names = f"{cover.refs[one].file} and {cover.refs[other].file}"
                offences.append(Offence(fault=f"the cubes of {names} overlap"))
    total = sum(counts) if voxels is None else sum(ref.count for ref in voxels.refs)
    if sum(counts) != total:
        offences.append(Offence(fault=f"the cubes have {sum(counts)} of {total} voxels"))
    return check_of("cubes divide the voxels", len(domains), offences[:LISTED], len(offences), "no overlap")


def _whole(cover: Parted, counts: Sequence[int], scene: Parted | None) -> Check:
    """Check that level and volume of the whole are those of its parts, and the frame that of the scene."""
    whole = cover.manifest
    assert isinstance(whole, CoverManifest)
    offences, excess = unclaimed(whole, "cover"), 0.0
    for number, ref in enumerate(cover.refs):
        mine = cover[number].manifest
        assert isinstance(mine, CoverManifest)
        offences += [
            Offence(fault=f"{name} of {ref.file} is {theirs}, of the whole {getattr(whole, name)}")
            for name in (*LEVEL, "frame", "unit", "polytopes")
            if (theirs := getattr(mine, name)) != getattr(whole, name)
        ]
        excess += (mine.conservativeness - 1) * counts[number]
    if scene is not None:
        offences += [
            Offence(fault=f"{name} of the cover is {getattr(whole, name)}, of the scene {theirs}")
            for name in ("frame", "unit")
            if (theirs := getattr(scene.manifest, name)) != getattr(whole, name)
        ]
    growth = 1 + excess / max(sum(counts), 1)
    if not abs(growth - whole.conservativeness) <= _TOLERANCE * growth:
        text = f"conservativeness of the parts is {growth}, of the whole {whole.conservativeness}"
        offences.append(Offence(fault=text))
    detail = f"conservativeness {at_most(growth, 6)}"
    return check_of("the whole is its parts", len(cover), offences[:LISTED], len(offences), detail)


def _sum_of(checks: Sequence[Check]) -> Check:
    first = [offence for check in checks for offence in check.first][:LISTED]
    checked, failed = (sum(getattr(check, name) for check in checks) for name in ("checked", "failed"))
    detail = checks[0].detail if not checks[0].detail.startswith("conservativeness") else "of each part"
    return check_of(checks[0].name, checked, first, failed, detail)
