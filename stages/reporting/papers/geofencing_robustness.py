"""What the geofence's reserve is worth against what its model leaves out, and many pilots together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from alula.stages.reporting.papers.geofencing import BASE, FREE, PROGRAM, Fenced, changed, select
from alula.stages.reporting.statistics import Rate, rate
from alula.stages.reporting.tables import Table, text

ROBUSTNESS, PILOTS = "robustness", "pilots"  # folders


@dataclass(frozen=True, slots=True)
class Disturbed:
    """Runs of one disturbance, by growing reserve.

    `enough` is the first from which on no flight of any run left its fence, None when some always did.
    """

    name: str
    runs: tuple[Fenced, ...]
    enough: Fenced | None


def disturbed(runs: Sequence[Fenced]) -> list[Disturbed]:
    """Runs of the folder by disturbance; a variant is called DISTURBANCE_RESERVE."""
    groups: dict[str, list[Fenced]] = {}
    for run in select(runs, ROBUSTNESS):
        groups.setdefault(run.variant.rpartition("_")[0], []).append(run)
    found = []
    for name, members in groups.items():
        ordered = sorted(members, key=lambda run: run.reserve_m)
        enough = None
        for run in reversed(ordered):
            if run.left.value:
                break
            enough = run
        found.append(Disturbed(name, tuple(ordered), enough))
    return found


def robustness_table(runs: Sequence[Fenced]) -> Table | None:
    """Each disturbance without a reserve, and the least reserve that no flight left; None without runs."""
    rows: list[tuple[Any, ...]] = []
    for group in disturbed(runs):
        bare, enough = group.runs[0], group.enough
        words = [w for w in changed(bare).split(", ") if not w.startswith("reserve_m")]
        row: list[Any] = [group.name, ", ".join(words), bare.left.n, *bare.left.cells, bare.least_m]
        row += [None] * 5 if enough is None else [enough.reserve_m, *enough.left.cells, enough.least_m]
        rows.append(tuple(row))
    if not rows:
        return None
    columns = (
        *("disturbance", "what flies, and the filter does not know", "flights", "without reserve left [%]"),
        *("95 % low", "95 % high", "least distance [m]", "least reserve of the grid with none [m]"),
        *("then left [%]", "95 % low", "95 % high", "least distance then [m]"),
    )
    grid = sorted({run.reserve_m for run in select(runs, ROBUSTNESS)})
    note = (
        f"Aggressive pilots in the box, each with reserves of {text(grid)} m; the least is that from which "
        "on no flight with any larger one left either. None of n is no proof of none: the interval says what "
        "n flights cannot exclude. Starts are safe for the filter with its reserve, so they differ a little. "
        "`delay-known`: the filter knows of the delay (latency_s)."
    )
    return Table(ROBUSTNESS, "Robustness, and the reserve that makes up for it", columns, tuple(rows), note)


def pilots_rate(runs: Sequence[Fenced], name: str) -> Rate | None:
    """Of the flights of all pilots behind a filter, the share that left; None without."""
    here = [run for run in select(runs, PILOTS) if run.record.filter == name]
    return rate(t.collision for run in here for t in run.record.trials) if here else None


def pilots_table(runs: Sequence[Fenced]) -> Table | None:
    """All pilots together, filter by filter; None without runs."""
    rows = []
    for name in (BASE, PROGRAM, FREE):
        here = [run for run in select(runs, PILOTS) if run.record.filter == name]
        found = pilots_rate(runs, name)
        if not here or found is None:
            continue
        kinds = dict.fromkeys(run.variant.removesuffix(f"-{name}") for run in here)
        rows.append(
            (
                *(name, len(kinds), found.n, sum(t.collision for run in here for t in run.record.trials)),
                *(*found.cells, min(run.least_m for run in here)),
                sum(result.interventions for run in here for result in run.results),
                sum(result.altered_passes for run in here for result in run.results),
            )
        )
    if not rows:
        return None
    columns = (
        *("filter", "kinds of pilots", "flights", "left the fence", "that is [%]", "95 % low", "95 % high"),
        *("least distance [m]", "engagements", "altered passes"),
    )
    note = "Vehicle as modelled, random starts in the safe set; without a filter and with the program fewer."
    return Table(PILOTS, "Random pilots from random safe starts", columns, tuple(rows), note)
