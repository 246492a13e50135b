"""Content that a browser without a GPU draws fast: fewer Gaussians and fewer line segments."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.stages.show.drawing.content import Content, Lines, Part

LIGHT_GAUSSIANS = 10_000
LIGHT_SEGMENTS = 4_000


def lightened(content: Content, make: Callable[[int], Content]) -> Content:
    """Return the content with at most `LIGHT_GAUSSIANS` and about `LIGHT_SEGMENTS`; itself when it is so.

    Each line of some pixels' width costs a processor as much as two Gaussians. Of edges the longest stay, of
    paths evenly spaced points; lines that are hidden at first stay as they are.

    Args:
        make: the same content with at most so many Gaussians.
    """
    found = make(LIGHT_GAUSSIANS) if content.gaussians > LIGHT_GAUSSIANS else content
    drawn = [part for part in found.parts if isinstance(part, Lines) and part.visible]
    total = sum(len(part.segments) for part in drawn)
    if total <= LIGHT_SEGMENTS:
        return found
    fraction = LIGHT_SEGMENTS / total
    return replace(found, parts=tuple(_lighter(part, fraction) for part in found.parts))


def _lighter(part: Part, fraction: float) -> Part:
    if not isinstance(part, Lines) or not part.visible or isinstance(part.color, np.ndarray):
        return part
    return replace(part, segments=fewer(part.segments, fraction))


def fewer(segments: FloatArray, fraction: float) -> FloatArray:
    """Keep about a fraction of line segments.

    Args:
        segments: shape (n, 2, 3) [m]; those of a path follow one another.
        fraction: of them to keep.

    Returns:
        Shape (m, 2, 3): of paths every so many points and both ends, of other segments the longest.
    """
    if not len(segments):
        return segments
    begins = np.r_[True, (segments[1:, 0] != segments[:-1, 1]).any(axis=1)]
    first = np.flatnonzero(begins)
    last = np.r_[first[1:], len(segments)] - 1
    if len(segments) < 3 * len(first):
        length = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1)
        kept = np.sort(np.argsort(-length, kind="stable")[: max(1, round(fraction * len(segments)))])
        return segments[kept]
    step = max(1, round(1 / fraction))
    place = np.arange(len(segments)) - np.repeat(first, last - first + 1)
    starts = np.flatnonzero(place % step == 0)
    ends = np.minimum(starts + step - 1, np.repeat(last, last - first + 1)[starts])
    found: FloatArray = np.stack([segments[starts, 0], segments[ends, 1]], axis=1)
    return found
