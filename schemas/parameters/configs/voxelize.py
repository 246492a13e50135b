"""Parameters of `voxelize`."""

from __future__ import annotations

from dataclasses import dataclass

from alula.schemas.parameters.configs.config import Config, box_option, option

MERGE_VOXELS = 2**24  # maximum input of `merge`, by its memory


@dataclass(frozen=True, slots=True, kw_only=True)
class VoxelizeConfig(Config):
    """Parameters of `voxelize`; `confidence` overrides `sigma` when given."""

    size_m: float = option(0.05, "Edge of a voxel [m].", within=(1e-4, 1e3))
    sigma: float = option(1.0, "Level of the ellipsoids, in standard deviations.", within=(0.01, 100))
    confidence: float | None = option(
        None, "Probability inside the ellipsoid; sets sigma by the chi-square distribution.", gt=0, lt=1
    )
    min_overlap: int = option(
        1, "Minimum number of ellipsoids that touch a marked voxel.", group="Obstacles", ge=1
    )
    crop: tuple[float, float, float, float, float, float] | None = box_option(
        None, "Mark only voxels that touch the box XMIN YMIN ZMIN XMAX YMAX ZMAX [m]."
    )
    min_opacity: float = option(
        0.0, "Minimum opacity of a Gaussian, in addition to the minimum of the import.", within=(0, 1)
    )
    inflation_m: float | None = option(
        None,
        "Radius of the ball added to each ellipsoid [m]; default: the alignment's suggestion.",
        flag="--inflate",
        within=(0, 1e6),
    )
    ignore_loss: bool = option(
        False,
        "Do not grow the ellipsoids by the precision that the splat file's format may have lost.",
        group="Obstacles",
    )
    max_voxels: int = option(
        MERGE_VOXELS,
        "Maximum number of voxels; the default is what merge can take. An estimate far above it ends the "
        "command before the work, with a size or a filter that would fit.",
        group="Limits",
        ge=1,
    )
