"""Parameters of `scale-align`."""

from __future__ import annotations

from dataclasses import dataclass, field

from alula.schemas.errors import UsageError

Point = tuple[float, float, float]
Distance = tuple[Point, Point, float]
MIN_NEAR = 0.6
NEAR_HELP = (
    "Minimum fraction of the 3D points of --colmap that have a Gaussian near; below it, cameras are mapped "
    "to the splat's frame if that is found, else refused."
)


def require_min_near(fraction: float) -> None:
    """Refuse a minimum fraction of near points that is none.

    Raises:
        UsageError: it is not between 0 and 1.
    """
    if not (0 <= fraction <= 1):
        raise UsageError(f"--min-near must be between 0 and 1, not {fraction}")


def require_map_origin(origin: Point | None) -> None:
    """Refuse an origin of a map beyond the earth.

    Args:
        origin: value of --map-origin [m].

    Raises:
        UsageError: a coordinate is not finite or beyond 1e8 m.
    """
    if origin is not None and not all(abs(c) <= 1e8 for c in origin):
        raise UsageError("--map-origin must have coordinates between -1e+08 and 1e+08 m")


@dataclass(frozen=True, slots=True, kw_only=True)
class ScaleAlignConfig:
    """Parameters of `scale-align`; the evidence is an input, except distances and a plain scale."""

    scale: float | None = field(default=None, metadata={"help": "Metres per unit of the scene."})
    origin: Point | None = field(
        default=None,
        metadata={
            "group": "Cameras",
            "help": "Position where lat,lon,alt become 0,0,0; default: the first row of --reference.",
            "metavar": "'LAT LON ALT'",
        },
    )
    map_origin: Point | None = field(
        default=None,
        metadata={
            "group": "Cameras",
            "help": "Position of the world that becomes 0 0 0 of the map [m]; default: 0 0 0, or a round one "
            "in the middle where coordinates are too large for the map's numbers.",
            "metavar": "'X Y Z'",
        },
    )
    up: Point | None = field(
        default=None,
        metadata={
            "help": "Direction in the scene's frame to turn to +z; with --floor, an approximate one.",
            "metavar": "'X Y Z'",
        },
    )
    floor: bool = field(
        default=False,
        metadata={
            "help": "Find the floor, turn its normal to +z and make its height 0; unaligned scenes need --up."
        },
    )
    rescale: bool = field(
        default=False,
        metadata={
            "group": "Checks",
            "help": "Accept another scale for a scene that is in metres already.",
        },
    )
    threshold_m: float = field(
        default=0.1,
        metadata={
            "group": "Checks",
            "help": "Maximum residual of an inlier, and half the thickness of a --floor [m].",
            "option": "--threshold",
        },
    )
    max_angle_deg: float = field(
        default=5.0,
        metadata={
            "group": "Checks",
            "help": "Maximum angle between the orientations of an inlier [deg].",
            "option": "--angle-threshold",
        },
    )
    max_rms_m: float | None = field(
        default=None,
        metadata={"help": "Maximum RMS residual of the inliers [m]; fail above it.", "option": "--max-rms"},
    )
    max_scale_sigma: float | None = field(
        default=None,
        metadata={
            "group": "Checks",
            "help": "Maximum standard deviation of the scale [m per unit]; fail above it.",
        },
    )
    min_inliers: int | None = field(
        default=None,
        metadata={
            "group": "Checks",
            "help": "Minimum number of inliers; fail below it; default: more than half of all.",
        },
    )
    min_matched: float = field(
        default=0.5,
        metadata={
            "group": "Checks",
            "help": "Minimum fraction of the rows of --reference or --poses whose image is a camera of the "
            "scene; the others are skipped.",
        },
    )
    min_near: float = field(
        default=MIN_NEAR,
        metadata={"group": "Checks", "help": NEAR_HELP},
    )
    min_fitness: float = field(
        default=0.3,
        metadata={
            "group": "Checks",
            "help": "Minimum fraction of scene or --cloud, the larger of both, that overlaps the other.",
        },
    )
    distances: tuple[Distance, ...] = field(default=(), metadata={"internal": True})

    def __post_init__(self) -> None:
        """Refuse values out of range."""
        for name, value in (
            ("--threshold", self.threshold_m),
            ("--max-rms", self.max_rms_m),
            ("--max-scale-sigma", self.max_scale_sigma),
            ("--scale", self.scale),
        ):
            if value is not None and not (1e-9 <= value <= 1e9):
                raise UsageError(f"{name} must be between 1e-9 and 1e9, not {value}")
        if not (0 < self.max_angle_deg <= 90):
            raise UsageError(f"--angle-threshold must be above 0 and at most 90, not {self.max_angle_deg}")
        if not (0 < self.min_matched <= 1):
            raise UsageError(f"--min-matched must be above 0 and at most 1, not {self.min_matched}")
        if not (0 < self.min_fitness <= 1):
            raise UsageError(f"--min-fitness must be above 0 and at most 1, not {self.min_fitness}")
        require_min_near(self.min_near)
        require_map_origin(self.map_origin)
        if self.min_inliers is not None and self.min_inliers < 1:
            raise UsageError(f"--min-inliers must be at least 1, not {self.min_inliers}")
        if self.origin is not None and not (abs(self.origin[0]) <= 90 and abs(self.origin[1]) <= 180):
            raise UsageError("--origin must be latitude, longitude [deg] and height [m]")
        if self.up is not None and not (1e-9 <= max(map(abs, self.up)) <= 1e9):
            raise UsageError("--up is no direction: its largest component must be between 1e-9 and 1e9")
        if len({frozenset(ends[:2]) for ends in self.distances}) < len(self.distances):
            raise UsageError("--distance: the same two points are given twice; give each pair once")
        for start, end, metres in self.distances:
            if not (1e-9 <= metres <= 1e9):
                raise UsageError(f"--distance: must be between 1e-9 and 1e9 m, not {metres}")
            if start == end:
                raise UsageError("--distance: both points are the same")

    @property
    def levels(self) -> bool:
        """True when the frame is to be levelled."""
        return self.floor or self.up is not None
