"""Failsafes and fence of a multicopter with PX4, from its parameters, as of PX4 1.15."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.stages.flight.links.own_safety import Action, Failsafe, OwnSafety, WayHome

_N, _L, _R = Action.NONE, Action.STOP_OR_LAND, Action.RETURN

# Actions by the values of parameters: hold, land, terminate and disarm all stay. Values that are not listed
# have none.
_OF_LINK = {1: _L, 2: _R, 3: _L, 5: _L, 6: _L}
_OF_OFFBOARD = {0: _L, 1: _L, 2: _L, 3: _R, 4: _L, 5: _L, 6: _L, 7: _L}
_OF_BATTERY = {1: _R, 2: _L, 3: _R}
_OF_FENCE = {2: _L, 3: _R, 4: _L, 5: _L}
_OF_TIME = {3: _R}
_OF_MOTOR = {1: _L, 2: _L, 3: _R, 4: _L}
_OF_SATELLITES = {1: _R, 2: _L, 3: _L}
_WITHOUT_STICKS = 4  # COM_RC_IN_MODE
_EXCEPT_LANDING, _EXCEPT_OFFBOARD = 2, 4  # bits of COM_RCL_EXCEPT and COM_DLL_EXCEPT

PX4_SAFETY = (
    *("NAV_RCL_ACT", "COM_RC_IN_MODE", "COM_RCL_EXCEPT", "NAV_DLL_ACT", "COM_DLL_EXCEPT"),
    *("COM_OBL_RC_ACT", "COM_OF_LOSS_T", "COM_LOW_BAT_ACT", "COM_FLTT_LOW_ACT", "COM_FLT_TIME_MAX"),
    *("COM_WIND_MAX", "COM_WIND_MAX_ACT", "COM_ACT_FAIL_ACT", "COM_GNSSLOSS_ACT"),
    *("GF_ACTION", "GF_MAX_HOR_DIST", "GF_MAX_VER_DIST"),
    *("RTL_TYPE", "RTL_RETURN_ALT", "RTL_CONE_ANG", "RTL_MIN_DIST", "NAV_ACC_RAD"),
)


@dataclass(frozen=True, slots=True)
class ConeHome(WayHome):
    """The way home with a cone around the take-off position.

    Within `near_m` the level part is at most `slope` times as high as it is long. It is at least twice as
    high as `arrived_m`, and within that distance twice as high as it is long.

    Attributes:
        near_m: distance within which the cone lowers it [m].
        arrived_m: distance at which the vehicle counts as arrived [m].
    """

    near_m: float = 0.0
    arrived_m: float = 0.0

    @property
    def jumps_m(self) -> tuple[float, ...]:
        """See `WayHome`."""
        return (self.near_m, self.arrived_m) if math.isfinite(self.slope) else ()

    def heights(self, above_m: FloatArray, away_m: FloatArray) -> FloatArray:
        """See `WayHome`.

        Args:
            above_m: height of the vehicle above the take-off position, shape (T,) [m].
            away_m: horizontal distance from it, shape (T,) [m].
        """
        if not math.isfinite(self.slope):
            level = np.full_like(away_m, self.height_m)
        else:
            cone = np.where(
                away_m <= self.near_m, np.minimum(self.slope * away_m, self.height_m), self.height_m
            )
            far = np.maximum(cone, 2 * self.arrived_m)
            level = np.minimum(np.where(away_m <= self.arrived_m, 2 * away_m, far), self.height_m)
        found: FloatArray = np.maximum(level, above_m)
        return found


def px4_safety(values: Mapping[str, float], *, flies_rates: bool = False) -> OwnSafety:
    """Failsafes and fence of a multicopter with PX4 that is flown in Offboard mode and lands in Land mode.

    A bad position ends Offboard mode by landing, because Return needs a position too: COM_POS_LOW_ACT and
    COM_POSCTL_NAVL act in other modes only.

    Args:
        values: of those of `PX4_SAFETY` that the vehicle has.
        flies_rates: has no effect: it lands when set-points stop, whatever they are.
    """

    def whole(name: str) -> int:
        return int(values.get(name, 0.0))

    def failsafe(cause: str, name: str, actions: dict[int, Action], stays: int) -> Failsafe:
        return Failsafe(cause, actions.get(whole(name), _N), f"{name} is {whole(name)}", f"{name} to {stays}")

    found = [failsafe("set-points stop", "COM_OBL_RC_ACT", _OF_OFFBOARD, 4)]
    for cause, name, bits, is_used in (
        ("radio", "NAV_RCL_ACT", "COM_RCL_EXCEPT", whole("COM_RC_IN_MODE") != _WITHOUT_STICKS),
        ("ground station", "NAV_DLL_ACT", "COM_DLL_EXCEPT", True),
    ):
        ignored = whole(bits) & (_EXCEPT_LANDING | _EXCEPT_OFFBOARD)
        if is_used and ignored != _EXCEPT_LANDING | _EXCEPT_OFFBOARD:
            when = " while it lands" if ignored & _EXCEPT_OFFBOARD else ""
            found.append(failsafe(f"its {cause} is lost{when}", name, _OF_LINK, 3))
    found += [
        failsafe("its battery is critical", "COM_LOW_BAT_ACT", _OF_BATTERY, 2),
        failsafe("its battery lasts just for the way home", "COM_FLTT_LOW_ACT", _OF_TIME, 1),
        failsafe("a motor fails", "COM_ACT_FAIL_ACT", _OF_MOTOR, 2),
        failsafe("its satellites are lost", "COM_GNSSLOSS_ACT", _OF_SATELLITES, 2),
        failsafe("it leaves its own fence", "GF_ACTION", _OF_FENCE, 5),
    ]
    if values.get("COM_WIND_MAX", 0.0) > 0:
        found.append(failsafe("the wind is too strong", "COM_WIND_MAX_ACT", _OF_FENCE, 5))
    if (longest_s := values.get("COM_FLT_TIME_MAX", 0.0)) > 0:
        setting = f"COM_FLT_TIME_MAX is {longest_s:g} s"
        found.append(Failsafe("it has flown for its time", _R, setting, "COM_FLT_TIME_MAX to -1"))
    walls = {
        name: values[name] for name in ("GF_MAX_VER_DIST", "GF_MAX_HOR_DIST") if values.get(name, 0.0) > 0
    }
    needed = ["NAV_RCL_ACT"]
    if any(each.action is _R for each in found):
        needed.append("RTL_RETURN_ALT")
    height_m, angle = values.get("RTL_RETURN_ALT", 0.0), values.get("RTL_CONE_ANG", 0.0)
    return OwnSafety(
        failsafes=tuple(found),
        way_home=ConeHome(
            height_m=height_m,
            slope=1 / math.tan(math.radians(min(max(angle, 1.0), 89.0))) if angle > 0 else math.inf,
            near_m=values.get("RTL_MIN_DIST", math.inf),
            arrived_m=values.get("NAV_ACC_RAD", 0.0),
            setting=f"RTL_RETURN_ALT is {height_m:g} m",
        ),
        not_home=tuple(_not_home(values)),
        highest_m=walls.get("GF_MAX_VER_DIST", math.inf),
        farthest_m=walls.get("GF_MAX_HOR_DIST", math.inf),
        fence="; ".join(f"{name} is {value:g} m" for name, value in walls.items()),
        unknown=tuple(name for name in needed if name not in values),
        unjudged=("its polygon fences and rally points are not read: there must be none near",),
        alone_s=values.get("COM_OF_LOSS_T", math.nan),
    )


def _not_home(values: Mapping[str, float]) -> list[str]:
    """Why it may fly elsewhere than straight home, or by another height."""
    found = []
    if values.get("RTL_TYPE"):
        found.append(f"RTL_TYPE is {values['RTL_TYPE']:g}: it may fly along a mission; set it to 0")
    if values.get("RTL_CONE_ANG", 0.0) >= 90:
        found.append(
            "RTL_CONE_ANG is 90: its height differs between versions of PX4; set it to 0, or to at most 80"
        )
    return found
