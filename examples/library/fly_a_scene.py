"""Run the pipeline as a library: from a splat file to judged flights.

Usage: python fly_a_scene.py point_cloud.ply METRES_PER_UNIT VOXEL_SIZE_M
"""

import sys
from pathlib import Path

from alula.schemas.configs.import_splat import ImportSplatConfig
from alula.schemas.configs.merge import MergeConfig
from alula.schemas.configs.scale_align import ScaleAlignConfig
from alula.schemas.configs.voxelize import VoxelizeConfig
from alula.schemas.world import decoded
from alula.stages.alignment.scale_align import scale_align, scale_only
from alula.stages.compression.merge import merge
from alula.stages.compression.verify import verify
from alula.stages.compression.voxelize import voxelize
from alula.stages.reconstruction.formats.registry import read_splats
from alula.stages.reconstruction.import_splat import import_splat
from alula.stages.simulation.world.simulate import simulate_world
from alula.stages.simulation.world.summary import world_summary

file, scale, size_m = Path(sys.argv[1]), float(sys.argv[2]), float(sys.argv[3])
scene = import_splat(ImportSplatConfig(), read_splats(file))
scene = scale_align(ScaleAlignConfig(), scene, scale_only(scale), seed=0)
voxels = voxelize(VoxelizeConfig(size_m=size_m), scene)
cover = merge(MergeConfig(hulls=100), voxels)
assert verify(cover, voxels=voxels, scene=scene).covered
scenario = decoded(  # the keys of a scenario's file; alula scenario --keys explains them
    {
        "vehicle": {"type": "single-integrator", "radius_m": 0.1},
        "world": {"cover": "cover", "scene": "scene"},
        "safety": {"filters": ["polytope-cbf"]},
        "rules": {"trials": 20},
    }
)
run = simulate_world(scenario, cover=cover, scene=scene)
summary = world_summary(run)
print(f"{len(scene['mean'])} Gaussians, {cover.manifest.summary['hulls']} hulls,", summary["success_rate"])
