"""Points of a flight: whether they are free, the nearest free ones, and free points to choose from."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.errors import InfeasibleError
from alula.schemas.parameters.configs.plan import BEYOND_MAP, PlanConfig, Point
from alula.schemas.progress import Progress
from alula.stages.planning.inside import ENCLOSED, inside_of, lattice_of
from alula.stages.planning.space import PlanSpace, mapped_box, room_around

_TOUCHES_M = 1e-9  # a smaller depth is none
_NEAREST_M = 1e-3  # tolerance of the nearest free point
_NEAREST_CELLS = 400_000  # of its search
_DECIMALS = 3  # of points that are printed
_MOST_POINTS = 500_000  # of the lattice that free points are chosen from
_NEAREST_NODES = 64  # lattice points inside, around which a nearest free point is looked for


def free_points_of_flight(
    config: PlanConfig,
    space: PlanSpace,
    named: Sequence[tuple[str, Point]],
    lower: FloatArray,
    upper: FloatArray,
    radius_m: float,
) -> tuple[list[Point], list[tuple[str, Point, Point]]]:
    """The points of a flight; with `snap`, those that are not free are moved to the nearest that are.

    Args:
        lower: corner of the box that moved points stay in, shape (3,) [m].
        upper: the other corner, shape (3,) [m].
        radius_m: distance that points must have from obstacles [m].

    Returns:
        The points, and of each that was moved its name and its positions before and after.

    Raises:
        InfeasibleError: a point is outside of the mapped box; or it is not free and `snap` is not set, or
            there is no free point near it.
    """
    mapped = mapped_box(space, config.beyond_map_m)
    if mapped is not None:
        known_as = [(f"the {name}", point) for name, point in named]
        kept = (
            0.0 if config.nearest_free else space.keep_m
        )  # a point in an outer wall may be moved into the room
        if (words := mapped.refusal(known_as, kept, BEYOND_MAP)) is not None:
            raise InfeasibleError(words)
    points: list[Point] = []
    moved: list[tuple[str, Point, Point]] = []
    for name, point in named:
        distance = float(space.map.distance(np.array([point]), space.keep_m + 1)[0])
        is_out = mapped is not None and bool(mapped.beyond(np.array([point]), space.keep_m)[0])
        if distance >= radius_m and not is_out:
            points.append(point)
            continue
        nearest = _nearest_inside(config, space, lower, upper, point, radius_m)
        if config.nearest_free and nearest is not None:
            points.append(nearest)
            moved.append((name, point, nearest))
            continue
        where = f"the {name} ({' '.join(f'{x:g}' for x in point)})"
        what = space.nearest_part(point)
        place = (
            f"is {max(distance, 0.0):.6g} m from {what}, and the plan must keep {space.keep_m:g} m (--radius)"
        )
        if distance < -_TOUCHES_M:
            place = f"is inside {what}, {-distance:.3g} m deep"
        if nearest is None:
            raise InfeasibleError(f"{where} {place}; no free point was found near it")
        free = " ".join(f"{x:g}" for x in nearest)
        raise InfeasibleError(
            f"{where} {place}; the nearest free point is ({free}), and --nearest-free takes it"
        )
    return points, moved


def _nearest_inside(
    config: PlanConfig, space: PlanSpace, lower: FloatArray, upper: FloatArray, point: Point, radius_m: float
) -> Point | None:
    """The nearest free point, of those inside unless bounds are given; see `inside_of`."""
    nearest = nearest_free_point(space, lower, upper, point, radius_m)
    if config.bounds is not None or nearest is None:
        return nearest
    inside = inside_of(space.map, lower, upper, space.keep_m, space.floor_m)
    if inside.holds(np.array([nearest]))[0]:
        return nearest
    nodes = lattice_of(space.map, inside.lower, upper, space.keep_m, _MOST_POINTS)
    chosen = nodes.point[nodes.enclosed >= ENCLOSED] if inside.is_closed else nodes.point
    near = chosen[np.argsort(np.linalg.norm(chosen - point, axis=1))[:_NEAREST_NODES]]
    half = 0.5 * nodes.spacing_m
    found = [
        each
        for node in near
        if (each := nearest_free_point(
            space, np.maximum(node - half, inside.lower), np.minimum(node + half, upper), point, radius_m
        )) is not None
        and inside.holds(np.array([each]))[0]
    ]  # fmt: skip
    return min(found, key=lambda each: math.dist(each, point), default=None)


def nearest_free_point(
    space: PlanSpace, lower: FloatArray, upper: FloatArray, point: Point, radius_m: float
) -> Point | None:
    """The free point nearest to a given one, up to a few millimetres; it is free as printed.

    Args:
        lower: corner of the box to look in, shape (3,) [m].
        upper: the other corner, shape (3,) [m].
        radius_m: distance that it must have from obstacles [m].

    Returns:
        The point; None if there is none in the box.
    """
    # Rounding to millimetres moves a point by less than a millimetre.
    found = _core.nearest_free(
        space.map,
        lower.tolist(),
        upper.tolist(),
        point,
        radius_m + 10.0**-_DECIMALS,
        _NEAREST_M,
        _NEAREST_CELLS,
    )
    if found is None:
        return None
    short = np.clip(np.round(found, _DECIMALS), lower, upper)
    best = short if space.map.distance(short[None], radius_m)[0] >= radius_m else np.array(found)
    x, y, z = best.tolist()
    return x, y, z


def free_points(
    config: PlanConfig, space: PlanSpace, count: int, *, seed: int = 0, progress: Progress | None = None
) -> FloatArray:
    """Free points of the largest connected part of a map, far from one another.

    Candidates are the points of a lattice in the mapped box, and in `bounds`, with the distance to keep and a
    millimetre from all obstacles; without bounds those that are inside, see `inside_of`. Two neighbours are
    connected where the segment between them keeps the distance, exactly. The first point is drawn from the
    largest connected set, and each further one is the candidate of that set that is farthest from all before.

    Args:
        config: of the plan; start and goal are not needed.

    Returns:
        Shape (count, 3), multiples of a millimetre [m].

    Raises:
        InfeasibleError: there are fewer candidates.
    """
    if space.box() is None and config.bounds is None:
        raise InfeasibleError("the map has no obstacles; set --bounds to the box to choose points from")
    point = _largest_part(space, *room_around(config, space, ()), has_bounds=config.bounds is not None)
    if len(point) < count:
        raise InfeasibleError(
            f"the largest connected part of the map has {len(point)} candidates that keep "
            f"{space.keep_m:g} m, not {count}; ask for fewer points or set --bounds to a smaller box"
        )
    chosen = [int(np.random.default_rng(seed).integers(len(point)))]
    x, y, z = np.ascontiguousarray(point.T)

    def distance_to(k: int) -> FloatArray:  # by columns: a fifth of the time of np.linalg.norm
        dx, dy, dz = x - x[k], y - y[k], z - z[k]
        distance: FloatArray = np.sqrt(dx * dx + dy * dy + dz * dz)
        return distance

    apart = distance_to(chosen[0])
    while len(chosen) < count:
        chosen.append(int(apart.argmax()))
        apart = np.minimum(apart, distance_to(chosen[-1]))
        if progress is not None:
            progress(len(chosen), count)
    found: FloatArray = point[chosen]
    return found


def _largest_part(space: PlanSpace, lower: FloatArray, upper: FloatArray, *, has_bounds: bool) -> FloatArray:
    """Free lattice points of the largest connected set, shape (N, 3) [m]; without bounds those inside."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    inside = None
    if not has_bounds:
        inside = inside_of(space.map, lower, upper, space.keep_m, space.floor_m)
        lower = inside.lower
    found = lattice_of(space.map, lower, upper, space.keep_m, _MOST_POINTS)
    chosen = np.arange(len(found.point))
    if inside is not None and inside.is_closed:
        chosen = np.flatnonzero(found.enclosed >= ENCLOSED)
    if len(chosen) == 0:
        return np.empty((0, 3))
    point, distance = found.point[chosen], found.distance[chosen]
    number = np.full(found.shape, -1)
    number[tuple(found.index[chosen].T)] = np.arange(len(chosen))
    ends = []
    for axis in range(3):
        a = np.delete(number, -1, axis=axis).reshape(-1)
        b = np.delete(number, 0, axis=axis).reshape(-1)
        both = (a >= 0) & (b >= 0)
        ends.append(np.stack([a[both], b[both]]))
    a, b = np.concatenate(ends, axis=1)
    clear = 0.5 * (distance[a] + distance[b] - found.spacing_m) >= space.keep_m  # distances are 1-Lipschitz
    doubt = np.flatnonzero(~clear)
    here, there = (np.ascontiguousarray(point[each[doubt]]) for each in (a, b))
    clear[doubt] = space.map.is_clear(here, there, space.keep_m)
    a, b = a[clear], b[clear]
    graph = coo_array((np.ones(len(a), np.bool_), (a, b)), shape=(len(chosen), len(chosen)))
    _, part = connected_components(graph, directed=False)
    return np.ascontiguousarray(point[part == np.bincount(part).argmax()])
