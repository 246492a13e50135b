"""What the generated parameter structs are made of, and questions about them."""

from __future__ import annotations

import operator
import types
from collections.abc import Mapping
from functools import cache
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

import msgspec


class Options(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Parameters of a filter: unknown keys are refused."""


class NativeStruct(NamedTuple):
    """A native struct that takes some of a filter's parameters.

    Attributes:
        argument: the field of the filter's own options that takes it; empty for these options themselves.
    """

    native: str
    argument: str
    names: tuple[str, ...]


class Entry(NamedTuple):
    """A parameter as its struct declares it.

    Attributes:
        type: its Python type without None.
        default: None when something else stands for an absent value.
        meta: limits and documentation.
    """

    type: Any
    default: Any
    meta: msgspec.Meta

    @property
    def choices(self) -> tuple[str, ...]:
        """The values that an enumeration has; empty for all other types."""
        return get_args(self.type) if get_origin(self.type) is Literal else ()

    @property
    def help(self) -> str:
        """The documentation as a sentence."""
        text = self.meta.description or ""
        return f"{text[:1].upper()}{text[1:]}."


@cache
def entries(options: type[Options]) -> Mapping[str, Entry]:
    """The parameters of a struct by name, without nested tables."""
    hints = get_type_hints(options, include_extras=True)
    found = {}
    for item in msgspec.structs.fields(options):
        hint = hints[item.name]
        if get_origin(hint) in (Union, types.UnionType):
            hint = next(part for part in get_args(hint) if part is not type(None))
        if get_origin(hint) is Annotated:
            kind, meta = get_args(hint)
            found[item.name] = Entry(kind, item.default, meta)
    return found


def defaults(options: type[Options]) -> dict[str, Any]:
    """The defaults of all parameters of a struct, vectors as lists."""
    values = ((name, entry.default) for name, entry in entries(options).items())
    return {name: list(value) if isinstance(value, tuple) else value for name, value in values}


def beyond(meta: msgspec.Meta, value: float) -> str | None:
    """Why a number is not within limits, as the end of a sentence after its name; None where it is."""
    if meta.ge is not None and meta.le is not None:
        words, is_good = f"between {meta.ge:.12g} and {meta.le:.12g}", meta.ge <= value <= meta.le
    else:
        limits = [
            (f"{word} {limit:.12g}", fits(value, limit))
            for word, limit, fits in (
                ("at least", meta.ge, operator.ge),
                ("above", meta.gt, operator.gt),
                ("at most", meta.le, operator.le),
                ("below", meta.lt, operator.lt),
            )
            if limit is not None
        ]
        words, is_good = " and ".join(text for text, _ in limits), all(good for _, good in limits)
    return None if is_good else f"must be {words}, not {value:.12g}"


def complaint(entry: Entry, value: Any) -> str | None:
    """Why a value cannot be a parameter's, as the end of a sentence after its name; None when it can.

    Args:
        value: any value of JSON or TOML; a whole number is a number, too.
    """
    if not _fits(entry, value):
        return f"must be {_wanted(entry)}, not {value!r}"
    return beyond(entry.meta, value) if entry.type in (int, float) else None


def _fits(entry: Entry, value: Any) -> bool:
    if entry.choices:
        return value in entry.choices
    if entry.type is bool or isinstance(value, bool):
        return entry.type is bool and isinstance(value, bool)
    if entry.type is float:
        return isinstance(value, int | float)
    if entry.type is int:
        return isinstance(value, int) and 0 <= value < 2**31
    numbers = isinstance(value, list | tuple) and all(
        isinstance(item, int | float) and not isinstance(item, bool) for item in value
    )
    return numbers and len(value) == len(get_args(entry.type))


def _wanted(entry: Entry) -> str:
    if entry.choices:
        return " or ".join(entry.choices)
    if get_origin(entry.type) is tuple:
        return f"{len(get_args(entry.type))} numbers"
    return {bool: "true or false", int: "a whole number from 0 to 2147483647"}.get(entry.type, "a number")
