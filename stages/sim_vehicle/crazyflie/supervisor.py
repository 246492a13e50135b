"""Supervisor of the simulated Crazyflie, which decides when the motors may run."""

from __future__ import annotations

from enum import Enum

WARNING_S = 0.5  # time without a set-point until it levels out
TIMEOUT_S = 2.0  # time without a set-point until the motors stop permanently
EMERGENCY_S = 1.0  # maximum time between two notices, after the first
STILL_S = 2.0  # time with the motors off until it is no longer flying
PREFLIGHT_S = 30.0  # maximum time armed without flying

_CAN_BE_ARMED, _IS_ARMED, _AUTO_ARMS, _CAN_FLY, _IS_FLYING = 0, 1, 2, 3, 4
_IS_TUMBLED, _IS_LOCKED, _PLANS, _PLAN_FINISHED, _PLAN_DISABLED = 5, 6, 8, 9, 10


class Stage(Enum):
    """Stage of the supervisor."""

    NOT_CHECKED = "pre-flight checks not passed"
    CHECKED = "pre-flight checks passed"
    READY = "ready to fly"
    FLYING = "flying"
    LEVEL_OUT = "no set-points: levels out"
    LOCKED = "locked"


_RUNS = (Stage.READY, Stage.FLYING, Stage.LEVEL_OUT)


class Supervisor:
    """State machine that arms on request or by itself, stops without set-points, and locks in an emergency.

    A locked supervisor must be restarted. All times are since boot [s].

    Args:
        arms_itself: whether it arms without a request.

    Attributes:
        tumbled: whether it lies upside down or crashed; set by the caller.
        texts: texts for the console; the reader removes them.
    """

    def __init__(self, *, arms_itself: bool) -> None:
        self.stage = Stage.NOT_CHECKED
        self.is_armed = self.tumbled = False
        self.texts: list[str] = []
        self._arms_itself = arms_itself
        self._thrust_s: float | None = None
        self._armed_s = 0.0
        self._notice_s: float | None = None
        self._is_stopped = False

    @property
    def motors_may_run(self) -> bool:
        """Return whether set-points reach the motors."""
        return self.stage in _RUNS

    @property
    def is_flying(self) -> bool:
        """Return whether it is flying: the motors ran in the last two seconds."""
        return self.stage in (Stage.FLYING, Stage.LEVEL_OUT)

    def arm(self, arms: bool) -> bool:
        """Request to arm (True) or disarm (False); returns whether the request holds now."""
        if arms == self.is_armed:
            return True
        if arms and self.stage is not Stage.CHECKED:
            return False
        self.is_armed = arms
        return True

    def notice(self, now_s: float) -> None:
        """Process a notice of the emergency watchdog; after the first it is required every second."""
        self._notice_s = now_s

    def stop(self) -> None:
        """Emergency stop: lock with the motors off."""
        self._is_stopped = True

    def update(self, now_s: float, setpoint_s: float, is_pushing: bool) -> None:
        """Update the stage.

        Args:
            setpoint_s: time of the last set-point [s].
        """
        if is_pushing:
            self._thrust_s = now_s
        moves = self._thrust_s is not None and now_s - self._thrust_s < STILL_S
        notice = self._notice_s
        emergency = self._is_stopped or (notice is not None and now_s - notice > EMERGENCY_S)
        before = self.stage
        self.stage = self._next(now_s, now_s - setpoint_s, moves, emergency)
        if self.stage is before:
            return
        if self.stage is Stage.READY:
            self._armed_s = now_s
            self._say("Ready to fly")
        elif self.stage in (Stage.NOT_CHECKED, Stage.CHECKED):
            if self.is_armed:
                self._say("Disarming")
            self.is_armed = self._arms_itself and self.stage is Stage.CHECKED
        elif self.stage is Stage.LOCKED:
            self.is_armed = False
            self.texts.append("SUP: Locked, reboot required\n")

    def bits(self, plans: bool, finished: bool) -> int:
        """Bits of the log variable `supervisor.info`."""
        found = {
            _CAN_BE_ARMED: self.stage is Stage.CHECKED,
            _IS_ARMED: self.is_armed,
            _AUTO_ARMS: self._arms_itself,
            _CAN_FLY: self.motors_may_run,
            _IS_FLYING: self.is_flying,
            _IS_TUMBLED: self.tumbled,
            _IS_LOCKED: self.stage is Stage.LOCKED,
            _PLANS: plans,
            _PLAN_FINISHED: finished,
            _PLAN_DISABLED: False,
        }
        return sum(1 << bit for bit, is_set in found.items() if is_set)

    def _next(self, now_s: float, age_s: float, moves: bool, emergency: bool) -> Stage:
        stage = self.stage
        if stage is Stage.LOCKED or emergency:
            return Stage.LOCKED
        if stage is Stage.NOT_CHECKED:
            return stage if self.tumbled else Stage.CHECKED
        if stage is Stage.CHECKED:
            if self.tumbled:
                return Stage.NOT_CHECKED
            return Stage.READY if self.is_armed else stage
        if stage is Stage.READY:
            if self.tumbled or not self.is_armed or now_s - self._armed_s > PREFLIGHT_S:
                return Stage.NOT_CHECKED
            return Stage.FLYING if moves else stage
        if age_s > TIMEOUT_S or self.tumbled or not self.is_armed:
            return Stage.LOCKED
        if age_s > WARNING_S:
            return Stage.LEVEL_OUT
        return Stage.FLYING if moves else Stage.NOT_CHECKED

    def _say(self, text: str) -> None:
        if not self._arms_itself:
            self.texts.append(f"SUP: {text}\n")
