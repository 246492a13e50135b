"""`alula import-voxels`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from alula.cli.shell import grouped, options
from alula.schemas.parameters.configs.import_voxels import ImportVoxelsConfig

EXAMPLES = """\b
Examples:
  alula import-voxels shed.obj -o shed.voxels.npz --size 0.1 --margin 0.05
  alula import-voxels shed.stl -o shed.voxels.npz --size 0.05 --solid --scale 0.001
  alula import-voxels shed.xyz -o shed.voxels.npz --size 0.05 --radius 0.04 --min-points 2
  alula import-voxels shed.bt -o shed.voxels.npz --size 0.2 --unknown occupied
"""


@grouped.command("import-voxels", epilog=EXAMPLES)
@click.argument("source", metavar="FILE", type=options.PATH)
@options.fields_of(ImportVoxelsConfig)
@options.output(".voxels.npz")
def command(source: Path, fields: dict[str, Any], common: options.Common) -> None:
    """Mark every voxel that a mesh, a cloud or an OctoMap touches.

    FILE is a mesh (.obj, .stl, .glb, .ply with faces), a point cloud (.ply without faces, .pcd, .xyz, .pts,
    .npz) or the octree of an OctoMap (.bt, .ot). The voxels go through merge, verify, plan and all other
    commands like those of a splat; verify --source proves them against FILE by other algorithms.

    A voxel is a closed cube. It is marked when a triangle or a point, grown by the ball of --margin, touches
    it; of an OctoMap, when it shares more than its surface with an occupied leaf. Rounding is outward, so no
    touched voxel is missed. Only the surface of a mesh is marked, unless --solid is given.

    Everything in FILE is read, or it is refused by name: see "What is read" in the guide.

    Memory: 72 bytes per triangle, or 24 per point, and what voxelize takes per voxel; 12 times the bytes of a
    text. An estimate of voxels far above --max-voxels ends the command before the work.
    """
    from alula.cli.verbs.import_voxels import import_voxels
    from alula.cli.verbs.verb import run_step

    run_step(common, import_voxels.step(source, jobs=common.jobs, **fields))
