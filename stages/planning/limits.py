"""Limits of a planned motion: those of the user, and those of the vehicle through differential flatness."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from alula._core import MotionLimits
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.errors import UsageError
from alula.schemas.parameters.configs.plan import PlanConfig
from alula.schemas.scenarios.vehicle import Vehicle
from alula.stages.planning.trajectory import evaluate
from alula.stages.vehicles.bodies import quadrotor
from alula.stages.vehicles.following import following_options

LIMIT_SHARE = (
    0.8  # of the way from hovering to a limit of the vehicle, for plans; the rest is the controller's
)
_TORQUE_SHARE = 0.25  # of the thrust that is left to a plan, at least: reserved for torques
_SNAP_RATIO = 3.0  # of the snap over the thrust to the square of the body rates
WITHIN = 1 - 1e-6  # of the limits, for a solver in double precision
# Of what a vehicle follows, for plans. With 0.8 simulated flights by accelerations at 2 m/s met a wall when
# the vehicle's attitude lagged by 0.15 s instead of 0.08 s; with 0.6 they kept their distance.
_FOLLOWED_SHARE = 0.6
_STEP_S = 0.01  # between samples of a plan
_SLACK = 1e-3  # for its rounding
_YAW_RATE_RAD_S = 2.0  # of the heading, where none is given
_YAW_RATIO_PER_S = 4.0  # of the acceleration of the heading to its rate, at most
_YAW_RATE_SHARE = 0.7  # of the rate about z, for turns of the heading; the rest is for tilting
_YAW_SHARE = 0.3  # of the torque about z that is reserved, for turns of the heading
_RATE_TOLERANCE = 1e-12  # of the body rate, relative
_LEAST_RATE_RAD_S = 1e-6
_FASTEST_FALL = 0.9  # of gravity, for an acceleration without a lower limit of the thrust


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Bounds that hold at every instant of a plan; infinite where there is none.

    Attributes:
        speed_m_s, acceleration_m_s2, jerk_m_s3, snap_m_s4: of the Euclidean norms.
        gravity_m_s2: that the thrust carries.
        most_thrust_m_s2: of |a + g e3|, the thrust per mass.
        least_thrust_m_s2: lower bound of a_z + g.
        tilt_rad: of the angle between a + g e3 and the vertical.
        yaw_rate_rad_s, yaw_acceleration_rad_s2: of the first two derivatives of the heading; infinite for one
            that is constant.
    """

    speed_m_s: float
    acceleration_m_s2: float
    jerk_m_s3: float = math.inf
    snap_m_s4: float = math.inf
    gravity_m_s2: float = 9.81
    most_thrust_m_s2: float = math.inf
    least_thrust_m_s2: float = -math.inf
    tilt_rad: float = math.pi / 2
    yaw_rate_rad_s: float = math.inf
    yaw_acceleration_rad_s2: float = math.inf

    @property
    def tangent(self) -> float:
        """Of the tilt; infinite without a limit."""
        return math.tan(self.tilt_rad) if self.tilt_rad < math.pi / 2 else math.inf

    def native(self) -> MotionLimits:
        """For the native solver, smaller by more than the rounding of stored coefficients."""
        return MotionLimits(
            speed=WITHIN * self.speed_m_s,
            acceleration=WITHIN * self.acceleration_m_s2,
            jerk=WITHIN * self.jerk_m_s3,
            snap=WITHIN * self.snap_m_s4,
            gravity=self.gravity_m_s2,
            most_thrust=WITHIN * self.most_thrust_m_s2,
            least_thrust=self.least_thrust_m_s2 + (1 - WITHIN) * self.gravity_m_s2,
            tilt=WITHIN * self.tangent,
        )

    def record(self) -> dict[str, float]:
        """Finite limits, for the manifest of a plan."""
        every = {name: float(getattr(self, name)) for name in self.__dataclass_fields__}
        if not self.tilt_rad < math.pi / 2:
            del every["tilt_rad"]
        return {name: value for name, value in every.items() if math.isfinite(value)}


def motion_limits(config: PlanConfig, vehicle: Vehicle, *, turns: bool = False) -> Limits:
    """Limits of a plan for a vehicle.

    A quadrotor that follows a curve p(t) with a constant heading has, with a, j, s the second to fourth
    derivative of p, the thrust c = |a + g e3| per mass along b3 = (a + g e3) / c, tilted by theta, and
      |omega_xy| = |b3'| <= |j| / c,  |omega_z| <= |omega_xy| tan(theta),
      |omega_xy'| <= |s| / c + |j|^2 / c^2 + |omega_xy omega_z|,
      |omega_z'| <= |omega_xy'| tan(theta) + |omega_xy|^2 / (2 cos(theta)^2).
    So with c >= c_min bounds of |j| and |s| bound the body rates and the torque J omega' + omega x J omega,
    hence each rotor's deviation from its part of the thrust. Every rotor stays within `LIMIT_SHARE` of the
    way from hovering to its limits; at least a quarter of that is reserved for torques, more where the limit
    of the acceleration leaves it. See docs/theory/planning.md. Drag is left to the controller.
    A heading that turns adds to rates and torques; it gets a part of their limits.

    Args:
        config: limits of the user; without an interface, those of body rates.
        vehicle: that will fly the plan; only that of a quadrotor bounds tilt, thrust and rates.

    Raises:
        UsageError: an option does not apply to the vehicle.
    """
    jerk = math.inf if config.jerk_m_s3 is None else config.jerk_m_s3
    snap = math.inf if config.snap_m_s4 is None else config.snap_m_s4
    acceleration = config.acceleration_m_s2
    if vehicle.model != "quadrotor":
        for option, value in (("--tilt", config.tilt_rad), ("--body-rate", config.body_rate_rad_s)):
            if value is not None:
                raise UsageError(f"{option} applies to a quadrotor, not to a {vehicle.model}")
        most = vehicle.limits.max_acceleration_m_s2
        return Limits(
            speed_m_s=config.speed_m_s,
            acceleration_m_s2=acceleration if most is None else min(acceleration, LIMIT_SHARE * most),
            jerk_m_s3=jerk,
            snap_m_s4=snap,
            **(_yaw(_yaw_rate(config), math.inf) if turns else {}),
        )
    if config.interface in (None, "body-rates"):
        return _quadrotor_limits(config, vehicle, acceleration, jerk, snap, turns=turns)
    followed = followed_limits(vehicle)
    acceleration = min(acceleration, followed.acceleration_m_s2)
    jerk = min(jerk, followed.jerk_m_s3)
    limits = _quadrotor_limits(config, vehicle, acceleration, jerk, snap, turns=turns)
    return replace(
        limits,
        most_thrust_m_s2=min(limits.most_thrust_m_s2, followed.most_thrust_m_s2),
        least_thrust_m_s2=max(limits.least_thrust_m_s2, followed.least_thrust_m_s2),
    )


def followed_limits(vehicle: Vehicle) -> Limits:
    """Limits of motions that a quadrotor's own autopilot follows well, by velocities or accelerations.

    `_FOLLOWED_SHARE` of those by which it shapes set-points, see `following_options`: level acceleration and
    jerk. The vertical acceleration A is bounded through the thrust: g - A <= a_z + g and |a + g e3| <= g + A.
    """
    shaping, gravity = following_options(vehicle), vehicle.body.gravity_m_s2
    up = _FOLLOWED_SHARE * shaping.vertical_acceleration_m_s2
    return Limits(
        speed_m_s=math.inf,
        acceleration_m_s2=_FOLLOWED_SHARE * shaping.horizontal_acceleration_m_s2,
        jerk_m_s3=_FOLLOWED_SHARE * min(shaping.horizontal_jerk_m_s3, shaping.vertical_jerk_m_s3),
        gravity_m_s2=gravity,
        most_thrust_m_s2=gravity + up,
        least_thrust_m_s2=gravity - up,
    )


def beyond_followed(plan: Artifact, vehicle: Vehicle) -> str:
    """What a plan asks beyond `followed_limits`, in words; empty if nothing.

    Its derivatives are sampled every 10 ms: this is about how well it is followed, and proves nothing.
    """
    knots = np.asarray(plan["time"], np.float64)
    coefficient = np.asarray(plan["coefficient"], np.float64)[:, :3]
    time = np.linspace(0, knots[-1], max(2, math.ceil(knots[-1] / _STEP_S)))
    acceleration, jerk = (evaluate(knots, coefficient, time, derivative) for derivative in (2, 3))
    limits = followed_limits(vehicle)
    up = limits.most_thrust_m_s2 - limits.gravity_m_s2
    asked = (
        ("accelerates by", np.linalg.norm(acceleration, axis=1).max(), limits.acceleration_m_s2, "m/s^2"),
        ("accelerates vertically by", np.abs(acceleration[:, 2]).max(), up, "m/s^2"),
        ("has a jerk of", np.linalg.norm(jerk, axis=1).max(), limits.jerk_m_s3, "m/s^3"),
    )
    return ", ".join(
        f"{what} {value:.3g} {unit}, of which {vehicle.name} follows {most:.3g} well"
        for what, value, most, unit in asked
        if value > (1 + _SLACK) * most
    )


def _yaw_rate(config: PlanConfig) -> float:
    return _YAW_RATE_RAD_S if config.yaw_rate_rad_s is None else config.yaw_rate_rad_s


def _yaw(rate: float, acceleration: float) -> dict[str, float]:
    return {"yaw_rate_rad_s": rate, "yaw_acceleration_rad_s2": min(acceleration, _YAW_RATIO_PER_S * rate)}


def _quadrotor_limits(
    config: PlanConfig, vehicle: Vehicle, acceleration: float, jerk: float, snap: float, *, turns: bool
) -> Limits:
    assert vehicle.rotors is not None
    body = quadrotor(vehicle)
    mixer = np.asarray(body.inverse_allocation)
    mass, g = body.mass, body.gravity
    share = mixer[:, 0]  # of each rotor in the thrust
    hover = mass * g * share
    high = hover + LIMIT_SHARE * (np.array(vehicle.rotors.max_thrust_n) - hover)
    low = hover - LIMIT_SHARE * (hover - np.array(vehicle.rotors.min_thrust_n))
    if not ((low < hover) & (hover < high) & (share > 0)).all():
        raise UsageError(f"the rotors of {vehicle.name} cannot hover level within their limits")

    # Thrust is reserved for torques; where the acceleration leaves more, that too.
    least_c = g - acceleration if acceleration < g else (1 - _FASTEST_FALL) * g
    spare = np.minimum(high - hover, hover - low)
    left = np.minimum(high - mass * (g + acceleration) * share, mass * least_c * share - low)
    torque = np.maximum(_TORQUE_SHARE * spare, left)
    most = float(((high - torque) / (mass * share)).min())
    least = max(float(((low + torque) / (mass * share)).max()), least_c)

    tilt = vehicle.tracking.max_tilt_rad
    full = math.pi / 2 if tilt is None else tilt
    theta = min(
        LIMIT_SHARE * full if config.tilt_rad is None else min(config.tilt_rad, full), math.acos(least / most)
    )
    if acceleration < g:
        theta = min(theta, math.asin(acceleration / g))
    tangent, secant2 = math.tan(theta), 1 / math.cos(theta) ** 2
    rates = vehicle.rates.max_rad_s
    yaw_rate = yaw_acceleration = 0.0
    jx, jy, jz = body.inertia
    if turns:
        most_yaw = _YAW_SHARE * float((torque / np.abs(mixer[:, 3])).min()) / jz  # of the torque about z
        yaw_rate = min(_yaw_rate(config), _YAW_RATE_SHARE * LIMIT_SHARE * rates[2] * math.cos(theta))
        yaw_rate, yaw_acceleration = _yaw(yaw_rate, most_yaw * math.cos(theta)).values()
    spinning = yaw_rate / (LIMIT_SHARE * math.cos(theta))  # a turn's part of the rate about z
    rate = min(rates[0], rates[1], (rates[2] - spinning) / tangent)
    rate = LIMIT_SHARE * rate if config.body_rate_rad_s is None else min(config.body_rate_rad_s, rate)

    # For |omega_xy| <= w and |s| / c <= ratio w^2: torques, and a rotor's part of them.
    ratio = _SNAP_RATIO
    sine, cosine = math.sin(theta), math.cos(theta)

    def fits(w: float) -> bool:
        tilt_rate = w + yaw_rate * sine  # seen from a frame that turns with the heading
        omega_z = w * tangent + yaw_rate / cosine
        across = (ratio + 1) * w**2 + w * omega_z
        seen = (ratio + 1) * w**2 + 2 * yaw_rate * w + (yaw_rate**2 + yaw_acceleration) * sine
        seen += tilt_rate**2 * tangent
        about_z = seen * tangent + tilt_rate**2 * secant2 / 2 + yaw_acceleration + yaw_rate * w * sine
        torques = np.array(
            [
                jx * across + abs(jz - jy) * w * omega_z,
                jy * across + abs(jx - jz) * w * omega_z,
                jz * about_z + abs(jy - jx) * w**2 / 2,
            ]
        )
        return bool((np.abs(mixer[:, 1:]) @ torques <= torque).all())

    if not fits(rate):
        slow, fast = 0.0, rate
        while fast - slow > _RATE_TOLERANCE * fast and fast > _LEAST_RATE_RAD_S:
            between = 0.5 * (slow + fast)
            slow, fast = (between, fast) if fits(between) else (slow, between)
        rate = slow
    if not rate > _LEAST_RATE_RAD_S:
        raise UsageError(f"{vehicle.name} has no torque left for tilting; use a lower --yaw-rate")
    return Limits(
        speed_m_s=config.speed_m_s,
        acceleration_m_s2=acceleration,
        jerk_m_s3=min(jerk, rate * least),
        snap_m_s4=min(snap, ratio * rate**2 * least),
        gravity_m_s2=g,
        most_thrust_m_s2=most,
        least_thrust_m_s2=least,
        tilt_rad=theta,
        **(_yaw(yaw_rate, yaw_acceleration) if turns else {}),
    )
