"""Rows of verdicts as a person reads them, and the claims that they leave open."""

from types import SimpleNamespace

from papers.claims import shown


def said(paper, rows):
    """The texts of rows, with what was measured as `found`."""
    texts = [(shown(paper.row(found.row)[1], found), found) for found in rows]
    fields = ("item", "quantity", "published", "ours", "interval", "verdict", "why", "numbers")
    return [
        SimpleNamespace(**{name: getattr(row, name) for name in fields}, found=found) for row, found in texts
    ]


def open_claims(paper, rows):
    """Names of the claims without a row."""
    return {claim.name for claim in paper.claims} - {paper.row(row.found.row)[0].name for row in rows}
