"""Scenes to compress: hoops, the built-in room and a garden of any size, all generated from a seed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from measure import FloatArray

from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.manifest import Similarity
from alula.schemas.parameters.configs.demo_scene import DemoSceneConfig
from alula.schemas.parameters.configs.import_splat import ImportSplatConfig
from alula.schemas.parameters.configs.scale_align import ScaleAlignConfig
from alula.schemas.parameters.configs.voxelize import VoxelizeConfig
from alula.stages.alignment.scale_align import scale_align
from alula.stages.compression.voxelize import voxelize
from alula.stages.reconstruction.demo_scene import demo_scene, world_from_scene
from alula.stages.reconstruction.formats.registry import read_splats
from alula.stages.reconstruction.formats.splats import Splats
from alula.stages.reconstruction.import_splat import import_splat
from alula.stages.reconstruction.room import HOOP_TUBE_M, HOOPS
from alula.stages.reconstruction.surfaces import disc, plain, torus, tube
from alula.stages.rotation import quat_wxyz_from_matrix

MIN_OPACITY, MIN_OVERLAP = 0.1, 3
METRIC = Similarity(scale=1.0, rotation=np.eye(3).tolist(), translation_m=[0.0, 0.0, 0.0])

_GARDEN_PER_M2 = 5200.0  # Gaussians over ground: 1.5 million are a garden of 17 m x 17 m
_TREE_M2 = 12.0
_CLUMPS = 40  # of leaves in a crown
_FRACTIONS = {"terrain": 0.5, "trunk": 0.05, "leaf": 0.44, "haze": 0.01}

# Real scenes under ALULA_DATA: metres per unit and voxel edge [m] that give some ten thousand voxels.
REAL = {
    "istanbul-outdoor/tile_x000_y003.splat": (1.0, 0.25),
    "istanbul-outdoor/tile_x001_y000.splat": (1.0, 0.25),
    "cc0-corpus/leica-sofort-top8192.ply": (1.0, 0.1),
}


def metric(splats: Splats, similarity: Similarity = METRIC, *, drop_floaters: bool = False) -> Artifact:
    """Convert a splat to a scene in metres."""
    config = ImportSplatConfig(min_opacity=MIN_OPACITY, drop_floaters=drop_floaters)
    return scale_align(ScaleAlignConfig(), import_splat(config, splats), similarity, 0)


def voxels_of(scene: Artifact, size_m: float, min_overlap: int = MIN_OVERLAP) -> Artifact:
    """Mark occupied voxels with the benchmark's parameters."""
    return voxelize(VoxelizeConfig(size_m=size_m, min_overlap=min_overlap, ignore_loss=True), scene)


def room(gaussians: int) -> Artifact:
    """Make the built-in scene without floaters."""
    splats = demo_scene(DemoSceneConfig(gaussians=gaussians), 0)
    return metric(splats, world_from_scene(), drop_floaters=True)


def real(path: Path, scale: float) -> Artifact:
    """Read a scene of a real camera, in its own frame."""
    similarity = Similarity(scale=scale, rotation=METRIC.rotation, translation_m=METRIC.translation_m)
    return metric(read_splats(path), similarity)


def hoops(count: int, gaussians: int) -> Artifact:
    """Make the first `count` hoops of the built-in scene on their stands."""
    surfaces = []
    for hoop in HOOPS[:count]:
        (x, y, z), paint = hoop.centre, plain(hoop.color)
        surfaces += [
            torus(hoop.centre, hoop.axis, hoop.radius_m, HOOP_TUBE_M, paint),
            tube((x, y, 0.0), 0.02, z - hoop.radius_m, paint),
            disc((x, y, 0.015), 0.18, paint),
        ]
    rng = np.random.default_rng(0)
    area = np.array([surface.area for surface in surfaces])
    rows = np.diff(np.rint(np.cumsum(area) / area.sum() * gaussians).astype(int), prepend=0)
    found = [s.sample(*rng.random((2, n))) for s, n in zip(surfaces, rows, strict=True)]
    mean, normal = (np.vstack(part) for part in zip(*found, strict=True))
    return metric(_splats(mean, _flat(normal, rng), rng.uniform(0.005, 0.012, (len(mean), 2)), rng))


def garden(gaussians: int) -> Splats:
    """Make rolling ground with trees, of the same density at any size: voxels grow like Gaussians.

    Half of the Gaussians are flat on the ground, 44 % leaves in clumps, 5 % bark and 1 % faint haze,
    which an import with the default minimum opacity leaves out. Metres, z up.
    """
    rng = np.random.default_rng(0)
    ends = np.rint(np.cumsum([0.0, *_FRACTIONS.values()]) * gaussians).astype(int)
    terrain, trunk, leaf, haze = np.diff(ends)
    side = float(np.sqrt(gaussians / _GARDEN_PER_M2))
    trees = max(1, round(side * side / _TREE_M2))

    ground = rng.uniform(0, side, (terrain, 2))
    height, slope = _height(ground)
    parts = [(np.column_stack([ground, height]), np.column_stack([-slope, np.ones(terrain)]), 0.015, 0.035)]

    steps = np.arange(trees)[:, None] * np.array([0.7548776662466927, 0.5698402909980532])
    foot = side * (0.08 + 0.84 * ((steps + 0.5) % 1.0))
    base = _height(foot)[0]
    radius, tall = rng.uniform(0.08, 0.16, trees), rng.uniform(2.0, 3.2, trees)
    tree, angle = rng.integers(trees, size=trunk), rng.uniform(0, 2 * np.pi, trunk)
    outward = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(trunk)])
    up = rng.uniform(-0.1, 1.0, trunk) * tall[tree]
    bark = np.column_stack([foot[tree], base[tree] + up]) + radius[tree, None] * outward
    parts.append((bark, outward, 0.010, 0.025))

    crown = rng.normal(size=(trees, _CLUMPS, 3))
    crown *= (rng.random((trees, _CLUMPS)) ** (1 / 3) / np.linalg.norm(crown, axis=2))[..., None]
    crown *= rng.uniform(0.9, 1.4, (trees, 1, 1)) * np.array([1.0, 1.0, 0.8])
    crown += np.column_stack([foot, base + tall + 0.5])[:, None, :]
    tree, clump = rng.integers(trees, size=leaf), rng.integers(_CLUMPS, size=leaf)
    leaves = crown[tree, clump] + 0.09 * rng.normal(size=(leaf, 3))
    parts.append((leaves, rng.normal(size=(leaf, 3)), 0.008, 0.030))

    air = rng.uniform(0, 1, (haze, 3)) * np.array([side, side, 6.0])
    parts.append((air, rng.normal(size=(haze, 3)), 0.02, 0.08))
    mean = np.vstack([p[0] for p in parts])
    along = np.vstack([rng.uniform(low, high, (len(p), 2)) for p, _, low, high in parts])
    axes = _flat(np.vstack([p[1] for p in parts]), rng)
    opacity = np.repeat([0.9, 0.9, 0.7, 0.05], [terrain, trunk, leaf, haze])
    return _splats(mean, axes, along, rng, opacity)


def _height(place: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Height of the ground and its gradient, shapes (n,) and (n, 2) [m]."""
    wave = np.array([[0.21, 0.13], [-0.34, 0.47], [0.9, 0.7], [-1.7, 2.3], [4.1, -3.3]])
    swing = np.array([0.9, 0.45, 0.16, 0.06, 0.02])
    phase = place @ wave.T + np.arange(len(wave))
    return np.sin(phase) @ swing, (np.cos(phase) * swing) @ wave


def _flat(normal: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Rotations with the normal as third axis and random other axes, shape (n, 3, 3)."""
    third = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    first = np.cross(third, rng.normal(size=third.shape))
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(third, first), third], axis=2)


def _splats(
    mean: FloatArray,
    axes: FloatArray,
    along: FloatArray,
    rng: np.random.Generator,
    opacity: FloatArray | None = None,
) -> Splats:
    """Make flat Gaussians, 1 to 3 mm thick, in random order as after a training run."""
    order = rng.permutation(len(mean))
    scale = np.column_stack([along, rng.uniform(0.001, 0.003, len(mean))])
    return Splats(
        format="ply",
        mean=mean[order].astype(np.float32),
        scale=scale[order].astype(np.float32),
        quat_wxyz=quat_wxyz_from_matrix(axes)[order].astype(np.float32),
        opacity=(np.full(len(mean), 0.9) if opacity is None else opacity[order]).astype(np.float32),
        color=np.full((len(mean), 3), 128, np.uint8),
    )
