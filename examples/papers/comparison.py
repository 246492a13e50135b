"""Output files of the examples that compare runs or maps: tables, figures, and pages of both."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from alula.stages.reporting.figures import Figure
from alula.stages.reporting.material import Material
from alula.stages.reporting.page import page
from alula.stages.reporting.table import Table, table_csv, to_markdown
from alula.stages.reporting.tables import inputs_table


def comparison_files(
    name: str,
    material: Material,
    facts: Mapping[str, str],
    tables: Sequence[Table],
    figures: Sequence[Figure],
    *,
    read: Sequence[Table] | None = None,
) -> dict[str, str]:
    """Write the files of a comparison: a CSV per table, an SVG per figure, NAME.md and NAME.html with all.

    Args:
        name: of the pages.
        material: title and inputs.
        facts: summary lines by subject.
        tables: in reading order, with all digits.
        figures: in reading order.
        read: tables as the pages show them; by default `tables`.

    Returns:
        The text of each file by its name.
    """
    shown = tables if read is None else read
    return {
        **{f"{table.name}.csv": table_csv(table) for table in tables},
        **{f"{figure.name}.svg": figure.svg for figure in figures},
        f"{name}.md": to_markdown(material.title, facts, shown, ""),
        f"{name}.html": page(material, [*shown, inputs_table(material)], figures, None, facts=facts),
    }


def headed(text: str, head: str) -> str:
    """Insert a paragraph below the title of a Markdown page."""
    return text.replace("\n\n", f"\n\n{head}\n\n", 1)
