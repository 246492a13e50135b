"""Addresses of the web as inputs: their form, and the options that limit downloads."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any, TypeVar
from urllib.parse import unquote, urlsplit

import click

from alula.cli.shell import grouped
from alula.schemas.errors import UsageError

F = TypeVar("F", bound=Callable[..., Any])

LOOPBACK = ("127.0.0.1", "::1")
_GROUP = "Downloads"
_UNITS = {"": 1, "k": 10**3, "M": 10**6, "G": 10**9, "Ki": 2**10, "Mi": 2**20, "Gi": 2**30}


def is_address(text: str) -> bool:
    """Test whether an argument is an address and not the name of a file."""
    return re.match(r"(?i)https?://", text) is not None


def is_allowed(text: str, *, from_loopback: bool = True) -> bool:
    """Test whether an address may be read: https, and http of this machine, by its number.

    Args:
        from_loopback: allow the latter.
    """
    parts = urlsplit(text)
    return parts.scheme == "https" or (
        from_loopback and parts.scheme == "http" and parts.hostname in LOOPBACK
    )


@dataclass(frozen=True, slots=True)
class Address:
    """Address of a file, checked; as text without user, password, query and fragment, which may be secret."""

    text: str

    def __post_init__(self) -> None:
        """Check the address.

        Raises:
            UsageError: it is not valid, or of a scheme that is not allowed.
        """
        if not re.fullmatch(r"[^\x00-\x20\x7f]+", self.text):
            raise UsageError("the address has a blank or a control character")
        try:
            parts = urlsplit(self.text)
            has_place = bool(parts.hostname) and (parts.port is None or parts.port > 0)
        except ValueError:
            has_place = False
        if not has_place:
            raise UsageError("the address is not valid; write https://host/path")
        if not is_allowed(self.text):
            raise UsageError(f"{self}: http is not safe against changes on the way; use https")

    def __str__(self) -> str:
        parts = urlsplit(self.text)
        host = f"[{parts.hostname}]" if ":" in str(parts.hostname) else parts.hostname
        port = "" if parts.port is None else f":{parts.port}"
        return f"{parts.scheme}://{host}{port}{parts.path}"

    @property
    def name(self) -> str:
        """Name of the file, for its suffix."""
        name = PurePosixPath(unquote(urlsplit(self.text).path)).name
        return name if re.fullmatch(r"\w[\w .()+-]{0,99}", name) else "download"


class ByteCount(click.ParamType):  # type: ignore[type-arg, unused-ignore]
    """A number of bytes: 500000, 20MB, 2GB, 1GiB."""

    name = "size"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """Parse the number and its unit."""
        if isinstance(value, int):
            return value
        found = re.fullmatch(r"([0-9]{1,15}(?:\.[0-9]{1,9})?) ?(k|M|G|Ki|Mi|Gi|)B?", value)
        if found is None or (count := round(float(found[1]) * _UNITS[found[2]])) < 1:
            self.fail(f"{value!r} is no size; write bytes, or a number with kB, MB, GB or GiB", param, ctx)
        return count


@dataclass(frozen=True, slots=True)
class Limits:
    """What a download must keep to.

    Attributes:
        most_bytes: maximum size.
        sha256: hash of each file, in their order; empty for any.
    """

    most_bytes: int
    sha256: tuple[str, ...]

    def for_each(self, count: int) -> tuple[str, ...]:
        """A hash for each download; empty for any.

        Raises:
            UsageError: the number of hashes is another.
        """
        if self.sha256 and len(self.sha256) != count:
            raise UsageError(
                f"--sha256 is for downloads, one for each: {len(self.sha256)} of them, "
                f"but {count} input{'' if count == 1 else 's'} of https:"
            )
        return self.sha256 or ("",) * count


def _hashes(_context: Any, _parameter: Any, values: tuple[str, ...]) -> tuple[str, ...]:
    for value in values:
        if not re.fullmatch(r"[0-9a-fA-F]{64}", value):
            raise click.BadParameter(f"{value!r} is no SHA-256: 64 hexadecimal digits")
    return tuple(value.lower() for value in values)


def limited(function: F) -> F:
    """Decorator that adds the options of downloads; the function gets them as `limits`."""

    def collect(*args: Any, **kwargs: Any) -> Any:
        limits = Limits(kwargs.pop("max_download"), kwargs.pop("sha256"))
        return function(*args, limits=limits, **kwargs)

    collect.__name__, collect.__doc__ = function.__name__, function.__doc__
    collect.__dict__.update(function.__dict__)
    made: Any = collect
    for option in (
        grouped.option(
            *("--sha256", "sha256"),
            group=_GROUP,
            multiple=True,
            metavar="HEX",
            callback=_hashes,
            help="Refuse a download of other bytes; of several, one for each in their order.",
        ),
        grouped.option(
            "--max-download",
            group=_GROUP,
            type=ByteCount(),
            metavar="SIZE",
            default="2GB",
            show_default=True,
            help="Maximum size of a download.",
        ),
    ):
        made = option(made)
    found: F = made
    return found
