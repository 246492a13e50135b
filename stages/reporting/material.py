"""What a report is made of."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from alula.schemas.artifact import Artifact
from alula.schemas.flights import Course, Flight
from alula.schemas.manifest import InputRef
from alula.schemas.run import RunRecord, TrialResult

OUTCOMES = (
    *("reached", "passed", "inside", "stuck", "timeout", "refused", "stopped", "outside", "collision"),
)
NOT_JUDGED = "not judged"  # of a flight whose log was cut


@dataclass(frozen=True, slots=True)
class Run:
    """One log: its label (unique in the report), its summary, its flights by trial, hulls of its map, and
    the course of a real flight.
    """

    label: str
    record: RunRecord
    flights: Mapping[int, Flight] = field(default_factory=dict)
    hulls: int | None = None
    course: Course | None = None


@dataclass(frozen=True, slots=True)
class Material:
    """Everything that a report shows; all numbers in it come from here.

    `inputs` describes the files that were read, `file_bytes` maps their roles to their sizes.
    """

    title: str
    runs: tuple[Run, ...] = ()
    cover: Artifact | None = None
    scene: Artifact | None = None
    plan: Artifact | None = None
    certificate: Mapping[str, Any] | None = None
    inputs: tuple[InputRef, ...] = ()
    file_bytes: Mapping[str, int] = field(default_factory=dict)


def outcome_of(trial: TrialResult) -> str:
    """The outcome that colours a trial: a collision counts before how the flight ended; not so of a fence."""
    return "collision" if trial.collision and trial.fence is None else trial.outcome


def clearance_of(trial: TrialResult) -> float | None:
    """The least clearance that was computed for a trial, of map and scene; None when none was."""
    known = [c for c in (trial.map_clearance_m, trial.scene_clearance_m) if c is not None]
    return min(known, default=None)


def is_covered(certificate: Mapping[str, Any] | None) -> bool | None:
    """What a certificate of `verify` says; None without one."""
    found = certificate.get("covered") if certificate is not None else None
    return found if isinstance(found, bool) else None


def proof(certificate: Mapping[str, Any] | None) -> str:
    """What a certificate proves, in words: coverage of the ellipsoids only when they were checked."""
    if certificate is None:
        return "alula verify has not checked this map"
    checks = [check for check in certificate.get("checks", []) if isinstance(check, dict)]
    if any("ellipsoid" in str(check.get("name")) for check in checks):
        return "ellipsoids in voxels, voxels in hulls: checked again"
    return "voxels in hulls: checked again; ellipsoids were not"


def flew_through(run: Run, material: Material) -> bool | None:
    """Whether a run flew through the cover that is shown; None when one of them is not known."""
    flown = cover_hash(run.record.provenance.inputs)
    shown = cover_hash(material.inputs)
    return None if flown is None or shown is None else flown == shown


def cover_hash(inputs: Iterable[InputRef]) -> str | None:
    """SHA-256 of the cover among input files."""
    return next((ref.sha256 for ref in inputs if ref.role == "cover"), None)
