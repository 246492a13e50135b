"""Every key of plant, estimation and rules is in the model of the shield, or named by the guarantee."""

from pathlib import Path

import msgspec
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from alula.schemas.errors import UsageError
from alula.schemas.scenarios.defaults import completed, vehicle_of
from alula.schemas.scenarios.scenario import Scenario, decoded
from alula.schemas.scenarios.vehicle import FASTBRIDGE, AssumedTable, DisturbanceTable
from alula.stages.simulation.left_out import COARSE, DIFFERENCES, INTERFACE, left_out
from alula.stages.simulation.prepare import prepare
from support.flights.world_runs import set_value
from support.models.quadrotor_model import derivative, fastbridge
from support.scenes.small_scenes import box_cover

BODY = fastbridge()
WALL = box_cover([((15, -20, 0), (18, 20, 30))])

REFUSED = "refused for a quadrotor"
# Why no value of a key, or of the keys below a table, makes a difference.
NO_DIFFERENCE = {
    "vehicle.type": "body, rotors and rate loop of the vehicle are those of the model",
    "vehicle.file": "body, rotors and rate loop of the vehicle are those of the model",
    "vehicle.radius_m": "the filter keeps the same radius",
    "vehicle.velocity_gain_per_s": "changes the nominal command, which no certificate depends on",
    **dict.fromkeys(
        (
            *("vehicle.max_speed_m_s", "vehicle.max_acceleration_m_s2"),
            *("vehicle.max_jerk_m_s3", "vehicle.actuation_delay_s"),
        ),
        REFUSED,
    ),
    **dict.fromkeys(
        ("vehicle.autopilot", "vehicle.velocity_lag_s"),
        "acts by velocities and accelerations only, where the whole cascade is named",
    ),
    "vehicle.disturbance.gust_time_s": "acts with gust_m_s only, which is named",
    "vehicle.disturbance.sag_time_s": "acts with sag_share only, which is named",
    "vehicle.assumed.motor_time_constant_s": "named beside the true one where they differ",
    "vehicle.assumed.delay_s": "named beside the true one where they differ",
    "estimation.preset": "gives values of other keys, which are looked at",
    "estimation.noise_time_s": "acts with noise only, which is named",
    "estimation.lost_for_s": "acts with lost_from_s only, which is named",
    "estimation.stale_s": "acts with lost measurements only, which are named",
    "rules.dt_s": "the model holds a command for dt_s * filter_ticks",
    "rules.filter_ticks": "the model holds a command for dt_s * filter_ticks",
    "rules.controller_ticks": "changes the nominal command, which no certificate depends on",
    **dict.fromkeys(
        ("rules.trials", "rules.seed", "rules.max_time_s", "rules.logged", "rules.log_rate_hz"),
        "chooses what is flown and kept",
    ),
    **dict.fromkeys(
        ("estimation.sensor", "estimation.tracker"),
        "the other keys act on tracks of moving obstacles, on which no static certificate depends",
    ),
}

# A value beside the model's, and an interface with which it has an effect; what is needed besides.
BESIDE = {
    "vehicle.interface": ("velocity", "velocity", {}),
    "vehicle.mass_scale": (1.1, "wrench", {}),
    "vehicle.thrust_scale": (0.9, "wrench", {}),
    "vehicle.rate_gain_scale": (1.2, "body-rates", {}),
    "vehicle.disturbance.motor_time_constant_s": (0.03, "wrench", {}),
    "vehicle.disturbance.linear_drag_n_s_m": ((0.1, 0.0, 0.0), "wrench", {}),
    "vehicle.disturbance.quadratic_drag_n_s2_m2": ((0.0, 0.0, 0.1), "wrench", {}),
    "vehicle.disturbance.wind_m_s": (
        (0.0, 1.0, 0.0),
        "wrench",
        {"vehicle.disturbance.linear_drag_n_s_m": (0.1, 0.1, 0.1)},
    ),
    "vehicle.disturbance.gust_m_s": (
        (0.0, 0.0, 1.0),
        "wrench",
        {"vehicle.disturbance.linear_drag_n_s_m": (0.1, 0.1, 0.1)},
    ),
    "vehicle.disturbance.sag_share": (0.1, "sticks", {"vehicle.type": "racer7"}),
    "estimation.position_noise_m": (0.01, "wrench", {}),
    "estimation.velocity_noise_m_s": (0.01, "wrench", {}),
    "estimation.attitude_noise_rad": (0.01, "wrench", {}),
    "estimation.rate_noise_rad_s": (0.01, "wrench", {}),
    "estimation.sensor.own_position_sigma_m": (0.01, "wrench", {}),
    "estimation.sensor.own_velocity_sigma_m_s": (0.01, "wrench", {}),
    "estimation.delay_s": (0.03, "wrench", {}),
    "estimation.lost_share": (0.1, "wrench", {}),
    "estimation.lost_from_s": (0.0, "wrench", {}),
    "estimation.disturbance_time_s": (0.1, "body-rates", {}),
    "rules.plant_steps": (1, "body-rates", {}),
}
# Values of the other keys that could change the motion, and those of the same kind together.
WITHIN = {
    "rules.dt_s, filter_ticks": {"rules.dt_s": 0.0125, "rules.filter_ticks": 3},
    "rules.dt_s": {"rules.dt_s": 0.004},
    "rules.controller_ticks": {"rules.controller_ticks": 4},
    "rules.plant_steps": {"rules.plant_steps": 40},
    "assumed.motor_time_constant_s": {
        "vehicle.disturbance.motor_time_constant_s": 0.04,
        "vehicle.assumed.motor_time_constant_s": 0.04,
        "rules.filter_ticks": 3,
    },
    "assumed.delay_s": {"estimation.delay_s": 0.0235, "vehicle.assumed.delay_s": 0.0235},
    "both": {
        "estimation.delay_s": 0.0235,
        "vehicle.assumed.delay_s": 0.0235,
        "vehicle.disturbance.motor_time_constant_s": 0.04,
        "vehicle.assumed.motor_time_constant_s": 0.04,
        "rules.filter_ticks": 3,
    },
    "vehicle.velocity_gain_per_s": {"vehicle.velocity_gain_per_s": 1.0},
    "estimation": {"estimation.noise_time_s": 1.0, "estimation.stale_s": 0.01},
    "gusts": {"vehicle.disturbance.gust_time_s": 0.1, "vehicle.disturbance.sag_time_s": 0.1},
    "sensor": {"estimation.sensor.rate_hz": 5.0, "estimation.tracker.confirm_hits": 4},
    "vehicle": {"vehicle.radius_m": 0.2},
}


def scenario(keys, interface="wrench"):
    tree = {
        "vehicle": {"type": "fastbridge"},
        "world": {"cover": "x"},
        "mission": {
            "kind": "goal",
            "start_m": (0.0, 0.0, 1.0),
            "goal_m": (1.0, 0.4, 1.3),
            "speed_m_s": 3.0,
            "beyond_map_m": 3.0,
        },
        "safety": {"filters": ["shield"] if interface in ("wrench", "body-rates") else []},
        "rules": {"max_time_s": 0.6},
    }
    for key, value in {"vehicle.interface": interface, **keys}.items():
        set_value(tree, key, value)
    made = decoded(tree, "test")
    return completed(made, vehicle_of(made, Path()))


def leaves(table, prefix):
    """Paths of all keys of a table and of the tables in it."""
    for field in msgspec.structs.fields(table):
        if isinstance(field.type, type) and issubclass(field.type, msgspec.Struct):
            yield from leaves(field.type, f"{prefix}.{field.name}")
        else:
            yield f"{prefix}.{field.name}"


def all_keys():
    types = {field.name: field.type for field in msgspec.structs.fields(Scenario)}
    return {key for name in ("vehicle", "estimation", "rules") for key in leaves(types[name], name)}


def reasons_of(key):
    """Entries of NO_DIFFERENCE for a key or for a table that it is in."""
    return [name for name in NO_DIFFERENCE if key == name or key.startswith(f"{name}.")]


def test_every_key_has_one_verdict_and_every_verdict_a_key():
    keys, named = all_keys(), {key for each in DIFFERENCES for key in each.keys} | {COARSE, INTERFACE}
    assert {"vehicle.disturbance.wind_m_s", "estimation.tracker.confirm_hits", "rules.dt_s"} <= keys
    assert named <= keys
    for key in keys:
        by_table = [name for name in reasons_of(key) if name != key]
        assert (key in named) + (key in NO_DIFFERENCE) + bool(by_table and key not in named) == 1, key
    for name in NO_DIFFERENCE:
        assert any(name in reasons_of(key) for key in keys), name


def test_every_key_of_a_vehicle_file_is_one_of_the_scenario():
    keys = {key.rpartition(".")[2] for key in all_keys()}
    assert {field.name for field in msgspec.structs.fields(DisturbanceTable)} <= keys
    assert {field.name for field in msgspec.structs.fields(AssumedTable)} <= keys


def test_every_key_in_which_a_plant_can_differ_is_named_with_its_value():
    assert BESIDE.keys() == {key for each in DIFFERENCES for key in each.keys} | {COARSE, INTERFACE}
    for interface in ("wrench", "body-rates"):
        assert left_out(scenario({}, interface)) == []
    for key, (value, interface, others) in BESIDE.items():
        found = "; ".join(left_out(scenario({key: value} | others, interface)))
        name = key.rpartition(".")[2]
        values = (
            " ".join(f"{item:g}" for item in (value if isinstance(value, tuple) else (value,)))
            if key != "vehicle.interface"
            else ""
        )
        assert (f"{name} {values}" if values else "own cascade") in found, key


def test_assumptions_that_the_plant_does_not_meet_are_named_too():
    for key in ("motor_time_constant_s", "delay_s"):
        assert f"({key} 0, assumed 0.02)" in left_out(scenario({f"vehicle.assumed.{key}": 0.02}))[0]


def moved(x, rotors, wrench, rates, seconds, *, lag_s, tau_s):
    """State and rotors after a command, by f' = (f_c - f) / lag and a rate loop of 1 kHz."""

    def change(_, y, goal):
        made, moves = (goal, np.zeros(4)) if lag_s == 0 else (y[12:], (goal - y[12:]) / lag_s)
        return np.concatenate([derivative(y[:12], BODY.allocation @ made), moves])

    def integrated(x, rotors, goal, seconds):
        begin = np.concatenate([x, rotors])
        end = solve_ivp(change, (0, seconds), begin, args=(goal,), rtol=1e-6, atol=1e-8).y[:, -1]
        return end[:12], end[12:]

    if rates is None:
        return integrated(x, rotors, np.linalg.solve(BODY.allocation, wrench), seconds)
    inertia, steps = np.array(BODY.inertia), round(seconds / 1e-3)
    for _ in range(steps):
        omega = x[9:]
        torque = np.cross(omega, inertia * omega) + inertia * (rates - omega) / tau_s
        goal = np.linalg.solve(BODY.allocation, np.array([wrench[0], *torque]))
        x, rotors = integrated(x, rotors, goal, seconds / steps)
    return x, rotors


def off_model(keys, interface):
    """Largest errors of what the filter sees and of the modelled ticks, in (p, sigma, v) and in rates."""
    made = scenario(keys | {"rules.max_time_s": 0.12}, interface)
    (log,) = prepare(made, FASTBRIDGE, cover=WALL, jobs=1).fly(0, 1, jobs=1)
    assert np.abs(log["state"][:, 9:]).max() > 3
    how = {
        "lag_s": made.vehicle.assumed.motor_time_constant_s,
        "tau_s": FASTBRIDGE.rates.time_constant_s,
    }
    rotors, off = np.full(4, BODY.hover_thrust / 4), [log["estimate"] - log["state"][:-1]]
    for state, after, command in zip(log["state"][:-1], log["state"][1:], log["command"], strict=True):
        rates = command[:3] if interface == "body-rates" else None
        end, rotors = moved(state, rotors, command[3:7], rates, made.rules.dt_s, **how)
        off.append((end - after)[None])
    worst = np.abs(np.concatenate(off)).max(axis=0)
    return made, worst[:9].max(), worst[9:].max()


@pytest.mark.parametrize("interface", ["wrench", "body-rates"])
@pytest.mark.parametrize("name", WITHIN)
def test_no_other_key_takes_the_plant_away_from_the_model(name, interface):
    """What the filter sees is the true state, and each tick moves it as the model of the interface says."""
    made, off, off_rates = off_model(WITHIN[name], interface)
    assert left_out(made) == []
    assert off < 2e-4
    assert off_rates < 0.03  # of a loop that is faster than 1 kHz


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("rules.plant_steps", 1),
        ("vehicle.rate_gain_scale", 1.1),
        ("vehicle.mass_scale", 1.1),
        ("vehicle.disturbance.motor_time_constant_s", 0.03),
        ("estimation.delay_s", 0.03),
    ],
)
def test_a_key_that_is_named_does(key, value):
    made, _, off_rates = off_model({key: value}, "body-rates")
    assert left_out(made)
    assert off_rates > 0.1


def test_keys_that_are_called_refused_are():
    refused = [key for key, reason in NO_DIFFERENCE.items() if reason == REFUSED]
    assert len(refused) == 4
    for key in refused:
        with pytest.raises(UsageError, match=key):
            prepare(scenario({key: 30.0 if "jerk" in key else 5.0}), FASTBRIDGE, cover=WALL, jobs=1)
