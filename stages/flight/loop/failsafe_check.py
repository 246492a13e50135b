"""Pre-flight check: what the vehicle does by itself in an emergency must not meet the map."""

from __future__ import annotations

import math

from alula.schemas.arrays import FloatArray
from alula.schemas.decimals import at_least
from alula.stages.flight.links.own_safety import Action, OwnSafety
from alula.stages.flight.loop.departures import Departures
from alula.stages.flight.loop.ways_home import Obstacles, closest_way_home


def failsafe_faults(
    own: OwnSafety,
    departures: Departures,
    home: FloatArray,
    obstacles: Obstacles,
    *,
    radius_m: float,
    foot_m: float,
    map_words: str = "the map",
) -> tuple[list[str], str]:
    """What is wrong with the vehicle's failsafes and fence for a flight.

    Args:
        departures: instants of the flight from which it may turn home, world frame, z up.
        home: take-off position, shape (3,), world frame [m].
        foot_m: the last part of the way down, to leave out the ground [m].

    Returns:
        A sentence for each fault; and what was found if there is none.
    """
    faults = [f"the vehicle does not report {name}" for name in own.unknown]
    low_m, above_m, away_m = departures.extent(home)
    if above_m >= own.highest_m or away_m >= own.farthest_m or low_m <= own.lowest_m:
        faults.append(
            f"the plan leaves the vehicle's own fence ({own.fence}): it goes {low_m:.1f} to {above_m:.1f} m "
            f"up and {away_m:.1f} m away; widen or disable that fence"
        )
    for each in own.failsafes:
        if each.action is Action.RETRACE:
            faults.append(
                f"{each.setting}: when {each.cause} it flies back along a simplified way (SmartRTL), which "
                f"cannot be judged; set {each.stays} so that it does not"
            )
    returning = [each for each in own.failsafes if each.action is Action.RETURN]
    exists = "".join(f"; {words}" for words in own.unjudged)
    if not returning:
        return faults, f"none of them flies home{exists}"
    causes = " or ".join(f"{each.cause} ({each.setting})" for each in returning)
    advice = f"set {' and '.join(each.stays for each in returning)} so that it does not fly home"
    faults += [f"when {causes} it flies home, but {why}; or {advice}" for why in own.not_home]
    met = closest_way_home(own.way_home, departures, home, obstacles, radius_m=radius_m, foot_m=foot_m)
    if not met.distance_m >= radius_m:
        x, y, z = met.at
        meets = f"meets {met.name}" if met.distance_m <= 0 else f"is {met.distance_m:.2f} m from {met.name}"
        faults.append(
            f"when {causes} it flies home {met.height_m:.1f} m above the take-off "
            f"({own.way_home.setting}); from ({x:.1f} {y:.1f} {z:.1f}), after {met.coast_m:.1f} m to rest, "
            f"that {meets}, and {radius_m:.3f} m are required; {advice}"
        )
    clear = (
        "clear of everything"
        if math.isinf(met.distance_m)
        else f"at least {at_least(met.distance_m)} m clear of {map_words}"
    )
    where = "all of the plan"
    if met.share < 1:
        where = f"{at_least(100 * met.share)} % of the plan, where the vehicle has room, "
    return faults, f"ways home from {where} are {clear}{exists}"
