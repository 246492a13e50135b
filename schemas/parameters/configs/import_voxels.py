"""Parameters of `import-voxels`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from alula.schemas.errors import UsageError
from alula.schemas.parameters.configs.config import Config, box_option, option
from alula.schemas.parameters.configs.voxelize import MERGE_VOXELS

LEAST_MARGIN_M = 1e-6  # of a ball, far above the rounding errors of its distances


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportVoxelsConfig(Config):
    """Parameters of `import-voxels`; lengths are in metres, after the scale."""

    size_m: float = option(help="Edge of a voxel [m].", within=(1e-4, 1e3))
    margin_m: float = option(
        0.0,
        "Radius of the ball around every point of a mesh's surface, or of a cloud [m].",
        flag=("--margin", "--radius"),
    )
    solid: bool = option(False, "Mark all that a mesh encloses, too; it must be watertight.")
    min_points: int = option(1, "Minimum number of balls of a cloud that touch a marked voxel.", ge=1)
    unknown: Literal["free", "occupied"] = option(
        "free", "What the space is that an octree does not describe, within the box of what it describes."
    )
    crop: tuple[float, float, float, float, float, float] | None = box_option(
        None, "Mark only voxels that touch the box XMIN YMIN ZMIN XMAX YMAX ZMAX [m]."
    )
    scale: float = option(
        1.0, "Metres per unit of the file, such as 0.001.", group="Frame", within=(1e-9, 1e9)
    )
    up: Literal["auto", "y", "z"] = option(
        "auto", "Axis of the file that points up; it becomes z. auto is y for .glb, else z.", group="Frame"
    )
    map_origin: tuple[float, float, float] | None = option(
        None,
        "Position of the world that becomes 0 0 0 of the map [m]; default: 0 0 0, or a round one in the "
        "middle where coordinates are too large for the map's numbers.",
        group="Frame",
        metavar="'X Y Z'",
        within=(-1e8, 1e8),
    )
    max_voxels: int = option(
        MERGE_VOXELS,
        "Maximum number of voxels; the default is what merge can take. An estimate far above it ends the "
        "command before the work, with a size that would fit.",
        group="Limits",
        ge=1,
    )

    def __post_init__(self) -> None:
        Config.__post_init__(self)
        if self.margin_m != 0 and not (LEAST_MARGIN_M <= self.margin_m <= 1e3):
            raise UsageError(
                f"--margin must be 0, or between {LEAST_MARGIN_M:g} and 1000 m, not {self.margin_m}"
            )
