"""Parameters of `view`, and of the pictures that it draws."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from alula.schemas.errors import UsageError
from alula.schemas.parameters.configs.config import Config, option

_SIDE_PX = (16, 4096)
_MOST_PIXELS = 2**31  # of all frames, which are in memory at once: 6 GB
MOST_GAUSSIANS = 200_000


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewConfig(Config):
    """Parameters of `view`."""

    title: str = option("", "Heading; default: the names.", metavar="TEXT")
    flight: tuple[int, ...] = option(
        (),
        "Play only this flight of the logs, by its number (repeatable); default: the worst ones of each "
        "log, the worst first.",
        metavar="N",
    )
    gaussians: int | None = option(
        None,
        "Show at most so many Gaussians, those that contribute most, however large the page; "
        f"default: at most {MOST_GAUSSIANS}, and fewer where the page would be larger than 7 MB.",
        metavar="N",
        ge=0,
    )
    up: Literal["+z", "-z", "+y", "-y", "+x", "-x"] = option(
        "+z", "Axis that points up; most trainers write -y."
    )

    @property
    def most_gaussians(self) -> int:
        """Maximum number of Gaussians of a picture."""
        return MOST_GAUSSIANS if self.gaussians is None else self.gaussians


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureConfig(Config):
    """Parameters of the pictures that `view` draws."""

    camera: Literal["chase", "cockpit", "orbit", "fixed"] = option(
        "chase",
        "Of moving pictures: chase is behind and above the vehicle, cockpit where it is; orbit turns "
        "around the scene on the vehicle's side; fixed looks as the page does at first.",
        group="Pictures",
    )
    size: str = option(
        "",
        "Of pictures: columns and rows [px]; default: 1280x800, of moving ones 640x400.",
        group="Pictures",
        metavar="COLUMNSxROWS",
    )
    frames_per_second: float = option(
        12.0, "Of moving pictures: frames per second.", group="Pictures", metavar="FLOAT", gt=0, le=60
    )
    seconds: float = option(
        10.0,
        "Of moving pictures: maximum time [s]; longer flights are shown faster.",
        group="Pictures",
        metavar="FLOAT",
        gt=0,
        le=600,
    )

    def __post_init__(self) -> None:
        """Refuse sizes and rates that make no picture, or one that does not fit into memory."""
        Config.__post_init__(self)
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
