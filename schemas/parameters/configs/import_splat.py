"""Parameters of `import-splat`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from alula.schemas.errors import UsageError
from alula.schemas.parameters.configs.config import Config, box_option, option

DRAWN = 0.0039  # just below 1/255: renderers skip a Gaussian whose alpha at a pixel is less than 1/255
PART_GAUSSIANS = 2_000_000  # of a part of a scene: 112 MB in the file


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportSplatConfig(Config):
    """Parameters of `import-splat`; lengths are in the file's own units, boxes in the scene's frame."""

    format: str = option("auto", "Format of the file; auto recognises it by the content.", metavar="NAME")
    lod: int | None = option(
        None,
        "Level of detail to read from lod-meta.json; default: 0, the finest. Further files, such as the "
        "environment, are read whole.",
        group="Levels of detail",
        ge=0,
    )
    part: bool = option(
        False,
        "Accept some files of a level of detail without the others; the scene then lacks what the others "
        "show, and every guarantee says so.",
        group="Levels of detail",
    )
    turn: Literal["none", "x", "y", "z"] = option(
        "none",
        "Turn the file's frame by 180 degrees about an axis, before all else. Most writers of SPZ turn the "
        "data of a .ply about x, some writers of glTF about z.",
    )
    drop_nan: bool = option(
        False,
        "Leave out Gaussians with a value that is not finite, or any number with a quaternion of length "
        "zero, instead of failing.",
        group="Filtering",
    )
    min_opacity: float = option(
        DRAWN,
        "Minimum opacity of a Gaussian. The default, just below 1/255, removes only what renderers do not "
        "draw; a higher one may remove obstacles, and the command says how much.",
        within=(0, 1),
    )
    crop: tuple[float, float, float, float, float, float] | None = box_option(
        None,
        "Keep Gaussians with a centre in the box XMIN YMIN ZMIN XMAX YMAX ZMAX [file units].",
        flag=("--crop-box", "--crop"),
    )
    crop_sphere: tuple[float, float, float, float] | None = option(
        None,
        "Keep Gaussians with a centre in the sphere X Y Z RADIUS [file units].",
        group="Filtering",
        metavar="SPHERE",
    )
    max_scale: float | None = option(
        None, "Maximum one-sigma semi-axis of a Gaussian [file units].", group="Filtering", gt=0
    )
    drop_floaters: bool = option(False, "Leave out small groups that are far from everything else.")

    def __post_init__(self) -> None:
        Config.__post_init__(self)
        if self.crop_sphere is not None and not self.crop_sphere[3] > 0:
            raise UsageError(f"--crop-sphere needs a positive radius, not {self.crop_sphere[3]}")
