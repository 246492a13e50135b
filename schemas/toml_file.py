"""TOML files that people write: one clear line for whatever is wrong with them."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

import msgspec

from alula.schemas.errors import InputError, UsageError, VersionError
from alula.schemas.manifest import VERSION, parse_version

Table = TypeVar("Table", bound=msgspec.Struct)


def has_key(path: Path, key: str) -> bool:
    """Whether a file is a TOML file with a key at its top."""
    try:
        return key in msgspec.toml.decode(path.read_bytes())
    except (OSError, msgspec.DecodeError, UnicodeDecodeError, ValueError):
        return False


def read_toml(path: Path, table: type[Table], schema: str) -> Table:
    """Read a file into a struct.

    Raises:
        InputError: the file cannot be read, is empty or is not TOML.
        VersionError: it was written for a later major version.
        UsageError: a key is unknown, missing, of the wrong type or out of range; the message has its path.
    """
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot read: {error.strerror or error}") from error
    if not raw.strip():
        raise InputError(f"{path}: is empty")
    try:
        # The version alone first: later versions may have keys that this one calls unknown.
        version = str(msgspec.toml.decode(raw).get("version", VERSION))
    except (msgspec.DecodeError, UnicodeDecodeError, ValueError) as error:
        raise InputError(f"{path}: is not TOML ({error})") from error
    try:
        major, _ = parse_version(version)
    except ValueError as error:
        raise UsageError(f"{path}: `$.version`: {error}") from error
    if major > parse_version(VERSION)[0]:
        raise VersionError(f"{path}: {schema} version {version} is newer than {VERSION}; update alula")
    try:
        return msgspec.toml.decode(raw, type=table)
    except msgspec.ValidationError as error:
        raise UsageError(f"{path}: {error}") from error
