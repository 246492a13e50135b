"""Vehicles: body, rotors, limits and gains in one TOML file, `alula/vehicle`.

    schema = "alula/vehicle"      # optional, as is the version
    version = "1.0"
    name = "fastbridge"
    model = "quadrotor"           # or "double-integrator", "single-integrator"

    [body]
    radius_m = 0.15               # of a sphere around the vehicle
    mass_kg = 0.461
    inertia_kg_m2 = [6.5e-4, 6.9e-4, 1.1e-3]

    [rotors]                      # body frame: x forward, y left, z up
    positions_m = [[0.078, 0.078], [-0.078, -0.078], [0.078, -0.078], [-0.078, 0.078]]
    spins = [-1, -1, 1, 1]        # -1: counter-clockwise seen from above
    torque_ratio_m = 0.0116
    max_thrust_n = [4.25, 4.25, 4.25, 4.25]

    [rates]
    max_rad_s = [10, 10, 4]       # of a rate command
    time_constant_s = 0.02        # of the loop that follows it

    [throttle]                    # for flying by throttle and rates, as a racing pilot does
    acceleration_m_s2 = [0.0, 7.75474, 73.895455]  # a_0 + a_1 u + a_2 u^2 of a throttle u in [0, 1]

    [tracking]
    kp_per_s2 = 3.0
    kv_per_s = 2.0

    [disturbance]                 # in simulation; all off by default
    motor_time_constant_s = 0.03

    [assumed]                     # by controller and filters; off by default
    motor_time_constant_s = 0.03

    [velocities]                  # how its own controller follows velocities; `alula identify` measures it
    horizontal_lag = [0.57, 0.185] # 63 % of a stop from the speed v take 0.57 s + 0.185 s^2/m v
    vertical_lag = [0.22, 0.57]
    max_up_m_s = 2.5
    max_down_m_s = 1.5
    deceleration_m_s2 = 2.5

A quadrotor needs mass, inertia and rotors. A double integrator has `[limits] max_acceleration_m_s2`, a
single integrator `[limits] max_speed_m_s`. A table or key that does not apply to the model is refused.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import UNSET, Meta, UnsetType

from alula.schemas.artifacts.manifest import VERSION
from alula.schemas.errors import UsageError
from alula.schemas.scenarios.types import Positive, SparseTable
from alula.schemas.toml_file import first_beyond, read_toml, toml_value

VEHICLE_SCHEMA: Literal["alula/vehicle"] = "alula/vehicle"

Model = Literal["quadrotor", "double-integrator", "single-integrator"]
Size = Annotated[float, Meta(ge=0)]
Sizes = tuple[Size, Size, Size]
Lag = tuple[Size, Size]
Interval = tuple[float, float]
Intervals = tuple[Interval, Interval, Interval]
Positives = tuple[Positive, Positive, Positive]
RotorPosition = tuple[float, float]
Spin = Literal[-1, 1]

# Gains of the attitude over the inertia J, when a file has none: K_R = this J, K_omega = this J.
_ATTITUDE_PER_S2 = (500.0, 500.0, 110.0)
_RATE_PER_S = (36.0, 36.0, 11.0)
_LOOP_SHARE = 1.5  # the damping of rates times the time constant of the loop that follows them, at most
_SWINGING_SHARE = 2.0  # above it `fly` warns of a file's gains: ArduPilot flies at 1.54, PX4 sank at 3.6


class BodyTable(SparseTable, frozen=True, kw_only=True):
    """The rigid body.

    Attributes:
        radius_m: of a sphere around the vehicle [m].
        mass_kg: of a quadrotor [kg].
        inertia_kg_m2: about its own axes x, y, z [kg m^2].
        gravity_m_s2: where it flies [m/s^2].
    """

    radius_m: Positive
    mass_kg: Positive | None = None
    inertia_kg_m2: Positives | None = None
    gravity_m_s2: Positive = 9.81


class RotorsTable(SparseTable, frozen=True, kw_only=True):
    """Four rotors that push along body z.

    Attributes:
        positions_m: x and y of each in the body frame [m].
        spins: -1: counter-clockwise seen from above.
        torque_ratio_m: torque about z over thrust [m].
        max_thrust_n: of each [N].
        min_thrust_n: of each [N].
    """

    positions_m: tuple[RotorPosition, RotorPosition, RotorPosition, RotorPosition]
    spins: tuple[Spin, Spin, Spin, Spin]
    torque_ratio_m: Positive
    max_thrust_n: tuple[Positive, Positive, Positive, Positive]
    min_thrust_n: tuple[Size, Size, Size, Size] = (0.0, 0.0, 0.0, 0.0)


class LimitsTable(SparseTable, frozen=True, kw_only=True):
    """Limits of a point without rotors.

    Attributes:
        max_speed_m_s: of a single integrator [m/s].
        max_acceleration_m_s2: of a double integrator [m/s^2].
    """

    max_speed_m_s: Positive | None = None
    max_acceleration_m_s2: Positive | None = None


class RatesTable(SparseTable, frozen=True, kw_only=True):
    """Limits of rate commands, and the first-order lag of the rate loop within the rotors' limits.

    Attributes:
        max_rad_s: maximum rates of a command, body x, y, z [rad/s].
        time_constant_s: of the loop that follows a rate, about all axes [s].
        axis_time_constant_s: replaces it by one for each of x, y, z of the body [s].
    """

    max_rad_s: Positives = (10.0, 10.0, 4.0)
    time_constant_s: Positive = 0.02
    axis_time_constant_s: Positives | UnsetType = UNSET

    @property
    def axes_s(self) -> tuple[float, float, float]:
        """Time constants about x, y, z of the body [s]."""
        one, each = self.time_constant_s, self.axis_time_constant_s
        return (one, one, one) if isinstance(each, UnsetType) else each

    @property
    def tilting_s(self) -> float:
        """Time constant of the slower axis that tilts the thrust [s]."""
        return max(self.axes_s[:2])


class ThrottleTable(SparseTable, frozen=True, kw_only=True):
    """Acceleration by throttle, for flying as a racing pilot does.

    Attributes:
        acceleration_m_s2: a_0, a_1, a_2 of a_0 + a_1 u + a_2 u^2 at the throttle u with a fresh battery
            [m/s^2].
        sag_share: fraction by which the acceleration falls at most, at full throttle.
        sag_time_s: time constant of that [s].
    """

    acceleration_m_s2: tuple[float, Size, Size]
    sag_share: Annotated[float, Meta(ge=0, lt=1)] = 0.0
    sag_time_s: Positive = 0.5


class TrackingTable(SparseTable, frozen=True, kw_only=True):
    """Gains of the geometric controller, and limits of its command; see
    `alula/dynamics/tracking_controller.hpp`.

    Attributes:
        kp_per_s2: acceleration per position error [1/s^2].
        kv_per_s: acceleration per velocity error [1/s].
        attitude_n_m: torque per attitude error, body x, y, z [N m]; null: in proportion to the inertia, and
            slower than the rate loop.
        rate_n_m_s: torque per rate error, body x, y, z [N m s]; null: likewise.
        catch_up_m_s: maximum speed beyond the reference's to make up for a position error [m/s].
        max_tilt_rad: maximum tilt of a command [rad].
        max_thrust_share: maximum thrust of a command as a fraction of that of the rotors.
        uses_acceleration: whether errors of acceleration and jerk, computed from the thrust, enter the
            derivatives of the commanded force.
    """

    kp_per_s2: Positive = 3.0
    kv_per_s: Positive = 2.0
    attitude_n_m: Positives | None = None
    rate_n_m_s: Positives | None = None
    catch_up_m_s: Positive | None = None
    max_tilt_rad: Annotated[float, Meta(gt=0, lt=1.57)] | None = None
    max_thrust_share: Annotated[float, Meta(gt=0, le=1)] | None = None
    uses_acceleration: bool = True


class DisturbanceTable(SparseTable, frozen=True, kw_only=True):
    """Disturbances of the simulated plant, all off by default.

    Attributes:
        motor_time_constant_s: of the rotors' thrusts [s].
        linear_drag_n_s_m: along body x, y, z [N s/m].
        quadratic_drag_n_s2_m2: along body x, y, z [N s^2/m^2].
        wind_m_s: steady wind, world frame [m/s].
        gust_m_s: standard deviation of gusts, world x, y, z [m/s].
        gust_time_s: correlation time of gusts [s].
        position_noise_m: standard deviation of the measured position [m].
        velocity_noise_m_s: of the measured velocity [m/s].
        attitude_noise_rad: of the measured attitude [rad].
        rate_noise_rad_s: of the measured body rates [rad/s].
        delay_s: age of a measurement [s].
    """

    motor_time_constant_s: Size = 0.0
    linear_drag_n_s_m: Sizes = (0.0, 0.0, 0.0)
    quadratic_drag_n_s2_m2: Sizes = (0.0, 0.0, 0.0)
    wind_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gust_m_s: Sizes = (0.0, 0.0, 0.0)
    gust_time_s: Positive = 1.0
    position_noise_m: Size = 0.0
    velocity_noise_m_s: Size = 0.0
    attitude_noise_rad: Size = 0.0
    rate_noise_rad_s: Size = 0.0
    delay_s: Annotated[float, Meta(ge=0, le=10)] = 0.0


class AssumedTable(SparseTable, frozen=True, kw_only=True):
    """What controller and filters assume; for a real vehicle the identified values.

    Attributes:
        motor_time_constant_s: of the rotors' thrusts [s].
        delay_s: of measurements [s].
    """

    motor_time_constant_s: Annotated[float, Meta(ge=0, le=1)] = 0.0
    delay_s: Annotated[float, Meta(ge=0, le=1)] = 0.0


class VelocitiesTable(SparseTable, frozen=True, kw_only=True):
    """How the vehicle's own controller follows velocity set-points; the defaults are ArduPilot Copter's.

    63 % of a stop from the speed v take a + b v.

    Attributes:
        horizontal_lag: a and b [s, s^2/m].
        vertical_lag: a and b in the slower of both directions [s, s^2/m].
        max_up_m_s: speed up to which it climbs [m/s].
        max_down_m_s: speed up to which it descends [m/s].
        deceleration_m_s2: horizontal deceleration that a stop sustains; the default is ArduPilot's
            WPNAV_ACCEL [m/s^2].
    """

    horizontal_lag: Lag = (0.57, 0.185)
    vertical_lag: Lag = (0.22, 0.57)
    max_up_m_s: Positive = 2.5
    max_down_m_s: Positive = 1.5
    deceleration_m_s2: Positive = 2.5


class IdentifiedTable(SparseTable, frozen=True, kw_only=True):
    """What `alula identify` measured; an interval [low, high] contains the value in 95 of 100 measurements.

    Attributes:
        autopilot: that followed the steps.
        date: of the measurement.
        speeds_m_s: of the steps [m/s].
        horizontal_lag_interval, vertical_lag_interval: of a and of b of `velocities`.
        delay_s: time from a velocity set-point to the first response [s].
        delay_interval_s: of that [s].
        deceleration_interval_m_s2: of `velocities.deceleration_m_s2` [m/s^2].
        hover_throttle: throttle at which it hovers.
        hover_throttle_interval: of that.
        drag_per_s: linear drag along x and y of the heading and z, over the mass [1/s].
        drag_interval_per_s: of that [1/s].
        residual_m_s2: 99 % quantile of the difference between the acceleration of the model and the measured
            one, means over 0.25 s [m/s^2].
        time_constant_interval_s: of `rates.axis_time_constant_s` [s].
        reached_rad_s: fastest body rates that were flown, 0 about an axis without such a step; they bound
            `rates.max_rad_s` only where more was asked [rad/s].
        reached_interval_rad_s: of that [rad/s].
        yaw_acceleration_rad_s2: with which it begins to turn [rad/s^2].
        yaw_acceleration_interval_rad_s2: of that [rad/s^2].
        thrust_time_constant_s: of the thrust [s].
        thrust_time_constant_interval_s: of that [s].
    """

    autopilot: str = ""
    date: str = ""
    speeds_m_s: tuple[Positive, ...] = ()
    horizontal_lag_interval: tuple[Interval, Interval] | None = None
    vertical_lag_interval: tuple[Interval, Interval] | None = None
    delay_s: Size | None = None
    delay_interval_s: Interval | None = None
    deceleration_interval_m_s2: Interval | None = None
    hover_throttle: Positive | None = None
    hover_throttle_interval: Interval | None = None
    drag_per_s: tuple[float, float, float] | None = None
    drag_interval_per_s: Intervals | None = None
    residual_m_s2: Size | None = None
    time_constant_interval_s: Intervals | None = None
    reached_rad_s: Sizes | None = None
    reached_interval_rad_s: Intervals | None = None
    yaw_acceleration_rad_s2: Size | None = None
    yaw_acceleration_interval_rad_s2: Interval | None = None
    thrust_time_constant_s: Size | None = None
    thrust_time_constant_interval_s: Interval | None = None


_OF_QUADROTORS = (
    *("body.mass_kg", "body.inertia_kg_m2", "body.gravity_m_s2", "rotors", "rates", "throttle"),
    *("assumed", "velocities", "identified"),
)
# Keys that do not apply to each model.
_UNUSED = {
    "quadrotor": ("limits",),
    "double-integrator": (
        *_OF_QUADROTORS,
        "limits.max_speed_m_s",
        "tracking.attitude_n_m",
        "tracking.rate_n_m_s",
        "tracking.max_tilt_rad",
        "tracking.max_thrust_share",
        "tracking.uses_acceleration",
        "disturbance.motor_time_constant_s",
        "disturbance.linear_drag_n_s_m",
        "disturbance.quadratic_drag_n_s2_m2",
        "disturbance.wind_m_s",
        "disturbance.gust_m_s",
        "disturbance.gust_time_s",
        "disturbance.attitude_noise_rad",
        "disturbance.rate_noise_rad_s",
    ),
    "single-integrator": (*_OF_QUADROTORS, "limits.max_acceleration_m_s2", "tracking", "disturbance"),
}
_NEEDED = {
    "quadrotor": ("body.mass_kg", "body.inertia_kg_m2", "rotors"),
    "double-integrator": ("limits.max_acceleration_m_s2",),
    "single-integrator": ("limits.max_speed_m_s",),
}


class Vehicle(SparseTable, frozen=True, kw_only=True):
    """A vehicle file.

    Attributes:
        name: of the vehicle.
        model: what it is simulated as; tables that do not apply to it are refused.
        schema: kind of the file.
        version: of the kind.
        body: mass and size.
        rotors: of a quadrotor.
        limits: of a point.
        rates: the loop that follows rate commands.
        throttle: for pilots.
        tracking: gains of the controller.
        disturbance: of the vehicle in simulation.
        assumed: what controller and filters assume.
        velocities: how its own controller follows velocities.
        identified: what was measured.
    """

    name: str
    model: Model
    body: BodyTable
    schema: Literal["alula/vehicle"] = VEHICLE_SCHEMA
    version: str = VERSION
    rotors: RotorsTable | None = None
    limits: LimitsTable = LimitsTable()
    rates: RatesTable = RatesTable()
    throttle: ThrottleTable | None = None
    tracking: TrackingTable = TrackingTable()
    disturbance: DisturbanceTable = DisturbanceTable()
    assumed: AssumedTable = AssumedTable()
    velocities: VelocitiesTable | None = None
    identified: IdentifiedTable | None = None

    @property
    def following(self) -> VelocitiesTable:
        """How the vehicle follows velocities: the file's table, or the defaults."""
        return self.velocities or VelocitiesTable()

    def attitude_gains(self) -> tuple[Sequence[float], Sequence[float]]:
        """K_R [N m] and K_omega [N m s] of a quadrotor: the file's, or in proportion to the inertia.

        Attitudes are turned no faster than the rate loop follows: beyond that its commands swing.
        """
        inertia = self.body.inertia_kg_m2
        assert inertia is not None
        attitude, rate = list[float](), list[float]()
        for j, turn, damping, lag_s in zip(
            inertia, _ATTITUDE_PER_S2, _RATE_PER_S, self.rates.axes_s, strict=True
        ):
            slower = min(1.0, _LOOP_SHARE / (lag_s * damping))
            attitude.append(turn * slower**2 * j)
            rate.append(damping * slower * j)
        return self.tracking.attitude_n_m or attitude, self.tracking.rate_n_m_s or rate

    def axes_beyond_rate_loop(self) -> str:
        """The body axes whose gain of rates in the file is faster than the rate loop follows, as "xy"."""
        if self.body.inertia_kg_m2 is None or self.tracking.rate_n_m_s is None:
            return ""
        loops = zip("xyz", self.tracking.rate_n_m_s, self.body.inertia_kg_m2, self.rates.axes_s, strict=True)
        return "".join(axis for axis, gain, j, lag_s in loops if gain / j * lag_s > _SWINGING_SHARE)


# The vehicle of the FastBridge paper; `examples/vehicles/fastbridge.toml` has the source of each number.
FASTBRIDGE = Vehicle(
    name="fastbridge",
    model="quadrotor",
    body=BodyTable(radius_m=0.15, mass_kg=0.461, inertia_kg_m2=(6.5e-4, 6.9e-4, 1.1e-3)),
    rotors=RotorsTable(
        positions_m=((0.078, 0.078), (-0.078, -0.078), (0.078, -0.078), (-0.078, 0.078)),
        spins=(-1, -1, 1, 1),
        torque_ratio_m=0.0116,
        max_thrust_n=(4.25,) * 4,
    ),
    tracking=TrackingTable(
        attitude_n_m=(0.35, 0.35, 0.12),
        rate_n_m_s=(0.025, 0.025, 0.012),
        max_tilt_rad=1.0,
        max_thrust_share=0.9,
    ),
)


def contents(table: msgspec.Struct) -> dict[str, Any]:
    """Convert a vehicle to plain JSON values, including the defaults that its file may omit."""
    values = {
        name: contents(value) if isinstance(value, msgspec.Struct) else value
        for name, value in msgspec.structs.asdict(table).items()
        if value is not UNSET
    }
    return msgspec.json.decode(msgspec.json.encode(values), type=dict[str, Any])


def vehicle_text(vehicle: Vehicle, comments: Sequence[str] = ()) -> str:
    """Write a vehicle as the text of its file; `read_vehicle` reads the same vehicle from it.

    Args:
        comments: lines at the beginning.
    """
    values = msgspec.to_builtins(vehicle)
    values = {"schema": vehicle.schema, "version": vehicle.version} | values
    lines = [f"# {line}" for line in comments]
    lines += [f"{key} = {toml_value(value)}" for key, value in values.items() if not isinstance(value, dict)]
    for table, entries in values.items():
        if isinstance(entries, dict):
            given = [f"{key} = {toml_value(value)}" for key, value in entries.items() if value is not None]
            lines += ["", f"[{table}]", *given]
    return "\n".join(lines) + "\n"


def read_vehicle(path: Path) -> Vehicle:
    """Read and check a vehicle file.

    Raises:
        InputError: the file cannot be read, is empty or is not TOML.
        VersionError: it was written for a later major version.
        UsageError: a key is unknown, missing, not applicable to the model, of the wrong type or out of range;
            the message has its path.
    """
    vehicle = read_toml(path, Vehicle, VEHICLE_SCHEMA)
    try:
        check_vehicle(vehicle)
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from error
    return vehicle


def check_vehicle(vehicle: Vehicle) -> None:
    """Check that the numbers of a vehicle fit each other and its model.

    Raises:
        UsageError: they do not; the message has the path of the key.
    """
    values = msgspec.to_builtins(vehicle)
    if wrong := first_beyond(values, "$", math.inf):
        raise UsageError(f"{wrong}: must be finite")
    for key in _NEEDED[vehicle.model]:
        if not _has(values, key):
            raise UsageError(f"`$.{key}`: a {vehicle.model} needs it")
    for key in _UNUSED[vehicle.model]:
        if _has(values, key):
            raise UsageError(f"`$.{key}`: does not apply to a {vehicle.model}")
    disturbance = vehicle.disturbance
    has_drag = any(disturbance.linear_drag_n_s_m) or any(disturbance.quadratic_drag_n_s2_m2)
    if not has_drag and (any(disturbance.wind_m_s) or any(disturbance.gust_m_s)):
        raise UsageError("`$.disturbance`: wind and gusts act through drag, but the drag is zero")
    if vehicle.model == "quadrotor":
        _check_quadrotor(vehicle)


def _check_quadrotor(vehicle: Vehicle) -> None:
    mass, inertia = vehicle.body.mass_kg, vehicle.body.inertia_kg_m2
    assert mass is not None
    assert inertia is not None
    assert vehicle.rotors is not None
    if 2 * max(inertia) > sum(inertia) * (1 + 1e-9):
        raise UsageError("`$.body.inertia_kg_m2`: no body has one above the sum of the others")
    low, high = vehicle.rotors.min_thrust_n, vehicle.rotors.max_thrust_n
    if any(a >= b for a, b in zip(low, high, strict=True)):
        raise UsageError("`$.rotors.min_thrust_n`: must be below max_thrust_n")
    weight = mass * vehicle.body.gravity_m_s2
    if not sum(low) < weight < sum(high):
        raise UsageError(
            f"`$.rotors.max_thrust_n`: {sum(low):g} to {sum(high):g} N of thrust cannot hover {weight:.3g} N"
        )
    _check_throttle(vehicle, sum(high) / mass)
    fraction = vehicle.tracking.max_thrust_share
    if fraction is not None and 0.95 * fraction * sum(high) < weight:
        raise UsageError(f"`$.tracking.max_thrust_share`: {fraction:g} of the thrust cannot hover")


def _check_throttle(vehicle: Vehicle, strongest_m_s2: float) -> None:
    if vehicle.throttle is None:
        return
    idle, full = vehicle.throttle.acceleration_m_s2[0], sum(vehicle.throttle.acceleration_m_s2)
    gravity = vehicle.body.gravity_m_s2
    if not idle < gravity < full * (1 - vehicle.throttle.sag_share):
        raise UsageError(f"`$.throttle.acceleration_m_s2`: {idle:g} to {full:.3g} m/s^2 cannot hover")
    if abs(full - strongest_m_s2) > 0.05 * strongest_m_s2:
        raise UsageError(
            f"`$.throttle.acceleration_m_s2`: {full:.3g} m/s^2 at full throttle,"
            f" but the rotors give {strongest_m_s2:.3g}"
        )


def _has(values: Any, key: str) -> bool:
    """True when a table of the file sets a key; a default value counts as absent."""
    for part in key.split("."):
        if part not in values:
            return False
        values = values[part]
    return True
