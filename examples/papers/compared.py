"""Record of a comparison with a paper: every claim of the paper with our values, as data.

The examples write one for each paper; the page of all papers is made from them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import msgspec

from alula.schemas.decode import MalformedError, decode_json
from alula.schemas.errors import InputError
from alula.schemas.manifest import Producer

COMPARISON_SCHEMA = "alula/comparison"
COMPARISON_VERSION = "1.0"
PAPERS_SCHEMA = "alula/papers"
PAPERS_VERSION = "1.0"
Verdict = Literal["better", "reproduced", "bounded", "refuted", "not comparable", "not available here"]
VERDICTS: tuple[Verdict, ...] = (
    *("better", "reproduced", "bounded", "refuted"),
    *("not comparable", "not available here"),
)


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


class ComparedValue(msgspec.Struct, frozen=True, kw_only=True):
    """A published value and ours.

    Attributes:
        claim: name of the claim that it belongs to.
        item: table, figure or section of the paper.
        quantity: what is compared.
        published: as printed.
        ours: our value; empty without a measurement.
        interval: its 95 % interval, or what stands for it.
        verdict: the judgement.
        why: its reason.
        numbers: exact values of the rounded numbers in `ours` and `interval`.
        flights: number of flights that the row is made from; null where it is made from none.
        command: what makes it.
        setting: `full` or `quick`: how many flights were asked for.
        copied_from: the committed page that the row was copied from, with the digits printed there.
    """

    claim: str
    item: str
    quantity: str
    published: str
    ours: str
    interval: str
    verdict: Verdict
    why: str
    numbers: list[ShownNumber]
    flights: int | None
    command: str
    setting: Literal["full", "quick"]
    copied_from: str = ""


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
    setting: Literal["full", "quick"]


class Comparison(msgspec.Struct, frozen=True, kw_only=True):
    """A comparison with one paper.

    Attributes:
        paper: its name.
        producer: the program that wrote the record.
        machine: in words.
        command: what wrote the record.
        setting: `full` or `quick`.
        rows: in the order of the paper.
        figures: in reading order.
    """

    schema: str
    version: str
    paper: str
    producer: Producer
    machine: str
    command: str
    setting: Literal["full", "quick"]
    rows: list[ComparedValue]
    figures: list[ComparedFigure]


class JudgedClaim(msgspec.Struct, frozen=True, kw_only=True):
    """A claim of a paper with its verdict.

    Attributes:
        name: short, unique in its paper.
        where: table, figure or section that makes it.
        says: the claim in plain words.
        printed: its values as printed; empty where it has none.
        kind: what makes it.
        verdict: the least favourable of the rows that have a measurement, or else that of the others.
        shows: of a figure, what the paper's figure shows.
        rows: in the order of the paper.
        figures: ours.
        see: the claim that already has our figure of this one; empty without.
    """

    name: str
    where: str
    says: str
    printed: str
    kind: Literal["number", "table", "figure", "theorem", "statement", "setting"]
    verdict: Verdict
    shows: str
    rows: list[ComparedValue]
    figures: list[ComparedFigure]
    see: str


class JudgedPaper(msgspec.Struct, frozen=True, kw_only=True):
    """A paper with all its claims.

    Attributes:
        name: of its folder in `examples`.
        title: as printed.
        source: where it is found.
        says: its claim in one plain sentence.
        page: the detailed page in `docs/results`.
        counts: number of claims by verdict.
        claims: in the paper's order.
        made: commands that wrote the records.
        machine: on which they were written, in words.
    """

    name: str
    title: str
    source: str
    says: str
    page: str
    counts: dict[str, int]
    claims: list[JudgedClaim]
    made: list[str]
    machine: str


class Papers(msgspec.Struct, frozen=True, kw_only=True):
    """All papers on one page, as data.

    Attributes:
        producer: the program that wrote it.
        counts: number of claims by verdict, of all papers.
        papers: in reading order.
    """

    schema: str
    version: str
    producer: Producer
    counts: dict[str, int]
    papers: list[JudgedPaper]


def write_comparison_record(record: Comparison | Papers) -> str:
    """Write a record, or the page of all papers, as JSON text."""
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
    if record.schema != COMPARISON_SCHEMA or record.version.split(".")[0] != "1":
        raise InputError(f"{path}: is no {COMPARISON_SCHEMA} of version 1")
    return record
