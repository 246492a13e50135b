"""Rows of verdicts against the claims of their paper."""

from papers.claims import claim_of


def open_claims(paper, rows):
    """Names of the claims without a row; every row must belong to exactly one claim."""
    judged = {claim_of(paper, row.item, row.quantity).name for row in rows}
    names = [claim.name for claim in paper.claims]
    assert len(set(names)) == len(names)
    return set(names) - judged
