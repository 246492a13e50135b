"""Pictures as files: PNG, and moving ones as WebP or GIF, each with its provenance."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.stages.reporting.page import comment
from alula.stages.show.viewing.film import Film

_LAST_MS = 1200  # the last frame stays so long before a moving picture begins again
_INK, _ACTS, _HALO = (40, 44, 52), (200, 95, 0), (255, 255, 255)
_FONT = 24  # rows of the picture per row of its words
_QUALITY = 72  # of moving pictures
_EMBEDDED_QUALITY = 80


def png(image: NDArray[np.uint8], line: str) -> bytes:
    """Encode a picture as PNG.

    Args:
        image: shape (rows, columns, 3).
        line: of provenance in ASCII, kept as its description.
    """
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    about = PngInfo()
    about.add_text("Description", line)
    out = io.BytesIO()
    Image.fromarray(image).save(out, format="PNG", optimize=True, pnginfo=about)
    return out.getvalue()


def still_webp(image: NDArray[np.uint8], most_bytes: int) -> bytes:
    """Encode a picture as WebP of limited size, in lower quality if it must be.

    Args:
        image: shape (rows, columns, 3).
        most_bytes: maximum size, which only the lowest quality may exceed.
    """
    from PIL import Image

    for quality in (_EMBEDDED_QUALITY, 60, 40, 20):
        out = io.BytesIO()
        Image.fromarray(image).save(out, format="WEBP", quality=quality, method=6)
        if len(out.getvalue()) <= most_bytes:
            break
    return out.getvalue()


def webp(film: Film, rate_hz: float, line: str) -> bytes:
    """Encode a moving picture as WebP.

    Args:
        line: of provenance, kept as a comment of its XMP data.
    """
    xmp = f'<x:xmpmeta xmlns:x="adobe:ns:meta/"><!-- {comment(line)} --></x:xmpmeta>'
    return _moving("WEBP", _labelled(film), rate_hz, 1, quality=_QUALITY, method=4, xmp=xmp.encode())


def gif(film: Film, rate_hz: float, line: str) -> bytes:
    """Encode a moving picture as GIF, in 256 colours that all frames share.

    Args:
        rate_hz: frames per second; GIF counts hundredths of a second.
        line: of provenance in ASCII, kept as its comment.
    """
    from PIL import Image

    frames = _labelled(film)
    some = frames[:: max(1, len(frames) // 8)]
    sample = Image.fromarray(np.concatenate([np.asarray(frame)[::3, ::3] for frame in some]))
    palette = sample.quantize(256, method=Image.Quantize.MEDIANCUT)
    flat = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    return _moving("GIF", flat, rate_hz, 10, optimize=False, comment=line.encode("ascii"))


def _moving(form: str, frames: list[Any], rate_hz: float, step_ms: int, **options: Any) -> bytes:
    """Encode frames; their times are multiples of a step, and the sum of these keeps to the rate."""
    ends = np.round(np.arange(len(frames) + 1) * 1000 / rate_hz / step_ms).astype(np.int64)
    found = (np.maximum(np.diff(ends), 1) * step_ms).tolist()
    times: Any = {"append_images": frames[1:], "duration": [*found[:-1], _LAST_MS], "loop": 0}
    out = io.BytesIO()
    frames[0].save(out, format=form, save_all=True, **times, **options)
    return out.getvalue()


def _labelled(film: Film) -> list[Any]:
    """Frames with their words in the lower left corner, orange where the filter acts."""
    from PIL import Image, ImageDraw, ImageFont

    found = []
    for frame, (words, acts) in zip(film.frames, film.words, strict=True):
        image = Image.fromarray(frame)
        if words:
            rows = frame.shape[0]
            size = max(rows / _FONT, 9.0)
            text = f"{words}   filter acts" if acts else words
            ImageDraw.Draw(image).text(
                (0.6 * size, rows - 1.7 * size),
                text,
                font=ImageFont.load_default(size),
                fill=_ACTS if acts else _INK,
                stroke_width=max(1, round(size / 10)),
                stroke_fill=_HALO,
            )
        found.append(image)
    return found
