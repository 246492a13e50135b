"""The mapped box: what lies outside of it is unknown, and unknown is not free."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.decimals import at_most, exact
from alula.stages.planning.trajectory import control_points, subdivided

BEYOND_KEY = "--set mission.beyond_map_m="  # before its value, in messages
ROUNDING_M = 1e-6  # of stored coefficients and printed points
_UNITS = (("feet", 0.3048), ("centimetres", 0.01), ("millimetres", 0.001))  # the largest that fits is named
_PROJECTED_M = 1e5  # from which both horizontal coordinates look like a map projection's
_FAR = 1.0  # of the largest edge of the box: points that are farther outside may be in another unit
_CHUNK = 1 << 18  # Gaussians in memory at once in double precision
_PARTS = 8  # of a piece, by whose control points its extent is bounded


@dataclass(frozen=True, slots=True)
class Mapped:
    """The box around all obstacles of a map, grown by what the user says is free around it.

    Attributes:
        lower, upper: corners of the box around all obstacles, shape (3,) [m].
        beyond_m: distance around this box in which space counts as free, because the user says so [m].
    """

    lower: FloatArray
    upper: FloatArray
    beyond_m: float = 0.0

    def room(self, radius_m: float) -> tuple[FloatArray, FloatArray]:
        """Corners of the box that the centre of a ball stays in, each of shape (3,) [m].

        Where the ball does not fit between two faces, both corners are in their middle.
        """
        inside = radius_m - self.beyond_m
        middle = 0.5 * (self.lower + self.upper)
        return np.minimum(self.lower + inside, middle), np.maximum(self.upper - inside, middle)

    def beyond(self, points: FloatArray, radius_m: float) -> FloatArray:
        """Maximum distance along an axis by which balls reach out of the box, shape (N,); 0 inside [m].

        Args:
            points: centres, shape (N, 3) [m].
        """
        lower, upper = self.room(radius_m)
        out: FloatArray = np.maximum(lower - points, points - upper).max(axis=1, initial=0.0)
        return np.where(out > ROUNDING_M, out, 0.0)

    def refusal(
        self, named: Sequence[tuple[str, Sequence[float]]], radius_m: float, insist: str
    ) -> str | None:
        """Say which point is outside, how far, and in which unit it probably is; None where all are inside.

        Args:
            radius_m: of the ball around each [m].
            insist: option that grows the box, up to its value.
        """
        points = np.array([point for _, point in named], np.float64).reshape(-1, 3)
        out = self.beyond(points, radius_m)
        if not out.any():
            return None
        name, point = named[int(np.flatnonzero(out)[0])]
        where = f"{name} ({' '.join(f'{x:g}' for x in point)})"
        return self._words(where, float(out.max()), points[out > 0], radius_m, insist)

    def refusal_of_plan(self, plan: Artifact, radius_m: float, insist: str) -> str | None:
        """Say how far a plan leads out of the box at any instant; None where it does not.

        Each part of a piece lies in the box around its control points.

        Args:
            insist: option that grows the box, up to its value.
        """
        coefficient = np.asarray(plan["coefficient"], np.float64)[:, :3]
        points = subdivided(control_points(plan["time"], coefficient), _PARTS)
        every = np.moveaxis(points, 1, -1).reshape(-1, 3)
        out = self.beyond(every, radius_m)
        if not out.any():
            return None
        return self._words("the plan", float(out.max()), every[out > 0], radius_m, insist)

    def _words(self, what: str, out_m: float, points: FloatArray, radius_m: float, insist: str) -> str:
        box = " ".join(f"{x:.4g}" for x in (*self.lower, *self.upper))
        is_far = out_m > _FAR * float((self.upper - self.lower).max())
        out = np.maximum(self.lower - points, points - self.upper) > self.beyond_m
        unit = self._unit(points) if is_far and (out.sum(axis=1) > 1).any() else ""
        return (
            f"{what} is {at_most(out_m)} m outside of the mapped box ({box} m, less a radius of {radius_m:g} "
            f"m), and what is there is unknown{f' ({unit}?)' if unit else ''}; "
            f"{insist}{at_most(self.beyond_m + out_m, 2)} takes so much around the box for free"
        )

    def _unit(self, points: FloatArray) -> str:
        """The unit that points outside are probably in; empty where nothing suggests another than metres."""
        x, y = np.abs(points[:, 0]), np.abs(points[:, 1])
        if ((x > _PROJECTED_M) & (y > _PROJECTED_M)).all():
            return "coordinates of a map projection"
        fine = np.abs(points[:, :2] - np.round(points[:, :2], 3)) > 1e-9
        if (np.maximum(x, y) <= 180).all() and (np.minimum(x, y) <= 90).all() and fine.all():
            return "latitude and longitude in degrees"
        for name, factor in _UNITS:
            scaled = factor * points
            if ((scaled >= self.lower) & (scaled <= self.upper)).all():
                return f"in {name}"
        return ""


def within_crop(
    box: tuple[FloatArray, FloatArray], crop: Sequence[float] | None
) -> tuple[FloatArray, FloatArray]:
    """The part of a box that a map's crop lets it know: what lies outside of the crop is unknown.

    Args:
        box: corners, each of shape (3,) [m].
        crop: XMIN YMIN ZMIN XMAX YMAX ZMAX; None for none [m].
    """
    if crop is None:
        return box
    return np.maximum(box[0], crop[:3]), np.minimum(box[1], crop[3:])


def words_beyond(beyond_m: float) -> str:
    """What a guarantee leaves out where space around the mapped box was taken for free; empty without.

    Args:
        beyond_m: see `Mapped` [m].
    """
    if beyond_m == 0:
        return ""
    return f" Space up to {exact(beyond_m)} m around the mapped box counts as free, though it is unknown."


def ellipsoid_box(scene: Artifact, sigma: float) -> list[FloatArray]:
    """Corners of a box around the ellipsoids of a scene, of shape (1, 3) each [m]; none without any."""
    corners: list[FloatArray] = []
    for first in range(0, len(scene["mean"]), _CHUNK):
        rows = slice(first, first + _CHUNK)
        mean = np.asarray(scene["mean"][rows], np.float64)
        reach = sigma * np.asarray(scene["scale"][rows].max(axis=1), np.float64)[:, None]
        corners += [(mean - reach).min(axis=0), (mean + reach).max(axis=0)]
    every = np.array(corners)
    return [every.min(axis=0)[None], every.max(axis=0)[None]] if corners else []
