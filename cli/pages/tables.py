"""Markdown tables of the fields of JSON Schemas."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from inspect import cleandoc
from typing import Any

Schema = Mapping[str, Any]

_SECTION = re.compile(r"^Attributes:\n", re.MULTILINE)
_ATTRIBUTE = re.compile(r"^ {4}(\w+(?:, \w+)*): (.*(?:\n {8,}\S.*)*)", re.MULTILINE)
_NAMES = {"string": "text", "boolean": "true or false", "integer": "whole number", None: "anything"}
_LIMITS = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A Markdown table; line breaks and bars of the cells are made harmless.

    Args:
        rows: cells, as Markdown.
    """
    names = list(head)
    lines = [names, ["---"] * len(names), *rows]
    return "".join(f"| {' | '.join(map(cell, line))} |\n" for line in lines)


def cell(text: str) -> str:
    """A text as the content of a cell."""
    return re.sub(r"(?<!\\)\|", r"\\|", " ".join(text.split()))


def code(text: str) -> str:
    """A text as code."""
    return f"`{text}`" if text else ""


def summary_and_attributes(docstring: str) -> tuple[str, dict[str, str]]:
    """A docstring without its section on attributes, and the meaning of each attribute."""
    head, *tail = _SECTION.split(cleandoc(docstring), maxsplit=1)
    found = _ATTRIBUTE.finditer(tail[0] if tail else "")
    meanings = {name: " ".join(match[2].split()) for match in found for name in match[1].split(", ")}
    return head.strip(), meanings


def structs(schema: Schema, level: int = 2, more: Mapping[str, Mapping[str, str]] | None = None) -> str:
    """Every struct of a JSON Schema: what it is, and its fields; the outermost first.

    Args:
        schema: as `msgspec.json.schema` makes it: a reference and `$defs`.
        more: meanings of fields by the names of struct and field, where the schema has none.
    """
    definitions = schema["$defs"]
    order: list[str] = []
    waiting = [_name(schema)]
    while waiting:
        name = waiting.pop(0)
        if name not in order:
            order.append(name)
            waiting += _references(definitions[name].get("properties", {}))
    links = {name: f"#{name.lower()}" for name in order}
    return "\n".join(
        _struct(name, definitions[name], level, links, (more or {}).get(name, {})) for name in order
    )


def _struct(name: str, schema: Schema, level: int, links: Mapping[str, str], more: Mapping[str, str]) -> str:
    text, own = summary_and_attributes(schema.get("description", ""))
    meanings = {**more, **own}
    required = set(schema.get("required", ()))
    rows = [
        (
            code(key),
            type_text(value, links),
            "required" if key in required else _default(value),
            value.get("description") or meanings.get(key, ""),
        )
        for key, value in schema.get("properties", {}).items()
    ]
    fields = table(("key", "type", "default", "meaning"), rows) if rows else ""
    return f"{'#' * level} {name}\n\n{text}\n\n{fields}"


def type_text(schema: Schema, links: Mapping[str, str]) -> str:
    """The type of a value in words, with its limits.

    Args:
        links: where structs are explained, by their names.
    """
    if "$ref" in schema:
        name = _name(schema)
        return f"[{name}]({links[name]})" if name in links else name
    if "anyOf" in schema:
        return " or ".join(dict.fromkeys(type_text(part, links) for part in schema["anyOf"]))
    if "allOf" in schema:
        return " and ".join(type_text(part, links) for part in schema["allOf"])
    if "const" in schema:
        return code(str(schema["const"]))
    if "enum" in schema:
        return ", ".join(code(str(value)) for value in schema["enum"])
    kind = schema.get("type")
    if kind == "array":
        return _array(schema, links)
    if kind == "object":
        values = schema.get("additionalProperties")
        return f"table of {type_text(values, links)}" if isinstance(values, dict) and values else "table"
    limits = [f"{sign} {schema[key]:g}" for key, sign in _LIMITS.items() if key in schema]
    return ", ".join([_NAMES.get(kind, str(kind)), *limits])


def _array(schema: Schema, links: Mapping[str, str]) -> str:
    if "prefixItems" in schema:
        parts = [type_text(part, links) for part in schema["prefixItems"]]
        return f"{len(parts)} × {parts[0]}" if len(set(parts)) == 1 else f"list of {'; '.join(parts)}"
    items = type_text(schema.get("items") or {}, links)
    low, high = schema.get("minItems"), schema.get("maxItems")
    return f"{low} × {items}" if low and low == high else f"list of {items}"


def _default(schema: Schema) -> str:
    value = schema.get("default")
    if value is None or value == "":
        return ""
    if isinstance(value, bool):
        return code(str(value).lower())
    if isinstance(value, float):
        return code(f"{value:.12g}")
    return code(str(value))


def _name(schema: Schema) -> str:
    return str(schema["$ref"]).rpartition("/")[2]


def _references(value: Any) -> list[str]:
    """Names of the structs that a part of a schema refers to, in order."""
    if isinstance(value, dict):
        own = [_name(value)] if isinstance(value.get("$ref"), str) else []
        return own + [name for part in value.values() for name in _references(part)]
    if isinstance(value, list):
        return [name for part in value for name in _references(part)]
    return []
