"""Progress of a stage that works in several parts."""

from __future__ import annotations

from alula.schemas.progress import Progress

WHOLE = 1000


def share(progress: Progress | None, begin: float, end: float) -> Progress | None:
    """A callback for one part of the work, from `begin` to `end` of the whole, 0 to 1.

    It reports (done, WHOLE) to `progress`; parts whose total is not known yet, 0 or 1, stand at their
    beginning. What it reports never decreases.
    """
    if progress is None:
        return None
    most = begin

    def report(done: int, total: int) -> None:
        nonlocal most
        if total > 1:
            most = max(most, begin + (end - begin) * min(done / total, 1.0))
        progress(int(WHOLE * most), WHOLE)

    return report
