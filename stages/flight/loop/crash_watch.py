"""Watch over crashes, and over landings that the vehicle does not notice."""

from __future__ import annotations

import math

from alula.stages.flight.links.protocol import VehicleState

_OVER_UP, _OVER_S = 0.0, 0.2  # world z of the body's z axis below which it is upside down, and for how long
_LYING_UP, _LYING_M_S, _LYING_S = 0.5, 0.5, 1.0  # no multicopter hovers with 60 degrees of tilt
_LOW_M, _RESTS_M_S, _RESTS_S = 0.25, 0.3, 0.5
_BELOW_M = 0.4  # the plan is this much above a vehicle that counts as fallen to the ground
# A landing vehicle descends by at least 0.3 m/s, the least that ArduPilot's LAND_SPEED allows: in _STILL_S it
# sinks by six times _STILL_M. Positions still creep after a crash, so speeds along the ground may be larger.
_STILL_M, _STILL_M_S, _STILL_S = 0.15, 0.5, 3.0
_LIES_M, _LIES_S = 0.5, 10.0
_GAP_S = 0.5  # without a state for longer, nothing is known of the time between


class CrashWatch:
    """Detection of crashes in the reported states, each kind after a time in which it holds without a break.

    The vehicle's own land detector does not help: while thrust is commanded ArduPilot reports that it is in
    the air, whatever lies on the ground.

    Attributes:
        is_over: it is tilted by more than 90 degrees.
        is_lying: it rests, tilted by more than 60 degrees; or it crashed in one of these three ways, and its
            landing has been still for 10 s at most 0.5 m above where it took off.
        is_down: it rests upright at the height of the ground, and its plan is above.
        is_still: it is landing, but its height has not changed for 3 s.
        words: what was found, for the user; empty before.
    """

    def __init__(self) -> None:
        self.is_over = self.is_lying = self.is_down = self.is_still = False
        self.words = ""
        self._since_s = [math.inf, math.inf, math.inf]
        self._seen: VehicleState | None = None
        self._has_crashed = False
        self._still_s, self._still_m, self._last_s = math.inf, math.nan, -math.inf

    def update(
        self, state: VehicleState, height_m: float, plan_m: float, *, is_landing: bool = False
    ) -> None:
        """Add a state; the same state again, or one with numbers that are not finite, changes nothing.

        Args:
            height_m: its height above the ground where it took off [m].
            plan_m: height of the plan above the vehicle, now [m]; minus infinity if it is not to be compared.
            is_landing: it was ordered to land, so that it descends unless it is on the ground.
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
        self._has_crashed = self._has_crashed or any(holds)
        still_s = self._time_still_s(now_s, float(state.position[2]), speed) if is_landing else 0.0
        self.is_still = still_s >= _STILL_S
        has_settled = self._has_crashed and still_s >= _LIES_S and height_m < _LIES_M
        tilt = math.degrees(math.acos(max(-1.0, min(1.0, up))))
        if self.is_over or self.is_lying:
            self.words = f"tilted {tilt:.0f} degrees{', at rest' if self.is_lying else ''}"
        elif self.is_down:
            self.words = f"{height_m:.2f} m above where it took off, {plan_m:.2f} m below its plan"
        elif has_settled:
            self.is_lying = True
            self.words = f"still for {_LIES_S:g} s, {height_m:.2f} m above where it took off, after a crash"

    def _time_still_s(self, now_s: float, z_m: float, speed_m_s: float) -> float:
        is_same = abs(z_m - self._still_m) <= _STILL_M and speed_m_s < _STILL_M_S
        if not is_same or now_s - self._last_s > _GAP_S:
            self._still_s, self._still_m = now_s, z_m
        self._last_s = now_s
        return now_s - self._still_s
