"""The small vehicle of Tables IV and V, and the corridor, from runs of encounters."""

from __future__ import annotations

from collections.abc import Sequence

from alula.schemas.run import ObstacleResult, TrialResult
from alula.stages.reporting.papers.dracbf import Flown, milli, select, success
from alula.stages.reporting.papers.published import DRACBF
from alula.stages.reporting.statistics import mean_of
from alula.stages.reporting.tables import Table

HARDWARE = {
    "table-4": ("Table IV: a small vehicle and one obstacle", ("thrown", "moving")),
    "table-5": ("Table V: a small vehicle and two obstacles", ("both", "approaching")),
}


def hardware_tables(flown: Sequence[Flown]) -> list[Table]:
    """Tables IV and V: the small vehicle, per obstacle; those without runs are left out."""
    found = [_hardware_table(flown, name, *of) for name, of in HARDWARE.items()]
    return [table for table in found if table.rows]


def _hardware_table(flown: Sequence[Flown], name: str, title: str, scenarios: Sequence[str]) -> Table:
    rows = []
    for scenario in scenarios:
        for f in select(flown, scenario):
            for i in range(f.obstacles):
                said = DRACBF["hardware"].get(f"{scenario}/{i + 1}", {}) if f.variant == "as-printed" else {}
                dt = f.dt_s
                reaction = f.mean(i, lambda m: m.reaction_s)
                rows.append(
                    (
                        *(scenario, f.variant, i + 1, *success(f, i).cells),
                        f.mean(i, lambda m: m.closing_m_s),
                        milli(None if reaction is None else reaction + dt),
                        milli(f.timing("command_mean_s", i)),
                        milli(f.mean(i, lambda m: m.avoid_s)),
                        milli(f.mean(i, detection_time)),
                        f.mean(i, lambda m: m.separation_m),
                        min(m.closest_m for m in f.met(i)),
                        *(said.get(key) for key in ("closing", "reaction", "command", "avoid", "detection")),
                        said.get("separation"),
                    )
                )
    columns = (
        *("scenario", "variant", "obstacle", "success [%]", "95 % low", "95 % high", "v_cl [m/s]"),
        *("t_r, to the next tick [ms]", "t_cm [ms]", "t_a [ms]", "t_d [ms]", "d_s [m]", "least distance [m]"),
        *("published: v_cl", "published: t_r", "published: t_cm", "published: t_a", "published: t_d"),
        "published: d_s",
    )
    note = (
        "Simulated: 0.8 m/s², radii of 0.1 m, motion capture at 120 Hz. t_a: from the first command that "
        "avoids to "
        "the end of hovering; t_d: from the first detection to that command. Published: means of five "
        "flights each, all without collision (100 %, by Wilson's interval 57 to 100 %), thrown by hand and "
        "with a radio link, so "
        "only the kind of numbers compares; our radio, if any, is in the delays of the scenario."
    )
    return Table(name, title, columns, tuple(rows), note)


def detection_time(met: ObstacleResult) -> float | None:
    """From the first detection until the avoidance command (t_d) [s]."""
    if met.detected_s is None or met.warned_s is None or met.reaction_s is None:
        return None
    return met.warned_s + met.reaction_s - met.detected_s


def wall_table(flown: Sequence[Flown]) -> Table | None:
    """Dodging between walls; None without runs."""
    runs = select(flown, "wall")
    if not runs:
        return None
    rows = []
    for f in runs:
        gaps = [t.map_clearance_m for t in f.record.trials if t.map_clearance_m is not None]
        rows.append(
            (
                *(f.variant, len(f.record.trials), *success(f, 0).cells),
                *(_touched(f.record.trials), min(gaps, default=None), mean_of(gaps), *success(f).cells),
            )
        )
    columns = (
        *("variant", "trials", "obstacle [%]", "95 % low", "95 % high", "trials that touch a wall"),
        *("least clearance of walls [m]", "its mean [m]", "runs [%]", "95 % low", "95 % high"),
    )
    note = "Walls are rows of the same projection; clearance is that of the vehicle's sphere."
    return Table("wall", "A corridor: dodging without touching a wall", columns, tuple(rows), note)


def _touched(trials: Sequence[TrialResult]) -> int:
    return sum(t.map_clearance_m is not None and t.map_clearance_m < 0 for t in trials)
