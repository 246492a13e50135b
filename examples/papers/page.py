"""One page about all papers: how many claims hold, then each paper with its claims, our values and figures.

The page has no script. Every rounded number of ours stands in an element with its exact value, `data-value`,
where the record knows it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from html import escape

from alula.stages.reporting.figures import Figure
from alula.stages.reporting.page import document, figure_html
from papers.claims import Shown
from papers.collected import JudgedClaim, JudgedPaper, Papers
from papers.compared import VERDICTS, Compared, ShownNumber
from papers.style import PAPERS_STYLE, name_of
from papers.verdicts import VERDICT_WORDS

TITLE = "Four papers, claim by claim"
_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
_LONG_COMMAND = 150
_CODE = re.compile("`([^`]*)`")
_READ = (
    "A claim is a table's column, a figure, a theorem, a printed number or a setting. Several rows may judge "
    "one claim; its verdict is then the least favourable of those with a measurement."
)


def papers_page(
    papers: Papers, drawings: Mapping[tuple[str, str], str], *, folder: str = "../../../docs/results"
) -> str:
    """Write the page; it loads nothing from elsewhere, and every name in it is escaped.

    Args:
        papers: from `collect`.
        drawings: SVG text of our figures by paper and name; a figure without one is described in words.
        folder: of the detailed pages, as seen from the page.

    Returns:
        The HTML text.
    """
    parts = [
        _first_screen(papers),
        _words(),
        _choice(papers.counts),
        *(_paper(paper, drawings, folder) for paper in papers.papers),
    ]
    return document(
        TITLE,
        f"{len(papers.papers)} papers, {sum(papers.counts.values())} claims",
        parts,
        style=PAPERS_STYLE,
        policy=_POLICY,
        head='<link rel="icon" href="data:,">',
    )


def sentence(counts: Mapping[str, int]) -> str:
    """State in words how many claims have which verdict."""
    total = sum(counts.values())
    better, reproduced, bounded, refuted = (counts[name] for name in VERDICTS[:4])
    return (
        f"Of {total} claims, {better} come out better here than published, {reproduced} are reproduced, "
        f"{bounded} bounded and {refuted} refuted; {counts['not comparable']} cannot be compared, and "
        f"{counts['not available here']} need hardware or data that are not here."
    )


def _first_screen(papers: Papers) -> str:
    each = "".join(
        f'<div><h3><a href="#{paper.name}">{escape(paper.title)}</a></h3>'
        f"{_bar(paper.counts)}{_tally(paper.counts, paper.name)}</div>"
        for paper in papers.papers
    )
    return (
        '<section class="hero alone"><div class="say">'
        f'<p class="verdict">{escape(sentence(papers.counts))}</p>'
        f"{_bar(papers.counts)}{_tally(papers.counts, 'all')}"
        f'<div class="overview">{each}</div></div></section>'
    )


def _bar(counts: Mapping[str, int]) -> str:
    total = max(1, sum(counts.values()))
    words = ", ".join(f"{counts[name]} {name}" for name in VERDICTS)
    parts = "".join(
        f'<i class="{name_of(name)}" style="width: {100 * counts[name] / total:.2f}%"></i>'
        for name in VERDICTS
        if counts[name]
    )
    return f'<div class="bar" role="img" aria-label="{escape(words)}">{parts}</div>'


def _tally(counts: Mapping[str, int], of: str) -> str:
    items = "".join(
        f'<li><span class="chip {name_of(name)}"><b data-of="{of}" data-key="{name_of(name)}" '
        f'data-value="{counts[name]}">{counts[name]:,}</b> {name}</span></li>'
        for name in VERDICTS
        if counts[name]
    )
    return f'<ul class="tally">{items}</ul>'


def _words() -> str:
    items = "".join(
        f'<dt><span class="chip {name_of(name)}">{name}</span></dt><dd>{escape(words)}</dd>'
        for name, words in VERDICT_WORDS.items()
    )
    return f'<h2>What the words mean</h2><dl class="words">{items}</dl><p class="soft">{_READ}</p>'


def _choice(counts: Mapping[str, int]) -> str:
    """The choice of claims by verdict, which the style sheet makes."""
    items = [
        '<label><input type="radio" name="only" id="only-all" checked>all</label>',
        *(
            f'<label><input type="radio" name="only" id="only-{name_of(name)}">{name} '
            f"({counts[name]})</label>"
            for name in VERDICTS
        ),
    ]
    return f'<fieldset class="panel choose"><legend>Show claims:</legend>{"".join(items)}</fieldset>'


def _paper(paper: JudgedPaper, drawings: Mapping[tuple[str, str], str], folder: str) -> str:
    drawn = [found for found in paper.claims if found.claim.shows]
    made = "".join(f"<p>Made by <code>{escape(command)}</code></p>" for command in paper.made)
    where = f" on {escape(paper.machine)}" if paper.machine else ""
    return (
        f'<section id="{paper.name}"><h2>{escape(paper.title)}</h2>'
        f'<p class="soft">{escape(paper.source)}</p><p>{escape(paper.says)}</p>'
        f"<p>{escape(sentence(paper.counts))} Everything else that was measured: "
        f'<a href="{escape(folder)}/{escape(paper.page)}">{escape(paper.page)}</a>.</p>'
        f'<div class="made soft">{made}{f"<p>{where.strip()}</p>" if where and made else ""}</div>'
        f"<h3>Claims</h3>{_claims(paper)}"
        f'<h3>Figures: theirs in words, ours beside them</h3><div class="drawn">'
        f"{''.join(_beside(paper, found, drawings) for found in drawn)}</div></section>"
    )


def _claims(paper: JudgedPaper) -> str:
    head = "".join(
        f'<th scope="col">{words}</th>'
        for words in ("what is compared", "published", "ours", "95 % interval", "verdict, reason, command")
    )
    bodies = "".join(_claim(paper, found) for found in paper.claims)
    widths = "".join(f'<col class="{name}">' for name in ("what", "printed", "ours", "interval", "verdict"))
    return (
        f'<div class="panel"><table class="claims"><colgroup>{widths}</colgroup>'
        f"<thead><tr>{head}</tr></thead>{bodies}</table></div>"
    )


def _claim(paper: JudgedPaper, found: JudgedClaim) -> str:
    """A claim with its rows; the verdict of several rows stands beside the claim."""
    claim = found.claim
    printed = f'<span class="printed">{escape(claim.printed)}</span>' if claim.printed else ""
    says = f'<span class="where">{escape(claim.where)}</span>{escape(claim.says)}{printed}'
    if len(found.rows) > 1:
        head = f'<th colspan="4" scope="rowgroup">{says}</th><td>together: {_chip(found.verdict)}</td>'
    else:
        head = f'<th colspan="5" scope="rowgroup">{says}</th>'
    rows = "".join(_row(row, found.texts(row)) for row in found.rows)
    return (
        f'<tbody id="{escape(paper.name)}-{escape(claim.name)}" data-verdict="{name_of(found.verdict)}">'
        f'<tr class="claim">{head}</tr>{rows}</tbody>'
    )


def _chip(verdict: str) -> str:
    return f'<span class="chip {name_of(verdict)}">{escape(verdict)}</span>'


def _row(row: Compared, said: Shown) -> str:
    why = f" {_CODE.sub(_as_code, escape(said.why))}" if said.why else ""
    return (
        f'<tr class="value"><td data-label="what">{escape(said.quantity)}</td>'
        f'<td data-label="published">{escape(said.published)}</td>'
        f'<td data-label="ours">{_exactly(said, "ours")}</td>'
        f'<td data-label="95 % interval">{_exactly(said, "interval")}</td>'
        f'<td>{_chip(row.verdict)}{why}<small data-flights="{"" if row.flights is None else row.flights}">'
        f"{escape(_flights(row))}</small>{_command(row.command)}</td></tr>"
    )


def _flights(row: Compared) -> str:
    few = " (quick setting)" if row.setting == "quick" else ""
    counted = "no flights" if row.flights is None else f"{row.flights:,} flight{'s' * (row.flights != 1)}"
    return f"{counted}{few}"


def _as_code(found: re.Match[str]) -> str:
    return f"<code>{found[1]}</code>"


def _exactly(row: Shown, cell: str) -> str:
    """The text of a cell, each rounded number with its exact value."""
    words = row.ours if cell == "ours" else row.interval
    parts, end = [], 0
    numbers: list[ShownNumber] = sorted((n for n in row.numbers if n.cell == cell), key=lambda n: n.at)
    for number in numbers:
        parts.append(escape(words[end : number.at]))
        parts.append(f'<span data-value="{number.value!r}">{escape(number.shown)}</span>')
        end = number.at + len(number.shown)
    return "".join([*parts, escape(words[end:])])


def _command(command: str) -> str:
    code = f"<code>{escape(command)}</code>"
    if len(command) <= _LONG_COMMAND:
        return f"<small>{code}</small>"
    return f"<details><summary>command</summary>{code}</details>"


def _beside(paper: JudgedPaper, found: JudgedClaim, drawings: Mapping[tuple[str, str], str]) -> str:
    """A figure of the paper in words, and ours."""
    claim, shown = found.claim, []
    for figure in found.figures:
        svg = drawings.get((paper.name, figure.name))
        if svg is not None:
            few = " (quick setting)" if figure.setting == "quick" else ""
            own = Figure(f"{paper.name}-{figure.name}", f"{figure.title}{few}", figure.description, svg)
            shown.append(figure_html(own))
    ours = "".join(shown)
    if not ours and found.see:
        ours = f'<p>Ours: <a href="#{escape(paper.name)}-{escape(found.see)}-drawn">the figure above</a>.</p>'
    ours = ours or (
        f'<p>Ours: no figure. <a href="#{escape(paper.name)}-{escape(claim.name)}">The claim</a> has the '
        "values and the reason.</p>"
    )
    place = f"{paper.name}-{claim.name}-drawn"
    return (
        f'<div class="panel beside apart" id="{escape(place)}"><div><h3>{escape(claim.where)}</h3>'
        f"<p><b>In the paper:</b> {escape(claim.shows)}</p><p>It claims: {escape(claim.says)}.</p>"
        f"<p>{_chip(found.verdict)}</p></div><div>{ours}</div></div>"
    )
