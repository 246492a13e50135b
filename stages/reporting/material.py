"""Inputs of a report: runs, map, plan and certificate, and what can be read off them directly."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from alula._core import EllipsoidSet
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.manifest import InputRef
from alula.schemas.log.flights import Course, Flight
from alula.schemas.log.run import RunRecord, TrialResult

OUTCOMES = (
    *("reached", "passed", "held", "stuck", "timeout", "refused", "stopped", "missed-via", "off-plan"),
    "collision",
)
NOT_JUDGED = "not judged"  # of a flight whose log was cut


@dataclass(frozen=True, slots=True)
class Run:
    """One log.

    Attributes:
        label: unique in the report.
        hulls: number of hulls of its map; None where the log does not state it.
        course: supervisor steps and messages of a real flight; None for a simulation.
    """

    label: str
    record: RunRecord
    flights: Mapping[int, Flight] = field(default_factory=dict)
    hulls: int | None = None
    course: Course | None = None


@dataclass(frozen=True, slots=True)
class Material:
    """All inputs of a report; every number in the report comes from here.

    `inputs` describes the files that were read; `file_bytes` maps their roles to their sizes;
    `certified_cover` is the hash of the cover that `certificate` proves; `trees` has those that
    `ellipsoids` made, by their level.
    """

    title: str
    runs: tuple[Run, ...] = ()
    cover: Artifact | None = None
    scene: Artifact | None = None
    plan: Artifact | None = None
    certificate: Mapping[str, Any] | None = None
    certified_cover: str | None = None
    inputs: tuple[InputRef, ...] = ()
    file_bytes: Mapping[str, int] = field(default_factory=dict)
    trees: dict[float, EllipsoidSet] = field(default_factory=dict)


def is_composed(trial: TrialResult) -> bool:
    """Whether a trial is simulated, in a world whose parts are chosen each on its own."""
    return trial.stale_steps is not None


def outcome_of(trial: TrialResult) -> str:
    """Outcome of a trial as the report counts it: a collision overrides the flight's end."""
    return "collision" if trial.collision else trial.outcome


def is_covered(certificate: Mapping[str, Any] | None) -> bool | None:
    """Result of a certificate of `verify`; None without a certificate."""
    found = certificate.get("covered") if certificate is not None else None
    return found if isinstance(found, bool) else None


def checks_ellipsoids(certificate: Mapping[str, Any] | None) -> bool:
    """Return whether a certificate's checks include the ellipsoids of a scene, or another source."""
    checks = certificate.get("checks", []) if certificate is not None else []
    return any(
        isinstance(check, dict)
        and ("ellipsoid" in (name := str(check.get("name"))) or name.endswith("lies in the voxels"))
        for check in checks
    )


def coverage(certificate: Mapping[str, Any] | None) -> bool | str:
    """Verdict on the obstacles; True only when all of their ellipsoids were checked."""
    covered = is_covered(certificate)
    if covered is None:
        return "not verified"
    if covered and not checks_ellipsoids(certificate):
        return "voxels only"
    return "in part" if covered and omitted(certificate) else covered


def omitted(certificate: Mapping[str, Any] | None) -> list[str]:
    """What the proven map leaves out of the scan, in words; none where its certificate says so."""
    if certificate is None:
        return []
    return [str(words) for words in certificate.get("omits", ["what its certificate does not say"])]


def proof(certificate: Mapping[str, Any] | None) -> str:
    """State in words what a certificate proves."""
    if certificate is None:
        return "this map was not checked by alula verify"
    return str(certificate.get("statement") or "a certificate without a statement")


def flew_through(run: Run, material: Material) -> bool | None:
    """Return whether a run flew through the cover that is shown; None when one of them is not known."""
    return _is_same(cover_hash(run.record.provenance.inputs), cover_hash(material.inputs))


def elsewhere(run: Run, material: Material) -> list[str]:
    """Name what of a report a run did not fly in: the map, which is shown or proven, and the scan."""
    flown = run.record.provenance.inputs
    covers = (cover_hash(material.inputs), material.certified_cover)
    found = []
    if any(_is_same(cover_hash(flown), cover) is False for cover in covers):
        found.append("map")
    if _is_same(_hash_of(flown, "scene"), _hash_of(material.inputs, "scene")) is False:
        found.append("scan")
    return found


def _is_same(one: str | None, other: str | None) -> bool | None:
    return None if one is None or other is None else one == other


def cover_hash(inputs: Iterable[InputRef]) -> str | None:
    """SHA-256 of the cover among input files."""
    return _hash_of(inputs, "cover")


def _hash_of(inputs: Iterable[InputRef], role: str) -> str | None:
    return next((ref.sha256 for ref in inputs if ref.role == role), None)
