"""Motion capture for a Crazyflie: poses come in as for MAVLink vehicles and go out at up to 100 Hz."""

from __future__ import annotations

import math

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.stages.flight.links.mocap import Mocap

_PERIOD_S = 0.01


class PoseFeed(Mocap):
    """The newest fresh pose, in the vehicle's frame; datagrams are those of `mocap`."""

    def pose(self, now_s: float) -> tuple[FloatArray, FloatArray] | None:
        """Take in what has come; position and attitude (w, x, y, z) if a new one is due."""
        self.take_all(now_s)
        is_new = self._arrival_s > self._sent_s
        # Half a period early is in time: ticks of the loop are as long as the period.
        if not is_new or now_s < self._next_s - _PERIOD_S / 2 or not self.is_fresh(now_s):
            return None
        self._next_s = max(self._next_s + _PERIOD_S, now_s)
        self._sent_s = self._arrival_s
        return self.newest()

    def newest(self) -> tuple[FloatArray, FloatArray] | None:
        """The newest pose, whether it was taken or not."""
        if not self._recent:
            return None
        sample = self._recent[-1][1]
        quat = np.array(sample.attitude_wxyz)
        position = self._frame.position_to_local(np.array(sample.position_m))
        return position, self._frame.attitude_to_local(quat / math.sqrt(float(quat @ quat)))
