"""Parameters of `view`."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from alula.schemas.errors import UsageError

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
    gaussians: int = field(
        default=MOST_GAUSSIANS,
        metadata={
            "help": "Maximum number of Gaussians to show, those that contribute most; fewer where the page "
            "would be larger than 7 MB.",
            "metavar": "N",
        },
    )
    up: Literal["+z", "-z", "+y", "-y", "+x", "-x"] = field(
        default="+z", metadata={"help": "Axis that points up; most trainers write -y."}
    )

    def __post_init__(self) -> None:
        """Refuse a negative number."""
        if self.gaussians < 0:
            raise UsageError(f"--gaussians must not be negative, not {self.gaussians}")
