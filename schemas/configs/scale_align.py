"""Parameters of `scale-align`."""

from __future__ import annotations

from dataclasses import dataclass, field

from alula.schemas.errors import UsageError

Point = tuple[float, float, float]
Distance = tuple[Point, Point, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class ScaleAlignConfig:
    """Parameters of `scale-align`; what it aligns by is an input, except distances and a plain scale."""

    scale: float | None = field(default=None, metadata={"help": "Metres per unit of the scene."})
    origin: Point | None = field(
        default=None,
        metadata={
            "help": "Where lat,lon,alt become 0,0,0; default: the first row of --reference.",
            "metavar": "'LAT LON ALT'",
        },
    )
    up: Point | None = field(
        default=None,
        metadata={
            "help": "Direction in the scene's frame to turn to +z; with --floor, about where up is.",
            "metavar": "'X Y Z'",
        },
    )
    floor: bool = field(
        default=False,
        metadata={
            "help": "Find the floor: turn its normal to +z, make its height 0; unaligned scenes need --up."
        },
    )
    threshold_m: float = field(
        default=0.1,
        metadata={
            "help": "Correspondences with a larger residual are outliers; a --floor is as thick [m].",
            "option": "--threshold",
        },
    )
    max_angle_deg: float = field(
        default=5.0,
        metadata={
            "help": "Poses whose orientations differ by more are outliers [deg].",
            "option": "--angle-threshold",
        },
    )
    max_rms_m: float | None = field(
        default=None,
        metadata={"help": "Fail if the inliers' RMS residual is larger [m].", "option": "--max-rms"},
    )
    max_scale_sigma: float | None = field(
        default=None, metadata={"help": "Fail if the scale's standard deviation is larger [m per unit]."}
    )
    min_inliers: int | None = field(
        default=None, metadata={"help": "Fail with fewer inliers; default: more than half of all."}
    )
    min_fitness: float = field(
        default=0.3,
        metadata={"help": "Fail if a smaller share of scene or --cloud, the larger, overlaps the other."},
    )
    distances: tuple[Distance, ...] = field(default=(), metadata={"internal": True})

    def __post_init__(self) -> None:
        """Refuse values that mean nothing."""
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
        if not (0 < self.min_fitness <= 1):
            raise UsageError(f"--min-fitness must be above 0 and at most 1, not {self.min_fitness}")
        if self.min_inliers is not None and self.min_inliers < 1:
            raise UsageError(f"--min-inliers must be at least 1, not {self.min_inliers}")
        if self.origin is not None and not (abs(self.origin[0]) <= 90 and abs(self.origin[1]) <= 180):
            raise UsageError("--origin must be latitude, longitude [deg] and height [m]")
        if self.up is not None and not (1e-9 <= max(map(abs, self.up)) <= 1e9):
            raise UsageError("--up is no direction")
        if len({frozenset(ends[:2]) for ends in self.distances}) < len(self.distances):
            raise UsageError("--distance: the same two points are given twice, which says nothing new")
        for start, end, metres in self.distances:
            if not (1e-9 <= metres <= 1e9):
                raise UsageError(f"--distance: {metres} m is no distance between two points")
            if start == end:
                raise UsageError("--distance: both points are the same")

    @property
    def levels(self) -> bool:
        """Whether the frame is to be levelled."""
        return self.floor or self.up is not None
