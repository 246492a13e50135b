"""Progress of a function: a bar on a terminal, a line below the cell in a notebook, else nothing."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from alula.cli.shell.options import Common
from alula.cli.shell.progress import shown_progress
from alula.schemas.progress import Progress

_EVERY_S = 0.2  # between two pictures of a bar


@contextmanager
def shown(name: str) -> Iterator[Progress]:
    """Context with a progress callback (done, total) that shows how far a function is."""
    shell = _notebook()
    if shell is None:
        with shown_progress(Common(Path(name))) as progress:
            yield progress
        return
    from importlib import import_module

    display: Any = import_module("IPython.display")
    handle = display.display(display.HTML(f"{name} …"), display_id=True)
    last = [0.0]

    def update(done: int, total: int) -> None:
        now = time.monotonic()
        if handle is not None and now - last[0] >= _EVERY_S:
            last[0] = now
            bar = f"<progress max='{total}' value='{done}'></progress>" if total > 1 else "…"
            handle.update(display.HTML(f"{name} {bar}"))

    try:
        yield update
    finally:
        if handle is not None:
            handle.update(display.HTML(""))


def _notebook() -> Any:
    """The shell of IPython where it shows cells in a browser; None elsewhere."""
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    return shell if shell is not None and hasattr(shell, "kernel") else None
