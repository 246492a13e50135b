"""Run CoACD on the surface of a splat's density, for comparison.

Usage: python coacd_parts.py SCENE VOXELS OUTPUT [LIMIT]
       python coacd_parts.py --count OUTPUT OTHERWISE

The first form writes the points of all parts [voxel edges], the start of each part, and the CPU time [s].
The surface is that of `density_mesh`, as SuGaR defines it, simplified to TRIANGLES triangles. CoACD may use
LIMIT seconds of CPU; without time (0), in too little time, or without the package coacd there are no parts.
The second form prints the number of parts, or OTHERWISE when there are none.
"""

import math
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

TRIANGLES, THRESHOLD = 20_000, 0.05


def decompose(mesh: Path, output: Path, limit_s: float) -> None:
    """Run CoACD with its defaults except its remeshing, which fills closed rooms; in a process of its own."""
    import coacd

    resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(limit_s), math.ceil(limit_s) + 5))
    with np.load(mesh) as arrays:
        corner, triangle = arrays["corner"], arrays["triangle"]
    coacd.set_log_level("error")
    origin = corner.min(axis=0)
    parts = coacd.run_coacd(
        coacd.Mesh(corner - origin, triangle), threshold=THRESHOLD, preprocess_mode="off", seed=0
    )
    used = resource.getrusage(resource.RUSAGE_SELF)
    points = [found + origin for found, _ in parts]
    start = np.cumsum([0, *map(len, points)])
    np.savez(
        output,
        points=np.concatenate(points),
        start=start,
        cpu_s=used.ru_utime + used.ru_stime,
        limit_s=limit_s,
    )


def main() -> None:
    """Make the surface, run CoACD on it, and write its parts or none."""
    from alula.schemas.artifacts.artifact import read_artifact
    from alula.schemas.atomic import atomic_output
    from papers.polymerge.density_mesh import density_mesh, simplified

    scene, voxels, output = (Path(word) for word in sys.argv[1:4])
    limit_s = float((*sys.argv[4:], "300")[0])
    with tempfile.TemporaryDirectory() as folder:
        mesh, found = Path(folder, "mesh.npz"), Path(folder, "parts.npz")
        data, why = b"", "no time is given"
        if limit_s > 0:
            corner, triangle = simplified(
                *density_mesh(read_artifact(scene), read_artifact(voxels)), TRIANGLES
            )
            np.savez(mesh, corner=corner, triangle=triangle)
            command = [sys.executable, __file__, "--run", str(mesh), str(found), str(limit_s)]
            done = subprocess.run(
                command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, check=False
            )
            why = (done.stderr.strip().splitlines() or [f"over {limit_s:g} s of CPU"])[-1]
        if not found.exists():
            np.savez(
                found, points=np.empty((0, 3)), start=np.zeros(1, np.int64), cpu_s=math.nan, limit_s=limit_s
            )
            print(f"no parts of CoACD: {why}", file=sys.stderr)
        data = found.read_bytes()
    with atomic_output(output) as file:
        file.write(data)
    with np.load(output) as arrays:
        print(f"{output}: {len(arrays['start']) - 1} parts of CoACD, {float(arrays['cpu_s']):.0f} s of CPU")


if sys.argv[1] == "--count":
    with np.load(sys.argv[2]) as arrays:
        print(len(arrays["start"]) - 1 or sys.argv[3])
elif sys.argv[1] == "--run":
    decompose(Path(sys.argv[2]), Path(sys.argv[3]), float(sys.argv[4]))
else:
    main()
