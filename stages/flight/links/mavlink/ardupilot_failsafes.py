"""Failsafes and fence of ArduPilot Copter, from its parameters."""

from __future__ import annotations

import math
from collections.abc import Callable

from alula.stages.flight.links.own_safety import Action, Failsafe, OwnSafety, WayHome

_N, _L, _R, _B = Action.NONE, Action.STOP_OR_LAND, Action.RETURN, Action.RETRACE

# Actions by the values of parameters, as of Copter 4.7; SmartRTL flies back along its way. Values that are
# not listed land.
_OF_RADIO = {0: _N, 1: _R, 2: _R, 4: _B, 5: _B, 6: _R}
_OF_BATTERY = {0: _N, 2: _R, 3: _B, 4: _B, 6: _R}
_OF_FENCE = {0: _N, 1: _R, 3: _B, 5: _B}
_CONTINUES_GUIDED = 4  # bit of FS_OPTIONS: in GUIDED, a lost radio has no action
_HAS_TOP, _HAS_CIRCLE = 1, 2  # bits of FENCE_TYPE
_SHALLOWEST = 0.5  # smaller values of RTL_CONE_SLOPE have no effect
_LOWEST_M = 0.3  # of the way home
_HEARTBEATS_CHECKED_S = 1 / 3  # period in which it looks for heartbeats

_ALWAYS_READ = ("FS_THR_ENABLE", "FS_OPTIONS", "FS_DR_ENABLE", "FENCE_ENABLE", "BATT_MONITOR")
_RETURNS = ("RTL_ALT", "RTL_CLIMB_MIN", "RTL_CONE_SLOPE")
_FENCE = ("FENCE_TYPE", "FENCE_ACTION", "FENCE_ALT_MAX", "FENCE_RADIUS", "FENCE_MARGIN")


def ardupilot_safety(read: Callable[[str], float | None], *, flies_rates: bool = False) -> OwnSafety:
    """Failsafes and fence of a Copter.

    Args:
        read: value of a parameter; None if the vehicle does not have it.
        flies_rates: without set-points it levels and coasts until it misses heartbeats; else it stops.
    """
    value = {name: read(name) for name in _ALWAYS_READ}
    if value["FENCE_ENABLE"]:
        value |= {name: read(name) for name in _FENCE}
    if value["BATT_MONITOR"]:
        for level in ("LOW", "CRT"):
            names = (f"BATT_FS_{level}_ACT", f"BATT_{level}_VOLT", f"BATT_{level}_MAH")
            value |= {name: read(name) for name in names}

    def whole(name: str) -> int:
        found = value.get(name)
        return 0 if found is None else int(found)

    def failsafe(cause: str, name: str, actions: dict[int, Action], lands: int) -> Failsafe:
        return Failsafe(cause, actions.get(whole(name), _L), f"{name} is {whole(name)}", f"{name} to {lands}")

    found = (
        []
        if whole("FS_OPTIONS") & _CONTINUES_GUIDED
        else [failsafe("its radio is lost", "FS_THR_ENABLE", _OF_RADIO, 3)]
    )
    found.append(failsafe("its satellites are lost", "FS_DR_ENABLE", _OF_BATTERY, 1))
    for level, word in (("LOW", "low"), ("CRT", "critical")):
        if (value.get(f"BATT_{level}_VOLT") or 0) > 0 or (value.get(f"BATT_{level}_MAH") or 0) > 0:
            found.append(failsafe(f"its battery is {word}", f"BATT_FS_{level}_ACT", _OF_BATTERY, 1))
    top_m = radius_m = safe_m = math.inf
    fence = []
    if whole("FENCE_ENABLE"):
        found.append(failsafe("it leaves its own fence", "FENCE_ACTION", _OF_FENCE, 2))
        if whole("FENCE_TYPE") & _HAS_TOP and (given := value["FENCE_ALT_MAX"]) is not None:
            top_m = given
            safe_m = given - (value["FENCE_MARGIN"] or 0.0)
            fence.append(f"FENCE_ALT_MAX is {given:g} m")
        if whole("FENCE_TYPE") & _HAS_CIRCLE and (given := value["FENCE_RADIUS"]) is not None:
            radius_m = given
            fence.append(f"FENCE_RADIUS is {given:g} m")
    needed = ["FS_THR_ENABLE"]
    if any(each.action is _R for each in found):
        value |= {name: read(name) for name in _RETURNS}
        needed += _RETURNS
    slope = value.get("RTL_CONE_SLOPE") or 0.0
    height_m = (value.get("RTL_ALT") or 0.0) / 100
    way_home = WayHome(
        height_m=height_m,
        climb_m=(value.get("RTL_CLIMB_MIN") or 0.0) / 100,
        slope=slope if slope >= _SHALLOWEST else math.inf,
        lowest_m=_LOWEST_M,
        highest_m=safe_m,
        setting=f"RTL_ALT is {100 * height_m:g} cm",
    )
    alone_s = read("FS_GCS_TIMEOUT" if flies_rates else "GUID_TIMEOUT")
    if alone_s is not None and flies_rates:
        alone_s += _HEARTBEATS_CHECKED_S
    return OwnSafety(
        failsafes=tuple(found),
        way_home=way_home,
        highest_m=top_m,
        farthest_m=radius_m,
        fence="; ".join(fence),
        unknown=tuple(name for name in needed if value[name] is None),
        alone_s=math.nan if alone_s is None else alone_s,
    )
