"""What the simulated MAVLink vehicles share: clock, body, estimate, landing, battery, pilot, parameters."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Mapping
from typing import ClassVar

from alula.schemas.scenarios.vehicle import Vehicle
from alula.stages.sim_vehicle.ardupilot.attitude import AttitudeControl
from alula.stages.sim_vehicle.ardupilot.flying import Flying
from alula.stages.sim_vehicle.ardupilot.modes import Mode
from alula.stages.sim_vehicle.ardupilot.position import PositionControl
from alula.stages.sim_vehicle.common.airframe import TICK_S, Airframe, Terrain
from alula.stages.sim_vehicle.common.battery import Battery
from alula.stages.sim_vehicle.common.estimator import Estimator, EstimatorOptions, LatLonAlt
from alula.stages.sim_vehicle.common.hand import Hand
from alula.stages.sim_vehicle.common.parameters import Parameters
from alula.stages.sim_vehicle.common.pilot import Pilot
from alula.stages.sim_vehicle.common.quaternions import rotate

EMERGENCY, CRITICAL, ERROR, WARNING, NOTICE, INFO = 0, 2, 3, 4, 5, 6  # MAV_SEVERITY

_RESTING_FRACTION = 0.9  # of the weight; less thrust for `LANDED_S` on the ground is a landing
_LEVEL_UP = math.cos(math.radians(15.0))  # it takes the ground for the air while it leans by more
_CRASH_S = 2.0  # tilted for this long on the ground is a crash
_CHECK_S = 0.1  # between checks of failsafes


class Copter(ABC):
    """A quadrotor with its autopilot; `tick` simulates 2.5 ms.

    A firmware adds modes, arming and failsafes. The initial value of its parameter `HOVER` is the true one,
    weight over full thrust. A value in `parameters` replaces it; the autopilot then uses the given value, but
    the rotors do not change.

    Args:
        parameters: values by name that replace the defaults.
        home: latitude, longitude [deg] and altitude [m] of the start; by default that of the firmware's own
            simulation.
        heading_rad: initial heading, clockwise from north [rad].
        hand: hand that moves the vehicle while it is disarmed; None for none.
        terrain: what it can stand on; None for a flat floor.

    Attributes:
        mode: its row in `Flying`, whose controller flies.
        hover_throttle: true hover throttle, weight over full thrust.
        failsafe: name of the last failsafe that triggered, whether it acts or not; empty without one.
        texts: STATUSTEXTs to send, severity and text.

    Raises:
        UsageError: the vehicle is not a quadrotor, or a parameter is unknown.
    """

    AUTOPILOT: ClassVar[str]
    FIRMWARE: ClassVar[str]
    HOVER: ClassVar[str]  # parameter with the hover throttle
    LOCATION: ClassVar[LatLonAlt]
    POSITION: ClassVar[type[PositionControl]]
    FLYING: ClassVar[type[Flying]]
    ARMING_DELAY_S: ClassVar[float] = 0.0  # the rotors stand still this long after arming
    LANDED_S: ClassVar[float]  # of rest until it reports that it has landed

    mode: Mode

    def __init__(
        self,
        vehicle: Vehicle,
        *,
        parameters: Mapping[str, float] | None = None,
        options: EstimatorOptions | None = None,
        home: LatLonAlt | None = None,
        heading_rad: float = 0.0,
        seed: int = 0,
        hand: Hand | None = None,
        terrain: Terrain | None = None,
    ) -> None:
        self.name = vehicle.name
        self.airframe = Airframe(self._plant(vehicle), seed=seed, heading_rad=heading_rad, terrain=terrain)
        self.hover_throttle = self.airframe.weight_n / self.airframe.body.max_thrust
        initial = {self.HOVER: round(self.hover_throttle, 6)}
        self.parameters = self._parameters(initial | dict(parameters or {}))
        self.attitude = self._attitude_control(vehicle)
        self.pilot = Pilot(self.parameters)
        self.battery = Battery(self.parameters)
        options = options or EstimatorOptions()
        self.estimator = Estimator(
            self.parameters, options, self.airframe.truth, self.LOCATION if home is None else home, seed
        )
        position = self.POSITION(self.attitude, self.parameters, vehicle.body.gravity_m_s2)
        self.flying = self.FLYING(self.attitude, position, self.parameters, self.pilot)
        self._hand = hand
        self.texts: deque[tuple[int, str]] = deque()
        self.is_armed = False
        self.is_landed = True
        self.failsafe = ""
        self._ticks = 0
        self.time_s = 0.0
        self._armed_s = 0.0
        self._resting_s = 0.0
        self._idle_s = 0.0
        self._lying_s = 0.0
        self._bad_s = 0.0
        self._checked_s = 0.0
        self._gcs_s: float | None = None
        self._client_s: float | None = None
        self._boot()
        self.say(INFO, self.FIRMWARE)

    @abstractmethod
    def _boot(self) -> None:
        """Enter its first mode."""

    @abstractmethod
    def _parameters(self, values: Mapping[str, float]) -> Parameters:
        """Its parameters, some changed."""

    @abstractmethod
    def _plant(self, vehicle: Vehicle) -> Vehicle:
        """The vehicle that the firmware's own simulation makes of one."""

    @abstractmethod
    def _attitude_control(self, vehicle: Vehicle) -> AttitudeControl:
        """Its inner loop."""

    def spoil_compass(self, *, is_bad: bool) -> None:
        """Apply a fault: the compass is off by 400 mG."""
        self.estimator.is_compass_bad = is_bad

    def say(self, severity: int, text: str) -> None:
        """Queue a STATUSTEXT.

        Args:
            severity: MAV_SEVERITY.
        """
        self.texts.append((severity, text))

    @property
    def _is_spooling(self) -> bool:
        """Return whether the rotors are still starting after arming."""
        return self.time_s - self._armed_s < self.ARMING_DELAY_S + 2 * self.parameters["MOT_SPOOL_TIME"]

    def tick(self) -> None:
        """Simulate `TICK_S`."""
        self._ticks += 1
        self.time_s = self._ticks * TICK_S
        if self._hand is not None:
            self._hand.attend(self.time_s, self._client_s, is_ready=self.estimator.has_position)
            self.airframe.carry(None if self.is_armed else self._hand.motion(self.time_s))
        is_still = self.airframe.on_ground and not self.airframe.is_carried
        self.estimator.update(self.airframe.sensed, is_still=is_still)
        motion = self.estimator.motion
        if self.time_s - self._checked_s >= _CHECK_S - 1e-9:
            self._check(self.time_s - self._checked_s)
            self._checked_s = self.time_s
        self.flying.has_position = self.estimator.has_position
        if not self.is_armed:
            self.attitude.throttle = 0.0
            self.airframe.step(0.0, (0.0, 0.0, 0.0))
            self._detect_landing(0.0)
            return
        # As in the firmware, the rates and the throttle of the tick before are followed first.
        thrust, torque = self.attitude.run(motion.attitude, motion.omega)
        if self._is_spooling or (
            self.is_landed and not self.flying.should_leave_ground(self.mode, self.time_s)
        ):
            self.flying.rest(motion)
        else:
            self.flying.run(self.mode, motion, self.time_s)
        self.airframe.step(thrust, torque)
        self._detect_landing(thrust)

    @abstractmethod
    def check_refusal(self) -> str | None:
        """First of its own checks before arming that does not hold, in its words; None if all do."""

    @abstractmethod
    def arm(self, *, forced: bool = False) -> bool:
        """Arm by COMPONENT_ARM_DISARM; returns whether it is armed.

        Args:
            forced: whether arming is forced.
        """

    @abstractmethod
    def disarm(self, *, forced: bool = False) -> bool:
        """Disarm; returns whether it is disarmed.

        Args:
            forced: disarm in the air too.
        """

    @abstractmethod
    def set_mode(self, number: int) -> bool:
        """Enter a mode by its custom_mode; returns whether it was entered, or a text states why not."""

    @abstractmethod
    def switch_to(self, number: float | None) -> None:
        """Apply a fault: set the pilot's switch; None for the mode that holds a position by sticks."""

    @abstractmethod
    def take_off(self, height_m: float) -> bool:
        """Execute NAV_TAKEOFF; returns whether it is possible."""

    def note_client(self) -> None:
        """Record a heartbeat of any client; a hand waits for it."""
        self._client_s = self.time_s

    @abstractmethod
    def note_ground_station(self, system: int) -> None:
        """Record a heartbeat of a system, which may be the ground station."""

    @abstractmethod
    def _check(self, passed_s: float) -> None:
        """Periodic checks: the mode switch, failsafes, texts."""

    def _detect_landing(self, thrust_n: float) -> None:
        self._lying_s = self._lying_s + TICK_S if self.airframe.is_lying and self.is_armed else 0.0
        if self._lying_s > 0:  # its attitude is not the one that it should have
            self.is_landed = False
            if self._lying_s >= _CRASH_S:
                self._crash()
            return
        if not self.airframe.on_ground:
            self.is_landed, self._resting_s = False, 0.0
            return
        is_level = -rotate(self.attitude.target, (0.0, 0.0, -1.0))[2] > _LEVEL_UP
        resting = thrust_n < _RESTING_FRACTION * self.airframe.weight_n and is_level
        self._resting_s = self._resting_s + TICK_S if resting else 0.0
        if not self.is_landed and self._resting_s >= self.LANDED_S:
            self.is_landed = True
            self._touch_down()
        if self.is_armed and self.is_landed:
            waits = self.flying.should_leave_ground(self.mode, self.time_s)
            self._idle_s = 0.0 if waits else self._idle_s + TICK_S
            if 0 < self._disarm_delay_s() <= self._idle_s:
                self.disarm()

    @abstractmethod
    def _crash(self) -> None:
        """Act on having lain tilted on the ground."""

    @abstractmethod
    def _touch_down(self) -> None:
        """Act on a landing."""

    @abstractmethod
    def _disarm_delay_s(self) -> float:
        """Time after which it disarms on the ground without a command to climb [s]; never if not positive."""
