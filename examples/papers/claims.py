"""The claims of a paper as data: every table, figure, theorem and printed number, each with its rows.

A claim's rows say in words what is compared; what was measured fills their places. `PAPER.toml` holds them:

- A place `{name}` takes a measured value and keeps all digits of a number; `{name:.2f}` rounds it in another
  way; `{name!s}` writes a count or a word; `{name!t}` rounds as tables do and keeps no digits.
- A list is written item by item, separated by commas; after the colon stands the text of an item.
- `ours` may be a list of parts. A text, or a part of `ours`, is left out where a value in it is not known.
- `why` may have a text for each verdict; a measured value `why` stands in its place.
- A row with a verdict of its own is never measured.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from string import Formatter
from typing import Any, Literal

import msgspec

from alula.schemas.errors import InputError
from alula.stages.reporting.table import text
from papers.compared import Measured, ShownNumber, Verdict

FOLDER = Path(__file__).parent
# What a claim with several rows is judged by: the first of these that a row has.
_STRICTEST: tuple[Verdict, ...] = (
    *("refuted", "bounded", "reproduced", "better"),
    *("not comparable", "not available here"),
)


class Row(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a row says.

    Attributes:
        name: unique in its claim; empty for the only row.
        item: table, figure or section of the paper.
        quantity: what is compared.
        published: as printed.
        ours: our value.
        interval: its 95 % interval, or what stands for it.
        why: the reason of the verdict, or that of each verdict.
        verdict: of a row that is never measured.
        limits: numbers of `published`, which the verdict needs.
    """

    name: str = ""
    item: str
    quantity: str
    published: str = ""
    ours: str | list[str] = ""
    interval: str = ""
    why: str | dict[str, str] = ""
    verdict: Verdict | None = None
    limits: list[float] = []


class Claim(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One claim of a paper.

    Attributes:
        name: short, unique in its paper.
        where: table, figure or section that makes it.
        says: the claim in plain words.
        printed: its values as printed; empty where it has none.
        rows: that judge it.
        kind: what makes it.
        how: command that checks it, where rows are made from no flight; empty for the comparison itself.
        shows: of a figure, what the paper's figure shows.
        figures: beginnings of the names of our figures of it.
    """

    name: str
    where: str
    says: str
    printed: str = ""
    rows: list[Row]
    kind: Literal["number", "table", "figure", "theorem", "statement", "setting"] = "number"
    how: str = ""
    shows: str = ""
    figures: list[str] = []


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
    known: Mapping[str, tuple[Claim, Row]] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Find the rows by their names.

        Raises:
            InputError: two rows have the same name.
        """
        rows = [(row_id(claim, row), claim, row) for claim in self.claims for row in claim.rows]
        known = {name: (claim, row) for name, claim, row in rows}
        if len(known) != len(rows) or len({claim.name for claim in self.claims}) != len(self.claims):
            raise InputError(f"{self.name}: two claims, or two rows of a claim, have the same name")
        object.__setattr__(self, "known", known)

    def row(self, name: str) -> tuple[Claim, Row]:
        """Find a row and its claim.

        Raises:
            InputError: no row has this name.
        """
        if name not in self.known:
            raise InputError(f"{self.name}: {name!r} is the row of no claim")
        return self.known[name]

    def limit(self, name: str) -> float:
        """The number that a row's verdict needs.

        Raises:
            InputError: no row has this name.
        """
        (limit,) = self.row(name)[1].limits
        return limit


def row_id(claim: Claim, row: Row) -> str:
    """Name of a row in its paper."""
    return f"{claim.name}/{row.name}" if row.name else claim.name


@cache
def _document(name: str) -> dict[str, Any]:
    return tomllib.loads((FOLDER / f"{name}.toml").read_text(encoding="utf-8"))


def published(name: str) -> dict[str, Any]:
    """The numbers that a paper prints, from `NAME.toml`."""
    return dict(_document(name)["published"])


def read_paper(name: str, tables: Mapping[str, Sequence[Claim]] | None = None) -> Paper:
    """Read a paper from `NAME.toml`.

    Args:
        name: of the paper.
        tables: claims that are made cell by cell, by the name that stands in their place in the file.

    Raises:
        InputError: a claim is not well formed.
    """
    document = _document(name)
    claims: list[Claim] = []
    for entry in document["claims"]:
        if "table" in entry:
            claims += (tables or {})[entry["table"]]
            continue
        try:
            claims.append(msgspec.convert(entry, Claim))
        except msgspec.ValidationError as error:
            raise InputError(f"{name}.toml, claim {entry.get('name')!r}: {error}") from error
    words = {key: document[key] for key in ("name", "title", "source", "says", "page")}
    return Paper(**words, claims=tuple(claims))


@dataclass(frozen=True, slots=True)
class Shown:
    """A row as a person reads it; `numbers` has all digits of those that `ours` and `interval` round."""

    item: str
    quantity: str
    published: str
    ours: str
    interval: str
    verdict: Verdict
    why: str
    numbers: tuple[ShownNumber, ...]

    @property
    def cells(self) -> tuple[str, ...]:
        """The texts of a table, in its order."""
        return (
            *(self.item, self.quantity, self.published, self.ours, self.interval),
            *(self.verdict, self.why),
        )


def shown(row: Row, found: Measured) -> Shown:
    """Write a row."""
    values = {"low": found.low, "high": found.high, **found.values}
    numbers: list[ShownNumber] = []

    def made(cell: str, template: str | list[str]) -> str:
        words = ""
        for part in [template] if isinstance(template, str) else template:
            words += _written(part, values, cell, len(words), numbers)
        return words

    why = row.why if isinstance(row.why, str) else row.why.get(found.verdict, "")
    why = "{why!s}" if "why" in values else why
    return Shown(
        item=made("item", row.item),
        quantity=made("quantity", row.quantity),
        published=made("published", row.published),
        ours=made("ours", row.ours),
        interval=made("interval", row.interval),
        verdict=found.verdict,
        why=made("why", why),
        numbers=tuple(number for number in numbers if number.cell in ("ours", "interval")),
    )


def _written(template: str, values: Mapping[str, Any], cell: str, at: int, numbers: list[ShownNumber]) -> str:
    """Fill the places of a text that begins at `at`, and add its numbers; empty where a value is unknown."""
    words, own = "", []

    def add(value: Any, form: str, kind: str | None) -> None:
        nonlocal words
        if kind == "t" or isinstance(value, str | bool):
            words += text(value)
        elif kind == "s":
            words += format(value, form)
        else:
            written = format(value, form) if form else text(value)
            if math.isfinite(value):
                start = at + len(words)
                own.append(ShownNumber(cell=cell, at=start, shown=written, value=float(value)))
            words += written

    for literal, name, form, kind in Formatter().parse(template):
        words += literal
        if name is None:
            continue
        value = values.get(name)
        if value is None:
            return ""
        if not isinstance(value, list | tuple):
            add(value, form or "", kind)
            continue
        for number, item in enumerate(value):
            words += ", " if number else ""
            inner = iter(item if isinstance(item, list | tuple) else [item])
            for before, place, own_form, own_kind in Formatter().parse(form or "{}"):
                words += before
                if place is not None:
                    add(next(inner), own_form or "", own_kind)
    numbers += own
    return words


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
