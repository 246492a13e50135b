"""Parameters of `observe`."""

from __future__ import annotations

from dataclasses import dataclass, field

from alula.schemas.errors import UsageError
from alula.schemas.parameters.configs.scale_align import MIN_NEAR, NEAR_HELP, require_min_near
from alula.schemas.parameters.configs.voxelize import VoxelizeConfig

LONGEST_RADIUS_VOXELS = 80.0  # squared distances up to it fit into 16 bits


@dataclass(frozen=True, slots=True, kw_only=True)
class ObserveConfig(VoxelizeConfig):
    """Parameters of `observe`: the level of the obstacles as for `voxelize`, and what counts as seen."""

    radius_m: float | None = field(
        default=None,
        metadata={
            "help": "Radius of the ball that must be able to go there [m]; default: that of the --vehicle.",
            "option": "--radius",
        },
    )
    range_m: float = field(
        default=5.0,
        metadata={
            "group": "Depth images",
            "help": "Depth up to which a pixel without a surface sees [m]; a pixel with one sees up to it.",
            "option": "--range",
        },
    )
    near_m: float = field(
        default=0.1,
        metadata={
            "group": "Depth images",
            "help": "Smallest depth of a voxel that is seen [m].",
            "option": "--near",
        },
    )
    columns: int = field(
        default=400,
        metadata={"group": "Depth images", "help": "Pixels along the longer side of a depth image."},
    )
    min_views: int = field(
        default=1, metadata={"group": "Depth images", "help": "Minimum number of cameras that see a voxel."}
    )
    min_near: float = field(default=MIN_NEAR, metadata={"group": "Cameras", "help": NEAR_HELP})
    reach: tuple[float, float, float] | None = field(
        default=None,
        metadata={
            "help": "Without cameras: take the closed space around this point for free [m].",
            "metavar": "POINT",
        },
    )

    def __post_init__(self) -> None:
        """Refuse values out of range."""
        VoxelizeConfig.__post_init__(self)
        require_min_near(self.min_near)
        if self.radius_m is not None and not (0 < self.radius_m <= LONGEST_RADIUS_VOXELS * self.size_m):
            raise UsageError(
                f"--radius must be above 0 and at most {LONGEST_RADIUS_VOXELS:g} voxels "
                f"({LONGEST_RADIUS_VOXELS * self.size_m:g} m), not {self.radius_m:g}"
            )
        if not (1e-3 <= self.near_m < self.range_m <= 1e4):
            raise UsageError(
                f"--near and --range need 0.001 <= near < range <= 10000 m, not {self.near_m:g} and "
                f"{self.range_m:g}"
            )
        if not (16 <= self.columns <= 8192):
            raise UsageError(f"--columns must be between 16 and 8192, not {self.columns}")
        if not (1 <= self.min_views <= 65535):
            raise UsageError(f"--min-views must be between 1 and 65535, not {self.min_views}")
