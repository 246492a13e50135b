"""Reports for paper and slides: figures as PDF at the width of a column, a PDF document, a PNG picture."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from alula.stages.reporting.brief import BAD, FAIR, GOOD, Subject
from alula.stages.reporting.content import Content
from alula.stages.reporting.differences import difference_words
from alula.stages.reporting.figures import Figure, Sheet, on_paper
from alula.stages.reporting.guarantees import GUARANTEES
from alula.stages.reporting.palette import GREEN, INK, ORANGE, SOFT, VERMILLION, run_color
from alula.stages.reporting.table import Table, folded, text

COLUMN_INCH, PAGE_INCH = 3.5, 7.16  # widths of one column and of two in journals
_PAGE_FROM = 7.0  # wider drawings [inch] take two columns
_A4 = (8.27, 11.69)
_LEFT, _TOP = 0.1, 0.93  # of a page of the document
_FONT, _LEADING = 9.0, 1.45
_SERIFLESS = 92  # characters in a line of text
_MONO, _MONO_FONT = 118, 6.6  # characters in a line of a table
_CARD = (12.0, 6.75)
_CARD_DPI = 150
_LISTED_ROWS = 60  # of a table in the document
_TONES = {GOOD: GREEN, FAIR: ORANGE, BAD: VERMILLION}


def column_figures(draw: Callable[[], Sequence[Figure]], line: str) -> list[tuple[Figure, bytes]]:
    """Draw all figures as PDF at the width of a column, or wide ones of two.

    Args:
        line: of provenance, kept among the keywords of each file.
    """

    def place(width: float, height: float) -> Sheet:
        wanted = PAGE_INCH if width > _PAGE_FROM else COLUMN_INCH
        return Sheet((wanted, 1.12 * height * wanted / width))

    with on_paper(place) as drawn:
        figures = draw()
    return [(figure, _pdf([one], line)) for figure, one in zip(figures, drawn, strict=True)]


def to_pdf(draw: Callable[[], Sequence[Figure]], content: Content, line: str) -> bytes:
    """Write a PDF document: the first screen, a page for each figure, then the tables.

    Args:
        line: of provenance, kept among the keywords of the document.
    """
    box_width = 1 - 2 * _LEFT

    def place(width: float, height: float) -> Sheet:
        tall = height * box_width * _A4[0] / width / _A4[1]
        tall = min(tall if width > _PAGE_FROM else 0.75 * tall, 0.68)
        return Sheet(_A4, (_LEFT, 0.9 - tall, box_width, tall))

    with on_paper(place) as drawn:
        figures = draw()
    for figure, sheet in zip(figures, drawn, strict=True):
        bottom = sheet.get_layout_engine().get()["rect"][1]
        _say(sheet, _LEFT, _TOP, _fit(figure.title), fontsize=11, weight="bold", color=INK, va="top")
        caption = "\n".join(textwrap.wrap(figure.alt, _SERIFLESS))
        _say(
            sheet, _LEFT, bottom - 0.012, caption, fontsize=_FONT, color=SOFT, va="top", linespacing=_LEADING
        )
    sheets = [*_text_pages(_first_pages(content)), *drawn, *_text_pages(_table_pages(content))]
    return _pdf(sheets, line)


def to_png(still: Callable[[], Figure | None], content: Content, line: str) -> bytes:
    """Draw the first screen as one picture: verdict and numbers beside the still picture.

    Args:
        line: of provenance, kept as the description of the picture.
    """
    found = content.brief

    def place(width: float, height: float) -> Sheet:
        return Sheet(_CARD, (0.42, 0.02, 0.57, 0.96), 10.0)

    with on_paper(place) as drawn:
        picture = still()
    sheet = drawn[0] if picture is not None else _blank(_CARD)
    tone = _TONES.get(found.tone, SOFT)
    _say(sheet, 0.035, 0.94, _fit(found.title, 60), fontsize=12, color=SOFT, va="top")
    sheet.add_artist(_bar(0.035, 0.868, 0.05, 0.012, tone))
    words = textwrap.wrap(found.verdict, 25 if picture is not None else 60)[:6]
    _say(
        sheet, 0.035, 0.84, "\n".join(words), fontsize=21, weight="bold", color=INK, va="top", linespacing=1.2
    )
    _card_numbers(sheet, found.of_kind("run") or list(found.subjects[:1]), 0.80 - 0.062 * len(words))
    out = io.BytesIO()
    sheet.savefig(out, format="png", dpi=_CARD_DPI, metadata={"Software": None, "Description": line})
    return out.getvalue()


def _card_numbers(sheet: Any, subjects: Sequence[Subject], top: float) -> None:
    """Four numbers of one subject in two columns, or of each run a row."""
    if len(subjects) == 1:
        step = min(0.19, (top - 0.06) / 2)
        for place, number in enumerate(subjects[0].numbers):
            x, y = 0.035 + 0.19 * (place % 2), top - step * (place // 2)
            color = INK if number.good is None else GREEN if number.good else VERMILLION
            _say(sheet, x, y, number.shown, fontsize=21, weight="bold", color=color, va="top")
            label = "\n".join(textwrap.wrap(number.label, 24))
            _say(sheet, x, y - 0.072, label, fontsize=10, color=INK, va="top")
        return
    step = min(0.15, (top - 0.04) / max(len(subjects), 1))
    for place, subject in enumerate(subjects):
        y = top - step * place
        _say(
            sheet,
            0.035,
            y,
            _fit(subject.title, 40),
            fontsize=12,
            weight="bold",
            color=run_color(place),
            va="top",
        )
        shown = [f"{number.shown} {number.label}" for number in subject.numbers[:3]]
        lines = "\n".join(textwrap.wrap(" · ".join(shown) or subject.verdict, 56)[:2])
        _say(sheet, 0.035, y - 0.042, lines, fontsize=9.5, color=INK, va="top", linespacing=1.3)


def _say(sheet: Any, x: float, y: float, words: str, **style: Any) -> None:
    """Set text; a dollar sign in it starts no formula."""
    sheet.text(x, y, words, parse_math=False, **style)


def _bar(x: float, y: float, width: float, height: float, color: str) -> Any:
    from matplotlib.patches import Rectangle

    return Rectangle((x, y), width, height, color=color, linewidth=0)


def _blank(size: tuple[float, float]) -> Any:
    from matplotlib.figure import Figure as Canvas

    return Canvas(figsize=size, facecolor="white")


def _pdf(sheets: Sequence[Any], line: str) -> bytes:
    """One PDF of sheets, with fonts that journals accept (TrueType); equal sheets give equal bytes."""
    import matplotlib as mpl
    from matplotlib.backends.backend_pdf import PdfPages

    out = io.BytesIO()
    about = {"Creator": "alula", "Producer": None, "CreationDate": None}
    with (
        mpl.rc_context({"pdf.fonttype": 42}),
        PdfPages(out, metadata=about | ({"Keywords": line} if line else {})) as pages,
    ):
        for sheet in sheets:
            pages.savefig(sheet)
    return out.getvalue()


# A page of text is a list of lines, each with its style.
_Line = tuple[str, dict[str, Any]]
_HEADING: dict[str, Any] = {"fontsize": 12.5, "weight": "bold"}
_BODY: dict[str, Any] = {"fontsize": _FONT}
_CELLS: dict[str, Any] = {"fontsize": _MONO_FONT, "family": "monospace"}


def _first_pages(content: Content) -> Iterator[_Line]:
    found = content.brief
    yield found.title, {"fontsize": 11.0, "color": SOFT}
    for words in textwrap.wrap(found.verdict, 46):
        yield words, {"fontsize": 19.0, "weight": "bold", "color": INK}
    for subject in found.subjects:
        yield "", _BODY
        yield subject.title, _HEADING
        if subject.verdict != found.verdict:
            yield from _wrapped(subject.verdict)
        for number in subject.numbers:
            detail = f" ({number.detail})" if number.detail else ""
            yield from _wrapped(f"{number.shown}  {number.label}{detail}")
    for table in content.differences:
        yield "", _BODY
        yield table.title, _HEADING
        for words in difference_words(table):
            yield from _wrapped(words)
        yield from _cells(folded(table))
    if found.proofs or found.limits:
        yield "", _BODY
        yield GUARANTEES, _HEADING
    for words in found.proofs:
        yield from _wrapped(words)
    for words in found.limits:
        yield from _wrapped(f"Not covered: {words}")
    for name, words in found.statements:
        yield from _wrapped(f"{name}: {words}")


def _table_pages(content: Content) -> Iterator[_Line]:
    for table in content.tables:
        yield table.title, _HEADING
        yield from _cells(folded(table))
        yield from _wrapped(table.note)
        yield "", _BODY


def _wrapped(words: str) -> Iterator[_Line]:
    for line in textwrap.wrap(words, _SERIFLESS):
        yield line, _BODY


def _cells(table: Table) -> Iterator[_Line]:
    """A table as lines of characters of one width; one that is too wide goes on below itself."""
    rows = [tuple(map(str, table.columns)), *(tuple(map(text, row)) for row in table.rows[:_LISTED_ROWS])]
    rows = [tuple(cell.replace("\u00a0", " ") for cell in row) for row in rows]
    most = _MONO // 2
    widths = [min(most, max(len(row[at]) for row in rows)) for at in range(len(table.columns))]
    blocks: list[list[int]] = [[0]]
    for at in range(1, len(widths)):
        if sum(widths[i] + 2 for i in [*blocks[-1], at]) > _MONO and len(blocks[-1]) > 1:
            blocks.append([0])
        blocks[-1].append(at)
    for block in blocks:
        for number, row in enumerate(rows):
            cells = [textwrap.wrap(row[at], widths[at]) or [""] for at in block]
            for level in range(max(map(len, cells))):
                parts = [
                    (cell[level] if level < len(cell) else "").ljust(widths[at])
                    for cell, at in zip(cells, block, strict=True)
                ]
                style = _CELLS | ({"weight": "bold"} if number == 0 else {})
                yield "  ".join(parts).rstrip(), style
    if len(table.rows) > _LISTED_ROWS:
        yield f"... {len(table.rows) - _LISTED_ROWS:,} more rows in the other formats", _CELLS


def _text_pages(lines: Iterator[_Line]) -> Iterator[Any]:
    """Set lines on as many pages as they need."""
    sheet, y = None, 0.0
    for words, style in lines:
        height = _LEADING * style["fontsize"] / 72 / _A4[1]
        if sheet is None or y - height < 1 - _TOP:
            if sheet is not None:
                yield sheet
            sheet, y = _blank(_A4), _TOP
        _say(sheet, _LEFT, y, _fit(words, 200), va="top", **({"color": INK} | style))
        y -= height
    if sheet is not None:
        yield sheet


def _fit(words: str, most: int = 84) -> str:
    """Cut a line that is too long."""
    return words if len(words) <= most else f"{words[: most - 1]}…"
