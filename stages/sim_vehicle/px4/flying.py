"""Controllers of the simulated PX4's modes, with its own heights of the way home and of the landing."""

from __future__ import annotations

import math

from alula.stages.sim_vehicle.ardupilot.flying import Flying
from alula.stages.sim_vehicle.common.airframe import Motion
from alula.stages.sim_vehicle.common.quaternions import Vector


class Px4Flying(Flying):
    """`Flying`, in which Return climbs to RTL_RETURN_ALT, or less within the cone RTL_CONE_ANG.

    A landing descends by MPC_LAND_CRWL below MPC_LAND_ALT3.
    """

    def _return_height_m(self, position: Vector) -> float:
        p, above_m = self._parameters, self.home[2] - position[2]
        away_m = math.dist(position[:2], self.home[:2])
        highest_m, near_m, arrived_m = p["RTL_RETURN_ALT"], p["RTL_MIN_DIST"], p["NAV_ACC_RAD"]
        level_m = highest_m
        if p["RTL_CONE_ANG"] > 0:
            half_rad = math.radians(max(1.0, min(89.0, p["RTL_CONE_ANG"])))
            if away_m <= arrived_m:
                level_m = 2 * away_m
            elif away_m <= near_m:
                level_m = max(away_m / math.tan(half_rad), 2 * arrived_m)
        return max(min(level_m, highest_m), above_m) - self.home[2]

    def _descend(self, motion: Motion) -> None:
        if self.home[2] - motion.position[2] < self._parameters["MPC_LAND_ALT3"]:
            self.position.climb(motion, -self._parameters["MPC_LAND_CRWL"])
        else:
            super()._descend(motion)
