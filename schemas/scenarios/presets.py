"""Presets of a scenario: what sees moving obstacles in a place, and filters that suit it."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from typing import Any

_THROWN = {
    "range_m": 10.0,
    "h_max_s": 0.8,
    "clearance_m": 0.3,
    "wasserstein_m": 0.02,
    "obstacle_braking_m_s2": 0.0,
    "accelerated": True,
    "envelope_cap_m_s2": 12.0,
}
PRESETS: dict[str, dict[str, Any]] = {
    "outdoor-radar": {},  # the defaults of all tables
    "room-mocap": {
        "estimation": {
            "sensor": {"kind": "mocap", "rate_hz": 100.0, "position_sigma_m": 0.002, "max_range_m": 20.0}
        },
        "safety": {"dr-acbf": _THROWN},
    },
}
_COMPARED = frozenset({"mpc", "cbf-qp", "rp-cbf"})  # flown with the defaults of dr-acbf's table
_INDOORS = ("crazyflie21",)  # vehicles that fly in rooms


def preset_of(tree: Mapping[str, Any]) -> str | None:
    """Name of the preset of a scenario; None where nothing moves, so that none has an effect."""
    if not tree.get("world", {}).get("moving"):
        return None
    given = tree.get("estimation", {}).get("preset")
    if given is not None:
        return str(given)
    return "room-mocap" if tree.get("vehicle", {}).get("type") in _INDOORS else "outdoor-radar"


def with_preset(tree: Mapping[str, Any]) -> dict[str, Any]:
    """Fill in the values of a preset where a scenario has none."""
    name = preset_of(tree)
    if name not in PRESETS:
        return dict(tree)
    return _over(_over(preset_values(tree), {"estimation": {"preset": name}}), tree)


def preset_values(tree: Mapping[str, Any]) -> dict[str, Any]:
    """The values of a scenario's preset; those for filters are left out where a compared method flies."""
    values = dict(PRESETS.get(preset_of(tree) or "", {}))
    if not _COMPARED.isdisjoint(tree.get("safety", {}).get("filters", ())):
        values.pop("safety", None)
    return values


def _over(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    found = deepcopy(dict(below))
    for key, value in above.items():
        is_table = isinstance(value, Mapping) and isinstance(found.get(key), Mapping)
        found[key] = _over(found[key], value) if is_table else value
    return found
