"""Parameters of `view`, and of the pictures that it draws."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from alula.schemas.errors import UsageError

_SIDE_PX = (16, 4096)
_MOST_PIXELS = 2**31  # of all frames, which are in memory at once: 6 GB
MOST_GAUSSIANS = 200_000


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewConfig:
    """Parameters of `view`."""

    title: str = field(default="", metadata={"help": "Heading; default: the names.", "metavar": "TEXT"})
    flight: tuple[int, ...] = field(
        default=(),
        metadata={
            "help": "Play only this flight of the logs, by its number (repeatable); default: the worst ones "
            "of each log, the worst first.",
            "metavar": "N",
        },
    )
    gaussians: int | None = field(
        default=None,
        metadata={
            "help": "Show at most so many Gaussians, those that contribute most, however large the page; "
            f"default: at most {MOST_GAUSSIANS}, and fewer where the page would be larger than 7 MB.",
            "metavar": "N",
        },
    )
    up: Literal["+z", "-z", "+y", "-y", "+x", "-x"] = field(
        default="+z", metadata={"help": "Axis that points up; most trainers write -y."}
    )

    def __post_init__(self) -> None:
        """Refuse a negative number."""
        if self.gaussians is not None and self.gaussians < 0:
            raise UsageError(f"--gaussians must not be negative, not {self.gaussians}")

    @property
    def most_gaussians(self) -> int:
        """Maximum number of Gaussians of a picture."""
        return MOST_GAUSSIANS if self.gaussians is None else self.gaussians


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureConfig:
    """Parameters of the pictures that `view` draws."""

    camera: Literal["chase", "cockpit", "orbit", "fixed"] = field(
        default="chase",
        metadata={
            "group": "Pictures",
            "help": "Of moving pictures: chase is behind and above the vehicle, cockpit where it is; orbit "
            "turns around the scene on the vehicle's side; fixed looks as the page does at first.",
        },
    )
    size: str = field(
        default="",
        metadata={
            "group": "Pictures",
            "help": "Of pictures: columns and rows [px]; default: 1280x800, of moving ones 640x400.",
            "metavar": "COLUMNSxROWS",
        },
    )
    frames_per_second: float = field(
        default=12.0,
        metadata={"group": "Pictures", "help": "Of moving pictures: frames per second.", "metavar": "FLOAT"},
    )
    seconds: float = field(
        default=10.0,
        metadata={
            "group": "Pictures",
            "help": "Of moving pictures: maximum time [s]; longer flights are shown faster.",
            "metavar": "FLOAT",
        },
    )

    def __post_init__(self) -> None:
        """Refuse sizes and rates that make no picture, or one that does not fit into memory."""
        for name, value, most in (
            ("--frames-per-second", self.frames_per_second, 60),
            ("--seconds", self.seconds, 600),
        ):
            if not 0 < value <= most:
                raise UsageError(f"{name} must be more than 0 and at most {most}, not {value:g}")
        columns, rows = self.size_px((1, 1))
        if self.size and not _SIDE_PX[0] <= min(columns, rows) <= max(columns, rows) <= _SIDE_PX[1]:
            raise UsageError(f"--size must be from {_SIDE_PX[0]} to {_SIDE_PX[1]} each way, not {self.size}")
        if self.seconds * self.frames_per_second * columns * rows > _MOST_PIXELS:
            raise UsageError(
                "the frames of that --size, --seconds and --frames-per-second need too much memory"
            )

    def size_px(self, default: tuple[int, int]) -> tuple[int, int]:
        """Columns and rows [px].

        Args:
            default: where no size is given.

        Raises:
            UsageError: the size is not two whole numbers.
        """
        if not self.size:
            return default
        columns, _, rows = self.size.partition("x")
        if not (columns.isascii() and columns.isdigit() and rows.isascii() and rows.isdigit()):
            raise UsageError(f"--size must be like 640x400, not {self.size}")
        if max(len(columns), len(rows)) > 6:
            raise UsageError(f"--size must be from {_SIDE_PX[0]} to {_SIDE_PX[1]} each way, not {self.size}")
        return int(columns), int(rows)
