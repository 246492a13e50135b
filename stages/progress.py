"""Progress of a stage with several parts."""

from __future__ import annotations

from alula.schemas.progress import Progress

WHOLE = 1000


def share(progress: Progress | None, begin: float, end: float) -> Progress | None:
    """Callback for one part of the work.

    It reports (done, WHOLE) to `progress`. A part whose total is not known yet, 0 or 1, counts as not begun.
    The reported value never decreases.

    Args:
        progress: of the whole work; None gives None.
        begin: fraction of the whole at which the part begins, 0 to 1.
        end: fraction of the whole at which it ends, 0 to 1.
    """
    if progress is None:
        return None
    reached = begin

    def report(done: int, total: int) -> None:
        nonlocal reached
        if total > 1:
            reached = max(reached, begin + (end - begin) * min(done / total, 1.0))
        progress(int(WHOLE * reached), WHOLE)

    return report
