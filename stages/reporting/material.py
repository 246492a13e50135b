"""What a report is made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from alula.schemas.artifact import Artifact
from alula.schemas.flights import Flight
from alula.schemas.manifest import InputRef
from alula.schemas.run import RunRecord, TrialResult

OUTCOMES = ("reached", "stuck", "timeout", "refused", "collision")


@dataclass(frozen=True, slots=True)
class Run:
    """One log: its label (unique in the report), its summary, its flights by trial, hulls of its map."""

    label: str
    record: RunRecord
    flights: Mapping[int, Flight] = field(default_factory=dict)
    hulls: int | None = None


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
    """The outcome that colours a trial: a collision counts before how the flight ended."""
    return "collision" if trial.collision else trial.outcome


def clearance_of(trial: TrialResult) -> float | None:
    """The least clearance that was computed for a trial, of map and scene; None when none was."""
    known = [c for c in (trial.map_clearance_m, trial.scene_clearance_m) if c is not None]
    return min(known, default=None)


def is_covered(certificate: Mapping[str, Any] | None, cover: Artifact | None) -> bool | None:
    """What a certificate, or else the cover itself, says about coverage; None when neither does."""
    for claims in (certificate, getattr(cover.manifest, "certificate", None) if cover else None):
        if claims is None:
            continue
        found = [claims] + [claims[key] for key in ("summary", "claims") if isinstance(claims.get(key), dict)]
        for record in found:
            if isinstance(record.get("covered"), bool):
                return bool(record["covered"])
    return None
