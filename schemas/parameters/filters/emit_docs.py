"""Generator of the parameter tables in the documentation."""

from __future__ import annotations

import math
import re

from alula.schemas.parameters.filters.source import Parameter, Struct

_MARKED = re.compile(r"(<!-- parameters: ([a-z -]+) -->\n).*?(<!-- end of parameters -->)", re.DOTALL)


def with_tables(page: str, structs: dict[str, Struct]) -> str:
    """A page with the tables between its markers made anew.

    Args:
        page: Markdown; `<!-- parameters: NAME NAME -->` and `<!-- end of parameters -->` enclose a table of
            the parameters of these files of the source, in this order.
    """

    def table(match: re.Match[str]) -> str:
        rows = [row for name in match[2].split() for row in _rows(structs[name])]
        head = "| name | default | unit | range | meaning |\n| --- | ---: | --- | --- | --- |\n"
        return f"{match[1]}{head}{''.join(rows)}{match[3]}"

    return _MARKED.sub(table, page)


def _rows(struct: Struct) -> list[str]:
    prefix = "" if not struct.parameters_of or struct.python == "" else f"{struct.name.replace('-', '_')}."
    of_parts = [p for part in struct.parts for p in part.parameters() if part.flat or p.name in part.defaults]
    return [_row(p, prefix) for p in (*struct.parameters, *of_parts) if not p.set_by]


def _row(p: Parameter, prefix: str) -> str:
    text = p.doc.replace("|", "\\|")
    if p.choices:
        text += ": " + "; ".join(f"`{name}`: {doc}" for name, doc in p.choices.items())
    unit = p.unit.replace("^2", "²").replace("^3", "³")
    return f"| `{prefix}{p.name}` | {_default(p)} | {unit} | {_range(p)} | {text} |\n"


def _default(p: Parameter) -> str:
    if p.optional:
        return p.optional
    if isinstance(p.default, bool):
        return str(p.default).lower()
    if isinstance(p.default, str):
        return f"`{p.default}`"
    if isinstance(p.default, list):
        return ", ".join(f"{value:g}" for value in p.default)
    if isinstance(p.default, float):
        return "∞" if math.isinf(p.default) else f"{p.default:.12g}"
    return str(p.default)


def _range(p: Parameter) -> str:
    words = [
        f"{sign} {value:g}"
        for sign, value in (("≥", p.min), (">", p.above), ("≤", p.max), ("<", p.below))
        if value is not None
    ]
    return ", ".join(words) + (f", a multiple of {p.multiple_of}" if p.multiple_of else "")
