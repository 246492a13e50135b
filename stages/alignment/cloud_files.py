"""Reading of surveyed clouds from files."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.errors import InputError
from alula.schemas.extras import load
from alula.stages.alignment.cloud_counts import check_cloud, check_member

SUFFIXES = (".ply", ".pcd", ".xyz", ".xyzn", ".xyzrgb", ".pts", ".npz")
_KEYS = ("points", "xyz", "positions")


def read_cloud(path: Path) -> FloatArray:
    """Read the points of a cloud.

    Open3D reads PLY, PCD, XYZ and PTS. In an .npz the points are the array `points`, `xyz` or `positions`.

    Args:
        path: the file.

    Returns:
        Shape (n, 3), in the file's units.

    Raises:
        InputError: the file cannot be read, has no points, or has one that is not finite.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"{path}: clouds end in {', '.join(SUFFIXES)}, not {suffix!r}")
    try:
        with path.open("rb") as file:
            file.read(1)
    except OSError as error:
        raise InputError(f"{path}: cannot read: {error.strerror or error}") from error
    points = _npz(path) if suffix == ".npz" else _open3d(path)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"{path}: points must have the shape (n, 3), not {points.shape}")
    if not len(points):
        raise InputError(f"{path}: holds no points that Open3D can read; compressed PLY is not supported")
    if not np.isfinite(points).all():
        row = int(np.argwhere(~np.isfinite(points))[0][0])
        raise InputError(f"{path}: point {row} is not finite")
    return points


def _npz(path: Path) -> FloatArray:
    try:
        with np.load(path, allow_pickle=False) as found:
            keys = [key for key in _KEYS if key in found.files]
            if not keys:
                raise InputError(f"{path}: has no array {' or '.join(_KEYS)}, only {', '.join(found.files)}")
            check_member(found.zip, keys[0], path)
            return np.asarray(found[keys[0]], np.float64)
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"{path}: is no readable .npz file: {str(error)[:200]}") from error


@contextmanager
def _native_stdout_discarded() -> Iterator[None]:
    """Discard what native code prints to standard output; flush Python's own output before and after."""
    sys.stdout.flush()
    try:
        kept = os.dup(1)
    except OSError:  # stdout is closed: nothing can be printed there
        yield
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        yield
    finally:
        sys.stdout.flush()
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)


def _open3d(path: Path) -> FloatArray:
    check_cloud(path)
    with _native_stdout_discarded():
        open3d = load("open3d")
        try:
            with open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error):
                cloud = open3d.io.read_point_cloud(
                    path, remove_nan_points=False, remove_infinite_points=False
                )
            return np.array(cloud.points, np.float64)
        except Exception as error:
            raise InputError(f"{path}: is no readable cloud: {str(error).splitlines()[0][:200]}") from error
