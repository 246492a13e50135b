"""What artifacts of a map must be before something flies among them."""

from __future__ import annotations

from alula.schemas.artifact import Artifact
from alula.schemas.errors import InputError
from alula.stages.compression.certificate import require_solid_hulls


def require_metric(role: str, artifact: Artifact) -> None:
    """Refuse an artifact that is not in metres.

    Raises:
        InputError: naming its role.
    """
    unit = artifact.manifest.unit
    if unit != "m":
        raise InputError(f"the {role} is in {unit} units, not metres; run scale-align first")


def require_obstacles(cover: Artifact, *, jobs: int = 0) -> None:
    """Refuse a cover whose hulls cannot be flown among.

    Raises:
        InputError: it is not in metres.
        ArtifactError: planes and vertices do not describe the same polytopes.
    """
    require_metric("cover", cover)
    require_solid_hulls(cover, jobs=jobs)
