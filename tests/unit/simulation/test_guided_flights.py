"""Flights with a guide, which changes the nominal command before the safety filter."""

import numpy as np
import pytest

from alula import _core
from alula.schemas.errors import UsageError
from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.stages.filtering import registry
from alula.stages.filtering.ellipsoid_filters import ELLIPSOID_FILTERS, parameters_of
from alula.stages.filtering.protocol import FilterWorld
from alula.stages.planning.rest_to_rest import rest_to_rest
from alula.stages.vehicles.bodies import quadrotor, tracking_gains
from support.flights.foreign_filters import Passing, Wrapped
from support.flights.reference_flights import along, vehicle_of
from support.flights.world_runs import IDEAL_POINT, flown
from support.scenes.fabricate import make_scene

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


def vehicle(model):
    return vehicle_of(model=model, gains=GAINS)


def fly(model, *filters, curves=(REFERENCE,), max_time_s=3.0, jobs=1):
    has_yaw = model == "quadrotor"
    return along(curves, filters, vehicle(model), has_yaw=has_yaw, max_time_s=max_time_s, jobs=jobs)


def filter_of(name, **parameters):
    return registry.make_filter(name, WORLD, parameters)


@pytest.mark.parametrize("plant", ["quadrotor", "double-integrator"])
@pytest.mark.parametrize("name", ["cone-di", "safer-splat"])
def test_the_nominal_is_what_realises_the_guide_s_acceleration(plant, name):
    """The filter behind the guide sees it; the controller knows of a thrust that is not its own."""
    guide, bent, own = filter_of(name), 0, None

    class Seeing(Passing):
        kind = "wrench" if plant == "quadrotor" else "acceleration"

        def __init__(self):
            super().__init__()
            self.seen = []

        def __call__(self, state, nominal):
            self.seen.append((nominal.acceleration, nominal.wrench, state.thrust))
            return super().__call__(state, nominal)

    seeing = Seeing()
    (log,) = fly(plant, guide, seeing, max_time_s=2.5)
    for i, (x, (found, found_wrench, thrust)) in enumerate(zip(log["state"], seeing.seen, strict=False)):
        row = REFERENCE.at(np.array([0.01 * i]))
        if plant == "quadrotor":
            applied = {} if own in (None, thrust) else {"applied_thrust": np.array([thrust])}
            asked = _core.track(BODY, GAINS, x[None], row, **applied)
            acceleration, wrench = asked["acceleration"][0], asked["wrench"][0]
            own = wrench[0]
        else:
            acceleration = _core.track_point(GAINS, x[None], row)[0]
        report = guide.native.filter(x.tolist(), acceleration.tolist())
        if report["status"] == 0:
            np.testing.assert_allclose(found, acceleration, rtol=0, atol=1e-9)
        else:
            bent += not np.allclose(found, acceleration)
            np.testing.assert_allclose(found, report["acceleration"], rtol=0, atol=1e-7)
            if plant == "quadrotor":
                bent_to = np.array([report["acceleration"]])
                wrench = _core.realise(BODY, GAINS, x[None], row, bent_to)[0]
        if plant == "quadrotor":
            np.testing.assert_allclose(found_wrench, wrench, rtol=0, atol=1e-7)
    assert len(seeing.seen) > 200
    assert bent > 3


@pytest.mark.parametrize("plant", ["quadrotor", "double-integrator"])
def test_a_python_filter_behind_a_guide_flies_as_the_native_one(plant):
    guide = filter_of("cone-di" if plant == "quadrotor" else "safer-splat")
    safety = filter_of("cone-ecbf" if plant == "quadrotor" else "cone-di")
    (native,) = fly(plant, guide, safety)
    (python,) = fly(plant, guide, Wrapped(safety))
    (alone,) = fly(plant, safety)
    for key in ("state", "command", "nominal", "status"):
        np.testing.assert_array_equal(native[key], python[key])
    count = min(len(native["state"]), len(alone["state"]))
    assert not np.array_equal(native["state"][:count], alone["state"][:count])


def test_a_guide_alone_flies_a_double_integrator_as_the_filter_would():
    """The guide is the first filter of the list, and there is no other."""
    guide = filter_of("cone-di")
    (guided,) = fly("double-integrator", guide)
    (passed,) = fly("double-integrator", guide, Passing())
    np.testing.assert_array_equal(guided["state"], passed["state"])
    np.testing.assert_array_equal(guided["a_command"], passed["a_command"])
    fast = {"vehicle": IDEAL_POINT, "speed_m_s": 3.0, "max_time_s": None}
    alone, filtered = quick((), **fast), quick("cone-di", guide="none", **fast)
    for one, other in zip(alone.flights, filtered.flights, strict=True):
        assert one.state == other.state
    assert alone.summary["filtered_steps"] == 0 < filtered.summary["filtered_steps"]
    assert alone.summary["min_margin"] is None
    steps = sum(trial.filters[0].filtered + trial.filters[0].recovering for trial in alone.trials)
    assert steps == filtered.summary["filtered_steps"]


def quick(filters="cone-ecbf", parameters=None, **fields):
    given = {"trials": 3, "which": "blocked", "guide": "cone-di", "speed_m_s": 1.5, "max_time_s": 2.0}
    return flown(filters, parameters, scene=FIELD, **(given | fields))


def test_a_guided_run_does_not_depend_on_jobs_and_says_who_guided():
    one, many = (quick(guide_parameters={"alpha": 3}, jobs=jobs) for jobs in (1, 3))
    assert one.trials == many.trials
    assert one.flights == many.flights
    assert one.vehicle.endswith(", commanded by thrust and torque, guided by cone-di")
    assert "The guide 'cone-di' only changes the nominal command" in one.guarantee.statement
    other = quick()
    assert other.trials != one.trials
    point = quick((), vehicle=IDEAL_POINT)
    assert point.vehicle.endswith("double integrator, commanded by acceleration, guided by cone-di")


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"guide": "nome"}, r"`\$.mission.controller.guide`"),
        ({"guide": "cone-backup"}, r"`\$.mission.controller.guide`"),
        ({"guide": "polytope-cbf"}, r"`\$.mission.controller.guide`"),
        (
            {"guide_parameters": {"alhpa": 1.0}},
            r"`\$.mission.controller.guide_parameters`: unknown parameter 'alhpa'",
        ),
        (
            {"guide_parameters": {"alpha": -1.0}},
            r"`\$.mission.controller.guide_parameters`: alpha must be above 0",
        ),
        ({"guide": "none", "guide_parameters": {"alpha": 1.0}}, "guide_parameters"),
    ],
)
def test_what_cannot_guide_is_refused(fields, message):
    with pytest.raises(UsageError, match=message):
        quick(**fields)


def test_clarabel_flies_as_the_native_solver_does():
    coefficient = np.zeros((1, 4, 8))
    coefficient[0, :, 0] = 0.7, 0.55, 1.5, 0.6
    coefficient[0, :2, 1] = 1.7, 1.1  # already in flight, towards the first ellipsoid
    fast = _core.ReferenceCurve(np.array([0.0, 3.0]), coefficient)
    for name in ("cone-di", "cone-ecbf", "cone-backup"):
        flown = [
            fly("quadrotor", filter_of(name, solver=solver), curves=[fast] * 2, max_time_s=1.0, jobs=2)
            for solver in ("active-set", "clarabel")
        ]
        (native, again), (other, twin) = flown
        assert (native["status"] != 0).sum() > 10, name  # the solver was asked
        assert (other["end"], len(other["status"])) == (native["end"], len(native["status"]))
        np.testing.assert_allclose(other["path"], native["path"], rtol=0, atol=1e-4, err_msg=name)
        np.testing.assert_array_equal(other["status"], native["status"])
        assert not np.array_equal(other["path"], native["path"]), name
        np.testing.assert_array_equal(other["state"], twin["state"])
        np.testing.assert_array_equal(native["state"], again["state"])


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
        fly("quadrotor", safety, curves=[REFERENCE] * 3, jobs=2)
