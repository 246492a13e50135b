"""All claims of all papers with their verdicts, from the records of the comparisons."""

from __future__ import annotations

from collections.abc import Sequence

from alula.schemas.errors import InputError
from alula.schemas.manifest import Producer
from papers.claims import Claim, Paper, counts, judged
from papers.compared import (
    PAPERS_SCHEMA,
    PAPERS_VERSION,
    ComparedFigure,
    ComparedValue,
    Comparison,
    JudgedClaim,
    JudgedPaper,
    Papers,
)
from papers.dracbf.claims import DRACBF_PAPER
from papers.fastbridge.claims import FASTBRIDGE_PAPER
from papers.geofencing.claims import GEOFENCING_PAPER
from papers.polymerge.claims import POLYMERGE_PAPER

PAPERS = (POLYMERGE_PAPER, FASTBRIDGE_PAPER, DRACBF_PAPER, GEOFENCING_PAPER)


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
    return Papers(schema=PAPERS_SCHEMA, version=PAPERS_VERSION, producer=producer, counts=total, papers=found)


def _collected(paper: Paper, records: Sequence[Comparison]) -> JudgedPaper:
    rows: dict[str, list[ComparedValue]] = {claim.name: [] for claim in paper.claims}
    tables = {claim.name for claim in paper.claims if claim.kind == "table"}
    for record in records:
        filled = {name for name, known in rows.items() if known}
        cells = {(row.claim, row.quantity) for known in rows.values() for row in known}
        for row in record.rows:
            if row.claim not in rows:
                raise InputError(
                    f"{paper.name}: a record judges {row.claim!r}, which is no claim of the paper"
                )
            is_missing = row.claim in tables and (row.claim, row.quantity) not in cells
            if row.claim not in filled or is_missing:
                rows[row.claim].append(row)
    for claim in paper.claims:
        rows[claim.name] = rows[claim.name] or [_open(claim, paper)]
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
                name=claim.name,
                where=claim.where,
                says=claim.says,
                printed=claim.printed,
                kind=claim.kind,
                verdict=judged(verdicts[claim.name]),
                shows=claim.shows,
                rows=rows[claim.name],
                figures=figures.get(claim.name, []),
                see=see.get(claim.name, ""),
            )
            for claim in paper.claims
        ],
        made=list(dict.fromkeys(record.command for record in records)),
        machine="; ".join(dict.fromkeys(record.machine for record in records)),
    )


def _open(claim: Claim, paper: Paper) -> ComparedValue:
    """The row of a claim that no record judges."""
    return ComparedValue(
        claim=claim.name,
        item=claim.where,
        quantity=claim.says,
        published=claim.printed,
        ours="",
        interval="",
        verdict="not available here",
        why="not in these records: the setting flies nothing for it, or its data are not at hand",
        numbers=[],
        flights=None,
        command=claim.how or f"make -C examples/{paper.name} page",
        setting="full",
    )


def _figures(
    paper: Paper, records: Sequence[Comparison]
) -> tuple[dict[str, list[ComparedFigure]], dict[str, str]]:
    """Our figures by claim, and by claim the other one that already has its figure.

    A figure belongs to the first of the claims that name the longest beginning of its name.
    """
    found: dict[str, list[ComparedFigure]] = {}
    see: dict[str, str] = {}
    shown = next((record.figures for record in records if record.figures), [])
    for figure in shown:
        fits = [(len(s), c.name) for c in paper.claims for s in c.figures if figure.name.startswith(s)]
        named = [name for length, name in fits if length == max(fits)[0]]
        if named:
            found.setdefault(named[0], []).append(figure)
            see |= dict.fromkeys(named[1:], named[0])
    return found, see
