"""Files with the key of a signature, as packets of MAVLink and indexes of tiles have one."""

from __future__ import annotations

from pathlib import Path

from alula.schemas.errors import InputError
from alula.schemas.files import read_small

KEY_BYTES = 32
_MOST_BYTES = 1000  # of a file, which may have spaces around the digits


def read_key(path: Path) -> bytes:
    """Read a key file, which holds only the key: 32 bytes, or 64 hexadecimal digits.

    Raises:
        InputError: the file cannot be read, or does not hold a key.
    """
    key = read_small(path, _MOST_BYTES)
    if len(key) != KEY_BYTES:
        try:
            key = bytes.fromhex(key.decode("ascii").strip())
        except ValueError:  # not ASCII, or no digits
            key = b""
    if len(key) != KEY_BYTES:
        raise InputError(f"{path}: a signing key is {KEY_BYTES} bytes, or {2 * KEY_BYTES} hexadecimal digits")
    return key
