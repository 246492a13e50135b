"""The geofencing paper's pendulum: both filters over a sweep of gains, their tables, the program's rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.stages.reporting.table import Table, text
from papers.compared import File
from papers.published import GEOFENCING

REGULATION, PROGRAM = "regulation", "backup-qp"
GAIN = {REGULATION: "beta", PROGRAM: "alpha"}  # the gain of each rule; a larger one approaches faster
PUSH = 2.0  # the constant command of the paper [rad/s^2]
MICRO = " [us]"
SOLVER = "solver "
FILE = File("pendulum.json")  # of the times
CALM = 1.0  # maximum chatter of a calm flight [rad/s^2 per s]
_ARRIVED = 0.95  # of the largest angle
_TAIL = 1 / 3  # last part of a flight, at the boundary


@dataclass(frozen=True, slots=True)
class Pendulum:
    """Parameters of the filters, as in `alula/dynamics/pendulum.hpp`; the paper prints only `end_rate`."""

    largest_angle: float = 1.0
    end_rate: float = 0.1
    k: float = 3.0
    push_distance: float = 0.1
    push_gain: float = 1.0
    push_rate: float = 0.1
    horizon_s: float = 3.0
    steps: int = 100
    beta: float = 15.0
    alpha: float = 5.0
    largest_input: float = 20.0


@dataclass(frozen=True, slots=True)
class Swing:
    """A flight from rest against the boundary.

    `settled_rad`, `ripple_rad` (maximum less minimum angle) and `chatter` (total variation of the input per
    second) are those of its last third. `arrival_s` is the time when it first passed 95 % of the largest
    angle, None if it did not. `unsolved` counts ticks in which the program had no solution.
    """

    rule: str
    gain: float
    tick_s: float
    time_s: FloatArray
    angle: FloatArray
    rate: FloatArray
    input: FloatArray
    settled_rad: float
    greatest_rad: float
    ripple_rad: float
    chatter: float
    arrival_s: float | None
    unsolved: int


def swing(rule: str, gain: float, tick_s: float, duration_s: float = 15.0) -> Swing:
    """Simulate a rule with a gain under the paper's command; the input is held for a tick.

    Args:
        rule: `REGULATION` or `PROGRAM`.
        gain: beta or alpha, see `GAIN`.
        tick_s: length of a tick.
        duration_s: length of the flight.
    """
    is_program = rule == PROGRAM
    made = _core.PendulumFilter(rule, alpha=gain) if is_program else _core.PendulumFilter(rule, beta=gain)
    rows = made.fly(0.0, 0.0, PUSH, tick_s, round(duration_s / tick_s))
    angle, rate, u = rows[:, 0].copy(), rows[:, 1].copy(), rows[:, 2].copy()
    tail = slice(-max(2, round(_TAIL * len(rows))), None)
    reached = np.flatnonzero(angle > _ARRIVED * Pendulum().largest_angle)
    span = tick_s * (len(u[tail]) - 1)
    return Swing(
        rule=rule,
        gain=gain,
        tick_s=tick_s,
        time_s=tick_s * np.arange(len(rows), dtype=np.float64),
        angle=angle,
        rate=rate,
        input=u,
        settled_rad=float(angle[tail].mean()),
        greatest_rad=float(np.abs(angle).max()),
        ripple_rad=float(np.ptp(angle[tail])),
        chatter=float(np.abs(np.diff(u[tail])).sum() / span),
        arrival_s=float(tick_s * reached[0]) if len(reached) else None,
        unsolved=int(rows[:, 6].sum()),
    )


def sweep(gains: dict[str, Sequence[float]], ticks_s: Sequence[float]) -> list[Swing]:
    """Simulate each rule at each gain and tick length.

    Args:
        gains: by rule, see `GAIN`.
        ticks_s: tick lengths.
    """
    return [swing(rule, gain, dt) for dt in ticks_s for rule in gains for gain in gains[rule]]


def time_table(measured: Mapping[str, Any]) -> Table:
    """Tabulate the time of an evaluation: both rules in native code, and the program in general solvers.

    Args:
        measured: times [us], numbers of rows and states, as examples/geofencing/pendulum.py writes them.
    """
    times = {name.removesuffix(MICRO): float(value) for name, value in measured["times"].items()}
    base, program = times[REGULATION], times[PROGRAM]
    published = GEOFENCING["pendulum"][PROGRAM]["time_ratio"]
    rows: list[tuple[Any, ...]] = [
        ("regulation, no gradient", base, None, base, 1.0, 1.0),
        ("program, ours", program, None, program, program / base, published),
    ]
    for name, value in times.items():
        if name.startswith(SOLVER):
            whole = program + value
            solver = name.removeprefix(SOLVER)
            rows.append((f"program through {solver}", program, value, whole, whole / base, None))
    columns = (
        *("filter", "our flow and rows [µs]", "solver call [µs]", "total [µs]", "ratio to the regulation"),
        "published ratio, about",
    )
    note = (
        f"Native code, over the {measured['states']:,} states of one flight. Our program costs little more "
        "than its flow with sensitivities: rows that no input within its limits can violate are dropped "
        f"before the active-set solver. A general solver gets all {measured['rows']} rows, is called from "
        "Python and is set up anew in every tick; its total is an upper estimate, because it includes our "
        "own solution, too."
    )
    return Table("pendulum-time", "Figure 4: time of an evaluation", columns, tuple(rows), note)


def gains_table(swings: Sequence[Swing]) -> Table:
    """Tabulate the behaviour of each rule at the boundary by its gain."""
    rows = [
        (
            *(
                s.rule,
                1e3 * s.tick_s,
                f"{GAIN[s.rule]} {s.gain:g}",
                s.arrival_s,
                s.settled_rad,
                s.greatest_rad,
            ),
            *(1e3 * s.ripple_rad, s.chatter, 100 * s.unsolved / len(s.time_s)),
        )
        for s in swings
    ]
    columns = (
        *("rule", "tick [ms]", "gain", "95 % after [s]", "settles at [rad]", "maximum angle [rad]"),
        *("ripple [mrad]", "chatter [rad/s² per s]", "ticks without a solution [%]"),
    )
    note = (
        f"Pushed by {PUSH:g} rad/s² from rest against the largest angle, {Pendulum().largest_angle:g} rad. "
        "Ripple and chatter (total variation of the input per second) are those of the last third of a "
        "flight. In a tick without a solution the backup controller acts. The regulation has a limit, too: "
        "with a gain far above the useful ones it switches between pilot and backup."
    )
    return Table("pendulum-gains", "Figure 4: at the boundary, by gain", columns, tuple(rows), note)


def times_in_short(measured: Mapping[str, Any]) -> str:
    """Summarise the times of `time_table` in one line."""
    times = {name.removesuffix(MICRO): float(value) for name, value in measured["times"].items()}
    base, program = times[REGULATION], times[PROGRAM]
    others = ", ".join(
        f"{(program + value) / base:.3g} times with {name.removeprefix(SOLVER)}"
        for name, value in times.items()
        if name.startswith(SOLVER)
    )
    return (
        f"{base:.3g} µs without gradients; our program takes {program / base:.3g} times as long, all rows in "
        f"a general solver up to {others}"
    )


def gains_in_short(swings: Sequence[Swing]) -> str:
    """Summarise the chatter of each rule over its gains at the shorter tick."""
    words = []
    tick = min((s.tick_s for s in swings), default=0.0)
    for rule in (REGULATION, PROGRAM):
        here = [s for s in swings if s.rule == rule and s.tick_s == tick and s.arrival_s is not None]
        calm = [s for s in here if s.chatter < CALM]
        calmest = min(here, key=lambda s: s.chatter, default=None)
        if calmest is None:
            continue
        words.append(
            f"{rule}: chatter below {CALM:g} rad/s² per s at {len(calm)} of {len(here)} gains, minimum "
            f"{text(calmest.chatter)} at {GAIN[rule]} {calmest.gain:g}, settled at "
            f"{text(calmest.settled_rad)} rad"
        )
    return "; ".join(words)


def program_rows(states: FloatArray, options: Pendulum | None = None) -> tuple[FloatArray, FloatArray]:
    """Build all rows a u >= b of the backup-set program for a general solver.

    The flow phi under the backup controller and its tangents along the drift f and the input g = (0, 1) are
    integrated by the explicit midpoint rule. The rows are d/dt h + alpha h >= 0 for h = theta_max -+ theta at
    every node and h_B = eps -+ theta' at the last node, then the limits of the input.

    Args:
        states: angle and rate, shape (S, 2) [rad, rad/s].
        options: parameters of the filter.

    Returns:
        a and b, shapes (S, 2 (N + 1) + 4).

    Source: Chen, Jankovic, Santillo, Ames 2021 (arXiv 2104.11332).
    """
    o = options or Pendulum()
    x = np.asarray(states, np.float64).T.copy()
    # tangent[i, j] is the change of x_i along the drift (j = 0) and the input (j = 1)
    tangent = np.array([[x[1], np.zeros_like(x[0])], [np.sin(x[0]), np.ones_like(x[0])]])
    dt = o.horizon_s / o.steps
    along, drift = [], []

    def add(value: FloatArray, slope: float, of: FloatArray) -> None:
        along.append(slope * of[1])
        drift.append(slope * of[0] + o.alpha * value)

    for node in range(o.steps + 1):
        add(o.largest_angle - x[0], -1.0, tangent[0])
        add(o.largest_angle + x[0], 1.0, tangent[0])
        if node == o.steps:
            break
        half = x + dt / 2 * _field(o, x)
        bent = tangent + dt / 2 * _turned(o, x, tangent)
        tangent = tangent + dt * _turned(o, half, bent)
        x = x + dt * _field(o, half)
    add(o.end_rate - x[1], -1.0, tangent[1])
    add(o.end_rate + x[1], 1.0, tangent[1])
    ones = np.ones_like(x[0])
    a = np.stack([*along, ones, -ones], axis=1)
    limit = np.full_like(x[0], -o.largest_input)
    return a, np.stack([*(-value for value in drift), limit, limit], axis=1)


def _pull(o: Pendulum, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Target rate of the backup controller and its slope."""
    raw = o.push_gain * (o.largest_angle - o.push_distance - np.abs(angle))
    target = np.sign(angle) * np.clip(raw, -o.push_rate, 0.0)
    return target, np.where((raw > -o.push_rate) & (raw < 0), -o.push_gain, 0.0)


def _field(o: Pendulum, x: FloatArray) -> FloatArray:
    return np.array([x[1], o.k * (_pull(o, x[0])[0] - x[1])])


def _turned(o: Pendulum, x: FloatArray, tangent: FloatArray) -> FloatArray:
    slope = _pull(o, x[0])[1]
    return np.array([tangent[1], o.k * (slope * tangent[0] - tangent[1])])
