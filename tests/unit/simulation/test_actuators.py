"""Known lag of rotors and known age of measurements: rollouts, prediction and flights among ellipsoids."""

import numpy as np
import pytest

from alula import _core
from alula.stages.filtering import registry
from alula.stages.filtering.protocol import FilterWorld
from alula.stages.planning.rest_to_rest import rest_to_rest
from support.flights.reference_flights import BODY, GAINS, along, vehicle_of
from support.models.wrench_flight import (
    RADIUS,
    Scene,
    admissible_start,
    attitude_controlled,
    empty_scene,
    random_scene,
    wall_scene,
)

LAG, DELAY = 0.03, 0.02


def hovering_rotors():
    return np.full(4, BODY.hover_thrust / 4)


def plant(lag=LAG, delay=DELAY, **options):
    return _core.PlantOptions(motor_time_constant_s=lag, sensor=_core.SensorOptions(delay_s=delay), **options)


def random_commands(rng, ticks):
    return [BODY.allocation @ rng.uniform(-1, 5, 4) for _ in range(ticks)]  # some beyond the limits


@pytest.mark.parametrize("lag", [0.0, 0.004, 0.03, 0.2])
@pytest.mark.parametrize("delay", [0.0, 0.004, 0.02, 0.037, 0.0007, 0.0125])
def test_the_prediction_is_the_plant(lag, delay):
    """Also with a delay that ends between two steps, their positions on a cubic, their rates on a line."""
    between = 1000 * delay % 1 > 1e-9
    rng = np.random.default_rng(3)
    flown = _core.Plant(BODY, plant(lag, delay))
    x = np.array([1.0, 2, 3, 0.05, -0.02, 0.1, 1.5, -1, 0.3, 0.4, -0.2, 0.1])
    flown.reset(x)
    predictor = _core.StatePredictor(
        BODY, _core.ActuatorModel(motor_time_constant_s=lag, delay_s=delay), tick_s=0.01
    )
    for tick, u in enumerate(random_commands(rng, 40)):
        now = np.array(predictor.now(np.array(flown.measured), age_s=0.01 * tick))
        now[3:6] = _core.shadowed(np.ascontiguousarray(now[None, 3:6]))[0]
        true = np.array(flown.state)
        true[3:6] = _core.shadowed(np.ascontiguousarray(true[None, 3:6]))[0]
        np.testing.assert_allclose(now[:9], true[:9], rtol=0, atol=1e-4 if between else 1e-7)
        np.testing.assert_allclose(now[9:], true[9:], rtol=0, atol=1e-2 if between else 1e-7)
        if tick:
            np.testing.assert_allclose(BODY.allocation @ predictor.rotors, flown.wrench, rtol=0, atol=1e-12)
        predictor.fly(u)
        for _ in range(10):
            flown.step(0.001, u)
        flown.switch_shadow()


def test_led_rotors_are_where_they_should_be_a_tick_later():
    rng = np.random.default_rng(4)
    predictor = _core.StatePredictor(BODY, _core.ActuatorModel(motor_time_constant_s=LAG), tick_s=0.01)
    for _ in range(20):
        desired = rng.uniform(1.0, 1.3, 4)
        command = np.array(predictor.lead(BODY.allocation @ desired))
        assert BODY.admissible(command[None], tolerance_n=1e-9)[0]
        predictor.fly(command)
        np.testing.assert_allclose(predictor.rotors, desired, rtol=0, atol=1e-9)
    at_once = _core.StatePredictor(BODY, _core.ActuatorModel(delay_s=0.02), tick_s=0.01)
    u = rng.normal(size=4)
    np.testing.assert_array_equal(at_once.lead(u), u)


@pytest.mark.parametrize("ticks", [1, 2, 5])
def test_a_command_that_is_held_brings_the_rotors_to_its_wrench_at_the_end(ticks):
    """As a shield rolls it out: one command for all ticks of the hold, by the law f' = (goal - f) / lag."""
    curve = _core.ReferenceCurve(*rest_to_rest((0, 0, 1), (2, 1, 1.5), 1.5))
    held, wanted = 0.01 * ticks, []

    class Passing:
        kind = "wrench"

        def reset(self):
            wanted.clear()

        def tick(self, state, nominal):
            wanted.append(nominal["wrench"])
            report = {"status": 0, "u": list(nominal["wrench"]), "margin": 1.0, "active": -1}
            report |= {"infeasible": False, "thrust_rate": nominal["thrust_rate"], "certified": False}
            return report | {"certified_moving": False, "solve_time_s": None}

    model = _core.ActuatorModel(motor_time_constant_s=LAG)
    vehicle = _core.VehicleSpec(BODY, gains=GAINS, plant=plant(LAG, 0.0), assumed=model)
    start = np.array([0.0, 0, 1] + 9 * [0.0])
    task = _core.Task(start, _core.Mission.along(curve), max_time_s=0.6)
    simulation = _core.SimulationSpec(vehicle, options=_core.FlightOptions(filter_ticks=ticks))
    (log,) = _core.simulate(simulation, [task], [_core.PythonFilter("wrench", Passing())], seed=1)
    commands = log["rotor_thrust"].reshape(-1, ticks, 4)
    assert len(commands) == len(wanted) == round(0.6 / held)
    np.testing.assert_array_equal(commands, np.repeat(commands[:, :1], ticks, axis=1))
    rotors = hovering_rotors()
    for goal, wrench in zip(commands[:, 0], wanted, strict=True):
        rotors = goal + np.exp(-held / LAG) * (rotors - goal)
        np.testing.assert_allclose(BODY.allocation @ rotors, wrench, rtol=0, atol=1e-9)


def test_without_delay_what_is_measured_comes_back_bit_by_bit():
    predictor = _core.StatePredictor(BODY, _core.ActuatorModel(motor_time_constant_s=0.1), tick_s=0.01)
    x = np.random.default_rng(0).normal(size=12)
    predictor.fly(np.array([9.0, 0, 0.1, 0]))
    np.testing.assert_array_equal(predictor.now(x), x)


def test_a_command_that_is_no_number_leaves_the_rotors_with_the_last_one():
    model = _core.ActuatorModel(motor_time_constant_s=0.05, delay_s=0.03)
    one, two = (_core.StatePredictor(BODY, model, tick_s=0.01) for _ in range(2))
    u = np.array([7.0, 0.05, 0, 0])
    for predictor, second in ((one, u), (two, np.full(4, np.nan))):
        predictor.fly(u)
        predictor.fly(second)
    assert one.rotors == two.rotors
    one.reset()
    np.testing.assert_allclose(one.rotors, hovering_rotors())


@pytest.mark.parametrize(
    "model", [{"delay_s": -1.0}, {"motor_time_constant_s": float("nan")}, {"delay_s": 11.0}]
)
def test_models_without_meaning_are_refused(model):
    with pytest.raises(ValueError):
        _core.ActuatorModel(**model)


def lagging_shield(scene, lag=LAG, kind="brake", **options):
    return _core.Shield(
        _core.BackupPolicy(BODY, kind), scene.index, _core.ShieldOptions(motor_time_constant_s=lag, **options)
    )


@pytest.mark.parametrize("lag", [0.002, 0.01, 0.03, 0.1])
def test_a_tick_of_a_lagging_rollout_is_what_the_plant_flies(lag):
    rng, shield = np.random.default_rng(1), lagging_shield(empty_scene(), lag)
    for _ in range(20):
        x = 0.3 * rng.normal(size=12)
        x[9:] *= 10
        before, u = (BODY.allocation @ rng.uniform(0, 4.25, 4) for _ in range(2))
        flown = _core.Plant(BODY, plant(lag, 0.0))
        flown.reset(x)
        for _ in range(5):
            flown.step(0.001, before)
        rotors = np.linalg.solve(BODY.allocation, flown.wrench)
        shield.see(rotors.tolist())
        after = shield.after(np.array(flown.state), tuple(u))
        desired = np.linalg.solve(BODY.allocation, u)
        led = BODY.allocation @ (rotors + (desired - rotors) / (1 - np.exp(-0.01 / lag)))
        command = BODY.limited(led[None])[0]
        for _ in range(10):
            flown.step(0.001, command)
        flown.switch_shadow()
        np.testing.assert_allclose(after, flown.state, rtol=0, atol=1e-3)
        np.testing.assert_allclose(
            after[[0, 1, 2, 6, 7, 8]], flown.state[[0, 1, 2, 6, 7, 8]], rtol=0, atol=1e-5
        )


def test_rotors_do_not_matter_without_lag():
    rng, scene = np.random.default_rng(5), wall_scene()
    policy = _core.BackupPolicy(BODY, "brake")
    for kind in (_core.ConeEcbf, _core.ConeBackup):
        for x0 in (0.0, 1.5, 2.5):
            x = np.array([x0, 0, 0, 0.1, 0, 0, 2.5, 0, 0, 0, 0, 0.0])
            answers = [
                kind(policy, scene.index).filter(x, (0, 0, 0), wrench=(6, 0, 0.1, 0), thrust=5.0, **more)
                for more in ({}, {"rotors": rng.uniform(0, 4, 4).tolist()})
            ]
            assert answers[0] == answers[1]


def test_rotors_on_their_way_count_with_lag():
    """Level and at rest, but with a torque in the rotors, is no rest; nor is it safe near the wall."""
    shield = lagging_shield(wall_scene(), lag=0.1)
    x = np.zeros(12)
    assert shield.certify(x)["time_s"] == 0
    shield.see([0.2, 4.0, 0.2, 4.0])
    assert shield.certify(x)["time_s"] > 0.1
    x[0] = 3 - 0.02 - RADIUS - 0.025
    assert not shield.certify(x)["safe"]
    shield.see(hovering_rotors().tolist())
    assert shield.certify(x)["safe"]


def test_a_flight_does_not_begin_with_a_manoeuvre_that_drifts_out_of_half_the_margin():
    """The gentle one keeps the whole margin here; the urgent one half of it at its rest, and less later."""
    rng, lag = np.random.default_rng(1000399), 0.005
    scene = Scene(rng.uniform(-3, 3, (100, 3)), rng.uniform(0.001, 0.5, (100, 3)), rng.normal(size=(100, 4)))
    shield = lagging_shield(scene, lag)
    x, direction = admissible_start(rng, shield), rng.normal(size=3)
    options = _core.ShieldOptions(motor_time_constant_s=lag)
    flown = _core.ConeBackup(
        _core.BackupPolicy(BODY, "brake"), scene.index, _core.ConeBackupOptions(shield_options=options)
    )
    predictor = _core.StatePredictor(BODY, _core.ActuatorModel(motor_time_constant_s=lag), tick_s=0.01)
    for tick in range(100):
        desired = (14 if tick // 25 % 2 else -14) * direction / np.linalg.norm(direction)
        rotors = list(predictor.rotors)
        wrench = tuple(attitude_controlled(BODY, x, desired))
        report = flown.filter(x, (0, 0, 0), wrench=wrench, thrust=BODY.hover_thrust, rotors=rotors)
        assert report["certified"]
        shield.see(rotors)
        x = np.array(shield.after(x, tuple(report["wrench"])))
        predictor.fly(np.array(predictor.lead(np.array(report["wrench"]))))


def test_a_policy_too_quick_for_the_tick_is_refused_with_lag_too():
    for lag in (0.005, 0.03, 0.2):
        lagging_shield(empty_scene(), lag=lag)
        with pytest.raises(ValueError, match="do not settle"):
            lagging_shield(empty_scene(), lag=lag, tick_s=0.15, margin_m=0.1)


def world_of(scene, lag):
    return FilterWorld(
        index=scene.index, body=BODY, gains=GAINS, radius_m=RADIUS, dt_s=0.01, motor_time_constant_s=lag
    )


def flights(scene, name, references, *, options, assumed, **parameters):
    lag = assumed.motor_time_constant_s
    chosen = registry.make_filter(name, world_of(scene, lag), parameters)
    return along(references, [chosen], vehicle_of(plant=options, assumed=assumed), max_time_s=3.0)


def through(rng, count, speed):
    """References through the wall at x = 3, here and there."""
    ends = [
        ((rng.uniform(-1, 1), *rng.uniform(-2, 2, 2)), (rng.uniform(4, 6), *rng.uniform(-2, 2, 2)))
        for _ in range(count)
    ]
    return [_core.ReferenceCurve(*rest_to_rest(np.array(a), np.array(b), speed)) for a, b in ends]


@pytest.mark.every(2)
@pytest.mark.parametrize(("name", "policy"), [("cone-ecbf", "brake"), ("cone-backup", "cone-escape")])
@pytest.mark.parametrize(("lag", "delay"), [(0.03, 0.02), (0.06, 0.0), (0.0, 0.05)])
def test_with_the_lag_and_delay_it_counts_with_a_flight_keeps_clear(name, policy, lag, delay):
    rng = np.random.default_rng(11)
    model = _core.ActuatorModel(motor_time_constant_s=lag, delay_s=delay)
    for scene in (wall_scene(), random_scene(rng, 120)):
        references = through(rng, 3, rng.uniform(2, 4))
        references = [
            r for r in references if scene.clearance(np.tile(r.at(np.zeros(1))[:, :3], (2, 1))) > 0.1
        ]
        for log in flights(scene, name, references, options=plant(lag, delay), assumed=model, policy=policy):
            assert ((log["flags"] & 4) != 0).all()  # certified
            assert scene.clearance(log["path"]) >= 0.01
            assert np.linalg.norm(log["path"][-1] - log["path"][0]) > 0.1


def test_a_model_of_nothing_changes_no_bit():
    scene, rng = wall_scene(), np.random.default_rng(2)
    references = through(rng, 2, 3.0)
    bare = flights(
        scene, "cone-ecbf", references, options=_core.PlantOptions(), assumed=_core.ActuatorModel()
    )
    delayed = flights(
        scene, "cone-ecbf", references, options=_core.PlantOptions(), assumed=_core.ActuatorModel(delay_s=0.0)
    )
    for a, b in zip(bare, delayed, strict=True):
        np.testing.assert_array_equal(a["path"], b["path"])
        np.testing.assert_array_equal(a["command"], b["command"])
