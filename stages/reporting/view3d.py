"""The 3D view of a report: hulls, Gaussians and paths as one self-contained page."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.artifact import Artifact
from alula.stages.compression.facets import Mesh, mesh
from alula.stages.planning.trajectory import evaluate
from alula.stages.reporting.curves import Path, paths_of, plan_positions, thin
from alula.stages.reporting.fenced import FenceShape, fence_shape
from alula.stages.reporting.figures import COLORS
from alula.stages.reporting.material import NOT_JUDGED, OUTCOMES, Material

_MAX_POINTS = 100_000
_MAX_TRIANGLES = 300_000
_HULL_COLORS = np.array([0x8FA6BF, 0xA9B8A0, 0xC2AE94, 0xA79BBD, 0x93B5B5, 0xBF9C9C], np.uint32)


@dataclass(frozen=True, slots=True)
class View:
    """A page that shows the scene in 3D, and a note on what it leaves out."""

    html: str
    note: str


def view(material: Material) -> View | None:
    """Make the 3D view; None when there is nothing to show.

    The same material gives the same text: object numbers and the title, which k3d derives from
    memory addresses and the clock, are replaced.
    """
    paths = [path for run in material.runs for path in paths_of(run)]
    if material.plan is not None:
        paths.append(Path("plan", "planned", thin(plan_positions(material.plan))))
    paths = [path for path in paths if len(path.position_world)]
    if material.cover is None and material.scene is None and not paths:
        return None
    top = max((float(path.position_world[:, 2].max()) for path in paths), default=np.inf)
    objects, notes = [], []
    if material.cover is not None:
        edge = float(material.cover.manifest.voxel_size_m)  # type: ignore[attr-defined]
        solid, shown = merged(mesh(material.cover))
        hulls = len(material.cover["plane_start"]) - 1
        if shown < hulls:
            notes.append(f"the {shown:,} largest of {hulls:,} hulls")
        objects += _hull_objects(solid, edge, top)
    if material.scene is not None:
        points, colors = sample(material.scene)
        if len(points) < len(material.scene["mean"]):
            notes.append(f"{len(points):,} of {len(material.scene['mean']):,} Gaussians")
        objects += _cloud_objects(points, colors, top)
    fences = [shape for run in material.runs if (shape := fence_shape(run)) is not None]
    objects += _fence_objects(list({shape.corners_world.tobytes(): shape for shape in fences}.values()))
    if material.plan is not None:
        objects += _corridor_objects(material.plan)
    objects += _path_objects(paths)
    note = f"Shown: {' and '.join(notes)}." if notes else ""
    if any(not item.visible for item in objects):
        note += " Parts above the flights are hidden at first; show them under Objects in the panel."
    return View(_page(objects), note.strip())


@dataclass(frozen=True, slots=True)
class Solid:
    """Meshes of many hulls as one: points [voxels], triangles, and a colour and a height per point."""

    points_voxel: NDArray[np.float64]
    triangles: NDArray[np.int64]
    colors: NDArray[np.uint32]
    bottom_voxel: NDArray[np.float64]  # lowest z of the hull that each point belongs to


def merged(meshes: Mesh, maximum: int = _MAX_TRIANGLES) -> tuple[Solid, int]:
    """Merge hulls into one mesh of at most `maximum` triangles, the largest hulls first.

    Returns:
        The mesh and the number of hulls in it.
    """
    counts = np.diff(meshes.triangle_start)
    hull = np.repeat(np.arange(len(counts)), counts)
    owner = np.repeat(np.arange(len(meshes)), np.diff(meshes.point_start))
    keep = np.ones(len(counts), np.bool_)
    starts = meshes.point_start[:-1]
    low = np.minimum.reduceat(meshes.points_voxel, starts, axis=0) if len(counts) else np.empty((0, 3))
    if counts.sum() > maximum:
        high = np.maximum.reduceat(meshes.points_voxel, starts, axis=0)
        order = np.argsort(-np.prod(high - low, axis=1), kind="stable")
        keep[order] = np.cumsum(counts[order]) <= maximum
    kept_points = keep[owner]
    renumber = np.cumsum(kept_points) - 1
    return (
        Solid(
            meshes.points_voxel[kept_points],
            renumber[meshes.triangles[keep[hull]]],
            _HULL_COLORS[owner[kept_points] % len(_HULL_COLORS)],
            low[owner[kept_points], 2],
        ),
        int(keep.sum()),
    )


def sample(scene: Artifact, maximum: int = _MAX_POINTS) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
    """Centres (n, 3) and colours (n,) (0xRRGGBB) of at most `maximum` Gaussians, evenly over the rows."""
    mean, color = np.asarray(scene["mean"]), np.asarray(scene["color"]).astype(np.uint32)
    rows = np.arange(len(mean))
    if len(mean) > maximum:
        rows = np.linspace(0, len(mean) - 1, maximum).round().astype(np.int64)
    packed = (color[rows, 0] << 16) | (color[rows, 1] << 8) | color[rows, 2]
    return mean[rows], packed


def _hull_objects(solid: Solid, edge: float, top: float) -> list[Any]:
    import k3d

    objects = []
    above = solid.bottom_voxel * edge >= top
    for name, hidden in (("hulls", False), ("hulls above the flights", True)):
        rows = above[solid.triangles[:, 0]] == hidden
        if not rows.any():
            continue
        used = np.flatnonzero(above == hidden)
        renumber = np.zeros(len(above), np.uint32)
        renumber[used] = np.arange(len(used))
        objects.append(
            k3d.mesh(
                (solid.points_voxel[used] * edge).astype(np.float32),
                renumber[solid.triangles[rows]],
                colors=solid.colors[used],
                opacity=0.3,
                flat_shading=True,
                name=name,
                visible=not hidden,
            )
        )
    return objects


def _cloud_objects(points: NDArray[np.float32], colors: NDArray[np.uint32], top: float) -> list[Any]:
    import k3d

    size = max(float(np.median(np.ptp(points, axis=0))) if len(points) > 1 else 1.0, 1e-3) / 350
    objects = []
    for name, hidden in (("Gaussians", False), ("Gaussians above the flights", True)):
        rows = (points[:, 2] >= top) == hidden
        if rows.any():
            shown = {"point_size": size, "shader": "flat", "name": name, "visible": not hidden}
            objects.append(k3d.points(points[rows], colors=colors[rows], **shown))
    return objects


def _fence_objects(shapes: Sequence[FenceShape]) -> list[Any]:
    import k3d

    return [
        k3d.mesh(
            shape.corners_world.astype(np.float32),
            shape.triangles.astype(np.uint32),
            color=0x1A8CCC,
            opacity=0.12,
            side="double",
            flat_shading=True,
            name="fence",
        )
        for shape in shapes
    ]


def _corridor_objects(plan: Artifact) -> list[Any]:
    """The cells of a plan's corridor as one transparent mesh."""
    import k3d

    corner, triangle = corridor_mesh(plan)
    if not len(triangle):
        return []
    return [
        k3d.mesh(
            corner.astype(np.float32),
            triangle.astype(np.uint32),
            color=0x2E9E5B,
            opacity=0.08,
            side="double",
            flat_shading=True,
            name="corridor",
        )
    ]


def corridor_mesh(plan: Artifact) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Corners, shape (V, 3) [m], and triangles, shape (F, 3), of the cells that pieces of a plan lie in."""
    from scipy.spatial import ConvexHull, HalfspaceIntersection

    corners, triangles, count = [np.empty((0, 3))], [np.empty((0, 3), np.int64)], 0
    time, cell = np.asarray(plan["time"]), np.asarray(plan.arrays.get("piece_cell", np.empty(0, np.int64)))
    middle = evaluate(time, plan["coefficient"], 0.5 * (time[:-1] + time[1:]))[:, :3]
    for number in np.unique(cell[cell >= 0]).tolist():
        rows = slice(*np.asarray(plan["cell_start"])[number : number + 2])
        planes = np.column_stack([plan["cell_normal"][rows], -np.asarray(plan["cell_offset"])[rows]])
        inside = middle[cell == number].mean(axis=0)
        if (planes[:, :3] @ inside + planes[:, 3]).max() >= -1e-6:
            continue  # too thin to show
        corner = HalfspaceIntersection(planes, inside).intersections
        triangles.append(ConvexHull(corner).simplices + count)
        corners.append(corner)
        count += len(corner)
    return np.concatenate(corners), np.concatenate(triangles)


def _path_objects(paths: Sequence[Path]) -> list[Any]:
    import k3d

    objects = []
    spans = [np.ptp(path.position_world, axis=0).max() for path in paths]
    width = max(0.02, float(max(spans, default=0.0)) / 300)  # visible in flights over hundreds of metres too
    for outcome in (*OUTCOMES, NOT_JUDGED, "planned"):
        own = [path.position_world.astype(np.float32) for path in paths if path.outcome == outcome]
        if not own:
            continue
        color = int(COLORS[outcome][1:], 16)
        segments = _segments([len(points) for points in own])
        if len(segments):
            objects.append(
                k3d.lines(
                    np.concatenate(own),
                    segments,
                    indices_type="segment",
                    color=color,
                    width=width,
                    shader="mesh",
                    name=f"paths: {outcome}",
                )
            )
        for what, row in (("starts", 0), ("ends", -1)):
            ends = np.array([points[row] for points in own])
            objects.append(
                k3d.points(ends, color=color, point_size=4 * width, shader="3d", name=f"{what}: {outcome}")
            )
    return objects


def _segments(lengths: Iterable[int]) -> NDArray[np.uint32]:
    """Pairs of consecutive rows of paths that are stored one after the other."""
    pairs, at = [np.empty((0, 2), np.uint32)], 0
    for length in lengths:
        rows = np.arange(at, at + length, dtype=np.uint32)
        pairs.append(np.stack([rows[:-1], rows[1:]], axis=1))
        at += length
    return np.concatenate(pairs)


def _page(objects: Sequence[Any]) -> str:
    import k3d

    plot = k3d.plot(snapshot_type="full", background_color=0xFAFBFC, grid_visible=True, camera_auto_fit=False)
    for number, item in enumerate(objects, 1):
        item.id = number
        plot += item
    plot.camera = plot.get_auto_camera(yaw=-60, pitch=50, factor=1.1)
    page: str = plot.get_snapshot()
    # k3d's style sheet names fallback fonts beside the page, which do not exist; browsers would request them.
    page = page.replace("eval(k3dSource);", "eval(k3dSource.split('url(fonts/').join('url(data:,'));")
    return re.sub(r"<title>.*?</title>", "<title>3D view</title>", page, count=1, flags=re.DOTALL)
