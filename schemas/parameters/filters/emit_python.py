"""Generator of the typed Python module `alula.schemas.parameters.filter_options`."""

from __future__ import annotations

import math
from collections.abc import Iterable

from alula.schemas.parameters.filters.emit_native import NOTE
from alula.schemas.parameters.filters.source import Parameter, Struct, filters


def module(structs: dict[str, Struct]) -> str:
    """The Python module: a frozen struct per filter, and what native options are made of."""
    named = _named(structs)
    out = [
        f'"""Parameters of all filters: names, defaults, limits, documentation.\n\n{NOTE}\n"""',
        "",
        "from __future__ import annotations",
        "",
        "from typing import Annotated, Literal",
        "",
        "from msgspec import Meta",
        "",
        "from alula.schemas.parameters.filters.values import NativeStruct, Options",
        "",
    ]
    for struct in named:
        out += _struct(struct, _base(struct, named))
    out += ["", "FILTERS: dict[str, type[Options]] = {"]
    out += [f'    "{name}": {_class(struct)},' for name, struct in filters(structs).items()]
    out += ["}", '"""The parameters of each filter."""', "", "TABLES: dict[str, str] = {"]
    out += [f'    "{name}": "{struct.filter}",' for name, struct in filters(structs).items()]
    out += ["}", '"""The table of a scenario that has the parameters of each filter."""', ""]
    out += ["NATIVE_STRUCTS: dict[str, tuple[NativeStruct, ...]] = {"]
    for struct in structs.values():
        if struct.filter and struct.cpp and not struct.parameters_of:
            out += [f'    "{struct.filter}": (', *(f"        {part}," for part in _parts(struct)), "    ),"]
    out += ["}", '"""The native structs that make up the options of a filter."""', ""]
    out += ["NATIVE_NAMES: dict[str, dict[str, str]] = {"]
    for struct in structs.values():
        names = {p.name: p.binding for p in _all(struct) if p.binding}
        if struct.filter and names:
            out += [
                f'    "{struct.filter}": {{',
                *(f'        "{k}": "{v}",' for k, v in names.items()),
                "    },",
            ]
    out += ["}", '"""Parameters that have another name in the native options of a filter."""', ""]
    out += ["NATIVE_VALUES: dict[str, dict[str, dict[str, int]]] = {"]
    for struct in structs.values():
        chosen = [p for p in _all(struct) if p.choices and p.c_names]
        if struct.filter and chosen:
            out += [
                f'    "{struct.filter}": {{',
                *(f'        "{p.name}": {_numbers(p)},' for p in chosen),
                "    },",
            ]
    out += ["}", '"""Numbers of choices in the native options of a filter that are numbers alone."""', ""]
    return "\n".join(out)


def _named(structs: dict[str, Struct]) -> list[Struct]:
    """Structs with a Python class, after the tables that they have and the structs that they extend."""
    done: dict[str, Struct] = {}

    classes = [struct for struct in structs.values() if struct.python]

    def add(struct: Struct) -> None:
        for part in struct.parts:
            if part.table:
                add(part.struct)
        if (base := _base(struct, classes)) is not None:
            add(base)
        if struct.python:
            done.setdefault(struct.name, struct)

    for struct in structs.values():
        add(struct)
    return list(done.values())


def _base(struct: Struct, others: Iterable[Struct]) -> Struct | None:
    """The largest other struct all of whose parameters this one has, with the same limits and defaults."""
    own = set(_fields(struct))
    found = [other for other in others if set(_fields(other)) < own and _fields(other)]
    return max(found, key=lambda other: len(_fields(other)), default=None)


def _fields(struct: Struct) -> list[str]:
    return [f"    {p.name}: {_annotation(p)} = {_default(p)}" for p in struct.public()]


def _all(struct: Struct) -> list[Parameter]:
    return [*struct.parameters, *(p for part in struct.parts if part.member for p in part.struct.parameters)]


def _numbers(p: Parameter) -> dict[str, int]:
    numbers = map(int, p.c_names) if p.c_type == "int" else range(len(p.c_names))
    return dict(zip(p.native_choices, numbers, strict=True))


def _class(struct: Struct) -> str:
    return f"{struct.python}Parameters"


def _struct(struct: Struct, base: Struct | None) -> list[str]:
    name = "Options" if base is None else _class(base)
    out = ["", f"class {_class(struct)}({name}, frozen=True, kw_only=True):", f'    """{struct.doc}"""', ""]
    inherited = [] if base is None else _fields(base)
    out += [field for field in _fields(struct) if field not in inherited]
    for part in struct.parts:
        if part.table:
            out += [f"    {part.name}: {_class(part.struct)} = {_class(part.struct)}()"]
    return [*(out[:-1] if out[-1] == "" else out), ""]


def _annotation(p: Parameter) -> str:
    limits = [
        f"{key}={value!r}"
        for key, value in (
            ("ge", p.min),
            ("gt", p.above),
            ("le", p.max),
            ("lt", p.below),
            ("multiple_of", p.multiple_of),
        )
        if value is not None
    ]
    text = p.text + (f"; default: {p.optional}" if p.optional else "")
    if p.choices:
        text += "; " + "; ".join(f"{name}: {doc}" for name, doc in p.choices.items())
    meta = ", ".join([*limits, f"description={text!r}"])
    return f"Annotated[{_type(p)}, Meta({meta})]{' | None' if p.optional else ''}"


def _type(p: Parameter) -> str:
    if p.choices:
        return f"Literal[{', '.join(map(repr, p.choices))}]"
    if isinstance(p.default, list):
        return f"tuple[{', '.join(['float'] * len(p.default))}]"
    return type(p.default).__name__


def _default(p: Parameter) -> str:
    if p.optional:
        return "None"
    if isinstance(p.default, float) and math.isinf(p.default):
        return 'float("inf")'
    return repr(tuple(p.default)) if isinstance(p.default, list) else repr(p.default)


def _parts(struct: Struct) -> list[str]:
    def names(parameters: Iterable[Parameter]) -> tuple[str, ...]:
        return tuple(p.name for p in parameters if p.native)

    own = names(struct.parameters) + tuple(
        name for part in struct.parts if part.flat for name in names(part.struct.parameters)
    )
    made = [f'NativeStruct("{struct.cpp}", "", {own!r})']
    made += [
        f'NativeStruct("{part.struct.cpp}", "{part.name}", {names(part.struct.parameters)!r})'
        for part in struct.parts
        if not part.flat and not part.table
    ]
    return made
