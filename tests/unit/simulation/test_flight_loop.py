"""The native loop of flights: values of an older loop, numpy, steps as on board, losses, refused commands."""

import json

import numpy as np
import pytest
from scipy import stats

from alula import _core
from alula.schemas.parameters.filter_options import MovingFilterParameters
from alula.schemas.scenarios.moving import DetectorTable, ObstacleTable, TrackerTable
from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.schemas.scenarios.vehicles import VEHICLES
from alula.stages.compression.hulls import Hulls
from alula.stages.filtering import registry
from alula.stages.filtering.moving_filters import moving_options
from alula.stages.filtering.obstacles import ellipsoid_index
from alula.stages.filtering.protocol import FilterWorld
from alula.stages.planning.rest_to_rest import rest_to_rest
from alula.stages.vehicles.bodies import quadrotor, tracking_gains
from alula.stages.vehicles.racer import racer_model
from alula.stages.world.moving import moving_spec
from support.models.quadrotor_model import E3, body_to_inertial
from support.paths import SUPPORT
from support.scenes.fabricate import make_scene
from support.scenes.small_scenes import box_cover

BODY, GAINS = quadrotor(FASTBRIDGE), tracking_gains(FASTBRIDGE)
MASS, GRAVITY = FASTBRIDGE.body.mass_kg, FASTBRIDGE.body.gravity_m_s2
OLDER = json.loads((SUPPORT / "vectors_older_flights.json").read_text())
INDEX = ellipsoid_index(make_scene(60, low=(0, 0, 0), high=(6, 4, 3)), 1.0, 0.15)
CURVE = _core.ReferenceCurve(*rest_to_rest((0, 0, 1), (6, 4, 1.5), 1.5, yaw_rad=0.4))
EXACT, IDEAL = _core.PlantOptions(), _core.ActuatorModel()
NOISY = _core.PlantOptions(
    motor_time_constant_s=0.03,
    linear_drag=(0.05, 0.05, 0.05),
    wind_m_s=(0.3, 0, 0),
    gust_m_s=(0.1, 0.1, 0.1),
    sensor=_core.SensorOptions(position_noise_m=0.003, delay_s=0.02),
)
LAGGING = _core.ActuatorModel(motor_time_constant_s=0.03, delay_s=0.02)
TIMES = ("filter_s", "tick_s", "active_tick_s", "command_s")  # measured
REFUSED, STALE = 1, 2


def start(position=(0, 0, 1), yaw=0.4, velocity=(0, 0, 0)):
    state = np.zeros(12)
    state[:3], state[5], state[6:9] = position, np.tan(yaw / 4), velocity
    return state


def among_ellipsoids(*names, motor_time_constant_s=0.0, ticks=1):
    world = FilterWorld(
        index=INDEX,
        body=BODY,
        gains=GAINS,
        radius_m=0.15,
        dt_s=0.01 * ticks,
        motor_time_constant_s=motor_time_constant_s,
    )
    return [registry.make_filter(name, world, {}).native for name in names if name]


def spec(interface="wrench", model="quadrotor", plant=EXACT, assumed=IDEAL, body=BODY, **fields):
    known = {"model": model, "interface": interface, "gains": GAINS, "plant": plant, "assumed": assumed}
    return _core.VehicleSpec(body, **(known | fields))


def flown(
    vehicle, mission, filters=(), *, state=None, time_s=1.0, trials=1, jobs=1, seed=3, pilot=None, **parts
):
    task = _core.Task(start() if state is None else state, mission, pilot=pilot, max_time_s=time_s)
    simulation = _core.SimulationSpec(vehicle, **parts)
    return _core.simulate(simulation, [task] * trials, list(filters), seed=seed, jobs=jobs)


class Passing:
    """A filter in Python that returns what it gets, and keeps what it saw."""

    def __init__(self, kind, answer=None):
        self.kind, self.answer = kind, answer
        self.seen = []

    def reset(self):
        self.seen = []

    def tick(self, state, nominal):
        self.seen.append(nominal)
        u = nominal[self.kind] if self.answer is None else self.answer
        report = {"status": 0, "u": list(u), "margin": 1.0, "active": -1, "infeasible": False}
        report |= {"thrust_rate": nominal["thrust_rate"], "certified": False}
        return report | {"certified_moving": False, "solve_time_s": None}

    def native(self):
        return _core.PythonFilter(self.kind, self)


class Answering(Passing):
    """A filter in Python whose report has fields replaced."""

    def __init__(self, kind, **fields):
        super().__init__(kind)
        self.fields = fields

    def tick(self, state, nominal):
        return super().tick(state, nominal) | self.fields


# Against the older loop, and numpy.


POINT_FILTERS = [(None, None), (None, "cone-di"), (None, "safer-splat")]
FILTERS = [
    *POINT_FILTERS,
    *((None, name) for name in ("cone-ecbf", "cone-backup", "shield")),
    ("cone-di", "cone-ecbf"),
]
FLOWN = [
    ("quadrotor", "wrench", EXACT, IDEAL, 1, 1),
    ("quadrotor", "wrench", NOISY, LAGGING, 3, 1),
    ("quadrotor", "wrench", EXACT, IDEAL, 2, 2),
    ("double-integrator", "acceleration", EXACT, IDEAL, 1, 1),
]
# The older loop led rotors with lag to a held wrench within a tick; filters of wrenches assume its hold.
# By body rates it let the torques of rotors with lag limit the thrust, so those flights are not compared.
BY_POINTS = (FLOWN[1], FLOWN[3])


@pytest.mark.parametrize(
    ("model", "interface", "plant", "assumed", "filter_ticks", "controller_ticks", "guide", "name"),
    [(*how, *names) for how in FLOWN for names in (POINT_FILTERS if how in BY_POINTS else FILTERS)],
)
def test_flights_among_ellipsoids_are_those_of_the_older_loop(
    model, interface, plant, assumed, filter_ticks, controller_ticks, guide, name
):
    """The values are of the loop among ellipsoids that this one replaced; its states were the same bits."""
    noise = "noisy" if plant is NOISY else "exact"
    key = f"{model} {interface} {noise} {filter_ticks} {controller_ticks} {guide or 'none'} {name or 'none'}"
    old = OLDER[key]
    names = [each for each in (guide, name) if each]
    lag = 0.03 if assumed is LAGGING else 0.0
    (new,) = flown(
        spec(interface, model, plant, assumed),
        _core.Mission.along(CURVE),
        among_ellipsoids(*names, motor_time_constant_s=lag, ticks=filter_ticks),
        state=start(yaw=0.4 if model == "quadrotor" else 0.0),
        time_s=1.5,
        options=_core.FlightOptions(filter_ticks=filter_ticks, controller_ticks=controller_ticks),
    )
    assert (new["end"], len(new["mark"])) == (old["end"], old["ticks"])
    if name:
        assert np.bincount(new["status"][:, -1], minlength=6).tolist() == old["status"]
    tolerance = {"rtol": 1e-9, "atol": 1e-9}
    np.testing.assert_allclose(new["state"].sum(axis=0), old["sum"], **tolerance)
    np.testing.assert_allclose(new["state"][-1], old["last"], **tolerance)
    np.testing.assert_allclose(new["a_command"].sum(axis=0), old["command"], **tolerance)
    np.testing.assert_allclose(new["rotor_thrust"].sum(axis=0), old["thrust"], **tolerance)
    assert new["a_error"].sum() == pytest.approx(old["error"], rel=1e-8, abs=1e-9)


def hull_filter(speed=1.0, dt_s=0.01):
    cover = box_cover([((10, -10, 0), (13, 6, 20)), ((22, 2, 0), (25, 20, 20)), ((8, 12, 4), (30, 15, 9))])
    world = FilterWorld(
        hulls=Hulls.from_cover(cover), radius_m=0.05, speed_m_s=speed, dt_s=dt_s, extent_m=100.0
    )
    return registry.make_filter("polytope-cbf", world, {}).native


@pytest.mark.parametrize("goal", [(3.2, 0.5, 1.0), (2.0, 1.35, 0.6)])
def test_a_single_integrator_flies_as_numpy_steps_it(goal):
    """u = c / 2 (goal - x) at most at the speed limit, filtered, held for a tick: bit by bit."""
    a, native, dt_s = np.array([0.2, -0.3, 0.8]), hull_filter(), 0.01
    stop = 0.01 * float(np.linalg.norm(goal - a))
    task = _core.Task(
        start(a, 0.0),
        _core.Mission.to(goal, gain_per_s=2.0, speed_m_s=1.0),
        max_time_s=30.0,
        stop_distance_m=stop,
    )
    simulation = _core.SimulationSpec(
        spec("velocity", "single-integrator", max_speed_m_s=1.0),
        rules=_core.SimulationRules(plant_steps=1, stuck_speed_m_s=1e-3, stuck_ticks=100),
    )
    (new,) = _core.simulate(simulation, [task], [native])
    x, path, still = a.copy(), [a.copy()], 0
    native.reset()
    while np.sqrt(((x - goal) ** 2).sum()) > stop and still < 100:
        u = 2.0 / 2 * (goal - x)
        speed = np.sqrt(u[0] ** 2 + u[1] ** 2 + u[2] ** 2)
        u = 1.0 / speed * u if speed > 1.0 else u
        report = native.filter(start(x, 0.0).tolist(), [0.0] * 3, velocity=u.tolist())
        x = x + np.array(report["velocity"]) * dt_s
        still = still + 1 if np.linalg.norm(report["velocity"]) < 1e-3 else 0
        path.append(x)
    np.testing.assert_array_equal(path, new["path"])
    assert len(path) > 100
    assert new["end"] == ("stuck" if still else "reached")
    assert (new["status"][:, 0] == 1).any()


# Stepped, as `fly` calls it.


BALLS = (
    ObstacleTable(
        motion="ballistic", radius_m=0.1, distance_m=3.0, azimuth_rad=(-0.8, 0.8), speed_m_s=(4.0, 6.0)
    ),
    ObstacleTable(motion="constant-velocity", position_m=(3.0, 3.0, 1.0), velocity_m_s=(-0.5, -1.0, 0.1)),
)


def among_balls():
    sensor = DetectorTable(kind="mocap", rate_hz=100.0, position_sigma_m=0.002)
    tracker = TrackerTable(confirm_hits=2, confirm_scans=3)
    return moving_spec(BALLS, sensor, tracker, yaw_rate_rad_s=1.0)


def avoiding():
    limits = {"max_speed_m_s": 3.0, "max_acceleration_m_s2": 4.0, "radius_m": 0.15}
    points = {"max_speed_m_s": 12.0, "max_acceleration_m_s2": 6.0, "max_jerk_m_s3": 60.0}
    world = FilterWorld(radius_m=0.15, dt_s=0.01, **points)
    native = _core.moving_filter("dr_acbf", moving_options(world, MovingFilterParameters()))
    return _core.MovingSafety(native, _core.EllipsoidMap(INDEX), **limits)


def listed(names):
    made = {"polytope-cbf": lambda: hull_filter(1.5), "dr-acbf": avoiding}
    return [
        made[name]() if name in made else among_ellipsoids(name, motor_time_constant_s=0.03)[0]
        for name in names
    ]


def as_flown(vehicle, options, mission, filters, log, noise_m):
    """Commands of a stepped flight that is fed with the measurements of a log, and its marks."""
    flight = _core.Flight(vehicle, options, mission, filters)
    size = len(log["tracks"]) // max(1, log["track_start"][-1])
    commands, marks = [], []
    for i, measured in enumerate(log["measured"]):
        a, b = (int(row) * size for row in log["track_start"][i : i + 2])
        sticks = log["sticks"][i]
        flight.observe(
            0.01 * i,
            None if np.isnan(measured).any() else measured,
            tracks=log["tracks"][a:b],
            position_variance=(noise_m**2,) * 3,
            sticks=None if np.isnan(sticks).any() else sticks,
        )
        decision = flight.decide()
        flight.sent()
        commands.append(decision["command"])
        marks.append(decision["is_refused"] + 2 * decision["is_stale"] + 4 * decision["is_limited"])
        np.testing.assert_array_equal(decision["estimate"], log["estimate"][i])
        assert [one["status"] for one in decision["filters"]] == log["status"][i].tolist()
    return np.array(commands), marks


@pytest.mark.parametrize(
    ("interface", "names"),
    [
        ("wrench", ()),
        ("wrench", ("cone-backup",)),
        ("body-rates", ("shield",)),
        ("body-rates", ("dr-acbf", "shield")),
        ("wrench", ("polytope-cbf", "dr-acbf", "cone-backup")),
        ("acceleration", ("cone-di",)),
        ("velocity", ("polytope-cbf",)),
    ],
)
@pytest.mark.parametrize("ticks", [(1, 1), (2, 3)])
def test_logged_measurements_give_the_logged_commands_bit_by_bit(interface, names, ticks):
    options = _core.FlightOptions(
        controller_ticks=ticks[0], filter_ticks=ticks[1], stale_s=0.06, has_losses=True
    )
    vehicle = spec(interface, plant=NOISY, assumed=LAGGING)
    mission, filters = _core.Mission.along(CURVE, speed_m_s=1.5), listed(names)
    (log,) = flown(
        vehicle,
        mission,
        filters,
        time_s=1.2,
        options=options,
        losses=_core.Losses(share=0.2, from_s=0.5, for_s=0.15),
        rules=_core.SimulationRules(ends_when_refused=False),
        moving=among_balls(),
    )
    lost = np.isnan(log["measured"][:, 0])
    assert len(lost) == 120
    assert 0.15 < lost.mean() < 0.6
    assert (log["mark"] & STALE).any()
    assert len(log["tracks"]) > 0
    commands, marks = as_flown(vehicle, options, mission, filters, log, 0.003)
    np.testing.assert_array_equal(commands, log["command"])
    assert marks == log["mark"].tolist()
    assert np.isfinite(log["command"]).all()


def test_a_pilots_sticks_give_the_logged_commands_bit_by_bit():
    racer = VEHICLES["racer7"]
    where = _core.Fence(box=((-20, -20, 1), (20, 20, 30)))
    filters = [
        _core.FenceFilter(_core.Geofence(where, racer_model(racer), {"radius_m": 0.2, "tick_s": 0.01}), None)
    ]
    vehicle = spec("sticks", "racer", body=quadrotor(racer), racer=racer_model(racer))
    options, mission = _core.FlightOptions(), _core.Mission.by_sticks()
    (log,) = flown(
        vehicle,
        mission,
        filters,
        state=start((0, 0, 10), 0.0),
        time_s=1.0,
        pilot=_core.Pilot(kind="aggressive"),
        losses=_core.Losses(radio_from_s=0.3, radio_for_s=0.2),
    )
    assert np.isnan(log["sticks"][:, 0]).sum() == 20
    commands, _ = as_flown(vehicle, options, mission, filters, log, 0.0)
    np.testing.assert_array_equal(commands, log["command"])


def test_results_do_not_depend_on_jobs():
    def run(jobs):
        return flown(
            spec("body-rates", plant=NOISY, assumed=LAGGING),
            _core.Mission.along(CURVE),
            listed(("dr-acbf", "shield")),
            trials=5,
            time_s=0.6,
            jobs=jobs,
            losses=_core.Losses(share=0.1),
            options=_core.FlightOptions(has_losses=True),
            moving=among_balls(),
        )

    for one, many in zip(run(1), run(3), strict=True):
        for key in one.keys() - set(TIMES):
            if isinstance(one[key], np.ndarray):
                np.testing.assert_array_equal(one[key], many[key], err_msg=key)
            else:
                assert one[key] == many[key]


# Losses.


def outage(for_s, interface="wrench", *, stale_s=0.2, filter_ticks=1, **parts):
    return flown(
        spec(interface),
        _core.Mission.along(CURVE),
        time_s=0.8,
        options=_core.FlightOptions(filter_ticks=filter_ticks, stale_s=stale_s, has_losses=True),
        losses=_core.Losses(from_s=0.3, for_s=for_s),
        **parts,
    )[0]


@pytest.mark.parametrize("interface", ["wrench", "body-rates", "velocity", "acceleration"])
def test_an_outage_that_is_short_enough_is_flown_on_the_prediction(interface):
    log, whole = outage(0.2, interface), outage(0.0, interface)
    assert np.isnan(log["measured"][:, 0]).sum() == 20
    assert not log["mark"].any()
    # The rate loop is predicted as if the torque were held, the vehicle's own cascade as a point.
    tolerance = {"wrench": 1e-9, "body-rates": 1e-4}.get(interface, 0.1)
    np.testing.assert_allclose(log["state"][:, :3], whole["state"][:, :3], rtol=0, atol=tolerance)


def test_an_outage_that_is_too_long_is_refused_and_called_stale():
    log = outage(0.4)
    assert log["end"] == "refused"
    assert len(log["mark"]) == 51  # the last measurement is of 0.29 s; the first tick beyond 0.2 s is 0.5 s
    assert log["mark"][-1] == REFUSED | STALE
    assert not log["mark"][:-1].any()
    log = outage(0.4, rules=_core.SimulationRules(ends_when_refused=False))
    stale = (log["mark"] & STALE) > 0
    assert np.flatnonzero(stale).tolist() == list(range(50, 70))
    np.testing.assert_allclose(log["command"][stale, 3], MASS * GRAVITY, rtol=1e-12)
    assert not log["command"][stale, 4:7].any()


def test_a_command_after_an_outage_is_held_as_long_as_every_other():
    """The first one is in tick 50, or 51: counted from tick 0 it would be held for one, or three."""
    for length, first in ((0.2, 50), (0.21, 51)):
        passing = Passing("wrench")
        log = outage(
            length,
            filters=[passing.native()],
            rules=_core.SimulationRules(ends_when_refused=False),
            filter_ticks=3,
            stale_s=0.1,
        )
        assert np.flatnonzero((log["mark"] & STALE) > 0)[-1] == first - 1
        held = log["command"][first : first + 27, 3:7].reshape(9, 3, 4)
        np.testing.assert_array_equal(held, np.repeat(held[:, :1], 3, axis=1))
        assert (np.diff(held[:, 0, 0]) != 0).all()


def test_a_vehicle_by_body_rates_holds_its_attitude_and_its_weight_without_a_state():
    log = outage(0.4, "body-rates", rules=_core.SimulationRules(ends_when_refused=False))
    stale = (log["mark"] & STALE) > 0
    assert stale.sum() == 20
    np.testing.assert_allclose(log["command"][stale, 3], MASS * GRAVITY, rtol=1e-12)
    assert not log["command"][stale, :3].any()
    assert np.abs(log["state"][-1, 9:]).max() < 1.0


def test_a_geofence_flies_on_without_navigation_for_as_long_as_it_takes():
    racer = VEHICLES["racer7"]
    where = _core.Fence(box=((-20, -20, 1), (20, 20, 30)))
    fence = _core.Geofence(where, racer_model(racer), {"radius_m": 0.2, "tick_s": 0.01})
    (log,) = flown(
        spec("sticks", "racer", body=quadrotor(racer), racer=racer_model(racer)),
        _core.Mission.by_sticks(),
        [_core.FenceFilter(fence, None)],
        state=start((0, 0, 10), 0.0),
        time_s=2.0,
        pilot=_core.Pilot(kind="sticks"),
        options=_core.FlightOptions(stale_s=1e3, has_losses=True),
        losses=_core.Losses(from_s=0.5, for_s=1e9),
        rules=_core.SimulationRules(ends_when_refused=False),
    )
    assert log["end"] == "ended"
    assert np.isfinite(log["command"]).all()
    lost = np.isnan(log["measured"][:, 0])
    assert lost.sum() == 150
    assert (log["status"][-100:, 0] != 0).all()  # it does not let the pilot fly


def test_measurements_are_lost_as_often_as_they_should_be():
    logs = flown(
        spec(),
        _core.Mission.along(CURVE),
        trials=20,
        time_s=1.0,
        losses=_core.Losses(share=0.3),
        options=_core.FlightOptions(has_losses=True),
    )
    lost = np.concatenate([np.isnan(log["measured"][1:, 0]) for log in logs])
    assert stats.binomtest(int(lost.sum()), len(lost), 0.3).pvalue > 1e-3
    again = lost[1:][lost[:-1]]
    assert stats.binomtest(int(again.sum()), len(again), 0.3).pvalue > 1e-3  # each on its own
    assert not any(np.isnan(log["measured"][0]).any() for log in logs)


# The cascade.


def test_a_velocity_of_a_quadrotor_is_held_as_numpy_says():
    """T = m (k_v (u - v) + g e3) . R e3 at tilted states."""
    rng = np.random.default_rng(2)
    vehicle = spec("wrench", velocity_gain_per_s=4.0)
    for _ in range(20):
        state = np.concatenate([rng.normal(size=3), *(0.05 * rng.normal(size=(3, 3)))])
        u = rng.uniform(-0.3, 0.3, 3)
        inner = Passing("wrench")  # sees the wrench before the rotors' limits
        filters = [Passing("velocity", u).native(), inner.native()]
        flight = _core.Flight(vehicle, _core.FlightOptions(), _core.Mission.to((9, 9, 9)), filters)
        flight.observe(0.0, state)
        flight.decide()
        thrust = inner.seen[0]["wrench"][0]
        force = MASS * (4.0 * (u - state[6:9]) + GRAVITY * E3)
        assert thrust == pytest.approx(force @ (body_to_inertial(state[3:6]) @ E3), rel=1e-9)


@pytest.mark.parametrize("interface", ["wrench", "body-rates"])
def test_a_quadrotor_behind_a_filter_of_velocities_that_passes_follows_its_reference(interface):
    """The set-point leads by a / k_v, and the attitude loop has jerk and snap; another velocity is held."""
    vehicle, seen = spec(interface), Passing("velocity")
    mission = _core.Mission.along(CURVE, gain_per_s=2.0)
    (log,) = flown(vehicle, mission, [seen.native()], time_s=6.0)
    reference = CURVE.at(0.01 * np.arange(len(log["state"])))
    assert np.linalg.norm(log["state"][:, :3] - reference[:, :3], axis=1).max() < 0.01
    assert np.linalg.norm(reference[:, 6:9], axis=1).max() > 0.3
    u = [nominal["velocity"] for nominal in seen.seen]
    lead = reference[:, 3:6] + reference[:, 6:9] / 2.0 + reference[:, :3] - log["state"][:, :3]
    np.testing.assert_allclose(u, lead[: len(u)], atol=1e-9)


def test_a_velocity_of_a_double_integrator_is_held_as_numpy_says():
    vehicle = spec("velocity", "double-integrator", velocity_gain_per_s=3.0, max_acceleration_m_s2=2.0)
    (log,) = flown(vehicle, _core.Mission.along(CURVE, gain_per_s=2.0), state=start(yaw=0.0))
    p, v = np.array([0.0, 0, 1]), np.zeros(3)
    for i in range(len(log["mark"])):
        target = CURVE.at(np.array([0.01 * i]))[0]
        u = target[3:6] + (target[:3] - p)
        np.testing.assert_allclose(log["command"][i, :3], u, rtol=0, atol=1e-12)
        a = 3.0 * (u - v)
        a *= min(1.0, 2.0 / np.linalg.norm(a)) if np.linalg.norm(a) > 0 else 1.0
        p, v = p + 0.01 * v + 0.5e-4 * a, v + 0.01 * a
    np.testing.assert_allclose(log["state"][-1, :3], p, rtol=0, atol=1e-9)


@pytest.mark.parametrize("ticks", [(1, 1), (2, 1), (3, 1), (1, 3), (2, 3)])
def test_filters_that_pass_everything_change_nothing(ticks):
    """Each filter gets a command of its own level in every tick, whatever is held."""
    options = _core.FlightOptions(controller_ticks=ticks[0], filter_ticks=ticks[1])
    mission = _core.Mission.along(CURVE, speed_m_s=2.0)
    one, two, three = Passing("velocity"), Passing("acceleration"), Passing("wrench")
    (alone,) = flown(spec(), mission, [one.native()], time_s=0.5, options=options)
    (log,) = flown(spec(), mission, [one.native(), two.native(), three.native()], time_s=0.5, options=options)
    assert all(nominal["wrench"][0] > 0.3 * MASS * GRAVITY for nominal in three.seen)
    assert all(np.any(nominal["acceleration"]) for nominal in two.seen)
    if ticks == (1, 1):
        np.testing.assert_array_equal(alone["command"], log["command"])
    assert np.linalg.norm(alone["state"][-1, :3] - log["state"][-1, :3]) < 0.02


def test_sticks_of_the_pilot_never_pass_between_two_ticks_of_the_filter():
    racer = VEHICLES["racer7"]
    vehicle = spec("sticks", "racer", body=quadrotor(racer), racer=racer_model(racer))
    hover = racer_model(racer).throttle_for(9.81)
    calm = Passing("sticks", [hover, 0.0, 0.0, 0.0])
    (log,) = flown(
        vehicle,
        _core.Mission.by_sticks(),
        [calm.native()],
        state=start((0, 0, 10), 0.0),
        pilot=_core.Pilot(kind="aggressive"),
        options=_core.FlightOptions(controller_ticks=2, filter_ticks=2),
    )
    assert np.abs(log["sticks"][:, 1:]).max() > 0.1
    assert np.ptp(log["command"][:, 7:], axis=0).max() == 0


def test_a_racer_by_sticks_flies_to_a_goal_without_filters():
    racer = VEHICLES["racer7"]
    vehicle = spec(
        "sticks", "racer", body=quadrotor(racer), gains=tracking_gains(racer), racer=racer_model(racer)
    )
    curve = _core.ReferenceCurve(*rest_to_rest((0, 0, 5), (4, 0, 5), 2.0))
    (log,) = flown(
        vehicle, _core.Mission.along(curve), state=start((0, 0, 5), 0.0), time_s=curve.duration_s + 2
    )
    assert log["end"] == "reached"
    assert np.abs(log["state"][:, 2] - 5).max() < 0.5


# Refused commands.


@pytest.mark.parametrize("kind", ["velocity", "acceleration", "wrench"])
def test_a_refused_command_never_flies(kind):
    mad = [1e3] * (4 if kind == "wrench" else 3)
    refusing = Answering(kind, status=4, u=mad).native()
    vehicle = spec("body-rates")
    options = {"state": start(velocity=(0.5, 0, 0)), "time_s": 0.3}
    (ended,) = flown(vehicle, _core.Mission.along(CURVE), [refusing], **options)
    assert ended["end"] == "refused"
    assert len(ended["mark"]) == 1
    rules = _core.SimulationRules(ends_when_refused=False)
    (log,) = flown(vehicle, _core.Mission.along(CURVE), [refusing], rules=rules, **options)
    assert (log["mark"] & REFUSED).all()
    assert np.linalg.norm(log["state"][:, 6:9], axis=1).max() < 0.6  # nothing speeds up
    assert log["command"][:, 3] == pytest.approx(MASS * GRAVITY, rel=0.2)
    held = Answering(kind, status=4, u=mad).native()
    (log,) = flown(
        vehicle,
        _core.Mission.along(CURVE),
        [held],
        rules=rules,
        options=_core.FlightOptions(controller_ticks=2, filter_ticks=2),
        **options,
    )
    assert (log["mark"] & REFUSED).all()  # a tick that holds a refused command is refused too


@pytest.mark.parametrize("ticks", [1, 4])
def test_braking_in_place_of_a_refused_command_does_not_reverse(ticks):
    (log,) = flown(
        spec("acceleration", "double-integrator"),
        _core.Mission.along(CURVE),
        [Answering("acceleration", status=4).native()],
        state=start(yaw=0.0, velocity=(0.5, 0, 0)),
        rules=_core.SimulationRules(ends_when_refused=False),
        options=_core.FlightOptions(controller_ticks=ticks, filter_ticks=ticks),
    )
    assert log["state"][:, 6].min() > -1e-9
    assert abs(log["state"][-1, 6]) < 1e-3


def test_a_filter_that_refuses_before_another_one_does_not_end_the_flight():
    refusing, passing = Answering("acceleration", status=4), Passing("wrench")
    (log,) = flown(spec(), _core.Mission.along(CURVE), [refusing.native(), passing.native()], time_s=0.2)
    assert not log["mark"].any()
    assert (log["status"][:, 0] == 4).all()
    assert (log["status"][:, 1] == 0).all()


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"u": [np.nan, 0.0, 0.0]}, "not finite"),
        ({"u": [0.0, np.inf, 0.0]}, "not finite"),
        ({"u": [0.0, 0.0]}, "another kind"),
        ({"u": [0.0] * 4}, "another kind"),
    ],
)
def test_a_filter_in_python_that_returns_no_command_ends_the_run(fields, message):
    with pytest.raises(ValueError, match=message):
        flown(spec(), _core.Mission.along(CURVE), [Answering("acceleration", **fields).native()])


def test_an_error_of_a_filter_in_python_is_raised_as_it_is():
    class Failing(Passing):
        def tick(self, state, nominal):
            raise ZeroDivisionError("by zero")

    with pytest.raises(ZeroDivisionError, match="by zero"):
        flown(spec(), _core.Mission.along(CURVE), [Failing("acceleration").native()])


def test_what_makes_no_list_of_filters_is_refused():
    curve = _core.Mission.along(CURVE)
    with pytest.raises(ValueError, match="in the order of their commands"):
        flown(spec(), curve, [Passing("wrench").native(), Passing("acceleration").native()])
    with pytest.raises(ValueError, match="beyond what the vehicle takes"):
        flown(spec("velocity"), curve, [Passing("wrench").native()])
    with pytest.raises(ValueError, match="is None"):
        flown(spec(), curve, [None])
