"""The numbers that matter: the head of the report, and what the command prints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from alula.schemas.run import TrialResult
from alula.stages.reporting.fenced import is_fenced
from alula.stages.reporting.material import (
    NOT_JUDGED,
    Material,
    Run,
    clearance_of,
    is_covered,
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
    """A number that matters: `good` is None when it is neither good nor bad."""

    label: str
    value: str
    detail: str = ""
    good: bool | None = None


def headline(material: Material) -> dict[str, Any]:
    """Five facts as plain values: compression, conservativeness, coverage, success, least clearance."""
    found: dict[str, Any] = {}
    if counted := chain(material):
        found["compression"] = " → ".join(f"{count} {what}" for count, what in counted)
    if material.cover is not None:
        found["conservativeness"] = float(material.cover.manifest.conservativeness)  # type: ignore[attr-defined]
    if material.cover is not None or material.certificate is not None:
        covered = is_covered(material.certificate)
        found["obstacles_covered"] = "not verified" if covered is None else covered
    trials = [(run.label, trial) for run in material.runs for trial in run.record.trials]
    if trials:
        static = [trial for _, trial in trials if trial.obstacles is None and trial.fence is None]
        moving = [trial for _, trial in trials if trial.obstacles is not None]
        fenced = [trial for _, trial in trials if trial.fence is not None]
        said = [_said(part) for part in (static, moving, fenced) if part]
        collisions = sum(trial.collision for _, trial in trials if trial.fence is None)
        found["flights"] = "; ".join(said) + (f", {collisions} collided" if static or moving else "")
    ends = [(r.label, r.record.summary["ended_by"]) for r in material.runs if "ended_by" in r.record.summary]
    if ends:
        found["ended_by"] = "; ".join(words if len(ends) == 1 else f"{who}: {words}" for who, words in ends)
    if known := [c for _, trial in trials if (c := clearance_of(trial)) is not None]:
        found["least_clearance_m"] = min(known)
    if notes := [
        f"{run.label}: {note}" for run in material.runs for note in run.record.summary.get("notes", ())
    ]:
        found["notes"] = notes
    return found


def _said(trials: Sequence[TrialResult]) -> str:
    """How many flights were good, all of one kind: past moving obstacles nobody waits for the goal."""
    if any(trial.fence is not None for trial in trials):
        good, word = sum(not trial.collision for trial in trials), "stayed in the fence"
    elif any(trial.obstacles is not None for trial in trials):
        good, word = sum(not trial.collision for trial in trials), "touched nothing"
    else:
        good, word = sum(outcome_of(trial) == "reached" for trial in trials), "reached the goal"
    return f"{text(good)} of {text(len(trials))} {word}"


def cards(material: Material) -> list[tuple[str, list[Card]]]:
    """The numbers that matter, in groups: the map, then each run."""
    groups: list[tuple[str, list[Card]]] = []
    if material.cover is not None or material.certificate is not None:
        groups.append(("Map", _map_cards(material)))
    for run in material.runs:
        groups.append((run.label if len(material.runs) > 1 else "Flights", _run_cards(run)))
    return groups


def _map_cards(material: Material) -> list[Card]:
    covered = is_covered(material.certificate)
    shown = text(covered) if covered is not None else "not verified"
    found = [Card("obstacles covered", shown, proof(material.certificate), covered)]
    if material.cover is not None:
        value = float(material.cover.manifest.conservativeness)  # type: ignore[attr-defined]
        found.insert(0, Card("conservativeness", text(value), "volume of hulls / volume of voxels"))
    return found


def _run_cards(run: Run) -> list[Card]:
    if is_fenced(run):
        return _fence_cards(run)
    summary, trials = run.record.summary, run.record.trials
    if run.course is not None and not trials:  # nothing that could be counted
        return [Card("verdict", NOT_JUDGED, "; ".join(summary.get("notes", ())), False)]
    interval = success_interval(run)
    rate, collisions = summary.get("success_rate"), summary.get("collisions")
    detail = _said(trials)
    if detail.endswith("goal"):
        detail += " unharmed"
    if interval:
        detail += f"; 95 %: {text(interval[0])} to {text(interval[1])}"
    found = []
    if (ended := summary.get("ended_by")) is not None:  # a real flight
        holds = summary.get("holds", 0)
        said = "never held on the way" if holds == 0 else f"held {text(holds)} times on the way"
        found.append(Card("ended by", str(ended), said, ended == "plan finished"))
    found += [
        Card("success rate", text(rate), detail),
        Card("collisions", text(collisions), "after the flight, continuous path", collisions == 0),
    ]
    for key, what in (("map", "hulls"), ("scene", "splats")):
        least = summary.get(f"min_{key}_clearance_m")
        if least is not None:
            found.append(Card(f"least clearance to {what}", f"{text(least)} m", "", least >= 0))
    found.append(
        Card("path length", text(summary.get("mean_path_ratio")), "× straight line, mean of successes")
    )
    return found


def _fence_cards(run: Run) -> list[Card]:
    summary, interval = run.record.summary, success_interval(run)
    least, left = float(summary["min_distance_m"]), int(summary["violations"])
    share = summary["passed"] / summary["ticks"] if summary["ticks"] else None
    detail = f"{_said(run.record.trials)}"
    if interval:
        detail += f"; 95 %: {text(interval[0])} to {text(interval[1])}"
    return [
        Card("left the fence", text(left), detail, left == 0),
        Card(
            "least distance to the fence", f"{text(least)} m", f"trial {summary['worst_trial']}", least >= 0
        ),
        Card("top speed", f"{text(summary['max_speed_km_h'])} km/h"),
        Card(
            "interventions", text(summary["interventions"]), f"in {text(summary['engaged_trials'])} flights"
        ),
        Card("pilot alone", text(share), "share of ticks in which his command passed bit by bit"),
    ]


def chain(material: Material) -> list[tuple[str, str]]:
    """The compression as a chain: count and what is counted."""
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
