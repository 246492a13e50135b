"""Parameters of `scale-align`."""

from __future__ import annotations

from dataclasses import dataclass, field

from alula.schemas.errors import UsageError

Distance = tuple[tuple[float, float, float], tuple[float, float, float], float]


@dataclass(frozen=True, slots=True, kw_only=True)
class ScaleAlignConfig:
    """Parameters of `scale-align`; what it aligns by is an input, except distances and a plain scale."""

    scale: float | None = field(default=None, metadata={"help": "Metres per unit of the scene."})
    threshold_m: float = field(
        default=0.1,
        metadata={
            "help": "Correspondences with a larger residual are outliers [m].",
            "option": "--threshold",
        },
    )
    max_rms_m: float | None = field(
        default=None,
        metadata={"help": "Fail if the inliers' RMS residual is larger [m].", "option": "--max-rms"},
    )
    max_scale_sigma: float | None = field(
        default=None, metadata={"help": "Fail if the scale's standard deviation is larger [m per unit]."}
    )
    min_inliers: int | None = field(
        default=None, metadata={"help": "Fail with fewer inliers; default: more than half of all."}
    )
    distances: tuple[Distance, ...] = field(default=(), metadata={"internal": True})

    def __post_init__(self) -> None:
        """Refuse values that mean nothing."""
        for name, value in (
            ("--threshold", self.threshold_m),
            ("--max-rms", self.max_rms_m),
            ("--max-scale-sigma", self.max_scale_sigma),
            ("--scale", self.scale),
        ):
            if value is not None and not (1e-9 <= value <= 1e9):
                raise UsageError(f"{name} must be between 1e-9 and 1e9, not {value}")
        if self.min_inliers is not None and self.min_inliers < 1:
            raise UsageError(f"--min-inliers must be at least 1, not {self.min_inliers}")
        for start, end, metres in self.distances:
            if not (1e-9 <= metres <= 1e9):
                raise UsageError(f"--distance: {metres} m is no distance between two points")
            if start == end:
                raise UsageError("--distance: both points are the same")
