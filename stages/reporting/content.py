"""The contents of a report, made once for all formats, and written as JSON and as Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import msgspec
import numpy as np

from alula.schemas.artifacts.provenance import Provenance
from alula.schemas.artifacts.report import (
    REPORT_SCHEMA,
    REPORT_VERSION,
    Report,
    ReportFigure,
    ReportStatement,
    ReportSubject,
    ReportTable,
)
from alula.stages.reporting.brief import Brief, brief
from alula.stages.reporting.differences import difference_tables, difference_words
from alula.stages.reporting.figures import Figure
from alula.stages.reporting.guarantees import GUARANTEES
from alula.stages.reporting.headline import headline
from alula.stages.reporting.material import Material
from alula.stages.reporting.table import Table, folded, markdown_cell, markdown_table, text
from alula.stages.reporting.tables import LISTED_TRIALS, all_tables

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Content:
    """What a report says, whatever its format.

    Attributes:
        facts: plain values, as the command prints them.
    """

    brief: Brief
    facts: Mapping[str, Any]
    tables: tuple[Table, ...]
    differences: tuple[Table, ...]

    @property
    def comparison(self) -> list[str]:
        """The differences in words."""
        return [line for table in self.differences for line in difference_words(table)]


def content_of(
    material: Material,
    names: Sequence[str] = (),
    *,
    listed: int | None = LISTED_TRIALS,
) -> Content:
    """Gather what a report says.

    Args:
        names: tables to keep; all when empty.
        listed: number of trials that are listed of each run; None for all.

    Raises:
        UsageError: no table has one of the names.
    """
    tables = tuple(all_tables(material, names, listed=listed))
    return Content(brief(material), headline(material), tables, tuple(difference_tables(material)))


def to_json(content: Content, figures: Sequence[Figure], provenance: Provenance) -> str:
    """Write the contents as JSON, with all digits."""
    found = content.brief
    record = Report(
        schema=REPORT_SCHEMA,
        version=REPORT_VERSION,
        provenance=msgspec.structs.replace(provenance, summary=dict(content.facts)),
        title=found.title,
        verdict=found.verdict,
        tone=found.tone,
        subjects=_records(found.subjects, ReportSubject),
        comparison=content.comparison,
        differences=_records(content.differences, ReportTable),
        guaranteed=list(found.proofs),
        not_guaranteed=list(found.limits),
        statements=[ReportStatement(subject=name, statement=words) for name, words in found.statements],
        tables=_records(content.tables, ReportTable),
        figures=[ReportFigure(name=one.name, title=one.title, description=one.alt) for one in figures],
    )
    values = msgspec.json.encode(record, enc_hook=np.generic.item)
    return msgspec.json.format(values, indent=1).decode() + "\n"


def _records(each: Sequence[Any], kind: type[T]) -> list[T]:
    """The same values as in the record of a report."""
    return [msgspec.convert(one, kind, from_attributes=True) for one in each]


def to_report_markdown(content: Content, first_line: str) -> str:
    """Write the contents as Markdown; `first_line` goes into a comment at the top."""
    found = content.brief
    parts = [f"<!-- {first_line} -->" if first_line else "", f"# {markdown_cell(found.title)}"]
    parts.append(f"**{markdown_cell(found.verdict)}**" if found.verdict else "")
    if content.facts:
        items = [
            f"- {k.replace('_', ' ')}: {markdown_cell(text(value))}" for k, value in content.facts.items()
        ]
        parts.append("\n".join(["## In short", "", *items]))
    for subject in found.subjects:
        rows = tuple((number.label, number.shown, number.detail) for number in subject.numbers)
        if rows:
            parts.append(markdown_table(Table("", subject.title, ("", "", ""), rows)))
    for table in content.differences:
        words = "\n".join(f"- {markdown_cell(line)}" for line in difference_words(table))
        parts.append(markdown_table(folded(table), before=words))
    lines = [f"- {markdown_cell(line)}" for line in found.proofs]
    lines += [f"- Not covered: {markdown_cell(line)}" for line in found.limits]
    lines += [f"- {markdown_cell(name)}: {markdown_cell(words)}" for name, words in found.statements]
    if lines:
        parts.append("\n".join([f"## {GUARANTEES}", "", *lines]))
    parts += [markdown_table(table) for table in content.tables]
    return "\n\n".join(part for part in parts if part) + "\n"
