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
from collections.abc import Mapping
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

    motion: Literal["constant-velocity", "accelerating", "curving", "ballistic", "quadrotor"] = (
        "constant-velocity"
    )
    radius_m: Positive = 0.15
    position_m: Vector | None = None
    distance_m: Positive = 50.0
    azimuth_rad: Interval = 0.0
    elevation_rad: Interval = 0.0
    either_side: bool = False
    crosses: bool = False
    offset_sigma_m: tuple[NotNegative, NotNegative, NotNegative] = (0.0, 0.0, 0.0)
    speed_m_s: Interval = (5.0, 8.0)
    heading_rad: Interval = 0.0
    acceleration_m_s2: Interval = 0.0
    velocity_m_s: Vector = (0.0, 0.0, 0.0)
    aims_at_vehicle: bool = False
    meeting_sigma_m: tuple[NotNegative, NotNegative, NotNegative] = (0.0, 0.0, 0.0)
    max_speed_m_s: Positive = 12.0
    turn_rate_rad_s: NotNegative = 0.25
    release_m: NotNegative = 12.0
    drag_per_m: NotNegative = 0.0
    start_s: NotNegative = 0.0
    way_points_m: tuple[Vector, ...] = ()


class SensorTable(_Table, frozen=True, kw_only=True):
    """The sensor that detects the obstacles."""

    kind: Literal["radar", "ideal", "mocap"] = "radar"
    rate_hz: Positive = 20.0
    half_azimuth_rad: Annotated[float, msgspec.Meta(gt=0, le=math.pi)] = math.radians(40)
    half_elevation_rad: Annotated[float, msgspec.Meta(gt=0, le=math.pi / 2)] = math.radians(10)
    max_range_m: Positive = 150.0
    detection_probability: Share = 0.95
    sigma_range_m: NotNegative = 0.15
    sigma_azimuth_rad: NotNegative = math.radians(0.5)
    sigma_elevation_rad: NotNegative = math.radians(0.7)
    sigma_range_rate_m_s: NotNegative = 0.1
    clutter_per_scan: NotNegative = 0.1
    clutter_range_rate_m_s: NotNegative = 15.0
    noise_scale: NotNegative = 1.0
    position_sigma_m: NotNegative = 0.0
    delay_s: NotNegative = 0.0
    own_position_sigma_m: NotNegative = 0.0
    own_velocity_sigma_m_s: NotNegative = 0.0


class TrackerTable(_Table, frozen=True, kw_only=True):
    """The tracker that makes tracks of detections."""

    gate: Positive = 30.0
    confirm_hits: Annotated[int, msgspec.Meta(ge=1)] = 5
    confirm_scans: Annotated[int, msgspec.Meta(ge=1)] = 6
    delete_misses: Annotated[int, msgspec.Meta(ge=1)] = 5
    coast_s: NotNegative = 3.0
    field_margin: NotNegative = 2.0
    acceleration_noise: NotNegative = 0.5
    jerk_noise: NotNegative = 0.2
    with_turn: bool = False
    turn_noise: NotNegative = 0.1
    transition: tuple[Share, Share, Share, Share] = (0.992, 0.008, 0.015, 0.985)
    prior: tuple[Share, Share] = (0.9, 0.1)
    turn_transition: tuple[Share, Share, Share, Share, Share, Share, Share, Share, Share] = (
        *(0.986, 0.010, 0.004),
        *(0.010, 0.986, 0.004),
        *(0.015, 0.015, 0.970),
    )
    turn_prior: tuple[Share, Share, Share] = (0.9, 0.05, 0.05)
    start_variance: tuple[Positive, Positive, Positive] = (4.0, 25.0, 25.0)
    cross_range_variance: Positive = 100.0
    turn_variance: Positive = 0.1
    mixing_variance: NotNegative = 3.0
    mixes: bool = True
    gates_models: bool = False
    heavy_tails: bool = False
    adapts_transition: bool = False
    winner_takes_all: bool = False
    jamming: bool = False


class MapTable(_Table, frozen=True, kw_only=True):
    """Static obstacles: a file relative to the scenario's folder."""

    cover: str | None = None


class WallTable(_Table, frozen=True, kw_only=True):
    """A static box."""

    lower_m: Vector
    upper_m: Vector


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
    for i, wall in enumerate(scenario.walls):
        below = all(low < high for low, high in zip(wall.lower_m, wall.upper_m, strict=True))
        require(below, f"walls[{i}].upper_m", "must be above lower_m on each axis")
    for i, obstacle in enumerate(scenario.obstacles):
        where = f"obstacles[{i}]"
        for key in ("azimuth_rad", "elevation_rad", "speed_m_s", "heading_rad", "acceleration_m_s2"):
            low, high = interval(getattr(obstacle, key))
            require(low <= high, f"{where}.{key}", "must be a number, or two that increase")
        require(interval(obstacle.speed_m_s)[0] >= 0, f"{where}.speed_m_s", "must be >= 0")


def interval(value: Interval) -> tuple[float, float]:
    """Both ends of an interval; a number is an interval of length zero.

    Args:
        value: a number or the two ends.
    """
    return value if isinstance(value, tuple) else (float(value), float(value))
