"""Make the record of a comparison: rows with the commands that make them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath

import msgspec

from alula.schemas.artifacts.manifest import Producer
from alula.stages.reporting.figures import Figure
from papers.claims import Claim, Paper
from papers.compared import (
    COMPARISON_SCHEMA,
    COMPARISON_VERSION,
    Compared,
    ComparedFigure,
    Comparison,
    Measured,
    Setting,
)


@dataclass(frozen=True, slots=True)
class Made:
    """How a comparison was made.

    Attributes:
        command: that makes any target of the example, with the variables that were given.
        folder: of the example's outputs, as its Makefile names it.
        page: the target of the whole comparison in it.
        setting: how many flights were asked for.
        machine: in words.
    """

    command: str
    folder: str
    page: str
    setting: Setting
    machine: str

    @property
    def whole(self) -> str:
        """Command of the whole comparison."""
        return f"{self.command} {self.folder}/{self.page}"


def command_of(row: Measured, claim: Claim, made: Made) -> str:
    """State the command that makes a row: its runs, a check of its claim, or the whole comparison.

    Several files of a folder are written as the shell's braces.
    """
    if not row.runs:
        return claim.how or made.whole
    folders: dict[tuple[str, str], list[str]] = {}
    for name in row.runs:
        path = PurePosixPath(made.folder, name)
        ending = ".run.mcap" if path.name.endswith(".run.mcap") else ""
        folders.setdefault((str(path.parent), ending), []).append(path.name.removesuffix(ending))
    targets = [
        f"{folder}/{names[0]}{ending}" if len(names) == 1 else f"{folder}/{{{','.join(names)}}}{ending}"
        for (folder, ending), names in folders.items()
    ]
    return f"{made.command} {' '.join(targets)}"


def comparison_record(
    paper: Paper, rows: Sequence[Measured], figures: Sequence[Figure], made: Made, producer: Producer
) -> Comparison:
    """Make the record of a comparison.

    Args:
        paper: with its claims.
        rows: in reading order.
        figures: in reading order; their files stand beside the record.
        made: how it was made.
        producer: the program that writes it.

    Raises:
        InputError: a row belongs to no claim of the paper.
    """
    values = []
    for row in rows:
        claim, _ = paper.row(row.row)
        setting: Setting = made.setting if row.runs or not claim.how else "full"  # tests are the same in both
        values.append(
            Compared(**msgspec.structs.asdict(row), command=command_of(row, claim, made), setting=setting)
        )
    return Comparison(
        schema=COMPARISON_SCHEMA,
        version=COMPARISON_VERSION,
        paper=paper.name,
        producer=producer,
        machine=made.machine,
        command=made.whole,
        setting=made.setting,
        rows=values,
        figures=[
            ComparedFigure(name=f.name, title=f.title, description=f.alt, setting=made.setting)
            for f in figures
        ],
    )
