"""Parameters of `scale-align`."""

from __future__ import annotations

from dataclasses import dataclass

from alula.schemas.errors import UsageError
from alula.schemas.parameters.configs.config import Config, internal, option

Point = tuple[float, float, float]
Distance = tuple[Point, Point, float]
MIN_NEAR = 0.6
NEAR_HELP = (
    "Minimum fraction of the 3D points of --colmap that have a Gaussian near; below it, cameras are mapped "
    "to the splat's frame if that is found, else refused."
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ScaleAlignConfig(Config):
    """Parameters of `scale-align`; the evidence is an input, except distances and a plain scale."""

    scale: float | None = option(None, "Metres per unit of the scene.", within=(1e-9, 1e9))
    origin: Point | None = option(
        None,
        "Position where lat,lon,alt become 0,0,0; default: the first row of --reference.",
        group="Cameras",
        metavar="'LAT LON ALT'",
    )
    map_origin: Point | None = option(
        None,
        "Position of the world that becomes 0 0 0 of the map [m]; default: 0 0 0, or a round one in the "
        "middle where coordinates are too large for the map's numbers.",
        group="Cameras",
        metavar="'X Y Z'",
        within=(-1e8, 1e8),
    )
    up: Point | None = option(
        None,
        "Direction in the scene's frame to turn to +z; with --floor, an approximate one.",
        metavar="'X Y Z'",
    )
    floor: bool = option(
        False, "Find the floor, turn its normal to +z and make its height 0; unaligned scenes need --up."
    )
    rescale: bool = option(
        False, "Accept another scale for a scene that is in metres already.", group="Checks"
    )
    threshold_m: float = option(
        0.1,
        "Maximum residual of an inlier, and half the thickness of a --floor [m].",
        group="Checks",
        within=(1e-9, 1e9),
    )
    max_angle_deg: float = option(
        5.0,
        "Maximum angle between the orientations of an inlier [deg].",
        flag="--angle-threshold",
        group="Checks",
        gt=0,
        le=90,
    )
    max_rms_m: float | None = option(
        None, "Maximum RMS residual of the inliers [m]; fail above it.", within=(1e-9, 1e9)
    )
    max_scale_sigma: float | None = option(
        None,
        "Maximum standard deviation of the scale [m per unit]; fail above it.",
        group="Checks",
        within=(1e-9, 1e9),
    )
    min_inliers: int | None = option(
        None,
        "Minimum number of inliers; fail below it; default: more than half of all.",
        group="Checks",
        ge=1,
    )
    min_matched: float = option(
        0.5,
        "Minimum fraction of the rows of --reference or --poses whose image is a camera of the scene; the "
        "others are skipped.",
        group="Checks",
        gt=0,
        le=1,
    )
    min_near: float = option(MIN_NEAR, NEAR_HELP, group="Checks", within=(0, 1))
    min_fitness: float = option(
        0.3,
        "Minimum fraction of scene or --cloud, the larger of both, that overlaps the other.",
        group="Checks",
        gt=0,
        le=1,
    )
    distances: tuple[Distance, ...] = internal(())

    def __post_init__(self) -> None:
        Config.__post_init__(self)
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
