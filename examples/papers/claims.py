"""The claims of a paper: every table, figure, theorem and printed number, each with the rows that judge it.

A claim names its rows by the beginning of "item | quantity". `claim_of` fails where a row belongs to no claim
or to two, so that no row is without a claim; a claim without a row is reported, never left out in silence.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from alula.schemas.errors import InputError
from papers.compared import Verdict

# What a claim with several rows is judged by: the first of these that a row has.
_STRICTEST: tuple[Verdict, ...] = (
    *("refuted", "bounded", "reproduced", "better"),
    *("not comparable", "not available here"),
)


@dataclass(frozen=True, slots=True)
class Claim:
    """One claim of a paper.

    Attributes:
        name: short, unique in its paper.
        where: table, figure or section that makes it.
        says: the claim in plain words.
        printed: its values as printed; empty where it has none.
        rows: beginnings of "item | quantity" of the rows that judge it.
        kind: what makes it.
        how: command that checks it, where rows are made from no flight; empty for the comparison itself.
        shows: of a figure, what the paper's figure shows.
        figures: beginnings of the names of our figures of it.
    """

    name: str
    where: str
    says: str
    printed: str
    rows: tuple[str, ...]
    kind: Literal["number", "table", "figure", "theorem", "statement", "setting"] = "number"
    how: str = ""
    shows: str = ""
    figures: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Paper:
    """A paper and its claims.

    Attributes:
        name: of its folder in `examples`.
        title: as printed.
        source: where it is found.
        says: the paper's claim in one plain sentence.
        page: the detailed page in `docs/results`.
        claims: in the paper's order.
    """

    name: str
    title: str
    source: str
    says: str
    page: str
    claims: tuple[Claim, ...]


def pytest_of(path: str) -> str:
    """Command of a test."""
    return f".venv/bin/pytest {path}"


def claim_of(paper: Paper, item: str, quantity: str) -> Claim:
    """Find the claim that a row judges.

    Raises:
        InputError: no claim of the paper, or more than one, names the row.
    """
    words = f"{item} | {quantity}"
    found = [claim for claim in paper.claims if any(words.startswith(start) for start in claim.rows)]
    if len(found) != 1:
        names = ", ".join(claim.name for claim in found) or "none"
        raise InputError(f"{paper.name}: a row belongs to one claim; {words!r} belongs to {names}")
    return found[0]


def judged(verdicts: Sequence[Verdict]) -> Verdict:
    """Judge a claim by its rows: the least favourable verdict of those with a measurement, or else the rest.

    Args:
        verdicts: of its rows; without any the claim is not available here.
    """
    return next((name for name in _STRICTEST if name in verdicts), "not available here")


def counts(verdicts: Mapping[str, Sequence[Verdict]]) -> dict[Verdict, int]:
    """Count claims by verdict, in the order in which a page names them.

    Args:
        verdicts: of the rows, by claim.
    """
    order: tuple[Verdict, ...] = ("better", "reproduced", "bounded", "refuted")
    each = [judged(rows) for rows in verdicts.values()]
    return {name: each.count(name) for name in (*order, "not comparable", "not available here")}
