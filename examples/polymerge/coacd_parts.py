"""Run CoACD on the surface of voxels, for comparison.

Usage: python coacd_parts.py room.voxels.npz room.coacd.npz [none]
       python coacd_parts.py --count room.coacd.npz OTHERWISE

The first form writes the points of all parts [voxel edges] and the start of each part; with `none` or without
the package coacd it writes no parts. The second form prints the number of parts, or OTHERWISE when there are
none.
"""

import sys
from pathlib import Path

import numpy as np

from alula.schemas.artifact import read_artifact
from alula.schemas.atomic import atomic_output
from alula.stages.compression.voxel_mesh import voxel_mesh


def decompose(source: Path) -> list[np.ndarray]:
    """Points of each part, with CoACD's defaults except its remeshing, which fills closed rooms."""
    try:
        import coacd
    except ImportError:
        print("coacd is not installed: its columns stay empty", file=sys.stderr)
        return []
    corners, triangles = voxel_mesh(read_artifact(source)["index"])
    coacd.set_log_level("error")
    mesh = coacd.Mesh(corners.astype(np.float64), triangles)
    return [points for points, _ in coacd.run_coacd(mesh, preprocess_mode="off", seed=0)]


if sys.argv[1] == "--count":
    with np.load(sys.argv[2]) as arrays:
        print(len(arrays["start"]) - 1 or sys.argv[3])
else:
    source, output = Path(sys.argv[1]), Path(sys.argv[2])
    parts = [] if sys.argv[3:] == ["none"] else decompose(source)
    starts = np.cumsum([0, *map(len, parts)])
    with atomic_output(output) as file:
        np.savez(file, points=np.concatenate([*parts, np.empty((0, 3))]), start=starts)
    print(f"{output}: {len(parts)} parts of CoACD")
