"""Camera poses of a COLMAP sparse model."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from alula.schemas.errors import InputError
from alula.schemas.extras import load
from alula.stages.alignment.colmap_counts import check_counts
from alula.stages.alignment.evidence import Landmarks, Positions

MODEL_PARTS = ("cameras", "frames", "images", "points3D", "rigs")


def model_files(folder: Path) -> dict[str, Path]:
    """Find the files of a COLMAP model; where both formats are there, the binary ones, as COLMAP does.

    Returns:
        The files by their role: `cameras`, `images`, `points3D`, and `frames` and `rigs` where they exist.

    Raises:
        InputError: there is no model.
    """
    suffix = ".bin" if (folder / "images.bin").is_file() else ".txt"
    files = {
        part: folder / f"{part}{suffix}" for part in MODEL_PARTS if (folder / f"{part}{suffix}").is_file()
    }
    lacking = [part for part in ("cameras", "images", "points3D") if part not in files]
    if lacking:
        where = "does not exist" if not folder.exists() else f"no {lacking[0]}.bin or {lacking[0]}.txt"
        raise InputError(f"{folder}: is no COLMAP model: {where}")
    return files


def read_model(folder: Path) -> Positions:
    """Read the poses of the registered cameras of a COLMAP model, binary or text, sorted by image name.

    Returns:
        Positions and axes (x right, y down, z forward) in the model's frame and units, with its 3D points.

    Raises:
        InputError: it cannot be read, or no image is registered.
        UsageError: pycolmap is not installed.
    """
    pycolmap = load("pycolmap")
    check_counts(model_files(folder))
    try:
        pycolmap.logging.minloglevel = 3
        model = pycolmap.Reconstruction(str(folder))
        name_of = image_names(folder, model)
        found = {
            name_of[number]: (
                np.asarray(image.projection_center(), np.float64),
                np.asarray(image.cam_from_world().rotation.matrix(), np.float64).T,
            )
            for number, image in model.images.items()
            if image.has_pose
        }
        points = np.array([point.xyz for point in model.points3D.values()], np.float64).reshape(-1, 3)
    except InputError:
        raise
    except Exception as error:
        reason = str(error).split("] ")[-1].splitlines()
        raise InputError(f"{folder}: is no readable COLMAP model: {' '.join(reason)[:200]}") from error
    if not found:
        raise InputError(f"{folder}: no image of the COLMAP model is registered")
    names = tuple(sorted(found))
    position = np.array([found[name][0] for name in names])
    axes = np.array([found[name][1] for name in names])
    for i, name in enumerate(names):
        if not (np.isfinite(position[i]).all() and np.isfinite(axes[i]).all()):
            raise InputError(f"{folder}: image {name!r} has a pose that is not finite")
    points = points[np.isfinite(points).all(axis=1)]
    rows = tuple(f"{folder.name} ({name})" for name in names)
    return Positions(names, position, rows, axes, landmarks=Landmarks(str(folder), points, position, axes))


def image_names(folder: Path, model: Any) -> dict[int, str]:
    """Names of the images of a model by their numbers; COLMAP cuts names in text files at the first space.

    Args:
        model: pycolmap's `Reconstruction` of it.

    Raises:
        InputError: two images have the same name.
    """
    names = {number: str(image.name) for number, image in model.images.items()}
    path = model_files(folder)["images"]
    if path.suffix == ".txt":
        with path.open(encoding="utf-8", errors="replace") as lines:
            for line in lines:
                words = line.split(maxsplit=9)
                if not words or words[0].startswith("#"):
                    continue
                if len(words) == 10:
                    names[int(words[0])] = words[9].rstrip()
                next(lines, None)  # points of the image
    seen: dict[str, int] = {}
    for number, name in sorted(names.items()):
        if seen.setdefault(name, number) != number:
            raise InputError(f"{path}: images {seen[name]} and {number} have the same name, {name!r}")
    return names
