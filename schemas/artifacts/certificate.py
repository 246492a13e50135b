"""Certificates: what `verify` writes, the results of all checks of a proof."""

from __future__ import annotations

from typing import Any, Literal

import msgspec

from alula.schemas.artifacts.manifest import parse_version
from alula.schemas.artifacts.provenance import Provenance
from alula.schemas.decode import decode_json

CERTIFICATE_SCHEMA, CERTIFICATE_VERSION = "alula/certificate", "1.3"


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
    """Result of all checks of a proof.

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


class PartProof(msgspec.Struct, frozen=True, kw_only=True):
    """Entry of the list of proofs.

    Attributes:
        name: of the part's file, or a name for the space around all parts.
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


class CertificateFile(Certificate, frozen=True, kw_only=True):
    """Contents of the file of a certificate.

    Attributes:
        schema: `alula/certificate`.
        version: of this format.
        provenance: of the file; a certificate that another program keeps may lack it.
        parts: see `PartsCertificate`; empty where the proof has no parts.
        merkle_root: see `PartsCertificate`.
    """

    schema: Literal["alula/certificate"]
    version: str = CERTIFICATE_VERSION
    provenance: Provenance | None = None
    parts: list[PartProof] = []
    merkle_root: str = ""


def certificate_text(certificate: Certificate, provenance: Provenance) -> str:
    """Text of the file of a certificate."""
    record = {"schema": CERTIFICATE_SCHEMA, "version": CERTIFICATE_VERSION, "provenance": provenance}
    record |= msgspec.structs.asdict(certificate)
    return msgspec.json.format(msgspec.json.encode(record, order="sorted"), indent=2).decode() + "\n"


def decode_certificate(raw: bytes) -> dict[str, Any]:
    """Decode and check a certificate.

    Returns:
        Kind, version and the values of a `Certificate`, by key.

    Raises:
        ValueError: it is not JSON, or a value is missing or of the wrong type, or of a later version.
    """
    stored = decode_json(raw, CertificateFile)
    if parse_version(stored.version)[0] > parse_version(CERTIFICATE_VERSION)[0]:
        raise ValueError(f"version {stored.version} is newer than {CERTIFICATE_VERSION}; update alula")
    if stored.covered != all(check.ok for check in stored.checks):
        raise ValueError("`covered` contradicts its checks")
    values = msgspec.to_builtins(stored)
    return {name: values[name] for name in (*Certificate.__struct_fields__, "schema", "version")}
