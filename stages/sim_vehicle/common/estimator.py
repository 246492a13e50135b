"""State estimate of the simulated vehicle: strapdown integration corrected by its position sources."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from alula.stages.sim_vehicle.common.airframe import TICK_S, Motion
from alula.stages.sim_vehicle.common.parameters import Parameters
from alula.stages.sim_vehicle.common.quaternions import (
    Quat,
    Vector,
    added,
    from_heading,
    from_vector,
    multiply,
    rotate,
    to_euler,
)

# EKF_STATUS_REPORT.flags as ArduPilot fills them: settled, without a position, after the loss of satellites,
# and just booted.
SETTLED, NO_POSITION, NO_SATELLITES, UNINITIALISED = 0x33F, 0xA7, 0x27, 0x400

EXTERNAL = 6  # EK3_SRC1_*: external navigation
GPS = 3
MOCAP_LOST_S = 7.0  # flags change this long after external navigation stops
SATELLITES_LOST_S = 7.0  # and this long after the last fix
_MOCAP_SETTLE = 15.6 / 36.0  # fraction of the boot time from setting the origin until it has settled
_STARTED = 0.1  # fraction of the boot time until attitude and height are available
_FIXED = 0.5  # fraction of the boot time until satellites are available
_GATE_M = 1.0  # external positions with a larger error are rejected
_REFUSED_S = 5.0  # after rejecting them for this long the estimate is reset to them
_GAIN = (4.0, 4.0, 2.0)  # position to position and velocity, velocity to velocity [1/s, 1/s^2, 1/s]
_POSITION_PULL, _VELOCITY_PULL, _STEP_PULL = _GAIN[1], 4 * _GAIN[2], TICK_S * _GAIN[0]
_COMPASS_REFUSED, _COMPASS_S = 0.77, 0.1  # of ArduPilot's, 400 mG off; and the time of its filter
_TURNED_RAD_S = 0.042  # by which its heading follows that compass
_BLOCK = 512  # ticks in one draw of noise

LatLonAlt = tuple[float, float, float]
_HIGHEST_M, _FARTHEST_M, _FASTEST_M_S = 1e5, 1e5, 1e3  # larger values are invalid
_EARTH_M = 6378100.0


@dataclass(frozen=True, slots=True)
class EstimatorOptions:
    """Errors of the estimate; standard deviations per axis, of white noise unless stated otherwise.

    Attributes:
        boot_time_s: time from boot until the position is good enough to fly, with satellites; other delays of
            the boot are in proportion [s].
        position_noise_m: position error, a first-order Gauss-Markov process [m].
        velocity_noise_m_s: velocity error, a first-order Gauss-Markov process [m/s].
        noise_time_s: time constant of both; at least 0.05 [s].
        attitude_noise_rad: error of lean angles and heading [rad].
        rate_noise_rad_s: error of body rates [rad/s].
        accelerometer_bias_m_s2: bias that makes the position drift without a position source [m/s^2].
        delay_s: delay of the reported estimate; the vehicle's own loops use it without delay [s].
    """

    boot_time_s: float = 36.0
    position_noise_m: float = 0.01
    velocity_noise_m_s: float = 0.01
    noise_time_s: float = 2.0
    attitude_noise_rad: float = 0.001
    rate_noise_rad_s: float = 0.002
    accelerometer_bias_m_s2: float = 0.02
    delay_s: float = 0.01


def is_location(location: LatLonAlt) -> bool:
    """Return whether latitude, longitude [deg] and altitude [m] are a location on Earth."""
    return abs(location[0]) <= 90 and abs(location[1]) <= 180 and abs(location[2]) <= _HIGHEST_M


class Estimator:
    """Estimated position, velocity and attitude, and their reported quality.

    Velocity integrates the true acceleration plus a constant bias; position integrates velocity. Both are
    corrected towards the source that EK3_SRC1_POSXY selects. Satellites are always available; external
    navigation arrives by VISION_POSITION_ESTIMATE and VISION_SPEED_ESTIMATE. When it stops, the flags change
    only after 7 s.

    Args:
        parameters: the sources, read at every tick.
        home: latitude, longitude [deg] and altitude [m] of the start.

    Attributes:
        offset: fault: offset of the position estimate, NED [m].
        has_failed: fault: the estimate is invalid.
        is_mocap_lost: fault: external navigation does not arrive.
        are_satellites_lost: fault: the receiver has no fix.
        fix_offset: fault: offset of all fixes, NED [m].
        is_compass_bad: fault: the compass contradicts the gyroscopes.
        follows_s: time in which the position follows fixes that jump to 63 % [s].
        fix_s: time since boot of the newest fix of satellites [s]; None before the first.
        origin: latitude, longitude [deg] and altitude [m] of the local frame; None before it is set.
        needs_origin: whether external positions are used with an origin only.
    """

    def __init__(
        self,
        parameters: Parameters,
        options: EstimatorOptions,
        start: Motion,
        home: LatLonAlt,
        seed: int = 0,
    ) -> None:
        self._parameters = parameters
        self._options = options
        self._start_location = home
        self._random = np.random.default_rng([seed, 8])
        self._walk = np.zeros(6)
        self._noise: list[list[float]] = []
        bias = options.accelerometer_bias_m_s2
        self._bias: Vector = (bias, -0.6 * bias, 0.3 * bias)
        self._position, self._velocity = list(start.position), list(start.velocity)
        self._yaw_error = 0.0
        self._time_s = 0.0
        self._vision_s: float | None = None  # time of the newest external position
        self._usable_s: float | None = None  # since when the source is available and the origin is set
        self._refused_s: float | None = None
        self._variance = 0.05
        self._history: deque[tuple[float, Motion]] = deque()
        self.offset: Vector = (0.0, 0.0, 0.0)
        self.has_failed = False
        self.is_mocap_lost = False
        self.are_satellites_lost = False
        self.fix_offset: Vector = (0.0, 0.0, 0.0)
        self.follows_s = 1.1
        self.is_compass_bad = False
        self.compass_variance = 0.05
        self._followed = [0.0, 0.0, 0.0]  # of it
        self.fix_s: float | None = None
        self.origin: LatLonAlt | None = None
        self.needs_origin = True
        self.motion = start
        self.is_settled = False
        parameters.follow(self._tune)

    def _tune(self) -> None:
        p = self._parameters
        self._uses_mocap = p.whole("EK3_SRC1_POSXY") == EXTERNAL and p.whole("VISO_TYPE") != 0
        self._takes_mocap_height = self._uses_mocap and p.whole("EK3_SRC1_POSZ") == EXTERNAL
        self._has_receiver = p.whole("GPS1_TYPE") != 0

    @property
    def uses_mocap(self) -> bool:
        """Return whether the horizontal position comes from external navigation."""
        return self._uses_mocap

    @property
    def has_fix(self) -> bool:
        """Return whether satellites are available."""
        if self.are_satellites_lost or self._time_s < _FIXED * self._options.boot_time_s:
            return False
        return self._has_receiver

    @property
    def is_started(self) -> bool:
        """Return whether attitude and height are available."""
        return self._time_s >= _STARTED * self._options.boot_time_s

    @property
    def has_position(self) -> bool:
        """Return whether the position is good enough to fly."""
        return self.is_settled and not self.has_failed

    @property
    def flags(self) -> int:
        """Flags of EKF_STATUS_REPORT."""
        if not self.is_started:
            return UNINITIALISED
        if self.are_satellites_lost and not self.has_failed and not self.is_settled:
            return NO_SATELLITES
        return SETTLED if self.has_position else NO_POSITION

    @property
    def variance(self) -> float:
        """Variance of EKF_STATUS_REPORT: innovations divided by their gates; above 0.8 is bad."""
        return 1.5 if self.has_failed else self._variance

    @property
    def reported(self) -> Motion:
        """The reported estimate, that of `delay_s` ago."""
        return self._history[0][1] if self._history else self.motion

    def set_origin(self, origin: LatLonAlt) -> bool:
        """Set the origin by SET_GPS_GLOBAL_ORIGIN, once; returns whether it was accepted.

        Args:
            origin: latitude, longitude [deg] and altitude [m].
        """
        if self.origin is not None or not is_location(origin):
            return False
        self.origin = origin
        return True

    def vision_position(self, position: Vector, yaw_rad: float) -> None:
        """Process an external position.

        Args:
            position: NED [m].
        """
        if self.is_mocap_lost or not self.uses_mocap:
            return
        if not (all(abs(c) < _FARTHEST_M for c in position) and abs(yaw_rad) < _FARTHEST_M):
            return  # also if NaN
        late = self._vision_s is None or self._time_s - self._vision_s > MOCAP_LOST_S
        interval = 0.02 if self._vision_s is None else min(max(self._time_s - self._vision_s, 1e-3), 0.2)
        self._vision_s = self._time_s
        errors = [z - p for z, p in zip(position, self._position, strict=True)]
        axes = [0, 1] + ([2] if self._parameters.whole("EK3_SRC1_POSZ") == EXTERNAL else [])
        size = math.sqrt(sum(errors[i] ** 2 for i in axes))
        self._variance = min(0.05 + size / _GATE_M, 10.0)
        if late or (self._refused_s is not None and self._time_s - self._refused_s > _REFUSED_S):
            for i in axes:
                self._position[i] = position[i]
            self._refused_s = None
        elif size > _GATE_M:
            self._refused_s = self._time_s if self._refused_s is None else self._refused_s
            return
        else:
            self._refused_s = None
            pull = 1 - math.exp(-4 * _GAIN[0] * interval)
            for i in axes:
                self._position[i] += pull * errors[i]
                self._velocity[i] += _GAIN[1] * interval * errors[i]
        if self._parameters.whole("EK3_SRC1_YAW") == EXTERNAL:
            error = yaw_rad - to_euler(self.motion.attitude)[2]
            error -= 2 * math.pi * round(error / (2 * math.pi))
            self._yaw_error += error if late else (1 - math.exp(-_GAIN[0] * interval)) * error

    def vision_velocity(self, velocity: Vector) -> None:
        """Process an external velocity, NED [m/s]."""
        if self.is_mocap_lost or not self.uses_mocap or not all(abs(c) < _FASTEST_M_S for c in velocity):
            return
        for i, name in enumerate(("VELXY", "VELXY", "VELZ")):
            if self._parameters.whole(f"EK3_SRC1_{name}") == EXTERNAL:
                self._velocity[i] += 0.3 * (velocity[i] - self._velocity[i])

    def update(self, truth: Motion, *, is_still: bool) -> None:
        """Advance the estimate by one tick.

        Args:
            truth: measured motion, with the sensor noise of the vehicle file.
        """
        self._time_s += TICK_S
        noise = self._next_noise()
        if self.is_compass_bad:
            self._yaw_error += _TURNED_RAD_S * TICK_S
        refused = _COMPASS_REFUSED if self.is_compass_bad else 0.05
        self.compass_variance += TICK_S / _COMPASS_S * (refused - self.compass_variance)
        turn = from_heading(self._yaw_error)
        acceleration = self._integrate(truth, turn, noise, is_still)
        self._settle()
        sigma, rate = self._options.attitude_noise_rad, self._options.rate_noise_rad_s
        roll, pitch, yaw, along_x, along_y, along_z = noise[6:]
        lean = from_vector((sigma * roll, sigma * pitch, sigma * yaw))
        (x, y, z), (u, v, w), (p, q, r) = self._position, self._velocity, truth.omega
        self.motion = Motion(
            added((x, y, z), self.offset),
            (u, v, w),
            multiply(turn, multiply(truth.attitude, lean)),
            (p + rate * along_x, q + rate * along_y, r + rate * along_z),
            acceleration,
        )
        history = self._history
        history.append((self._time_s, self.motion))
        shown_s = self._time_s - self._options.delay_s + 1e-9
        while len(history) > 1 and history[1][0] <= shown_s:
            history.popleft()

    def global_position(self, position: Vector) -> LatLonAlt:
        """Latitude, longitude [deg] and altitude [m] of a local position, NED [m], on a sphere."""
        lat, lon, alt = self.origin or self._start_location
        north, east, down = position
        cosine = max(math.cos(math.radians(lat)), 1e-6)
        return (
            lat + math.degrees(north / _EARTH_M),
            lon + math.degrees(east / (_EARTH_M * cosine)),
            alt - down,
        )

    def local_position(self, location: LatLonAlt) -> Vector:
        """Local position, NED [m]; the inverse of `global_position`."""
        lat, lon, alt = self.origin or self._start_location
        north = math.radians(location[0] - lat) * _EARTH_M
        east = math.radians(location[1] - lon) * _EARTH_M * math.cos(math.radians(lat))
        return north, east, alt - location[2]

    def _integrate(self, truth: Motion, turn: Quat, noise: list[float], is_still: bool) -> Vector:
        """Advance position and velocity; return the measured acceleration, NED [m/s^2]."""
        follows_level = not self.uses_mocap and self.has_fix
        follows_height = not self._takes_mocap_height
        stands = is_still and not self.has_position
        measured = added(rotate(turn, truth.acceleration), self._bias)
        positions, velocities = self._position, self._velocity
        true_position, true_velocity = truth.position, truth.velocity
        if self.fix_offset != (0.0, 0.0, 0.0) or any(self._followed):
            share = TICK_S / self.follows_s
            for i, offset in enumerate(self.fix_offset):
                self._followed[i] += share * (offset - self._followed[i])
            true_position = added(true_position, (self._followed[0], self._followed[1], self._followed[2]))
        for i, follows in enumerate((follows_level, follows_level, follows_height)):
            velocity, position = velocities[i] + measured[i] * TICK_S, positions[i]
            if stands:
                velocity = 0.0  # standstill is detected
            if follows:
                error = true_position[i] + noise[i] - position
                slip = true_velocity[i] + noise[3 + i] - velocity
                velocity += TICK_S * (_POSITION_PULL * error + _VELOCITY_PULL * slip)
                position += _STEP_PULL * error
            velocities[i], positions[i] = velocity, position + velocity * TICK_S
        return measured

    def _settle(self) -> None:
        if self.has_fix:
            self.fix_s = self._time_s
        if self.uses_mocap:
            alive = self._vision_s is not None and self._time_s - self._vision_s <= MOCAP_LOST_S
            usable = alive and (self.origin is not None or not self.needs_origin)
            wait_s = _MOCAP_SETTLE * self._options.boot_time_s
        else:
            usable = self.fix_s is not None and self._time_s - self.fix_s <= SATELLITES_LOST_S
            wait_s = (1 - _FIXED) * self._options.boot_time_s
            if usable and self.origin is None:
                self.origin = self._start_location
        if not usable:
            self._usable_s = None
        elif self._usable_s is None:
            self._usable_s = self._time_s
        self.is_settled = self._usable_s is not None and (
            self.is_started and self._time_s - self._usable_s >= wait_s - 1e-9
        )

    def _next_noise(self) -> list[float]:
        if not self._noise:
            options, white = self._options, self._random.standard_normal((_BLOCK, 12))
            kept = math.exp(-TICK_S / max(options.noise_time_s, 0.05))
            scale = np.repeat([options.position_noise_m, options.velocity_noise_m_s], 3)
            # x_k = kept x_(k-1) + r_k, all at once: x_k = kept^k (x_0 + sum of kept^-j r_j).
            powers = kept ** np.arange(1, _BLOCK + 1)[:, None]
            steps = math.sqrt(1 - kept**2) * scale * white[:, :6]
            white[:, :6] = powers * (self._walk + np.cumsum(steps / powers, axis=0))
            self._walk = white[-1, :6].copy()
            self._noise = white[::-1].tolist()
        return self._noise.pop()
