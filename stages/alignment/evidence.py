"""Evidence for an alignment: points or poses that are known in the scene and in the world."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import PureWindowsPath
from typing import Any

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.manifest import Similarity
from alula.schemas.errors import InputError
from alula.stages.alignment.similarity import inverse, transform_points

UNCHECKED = (
    "that the cameras are in the frame of the splat could not be checked: {why}; gsplat, nerfstudio and "
    "OpenSplat move a model before they train"
)

_SAME_PLACE = 1e-6  # of the extent
_NEAR_PLACE = 1e-2  # of the extent: as far as the other side may be apart

# Differences of names that hide matches, each with those before it.
_NAMINGS: tuple[tuple[str, Callable[[str], str]], ...] = (
    ("with / instead of \\", lambda name: name.replace("\\", "/")),
    ("without regard to case", lambda name: name.replace("\\", "/").lower()),
    ("without their folders", lambda name: PureWindowsPath(name).name.lower()),
    ("without folders and endings", lambda name: PureWindowsPath(name).stem.lower()),
)


@dataclass(frozen=True, slots=True)
class Landmarks:
    """3D points of a camera model, and all of its cameras.

    Attributes:
        points: shape (n, 3), frame and units of the model.
        cameras: centres, shape (m, 3).
        axes: the cameras' axes as columns (x right, y down, z forward), shape (m, 3, 3).
    """

    name: str
    points: FloatArray
    cameras: FloatArray
    axes: FloatArray

    def moved(self, similarity: Similarity) -> Landmarks:
        """Landmarks in another frame.

        Args:
            similarity: the other frame from this one.
        """
        return Landmarks(
            self.name,
            transform_points(similarity, self.points),
            transform_points(similarity, self.cameras),
            np.array(similarity.rotation) @ self.axes,
        )


@dataclass(frozen=True, slots=True)
class Correspondences:
    """Points or poses of the scene and of the world, row by row.

    Attributes:
        rows: file and row of each pair, for messages.
        scene: positions, shape (n, 3), scene frame and units.
        world: the same positions, shape (n, 3), world frame [m].
        unused: number of cameras without a reference.
        unmatched: images of the reference that are no cameras of the scene; their rows were skipped.
        R_scene: axes of the cameras as columns, shape (n, 3, 3), scene frame; None when orientations are no
            evidence.
        R_world: axes of the same cameras, shape (n, 3, 3), world frame; None as above.
        landmarks: of the model of the scene's cameras, scene frame; None where it has no 3D points.
    """

    rows: tuple[str, ...]
    scene: FloatArray
    world: FloatArray
    unused: int = 0
    unmatched: tuple[str, ...] = ()
    R_scene: FloatArray | None = None
    R_world: FloatArray | None = None
    facts: Mapping[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    landmarks: Landmarks | None = None

    def moved(self, similarity: Similarity) -> Correspondences:
        """The same evidence with its scene side mapped.

        Args:
            similarity: frame of the new scene side from that of the present one.
        """
        return dataclasses.replace(
            self,
            scene=transform_points(similarity, self.scene),
            R_scene=None if self.R_scene is None else np.array(similarity.rotation) @ self.R_scene,
            landmarks=None if self.landmarks is None else self.landmarks.moved(similarity),
        )


@dataclass(frozen=True, slots=True)
class Positions:
    """Named camera positions of one frame.

    Attributes:
        position: shape (n, 3), units of the frame.
        rows: file and row of each, for messages.
        axes: the cameras' axes as columns (x right, y down, z forward), shape (n, 3, 3); None when unknown.
        landmarks: of the cameras' model; None where it has no 3D points.
    """

    names: tuple[str, ...]
    position: FloatArray
    rows: tuple[str, ...]
    axes: FloatArray | None = None
    facts: Mapping[str, Any] = field(default_factory=dict)
    landmarks: Landmarks | None = None

    def moved(self, similarity: Similarity) -> Positions:
        """The cameras in another frame.

        Args:
            similarity: the other frame from this one.
        """
        return dataclasses.replace(
            self,
            position=transform_points(similarity, self.position),
            axes=None if self.axes is None else np.array(similarity.rotation) @ self.axes,
            landmarks=None if self.landmarks is None else self.landmarks.moved(similarity),
        )


def match(
    cameras: Positions, reference: Positions, *, orientations: bool = False, min_matched: float = 0.5
) -> Correspondences:
    """Pair positions, or with `orientations` poses, by the names of the images.

    A row of the reference whose image is no camera is skipped and counted: COLMAP seldom registers all
    photographs. Few matches mean that the names or the files are wrong.

    Args:
        cameras: cameras in the scene's frame; those without a reference are counted as unused.
        reference: cameras in the world frame [m].
        orientations: pair the axes of the cameras too; both sides must have them.
        min_matched: minimum fraction of the reference's rows whose image is a camera.

    Raises:
        InputError: too few rows of the reference name a camera, or cameras at one place are far apart on the
            other side.
    """
    index = {name: i for i, name in enumerate(cameras.names)}
    known = np.array([name in index for name in reference.names])
    unmatched = tuple(name for name in reference.names if name not in index)
    if known.mean() < min_matched or not known.any():
        first = reference.rows[int(np.argmin(known))]
        raise InputError(
            f"{first}: no camera has an image of that name; {len(unmatched)} of {len(known)} rows name none, "
            f"and {min_matched:.0%} must name one (--min-matched)"
            + _naming_hint(cameras.names, reference.names, min_matched)
        )
    warnings: tuple[str, ...] = ()
    if unmatched:
        some = ", ".join(unmatched[:3]) + (", ..." if len(unmatched) > 3 else "")
        warnings = (
            f"{len(unmatched)} of {len(known)} rows were skipped: no camera has their image ({some})",
        )
    if cameras.landmarks is None:
        warnings += (UNCHECKED.format(why="they come without 3D points"),)
    reference = dataclasses.replace(
        reference,
        names=tuple(name for name in reference.names if name in index),
        position=reference.position[known],
        rows=tuple(row for row, found in zip(reference.rows, known, strict=True) if found),
        axes=None if reference.axes is None else reference.axes[known],
    )
    chosen = [index[name] for name in reference.names]
    found = Correspondences(
        rows=reference.rows,
        scene=cameras.position[chosen],
        world=reference.position,
        unused=len(cameras.names) - len(chosen),
        unmatched=unmatched,
        warnings=warnings,
        facts={**cameras.facts, **reference.facts},
        landmarks=cameras.landmarks,
    )
    if orientations:
        assert cameras.axes is not None
        assert reference.axes is not None
        found = dataclasses.replace(found, R_scene=cameras.axes[chosen], R_world=reference.axes)
    return one_of_each_place(found)


def one_of_each_place(found: Correspondences) -> Correspondences:
    """Keep the first of the cameras at one place, as of a hover or of the faces of a 360 degree camera.

    Their errors are the same, so that they are no independent evidence. Places are the same within a
    millionth of the extent on one side; the other side may then differ by a hundredth of its extent.

    Raises:
        InputError: cameras at one place on one side are far apart on the other; names both rows.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    sides = {"scene": found.scene, "world": found.world}
    extent = {name: float(np.linalg.norm(np.ptp(points, axis=0))) for name, points in sides.items()}
    count = len(found.rows)
    pairs = np.concatenate(
        [
            cKDTree(points).query_pairs(_SAME_PLACE * extent[name], output_type="ndarray")
            for name, points in sides.items()
        ]
    )
    if not len(pairs):
        return found
    for name, points in sides.items():
        gap = np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1)
        worst = int(np.argmax(gap))
        if gap[worst] > _NEAR_PLACE * extent[name]:
            other = "world" if name == "scene" else "scene"
            first, second = sorted(pairs[worst].tolist())
            raise InputError(
                f"{found.rows[second]}: the same point in the {other} as {found.rows[first]}, but in "
                f"the {name} they are {gap[worst]:.4g} apart"
            )
    graph = coo_array((np.ones(len(pairs)), tuple(pairs.T)), shape=(count, count))
    kept = np.sort(np.unique(connected_components(graph, directed=False)[1], return_index=True)[1])
    left_out = count - len(kept)
    warning = (
        f"{left_out} of {count} images were taken at a place of another one (a hover, or the faces of a 360 "
        f"degree camera) and add no evidence: one of each of {len(kept)} places counts"
    )
    return dataclasses.replace(
        found,
        rows=tuple(found.rows[k] for k in kept),
        scene=found.scene[kept],
        world=found.world[kept],
        R_scene=None if found.R_scene is None else found.R_scene[kept],
        R_world=None if found.R_world is None else found.R_world[kept],
        facts={**found.facts, "same_place": left_out},
        warnings=(*found.warnings, warning),
    )


def _naming_hint(cameras: Sequence[str], reference: Sequence[str], min_matched: float) -> str:
    """Hint at a difference of the names without which enough would match; empty without one."""
    for words, named in _NAMINGS:
        of = dict(zip(map(named, cameras), cameras, strict=True))
        pairs = [(name, of[named(name)]) for name in reference if named(name) in of]
        if pairs and len(pairs) >= min_matched * len(reference) and len(of) == len(cameras):
            row, camera = pairs[0]
            return f"; {words} {len(pairs)} would match: name {row!r} as the camera is, {camera!r}"
    return ""


def in_training_frame(
    original_from_training: Similarity,
    found: Correspondences,
    facts: Mapping[str, Any],
    warnings: tuple[str, ...] = (),
) -> Correspondences:
    """Map evidence from the frame of the source poses into the frame that the scene was trained in.

    Args:
        original_from_training: source poses' frame from the scene's frame.
        found: correspondences whose scene side is in the frame of the source poses.
    """
    return dataclasses.replace(
        found.moved(inverse(original_from_training)),
        facts={**found.facts, **facts},
        warnings=(*found.warnings, *warnings),
    )


def distinct(found: Correspondences) -> Correspondences:
    """Refuse correspondences that hold a point twice: a repeated point is a mistake and adds no information.

    Args:
        found: the correspondences, which are returned unchanged.

    Raises:
        InputError: two points of one side are equal; names both rows.
    """
    for name, points in (("scene", found.scene), ("world", found.world)):
        seen: dict[tuple[float, ...], str] = {}
        for row, point in zip(found.rows, points.tolist(), strict=True):
            earlier = seen.setdefault(tuple(point), row)
            if earlier != row:
                raise InputError(f"{row}: the same point in the {name} as {earlier}")
    return found
