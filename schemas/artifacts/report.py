"""Contents of a report as data: the numbers of its page, with all digits."""

from __future__ import annotations

from typing import Any, Literal

import msgspec

from alula.schemas.artifacts.provenance import Provenance

REPORT_SCHEMA = "alula/report"
REPORT_VERSION = "1.1"


class ReportNumber(msgspec.Struct, frozen=True, kw_only=True):
    """A number of the first screen.

    Attributes:
        key: its name, which ends with the unit where it has one.
        label: its meaning.
        value: with all digits; null where it is unknown.
        shown: as a person reads it.
        detail: one line more.
        good: whether it is good news; null for neither.
    """

    key: str
    label: str
    value: Any
    shown: str
    detail: str
    good: bool | None


class ReportSubject(msgspec.Struct, frozen=True, kw_only=True):
    """A run, the map, the plan or the scene.

    Attributes:
        kind: which of these.
        title: its heading.
        words: what it is, in a line.
        verdict: a sentence.
        tone: of the verdict.
        numbers: of the first screen.
    """

    kind: Literal["run", "map", "plan", "scene"]
    title: str
    words: str
    verdict: str
    tone: Literal["good", "fair", "bad", "plain"]
    numbers: list[ReportNumber]


class ReportTable(msgspec.Struct, frozen=True, kw_only=True):
    """A table.

    Attributes:
        name: for programs.
        title: its heading.
        columns: names with units.
        rows: each as long as `columns`; an unknown value is null.
        note: a sentence below it.
    """

    name: str
    title: str
    columns: list[str]
    rows: list[list[Any]]
    note: str


class ReportFigure(msgspec.Struct, frozen=True, kw_only=True):
    """A figure of the page, in words.

    Attributes:
        name: for programs.
        title: its heading.
        description: what it shows.
    """

    name: str
    title: str
    description: str


class ReportStatement(msgspec.Struct, frozen=True, kw_only=True):
    """The exact statement of a guarantee.

    Attributes:
        subject: the run, or the map.
        statement: the words of its file.
    """

    subject: str
    statement: str


class Report(msgspec.Struct, frozen=True, kw_only=True):
    """A report.

    Attributes:
        schema: always "alula/report".
        version: of the kind.
        provenance: program, parameters and inputs.
        title: its heading.
        verdict: a sentence.
        tone: of the verdict.
        subjects: runs first, in the order in which they were given.
        comparison: in words, each run against the first one.
        differences: the same as tables, with 95 % intervals.
        guaranteed: what is proven or was checked, in plain words.
        not_guaranteed: limits of the guarantee.
        statements: exact statements.
        tables: in reading order, with all trials.
        figures: in reading order.
    """

    schema: str
    version: str
    provenance: Provenance
    title: str
    verdict: str
    tone: Literal["good", "fair", "bad", "plain"]
    subjects: list[ReportSubject]
    comparison: list[str]
    differences: list[ReportTable]
    guaranteed: list[str]
    not_guaranteed: list[str]
    statements: list[ReportStatement]
    tables: list[ReportTable]
    figures: list[ReportFigure]
