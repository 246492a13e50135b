"""Tables of a scenario for what moves, for the sensor that detects it, and for the tracker.

The headers native/core/include/alula/{flight/obstacle_motion,tracking/radar,tracking/tracker}.hpp explain the
keys. Source: Mandaokar, Rinner 2025 (arXiv 2512.00462).
"""

from __future__ import annotations

import math
from typing import Annotated, Literal

from msgspec import Meta

from alula.schemas.scenarios.types import NotNegative, Positive, Table, about

Chance = Annotated[float, Meta(ge=0, le=1)]
Vector = tuple[float, float, float]
Interval = float | tuple[float, float]  # a number, or the ends of a uniform distribution


class ObstacleTable(Table, frozen=True, kw_only=True):
    """One moving obstacle."""

    motion: Annotated[
        Literal["constant-velocity", "accelerating", "curving", "ballistic", "quadrotor"],
        about("its motion; quadrotor: a second vehicle, which flies to way points"),
    ] = "constant-velocity"
    radius_m: Annotated[Positive, about("radius of its sphere [m]")] = 0.15
    position_m: Annotated[
        Vector | None, about("its start; None: at distance_m from the start of the vehicle [m]")
    ] = None
    distance_m: Annotated[Positive, about("distance of its start from the vehicle's [m]")] = 50.0
    azimuth_rad: Annotated[Interval, about("azimuth of its start from the vehicle's course [rad]")] = 0.0
    elevation_rad: Annotated[Interval, about("elevation of its start [rad]")] = 0.0
    either_side: Annotated[bool, about("draw the sign of the azimuth")] = False
    crosses: Annotated[bool, about("azimuth and elevation are those seen from the meeting point")] = False
    offset_sigma_m: Annotated[
        tuple[NotNegative, NotNegative, NotNegative],
        about("standard deviation of its start, along course, left, up [m]"),
    ] = (0.0, 0.0, 0.0)
    speed_m_s: Annotated[
        Interval, about("its speed, of a ballistic one the horizontal mean, of a quadrotor the maximum [m/s]")
    ] = (5.0, 8.0)
    heading_rad: Annotated[
        Interval, about("turn of its direction from the meeting point, outwards [rad]")
    ] = 0.0
    acceleration_m_s2: Annotated[
        Interval, about("acceleration along its heading; of a quadrotor the maximum, 0: g / 2 [m/s^2]")
    ] = 0.0
    velocity_m_s: Annotated[
        Vector, about("its velocity, where position_m is given and this is not zero [m/s]")
    ] = (0.0, 0.0, 0.0)
    aims_at_vehicle: Annotated[
        bool, about("the meeting point is the vehicle's start, and not where both would meet")
    ] = False
    meeting_sigma_m: Annotated[
        tuple[NotNegative, NotNegative, NotNegative],
        about("standard deviation of the meeting point, along course, left, up [m]"),
    ] = (0.0, 0.0, 0.0)
    max_speed_m_s: Annotated[Positive, about("maximum speed of an accelerating or curving one [m/s]")] = 12.0
    turn_rate_rad_s: Annotated[NotNegative, about("maximum turn rate of a curving one [rad/s]")] = 0.25
    release_m: Annotated[NotNegative, about("distance at which a curving one stops turning [m]")] = 12.0
    drag_per_m: Annotated[
        NotNegative, about("quadratic drag of a ballistic one: a = g - drag |v| v [1/m]")
    ] = 0.0
    start_s: Annotated[NotNegative, about("time until which it rests, or is held [s]")] = 0.0
    way_points_m: Annotated[
        tuple[Vector, ...], about("way points of a quadrotor; default: one leg through the meeting point [m]")
    ] = ()


class DetectorTable(Table, frozen=True, kw_only=True):
    """The sensor that detects the obstacles."""

    kind: Annotated[
        Literal["radar", "ideal", "mocap"],
        about("radar; mocap: positions alone, all around; ideal: positions alone, of all obstacles"),
    ] = "radar"
    rate_hz: Annotated[Positive, about("scans per second [Hz]")] = 20.0
    half_azimuth_rad: Annotated[
        Annotated[float, Meta(gt=0, le=math.pi)], about("half of the horizontal field of view [rad]")
    ] = math.radians(40)
    half_elevation_rad: Annotated[
        Annotated[float, Meta(gt=0, le=math.pi / 2)], about("half of the vertical field of view [rad]")
    ] = math.radians(10)
    max_range_m: Annotated[Positive, about("maximum range [m]")] = 150.0
    detection_probability: Annotated[
        Chance, about("probability that an obstacle within the field of view is detected")
    ] = 0.95
    sigma_range_m: Annotated[NotNegative, about("standard deviation of a range of the radar [m]")] = 0.15
    sigma_azimuth_rad: Annotated[
        NotNegative, about("standard deviation of an azimuth of the radar, across the line of sight [rad]")
    ] = math.radians(0.5)
    sigma_elevation_rad: Annotated[
        NotNegative, about("standard deviation of an elevation of the radar [rad]")
    ] = math.radians(0.7)
    sigma_range_rate_m_s: Annotated[
        NotNegative, about("standard deviation of a range rate of the radar [m/s]")
    ] = 0.1
    clutter_per_scan: Annotated[
        NotNegative, about("mean number of false detections of the radar in a scan")
    ] = 0.1
    clutter_range_rate_m_s: Annotated[
        NotNegative, about("range rates of false detections are uniform within plus and minus this [m/s]")
    ] = 15.0
    noise_scale: Annotated[NotNegative, about("factor on all standard deviations")] = 1.0
    position_sigma_m: Annotated[
        NotNegative, about("standard deviation of a position of mocap and ideal, per axis [m]")
    ] = 0.0
    delay_s: Annotated[NotNegative, about("time from a detection to the tracker [s]")] = 0.0
    own_position_sigma_m: Annotated[
        NotNegative, about("standard deviation of the sensor's own position, per axis [m]")
    ] = 0.0
    own_velocity_sigma_m_s: Annotated[
        NotNegative, about("standard deviation of the sensor's own velocity, per axis [m/s]")
    ] = 0.0


class TrackerTable(Table, frozen=True, kw_only=True):
    """The tracker that makes tracks of detections."""

    gate: Annotated[Positive, about("maximum squared Mahalanobis distance of a detection from its track")] = (
        30.0
    )
    confirm_hits: Annotated[
        Annotated[int, Meta(ge=1)], about("hits in the last confirm_scans that confirm a track")
    ] = 5
    confirm_scans: Annotated[Annotated[int, Meta(ge=1)], about("scans that count for confirm_hits")] = 6
    delete_misses: Annotated[Annotated[int, Meta(ge=1)], about("misses in a row that delete a track")] = 5
    coast_s: Annotated[
        NotNegative, about("time without a detection outside the field of view that deletes a track [s]")
    ] = 3.0
    field_margin: Annotated[
        NotNegative, about("standard deviations of a track that the field of view must contain for a miss")
    ] = 2.0
    acceleration_noise: Annotated[
        NotNegative, about("spectral density of the white acceleration [m^2/s^3]")
    ] = 0.5
    jerk_noise: Annotated[NotNegative, about("spectral density of the white jerk [m^2/s^5]")] = 0.2
    with_turn: Annotated[bool, about("add a third model, a coordinated turn")] = False
    turn_noise: Annotated[
        NotNegative, about("spectral density of the white turn rate's derivative [rad^2/s^3]")
    ] = 0.1
    transition: Annotated[
        tuple[Chance, Chance, Chance, Chance],
        about("transition probabilities of two models per scan, row by row"),
    ] = (0.992, 0.008, 0.015, 0.985)
    prior: Annotated[tuple[Chance, Chance], about("initial probabilities of two models")] = (0.9, 0.1)
    turn_transition: Annotated[
        tuple[Chance, Chance, Chance, Chance, Chance, Chance, Chance, Chance, Chance],
        about("transition probabilities of three models per scan, row by row"),
    ] = (*(0.986, 0.010, 0.004), *(0.010, 0.986, 0.004), *(0.015, 0.015, 0.970))
    turn_prior: Annotated[tuple[Chance, Chance, Chance], about("initial probabilities of three models")] = (
        0.9,
        0.05,
        0.05,
    )
    start_variance: Annotated[
        tuple[Positive, Positive, Positive],
        about("variances of a new track: position, velocity, acceleration, per axis, in SI units"),
    ] = (4.0, 25.0, 25.0)
    cross_range_variance: Annotated[
        Positive, about("variance of the velocity of a new track across the line of sight [m^2/s^2]")
    ] = 100.0
    turn_variance: Annotated[Positive, about("variance of the turn rate of a new track [rad^2/s^2]")] = 0.1
    mixing_variance: Annotated[
        NotNegative,
        about("variance of the acceleration of a model that has none, where models mix [m^2/s^4]"),
    ] = 3.0
    mixes: Annotated[bool, about("mix initial conditions; false: mix at read-out only")] = True
    gates_models: Annotated[
        bool, about("SAFE-IMM: do not correct a model that an innovation does not fit")
    ] = False
    heavy_tails: Annotated[
        bool, about("SAFE-IMM: likelihoods of Student's t once innovations are too large")
    ] = False
    adapts_transition: Annotated[
        bool, about("SAFE-IMM: adapt the transition probabilities to the evidence")
    ] = False
    winner_takes_all: Annotated[bool, about("SAFE-IMM: read out the most probable model alone")] = False
    jamming: Annotated[bool, about("SAFE-IMM: widen gates and tails for a jammed sensor")] = False


class WallTable(Table, frozen=True, kw_only=True):
    """A static box."""

    lower_m: Annotated[Vector, about("lower corner [m]")]
    upper_m: Annotated[Vector, about("upper corner [m]")]


def interval(value: Interval) -> tuple[float, float]:
    """Both ends of an interval; a number is an interval of length zero.

    Args:
        value: a number or the two ends.
    """
    return value if isinstance(value, tuple) else (float(value), float(value))
