"""The view in a report: scene, hulls, plan and flights as one self-contained page for a frame."""

from __future__ import annotations

from alula.stages.reporting.flight_curves import MOST_RUNS, closest_flight
from alula.stages.reporting.material import Material, flew_through
from alula.stages.reporting.page import View
from alula.stages.show.viewing.compose import Shown, composer
from alula.stages.show.viewing.page import within

_MOST_BYTES = 6_000_000  # the rest of a report takes up to two million
_MOST_PLAYED_S = 60.0


def view(material: Material) -> View | None:
    """Make the 3D view; None when there is nothing to show. The same material gives the same text.

    Those flights are played first that the report has curves of, then the worst ones. Hulls are the cover's,
    also for runs that flew through another one, whose clearance to it is not shown.
    """
    runs = [run for run in material.runs if run.flights]
    if not (runs or material.scene or material.cover or material.plan):
        return None
    shown = Shown(
        title=material.title,
        runs=runs,
        elsewhere=frozenset(run.label for run in runs if flew_through(run, material) is False),
        scenes=[] if material.scene is None else [("scene", material.scene)],
        trees=material.trees,
        covers=[] if material.cover is None else [("cover", material.cover)],
        plans=[] if material.plan is None else [("plan", material.plan)],
    )
    closest = [(number, closest_flight(run)) for number, run in enumerate(runs[:MOST_RUNS])]
    first = [(number, found[0]) for number, found in closest if found is not None]
    html, content = within(composer(shown, most_played_s=_MOST_PLAYED_S, first=first), maximum=_MOST_BYTES)
    notes = "; ".join(content.notes)
    return View(html, f"{notes[0].upper()}{notes[1:]}." if notes else "")
