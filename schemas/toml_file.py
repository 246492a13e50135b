"""Reading of TOML files that users write, with one-line error messages."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from alula.schemas.artifacts.manifest import VERSION, parse_version
from alula.schemas.decode import MOST_TOML, MalformedError, convert, decode_toml
from alula.schemas.errors import InputError, UsageError, VersionError
from alula.schemas.files import check_no_stream, reading

Table = TypeVar("Table", bound=msgspec.Struct)


def read_toml(path: Path, table: type[Table], schema: str) -> Table:
    """Read a file into a struct.

    Args:
        schema: id of the file's schema, for messages.

    Raises:
        InputError: the file cannot be read, is empty or is not TOML.
        VersionError: it was written for a later major version.
        UsageError: a key is unknown, missing, of the wrong type or out of range; the message has its path.
    """
    tree = read_tree(path)
    # The version is checked first, because later versions may have keys that are unknown here.
    version = str(tree.get("version", VERSION))
    try:
        major, _ = parse_version(version)
    except ValueError as error:
        raise UsageError(f"{path}: `$.version`: {error}") from error
    if major > parse_version(VERSION)[0]:
        raise VersionError(f"{path}: {schema} version {version} is newer than {VERSION}; update alula")
    try:
        return convert(tree, table)
    except MalformedError as error:
        raise UsageError(f"{path}: {error}") from error


def read_tree(path: Path) -> dict[str, Any]:
    """Read a file into plain values.

    Raises:
        InputError: the file cannot be read, is empty or is not TOML.
    """
    try:
        return _decoded(path)
    except MalformedError as error:
        raise InputError(f"{path}: is not TOML ({error})") from error


def _decoded(path: Path) -> dict[str, Any]:
    """Plain values of a file; a file that is not TOML raises MalformedError."""
    with reading(path):
        check_no_stream(path)
        with path.open("rb") as file:
            raw = file.read(MOST_TOML + 1)
    if not raw.strip():
        raise InputError(f"{path}: is empty")
    return decode_toml(raw)


def first_beyond(value: Any, path: str, limit: float) -> str | None:
    """Path of the first number with an absolute value that is not below a limit; None without one.

    Args:
        path: path of `value` itself.
        limit: the limit; with infinity only numbers that are not finite are found.
    """
    if isinstance(value, float):
        return None if abs(value) < limit else f"`{path}`"
    items: list[tuple[str, Any]] = []
    if isinstance(value, dict):
        items = [(f"{path}.{key}", child) for key, child in value.items()]
    elif isinstance(value, list | tuple):
        items = [(f"{path}[{i}]", child) for i, child in enumerate(value)]
    found = (first_beyond(child, where, limit) for where, child in items)
    return next((where for where in found if where), None)


_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")
_ESCAPES = {"\b": "\\b", "\t": "\\t", "\n": "\\n", "\f": "\\f", "\r": "\\r", '"': '\\"', "\\": "\\\\"}


def toml_key(key: str) -> str:
    """Write a key, quoted where TOML needs it.

    Args:
        key: one part of a key.
    """
    return key if _BARE_KEY.fullmatch(key) else toml_value(key)


def toml_value(value: Any) -> str:
    """Write a value on one line; a reader gets the same value, bit by bit.

    Args:
        value: a text, a number, a boolean, or lists and dictionaries of them.
    """
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, str):
        return f'"{"".join(_escaped(letter) for letter in value)}"'
    if isinstance(value, dict):
        items = ", ".join(f"{toml_key(key)} = {toml_value(item)}" for key, item in value.items())
        return f"{{ {items} }}" if items else "{}"
    return f"[{', '.join(map(toml_value, value))}]"


def _escaped(letter: str) -> str:
    if letter in _ESCAPES:
        return _ESCAPES[letter]
    return f"\\u{ord(letter):04X}" if ord(letter) < 32 or ord(letter) == 127 else letter
