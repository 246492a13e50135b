"""What a scene is aligned by: points or poses known in the scene and in the world."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.errors import InputError
from alula.schemas.manifest import Similarity
from alula.stages.alignment.similarity import inverse, transform_points


@dataclass(frozen=True, slots=True)
class Correspondences:
    """Points or poses of the scene and of the world, row by row.

    `rows` says where each pair comes from; `unused` counts cameras without a reference; `R_scene` and
    `R_world`, shape (n, 3, 3), are the axes of cameras as columns where orientations are evidence too;
    `facts` and `warnings` go into the record of the
    alignment.
    """

    rows: tuple[str, ...]
    scene: FloatArray
    world: FloatArray
    unused: int = 0
    R_scene: FloatArray | None = None
    R_world: FloatArray | None = None
    facts: Mapping[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Positions:
    """Named positions, shape (n, 3), and where each was read.

    `axes`, shape (n, 3, 3), holds the cameras' axes as columns: x right, y down, z forward; `facts` say
    more about the frame.
    """

    names: tuple[str, ...]
    position: FloatArray
    rows: tuple[str, ...]
    axes: FloatArray | None = None
    facts: Mapping[str, Any] = field(default_factory=dict)


def match(cameras: Positions, reference: Positions, *, orientations: bool = False) -> Correspondences:
    """Pair positions, or with `orientations` poses, by the names of the images.

    Raises:
        InputError: a reference names an unknown image, or two positions are equal.
    """
    index = {name: i for i, name in enumerate(cameras.names)}
    for name, row in zip(reference.names, reference.rows, strict=True):
        if name not in index:
            raise InputError(f"{row}: no camera has an image of that name")
    chosen = [index[name] for name in reference.names]
    found = Correspondences(
        rows=reference.rows,
        scene=cameras.position[chosen],
        world=reference.position,
        unused=len(cameras.names) - len(chosen),
        facts={**cameras.facts, **reference.facts},
    )
    if orientations:
        assert cameras.axes is not None
        assert reference.axes is not None
        found = dataclasses.replace(found, R_scene=cameras.axes[chosen], R_world=reference.axes)
    return distinct(found)


def before(
    undo: Similarity, found: Correspondences, facts: Mapping[str, Any], warnings: tuple[str, ...] = ()
) -> Correspondences:
    """The same evidence for a scene that `undo` maps into the frame where it was measured."""
    back = inverse(undo)
    axes = None if found.R_scene is None else np.array(back.rotation) @ found.R_scene
    scene = transform_points(back, found.scene)
    return dataclasses.replace(
        found,
        scene=scene,
        R_scene=axes,
        facts={**found.facts, **facts},
        warnings=(*found.warnings, *warnings),
    )


def distinct(found: Correspondences) -> Correspondences:
    """Refuse equal points: they count twice but say nothing new, and come from mistakes."""
    for name, points in (("scene", found.scene), ("world", found.world)):
        seen: dict[tuple[float, ...], str] = {}
        for row, point in zip(found.rows, points.tolist(), strict=True):
            earlier = seen.setdefault(tuple(point), row)
            if earlier != row:
                raise InputError(f"{row}: the same point in the {name} as {earlier}")
    return found
