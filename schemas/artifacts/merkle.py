"""Merkle tree: one hash for a list, in which no entry can be changed, removed or moved unnoticed."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence


def leaf(content: bytes) -> str:
    """Hash of one entry, in hexadecimal."""
    return hashlib.sha256(b"\x00" + content).hexdigest()


def root(leaves: Sequence[str]) -> str:
    """Root of a list of entries, in hexadecimal; of an empty list the hash of nothing.

    Entries and inner nodes are hashed with different first bytes. The left half of n entries has the largest
    power of two below n.

    Args:
        leaves: hashes of the entries, as `leaf` returns them.

    Source: RFC 6962, section 2.1.
    """
    if not leaves:
        return hashlib.sha256().hexdigest()
    if len(leaves) == 1:
        return leaves[0]
    half = 1 << (len(leaves) - 1).bit_length() - 1
    left, right = (bytes.fromhex(root(part)) for part in (leaves[:half], leaves[half:]))
    return hashlib.sha256(b"\x01" + left + right).hexdigest()
