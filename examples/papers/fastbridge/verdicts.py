"""Every table, figure and number of FastBridge with ours beside it and a verdict, from sweeps of runs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from alula.stages.reporting.statistics import Estimate, mean_estimate
from alula.stages.reporting.table import Table
from papers.fastbridge.rows import (
    above,
    ends_of,
    flights_span,
    goals,
    outcomes,
    row_of,
    runs_of,
    share,
    span,
)
from papers.fastbridge.sweeps import (
    Comparison,
    Sweep,
    compare,
    find,
    realisation_error,
    speeds_of,
)
from papers.fastbridge.tables import BASELINE, SAME_RADIUS, TUNED
from papers.fastbridge.theory import equations, propositions
from papers.published import FASTBRIDGE
from papers.settings import settings_rows
from papers.verdicts import PaperRow, exact, lower_is_better

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
_HARDWARE = "needs the vehicle, its radio link and the motion capture"
_OTHER_SCENE = "the paper's scene of 395,000 Gaussians is not public"


def verdict_rows(sweeps: Sequence[Sweep], scene: str, feasibility: Table) -> list[PaperRow]:
    """List the published values, ours and the verdicts, in the order of the paper.

    Args:
        sweeps: all runs.
        scene: the one whose flights are compared.
        feasibility: the table of Proposition 3.
    """
    here = [sweep for sweep in sweeps if sweep.scene == scene]
    return [
        *settings_rows("fastbridge"),
        *equations(),
        *propositions(feasibility),
        *_gap(here),
        *_slow(here),
        *_comparison(here),
        *_limits(here),
        *_programs(here),
        *_hardware(here),
    ]


def _gap(here: Sequence[Sweep]) -> list[PaperRow]:
    rows = []
    for variant, claim in (
        ("ideal-di", "0 by construction"),
        ("cone-di", "grows rapidly with the speed"),
        ("cone-ecbf", "near zero at every speed"),
        ("cone-backup", "not in the figure"),
    ):
        ends = ends_of(here, variant, realisation_error)
        if ends is None:
            continue
        (slow, low), (fast, high) = ends
        grows = above(high, low)
        verdict = {
            "ideal-di": "reproduced" if high.value == 0 else "refuted",
            "cone-di": "reproduced" if grows else "refuted",
            "cone-ecbf": "refuted" if grows else "reproduced",
            "cone-backup": "not comparable",
        }[variant]
        why = {
            "ideal-di": "",
            "cone-di": "",
            "cone-ecbf": _against(here, fast, high),
            "cone-backup": "the paper measures two of its filters",
        }[variant]
        rows.append(
            row_of(
                "Figure 2, left",
                f"peak |e_a| of {variant} [m/s²]",
                claim,
                f"{exact(low.value, '.3g')} at {slow:g} m/s, {exact(high.value, '.3g')} at {fast:g} m/s",
                verdict,
                why,
                span(high),
                flown=runs_of(here, variant, slow, fast),
            )
        )
    for variant, claim in (
        ("cone-di", "almost no margin, never below 0"),
        ("cone-ecbf", "above that of the double integrator, grows with the speed"),
    ):
        ends = ends_of(here, variant, lambda t: t.min_gamma)
        if ends is None:
            continue
        (slow, low), (fast, high) = ends
        flown = [t.min_gamma for s in here if s.variant == variant for t in s.run.record.trials]
        least = min(g for g in flown if g is not None)
        if variant == "cone-di":
            verdict, why = (
                ("reproduced", "") if least >= 0 else ("refuted", "inside a grown ellipsoid at speed")
            )
        else:
            verdict = "reproduced" if above(high, low) else "bounded"
            why = "" if above(high, low) else "above that of cone-di; it does not grow with the speed"
        rows.append(
            row_of(
                "Figure 2, right",
                f"minimum γ of {variant}",
                claim,
                f"mean {exact(low.value, '.3g')} at {slow:g} m/s, {exact(high.value, '.3g')} at {fast:g} "
                "m/s; "
                f"of all {exact(least, '.3g')}",
                verdict,
                why,
                span(high),
                flown=runs_of(here, variant),
            )
        )
    return rows


def _slow(here: Sequence[Sweep]) -> list[PaperRow]:
    """What the text says of the double integrator at low speed."""
    ends = ends_of(here, "cone-di", realisation_error)
    if ends is None:
        return []
    (slow, low), (fast, high) = ends
    return [
        row_of(
            "IV-A",
            "the error of the double integrator is small at low speed",
            "below 1 m/s",
            f"{exact(low.value, '.3g')} m/s² at {slow:g} m/s, {exact(low.value / high.value, '.2f')} of that "
            "at "
            f"{fast:g} m/s",
            "bounded" if above(high, low) else "refuted",
            "the slowest speed of the paper's sweep; it prints no error",
            span(low),
            flown=runs_of(here, "cone-di", slow, fast),
        )
    ]


def _comparison(here: Sequence[Sweep]) -> list[PaperRow]:
    p = FASTBRIDGE["comparison"]
    rows = []
    if flown := runs_of(here, "cone-ecbf"):
        low, high = (end(s.speed_m_s for s in flown) for end in (min, max))
        rows.append(
            row_of(
                "IV-B",
                "setting: peak speeds of the reference",
                "1.1 to 5.1 m/s",
                f"{exact(low)} to {exact(high)} m/s",
                "reproduced" if (low, high) == (1.1, 5.1) else "not comparable",
                f"{len(flown)} speeds",
                flown=flown,
            )
        )
    for pair, whose in _WHOSE.items():
        speeds = speeds_of(here, here[0].scene, pair) if here else []
        if not speeds:
            continue
        ours, theirs = ([s for w in speeds if (s := find(here, here[0].scene, v, w))] for v in pair)
        found = compare(ours, theirs)
        at = f"{', '.join(f'{w:g}' for w in speeds)} m/s"
        for words, value, published in (
            ("mean jerk, ratio", found.mean_jerk, p["mean_jerk_ratio"]),
            ("max jerk, ratio", found.max_jerk, p["max_jerk_ratio"]),
        ):
            if value is not None:
                rows.append(
                    row_of(
                        "Abstract, Figure 3",
                        words,
                        f"× {published:g}",
                        f"× {exact(value.value, '.2f')}",
                        lower_is_better(value, published),
                        f"{whose}; {at}",
                        span(value),
                        flown=[*ours, *theirs],
                    )
                )
        if found.filter_time:
            rows.append(_time_row(found, whose, p["time_ratio"], [*ours, *theirs]))
    return rows


def _time_row(found: Comparison, whose: str, published: float, flown: Sequence[Sweep]) -> PaperRow:
    assert found.filter_time is not None
    ratio, digit = found.filter_time, 0.005  # half of the last printed digit
    if ratio > 1:
        verdict = "refuted"
    elif ratio > published + digit:
        verdict = "bounded"
    else:
        verdict = "better" if ratio < published - digit else "reproduced"
    return row_of(
        "Abstract, Figure 3",
        "time of the filter, ratio",
        f"× {published:.2f} (2.25 times as fast)",
        f"× {exact(ratio, '.2f')}",
        verdict,
        f"{whose}; both native, on one thread of one machine",
        flown=flown,
    )


def _limits(here: Sequence[Sweep]) -> list[PaperRow]:
    if not here:
        return []
    rows = []
    p = FASTBRIDGE["comparison"]
    top = max(s.speed_m_s for s in here)
    for variant, key in (
        ("safer-splat-gated-3m", "baseline_top_speed_m_s"),
        (BASELINE, "baseline_top_speed_m_s"),
        (f"{BASELINE}-tuned", "baseline_top_speed_m_s"),
        ("cone-ecbf", "top_speed_m_s"),
        ("cone-ecbf-tuned", "top_speed_m_s"),
    ):
        if (sweep := find(here, here[0].scene, variant, top)) is None:
            continue
        found = mean_estimate(sweep.values(lambda t: t.max_speed_m_s))
        assert found is not None
        rows.append(
            row_of(
                "IV-B, Figure 3",
                f"top speed of {variant} at a reference of {top:g} m/s",
                f"{p[key]:g} m/s",
                f"{exact(found.value, '.2f')} m/s",
                "not comparable",
                "a barrier on the distance bounds the speed by the free distance, which is the scene's",
                span(found),
                flown=[sweep],
            )
        )
        good, count = goals(sweep)
        rows.append(
            row_of(
                "IV-B, Figure 3",
                f"goals of {variant} at a reference of {top:g} m/s",
                "none beyond about 5 m/s",
                f"{good} of {count}",
                "reproduced" if good == 0 else "better" if key == "top_speed_m_s" else "refuted",
                "in time and without a collision",
                share(good, count),
                flown=[sweep],
            )
        )
    for variant in (
        *("safer-splat-gated", "safer-splat-gated-3m", "safer-splat-gated-cones", "safer-splat-gated-tuned"),
        *(BASELINE, f"{BASELINE}-tuned"),
        *("cone-ecbf", "cone-ecbf-tuned", "printed-ecbf-14-clf"),
    ):
        flown = [t for s in here if s.variant == variant for t in s.run.record.trials]
        if not flown:
            continue
        hits = sum(t.collision for t in flown)
        speeds = ", ".join(f"{w:g}" for w in sorted({s.speed_m_s for s in here if s.variant == variant}))
        rows.append(
            row_of(
                "IV-B",
                f"collisions of {variant} at {speeds} m/s",
                "none",
                f"{hits} of {len(flown)} flights",
                "reproduced" if hits == 0 else "refuted",
                "exact clearance of the flown path",
                share(hits, len(flown)),
                flown=runs_of(here, variant),
            )
        )
    return rows


def _programs(here: Sequence[Sweep]) -> list[PaperRow]:
    """The readings of the programs that the paper leaves open."""
    rows = []
    for item, quantity, variants in (
        ("III-D, eq. 16", "λ of the triple pole, without the CLF", _printed("4", "14", "20")),
        ("IV, CLF", "the same with the CLF of every program", _printed("4-clf", "14-clf", "20-clf")),
        ("IV, CLF", "a weight of 1 instead of 1,000 on its slack", _printed("14-clf-weak")),
        (
            "III-D, eq. 14",
            "finite-difference thrust cascade, without and with the CLF",
            _printed("14-difference", "14-difference-clf"),
        ),
        (
            "III-E, d",
            "d = (2, 3, 0.3, 0.05) as printed, without and with the CLF",
            ("printed-backup-d", "printed-backup-d-clf"),
        ),
        (
            "III-E, d",
            "d = (2, 0.3, 0.3, 0.05), without and with the CLF",
            ("printed-backup", "printed-backup-clf"),
        ),
        ("IV, CLF", "ours with the CLF", ("cone-di-clf", "cone-ecbf-clf", "cone-backup-clf")),
    ):
        parts = [f"{v}: {words}" for v in variants if (words := outcomes(here, v))]
        if parts:
            rows.append(
                row_of(
                    item,
                    quantity,
                    "no number",
                    "; ".join(parts),
                    "not comparable",
                    "the paper prints neither λ nor the CLF's weight, and no flight of either reading",
                    flown=runs_of(here, variants),
                )
            )
    return rows


def _hardware(here: Sequence[Sweep]) -> list[PaperRow]:
    f = FASTBRIDGE["flight"]
    found = next(
        (s for s in sorted(here, key=lambda s: s.speed_m_s) if s.variant == "printed-backup-split"), None
    )
    rows = []
    if found is not None:
        trials = found.run.record.trials
        ticks, infeasible = sum(t.steps for t in trials), sum(t.infeasible_steps for t in trials)
        whose = f"simulated: the paper's backup program, 30/10/50 Hz, body rates, {found.speed_m_s:g} m/s"
        clear = [t.scene_clearance_m for t in trials if t.scene_clearance_m is not None]
        seconds = sum(t.duration_s for t in trials)
        rows = [
            row_of(
                "Figure 4, table",
                "feasible ticks",
                f"{100 * f['feasible']:.1f} % of {f['ticks']:,.0f}",
                f"{exact(100 * (ticks - infeasible) / ticks, '.1f')} % of {ticks:,}",
                "not comparable",
                f"{whose}; another scene and another path. Ticks of a flight are not independent",
                flights_span([1 - t.infeasible_steps / t.steps for t in trials]),
                flown=[found],
            ),
            row_of(
                "Figure 4, table",
                "minimum clearance",
                f"{f['min_clearance_m']:g} m",
                f"{exact(min(clear), '.3g')} m over {len(clear)} flights" if clear else "",
                "not comparable",
                f"{whose}; one flight against {len(clear)} through a furnished room",
                flown=[found],
            ),
            row_of(
                "Figure 4, table",
                "mean and maximum speed",
                f"{f['mean_speed_m_s']:g} and {f['max_speed_m_s']:g} m/s",
                f"{exact(sum(t.path_length_m for t in trials) / seconds, '.3g')} and "
                f"{exact(max(t.max_speed_m_s for t in trials), '.3g')} m/s",
                "not comparable",
                whose,
                flown=[found],
            ),
        ]
        mean, p99, most = (found.timing(f"tick_{key}_s") for key in ("mean", "p99", "max"))
        if mean is not None and p99 is not None and most is not None:
            rows.append(
                row_of(
                    "Figure 4, table",
                    "loop mean, p99 and max",
                    f"{f['loop_mean_us'] / 1e3:.1f}, {f['loop_p99_us'] / 1e3:.1f}, "
                    f"{f['loop_max_us'] / 1e3:.1f} ms",
                    f"{', '.join(exact(1e3 * value, '.2g') for value in (mean, p99, most))} ms",
                    "bounded" if 1e3 * p99 < 1e3 / 30 else "refuted",
                    "30 Hz leave 33 ms, which 99 % of the loops keep; other machines and another solver, so "
                    "only the limit compares",
                    flown=[found],
                )
            )
    rows += [
        row_of(
            "Figure 4, IV-C",
            "30 Hz filter, 10 Hz gate, 50 Hz controller, body rates",
            "one flight, stopped by hand",
            "; ".join(f"{v}: {words}" for v in _LOOPS if (words := outcomes(here, v))) or "not flown",
            "not comparable",
            "simulated; -rates: body rates at 100 Hz, -split: the rates of the hardware too",
            flown=runs_of(here, _LOOPS),
        ),
        row_of(
            "V",
            "the backup filter flies without a collision in real time",
            "one flight",
            outcomes(here, "printed-backup-split") or "not flown",
            "not comparable",
            "ours is simulated, in another scene, with more flights; the paper's policy as printed",
            flown=runs_of(here, "printed-backup-split"),
        ),
        row_of(
            "Figure 4, table",
            "loop overruns, termination",
            "1 of 822, by hand",
            "",
            "not available here",
            _HARDWARE,
        ),
        row_of(
            "IV-C",
            "backup CBF in SITL",
            "omitted in the paper",
            "",
            "not available here",
            "no number is printed",
        ),
        row_of(
            "IV",
            "scene of 395,000 Gaussians",
            "trained by the authors",
            "",
            "not available here",
            _OTHER_SCENE,
        ),
        row_of(
            "Figure 3, left",
            "paths from above",
            "one pair of points",
            "a figure of the report: one pair, three filters",
            "not comparable",
            _OTHER_SCENE,
        ),
        row_of("Figure 1", "architecture", "a drawing", "", "not comparable", "no number"),
    ]
    return rows


def _printed(*names: str) -> tuple[str, ...]:
    return tuple(f"printed-ecbf-{name}" for name in names)


def _against(here: Sequence[Sweep], speed: float, high: Estimate) -> str:
    other = next((s for s in here if (s.variant, s.speed_m_s) == ("cone-di", speed)), None)
    if other is None:
        return ""
    values = other.values(realisation_error)
    share = high.value / float(np.mean(values[np.isfinite(values)]))
    return f"{100 * share:.0f} % of that of cone-di at this speed"
