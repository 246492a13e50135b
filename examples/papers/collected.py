"""All claims of all papers with their verdicts, from the records of the comparisons."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from alula.schemas.artifacts.manifest import Producer
from alula.schemas.errors import InputError
from papers.claims import Claim, Paper, Row, Shown, counts, judged, row_id, shown
from papers.compared import Compared, ComparedFigure, Comparison, Verdict
from papers.papers import PAPERS

_OPEN = "not in these records: the setting flies nothing for it, or its data are not at hand"


class JudgedClaim(msgspec.Struct, frozen=True, kw_only=True):
    """A claim of a paper with its verdict.

    Attributes:
        claim: with the texts of its rows.
        verdict: the least favourable of the rows that have a measurement, or else that of the others.
        rows: what was measured; of a claim that no record judges one without a name.
        figures: ours.
        see: the claim that already has our figure of this one; empty without.
    """

    claim: Claim
    verdict: Verdict
    rows: list[Compared]
    figures: list[ComparedFigure]
    see: str

    def texts(self, found: Compared) -> Shown:
        """A row of the claim as a person reads it."""
        claim = self.claim
        row = next(
            (row for row in claim.rows if row_id(claim, row) == found.row),
            Row(item=claim.where, quantity=claim.says, published=claim.printed, why=_OPEN),
        )
        return shown(row, found)


class JudgedPaper(msgspec.Struct, frozen=True, kw_only=True):
    """A paper with all its claims.

    Attributes:
        name, title, source, says, page: as of `Paper`.
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

    producer: Producer
    counts: dict[str, int]
    papers: list[JudgedPaper]


def collect(records: Sequence[Comparison], producer: Producer) -> Papers:
    """Put the records together: every claim of every paper, with its rows, its verdict and our figures.

    Of several records of a paper the first counts; rows of later ones fill the claims and the cells of tables
    that it leaves open. A claim that no record judges says so in a row of its own.

    Args:
        records: of any papers, in any order; a paper without a record has all its claims open.
        producer: the program that writes the page.

    Raises:
        InputError: a record is of no known paper, or a row of no claim.
    """
    known = {paper.name: paper for paper in PAPERS}
    for record in records:
        if record.paper not in known:
            raise InputError(f"{record.paper!r} is no known paper")
    found = [_collected(p, [record for record in records if record.paper == p.name]) for p in PAPERS]
    total = {name: sum(paper.counts[name] for paper in found) for name in found[0].counts}
    return Papers(producer=producer, counts=total, papers=found)


def _collected(paper: Paper, records: Sequence[Comparison]) -> JudgedPaper:
    rows: dict[str, list[Compared]] = {claim.name: [] for claim in paper.claims}
    for record in records:
        filled = {name for name, known in rows.items() if known}
        cells = {row.row for known in rows.values() for row in known}
        for row in record.rows:
            claim, _ = paper.row(row.row)
            is_missing = claim.kind == "table" and row.row not in cells
            if claim.name not in filled or is_missing:
                rows[claim.name].append(row)
    for claim in paper.claims:
        rows[claim.name] = rows[claim.name] or [
            Compared(
                row="",
                verdict="not available here",
                command=claim.how or f"make -C examples/{paper.name} page",
                setting="full",
            )
        ]
    figures, see = _figures(paper, records)
    verdicts = {name: [row.verdict for row in known] for name, known in rows.items()}
    return JudgedPaper(
        name=paper.name,
        title=paper.title,
        source=paper.source,
        says=paper.says,
        page=paper.page,
        counts={str(name): count for name, count in counts(verdicts).items()},
        claims=[
            JudgedClaim(
                claim=claim,
                verdict=judged(verdicts[claim.name]),
                rows=rows[claim.name],
                figures=figures.get(claim.name, []),
                see=see.get(claim.name, ""),
            )
            for claim in paper.claims
        ],
        made=list(dict.fromkeys(record.command for record in records)),
        machine="; ".join(dict.fromkeys(record.machine for record in records)),
    )


def _figures(
    paper: Paper, records: Sequence[Comparison]
) -> tuple[dict[str, list[ComparedFigure]], dict[str, str]]:
    """Our figures by claim, and by claim the other one that already has its figure.

    A figure belongs to the first of the claims that name the longest beginning of its name.
    """
    found: dict[str, list[ComparedFigure]] = {}
    see: dict[str, str] = {}
    drawn = next((record.figures for record in records if record.figures), [])
    for figure in drawn:
        fits = [(len(s), c.name) for c in paper.claims for s in c.figures if figure.name.startswith(s)]
        named = [name for length, name in fits if length == max(fits)[0]]
        if named:
            found.setdefault(named[0], []).append(figure)
            see |= dict.fromkeys(named[1:], named[0])
    return found, see
