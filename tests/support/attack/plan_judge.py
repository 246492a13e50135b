"""What a plan does, by dense evaluation in NumPy, apart from alula's proofs: its faults, in words."""

from __future__ import annotations

import math

import numpy as np

from alula.schemas.artifacts.artifact import Artifact
from support.scenes.covers import SIZE_M

STEP_S = 2e-3  # of the evaluation, and a hundred instants in each piece at least
INSTANTS = 100
CLOSE_M = 1e-7  # of positions
CLOSE_M_S = 1e-5  # of velocities
REACH_M = 5e-3  # before and behind the plane of a gate that is flown through
STANDARD = ("speed_m_s", "acceleration_m_s2", "jerk_m_s3", "snap_m_s4")


def faults_of(plan: Artifact, boxes: list[list[int]], start=None, goal=None) -> list[str]:
    """Faults of a plan among boxes, as far as instants show them.

    Args:
        plan: judged.
        boxes: obstacles, six lattice numbers each.
        start: where it must begin; None: as its parameters say.
        goal: where it must end; None: as its parameters say.
    """
    manifest = plan.manifest
    time, c = np.asarray(plan["time"]), np.asarray(plan["coefficient"])
    found = _of_joins(time, c)
    at, value = _instants(time, c)
    place = value[0][:, :3]
    keep = min(
        [each["keep_m"] for each in manifest.maps if each["map"] == "cover"], default=manifest.radius_m
    )
    if len(boxes) and (nearest := _distance(place, boxes).min()) < keep - CLOSE_M:
        found.append(f"{keep - nearest:.3g} m nearer to a box than {keep:g} m")
    bounds = {"speed_m_s": manifest.speed_m_s} | manifest.limits
    bounds["speed_m_s"] = min(bounds["speed_m_s"], manifest.speed_m_s)
    for order, name in enumerate(STANDARD, 1):
        most = np.linalg.norm(value[order][:, :3], axis=1).max()
        if most > bounds.get(name, math.inf) * (1 + 1e-6) + 1e-9:
            found.append(f"{name} is {most:.6g}, not {bounds[name]:.6g}")
    for order, name in enumerate(("yaw_rate_rad_s", "yaw_acceleration_rad_s2"), 1):
        most = np.abs(value[order][:, 3]).max()
        if most > bounds.get(name, math.inf) * (1 + 1e-6) + 1e-9:
            found.append(f"{name} is {most:.6g}, not {bounds[name]:.6g}")
    if "tilt_rad" in bounds:
        thrust = value[2][:, :3] + [0, 0, bounds["gravity_m_s2"]]
        tilt = np.arctan2(np.linalg.norm(thrust[:, :2], axis=1), thrust[:, 2]).max()
        if tilt > bounds["tilt_rad"] + 1e-6:
            found.append(f"the tilt is {tilt:.6g}, not {bounds['tilt_rad']:.6g}")
        size = np.linalg.norm(thrust, axis=1)
        low, high = bounds.get("least_thrust_m_s2", -math.inf), bounds.get("most_thrust_m_s2", math.inf)
        if size.max() > high + 1e-6 or thrust[:, 2].min() < low - 1e-6:
            found.append(f"the thrust is {size.min():.6g} to {size.max():.6g}, not {low:.6g} to {high:.6g}")
    for zone in manifest.zones:
        box = np.array(zone.box_m)
        inside = ((place > box[:3] + CLOSE_M) & (place < box[3:] - CLOSE_M)).all(axis=1)
        speed = np.linalg.norm(value[1][inside, :3], axis=1).max(initial=0.0)
        if speed > zone.speed_m_s * (1 + 1e-6):
            found.append(f"{speed:.6g} m/s in a zone of {zone.speed_m_s:g} m/s")
    if np.linalg.norm(value[1][-1, :3]) > CLOSE_M_S:
        found.append(f"it ends at {np.linalg.norm(value[1][-1, :3]):.3g} m/s")
    for name, end, asked in (("start", 0, start), ("goal", -1, goal)):
        asked = manifest.parameters.get(name) if asked is None else asked
        if asked is not None and np.linalg.norm(place[end] - asked) > CLOSE_M:
            found.append(f"the {name} is {np.linalg.norm(place[end] - asked):.3g} m off")
    return found + _of_passes(manifest, at, place)


def _of_joins(time, c) -> list[str]:
    """Jumps of position and velocity between pieces, however short these are."""
    found = []
    length = np.diff(time)
    powers = length[:, None, None] ** np.arange(8)
    end = (c * powers).sum(axis=2)
    leap = np.linalg.norm(end[:-1, :3] - c[1:, :3, 0], axis=1).max(initial=0.0)
    if leap > CLOSE_M:
        found.append(f"the position jumps by {leap:.3g} m")
    if (turn := np.abs(end[:-1, 3] - c[1:, 3, 0]).max(initial=0.0)) > CLOSE_M:
        found.append(f"the heading jumps by {turn:.3g} rad")
    fast = (c[:, :, 1:] * powers[..., :-1] * np.arange(1, 8)).sum(axis=2)
    jump = np.linalg.norm(fast[:-1, :3] - c[1:, :3, 1], axis=1).max(initial=0.0)
    if jump > CLOSE_M_S:
        found.append(f"the velocity jumps by {jump:.3g} m/s")
    return found


def _instants(time, c):
    """Instants of all pieces, and the first five derivatives of (x, y, z, yaw) there."""
    at, rows = [], [[] for _ in range(5)]
    for k, length in enumerate(np.diff(time)):
        local = np.linspace(0, length, max(INSTANTS, min(5000, math.ceil(length / STEP_S))))
        at.append(time[k] + local)
        polynomials = [np.polynomial.Polynomial(row) for row in c[k]]
        for order, row in enumerate(rows):
            row.append(np.column_stack([each.deriv(order)(local) for each in polynomials]))
    return np.concatenate(at), [np.concatenate(row) for row in rows]


def _distance(points, boxes):
    """Distance of points from the nearest box [m]."""
    box = SIZE_M * np.asarray(boxes, float).reshape(-1, 6)
    nearest = np.full(len(points), math.inf)
    for each in box:
        outside = np.maximum(np.maximum(each[:3] - points, points - each[3:]), 0)
        nearest = np.minimum(nearest, np.linalg.norm(outside, axis=1))
    return nearest


def _of_passes(manifest, at, place) -> list[str]:
    found, before = [], -math.inf
    for each in manifest.passes:
        what = f"{each.kind} {each.number} of lap {each.lap}"
        if each.time_s < before - 1e-9:
            found.append(f"{what} is passed before the one before it")
        before = each.time_s
        here = place[np.abs(at - each.time_s).argmin()]
        away = np.linalg.norm(here - each.point_m)
        if each.kind == "waypoint":
            if away > (each.tolerance_m or 0.0) + CLOSE_M:
                found.append(f"{what} is passed {away:.3g} m from it")
            stays = (at >= each.time_s) & (at <= each.time_s + each.hold_s)
            if each.hold_s and np.ptp(place[stays], axis=0).max() > CLOSE_M:
                found.append(f"the plan moves while it holds at {what}")
            if each.hold_s and at[-1] < each.time_s + each.hold_s - 1e-6:
                found.append(f"the plan ends while it holds at {what}")
            continue
        if away > each.radius_m - max(manifest.radius_m - manifest.margin_m, 0) + CLOSE_M:
            found.append(f"{what} is passed {away:.3g} m from its centre")
        height = (place - each.point_m) @ np.array(each.normal)
        for side, row in ((-1, height[at <= each.time_s][::-1]), (1, height[at >= each.time_s])):
            far = np.flatnonzero(side * row >= REACH_M)
            wrong = np.flatnonzero(side * row < -CLOSE_M)
            if not len(far) or (len(wrong) and wrong[0] < far[0]):
                found.append(f"{what} is not flown through {'before' if side < 0 else 'behind'} its plane")
    return found
