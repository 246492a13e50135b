"""Parameters of `import-splat`."""

from __future__ import annotations

from dataclasses import dataclass, field

from alula.schemas.errors import UsageError


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportSplatConfig:
    """Parameters of `import-splat`; lengths are in the file's own units."""

    format: str = field(
        default="auto",
        metadata={"help": "auto looks at the content; ply and splat force a format.", "metavar": "NAME"},
    )
    min_opacity: float = field(default=0.1, metadata={"help": "Leave out Gaussians with a lower opacity."})
    crop: tuple[float, float, float, float, float, float] | None = field(
        default=None,
        metadata={
            "help": "Keep Gaussians with a centre in the box XMIN YMIN ZMIN XMAX YMAX ZMAX [file units].",
            "metavar": "BOX",
        },
    )
    max_scale: float | None = field(
        default=None, metadata={"help": "Leave out Gaussians with a longer one-sigma semi-axis [file units]."}
    )
    drop_floaters: bool = field(
        default=False, metadata={"help": "Leave out small groups that are far from everything else."}
    )

    def __post_init__(self) -> None:
        """Refuse values that mean nothing."""
        if not (0 <= self.min_opacity <= 1):
            raise UsageError(f"--min-opacity must be between 0 and 1, not {self.min_opacity}")
        if self.crop is not None and not all(self.crop[i] < self.crop[i + 3] for i in range(3)):
            raise UsageError("--crop needs XMIN < XMAX, YMIN < YMAX and ZMIN < ZMAX")
        if self.max_scale is not None and not self.max_scale > 0:
            raise UsageError(f"--max-scale must be positive, not {self.max_scale}")
