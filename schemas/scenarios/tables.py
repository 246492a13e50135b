"""The parts of a scenario, one table each: keys, defaults, limits, descriptions.

None stands for a value of the vehicle, of the plan or of the world, or for something that the run does not
have; the description says which.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from alula.schemas.parameters.filter_options import (
    TABLES,
    ConeBackupParameters,
    ConeDiParameters,
    ConeEcbfParameters,
    GeofenceParameters,
    MovingFilterParameters,
    PolytopeCbfParameters,
    SaferSplatParameters,
    ShieldParameters,
)
from alula.schemas.parameters.filters.values import Options
from alula.schemas.scenarios.moving import DetectorTable, ObstacleTable, TrackerTable, WallTable
from alula.schemas.scenarios.types import (
    Box,
    Delay,
    FileName,
    Gain,
    Lag,
    Length,
    Limit,
    NotNegative,
    Positive,
    Scale,
    Share,
    Sizes,
    Speed,
    Table,
    Ticks,
    Vector,
    about,
)

SCENARIO_SCHEMA: Literal["alula/scenario"] = "alula/scenario"

MOST_TRIALS = 1_000_000
MOST_FACES = 32  # ALULA_FENCE_FACES of native/onboard
Face = tuple[float, float, float, float]  # n, d: n . p <= d is inside

# What commands there are, from the outer to the inner loop; body rates with a throttle are sticks.
COMMANDS = ("velocity", "acceleration", "wrench", "sticks")

VehicleName = Literal["crazyflie21", "fastbridge", "racer7", "single-integrator", "double-integrator"]
Interface = Literal["velocity", "acceleration", "wrench", "body-rates", "sticks"]
MissionKind = Literal["pairs", "goal", "waypoints", "plan", "hover", "pilot"]


class DisturbanceChanges(Table, frozen=True, kw_only=True):
    """Disturbances of the simulated plant; None: the vehicle file's."""

    motor_time_constant_s: Annotated[NotNegative | None, about("lag of the rotors' thrust [s]")] = None
    linear_drag_n_s_m: Annotated[Sizes | None, about("drag per speed through the air, body axes [N s/m]")] = (
        None
    )
    quadratic_drag_n_s2_m2: Annotated[
        Sizes | None, about("drag per squared speed, body axes [N s^2/m^2]")
    ] = None
    wind_m_s: Annotated[Vector | None, about("constant wind, world frame [m/s]")] = None
    gust_m_s: Annotated[Sizes | None, about("standard deviation of gusts, world frame [m/s]")] = None
    gust_time_s: Annotated[Positive | None, about("correlation time of gusts [s]")] = None
    sag_share: Annotated[
        Share | None, about("thrust lost to the battery at full throttle, as a fraction")
    ] = None
    sag_time_s: Annotated[Positive | None, about("time constant of that loss [s]")] = None


class AssumedChanges(Table, frozen=True, kw_only=True):
    """Lag and delay that controller and filters assume; None: the vehicle file's."""

    motor_time_constant_s: Annotated[Lag | None, about("lag of the rotors' thrust [s]")] = None
    delay_s: Annotated[Lag | None, about("delay of measurements [s]")] = None


class VehicleTable(Table, frozen=True, kw_only=True):
    """What flies: one of a name and a file, and deviations from it."""

    type: Annotated[
        VehicleName | None, about("vehicle built in by name; default: fastbridge, without file")
    ] = None
    file: Annotated[FileName | None, about("vehicle file, in place of type")] = None
    interface: Annotated[
        Interface | None,
        about(
            "what the vehicle is commanded by; default: velocity of a single integrator, acceleration "
            "of a double integrator, wrench of a quadrotor, sticks with a pilot"
        ),
    ] = None
    radius_m: Annotated[
        Length | None, about("radius of the sphere around it; default: the vehicle's [m]")
    ] = None
    max_speed_m_s: Annotated[
        Limit | None, about("limit of the speed of a point; default: the vehicle's [m/s]")
    ] = None
    max_acceleration_m_s2: Annotated[
        Limit | None,
        about("limit of the acceleration of a double integrator, per axis; default: the vehicle's [m/s^2]"),
    ] = None
    max_jerk_m_s3: Annotated[
        Limit | None, about("limit of the jerk of a double integrator, per axis; default: none [m/s^3]")
    ] = None
    actuation_delay_s: Annotated[
        Delay | None, about("time until a command of a double integrator begins to act; default: 0 [s]")
    ] = None
    velocity_gain_per_s: Annotated[
        Positive | None,
        about(
            "gain of the loop that follows velocities; default: the vehicle's tracking.kv_per_s, none with "
            "an autopilot [1/s]"
        ),
    ] = None
    autopilot: Annotated[
        bool | None,
        about(
            "a quadrotor follows velocities and accelerations as its own autopilot does: with the "
            "acceleration and jerk for which stops take as long as its table [velocities] says; default: "
            "with that table, which `identify` writes, and without velocity_gain_per_s"
        ),
    ] = None
    velocity_lag_s: Annotated[
        Delay | None,
        about(
            "lag with which velocities are followed; filters of velocities keep the way to a stop clear too; "
            "default: 1 / velocity_gain_per_s plus 0.15 s for the attitude loop; with an autopilot by axis, "
            "as in `fly`; single integrator: 0 [s]"
        ),
    ] = None
    mass_scale: Annotated[Scale, about("true mass over the vehicle's, which filters assume")] = 1.0
    thrust_scale: Annotated[Scale, about("true thrust over the vehicle's")] = 1.0
    rate_gain_scale: Annotated[Scale, about("true gain of the rate loop over the vehicle's")] = 1.0
    disturbance: DisturbanceChanges = DisturbanceChanges()
    assumed: AssumedChanges = AssumedChanges()


class FenceTable(Table, frozen=True, kw_only=True):
    """The permitted region: inside the box and the faces."""

    box_m: Annotated[Box | None, about("XMIN YMIN ZMIN XMAX YMAX ZMAX; None: no box [m]")] = None
    faces: Annotated[
        tuple[Face, ...], about("planes (n, d): n . p <= d is inside", max_length=MOST_FACES)
    ] = ()


class WorldTable(Table, frozen=True, kw_only=True):
    """What the vehicle must not touch: the union of all of it."""

    cover: Annotated[FileName | None, about("cover whose hulls are obstacles; None: no hulls")] = None
    onboard: Annotated[
        bool, about("filters read the cover as the image that flies, as on a microcontroller, bit by bit")
    ] = False
    tiles: Annotated[
        FileName | None,
        about(
            "folder of `export --tiles` of the cover, of which polytope-cbf reads two tiles at a time; None: "
            "it reads the whole"
        ),
    ] = None
    tile_load_s: Annotated[Delay, about("time that a tile takes to load, after the first [s]")] = 0.0
    scene: Annotated[FileName | None, about("scene whose ellipsoids are obstacles; None: no ellipsoids")] = (
        None
    )
    sigma: Annotated[
        float, about("level of the scene's ellipsoids, in standard deviations", ge=0.01, le=100)
    ] = 1.0
    confidence: Annotated[
        Annotated[float, Meta(gt=0, lt=1)] | None,
        about("probability inside an ellipsoid, in place of sigma, by the chi-square law"),
    ] = None
    inflation_m: Annotated[
        Length | None, about("length that filters add to the radius; default: by the scene's alignment [m]")
    ] = None
    fence: Annotated[FenceTable | None, about("permitted region; None: no fence")] = None
    moving: Annotated[tuple[ObstacleTable, ...], about("moving obstacles", max_length=100)] = ()
    walls: Annotated[tuple[WallTable, ...], about("boxes that are static obstacles")] = ()
    seen: Annotated[
        FileName | None, about("seen space; all other space is a static obstacle; None: all was seen")
    ] = None

    @property
    def has_boxes(self) -> bool:
        """Whether there are boxes beside the hulls of a cover: walls, or space that was not seen."""
        return bool(self.walls) or self.seen is not None

    @property
    def has_hulls(self) -> bool:
        """Whether there are convex polytopes to keep out of: of a cover, walls, or unseen space."""
        return self.cover is not None or self.has_boxes

    @property
    def is_static(self) -> bool:
        """Whether there is any static obstacle."""
        return self.has_hulls or self.scene is not None or self.fence is not None


def default_shield_map(*, has_ellipsoids: bool, has_hulls: bool) -> Literal["ellipsoids", "hulls", "both"]:
    """What a shield certifies against where nothing else is chosen: all that flights are judged against.

    Args:
        has_hulls: whether there are hulls, of a cover, of walls or of unseen space.
    """
    if not has_ellipsoids:
        return "hulls"
    return "both" if has_hulls else "ellipsoids"


class ControllerTable(Table, frozen=True, kw_only=True):
    """What makes the nominal command of a mission."""

    gain_per_s: Annotated[
        float, about("gain towards the goal, or of the speed error, of a point [1/s]", ge=1e-6, le=1e6)
    ] = 2.0
    guide: Annotated[
        Literal["none", "cone-di", "safer-splat"],
        about("filter of accelerations that changes the nominal command before the first filter gets it"),
    ] = "none"
    guide_parameters: Annotated[dict[str, Any], about("parameters of the guide")] = msgspec.field(
        default_factory=dict
    )
    catch_up_m_s: Annotated[
        Gain | None,
        about(
            "speed above the reference's at which a delayed vehicle catches up; default: the vehicle's, "
            "else half of speed_m_s [m/s]"
        ),
    ] = None


class PilotTable(Table, frozen=True, kw_only=True):
    """The simulated pilot, and an outage of its radio."""

    kind: Annotated[
        Literal["straight", "diagonal", "fall", "sticks", "aggressive", "silent", "repeated"],
        about(
            "straight, diagonal: tilted, permanently; fall: no throttle; sticks: random; "
            "aggressive: random attitudes; silent: aggressive, then no radio; repeated: from wall to wall"
        ),
    ] = "straight"
    heading_deg: Annotated[
        float, about("heading of straight and repeated; of diagonal 45 degrees to the left of it [deg]")
    ] = 0.0
    tilt_deg: Annotated[float, about("tilt of straight, diagonal and repeated [deg]", ge=0, lt=90)] = 72.0
    climb_m_s2: Annotated[float, about("vertical acceleration of diagonal [m/s^2]")] = 0.0
    silent_after_s: Annotated[
        NotNegative, about("minimum time until silent has no radio, at most twice as long [s]")
    ] = 1.5
    radio_from_s: Annotated[NotNegative | None, about("time at which the radio fails; None: never [s]")] = (
        None
    )
    radio_for_s: Annotated[NotNegative | None, about("duration of that; None: to the end [s]")] = None


class MissionTable(Table, frozen=True, kw_only=True):
    """What the vehicle shall do. Keys of another kind of mission are refused."""

    kind: Annotated[
        MissionKind,
        about(
            "pairs: random starts and goals, or those of another run; goal: from start_m to goal_m, by a "
            "double integrator's accelerations without a reference; "
            "waypoints: from start_m through waypoints_m; plan: along a plan; hover: stay at start_m; "
            "pilot: sticks of a simulated pilot"
        ),
    ] = "pairs"
    start_m: Annotated[
        Vector | None,
        about(
            "start (goal, waypoints, hover, pilot); of a plan: where the vehicle is when its time begins, as "
            "at the end of a climb, default: on it [m]"
        ),
    ] = None
    goal_m: Annotated[Vector | None, about("goal (goal) [m]")] = None
    waypoints_m: Annotated[tuple[Vector, ...], about("points to fly through, the last one the goal [m]")] = ()
    start_velocity_m_s: Annotated[
        Vector | None,
        about(
            "velocity at start_m, or at the plan's start, where `fly` takes over from a climb; default: by "
            "start_speed_m_s [m/s]"
        ),
    ] = None
    start_speed_m_s: Annotated[
        float,
        about(
            "speed at the start, towards the goal; in start_box_m the maximum, in a random direction [m/s]",
            ge=0,
            le=200,
        ),
    ] = 0.0
    start_yaw_deg: Annotated[float, about("yaw at start_m (hover, pilot); others look at the goal [deg]")] = (
        0.0
    )
    start_box_m: Annotated[
        Box | None, about("box of random safe starts, in place of start_m (pilot) [m]")
    ] = None
    start_tilt_deg: Annotated[float, about("maximum tilt of starts in start_box_m [deg]", ge=0, le=180)] = 0.0
    plan: Annotated[FileName | None, about("plan file (plan)")] = None
    pairs_from: Annotated[
        FileName | None, about("run (.run.mcap) whose starts and goals are flown (pairs)")
    ] = None
    speed_m_s: Annotated[
        Speed | None,
        about("speed of the nominal command; default: the plan's, a point's limit, else 1 [m/s]"),
    ] = None
    bounds_m: Annotated[
        Box | None,
        about(
            "box of random pairs; default: the central 98 % of hulls' vertices or Gaussians' centres, above "
            "the floor where it is known, and inside the closed space where there is one [m]"
        ),
    ] = None
    margin_m: Annotated[Length, about("extra clearance of random starts and goals (pairs) [m]")] = 0.05
    separation: Annotated[
        float, about("minimum distance of a pair, as a fraction of the box's diagonal (pairs)", ge=0, le=0.9)
    ] = 0.3
    which: Annotated[
        Literal["any", "blocked"],
        about("pairs to fly; blocked: only those whose straight line meets an obstacle (pairs)"),
    ] = "any"
    planned: Annotated[
        bool,
        about(
            "plan each flight in the cover, the scene and the space that was seen, slower where the filters "
            "would act, and fly the plan (pairs, goal, waypoints)"
        ),
    ] = False
    stop_fraction: Annotated[
        float,
        about(
            "the goal is reached within this fraction of its distance from the start, or within 1 mm, in a "
            "scene 5 cm",
            ge=1e-6,
            le=0.5,
        ),
    ] = 0.01
    via_tolerance_m: Annotated[
        Annotated[float, Meta(ge=1e-6, le=1e3)] | None,
        about("distance within which a via point counts as passed; default: the radius, at least 0.1 [m]"),
    ] = None
    allow_tight: Annotated[
        bool, about("fly a plan that is nearer to the map than the filters let the vehicle be (plan)")
    ] = False
    allow_other_map: Annotated[
        bool, about("fly a plan in a map that it was not made in, nor in one of the same scene (plan)")
    ] = False
    beyond_map_m: Annotated[
        Length,
        about(
            "distance around the mapped box, the box around all hulls and ellipsoids, in which space counts "
            "as free although the map does not have it; of a plan at least its own [m]"
        ),
    ] = 0.0
    waits: Annotated[
        bool | None,
        about(
            "time along a plan slows down for a vehicle that falls behind, and stops at via points, and the "
            "plan is finished, as in `fly`; default: for a vehicle with a table [velocities], which "
            "`identify` writes (plan)"
        ),
    ] = None
    receded_s: Annotated[
        NotNegative | None,
        about(
            "a flight ends when all moving obstacles have receded for this time, and not at its goal; None: "
            "at its goal [s]"
        ),
    ] = None
    controller: ControllerTable = ControllerTable()
    pilot: PilotTable = PilotTable()


class SensorTable(DetectorTable, frozen=True, kw_only=True):
    """The sensor that detects moving obstacles."""

    yaw_rate_rad_s: Annotated[
        NotNegative,
        about("maximum turn rate of the sensor, which looks at tracks; 0: it looks along the course"),
    ] = 1.0


class EstimationTable(Table, frozen=True, kw_only=True):
    """What the vehicle knows of its own state, and of what moves."""

    preset: Annotated[
        Literal["room-mocap", "outdoor-radar"] | None,
        about(
            "values of the sensor and of dr-acbf that the scenario does not give: room-mocap for objects "
            "thrown in a room with motion capture, outdoor-radar for traffic seen by a radar; default: "
            "room-mocap for a crazyflie21, else outdoor-radar"
        ),
    ] = None

    position_noise_m: Annotated[
        NotNegative | None, about("standard deviation of the measured position; default: the vehicle's [m]")
    ] = None
    velocity_noise_m_s: Annotated[
        NotNegative | None, about("standard deviation of the measured velocity; default: the vehicle's [m/s]")
    ] = None
    attitude_noise_rad: Annotated[
        NotNegative | None, about("standard deviation of the measured attitude; default: the vehicle's [rad]")
    ] = None
    rate_noise_rad_s: Annotated[
        NotNegative | None,
        about("standard deviation of the measured body rates; default: the vehicle's [rad/s]"),
    ] = None
    noise_time_s: Annotated[
        NotNegative,
        about("correlation time of the errors of position and velocity; 0: white noise of each step [s]"),
    ] = 0.0
    delay_s: Annotated[Delay | None, about("age of a measurement; default: the vehicle's [s]")] = None
    lost_share: Annotated[Share, about("probability that a measurement is lost, each on its own")] = 0.0
    lost_from_s: Annotated[
        NotNegative | None, about("time at which measurements cease; None: they do not [s]")
    ] = None
    lost_for_s: Annotated[NotNegative | None, about("duration of that; None: to the end [s]")] = None
    stale_s: Annotated[
        Positive,
        about("age of the last measurement beyond which no command is flown on it; inf: no limit [s]"),
    ] = 0.5
    disturbance_time_s: Annotated[
        Delay,
        about(
            "time constant with which controller and filters of a quadrotor estimate the acceleration that "
            "its model leaves out, as `fly` does with 0.1 by body rates; 0: not at all [s]"
        ),
    ] = 0.0
    sensor: SensorTable = SensorTable()
    tracker: TrackerTable = TrackerTable()


class SafetyTable(
    Table,
    frozen=True,
    kw_only=True,
    rename=lambda name: name if name in ("filters", "others") else name.replace("_", "-"),
):
    """The filters in their order, and the parameters of each under the name of its table.

    Filters with the same parameters have one table, see `TABLES`: mpc is flown with those of `dr-acbf`, and
    backup-qp with those of `geofence`. A file has no table `others`: the reader puts the tables of other
    packages' filters there.
    """

    filters: Annotated[
        tuple[str, ...],
        about("safety filters; each gets the command of the one before, and the last one is certified"),
    ] = ()
    polytope_cbf: PolytopeCbfParameters = PolytopeCbfParameters()
    safer_splat: SaferSplatParameters = SaferSplatParameters()
    cone_di: ConeDiParameters = ConeDiParameters()
    cone_ecbf: ConeEcbfParameters = ConeEcbfParameters()
    cone_backup: ConeBackupParameters = ConeBackupParameters()
    shield: ShieldParameters = ShieldParameters()
    dr_acbf: MovingFilterParameters = MovingFilterParameters()
    geofence: GeofenceParameters = GeofenceParameters()
    others: dict[str, dict[str, Any]] = msgspec.field(default_factory=dict)

    def parameters(self, name: str) -> Options | dict[str, Any]:
        """Parameters of a filter: complete of one of this package, as given of another's."""
        if name not in TABLES:
            return self.others.get(name, {})
        found: Options = getattr(self, TABLES[name].replace("-", "_"))
        return found


class RulesTable(Table, frozen=True, kw_only=True):
    """Time steps, trials and log."""

    dt_s: Annotated[float, about("time step of the loop [s]", ge=1e-4, le=1)] = 0.01
    plant_steps: Annotated[
        Ticks | None, about("steps of the plant in a time step; default: as many as keep them within 1 ms")
    ] = None
    controller_ticks: Annotated[Ticks, about("time steps for which the nominal command is held")] = 1
    filter_ticks: Annotated[Ticks, about("time steps for which the filters' command is held")] = 1
    trials: Annotated[
        Annotated[int, Meta(ge=1, le=MOST_TRIALS)] | None,
        about("number of flights; default: 100 random pairs, all pairs of pairs_from, else 1"),
    ] = None
    seed: Annotated[int, about("of everything that is random", ge=0, le=2**63 - 1)] = 0
    max_time_s: Annotated[
        Annotated[float, Meta(gt=0, le=1e5)] | None,
        about(
            "maximum duration of a flight; default: three times that of its reference; with commands of "
            "velocity 10 s more than the plan, or than five diagonals of the box take; hover, pilot: 10 [s]"
        ),
    ] = None
    logged: Annotated[
        int, about("number of first flights in the log, besides the worst ones", ge=0, le=MOST_TRIALS)
    ] = 20
    log_rate_hz: Annotated[float, about("samples per second in the log [Hz]", ge=1e-3, le=1e5)] = 20.0


class FlyTable(Table, frozen=True, kw_only=True):
    """A real flight: its link, and options of `fly` by name."""

    link: str | None = None
    speed_m_s: float | None = None
    rate_hz: float | None = None
    margin_m: float | None = None
    fence_m: tuple[float, float, float, float, float, float] | None = None
    fence_map: bool | None = None
    fence_reserve_m: float | None = None
    latency_s: float | None = None
    velocity_lag_s: float | None = None
    frame_check: Literal["motion", "hand", "none"] | None = None
    near_m: float | None = None
    allow_blocked: bool | None = None
    replan_after_s: float | None = None
    replans: int | None = None
    battery: float | None = None
    stale_s: float | None = None
    fallback_s: float | None = None
