"""Parameters of `export`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from alula.schemas.errors import UsageError

FORMATS = ("glb", "obj", "json", "ply", "stl")


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportConfig:
    """Parameters of `export`."""

    format: Literal["auto", "glb", "obj", "json", "ply", "stl"] = field(
        default="auto", metadata={"help": "Format to write; auto goes by the output's suffix."}
    )

    def resolved(self, output: Path) -> str:
        """The format for an output file.

        Raises:
            UsageError: `auto`, and the suffix is not that of a format.
        """
        name = self.format if self.format != "auto" else output.suffix.lower().removeprefix(".")
        if name not in FORMATS:
            suffixes = ", ".join(f".{known}" for known in FORMATS)
            raise UsageError(f"{output}: the output must end in one of {suffixes}, or give --format")
        return name
