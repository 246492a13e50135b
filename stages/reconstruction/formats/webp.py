"""Lossless WebP images: reading of their size without decoding, and decoding of their stored pixels."""

from __future__ import annotations

import io
import struct

import numpy as np
from numpy.typing import NDArray

from alula.schemas.errors import ArtifactError


def webp_size(raw: bytes | memoryview) -> tuple[int, int]:
    """Read width and height of a still, lossless image from its header alone.

    Raises:
        ArtifactError: the bytes are not such an image.
    """
    if len(raw) < 12 or raw[:4] != b"RIFF" or raw[8:12] != b"WEBP":
        raise ArtifactError("is no WebP image")
    at = 12
    while at + 8 <= len(raw):
        name, size = bytes(raw[at : at + 4]), struct.unpack_from("<I", raw, at + 4)[0]
        if name == b"VP8L":
            if size < 5 or at + 8 + size > len(raw):
                raise ArtifactError(f"is truncated: {len(raw)} bytes")
            signature, bits = struct.unpack_from("<BI", raw, at + 8)
            if signature != 0x2F:
                raise ArtifactError("is a damaged WebP image")
            return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
        if name in (b"VP8 ", b"ALPH", b"ANIM", b"ANMF"):
            raise ArtifactError(f"is not a still, lossless WebP image (it has a chunk {name.decode()!r})")
        at += 8 + size + size % 2
    raise ArtifactError("is a WebP image without data")


def decode_webp(raw: bytes | memoryview) -> NDArray[np.uint8]:
    """Decode the pixels of a still, lossless image: red, green, blue, alpha, rows from the top.

    Alpha is not premultiplied and no colour management applies; a missing alpha becomes 255. Decoding takes
    about 12 bytes per pixel of `webp_size`, which the caller limits.

    Returns:
        Shape (height * width, 4).

    Raises:
        ArtifactError: it is no such image, or damaged.
    """
    from PIL.WebPImagePlugin import WebPImageFile  # Image.open would warn of sizes that are legal here

    width, height = webp_size(raw)
    try:
        with WebPImageFile(io.BytesIO(raw)) as image:
            mode, size, data = image.mode, image.size, image.tobytes()
    except (OSError, SyntaxError, ValueError, EOFError, RuntimeError, MemoryError) as error:
        raise ArtifactError("is a damaged WebP image") from error
    bands = {"RGB": 3, "RGBA": 4}.get(mode, 0)
    if size != (width, height) or len(data) != width * height * bands:
        raise ArtifactError("is a damaged WebP image")
    pixels = np.frombuffer(data, np.uint8).reshape(-1, bands)
    if bands == 4:
        return pixels
    opaque = np.full((len(pixels), 4), 255, np.uint8)
    opaque[:, :3] = pixels
    return opaque
