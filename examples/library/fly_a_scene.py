"""From a splat file to judged flights, as a library.

Usage: python fly_a_scene.py point_cloud.ply METRES_PER_UNIT VOXEL_SIZE_M
"""

import sys

import alula

splat, scale, size_m = sys.argv[1], float(sys.argv[2]), float(sys.argv[3])
scene = alula.align(alula.import_splat(splat), scale=scale)
voxels = alula.voxelize(scene, size_m=size_m)
cover = alula.merge(voxels, hulls=100)
proof = alula.verify(cover, voxels=voxels, scene=scene)
run = alula.simulate(cover, scene=scene, trials=20, settings={"vehicle.radius_m": 0.1}).check()
print(scene, cover, proof, run, sep="\n")
