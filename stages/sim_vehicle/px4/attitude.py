"""Inner loop of the simulated PX4: first-order rates and throttle; in FRD and NED."""

from __future__ import annotations

from alula.stages.sim_vehicle.ardupilot.attitude import AttitudeControl
from alula.stages.sim_vehicle.common.airframe import TICK_S, Airframe
from alula.stages.sim_vehicle.common.parameters import Parameters
from alula.stages.sim_vehicle.common.quaternions import (
    Quat,
    Vector,
    added,
    cos_tilt,
    from_vector,
    multiply,
    relative,
    rotate,
    scaled,
    to_vector,
    unit,
)

_RATE_INPUT_S = 0.0185  # lag of a rate command; with the rate loop, a step reaches 63 % after 40 ms
_THROTTLE_S = 0.04  # lag of the observed rotors: -5.5 m/s, 0.6 s after the throttle went to its minimum
_MAX_ERROR_RAD = 0.7  # larger attitude errors are clipped


class Px4AttitudeControl(AttitudeControl):
    """Controller of an attitude target; rate commands are integrated into the target.

    The rates of the target follow the command with a first-order lag. The commanded body rates are those of
    the target plus the attitude error times ATC_ANG_*_P. The torque of the rate loop is
    tau = J (omega_command - omega) / time constant + omega x J omega.

    Args:
        airframe: gives inertia and maximum thrust.
        parameters: gains, read at every tick.
        rate_times_s: time constants of the rate loop about x, y, z [s].
        motor_time_s: lag of the rotors in the plant itself [s].
    """

    def __init__(
        self, airframe: Airframe, parameters: Parameters, rate_times_s: Vector, motor_time_s: float
    ) -> None:
        super().__init__(airframe, parameters)
        self._rate_times_s = tuple(max(each, TICK_S) for each in rate_times_s)
        self._throttle_weight = TICK_S / max(_THROTTLE_S - motor_time_s, TICK_S)

    def reset(self, attitude: Quat) -> None:
        """See `AttitudeControl`."""
        self.target, self.rates = attitude, (0.0, 0.0, 0.0)

    def input_rates(self, omega: Vector) -> None:
        """See `AttitudeControl`."""
        self._turn_with_lag(omega, TICK_S / (_RATE_INPUT_S + TICK_S))

    def input_attitude(self, attitude: Quat, omega: Vector = (0.0, 0.0, 0.0), *, slews: bool = False) -> None:
        """See `AttitudeControl`."""
        time_s = max(self._parameters["ATC_INPUT_TC"], 2 * TICK_S) / 2
        error = to_vector(relative(self.target, attitude))
        self._turn_with_lag(added(omega, scaled(error, 1 / time_s)), TICK_S / (time_s / 2 + TICK_S))

    def set_throttle(self, throttle: float, *, boosted: bool = True, cutoff_hz: float = 0.0) -> None:
        """See `AttitudeControl`."""
        if boosted and self._parameters.whole("ATC_ANGLE_BOOST"):
            cosine = cos_tilt(self.target)
            throttle *= max(0.0, min(1.0, 10 * cosine)) / max(0.1, min(1.0, cosine))
        self.throttle_command = max(0.0, min(1.0, throttle))

    def run(self, attitude: Quat, omega: Vector) -> tuple[float, Vector]:
        """See `AttitudeControl`."""
        between = relative(attitude, self.target)
        error = to_vector(between)
        ahead = rotate(between, self.rates)
        gains = (self._parameters[f"ATC_ANG_{axis}_P"] for axis in ("RLL", "PIT", "YAW"))
        target_rates = tuple(
            rate + gain * max(-_MAX_ERROR_RAD, min(_MAX_ERROR_RAD, e))
            for rate, gain, e in zip(ahead, gains, error, strict=True)
        )
        i, (p, q, r) = self._inertia, omega
        gyroscopic = (q * r * (i[2] - i[1]), r * p * (i[0] - i[2]), p * q * (i[1] - i[0]))
        x, y, z = (
            j * (w - o) / time_s + g
            for j, w, o, time_s, g in zip(i, target_rates, omega, self._rate_times_s, gyroscopic, strict=True)
        )
        self.throttle += self._throttle_weight * (self.throttle_command - self.throttle)
        return self.throttle * self._max_thrust_n, (x, y, z)

    def _turn_with_lag(self, omega: Vector, weight: float) -> None:
        p, q, r = self.rates
        self.rates = (p + weight * (omega[0] - p), q + weight * (omega[1] - q), r + weight * (omega[2] - r))
        self.target = unit(multiply(self.target, from_vector(scaled(self.rates, TICK_S))))
