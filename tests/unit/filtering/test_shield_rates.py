"""The shield and the predictor for a vehicle that is commanded by thrust and body rates."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from alula import _core
from alula.schemas.scenarios.vehicle import read_vehicle
from alula.stages.filtering.protocol import FilterWorld
from alula.stages.filtering.registry import make_filter
from alula.stages.planning.rest_to_rest import rest_to_rest
from alula.stages.vehicles.bodies import quadrotor, tracking_gains
from support.flights.reference_flights import along, vehicle_of
from support.models import quadrotor_model as model
from support.models.wrench_flight import Scene, empty_scene, moving, random_scene, wall_scene
from support.paths import VEHICLES

CRAZYFLIE = read_vehicle(VEHICLES / "crazyflie21.toml")
BODY, GAINS = quadrotor(CRAZYFLIE), tracking_gains(CRAZYFLIE)
INERTIA = np.array(BODY.inertia)
MAX_RATE = CRAZYFLIE.rates.max_rad_s
TICK, PERIOD = 0.01, 0.001
COPTER = (0.054, 0.057, 0.3)  # a yaw that is slower than roll and pitch [s]


def axes(constant):
    """Time constants about x, y, z, of one number or of three."""
    return tuple(np.broadcast_to(constant, 3).tolist())


def shield_of(scene, lag=0.0, constant=0.02, kind="brake", **options):
    own = {"motor_time_constant_s": lag, "rate_time_constant_s": axes(constant), "max_rate_rad_s": MAX_RATE}
    policy = _core.BackupPolicy(BODY, kind)
    return _core.Shield(policy, scene.index, _core.ShieldOptions(**own, **options))


def random_wrench(rng):
    return BODY.allocation @ rng.uniform(0.02, 0.1125, 4)


def commanded(x, u, rotors, lag, constant):
    """Rates and thrust that a flight commands for a wrench."""
    leads = [max(each, TICK) for each in axes(constant)]
    led = [
        _core.body_rates(BODY, x[None], np.array([u]), dt_s=each, max_rate_rad_s=MAX_RATE)[0]
        for each in leads
    ]
    rates = np.diagonal(led)
    if not lag:
        return rates, u[0]
    now = (BODY.allocation @ rotors)[0]
    led = now + (u[0] - now) / (1 - np.exp(-TICK / lag))
    return rates, np.clip(led, 0, BODY.max_thrust)


def loop_torque(omega, rates, constant):
    return model.cross(omega, INERTIA * omega) + INERTIA * (rates - omega) / constant


def at_random(rng, lag, fast=3.0):
    """A state and the thrusts of rotors on their way."""
    x = np.concatenate([np.zeros(3), 0.1 * rng.normal(size=3), rng.normal(size=3), fast * rng.normal(size=3)])
    return x, rng.uniform(0.03, 0.1, 4) if lag else np.full(4, BODY.hover_thrust / 4)


@pytest.mark.every(4)
@pytest.mark.parametrize("lag", [0.0, 0.03, 0.05])
@pytest.mark.parametrize("constant", [0.02, 0.05, COPTER])
def test_a_tick_is_that_of_the_model_integrated_by_another_solver(lag, constant):
    """Of a loop without a period: the shield's differs by half a period of the angular acceleration."""
    rng, shield = np.random.default_rng(1), shield_of(empty_scene(), lag, constant)
    for _ in range(10):
        x, rotors = at_random(rng, lag)
        u = random_wrench(rng)
        rates, thrust = commanded(x, u, rotors, lag, constant)

        def derivative(_, y, rates=rates, thrust=thrust):
            state, f = y[:12], y[12:]
            made = BODY.allocation @ f
            spin = (made[1:] - model.cross(state[9:], INERTIA * state[9:])) / INERTIA
            sensed = state[9:] - PERIOD / 2 * spin if lag else state[9:]
            own = np.array(constant) - (0 if lag else PERIOD / 2)
            goal = BODY.limited(np.array([[thrust, *loop_torque(sensed, rates, own)]]))[0]
            if not lag:
                made = goal
            still = (np.linalg.solve(BODY.allocation, goal) - f) / lag if lag else np.zeros(4)
            return np.concatenate(
                [model.derivative(state, made, mass=BODY.mass, inertia=INERTIA, gravity=BODY.gravity), still]
            )

        y = solve_ivp(derivative, (0, TICK), [*x, *rotors], rtol=1e-8, atol=1e-10, max_step=1e-3).y[:12, -1]
        shield.see(rotors.tolist())
        np.testing.assert_allclose(shield.after(x, tuple(u)), y, rtol=0, atol=2e-3)
        np.testing.assert_allclose(shield.after(x, tuple(u))[6:9], y[6:9], rtol=0, atol=1e-4)


def ticks_of_the_plant(plant, u, rotors, lag, constant):
    """A tick of thrust and rates, with a rate loop at 1 kHz; the commanded thrust and rates."""
    x = np.array(plant.state)
    rates, thrust = commanded(x, u, rotors, lag, constant)
    for _ in range(round(TICK / PERIOD)):
        torque = loop_torque(np.array(plant.state)[9:], rates, constant)
        plant.step(PERIOD, BODY.limited(np.array([[thrust, *torque]]))[0])
    plant.switch_shadow()
    return thrust, rates


@pytest.mark.parametrize("lag", [0.0, 0.03, 0.05])
@pytest.mark.parametrize("constant", [0.02, COPTER])
def test_a_tick_is_what_the_plant_flies(lag, constant):
    rng, shield = np.random.default_rng(2), shield_of(empty_scene(), lag, constant)
    plant = _core.Plant(BODY, _core.PlantOptions(motor_time_constant_s=lag))
    for _ in range(20):
        x, _ = at_random(rng, lag)
        plant.reset(x)
        for _ in range(20):
            plant.step(0.001, random_wrench(rng))
        x, rotors = np.array(plant.state), np.linalg.solve(BODY.allocation, plant.wrench)
        u = BODY.limited(random_wrench(rng)[None])[0]
        shield.see(rotors.tolist())
        after = shield.after(x, tuple(u))
        ticks_of_the_plant(plant, u, rotors, lag, constant)
        np.testing.assert_allclose(after[:9], plant.state[:9], rtol=0, atol=2e-4)
        np.testing.assert_allclose(after[9:], plant.state[9:], rtol=0, atol=0.02)


@pytest.mark.parametrize("lag", [0.0, 0.03])
@pytest.mark.parametrize("delay", [0.0, 0.02, 0.034])
@pytest.mark.parametrize("constant", [0.02, COPTER])
def test_the_prediction_is_the_plant_with_its_rate_loop(lag, delay, constant):
    rng = np.random.default_rng(3)
    options = _core.PlantOptions(motor_time_constant_s=lag, sensor=_core.SensorOptions(delay_s=delay))
    plant = _core.Plant(BODY, options)
    plant.reset(moving((1, -0.5, 0.2)))
    assumed = _core.ActuatorModel(
        motor_time_constant_s=lag, delay_s=delay, rate_time_constant_s=axes(constant)
    )
    predictor = _core.StatePredictor(BODY, assumed, tick_s=TICK)
    for tick in range(30):
        now = np.array(predictor.now(np.array(plant.measured), age_s=TICK * tick))
        now[3:6] = _core.shadowed(np.ascontiguousarray(now[None, 3:6]))[0]
        np.testing.assert_allclose(now, plant.state, rtol=0, atol=1e-6)
        if lag and tick:
            np.testing.assert_allclose(BODY.allocation @ predictor.rotors, plant.wrench, rtol=0, atol=1e-7)
        u = random_wrench(rng)
        thrust, rates = ticks_of_the_plant(plant, u, np.array(predictor.rotors), lag, constant)
        predictor.fly(np.array([thrust, 0, 0, 0]), rates.tolist(), now)


def test_a_rate_loop_needs_rates_and_a_state():
    predictor = _core.StatePredictor(BODY, _core.ActuatorModel(rate_time_constant_s=axes(0.02)), tick_s=TICK)
    with pytest.raises(ValueError, match="rates and the present state"):
        predictor.fly(np.array([0.28, 0, 0, 0]))
    for bad in (axes(-1.0), (0.02, 0.02, -1.0), (0.0, 0.02, 0.02), (0.02, 0.02, 0.0)):
        with pytest.raises(ValueError, match="rate loop"):
            _core.ActuatorModel(rate_time_constant_s=bad)


def fly_rates(plant, body, thrust, rates, constant, tick=TICK):
    """A tick of a thrust and body rates on a plant with a rate loop of 1 kHz."""
    inertia = np.array(body.inertia)
    for _ in range(round(tick / PERIOD)):
        omega = np.array(plant.state)[9:]
        torque = model.cross(omega, inertia * omega) + inertia * (rates - omega) / constant
        plant.step(PERIOD, body.limited(np.array([[thrust, *torque]]))[0])
    plant.switch_shadow()


@pytest.mark.parametrize("lag", [0.0, 0.05])
@pytest.mark.parametrize("kind", ["hover", "brake"])
def test_what_counts_as_rest_stays_within_half_the_margin(lag, kind):
    """Flown on the plant, from states near rest, with any heading for `brake`."""
    body = model.fastbridge() if kind == "hover" else BODY
    policy = _core.BackupPolicy(body, kind)
    options = _core.ShieldOptions(motor_time_constant_s=lag, rate_time_constant_s=axes(0.02))
    shield, rng, rests = _core.Shield(policy, empty_scene().index, options), np.random.default_rng(4), 0
    plant = _core.Plant(body, _core.PlantOptions(motor_time_constant_s=lag))
    for _ in range(300):
        yaw = rng.uniform(-3, 3) if kind == "brake" else 0.0
        x = np.array([0, 0, 0, 0, 0, np.tan(yaw / 4), *0.04 * rng.normal(size=3), *0.07 * rng.normal(size=3)])
        x[3:5] += 0.004 * rng.normal(size=2)
        x[6:] *= 0.1 if kind == "hover" else 1  # it stops more slowly
        x[3:5] *= 0.1 if kind == "hover" else 1
        plant.reset(x)
        shield.see(None)
        if shield.certify(x)["time_s"] > 0:
            continue
        rests += 1
        predictor = _core.StatePredictor(
            body, _core.ActuatorModel(motor_time_constant_s=lag, rate_time_constant_s=axes(0.02)), tick_s=TICK
        )
        for _ in range(60):
            x = np.array(plant.state)
            u = np.array(policy(x))
            rates = _core.body_rates(body, x[None], u[None], dt_s=0.02, max_rate_rad_s=MAX_RATE)[0]
            fly_rates(plant, body, predictor.lead(u)[0], rates, 0.02)
            predictor.fly(np.array([predictor.lead(u)[0], 0, 0, 0]), rates.tolist(), x)
            assert np.linalg.norm(np.array(plant.state)[:3]) < 0.01
        if rests == 8:
            break
    assert rests > 3


@pytest.mark.parametrize("lag", [0.02, 0.067])
def test_what_counts_as_rest_with_rotors_on_their_way_stays_within_the_margin(lag):
    """With a tick much shorter than the lag: the command leads by up to 34 times what the rotors lack."""
    body, tick, constant, margin = model.fastbridge(), 0.002, 0.0229, 0.02
    policy, rng, rests = _core.BackupPolicy(body, "brake"), np.random.default_rng(0), 0
    own = {"motor_time_constant_s": lag, "rate_time_constant_s": axes(constant)}
    shield = _core.Shield(
        policy,
        empty_scene().index,
        _core.ShieldOptions(tick_s=tick, margin_m=margin, rest_drift_m=0.008, **own),
    )
    for _ in range(300):
        plant = _core.Plant(body, _core.PlantOptions(motor_time_constant_s=lag))
        plant.reset(np.array([0, 0, 0, *0.002 * rng.normal(size=3), *0.02 * rng.normal(size=3), 0, 0, 0]))
        predictor = _core.StatePredictor(body, _core.ActuatorModel(**own), tick_s=tick)

        def fly(u, rates, plant=plant, predictor=predictor):
            thrust, x = predictor.lead(u)[0], np.array(plant.state)
            fly_rates(plant, body, thrust, rates, constant, tick)
            predictor.fly(np.array([thrust, 0, 0, 0]), rates.tolist(), x)

        u, rates = np.array([body.hover_thrust, 0, 0, 0]), rng.uniform(-4, 4, 3)
        for _ in range(rng.integers(2, 8)):
            fly(u, rates)
        start = np.array(plant.state)
        shield.see(predictor.rotors)
        if shield.certify(start)["time_s"] > 0:
            continue
        rests += 1
        for _ in range(500):
            x = np.array(plant.state)
            u = np.array(policy(x))
            rates = _core.body_rates(body, x[None], u[None], dt_s=constant, max_rate_rad_s=MAX_RATE)[0]
            fly(u, rates)
            assert np.linalg.norm(np.array(plant.state)[:3] - start[:3]) < margin
        if rests == 6:
            break
    assert rests == 6


def test_gains_too_quick_for_the_rate_loop_are_refused():
    with pytest.raises(ValueError, match="do not settle"):
        shield_of(empty_scene(), 0.2, 0.2, tick_s=0.05, margin_m=0.1)
    for bad in ({"rate_time_constant_s": axes(-0.1)}, {"max_rate_rad_s": (1, 0, 1)}):
        with pytest.raises(ValueError, match="rate"):
            _core.Shield(_core.BackupPolicy(BODY, "brake"), empty_scene().index, _core.ShieldOptions(**bad))


def world_of(scene, lag, constant=0.02):
    return FilterWorld(
        index=scene.index,
        body=BODY,
        gains=GAINS,
        radius_m=scene.radius,
        dt_s=TICK,
        motor_time_constant_s=lag,
        rate_time_constant_s=axes(constant),
        max_rate_rad_s=MAX_RATE,
    )


@pytest.mark.every(5)
@pytest.mark.parametrize("name", ["cone-backup", "cone-ecbf", "shield"])
@pytest.mark.parametrize(
    ("lag", "delay", "constant"),
    [(0.0, 0.0, 0.02), (0.03, 0.02, 0.02), (0.05, 0.02, 0.02), (0.0, 0.0, (0.02, 0.03, 0.1))],
)
def test_flights_by_rates_are_certified_in_all_ticks(name, lag, delay, constant):
    rng = np.random.default_rng(11)
    assumed = _core.ActuatorModel(motor_time_constant_s=lag, delay_s=delay)
    options = _core.PlantOptions(motor_time_constant_s=lag, sensor=_core.SensorOptions(delay_s=delay))
    vehicle = vehicle_of(
        BODY,
        gains=GAINS,
        plant=options,
        interface="body-rates",
        max_rate_rad_s=MAX_RATE,
        rate_time_constant_s=axes(constant),
        assumed=assumed,
    )
    ticks = 0
    for scene in (wall_scene(), random_scene(rng, 120)):
        made = make_filter(name, world_of(scene, lag, constant), {})
        ends = [(rng.uniform(-3, 1, 3) * [1, 0.5, 0.5], (5.0, *rng.uniform(-1, 1, 2))) for _ in range(3)]
        references = [
            _core.ReferenceCurve(*rest_to_rest(np.array(a), np.array(b), 3.0))
            for a, b in ends
            if scene.clearance(np.tile(a, (2, 1))) > 0.1
        ]
        for log in along(references, [made], vehicle, max_time_s=3.0):
            assert ((log["flags"] & 4) != 0).all()
            assert scene.clearance(log["path"]) >= 0.008
            ticks += len(log["flags"])
    assert ticks > 300


def test_a_thin_obstacle_between_ticks_is_seen():
    """A needle across the path at 12 m/s, 12 cm from tick to tick."""
    for offset in np.linspace(0, 0.12, 9):
        needle = Scene([[1 + offset, 0, 0]], [[1e-3, 3.0, 1e-3]], [[1, 0, 0, 0]], radius=0.01)
        assert not shield_of(needle, 0.03).certify(moving((12, 0, 0)))["safe"]


def test_a_filter_is_built_for_the_rate_loop_of_its_world():
    made = make_filter("cone-backup", world_of(empty_scene(), 0.03), {})
    options = made.native.options.shield_options
    assert options.rate_time_constant_s == [0.02, 0.02, 0.02]
    assert options.max_rate_rad_s == list(MAX_RATE)
