"""Parameters of `report`."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from alula.schemas.errors import UsageError
from alula.schemas.parameters.configs.config import Config, option

FORMATS = ("html", "md", "csv", "json", "tex", "pdf", "png")


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportConfig(Config):
    """Parameters of `report`."""

    format: Literal["auto", "html", "md", "csv", "json", "tex", "pdf", "png"] = option(
        "auto",
        "Format to write; auto follows the output's suffix. csv has a row per trial, json everything as "
        "data, png the first screen. tex has a PDF for each figure beside it, as wide as a column.",
    )
    title: str = option("Flight report", "Heading of the page.", metavar="TEXT")
    table: tuple[str, ...] = option((), "Keep only this table (repeatable).", metavar="NAME")

    def __post_init__(self) -> None:
        Config.__post_init__(self)
        if not self.title.strip():
            raise UsageError("--title must not be empty")

    def parameters(self, output: Path) -> dict[str, Any]:
        """Parameters to record, with the format resolved.

        Raises:
            UsageError: the format is `auto` and the suffix belongs to no format.
        """
        return asdict(self) | {"format": self.resolved(output), "table": list(self.table)}

    def resolved(self, output: Path) -> str:
        """Format of an output file.

        Raises:
            UsageError: the format is `auto` and the suffix belongs to no format.
        """
        if self.format != "auto":
            return self.format
        name = output.suffix.lower().removeprefix(".")
        name = "html" if name == "htm" else name
        if name not in FORMATS:
            raise UsageError(
                f"{output}: the output must end in .{', .'.join(FORMATS[:-1])} or .{FORMATS[-1]}"
            )
        return name
