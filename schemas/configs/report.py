"""Parameters of `report`."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from alula.schemas.errors import UsageError


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportConfig:
    """Parameters of `report`."""

    title: str = field(default="Flight report", metadata={"help": "Heading of the page.", "metavar": "TEXT"})
    table: tuple[str, ...] = field(
        default=(), metadata={"help": "Keep only this table (repeatable).", "metavar": "NAME"}
    )
    paper: Literal["polymerge"] | None = field(
        default=None, metadata={"help": "Add tables with the published values of a paper."}
    )

    def __post_init__(self) -> None:
        """Refuse an empty title."""
        if not self.title.strip():
            raise UsageError("--title must not be empty")
