"""The numbers that the papers print, by paper; `PAPER.toml` says what they are."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from papers.claims import published

POLYMERGE = published("polymerge")
POLYMERGE_SCENES, POLYMERGE_SIZES, POLYMERGE_FLIGHTS = (
    POLYMERGE[name] for name in ("scenes", "sizes", "flights")
)
FASTBRIDGE, DRACBF_PRINTED, GEOFENCING = (published(name) for name in ("fastbridge", "dr-acbf", "geofencing"))


def _of_obstacles(printed: Mapping[str, Any]) -> dict[str, float]:
    """Values of both obstacles."""
    names = {"s": "success", "v_cl": "closing", "d_s": "separation"}
    return {f"{name}_{i + 1}": printed[symbol][i] for symbol, name in names.items() for i in (0, 1)}


_SCENARIO_2: dict[str, dict[str, float]] = {
    variant: dict(
        zip(
            ("success_mean", "closing_mean", "reaction", "command", "tick", "separation_mean"),
            row["values"],
            strict=True,
        )
    )
    for variant, row in DRACBF_PRINTED["table-2"].items()
}
# DR-ACBF's values by scenario or group of runs and by variant, under the names of our tables.
DRACBF: dict[str, dict[str, dict[str, float]]] = {
    "scenario-1": {
        variant: {
            **_of_obstacles(row),
            **{"reaction": row["t_r"][2], "command": row["t_cm"][2]},
            **dict(zip(("tick", "tick_std"), row["t_cp"], strict=True)),
        }
        for variant, row in DRACBF_PRINTED["table-1"].items()
    },
    "scenario-2": _SCENARIO_2,
    "trigger": {
        variant: {
            name: value
            for name, value in _of_obstacles(DRACBF_PRINTED["table-3"][state]).items()
            if not name.startswith("closing")
        }
        for variant, state in (("dr-acbf", "on"), ("trigger-simple", "off"))
    },
    "solver": {
        "dr-acbf-gs": {name: _SCENARIO_2["dr-acbf"][name] for name in ("tick", "command")},
        **DRACBF_PRINTED["solver"],
    },
    "hardware": {
        flight: {name: row[name][0] for name in row["flights"]} | {"success": 100.0}
        for flight, row in DRACBF_PRINTED["hardware"].items()
    },
}
