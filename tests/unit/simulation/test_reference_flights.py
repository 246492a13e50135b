"""Flights along references against independent loops, and with filters of other packages."""

import numpy as np
import pytest

from alula import _core
from alula.schemas.errors import InputError
from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.stages.filtering import registry
from alula.stages.filtering.ellipsoid_filters import ELLIPSOID_FILTERS
from alula.stages.filtering.protocol import FilterResult, FilterStatus, FilterWorld
from alula.stages.planning.rest_to_rest import rest_to_rest
from support.flights.foreign_filters import Broken, Holding, Limiting, Passing, Wrapped
from support.flights.reference_flights import BODY, GAINS, along, vehicle_of
from support.models.quadrotor_model import derivative, rk4
from support.scenes.fabricate import make_scene

FIELD = make_scene(60, low=(0, 0, 0), high=(6, 4, 3))
NATIVE = list(ELLIPSOID_FILTERS)
CERTIFIED, LIMITED = 4, 4  # bits of `flags`, and of `mark`


def curve(start=(0, 0, 1), goal=(3, 1, 1.5), speed=1.5, yaw=0.4):
    return _core.ReferenceCurve(*rest_to_rest(start, goal, speed, yaw_rad=yaw))


def one(safety_filter=None, reference=None, model="quadrotor", **options):
    fields = {key: options.pop(key) for key in ("interface", "plant") if key in options}
    (flown,) = along(
        [reference or curve()],
        [] if safety_filter is None else [safety_filter],
        vehicle_of(model=model, **fields),
        has_yaw=model == "quadrotor",
        **options,
    )
    return flown


def test_a_double_integrator_flies_as_a_loop_in_numpy():
    reference = curve()
    flown = one(reference=reference, model="double-integrator")
    p, v = np.array([0, 0, 1.0]), np.zeros(3)
    for i in range(len(flown["mark"])):
        row = reference.at(np.array([0.01 * i]))[0]
        a = row[6:9] - 3 * (p - row[:3]) - 2 * (v - row[3:6])
        np.testing.assert_allclose(flown["a_command"][i], a, rtol=0, atol=1e-9)
        p, v = p + 0.01 * v + 0.5 * 0.01**2 * a, v + 0.01 * a
        np.testing.assert_allclose(flown["state"][i + 1], [*p, 0, 0, 0, *v, 0, 0, 0], rtol=0, atol=1e-9)
    assert flown["end"] == "reached"
    assert flown["a_error"].max() == 0
    assert len(flown["path"]) == 10 * len(flown["mark"]) + 1
    np.testing.assert_array_equal(flown["path"][::10], flown["state"][:, :3])


def test_a_quadrotor_flies_as_a_loop_in_numpy():
    reference = curve(speed=2.5)
    flown = one(reference=reference)
    inertia = np.array(FASTBRIDGE.body.inertia_kg_m2)
    x = np.array([0, 0, 1, 0, 0, np.tan(0.1), 0, 0, 0, 0, 0, 0.0])
    for i in range(80):
        row = reference.at(np.array([0.01 * i]))
        u = _core.track(BODY, GAINS, x[None], row)["wrench"]
        assert BODY.admissible(u)[0]
        np.testing.assert_allclose(flown["command"][i, 3:7], u[0], rtol=1e-7, atol=1e-9)
        for _ in range(10):
            x = rk4(
                lambda _, y, u=u: derivative(y, u[0], mass=FASTBRIDGE.body.mass_kg, inertia=inertia), x, 1e-3
            )
        np.testing.assert_allclose(flown["state"][i + 1], x, rtol=0, atol=1e-8)
    assert flown["end"] == "reached"


def test_at_rest_it_hovers():
    flown = one(reference=curve(goal=(1e-3, 0, 1), speed=1e-3))
    weight = FASTBRIDGE.body.mass_kg * 9.81
    np.testing.assert_allclose(flown["command"][:, 3], weight, rtol=1e-4)
    np.testing.assert_allclose(flown["rotor_thrust"], weight / 4, rtol=1e-2)
    assert flown["a_error"].max() < 0.01


def test_the_realisation_error_is_that_of_the_attitude_loop_and_grows_with_speed():
    errors = [one(reference=curve(speed=speed))["a_error"].max() for speed in (1, 2, 4)]
    assert 0 < errors[0] < errors[1] < errors[2]


def test_the_commanded_acceleration_of_a_wrench_is_held_as_that_of_an_acceleration_is():
    """The axis turns before the next command, so a filter of wrenches has a realisation error too."""

    class Wrench(Passing):
        kind = "wrench"

    flown = one(Wrench(), reference=curve(speed=4))
    assert not (flown["mark"] & LIMITED).any()

    def acceleration(x, thrust):
        inertia = np.array(FASTBRIDGE.body.inertia_kg_m2)
        wrench = np.array([thrust, 0, 0, 0])
        return derivative(x, wrench, mass=FASTBRIDGE.body.mass_kg, inertia=inertia)[6:9]

    ends = []
    for now, later, u, command in zip(
        flown["state"], flown["state"][1:], flown["command"][:, 3:7], flown["a_command"], strict=False
    ):
        np.testing.assert_allclose(command, acceleration(now, u[0]), rtol=0, atol=1e-9)
        ends.append(np.linalg.norm(acceleration(later, u[0]) - command))
    assert (flown["a_error"] >= np.array(ends) - 1e-9).all()
    assert flown["a_error"].max() == pytest.approx(max(ends), rel=0.05)
    assert max(ends) > 0.1


@pytest.mark.parametrize("kind", ["acceleration", "wrench"])
@pytest.mark.parametrize("interface", ["wrench", "body-rates"])
def test_controller_and_filter_hold_their_output_for_their_ticks(kind, interface):
    mine = Passing()
    mine.kind = kind
    calls = []
    mine_of = type(mine).__call__

    class Counted(Passing):
        def __call__(self, state, nominal):
            calls.append(nominal.acceleration)
            return mine_of(self, state, nominal)

    counted = Counted()
    counted.kind = kind
    rules = {"dt_s": 1 / 150, "controller_ticks": 3, "filter_ticks": 5, "max_time_s": 1.0}
    flown = one(counted, **rules, interface=interface)
    assert len(calls) == 30
    assert len(flown["mark"]) == 150
    # The controller realises an acceleration, so a new one waits for the controller's next tick.
    command_ticks = 5 if kind == "wrench" else 3
    for held, ticks in ((flown["nominal"], 3), (flown["u_nominal"], 3), (flown["a_command"], command_ticks)):
        for begin in range(0, 150, ticks):
            assert (held[begin : begin + ticks] == held[begin]).all()
    assert not (flown["nominal"][0] == flown["nominal"][3]).all()
    np.testing.assert_array_equal(flown["nominal"][0::15], calls[0::3])
    np.testing.assert_array_equal(
        flown["nominal"][9::15], calls[2::3]
    )  # the newest command of the controller


@pytest.mark.parametrize("name", NATIVE)
def test_a_native_filter_is_called_as_often_as_a_python_one(name):
    index = _core.EllipsoidIndex(FIELD["mean"], FIELD["scale"], FIELD["quat_wxyz"], sigma=1.0, radius=0.15)
    world = FilterWorld(index=index, body=BODY, gains=GAINS, radius_m=0.15, dt_s=0.02)
    rules = {"dt_s": 0.01, "filter_ticks": 2, "max_time_s": 1.0}
    reference = curve((0.2, 0.2, 1.5), (5.8, 3.8, 1.5), speed=3)
    native = registry.make_filter(name, world, {} if name == "shield" else {"prune_ticks": 3})
    flown = one(native, reference, **rules)
    np.testing.assert_array_equal(flown["state"], one(Wrapped(native), reference, **rules)["state"])
    assert (flown["margin"][0::2] == flown["margin"][1::2]).all()


def test_ticks_that_hold_nothing_are_refused():
    for bad in ({"controller_ticks": 0}, {"filter_ticks": 0}):
        with pytest.raises(ValueError, match="positive"):
            one(**bad)


@pytest.mark.parametrize("kind", ["acceleration", "wrench"])
@pytest.mark.parametrize("interface", ["wrench", "body-rates"])
def test_a_python_filter_that_passes_everything_flies_as_none_does(kind, interface):
    mine = Passing()
    mine.kind = kind
    flown, native = one(mine, interface=interface), one(interface=interface)
    np.testing.assert_array_equal(flown["state"], native["state"])
    np.testing.assert_array_equal(flown["command"], native["command"])
    assert mine.flights == 1
    assert flown["end"] == native["end"] == "reached"
    assert (flown["flags"] & CERTIFIED).all()
    assert (flown["margin"] == 1).all()
    assert native["margin"].shape == (len(native["mark"]), 0)


def test_body_rates_are_followed_by_a_lagging_loop():
    direct, rates = one(), one(interface="body-rates")
    np.testing.assert_allclose(rates["state"][-1, :3], direct["state"][-1, :3], atol=0.05)
    assert not np.array_equal(direct["state"], rates["state"])


@pytest.mark.parametrize(("dt", "steps"), [(0.01, 10), (0.05, 50), (0.0025, 3), (0.0004, 1)])
def test_the_plant_moves_in_steps_of_at_most_1_ms_by_default(dt, steps):
    flown = one(dt_s=dt, max_time_s=0.1)
    assert len(flown["path"]) == len(flown["mark"]) * steps + 1
    coarse = one(dt_s=dt, plant_steps=1, max_time_s=0.1)
    assert len(coarse["path"]) == len(coarse["mark"]) + 1


def test_a_wrench_for_a_double_integrator_is_refused():
    mine = Passing()
    mine.kind = "wrench"
    with pytest.raises(ValueError, match="beyond what the vehicle takes"):
        one(mine, model="double-integrator")


def test_flights_end_as_they_should():
    assert one(Holding())["end"] == "stuck"
    assert one(Holding(), max_time_s=0.5)["end"] == "timeout"
    late = one(Limiting(None, {"stop_x": 1.0}))
    assert late["end"] == "refused"
    assert late["status"][-1, -1] == FilterStatus.REFUSED
    assert late["state"][-2, 0] > 1 >= late["state"][-3, 0]
    outside = one(lower=(-1, -1, 0), upper=(2, 2, 2))
    assert outside["end"] == "refused"
    assert 2 < outside["state"][-1, 0] < 2.1
    with pytest.raises(InputError, match="no acceleration, at"):
        one(Broken())


def test_what_the_rotors_cannot_do_is_counted_and_limited():
    class Mad(Passing):
        kind = "wrench"

        def __call__(self, state, nominal):
            return FilterResult(np.array([100.0, 1, 0, 0]), FilterStatus.FILTERED)

    flown = one(Mad(), max_time_s=0.2)
    assert (flown["mark"] & LIMITED).all()
    assert (flown["rotor_thrust"] <= 4.25 + 1e-9).all()
    assert (flown["rotor_thrust"] >= -1e-9).all()
    assert flown["a_error"].max() > 100


def test_a_delayed_noisy_vehicle_flies_the_same_for_the_same_seed():
    sensor = _core.SensorOptions(position_noise_m=0.01, velocity_noise_m_s=0.02)
    vehicle = vehicle_of(plant=_core.PlantOptions(sensor=sensor))
    first, again = (along([curve()] * 3, (), vehicle, seed=5, jobs=jobs) for jobs in (1, 3))
    for a, b in zip(first, again, strict=True):
        np.testing.assert_array_equal(a["state"], b["state"])
    assert not np.array_equal(first[0]["state"], first[1]["state"])
    (third,) = along([curve()], (), vehicle, seed=5, first_trial=2)
    np.testing.assert_array_equal(third["state"], first[2]["state"])
    (other,) = along([curve()], (), vehicle, seed=6)
    assert not np.array_equal(other["state"], first[0]["state"])


@pytest.mark.parametrize("name", NATIVE)
def test_every_filter_flies_the_same_from_python(name):
    index = _core.EllipsoidIndex(FIELD["mean"], FIELD["scale"], FIELD["quat_wxyz"], sigma=1.0, radius=0.15)
    world = FilterWorld(index=index, body=BODY, gains=GAINS, radius_m=0.15, dt_s=0.01)
    made = registry.make_filter(name, world, {})
    rules = {"max_time_s": 1.5}
    reference = curve((0.2, 0.2, 1.5), (5.8, 3.8, 1.5), speed=3)
    native, python = one(made, reference, **rules), one(Wrapped(made), reference, **rules)
    np.testing.assert_array_equal(native["state"], python["state"])
    np.testing.assert_array_equal(native["status"], python["status"])


class Turning:
    """Turns about the vertical and notes the attitudes that it sees."""

    kind = "wrench"

    def __init__(self):
        self.seen = []

    def reset(self):
        self.seen.clear()

    def __call__(self, state, nominal):
        self.seen.append(state.sigma)
        torque = 0.01 if state.omega[2] < 6 else 0.0
        return FilterResult(u=np.array([BODY.mass * 9.81, 0, 0, torque]), status=FilterStatus.FILTERED)


def test_a_filter_sees_the_attitude_that_the_tick_begins_with():
    """Includes the tick after half a turn, where the attitude parameters switch."""
    turning = Turning()
    flown = one(turning, max_time_s=3.0)
    seen = np.array(turning.seen)
    np.testing.assert_array_equal(seen, flown["state"][:-1, 3:6])
    assert np.linalg.norm(seen, axis=1).max() <= 1
    assert np.ptp(np.sign(seen[:, 2])) == 2
