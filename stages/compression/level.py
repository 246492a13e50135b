"""What counts as an obstacle, in words: the part of a Gaussian, or what of another map."""

from __future__ import annotations

import math
import re
from typing import Any

import msgspec

from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.manifest import LEVEL, ImportedMap, LevelManifest
from alula.schemas.decimals import at_least, at_most, exact
from alula.schemas.errors import UsageError


def mass_within(sigma: float) -> float:
    """Fraction of a Gaussian's mass inside its ellipsoid at a level.

    P(x' inv(Sigma) x <= k^2) = erf(k / sqrt 2) - sqrt(2 / pi) k exp(-k^2 / 2) for x normal in three
    dimensions, the chi-square distribution with three degrees of freedom.

    Args:
        sigma: k, in standard deviations, at least 0.
    """
    inside = math.erf(sigma / math.sqrt(2)) - math.sqrt(2 / math.pi) * sigma * math.exp(-(sigma**2) / 2)
    return min(max(inside, 0.0), 1.0)


def level_words(sigma: float) -> str:
    """State a level with the mass inside, rounded down: "1 sigma (19.8 % of a Gaussian's mass)".

    Args:
        sigma: k, in standard deviations.
    """
    return f"{exact(sigma)} sigma ({at_least(100 * mass_within(sigma))} % of a Gaussian's mass)"


def beyond_words(sigma: float) -> str:
    """State what a level leaves out, with its mass rounded up.

    Args:
        sigma: k, in standard deviations.
    """
    mass = at_most(100 * (1 - mass_within(sigma)))
    return f"what of each Gaussian lies beyond {exact(sigma)} sigma ({mass} % of its mass)"


def imported_words(imported: ImportedMap, margin_m: float) -> str:
    """Name an obstacle of a map without Gaussians, after "every voxel that" or "contain".

    Args:
        margin_m: radius of the ball around each triangle or point [m].
    """
    grown = f", thickened by {exact(margin_m)} m," if margin_m else ""
    if imported.kind == "mesh":
        return f"a triangle of the mesh{grown}" + (" or the inside of the mesh" if imported.solid else "")
    if imported.kind == "cloud":
        return (
            f"a ball of {exact(margin_m)} m around a point of the cloud"
            if margin_m
            else "a point of the cloud"
        )
    unknown = " and all unknown space within the box of its leaves" if imported.unknown == "occupied" else ""
    return f"every occupied leaf of the octree{unknown}"


def obstacles_words(level: LevelManifest) -> str:
    """Name all obstacles of voxels or a cover: "every ellipsoid of the scene at 1 sigma ..."."""
    if level.imported is not None:
        words = imported_words(level.imported, level.inflation_m).rstrip(",")
        return re.sub(r"^a ", "every ", words).replace(" or the inside of", " and the inside of")
    what = "retained ellipsoid" if level.min_opacity > 0 else "ellipsoid"
    assert level.sigma is not None
    return f"every {what} of the scene at {level_words(level.sigma)}"


def require_sigma(level: LevelManifest) -> float:
    """Level of the ellipsoids that the obstacles are.

    Raises:
        UsageError: they are no ellipsoids of a scene.
    """
    if level.sigma is None:
        assert level.imported is not None
        raise UsageError(
            f"the obstacles are those of a {level.imported.kind}, not of a scene; leave out --scene, and "
            "verify with --source and its file"
        )
    return level.sigma


def obstacle_of(level: LevelManifest) -> str:
    """Noun for one obstacle: ellipsoid, triangle, point or leaf."""
    kind = "" if level.imported is None else level.imported.kind
    return {"": "ellipsoid", "mesh": "triangle", "cloud": "point", "octree": "leaf"}[kind]


def outside_words(level: LevelManifest) -> str:
    """State what the obstacles themselves leave out."""
    if level.imported is None:
        assert level.sigma is not None
        return beyond_words(level.sigma)
    if level.imported.kind == "mesh":
        return "what the mesh does not show" + ("" if level.imported.solid else "; its inside")
    if level.imported.kind == "cloud":
        return f"what lies more than {exact(level.inflation_m)} m from the points of the cloud"
    if level.imported.unknown == "free":
        return "space that the octree does not know"
    return "space that the octree does not know, outside of the box of its leaves"


def recorded_level(level: LevelManifest) -> dict[str, Any]:
    """Definition of an obstacle for a certificate, with the fraction of a Gaussian's mass inside."""
    found: dict[str, Any] = msgspec.to_builtins({name: getattr(level, name) for name in LEVEL})
    return found if level.sigma is None else found | {"mass_fraction": mass_within(level.sigma)}


def omissions(level: LevelManifest, *, below: int | None = None, is_cropped: bool = True) -> list[str]:
    """What a level leaves out of its scene or map, in words; none where it counts every obstacle in full.

    Args:
        below: number of Gaussians below the minimum opacity, where it is known.
        is_cropped: whether the claim reaches beyond the crop.
    """
    count = "" if below is None else f"{below} "
    found = {
        f"voxels that fewer than {level.min_overlap} {_several(level)} touch": level.min_overlap > 1,
        f"{count}Gaussians of opacity below {exact(level.min_opacity)}": level.min_opacity > 0 and below != 0,
        f"what lies outside the crop {exact(level.crop or [])} m": is_cropped and level.crop is not None,
        "the loss of the splat file's format": level.ignore_loss,
    }
    return [words for words, is_so in found.items() if is_so]


def _several(level: LevelManifest) -> str:
    one = obstacle_of(level)
    return "leaves" if one == "leaf" else f"{one}s"


def without(omitted: list[str]) -> str:
    """End of a verdict that names what it does not include; empty where it includes everything."""
    return f"; not included: {', '.join(omitted)}" if omitted else ""


def level_of(artifact: Artifact) -> LevelManifest:
    """Definition of an obstacle in voxels, seen space or a cover."""
    assert isinstance(artifact.manifest, LevelManifest)
    return artifact.manifest


def scene_level(sigma: float) -> dict[str, Any]:
    """Definition of an obstacle among all ellipsoids of a scene, for a certificate.

    Args:
        sigma: level, in standard deviations.
    """
    return {"sigma": sigma, "mass_fraction": mass_within(sigma)}


def hull_words(level: LevelManifest) -> str:
    """Name a hull by what it was made for, after "every"."""
    return f"hull of the cover, made for {obstacles_words(level)}"


def map_words(cover: Artifact | None, scene: Artifact | None, sigma: float, *, is_within: bool) -> str:
    """Name what a flight is judged against: the obstacles with their level, and what this leaves out.

    Args:
        sigma: level of its ellipsoids, in standard deviations.
        is_within: whether unseen space counts, too.
    """
    parts = []
    if cover is not None:
        level = level_of(cover)
        parts.append(f"the hulls of the cover, made for {obstacles_words(level)}{without(omissions(level))}")
    parts += ["all space that was not seen"] if is_within else []
    parts += [] if scene is None else [f"the ellipsoids of the scene at {level_words(sigma)}"]
    return " and ".join(parts)
