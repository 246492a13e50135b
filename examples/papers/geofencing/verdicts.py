"""Verdicts on every figure and number of the geofencing paper (arXiv 2201.04331)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from alula.schemas.fence_ticks import Ticks
from alula.stages.reporting.statistics import Rate, difference_estimate, rate
from papers.geofencing.pendulum import MICRO, PROGRAM, REGULATION, SOLVER, Swing
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
from papers.settings import settings_rows
from papers.verdicts import PaperRow, exact

_SAME = 0.05  # relative difference up to which a simulated value counts as reproduced
_REST_M_S = 0.1
_CHATTER = 1.0  # [rad/s^2 per s] below it the pendulum's input is smooth
_ONE = "one flight without random numbers: no interval"
_HARDWARE = "a real flight"
_BETA = (
    "β of the fall is not printed. A fall without drag that peaks at 70 km/h is one of 19.3 m, so the filter "
    "braked far above its barrier; with the β = 1.5 of the published flight code it brakes as late as it can"
)


def paper_rows(
    runs: Sequence[Fenced],
    swings: Sequence[Swing],
    measured: Mapping[str, Any],
    teensy_us: float | None = None,
) -> list[PaperRow]:
    """State for each item of the paper what was published, our value, its interval and a verdict.

    Items whose runs are missing are left out.

    Args:
        runs: all runs.
        swings: pendulum flights.
        measured: times measured by examples/geofencing/pendulum.py.
        teensy_us: time of a tick on a Teensy 4.1 by emulated instructions [us]; None where it is not known.
    """
    return [
        *settings_rows("geofencing"),
        *_claims(runs),
        *_theory(runs),
        *_mixing(runs),
        *_pendulum(swings, measured),
        *_modelling(),
        *_wall(runs),
        *_fall(runs),
        *_hardware(teensy_us),
        *_repeated(runs),
        *_beside_the_program(runs),
    ]


def _row(item: str, quantity: str, published: str, ours: str, verdict: str, why: str = "") -> PaperRow:
    return PaperRow(item, quantity, published, ours, "", verdict, why)


def _from(row: PaperRow, *runs: Fenced | None) -> PaperRow:
    """The row with the runs that it is made from."""
    flown = [run for run in runs if run is not None]
    if not flown:
        return row
    files = [f"{run.scenario}/{run.variant}.run.mcap" for run in flown]
    return row.made_from(files, sum(len(run.record.trials) for run in flown))


def _interval(found: Rate) -> str:
    return "" if found.low is None else f"{exact(found.low)} to {exact(found.high)} % of {found.n:,}"


def _first(runs: Sequence[Fenced], scenario: str, variant: str) -> tuple[Fenced, Approach, Ticks] | None:
    run = find(runs, scenario, variant)
    found = None if run is None else approach_of(run)
    return None if run is None or found is None or run.ticks is None else (run, found, run.ticks)


def _close(value: float, published: float, limit: float = _SAME) -> bool:
    return abs(value - published) <= limit * published


def _claims(runs: Sequence[Fenced]) -> list[PaperRow]:
    kept = [run for run in select(runs, "wall") if run.record.filter == BASE and not run.left.value]
    held = [KM_H * max(trial.max_speed_m_s for trial in run.record.trials) for run in kept]
    if not held:
        return []
    fast = sum(speed > 100 for speed in held)
    return [
        _from(
            PaperRow(
                "abstract",
                "speeds at which the drone is held",
                "above 100 km/h",
                f"{exact(min(held))} to {exact(max(held))} km/h, {fast} of {len(held)} approaches above 100",
                _ONE,
                "reproduced" if fast else "refuted",
                "in simulation, with the vehicle as modelled",
            ),
            *kept,
        ),
        _row("abstract", "weight of the microcontroller", "10 g", "", "not available here", "hardware"),
        _row("Figures 1 and 2", "illustrations", "no numbers", "", "not comparable", "nothing is measured"),
    ]


def _theory(runs: Sequence[Fenced]) -> list[PaperRow]:
    guarded = [run for run in runs if run.record.filter == BASE and run.scenario in (PILOTS, "box", "faces")]
    guarded = [run for run in guarded if not run.steps("hand_over") and not run.steps("refused")]
    rows = []
    if guarded:
        out = rate(trial.collision for run in guarded for trial in run.record.trials)
        left = sum(trial.collision for run in guarded for trial in run.record.trials)
        rows.append(
            _from(
                PaperRow(
                    "Proposition 1",
                    "flights that leave the safe set",
                    "none, in continuous time",
                    f"{left} of {out.n:,} random flights",
                    _interval(out),
                    "refuted" if left else "bounded",
                    "a filter in ticks needs conditions that the paper does not state: the horizon reaches "
                    "rest "
                    "and β D / v_c ≤ 1 (geofence.md); what violates them is refused, the rest is sampled",
                ),
                *guarded,
            )
        )
    rows.append(
        _row(
            "Theorem 1",
            "continuity of the filter",
            "locally Lipschitz",
            "λ changes by less than 0.02 in 5 mm of an approach at 12 m/s",
            "bounded",
            "a test of one approach, test_the_command_is_a_continuous_function_of_the_position",
        )
    )
    passed = [run for run in runs if run.record.filter == BASE]
    if passed:
        count = sum(run.steps("passed") for run in passed)
        altered = sum(result.altered_passes for run in passed for result in run.results)
        rows.append(
            _from(
                _row(
                    "III-B",
                    "the pilot's command where λ is 1",
                    "passed exactly",
                    f"{altered} of {count:,} differ in a bit",
                    "refuted" if altered else "reproduced",
                    "λ rounds to 1 far from the fence only",
                ),
                *passed,
            )
        )
    return rows


def _mixing(runs: Sequence[Fenced]) -> list[PaperRow]:
    found = _first(runs, "wall", "from-40")
    if found is None:
        return []
    run, a, ticks = found
    share = ticks.regulation[np.isfinite(ticks.regulation)]
    speed = float(np.linalg.norm(ticks.velocity[-1]))
    rests = 0 < share[-1] < 1 and speed < _REST_M_S
    return [
        _from(
            PaperRow(
                "Figure 3",
                "mixing λ (9) on the way to a wall",
                "1 far away, decreases, steady between 0 and 1 where the drone stops",
                f"{exact(float(share[0]))} at 40 m, minimum {exact(a.min_lambda)}, "
                f"at last {exact(float(share[-1]))} at {exact(a.rest_m + run.radius_m)} m of the centre, "
                "where the "
                f"speed is {exact(speed)} m/s",
                _ONE,
                "reproduced" if share[0] > 0.9 and rests else "refuted",
                "the figure has no numbers",
            ),
            run,
        )
    ]


def _pendulum(swings: Sequence[Swing], measured: Mapping[str, Any]) -> list[PaperRow]:
    times = {name.removesuffix(MICRO): float(value) for name, value in measured["times"].items()}
    base, program = times[REGULATION], times[PROGRAM]
    others = {name: (program + value) / base for name, value in times.items() if name.startswith(SOLVER)}
    general = "; ".join(f"{name.removeprefix(SOLVER)} {value:.3g}" for name, value in others.items())
    rows = [
        _row(
            "Figure 4, III-C",
            "time of the program over that of the regulation function",
            "an order of magnitude",
            f"{program / base:.3g} with our program; all rows in a general solver: {general}",
            "bounded",
            "the paper's solver is not named; the ratio depends on it",
        ).made_from(["pendulum.json"])
    ]

    def chatter(rule: str, good: Callable[[float], bool]) -> list[Swing]:
        return [s for s in swings if s.rule == rule and s.arrival_s is not None and good(s.chatter)]

    smooth, rough = chatter(REGULATION, lambda c: c < _CHATTER), chatter(PROGRAM, lambda c: c >= _CHATTER)
    of_smooth, of_rough = chatter(REGULATION, lambda _: True), chatter(PROGRAM, lambda _: True)
    if of_rough and of_smooth:
        rows += [
            _row(
                "Figure 4, III-C",
                "the program oscillates at high gains",
                "yes",
                f"at {len(rough)} of {len(of_rough)} gains and ticks, chatter {_span(of_rough)} rad/s² per s",
                "reproduced" if rough else "refuted",
                f"below {_CHATTER:g} rad/s² per s counts as smooth",
            ),
            _row(
                "Figure 4, III-C",
                "the regulation function does not",
                "never",
                f"smooth at {len(smooth)} of {len(of_smooth)} gains and ticks, chatter "
                f"{_span(of_smooth)} rad/s² per s",
                "reproduced" if len(smooth) == len(of_smooth) else "refuted",
                "it oscillates where β times the decrease in a tick is above 1: at the highest gains",
            ),
            _row(
                "Figure 4, eqs. 11 to 14",
                "angle, rate and input over time",
                "curves without numbers",
                f"settles at {exact(max(s.settled_rad for s in smooth))} of 1 rad" if smooth else "",
                "not comparable",
                "the backup controller (12) and the gains are not printed",
            ),
        ]
    return rows


def _span(swings: Sequence[Swing]) -> str:
    values = [s.chatter for s in swings]
    return f"{exact(min(values))} to {exact(max(values))}"


def _modelling() -> list[PaperRow]:
    return [
        _row(
            "IV-A, eq. 15",
            "gain C of the rate loop",
            "on the order of 50 1/s",
            "67.7 1/s after 6.1 ms, of Betaflight's firmware (betaflight.md)",
            "reproduced",
            "with an assumed body and assumed motors",
        ),
        _row(
            "IV-A",
            "thrust by throttle, fitted to accelerometer and GPS",
            "a polynomial of second order",
            "that of the published flight code",
            "not available here",
            "its flight data are not published",
        ),
    ]


def _wall(runs: Sequence[Fenced]) -> list[PaperRow]:
    found = _first(runs, "wall", "from-40")
    if found is None:
        return []
    run, a, _ = found
    centre = a.least_m + run.radius_m
    beside = (_first(runs, "wall", name) for name in ("from-36", "from-40"))
    slower = [(b.peak_km_h, b.braking_m + r.radius_m) for r, b, _ in filter(None, beside)]
    inside = a.least_m >= 0
    pilot = "the pilot's commands are not printed; pitched by 72° here"
    return [
        _from(
            PaperRow(
                "Figure 5a",
                "peak speed, simulation",
                "107 km/h",
                f"{exact(a.peak_km_h)} km/h",
                _ONE,
                "reproduced" if _close(a.peak_km_h, 107) else "not comparable",
                pilot,
            ),
            run,
        ),
        _from(
            PaperRow(
                "Figure 5a",
                "minimum distance, simulation",
                "0.12 m",
                f"{exact(centre)} m of the centre, {exact(a.least_m)} m of the sphere",
                _ONE,
                "bounded" if inside else "refuted",
                "inside in both; the paper's radius and margins are not printed",
            ),
            run,
        ),
        _from(
            PaperRow(
                "Figure 7a, test 1",
                "peak speed, flight",
                "104 km/h",
                f"{exact(a.peak_km_h)} km/h, simulated",
                _ONE,
                "reproduced" if _close(a.peak_km_h, 104, 0.1) else "not comparable",
                f"{_HARDWARE}; {pilot}",
            ),
            run,
        ),
        _from(
            PaperRow(
                "Figure 7a, test 1",
                "distance at which it brakes, flight",
                "15 m",
                f"{', '.join(f'{exact(d)} m at {exact(v)} km/h' for v, d in slower)}, simulated",
                _ONE,
                "reproduced" if any(_close(d, 15) for _, d in slower) else "not comparable",
                "of the centre, at the peak speed; without drag",
            ),
            find(runs, "wall", "from-36"),
            run,
        ),
        _from(
            PaperRow(
                "Figures 7a and 7c, test 1",
                "tilt while braking, flight",
                "nearly 90°",
                f"{exact(a.tilt_deg)}°, simulated",
                _ONE,
                "reproduced" if a.tilt_deg > 80 else "refuted",
                "the backup controller's limit is 85.7°",
            ),
            run,
        ),
        _from(
            PaperRow(
                "Figure 7a, test 1",
                "minimum distance, flight",
                "1.7 m",
                f"{exact(centre)} m of the centre, simulated",
                _ONE,
                "not comparable",
                f"{_HARDWARE}; drag, the reserve and the pilot's push at the wall are not printed",
            ),
            run,
        ),
        _row(
            "Figure 7a, test 1",
            "tracking of the rates, flight",
            "very accurate, a slight delay",
            "0.17 rad/s RMS through Betaflight's firmware (betaflight.md)",
            "not comparable",
            f"{_HARDWARE}; the paper has a plot without numbers",
        ),
    ]


def _fall(runs: Sequence[Fenced]) -> list[PaperRow]:
    found = _first(runs, "fall", "fall")
    if found is None:
        return []
    run, a, _ = found
    others = {name: _first(runs, "fall", name) for name in ("gentle", "drag")}
    peaks = ", ".join(f"{exact(f[1].peak_km_h)} `{name}`" for name, f in others.items() if f is not None)
    beside = f" ({peaks})" if peaks else ""
    rest = f"{exact(a.rest_m + run.radius_m)} m of the centre"
    if (gentle := others["gentle"]) is not None:
        rest += f", {exact(gentle[1].rest_m + gentle[0].radius_m)} `gentle`"
    rows = [
        _from(
            PaperRow(
                "Figure 5b",
                "peak speed of the fall from 70 m, simulation",
                "70 km/h",
                f"{exact(a.peak_km_h)} km/h{beside}",
                _ONE,
                "not comparable",
                f"{_BETA}, {exact(a.braking_m + run.radius_m)} m above it",
            ),
            run,
            *(find(runs, "fall", name) for name in ("gentle", "drag")),
        ),
        _from(
            PaperRow(
                "Figure 5b",
                "hovers above the barrier, simulation",
                "1.2 m",
                rest,
                _ONE,
                "not comparable",
                "with no throttle the blend settles where the part of u_B hovers, which depends on β",
            ),
            run,
            *(find(runs, "fall", name) for name in ("gentle", "drag")),
        ),
        _from(
            PaperRow(
                "Figure 7b, test 2",
                "vertical speed, flight",
                "60 km/h",
                f"{exact(a.peak_km_h)} km/h, simulated{beside}",
                _ONE,
                "not comparable",
                f"{_HARDWARE}; its drag and β are not printed",
            ),
            run,
            *(find(runs, "fall", name) for name in ("gentle", "drag")),
        ),
        _from(
            PaperRow(
                "Figure 7b, test 2",
                "stops above the barrier, flight",
                "1.3 m (1.8 m above the ground)",
                rest,
                _ONE,
                "not comparable",
                f"{_HARDWARE}; as for Figure 5b",
            ),
            run,
            *(find(runs, "fall", name) for name in ("gentle", "drag")),
        ),
        _from(
            PaperRow(
                "conclusion",
                "recovers from a fall of 70 m",
                "yes",
                f"minimum distance {exact(a.least_m)} m of the sphere",
                _ONE,
                "reproduced" if a.least_m >= 0 else "refuted",
                "",
            ),
            run,
        ),
    ]
    if (drag := others["drag"]) is not None:
        less = a.peak_km_h - drag[1].peak_km_h
        rows.append(
            _from(
                PaperRow(
                    "V-C",
                    "simulation without drag is faster than the flight",
                    "by 10 km/h",
                    f"by {exact(less)} km/h with assumed drag",
                    _ONE,
                    "not comparable" if less > 0 else "refuted",
                    "the sign agrees; the amount depends on the drag, which is not printed",
                ),
                run,
                drag[0],
            )
        )
    return rows


def _hardware(teensy_us: float | None) -> list[PaperRow]:
    count = "" if teensy_us is None else f"{exact(teensy_us)} µs by emulated instructions (onboard.md)"
    return [
        _row(
            "Figure 6, V-A",
            "the drone and its devices",
            "a 7 inch racer, rate loop at 8 kHz, video 25 ms late",
            "",
            "not available here",
            "hardware",
        ),
        _row(
            "V-B",
            "time of an evaluation on a Teensy 4.1",
            "350 µs",
            count,
            "not comparable",
            "instructions are counted and cycles estimated; no device was measured",
        ),
        _row(
            "V-A, V-B",
            "rate of navigation and filter",
            "400 Hz",
            "400 Hz, simulated",
            "not available here",
            "hardware",
        ),
        _row("Figure 7c", "photographs of the flight", "no numbers", "", "not available here", "photographs"),
    ]


def _repeated(runs: Sequence[Fenced]) -> list[PaperRow]:
    rows = []
    run = find(runs, "engaged", "geofence")
    if run is not None and run.results:
        count = sum(result.interventions for result in run.results)
        zero = rate(result.backup_steps > 0 for result in run.results)
        longest = max(result.longest_backup_s for result in run.results)
        again = sum(result.interventions > 1 for result in run.results)
        speed = KM_H * max(trial.max_speed_m_s for trial in run.record.trials)
        rows += [
            _from(
                PaperRow(
                    "Figure 8",
                    "repeated engagements, safety maintained",
                    "4 flights, 2 to 4 engagements each, every time",
                    f"{count:,} engagements in {len(run.results)} flights at up to {exact(speed)} km/h, "
                    f"{sum(t.collision for t in run.record.trials)} left",
                    f"left: {_interval(run.left)}",
                    "refuted" if run.left.value else "reproduced",
                    "simulated",
                ),
                run,
            ),
            _from(
                PaperRow(
                    "IV-B, V-C",
                    "the pilot can fly away from the boundary again",
                    "yes",
                    f"{again} of {len(run.results)} flights engage the fence again after they left it",
                    "",
                    "reproduced" if again else "refuted",
                    "u_B moves away from the boundary, so the blend never stops the drone there for good",
                ),
                run,
            ),
            _from(
                PaperRow(
                    "Figure 8, V-C",
                    "λ never reaches 0",
                    "never, in 4 flights",
                    f"in {exact(zero.value)} % of the flights, for up to {exact(longest)} s",
                    _interval(zero),
                    "refuted" if zero.value else "reproduced",
                    "h_I includes margins, so u_B alone ends a fast approach; the paper's h_I has none",
                ),
                run,
            ),
        ]
    silent = [run for name in ("silent", "radio-1s") if (run := find(runs, "box", name)) is not None]
    if silent:
        out = rate(trial.collision for run in silent for trial in run.record.trials)
        left = sum(trial.collision for run in silent for trial in run.record.trials)
        rows.append(
            _from(
                PaperRow(
                    "abstract, V-C",
                    "safe when the radio fails",
                    "yes",
                    f"{left} of {out.n:,} flights left",
                    _interval(out),
                    "refuted" if left else "reproduced",
                    "simulated",
                ),
                *silent,
            )
        )
    return rows


def _beside_the_program(runs: Sequence[Fenced]) -> list[PaperRow]:
    """What the text says of the filter beside the program, and of rule (19) beside (10)."""
    rows = []
    ours, program = (find(runs, "filters", name) for name in (BASE, "backup-qp"))
    if ours is not None and program is not None:
        speeds = [[t.path_length_m / t.duration_s for t in run.record.trials] for run in (ours, program)]
        gap = difference_estimate(speeds[1], speeds[0])
        if gap is not None:
            known = gap.low is not None and gap.high is not None
            rows.append(
                _from(
                    PaperRow(
                        "III-C",
                        "the program moves faster along the boundary",
                        "stated",
                        f"{exact(gap.value)} m/s faster on average over whole flights",
                        f"{exact(gap.low)} to {exact(gap.high)} m/s" if known else "",
                        "not comparable"
                        if gap.low is None or gap.high is None or gap.low <= 0 <= gap.high
                        else "reproduced"
                        if gap.low > 0
                        else "refuted",
                        "the same pilots; most of a flight is away from the boundary, and the paper prints "
                        "no "
                        "number",
                    ),
                    ours,
                    program,
                )
            )
    new, old = (_first(runs, "wall", name) for name in ("from-40", "from-40-rule-10"))
    if new is not None and old is not None:
        (run, a, _), (other, b, _) = new, old
        nearer = a.rest_m < b.rest_m
        rows.append(
            _from(
                PaperRow(
                    "IV-C, eq. 19",
                    "scaled by the speed, the filter is less conservative near the boundary",
                    "stated",
                    f"stops {exact(a.rest_m)} m from the boundary with (19), {exact(b.rest_m)} m with (10); "
                    f"minimum {exact(a.least_m)} and {exact(b.least_m)} m",
                    _ONE,
                    "reproduced" if nearer else "not comparable",
                    "the same β for both; the paper scales so that a larger β may be used",
                ),
                run,
                other,
            )
        )
    return rows
