"""Frames that trainers move a COLMAP model to before they train, computed from the model.

Sources: gsplat, examples/datasets/normalize.py (`similarity_from_cameras`, `align_principal_axes`);
nerfstudio, `auto_orient_and_center_poses` and `colmap_to_json`; OpenSplat, `autoScaleAndCenterPoses`.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import permutations, product
from typing import NamedTuple

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.manifest import Similarity
from alula.stages.alignment.evidence import Landmarks
from alula.stages.alignment.similarity import compose, transform_points

_UP_CAMERA = np.array([0.0, -1.0, 0.0])  # axes x right, y down, z forward
# World axes of transforms.json in terms of COLMAP's: as they are, of today's and of older ns-process-data.
_NERFSTUDIO_WORLDS = (
    np.eye(3),
    np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
    np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]),
)


class Recipe(NamedTuple):
    """A frame that a trainer may have moved the model to: its words, and the frame from that of the model."""

    name: str
    moved_from_model: Similarity


def recipes(landmarks: Landmarks) -> Iterator[Recipe]:
    """Frames of trainers, without the turns by right angles that exporters and importers add."""
    as_it_is = Similarity(scale=1.0, rotation=np.eye(3).tolist(), translation_m=[0.0, 0.0, 0.0])
    yield Recipe("turned axes", as_it_is)
    for name, by_focus in (
        ("gsplat's normalize", True),
        ("gsplat's normalize, centred on the cameras", False),
    ):
        if (found := _gsplat(landmarks, by_focus=by_focus)) is not None:
            yield Recipe(name, found)
    for world in _NERFSTUDIO_WORLDS:
        if (found := _nerfstudio(landmarks, world)) is not None:
            yield Recipe("nerfstudio's orientation and scale", found)
    if (found := _centred(landmarks.cameras, np.eye(3))) is not None:
        yield Recipe("OpenSplat's centre and scale", found)


def right_angles() -> Iterator[FloatArray]:
    """The 24 rotations that map the axes to axes, the identity first."""
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[np.arange(3), order] = signs
            if np.linalg.det(matrix) > 0:
                yield matrix


def _similarity(scale: float, rotation: FloatArray, centre: FloatArray) -> Similarity | None:
    """Similarity x -> scale rotation (x - centre); None where it is not finite."""
    translation = -scale * rotation @ centre
    if not (np.isfinite(translation).all() and np.isfinite(rotation).all() and 0 < scale < np.inf):
        return None
    return Similarity(scale=scale, rotation=rotation.tolist(), translation_m=translation.tolist())


def _between(start: FloatArray, end: FloatArray) -> FloatArray:
    """Smallest rotation that takes one unit vector to another; a half turn about z or x for opposite ones."""
    cosine = float(start @ end)
    if cosine < -1 + 1e-9:
        return np.diag([-1.0, -1.0, 1.0]) if abs(start[2]) < 0.5 else np.diag([1.0, -1.0, -1.0])
    x, y, z = np.cross(start, end)
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    rotation: FloatArray = np.eye(3) + skew + skew @ skew / (1 + cosine)
    return rotation


def _up(landmarks: Landmarks) -> FloatArray:
    up: FloatArray = (landmarks.axes @ _UP_CAMERA).mean(axis=0)
    with np.errstate(invalid="ignore"):
        up /= np.linalg.norm(up)
    return up


def _gsplat(landmarks: Landmarks, *, by_focus: bool) -> Similarity | None:
    R = _between(_up(landmarks), _UP_CAMERA)
    centre = landmarks.cameras @ R.T
    nearest = centre
    if by_focus:  # point of each optical axis that is nearest to the origin
        forward = landmarks.axes[:, :, 2] @ R.T
        nearest = centre - (forward * centre).sum(axis=1, keepdims=True) * forward
    middle = np.median(nearest, axis=0)
    reach = float(np.median(np.linalg.norm(centre - middle, axis=1)))
    first = _similarity(1 / reach, R, R.T @ middle) if reach > 0 else None
    if first is None:
        return None
    points = transform_points(first, landmarks.points)
    _, vectors = np.linalg.eigh(np.cov(points, rowvar=False))
    principal = vectors[:, ::-1].T
    principal[0] *= np.sign(np.linalg.det(principal))
    second = _similarity(1.0, principal, np.median(points, axis=0))
    return None if second is None else compose(second, first)


def _nerfstudio(landmarks: Landmarks, world: FloatArray) -> Similarity | None:
    return _centred(landmarks.cameras, _between(world @ _up(landmarks), np.array([0.0, 0.0, 1.0])) @ world)


def _centred(cameras: FloatArray, rotation: FloatArray) -> Similarity | None:
    """Cameras around their mean, turned, in a cube of half-width 1."""
    centre = cameras.mean(axis=0)
    reach = float(np.abs((cameras - centre) @ rotation.T).max())
    return _similarity(1 / reach, rotation, centre) if reach > 0 else None
