"""Parameters of `import-voxels`."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from alula.schemas.errors import UsageError
from alula.schemas.parameters.configs.scale_align import require_map_origin
from alula.schemas.parameters.configs.voxelize import MERGE_VOXELS

LEAST_MARGIN_M = 1e-6  # of a ball, far above the rounding errors of its distances


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportVoxelsConfig:
    """Parameters of `import-voxels`; lengths are in metres, after the scale."""

    size_m: float = field(metadata={"help": "Edge of a voxel [m].", "option": "--size"})
    margin_m: float = field(
        default=0.0,
        metadata={
            "help": "Radius of the ball around every point of a mesh's surface, or of a cloud [m].",
            "option": ("--margin", "--radius"),
        },
    )
    solid: bool = field(
        default=False, metadata={"help": "Mark all that a mesh encloses, too; it must be watertight."}
    )
    min_points: int = field(
        default=1, metadata={"help": "Minimum number of balls of a cloud that touch a marked voxel."}
    )
    unknown: Literal["free", "occupied"] = field(
        default="free",
        metadata={
            "help": "What the space is that an octree does not describe, within the box of what it describes."
        },
    )
    crop: tuple[float, float, float, float, float, float] | None = field(
        default=None,
        metadata={
            "help": "Mark only voxels that touch the box XMIN YMIN ZMIN XMAX YMAX ZMAX [m].",
            "metavar": "BOX",
        },
    )
    scale: float = field(
        default=1.0, metadata={"group": "Frame", "help": "Metres per unit of the file, such as 0.001."}
    )
    up: Literal["auto", "y", "z"] = field(
        default="auto",
        metadata={
            "group": "Frame",
            "help": "Axis of the file that points up; it becomes z. auto is y for .glb, else z.",
        },
    )
    map_origin: tuple[float, float, float] | None = field(
        default=None,
        metadata={
            "group": "Frame",
            "help": "Position of the world that becomes 0 0 0 of the map [m]; default: 0 0 0, or a round one "
            "in the middle where coordinates are too large for the map's numbers.",
            "metavar": "'X Y Z'",
        },
    )
    max_voxels: int = field(
        default=MERGE_VOXELS,
        metadata={
            "group": "Limits",
            "help": "Maximum number of voxels; the default is what merge can take. An estimate far above it "
            "ends the command before the work, with a size that would fit.",
        },
    )

    def __post_init__(self) -> None:
        """Refuse values out of range."""
        if not (1e-4 <= self.size_m <= 1e3):
            raise UsageError(f"--size must be between 0.0001 and 1000 m, not {self.size_m}")
        if self.margin_m != 0 and not (LEAST_MARGIN_M <= self.margin_m <= 1e3):
            raise UsageError(
                f"--margin must be 0, or between {LEAST_MARGIN_M:g} and 1000 m, not {self.margin_m}"
            )
        if self.min_points < 1:
            raise UsageError(f"--min-points must be at least 1, not {self.min_points}")
        if not (1e-9 <= self.scale <= 1e9):
            raise UsageError(f"--scale must be between 1e-09 and 1e+09, not {self.scale}")
        if self.max_voxels < 1:
            raise UsageError(f"--max-voxels must be at least 1, not {self.max_voxels}")
        require_map_origin(self.map_origin)
        if self.crop is not None and not all(self.crop[i] < self.crop[i + 3] for i in range(3)):
            raise UsageError("--crop needs XMIN < XMAX, YMIN < YMAX and ZMIN < ZMAX")
