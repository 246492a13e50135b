"""The headline of a report: the cards at the top of the page and the facts that the command prints.

All verdicts on a run that the report states in words are written here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from alula.schemas.run import TrialResult
from alula.stages.filtering.registry import NO_FILTER
from alula.stages.reporting.fenced import fence_figures, is_fenced
from alula.stages.reporting.material import (
    NOT_JUDGED,
    Material,
    Run,
    clearance_of,
    coverage,
    is_composed,
    outcome_of,
    proof,
)
from alula.stages.reporting.table import text
from alula.stages.reporting.tables import (
    BYTES_PER_HALF_PLANE,
    gaussian_count,
    success_interval,
    voxel_count,
)


@dataclass(frozen=True, slots=True)
class Card:
    """A headline number; `good` is None when it is neither good nor bad."""

    label: str
    value: str
    detail: str = ""
    good: bool | None = None


def headline(material: Material) -> dict[str, Any]:
    """State compression, conservativeness, coverage, success and minimum clearance as plain values.

    `flights` and `least_clearance_m` are of the flights behind a filter, `baseline` and
    `baseline_least_clearance_m` of those without one.
    """
    found: dict[str, Any] = {}
    if counted := chain(material):
        found["compression"] = " → ".join(f"{count} {what}" for count, what in counted)
    if material.cover is not None:
        found["conservativeness"] = float(material.cover.manifest.conservativeness)  # type: ignore[attr-defined]
    if material.cover is not None or material.certificate is not None:
        found["obstacles_covered"] = coverage(material.certificate)
    judged = [run for run in material.runs if run.record.filter != NO_FILTER]
    baselines = [run for run in material.runs if run.record.filter == NO_FILTER]
    for key, runs in (("flights", judged), ("baseline", baselines)):
        if verdicts := _verdicts(runs):
            found[key] = "; ".join(verdicts)
    ends = [(r.label, r.record.summary["ended_by"]) for r in material.runs if "ended_by" in r.record.summary]
    if ends:
        found["ended_by"] = "; ".join(end if len(ends) == 1 else f"{label}: {end}" for label, end in ends)
    for key, runs in (("least_clearance_m", judged), ("baseline_least_clearance_m", baselines)):
        trials = [trial for run in runs for trial in run.record.trials]
        if known := [clearance for trial in trials if (clearance := clearance_of(trial)) is not None]:
            found[key] = min(known)
    if notes := [
        f"{run.label}: {note}" for run in material.runs for note in run.record.summary.get("notes", ())
    ]:
        found["notes"] = notes
    return found


def _verdicts(runs: Sequence[Run]) -> list[str]:
    """Verdicts on flights of one kind behind one filter with one set of parameters, each named by its filter.

    Flights behind different filters are not added up. The names of the runs are added where one filter
    flew with several sets of parameters.
    """
    groups: dict[tuple[str, str, int], list[tuple[str, TrialResult]]] = {}
    for run in runs:
        settings = _settings(run)
        for trial in run.record.trials:
            kind = 1 if _waits(run) else 2 if trial.fence is not None else 3 if is_composed(trial) else 0
            groups.setdefault((run.record.filter, settings, kind), []).append((run.label, trial))
    several = {name for name, _, _ in groups if len({s for n, s, _ in groups if n == name}) > 1}
    found = []
    for (name, _, kind), flown in sorted(groups.items(), key=lambda group: group[0][2]):
        labels = f" ({', '.join(dict.fromkeys(label for label, _ in flown))})" if name in several else ""
        trials = [trial for _, trial in flown]
        collided = "" if kind == 2 else f", {text(sum(trial.collision for trial in trials))} collided"
        shown = "no filter" if name == NO_FILTER else name
        found.append(f"{shown}{labels}: {_verdict(trials, waits=kind == 1)}{collided}")
    return found


def _settings(run: Run) -> str:
    """Parameters of a run's filter as text; empty where the record has none."""
    parameters = run.record.provenance.parameters
    table = parameters.get("filter")
    inner = table.get("parameters") if isinstance(table, dict) else None
    return repr((parameters.get("filter_parameters"), inner, parameters.get("safety")))


def _waits(run: Run) -> bool:
    """Whether flights end when moving obstacles have passed, and not at a goal."""
    mission = run.record.provenance.parameters.get("mission")
    if isinstance(mission, dict):
        return mission.get("receded_s") is not None
    return any(trial.obstacles is not None for trial in run.record.trials)


def _verdict(trials: Sequence[TrialResult], *, waits: bool) -> str:
    """Count the successful flights, all of one kind; past moving obstacles, success is no collision."""
    if waits:
        good, word = sum(not trial.collision for trial in trials), "touched nothing"
    elif any(trial.fence is not None for trial in trials):
        good, word = sum(not trial.collision for trial in trials), "stayed in the fence"
    elif any(map(is_composed, trials)):
        ends = [outcome_of(trial) for trial in trials]
        stays = "reached" not in ends and ("held" in ends or "passed" in ends)
        good, word = ends.count("reached"), "reached the goal"
        if stays:
            good, word = ends.count("held") + ends.count("passed"), "flew to the end"
    else:
        good, word = sum(outcome_of(trial) == "reached" for trial in trials), "reached the goal"
    return f"{text(good)} of {text(len(trials))} {word}"


def _verdict_and_interval(run: Run) -> str:
    """The verdict on a run with the 95 % interval of its success rate."""
    verdict, interval = _verdict(run.record.trials, waits=_waits(run)), success_interval(run)
    if verdict.endswith("goal"):
        verdict += " without a collision"
    return verdict + (f"; 95 %: {text(interval[0])} to {text(interval[1])}" if interval else "")


def cards(material: Material) -> list[tuple[str, list[Card]]]:
    """Make the headline cards in groups: the map, then each run."""
    groups: list[tuple[str, list[Card]]] = []
    if material.cover is not None or material.certificate is not None:
        groups.append(("Map", _map_cards(material)))
    for run in material.runs:
        title = run.label if len(material.runs) > 1 else "Flights"
        baseline = " (baseline: no filter)" if run.record.filter == NO_FILTER else ""
        groups.append((title + baseline, _run_cards(run)))
    return groups


def _map_cards(material: Material) -> list[Card]:
    covered = coverage(material.certificate)
    is_good = covered if isinstance(covered, bool) else None
    found = [Card("obstacles covered", text(covered), proof(material.certificate), is_good)]
    if material.cover is not None:
        value = float(material.cover.manifest.conservativeness)  # type: ignore[attr-defined]
        found.insert(0, Card("conservativeness", text(value), "volume of hulls / volume of voxels"))
    return found


def _run_cards(run: Run) -> list[Card]:
    if is_fenced(run):
        return _fence_cards(run)
    summary, trials = run.record.summary, run.record.trials
    if run.course is not None and not trials:  # nothing to count
        return [Card("verdict", NOT_JUDGED, "; ".join(summary.get("notes", ())), False)]
    rate, collisions = summary.get("success_rate"), summary.get("collisions")
    found = []
    if (ended := summary.get("ended_by")) is not None:  # a real flight
        holds = summary.get("holds", 0)
        detail = "no holds" if holds == 0 else f"{text(holds)} hold{'s' if holds != 1 else ''}"
        found.append(Card("ended by", str(ended), detail, ended == "plan finished"))
    found += [
        Card("success rate", text(rate), _verdict_and_interval(run)),
        Card(
            "collisions",
            text(collisions),
            "computed after the flight from the continuous path",
            collisions == 0,
        ),
    ]
    for key, what in (("map", "hulls"), ("scene", "splats")):
        minimum = summary.get(f"min_{key}_clearance_m")
        if minimum is not None:
            found.append(Card(f"minimum clearance to {what}", f"{text(minimum)} m", "", minimum >= 0))
    found.append(
        Card("path length", text(summary.get("mean_path_ratio")), "× straight line, mean of successes")
    )
    return found


def _fence_cards(run: Run) -> list[Card]:
    summary, figures = run.record.summary, fence_figures(run)
    minimum, left = float(figures["min_distance_m"]), int(figures["violations"])
    ticks = sum(trial.steps for trial in run.record.trials)
    passed = figures["passed"] / ticks if ticks else None
    worst = f"trial {summary['worst_trial']}"
    found = [
        Card("left the fence", text(left), _verdict_and_interval(run), left == 0),
        Card("minimum distance to the fence", f"{text(minimum)} m", worst, minimum >= 0),
        Card("top speed", f"{text(figures['max_speed_km_h'])} km/h"),
        Card(
            "interventions", text(figures["interventions"]), f"in {text(figures['engaged_trials'])} flights"
        ),
        Card("passed unchanged", text(passed), "fraction of ticks with the pilot's command bit for bit"),
    ]
    if (collisions := summary.get("collisions")) != left:  # with what is no part of the fence
        found.append(Card("collisions", text(collisions), "with all parts of the world", collisions == 0))
    return found


def chain(material: Material) -> list[tuple[str, str]]:
    """State the compression as a chain of pairs: a count and what is counted."""
    found = []
    if (gaussians := gaussian_count(material)) is not None:
        found.append((text(gaussians), "Gaussians"))
    if material.cover is not None:
        planes = len(material.cover["plane_offset"])
        onboard = material.cover.manifest.summary.get("onboard_bytes")
        found += [
            (text(voxel_count(material.cover)), "voxels"),
            (text(len(material.cover["plane_start"]) - 1), "hulls"),
            (text(planes), "half-planes"),
            (text(onboard), "bytes on board")
            if isinstance(onboard, int)
            else (text(planes * BYTES_PER_HALF_PLANE), "bytes of half-planes"),
        ]
    return found
