"""Parameters of `observe`."""

from __future__ import annotations

from dataclasses import dataclass

from alula.schemas.errors import UsageError
from alula.schemas.parameters.configs.config import Config, option
from alula.schemas.parameters.configs.scale_align import MIN_NEAR, NEAR_HELP
from alula.schemas.parameters.configs.voxelize import VoxelizeConfig

LONGEST_RADIUS_VOXELS = 80.0  # squared distances up to it fit into 16 bits


@dataclass(frozen=True, slots=True, kw_only=True)
class ObserveConfig(VoxelizeConfig):
    """Parameters of `observe`: the level of the obstacles as for `voxelize`, and what counts as seen."""

    radius_m: float | None = option(
        None, "Radius of the ball that must be able to go there [m]; default: that of the --vehicle."
    )
    range_m: float = option(
        5.0,
        "Depth up to which a pixel without a surface sees [m]; a pixel with one sees up to it.",
        group="Depth images",
    )
    near_m: float = option(0.1, "Smallest depth of a voxel that is seen [m].", group="Depth images")
    columns: int = option(
        400, "Pixels along the longer side of a depth image.", group="Depth images", within=(16, 8192)
    )
    min_views: int = option(
        1, "Minimum number of cameras that see a voxel.", group="Depth images", within=(1, 65535)
    )
    min_near: float = option(MIN_NEAR, NEAR_HELP, group="Cameras", within=(0, 1))
    reach: tuple[float, float, float] | None = option(
        None, "Without cameras: take the closed space around this point for free [m].", metavar="POINT"
    )

    def __post_init__(self) -> None:
        Config.__post_init__(self)
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
