"""Decoding of JSON and TOML that other programs or persons wrote: bounded in size and depth, safe in threads.

msgspec describes a type when it is used for the first time. It publishes the description before it is
complete, so two threads that use a type for the first time at once can crash the process. Here one lock
guards the making of every decoder, and a decoder describes its type completely when it is made.
"""

from __future__ import annotations

import difflib
import re
import threading
from collections.abc import Hashable
from functools import cache
from typing import Any, TypeVar, cast

import msgspec

T = TypeVar("T")

MOST_DEPTH = 64  # nested arrays and objects; the project's own files have less than ten
MOST_TEXT = 2**28  # [B] of JSON
MOST_VALUES = 2**21  # in JSON; one takes up to 100 bytes of memory, however few it has in the text
MOST_TOML = 2**18  # [B]
_MOST_KEY_PARTS = 16

_LOCK = threading.RLock()
_BLOCK = 2**20
# Possessive quantifiers never backtrack: the time is linear in the text.
_TOML_TEXT = re.compile(
    r'"""(?:[^\\]|\\.)*?(?:"{3,5}|\Z)|\'\'\'.*?(?:\'{3,5}|\Z)'
    r'|"(?:[^"\\\n]|\\.)*+"?|\'[^\'\n]*+\'?|#[^\n]*+',
    re.DOTALL,
)
_LONG_KEY = re.compile(rf"(?<![\w-])(?:[\w-]++[ \t]*+\.[ \t]*+){{{_MOST_KEY_PARTS}}}")


class MalformedError(ValueError):
    """Text that is not of the expected form; the message is one line without the name of the file."""


@cache
def _json_decoder(kind: Any) -> msgspec.json.Decoder[Any]:
    with _LOCK:
        return msgspec.json.Decoder(kind)


@cache
def _msgpack_decoder(kind: Any) -> msgspec.msgpack.Decoder[Any]:
    with _LOCK:
        return msgspec.msgpack.Decoder(kind)


def json_decoder(kind: type[T]) -> msgspec.json.Decoder[T]:
    """Decoder of many short messages of one type; its errors are those of msgspec, or a RecursionError."""
    decoder: msgspec.json.Decoder[T] = _json_decoder(cast(Hashable, kind))
    return decoder


def msgpack_decoder(kind: type[T]) -> msgspec.msgpack.Decoder[T]:
    """Decoder of MessagePack of one type; its errors are those of msgspec, or a RecursionError."""
    decoder: msgspec.msgpack.Decoder[T] = _msgpack_decoder(cast(Hashable, kind))
    return decoder


def decode_json(raw: bytes, kind: type[T], *, most_values: int = MOST_VALUES) -> T:
    """Decode JSON of one type.

    Args:
        raw: the text in UTF-8.
        most_values: text with more values is refused.

    Raises:
        MalformedError: the text is too long, too deep, not JSON, or of another type.
    """
    _check_extent(raw, most_values)
    try:
        return json_decoder(kind).decode(raw)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise MalformedError(str(error)) from error


def _check_extent(raw: bytes, most_values: int) -> None:
    if len(raw) > MOST_TEXT:
        raise MalformedError(f"{len(raw)} bytes of JSON, more than {MOST_TEXT}")
    if sum(map(raw.count, (b",", b"[", b"{"))) > most_values:
        raise MalformedError(f"JSON with more than {most_values} values")
    if json_depth(raw) > MOST_DEPTH:
        raise MalformedError(f"JSON with more than {MOST_DEPTH} levels")


def decode_plain_json(raw: bytes) -> Any:
    """Decode JSON as people write it, with NaN and Infinity, into plain values.

    Raises:
        MalformedError: the text is too long, has too many values, is too deep or is not JSON.
    """
    import json

    _check_extent(raw, MOST_VALUES)
    try:
        return json.loads(raw)
    except (ValueError, RecursionError) as error:
        raise MalformedError(str(error).partition("; use sys.")[0]) from error


def json_depth(raw: bytes) -> int:
    """Maximum number of open brackets at any place of JSON; brackets in strings do not count."""
    import numpy as np

    bare = np.frombuffer(raw.replace(b"\\\\", b"").replace(b'\\"', b""), np.uint8)
    deepest = depth = quotes = 0
    for start in range(0, len(bare), _BLOCK):
        block = bare[start : start + _BLOCK]
        outside = (quotes + np.cumsum(block == ord('"'), dtype=np.int64)) % 2 == 0
        opens = ((block == ord("[")) | (block == ord("{"))) & outside
        closes = ((block == ord("]")) | (block == ord("}"))) & outside
        open_here = depth + np.cumsum(opens.astype(np.int8) - closes, dtype=np.int64)
        deepest, depth = max(deepest, int(open_here.max())), int(open_here[-1])
        quotes += int(np.count_nonzero(block == ord('"')))
    return deepest


def decode_toml(raw: bytes) -> dict[str, Any]:
    """Decode TOML into plain values.

    The parser's time and memory are quadratic in the parts of a dotted key, and it recurses into arrays, so
    both are bounded before it runs.

    Raises:
        MalformedError: the text is too long, has keys of too many parts, is too deep or is not TOML.
    """
    if len(raw) > MOST_TOML:
        raise MalformedError(f"{len(raw)} bytes of TOML, more than {MOST_TOML}")
    try:
        bare = _TOML_TEXT.sub("s", raw.decode())
        if (long := _LONG_KEY.search(bare)) is not None:
            line = bare.count("\n", 0, long.start()) + 1
            raise MalformedError(f"a key of more than {_MOST_KEY_PARTS} parts near line {line}")
        if json_depth(bare.encode()) > MOST_DEPTH:
            raise MalformedError(f"TOML with more than {MOST_DEPTH} levels")
        tree: dict[str, Any] = msgspec.toml.decode(raw)
    except MalformedError:
        raise
    except (msgspec.DecodeError, UnicodeDecodeError, ValueError, RecursionError) as error:
        raise MalformedError(str(error).partition("; use sys.")[0]) from error
    _check_tree(tree)
    return tree


def _check_tree(tree: dict[str, Any]) -> None:
    """Refuse values that JSON or the schemas of the project cannot hold; without recursion."""
    level: list[Any] = [tree]
    for _ in range(MOST_DEPTH):
        inner: list[Any] = []
        for value in level:
            if isinstance(value, dict):
                inner.extend(value.values())
            elif isinstance(value, list):
                inner.extend(value)
            elif isinstance(value, int) and not -(2**63) <= value < 2**63:
                raise MalformedError("an integer has more than 64 bits")
            elif not isinstance(value, str | int | float):
                raise MalformedError(f"a {type(value).__name__}, which no key takes")
        if not inner:
            return
        level = inner
    raise MalformedError(f"TOML with more than {MOST_DEPTH} levels")


def convert(tree: Any, kind: type[T]) -> T:
    """Convert plain values to a type.

    Raises:
        MalformedError: a value is of another type or out of range; the message has its path.
    """
    with _LOCK:
        try:
            return msgspec.convert(tree, kind)
        except msgspec.ValidationError as error:
            raise MalformedError(f"{error}{_nearest(str(error), kind)}") from error


_UNKNOWN = re.compile(r"Object contains unknown field `([^`]*)`(?: - at `\$(.*)`)?$")


def _nearest(message: str, kind: Any) -> str:
    """Name of the known field that an unknown one most resembles, in words; "" without one."""
    found = _UNKNOWN.match(message)
    if found is None:
        return ""
    at = [msgspec.inspect.type_info(kind)]
    for part in re.findall(r"\.([^.\[]+)|\[", found[2] or ""):
        at = [inner for one in at for inner in _inside(one, part)]
    names = [field.encode_name for one in at for field in getattr(one, "fields", ())]
    close = [name for name in names if name.startswith(f"{found[1]}_")]
    close += difflib.get_close_matches(found[1], names, 1)
    return f"; did you mean `{close[0]}`?" if close else ""


def _inside(kind: Any, part: str) -> list[Any]:
    """Types of a field, or without its name those of the items of a list."""
    if part:
        found = [one.type for one in getattr(kind, "fields", ()) if one.encode_name == part]
    else:
        found = [kind.item_type] if hasattr(kind, "item_type") else []
    found = [getattr(one, "type", one) for one in found]  # without its description
    return [one for each in found for one in getattr(each, "types", (each,))]
