"""The still picture of a report: splat or hulls, fence and paths, seen obliquely from above.

It is a drawing, so every browser and every printer shows it. The projection is parallel, so its scale holds
everywhere. Ceiling and walls nearest to the viewer are left out, so that one sees inside.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.artifact import Artifact
from alula.stages.reporting.curves import Path, paths_of, plan_positions, thin
from alula.stages.reporting.fenced import FenceShape, fence_shape
from alula.stages.reporting.figures import STILL, Figure, all_figures, drawing
from alula.stages.reporting.flight_figures import flight_figures
from alula.stages.reporting.material import NOT_JUDGED, OUTCOMES, Material
from alula.stages.reporting.palette import BLACK, COLORS, DASHES, PURPLE, SOFT, run_color
from alula.stages.show.drawing.content import Part
from alula.stages.show.drawing.picture import model_of, translucent
from alula.stages.show.drawing.sight import Sight
from alula.stages.show.drawing.solids import drawn, solids_of_cover
from alula.stages.show.drawing.splat import chosen, gaussians

_AZIMUTH, _ELEVATION = np.deg2rad([-60.0, 48.0])  # of the viewer, seen from the scene
_MOST_GAUSSIANS = 500_000
_HULL_COLOR = (218, 228, 242)
_PX_PER_INCH = 110  # of splat and hulls
_WALL = 0.035  # of the extent: what is left out at the sides that face the viewer
_CEILING = 0.7  # of the height: what is left out above it, and above all flights
_FEW_PATHS = 40  # more are drawn thinner
_ANY_DEPTH_M = 1e12  # in front of everything
_WIDTH, _MIN_HEIGHT, _MAX_HEIGHT = 9.5, 4.2, 7.4  # of the drawing [inch]
_FENCE = (0.8, 0.475, 0.655)  # of its faces
_AROUND = 0.12  # of the extent of the flights: what is shown of a fence beyond them


# Parallel projection: _ALONG points away from the viewer, _RIGHT and _UP span the picture.
_RIGHT = np.array([-np.sin(_AZIMUTH), np.cos(_AZIMUTH), 0.0])
_ALONG = -np.array(
    [np.cos(_ELEVATION) * np.cos(_AZIMUTH), np.cos(_ELEVATION) * np.sin(_AZIMUTH), np.sin(_ELEVATION)]
)
_UP = np.cross(-_ALONG, _RIGHT)


def _flat(points: FloatArray) -> FloatArray:
    """Project points, shape (n, 3), to the picture, shape (n, 2) [m]."""
    return np.column_stack([points @ _RIGHT, points @ _UP])


def draw(material: Material) -> list[Figure]:
    """Draw all figures of a report, in reading order: the still picture, single flights, and the others."""
    picture = still(material)
    return [*([picture] if picture is not None else []), *flight_figures(material), *all_figures(material)]


def still(material: Material) -> Figure | None:
    """Draw the picture; None when there is nothing to see."""
    flown = [(number, path) for number, run in enumerate(material.runs) for path in paths_of(run)]
    flown = [(number, path) for number, path in flown if len(path.position_world)]
    planned = thin(plan_positions(material.plan)) if material.plan is not None else np.empty((0, 3))
    lines = [path.position_world for _, path in flown] + ([planned] if len(planned) else [])
    world = _world(material)
    if not lines and not len(world):
        return None
    top = max([float(line[:, 2].max()) for line in lines] + ([_height(world)] if len(world) else []))
    shapes = [shape for run in material.runs if (shape := fence_shape(run)) is not None]
    shapes = list({shape.corners_world.tobytes(): shape for shape in shapes}.values())
    faces = [face for shape in shapes for face in faces_near(shape, lines)] if lines else []
    frame_top = top if material.scene is not None else np.inf
    shown = lines + [face for face, _ in faces]
    low, high = _frame(shown, world, frame_top, fenced=bool(faces))
    size = high - low
    height = float(np.clip(_WIDTH * size[1] / size[0], _MIN_HEIGHT, _MAX_HEIGHT))
    words: list[str] = []
    with drawing(_WIDTH, height) as (axes, render):
        axes.set_axis_off()
        parts, said = _world_parts(material, top)
        if parts:
            _draw_world(axes, parts, low, high, height)
        words += [said] if said else []
        if faces:
            _draw_fence(axes, faces)
            words.append("the fence")
        _draw_paths(axes, flown, planned, [run.label for run in material.runs])
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
        _draw_scale(axes, low, high)
        if lines:
            axes.legend(loc="upper left", fontsize="medium", handlelength=1.6)
        svg = render()
    if flown:
        everything = max(len(flown), sum(len(run.record.trials) for run in material.runs))
        of = f" of {everything:,}" if everything > len(flown) else ""
        words.append(f"{len(flown):,}{of} flown {'path' if everything == 1 else 'paths'}")
    if len(planned):
        words.append("the plan")
    alt = f"Seen from above at an angle: {', '.join(words)}."
    alt += " Ceiling and near walls are left out." if len(world) else ""
    alt += " Circles are starts, crosses ends." if lines else ""
    return Figure(STILL, material.title, alt, svg, wide=True)


def _world(material: Material) -> FloatArray:
    """Points that stand for the world's extent, shape (n, 3) [m]."""
    if material.scene is not None:
        mean = material.scene["mean"]
        return np.asarray(mean[:: max(1, len(mean) // 20_000)], np.float64)
    if material.cover is not None:
        edge = float(material.cover.manifest.voxel_size_m)  # type: ignore[attr-defined]
        return np.asarray(material.cover["vertex"], np.float64) * edge
    return np.empty((0, 3))


def _height(world: FloatArray) -> float:
    low, high = np.percentile(world[:, 2], [1, 99])
    return float(low + _CEILING * (high - low))


def _frame(
    lines: Sequence[FloatArray], world: FloatArray, top: float, *, fenced: bool
) -> tuple[FloatArray, FloatArray]:
    """Lower and upper corner of the picture: the world, or in a fence the flights with room around them."""
    shown = list(lines)
    if len(world) and not fenced:
        low, high = np.percentile(world, [0.5, 99.5], axis=0)
        high[2] = min(high[2], top)
        corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
        shown.append(corners)
    flat = _flat(np.concatenate(shown))
    low, high = flat.min(axis=0), flat.max(axis=0)
    pad = 0.03 * (high - low).max() if len(world) and not fenced else 0.08 * (high - low).max()
    low, high = low - max(pad, 1e-3), high + max(pad, 1e-3)
    # a picture that is too wide or too tall gets room at its sides
    size, middle = high - low, 0.5 * (low + high)
    size = np.array(
        [max(size[0], size[1] * _WIDTH / _MAX_HEIGHT), max(size[1], size[0] * _MIN_HEIGHT / _WIDTH)]
    )
    return middle - 0.5 * size, middle + 0.5 * size


def _is_inside(points: NDArray[np.floating[Any]], top: float) -> NDArray[np.bool_]:
    """Mark the points below `top` that are not at the sides of the world that face the viewer."""

    def column(axis: int) -> FloatArray:
        return points[:, axis].astype(np.float64)

    keep: NDArray[np.bool_] = column(2) <= top
    if not len(points):
        return keep
    low, high = np.transpose(
        [np.percentile(column(axis), [0.5, 99.5], overwrite_input=True) for axis in range(2)]
    )
    band = _WALL * (high - low).max()
    for axis in range(2):
        if _ALONG[axis] > 0:
            keep &= column(axis) >= low[axis] + band
        else:
            keep &= column(axis) <= high[axis] - band
    return keep


def _world_parts(material: Material, top: float) -> tuple[list[Part], str]:
    """Splat or hulls without ceiling and near walls, and what they are in words."""
    if material.scene is not None:
        return _gaussians(material.scene, top)
    return ([], "") if material.cover is None else _hulls(material.cover, top)


def _gaussians(scene: Artifact, top: float) -> tuple[list[Part], str]:
    choice = chosen(scene, _MOST_GAUSSIANS)
    is_inside = _is_inside(np.asarray(scene["mean"]), top)
    inside = int(is_inside.sum())
    shown = choice.of(is_inside[choice.row])
    words = f"{len(shown.row):,} Gaussians" + (f" of {inside:,}" if inside > len(shown.row) else "")
    return [gaussians("splat", scene, shown)], words


def _hulls(cover: Artifact, top: float) -> tuple[list[Part], str]:
    solids = solids_of_cover(cover)
    low, high = solids.bounds()
    # a hull is left out where its far side is, seen from the viewer: a near wall, or a ceiling
    far = np.where(_ALONG > 0, high, low)
    far[:, 2] = low[:, 2]
    keep = _is_inside_hulls(far, low, high, top)
    words = f"{int(keep.sum()):,} of {len(solids):,} hulls"
    return drawn("hulls", *solids.of(keep), _HULL_COLOR, opacity=1.0), words


def _draw_world(axes: Any, parts: list[Part], low: FloatArray, high: FloatArray, height: float) -> None:
    """Draw splat or hulls as an image between two corners of the picture."""
    size = high - low
    columns, rows = (round(inch * _PX_PER_INCH) for inch in (_WIDTH, height))
    middle = 0.5 * (low + high)
    image = translucent(
        model_of(parts),
        Sight(
            R_camera_world=np.stack([_RIGHT, -_UP, _ALONG]),
            position=middle[0] * _RIGHT + middle[1] * _UP,
            focal=columns / float(size[0]),
            columns=columns,
            rows=rows,
            near_m=-_ANY_DEPTH_M,
            is_parallel=True,
        ),
    )
    reach = 0.5 * np.array([columns, rows]) * size[0] / columns
    box = (middle[0] - reach[0], middle[0] + reach[0], middle[1] - reach[1], middle[1] + reach[1])
    axes.imshow(image, extent=box, aspect="equal", zorder=1)


def _is_inside_hulls(far: FloatArray, low: FloatArray, high: FloatArray, top: float) -> NDArray[np.bool_]:
    if not len(far):
        return np.empty(0, np.bool_)
    world_low, world_high = low.min(axis=0), high.max(axis=0)
    band = 2 * _WALL * (world_high - world_low)[:2].max()
    keep = far[:, 2] < top
    for axis in range(2):
        if _ALONG[axis] > 0:
            keep &= far[:, axis] > world_low[axis] + band
        else:
            keep &= far[:, axis] < world_high[axis] - band
    return keep


def faces_near(shape: FenceShape, paths: Sequence[FloatArray]) -> list[tuple[FloatArray, FloatArray]]:
    """Faces of a fence, cut to a box around the flights.

    Args:
        paths: flown positions, shape (n, 3) each [m].

    Returns:
        Corners of each face, shape (k, 3) [m], in their order around it, and its outward normal.
    """
    points = np.concatenate(paths)
    low, high = points.min(axis=0), points.max(axis=0)
    around = max(_AROUND * float((high - low).max()), 1.0)
    found: dict[tuple[float, ...], list[FloatArray]] = {}
    for triangle in shape.corners_world[shape.triangles]:
        normal = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
        length = float(np.linalg.norm(normal))
        if length > 0:
            plane = np.append(normal, normal @ triangle[0]) / length
            found.setdefault(tuple(plane.round(6).tolist()), []).append(triangle)
    faces = []
    for equation, triangles in found.items():
        normal = np.array(equation[:3])
        face = _clipped(_ordered(np.concatenate(triangles), normal), low - around, high + around)
        if len(face) >= 3:
            faces.append((face, normal))
    return faces


def _draw_fence(axes: Any, faces: Sequence[tuple[FloatArray, FloatArray]]) -> None:
    """Draw the faces of a fence, those behind the flights darker."""
    from matplotlib.collections import PolyCollection

    axes.add_collection(
        PolyCollection(
            [_flat(face) for face, _ in faces],
            facecolors=[(*_FENCE, 0.16 if normal @ _ALONG > 0 else 0.07) for _, normal in faces],
            edgecolors=PURPLE,
            linewidths=1.2,
            label="fence",
            zorder=2,
        )
    )


def _ordered(points: FloatArray, normal: FloatArray) -> FloatArray:
    """Sort the corners of a convex polygon around its middle; points, shape (n, 3), may repeat."""
    points = np.unique(points.round(9), axis=0)
    arm = points - points.mean(axis=0)
    across = np.cross(normal, arm[0])
    return points[
        np.argsort(np.arctan2(arm @ across / max(np.linalg.norm(across), 1e-12), arm @ _unit(arm[0])))
    ]


def _unit(vector: FloatArray) -> FloatArray:
    return vector / max(float(np.linalg.norm(vector)), 1e-12)


def _clipped(polygon: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Cut a convex polygon, shape (n, 3), to a box.

    Source: Sutherland and Hodgman 1974.
    """
    for axis in range(3):
        for sign, limit in ((1.0, high[axis]), (-1.0, -low[axis])):
            if not len(polygon):
                return polygon
            beyond = sign * polygon[:, axis] - limit
            kept = []
            for i in range(len(polygon)):
                a, b, d, e = polygon[i - 1], polygon[i], beyond[i - 1], beyond[i]
                if (d > 0) != (e > 0):
                    kept.append(a + (b - a) * (d / (d - e)))
                if e <= 0:
                    kept.append(b)
            polygon = np.array(kept).reshape(-1, 3)
    return polygon


def _draw_paths(
    axes: Any,
    flown: Sequence[tuple[int, Path]],
    planned: FloatArray,
    labels: Sequence[str],
) -> None:
    """Draw paths by outcome, or by run where there are several."""
    from matplotlib.collections import LineCollection
    from matplotlib.patheffects import Normal, Stroke

    few = len(flown) <= _FEW_PATHS
    width = 2.0 if few else 1.0
    groups: list[tuple[str, str, str, list[FloatArray]]] = []
    if len(labels) > 1:
        for number, label in enumerate(labels):
            own = [path.position_world for n, path in flown if n == number]
            groups.append((label, run_color(number), "-", own))
    else:
        for outcome in (*OUTCOMES, NOT_JUDGED):
            own = [path.position_world for _, path in flown if path.outcome == outcome]
            groups.append((outcome, COLORS[outcome], DASHES[outcome], own))
    # the longest group lies below the others
    groups = sorted((group for group in groups if group[3]), key=lambda group: -len(group[3]))
    if len(planned):
        groups.append(("planned", BLACK, "--", [planned]))
    for order, (label, color, dash, lines) in enumerate(groups):
        name = f"{label} ({len(lines)})" if label != "planned" else label
        thick = width * (1.6 if len(lines) == 1 and len(flown) > 1 else 1)
        drawn = LineCollection(
            [_flat(line) for line in lines],
            linewidths=thick,
            colors=color,
            linestyles=dash,
            label=name,
            alpha=None if few or len(lines) == 1 else 0.75,
            zorder=4 + order,
        )
        if few or len(lines) == 1:
            drawn.set_path_effects([Stroke(linewidth=thick + 1.6, foreground="white", alpha=0.75), Normal()])
        axes.add_collection(drawn)
        ends = [_flat(line[[0, -1]]) for line in lines]
        dot = 30 if few or len(lines) == 1 else 9
        for row, marker, face in ((0, "o", "white"), (1, "X", color)):
            points = np.array([end[row] for end in ends])
            axes.scatter(
                *points.T,
                s=dot,
                marker=marker,
                facecolors=face,
                edgecolors=color,
                linewidths=0.9,
                zorder=5 + order,
            )


def _draw_scale(axes: Any, low: FloatArray, high: FloatArray) -> None:
    """Draw a bar of a round length; the projection is parallel, so it holds everywhere along it."""
    wanted = 0.16 * (high[0] - low[0])
    power = 10.0 ** np.floor(np.log10(wanted))
    length = max((m * power for m in (1, 2, 5) if m * power <= wanted), default=power)
    right, bottom = high[0] - 0.03 * (high[0] - low[0]), low[1] + 0.035 * (high[1] - low[1])
    axes.plot(
        [right - length, right], [bottom, bottom], color=SOFT, linewidth=2.4, solid_capstyle="butt", zorder=20
    )
    words = f"{length:g} m" if length >= 1 else f"{100 * length:g} cm"
    axes.annotate(
        words,
        (right - length / 2, bottom),
        (0, 4),
        textcoords="offset points",
        ha="center",
        fontsize="medium",
        color=SOFT,
        zorder=20,
    )
