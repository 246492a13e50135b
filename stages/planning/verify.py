"""Proof of a stored plan from its file: clearance, corridor, limits, continuity; apart from the planner."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.certificate import Certificate, Check, Offence
from alula.schemas.artifacts.manifest import CoverManifest, PlanManifest, PlanPass, SceneManifest
from alula.schemas.decimals import at_most
from alula.schemas.errors import UsageError
from alula.stages.clearance import hull_obstacles, scene_obstacles
from alula.stages.compression.cover_checks import require_solid_hulls
from alula.stages.compression.ellipsoids import removed_from, retained, rows_of
from alula.stages.compression.hulls import Hulls
from alula.stages.compression.level import (
    beyond_words,
    hull_words,
    level_of,
    level_words,
    obstacles_words,
    omissions,
    outside_words,
    recorded_level,
    require_sigma,
    scene_level,
    without,
)
from alula.stages.filtering.obstacles import ellipsoid_index
from alula.stages.planning import exact
from alula.stages.planning.curve_certificate import certify_curve
from alula.stages.planning.joins import APART, ORDERS, faults_of_joins
from alula.stages.planning.passes import laps_of, name_of
from alula.stages.planning.unseen import is_seen, unseen_hulls
from alula.stages.proof import check

_PASSED_M = 1e-9  # a point of the flight, at the end of a piece
_PASSED_S = 1e-9  # the time at which a plan says that it passes a point, at the end of a piece
_ZONE_HALVINGS = 12  # of a piece beside a zone
_HOLD_S = 1e-9  # that the rest at a point may be short of its time
_CORRIDOR = ("cell_normal", "cell_offset", "cell_start", "piece_cell")
_YAW_LIMITS = ("yaw_rate_rad_s", "yaw_acceleration_rad_s2")


def verify_plan(
    plan: Artifact,
    *,
    cover: Artifact | None = None,
    scene: Artifact | None = None,
    within: Artifact | None = None,
    sha256: Mapping[str, str] | None = None,
    jobs: int = 0,
) -> Certificate:
    """Prove a plan again, from its arrays and the map.

    Clearance: every piece keeps its distance from every hull, by separating planes of its control points, and
    of a plan that was made in a scene from every ellipsoid, by distances of chords. Corridor: every cell that
    a piece lies in keeps the distance from every hull, and with a scene from every ellipsoid of the plan's
    level, or else of those that the cover was made to contain, by duality in numbers rounded to the safe
    side. Each piece in its cell, and limits of the motion over every piece: by control points in rational
    arithmetic, halved where that does not decide. Continuity up to snap, within the absolute bounds of
    `joins`; start, waypoints, gates and goal in their order; rest where the plan holds, and at the goal.

    Args:
        cover: the `alula/cover` that it keeps away from; without one, the scene that it was made in.
        scene: the `alula/scene` that it was made in, or that of the cover.
        within: the `alula/seen` that it stays in: it begins in a seen voxel, and keeps the distance from all
            others as from hulls.
        sha256: hashes of the files "cover" and "scene"; a difference from the plan's inputs becomes a note.

    Raises:
        ArtifactError: the cover is not sound.
        UsageError: frame or unit of the files differ, or only a scene that the plan was not made in is given.
    """
    manifest = plan.manifest
    assert isinstance(manifest, PlanManifest)
    for what, other in (("cover", cover), ("scene", scene), ("seen space", within)):
        if other is not None and (other.manifest.frame, other.manifest.unit) != (manifest.frame, "m"):
            raise UsageError(
                f"the {what} is in the frame {other.manifest.frame} in {other.manifest.unit}, the plan in "
                f"{manifest.frame} in m"
            )
    pieces = _Pieces(plan)
    made_in = {each["map"]: each for each in manifest.maps}
    checks, statements, not_checked = [], [], []
    level: dict[str, Any] = {}
    omits: list[str] = []
    beyond: list[str] = []
    if cover is not None:
        of_cover = level_of(cover)
        level, omits, beyond = recorded_level(of_cover), omissions(of_cover), [outside_words(of_cover)]
        require_solid_hulls(cover, jobs=jobs)
        hulls = hull_obstacles(Hulls.from_cover(cover))
        keep_m = float(made_in.get("cover", {}).get("keep_m", manifest.radius_m))
        checks.append(_clearance(plan, hulls, keep_m, "hull", jobs))
        if pieces.used:
            checks.append(_cells(pieces, [hulls], [], keep_m, "hull", jobs))
        statements.append(
            f"every point of the plan is at least {keep_m:g} m from every {hull_words(of_cover)}"
        )
        not_checked.append("that the cover contains what it was made for, see `verify` of the cover")
    if scene is not None and "scene" in made_in:
        sigma, keep_m = float(made_in["scene"]["sigma"]), float(made_in["scene"]["keep_m"])
        among = _core.EllipsoidMap(ellipsoid_index(scene, sigma, keep_m))
        checks.append(_clearance(plan, among, keep_m, "ellipsoid", jobs, extent_m=_extent_m(scene, sigma)))
        if pieces.used:
            checks.append(_cells(pieces, [], [scene_obstacles(scene, sigma)], keep_m, "ellipsoid", jobs))
        statements.append(
            f"every point of the plan is at least {keep_m:g} m from every ellipsoid of the scene at "
            f"{level_words(sigma)}"
        )
        level = level | {"scene": scene_level(sigma)} if level else scene_level(sigma)
        beyond.append(beyond_words(sigma))
    elif scene is not None:
        if cover is None:
            raise UsageError("the plan was not made in a scene; give the cover that it keeps away from")
        assert isinstance(cover.manifest, CoverManifest)
        if pieces.used:
            ellipsoids = [_ellipsoids(scene, cover.manifest)]
            checks.append(_cells(pieces, [], ellipsoids, manifest.radius_m, "ellipsoid", jobs))
            statements.append(f"every cell of its corridor from {obstacles_words(cover.manifest)}")
        else:
            not_checked.append("the distance from ellipsoids: the plan has no corridor")
    if within is not None:
        unseen = hull_obstacles(unseen_hulls(within))
        checks.append(_clearance(plan, unseen, manifest.radius_m, "unseen voxel", jobs))
        begin = np.asarray(plan["coefficient"])[:1, :3, 0]
        offences = [] if is_seen(within, begin).all() else [Offence(fault="the plan begins in unseen space")]
        checks.append(check("begins in seen space", 1, offences, "the voxel of its start"))
        statements.append("within the space that was seen")
        omits += omissions(level_of(within), is_cropped=False)
        if not level:
            level = recorded_level(level_of(within))
    if scene is not None:
        assert isinstance(scene.manifest, SceneManifest)
        omits += removed_from(scene.manifest)
    omits = list(dict.fromkeys(omits))
    given = {"cover": cover, "scene": scene, "within": within}
    if "seen" in made_in and within is None:
        not_checked.append("the space that was seen, in which the plan was made")
    for role in ("cover", "scene"):
        if role in made_in and given[role] is None:
            not_checked.append(f"the distance from the {role} that the plan was made in")
    if pieces.used:
        checks.append(pieces.in_cells())
    checks += [pieces.limits(), pieces.continuity(), pieces.passed()]
    if manifest.zones:
        checks.append(pieces.zones())
    if pieces.turns:
        checks.append(pieces.heading())
    proven = all(one.ok for one in checks)
    notes = [
        f"the {name} of the plan is {at_most(pieces.moved_m(name))} m from the one asked for (--nearest-free)"
        for name in ("start", "goal")
        if pieces.is_moved(name)
    ]
    if (speed := math.hypot(*pieces.coefficient[0, :, 1].tolist())) > APART[1]:
        notes.append(f"the plan begins in motion, at {at_most(speed)} m/s")
    recorded = {ref.role: ref.sha256 for ref in manifest.inputs}
    for role in ("cover", "scene", "within"):
        if sha256 and role in recorded and given[role] is not None and sha256.get(role) != recorded[role]:
            notes.append(f"the plan was made from another {'seen' if role == 'within' else role} file")
    return Certificate(
        covered=proven,
        checks=checks,
        left_out="; ".join(
            [
                *("errors of tracking and of the vehicle's state", "drag"),
                *("everything that the map does not have", *dict.fromkeys(beyond), *omits),
            ]
        ),
        notes=notes,
        statement=f"proven: {', '.join(statements)}{without(omits)}" if proven else "not proven",
        level=level,
        given=["plan", *(role for role, each in given.items() if each is not None)],
        not_checked=not_checked,
        omits=omits,
    )


class _Pieces:
    """A plan's pieces in rational numbers."""

    def __init__(self, plan: Artifact) -> None:
        assert isinstance(plan.manifest, PlanManifest)
        self.plan, self.manifest = plan, plan.manifest
        self.time = np.asarray(plan["time"], np.float64)
        self.coefficient = np.asarray(plan["coefficient"], np.float64)[:, :3]
        knots = [Fraction(t) for t in self.time.tolist()]
        self.duration = [b - a for a, b in pairwise(knots)]
        self.points = [
            exact.control_points(c, t) for c, t in zip(self.coefficient, self.duration, strict=True)
        ]
        has_cells = all(name in plan.arrays for name in _CORRIDOR)
        self.cell = np.asarray(plan["piece_cell"]).tolist() if has_cells else [-1] * len(self.points)
        self.used = sorted({c for c in self.cell if c >= 0})

    def rows(self, cell: int) -> slice:
        """Rows of a cell."""
        start = np.asarray(self.plan["cell_start"])
        return slice(int(start[cell]), int(start[cell + 1]))

    def where(self, piece: int) -> tuple[float, float, float]:
        """A point of a piece, for messages."""
        x, y, z = (float(c) for c in self.points[piece][0])
        return x, y, z

    def in_cells(self) -> Check:
        """Check that each piece lies in its cell."""
        offences = []
        count = len(self.plan["cell_start"]) - 1
        inside = [i for i, c in enumerate(self.cell) if c >= 0]
        for i in inside:
            rows = self.rows(self.cell[i]) if self.cell[i] < count else slice(0, 0)
            planes = zip(
                self.plan["cell_normal"][rows].tolist(), self.plan["cell_offset"][rows].tolist(), strict=True
            )
            good = self.cell[i] < count and all(
                exact.holds(self.points[i], exact.half_space(n, d)) for n, d in planes
            )
            if not good:
                offences.append(Offence(fault=f"piece {i} leaves cell {self.cell[i]}", place_m=self.where(i)))
        return check("pieces in cells", len(inside), offences, "control points, in rational arithmetic")

    def limits(self) -> Check:
        """Check the recorded limits over every piece."""
        offences, checked = [], 0
        sets = _limit_sets(self.manifest)
        for i, points in enumerate(self.points):
            for order in range(1, 5):
                points = exact.derivative(points, self.duration[i])
                for name, of, is_inside in sets:
                    if of != order:
                        continue
                    checked += 1
                    if not exact.holds(points, is_inside):
                        fault = f"piece {i} exceeds the limit {name}"
                        offences.append(Offence(fault=fault, place_m=self.where(i)))
        bounds = self.manifest.limits or {"speed_m_s": self.manifest.speed_m_s}
        detail = ", ".join(f"{name} {value:.6g}" for name, value in bounds.items())
        return check("limits", checked, offences, f"Bernstein bounds, in rational arithmetic: {detail}")

    def continuity(self) -> Check:
        """Check that derivatives agree where pieces meet, within bounds that do not depend on the plan."""
        every = np.asarray(self.plan["coefficient"], np.float64)
        offences = [
            Offence(fault=fault, place_m=self.where(min(i + 1, len(self.points) - 1)))
            for i, fault in faults_of_joins(self.time, every)
        ]
        within = ", ".join(
            f"{each:g} m/s^{order}" if order > 1 else f"{each:g} m{'/s' * order}"
            for order, each in enumerate(APART)
        )
        return check("continuity", len(self.points) - 1, offences, f"up to {ORDERS[-1]}: {within}")

    def zones(self) -> Check:
        """Check that each piece is slow wherever it may be in a zone."""
        offences = []
        for zone in self.manifest.zones:
            for i, points in enumerate(self.points):
                velocity = exact.derivative(points, self.duration[i])
                if not exact.is_slow_in(points, velocity, zone.box_m, zone.speed_m_s, _ZONE_HALVINGS):
                    fault = f"piece {i} may be faster than {zone.speed_m_s:g} m/s in a zone"
                    offences.append(Offence(fault=fault, place_m=self.where(i)))
        count = len(self.manifest.zones) * len(self.points)
        return check("zones", count, offences, "Bernstein bounds, in rational arithmetic")

    @property
    def turns(self) -> bool:
        """Whether the heading is not a constant without limits."""
        yaw = np.asarray(self.plan["coefficient"])[:, 3]
        limited = any(name in self.manifest.limits for name in _YAW_LIMITS)
        return limited or bool(yaw[:, 1:].any() or (yaw[:, 0] != yaw[0, 0]).any())

    def heading(self) -> Check:
        """Check the limits of the heading over every piece, its continuity, and that it ends at rest."""
        yaw = np.asarray(self.plan["coefficient"], np.float64)[:, 3:]
        rows = np.concatenate([yaw, np.zeros((len(yaw), 2, yaw.shape[2]))], axis=1)
        offences: list[Offence] = []
        turning: list[tuple[str, Fraction]] = []  # rate and acceleration at the beginning and at the end
        for i, (row, duration) in enumerate(zip(rows, self.duration, strict=True)):
            points = exact.control_points(row, duration)
            for order, name in enumerate(_YAW_LIMITS, 1):
                points = exact.derivative(points, duration)
                if not exact.holds(points, exact.ball(self.manifest.limits.get(name, 0.0))):
                    offences.append(
                        Offence(fault=f"piece {i} exceeds the limit {name}", place_m=self.where(i))
                    )
                ends = {"beginning": points[0][0]} if i == 0 else {}
                ends |= {"end": points[-1][0]} if i == len(rows) - 1 else {}
                turning += [(where, abs(value) / Fraction(APART[order])) for where, value in ends.items()]
        for where in dict.fromkeys(where for where, ratio in turning if ratio > 1):
            offences.append(Offence(fault=f"the heading turns at the {where}"))
        return check("heading", len(rows), offences, "rate and acceleration, in rational arithmetic")

    def passed(self) -> Check:
        """Check start, waypoints, gates and goal, each at its time, in their order, and rest at the goal."""
        ends = [p[0] for p in self.points] + [self.points[-1][-1]]
        knots = np.array([[float(c) for c in p] for p in ends])
        parameters = self.manifest.parameters
        passes = self.manifest.passes
        laps = laps_of(passes)
        offences: list[Offence] = []
        for name, knot in (("start", 0), ("goal", -1)):
            if parameters.get(name) is None or self.is_moved(name):
                continue
            given = _point(parameters[name])
            if not np.linalg.norm(knots[knot] - given) <= _PASSED_M:
                offences.append(Offence(fault=f"the {name} is not passed", place_m=given))
        first = 0
        for each in passes:
            at = int(np.abs(self.time - each.time_s).argmin())
            x, y, z = each.point_m
            fault = f"the {name_of(each, laps)} is not passed"
            if at < first or abs(self.time[at] - each.time_s) > _PASSED_S:
                fault += f" at {each.time_s:.6g} s, in its order"
            elif self._is_passed(each, at, knots):
                rest = f"the plan does not rest at the {name_of(each, laps)}"
                fault = "" if self._rests(at, each.hold_s) else rest
            if fault:
                offences.append(Offence(fault=fault, place_m=(x, y, z)))
            first = max(first, at + 1)
        last = self.points[-1]
        for order in range(1, 4):
            last = exact.derivative(last, self.duration[-1])
            if max(abs(c) for c in last[-1]) > Fraction(APART[order]):
                offences.append(Offence(fault=f"the {ORDERS[order]} is not zero at the end"))
                break
        count = len(passes) + sum(parameters.get(name) is not None for name in ("start", "goal"))
        has_gates = any(each.kind == "gate" for each in passes)
        name = "start, vias, gates, goal" if has_gates else "start, vias, goal"
        fits = f"; a vehicle of {self.body_m:g} m fits through the gates" if has_gates else ""
        return check(name, count, offences, f"each at its time, and rest at the end{fits}")

    def is_moved(self, name: str) -> bool:
        """Whether start or goal is another point than the one asked for, as --nearest-free permits."""
        return self.manifest.parameters.get("nearest_free") is True and self.moved_m(name) > _PASSED_M

    def moved_m(self, name: str) -> float:
        """Distance of the plan's start or goal from the point that was asked for [m]."""
        end = self.points[0][0] if name == "start" else self.points[-1][-1]
        return math.dist(_point(self.manifest.parameters.get(name)), [float(c) for c in end])

    def _is_passed(self, each: PlanPass, knot: int, knots: FloatArray) -> bool:
        """Whether a knot is at a waypoint, or in a gate that the flight passes in its direction.

        The knot is in the plane of the gate, where the vehicle's radius fits into the opening, and the flight
        does not only touch the plane, see `exact.is_crossed`.
        """
        if each.kind == "waypoint":
            allowed = _PASSED_M if each.tolerance_m is None else each.tolerance_m
            return bool(np.linalg.norm(knots[knot] - each.point_m) <= allowed)
        return exact.is_crossed(self.points, knot, each.point_m, each.normal) and exact.ball(
            each.radius_m - self.body_m, each.point_m
        )(self.points[knot][0])

    @property
    def body_m(self) -> float:
        """Radius of the vehicle that fits through the gates [m]."""
        return max(self.manifest.radius_m - self.manifest.margin_m, 0.0)

    def _rests(self, knot: int, hold_s: float) -> bool:
        """Whether the pieces from a knot on stand still for a time."""
        left = Fraction(hold_s)
        while left > _HOLD_S and knot < len(self.points):
            here = self.points[knot][0]
            if any(abs(a - b) > _PASSED_M for p in self.points[knot] for a, b in zip(p, here, strict=True)):
                return False
            left -= self.duration[knot]
            knot += 1
        return left <= _HOLD_S


def _point(value: object) -> tuple[float, float, float]:
    """A point of the parameters; far from everything if it is none."""
    if isinstance(value, list) and len(value) == 3 and all(isinstance(c, int | float) for c in value):
        return float(value[0]), float(value[1]), float(value[2])
    return math.inf, math.inf, math.inf


def _limit_sets(manifest: PlanManifest) -> list[tuple[str, int, Callable[[exact.Vector], bool]]]:
    """Recorded limits: name, order of the derivative, convex set."""
    limits = {"speed_m_s": manifest.speed_m_s} | manifest.limits
    g = limits.get("gravity_m_s2", 0.0)
    sets: list[tuple[str, int, Callable[[exact.Vector], bool]]] = []
    for order, name in enumerate(("speed_m_s", "acceleration_m_s2", "jerk_m_s3", "snap_m_s4"), 1):
        if name in limits:
            sets.append((name, order, exact.ball(limits[name])))
    if limits["speed_m_s"] != manifest.speed_m_s:
        sets.append(("speed_m_s", 1, exact.ball(manifest.speed_m_s)))
    if "most_thrust_m_s2" in limits:
        sets.append(("most_thrust_m_s2", 2, exact.ball(limits["most_thrust_m_s2"], (0, 0, -g))))
    if "least_thrust_m_s2" in limits:
        sets.append(("least_thrust_m_s2", 2, exact.half_space((0, 0, -1), g - limits["least_thrust_m_s2"])))
    if "tilt_rad" in limits:
        tangent = math.nextafter(math.tan(limits["tilt_rad"]), 0.0)
        is_tilt = 0 <= limits["tilt_rad"] < math.pi / 2
        sets.append(("tilt_rad", 2, exact.cone(tangent, g) if is_tilt else exact.nothing))
    return sets


def _clearance(
    plan: Artifact,
    obstacles: _core.PolytopeSet | _core.ObstacleMap,
    keep_m: float,
    what: str,
    jobs: int,
    extent_m: float = 0.0,
) -> Check:
    proof = certify_curve(plan["time"], plan["coefficient"], obstacles, keep_m, jobs=jobs, extent_m=extent_m)
    offences = []
    for i in np.flatnonzero(~proof.proven):
        x, y, z = (float(c) for c in np.asarray(plan["coefficient"])[i, :3, 0])
        fault = f"piece {i} is not proven to keep {keep_m:g} m from every {what}"
        offences.append(Offence(fault=fault, place_m=(x, y, z)))
    return check(
        f"clearance from {what}s",
        len(proof.proven),
        offences,
        f"at least {proof.clearance_m.min():.6g} m, {proof.pairs} pairs",
    )


def _cells(
    pieces: _Pieces,
    hulls: list[_core.PolytopeSet],
    ellipsoids: list[_core.EllipsoidSet],
    keep_m: float,
    what: str,
    jobs: int,
) -> Check:
    """Check the cells that pieces use."""
    plan = pieces.plan
    normal, offset, start = (
        np.ascontiguousarray(plan[name]) for name in ("cell_normal", "cell_offset", "cell_start")
    )
    used = [c for c in pieces.used if c < len(start) - 1]
    proven, clearance, pairs = _core.check_cells(hulls, ellipsoids, normal, offset, start, keep_m, jobs)
    offences = [
        Offence(fault=f"cell {c} is not proven to keep {keep_m:g} m from every {what}")
        for c in used
        if not proven[c]
    ]
    least = min((float(clearance[c]) for c in used), default=math.inf)
    return check(f"cells and {what}s", len(used), offences, f"at least {least:.6g} m, {pairs} pairs")


def _extent_m(scene: Artifact, sigma: float) -> float:
    """Largest coordinate of a box around the ellipsoids [m]."""
    reach = sigma * np.asarray(scene["scale"], np.float64).max(axis=1, initial=0.0)[:, None]
    return float((np.abs(np.asarray(scene["mean"], np.float64)) + reach).max(initial=0.0))


def _ellipsoids(scene: Artifact, level: CoverManifest) -> _core.EllipsoidSet:
    rows = rows_of(scene, retained(scene, level.min_opacity), ignore_loss=level.ignore_loss)
    return _core.EllipsoidSet(
        mean=np.ascontiguousarray(rows.mean),
        scale=np.ascontiguousarray(rows.scale),
        quat_wxyz=np.ascontiguousarray(rows.quat_wxyz),
        k=require_sigma(level),
        loss=rows.loss,
    )
