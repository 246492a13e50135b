"""One protocol and one registry for all filters: each is built by name and answers the same behind Python."""

import dataclasses

import numpy as np
import pytest

from alula import _core
from alula.schemas.errors import InputError, UsageError
from alula.schemas.scenarios.check import FILTER_COMMANDS, TRACKING
from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.schemas.scenarios.vehicles import VEHICLES
from alula.stages.clearance import hull_obstacles
from alula.stages.compression.hulls import Hulls
from alula.stages.filtering import registry
from alula.stages.filtering.bridge import NativeFilter, native_filter
from alula.stages.filtering.obstacles import ellipsoid_index
from alula.stages.filtering.polytope_cbf import without_filter
from alula.stages.filtering.protocol import (
    SIZES,
    FilterResult,
    FilterStatus,
    FilterWorld,
    FlightState,
    Nominal,
)
from alula.stages.vehicles.bodies import quadrotor, tracking_gains
from alula.stages.vehicles.racer import racer_model
from support.flights.foreign_filters import OfVelocities, Passing, Wrapped, provide
from support.scenes.fabricate import make_scene
from support.scenes.small_scenes import box_cover

BODY = quadrotor(FASTBRIDGE)
HULLS = Hulls.from_cover(box_cover([((20, -5, 0), (22, 25, 20))]))
WORLD = FilterWorld(
    radius_m=0.15,
    dt_s=0.01,
    hulls=HULLS,
    polytopes=hull_obstacles(HULLS),
    index=ellipsoid_index(make_scene(30), 1.0, 0.15),
    fence_box=((-9.0, -9.0, -9.0), (9.0, 9.0, 9.0)),
    body=BODY,
    gains=tracking_gains(FASTBRIDGE),
    racer=racer_model(VEHICLES["racer7"]),
)
HOVER = np.array([BODY.hover_thrust, 0, 0, 0])
TRACK = np.zeros((1, 32))
TRACK[0, 1:7], TRACK[0, 28] = (3.0, 0.1, 0.0, -4.0, 0.0, 0.0), 0.1
TRACK[0, [7, 9, 12, 16, 21, 27]] = 0.01


def given(rng):
    return FlightState(
        rng.uniform(-1, 3, 3),
        0.05 * rng.normal(size=3),
        rng.normal(size=3),
        0.1 * rng.normal(size=3),
        thrust=BODY.hover_thrust,
        tracks=TRACK,
        position_variance=np.full(3, 1e-4),
    ), Nominal(
        rng.normal(size=3),
        2 * rng.normal(size=3),
        HOVER + 0.01 * rng.normal(size=4),
        sticks=np.array([0.3, *rng.normal(size=3)]),
    )


def test_all_filters_are_in_one_list():
    assert registry.filter_names() == ["none", *registry.filter_names()[1:]]
    assert set(registry.filter_names()) == {"none", *FILTER_COMMANDS}
    assert len(FILTER_COMMANDS) == 13


@pytest.mark.parametrize("name", FILTER_COMMANDS)
def test_every_filter_is_built_by_its_name_and_answers_the_same_from_python(name):
    made, twin = (registry.make_filter(name, WORLD, {}) for _ in range(2))
    assert isinstance(made, NativeFilter)
    assert made.kind == registry.filter_kind(name) == FILTER_COMMANDS[name]
    bridged = NativeFilter(native_filter(Wrapped(twin)), {})
    made.reset()
    bridged.reset()
    rng, statuses = np.random.default_rng(3), set()
    for _ in range(20):
        state, nominal = given(rng)
        mine, other = made(state, nominal), bridged(state, nominal)
        assert mine.u.shape == (SIZES[made.kind],)
        assert np.isfinite(mine.u).all()
        if mine.status is not FilterStatus.REFUSED:
            np.testing.assert_array_equal(mine.u, other.u)
        assert (mine.status, mine.margin, mine.active) == (other.status, other.margin, other.active)
        assert (mine.certified, mine.infeasible) == (other.certified, other.infeasible)
        statuses.add(mine.status)
    assert statuses - {FilterStatus.REFUSED}
    assert made.native.shares_state is False
    assert bridged.native.shares_state is True


def test_none_is_no_filter_and_reports_the_margin_of_polytope_cbf():
    assert registry.make_filter("none", WORLD, {}) is None
    bare, whole = without_filter(WORLD, {}), registry.make_filter("polytope-cbf", WORLD, {})
    for x in ((0.0, 0.0, 0.5), (1.7, 0.5, 0.5)):
        state, nominal = FlightState(np.array(x)), Nominal(np.array([5.0, 0, 0]))
        passed = bare(state, nominal)
        assert (passed.status, passed.u.tolist()) == (FilterStatus.OK, [5.0, 0, 0])
    filtered = whole(state, nominal)
    assert filtered.status in (FilterStatus.FILTERED, FilterStatus.SHORTENED)
    assert passed.margin == pytest.approx(filtered.margin)  # where the row binds both know the exact value
    assert passed.active == filtered.active == 0


@pytest.mark.parametrize(
    ("name", "parameters", "fields", "message"),
    [
        ("polytope-cbf", {}, {"hulls": None}, "polytope-cbf needs the hulls of a cover"),
        ("polytope-cbf", {"bta": 1}, {}, "polytope-cbf: unknown parameter 'bta'"),
        ("shield", {}, {"body": None}, "shield gives thrust and torque, and the vehicle is a point"),
        ("cone-di", {"alpha": -1.0}, {}, "cone-di: "),
        ("dr-acbf", {"alpha": 2.0}, {}, "dr-acbf: .*alpha"),
        ("mpc", {"alhpa": 0.1}, {}, "mpc: .*alhpa"),
        ("geofence", {"steps": 1}, {}, "geofence: .*steps"),
        ("geofence", {}, {"racer": None}, "geofence: .* throttle and rates"),
        ("geofence", {}, {"fence_box": None}, "geofence: "),
        ("nome", {}, {}, "no filter is called 'nome'; known: none, polytope-cbf, cone-di, .*geofence"),
    ],
)
def test_what_cannot_be_built_is_refused_in_words(name, parameters, fields, message):
    with pytest.raises(UsageError, match=message):
        registry.make_filter(name, dataclasses.replace(WORLD, **fields), parameters)


def test_without_ellipsoids_the_index_is_empty():
    made = registry.make_filter("cone-di", FilterWorld(radius_m=0.1, dt_s=0.01), {})
    state, nominal = FlightState(np.zeros(3)), Nominal(acceleration=np.array([0.1, 0.2, 0.3]))
    assert made(state, nominal).u.tolist() == [0.1, 0.2, 0.3]


def test_filters_among_moving_obstacles_see_tracks_from_python():
    rng = np.random.default_rng(5)
    for name in TRACKING - {"mpc"}:
        made = registry.make_filter(name, FilterWorld(radius_m=0.3, dt_s=0.01), {})
        state = FlightState(np.zeros(3), velocity=np.array([1.0, 0, 0]), tracks=TRACK)
        nominal = Nominal(acceleration=np.array([3.0, 0, 0]))
        alone = FlightState(state.position, velocity=state.velocity)
        answers = []
        for seen in (state, alone):
            made.reset()
            for _ in range(3):
                found = made(seen, nominal)
            answers.append(found.u)
        assert not np.allclose(*answers), name
        with pytest.raises(ValueError, match="tracks have 29 columns, or 32"):
            made(FlightState(np.zeros(3), tracks=rng.normal(size=(1, 30))), nominal)


@pytest.fixture
def elsewhere(monkeypatch):
    known = {"passing": Passing, "unkind": lambda world, parameters: None}
    provide(monkeypatch, known)


def test_a_filter_of_another_package_is_in_the_one_group(elsewhere):
    assert registry.filter_names()[-2:] == ["passing", "unkind"]
    assert registry.filter_kind("passing") == "acceleration"
    assert isinstance(registry.make_filter("passing", WORLD, {}), Passing)
    with pytest.raises(UsageError, match="'unkind': its factory needs an attribute `kind`, of velocity, acc"):
        registry.filter_kind("unkind")


def test_what_a_filter_in_python_returns_is_checked():
    state, nominal = FlightState(np.array([1.0, 2, 3])), Nominal(np.ones(3))
    for u, status in ((np.array([1, np.nan, 0]), 0), (np.zeros(4), 0), (None, 1)):
        made = OfVelocities(lambda x, v, u=u, status=status: FilterResult(u, FilterStatus(status)))
        with pytest.raises(InputError, match=r"which is no velocity, at \[1.0, 2.0, 3.0\]"):
            NativeFilter(native_filter(made), {})(state, nominal)
    refusing = OfVelocities(lambda x, v: FilterResult(np.full(3, np.nan), FilterStatus.REFUSED, -1.0))
    found = NativeFilter(native_filter(refusing), {})(state, nominal)
    assert (found.status, found.u.tolist()) == (FilterStatus.REFUSED, [0, 0, 0])
    odd = OfVelocities(lambda x, v: FilterResult(v, 17))
    with pytest.raises(ValueError, match="17"):
        NativeFilter(native_filter(odd), {})(state, nominal)


def test_a_python_filter_sees_all_that_a_native_one_sees():
    seen = []

    def note(state, nominal):
        seen.append((state, nominal))
        return FilterResult(nominal.sticks, FilterStatus.OK)

    class Noting(OfVelocities):
        kind = "sticks"

        def __call__(self, state, nominal):
            return self.answer(state, nominal)

    state, nominal = given(np.random.default_rng(8))
    NativeFilter(native_filter(Noting(note)), {})(state, nominal)
    for mine, other in zip((state, nominal), seen[0], strict=True):
        for key in mine.__slots__:
            a, b = getattr(mine, key), getattr(other, key)
            if key == "tracks":
                np.testing.assert_allclose(a, b, rtol=1e-6)  # they are of single precision
            elif isinstance(a, np.ndarray):
                np.testing.assert_array_equal(a, b, err_msg=key)
            else:
                assert a == b, key


def test_what_stands_around_a_python_filter_flies_in_one_thread_too():
    python, native = OfVelocities(lambda x, v: FilterResult(v, FilterStatus.OK)), without_filter(WORLD, {})
    for made, shares in ((python, True), (native, False)):
        chord = _core.ChordFilter(native_filter(made), lag_s=0.3, max_speed_m_s=9.0)
        assert chord.shares_state is chord.clone().shares_state is shares
