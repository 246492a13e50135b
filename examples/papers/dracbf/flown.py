"""Settings that DR-ACBF prints and the scenarios of the example hold, from the records of the flights."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from alula.stages.reporting.table import flat
from papers.dracbf.tables import BASE, Flown, find
from papers.verdicts import PaperRow, exact

_VEHICLE = ("vehicle.radius_m", "vehicle.max_acceleration_m_s2")
_MANOEUVRE = tuple(f"safety.{BASE}.{name}" for name in ("clearance_m", "hold_s", "stop_s", "brake"))


def flown_settings(flown: Sequence[Flown]) -> list[PaperRow]:
    """One row for each group of printed settings; a group whose run is missing or older is left out."""
    rows = [
        _row(
            find(flown, "scenario-1", BASE),
            ("section IV-A", "radii [m], limit of the acceleration [m/s²], tick [s], least speed [m/s]"),
            "R_uav = R_obs = 0.15 m, 6 m/s², 100 Hz, 5 m/s",
            lambda p: [p[_VEHICLE[0]], _first(p, "radius_m"), p[_VEHICLE[1]], p["rules.dt_s"], _slowest(p)],
            [0.15, 0.15, 6.0, 0.01, 5.0],
            "the upper ends of the speeds are not printed; they are our choice",
        ),
        _row(
            find(flown, "scenario-1", BASE),
            ("section IV-B", "scenario 1: distances of both obstacles at the start [m]"),
            "50 m",
            lambda p: [m["distance_m"] for m in p["world.moving"]],
            [50.0, 50.0],
            "3,000 simulations there; the number of flights stands beside each row here",
        ),
        _row(
            find(flown, "scenario-2", BASE),
            ("section IV-C", "scenario 2: distances of both obstacles at the start [m]"),
            "150 m and 200 m",
            lambda p: [m["distance_m"] for m in p["world.moving"]],
            [150.0, 200.0],
            "1,000 runs there; the number of flights stands beside each row here",
        ),
        _row(
            find(flown, "thrown", "as-printed"),
            ("section V-A", "radii [m], limit [m/s²], d_cl [m], t_hd [s], t_s [s], k_s of the Crazyflie"),
            "0.10 m, 0.8 m/s², 0.05 m, 0.2 s, at most 0.7 s, 0.2",
            lambda p: [p[_VEHICLE[0]], _first(p, "radius_m"), p[_VEHICLE[1]], *(p[k] for k in _MANOEUVRE)],
            [0.1, 0.1, 0.8, 0.05, 0.2, 0.7, 0.2],
            "of the runs `as-printed`",
        ),
    ]
    return [row for row in rows if row is not None]


def _row(
    f: Flown | None, name: tuple[str, str], published: str, get: Any, printed: Sequence[float], why: str
) -> PaperRow | None:
    if f is None:
        return None
    try:
        ours = [float(value) for value in get(flat(f.record.provenance.parameters))]
    except KeyError:  # a record of before these keys
        return None
    same = all(math.isclose(a, b, rel_tol=1e-6) for a, b in zip(printed, ours, strict=True))
    words = ", ".join(exact(value) for value in ours)
    item, quantity = name
    row = PaperRow(
        *(item, f"setting: {quantity}", published, words, ""), "reproduced" if same else "not comparable", why
    )
    return row.made_from([f"{f.scenario}/{f.variant}.run.mcap"], len(f.record.trials))


def _first(parameters: dict[str, Any], key: str) -> float:
    return float(parameters["world.moving"][0][key])


def _slowest(parameters: dict[str, Any]) -> float:
    return min(float(moving["speed_m_s"][0]) for moving in parameters["world.moving"])
