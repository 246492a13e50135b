"""The onboard geofence, evaluation by evaluation and tick by tick."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula import _core
from alula.stages.compression.hulls import Hulls
from alula.stages.compression.onboard.layout import encode_map
from alula.stages.vehicles.fence import fence
from support.effort import examples
from support.flights.fence_flights import fly_in
from support.models import racer_model as model
from support.scenes import covers

HOVERING = np.r_[0, 0, 30.0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0]


def filter_in(box=model.BOX, **parameters):
    return _core.Geofence(_core.Fence(box=box), _core.RacerModel(), parameters)


def test_the_backup_controller_is_that_of_the_independent_model():
    states = np.concatenate([model.random_states(60, 0), model.random_states(60, 1, speed=6, tilt=3.0)])
    states[::4, 0] = 39.5  # where (17) acts
    states[1::4, 2] = 0.4
    _, first = filter_in().evaluate(states)
    expected = np.array([model.backup(x, model.hold(x)) for x in states])
    np.testing.assert_allclose(first, expected, rtol=1e-4, atol=2e-4)


def test_h_i_is_a_lower_bound_of_the_exact_flow_and_a_tight_one():
    """Of the continuous flow, within the margin: that is what the margin claims to cover."""
    states = model.random_states(8, 2, speed=25)
    values, _ = filter_in().evaluate(states)
    for x, (h_i, _, margin, distance, end) in zip(states, values, strict=True):
        flow = model.flow(x, 3.0)
        exact = min(model.box_distance(flow[:, :3]).min(), 40 * (1 - np.linalg.norm(flow[-1, 3:6])))
        assert h_i <= min(exact, distance, end)
        if h_i < end:  # decided by the fence
            assert exact - h_i <= 4 * margin + 1e-3


@pytest.mark.slow
@pytest.mark.parametrize(("tilt", "seed"), [(1.3, 0), (3.14, 1)])
def test_what_is_flown_stays_above_the_prediction(tilt, seed):
    """u_B held for ticks of 2.5 ms on the plant, from fast states, also upside down: never below h_I."""
    geofence = filter_in()
    logs = fly_in(
        geofence,
        starts=((-30.0, -30, 5), (30.0, 30, 55)),
        speed_m_s=30,
        tilt_rad=tilt,
        duration_s=3,
        losses=_core.Losses(radio_from_s=0, radio_for_s=9),
        count=120,
        seed=seed,
    )
    values, _ = geofence.evaluate(np.array([log["start"] for log in logs]))
    least = np.array([log["min_distance_m"] for log in logs])
    decided_by_distance = values[:, 0] < values[:, 4]
    assert decided_by_distance.sum() > 80
    assert (least - values[:, 0])[decided_by_distance].min() > 0


def test_finer_steps_need_less_margin():
    states = model.random_states(50, 3, speed=25)
    margins = [np.median(filter_in(steps=n, step_s=3 / n).evaluate(states)[0][:, 2]) for n in (100, 200, 400)]
    assert margins[0] > 1.4 * margins[1] > margins[1] > margins[2]


def test_a_box_and_its_six_faces_are_the_same_fence():
    lower, upper = model.BOX
    faces = np.array(
        [[*-row, -lower[i]] for i, row in enumerate(np.eye(3))]
        + [[*row, upper[i]] for i, row in enumerate(np.eye(3))]
    )
    states = model.random_states(40, 4)
    as_box, u_box = filter_in().evaluate(states)
    as_faces, u_faces = _core.Geofence(_core.Fence(faces=faces)).evaluate(states)
    # faces give away 16 u of a kilometre
    assert (as_faces[:, 0] <= as_box[:, 0] + 1e-4).all()
    np.testing.assert_allclose(as_faces[:, :4], as_box[:, :4], atol=5e-3)
    np.testing.assert_allclose(u_faces, u_box, atol=5e-3)


def test_the_combination_is_the_least_of_its_parts():
    states = model.random_states(40, 5, low=(-35, -35, 8), high=(20, 20, 50))
    slant = np.array([[0.6, 0.8, 0.0, 30.0]])
    both = _core.Geofence(_core.Fence(box=model.BOX, faces=slant)).evaluate(states)[0][:, 0]
    box = filter_in().evaluate(states)[0][:, 0]
    face = _core.Geofence(_core.Fence(faces=slant)).evaluate(states)[0][:, 0]
    inner = np.minimum(box, face) > 2  # where neither pushes the other's flow
    assert inner.sum() > 10
    np.testing.assert_allclose(both[inner], np.minimum(box, face)[inner], atol=5e-3)


@pytest.fixture(scope="module")
def cover():
    return covers.cover_of(covers.voxels_of(covers.furniture(1)))


def test_a_cover_keeps_out_and_h_i_is_below_its_distance_along_the_flow(cover):
    hulls = Hulls.from_cover(cover)
    low, high = hulls.vertices_world.min(axis=0), hulls.vertices_world.max(axis=0)
    where = fence(box=(tuple(low - 6), tuple(high + 6)), cover=cover)
    geofence = _core.Geofence(where)
    logs = fly_in(
        geofence,
        starts=(tuple(low - 4), tuple(high + 4)),
        speed_m_s=6,
        pilot=_core.Pilot("aggressive"),
        duration_s=4,
        count=12,
        seed=2,
    )
    assert min(log["min_distance_m"] for log in logs) > 0
    assert sum(log["interventions"] for log in logs) > 10
    starts = np.array([log["start"] for log in logs])
    values, _ = geofence.evaluate(starts)
    for x, value in zip(starts, values, strict=True):
        assert value[3] <= where.clearance(tuple(x[:3]), tuple(x[:3])) + 1e-6


def test_an_indexed_map_and_one_without_give_the_same_bits_whatever_came_before(cover):
    images = [encode_map(cover, indexed=indexed) for indexed in (True, False)]
    hulls = Hulls.from_cover(cover)
    low, high = hulls.vertices_world.min(axis=0) - 3, hulls.vertices_world.max(axis=0) + 3
    states = model.random_states(60, 9, speed=8, tilt=2, low=low, high=high)
    states[::3, :3] = states[0, :3]
    ahead, behind, alone = (_core.Geofence(_core.Fence(image=image)) for image in (*images, images[0]))
    one, other = ahead.evaluate(states), behind.evaluate(states[::-1])
    for values, reversed_values in zip(one, other, strict=True):
        assert values.tobytes() == reversed_values[::-1].tobytes()
    for k, state in enumerate(states[:10]):
        alone.reset()
        np.testing.assert_array_equal(alone.evaluate(state[None])[0][0], one[0][k])


@given(
    seed=st.integers(0, 10**6),
    speed=st.floats(0, 40),
    tilt=st.floats(0, 3.1),
    pilot=st.tuples(st.floats(-2, 3), *[st.floats(-50, 50)] * 3),
    parameters=st.sampled_from(
        [{}, {"fast_m_s": 1.0}, {"reserve_m": 2.0}, {"beta": 5.0}, {"latency_s": 0.02}]
    ),
)
@settings(max_examples=examples(150), deadline=None)
def test_commands_stay_in_their_limits_and_lambda_decides_between_pilot_and_backup(
    seed, speed, tilt, pilot, parameters
):
    x = model.random_states(1, seed, speed=speed, tilt=tilt, low=(-42, -42, -2), high=(42, 42, 62))[0]
    geofence, pilot = filter_in(**parameters), np.array(pilot, np.float32).astype(float)
    u, status, detail = geofence.filter(x, pilot)
    assert 0 <= u[0] <= 1
    assert (np.abs(u[1:]) <= model.MAX_RATE).all()
    assert 0 <= detail["lambda"] <= 1
    desired = np.clip(pilot, [0, *-model.MAX_RATE], [1, *model.MAX_RATE])
    if not parameters.get("latency_s"):
        value, first = geofence.evaluate(x[None])
        assert detail["h_i"] == value[0, 0]
        mixed = detail["lambda"] * desired + (1 - detail["lambda"]) * first[0]
        np.testing.assert_allclose(u, mixed, rtol=1e-5, atol=1e-5)
        if detail["h_i"] <= 0:
            assert (status, detail["lambda"]) == ("backup", 0)
            np.testing.assert_array_equal(u, first[0])
    if status == "passed":
        assert detail["lambda"] == 1
        np.testing.assert_array_equal(u, pilot)
    if detail["lambda"] == 1:
        np.testing.assert_array_equal(u, desired)


@pytest.mark.parametrize("speed", [0.0, 4.0, 20.0])
def test_the_regulation_function_is_that_of_the_paper(speed):
    x = HOVERING.copy()
    x[0], x[3] = 37.5 - 1.2 * speed, speed
    pilot = np.array([0.3, 1.0, 0, 0])
    for fast, v in ((10.0, np.clip(speed, 1, 10)), (1.0, 1.0)):
        _, status, detail = filter_in(fast_m_s=fast).filter(x, pilot)
        assert status in ("blended", "passed")
        assert detail["v_towards"] == pytest.approx(v)
        assert detail["lambda"] == pytest.approx(1 - np.exp(-1.5 * detail["h_i"] / v), abs=1e-6)


def test_far_from_everything_the_pilot_flies():
    pilot = np.array([0.123456789, 1e-9, -11.9999999, 6.0])
    u, status, detail = filter_in(((-500.0, -500, 0), (500.0, 500, 500))).filter(HOVERING, pilot)
    assert (status, detail["lambda"]) == ("passed", 1)
    assert u.tobytes() == pilot.tobytes()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("place", range(13))
def test_navigation_that_is_not_finite_is_never_used(place, bad):
    geofence, x = filter_in(), HOVERING.copy()
    x[place] = bad
    u, status, _ = geofence.filter(x, np.array([1.0, 0, 0, 0]))
    assert status == "refused"
    np.testing.assert_array_equal(u, 0)
    geofence.filter(HOVERING, np.array([0.3, 0, 0, 0]))
    u, status, detail = geofence.filter(x, np.array([0.3, 0, 0, 0]))
    assert status in ("passed", "blended")
    assert np.isfinite(u).all()
    assert detail["stale_s"] == pytest.approx(0.0025)


@pytest.mark.parametrize("pilot", [None, np.array([np.nan, 0, 0, 0]), np.array([0.5, 0, np.inf, 0])])
def test_without_a_pilot_the_backup_holds_where_he_fell_silent(pilot):
    geofence, racer = filter_in(), _core.Racer(_core.RacerModel())
    x = model.random_states(1, 6, speed=15, low=(0, 0, 30), high=(1, 1, 31))[0]
    racer.reset(x)
    for _ in range(2400):
        u, status, _ = geofence.filter(racer.state, pilot)
        assert status == "no-pilot"
        racer.step(0.0025, u)
    assert np.linalg.norm(racer.state[3:6]) < 0.05
    assert racer.state[2] == pytest.approx(x[2], abs=0.05)


def test_with_stale_navigation_the_margin_grows_and_then_it_is_handed_over():
    geofence, pilot = filter_in(stale_limit_s=0.1), np.array([geofence_hover(), 0, 0, 0])
    geofence.filter(HOVERING, pilot)
    seen = [geofence.filter(None, pilot) for _ in range(60)]
    margins = [detail["margin_m"] for _, _, detail in seen[:39]]
    assert all(a < b for a, b in itertools.pairwise(margins))
    t = 39 * 0.0025
    expected = 0.5 * t + 0.5 * 5 * t**2
    assert margins[-1] - geofence_margin() == pytest.approx(expected, abs=2e-3)
    assert [status for _, status, _ in seen].index("hand-over") in (39, 40)
    u, status, _ = seen[-1]
    assert status == "hand-over"
    assert u[0] == pytest.approx(0.9 * geofence.hover_throttle)
    np.testing.assert_allclose(u[1:], 0, atol=1e-5)
    assert geofence.filter(HOVERING, pilot)[1] in ("passed", "blended")


def geofence_hover():
    return filter_in().hover_throttle


def geofence_margin():
    return filter_in().filter(HOVERING, np.zeros(4))[2]["margin_m"]


@pytest.mark.parametrize(
    "parameters",
    [
        {"steps": 101},
        {"steps": 0},
        {"steps": 402},
        {"step_s": 0.0},
        {"beta": np.nan},
        {"fast_m_s": 0.5},
        {"latency_s": 0.2},
        {"reserve_m": -1.0},
        {"max_tilt_rad": 1.6},
        {"unknown": 1.0},
    ],
)
def test_parameters_out_of_range_are_refused(parameters):
    with pytest.raises(ValueError):
        filter_in(**parameters)


@pytest.mark.parametrize(
    "where",
    [
        {},
        {"box": ((0.0, 0, 0), (1.0, 1, 0))},
        {"box": ((0.0, 0, 0), (np.nan, 1, 1))},
        {"box": ((0.0, 0, 0), (1e5, 1, 1))},
        {"faces": np.array([[1.0, 1.0, 0.0, 3.0]])},
        {"faces": np.tile([1.0, 0, 0, 3], (40, 1))},
        {"image": b"no map"},
    ],
)
def test_fences_that_are_none_are_refused(where):
    with pytest.raises(ValueError):
        _core.Geofence(_core.Fence(**where))
