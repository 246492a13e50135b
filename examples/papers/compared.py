"""Records of comparisons with papers as data: what was measured for each row of a claim.

The examples write one for each paper; the page of all papers is made from them.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

import msgspec

from alula.schemas.artifacts.manifest import Producer
from alula.schemas.decode import MalformedError, decode_json
from alula.schemas.errors import InputError
from alula.stages.reporting.statistics import Estimate, Rate

COMPARISON_SCHEMA = "papers/comparison"
COMPARISON_VERSION = "2.0"
Verdict = Literal["better", "reproduced", "bounded", "refuted", "not comparable", "not available here"]
VERDICTS: tuple[Verdict, ...] = (
    *("better", "reproduced", "bounded", "refuted"),
    *("not comparable", "not available here"),
)
Setting = Literal["full", "quick"]


class ShownNumber(msgspec.Struct, frozen=True, kw_only=True):
    """A rounded number in the text of a row.

    Attributes:
        cell: `ours` or `interval`.
        at: index of its first character in that text.
        shown: as a person reads it.
        value: with all digits.
    """

    cell: str
    at: int
    shown: str
    value: float


class Measured(msgspec.Struct, frozen=True, kw_only=True):
    """What was measured for a row of a claim.

    Attributes:
        row: its name in the paper.
        verdict: the judgement.
        values: that the texts of the row take, by name.
        low, high: ends of the 95 % interval; null where it is not known or is none.
        runs: files below the example's output folder that it is made from.
        flights: number of flights in them; null where it is made from none.
    """

    row: str
    verdict: Verdict
    values: dict[str, Any] = {}
    low: float | None = None
    high: float | None = None
    runs: list[str] = []
    flights: int | None = None


class Source(Protocol):
    """What a row is made from: a file, and the number of flights in it, or None."""

    @property
    def file(self) -> str:
        """Below the example's output folder; empty for none."""

    @property
    def flights(self) -> int | None:
        """Number of flights in it; None for none."""


@dataclass(frozen=True, slots=True)
class File:
    """A file that a row is made from."""

    file: str
    flights: int | None = None


def measured(
    row: str,
    verdict: Verdict,
    made_of: Iterable[Source | None] = (),
    interval: Estimate | Rate | tuple[float | None, float | None] | None = None,
    /,
    **values: Any,
) -> Measured:
    """What was measured for a row.

    Args:
        row: its name in the paper.
        verdict: the judgement.
        made_of: what it is made from; None is skipped.
        interval: of 95 %; unknown unless both ends are.
        values: that the texts of the row take, by name.
    """
    sources = [source for source in made_of if source is not None]
    flown = [source.flights for source in sources if source.flights is not None]
    ends = (interval.low, interval.high) if isinstance(interval, Estimate | Rate) else interval
    low, high = (None, None) if ends is None or None in ends else ends
    return Measured(
        row=row,
        verdict=verdict,
        values=values,
        low=None if low is None else float(low),
        high=None if high is None else float(high),
        runs=list(dict.fromkeys(source.file for source in sources if source.file)),
        flights=sum(flown) if flown else None,
    )


class Compared(Measured, frozen=True, kw_only=True):
    """A row of a record: what was measured, and how.

    Attributes:
        command: what makes it.
        setting: how many flights were asked for.
    """

    command: str
    setting: Setting


class ComparedFigure(msgspec.Struct, frozen=True, kw_only=True):
    """One of our figures.

    Attributes:
        name: of the SVG file beside the record.
        title: heading.
        description: what it shows, in words.
        setting: of the flights that it shows.
    """

    name: str
    title: str
    description: str
    setting: Setting


class Comparison(msgspec.Struct, frozen=True, kw_only=True):
    """A comparison with one paper.

    Attributes:
        paper: its name.
        producer: the program that wrote the record.
        machine: in words.
        command: what wrote the record.
        setting: how many flights were asked for.
        rows: in the order of the paper.
        figures: in reading order.
    """

    schema: str
    version: str
    paper: str
    producer: Producer
    machine: str
    command: str
    setting: Setting
    rows: list[Compared]
    figures: list[ComparedFigure]


def write_comparison_record(record: Any) -> str:
    """Write a record, or the claims of all papers, as JSON text."""
    return msgspec.json.format(msgspec.json.encode(record), indent=1).decode() + "\n"


def read_comparison(path: Path) -> Comparison:
    """Read a record.

    Raises:
        InputError: the file cannot be read or holds no record of this version.
    """
    try:
        record = decode_json(path.read_bytes(), Comparison)
    except (OSError, MalformedError) as error:
        raise InputError(f"{path}: {error}") from error
    if record.schema != COMPARISON_SCHEMA or record.version.split(".")[0] != "2":
        raise InputError(f"{path}: is no {COMPARISON_SCHEMA} of version 2")
    return record
