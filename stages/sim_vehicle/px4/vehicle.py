"""The vehicle with PX4's behaviour: streams of set-points, arming, and failsafes.

Times, answers and parameters that `tests/support/vehicles/px4_responses.py` measures are those of PX4 1.18 in
its own simulation, the rest follows PX4's documentation. docs/guide/sim-vehicle.md lists what is uncertain.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import IntEnum
from typing import ClassVar

from alula.schemas.scenarios.vehicle import Vehicle
from alula.stages.sim_vehicle.ardupilot.attitude import AttitudeControl
from alula.stages.sim_vehicle.ardupilot.flying import Flying
from alula.stages.sim_vehicle.ardupilot.position import PositionControl
from alula.stages.sim_vehicle.common.battery import Charge
from alula.stages.sim_vehicle.common.copter import CRITICAL, INFO, WARNING, Copter
from alula.stages.sim_vehicle.common.estimator import LatLonAlt
from alula.stages.sim_vehicle.common.parameters import Parameters
from alula.stages.sim_vehicle.px4.attitude import Px4AttitudeControl
from alula.stages.sim_vehicle.px4.flying import Px4Flying
from alula.stages.sim_vehicle.px4.modes import ROWS, SWITCHED, Px4Mode
from alula.stages.sim_vehicle.px4.parameters import DERIVED, TABLE
from alula.stages.sim_vehicle.px4.position import Px4PositionControl

ZURICH: LatLonAlt = (47.397742, 8.545594, 488.0)  # start of PX4's own simulation

_SLOWEST_S = 0.5  # maximum interval of set-points in a stream: 2 Hz
_PROOF_S = 1.0  # a stream counts after this time
_ESTIMATOR_S = 1.0  # a bad estimate for this long triggers a failsafe
_NO_STICKS = 4  # value of COM_RC_IN_MODE
_EXCEPT_AUTO, _EXCEPT_OFFBOARD = 2, 4  # bits of COM_RCL_EXCEPT
_IN_AUTO, _IN_OFFBOARD = 1, 2  # bits of COM_RC_OVERRIDE
_ON_TOP_M = 0.3  # a take-off ends this far below its height


class Action(IntEnum):
    """Action of a failsafe, the most severe last."""

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
# Actions by the values of COM_OBL_RC_ACT, and of NAV_RCL_ACT and NAV_DLL_ACT. Termination is a disarm here.
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
_FENCE_ACTION = {2: Action.HOLD, 3: Action.RETURN, 4: Action.DISARM, 5: Action.LAND}
_BATTERY_ACTION = {
    2: {Charge.CRITICAL: Action.LAND},
    3: {Charge.CRITICAL: Action.RETURN},
}


class Px4Copter(Copter):
    """A `Copter` with the firmware PX4.

    It keeps two modes: the chosen one and the one that is flown. They differ while a failsafe acts. When the
    cause is gone the vehicle returns to the chosen mode **by itself**, also to Offboard. Choosing a mode
    meanwhile ends the failsafe until another cause appears.
    """

    AUTOPILOT: ClassVar[str] = "px4"
    FIRMWARE: ClassVar[str] = "PX4 v1.15.4 (simulated)"
    HOVER: ClassVar[str] = "MPC_THR_HOVER"
    LOCATION: ClassVar[LatLonAlt] = ZURICH
    POSITION: ClassVar[type[PositionControl]] = Px4PositionControl
    FLYING: ClassVar[type[Flying]] = Px4Flying
    LANDED_S: ClassVar[float] = 2.5

    def _boot(self) -> None:
        self.chosen = self.flown = Px4Mode.HOLD
        self.estimator.needs_origin = False
        self.estimator.follows_s = 1.8
        self._lands_from: Px4Mode | None = None  # mode in which its landing was chosen
        self._setpoint_s = self._stream_s = -math.inf
        self._since_s: dict[str, float] = {}  # when each cause of a failsafe began
        self._ended: set[str] = set()  # causes ended by the choice of a mode
        self._top_m: float | None = None  # height of a take-off above the local origin
        self._has_flown = self._has_left = self._is_told = False
        self.mode = ROWS[self.flown].flown

    def _plant(self, vehicle: Vehicle) -> Vehicle:
        return vehicle

    def _attitude_control(self, vehicle: Vehicle) -> AttitudeControl:
        rates_s, motor_s = vehicle.rates.axes_s, vehicle.disturbance.motor_time_constant_s
        return Px4AttitudeControl(self.airframe, self.parameters, rates_s, motor_s)

    def _parameters(self, values: Mapping[str, float]) -> Parameters:
        return Parameters(values, table=TABLE, derived=DERIVED)

    @property
    def has_stream(self) -> bool:
        """Return whether set-points came at 2 Hz for over a second, the last within COM_OF_LOSS_T."""
        last_s = self.time_s - self._setpoint_s
        return last_s <= self.parameters["COM_OF_LOSS_T"] and self.time_s - self._stream_s > _PROOF_S

    def note_setpoint(self) -> bool:
        """Record a set-point of a supported kind, in any mode; returns whether it is to be followed."""
        if self.time_s - self._setpoint_s > min(_SLOWEST_S, self.parameters["COM_OF_LOSS_T"]):
            self._stream_s = self.time_s
        self._setpoint_s = self.time_s
        return self.flown is Px4Mode.OFFBOARD

    def note_ground_station(self, system: int) -> None:
        """Record a heartbeat of a ground station with any system id."""
        self.note_client()
        self._gcs_s = self.time_s

    def refusal(self, mode: Px4Mode) -> str | None:
        """Reason why a mode cannot be entered; None if it can."""
        if ROWS[mode].needs_position and not self.estimator.has_position:
            return "no valid position estimate"
        if mode is Px4Mode.OFFBOARD and not self.has_stream:
            return "no offboard signal"
        return None

    def set_mode(self, number: int) -> bool:
        """Enter a mode by its custom_mode; returns whether it was entered. A text states a refusal."""
        if number not in Px4Mode._value2member_map_:
            self.say(WARNING, f"Switching to mode {number:#x} is not simulated")
            return False
        mode = Px4Mode(number)
        is_idle = mode is Px4Mode.OFFBOARD and not self.is_armed  # then only arming needs set-points
        if not is_idle and (reason := self.refusal(mode)) is not None:
            self.say(CRITICAL, f"Switching to {ROWS[mode].name} is currently not available: {reason}")
            return False
        if mode is Px4Mode.TAKEOFF and self._top_m is None:
            self._top_m = self._min_top_m()
        self._ended |= self._since_s.keys()
        self._has_left = False
        if mode is Px4Mode.LAND and self.chosen is not mode:
            self._lands_from = self.chosen
        self.chosen = mode
        self._fly(mode)
        return True

    def switch_to(self, number: float | None) -> None:
        """Apply a fault: set the pilot's switch to a value of COM_FLTMODE; None for Position."""
        mode = Px4Mode.POSCTL if number is None else SWITCHED.get(int(number))
        if mode is None:
            self.say(WARNING, f"Switch position {number:g} is not simulated")
        else:
            self.set_mode(mode)

    def take_off(self, height_m: float) -> bool:
        """Execute NAV_TAKEOFF; returns whether it is possible.

        A target lower than MIS_TAKEOFF_ALT above home is raised to that height, and a text states it.

        Args:
            height_m: altitude **above the sea** [m]; NaN for MIS_TAKEOFF_ALT above home.
        """
        if not self.estimator.has_position:
            return False
        min_m = self._min_top_m()
        top_m = min_m
        if math.isfinite(height_m):
            top_m = -self.estimator.local_position((*self.LOCATION[:2], height_m))[2]
            if top_m < min_m - 1e-3:
                lowest = self.parameters["MIS_TAKEOFF_ALT"]
                self.say(CRITICAL, f"Using minimum takeoff altitude: {lowest:.2f} m")
                top_m = min_m
        self._top_m = top_m
        return self.set_mode(Px4Mode.TAKEOFF)

    def go_to(self, location: LatLonAlt) -> bool:
        """Execute DO_REPOSITION: fly to a location and hold; returns whether it is possible.

        Args:
            location: latitude, longitude [deg] and altitude [m].
        """
        if not (self.is_armed and not self.is_landed and self.set_mode(Px4Mode.HOLD)):
            return False
        self.mode = ROWS[Px4Mode.TAKEOFF].flown
        self.flying.enter(self.mode, self.estimator.motion)
        self.flying.guided.go_to(self.estimator.motion, self.estimator.local_position(location))
        return True

    def arming_refusal(self) -> str | None:
        """Reason why it would not arm; None if it would."""
        row = ROWS[self.chosen]
        if not self.estimator.is_started or self.estimator.has_failed:
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

    def check_refusal(self) -> str | None:
        """Reason why it would not arm in the chosen mode; None if it would."""
        return self.arming_refusal()

    def arm(self, *, forced: bool = False) -> bool:
        """See `Copter`; `forced` **skips every check**."""
        if self.is_armed:
            return True
        if not forced and (reason := self.arming_refusal()) is not None:
            self.say(CRITICAL, f"Preflight Fail: {reason}")
            self.say(CRITICAL, "Arming denied: Resolve system health failures first")
            return False
        self.is_armed, self._armed_s, self._idle_s, self._has_flown = True, self.time_s, 0.0, False
        self._since_s.clear()
        self._ended.clear()
        self._has_left = False
        self.flying.home = self.estimator.motion.position
        if self.chosen is Px4Mode.TAKEOFF and self._top_m is None:
            self._top_m = self._min_top_m()
        self._fly(self.chosen, again=True)
        self.say(INFO, "Armed by external command")
        return True

    def disarm(self, *, forced: bool = False) -> bool:
        """See `Copter`."""
        if not (self.is_landed or forced):
            self.say(CRITICAL, "Disarming denied: not landed")
            return False
        if self.is_armed:
            self.is_armed, self.failsafe, self._top_m = False, "", None
            self.chosen = self.flown
            if self.chosen is Px4Mode.LAND and self._lands_from is Px4Mode.OFFBOARD:
                self.chosen = self.flown = Px4Mode.OFFBOARD
                self.mode = ROWS[self.flown].flown
            self.say(INFO, "Disarmed")
        return True

    def spoil_compass(self, *, is_bad: bool) -> None:
        """See `Copter`; what PX4 does then was not measured."""
        if is_bad and not self._is_told:
            self._is_told = True
            self.say(WARNING, "A compass that is off is not simulated")

    def _min_top_m(self) -> float:
        ground = self.flying.home if self.is_armed else self.estimator.motion.position
        return self.parameters["MIS_TAKEOFF_ALT"] - ground[2]

    def _fly(self, mode: Px4Mode, *, again: bool = False) -> None:
        """Fly a mode; `again` restarts it if it is already flown."""
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
        """Change to Position when the pilot moves a stick beyond COM_RC_STICK_OV."""
        bit = _IN_OFFBOARD if self.flown is Px4Mode.OFFBOARD else _IN_AUTO
        if ROWS[self.flown].is_piloted or self.is_landed or self.pilot.is_lost:
            return
        if not self.parameters.whole("COM_RC_OVERRIDE") & bit or self._without_sticks():
            return
        deflection = max(abs(self.pilot.stick(name, self.time_s)) for name in ("ROLL", "PITCH", "YAW"))
        if deflection > self.parameters["COM_RC_STICK_OV"] / 100 and self.set_mode(Px4Mode.POSCTL):
            self.say(INFO, "Pilot took over using sticks")

    def _judge_battery(self, passed_s: float) -> None:
        battery = self.battery
        battery.use(passed_s, self.attitude.throttle / self.hover_throttle)
        levels = ((Charge.LOW, "LOW"), (Charge.CRITICAL, "CRIT"))
        for level, name in levels:
            if battery.remaining < self.parameters[f"BAT_{name}_THR"] and battery.charge < level:
                battery.charge = level
                self.say(CRITICAL, f"{'Low' if level is Charge.LOW else 'Critical'} battery level")

    def _judge_failsafes(self, passed_s: float) -> None:
        """Execute the most severe action of all present causes, each after COM_FAIL_ACT_T of Hold."""
        if not self.is_armed:
            return
        needs = ROWS[self.flown].needs_position and not self.estimator.has_position
        self._bad_s = self._bad_s + passed_s if needs or "estimator" in self._since_s else 0.0
        causes = {cause: row for cause, row in self._causes().items() if row[0] is not Action.NONE}
        for cause in [cause for cause in self._since_s if cause not in causes]:
            del self._since_s[cause]
            self._ended.discard(cause)
        action, reason = Action.NONE, ""
        for cause, (candidate, waits) in causes.items():
            began_s = self._since_s.setdefault(cause, self.time_s)
            if waits and self.time_s - began_s < self.parameters["COM_FAIL_ACT_T"]:
                candidate = min(candidate, Action.HOLD)
            if cause not in self._ended and candidate > action:
                action, reason = candidate, cause
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
        """Present causes of a failsafe: the action of each, and whether it first waits in Hold."""
        whole = self.parameters.whole
        found: dict[str, tuple[Action, bool]] = {}
        if self.chosen is Px4Mode.OFFBOARD and not self.has_stream:
            action = _OFFBOARD_ACTION.get(whole("COM_OBL_RC_ACT"), Action.LAND)
            if action <= Action.POSITION and (self.pilot.is_lost or self._without_sticks()):
                action = _LINK_ACTION.get(whole("NAV_RCL_ACT"), Action.LAND)  # no pilot can take over
            found["no offboard signal"] = (action, False)
        if self._is_radio_missed():
            found["manual control lost"] = (_LINK_ACTION.get(whole("NAV_RCL_ACT"), Action.NONE), True)
        if self._gcs_s is not None and self._is_ground_station_away():
            found["GCS connection lost"] = (_LINK_ACTION.get(whole("NAV_DLL_ACT"), Action.NONE), True)
        action = _BATTERY_ACTION.get(whole("COM_LOW_BAT_ACT"), {}).get(self.battery.charge, Action.NONE)
        if action is Action.RETURN and self.battery.remaining < self.parameters["BAT_EMERGEN_THR"]:
            found["emergency battery"] = (Action.LAND, False)
        found["low battery"] = (action, True)
        found["geofence violation"] = (self._fence_action(), True)
        if 0 < self.parameters["COM_FLT_TIME_MAX"] < self.time_s - self._armed_s:
            found["maximum flight time reached"] = (Action.RETURN, True)
        if self._bad_s >= _ESTIMATOR_S - 1e-9 and not self.estimator.has_position:
            found["estimator"] = (Action.LAND, False)
        return found

    def _fence_action(self) -> Action:
        """Action of the fence around the take-off position, from its breach until a mode is chosen."""
        place, home, p = self.estimator.motion.position, self.flying.home, self.parameters
        away_m, above_m = math.dist(place[:2], home[:2]), home[2] - place[2]
        if 0 < p["GF_MAX_HOR_DIST"] < away_m or 0 < p["GF_MAX_VER_DIST"] < above_m:
            self._has_left = True
        return _FENCE_ACTION.get(p.whole("GF_ACTION"), Action.NONE) if self._has_left else Action.NONE

    def _without_sticks(self) -> bool:
        return self.parameters.whole("COM_RC_IN_MODE") == _NO_STICKS

    def _is_radio_missed(self) -> bool:
        bit = _EXCEPT_OFFBOARD if self.chosen is Px4Mode.OFFBOARD else _EXCEPT_AUTO
        is_excepted = not ROWS[self.chosen].is_piloted and self.parameters.whole("COM_RCL_EXCEPT") & bit
        return self.pilot.is_lost and not self._without_sticks() and not is_excepted

    def _is_ground_station_away(self) -> bool:
        return self._gcs_s is None or self.time_s - self._gcs_s > self.parameters["COM_DL_LOSS_T"]

    def _crash(self) -> None:
        """Nothing: by default its failure detector does not act in the air."""

    def _touch_down(self) -> None:
        self._idle_s = 0.0

    def _disarm_delay_s(self) -> float:
        return self.parameters["COM_DISARM_LAND" if self._has_flown else "COM_DISARM_PRFLT"]
