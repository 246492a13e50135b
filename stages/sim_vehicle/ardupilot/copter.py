"""The vehicle with ArduPilot Copter's behaviour: modes, arming and failsafes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from alula.schemas.scenarios.vehicle import Vehicle
from alula.stages.sim_vehicle.ardupilot.attitude import AttitudeControl
from alula.stages.sim_vehicle.ardupilot.drag import with_drag
from alula.stages.sim_vehicle.ardupilot.flying import Flying
from alula.stages.sim_vehicle.ardupilot.modes import MODES, Mode, refusal
from alula.stages.sim_vehicle.ardupilot.parameters import TABLE
from alula.stages.sim_vehicle.ardupilot.position import PositionControl
from alula.stages.sim_vehicle.common.battery import Charge
from alula.stages.sim_vehicle.common.copter import CRITICAL, EMERGENCY, INFO, WARNING, Copter
from alula.stages.sim_vehicle.common.estimator import LatLonAlt
from alula.stages.sim_vehicle.common.parameters import Parameters

HOME: LatLonAlt = (-35.3632621, 149.1652374, 584.0)  # start of ArduPilot's own simulation

_ESTIMATOR_S = 1.0  # a bad estimate for this long triggers a failsafe
_REMINDER_S = 30.0  # between texts with the reason why it would not arm
_GCS_ACTION = {1: Mode.RTL, 2: Mode.RTL, 3: Mode.RTL, 4: Mode.LAND, 5: Mode.LAND, 7: Mode.BRAKE}
_THROTTLE_ACTION = {1: Mode.RTL, 2: Mode.RTL, 3: Mode.LAND, 4: Mode.RTL, 5: Mode.LAND, 7: Mode.BRAKE}
_BATTERY_ACTION = {1: Mode.LAND, 2: Mode.RTL, 3: Mode.RTL, 4: Mode.LAND, 7: Mode.BRAKE}
_CONTINUES_IN_PILOTED = 16  # bit of FS_OPTIONS


class ArduCopter(Copter):
    """A `Copter` with the firmware ArduPilot."""

    AUTOPILOT: ClassVar[str] = "ardupilot"
    FIRMWARE: ClassVar[str] = "ArduCopter V4.7.0-dev (simulated)"
    HOVER: ClassVar[str] = "MOT_THST_HOVER"
    LOCATION: ClassVar[LatLonAlt] = HOME
    POSITION: ClassVar[type[PositionControl]] = PositionControl
    FLYING: ClassVar[type[Flying]] = Flying
    ARMING_DELAY_S: ClassVar[float] = 2.0
    LANDED_S: ClassVar[float] = 1.0

    def _boot(self) -> None:
        self._reminded_s = 0.0
        self._active: set[str] = set()
        self._announced: set[str] = set()
        self.mode = Mode.STABILIZE
        initial = self.parameters.whole("INITIAL_MODE")
        if refusal(initial, has_position=True) is None:
            self.mode = Mode(initial)

    def _parameters(self, values: Mapping[str, float]) -> Parameters:
        return Parameters(values, table=TABLE)

    def _plant(self, vehicle: Vehicle) -> Vehicle:
        return with_drag(vehicle)

    def _attitude_control(self, vehicle: Vehicle) -> AttitudeControl:
        return AttitudeControl(self.airframe, self.parameters)

    def arming_refusal(self) -> str | None:
        """Reason why it would not arm, in ArduPilot's words; None if it would."""
        if not MODES[self.mode].can_arm:
            return f"{self.mode.name} mode not armable"
        return self.check_refusal()

    def check_refusal(self) -> str | None:
        """First of its own checks before arming that does not hold, in ArduPilot's words; None if all do."""
        if not self.estimator.is_started:
            return "AHRS: EKF3 not started"
        if MODES[self.mode].needs_position and not self.estimator.has_position:
            if self.parameters.whole("GPS1_TYPE") and not self.estimator.has_fix:
                return "GPS 1: Bad fix"
            return "Need Position Estimate"
        if self.estimator.has_failed:
            return "AHRS: EKF3 unhealthy"
        if self.battery.charge is not Charge.GOOD:
            return "Battery 1 low voltage failsafe"
        if self.pilot.is_lost and self.parameters.whole("FS_THR_ENABLE"):
            return "Radio failsafe on" if self.pilot.was_seen else "RC not found"
        return None

    def arm(self, *, forced: bool = False) -> bool:
        """See `Copter`; `forced` is always refused."""
        if self.is_armed:
            return True
        reason = "forced arming refused" if forced else self.arming_refusal()
        if reason is not None:
            self.say(CRITICAL, f"Arm: {reason}")
            return False
        self.is_armed, self._armed_s, self._idle_s = True, self.time_s, 0.0
        self.flying.home = self.estimator.motion.position
        self.flying.rest(self.estimator.motion)
        self.flying.enter(self.mode, self.estimator.motion)
        self.say(INFO, "Arming motors")
        return True

    def disarm(self, *, forced: bool = False) -> bool:
        """See `Copter`."""
        if not (self.is_landed or forced):
            return False
        if self.is_armed:
            self.is_armed = False
            self.failsafe = ""
            self.say(INFO, "Disarming motors")
        return True

    def set_mode(self, number: int) -> bool:
        """Enter a mode by its number; returns whether it was entered, or a text states why not.

        A disarmed vehicle enters any mode; arming checks what the mode needs.
        """
        reason = refusal(number, has_position=self.estimator.has_position or not self.is_armed)
        if reason is not None:
            self.say(WARNING, reason)
            return False
        if number != self.mode:
            self.mode = Mode(number)
            self.flying.enter(self.mode, self.estimator.motion)
        return True

    def switch_to(self, number: float | None) -> None:
        """Apply a fault: set the pilot's switch to a mode; None for LOITER."""
        self.set_mode(Mode.LOITER if number is None else int(number))

    def take_off(self, height_m: float) -> bool:
        """Execute NAV_TAKEOFF; returns whether it is possible: armed, in GUIDED, on the ground.

        Args:
            height_m: height above home [m].
        """
        if not (self.is_armed and self.is_landed and self.mode is Mode.GUIDED and height_m > 0):
            return False
        self.flying.guided.take_off(self.estimator.motion, height_m - self.flying.home[2])
        return True

    def note_ground_station(self, system: int) -> None:
        """Record a heartbeat of a system; only MAV_GCS_SYSID counts as the ground station."""
        self.note_client()
        if system == self.parameters.whole("MAV_GCS_SYSID"):
            self._gcs_s = self.time_s

    def _check(self, passed_s: float) -> None:
        """Periodic checks: the mode switch, failsafes by their tables of actions, texts."""
        self._announce()
        if (switched := self.pilot.moved_switch(self.time_s)) is not None:
            self.set_mode(switched)
        charge = self.battery.use(passed_s, self.attitude.throttle / self.hover_throttle)
        for level, name in ((Charge.LOW, "LOW"), (Charge.CRITICAL, "CRT")):
            if charge >= level and f"battery {level}" not in self._active:
                self._active.add(f"battery {level}")
                volts, used = self.battery.voltage, self.battery.used_mah
                word = "low" if level is Charge.LOW else "critical"
                self.say(CRITICAL, f"Battery 1 is {word} {volts:.2f}V used {used:.0f} mAh")
                action = self.parameters.whole(f"BATT_FS_{name}_ACT")
                self._act("Battery", _BATTERY_ACTION.get(action))
        age_s = None if self._gcs_s is None else self.time_s - self._gcs_s
        lost = age_s is not None and age_s > self.parameters["FS_GCS_TIMEOUT"]
        action = self.parameters.whole("FS_GCS_ENABLE")
        keeps = MODES[self.mode].is_piloted and self.parameters.whole("FS_OPTIONS") & _CONTINUES_IN_PILOTED
        self._watch("GCS", lost and action > 0, None if keeps else _GCS_ACTION.get(action))
        action = self.parameters.whole("FS_THR_ENABLE")
        no_pilot = self.pilot.channels(self.time_s)[2] < self.parameters["FS_THR_VALUE"]
        self._watch("Radio", no_pilot and action > 0, _THROTTLE_ACTION.get(action))
        threshold = self.parameters["FS_EKF_THRESH"]
        bad = self.estimator.variance > threshold > 0 or not self.estimator.has_position
        needs = self.is_armed and MODES[self.mode].needs_position
        self._bad_s = self._bad_s + passed_s if bad and (needs or "EKF" in self._active) else 0.0
        has_failed = self._bad_s >= _ESTIMATOR_S - 1e-9 and self.parameters.whole("FS_EKF_ACTION") > 0
        if has_failed and "EKF" not in self._active:
            self.say(CRITICAL, "EKF variance")
        self._watch("EKF", has_failed, Mode.LAND)
        if not self.is_armed and self.time_s - self._reminded_s >= _REMINDER_S:
            self._reminded_s = self.time_s
            if (reason := self.check_refusal()) is not None:
                self.say(CRITICAL, f"PreArm: {reason}")
        self.pilot.attend(landed=self.is_landed)

    def _watch(self, name: str, is_bad: bool, action: Mode | None) -> None:
        """Start a failsafe once when its cause appears; send a text when the cause is gone."""
        if is_bad and name not in self._active:
            self._active.add(name)
            self._act(name, action)
        elif not is_bad and name in self._active:
            self._active.discard(name)
            if self.failsafe == name:
                self.failsafe = ""
            self.say(WARNING, f"{name} Failsafe Cleared")

    def _act(self, name: str, action: Mode | None) -> None:
        """Execute a failsafe: change the mode in the air, disarm on the ground."""
        if not self.is_armed:
            return
        self.failsafe = name
        if action is None or self.mode is Mode.LAND:
            self.say(WARNING, f"{name} Failsafe")
        elif self.is_landed:
            self.say(WARNING, f"{name} Failsafe - Disarming")
            self.disarm()
        else:
            is_blind = MODES[action].needs_position and not self.estimator.has_position
            self.set_mode(Mode.LAND if is_blind else action)
            change = f": changed to {self.mode.name} Mode" if name == "EKF" else ""
            self.say(WARNING, f"{name} Failsafe{change}")

    def _crash(self) -> None:
        if self.parameters.whole("FS_CRASH_CHECK"):
            self.say(EMERGENCY, "Crash: Disarming: AngErr=90>30, Accel=0.0<3.0")
            self.disarm(forced=True)

    def _touch_down(self) -> None:
        if self.mode in (Mode.LAND, Mode.RTL):
            self.disarm()

    def _disarm_delay_s(self) -> float:
        return self.parameters["DISARM_DELAY"]

    def _announce(self) -> None:
        now = set()
        if self.estimator.is_started:
            now.add("EKF3 IMU0 initialised")
        if self.estimator.origin is not None:
            now.add("EKF3 IMU0 origin set")
        if self.estimator.is_settled:
            source = "external nav data" if self.estimator.uses_mocap else "GPS"
            now.add(f"EKF3 IMU0 is using {source}")
        for text in sorted(now - self._announced):
            self.say(INFO, text)
        self._announced = now
