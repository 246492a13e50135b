"""The comparisons, one function per stage; each checks that both sides give the same answer."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from measure import Row, counted, in_turns, peak_memory, timed
from peers import NumpyFilter, box_voxels, ply_arrays, voxel_keys, write_inria_ply

from alula import _core
from alula.schemas.artifacts.artifact import Artifact, write_artifact
from alula.schemas.parameters.configs.demo_scene import DemoSceneConfig
from alula.schemas.parameters.configs.import_splat import ImportSplatConfig
from alula.schemas.parameters.configs.merge import MergeConfig
from alula.schemas.parameters.configs.scale_align import ScaleAlignConfig
from alula.schemas.parameters.configs.voxelize import VoxelizeConfig
from alula.stages.alignment.scale_align import scale_align
from alula.stages.clearance import hull_obstacles, path_clearance
from alula.stages.compression.hulls import Hulls
from alula.stages.compression.merge import merge
from alula.stages.compression.verify import verify
from alula.stages.compression.voxelize import voxelize
from alula.stages.reconstruction.demo_scene import demo_scene, world_from_scene
from alula.stages.reconstruction.formats.registry import read_splats
from alula.stages.reconstruction.import_splat import import_splat

ROOM_M = np.array([8.0, 6.0, 3.0])
MIN_OPACITY = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class Sizes:
    """Extent of the measurement."""

    runs: int
    import_rows: tuple[int, ...]
    gaussians: int
    voxel_m: float
    hulls: int
    growth_voxels: tuple[int, ...]
    queries: int


FULL = Sizes(
    runs=5,
    import_rows=(150_000, 600_000),
    gaussians=200_000,
    voxel_m=0.05,
    hulls=300,
    growth_voxels=(20_000, 50_000, 120_000, 300_000),
    queries=1000,
)
QUICK = Sizes(
    runs=2,
    import_rows=(10_000,),
    gaussians=20_000,
    voxel_m=0.12,
    hulls=60,
    growth_voxels=(3_000, 10_000),
    queries=100,
)


def room(gaussians: int) -> Artifact:
    """Make the built-in scene in metres."""
    config = ImportSplatConfig(min_opacity=MIN_OPACITY, drop_floaters=True)
    scene = import_splat(config, demo_scene(DemoSceneConfig(gaussians=gaussians), 0))
    return scale_align(ScaleAlignConfig(), scene, world_from_scene(), 0)


def importing(sizes: Sizes, folder: Path) -> Iterator[Row]:
    """Compare decoding and checking a splat file with reading its bytes."""
    path = folder / "splat.ply"
    for count in sizes.import_rows:
        write_inria_ply(path, demo_scene(DemoSceneConfig(gaussians=count), 0))
        (scene, _), seconds = in_turns(
            [partial(_import, path), partial(np.fromfile, path, np.uint8)],
            sizes.runs,
        )
        expected = ply_arrays(path, MIN_OPACITY)
        yield timed(
            f"import-splat, {count:,} rows",
            "numpy.fromfile of the same bytes",
            *seconds.T,
            agrees=all(np.array_equal(scene[name], values) for name, values in expected.items()),
            check="arrays equal bit for bit to those of a structured numpy read",
            rows=count,
            megabytes=path.stat().st_size / 1e6,
        )
    path.unlink()


def _import(path: Path) -> Artifact:
    return import_splat(ImportSplatConfig(min_opacity=MIN_OPACITY), read_splats(path))


def voxelizing(sizes: Sizes, scene: Artifact) -> Iterator[Row]:
    """Compare exact voxels with those of bounding boxes."""
    size = sizes.voxel_m
    (voxels, boxes), seconds = in_turns(
        [
            lambda: voxelize(VoxelizeConfig(size_m=size), scene, jobs=1),
            lambda: box_voxels(scene, size),
        ],
        sizes.runs,
    )
    contained = bool(np.isin(voxel_keys(voxels["index"]), boxes, assume_unique=True).all())
    check = "no voxel outside the bounding boxes"
    yield timed(
        f"voxelize, {len(scene['mean']):,} Gaussians at {size} m",
        "bounding boxes in numpy",
        *seconds.T,
        agrees=contained,
        check=check,
        ns_per_gaussian=float(np.median(seconds[:, 0])) / len(scene["mean"]) * 1e9,
    )
    yield counted(
        "voxelize, marked",
        "voxels",
        "bounding boxes in numpy",
        len(voxels["index"]),
        len(boxes),
        agrees=contained,
        check=check,
    )


def merging(sizes: Sizes, scene: Artifact, voxels: Artifact) -> Iterator[Row]:
    """Compare the default rule with the paper's at equal n, and verifying with merging."""
    ours = MergeConfig(hulls=sizes.hulls)
    cover = merge(ours, voxels, jobs=1)
    (cover, paper, certificate), seconds = in_turns(
        [
            lambda: merge(ours, voxels, jobs=1),
            lambda: merge(MergeConfig(hulls=sizes.hulls, method="paper"), voxels, jobs=1),
            lambda: verify(cover, voxels=voxels, scene=scene, jobs=1),
        ],
        sizes.runs,
    )
    both = certificate.covered and verify(paper, voxels=voxels, jobs=1).covered
    found = [Hulls.from_cover(c) for c in (cover, paper)]
    subject = f"merge {len(voxels['index']):,} voxels to {sizes.hulls} hulls"
    check = "both covers pass verify"
    yield timed(subject, "--method paper", seconds[:, 0], seconds[:, 1], agrees=both, check=check)
    yield counted(
        "merge, excess of the union",
        "of V+",
        "--method paper",
        *(c.manifest.conservativeness - 1 for c in (cover, paper)),
        agrees=both,
        check=check,
        hulls=len(found[0]),
        hulls_paper=len(found[1]),
    )
    yield counted(
        "merge, half-planes",
        "planes",
        "--method paper",
        *(len(hulls.offset_m) for hulls in found),
        agrees=both,
        check=check,
    )
    yield timed(
        "verify with voxels and scene",
        "merge",
        seconds[:, 2],
        seconds[:, 0],
        agrees=certificate.covered,
        check="the certificate holds",
    )


def growth(sizes: Sizes, scene: Artifact, voxels: Artifact) -> Row:
    """Compare the growth of merge's cost with the number of voxels with N log N."""
    counts: list[int] = []
    inputs: list[Artifact] = []
    for wanted in sizes.growth_voxels:
        size = sizes.voxel_m * float(
            np.sqrt(len(voxels["index"]) / wanted)
        )  # surfaces: the count is ~ 1 / g^2
        inputs.append(voxelize(VoxelizeConfig(size_m=size), scene, jobs=1))
        counts.append(len(inputs[-1]["index"]))
    config = MergeConfig(hulls=sizes.hulls)
    covers, seconds = in_turns([partial(merge, config, v, jobs=1) for v in inputs], min(3, sizes.runs))
    logarithm = np.log(np.array(counts, np.float64))
    exponent = np.array([np.polyfit(logarithm, np.log(row), 1)[0] for row in seconds])
    reference = float(np.polyfit(logarithm, np.log(np.exp(logarithm) * logarithm), 1)[0])
    return timed(
        f"merge, growth from {counts[0]:,} to {counts[-1]:,} voxels",
        "N log N",
        exponent,
        np.full_like(exponent, reference),
        unit="exponent",
        per=1.0,
        agrees=all(verify(c, voxels=v, jobs=1).covered for c, v in zip(covers, inputs, strict=True)),
        check="every cover passes verify",
        **{f"seconds_{n}": float(s) for n, s in zip(counts, np.median(seconds, axis=0), strict=True)},
    )


def filtering(sizes: Sizes, hulls: Hulls) -> Iterator[Row]:
    """Compare a filter step that skips boxes with all planes in the same C code, and with numpy."""
    rng = np.random.default_rng(0)
    x = rng.uniform(0.05, 0.95, (sizes.queries, 3)) * ROOM_M
    u_nom = rng.normal(size=(sizes.queries, 3))
    queries = list(zip(x.tolist(), u_nom.tolist(), strict=True))
    planes = (hulls.normal_world, hulls.offset_m, hulls.plane_start)
    options: dict[str, Any] = {"radius_m": 0.15, "beta": 2.0, "kappa": 100.0, "dt_s": 0.02, "v_max": 1.0}
    native = [
        _core.PolytopeCbf(*planes, extent_m=20.0, **options, brute_force=brute) for brute in (False, True)
    ]
    plain = NumpyFilter(hulls, **options)

    def by_native(filter_: Any) -> list[Any]:
        return [filter_.filter(p, u) for p, u in queries]

    (ours, brute, numpy), seconds = in_turns(
        [
            lambda: by_native(native[0]),
            lambda: by_native(native[1]),
            lambda: [plain(p, u) for p, u in zip(x, u_nom, strict=True)],
        ],
        sizes.runs,
    )
    subject = f"polytope-cbf step among {len(hulls)} hulls, {len(hulls.offset_m):,} planes"
    figures: dict[str, Any] = {"unit": "us", "per": 1e-6 * len(queries)}
    yield timed(
        subject,
        "all planes, same C code",
        *seconds.T[:2],
        agrees=ours == brute,
        check="equal bit for bit",
        **figures,
    )
    margin, reference = np.array([o[2] for o in ours]), np.array([n[1] for n in numpy])
    binds = options["beta"] * margin < options["v_max"]  # beyond that, ours is a lower bound of the margin
    off = float(np.where(binds, np.abs(margin - reference), margin - reference).max())
    input_off = float(np.abs(np.array([o[0] for o in ours]) - np.array([n[0] for n in numpy])).max())
    yield timed(
        subject,
        "numpy, double precision",
        seconds[:, 0],
        seconds[:, 2],
        agrees=off < 1e-4 and bool(binds.any()) and input_off < 1e-2,
        check="margin within 0.1 mm where the row can become active, else not above; input within 1 cm/s",
        largest_margin_difference_m=off,
        largest_input_difference_m_s=input_off,
        **figures,
    )


def clearance(sizes: Sizes, hulls: Hulls) -> Row:
    """Compare the exact clearance of a path by the tree with measuring every hull."""
    t = np.linspace(0, 1, sizes.queries + 1)[:, None]
    path = ROOM_M * (0.5 + 0.45 * np.sin(2 * np.pi * t * np.array([3.0, 5.0, 7.0])))
    tree = hull_obstacles(hulls)
    single = [hull_obstacles(_only(hulls, i)) for i in range(len(hulls))]
    (ours, brute), seconds = in_turns(
        [
            lambda: path_clearance(path, tree, jobs=1),
            lambda: np.min([path_clearance(path, one, jobs=1) for one in single], axis=0),
        ],
        sizes.runs,
    )
    return timed(
        f"clearance of a path of {sizes.queries} segments to {len(hulls)} hulls",
        "every hull, same C++ code",
        *seconds.T,
        agrees=float(np.abs(ours - brute).max()) < 1e-9,
        check="within 1 nm",
    )


def _only(hulls: Hulls, i: int) -> Hulls:
    planes = slice(*hulls.plane_start[i : i + 2])
    vertices = slice(*hulls.vertex_start[i : i + 2])
    return Hulls(
        normal_world=hulls.normal_world[planes],
        offset_m=hulls.offset_m[planes],
        plane_start=np.array([0, planes.stop - planes.start]),
        vertices_world=hulls.vertices_world[vertices],
        vertex_start=np.array([0, vertices.stop - vertices.start]),
    )


_HOLD = """
import sys
from pathlib import Path
from alula.schemas.artifacts.artifact import read_artifact
held = [{name: array.copy() for name, array in read_artifact(Path(p)).arrays.items()} for p in sys.argv[1:]]
"""


def memory(sizes: Sizes, folder: Path, scene: Artifact, voxels: Artifact) -> Iterator[Row]:
    """Compare the peak memory of the commands with holding their input and output."""
    source, marked, cover = (folder / f"room.{kind}.npz" for kind in ("scene", "voxels", "cover"))
    write_artifact(source, scene)
    write_artifact(marked, voxels)
    for name, given, made, options in (
        ("voxelize", source, folder / "out.voxels.npz", ["--size", str(sizes.voxel_m)]),
        ("merge", marked, cover, ["--hulls", str(sizes.hulls)]),
    ):
        ours = peak_memory(["-m", "alula.cli", name, "-q", str(given), "-o", str(made), *options])
        reference = peak_memory(["-c", _HOLD, str(given), str(made)])
        yield counted(
            f"{name}, peak memory",
            "MB",
            "holding input and output",
            ours / 1e6,
            reference / 1e6,
            agrees=made.exists(),
            check="the command wrote its output",
        )


def all_rows(sizes: Sizes, folder: Path) -> Iterator[Row]:
    """Run every comparison, in the order of the pipeline."""
    yield from importing(sizes, folder)
    scene = room(sizes.gaussians)
    yield from voxelizing(sizes, scene)
    voxels = voxelize(VoxelizeConfig(size_m=sizes.voxel_m), scene, jobs=1)
    yield from merging(sizes, scene, voxels)
    yield growth(sizes, scene, voxels)
    hulls = Hulls.from_cover(merge(MergeConfig(hulls=sizes.hulls), voxels, jobs=1))
    yield from filtering(sizes, hulls)
    yield clearance(sizes, hulls)
    yield from memory(sizes, folder, scene, voxels)
