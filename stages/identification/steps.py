"""Steps that `identify` flies: their set-points over time, and whether they fit into the box."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.scenarios.vehicle import Vehicle
from alula.stages.vehicles.velocity_lag import LAG_MARGIN, stop_m, stop_time_s

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
_REPEATS = 2  # of each doublet, in both directions; fast ones are not repeated
_DOUBLET_M = 1.0  # distance from the box in which doublets of rates and thrust end
# Fast doublets show how fast the vehicle can rotate. One that tilts lasts until the rate has settled, and is
# so fast that the lean is this by then; it ends early before the lean could exceed the maximum.
LEAN_RAD, MAX_LEAN_RAD = 0.35, 0.6
_OF_OWN_LEAN = 0.8  # part of the vehicle's own lean angle limit that it may reach
_RATE_SETTLING, _RATE_DELAY_S = 4.0, 0.06
_LEAST_LAG_S = (0.04, 0.04, 0.3)  # rate loops about as slow as ArduPilot's, whatever the first guess says
_TURNED_RAD_S = 6.0  # fastest turn

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
        back_s: duration of its end [s].
        back: set-point of its end, by that of the step: 0, or -1 for the opposite.
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
    back: float = 0.0

    @property
    def is_fast(self) -> bool:
        """A step of a rate that shows how fast the vehicle can rotate."""
        return self.kind == "rate" and abs(self.size) > RATE_RAD_S

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
    vehicle: Vehicle,
    speeds_m_s: Sequence[float],
    box: Sequence[float],
    *,
    reserve_m: float,
    rates: bool,
    lean_rad: float = math.inf,
    turns_rad_s2: float = math.inf,
) -> Steps:
    """Steps of the velocity along all axes at all speeds, and on demand of rates and thrust.

    A velocity v is kept until the first guess of its response has settled. A vehicle with a lag comes to rest
    at most v times the duration of the step from its start; a quarter of the stop is added. A step is about
    the box's centre, so that the opposite one begins where it ends. It is left out unless its travel, the
    vehicle's radius and the reserve on both sides fit into the box.

    Args:
        box: XMIN YMIN ZMIN XMAX YMAX ZMAX, world frame [m].
        reserve_m: additional distance to the box [m].
        rates: also steps of rates and thrust.
        lean_rad: largest lean angle by the vehicle's parameters [rad].
        turns_rad_s2: largest yaw acceleration by the vehicle's parameters [rad/s^2].
    """
    low, high = np.array(box[:3], np.float64), np.array(box[3:], np.float64)
    centre, half = (low + high) / 2, (high - low) / 2 - vehicle.body.radius_m - reserve_m
    following = vehicle.following
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
    if rates:
        doublets = _doublets(vehicle, centre, lean_rad, turns_rad_s2)
        flown += [each for each in doublets if (half >= each.travel_m).all()]
        far = {each.name: each.travel_m for each in doublets if not (half >= each.travel_m).all()}
        skipped += [f"{name}: it needs {2 * travel:.1f} m along each axis" for name, travel in far.items()]
    return Steps(flown, skipped)


def _doublets(vehicle: Vehicle, centre: FloatArray, lean_rad: float, turns_rad_s2: float) -> list[Step]:
    """Steps of rates and thrust, first the slow ones."""
    slow, fast = list[Step](), list[Step]()
    for repeat in range(_REPEATS):
        for sign in (1.0, -1.0):
            for name, axis, seconds in (("roll", 0, _TILT_S), ("pitch", 1, _TILT_S), ("yaw", 2, _TURN_S)):
                slow.append(_doublet(f"{name} rate", "rate", axis, sign * RATE_RAD_S, seconds, centre))
                quick = _fastest(vehicle, axis, lean_rad, turns_rad_s2)
                if quick is not None and repeat == 0:
                    rate, seconds, travel = quick
                    words = f"{name} rate of {rate:.1f} rad/s"
                    each = _doublet(words, "rate", axis, sign * rate, seconds, centre, travel)
                    fast.append(dataclasses.replace(each, back=0.0) if axis == 2 else each)
            slow.append(_doublet("thrust", "thrust", 2, sign * THRUST_SHARE, _THRUST_S, centre))
    return slow + fast


def _fastest(
    vehicle: Vehicle, axis: int, lean_rad: float, turns_rad_s2: float
) -> tuple[float, float, float] | None:
    """Rate [rad/s], duration [s] and travel [m] of a fast doublet; None if it is no faster than a slow one.

    A tilt to an angle a and back in T each gives the speed g a T, which the vehicle then stops.
    """
    allowed = vehicle.rates.max_rad_s[axis]
    lasts_s = _RATE_SETTLING * max(vehicle.rates.axes_s[axis], _LEAST_LAG_S[axis]) + _RATE_DELAY_S
    if axis == 2:
        rate = min(allowed, _TURNED_RAD_S)
        return (rate, lasts_s + rate / turns_rad_s2, 0.0) if rate > RATE_RAD_S else None
    lean = min(LEAN_RAD, _OF_OWN_LEAN * lean_rad)
    rate = min(allowed, lean / lasts_s)
    speed = vehicle.body.gravity_m_s2 * rate * lasts_s * lasts_s
    travel = speed * lasts_s + stop_m(vehicle.following.horizontal_lag, speed)
    return (rate, lasts_s, max(travel, _DOUBLET_M)) if rate > RATE_RAD_S else None


def _doublet(
    name: str,
    kind: Kind,
    axis: int,
    size: float,
    seconds: float,
    centre: FloatArray,
    travel_m: float = _DOUBLET_M,
) -> Step:
    return Step(
        name=name,
        kind=kind,
        axis=axis,
        size=size,
        out_s=seconds,
        back_s=seconds,
        start=centre,
        travel_m=travel_m,
        back=-1.0,
    )
