"""Command line and output files of the examples that compare runs or maps."""

from __future__ import annotations

import argparse
import os
import platform
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from alula.cli.shell.runner import input_ref
from alula.schemas.artifacts.manifest import producer
from alula.schemas.atomic import write_text
from alula.stages.reporting.figures import Figure
from alula.stages.reporting.material import Material
from alula.stages.reporting.page import page
from alula.stages.reporting.table import Table, table_csv, to_markdown
from alula.stages.reporting.tables import inputs_table
from papers.claims import Paper
from papers.compared import Measured, write_comparison_record
from papers.record import Made, comparison_record


def comparison_words(description: str, *, tuning: bool = False) -> argparse.Namespace:
    """Parse the command line of a comparison.

    Args:
        description: first line of its help.
        tuning: whether it also reads the table of a search for gains.

    Returns:
        `folder`, `runs`, and `markdown`, which may be None; with `tuning` also that file.
    """
    parser = argparse.ArgumentParser(description=description)
    common_words(parser)
    if tuning:
        parser.add_argument("--tuning", type=Path, metavar="FILE", required=True, help="table of a search")
    parser.add_argument("folder", type=Path)
    parser.add_argument("runs", type=Path, nargs="+", metavar="RUN")
    return parser.parse_args()


def common_words(parser: argparse.ArgumentParser) -> None:
    """Add the options of every comparison: its Markdown page, and how it was made."""
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="also write the tables to FILE")
    parser.add_argument("--command", default="make", help="command that makes a target of the example")
    parser.add_argument("--setting", choices=("full", "quick"), default="full", help="how much was flown")


def this_machine() -> str:
    """Describe in words the machine that writes a page."""
    return f"{platform.machine()}, {os.cpu_count()} processors, Python {platform.python_version()}"


def write_comparison(
    output: Path,
    title: str,
    inputs: Iterable[tuple[str, Path]],
    facts: Mapping[str, str],
    tables: Sequence[Table],
    figures: Sequence[Figure],
    *,
    read: Sequence[Table] | None = None,
    markdown: Path | None = None,
    head: str = "",
) -> None:
    """Write all files of a comparison.

    Args:
        output: OUTPUT.md and OUTPUT.html are written, and tables and figures beside them.
        title: of the pages.
        inputs: roles and files that the comparison was made from.
        facts: summary lines by subject.
        tables: in reading order, with all digits.
        figures: in reading order.
        read: tables as the pages show them; by default `tables`.
        markdown: second file for the Markdown page, with `head` below its title.
        head: a paragraph.

    Raises:
        InputError: an input cannot be read.
        OutputError: a file cannot be written.
    """
    material = Material(title, inputs=tuple(input_ref(role, path) for role, path in inputs))
    shown = tables if read is None else read
    text = to_markdown(title, facts, shown, "")
    files = {
        **{f"{table.name}.csv": table_csv(table) for table in tables},
        **{f"{figure.name}.svg": figure.svg for figure in figures},
        f"{output.name}.md": text,
        f"{output.name}.html": page(material, [*shown, inputs_table(material)], figures, None, facts=facts),
    }
    for name, content in files.items():
        write_text(output.parent / name, content)
    if markdown is not None:
        write_text(markdown, text.replace("\n\n", f"\n\n{head}\n\n", 1))


def write_record(
    output: Path,
    paper: Paper,
    rows: Sequence[Measured],
    figures: Sequence[Figure],
    options: argparse.Namespace,
) -> None:
    """Write the record of a comparison: OUTPUT.record.json.

    Args:
        output: name of the comparison's files, without an ending.
        paper: with its claims.
        rows: in reading order.
        figures: in reading order.
        options: from `comparison_words`: `folder`, `command` and `setting`.

    Raises:
        InputError: a row belongs to no claim.
        OutputError: a file cannot be written.
    """
    made = Made(
        options.command, options.folder.as_posix(), f"{output.name}.html", options.setting, this_machine()
    )
    text = write_comparison_record(comparison_record(paper, rows, figures, made, producer()))
    write_text(output.parent / f"{output.name}.record.json", text)
