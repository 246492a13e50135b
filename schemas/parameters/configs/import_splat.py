"""Parameters of `import-splat`."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from alula.schemas.errors import UsageError

DRAWN = 0.0039  # just below 1/255: renderers skip a Gaussian whose alpha at a pixel is less than 1/255
PART_GAUSSIANS = 2_000_000  # of a part of a scene: 112 MB in the file


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportSplatConfig:
    """Parameters of `import-splat`; lengths are in the file's own units, boxes in the scene's frame."""

    format: str = field(
        default="auto",
        metadata={
            "help": "Format of the file; auto recognises it by the content.",
            "metavar": "NAME",
        },
    )
    lod: int | None = field(
        default=None,
        metadata={
            "group": "Levels of detail",
            "help": "Level of detail to read from lod-meta.json; default: 0, the finest. Further files, such "
            "as the environment, are read whole.",
        },
    )
    part: bool = field(
        default=False,
        metadata={
            "group": "Levels of detail",
            "help": "Accept some files of a level of detail without the others; the scene then lacks what "
            "the others show, and every guarantee says so.",
        },
    )
    turn: Literal["none", "x", "y", "z"] = field(
        default="none",
        metadata={
            "help": "Turn the file's frame by 180 degrees about an axis, before all else. "
            "Most writers of SPZ turn the data of a .ply about x, some writers of glTF about z."
        },
    )
    drop_nan: bool = field(
        default=False,
        metadata={
            "group": "Filtering",
            "help": "Leave out Gaussians with a value that is not finite, or any number with a quaternion of "
            "length zero, instead of failing.",
        },
    )
    min_opacity: float = field(
        default=DRAWN,
        metadata={
            "help": "Minimum opacity of a Gaussian. The default, just below 1/255, removes only what "
            "renderers do not draw; a higher one may remove obstacles, and the command says how much."
        },
    )
    crop: tuple[float, float, float, float, float, float] | None = field(
        default=None,
        metadata={
            "option": ("--crop-box", "--crop"),
            "help": "Keep Gaussians with a centre in the box XMIN YMIN ZMIN XMAX YMAX ZMAX [file units].",
            "metavar": "BOX",
        },
    )
    crop_sphere: tuple[float, float, float, float] | None = field(
        default=None,
        metadata={
            "group": "Filtering",
            "help": "Keep Gaussians with a centre in the sphere X Y Z RADIUS [file units].",
            "metavar": "SPHERE",
        },
    )
    max_scale: float | None = field(
        default=None,
        metadata={"group": "Filtering", "help": "Maximum one-sigma semi-axis of a Gaussian [file units]."},
    )
    drop_floaters: bool = field(
        default=False, metadata={"help": "Leave out small groups that are far from everything else."}
    )

    def __post_init__(self) -> None:
        """Refuse values out of range."""
        if self.lod is not None and self.lod < 0:
            raise UsageError(f"--lod must be at least 0, not {self.lod}")
        if not (0 <= self.min_opacity <= 1):
            raise UsageError(f"--min-opacity must be between 0 and 1, not {self.min_opacity}")
        if self.crop is not None and not all(self.crop[i] < self.crop[i + 3] for i in range(3)):
            raise UsageError("--crop-box needs XMIN < XMAX, YMIN < YMAX and ZMIN < ZMAX")
        if self.crop_sphere is not None and not self.crop_sphere[3] > 0:
            raise UsageError(f"--crop-sphere needs a positive radius, not {self.crop_sphere[3]}")
        if self.max_scale is not None and not self.max_scale > 0:
            raise UsageError(f"--max-scale must be positive, not {self.max_scale}")
