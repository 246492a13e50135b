"""The page of all papers as Markdown."""

from __future__ import annotations

from alula.stages.reporting.table import markdown_cell
from papers.collected import JudgedClaim, JudgedPaper, Papers
from papers.compared import VERDICTS, Compared
from papers.page import TITLE, sentence
from papers.verdicts import NOTE

_COLUMNS = (
    *("where", "claim", "what is compared", "published", "ours", "95 % interval", "verdict", "why"),
    *("flights", "command"),
)


def papers_markdown(papers: Papers, head: str = "") -> str:
    """Write the page.

    Args:
        papers: from `collect`.
        head: a paragraph below the title.
    """
    names = " | ".join(VERDICTS)
    counted = [f"| paper | claims | {names} |", "|" + " --- |" * (2 + len(VERDICTS))]
    counted += [
        _counts(paper.name, f"[{paper.name}](#{paper.name})", paper.counts) for paper in papers.papers
    ]
    counted.append(_counts("all", "all", papers.counts))
    parts = [
        f"# {TITLE}",
        head,
        f"**{sentence(papers.counts)}**",
        "\n".join(counted),
        NOTE,
        "Several rows may judge one claim; its verdict is then the least favourable of those with a "
        "measurement.",
        *(_paper(paper) for paper in papers.papers),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def _counts(name: str, shown: str, counts: dict[str, int]) -> str:
    each = " | ".join(str(counts[verdict]) for verdict in VERDICTS)
    return f"| {shown} | {sum(counts.values())} | {each} |"


def _paper(paper: JudgedPaper) -> str:
    lines = ["| " + " | ".join(_COLUMNS) + " |", "|" + " --- |" * len(_COLUMNS)]
    for found in paper.claims:
        for place, row in enumerate(found.rows):
            lines.append(_row(found, row, is_first=place == 0))
    figures = [
        f"- {markdown_cell(found.claim.where)}: {markdown_cell(found.claim.shows)} "
        + (
            f"Ours: {'; '.join(markdown_cell(f.title) for f in found.figures)}."
            if found.figures
            else f"Ours: as for {found.see}."
            if found.see
            else "Ours: the values above."
        )
        for found in paper.claims
        if found.claim.shows
    ]
    made = "; ".join(f"`{command}`" for command in paper.made)
    return "\n\n".join(
        [
            f"## {paper.name}",
            f"{markdown_cell(paper.title)}, {paper.source}. {markdown_cell(paper.says)}",
            f"**{sentence(paper.counts)}** Everything else that was measured: [{paper.page}]({paper.page}).",
            f"Made by {made} on {markdown_cell(paper.machine)}." if paper.made else "Nothing was flown.",
            "\n".join(lines),
            "### Figures",
            "\n".join(figures),
        ]
    )


def _row(found: JudgedClaim, row: Compared, *, is_first: bool) -> str:
    setting = "quick: " if row.setting == "quick" else ""
    flights = f"{setting}{'–' if row.flights is None else format(row.flights, ',')}"
    said = found.texts(row)
    cells = [
        *((found.claim.where, found.claim.says) if is_first else ("", "")),
        *(
            said.quantity,
            said.published,
            said.ours or "–",
            said.interval or "–",
            said.verdict,
            said.why or "–",
        ),
        flights,
    ]
    return "| " + " | ".join(markdown_cell(cell) for cell in cells) + f" | `{row.command}` |"
