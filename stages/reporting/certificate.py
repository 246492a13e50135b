"""Certificates of `verify` as a report reads them."""

from __future__ import annotations

from typing import Any, Literal

import msgspec

from alula.schemas.decode import decode_json
from alula.schemas.manifest import parse_version
from alula.stages.compression.verify import VERSION, Certificate


class _Stored(Certificate, frozen=True, kw_only=True):
    """A certificate with the kind and version that its file has."""

    schema: Literal["alula/certificate"]
    version: str = VERSION


def decode_certificate(raw: bytes) -> dict[str, Any]:
    """Decode and check a certificate.

    Args:
        raw: contents of the file.

    Returns:
        Its values by key, without its provenance.

    Raises:
        ValueError: it is not JSON, or a value is missing or of the wrong type, or of a later version.
    """
    stored = decode_json(raw, _Stored)
    if parse_version(stored.version)[0] > parse_version(VERSION)[0]:
        raise ValueError(f"version {stored.version} is newer than {VERSION}; update alula")
    if stored.covered != all(check.ok for check in stored.checks):
        raise ValueError("`covered` contradicts its checks")
    values: dict[str, Any] = msgspec.to_builtins(stored)
    return values
