"""Parameters of `voxelize`."""

from __future__ import annotations

from dataclasses import dataclass, field

from alula.schemas.errors import UsageError

MERGE_VOXELS = 2**24  # maximum input of `merge`, by its memory


@dataclass(frozen=True, slots=True, kw_only=True)
class VoxelizeConfig:
    """Parameters of `voxelize`; `confidence` overrides `sigma` when given."""

    size_m: float = field(default=0.05, metadata={"help": "Edge of a voxel [m].", "option": "--size"})
    sigma: float = field(default=1.0, metadata={"help": "Level of the ellipsoids, in standard deviations."})
    confidence: float | None = field(
        default=None,
        metadata={"help": "Probability inside the ellipsoid; sets sigma by the chi-square distribution."},
    )
    min_overlap: int = field(
        default=1,
        metadata={"group": "Obstacles", "help": "Minimum number of ellipsoids that touch a marked voxel."},
    )
    crop: tuple[float, float, float, float, float, float] | None = field(
        default=None,
        metadata={
            "help": "Mark only voxels that touch the box XMIN YMIN ZMIN XMAX YMAX ZMAX [m].",
            "metavar": "BOX",
        },
    )
    min_opacity: float = field(
        default=0.0,
        metadata={"help": "Minimum opacity of a Gaussian, in addition to the minimum of the import."},
    )
    inflation_m: float | None = field(
        default=None,
        metadata={
            "help": "Radius of the ball added to each ellipsoid [m]; default: the alignment's suggestion.",
            "option": "--inflate",
        },
    )
    ignore_loss: bool = field(
        default=False,
        metadata={
            "group": "Obstacles",
            "help": "Do not grow the ellipsoids by the precision that the splat file's format may have lost.",
        },
    )
    max_voxels: int = field(
        default=MERGE_VOXELS,
        metadata={
            "group": "Limits",
            "help": "Maximum number of voxels; the default is what merge can take. An estimate far above it "
            "ends the command before the work, with a size or a filter that would fit.",
        },
    )

    def __post_init__(self) -> None:
        """Refuse values out of range."""
        if not (1e-4 <= self.size_m <= 1e3):
            raise UsageError(f"--size must be between 0.0001 and 1000 m, not {self.size_m}")
        if not (0.01 <= self.sigma <= 100):
            raise UsageError(f"--sigma must be between 0.01 and 100, not {self.sigma}")
        if self.confidence is not None and not (0 < self.confidence < 1):
            raise UsageError(f"--confidence must be between 0 and 1, not {self.confidence}")
        if self.min_overlap < 1:
            raise UsageError(f"--min-overlap must be at least 1, not {self.min_overlap}")
        if self.max_voxels < 1:
            raise UsageError(f"--max-voxels must be at least 1, not {self.max_voxels}")
        if self.crop is not None and not all(self.crop[i] < self.crop[i + 3] for i in range(3)):
            raise UsageError("--crop needs XMIN < XMAX, YMIN < YMAX and ZMIN < ZMAX")
        if not (0 <= self.min_opacity <= 1):
            raise UsageError(f"--min-opacity must be between 0 and 1, not {self.min_opacity}")
        if self.inflation_m is not None and not (0 <= self.inflation_m <= 1e6):
            raise UsageError(f"--inflate must be between 0 and 1e6 m, not {self.inflation_m}")
