"""What was measured for every row of FastBridge, with a verdict, from sweeps of runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from alula import _core
from alula.schemas.log.run import TrialResult
from alula.schemas.parameters.filter_options import ConeBackupParameters
from alula.schemas.scenarios.vehicle import FASTBRIDGE as VEHICLE
from alula.stages.compression.voxelize import sigma_of_confidence
from alula.stages.reporting.statistics import Estimate, mean_estimate
from alula.stages.reporting.table import Table
from alula.stages.verdict import wilson_interval
from papers import published
from papers.compared import Measured, Verdict, measured
from papers.fastbridge.sweeps import (
    Sweep,
    compare,
    find,
    realisation_error,
    speeds_of,
    succeeded,
)
from papers.fastbridge.tables import BASELINE, SAME_RADIUS, TUNED
from papers.papers import FASTBRIDGE
from papers.verdicts import below, holds, settings, stated

PRINTED = ("printed-ecbf-14-clf", "safer-splat-gated-3m")  # the paper's program, with the CLF and our lambda
CONES = ("cone-ecbf", "safer-splat-gated-cones")
_WHOSE = {
    SAME_RADIUS: "ours against SAFER-Splat, published gains, the same radius of 3 m",
    PRINTED: "the paper's program (λ = 14, ours) against SAFER-Splat, published gains, 3 m",
    CONES: "ours against SAFER-Splat, published gains, the gate of the cones, where SAFER-Splat collides",
    TUNED: "ours against SAFER-Splat, both tuned by the same search, each its own gate",
}
_LOOPS = (
    *("cone-ecbf-rates", "cone-backup-rates", "printed-backup-rates"),
    *("cone-ecbf-split", "cone-backup-split", "printed-backup-split"),
)
_PROGRAMS = {  # readings that the paper leaves open
    "ecbf-program/pole": [f"printed-ecbf-{name}" for name in ("4", "14", "20")],
    "clf/all": [f"printed-ecbf-{name}-clf" for name in ("4", "14", "20")],
    "clf/weak": ["printed-ecbf-14-clf-weak"],
    "ecbf-program/cascade": ["printed-ecbf-14-difference", "printed-ecbf-14-difference-clf"],
    "caps/printed": ["printed-backup-d", "printed-backup-d-clf"],
    "caps/intended": ["printed-backup", "printed-backup-clf"],
    "clf/ours": ["cone-di-clf", "cone-ecbf-clf", "cone-backup-clf"],
}
_SAFE = {
    **dict.fromkeys(
        ("safer-splat-gated", "safer-splat-gated-3m", "safer-splat-gated-cones", "safer-splat-gated-tuned"),
        "no-collision-baseline",
    ),
    **dict.fromkeys((BASELINE, f"{BASELINE}-tuned"), "no-collision-baseline"),
    **dict.fromkeys(("cone-ecbf", "cone-ecbf-tuned"), "no-collision"),
    "printed-ecbf-14-clf": "no-collision-printed",
}
_PRINTED = published.FASTBRIDGE["comparison"]
_FILTER_HZ = 30


def verdict_rows(sweeps: Sequence[Sweep], scene: str, feasibility: Table) -> list[Measured]:
    """List what was measured with the verdicts, in the order of the paper.

    Args:
        sweeps: all runs.
        scene: the one whose flights are compared.
        feasibility: the table of Proposition 3.
    """
    here = [sweep for sweep in sweeps if sweep.scene == scene]
    return [
        *_settings(),
        *stated(FASTBRIDGE, "linearization", "cone", "relative-degree"),
        _at_rest(),
        *stated(FASTBRIDGE, "reference", "invariant-set", "sensitivity", "braking-torque"),
        *stated(FASTBRIDGE, "proposition-1", "proposition-2"),
        *_proposition_3(feasibility),
        *stated(FASTBRIDGE, "lemma-1", "hover"),
        *_gap(here),
        *_slow(here),
        *_comparison(here),
        *_limits(here),
        *_programs(here),
        *_hardware(here),
        *stated(FASTBRIDGE, "overruns", "sitl", "scene", "figure-3-paths", "figure-1"),
    ]


def _settings() -> list[Measured]:
    body, rotors, gains = VEHICLE.body, VEHICLE.rotors, VEHICLE.tracking
    assert body is not None
    assert rotors is not None
    assert gains is not None
    assert body.mass_kg is not None
    vehicle = [body.mass_kg, abs(rotors.positions_m[0][0]), sum(rotors.max_thrust_n)]
    return [
        settings(FASTBRIDGE, "quantile", [sigma_of_confidence(0.99) ** 2]),
        settings(FASTBRIDGE, "vehicle", vehicle),
        settings(FASTBRIDGE, "gains", [gains.kp_per_s2, gains.kv_per_s]),
        settings(FASTBRIDGE, "caps/eta", [ConeBackupParameters().eta_frac]),
    ]


def _at_rest(ellipsoids: int = 100) -> Measured:
    """Evaluate both barriers at rest beside random ellipsoids."""
    rng = np.random.default_rng(0)
    rest = (0.0, 0.0, 0.0)
    cones = [
        _core.collision_cone(
            rng.uniform(2, 5, 3).tolist(),
            np.diag(rng.uniform(1, 100, 3)),
            rest,
            rest,
            acceleration=rest,
            jerk=rest,
        )
        for _ in range(ellipsoids)
    ]
    vanish, stay = sum(c["h"] == 0 for c in cones), sum(c["gamma"] > 0 for c in cones)
    return measured("rest", holds(vanish == stay == ellipsoids), vanish=vanish, stay=stay, of=ellipsoids)


def _share(row: str, good: int, of: int, **values: float) -> Measured:
    """A statement about all of a number of states."""
    low, high = wilson_interval(good, of)
    return measured(row, holds(good == of), (), (100 * low, 100 * high), good=good, of=of, **values)


def _proposition_3(feasibility: Table) -> list[Measured]:
    printed = [row for row in feasibility.rows if "printed" in row[0]]
    every = _share("proposition-3", sum(row[3] for row in printed), sum(row[2] for row in printed))
    return [every, *(_share("feasible-point", row[4], row[2], alpha=row[1]) for row in printed)]


def _ends(
    here: Sequence[Sweep], variant: str, get: Callable[[TrialResult], float | None]
) -> tuple[tuple[float, Estimate], tuple[float, Estimate]] | None:
    """Mean of a value at the lowest and the highest speed of a variant."""
    flown = sorted((s for s in here if s.variant == variant), key=lambda s: s.speed_m_s)
    found = []
    for sweep in flown[:1] + flown[-1:]:
        values = sweep.values(get)
        mean = mean_estimate(values[np.isfinite(values)])
        if mean is None:
            return None
        found.append((sweep.speed_m_s, mean))
    return (found[0], found[1]) if len(found) == 2 and found[0][0] < found[1][0] else None


def _grows(low: Estimate, high: Estimate) -> bool:
    """Whether the interval of one mean lies above that of another."""
    return (high.value if high.low is None else high.low) > (low.value if low.high is None else low.high)


def _runs(here: Sequence[Sweep], variants: Sequence[str], *speeds: float) -> list[Sweep]:
    """Runs of variants, at all speeds or at some."""
    return [s for s in here if s.variant in variants and (not speeds or s.speed_m_s in speeds)]


def _gap(here: Sequence[Sweep]) -> list[Measured]:
    rows = []
    for variant in ("ideal-di", "cone-di", "cone-ecbf", "cone-backup"):
        ends = _ends(here, variant, realisation_error)
        if ends is None:
            continue
        (slow, low), (fast, high) = ends
        grows = _grows(low, high)
        verdicts: dict[str, Verdict] = {
            "ideal-di": holds(high.value == 0),
            "cone-di": holds(grows),
            "cone-ecbf": holds(not grows),
            "cone-backup": "not comparable",
        }
        beside = find(here, here[0].scene, "cone-di", fast)
        errors = beside.values(realisation_error) if beside is not None else np.empty(0)
        mean = float(np.mean(errors[np.isfinite(errors)])) if len(errors) else None
        rows.append(
            measured(
                f"figure-2-left/{variant}",
                verdicts[variant],
                _runs(here, [variant], slow, fast),
                high,
                slow=slow,
                fast=fast,
                slow_error=low.value,
                fast_error=high.value,
                percent=None if mean is None else 100 * (high.value / mean),
            )
        )
    for variant in ("cone-di", "cone-ecbf"):
        ends = _ends(here, variant, lambda t: t.min_gamma)
        if ends is None:
            continue
        (slow, low), (fast, high) = ends
        runs = _runs(here, [variant])
        least = min(t.min_gamma for s in runs for t in s.run.record.trials if t.min_gamma is not None)
        verdict = holds(least >= 0) if variant == "cone-di" else holds(_grows(low, high), "bounded")
        rows.append(
            measured(
                f"figure-2-right/{variant}",
                verdict,
                runs,
                high,
                slow=slow,
                fast=fast,
                slow_gamma=low.value,
                fast_gamma=high.value,
                least=least,
            )
        )
    return rows


def _slow(here: Sequence[Sweep]) -> list[Measured]:
    """What the text says of the double integrator at low speed."""
    ends = _ends(here, "cone-di", realisation_error)
    if ends is None:
        return []
    (slow, low), (fast, high) = ends
    return [
        measured(
            "slow-error",
            "bounded" if _grows(low, high) else "refuted",
            _runs(here, ["cone-di"], slow, fast),
            low,
            slow=slow,
            fast=fast,
            slow_error=low.value,
            ratio=low.value / high.value,
        )
    ]


def _comparison(here: Sequence[Sweep]) -> list[Measured]:
    rows = []
    if flown := _runs(here, ["cone-ecbf"]):
        ends = [end(s.speed_m_s for s in flown) for end in (min, max)]
        verdict = holds(ends == FASTBRIDGE.row("sweep")[1].limits, "not comparable")
        rows.append(measured("sweep", verdict, flown, slowest=ends[0], fastest=ends[1], speeds=len(flown)))
    for pair, whose in _WHOSE.items():
        speeds = speeds_of(here, here[0].scene, pair) if here else []
        if not speeds:
            continue
        ours, theirs = ([s for w in speeds if (s := find(here, here[0].scene, v, w))] for v in pair)
        found = compare(ours, theirs)
        of, at = [*ours, *theirs], ", ".join(f"{w:g}" for w in speeds)
        for row, ratio, key in (
            ("mean-jerk", found.mean_jerk, "mean_jerk_ratio"),
            ("max-jerk", found.max_jerk, "max_jerk_ratio"),
        ):
            if ratio is not None:
                verdict = below(ratio, _PRINTED[key])
                rows.append(measured(row, verdict, of, ratio, value=ratio.value, whose=whose, speeds=at))
        if found.filter_time:
            verdict = _time_verdict(found.filter_time, _PRINTED["time_ratio"])
            rows.append(measured("filter-time", verdict, of, value=found.filter_time, whose=whose))
    return rows


def _time_verdict(ratio: float, published: float) -> Verdict:
    digit = 0.005  # half of the last printed digit
    if ratio > 1:
        return "refuted"
    if ratio > published + digit:
        return "bounded"
    return "better" if ratio < published - digit else "reproduced"


def _limits(here: Sequence[Sweep]) -> list[Measured]:
    rows = []
    top = max((s.speed_m_s for s in here), default=0.0)
    for variant in ("safer-splat-gated-3m", BASELINE, f"{BASELINE}-tuned", "cone-ecbf", "cone-ecbf-tuned"):
        if not here or (sweep := find(here, here[0].scene, variant, top)) is None:
            continue
        whose = "" if variant.startswith("cone-ecbf") else "-baseline"
        found = mean_estimate(sweep.values(lambda t: t.max_speed_m_s))
        assert found is not None
        rows.append(
            measured(
                f"top-speed{whose}",
                "not comparable",
                [sweep],
                found,
                variant=variant,
                top=top,
                value=found.value,
            )
        )
        good = sum(succeeded(t) for t in sweep.run.record.trials)
        low, high = wilson_interval(good, sweep.flights)
        rows.append(
            measured(
                f"incomplete{whose}",
                holds(good == 0, "refuted" if whose else "better"),
                [sweep],
                (100 * low, 100 * high),
                variant=variant,
                top=top,
                good=good,
                of=sweep.flights,
            )
        )
    for variant, row in _SAFE.items():
        runs = _runs(here, [variant])
        if not runs:
            continue
        hits, of = sum(t.collision for s in runs for t in s.run.record.trials), sum(s.flights for s in runs)
        low, high = wilson_interval(hits, of)
        rows.append(
            measured(
                row,
                holds(hits == 0),
                runs,
                (100 * low, 100 * high),
                variant=variant,
                hits=hits,
                of=of,
                speeds=", ".join(f"{w:g}" for w in sorted({s.speed_m_s for s in runs})),
            )
        )
    return rows


def _outcomes(here: Sequence[Sweep], variant: str) -> str:
    """Goals and collisions of a variant by speed, in words; empty where it was not flown."""
    parts = []
    for sweep in sorted(_runs(here, [variant]), key=lambda s: s.speed_m_s):
        trials = sweep.run.record.trials
        good, hits = sum(succeeded(t) for t in trials), sum(t.collision for t in trials)
        parts.append(f"{good} reached and {hits} collided of {len(trials)} at {sweep.speed_m_s:g} m/s")
    return ", ".join(parts)


def _all_outcomes(here: Sequence[Sweep], variants: Sequence[str]) -> str:
    return "; ".join(f"{v}: {words}" for v in variants if (words := _outcomes(here, v)))


def _programs(here: Sequence[Sweep]) -> list[Measured]:
    return [
        measured(row, "not comparable", _runs(here, variants), flown=words)
        for row, variants in _PROGRAMS.items()
        if (words := _all_outcomes(here, variants))
    ]


def _hardware(here: Sequence[Sweep]) -> list[Measured]:
    split = _runs(here, ["printed-backup-split"])
    rows = _as_in_flight(min(split, key=lambda s: s.speed_m_s)) if split else []
    loops, alone = _all_outcomes(here, _LOOPS), _outcomes(here, "printed-backup-split")
    return [
        *rows,
        measured("rates", "not comparable", _runs(here, _LOOPS), flown=loops or "not flown"),
        measured("collision-free", "not comparable", split, flown=alone or "not flown"),
    ]


def _as_in_flight(sweep: Sweep) -> list[Measured]:
    """The table of Figure 4, of the simulated loop."""
    trials, speed = sweep.run.record.trials, sweep.speed_m_s
    ticks, infeasible = sum(t.steps for t in trials), sum(t.infeasible_steps for t in trials)
    each = mean_estimate([1 - t.infeasible_steps / t.steps for t in trials], bounds=(0.0, 1.0))
    known = each is not None and each.low is not None and each.high is not None
    clear = [t.scene_clearance_m for t in trials if t.scene_clearance_m is not None]
    rows = [
        measured(
            "feasible",
            "not comparable",
            [sweep],
            (100 * each.low, 100 * each.high) if known else None,  # type: ignore[union-attr, operator]
            percent=100 * (ticks - infeasible) / ticks,
            ticks=ticks,
            speed=speed,
        ),
        measured(
            "clearance",
            "not comparable",
            [sweep],
            least_m=min(clear, default=None),
            flights=len(clear),
            speed=speed,
        ),
        measured(
            "speed",
            "not comparable",
            [sweep],
            mean_m_s=sum(t.path_length_m for t in trials) / sum(t.duration_s for t in trials),
            most_m_s=max(t.max_speed_m_s for t in trials),
            speed=speed,
        ),
    ]
    times = [sweep.timing(f"tick_{key}_s") for key in ("mean", "p99", "max")]
    known_times = [1e3 * value for value in times if value is not None]
    if len(known_times) == len(times):
        verdict: Verdict = "bounded" if known_times[1] < 1e3 / _FILTER_HZ else "refuted"
        rows.append(measured("loop-times", verdict, [sweep], times=known_times))
    return rows
