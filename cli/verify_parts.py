"""`alula verify` for covers in parts, and for one part against the certificate of all."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from alula.schemas.artifacts.artifact import file_hash, read_artifact
from alula.schemas.artifacts.certificate import Certificate, PartsCertificate
from alula.schemas.artifacts.kinds import COVER, SCENE, VOXELS
from alula.schemas.artifacts.parts import Parts, is_parts, open_parts
from alula.schemas.decode import MalformedError, decode_json
from alula.schemas.errors import AlulaError, ArtifactError
from alula.schemas.files import read_small
from alula.schemas.progress import Progress
from alula.stages.compression.verify_parts import prove_part, verify_parts

_LIMIT = 2**28  # of a certificate [B]


def has_domains(path: Path) -> bool:
    """Test whether a path is a cover in parts that can be proven one by one.

    Args:
        path: any path; the reader reports what is wrong with it.
    """
    if not is_parts(path):
        return False
    try:
        return all(ref.domain is not None for ref in open_parts(path, COVER).refs)
    except AlulaError:
        return False


def verified(
    proven: Path,
    voxels: Path | None,
    scene: Path | None,
    sha256: Mapping[str, str],
    jobs: int,
    scheduler: str | None,
    progress: Progress,
) -> PartsCertificate:
    """Verify a cover in parts.

    Args:
        proven: folder of the cover.
        voxels: file or folder.
        scene: file or folder.
        sha256: hashes of these, by role.
        jobs: processes.
        scheduler: address, instead of processes.
        progress: see `verify_parts`.

    Raises:
        see `verify_parts` and `open_parts`.
    """
    cover = open_parts(proven, COVER)
    return verify_parts(
        cover, **_others(voxels, scene), sha256=sha256, jobs=jobs, scheduler=scheduler, progress=progress
    )


def verified_part(proven: Path, certificate: Path, voxels: Path | None, scene: Path | None) -> Certificate:
    """Prove one part again, against the list of a certificate.

    Args:
        proven: file of the part.
        certificate: file of the certificate.
        voxels: file or folder.
        scene: file or folder.

    Raises:
        ArtifactError: the certificate is damaged, or not one of a cover in parts.
        UsageError, CheckError: see `prove_part`.
    """
    raw = read_small(certificate, _LIMIT)
    try:
        whole = decode_json(raw, PartsCertificate)
    except MalformedError as error:
        raise ArtifactError(f"{certificate}: is no certificate of a cover in parts ({error})") from error
    part = read_artifact(proven, COVER)
    try:
        return prove_part(whole, part, file_hash(proven), **_others(voxels, scene))
    except ArtifactError as error:
        raise error.reworded(f"{certificate}: {error}") from error


def _others(voxels: Path | None, scene: Path | None) -> dict[str, Parts | None]:
    return {
        "voxels": None if voxels is None else open_parts(voxels, VOXELS),
        "scene": None if scene is None else open_parts(scene, SCENE),
    }
