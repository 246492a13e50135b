"""Inner loop: from attitude and rates to torque, from throttle to thrust; in FRD and NED."""

from __future__ import annotations

import math

from alula.stages.sim_vehicle.ardupilot.pid import Pid
from alula.stages.sim_vehicle.ardupilot.shaping import low_pass_weight, square_root
from alula.stages.sim_vehicle.common.airframe import TICK_S, Airframe
from alula.stages.sim_vehicle.common.parameters import Parameters
from alula.stages.sim_vehicle.common.quaternions import (
    Quat,
    Vector,
    cos_tilt,
    from_vector,
    multiply,
    relative,
    rotate,
    to_vector,
    unit,
)

# Angular acceleration of a full command of roll, pitch and yaw: that of the vehicle in ArduPilot's own
# simulation at hover thrust, for which the default gains are made [rad/s^2].
_EFFECT: Vector = (307.0, 307.0, 14.1)
_DAMPING_PER_S = 2.0  # of its rotations, by the drag of its rotors
_LEAST_RAD_S2 = tuple(map(math.radians, (40.0, 40.0, 10.0)))  # angular acceleration to remove errors
_MOST_RAD_S2 = tuple(map(math.radians, (720.0, 720.0, 120.0)))
_MAX_YAW_ERROR_RAD = math.radians(45.0)  # larger errors are clipped
_AXES = (("RLL", "R"), ("PIT", "P"), ("YAW", "Y"))


class AttitudeControl:
    """Controller of an attitude target; rate commands are integrated into the target.

    The rates of the target follow the command with at most ATC_ACCEL_*_MAX. The commanded body rates are
    those of the target plus a square-root law of the attitude error with the gains ATC_ANG_*_P.
    ATC_RATE_*_MAX bound both, but not a rate command. With ATC_RATE_FF_ENAB 0 a rate command turns the target
    without its rates. Controllers with ATC_RAT_* follow them by the low-passed rates (INS_GYRO_FILTER). Their
    output scales an angular acceleration that does not depend on the vehicle file, so all files have the same
    rate loop.

    Args:
        airframe: gives inertia and maximum thrust.
        parameters: gains, read at every tick.

    Attributes:
        target: attitude target, unit quaternion w, x, y, z, NED from FRD.
        rates: its body rates, FRD [rad/s].
        throttle: throttle of the rotors, 0 to 1.
        throttle_command: commanded throttle, 0 to 1.
    """

    def __init__(self, airframe: Airframe, parameters: Parameters) -> None:
        ix, iy, iz = airframe.body.inertia
        self._inertia: Vector = (ix, iy, iz)
        self._max_thrust_n = airframe.body.max_thrust
        self._parameters = parameters
        self.target: Quat = (1.0, 0.0, 0.0, 0.0)
        self.rates: Vector = (0.0, 0.0, 0.0)
        self.throttle = 0.0
        self.throttle_command = 0.0
        self._throttle_pull = 1.0  # of the low-pass on the throttle
        self._loops = [Pid(parameters, f"ATC_RAT_{name}") for name, _ in _AXES]
        self._gyro = [[0.0, 0.0] for _ in _AXES]  # of the second-order low-pass
        parameters.follow(self._tune)

    def _tune(self) -> None:
        p = self._parameters
        self._gains = [p[f"ATC_ANG_{name}_P"] for name, _ in _AXES]
        # Largest angular accelerations of the target; 0 for no limit.
        self._limits = [math.radians(p[f"ATC_ACCEL_{letter}_MAX"] / 100) for _, letter in _AXES]
        self._changes = [limit * TICK_S for limit in self._limits]  # of the target's rates in a tick
        bounds = zip(_LEAST_RAD_S2, _MOST_RAD_S2, self._limits, strict=True)
        self._removal = [max(least, min(most, limit / 2)) for least, most, limit in bounds]
        fastest = [math.radians(p[f"ATC_RATE_{letter}_MAX"]) for _, letter in _AXES]
        self._fastest = [limit if limit > 0 else math.inf for limit in fastest]
        self._is_bounded = min(self._fastest) < math.inf
        self._feeds_forward = p.whole("ATC_RATE_FF_ENAB") != 0
        cutoff = 2 * math.pi * p.get("INS_GYRO_FILTER", 0.0)
        slope = cutoff * TICK_S
        self._gyro_pull = slope * cutoff
        self._gyro_scale = 1 / (1 + math.sqrt(2) * slope + slope * slope)
        self._input_gain = 1 / max(p["ATC_INPUT_TC"], 0.01)
        self._slew_rad_s = math.radians(max(p["ATC_SLEW_YAW"], 500.0) / 100)
        self._is_boosted = p.whole("ATC_ANGLE_BOOST") != 0

    def reset(self, attitude: Quat) -> None:
        """Set the target to the present attitude, at rest."""
        self.target, self.rates = attitude, (0.0, 0.0, 0.0)
        for loop in self._loops:
            loop.reset()

    def input_rates(self, omega: Vector) -> None:
        """Turn the target with commanded body rates, FRD [rad/s]."""
        if self._feeds_forward:
            self._turn(omega)
        else:
            p, q, r = omega
            self.rates = (0.0, 0.0, 0.0)
            self.target = unit(multiply(self.target, from_vector((p * TICK_S, q * TICK_S, r * TICK_S))))

    def input_attitude(self, attitude: Quat, omega: Vector = (0.0, 0.0, 0.0), *, slews: bool = False) -> None:
        """Turn the target to an attitude within about ATC_INPUT_TC.

        Args:
            attitude: commanded attitude, unit quaternion w, x, y, z, NED from FRD.
            omega: commanded body rates on top, FRD [rad/s].
            slews: bound the yaw rate by ATC_SLEW_YAW.
        """
        gain, (p, q, r), (x, y, z) = self._input_gain, omega, to_vector(relative(self.target, attitude))
        along_x, along_y, along_z = self._limits
        r += square_root(z, gain, along_z)
        if slews:
            r = max(-self._slew_rad_s, min(self._slew_rad_s, r))
        p, q = p + square_root(x, gain, along_x), q + square_root(y, gain, along_y)
        if self._is_bounded:
            p, q, r = (max(-most, min(most, v)) for v, most in zip((p, q, r), self._fastest, strict=True))
        self._turn((p, q, r))

    def set_throttle(self, throttle: float, *, boosted: bool = True, cutoff_hz: float = 0.0) -> None:
        """Set the throttle.

        Args:
            throttle: 0 to 1.
            boosted: divide it by the cosine of the target's tilt, unless ATC_ANGLE_BOOST is 0.
            cutoff_hz: cutoff of the low-pass on the way to the rotors [Hz]; 0 for none.
        """
        if boosted and self._is_boosted:
            cosine = cos_tilt(self.target)
            throttle *= max(0.0, min(1.0, 10 * cosine)) / max(0.1, min(1.0, cosine))
        self.throttle_command = max(0.0, min(1.0, throttle))
        self._throttle_pull = low_pass_weight(cutoff_hz)

    def run(self, attitude: Quat, omega: Vector) -> tuple[float, Vector]:
        """Compute thrust [N] and torque, FRD [N m], of this tick.

        Args:
            attitude: estimated attitude, unit quaternion w, x, y, z, NED from FRD.
            omega: estimated body rates, FRD [rad/s].
        """
        between = relative(attitude, self.target)
        (roll, pitch, yaw), ahead = to_vector(between), rotate(between, self.rates)
        errors = (roll, pitch, max(-_MAX_YAW_ERROR_RAD, min(_MAX_YAW_ERROR_RAD, yaw)))
        (i, j, k), (p, q, r) = self._inertia, omega
        gyroscopic = (q * r * (k - j), r * p * (i - k), p * q * (j - i))
        gains, removal, pull, scale = self._gains, self._removal, self._gyro_pull, self._gyro_scale
        torque = []
        for axis, rate in enumerate(omega):
            correction = square_root(errors[axis], gains[axis], removal[axis])
            if self._is_bounded:
                correction = max(-self._fastest[axis], min(self._fastest[axis], correction))
            wanted = ahead[axis] + correction
            measured = rate
            if pull:
                # Second order, damping 0.71. Implicit steps of y'' = w^2 (u - y) - sqrt(2) w y' are stable
                # for every cutoff.
                state = self._gyro[axis]
                measured, slope = state
                state[1] = slope = (slope + pull * (rate - measured)) * scale
                state[0] = measured = measured + slope * TICK_S
            command = self._loops[axis].run(wanted, measured)
            command = command if command < 1.0 else 1.0
            command = command if command > -1.0 else -1.0
            turns = _EFFECT[axis] * command - _DAMPING_PER_S * rate
            torque.append(self._inertia[axis] * turns + gyroscopic[axis])
        self.throttle += self._throttle_pull * (self.throttle_command - self.throttle)
        return self.throttle * self._max_thrust_n, (torque[0], torque[1], torque[2])

    def _turn(self, omega: Vector) -> None:
        (p, q, r), (x, y, z), (u, v, w) = self.rates, omega, self._changes
        self.rates = p, q, r = _towards(p, x, u), _towards(q, y, v), _towards(r, z, w)
        self.target = unit(multiply(self.target, from_vector((p * TICK_S, q * TICK_S, r * TICK_S))))


def _towards(old: float, new: float, most: float) -> float:
    """Change a rate by at most so much; without limit if that is not positive."""
    if most <= 0:
        return new
    change = new - old
    change = change if change < most else most
    return old + (change if change > -most else -most)
