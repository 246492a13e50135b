"""CoACD on the surface of voxels, for comparison.

Usage: python coacd_parts.py room.voxels.npz room.coacd.npz [none]
       python coacd_parts.py --count room.coacd.npz OTHERWISE

Writes the points of all parts [voxel edges] and where each part starts; no parts with `none` or without
the package coacd. The second form prints how many parts there are, or OTHERWISE when there are none.
"""

import sys
from pathlib import Path

import numpy as np

from alula.schemas.artifact import read_artifact
from alula.schemas.atomic import atomic_output
from alula.stages.compression.voxel_mesh import voxel_mesh


def decompose(source: Path) -> list[np.ndarray]:
    """The points of each part, by CoACD's defaults but for its remeshing, which fills closed rooms."""
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
