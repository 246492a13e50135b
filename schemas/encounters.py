"""Scenarios with moving obstacles, `alula/scenario` too: those with a table `[encounter]` or `[[obstacles]]`.

    name = "two ahead"

    [encounter]
    start_m = [0.0, 0.0, 10.0]
    goal_m = [200.0, 0.0, 10.0]
    cruise_m_s = 4.0

    [vehicle]
    radius_m = 0.15
    a_max_m_s2 = 6.0

    [[obstacles]]                 # one table for each
    motion = "curving"            # or constant-velocity, accelerating, ballistic, quadrotor
    distance_m = 50.0             # from the start, at an azimuth; or position_m
    azimuth_rad = [0.349, 0.611]  # drawn between two numbers, or one number
    either_side = true
    speed_m_s = [5.0, 8.0]

    [sensor]
    kind = "radar"                # or ideal, mocap
    rate_hz = 20.0

    [tracker]
    gate = 30.0

    [filter]
    name = "dr-acbf"              # or dr-acbf-qp, mpc, cbf-qp, rp-cbf, none
    parameters = { clearance_m = 1.0, solver = "exact", trigger = "cvar" }

    [map]
    cover = "room.cover.npz"      # optional: static obstacles, relative to this file

    [[walls]]                     # optional: boxes that are static obstacles
    lower_m = [10.0, -1.0, 0.0]
    upper_m = [12.0, 1.0, 20.0]

    [trials]
    count = 100
    seed = 0

    [run]
    max_time_s = 14.0

Every key has a default. The headers native/core/include/alula/{flight/simulated_vehicle,
flight/obstacle_motion,tracking/radar,tracking/tracker}.hpp explain the keys; schemas/filters explains the
filter's parameters.
Source: Mandaokar, Rinner 2025 (arXiv 2512.00462).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

from alula.schemas.encounter_filter import FilterTable
from alula.schemas.errors import UsageError
from alula.schemas.manifest import VERSION
from alula.schemas.scenario import SCENARIO_SCHEMA
from alula.schemas.toml_file import first_beyond, has_key, read_changed

NotNegative = Annotated[float, msgspec.Meta(ge=0)]
Positive = Annotated[float, msgspec.Meta(gt=0)]
Share = Annotated[float, msgspec.Meta(ge=0, le=1)]
Vector = tuple[float, float, float]
Interval = float | tuple[float, float]  # a number, or the ends of a uniform distribution

MOST_TRIALS = 1_000_000
LARGEST = 1e6  # bound of positions, velocities and accelerations: ALULA_LARGEST of native/onboard


class _Table(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A table of the file: unknown keys are refused."""


class EncounterTable(_Table, frozen=True, kw_only=True):
    """Path of the vehicle, and the end of a trial."""

    start_m: Vector = (0.0, 0.0, 10.0)
    goal_m: Vector = (200.0, 0.0, 10.0)
    hovers: bool = False
    start_speed_m_s: NotNegative | None = None
    cruise_m_s: Positive = 4.0
    gain_per_s: Positive = 2.0
    receded_s: NotNegative = 1.0


class VehicleTable(_Table, frozen=True, kw_only=True):
    """The vehicle: a sphere that moves as a double integrator with limits."""

    radius_m: NotNegative = 0.15
    v_max_m_s: Positive = 12.0
    a_max_m_s2: Positive = 6.0
    j_max_m_s3: Positive = 60.0
    actuation_delay_s: NotNegative = 0.0
    yaw_rate_rad_s: NotNegative = 1.0


class ObstacleTable(_Table, frozen=True, kw_only=True):
    """One moving obstacle."""

    motion: Annotated[
        Literal["constant-velocity", "accelerating", "curving", "ballistic", "quadrotor"],
        msgspec.Meta(description="its motion; quadrotor: a second vehicle, which flies to way points"),
    ] = "constant-velocity"
    radius_m: Annotated[Positive, msgspec.Meta(description="radius of its sphere [m]")] = 0.15
    position_m: Annotated[
        Vector | None,
        msgspec.Meta(description="its start; None: at distance_m from the start of the vehicle [m]"),
    ] = None
    distance_m: Annotated[
        Positive, msgspec.Meta(description="distance of its start from the vehicle's [m]")
    ] = 50.0
    azimuth_rad: Annotated[
        Interval, msgspec.Meta(description="azimuth of its start from the vehicle's course [rad]")
    ] = 0.0
    elevation_rad: Annotated[Interval, msgspec.Meta(description="elevation of its start [rad]")] = 0.0
    either_side: Annotated[bool, msgspec.Meta(description="draw the sign of the azimuth")] = False
    crosses: Annotated[
        bool, msgspec.Meta(description="azimuth and elevation are those seen from the meeting point")
    ] = False
    offset_sigma_m: Annotated[
        tuple[NotNegative, NotNegative, NotNegative],
        msgspec.Meta(description="standard deviation of its start, along course, left, up [m]"),
    ] = (0.0, 0.0, 0.0)
    speed_m_s: Annotated[
        Interval,
        msgspec.Meta(
            description="its speed, of a ballistic one the horizontal mean, of a quadrotor the maximum [m/s]"
        ),
    ] = (5.0, 8.0)
    heading_rad: Annotated[
        Interval, msgspec.Meta(description="turn of its direction from the meeting point, outwards [rad]")
    ] = 0.0
    acceleration_m_s2: Annotated[
        Interval,
        msgspec.Meta(
            description="acceleration along its heading; of a quadrotor the maximum, 0: g / 2 [m/s^2]"
        ),
    ] = 0.0
    velocity_m_s: Annotated[
        Vector, msgspec.Meta(description="its velocity, where position_m is given and this is not zero [m/s]")
    ] = (0.0, 0.0, 0.0)
    aims_at_vehicle: Annotated[
        bool,
        msgspec.Meta(description="the meeting point is the vehicle's start, and not where both would meet"),
    ] = False
    meeting_sigma_m: Annotated[
        tuple[NotNegative, NotNegative, NotNegative],
        msgspec.Meta(description="standard deviation of the meeting point, along course, left, up [m]"),
    ] = (0.0, 0.0, 0.0)
    max_speed_m_s: Annotated[
        Positive, msgspec.Meta(description="maximum speed of an accelerating or curving one [m/s]")
    ] = 12.0
    turn_rate_rad_s: Annotated[
        NotNegative, msgspec.Meta(description="maximum turn rate of a curving one [rad/s]")
    ] = 0.25
    release_m: Annotated[
        NotNegative, msgspec.Meta(description="distance at which a curving one stops turning [m]")
    ] = 12.0
    drag_per_m: Annotated[
        NotNegative, msgspec.Meta(description="quadratic drag of a ballistic one: a = g - drag |v| v [1/m]")
    ] = 0.0
    start_s: Annotated[NotNegative, msgspec.Meta(description="time until which it rests, or is held [s]")] = (
        0.0
    )
    way_points_m: Annotated[
        tuple[Vector, ...],
        msgspec.Meta(description="way points of a quadrotor; default: one leg through the meeting point [m]"),
    ] = ()


class SensorTable(_Table, frozen=True, kw_only=True):
    """The sensor that detects the obstacles."""

    kind: Annotated[
        Literal["radar", "ideal", "mocap"],
        msgspec.Meta(
            description="radar; mocap: positions alone, all around; ideal: positions alone, of all obstacles"
        ),
    ] = "radar"
    rate_hz: Annotated[Positive, msgspec.Meta(description="scans per second [Hz]")] = 20.0
    half_azimuth_rad: Annotated[
        Annotated[float, msgspec.Meta(gt=0, le=math.pi)],
        msgspec.Meta(description="half of the horizontal field of view [rad]"),
    ] = math.radians(40)
    half_elevation_rad: Annotated[
        Annotated[float, msgspec.Meta(gt=0, le=math.pi / 2)],
        msgspec.Meta(description="half of the vertical field of view [rad]"),
    ] = math.radians(10)
    max_range_m: Annotated[Positive, msgspec.Meta(description="maximum range [m]")] = 150.0
    detection_probability: Annotated[
        Share, msgspec.Meta(description="probability that an obstacle within the field of view is detected")
    ] = 0.95
    sigma_range_m: Annotated[
        NotNegative, msgspec.Meta(description="standard deviation of a range of the radar [m]")
    ] = 0.15
    sigma_azimuth_rad: Annotated[
        NotNegative,
        msgspec.Meta(
            description="standard deviation of an azimuth of the radar, across the line of sight [rad]"
        ),
    ] = math.radians(0.5)
    sigma_elevation_rad: Annotated[
        NotNegative, msgspec.Meta(description="standard deviation of an elevation of the radar [rad]")
    ] = math.radians(0.7)
    sigma_range_rate_m_s: Annotated[
        NotNegative, msgspec.Meta(description="standard deviation of a range rate of the radar [m/s]")
    ] = 0.1
    clutter_per_scan: Annotated[
        NotNegative, msgspec.Meta(description="mean number of false detections of the radar in a scan")
    ] = 0.1
    clutter_range_rate_m_s: Annotated[
        NotNegative,
        msgspec.Meta(
            description="range rates of false detections are uniform within plus and minus this [m/s]"
        ),
    ] = 15.0
    noise_scale: Annotated[NotNegative, msgspec.Meta(description="factor on all standard deviations")] = 1.0
    position_sigma_m: Annotated[
        NotNegative,
        msgspec.Meta(description="standard deviation of a position of mocap and ideal, per axis [m]"),
    ] = 0.0
    delay_s: Annotated[NotNegative, msgspec.Meta(description="time from a detection to the tracker [s]")] = (
        0.0
    )
    own_position_sigma_m: Annotated[
        NotNegative, msgspec.Meta(description="standard deviation of the sensor's own position, per axis [m]")
    ] = 0.0
    own_velocity_sigma_m_s: Annotated[
        NotNegative,
        msgspec.Meta(description="standard deviation of the sensor's own velocity, per axis [m/s]"),
    ] = 0.0


class TrackerTable(_Table, frozen=True, kw_only=True):
    """The tracker that makes tracks of detections."""

    gate: Annotated[
        Positive,
        msgspec.Meta(description="maximum squared Mahalanobis distance of a detection from its track"),
    ] = 30.0
    confirm_hits: Annotated[
        Annotated[int, msgspec.Meta(ge=1)],
        msgspec.Meta(description="hits in the last confirm_scans that confirm a track"),
    ] = 5
    confirm_scans: Annotated[
        Annotated[int, msgspec.Meta(ge=1)], msgspec.Meta(description="scans that count for confirm_hits")
    ] = 6
    delete_misses: Annotated[
        Annotated[int, msgspec.Meta(ge=1)], msgspec.Meta(description="misses in a row that delete a track")
    ] = 5
    coast_s: Annotated[
        NotNegative,
        msgspec.Meta(
            description="time without a detection outside the field of view that deletes a track [s]"
        ),
    ] = 3.0
    field_margin: Annotated[
        NotNegative,
        msgspec.Meta(
            description="standard deviations of a track that the field of view must contain for a miss"
        ),
    ] = 2.0
    acceleration_noise: Annotated[
        NotNegative, msgspec.Meta(description="spectral density of the white acceleration [m^2/s^3]")
    ] = 0.5
    jerk_noise: Annotated[
        NotNegative, msgspec.Meta(description="spectral density of the white jerk [m^2/s^5]")
    ] = 0.2
    with_turn: Annotated[bool, msgspec.Meta(description="add a third model, a coordinated turn")] = False
    turn_noise: Annotated[
        NotNegative,
        msgspec.Meta(description="spectral density of the white turn rate's derivative [rad^2/s^3]"),
    ] = 0.1
    transition: Annotated[
        tuple[Share, Share, Share, Share],
        msgspec.Meta(description="transition probabilities of two models per scan, row by row"),
    ] = (0.992, 0.008, 0.015, 0.985)
    prior: Annotated[tuple[Share, Share], msgspec.Meta(description="initial probabilities of two models")] = (
        0.9,
        0.1,
    )
    turn_transition: Annotated[
        tuple[Share, Share, Share, Share, Share, Share, Share, Share, Share],
        msgspec.Meta(description="transition probabilities of three models per scan, row by row"),
    ] = (
        *(0.986, 0.010, 0.004),
        *(0.010, 0.986, 0.004),
        *(0.015, 0.015, 0.970),
    )
    turn_prior: Annotated[
        tuple[Share, Share, Share], msgspec.Meta(description="initial probabilities of three models")
    ] = (0.9, 0.05, 0.05)
    start_variance: Annotated[
        tuple[Positive, Positive, Positive],
        msgspec.Meta(
            description="variances of a new track: position, velocity, acceleration, per axis, in SI units"
        ),
    ] = (4.0, 25.0, 25.0)
    cross_range_variance: Annotated[
        Positive,
        msgspec.Meta(
            description="variance of the velocity of a new track across the line of sight [m^2/s^2]"
        ),
    ] = 100.0
    turn_variance: Annotated[
        Positive, msgspec.Meta(description="variance of the turn rate of a new track [rad^2/s^2]")
    ] = 0.1
    mixing_variance: Annotated[
        NotNegative,
        msgspec.Meta(
            description="variance of the acceleration of a model that has none, where models mix [m^2/s^4]"
        ),
    ] = 3.0
    mixes: Annotated[
        bool, msgspec.Meta(description="mix initial conditions; false: mix at read-out only")
    ] = True
    gates_models: Annotated[
        bool, msgspec.Meta(description="SAFE-IMM: do not correct a model that an innovation does not fit")
    ] = False
    heavy_tails: Annotated[
        bool, msgspec.Meta(description="SAFE-IMM: likelihoods of Student's t once innovations are too large")
    ] = False
    adapts_transition: Annotated[
        bool, msgspec.Meta(description="SAFE-IMM: adapt the transition probabilities to the evidence")
    ] = False
    winner_takes_all: Annotated[
        bool, msgspec.Meta(description="SAFE-IMM: read out the most probable model alone")
    ] = False
    jamming: Annotated[
        bool, msgspec.Meta(description="SAFE-IMM: widen gates and tails for a jammed sensor")
    ] = False


class MapTable(_Table, frozen=True, kw_only=True):
    """Static obstacles: a file relative to the scenario's folder."""

    cover: str | None = None


class WallTable(_Table, frozen=True, kw_only=True):
    """A static box."""

    lower_m: Annotated[Vector, msgspec.Meta(description="lower corner [m]")]
    upper_m: Annotated[Vector, msgspec.Meta(description="upper corner [m]")]


class TrialsTable(_Table, frozen=True, kw_only=True):
    """Number of trials, their seed, and the number of first trials in the log, besides the closest one."""

    count: Annotated[int, msgspec.Meta(ge=1, le=MOST_TRIALS)] = 100
    seed: Annotated[int, msgspec.Meta(ge=0, le=2**63 - 1)] = 0
    logged: Annotated[int, msgspec.Meta(ge=0, le=1000)] = 5


class RunTable(_Table, frozen=True, kw_only=True):
    """Time steps and limits."""

    dt_s: Positive = 0.01
    plant_steps: Annotated[int, msgspec.Meta(ge=1, le=1000)] = 10
    max_time_s: Positive = 14.0
    log_rate_hz: Positive = 20.0


class Encounters(_Table, frozen=True, kw_only=True):
    """A scenario file with moving obstacles; everything that shapes the result of its trials."""

    schema: Literal["alula/scenario"] = SCENARIO_SCHEMA
    version: str = VERSION
    name: str = "encounters"
    encounter: EncounterTable = EncounterTable()
    vehicle: VehicleTable = VehicleTable()
    obstacles: tuple[ObstacleTable, ...] = ()
    sensor: SensorTable = SensorTable()
    tracker: TrackerTable = TrackerTable()
    filter: FilterTable = FilterTable()
    map: MapTable = MapTable()
    walls: tuple[WallTable, ...] = ()
    trials: TrialsTable = TrialsTable()
    run: RunTable = RunTable()


def is_encounters(path: Path) -> bool:
    """Return whether a scenario file has moving obstacles."""
    return has_key(path, "encounter") or has_key(path, "obstacles")


def read_encounters(path: Path, changes: Mapping[str, Any] | None = None) -> Encounters:
    """Read a scenario with moving obstacles.

    Args:
        path: the file.
        changes: values that replace those of the file, by their keys with dots between:
            `sensor.rate_hz`, `obstacles.0.radius_m`.

    Raises:
        InputError: the file cannot be read or is not TOML.
        VersionError: it was written for a later major version.
        UsageError: a key is unknown, of the wrong type or out of range; the message has its path.
    """
    scenario = read_changed(path, Encounters, SCENARIO_SCHEMA, changes)
    tree = msgspec.to_builtins(scenario)
    for table in ("encounter", "obstacles", "walls"):
        if wrong := first_beyond(tree[table], f"$.{table}", LARGEST):
            raise UsageError(f"{path}: {wrong} must be below {LARGEST:g}")
    _check(path, scenario)
    return scenario


def _check(path: Path, scenario: Encounters) -> None:
    """Refuse keys that contradict each other."""

    def require(good: bool, where: str, words: str) -> None:
        if not good:
            raise UsageError(f"{path}: `$.{where}` {words}")

    table, vehicle, run = scenario.encounter, scenario.vehicle, scenario.run
    require(bool(scenario.name.strip()), "name", "must not be empty")
    require(len(scenario.obstacles) <= 100, "obstacles", "may be 100 at most")
    require(
        table.hovers or table.start_m != table.goal_m,
        "encounter.goal_m",
        "is the start; a vehicle that stays there hovers",
    )
    for where, value, low, high in (
        ("vehicle.radius_m", vehicle.radius_m, 0, 1e3),
        ("vehicle.v_max_m_s", vehicle.v_max_m_s, 1e-3, 1e3),
        ("vehicle.a_max_m_s2", vehicle.a_max_m_s2, 1e-3, 1e4),
        ("vehicle.j_max_m_s3", vehicle.j_max_m_s3, 1e-3, 1e9),
    ):
        require(low <= value <= high, where, f"must be between {low:g} and {high:g}")
    require(table.cruise_m_s <= vehicle.v_max_m_s, "encounter.cruise_m_s", "is above vehicle.v_max_m_s")
    start_speed = table.start_speed_m_s or 0.0
    require(start_speed <= vehicle.v_max_m_s, "encounter.start_speed_m_s", "is above vehicle.v_max_m_s")
    require(1e-4 <= run.dt_s <= 1, "run.dt_s", "must be between 0.0001 and 1")
    require(run.dt_s <= run.max_time_s <= 1e5, "run.max_time_s", "must be between dt_s and 100000")
    require(1e-3 <= run.log_rate_hz <= 1e5, "run.log_rate_hz", "must be between 0.001 and 100000")
    require(table.gain_per_s <= 1 / run.dt_s, "encounter.gain_per_s", "is above 1 / run.dt_s")
    require(vehicle.actuation_delay_s <= 10, "vehicle.actuation_delay_s", "must be at most 10")
    require(scenario.sensor.delay_s <= 10, "sensor.delay_s", "must be at most 10")
    tracker = scenario.tracker
    require(tracker.confirm_hits <= tracker.confirm_scans, "tracker.confirm_hits", "is above confirm_scans")
    check_walls(scenario.walls, "walls", require)
    check_moving(scenario.obstacles, "obstacles", require)


def check_walls(walls: Sequence[WallTable], where: str, require: Callable[[bool, str, str], None]) -> None:
    """Check boxes that stand in the way.

    Args:
        walls: of a scenario.
        where: path of their key.
        require: refuses a value, from whether it is good, the path of its key and the rest of the sentence.
    """
    for i, wall in enumerate(walls):
        below = all(low < high for low, high in zip(wall.lower_m, wall.upper_m, strict=True))
        require(below, f"{where}[{i}].upper_m", "must be above lower_m on each axis")


def check_moving(
    obstacles: Sequence[ObstacleTable], where: str, require: Callable[[bool, str, str], None]
) -> None:
    """Check the intervals from which moving obstacles are drawn.

    Args:
        obstacles: of a scenario.
        where: path of their key.
        require: as for `check_walls`.
    """
    for i, obstacle in enumerate(obstacles):
        for key in ("azimuth_rad", "elevation_rad", "speed_m_s", "heading_rad", "acceleration_m_s2"):
            low, high = interval(getattr(obstacle, key))
            require(low <= high, f"{where}[{i}].{key}", "must be a number, or two that increase")
        require(interval(obstacle.speed_m_s)[0] >= 0, f"{where}[{i}].speed_m_s", "must be >= 0")


def interval(value: Interval) -> tuple[float, float]:
    """Both ends of an interval; a number is an interval of length zero.

    Args:
        value: a number or the two ends.
    """
    return value if isinstance(value, tuple) else (float(value), float(value))
