"""Content of a view from artifacts, runs and the maps in their logs."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from alula._core import EllipsoidSet, PolytopeSet
from alula.schemas.arrays import FloatArray, IntArray
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.parameters.configs.view import MOST_GAUSSIANS
from alula.stages.clearance import kept_obstacles
from alula.stages.reporting.curves import plan_positions
from alula.stages.reporting.flight_curves import sigma_of
from alula.stages.reporting.material import Run
from alula.stages.reporting.palette import COLORS
from alula.stages.runlog.maps import fence_shell
from alula.stages.show.drawing.content import CUT, Content, Lines, Part, Play, hex_of, tree_name
from alula.stages.show.drawing.solids import (
    Solids,
    drawn,
    largest,
    solids_of_cover,
    surface_points,
    voxel_surface,
)
from alula.stages.show.drawing.splat import THINNED_FROM, chosen, gaussians
from alula.stages.show.viewing.active import DECIDES_COLOR, Numbered
from alula.stages.show.viewing.camera import fitted
from alula.stages.show.viewing.corridor import NEW_PLAN_COLOR, PLAN_COLOR, plan_parts
from alula.stages.show.viewing.cut import Cut, find_cut
from alula.stages.show.viewing.flown import MOST_PLAYED_S, faces_of, path_parts, play_of, worst_first
from alula.stages.show.viewing.logged_map import LoggedMap
from alula.stages.show.viewing.nearest import solid_obstacles
from alula.stages.vehicles.fence import fence_faces

HULL_COLOR = (140, 153, 173)
_FENCE_COLOR = (26, 140, 204)
_VOXEL_COLOR = (150, 150, 160)
_SEEN_COLOR = (86, 180, 233)
_FACES_OPACITY = 0.25
_FENCE_OPACITY = 0.1
_SOLID_POINTS = 100_000  # of matter, for the camera and the cut
_MATTER_M = 0.4  # between points of hulls there
_LEAST_OPACITY = 0.3  # of a Gaussian that counts as matter there


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
    """What a view is made from.

    Attributes:
        scenes, covers, voxels, seen, plans: artifacts with their names.
        maps: maps in the logs of runs, by the run's label.
        elsewhere: labels of runs that flew through other hulls than those given.
        around: further points that the camera shows, shape (n, 3) [m].
        trees: search trees of a single scene by level, made when they are needed.
    """

    title: str
    scenes: Sequence[tuple[str, Artifact]] = ()
    covers: Sequence[tuple[str, Artifact]] = ()
    voxels: Sequence[tuple[str, Artifact]] = ()
    seen: Sequence[tuple[str, Artifact]] = ()
    plans: Sequence[tuple[str, Artifact]] = ()
    runs: Sequence[Run] = ()
    maps: Mapping[str, LoggedMap] = field(default_factory=dict)
    elsewhere: Collection[str] = ()
    around: FloatArray | None = None
    trees: dict[float, EllipsoidSet] = field(default_factory=dict)


def composer(
    shown: Shown,
    *,
    flights: Collection[tuple[int, int]] | None = None,
    most_played_s: float = MOST_PLAYED_S,
    first: Collection[tuple[int, int]] = (),
    up: str = "+z",
) -> Callable[[int], Content]:
    """Return what makes the content of a view with at most so many Gaussians; all else is made once.

    Args:
        flights: those to play, as (run, trial); None for the worst ones of each run, up to `most_played_s`.
        most_played_s: maximum time of the flights to play, beyond the first [s].
        first: flights to play before all others, as (run, trial).
    """
    notes: list[str] = []
    solids = _solids(shown)
    flown = _flown_points(shown)
    matter = _matter(shown, solids)
    cut = find_cut(matter, flown) if up == "+z" else None
    parts: list[Part] = []
    total = sum(len(scene["mean"]) for _, scene in shown.scenes)
    for name, each in solids:
        parts += _hull_parts(name, each, cut, notes, has_splat=bool(shown.scenes))
    for logged in shown.maps.values():
        parts += logged.ellipsoids("Ellipsoids", cut) if not shown.scenes else []
    voxels = (("Voxels", _VOXEL_COLOR, shown.voxels), ("Seen space", _SEEN_COLOR, shown.seen))
    for base, color, some in voxels:
        for name, artifact in some:
            parts += _voxel_parts(_named(base, name, some), artifact, color, cut, notes, shown)
    for name, plan in shown.plans:
        found = plan_parts(plan, has_splat=bool(shown.scenes))
        parts += found if len(shown.plans) == 1 else _renamed(found, "Plan", f"Plan {tree_name(name)}")
    parts += _fence_parts(shown)
    parts += path_parts(shown.runs)
    plays = _plays(shown, flights, most_played_s, first)
    outcomes = dict.fromkeys(
        part.name.split("/")[1].rpartition(" (")[0] for part in parts if part.name.startswith("Flights/")
    )
    legend = {name: COLORS[name] for name in outcomes}
    legend |= {"plan": hex_of(PLAN_COLOR)} if shown.plans else {}
    legend |= {"new plan": hex_of(NEW_PLAN_COLOR)} if any(play.plans for play in plays) else {}
    legend |= {"obstacle that decides": hex_of(DECIDES_COLOR)} if any(play.decides for play in plays) else {}
    camera = fitted(matter, flown, up)

    def compose(most_gaussians: int) -> Content:
        said: list[str] = []
        splats: list[Part] = []
        for name, scene in shown.scenes:
            own = len(scene["mean"]) * most_gaussians // max(total, most_gaussians, 1)
            splats += _splat_parts(_named("Splat", name, shown.scenes), scene, cut, own, said)
        is_cut = any(part.name.startswith(f"{CUT}/") for part in (*splats, *parts))
        return Content(
            title=shown.title,
            parts=tuple(_distinct([*splats, *parts])),
            camera=camera,
            plays=tuple(plays),
            legend=legend,
            notes=(*said, *notes, *(["ceiling and near walls are hidden at first"] if is_cut else [])),
            up=up,
        )

    return compose


def content_of(shown: Shown, *, most_gaussians: int = MOST_GAUSSIANS, **fields: Any) -> Content:
    """Make the content of a view with at most so many Gaussians; `fields` are those of `composer`."""
    return composer(shown, **fields)(most_gaussians)


def _distinct(parts: Iterable[Part]) -> list[Part]:
    """Parts of the same name would replace each other: number them."""
    found: list[Part] = []
    names: set[str] = set()
    for part in parts:
        name, number = part.name, 2
        while name in names:
            name, number = f"{part.name} {number}", number + 1
        names.add(name)
        found.append(part if name == part.name else replace(part, name=name))
    return found


def _renamed(parts: Iterable[Part], old: str, new: str) -> list[Part]:
    return [replace(part, name=new + part.name.removeprefix(old)) for part in parts]


def _named(base: str, name: str, among: Sequence[Any]) -> str:
    return base if len(among) == 1 else f"{base} {tree_name(name)}"


def _solids(shown: Shown) -> list[tuple[str, Solids]]:
    """Hulls of covers, or those in the logs when no cover is given; equal ones once."""
    if shown.covers:
        return [(_named("Hulls", name, shown.covers), solids_of_cover(cover)) for name, cover in shown.covers]
    found: dict[bytes, tuple[str, Solids]] = {}
    for label, logged in shown.maps.items():
        if len(logged.solids):
            name = "Hulls" if len(shown.maps) == 1 else f"Hulls of {tree_name(label)}"
            found.setdefault(logged.solids.corners.tobytes(), (name, logged.solids))
    return list(found.values())


def _flown_points(shown: Shown) -> FloatArray:
    """Points of all flights and plans, shape (m, 3) [m]."""
    paths = [flight.position_world for run in shown.runs for flight in run.flights.values()]
    paths += [plan_positions(plan) for _, plan in shown.plans]
    paths += [] if shown.around is None else [shown.around]
    found = np.concatenate([np.empty((0, 3)), *(path[:: max(1, len(path) // 400)] for path in paths)])
    finite: FloatArray = found[np.isfinite(found).all(axis=1)]
    return finite


def _matter(shown: Shown, solids: Sequence[tuple[str, Solids]]) -> FloatArray:
    """Points of Gaussians that can be seen, of hulls, and of voxels where there is nothing else."""
    found = [np.empty((0, 3))]
    for _, scene in shown.scenes:
        rows = np.flatnonzero(np.asarray(scene["opacity"]) >= _LEAST_OPACITY)
        rows = rows if len(rows) else np.arange(len(scene["mean"]))
        few = rows[:: max(1, len(rows) // _SOLID_POINTS)]
        found.append(np.asarray(scene["mean"])[few].astype(np.float64))
    if not shown.scenes:
        found += [surface_points(each.corners, each.triangles, _MATTER_M) for _, each in solids]
        found += [logged.centers for logged in shown.maps.values()]
    if not any(map(len, found)):
        for _, voxels in (*shown.voxels, *shown.seen):
            index = np.asarray(voxels["index"], np.float64) + 0.5
            edge = float(voxels.manifest.voxel_size_m)  # type: ignore[attr-defined]
            found.append(index[:: max(1, len(index) // _SOLID_POINTS)] * edge)
    return np.concatenate(found)


def _splat_parts(name: str, scene: Artifact, cut: Cut | None, maximum: int, notes: list[str]) -> list[Part]:
    choice = chosen(scene, maximum)
    count = len(choice.row)
    whole = scene.manifest.summary.get(THINNED_FROM)
    total = whole if isinstance(whole, int) else len(scene["mean"])
    if count < total:
        notes.append(f"{name}: {count:,} of {total:,} Gaussians, by contribution, grown to fill the gaps")
    mean = np.asarray(scene["mean"][choice.row], np.float64)
    gone = np.zeros(count, np.bool_) if cut is None else cut.removes(mean, mean)
    return [
        gaussians(full, scene, choice.of(some))
        for full, some in ((name, ~gone), (f"{CUT}/{name}", gone))
        if some.any()
    ]


def _hull_parts(
    name: str, solids: Solids, cut: Cut | None, notes: list[str], *, has_splat: bool
) -> list[Part]:
    keep = largest(solids)
    if not keep.all():
        notes.append(f"{name}: the {int(keep.sum()):,} largest of {len(solids):,}")
    gone = np.zeros(len(solids), np.bool_) if cut is None else cut.removes(*solids.bounds())
    parts: list[Part] = []
    for full, some in ((name, keep & ~gone), (f"{CUT}/{name}", keep & gone)):
        parts += drawn(full, *solids.of(some), HULL_COLOR, opacity=_FACES_OPACITY, far_only=has_splat)
    return parts


def _voxel_parts(
    name: str, voxels: Artifact, color: Any, cut: Cut | None, notes: list[str], shown: Shown
) -> list[Part]:
    edge = float(voxels.manifest.voxel_size_m)  # type: ignore[attr-defined]
    index = np.asarray(voxels["index"], np.int64)
    is_free = name.startswith("Seen")
    low = edge * index.astype(np.float64)
    gone = np.zeros(len(index), np.bool_) if cut is None or is_free else cut.removes(low, low + edge)
    visible = not (shown.scenes or shown.covers) or is_free
    parts: list[Part] = []
    for full, some in ((name, ~gone), (f"{CUT}/{name}", gone)):
        corners, triangles, step = voxel_surface(index[some], edge)
        if step > 1:
            notes.append(f"{full}: drawn in cubes of {step} voxels")
        opacity = 0.12 if is_free else 0.9
        found = drawn(full, corners, triangles, color, opacity=opacity, visible=visible)
        parts += found[:1] if is_free else found
    return parts


def _fence_parts(shown: Shown) -> list[Part]:
    """Shells of the runs' fences; equal ones once."""
    found: dict[bytes, list[Part]] = {}
    for run in shown.runs:
        faces = faces_of(run)
        if len(faces):
            paths = [flight.position_world for flight in run.flights.values() if len(flight.position_world)]
            name = "Fence" if len(shown.runs) == 1 else f"Fence of {tree_name(run.label)}"
            corners, triangles = fence_shell(faces, paths)
            found.setdefault(corners.tobytes(), _fence(name, corners, triangles))
    return [part for parts in found.values() for part in parts]


def fence_parts(box_m: Sequence[float] | None, around: FloatArray) -> list[Part]:
    """Shell of a fence that is a box.

    Args:
        box_m: XMIN YMIN ZMIN XMAX YMAX ZMAX [m]; None without a fence.
        around: points of a path in it, shape (n, 3) [m].
    """
    return [] if box_m is None else _fence("Fence", *fence_shell(fence_faces(box_m, ()), [around]))


def _fence(name: str, corners: FloatArray, triangles: IntArray) -> list[Part]:
    parts = drawn(name, corners, triangles, _FENCE_COLOR, opacity=_FENCE_OPACITY, far_only=True)
    return [
        replace(part, width_px=2.5, color=_FENCE_COLOR) if isinstance(part, Lines) else part for part in parts
    ]


def _plays(
    shown: Shown,
    flights: Collection[tuple[int, int]] | None,
    most_played_s: float,
    first: Collection[tuple[int, int]],
) -> list[Play]:
    obstacles = [_obstacles(shown, run) for run in shown.runs]
    numbered = [_numbered(shown, run) for run in shown.runs]
    several = len(shown.runs) > 1
    found: list[Play] = []
    total = 0.0
    order = sorted(worst_first(shown.runs), key=lambda key: key not in first)
    for number, index in order if flights is None else [key for key in order if key in flights]:
        flight = shown.runs[number].flights[index]
        if len(flight.time_s) < 2 or not np.isfinite(flight.position_world).all():
            continue
        total += float(flight.time_s[-1] - flight.time_s[0])
        if found and flights is None and total > most_played_s:
            break
        found.append(play_of(shown.runs[number], index, obstacles[number], several, numbered[number]))
    return found


def _numbered(shown: Shown, run: Run) -> Numbered | None:
    """Obstacles that a run flew in, by their numbers in its log; None where it flew through others."""
    if run.label in shown.elsewhere:
        return None
    logged = shown.maps.get(run.label)
    covers, scene = shown.covers, shown.scenes[0][1] if len(shown.scenes) == 1 else None
    if logged is not None:
        solids: Solids | None = logged.solids
        count: int | None = logged.ellipsoid_count
    else:
        solids = solids_of_cover(covers[0][1]) if len(covers) == 1 else None
        count = None if scene is None else len(scene["mean"])
    if scene is not None and count == len(scene["mean"]):
        return Numbered(solids, scene["mean"], scene["scale"], scene["quat_wxyz"], count, sigma_of(run))
    if logged is not None and count == len(logged.centers):
        quat, axes, centers = logged.quat_wxyz, logged.semi_axes, logged.centers
    else:
        quat, axes, centers = np.empty((0, 4)), np.empty((0, 3)), np.empty((0, 3))
    return Numbered(solids, centers, axes, quat, count)


def _obstacles(shown: Shown, run: Run) -> dict[str, PolytopeSet | EllipsoidSet]:
    """Search trees of what a run flew in: hulls of its log, or those given, and the scene's ellipsoids."""
    found: dict[str, PolytopeSet | EllipsoidSet] = {}
    logged = shown.maps.get(run.label)
    hulls = [logged.solids] if logged is not None else [solids for _, solids in _solids(shown)]
    hulls = [] if run.label in shown.elsewhere else hulls
    for number, each in enumerate(hulls):
        if (tree := solid_obstacles(each)) is not None:
            found["hulls" if number == 0 else f"hulls {number + 1}"] = tree
    sigma = run.record.summary.get("sigma")
    flew_ellipsoids = logged is None or logged.has_ellipsoids
    if isinstance(sigma, int | float) and sigma > 0 and len(shown.scenes) == 1 and flew_ellipsoids:
        found["ellipsoids"] = kept_obstacles(shown.scenes[0][1], float(sigma), shown.trees)
    return found
