"""How a real flight went: the states of its supervisor, and what was said."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from alula.schemas.flights import Course
from alula.stages.reporting.material import Run

Parts = tuple[str, str, tuple[str, ...], tuple[tuple[Any, ...], ...], str]

_LEVELS = {3: "warning", 4: "error", 5: "fatal"}  # of `foxglove.Log`


@dataclass(frozen=True, slots=True)
class Spell:
    """A state of the supervisor, from a time to another [s]."""

    state: str
    begin_s: float
    end_s: float

    def __str__(self) -> str:
        return f"{self.state} {self.begin_s:.2f} to {self.end_s:.2f} s"


def spells(course: Course | None) -> tuple[Spell, ...]:
    """The states one after another; steps that stay in a state do not end it, the last one takes no time."""
    found: list[Spell] = []
    for step in course.steps if course is not None else ():
        if found and found[-1].state == step.state:
            continue
        if found:
            found[-1] = Spell(found[-1].state, found[-1].begin_s, step.time_s)
        found.append(Spell(step.state, step.time_s, step.time_s))
    if course is not None and found:
        found[-1] = Spell(found[-1].state, found[-1].begin_s, max(found[-1].begin_s, course.end_s))
    return tuple(spell for spell in found if spell.end_s > spell.begin_s)


def course_rows(summary: Mapping[str, Any]) -> dict[str, Any]:
    """What only a real flight's summary has; empty for others."""
    if "ended_by" not in summary:
        return {}
    return {
        "ended by": summary["ended_by"],
        "holds": summary.get("holds"),
        "largest distance from the plan [m]": summary.get("max_tracking_error_m"),
    }


def course_tables(runs: Sequence[Run]) -> list[Parts]:
    """Two tables of each real flight: its supervisor's steps, and what was said; as `Table` takes them."""
    found: list[Parts] = []
    for number, run in enumerate(runs, 1):
        if (course := run.course) is None:
            continue
        end = f"-{number}" if len(runs) > 1 else ""
        steps = tuple((round(step.time_s, 3), step.event, step.state, step.action) for step in course.steps)
        said = tuple(
            (round(line.time_s, 3), _LEVELS.get(line.level, ""), line.words) for line in course.lines
        )
        note = f"The supervisor was last heard at {course.end_s:.2f} s."
        columns = ("time [s]", "event", "state after it", "order")
        found.append((f"course{end}", f"Course of {run.label}", columns, steps, note))
        found.append((f"said{end}", f"What was said in {run.label}", ("time [s]", "level", "line"), said, ""))
    return found
