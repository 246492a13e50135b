"""The first screen of a report: a verdict in words and four numbers for each run, or for the map or the plan.

Every format of a report shows these values; a page also states each one as data, with all of its digits.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

from alula.schemas.log.run import TrialResult
from alula.schemas.parameters.flight_defaults import NO_FILTER
from alula.stages.reporting import plain
from alula.stages.reporting.fenced import fence_distance, fence_figures, is_fenced
from alula.stages.reporting.guarantees import guarantees, statements
from alula.stages.reporting.headline import successes
from alula.stages.reporting.material import (
    Material,
    Run,
    coverage,
    elsewhere,
    outcome_of,
    proof,
)
from alula.stages.reporting.tables import BYTES_PER_HALF_PLANE, gaussian_count, success_interval, voxel_count
from alula.stages.unlike import unlike
from alula.stages.verdict import clearance_of

Tone = Literal["good", "fair", "bad", "plain"]
GOOD: Final = "good"
FAIR: Final = "fair"
BAD: Final = "bad"
PLAIN: Final = "plain"
_UNPROVEN: Final[tuple[str, Tone]] = ("A plan; its file holds no proof that it is clear of the map.", PLAIN)
_PARTS = {
    "map_clearance_m": "hulls",
    "scene_clearance_m": "splats",
    "fence_clearance_m": "fence",
    "moving_clearance_m": "moving obstacles",
}
_ENDS = {
    "stuck": "got stuck",
    "timeout": "ran out of time",
    "refused": "were refused",
    "stopped": "were stopped",
    "missed-via": "missed a via point",
    "off-plan": "left the plan",
}


@dataclass(frozen=True, slots=True)
class Number:
    """A number of the first screen.

    Attributes:
        key: its name in data.
        value: with all digits, in the unit of the key; None where unknown.
        shown: as a person reads it.
        good: whether it is good news; None for neither.
    """

    key: str
    label: str
    value: Any
    shown: str
    detail: str = ""
    good: bool | None = None


@dataclass(frozen=True, slots=True)
class Subject:
    """A run, the map or the plan, with its verdict and its numbers.

    Attributes:
        kind: run, map, plan or scene.
        tone: of the verdict: good, fair, bad or plain.
        numbers: the same keys for all subjects of a kind, as far as they are known.
    """

    kind: Literal["run", "map", "plan", "scene"]
    title: str
    words: str
    verdict: str
    tone: Tone
    numbers: tuple[Number, ...]


@dataclass(frozen=True, slots=True)
class Brief:
    """What the first screen shows; `proofs` and `limits` say in plain words what is and is not guaranteed."""

    title: str
    verdict: str
    tone: Tone
    subjects: tuple[Subject, ...]
    proofs: tuple[str, ...]
    limits: tuple[str, ...]
    statements: tuple[tuple[str, str], ...]

    def of_kind(self, kind: str) -> list[Subject]:
        """Subjects of a kind, in their order."""
        return [subject for subject in self.subjects if subject.kind == kind]


def brief(material: Material) -> Brief:
    """Sum up a report."""
    runs = [_run(run) for run in material.runs]
    others = []
    if material.cover is not None or material.certificate is not None:
        others.append(_map(material))
    if material.plan is not None:
        others.append(_plan(material.plan.manifest))
    if not (runs or others) and (gaussians := gaussian_count(material)) is not None:
        words = f"{gaussians:,} Gaussians. Voxelize and merge them to get a map."
        others.append(Subject("scene", "Scene", "", words, PLAIN, ()))
    verdict, tone = _overall(material.runs, runs) if runs else _first(others)
    verdict += _unlike(material.runs) + _elsewhere(material)
    proofs, limits = guarantees(material)
    return Brief(material.title, verdict, tone, (*runs, *others), proofs, limits, tuple(statements(material)))


def _first(subjects: Sequence[Subject]) -> tuple[str, Tone]:
    return (subjects[0].verdict, subjects[0].tone) if subjects else ("", PLAIN)


def _overall(runs: Sequence[Run], judged: Sequence[Subject]) -> tuple[str, Tone]:
    """Verdict on all runs; those without a filter are only what others are compared with."""
    if len(judged) == 1:
        return judged[0].verdict, judged[0].tone
    behind = [r for r in runs if r.record.filter != NO_FILTER] or list(runs)
    labels = {run.label for run in behind}
    tones = {subject.tone for subject in judged if subject.title in labels}
    ranked: tuple[Tone, ...] = (BAD, FAIR, GOOD)
    tone: Tone = next((one for one in ranked if one in tones), PLAIN)
    trials = [trial for run in behind for trial in run.record.trials]
    unjudged = sum(not run.record.trials for run in behind)
    blind = sum(clearance_of(trial) is None for trial in trials)
    touched = sum(trial.collision for trial in trials)
    flown = sum(bool(run.record.trials) for run in behind)
    several = f" in {flown} runs" if flown > 1 else ""
    if touched:
        words = f"{plain.count(touched, len(trials))} flights {_bad_word(behind)}."
    elif blind == len(trials):
        words = f"{len(trials):,} flights{several}; no obstacle was judged."
    elif blind:
        words = (
            f"None of {len(trials) - blind:,} flights touched anything; {blind:,} had no obstacle to judge."
        )
    elif all(map(is_fenced, behind)):
        words = "All flights stayed inside the fence."
    else:
        words = f"None of {len(trials):,} flights{several} touched anything{_ends_of(behind)}."
    if unjudged:
        words += f" {unjudged} {'run was' if unjudged == 1 else 'runs were'} not judged."
    if len(behind) < len(runs):
        bare = [trial for run in runs if run.record.filter == NO_FILTER for trial in run.record.trials]
        hit = sum(trial.collision for trial in bare)
        words = words.replace("None of", "Behind a filter none of", 1)
        words += f" Without one, {hit:,} of {len(bare):,} {_bad_word(runs)}."
    return words, tone


def _unlike(runs: Sequence[Run]) -> str:
    """Sentence that runs differ in vehicle or map, which no comparison of their filters allows for."""
    found = {one.what for run in runs[1:] for one in unlike(runs[0].record, run.record)}
    kinds = [kind for kind in ("vehicle", "map") if kind in found]
    return f" The runs differ in their {' and '.join(kinds)}, too." if kinds else ""


def _elsewhere(material: Material) -> str:
    """Sentence that names the runs that did not fly in the map or the scan of the report."""
    labels = [run.label for run in material.runs if elsewhere(run, material)]
    return f" Not flown in the map and scan of this report: {', '.join(labels)}." if labels else ""


def _ends_of(runs: Sequence[Run]) -> str:
    """How many reached the goal, if all flew behind one filter and mean the same by success."""
    words = {successes(run)[1] for run in runs if run.record.trials}
    if len({run.record.filter for run in runs}) > 1 or len(words) != 1 or words == {"touched nothing"}:
        return ""
    return f"; {sum(successes(run)[0] for run in runs):,} {words.pop()}"


def _bad_word(runs: Sequence[Run]) -> str:
    return "left the fence" if all(map(is_fenced, runs)) else "touched an obstacle"


def _run(run: Run) -> Subject:
    filter_ = "no filter" if run.record.filter == NO_FILTER else run.record.filter
    words = f"{filter_} · {run.record.vehicle}"
    verdict, tone = _verdict(run)
    numbers = () if not run.record.trials else _fence_numbers(run) if is_fenced(run) else _numbers(run)
    return Subject("run", run.label, words, verdict, tone, numbers)


def _verdict(run: Run) -> tuple[str, Tone]:
    trials, summary = run.record.trials, run.record.summary
    if not trials:
        notes = "; ".join(summary.get("notes", ())) or "there is no trial"
        notes = notes.removesuffix("; the flight was not judged")
        return f"Not judged: {notes}.", BAD if run.course is not None else PLAIN
    touched, (good, word) = sum(trial.collision for trial in trials), successes(run)
    n, fenced = len(trials), is_fenced(run)
    is_known = any(clearance_of(trial) is not None for trial in trials)
    bare = run.record.filter == NO_FILTER
    if n == 1:
        verdict = _single(trials[0], touched, good == n, word, is_known=is_known, fenced=fenced)
        if (ended := summary.get("ended_by")) is not None and ended != "plan finished":
            verdict = f"{verdict[:-1]}; it ended early: {ended}."
    elif touched:
        verdict = f"{plain.count(touched, n)} flights {_bad_word([run])}."
    elif fenced:
        verdict = f"All {n:,} flights stayed inside the fence."
    elif word == "touched nothing":
        verdict = f"None of {n:,} flights touched anything."
    else:
        reached = f"All {n:,} flights {word}" if good == n else f"{plain.count(good, n)} flights {word}"
        verdict = f"{reached} and touched nothing." if is_known else f"{reached}; no obstacle was judged."
        if is_known and good < n:
            verdict = f"None of {n:,} flights touched anything; {good:,} {word}."
    if bare:
        return f"Without a filter: {verdict[0].lower()}{verdict[1:]}", BAD if touched else PLAIN
    return verdict, BAD if touched else GOOD if good == n else FAIR


def _single(
    trial: TrialResult, touched: int, is_good: bool, word: str, *, is_known: bool, fenced: bool
) -> str:
    if touched:
        return f"The flight {'left the fence' if fenced else 'touched an obstacle'}."
    if fenced or word == "touched nothing":
        return f"The flight {word}."
    ended = f"The flight {word}" if is_good else f"The flight did not reach its goal ({outcome_of(trial)})"
    return f"{ended}{' and touched nothing' if is_known else '; no obstacle was judged'}."


def _numbers(run: Run) -> tuple[Number, ...]:
    trials, summary = run.record.trials, run.record.summary
    n, touched, (good, word) = len(trials), sum(t.collision for t in trials), successes(run)
    found = [
        Number("successes", word, good, plain.count(good, n), _others(run), None if good < n else True),
        Number("collisions", "touched an obstacle", touched, f"{touched:,}", _how(run), touched == 0),
    ]
    if (closest := _closest(trials)) is not None:
        value, part, index, others = closest
        where = f"{'to' if value >= 0 else 'in'} the {part}" + (f", trial {index}" if n > 1 else "")
        detail = "; ".join([where, *others])
        label = "closest to an obstacle" if value >= 0 else "in an obstacle"
        shown = plain.length(value, down=True) if value >= 0 else f"{plain.length(-value)} deep"
        found.append(Number("min_clearance_m", label, value, shown, detail, value >= 0))
    off = summary.get("max_tracking_error_m")
    steps = sum(trial.steps for trial in trials)
    if "ended_by" in summary and isinstance(off, int | float):
        holds = summary.get("holds") or 0
        detail = "no holds" if not holds else f"{holds} {'hold' if holds == 1 else 'holds'}"
        shown = plain.length(off)
        found.append(Number("max_tracking_error_m", "farthest from the plan", off, shown, detail))
    elif run.record.filter != NO_FILTER and steps:
        changed = sum(trial.filtered_steps for trial in trials)
        label, value = "commands changed by the filter", changed / steps
        detail = f"{plain.count(changed, steps)} steps"
        found.append(Number("changed_fraction", label, value, plain.share(changed, steps), detail))
    else:
        top = max(trial.max_speed_m_s for trial in trials)
        found.append(Number("max_speed_m_s", "top speed", top, plain.speed(top)))
    return tuple(found)


def _others(run: Run) -> str:
    """Interval of the success rate; how the other flights ended."""
    words = []
    if len(run.record.trials) > 1 and (interval := success_interval(run)):
        low, high = (f"{100 * end:.0f}" for end in interval)
        words.append(f"95 % interval: {low} to {high} %")
    ends = Counter(map(outcome_of, run.record.trials))
    words += [f"{ends[end]:,} {name}" for end, name in _ENDS.items() if ends[end]]
    return "; ".join(words)


def _how(run: Run) -> str:
    if "ended_by" in run.record.summary:
        return "judged along the path that the vehicle measured"
    return "judged afterwards along the whole path"


def _closest(trials: Sequence[TrialResult]) -> tuple[float, str, int, list[str]] | None:
    """Minimum clearance, the part of the world, the trial, and words on the other parts."""
    minima = []
    for key, part in _PARTS.items():
        known = [(getattr(t, key), t.index) for t in trials if getattr(t, key) is not None]
        if known:
            minima.append((*min(known), part))
    if not minima:
        return None
    minima.sort(key=lambda one: one[0])
    value, index, part = minima[0]
    others = [
        f"{plain.length(other, down=True)} to the {name}"
        if other >= 0
        else f"{plain.length(-other)} deep in the {name}"
        for other, _, name in minima[1:]
    ]
    return value, part, index, others


def _fence_numbers(run: Run) -> tuple[Number, ...]:
    trials, figures, (good, word) = run.record.trials, fence_figures(run), successes(run)
    n, engaged = len(trials), int(figures["engaged_trials"])
    minimum, top, times = figures["min_distance_m"], figures["max_speed_km_h"], int(figures["interventions"])
    worst = min(trials, key=lambda trial: (fence_distance(trial), trial.index)).index
    label = "closest to the fence" if minimum >= 0 else "of the fence, at most"
    shown = plain.length(minimum, down=True) if minimum >= 0 else f"{plain.length(-minimum)} outside"
    where = f"trial {worst}" if n > 1 else ""
    engaged_in = f"in {engaged:,} {'flight' if engaged == 1 else 'flights'}"
    return (
        Number("successes", word, good, plain.count(good, n), _others(run), good == n),
        Number("min_distance_m", label, minimum, shown, where, minimum >= 0),
        Number("max_speed_km_h", "top speed", top, f"{top:.0f} km/h"),
        Number("interventions", "interventions", times, f"{times:,}", engaged_in),
    )


def _map(material: Material) -> Subject:
    covered = coverage(material.certificate)
    words = {True: "proven", False: "no", "in part": "in part", "voxels only": "voxels only"}.get(
        covered, "not checked"
    )
    known: dict[bool | str, tuple[str, Tone]] = {
        True: ("The map covers the scan: checked again, and proven.", GOOD),
        False: ("The map does not cover the scan.", BAD),
        "in part": ("The map covers the scan but for what it leaves out: checked again, and proven.", FAIR),
        "voxels only": ("The map covers the voxels; the scan itself was not checked.", FAIR),
    }
    unknown: tuple[str, Tone] = (
        "This map was not checked. Run alula verify, and pass --certificate.",
        PLAIN,
    )
    verdict, tone = known.get(covered, unknown)
    good = covered if isinstance(covered, bool) else None
    found = [Number("covered", "covers the scan", covered, words, proof(material.certificate), good)]
    if (cover := material.cover) is not None:
        manifest: Any = cover.manifest
        hulls, gaussians = len(cover["plane_start"]) - 1, gaussian_count(material)
        of = f"from {gaussians:,} Gaussians" if gaussians is not None else ""
        excess = float(manifest.conservativeness) - 1
        stored = manifest.summary.get("onboard_bytes")
        is_stored = isinstance(stored, int)
        count = stored if is_stored else len(cover["plane_offset"]) * BYTES_PER_HALF_PLANE
        voxels = f"than its {voxel_count(cover):,} voxels"
        found += [
            Number("hulls", "convex hulls", hulls, f"{hulls:,}", of),
            Number("conservativeness", "larger", float(manifest.conservativeness), _more(excess), voxels),
            Number("bytes", "on board" if is_stored else "of half-planes", count, plain.size(count)),
        ]
    return Subject("map", "The map", "", verdict, tone, tuple(found))


def _more(excess: float) -> str:
    if excess < 0.1:
        return f"{100 * excess:.1f} %"
    return f"{100 * excess:.0f} %"


def _plan(manifest: Any) -> Subject:
    summary, proven = manifest.summary, manifest.certificate.get("min_proven_clearance_m")
    found = []
    for key, label, write in (
        ("duration_s", "flight time", plain.duration),
        ("length_m", "length", plain.length),
        ("max_speed_m_s", "top speed", plain.speed),
    ):
        if isinstance(value := summary.get(key), int | float):
            found.append(Number(key, label, value, write(value)))
    verdict, tone = _UNPROVEN
    if isinstance(proven, int | float):
        # the bound is on the distance of the centre
        is_clear = proven >= manifest.radius_m
        shown, radius = plain.length(proven, down=True), plain.length(manifest.radius_m)
        levels = [each.get("level", {}).get("sigma") for each in manifest.maps]
        sizes = dict.fromkeys(plain.deviations(sigma) for sigma in levels if isinstance(sigma, int | float))
        of = f", of Gaussians up to {' and '.join(sizes)}" if sizes else ""
        verdict = f"The plan keeps its centre {shown} from everything in the map{of}: proven."
        if not is_clear:
            verdict = f"The plan comes nearer to the map than the vehicle's radius of {radius}."
        tone = GOOD if is_clear else BAD
        detail = f"proven for the centre; the vehicle's radius is {radius}"
        found.append(Number("min_proven_clearance_m", "from the map", proven, shown, detail, is_clear))
    return Subject("plan", "The plan", "", verdict, tone, tuple(found))
