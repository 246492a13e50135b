"""The pilot's remote control: sticks, the mode switch, and what overrides them."""

from __future__ import annotations

from alula.stages.sim_vehicle.ardupilot.parameters import Parameters

CHANNELS = 16
CENTRE, LOW, HIGH = 1500, 1000, 2000
_DEAD_US = 30
_SWITCH = (1230, 1360, 1490, 1620, 1749)  # between the six places of the mode switch [us]
_IGNORED = (0, 65535)  # of RC_CHANNELS_OVERRIDE; 0 gives channels 1 to 8 back


class Pilot:
    """A receiver with centred sticks, and an attentive pilot: throttle low on the ground, centred in the air.

    RC_CHANNELS_OVERRIDE replaces channels for RC_OVERRIDE_TIME.
    """

    def __init__(self, parameters: Parameters) -> None:
        self._parameters = parameters
        self._sticks = [CENTRE] * CHANNELS
        self._sticks[2] = LOW
        self._overrides: dict[int, tuple[int, float]] = {}
        self._place: int | None = None
        self.is_lost = False  # the receiver hears no pilot

    def channels(self, now_s: float) -> list[int]:
        """Pulse widths [us]."""
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
        """RC_CHANNELS_OVERRIDE."""
        until_s = now_s + self._parameters["RC_OVERRIDE_TIME"]
        for index, value in enumerate(values[:CHANNELS]):
            if value not in _IGNORED:
                self._overrides[index] = (value, until_s)
            elif value == 0 and index < 8:
                self._overrides.pop(index, None)

    def move(self, channel: int, value: int) -> None:
        """A test's hand on a stick or switch, counted from 1 [us]."""
        self._sticks[channel - 1] = value

    def attend(self, *, landed: bool) -> None:
        """Hold the throttle stick as one does."""
        self._sticks[2] = LOW if landed else CENTRE

    def stick(self, name: str, now_s: float) -> float:
        """Of RCMAP_*: -1 to 1 with a dead zone around 0."""
        channel = max(1, min(CHANNELS, self._parameters.whole(f"RCMAP_{name}")))
        value = self.channels(now_s)[channel - 1] - CENTRE
        if abs(value) <= _DEAD_US:
            return 0.0
        return max(-1.0, min(1.0, (abs(value) - _DEAD_US) / (HIGH - CENTRE - _DEAD_US))) * (
            1 if value > 0 else -1
        )

    def moved_switch(self, now_s: float) -> int | None:
        """The mode that the switch was moved to since the last call; None if it was not."""
        channel = self._parameters.whole("FLTMODE_CH")
        if not 1 <= channel <= CHANNELS:
            return None
        value = self.channels(now_s)[channel - 1]
        place = sum(value > edge for edge in _SWITCH)
        moved = self._place is not None and place != self._place
        self._place = place
        return self._parameters.whole(f"FLTMODE{place + 1}") if moved else None
