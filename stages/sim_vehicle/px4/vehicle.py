"""The vehicle with PX4's manners: streams of set-points, arming, and what happens when something is lost.

Taken from PX4's documentation, not observed of PX4; docs/guide/sim-vehicle.md says what of it is uncertain.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import IntEnum
from typing import ClassVar

from alula.stages.sim_vehicle.ardupilot.battery import Charge
from alula.stages.sim_vehicle.ardupilot.copter import CRITICAL, INFO, WARNING, Copter
from alula.stages.sim_vehicle.ardupilot.estimator import LatLonAlt
from alula.stages.sim_vehicle.ardupilot.parameters import Parameters
from alula.stages.sim_vehicle.px4.modes import ROWS, SWITCHED, Px4Mode
from alula.stages.sim_vehicle.px4.parameters import DERIVED, TABLE

ZURICH: LatLonAlt = (47.397742, 8.545594, 488.0)  # where PX4's simulation starts

_SLOWEST_S = 0.5  # set-points further apart are no stream: 2 Hz
_PROOF_S = 1.0  # of a stream, before it counts
_ESTIMATOR_S = 1.0  # a bad estimate for this long is a failsafe
_NO_STICKS = 4  # COM_RC_IN_MODE
_EXCEPT_OFFBOARD = 4  # COM_RCL_EXCEPT
_IN_AUTO, _IN_OFFBOARD = 1, 2  # COM_RC_OVERRIDE
_ON_TOP_M = 0.3  # below its height a take-off is over


class Action(IntEnum):
    """What a failsafe does, the most severe last."""

    NONE = 0
    STABILIZED = 1
    ALTITUDE = 2
    POSITION = 3
    HOLD = 4
    RETURN = 5
    LAND = 6
    DISARM = 7


_FLOWN = {
    Action.STABILIZED: Px4Mode.STABILIZED,
    Action.ALTITUDE: Px4Mode.ALTCTL,
    Action.POSITION: Px4Mode.POSCTL,
    Action.HOLD: Px4Mode.HOLD,
    Action.RETURN: Px4Mode.RTL,
    Action.LAND: Px4Mode.LAND,
}
# By the values of COM_OBL_RC_ACT, and of NAV_RCL_ACT and NAV_DLL_ACT. To terminate is to disarm here.
_OFFBOARD_ACTION = {
    0: Action.POSITION,
    1: Action.ALTITUDE,
    2: Action.STABILIZED,
    3: Action.RETURN,
    4: Action.LAND,
    5: Action.HOLD,
    6: Action.DISARM,
    7: Action.DISARM,
}
_LINK_ACTION = {1: Action.HOLD, 2: Action.RETURN, 3: Action.LAND, 5: Action.DISARM, 6: Action.DISARM}
_BATTERY_ACTION = {
    2: {Charge.CRITICAL: Action.LAND},
    3: {Charge.CRITICAL: Action.RETURN},
}


class Px4Copter(Copter):
    """A `Copter` that takes itself for one with PX4.

    Two modes are kept: the one that was chosen, and the one that flies. They differ while a failsafe acts;
    when its cause is gone the vehicle goes back to the chosen one **by itself**, to Offboard too. Who chooses
    a mode meanwhile ends the failsafe, until something else happens.
    """

    AUTOPILOT: ClassVar[str] = "px4"
    FIRMWARE: ClassVar[str] = "PX4 v1.15.4 (simulated)"
    HOVER: ClassVar[str] = "MPC_THR_HOVER"
    PLACE: ClassVar[LatLonAlt] = ZURICH
    ARMING_DELAY_S: ClassVar[float] = 0.0

    def _boot(self) -> None:
        self.chosen = self.flown = Px4Mode.HOLD
        self._setpoint_s = self._stream_s = -math.inf
        self._since_s: dict[str, float] = {}  # when each cause of a failsafe began
        self._ended: set[str] = set()  # causes that somebody has taken over from
        self._top_m: float | None = None  # of a take-off, above the local origin
        self._has_flown = False
        self.mode = ROWS[self.flown].flown

    def _parameters(self, values: Mapping[str, float]) -> Parameters:
        return Parameters(values, table=TABLE, derived=DERIVED)

    @property
    def has_stream(self) -> bool:
        """Whether set-points came at 2 Hz for over a second, and the last one within COM_OF_LOSS_T."""
        last_s = self.time_s - self._setpoint_s
        return last_s <= self.parameters["COM_OF_LOSS_T"] and self.time_s - self._stream_s > _PROOF_S

    def hear_setpoint(self) -> bool:
        """A set-point that PX4 understands, in whatever mode; whether it is to be followed."""
        if self.time_s - self._setpoint_s > min(_SLOWEST_S, self.parameters["COM_OF_LOSS_T"]):
            self._stream_s = self.time_s
        self._setpoint_s = self.time_s
        return self.flown is Px4Mode.OFFBOARD

    def hear_ground_station(self, system: int) -> None:
        """A heartbeat of a ground station, whatever its system."""
        self.hear_client()
        self._gcs_s = self.time_s

    def refusal(self, mode: Px4Mode) -> str | None:
        """Why a mode cannot be entered; None if it can."""
        if ROWS[mode].needs_position and not self.estimator.has_position:
            return "no valid position estimate"
        if mode is Px4Mode.OFFBOARD and not self.has_stream:
            return "no offboard signal"
        return None

    def set_mode(self, number: int) -> bool:
        """Enter a mode, by custom_mode; refusals are said."""
        if number not in Px4Mode._value2member_map_:
            self.say(WARNING, f"Switching to mode {number:#x} is not simulated")
            return False
        mode = Px4Mode(number)
        if (reason := self.refusal(mode)) is not None:
            self.say(CRITICAL, f"Switching to {ROWS[mode].name} is currently not available: {reason}")
            return False
        if mode is Px4Mode.TAKEOFF and self._top_m is None:
            self._top_m = self._least_top_m()
        self._ended |= self._since_s.keys()
        self.chosen = mode
        self._fly(mode)
        return True

    def switch_to(self, number: float | None) -> None:
        """A fault: the pilot's switch goes to a place, Position unless one is named."""
        mode = Px4Mode.POSCTL if number is None else SWITCHED.get(int(number))
        if mode is None:
            self.say(WARNING, f"Switch place {number:g} is not simulated")
        else:
            self.set_mode(mode)

    def take_off(self, height_m: float) -> bool:
        """NAV_TAKEOFF to an altitude **above the sea**; without a number to MIS_TAKEOFF_ALT above home.

        An altitude lower than MIS_TAKEOFF_ALT above home is raised to that, and a text says so.
        """
        if not self.estimator.has_position:
            return False
        least_m = self._least_top_m()
        top_m = least_m
        if math.isfinite(height_m):
            top_m = -self.estimator.local_position((*self.PLACE[:2], height_m))[2]
            if top_m < least_m - 1e-3:
                lowest = self.parameters["MIS_TAKEOFF_ALT"]
                self.say(CRITICAL, f"Using minimum takeoff altitude: {lowest:.2f} m")
                top_m = least_m
        self._top_m = top_m
        return self.set_mode(Px4Mode.TAKEOFF)

    def go_to(self, place: LatLonAlt) -> bool:
        """DO_REPOSITION: hold there."""
        if not (self.is_armed and not self.is_landed and self.set_mode(Px4Mode.HOLD)):
            return False
        self.mode = ROWS[Px4Mode.TAKEOFF].flown
        self.flying.enter(self.mode, self.estimator.motion)
        self.flying.guided.go_to(self.estimator.motion, self.estimator.local_position(place))
        return True

    def arming_refusal(self) -> str | None:
        """Why it would not arm; None if it would."""
        row = ROWS[self.chosen]
        if not self.estimator.is_started or self.estimator.is_sick:
            return "ekf2 missing data"
        if not row.can_arm:
            return "Mode not suitable for takeoff"
        if (reason := self.refusal(self.chosen)) is not None:
            return reason
        if self.battery.charge is not Charge.GOOD:
            return "Low battery"
        if self._is_radio_missed():
            return "No manual control input"
        if self.parameters.whole("NAV_DLL_ACT") and self._is_ground_station_away():
            return "No connection to the ground control station"
        return None

    def arm(self, *, forced: bool = False) -> bool:
        """COMPONENT_ARM_DISARM; **force skips every check**."""
        if self.is_armed:
            return True
        if not forced and (reason := self.arming_refusal()) is not None:
            self.say(CRITICAL, f"Preflight Fail: {reason}")
            self.say(CRITICAL, "Arming denied: Resolve system health failures first")
            return False
        self.is_armed, self._armed_s, self._idle_s, self._has_flown = True, self.time_s, 0.0, False
        self._since_s.clear()
        self._ended.clear()
        self.flying.home = self.estimator.motion.position
        if self.chosen is Px4Mode.TAKEOFF and self._top_m is None:
            self._top_m = self._least_top_m()
        self._fly(self.chosen, again=True)
        self.say(INFO, "Armed by external command")
        return True

    def disarm(self, *, forced: bool = False) -> bool:
        """Refused in the air, unless forced."""
        if not (self.is_landed or forced):
            self.say(CRITICAL, "Disarming denied: not landed")
            return False
        if self.is_armed:
            self.is_armed, self.failsafe, self._top_m = False, "", None
            self.chosen = self.flown
            self.say(INFO, "Disarmed")
        return True

    def _least_top_m(self) -> float:
        ground = self.flying.home if self.is_armed else self.estimator.motion.position
        return self.parameters["MIS_TAKEOFF_ALT"] - ground[2]

    def _fly(self, mode: Px4Mode, *, again: bool = False) -> None:
        """Let a mode fly, from the start if it does so already."""
        if mode is not Px4Mode.TAKEOFF:
            self._top_m = None
        if mode is self.flown and self.mode is ROWS[mode].flown and not again and mode is not Px4Mode.TAKEOFF:
            return
        self.flown, self.mode = mode, ROWS[mode].flown
        motion = self.estimator.motion
        self.flying.enter(self.mode, motion)
        if mode is Px4Mode.TAKEOFF and self._top_m is not None:
            self.flying.guided.take_off(motion, self._top_m)

    def _check(self, passed_s: float) -> None:
        if (switched := self.pilot.moved_switch(self.time_s)) is not None and switched in SWITCHED:
            self.set_mode(SWITCHED[switched])
        self._has_flown = self._has_flown or (self.is_armed and not self.is_landed)
        self._override_by_sticks()
        self._judge_battery(passed_s)
        self._judge_failsafes(passed_s)
        if self.flown is Px4Mode.TAKEOFF and self.is_armed and self._top_m is not None:
            motion = self.estimator.motion
            if -motion.position[2] > self._top_m - _ON_TOP_M:
                self.chosen = Px4Mode.HOLD
                self._fly(Px4Mode.HOLD)
        self.pilot.attend(landed=self.is_landed)

    def _override_by_sticks(self) -> None:
        """The pilot's sticks, further out than COM_RC_STICK_OV, take over to Position."""
        bit = _IN_OFFBOARD if self.flown is Px4Mode.OFFBOARD else _IN_AUTO
        if ROWS[self.flown].is_piloted or self.is_landed or self.pilot.is_lost:
            return
        if not self.parameters.whole("COM_RC_OVERRIDE") & bit or self._without_sticks():
            return
        most = max(abs(self.pilot.stick(name, self.time_s)) for name in ("ROLL", "PITCH", "YAW"))
        if most > self.parameters["COM_RC_STICK_OV"] / 100 and self.set_mode(Px4Mode.POSCTL):
            self.say(INFO, "Pilot took over using sticks")

    def _judge_battery(self, passed_s: float) -> None:
        battery = self.battery
        battery.use(passed_s, self.attitude.throttle / self.hover_throttle)
        levels = ((Charge.LOW, "LOW"), (Charge.CRITICAL, "CRIT"))
        for level, name in levels:
            if battery.share < self.parameters[f"BAT_{name}_THR"] and battery.charge < level:
                battery.charge = level
                self.say(CRITICAL, f"{'Low' if level is Charge.LOW else 'Critical'} battery level")

    def _judge_failsafes(self, passed_s: float) -> None:
        """The most severe action of all causes that are there, each after COM_FAIL_ACT_T of Hold."""
        if not self.is_armed:
            return
        needs = ROWS[self.flown].needs_position and not self.estimator.has_position
        self._bad_s = self._bad_s + passed_s if needs or "estimator" in self._since_s else 0.0
        causes = {cause: row for cause, row in self._causes().items() if row[0] is not Action.NONE}
        for cause in [cause for cause in self._since_s if cause not in causes]:
            del self._since_s[cause]
            self._ended.discard(cause)
        action, reason = Action.NONE, ""
        for cause, (wanted, waits) in causes.items():
            began_s = self._since_s.setdefault(cause, self.time_s)
            if waits and self.time_s - began_s < self.parameters["COM_FAIL_ACT_T"]:
                wanted = min(wanted, Action.HOLD)
            if cause not in self._ended and wanted > action:
                action, reason = wanted, cause
        if reason and reason != self.failsafe:
            self.say(CRITICAL, f"Failsafe activated: {reason}")
        elif self.failsafe and not reason:
            self.say(INFO, "Failsafe deactivated")
        has_ended = bool(self.failsafe) and not reason
        self.failsafe = reason
        if action is Action.DISARM:
            self.disarm(forced=True)
        elif reason:
            mode = _FLOWN[action]
            if ROWS[mode].needs_position and not self.estimator.has_position:
                mode = Px4Mode.LAND
            self._fly(mode)
        elif has_ended and self.refusal(self.chosen) is None:
            self._fly(self.chosen)

    def _causes(self) -> dict[str, tuple[Action, bool]]:
        """What is wrong now: its action, and whether it waits in Hold first."""
        whole = self.parameters.whole
        found: dict[str, tuple[Action, bool]] = {}
        if self.chosen is Px4Mode.OFFBOARD and not self.has_stream:
            action = _OFFBOARD_ACTION.get(whole("COM_OBL_RC_ACT"), Action.LAND)
            if action <= Action.POSITION and (self.pilot.is_lost or self._without_sticks()):
                action = _LINK_ACTION.get(whole("NAV_RCL_ACT"), Action.LAND)  # nobody to fly it by hand
            found["no offboard signal"] = (action, False)
        if self._is_radio_missed():
            found["manual control lost"] = (_LINK_ACTION.get(whole("NAV_RCL_ACT"), Action.NONE), True)
        if self._gcs_s is not None and self._is_ground_station_away():
            found["GCS connection lost"] = (_LINK_ACTION.get(whole("NAV_DLL_ACT"), Action.NONE), True)
        action = _BATTERY_ACTION.get(whole("COM_LOW_BAT_ACT"), {}).get(self.battery.charge, Action.NONE)
        if action is Action.RETURN and self.battery.share < self.parameters["BAT_EMERGEN_THR"]:
            found["emergency battery"] = (Action.LAND, False)
        found["low battery"] = (action, True)
        if self._bad_s >= _ESTIMATOR_S - 1e-9 and not self.estimator.has_position:
            found["estimator"] = (Action.LAND, False)
        return found

    def _without_sticks(self) -> bool:
        return self.parameters.whole("COM_RC_IN_MODE") == _NO_STICKS

    def _is_radio_missed(self) -> bool:
        is_excepted = self.chosen is Px4Mode.OFFBOARD and (
            self.parameters.whole("COM_RCL_EXCEPT") & _EXCEPT_OFFBOARD
        )
        return self.pilot.is_lost and not self._without_sticks() and not is_excepted

    def _is_ground_station_away(self) -> bool:
        return self._gcs_s is None or self.time_s - self._gcs_s > self.parameters["COM_DL_LOSS_T"]

    def _touch_down(self) -> None:
        self._idle_s = 0.0

    def _disarm_delay_s(self) -> float:
        return self.parameters["COM_DISARM_LAND" if self._has_flown else "COM_DISARM_PRFLT"]
