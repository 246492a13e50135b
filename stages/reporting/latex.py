"""A report as a document of LaTeX, with figures as PDF files beside it."""

from __future__ import annotations

from collections.abc import Sequence

from alula.stages.reporting.content import Content
from alula.stages.reporting.differences import difference_words
from alula.stages.reporting.figures import Figure
from alula.stages.reporting.guarantees import GUARANTEES
from alula.stages.reporting.paper import COLUMN_INCH
from alula.stages.reporting.table import Table, folded, text

_MARKS = {
    "\\": r"\textbackslash{}",
    **{mark: f"\\{mark}" for mark in "&%$#_{}"},
    "~": r"\textasciitilde{}",
    "[": "{[}",  # after the end of a row it would be an option
    "]": "{]}",
    "*": "{*}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "\u00a0": "~",
    "–": "--",
    "→": r"$\rightarrow$",
    "≤": r"$\le$",
    "≥": r"$\ge$",
    "×": r"$\times$",
    "·": r"$\cdot$",
    "²": r"$^2$",
    "³": r"$^3$",
    "−": "$-$",
    "λ": r"$\lambda$",
    "σ": r"$\sigma$",
    "γ": r"$\gamma$",
    "μ": r"$\mu$",
    "ᵀ": r"$^{T}$",
    "₀": r"$_0$",
}
_HEAD = r"""\documentclass[10pt]{article}
\usepackage[T1]{fontenc}
\usepackage[utf8]{inputenc}
\usepackage[a4paper,margin=18mm]{geometry}
\usepackage{booktabs,graphicx,longtable}
\setlength{\tabcolsep}{3pt}
\begin{document}"""
_TABLES = ("runs", "compression", "cover", "timing")  # the others are long, and in the other formats


def to_tex(content: Content, figures: Sequence[tuple[Figure, str]], first_line: str) -> str:
    """Write the contents as a document of LaTeX, with figures from files beside it.

    Args:
        figures: each with the name of its file, without folder.
        first_line: of provenance, put into a comment.
    """
    found = content.brief
    parts = [f"% {first_line}" if first_line else "", _HEAD]
    parts += [
        rf"\section*{{{tex(found.title)}}}",
        rf"\textbf{{{tex(found.verdict)}}}" if found.verdict else "",
    ]
    for subject in found.subjects:
        rows = tuple((number.label, number.shown) for number in subject.numbers)
        if rows:
            parts.append(_table(Table("", subject.title, ("", ""), rows)))
    for table in content.differences:
        parts.append(_list(difference_words(table)))
        parts.append(_table(folded(table)))
    parts += [rf"\section*{{{GUARANTEES}}}", _list(found.proofs)]
    parts.append(_list([f"Not covered: {line}" for line in found.limits]))
    for figure, file in figures:
        width = r"\linewidth" if figure.wide else f"{COLUMN_INCH}in"
        parts.append(
            f"\\begin{{figure}}\\centering\n\\includegraphics[width={width}]{{{file}}}\n"
            f"\\caption{{{tex(figure.alt)}}}\n\\end{{figure}}"
        )
    tables = [table for table in content.tables if table.name in _TABLES]
    parts += [r"\clearpage"] if tables else []
    parts += [_table(folded(table), long=True) for table in tables]
    return "\n\n".join(part for part in [*parts, r"\end{document}"] if part) + "\n"


def tex(words: str) -> str:
    """Escape text for LaTeX; a character that its fonts may lack becomes a question mark."""
    escaped = (_MARKS.get(mark, mark if ord(mark) < 0x180 else "?") for mark in words)
    return " ".join("".join(escaped).split())


def _list(lines: Sequence[str]) -> str:
    if not lines:
        return ""
    items = "\n".join(rf"\item {tex(line)}" for line in lines)
    return f"\\begin{{itemize}}\n{items}\n\\end{{itemize}}"


def _table(table: Table, *, long: bool = False) -> str:
    """A table with rules above, below and under its head; a long one may break over pages."""
    name = "longtable" if long else "tabular"
    others = len(table.columns) - 1
    kind = (
        "p{0.34\\linewidth}" + f"p{{{0.58 / max(others, 1):.3f}\\linewidth}}" * others
        if long
        else "l" * len(table.columns)
    )
    has_head = any(table.columns)
    head = " & ".join(rf"\textbf{{{tex(word)}}}" for word in table.columns) + r" \\ \midrule"
    rows = "\n".join(" & ".join(tex(text(value)) for value in row) + r" \\" for row in table.rows)
    body = f"\\toprule\n{head if has_head else ''}\n{rows}\n\\bottomrule"
    size = r"{\footnotesize" if not long else r"{\small"
    note = f"\n\n{{\\footnotesize {tex(table.note)}}}" if table.note else ""
    title = rf"\subsection*{{{tex(table.title)}}}"
    return f"{title}\n{size}\n\\begin{{{name}}}{{{kind}}}\n{body}\n\\end{{{name}}}}}{note}"
