"""Difficulty at which the filters among moving obstacles fail, and their comparison there.

Runs are named METHOD_AXIS_LEVEL in the folder `difficulty`, METHOD_CONDITION_SETTING in `tune` and in `hard`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from alula.stages.reporting.statistics import Estimate, Rate, difference_estimate, mean_of, rate
from alula.stages.reporting.table import HIGH, LOW, Table, flat, text
from papers.dracbf.tables import BASE, PRINTED, Flown, find, select, success
from papers.published import DRACBF_PRINTED

COMPARED = (BASE, "mpc", "cbf-qp", "rp-cbf")
_SUCCESS = [row["values"][0] for row in DRACBF_PRINTED["table-2"].values()]
PUBLISHED = (min(_SUCCESS), max(_SUCCESS))  # of Table II, means of the obstacles [%]
AXES = {  # name and value in scenario 2
    "detection": ("detection probability", 0.95),
    "noise": ("factor of the radar's noise", 2.0),
    "delay": ("delay of the radar [s]", 0.0),
    "lag": ("delay of the actuation [s]", 0.0),
    "speed": ("factor of the obstacles' speed", 1.0),
    "limit": ("limit of the vehicle's acceleration [m/s²]", 6.0),
}
CONDITIONS = {
    "missed": "detections missed",
    "late": "actuation late",
    "noisy": "radar noisy",
}
SHARED = ("obstacle_braking_m_s2", "clearance_m")
GAINS = {  # of each method, tuned beside the shared ones
    BASE: "alpha",
    "mpc": "mpc.step_s",
    "cbf-qp": "cbf_qp.horizon_s",
    "rp-cbf": "rp_cbf.alpha",
}


def mean_success(flown: Flown) -> float:
    """Mean of the obstacles' success, as published [%]."""
    return mean_of(success(flown, i).value for i in range(flown.obstacles)) or 0.0


@dataclass(frozen=True, slots=True)
class Level:
    """Runs of the compared methods at one value of an axis."""

    axis: str
    value: float
    runs: dict[str, Flown]


def levels(flown: Sequence[Flown]) -> list[Level]:
    """Group the runs by axis and value, the easiest first, which is scenario 2 itself."""
    base = {m: f for m in COMPARED if (f := find(flown, "scenario-2", m)) is not None}
    found: dict[tuple[str, float], dict[str, Flown]] = {}
    for f in select(flown, "difficulty"):
        method, axis, value = f.variant.rsplit("_", 2)
        found.setdefault((axis, float(value)), {})[method] = f
    result = []
    for axis, (_, usual) in AXES.items():
        here = [Level(axis, value, runs) for (name, value), runs in found.items() if name == axis]
        if here and base:
            here.append(Level(axis, usual, base))
        result += sorted(here, key=lambda level: abs(level.value - usual))
    return result


def crossing(at: Sequence[Level], method: str, target: float = PUBLISHED[1]) -> float | None:
    """Value at which a method's mean success first falls to `target` [%], by linear interpolation.

    Args:
        at: levels of one axis, the easiest first.
        method: a compared method.
        target: success [%].

    Returns:
        None where it stays above.
    """
    known = [(level.value, mean_success(level.runs[method])) for level in at if method in level.runs]
    for (x0, y0), (x1, y1) in pairwise(known):
        if y0 > target >= y1:
            return x0 + (x1 - x0) * (y0 - target) / (y0 - y1)
    return None


def difficulty_table(flown: Sequence[Flown]) -> Table | None:
    """Tabulate success over difficulty for every compared method; None without runs."""
    rows = []
    for level in levels(flown):
        row: list[Any] = [AXES[level.axis][0], level.value]
        row.append(", ".join(text(n) for n in sorted({len(f.record.trials) for f in level.runs.values()})))
        for method in COMPARED:
            f = level.runs.get(method)
            row += [None] * 4 if f is None else [mean_success(f), *success(f).cells]
        rows.append(tuple(row))
    if not rows:
        return None
    columns = ["what is changed", "value", "trials"]
    for method in COMPARED:
        columns += [f"{method}: mean of obstacles [%]", f"{method}: runs [%]", LOW, HIGH]
    note = (
        "Scenario 2 with one value changed; the first row of each value is scenario 2 as it stands. "
        f"Published: {PUBLISHED[0]:g} to {PUBLISHED[1]:g} %, the mean of the obstacles. No filter knows the "
        "delays. More noise widens the covariances, so that the warning comes earlier."
    )
    return Table(
        "difficulty", "Difficulty at which the published rates appear", tuple(columns), tuple(rows), note
    )


def crossings(flown: Sequence[Flown]) -> dict[str, str]:
    """State in words, for each axis, where each method falls to the published success."""
    every = levels(flown)
    facts = {}
    for axis, (name, _) in AXES.items():
        at = [level for level in every if level.axis == axis]
        if not at:
            continue
        found = {method: crossing(at, method) for method in COMPARED}
        words = [f"{m} {'stays above' if x is None else text(x)}" for m, x in found.items()]
        facts[f"falls to {PUBLISHED[1]:g} % at a {name} of"] = ", ".join(words)
    return facts


@dataclass(frozen=True, slots=True)
class Tried:
    """One setting that tuning tried: options, and the success in the runs of all conditions."""

    method: str
    options: tuple[str, ...]
    success: Rate


def tried(flown: Sequence[Flown], method: str) -> list[Tried]:
    """Success of every setting of a method over all conditions of the tuning, the default first."""
    groups: dict[str, list[Flown]] = {}
    for f in flown:
        name, _, setting = f.variant.rsplit("_", 2)
        if name == method:
            groups.setdefault(setting, []).append(f)
    result = []
    for name in sorted(groups, key=_order):
        runs = groups[name]
        values = flat(runs[0].record.provenance.parameters)
        keys = [f"safety.{BASE}.{key}" for key in (*SHARED, GAINS[method])]
        options = tuple(f"{key}={values[key]:g}" for key in keys)
        result.append(
            Tried(method, options, rate(not trial.collision for f in runs for trial in f.record.trials))
        )
    return result


def _order(setting: str) -> tuple[float, float, int]:
    """Place of a setting BRAKING-CLEARANCE-GAIN: the defaults are the larger values and the first gain."""
    braking, clearance, gain = setting.split("-")
    return -float(braking), -float(clearance), int(gain)


def chosen(flown: Sequence[Flown], method: str) -> Tried:
    """Choose the setting with the highest success; of equal ones the first, where the default stands."""
    return max(tried(flown, method), key=lambda each: each.success.value or 0.0)


def tuning_table(flown: Sequence[Flown]) -> Table | None:
    """Show what tuning tried and chose for every method; None without runs."""
    runs = select(flown, "tune")
    rows = []
    for method in COMPARED:
        every = tried(runs, method)
        if not every:
            continue
        best = chosen(runs, method)
        lowest = min(every, key=lambda each: each.success.value or 0.0)
        words = ", ".join(option.removeprefix(f"safety.{BASE}.") for option in best.options)
        rows.append(
            (
                *(method, len(every), every[0].success.n, *every[0].success.cells),
                *(words, *best.success.cells, lowest.success.value),
            )
        )
    if not rows:
        return None
    columns = (
        *("method", "settings", "trials of each", "default: runs [%]", LOW, HIGH),
        *("chosen setting", "chosen: runs [%]", LOW, HIGH, "lowest [%]"),
    )
    note = (
        "Every method is tuned in the same way: eight settings, two values of each of "
        "obstacle_braking_m_s2, clearance_m and a gain of its own, in equal trials of all hard conditions, "
        "with seed 1000. The highest success counts, of equal ones the first; the first is the default. No "
        "trial of this table is reported elsewhere."
    )
    return Table("tuning", "Tuning for the hard conditions", columns, tuple(rows), note)


def paired(ours: Flown, theirs: Flown) -> Estimate | None:
    """Difference of the success of runs in the same trials [points], with its paired interval."""
    a, b = ([not trial.collision for trial in f.record.trials] for f in (ours, theirs))
    found = difference_estimate(np.array(a, float), np.array(b, float), bounds=(-1.0, 1.0))
    if found is None or found.low is None or found.high is None:
        return None
    return Estimate(100 * found.value, 100 * found.low, 100 * found.high, found.n)


def hard_table(flown: Sequence[Flown]) -> Table | None:
    """Compare the methods in the hard conditions, with default and tuned settings; None without runs."""
    runs = select(flown, "hard")
    rows = []
    for condition, words in CONDITIONS.items():
        for setting in ("default", "tuned"):
            here = {
                f.variant.rsplit("_", 2)[0]: f for f in runs if f.variant.endswith(f"_{condition}_{setting}")
            }
            base = here.get(BASE)
            for method in (*COMPARED, *PRINTED[1:]):
                f = here.get(method)
                if f is None:
                    continue
                gap = None if base is None or f is base else paired(f, base)
                rows.append(
                    (
                        *(words, setting, method, len(f.record.trials)),
                        *(success(f, i).value for i in range(f.obstacles)),
                        *(mean_success(f), *success(f).cells),
                        *((None,) * 3 if gap is None else (gap.value, gap.low, gap.high)),
                        _side(gap),
                    )
                )
    if not rows:
        return None
    obstacles = runs[0].obstacles
    columns = (
        *("condition", "setting", "method", "trials", *(f"obstacle {i + 1} [%]" for i in range(obstacles))),
        *("mean of obstacles [%]", "runs [%]", LOW, HIGH),
        *(f"difference to {BASE} [points]", LOW, HIGH, "beside it"),
    )
    values = {words: _changed(runs, condition) for condition, words in CONDITIONS.items()}
    conditions = ", ".join(f"{words}: {value}" for words, value in values.items() if value)
    note = (
        f"Scenario 2; {conditions}. The same trials for all, so the differences are paired (bootstrap over "
        "trials, widened for what the number of trials cannot exclude). The printed equations and SAFE-IMM "
        "are those of the table on them."
    )
    return Table("hard", "The methods in the hard conditions", columns, tuple(rows), note)


def hard_facts(flown: Sequence[Flown]) -> dict[str, str]:
    """State in words how the methods differ from `dr-acbf` in the hard conditions."""
    facts = {}
    for condition, name in CONDITIONS.items():
        for setting in ("default", "tuned"):
            base = find(flown, "hard", f"{BASE}_{condition}_{setting}")
            if base is None:
                continue
            words = [f"{BASE} {success(base)}"]
            for method in COMPARED[1:]:
                f = find(flown, "hard", f"{method}_{condition}_{setting}")
                gap = None if f is None else paired(f, base)
                if gap is not None:
                    words.append(f"{method} {gap.value:+.3g} points ({text(gap.low)} to {text(gap.high)})")
            facts[f"{name}, {setting}, runs"] = ", ".join(words)
    return facts


def _side(gap: Estimate | None) -> str:
    if gap is None or gap.low is None or gap.high is None:
        return ""
    return "better" if gap.low > 0 else "worse" if gap.high < 0 else "not apart"


def _changed(runs: Sequence[Flown], condition: str) -> str:
    f = next((f for f in runs if f"_{condition}_" in f.variant), None)
    if f is None:
        return ""
    values = flat(f.record.provenance.parameters)
    key = {
        "missed": "estimation.sensor.detection_probability",
        "late": "vehicle.actuation_delay_s",
        "noisy": "estimation.sensor.noise_scale",
    }[condition]
    return f"{key} = {text(values.get(key))}"
