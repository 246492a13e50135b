"""The 3D view as a report gets it; `alula.stages.show.viewing.report` makes it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class View:
    """A page that shows the scene in 3D, and a note on what it leaves out."""

    html: str
    note: str
