"""State estimate of the simulated Crazyflie."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.stages.rotation import multiply_quat_wxyz
from alula.stages.vehicles.simulated_body import Body

_UNKNOWN_M2, _KNOWN_M2 = 100.0, 1e-4  # variances
_WEIGHT = 0.2  # fraction of the difference to a pose by which the estimate is corrected
_FRESH_S = 0.1
_DRIFT_M_S, _GROWTH_M2_S = 0.3, 0.5


class Estimator:
    """The measured state of the body, shifted and turned about z by external poses.

    With `needs_poses` the position drifts and its variance grows while no poses arrive.

    Args:
        needs_poses: whether the estimate drifts without poses.

    Attributes:
        variance: variance of each axis of the position [m^2].
        yaw_offset_rad: rotation of the estimate relative to the truth [rad].
    """

    def __init__(self, body: Body, *, needs_poses: bool, seed: int) -> None:
        self._body, self._needs_poses = body, needs_poses
        self.variance = _UNKNOWN_M2 if needs_poses else _KNOWN_M2
        self.yaw_offset_rad = 0.0
        self._offset = np.zeros(3)
        self._pose_age_s = math.inf
        angle = np.random.default_rng([seed, 11]).uniform(-math.pi, math.pi)
        self._drift = _DRIFT_M_S * np.array([math.cos(angle), math.sin(angle), 0.0])
        self._look()

    @property
    def yaw_rad(self) -> float:
        """Estimated heading [rad]."""
        return _yaw(self.attitude_wxyz)

    def step(self, dt_s: float) -> None:
        """Advance the estimate by `dt_s` [s]."""
        self._pose_age_s += dt_s
        if self._needs_poses and self._pose_age_s > _FRESH_S:
            self.variance = min(self.variance + _GROWTH_M2_S * dt_s, _UNKNOWN_M2)
            if not self._body.is_resting:
                self._offset = self._offset + self._drift * dt_s
        self._look()

    def take_pose(self, position: FloatArray, attitude_wxyz: FloatArray) -> None:
        """Correct the estimate by an external pose.

        Args:
            position: shape (3,) [m].
            attitude_wxyz: unit quaternion, shape (4,).
        """
        if not (np.isfinite(position).all() and np.isfinite(attitude_wxyz).all()):
            return
        self._pose_age_s = 0.0
        self.variance = max(_KNOWN_M2, self.variance * (1 - _WEIGHT))
        turn = math.remainder(_yaw(attitude_wxyz) - self.yaw_rad, 2 * math.pi)
        self.yaw_offset_rad += _WEIGHT * turn
        self._look()
        self._offset = self._offset + _WEIGHT * (position - self.position)
        self._look()

    def reset(self, position: FloatArray, yaw_rad: float) -> None:
        """Reset the estimate.

        Args:
            position: shape (3,) [m].
        """
        if not (np.isfinite(position).all() and math.isfinite(yaw_rad)):
            return
        self.variance = _UNKNOWN_M2 if self._needs_poses else _KNOWN_M2
        if self._needs_poses:
            self.yaw_offset_rad += math.remainder(yaw_rad - self.yaw_rad, 2 * math.pi)
            self._look()
            self._offset = self._offset + position - self.position
            self._look()

    def to_truth(self, vector: FloatArray) -> FloatArray:
        """Turn a vector, shape (3,), from the estimate's frame to the true frame."""
        return self._turned(vector, -self.yaw_offset_rad)

    def readers(self) -> dict[str, Callable[[], float]]:
        """Log variables of the compressed state [m, m/s, rad/s]; the pitch rate has the firmware's sign."""

        def of(name: str, i: int, sign: float = 1.0) -> Callable[[], float]:
            return lambda: sign * float(getattr(self, name)[i])

        found = {axis: of("position", i) for i, axis in enumerate("xyz")}
        found |= {f"v{axis}": of("velocity", i) for i, axis in enumerate("xyz")}
        return found | {
            "rateRoll": of("omega", 0),
            "ratePitch": of("omega", 1, -1.0),
            "rateYaw": of("omega", 2),
        }

    def _look(self) -> None:
        position, velocity, attitude, self.omega = self._body.measured()
        half = 0.5 * self.yaw_offset_rad
        self.position: FloatArray = self._turned(position, self.yaw_offset_rad) + self._offset
        self.velocity: FloatArray = self._turned(velocity, self.yaw_offset_rad)
        self.attitude_wxyz: FloatArray = attitude
        self.true_attitude_wxyz: FloatArray = attitude
        if half:
            self.attitude_wxyz = multiply_quat_wxyz(
                np.array([math.cos(half), 0.0, 0.0, math.sin(half)]), attitude
            )

    @staticmethod
    def _turned(vector: FloatArray, angle: float) -> FloatArray:
        if angle == 0.0:
            return vector
        cos, sin = math.cos(angle), math.sin(angle)
        x, y, z = vector.tolist()
        return np.array([cos * x - sin * y, sin * x + cos * y, z])


def _yaw(quat_wxyz: FloatArray) -> float:
    w, x, y, z = quat_wxyz.tolist()
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
