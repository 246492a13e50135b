"""Pinhole cameras of a capture: poses in the world, and the rectangle that each image surely shows."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.manifest import Similarity
from alula.schemas.errors import InputError
from alula.stages.alignment.colmap import image_names, read_model
from alula.stages.alignment.evidence import Positions

WIDEST = 2.0  # largest |x/z| and |y/z| that is used, 63 degrees off the axis
_EDGE_POINTS = 256  # per edge of an image
_GRID_POINTS = 33  # per axis, to check a rectangle
_SHRINKS = 30
_SHRINK = 0.01  # of the half-size
_ROUND_TRIP = 1e-6  # of x/z; a model that does not return to a point is not one to one there
_NO_PINHOLES = ("EQUIRECTANGULAR",)


@dataclass(frozen=True, slots=True)
class Pinholes:
    """Cameras without distortion, in the frame that they were given in.

    Attributes:
        poses: names, positions and axes (x right, y down, z forward; columns), `poses.axes` is not None.
        image: left, top, right and bottom of the image as x/z and y/z, shape (n, 4). Each ray inside the
            rectangle meets the photograph, whatever its distortion.
    """

    poses: Positions
    image: FloatArray

    def __len__(self) -> int:
        return len(self.image)

    def moved(self, world_from_here: Similarity) -> Pinholes:
        """Map the cameras to another frame."""
        return Pinholes(self.poses.moved(world_from_here), self.image)

    def arrays(self, columns: int) -> dict[str, Any]:
        """Arguments of the native functions: poses, images and pixels.

        Args:
            columns: pixels along the longer side of each image; pixels are as good as square.
        """
        assert self.poses.axes is not None
        size = self.image[:, 2:] - self.image[:, :2]
        pixels = np.maximum(np.ceil(columns * size / size.max(axis=1, keepdims=True)), 1)
        return {
            "rotation": np.ascontiguousarray(self.poses.axes.swapaxes(1, 2)),
            "centre": np.ascontiguousarray(self.poses.position),
            "image": np.ascontiguousarray(self.image),
            "pixels": pixels.astype(np.int64),
        }


def read_pinholes(folder: Path) -> Pinholes:
    """Read the registered cameras of a COLMAP model, with any of its perspective camera models.

    The image of a camera with distortion is replaced by a rectangle of rays that lies within it: by the
    innermost points of its undistorted edges, and at most `WIDEST`. Rays through the rectangle and its edges
    are projected into the photograph and back as a check.

    Raises:
        InputError: the model cannot be read, or a camera has no such rectangle.
    """
    import pycolmap

    poses = read_model(folder)
    try:
        model = pycolmap.Reconstruction(str(folder))
        names = image_names(folder, model)
        camera_of = {names[number]: image.camera_id for number, image in model.images.items()}
        used = sorted({camera_of[name] for name in poses.names})
        found = {number: _rectangle(model.cameras[number], f"{folder}: camera {number}") for number in used}
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"{folder}: is no readable COLMAP model: {str(error)[:200]}") from error
    return Pinholes(poses, np.array([found[camera_of[name]] for name in poses.names]))


def _rectangle(camera: Any, where: str) -> FloatArray:
    """Left, top, right and bottom of the rays that are surely in a camera's image."""
    name = camera.model.name
    if name in _NO_PINHOLES:
        raise InputError(f"{where}: the model {name} is no perspective camera; give perspective images")
    width, height = float(camera.width), float(camera.height)
    along = np.linspace(0.0, 1.0, _EDGE_POINTS)
    zero, one = np.zeros_like(along), np.ones_like(along)
    edges = [(zero, along), (along, zero), (one, along), (along, one)]
    inner = []
    for side, (x, y) in enumerate(edges):
        ray = np.asarray(camera.cam_from_img(np.column_stack([x * width, y * height])))[:, side % 2]
        ray = ray[np.isfinite(ray)]
        # An edge without rays, 90 degrees off the axis or more, does not bound the rectangle.
        inner.append(ray.max(initial=-np.inf) if side < 2 else ray.min(initial=np.inf))
    image = np.clip(np.array(inner), -WIDEST, WIDEST)
    for _ in range(_SHRINKS):
        middle, half = (image[2:] + image[:2]) / 2, (image[2:] - image[:2]) / 2
        if not (half > 0).all():
            break
        half *= 1 - (_SHRINK if _is_distorted(name) else 0.0)
        image = np.concatenate([middle - half, middle + half])
        if _is_within(camera, image):
            return image
    raise InputError(
        f"{where} ({name}): no rectangle of its undistorted image was found; undistort the images with "
        "colmap image_undistorter and give that model"
    )


def _is_distorted(name: str) -> bool:
    return name not in ("PINHOLE", "SIMPLE_PINHOLE")


def _is_within(camera: Any, image: FloatArray) -> bool:
    """Test whether rays through a rectangle and its edges meet the photograph and come back."""
    u, v = np.meshgrid(*(np.linspace(image[i], image[i + 2], _GRID_POINTS) for i in range(2)))
    fine = np.linspace(0.0, 1.0, _EDGE_POINTS)
    across, down = image[0] + (image[2] - image[0]) * fine, image[1] + (image[3] - image[1]) * fine
    rays = np.concatenate(
        [
            np.column_stack([u.ravel(), v.ravel()]),
            *(np.column_stack([np.full_like(fine, x), down]) for x in image[::2]),
            *(np.column_stack([across, np.full_like(fine, y)]) for y in image[1::2]),
        ]
    )
    pixel = np.asarray(camera.img_from_cam(np.column_stack([rays, np.ones(len(rays))])))
    if not np.isfinite(pixel).all():
        return False
    slack = 1e-6 * max(camera.width, camera.height)
    inside = (pixel >= -slack) & (pixel <= np.array([camera.width, camera.height]) + slack)
    back = np.asarray(camera.cam_from_img(np.ascontiguousarray(pixel)))
    return bool(inside.all() and (np.abs(back - rays) <= _ROUND_TRIP * (1 + np.abs(rays))).all())
