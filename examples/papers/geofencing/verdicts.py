"""What was measured for every row of the geofencing paper (arXiv 2201.04331), with a verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from alula.schemas.parameters.filter_options import GeofenceParameters
from alula.stages.reporting.statistics import difference_estimate, rate
from papers import published
from papers.compared import Measured, Source, Verdict, measured
from papers.geofencing.pendulum import CALM, FILE, MICRO, PROGRAM, REGULATION, SOLVER, Swing
from papers.geofencing.tables import (
    BASE,
    KM_H,
    PILOTS,
    Approach,
    Fenced,
    approach_of,
    find,
    select,
)
from papers.geofencing.ticks import Ticks
from papers.papers import GEOFENCING
from papers.verdicts import above, close, holds, settings, stated

_SAME = 0.05  # relative difference up to which a simulated value counts as reproduced
_SAME_AS_FLIGHT = 0.1
_REST_M_S = 0.1


def paper_rows(
    runs: Sequence[Fenced],
    swings: Sequence[Swing],
    times: Mapping[str, Any],
    teensy_us: float | None = None,
) -> list[Measured]:
    """State for each row of the paper what was measured, and a verdict.

    Rows whose runs are missing are left out.

    Args:
        runs: all runs.
        swings: pendulum flights.
        times: what examples/geofencing/pendulum.py measured.
        teensy_us: time of a tick on a Teensy 4.1 by emulated instructions [us]; None where it is not known.
    """
    return [
        *_settings(),
        *_claims(runs),
        *_theory(runs),
        *_mixing(runs),
        *_pendulum(swings, times),
        *stated(GEOFENCING, "rate-gain", "thrust"),
        *_wall(runs),
        *_fall(runs),
        *stated(GEOFENCING, "hardware"),
        measured("execution-time", "not comparable", teensy_us=teensy_us),
        *stated(GEOFENCING, "rate/hardware", "figure-7c"),
        *_repeated(runs),
        *_beside_the_program(runs),
    ]


def _settings() -> list[Measured]:
    own = GeofenceParameters()
    lengths = {"push_m": own.push_distance_m, "end_m_s": own.end_speed_m_s}
    return [
        measured("backup", "not comparable", **lengths, horizon_s=own.steps * own.step_s),
        settings(GEOFENCING, "rate/setting", [1 / own.tick_s]),
    ]


def _left(row: str, runs: Sequence[Fenced], kept: Verdict) -> Measured:
    """A statement that no flight leaves its fence: `kept` where none does."""
    out = [trial.collision for run in runs for trial in run.record.trials]
    return measured(row, kept if not any(out) else "refuted", runs, rate(out), left=sum(out), of=len(out))


def _first(runs: Sequence[Fenced], scenario: str, variant: str) -> tuple[Fenced, Approach, Ticks] | None:
    run = find(runs, scenario, variant)
    found = None if run is None else approach_of(run)
    return None if run is None or found is None or run.ticks is None else (run, found, run.ticks)


def _claims(runs: Sequence[Fenced]) -> list[Measured]:
    kept = [run for run in select(runs, "wall") if run.record.filter == BASE and not run.left.value]
    held = [KM_H * max(trial.max_speed_m_s for trial in run.record.trials) for run in kept]
    if not held:
        return []
    fast = sum(speed > GEOFENCING.limit("speed") for speed in held)
    words = {"slowest": min(held), "fastest": max(held), "fast": fast, "of": len(held)}
    return [measured("speed", holds(fast > 0), kept, **words), *stated(GEOFENCING, "weight", "figures-1-2")]


def _theory(runs: Sequence[Fenced]) -> list[Measured]:
    guarded = [run for run in runs if run.record.filter == BASE and run.scenario in (PILOTS, "box", "faces")]
    guarded = [run for run in guarded if not run.steps("hand_over") and not run.steps("refused")]
    rows = [_left("proposition-1", guarded, "bounded")] if guarded else []
    rows += stated(GEOFENCING, "theorem-1")
    passed = [run for run in runs if run.record.filter == BASE]
    if passed:
        altered = sum(result.altered_passes for run in passed for result in run.results)
        count = sum(run.steps("passed") for run in passed)
        rows.append(measured("passed", holds(not altered), passed, altered=altered, of=count))
    return rows


def _mixing(runs: Sequence[Fenced]) -> list[Measured]:
    found = _first(runs, "wall", "from-40")
    if found is None:
        return []
    run, a, ticks = found
    share = ticks.regulation[np.isfinite(ticks.regulation)]
    speed = float(np.linalg.norm(ticks.velocity[-1]))
    rests = 0 < share[-1] < 1 and speed < _REST_M_S
    ends = {"far": float(share[0]), "least": a.min_lambda, "last": float(share[-1])}
    at = {"rest_m": a.rest_m + run.radius_m, "speed_m_s": speed}
    return [measured("figure-3", holds(share[0] > 0.9 and rests), [run], **ends, **at)]


def _pendulum(swings: Sequence[Swing], measured_times: Mapping[str, Any]) -> list[Measured]:
    times = {name.removesuffix(MICRO): float(value) for name, value in measured_times["times"].items()}
    base, program = times[REGULATION], times[PROGRAM]
    solvers = "; ".join(
        f"{name.removeprefix(SOLVER)} {(program + value) / base:.3g}"
        for name, value in times.items()
        if name.startswith(SOLVER)
    )
    ratio = {"program": program / base, "solvers": solvers}
    rows = [measured("order-of-magnitude", "bounded", [FILE], **ratio)]
    arrived = [s for s in swings if s.arrival_s is not None]
    regulated, solved = ([s for s in arrived if s.rule == rule] for rule in (REGULATION, PROGRAM))
    if not regulated or not solved:
        return rows
    rough = sum(s.chatter >= CALM for s in solved)
    smooth = [s for s in regulated if s.chatter < CALM]
    settled = max((s.settled_rad for s in smooth), default=None)
    return [
        *rows,
        measured("oscillation", holds(rough > 0), rough=rough, of=len(solved), calm=CALM, **_chatter(solved)),
        measured(
            "no-oscillation",
            holds(len(smooth) == len(regulated)),
            smooth=len(smooth),
            of=len(regulated),
            **_chatter(regulated),
        ),
        measured("figure-4", "not comparable", settled_rad=settled),
    ]


def _chatter(swings: Sequence[Swing]) -> dict[str, float]:
    values = [s.chatter for s in swings]
    return {"least": min(values), "most": max(values)}


def _wall(runs: Sequence[Fenced]) -> list[Measured]:
    found = _first(runs, "wall", "from-40")
    if found is None:
        return []
    run, a, _ = found
    centre, peak = a.least_m + run.radius_m, a.peak_km_h
    beside = (_first(runs, "wall", name) for name in ("from-36", "from-40"))
    slower = [[b.braking_m + r.radius_m, b.peak_km_h] for r, b, _ in filter(None, beside)]

    printed, steep = published.GEOFENCING["wall"], GEOFENCING.limit("flown-tilt")

    def same(of: str, key: str, values: Sequence[float], limit: float = _SAME) -> Verdict:
        return holds(any(close(value, printed[of][key], limit) for value in values), "not comparable")

    return [
        measured("simulated-peak", same("simulation", "peak_km_h", [peak]), [run], peak_km_h=peak),
        measured(
            "simulated-minimum",
            "bounded" if a.least_m >= 0 else "refuted",
            [run],
            centre_m=centre,
            least_m=a.least_m,
        ),
        measured("flown-peak", same("flight", "peak_km_h", [peak], _SAME_AS_FLIGHT), [run], peak_km_h=peak),
        measured(
            "flown-braking",
            same("flight", "braking_m", [distance for distance, _ in slower]),
            [find(runs, "wall", "from-36"), run],
            braking=slower,
        ),
        measured("flown-tilt", holds(a.tilt_deg > steep), [run], tilt_deg=a.tilt_deg),
        measured("flown-minimum", "not comparable", [run], centre_m=centre),
        *stated(GEOFENCING, "flown-rates"),
    ]


def _fall(runs: Sequence[Fenced]) -> list[Measured]:
    found = _first(runs, "fall", "fall")
    if found is None:
        return []
    run, a, _ = found
    others = {name: f for name in ("gentle", "drag") if (f := _first(runs, "fall", name)) is not None}
    made_of = [run, *(find(runs, "fall", name) for name in ("gentle", "drag"))]
    gentle, drag = others.get("gentle"), others.get("drag")
    peak = {
        "peak_km_h": a.peak_km_h,
        "beside": [[other.peak_km_h, name] for name, (_, other, _) in others.items()] or None,
    }
    rest = {
        "rest_m": a.rest_m + run.radius_m,
        "gentle_m": None if gentle is None else gentle[1].rest_m + gentle[0].radius_m,
    }
    braking = a.braking_m + run.radius_m
    rows = [
        measured("simulated-fall", "not comparable", made_of, **peak, braking_m=braking),
        measured("simulated-hover", "not comparable", made_of, **rest),
        measured("flown-fall", "not comparable", made_of, **peak),
        measured("flown-stop", "not comparable", made_of, **rest),
        measured("recovery", holds(a.least_m >= 0), [run], least_m=a.least_m),
    ]
    if drag is not None:
        less = a.peak_km_h - drag[1].peak_km_h
        verdict: Verdict = "not comparable" if less > 0 else "refuted"
        rows.append(measured("drag", verdict, [run, drag[0]], less_km_h=less))
    return rows


def _repeated(runs: Sequence[Fenced]) -> list[Measured]:
    rows = []
    run = find(runs, "engaged", "geofence")
    if run is not None and run.results:
        results, trials = run.results, run.record.trials
        zero = rate(result.backup_steps > 0 for result in results)
        again = sum(result.interventions > 1 for result in results)
        engaged = {"engagements": sum(r.interventions for r in results), "flights": len(results)}
        rows += [
            measured(
                "figure-8",
                holds(not run.left.value),
                [run],
                run.left,
                **engaged,
                speed_km_h=KM_H * max(trial.max_speed_m_s for trial in trials),
                left=sum(trial.collision for trial in trials),
                of=run.left.n,
            ),
            measured("away-again", holds(again > 0), [run], again=again, of=len(results)),
            measured(
                "lambda-positive",
                holds(not zero.value),
                [run],
                zero,
                zero=zero.value,
                of=zero.n,
                longest_s=max(r.longest_backup_s for r in results),
            ),
        ]
    silent = [run for name in ("silent", "radio-1s") if (run := find(runs, "box", name)) is not None]
    return [*rows, _left("radio", silent, "reproduced")] if silent else rows


def _beside_the_program(runs: Sequence[Fenced]) -> list[Measured]:
    """What the text says of the filter beside the program, and of rule (19) beside (10)."""
    rows = []
    ours, program = (find(runs, "filters", name) for name in (BASE, "backup-qp"))
    if ours is not None and program is not None:
        speeds = [[t.path_length_m / t.duration_s for t in run.record.trials] for run in (ours, program)]
        gap = difference_estimate(speeds[1], speeds[0])
        if gap is not None:
            made_of: list[Source] = [ours, program]
            verdict = above(gap, 0, "not comparable")
            rows.append(measured("along-the-boundary", verdict, made_of, gap, faster_m_s=gap.value))
    new, old = (_first(runs, "wall", name) for name in ("from-40", "from-40-rule-10"))
    if new is not None and old is not None:
        (run, a, _), (other, b, _) = new, old
        rows.append(
            measured(
                "high-speed",
                holds(a.rest_m < b.rest_m, "not comparable"),
                [run, other],
                rest_m=a.rest_m,
                other_rest_m=b.rest_m,
                least_m=a.least_m,
                other_least_m=b.least_m,
            )
        )
    return rows
