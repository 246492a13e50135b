"""Parameters of `plan`."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from alula.schemas.errors import UsageError
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
class AlongPlanConfig:
    """Parameters of flights along a plan, simulated or real."""

    via_tolerance_m: float | None = field(
        default=None,
        metadata={
            "group": "Flight",
            "help": "Distance within which a via point of a plan counts as passed [m]; default: the "
            "vehicle's radius, at least 0.1.",
            "option": "--via-tolerance",
        },
    )
    allow_tight: bool = field(
        default=False,
        metadata={
            "group": "Flight",
            "help": "Fly a plan although it is nearer to the map than the filter lets the vehicle be.",
        },
    )
    beyond_map_m: float = field(
        default=0.0, metadata={"group": "Flight", "help": BEYOND_MAP_HELP, "option": "--beyond-map"}
    )
    allow_other_map: bool = field(
        default=False,
        metadata={
            "group": "Flight",
            "help": "Fly a plan in a map that it was not made in, nor in one of the same scene.",
        },
    )

    def __post_init__(self) -> None:
        """Refuse values out of range."""
        if not (0 <= self.beyond_map_m <= LARGEST_BEYOND_M):
            raise UsageError(
                f"--beyond-map must be between 0 and {LARGEST_BEYOND_M:g}, not {self.beyond_map_m:g}"
            )
        if self.via_tolerance_m is not None and not (1e-6 <= self.via_tolerance_m <= 1e3):
            raise UsageError(f"--via-tolerance must be between 1e-06 and 1000, not {self.via_tolerance_m:g}")


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanConfig:
    """Parameters of `plan`; points in the world frame [m]."""

    start: Point | None = field(
        default=None, metadata={"help": "First point of the flight [m].", "metavar": "POINT"}
    )
    goal: Point | None = field(
        default=None, metadata={"help": "Last point of the flight [m].", "metavar": "POINT"}
    )
    via: tuple[Point, ...] = field(
        default=(),
        metadata={"help": "Intermediate point to fly through [m]; may be repeated.", "metavar": "POINT"},
    )
    radius_m: float | None = field(
        default=None,
        metadata={
            "help": "Minimum distance to every obstacle [m]; default: the radius of the --vehicle, "
            "--margin, and --inflate where obstacles have not grown by it.",
            "option": "--radius",
        },
    )
    margin_m: float | None = field(
        default=None,
        metadata={
            "help": f"Distance that the filter will keep beyond the vehicle's radius, as --margin of fly "
            f"[m]; default: {MARGIN_M}. Hulls already contain the error of the alignment.",
            "option": "--margin",
        },
    )
    speed_m_s: float = field(default=1.0, metadata={"help": "Maximum speed [m/s].", "option": "--speed"})
    acceleration_m_s2: float = field(
        default=3.0,
        metadata={
            "group": "Limits of the motion",
            "help": "Maximum acceleration [m/s^2].",
            "option": "--acceleration",
        },
    )
    jerk_m_s3: float | None = field(
        default=None,
        metadata={
            "group": "Limits of the motion",
            "help": "Maximum jerk [m/s^3]; default: what the body rates and rotors of the vehicle allow.",
            "option": "--max-jerk",
        },
    )
    snap_m_s4: float | None = field(
        default=None,
        metadata={
            "group": "Limits of the motion",
            "help": "Maximum snap [m/s^4]; default: what the rotors of the vehicle allow.",
            "option": "--max-snap",
        },
    )
    tilt_rad: float | None = field(
        default=None,
        metadata={
            "group": "Limits of the motion",
            "help": "Maximum tilt of the thrust [rad]; default: 0.8 of that of the vehicle.",
            "option": "--tilt",
        },
    )
    body_rate_rad_s: float | None = field(
        default=None,
        metadata={
            "group": "Limits of the motion",
            "help": "Maximum rate of the thrust axis [rad/s]; default: 0.8 of that of the vehicle, or less "
            "for its rotors.",
            "option": "--body-rate",
        },
    )
    interface: PlannedInterface | None = field(
        default=None,
        metadata={
            "group": "Limits of the motion",
            "help": "What the vehicle will be commanded by; default: as fly commands it behind --filter, or "
            "without one behind its default filter in this map. A plan for accelerations or velocities keeps "
            "to the accelerations and the jerk with which the vehicle's own autopilot follows them.",
        },
    )
    filter: str | None = field(
        default=None,
        metadata={
            "help": "Filters behind which the plan will be flown, as --filter of simulate: where they would "
            "act it is slower and keeps farther away; none: a plan for flights without one; default: for a "
            "quadrotor the default filter of fly in this map, none with --straight or in an onboard map.",
            "metavar": "NAME,…",
        },
    )
    smooth: float = field(
        default=1.0,
        metadata={
            "group": "Search",
            "help": "Fly this many times the minimum time, at least 1, and minimise snap instead.",
        },
    )
    straight: bool = field(
        default=False,
        metadata={
            "group": "Search",
            "help": "Fly straight from start to goal, from rest to rest by a polynomial of degree 7 in time: "
            "the reference of FastBridge.",
        },
    )
    allow_blocked: bool = field(
        default=False,
        metadata={
            "group": "Search",
            "help": "With --straight, also write a plan that is not proven: for flights behind a filter.",
        },
    )
    resolution_m: float | None = field(
        default=None,
        metadata={
            "group": "Search",
            "help": "Spacing of the search lattice [m]; default: by --radius and the size of the box.",
            "option": "--resolution",
        },
    )
    bounds: tuple[float, float, float, float, float, float] | None = field(
        default=None,
        metadata={
            "group": "Search",
            "help": "Box to stay in, XMIN YMIN ZMIN XMAX YMAX ZMAX [m]; default: the mapped box.",
            "metavar": "BOX",
        },
    )
    beyond_map_m: float = field(
        default=0.0, metadata={"group": "Search", "help": BEYOND_MAP_HELP, "option": "--beyond-map"}
    )
    gate: tuple[Gate, ...] = field(
        default=(),
        metadata={
            "group": "Course",
            "help": "Hoop to fly through: centre [m], direction, radius of the opening [m]; may be repeated.",
            "metavar": "CX CY CZ NX NY NZ R",
        },
    )
    loops: int = field(
        default=1, metadata={"group": "Course", "help": "Laps: fly via points or gates so many times."}
    )
    yaw: str = field(
        default="0",
        metadata={
            "group": "Course",
            "help": "Heading: constant [rad], `along` the motion, or `towards:X,Y,Z`, a point [m].",
            "metavar": "HEADING",
        },
    )
    yaw_rate_rad_s: float | None = field(
        default=None,
        metadata={
            "group": "Course",
            "help": "Maximum rate of the heading [rad/s]; default: 2, or what the vehicle can do.",
            "option": "--yaw-rate",
        },
    )
    # What the obstacles are, and points that are not free.
    sigma: float = field(
        default=1.0,
        metadata={
            "group": "Obstacles of a scene",
            "help": "Level of a scene's ellipsoids as obstacles, in standard deviations.",
        },
    )
    confidence: float | None = field(
        default=None,
        metadata={
            "group": "Obstacles of a scene",
            "help": "Probability inside the ellipsoid; sets sigma by the chi-square distribution.",
        },
    )
    inflation_m: float | None = field(
        default=None,
        metadata={
            "group": "Obstacles of a scene",
            "help": "Distance that filters will add to radius and margin [m]; default: as suggested by the "
            "scene's alignment, and for hulls what of that they have not grown by.",
            "option": "--inflate",
        },
    )
    nearest_free: bool = field(
        default=False,
        metadata={
            "group": "Search",
            "help": "Move points of the flight that are not free to the nearest free one.",
        },
    )

    def __post_init__(self) -> None:
        """Refuse values out of range and points that cannot be flown through."""
        for option, value, low, high in (
            ("--radius", self.radius_m, 1e-3, 1e3),
            ("--margin", self.margin_m, 0.0, 100.0),
            ("--speed", self.speed_m_s, 1e-3, 1e3),
            ("--acceleration", self.acceleration_m_s2, 1e-3, 1e4),
            ("--max-jerk", self.jerk_m_s3, 1e-3, 1e6),
            ("--max-snap", self.snap_m_s4, 1e-3, 1e8),
            ("--tilt", self.tilt_rad, 1e-3, 1.5),
            ("--body-rate", self.body_rate_rad_s, 1e-3, 1e3),
            ("--yaw-rate", self.yaw_rate_rad_s, 1e-3, 1e3),
            ("--smooth", self.smooth, 1.0, 100.0),
            ("--resolution", self.resolution_m, 1e-4, 1e3),
            ("--sigma", self.sigma, 0.01, 100.0),
            ("--inflate", self.inflation_m, 0.0, 100.0),
            ("--beyond-map", self.beyond_map_m, 0.0, LARGEST_BEYOND_M),
        ):
            if value is not None and not (low <= value <= high):
                raise UsageError(f"{option} must be between {low:g} and {high:g}, not {value:g}")
        self.heading  # noqa: B018  # refuses what is none
        if not (1 <= self.loops <= 100):
            raise UsageError(f"--loops must be between 1 and 100, not {self.loops}")
        if self.straight and (self.via or self.gate or self.loops > 1):
            raise UsageError("--straight leads from --start to --goal; leave out --via, --gate and --loops")
        if self.straight and "look_at_m" in self.heading:
            raise UsageError("--straight has one heading: an angle in radians, or along")
        if self.allow_blocked and not self.straight:
            raise UsageError("--allow-blocked is for plans with --straight; all others are proven")
        if self.confidence is not None and not (0 < self.confidence < 1):
            raise UsageError(f"--confidence must be between 0 and 1, not {self.confidence}")
        points = self.points
        for before, after in pairwise(points) if self.via else ():
            if before == after:
                raise UsageError("two consecutive points of the flight are the same")
        if self.bounds is not None:
            lower, upper = self.bounds[:3], self.bounds[3:]
            if not all(a < b for a, b in zip(lower, upper, strict=True)):
                raise UsageError("--bounds needs XMIN < XMAX, YMIN < YMAX and ZMIN < ZMAX")
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
