"""The stage `verify` for covers in parts: each part is proven alone, and one certificate lists all proofs."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence

import msgspec
import numpy as np

from alula.schemas.artifacts import merkle
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.certificate import Certificate, Check, Offence, PartProof, PartsCertificate
from alula.schemas.artifacts.manifest import LEVEL, CoverManifest
from alula.schemas.artifacts.parts import Parts
from alula.schemas.decimals import at_most
from alula.schemas.errors import ArtifactError, CheckError, InputError, UsageError
from alula.schemas.progress import Progress
from alula.stages.compression.cell_hulls import CUBE_CHECK
from alula.stages.compression.cover_checks import (
    SCENE_CHECK,
    VOLUME_TOLERANCE,
    differences,
    files_agree,
    history_check,
    hull_words,
    no_hull,
    occupied_words,
    unclaimed,
    volume_of,
)
from alula.stages.compression.verify import certificate_of, notes_of
from alula.stages.compression.verify_cubes import (
    CellProof,
    CellTask,
    Index,
    Sources,
    cells_of,
    outside_cells,
    proof_of,
)
from alula.stages.distribute import distribute
from alula.stages.proof import check, sum_of

OUTSIDE = "space without a part"
_NO_ELLIPSOID = check(SCENE_CHECK, 0, [], "separating planes")


def verify_parts(
    cover: Parts,
    *,
    voxels: Parts | None = None,
    scene: Parts | None = None,
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
        jobs: processes, 0 for all processors; the result does not depend on it.
        scheduler: address of a `dask.distributed` scheduler, instead of processes of this machine.

    Returns:
        The certificate with the list of the proofs of all parts.

    Raises:
        InputError: a part has no domain, or see `verify`.
        UsageError, LinkError: see `distribute`.
    """
    level = cover.manifest
    assert isinstance(level, CoverManifest)
    domains = domains_of(cover)
    sources = Sources(level, voxels or cover, voxels, scene)
    cells = _Cells(cover, domains, sources)
    proofs, parts, counts = [], [], []
    for number, found in cells.proven(jobs, scheduler, progress):
        if number < len(cover):
            proof, count = part_proof(sources, cover[number], found)
            counts.append(count)
            ref = cover.refs[number]
            parts.append(_entry(ref.file, ref.sha256, domains[number].tolist(), proof))
        else:
            around = [_NO_ELLIPSOID, *(cell.scene for cell in found if cell.scene is not None)]
            proof = _certificate(cover, voxels, scene, [_sum(around)])
            parts.append(_entry(OUTSIDE, "", [], proof))
        proofs.append(proof)
    checks = [_cubes(cover, domains, counts, voxels), _whole(cover, counts, scene)]
    names = dict.fromkeys(one.name for proof in proofs for one in proof.checks)
    checks += [_sum([c for proof in proofs for c in proof.checks if c.name == name]) for name in names]
    whole = _certificate(cover, voxels, scene, checks)
    fields = {name: getattr(whole, name) for name in Certificate.__struct_fields__}
    fields["notes"] = notes_of(cover, voxels, scene, sha256 or {})
    root = merkle.root([part.certificate for part in parts])
    return PartsCertificate(**fields, parts=parts, merkle_root=root)


def prove_part(
    whole: PartsCertificate, part: Artifact, sha256: str, voxels: Parts | None, scene: Parts | None
) -> Certificate:
    """Prove one part again, and compare the proof with the list of a certificate.

    Args:
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
    sources = Sources(level, voxels, voxels, scene)
    proof, _ = part_proof(sources, part, [proof_of(task) for task in cells_of(sources, domain, part)])
    if leaf_of(proof) != entry.certificate:
        why = proof.complaint().removeprefix("not proven: ") or "its proof is not the listed one"
        raise CheckError(f"not proven: {entry.name}: {why}")
    return proof


class _Cells:
    """Cells of all parts and of the space around them, and their proofs."""

    def __init__(self, cover: Parts, domains: Sequence[Index], sources: Sources) -> None:
        self._cover, self._domains, self._sources = cover, domains, sources
        self._steps = len(cover) + (sources.scene is not None)
        self._of: deque[int] = deque()  # number of the part, of each task under way

    def _tasks(self) -> Iterator[CellTask]:
        sources = self._sources
        for number, domain in enumerate(self._domains):
            for task in cells_of(sources, domain, self._cover[number]):
                self._of.append(number)
                yield task
        if sources.scene is not None:
            for cell in outside_cells(sources.level, self._domains, sources.scene):
                for task in cells_of(sources, cell, None):
                    self._of.append(len(self._domains))
                    yield task

    def proven(
        self, jobs: int, scheduler: str | None, progress: Progress | None
    ) -> Iterator[tuple[int, list[CellProof]]]:
        """Number of each part and the proofs of its cells; the space around has the number after the last."""
        number = 0
        found: list[CellProof] = []
        for proof in _run(self._tasks(), jobs, scheduler):
            while number < self._of[0]:
                yield number, found
                number, found = number + 1, []
                if progress is not None:
                    progress(number, self._steps)
            self._of.popleft()
            found.append(proof)
        while number < self._steps:
            yield number, found
            number, found = number + 1, []
        if progress is not None:
            progress(self._steps, self._steps)


def part_proof(sources: Sources, part: Artifact, cells: Sequence[CellProof]) -> tuple[Certificate, int]:
    """Join the proofs of all cells of a part to its certificate, as `verify` would make it for the part.

    Returns:
        The certificate, and the number of voxels in the cube, or of different members without voxels.
    """
    voxels, scene = sources.voxels, sources.scene
    hulls = [cell.hulls for cell in cells if cell.hulls is not None]
    words, occupied = hull_words(part), occupied_words(is_given=voxels is not None)
    names = [(CUBE_CHECK, "vertices"), words[:2], words[2:], occupied]
    joined = [
        _sum([check(name, 0, [], detail), *(hull.checks[at] for hull in hulls)])
        for at, (name, detail) in enumerate(names)
    ]
    members = sum(hull.members for hull in hulls)
    checks = [joined[0], files_agree(part, voxels, scene), history_check(part)]
    if len(part["vertex_start"]) < 2:
        joined[1] = no_hull(joined[1])
    elif all(one.ok for one in joined) and all(hull.excess is not None for hull in hulls):
        excess = math.fsum(hull.excess for hull in hulls if hull.excess is not None)
        checks.append(volume_of(part.manifest, excess, members))
    checks += joined[1:]
    if scene is not None:
        of_cells = [cell.scene for cell in cells if cell.scene is not None]
        checks.append(_sum([_NO_ELLIPSOID, *of_cells]))
    proven = "members in hulls" if voxels is None else "every voxel in a hull"
    files = {"cover": part, "voxels": voxels, "scene": scene}
    below = None if scene is None else sum(cell.below for cell in cells)
    proof = certificate_of(sources.level, files, checks, proven, [], below)
    return proof, members if voxels is None else joined[3].checked


def leaf_of(proof: Certificate) -> str:
    """Leaf of a part's certificate."""
    return merkle.leaf(msgspec.json.encode(proof, order="sorted"))


def domains_of(cover: Parts) -> list[Index]:
    """Cubes of all parts, each of shape (2, 3): lowest and highest voxel.

    Raises:
        InputError: a part has none.
    """
    for ref in cover.refs:
        if ref.domain is None:
            raise InputError(f"{ref.file}: has no domain, so it cannot be proven alone; join the parts")
    return [np.array(ref.domain, np.int64) for ref in cover.refs]


def _run(tasks: Iterable[CellTask], jobs: int, scheduler: str | None) -> Iterator[CellProof]:
    if scheduler is None and jobs == 1:
        return map(proof_of, tasks)
    return distribute(proof_of, tasks, jobs=jobs, processes=True, scheduler=scheduler)


def _entry(name: str, sha256: str, domain: list[list[int]], proof: Certificate) -> PartProof:
    return PartProof(name=name, sha256=sha256, domain=domain, certificate=leaf_of(proof))


def _certificate(cover: Parts, voxels: Parts | None, scene: Parts | None, checks: list[Check]) -> Certificate:
    """Certificate with the words for the whole files."""
    level = cover.manifest
    assert isinstance(level, CoverManifest)
    files = {"cover": cover, "voxels": voxels, "scene": scene}
    below = None
    if scene is not None and level.min_opacity > 0:  # the words count the Gaussians that are left out
        parts = (scene[number]["opacity"] for number in range(len(scene)))
        below = sum(int((opacity < np.float32(level.min_opacity)).sum()) for opacity in parts)
    proven = "members in hulls" if voxels is None else "every voxel in a hull"
    return certificate_of(level, files, checks, proven, [], below)


def _cubes(cover: Parts, domains: Sequence[Index], counts: Sequence[int], voxels: Parts | None) -> Check:
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
    return check("cubes divide the voxels", len(domains), offences, "no overlap")


def _whole(cover: Parts, counts: Sequence[int], scene: Parts | None) -> Check:
    """Check that level and volume of the whole are those of its parts, and the frame that of the scene."""
    whole = cover.manifest
    assert isinstance(whole, CoverManifest)
    offences, excess = unclaimed(whole, "cover"), 0.0
    for number, ref in enumerate(cover.refs):
        mine = cover[number].manifest
        assert isinstance(mine, CoverManifest)
        names = (*LEVEL, "frame", "unit", "polytopes")
        offences += differences(names, ref.file, mine, "the whole", whole)
        excess += (mine.conservativeness - 1) * counts[number]
    if scene is not None:
        offences += differences(("frame", "unit"), "the cover", whole, "the scene", scene.manifest)
    growth = 1 + excess / max(sum(counts), 1)
    if not abs(growth - whole.conservativeness) <= VOLUME_TOLERANCE * growth:
        text = f"conservativeness of the parts is {growth}, of the whole {whole.conservativeness}"
        offences.append(Offence(fault=text))
    return check("the whole is its parts", len(cover), offences, f"conservativeness {at_most(growth, 6)}")


def _sum(checks: Sequence[Check]) -> Check:
    """One check of all parts; the volume of each is its own."""
    found = sum_of(checks)
    is_volume = found.detail.startswith("conservativeness")
    return msgspec.structs.replace(found, detail="of each part") if is_volume else found
