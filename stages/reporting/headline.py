"""The facts of a report in plain values, as the command prints them, and the count of successes in a run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from alula.schemas.log.run import TrialResult
from alula.schemas.parameters.flight_defaults import NO_FILTER
from alula.stages.reporting.material import Material, Run, coverage, is_composed, outcome_of
from alula.stages.reporting.table import text
from alula.stages.reporting.tables import (
    BYTES_PER_HALF_PLANE,
    gaussian_count,
    voxel_count,
)
from alula.stages.unlike import unlike, unlike_words
from alula.stages.verdict import clearance_of


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
    if words := _unlike(material.runs):
        found["unlike"] = words
    if notes := [
        f"{run.label}: {note}" for run in material.runs for note in run.record.summary.get("notes", ())
    ]:
        found["notes"] = notes
    return found


def _unlike(runs: Sequence[Run]) -> list[str]:
    """How each run differs from the first one, beside the filter."""
    each = [unlike_words(unlike(runs[0].record, run.record), runs[0].label, run.label) for run in runs[1:]]
    return [words for words in each if words]


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
        good, word = _successes(trials, waits=kind == 1)
        found.append(f"{shown}{labels}: {text(good)} of {text(len(trials))} {word}{collided}")
    return found


def _settings(run: Run) -> str:
    """Parameters of a run's filter as text; empty where the record has none."""
    parameters = run.record.provenance.parameters
    return repr((parameters.get("filter_parameters"), parameters.get("safety")))


def _waits(run: Run) -> bool:
    """Whether flights end when moving obstacles have passed, and not at a goal."""
    mission = run.record.provenance.parameters.get("mission")
    if isinstance(mission, dict):
        return mission.get("receded_s") is not None
    return any(trial.obstacles is not None for trial in run.record.trials)


def successes(run: Run) -> tuple[int, str]:
    """Count the successful flights of a run, and say what success is."""
    return _successes(run.record.trials, waits=_waits(run))


def successful(run: Run) -> set[int]:
    """Numbers of the trials that `successes` counts."""
    _, word = successes(run)
    if word in ("touched nothing", "stayed in the fence"):
        return {trial.index for trial in run.record.trials if not trial.collision}
    ends = ("held", "passed") if word == "flew to the end" else ("reached",)
    return {trial.index for trial in run.record.trials if outcome_of(trial) in ends}


def _successes(trials: Sequence[TrialResult], *, waits: bool) -> tuple[int, str]:
    """Count the successful flights, all of one kind; past moving obstacles, success is no collision."""
    if waits:
        return sum(not trial.collision for trial in trials), "touched nothing"
    if any(trial.fence is not None for trial in trials):
        return sum(not trial.collision for trial in trials), "stayed in the fence"
    ends = [outcome_of(trial) for trial in trials]
    if any(map(is_composed, trials)) and "reached" not in ends and ("held" in ends or "passed" in ends):
        return ends.count("held") + ends.count("passed"), "flew to the end"
    return ends.count("reached"), "reached the goal"


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
