"""The pilot's remote control: sticks, mode switch and channel overrides."""

from __future__ import annotations

from alula.stages.sim_vehicle.common.parameters import Parameters

CHANNELS = 16
CENTRE, LOW, HIGH = 1500, 1000, 2000
_DEAD_US = 30
_SWITCH = (1230, 1360, 1490, 1620, 1749)  # boundaries of the six positions of the mode switch [us]
_IGNORED = (0, 65535)  # not overrides in RC_CHANNELS_OVERRIDE; 0 releases channels 1 to 8


class Pilot:
    """Receiver of a remote control with centred sticks; on the ground the throttle is low.

    RC_CHANNELS_OVERRIDE replaces channels for RC_OVERRIDE_TIME.

    Args:
        parameters: channel numbers and timeouts, read at every use.

    Attributes:
        is_lost: whether the receiver has lost the signal.
        was_seen: whether it ever had one.
    """

    def __init__(self, parameters: Parameters) -> None:
        self._parameters = parameters
        self._sticks = [CENTRE] * CHANNELS
        self._sticks[2] = LOW
        self._overrides: dict[int, tuple[int, float]] = {}
        self._position: int | None = None
        self.is_lost = self.was_seen = False

    def channels(self, now_s: float) -> list[int]:
        """Pulse widths of all channels at `now_s` [us]."""
        channels = list(self._sticks)
        for index, (value, until_s) in list(self._overrides.items()):
            if now_s > until_s:
                del self._overrides[index]
            else:
                channels[index] = value
        if self.is_lost and not self._overrides:
            channels[2] = int(self._parameters["FS_THR_VALUE"]) - 25
        return channels

    def override(self, values: list[int], now_s: float) -> None:
        """Process an RC_CHANNELS_OVERRIDE.

        Args:
            values: pulse widths of the channels [us]; 0 and 65535 are not overrides.
        """
        until_s = now_s + self._parameters["RC_OVERRIDE_TIME"]
        for index, value in enumerate(values[:CHANNELS]):
            if value not in _IGNORED:
                self._overrides[index] = (value, until_s)
            elif value == 0 and index < 8:
                self._overrides.pop(index, None)

    def move(self, channel: int, value: int) -> None:
        """Move a stick or switch; used by tests.

        Args:
            value: pulse width [us].
        """
        self._sticks[channel - 1] = value

    def attend(self, *, landed: bool) -> None:
        """Hold the throttle stick low on the ground, centred in the air."""
        self._sticks[2] = LOW if landed else CENTRE
        self.was_seen = self.was_seen or not self.is_lost

    def stick(self, name: str, now_s: float) -> float:
        """Deflection of a stick, -1 to 1 with a dead zone around 0.

        Args:
            name: ROLL, PITCH, THROTTLE or YAW, as in RCMAP_*.
        """
        channel = max(1, min(CHANNELS, self._parameters.whole(f"RCMAP_{name}")))
        value = self.channels(now_s)[channel - 1] - CENTRE
        if abs(value) <= _DEAD_US:
            return 0.0
        return max(-1.0, min(1.0, (abs(value) - _DEAD_US) / (HIGH - CENTRE - _DEAD_US))) * (
            1 if value > 0 else -1
        )

    def moved_switch(self, now_s: float) -> int | None:
        """FLTMODE value of the switch if it moved since the last call, else None."""
        channel = self._parameters.whole("FLTMODE_CH")
        if not 1 <= channel <= CHANNELS:
            return None
        value = self.channels(now_s)[channel - 1]
        position = sum(value > edge for edge in _SWITCH)
        moved = self._position is not None and position != self._position
        self._position = position
        return self._parameters.whole(f"FLTMODE{position + 1}") if moved else None
