"""Conversions between the world frame and an autopilot's frames; only here do axes swap names or signs.

World frame: z up; body: x forward, y left, z up (FLU). MAVLink autopilots: the local frame has x north, y
east, z down (NED), from its own origin; the body x forward, y right, z down (FRD). East-north-up (ENU) with
the same origin lies between them, and is the local frame of a Crazyflie. Vectors have shape (..., 3),
quaternions wxyz shape (..., 4).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray
from alula.stages.rotation import multiply_quat_wxyz

_HALF = math.sqrt(0.5)
_NED_FROM_ENU = np.array([0.0, _HALF, _HALF, 0.0])  # half a turn about (1, 1, 0); its own inverse
_FLU_FROM_FRD = np.array([0.0, 1.0, 0.0, 0.0])  # half a turn about x; its own inverse


def flipped_body(vector: NDArray[Any]) -> FloatArray:
    """Body components FLU to FRD, and back: (x, -y, -z).

    Args:
        vector: shape (..., 3).
    """
    return np.asarray(vector, np.float64) * (1.0, -1.0, -1.0)


@dataclass(frozen=True, slots=True)
class LocalFrame:
    """Pose of the autopilot's local frame: p_enu = Rz(yaw) p_world + origin, and NED from ENU.

    Attributes:
        yaw_rad: angle from east to the world's x axis, counter-clockwise from above [rad].
        origin_enu_m: the world's origin in the autopilot's local frame, as east, north, up [m].
    """

    yaw_rad: float = 0.0
    origin_enu_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def position_to_ned(self, position: NDArray[Any]) -> FloatArray:
        """World positions, shape (..., 3) [m], in the autopilot's local frame."""
        return _swapped(self._turned(position, self.yaw_rad) + self.origin_enu_m)

    def position_from_ned(self, position: NDArray[Any]) -> FloatArray:
        """The autopilot's local positions, shape (..., 3) [m], in the world."""
        return self._turned(_swapped(position) - self.origin_enu_m, -self.yaw_rad)

    def vector_to_ned(self, vector: NDArray[Any]) -> FloatArray:
        """World velocities and accelerations, shape (..., 3), along the autopilot's axes."""
        return _swapped(self._turned(vector, self.yaw_rad))

    def vector_from_ned(self, vector: NDArray[Any]) -> FloatArray:
        """Velocities and accelerations along the autopilot's axes, shape (..., 3), in the world."""
        return self._turned(_swapped(vector), -self.yaw_rad)

    def attitude_to_ned(self, quat_wxyz: NDArray[Any]) -> FloatArray:
        """Attitudes world from FLU, shape (..., 4), as NED from FRD, with w >= 0."""
        enu = multiply_quat_wxyz(self._yaw(1.0), quat_wxyz)
        return _canonical(multiply_quat_wxyz(multiply_quat_wxyz(_NED_FROM_ENU, enu), _FLU_FROM_FRD))

    def attitude_from_ned(self, quat_wxyz: NDArray[Any]) -> FloatArray:
        """Attitudes NED from FRD, shape (..., 4), as world from FLU, with w >= 0."""
        enu = multiply_quat_wxyz(multiply_quat_wxyz(_NED_FROM_ENU, quat_wxyz), _FLU_FROM_FRD)
        return _canonical(multiply_quat_wxyz(self._yaw(-1.0), enu))

    def position_to_local(self, position: NDArray[Any]) -> FloatArray:
        """World positions, shape (..., 3) [m], in the local ENU frame of a Crazyflie."""
        return self._turned(position, self.yaw_rad) + self.origin_enu_m

    def position_from_local(self, position: NDArray[Any]) -> FloatArray:
        """Positions in a local ENU frame, shape (..., 3) [m], in the world."""
        return self._turned(np.asarray(position, np.float64) - self.origin_enu_m, -self.yaw_rad)

    def vector_to_local(self, vector: NDArray[Any]) -> FloatArray:
        """World velocities and accelerations, shape (..., 3), along the axes of a local ENU frame."""
        return self._turned(vector, self.yaw_rad)

    def vector_from_local(self, vector: NDArray[Any]) -> FloatArray:
        """Velocities and accelerations along the axes of a local ENU frame, shape (..., 3), in the world."""
        return self._turned(vector, -self.yaw_rad)

    def attitude_to_local(self, quat_wxyz: NDArray[Any]) -> FloatArray:
        """Attitudes world from FLU, shape (..., 4), as local ENU from FLU, with w >= 0."""
        return _canonical(multiply_quat_wxyz(self._yaw(1.0), quat_wxyz))

    def attitude_from_local(self, quat_wxyz: NDArray[Any]) -> FloatArray:
        """Attitudes local ENU from FLU, shape (..., 4), as world from FLU, with w >= 0."""
        return _canonical(multiply_quat_wxyz(self._yaw(-1.0), quat_wxyz))

    def yaw_to_ned(self, yaw_rad: float) -> float:
        """Heading of a yaw in the world, clockwise from north, in (-pi, pi] [rad]."""
        return math.pi - (math.pi / 2 + yaw_rad + self.yaw_rad) % (2 * math.pi)

    def _yaw(self, sign: float) -> FloatArray:
        half = 0.5 * sign * self.yaw_rad
        return np.array([math.cos(half), 0.0, 0.0, math.sin(half)])

    @staticmethod
    def _turned(vector: NDArray[Any], angle: float) -> FloatArray:
        given = np.asarray(vector, np.float64)
        x, y = given[..., 0], given[..., 1]
        cos, sin = math.cos(angle), math.sin(angle)
        turned = given.copy()
        turned[..., 0] = cos * x - sin * y
        turned[..., 1] = sin * x + cos * y
        return turned


def _swapped(vector: NDArray[Any]) -> FloatArray:
    """ENU to NED, and back."""
    swapped: FloatArray = np.asarray(vector, np.float64)[..., [1, 0, 2]]
    swapped[..., 2] = -swapped[..., 2]
    return swapped


def _canonical(quat: FloatArray) -> FloatArray:
    signed: FloatArray = np.where(quat[..., :1] < 0, -quat, quat)
    return signed
