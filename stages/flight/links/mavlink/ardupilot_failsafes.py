"""Failsafes and fence of ArduPilot Copter, from its parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping

from alula.stages.flight.links.own_safety import Action, Failsafe, OwnSafety, WayHome

_N, _L, _R, _B = Action.NONE, Action.STOP_OR_LAND, Action.RETURN, Action.RETRACE

# Actions by the values of parameters, as of Copter 4.7; SmartRTL flies back along its way. Values that are
# not listed land.
_OF_RADIO = {0: _N, 1: _R, 2: _R, 4: _B, 5: _B, 6: _R}
_OF_BATTERY = {0: _N, 2: _R, 3: _B, 4: _B, 6: _R}
_OF_FENCE = {0: _N, 1: _R, 3: _B, 5: _B}
_OF_ESTIMATE = {0: _N, 2: _N}
_CONTINUES_GUIDED, _CONTINUES_LANDING = 4, 8  # bits of FS_OPTIONS: a lost radio then has no action
_HAS_TOP, _HAS_CIRCLE, _HAS_POLYGONS, _HAS_BOTTOM = 1, 2, 4, 8  # bits of FENCE_TYPE
_SHALLOWEST = 0.5  # smaller values of RTL_CONE_SLOPE have no effect
_LOWEST_M = 0.3  # of the way home
_HEARTBEATS_CHECKED_S = 1 / 3  # period in which it looks for heartbeats
_CM = 0.01

# Heights with their names before and since Copter 4.7, and their factors to metres.
_RETURN_HEIGHT = (("RTL_ALT", _CM, "cm"), ("RTL_ALT_M", 1.0, "m"))
_LEAST_CLIMB = (("RTL_CLIMB_MIN", _CM, "cm"), ("RTL_CLIMB_MIN_M", 1.0, "m"))
_LEVELS = (("LOW", "low"), ("CRT", "critical"))
ARDUPILOT_SAFETY = (
    *("FS_THR_ENABLE", "FS_OPTIONS", "FS_DR_ENABLE", "FS_EKF_ACTION", "BATT_MONITOR"),
    *(f"BATT_FS_{level}_ACT" for level, _ in _LEVELS),
    *(f"BATT_{level}_{kind}" for level, _ in _LEVELS for kind in ("VOLT", "MAH")),
    *("FENCE_ENABLE", "FENCE_AUTOENABLE", "FENCE_TYPE", "FENCE_ACTION", "FENCE_ALT_MAX", "FENCE_ALT_MIN"),
    *("FENCE_RADIUS", "FENCE_MARGIN", "FENCE_TOTAL", "RALLY_TOTAL"),
    *(name for name, _, _ in (*_RETURN_HEIGHT, *_LEAST_CLIMB)),
    *("RTL_CONE_SLOPE", "RTL_ALT_TYPE", "GUID_TIMEOUT", "FS_GCS_TIMEOUT"),
)


def ardupilot_safety(values: Mapping[str, float], *, flies_rates: bool = False) -> OwnSafety:
    """Failsafes and fence of a Copter.

    Args:
        flies_rates: without set-points it levels and coasts until it misses heartbeats; else it stops.
    """

    def whole(name: str) -> int:
        return int(values.get(name, 0.0))

    def failsafe(cause: str, name: str, actions: dict[int, Action], stays: int) -> Failsafe:
        return Failsafe(cause, actions.get(whole(name), _L), f"{name} is {whole(name)}", f"{name} to {stays}")

    found = list[Failsafe]()
    ignored = whole("FS_OPTIONS") & (_CONTINUES_GUIDED | _CONTINUES_LANDING)
    if ignored != _CONTINUES_GUIDED | _CONTINUES_LANDING:
        when = " while it lands" if ignored & _CONTINUES_GUIDED else ""
        found.append(failsafe(f"its radio is lost{when}", "FS_THR_ENABLE", _OF_RADIO, 3))
    found.append(failsafe("its satellites are lost", "FS_DR_ENABLE", _OF_BATTERY, 1))
    found.append(failsafe("its estimate is bad", "FS_EKF_ACTION", _OF_ESTIMATE, 1))
    if values.get("BATT_MONITOR"):
        for level, word in _LEVELS:
            if any(values.get(f"BATT_{level}_{kind}", 0.0) > 0 for kind in ("VOLT", "MAH")):
                found.append(failsafe(f"its battery is {word}", f"BATT_FS_{level}_ACT", _OF_BATTERY, 1))
    is_fenced = bool(values.get("FENCE_ENABLE") or values.get("FENCE_AUTOENABLE"))
    if is_fenced:
        found.append(failsafe("it leaves its own fence", "FENCE_ACTION", _OF_FENCE, 2))
    kinds = whole("FENCE_TYPE") if is_fenced else 0
    walls = {
        name: values[name]
        for name, bit in (
            ("FENCE_ALT_MAX", _HAS_TOP),
            ("FENCE_RADIUS", _HAS_CIRCLE),
            ("FENCE_ALT_MIN", _HAS_BOTTOM),
        )
        if kinds & bit and name in values
    }
    height_m, height = _height(values, _RETURN_HEIGHT)
    climb_m, climb = _height(values, _LEAST_CLIMB)
    unknown = [] if "FS_THR_ENABLE" in values else ["FS_THR_ENABLE"]
    if any(each.action is _R for each in found):
        known = (
            ("RTL_ALT", bool(height)),
            ("RTL_CLIMB_MIN", bool(climb)),
            ("RTL_CONE_SLOPE", "RTL_CONE_SLOPE" in values),
        )
        unknown += [name for name, is_known in known if not is_known]
    slope = values.get("RTL_CONE_SLOPE", 0.0)
    top_m = walls.get("FENCE_ALT_MAX", math.inf)
    alone_s = values.get("FS_GCS_TIMEOUT" if flies_rates else "GUID_TIMEOUT", math.nan)
    return OwnSafety(
        failsafes=tuple(found),
        way_home=WayHome(
            height_m=height_m,
            climb_m=climb_m,
            slope=slope if slope >= _SHALLOWEST else math.inf,
            lowest_m=_LOWEST_M,
            highest_m=top_m - values.get("FENCE_MARGIN", 0.0),
            setting=height,
        ),
        not_home=tuple(_not_home(values)),
        lowest_m=walls.get("FENCE_ALT_MIN", -math.inf),
        highest_m=top_m,
        farthest_m=walls.get("FENCE_RADIUS", math.inf),
        fence="; ".join(f"{name} is {value:g} m" for name, value in walls.items()),
        unknown=tuple(unknown),
        unjudged=tuple(_unjudged(values, kinds)),
        alone_s=alone_s + (_HEARTBEATS_CHECKED_S if flies_rates else 0.0),
    )


def _height(values: Mapping[str, float], names: tuple[tuple[str, float, str], ...]) -> tuple[float, str]:
    """A height [m], and the parameter with its value; empty if the vehicle does not report it."""
    for name, factor, unit in names:
        if name in values:
            return values[name] * factor, f"{name} is {values[name]:g} {unit}"
    return 0.0, ""


def _not_home(values: Mapping[str, float]) -> list[str]:
    """Why it may fly elsewhere than home, or by another height."""
    found = []
    if values.get("RALLY_TOTAL"):
        found.append(f"RALLY_TOTAL is {values['RALLY_TOTAL']:g}: it may fly to a rally point; remove them")
    if values.get("RTL_ALT_TYPE"):
        found.append(
            f"RTL_ALT_TYPE is {values['RTL_ALT_TYPE']:g}: its height is above the terrain; set it to 0"
        )
    return found


def _unjudged(values: Mapping[str, float], kinds: int) -> list[str]:
    """Name unjudged failsafes: polygons of the fence, and a bad estimate with which it flies on."""
    found = []
    if kinds & _HAS_POLYGONS and values.get("FENCE_TOTAL"):
        found.append(
            f"polygons and circles of its fence (FENCE_TOTAL is {values['FENCE_TOTAL']:g}) are not judged: "
            f"keep the plan inside, or set FENCE_TYPE to {kinds & ~_HAS_POLYGONS}"
        )
    action = values.get("FS_EKF_ACTION")
    if action in _OF_ESTIMATE:
        flies = (
            "only reports a bad estimate" if action == 0 else "holds its height only when its estimate is bad"
        )
        found.append(f"FS_EKF_ACTION is {action:g}: it {flies}; set it to 1, to land")
    return found
