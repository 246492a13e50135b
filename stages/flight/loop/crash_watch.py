"""Watch over crashes: a vehicle upside down, on its side, or at rest on the ground below its plan."""

from __future__ import annotations

import math

from alula.stages.flight.links.protocol import VehicleState

_OVER_UP, _OVER_S = 0.0, 0.2  # world z of the body's z axis below which it is upside down, and for how long
_LYING_UP, _LYING_M_S, _LYING_S = 0.5, 0.5, 1.0  # no multicopter hovers with 60 degrees of tilt
_LOW_M, _RESTS_M_S, _RESTS_S = 0.25, 0.3, 0.5
_BELOW_M = 0.4  # the plan is this much above a vehicle that counts as fallen to the ground


class CrashWatch:
    """Detection of crashes in the reported states, each kind after a time in which it holds without a break.

    The vehicle's own land detector does not help: while thrust is commanded ArduPilot reports that it is in
    the air, whatever lies on the ground.

    Attributes:
        is_over: it is tilted by more than 90 degrees.
        is_lying: it rests, tilted by more than 60 degrees.
        is_down: it rests upright at the height of the ground, and its plan is above.
        words: what was found, for the user; empty before.
    """

    def __init__(self) -> None:
        self.is_over = self.is_lying = self.is_down = False
        self.words = ""
        self._since_s = [math.inf, math.inf, math.inf]
        self._seen: VehicleState | None = None

    def update(self, state: VehicleState, height_m: float, plan_m: float) -> None:
        """Add a state; the same state again, or one with numbers that are not finite, changes nothing.

        Args:
            state: newest state of the vehicle, world frame.
            height_m: its height above the ground where it took off [m].
            plan_m: height of the plan above the vehicle, now [m]; minus infinity if it is not to be compared.
        """
        if state is self._seen:
            return
        self._seen, now_s = state, state.received_s
        _, x, y, _ = state.attitude_wxyz.tolist()
        up = 1 - 2 * (x * x + y * y)
        speed = math.sqrt(float(state.velocity @ state.velocity))
        kinds = (
            (up < _OVER_UP, _OVER_S),
            (up < _LYING_UP and speed < _LYING_M_S, _LYING_S),
            (up >= _LYING_UP and height_m < _LOW_M and speed < _RESTS_M_S and plan_m > _BELOW_M, _RESTS_S),
        )
        holds = []
        for i, (is_so, needed_s) in enumerate(kinds):
            self._since_s[i] = min(self._since_s[i], now_s) if is_so else math.inf
            holds.append(now_s - self._since_s[i] >= needed_s)
        self.is_over, self.is_lying, self.is_down = holds
        tilt = math.degrees(math.acos(max(-1.0, min(1.0, up))))
        if self.is_over or self.is_lying:
            self.words = f"tilted {tilt:.0f} degrees{', at rest' if self.is_lying else ''}"
        elif self.is_down:
            self.words = f"{height_m:.2f} m above where it took off, {plan_m:.2f} m below its plan"
