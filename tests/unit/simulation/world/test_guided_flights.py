"""Flights with a guide, which changes the nominal command before the safety filter."""

import numpy as np
import pytest

from alula import _core
from alula.schemas.configs.simulate import SimulateConfig
from alula.schemas.errors import UsageError
from alula.schemas.vehicle import FASTBRIDGE
from alula.stages.filtering import registry
from alula.stages.filtering.ellipsoid_filters import ELLIPSOID_FILTERS, GUIDES, parameters_of
from alula.stages.filtering.protocol import FilterWorld
from alula.stages.planning.rest_to_rest import rest_to_rest
from alula.stages.simulation.ellipsoids.closed_loop import fly
from alula.stages.simulation.ellipsoids.simulate import simulate_splat
from alula.stages.vehicles.bodies import quadrotor, tracking_gains
from support.fabricate import make_scene
from support.foreign_filters import Passing

BODY, GAINS = quadrotor(FASTBRIDGE), tracking_gains(FASTBRIDGE, 1.0)
FIELD = make_scene(60, low=(0, 0, 0), high=(6, 4, 3))
WORLD = FilterWorld(  # the field, and two ellipsoids in the way of the reference
    index=_core.EllipsoidIndex(
        np.vstack([FIELD["mean"], np.float32([[2.0, 1.4, 1.6], [4.0, 2.6, 1.4]])]),
        np.vstack([FIELD["scale"], np.float32([[0.3, 0.2, 0.4], [0.2, 0.3, 0.3]])]),
        np.vstack([FIELD["quat_wxyz"], np.float32([[1, 0, 0, 0], [0.8, 0, 0, 0.6]])]),
        sigma=1.0,
        radius=0.15,
    ),
    body=BODY,
    gains=GAINS,
    radius_m=0.15,
    dt_s=0.01,
)
REFERENCE = _core.ReferenceCurve(*rest_to_rest((0.2, 0.2, 1.5), (5.8, 3.8, 1.5), 2.0, yaw_rad=0.6))
RULES = _core.FlightRules(max_time_s=3.0)


def vehicle(plant):
    return _core.FlightVehicle(BODY, GAINS, _core.PlantOptions(), plant=plant)


def filter_of(name, **parameters):
    return registry.make_filter(name, WORLD, parameters)


@pytest.mark.parametrize("plant", ["quadrotor", "double-integrator"])
@pytest.mark.parametrize("name", GUIDES)
def test_the_nominal_is_what_realises_the_guide_s_acceleration(plant, name):
    guide, bent = filter_of(name), 0
    trial = _core.FlightTrial(vehicle(plant), RULES, REFERENCE, guide=guide.native)
    for i in range(250):
        p, sigma, v, omega = trial.state()[:4]
        x, row = np.concatenate([p, sigma, v, omega]), REFERENCE.at(np.array([0.01 * i]))
        if plant == "quadrotor":
            asked = _core.track(BODY, GAINS, x[None], row)
            acceleration, wrench = asked["acceleration"][0], asked["wrench"][0]
        else:
            acceleration = _core.track_point(GAINS, x[None], row)[0]
        report = guide.native.filter(x.tolist(), acceleration.tolist())
        found, found_wrench = trial.nominal()[:2]
        if report["status"] == 0:
            np.testing.assert_allclose(found, acceleration, rtol=0, atol=1e-9)
        else:
            bent += not np.allclose(found, acceleration)
            np.testing.assert_allclose(found, report["acceleration"], rtol=0, atol=1e-7)
            if plant == "quadrotor":
                wrench = _core.realise(BODY, GAINS, x[None], row, np.array([report["acceleration"]]))[0]
        if plant == "quadrotor":
            np.testing.assert_allclose(found_wrench, wrench, rtol=0, atol=1e-7)
        if trial.advance(found_wrench if plant == "quadrotor" else found, status=0, margin=np.inf):
            break
    assert bent > 3


@pytest.mark.parametrize("plant", ["quadrotor", "double-integrator"])
def test_a_python_filter_behind_a_guide_flies_as_the_native_one(plant):
    guide = filter_of("cone-di" if plant == "quadrotor" else "safer-splat")
    safety = filter_of("cone-ecbf" if plant == "quadrotor" else "cone-di")

    class Wrapped:
        kind = safety.kind

        def reset(self):
            safety.reset()

        def __call__(self, state, nominal):
            return safety(state, nominal)

    (native,) = fly(safety, vehicle(plant), [REFERENCE], RULES, guide=guide)
    (python,) = fly(Wrapped(), vehicle(plant), [REFERENCE], RULES, guide=guide)
    (alone,) = fly(safety, vehicle(plant), [REFERENCE], RULES)
    np.testing.assert_array_equal(native.state, python.state)
    np.testing.assert_array_equal(native.a_nominal, python.a_nominal)
    np.testing.assert_array_equal(native.status, python.status)
    assert not np.array_equal(
        native.a_nominal[: len(alone.a_nominal)], alone.a_nominal[: len(native.a_nominal)]
    )


def test_a_guide_alone_flies_a_double_integrator_as_the_filter_would():
    guide, plant = filter_of("cone-di"), vehicle("double-integrator")
    (guided,) = fly(None, plant, [REFERENCE], RULES, guide=guide)
    (passed,) = fly(Passing(), plant, [REFERENCE], RULES, guide=guide)
    (filtered,) = fly(guide, plant, [REFERENCE], RULES)
    np.testing.assert_array_equal(guided.state, filtered.state)
    np.testing.assert_array_equal(passed.state, filtered.state)
    np.testing.assert_array_equal(guided.a_nominal, filtered.a_command)


def quick(**fields):
    given = {
        "trials": 3,
        "pairs": "blocked",
        "filter": "cone-ecbf",
        "guide": "cone-di",
        "speed_m_s": 1.5,
        "max_time_s": 2.0,
    }
    return SimulateConfig(**(given | fields))


def test_a_guided_run_does_not_depend_on_jobs_and_says_who_guided():
    config = quick(guide_parameters={"alpha": 3})
    one, many = (simulate_splat(config, FIELD, FASTBRIDGE, jobs=jobs) for jobs in (1, 3))
    assert one.trials == many.trials
    for a, b in zip(one.flights, many.flights, strict=True):
        np.testing.assert_array_equal(a.state, b.state)
    assert one.vehicle.endswith(", commanded by thrust and torque, guided by cone-di")
    assert "The guide 'cone-di' only changes the nominal command" in one.guarantee.statement
    other = simulate_splat(quick(), FIELD, FASTBRIDGE)
    assert other.trials != one.trials
    point = simulate_splat(quick(plant="double-integrator", filter="none"), FIELD, FASTBRIDGE)
    assert point.vehicle.endswith("double integrator, guided by cone-di")


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"guide": "nome"}, "--guide nome: a guide is cone-di or safer-splat"),
        ({"guide": "cone-backup"}, "--guide cone-backup: a guide is cone-di or safer-splat"),
        ({"guide": "polytope-cbf"}, "--guide polytope-cbf: a guide is"),
        ({"guide_parameters": {"alhpa": 1.0}}, "cone-di: unknown parameter 'alhpa'"),
        ({"guide_parameters": {"alpha": -1.0}}, "cone-di: alpha must be above 0"),
        ({"guide": "none", "guide_parameters": {"alpha": 1.0}}, "--set guide.alpha: there is no --guide"),
    ],
)
def test_what_cannot_guide_is_refused(fields, message):
    with pytest.raises(UsageError, match=message):
        simulate_splat(quick(**fields), FIELD, FASTBRIDGE)
    with pytest.raises(ValueError, match="a guide gives accelerations"):
        _core.FlightTrial(vehicle("quadrotor"), RULES, REFERENCE, guide=filter_of("cone-ecbf").native)


def test_clarabel_flies_as_the_native_solver_does():
    rules = _core.FlightRules(max_time_s=1.0)
    coefficient = np.zeros((1, 4, 8))
    coefficient[0, :, 0] = 0.7, 0.55, 1.5, 0.6
    coefficient[0, :2, 1] = 1.7, 1.1  # already in flight, towards the first ellipsoid
    fast = _core.ReferenceCurve(np.array([0.0, 3.0]), coefficient)
    for name in ("cone-di", "cone-ecbf", "cone-backup"):
        flown = [
            fly(filter_of(name, solver=solver), vehicle("quadrotor"), [fast] * 2, rules, jobs=2)
            for solver in ("active-set", "clarabel")
        ]
        (native, again), (other, twin) = flown
        assert (native.status != 0).sum() > 10, name  # the solver was asked
        assert (other.outcome, len(other.status)) == (native.outcome, len(native.status))
        np.testing.assert_allclose(other.position, native.position, rtol=0, atol=1e-4, err_msg=name)
        np.testing.assert_array_equal(other.status, native.status)
        assert not np.array_equal(other.position, native.position), name
        np.testing.assert_array_equal(other.state, twin.state)
        np.testing.assert_array_equal(native.state, again.state)


def test_the_solver_is_a_parameter():
    assert parameters_of("cone-di", {})["solver"] == "active-set"
    assert parameters_of("cone-backup", {"solver": "interpolation"})["solver"] == "interpolation"
    assert parameters_of("cone-ecbf", {"solver": "clarabel"})["solver"] == "clarabel"
    assert parameters_of("cone-ecbf", {})["lambda_"] == 14
    with pytest.raises(UsageError, match="solver must be active-set or clarabel, not 'interpolation'"):
        parameters_of("cone-di", {"solver": "interpolation"})
    for name in ELLIPSOID_FILTERS:
        with pytest.raises(UsageError, match="unknown parameter 'qp_backend'"):
            parameters_of(name, {"qp_backend": "clarabel"})


def test_what_a_backend_raises_ends_the_flights_with_it():
    def broken(*problem):
        raise ArithmeticError("no solution today")

    safety = _core.ConeDi(WORLD.index, qp_backend=broken)
    with pytest.raises(ArithmeticError, match="today"):
        _core.fly(vehicle("quadrotor"), RULES, [REFERENCE] * 3, safety, jobs=2)
