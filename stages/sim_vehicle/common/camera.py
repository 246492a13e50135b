"""Motion capture of the simulated vehicle: the datagrams that `alula fly --mocap` listens to."""

from __future__ import annotations

import msgspec
import numpy as np

from alula.stages.sim_vehicle.common.airframe import Motion
from alula.stages.sim_vehicle.common.quaternions import Vector
from alula.stages.vehicles.frames import LocalFrame

PERIOD_S = 0.01
_NOISE_M = 0.0005


class Camera:
    """Sees the true pose, to half a millimetre, in east-north-up with body forward-left-up.

    Args:
        seed: of the noise.
        start: where the vehicle boots, in the camera's frame [m].
    """

    def __init__(self, seed: int, start: Vector = (0.0, 0.0, 0.0)) -> None:
        x, y, z = start
        self._frame = LocalFrame(0.0, (-x, -y, -z))
        self._random = np.random.default_rng([seed, 11])

    def datagram(self, time_s: float, truth: Motion) -> bytes:
        """One JSON object: time, position [m], attitude (w, x, y, z)."""
        position = self._frame.position_from_ned(np.array(truth.position))
        position += _NOISE_M * self._random.standard_normal(3)
        attitude = self._frame.attitude_from_ned(np.array(truth.attitude))
        return msgspec.json.encode(
            {"time_s": time_s, "position_m": position.tolist(), "attitude_wxyz": attitude.tolist()}
        )
