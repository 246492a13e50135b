"""Steps that `identify` flies: their set-points over time, and whether they fit into the box."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.vehicle import VelocitiesTable
from alula.stages.vehicles.velocity_lag import LAG_MARGIN, stop_time_s

# A step and its stop each last this many times the predicted time of 63 %, and a constant.
_SETTLING, _LONGER_S = 3.0, 0.5
_DIRECTIONS = (
    ("+x", 0, 1.0),
    ("-x", 0, -1.0),
    ("+y", 1, 1.0),
    ("-y", 1, -1.0),
    ("+z", 2, 1.0),
    ("-z", 2, -1.0),
)
# Doublets of body rates: rate [rad/s] and duration of each half [s]; of the thrust: fraction of the weight.
RATE_RAD_S, _TILT_S, _TURN_S = 0.5, 0.3, 1.5
THRUST_SHARE, _THRUST_S = 0.2, 0.4
_REPEATS = 2  # of each doublet, in both directions
_DOUBLET_M = 1.0  # distance from the box in which doublets of rates and thrust end

Kind = Literal["velocity", "rate", "thrust"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """One step, flown from rest and back to rest.

    Attributes:
        name: for people.
        kind: of set-points.
        axis: of the world for velocities, of the body for rates; 2 for the thrust.
        size: signed: velocity [m/s], rate [rad/s] or fraction of the weight.
        out_s: duration of the step [s].
        back_s: duration of its end [s]: zero velocity, or the opposite rate or thrust.
        start: where it begins, shape (3,), world frame [m].
        travel_m: predicted distance from there to rest [m].
    """

    name: str
    kind: Kind
    axis: int
    size: float
    out_s: float
    back_s: float
    start: FloatArray
    travel_m: float = 0.0

    @property
    def duration_s(self) -> float:
        """Duration with its end [s]."""
        return self.out_s + self.back_s


@dataclass(frozen=True, slots=True)
class Steps:
    """Steps to fly, and those left out, in words."""

    flown: list[Step]
    skipped: list[str]


def plan_steps(
    following: VelocitiesTable,
    speeds_m_s: Sequence[float],
    box: Sequence[float],
    *,
    radius_m: float,
    reserve_m: float,
    rates: bool,
) -> Steps:
    """Steps of the velocity along all axes at all speeds, and on demand of rates and thrust.

    A velocity v is kept until the first guess of its response has settled. A vehicle with a lag comes to rest
    at most v times the duration of the step from its start; a quarter of the stop is added. A step is about
    the box's centre, so that the opposite one begins where it ends. It is left out unless its travel, the
    vehicle's radius and the reserve on both sides fit into the box.

    Args:
        following: first guess of how the vehicle follows velocities.
        speeds_m_s: speeds [m/s].
        box: XMIN YMIN ZMIN XMAX YMAX ZMAX, world frame [m].
        radius_m: of the vehicle [m].
        reserve_m: additional distance to the box [m].
        rates: also steps of rates and thrust.
    """
    low, high = np.array(box[:3], np.float64), np.array(box[3:], np.float64)
    centre, half = (low + high) / 2, (high - low) / 2 - radius_m - reserve_m
    flown, skipped = list[Step](), list[str]()
    for speed in sorted(speeds_m_s):
        for name, axis, sign in _DIRECTIONS:
            lag = stop_time_s(following.vertical_lag if axis == 2 else following.horizontal_lag, speed)
            settles_s = _SETTLING * lag + _LONGER_S
            travel = speed * (settles_s + (LAG_MARGIN - 1) * lag)
            words = f"{name} at {speed:g} m/s"
            if travel > 2 * half[axis]:
                room = 2 * max(0.0, float(half[axis]))
                skipped.append(f"{words}: it needs {travel:.1f} m, and the box has {room:.1f} m")
                continue
            start = centre.copy()
            start[axis] -= sign * travel / 2
            flown.append(
                Step(
                    name=words,
                    kind="velocity",
                    axis=axis,
                    size=sign * speed,
                    out_s=settles_s,
                    back_s=settles_s,
                    start=start,
                    travel_m=travel,
                )
            )
    if rates and (half < _DOUBLET_M).any():
        skipped.append(f"steps of rates and thrust: they need {2 * _DOUBLET_M:g} m along each axis")
    elif rates:
        for _ in range(_REPEATS):
            for sign in (1.0, -1.0):
                for name, axis, seconds in (("roll", 0, _TILT_S), ("pitch", 1, _TILT_S), ("yaw", 2, _TURN_S)):
                    flown.append(_doublet(f"{name} rate", "rate", axis, sign * RATE_RAD_S, seconds, centre))
                flown.append(_doublet("thrust", "thrust", 2, sign * THRUST_SHARE, _THRUST_S, centre))
    return Steps(flown, skipped)


def _doublet(name: str, kind: Kind, axis: int, size: float, seconds: float, centre: FloatArray) -> Step:
    return Step(
        name=name,
        kind=kind,
        axis=axis,
        size=size,
        out_s=seconds,
        back_s=seconds,
        start=centre,
        travel_m=_DOUBLET_M,
    )
