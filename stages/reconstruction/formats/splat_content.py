"""Recognition of a `.splat` file by its content: the format has no magic number."""

from __future__ import annotations

import numpy as np

from alula.stages.reconstruction.formats.source import Source
from alula.stages.reconstruction.formats.splat import LEAST, QUATERNION_LOSS, RECORD, has_plausible_size

_FIRST, _SPREAD = 128, 128  # sampled records: the first ones, and as many all over the file
_PLAUSIBLE = 0.95  # minimum fraction of them; trained scenes have a few broken rows
_POSITIVE = 0.9  # minimum fraction of rows without a negative scale
_DISTINCT = 0.5  # minimum fraction of rows with a position of their own


def is_splat(source: Source) -> bool:
    """Test whether a file is a `.splat` file, by its suffix or by its content.

    By the content it is one if it has whole records, at least `LEAST`, and 95 % of a sample of at most 256
    are plausible: position and scale are finite, neither huge nor tiny, some scale is not 0, and the
    quaternion has the length 1 within the error of its bytes. Of random records one in 80,000 is plausible,
    so the probability that eight of them pass is below 1e-38. Text, and positions or rows that repeat, are
    refused for themselves. A file with quaternions that are not normalised is not recognised.
    """
    if source.is_folder:
        return False
    return source.suffix == ".splat" or has_plausible_records(source.data)


def has_plausible_records(buffer: memoryview) -> bool:
    """Test the content, as `is_splat` says."""
    count, rest = divmod(len(buffer), RECORD.itemsize)
    if rest or count < LEAST:
        return False
    spread = np.linspace(0, count - 1, _SPREAD).astype(np.int64)
    sampled = np.unique(np.concatenate([np.arange(min(count, _FIRST)), spread]))
    rows = np.frombuffer(buffer, RECORD)[sampled]
    if (rows.view(np.uint8) < 0x80).all():  # text in ASCII
        return False
    if len(np.unique(rows["mean"].view(np.uint32).reshape(-1, 3), axis=0)) < _DISTINCT * len(rows):
        return False
    length = np.linalg.norm(rows["quat"] / 127.5 - 1.0, axis=1)
    # Some writers have a factor of 256/255.
    plausible = has_plausible_size(rows) & (np.abs(length - 1.0) <= QUATERNION_LOSS + 1 / 255)
    positive = (rows["scale"] >= 0).all(axis=1)
    return bool(plausible.mean() >= _PLAUSIBLE and positive.mean() >= _POSITIVE)
