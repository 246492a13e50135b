"""A plan: its curve, corridor, points to pass, start and goal."""

from __future__ import annotations

import numpy as np

from alula.schemas.arrays import FloatArray, IntArray
from alula.schemas.artifacts.artifact import Artifact
from alula.stages.planning.trajectory import evaluate
from alula.stages.reporting.curves import plan_positions, thin
from alula.stages.show.drawing.content import Lines, Part, segments_of
from alula.stages.show.drawing.solids import drawn
from alula.stages.show.viewing.shapes import balls

PLAN_COLOR = (117, 112, 179)  # these two are seen on white and on black
NEW_PLAN_COLOR = (231, 41, 138)
_CORRIDOR = (46, 158, 91)
_VIA = (213, 94, 0)
_GATE = (230, 159, 0)
_SIDES = 32  # of a gate


def plan_parts(plan: Artifact, *, has_splat: bool = False) -> list[Part]:
    """Parts of an `alula/plan`: curve, start, goal, via points, gates, and the cells of its corridor.

    Args:
        has_splat: faces of the corridor would hide the Gaussians behind it, so they are not shown at first.
    """
    points = thin(plan_positions(plan))
    parts: list[Part] = []
    if len(points) > 1:
        parts.append(Lines(name="Plan/curve", segments=segments_of(points), color=PLAN_COLOR, width_px=3.0))
    mark_m = max(0.03, 0.5 * float(plan.manifest.radius_m))  # type: ignore[attr-defined]
    via = np.array(plan.manifest.via_m, np.float64).reshape(-1, 3)  # type: ignore[attr-defined]
    for name, places, color in (
        ("Plan/start", points[:1], (0, 158, 115)),
        ("Plan/goal", points[-1:], PLAN_COLOR),
        ("Plan/points to pass", via, _VIA),
    ):
        if len(places):
            parts.append(balls(name, places, mark_m, color))
    gates = gate_lines(plan)
    if len(gates):
        parts.append(Lines(name="Plan/gates", segments=gates, color=_GATE, width_px=4.0))
    corners, triangles = corridor_mesh(plan)
    parts += drawn("Plan/corridor", corners, triangles, _CORRIDOR, opacity=0.1, faces_visible=not has_splat)
    return parts


def gate_lines(plan: Artifact) -> FloatArray:
    """Openings of a plan's gates as circles, each once, with an arrow along its normal, shape (n, 2, 3) [m].

    Args:
        plan: an `alula/plan`; one without gates has no lines.
    """
    angle = np.linspace(0, 2 * np.pi, _SIDES + 1)[:, None]
    lines = [np.empty((0, 2, 3))]
    gates = {
        (*one.point_m, *one.normal, one.radius_m): one
        for one in plan.manifest.passes  # type: ignore[attr-defined]
        if one.kind == "gate"
    }
    for gate in gates.values():
        center, normal, radius = np.array(gate.point_m), np.array(gate.normal), gate.radius_m
        across = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
        across /= np.linalg.norm(across)
        up = np.cross(normal, across)
        lines.append(segments_of(center + radius * (np.cos(angle) * across + np.sin(angle) * up)))
        tip, barb = center + 0.6 * radius * normal, center + 0.4 * radius * normal
        ends = [center, barb + 0.15 * radius * across, barb - 0.15 * radius * across]
        lines.append(np.array([(end, tip) for end in ends]))
    return np.concatenate(lines)


def corridor_mesh(plan: Artifact) -> tuple[FloatArray, IntArray]:
    """Corners, shape (V, 3) [m], and triangles, shape (F, 3), of the cells that pieces of a plan lie in.

    Args:
        plan: an `alula/plan`; a plan without corridor has no corners.
    """
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
