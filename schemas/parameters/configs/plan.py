"""Parameters of `plan`."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from alula.schemas.errors import UsageError
from alula.schemas.parameters.configs.config import Config, box_option, option
from alula.schemas.parameters.flight_defaults import PlannedInterface

MARGIN_M = 0.1  # that filters keep beyond the vehicle's radius in flight, for errors of tracking and state
BEYOND_MAP = "--beyond-map "  # before its value, in messages
LARGEST_BEYOND_M = 1e3
BEYOND_MAP_HELP = (
    "Distance around the mapped box, the box around all obstacles, in which space counts as free although "
    "the map does not have it [m]."
)
Point = tuple[float, float, float]
Gate = tuple[float, float, float, float, float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class AlongPlanConfig(Config):
    """Parameters of flights along a plan, simulated or real."""

    via_tolerance_m: float | None = option(
        None,
        "Distance within which a via point of a plan counts as passed [m]; default: the vehicle's radius, "
        "at least 0.1.",
        group="Flight",
        within=(1e-6, 1e3),
    )
    allow_tight: bool = option(
        False,
        "Fly a plan although it is nearer to the map than the filter lets the vehicle be.",
        group="Flight",
    )
    beyond_map_m: float = option(0.0, BEYOND_MAP_HELP, group="Flight", within=(0, LARGEST_BEYOND_M))
    allow_other_map: bool = option(
        False, "Fly a plan in a map that it was not made in, nor in one of the same scene.", group="Flight"
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanConfig(Config):
    """Parameters of `plan`; points in the world frame [m]."""

    start: Point | None = option(None, "First point of the flight [m].", metavar="POINT")
    goal: Point | None = option(None, "Last point of the flight [m].", metavar="POINT")
    via: tuple[Point, ...] = option(
        (), "Intermediate point to fly through [m]; may be repeated.", metavar="POINT"
    )
    radius_m: float | None = option(
        None,
        "Minimum distance to every obstacle [m]; default: the radius of the --vehicle, --margin, and "
        "--inflate where obstacles have not grown by it.",
        within=(1e-3, 1e3),
    )
    margin_m: float | None = option(
        None,
        f"Distance that the filter will keep beyond the vehicle's radius, as --margin of fly "
        f"[m]; default: {MARGIN_M}. Hulls already contain the error of the alignment.",
        within=(0, 100),
    )
    speed_m_s: float = option(1.0, "Maximum speed [m/s].", within=(1e-3, 1e3))
    acceleration_m_s2: float = option(
        3.0, "Maximum acceleration [m/s^2].", group="Limits of the motion", within=(1e-3, 1e4)
    )
    jerk_m_s3: float | None = option(
        None,
        "Maximum jerk [m/s^3]; default: what the body rates and rotors of the vehicle allow.",
        flag="--max-jerk",
        group="Limits of the motion",
        within=(1e-3, 1e6),
    )
    snap_m_s4: float | None = option(
        None,
        "Maximum snap [m/s^4]; default: what the rotors of the vehicle allow.",
        flag="--max-snap",
        group="Limits of the motion",
        within=(1e-3, 1e8),
    )
    tilt_rad: float | None = option(
        None,
        "Maximum tilt of the thrust [rad]; default: 0.8 of that of the vehicle.",
        group="Limits of the motion",
        within=(1e-3, 1.5),
    )
    body_rate_rad_s: float | None = option(
        None,
        "Maximum rate of the thrust axis [rad/s]; default: 0.8 of that of the vehicle, or less for its "
        "rotors.",
        group="Limits of the motion",
        within=(1e-3, 1e3),
    )
    interface: PlannedInterface | None = option(
        None,
        "What the vehicle will be commanded by; default: as fly commands it behind --filter, or without "
        "one behind its default filter in this map. A plan for accelerations or velocities keeps to the "
        "accelerations and the jerk with which the vehicle's own autopilot follows them.",
        group="Limits of the motion",
    )
    filter: str | None = option(
        None,
        "Filters behind which the plan will be flown, as --filter of simulate: where they would act it is "
        "slower and keeps farther away; none: a plan for flights without one; default: for a quadrotor the "
        "default filter of fly in this map, none with --straight or in an onboard map.",
        metavar="NAME,…",
    )
    smooth: float = option(
        1.0,
        "Fly this many times the minimum time, at least 1, and minimise snap instead.",
        group="Search",
        within=(1, 100),
    )
    straight: bool = option(
        False,
        "Fly straight from start to goal, from rest to rest by a polynomial of degree 7 in time: the "
        "reference of FastBridge.",
        group="Search",
    )
    allow_blocked: bool = option(
        False,
        "With --straight, also write a plan that is not proven: for flights behind a filter.",
        group="Search",
    )
    resolution_m: float | None = option(
        None,
        "Spacing of the search lattice [m]; default: by --radius and the size of the box.",
        group="Search",
        within=(1e-4, 1e3),
    )
    bounds: tuple[float, float, float, float, float, float] | None = box_option(
        None, "Box to stay in, XMIN YMIN ZMIN XMAX YMAX ZMAX [m]; default: the mapped box.", group="Search"
    )
    beyond_map_m: float = option(0.0, BEYOND_MAP_HELP, group="Search", within=(0, LARGEST_BEYOND_M))
    gate: tuple[Gate, ...] = option(
        (),
        "Hoop to fly through: centre [m], direction, radius of the opening [m]; may be repeated.",
        group="Course",
        metavar="CX CY CZ NX NY NZ R",
    )
    loops: int = option(1, "Laps: fly via points or gates so many times.", group="Course", within=(1, 100))
    yaw: str = option(
        "0",
        "Heading: constant [rad], `along` the motion, or `towards:X,Y,Z`, a point [m].",
        group="Course",
        metavar="HEADING",
    )
    yaw_rate_rad_s: float | None = option(
        None,
        "Maximum rate of the heading [rad/s]; default: 2, or what the vehicle can do.",
        group="Course",
        within=(1e-3, 1e3),
    )
    # What the obstacles are, and points that are not free.
    sigma: float = option(
        1.0,
        "Level of a scene's ellipsoids as obstacles, in standard deviations.",
        group="Obstacles of a scene",
        within=(0.01, 100),
    )
    confidence: float | None = option(
        None,
        "Probability inside the ellipsoid; sets sigma by the chi-square distribution.",
        group="Obstacles of a scene",
        gt=0,
        lt=1,
    )
    inflation_m: float | None = option(
        None,
        "Distance that filters will add to radius and margin [m]; default: as suggested by the scene's "
        "alignment, and for hulls what of that they have not grown by.",
        flag="--inflate",
        group="Obstacles of a scene",
        within=(0, 100),
    )
    nearest_free: bool = option(
        False, "Move points of the flight that are not free to the nearest free one.", group="Search"
    )

    def __post_init__(self) -> None:
        Config.__post_init__(self)
        self.heading  # noqa: B018  # refuses what is none
        if self.straight and (self.via or self.gate or self.loops > 1):
            raise UsageError("--straight leads from --start to --goal; leave out --via, --gate and --loops")
        if self.straight and "look_at_m" in self.heading:
            raise UsageError("--straight has one heading: an angle in radians, or along")
        if self.allow_blocked and not self.straight:
            raise UsageError("--allow-blocked is for plans with --straight; all others are proven")
        points = self.points
        for before, after in pairwise(points) if self.via else ():
            if before == after:
                raise UsageError("two consecutive points of the flight are the same")
        if self.bounds is not None:
            lower, upper = self.bounds[:3], self.bounds[3:]
            for point in points:
                if not all(a <= x <= b for a, x, b in zip(lower, point, upper, strict=True)):
                    raise UsageError(f"the point {' '.join(f'{x:g}' for x in point)} is outside --bounds")

    @property
    def keep_m(self) -> float:
        """Distance to keep, without inflation, of a configuration that has it; see `resolve_plan` [m]."""
        assert self.radius_m is not None
        return self.radius_m

    @property
    def heading(self) -> dict[str, Any]:
        """The heading as keys of a mission."""
        if self.yaw == "along":
            return {"yaw": "along"}
        kind, _, rest = self.yaw.rpartition(":")
        try:
            values = [float(word) for word in rest.replace(",", " ").split()]
        except ValueError:
            values = []
        if kind == "towards" and len(values) == 3 and all(abs(x) < 1e6 for x in values):
            return {"look_at_m": tuple(values)}
        if kind or len(values) != 1:
            raise UsageError(f"--yaw is an angle in radians, along, or towards:X,Y,Z, not {self.yaw!r}")
        if not (-7 <= values[0] <= 7):
            raise UsageError(f"--yaw is in radians, not {values[0]:g}")
        return {"yaw_rad": values[0]}

    @property
    def points(self) -> list[Point]:
        """Start, intermediate points, goal; those that are given."""
        return [point for point in (self.start, *self.via, self.goal) if point is not None]
