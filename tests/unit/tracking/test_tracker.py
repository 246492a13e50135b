"""The tracker: assignment, the life of tracks, refusals."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from alula import _core
from support.effort import examples
from support.flights.tracked import scan, tracker

DT = 0.05


def idle(cost, gate):
    """The least cost of rows that may stay without a column at the price of the gate."""
    rows, columns = cost.shape
    wide = np.full((rows, columns + rows), 1e9)
    wide[:, :columns] = np.where(cost <= gate, cost, 1e9)
    wide[:, columns:][np.eye(rows, dtype=bool)] = gate
    return wide[linear_sum_assignment(wide)].sum()


def price(cost, column, gate):
    taken = column >= 0
    return cost[taken, column[taken]].sum() + gate * np.sum(~taken)


@settings(deadline=None, max_examples=examples(100))
@given(
    st.integers(0, 2**32 - 1), st.integers(0, 9), st.integers(0, 9), st.sampled_from([0.3, 1.0, 3.0, 30.0])
)
def test_an_assignment_within_a_gate_costs_least(seed, rows, columns, gate):
    cost = np.random.default_rng(seed).exponential(1.5, (rows, columns))
    column = _core.assign(cost, gate)
    taken = column[column >= 0]
    assert len(set(taken)) == len(taken)
    assert np.all(cost[column >= 0, taken] <= gate)
    assert price(cost, column, gate) == pytest.approx(idle(cost, gate), rel=1e-12)


@settings(deadline=None, max_examples=examples(100))
@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.integers(1, 12), st.booleans())
def test_an_assignment_without_a_gate_is_scipys(seed, rows, columns, ties):
    rng = np.random.default_rng(seed)
    cost = (
        rng.integers(-3, 4, (rows, columns)).astype(float) if ties else rng.normal(size=(rows, columns)) * 50
    )
    column = _core.assign(cost)
    i, j = linear_sum_assignment(cost)
    assert np.sum(column >= 0) == min(rows, columns)
    assert cost[column >= 0, column[column >= 0]].sum() == pytest.approx(cost[i, j].sum(), rel=1e-9, abs=1e-9)
    if not ties:
        assert np.array_equal(np.flatnonzero(column >= 0), i)
        assert np.array_equal(column[column >= 0], j)


def test_costs_that_mean_nothing_are_forbidden():
    cost = np.array([[np.nan, 1.0], [np.inf, 2.0], [1e300, -np.inf]])
    assert _core.assign(cost).tolist() == [1, -1, -1]
    assert _core.assign(np.zeros((0, 3))).tolist() == []
    assert _core.assign(np.zeros((2, 0)), 1.0).tolist() == [-1, -1]
    for gate in (-1.0, np.nan):
        with pytest.raises(ValueError, match="gate"):
            _core.assign(cost, gate)


def test_a_large_assignment_is_scipys():
    cost = np.random.default_rng(5).uniform(size=(150, 130))
    i, j = linear_sum_assignment(cost)
    column = _core.assign(cost)
    assert np.array_equal(np.flatnonzero(column >= 0), i)
    assert np.array_equal(column[i], j)


def life(pattern, hits, window, misses):
    """Per scan (id, confirmed) of the only target's track, or None."""
    now, number, result = None, 0, []
    for hit in pattern:
        if now is None:
            if hit:
                number += 1
                now = {"id": number, "seen": [True], "confirmed": False}
        else:
            now["seen"].append(hit)
        if now is not None:
            now["confirmed"] |= sum(now["seen"][-window:]) >= hits
            if len(now["seen"]) >= misses and not any(now["seen"][-misses:]):
                now = None
        result.append(now and (now["id"], now["confirmed"]))
    return result


@settings(deadline=None, max_examples=examples(100))
@given(
    st.lists(st.booleans(), max_size=60),
    st.sampled_from([(5, 6), (1, 1), (3, 3), (2, 5), (40, 64)]),
    st.integers(1, 7),
)
def test_tracks_are_confirmed_and_deleted_by_counts(pattern, confirm, misses):
    hits, window = confirm
    target = tracker(confirm_hits=hits, confirm_scans=window, delete_misses=misses)
    for k, (hit, expected) in enumerate(zip(pattern, life(pattern, hits, window, misses), strict=True)):
        scan(target, k * DT, *([(10.0, 20.0, 30.0)] if hit else []))
        got = target.tracks(k * DT)
        assert [*zip(got["id"], got["is_confirmed"], strict=True)] == ([expected] if expected else [])


def test_the_defaults_confirm_with_the_fifth_hit_and_delete_with_the_fifth_miss():
    target = tracker()
    confirmed = []
    for k in range(6):
        scan(target, k * DT, *([] if k == 2 else [(1.0, 2.0, 3.0)]))
        confirmed.append(bool(target.tracks(k * DT)["is_confirmed"][0]))
    assert confirmed == [False] * 5 + [True]
    for k in range(6, 11):
        assert len(target.tracks(k * DT)["id"]) == 1
        scan(target, k * DT)
    assert len(target.tracks(11 * DT)["id"]) == 0


def doppler_scan(target, t, truths, rng, chance=0.95):
    """Detections of (p, v) from the origin, shuffled, some missing, with the errors of a radar."""
    seen = [(p, v) for p, v in truths if rng.uniform() < chance]
    rng.shuffle(seen)
    los = np.array([p / np.linalg.norm(p) for p, _ in seen]).reshape(-1, 3)
    rate = np.array([u @ v for u, (_, v) in zip(los, seen, strict=True)]) + 0.1 * rng.normal(size=len(seen))
    positions = [p + 0.3 * rng.normal(size=3) for p, _ in seen]
    scan(target, t, *positions, los=los, range_rate=rate)


@pytest.mark.parametrize("seed", range(12))
def test_crossing_targets_keep_their_names(seed):
    """Two that meet in one point, at the same time, 40 m away."""
    rng, target = np.random.default_rng(seed), tracker()
    v = np.array([[-5.0, 4.0, 0.0], [-5.0, -4.0, 0.5]])
    meeting = np.array([40.0, 0.0, 2.0])
    names = {}
    for k in range(120):
        t = k * DT
        p = meeting + v * (t - 3.0)
        doppler_scan(target, t, list(zip(p, v, strict=True)), rng)
        got = target.tracks(t)
        if k in (20, 119):
            for i, name in enumerate(got["id"][got["is_confirmed"]]):
                names.setdefault(k, {})[name] = int(np.argmin(np.linalg.norm(p - got["p"][i], axis=1)))
    assert names[20] == names[119]
    assert sorted(names[119].values()) == [0, 1]


def clutter(rng, mean):
    """Uniform in the field of view of a radar: 80 x 20 degrees, 150 m."""
    n = rng.poisson(mean)
    r, azimuth = 150 * rng.uniform(size=n) ** (1 / 3), np.radians(rng.uniform(-40, 40, n))
    z = rng.uniform(-1, 1, n) * np.sin(np.radians(10))
    flat = np.sqrt(1 - z**2)
    los = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), z], axis=1)
    return r[:, None] * los, los, rng.uniform(-15, 15, n)


@pytest.mark.parametrize(("mean", "scans", "most"), [(0.1, 4000, 0), (5.0, 500, 2)])
def test_clutter_is_hardly_ever_confirmed(mean, scans, most):
    rng, target, confirmed = np.random.default_rng(9), tracker(), set()
    for k in range(scans):
        position, los, rate = clutter(rng, mean)
        scan(target, k * DT, *position, los=los, range_rate=rate)
        got = target.tracks(k * DT)
        confirmed.update(got["id"][got["is_confirmed"]].tolist())
    assert len(confirmed) <= most
    assert target.dropped == 0


def test_a_new_track_takes_nothing_from_a_confirmed_one():
    """What has just begun has a wide covariance and so a small distance to everything; it has to wait."""
    target = tracker(confirm_hits=3, confirm_scans=3)
    for k in range(20):
        scan(target, k * DT, (50.0, 0, 0))
    scan(target, 20 * DT, (50.0, 0, 0), (50.0, 2.6, 0))
    assert target.tracks(20 * DT)["id"].tolist() == [1, 2]
    scan(target, 21 * DT, (50.0, 0.9, 0))  # farther from the old one, but in its gate
    scan(target, 22 * DT, (50.0, 0.0, 0))
    assert np.linalg.norm(target.tracks(22 * DT)["p"][0] - (50, 0, 0)) < 0.5


def test_predictions_reach_any_time():
    """Along the velocity, with a growing covariance; before the last scan it is that scan's."""
    target = tracker()
    for k in range(30):
        scan(target, k * DT, (5.0 * k * DT, 0, 0))
    last = 29 * DT
    now, later = target.tracks(last), target.tracks(last + 0.5)
    assert later["p"][0] - now["p"][0] == pytest.approx(0.5 * now["v"][0] + 0.125 * now["a"][0], abs=1e-12)
    assert np.linalg.eigvalsh(later["covariance"][0] - now["covariance"][0])[-1] > 0
    assert all(np.array_equal(now[name], target.tracks(0.0)[name]) for name in now)


def test_equal_scans_give_equal_tracks_whatever_was_before():
    def run(target):
        rng, answers = np.random.default_rng(11), []
        for k in range(60):
            p, v = (
                np.array([[60 - 5.0 * k * DT, 1, 0], [30, -6 + 4.0 * k * DT, 1]]),
                np.array([[-5.0, 0, 0], [0, 4, 0]]),
            )
            doppler_scan(target, k * DT, list(zip(p, v, strict=True)), rng, 0.9)
            answers.append({k: v.tobytes() for k, v in target.tracks(k * DT + 0.02).items()})
        return answers

    used = tracker(with_turn=True)
    scan(used, 5.0, (1, 2, 3), (4, 5, 6))
    used.reset()
    assert used.dropped == 0
    fresh = run(tracker(with_turn=True))
    assert run(used) == fresh
    used.reset()
    assert run(used) == fresh


BAD = {
    "position": {"position": [np.nan, 0, 0]},
    "infinite": {"position": [np.inf, 0, 0]},
    "far": {"position": [0, 0, -2e9]},
    "vague": {"covariance": 1e19 * np.eye(3)},
    "covariance": {"covariance": np.diag([1.0, np.nan, 1.0])},
    "negative": {"covariance": np.diag([1.0, -1.0, 1.0])},
    "indefinite": {"covariance": np.array([[1.0, 2, 0], [2, 1, 0], [0, 0, 1]])},
    "determinant": {"covariance": np.array([[1.0, -0.9, -0.9], [-0.9, 1, -0.9], [-0.9, -0.9, 1]])},
    "lopsided": {"covariance": np.array([[1.0, 0.5, 0], [0, 1, 0], [0, 0, 1]])},
    "los": {"los": [np.nan, 0, 1]},
    "nowhere": {"los": [0.0, 0, 0]},
    "rate": {"rate": np.inf},
}


@pytest.mark.parametrize("name", BAD)
def test_detections_that_mean_nothing_are_dropped_and_counted(name):
    good = {"position": [9.0, 9, 9], "covariance": np.eye(3), "los": [1.0, 0, 0], "rate": 1.0}
    rows = [good, {**good, **BAD[name]}, {**good, "position": [90.0, 9, 9]}]
    columns = {key: np.array([row[key] for row in rows], float) for key in good}
    target = tracker()
    target.update(0.0, columns["position"], columns["covariance"], columns["los"], columns["rate"])
    assert target.dropped == 1
    assert target.tracks(0.0)["p"].tolist() == [[9.0, 9, 9], [90.0, 9, 9]]


@settings(deadline=None, max_examples=examples(150))
@given(st.integers(0, 2**32 - 1), st.booleans(), st.booleans())
def test_tracks_are_finite_whatever_is_detected(seed, safe, mixes):
    """Sizes and times over many orders of magnitude: beliefs stay finite, symmetric, positive to rounding."""
    rng = np.random.default_rng(seed)
    options = dict.fromkeys(["gates_models", "heavy_tails", "adapts_transition", "winner_takes_all"], safe)
    target, t = tracker(most=8, with_turn=True, mixes=mixes, confirm_hits=2, **options), 0.0
    size = 10.0 ** rng.uniform(-3, 9)
    for _ in range(12):
        t += rng.choice([0, 10.0 ** rng.uniform(-4, 5)])
        n = rng.integers(0, 4)
        root = rng.normal(size=(n, 3, 3)) * 10.0 ** rng.uniform(-9, 4, (n, 1, 1))
        los, rate = rng.normal(size=(n, 3)), 10.0 ** rng.uniform(-3, 3) * rng.normal(size=n)
        position = size * rng.normal(size=(n, 3)) / 5
        target.update(t, position, root @ root.transpose(0, 2, 1), los, rate, 10.0 ** rng.uniform(-6, 1))
        for ahead in (0.0, 0.01, 100.0):
            got = target.tracks(t + ahead)
            assert all(np.isfinite(value).all() for value in got.values())
            for P in got["covariance"]:
                assert np.array_equal(P, P.T)
                scale = np.sqrt(np.maximum(np.diag(P), 1e-300))
                assert np.linalg.eigvalsh(P / np.outer(scale, scale)).min() > -1e-6
            assert np.all((got["turning"] >= 0) & (got["turning"] <= 1))


def test_there_is_no_room_for_more_than_the_most():
    target = tracker(most=2)
    for k in range(2):
        scan(target, k * DT, (0, 0, 0), (100.0, 0, 0), (200.0, 0, 0))
    assert target.tracks(DT)["id"].tolist() == [1, 2]
    assert target.dropped == 2


def test_times_that_mean_nothing_are_refused_and_change_nothing():
    target = tracker()
    scan(target, 1.0, (1, 2, 3))
    before = target.tracks(1.0)
    for t in (0.5, 2e6, np.nan, np.inf):
        with pytest.raises(ValueError, match="time of a scan"):
            scan(target, t, (1, 2, 3))
    for t in (2e6, np.nan):
        with pytest.raises(ValueError, match="time of a prediction"):
            target.tracks(t)
    assert all(np.array_equal(before[name], target.tracks(1.0)[name]) for name in before)


@pytest.mark.parametrize(
    "options",
    [
        {"gate": 0.0},
        {"gate": np.nan},
        {"confirm_hits": 0},
        {"confirm_hits": 7},
        {"confirm_scans": 65},
        {"delete_misses": 0},
        {"acceleration_noise": -1.0},
        {"jerk_noise": np.nan},
        {"turn_noise": np.inf},
        {"start_variance": (1, -1, 1)},
        {"cross_range_variance": np.nan},
        {"mixing_variance": -1.0},
        {"turn_variance": -1.0},
        {"transition": (0.9, 0.2, 0.1, 0.9)},
        {"transition": (1.5, -0.5, 0.1, 0.9)},
        {"prior": (0.5, 0.6)},
        {"with_turn": True, "turn_prior": (1, 1, 1)},
    ],
)
def test_options_that_mean_nothing_are_refused(options):
    with pytest.raises(ValueError, match=r"must|needs|deleted"):
        tracker(**options)


def test_arrays_must_fit():
    target, p, R = tracker(), np.zeros((2, 3)), np.tile(np.eye(3), (2, 1, 1))
    for arguments in (p, R[:1]), (p, R, p), (p, R, p[:1], np.zeros(2)), (p, R, p, np.zeros(1)):
        with pytest.raises(ValueError, match=r"per position|needs"):
            target.update(0.0, *arguments)
    with pytest.raises(ValueError, match="room"):
        tracker(most=0)
    assert len(target.tracks(0.0)["id"]) == 0


def looking():
    """Along x, 40 degrees to each side."""
    return _core.FieldOfView(position=(0.0, 0.0, 0.0), half_azimuth_rad=0.7, max_range_m=100.0)


INSIDE, OUTSIDE = (30.0, 0.0, 0.0), (30.0, 40.0, 0.0)


def confirmed(at, **options):
    """A tracker whose only track, at rest, has just been confirmed; the time of its last scan."""
    target = tracker(**options)
    for k in range(20):
        scan(target, k * DT, at)
    return target, 19 * DT


@pytest.mark.parametrize(
    ("at", "has_field", "coast_s", "lives"),
    [
        (OUTSIDE, True, 1.0, True),
        (INSIDE, True, 1.0, False),  # a scan that should have seen it
        (OUTSIDE, False, 1.0, False),
        (OUTSIDE, True, 0.0, False),
        ((30.0, 25.1, 0.0), True, 1.0, True),  # inside, but by less than its uncertainty
    ],
)
def test_a_track_out_of_sight_coasts(at, has_field, coast_s, lives):
    field = looking() if has_field else None
    target, last = confirmed(at, coast_s=coast_s)
    was = target.tracks(last)["covariance"][0].trace()
    for k in range(1, 20):
        scan(target, last + k * DT, field=field)
    alive = target.tracks(last + 19 * DT)
    assert len(alive["id"]) == lives
    if lives:
        assert alive["covariance"][0].trace() > was
        scan(target, last + 20 * DT, at, field=field)
        assert target.tracks(last + 20 * DT)["id"].tolist() == [1]


def test_coasting_ends():
    target, last = confirmed(OUTSIDE, coast_s=1.0)
    lives = []
    for k in range(1, 40):
        scan(target, last + k * DT, field=looking())
        lives.append(len(target.tracks(last + k * DT)["id"]))
    assert lives == sorted(lives, reverse=True)
    assert 1.0 <= sum(lives) * DT <= 1.0 + 5 * DT  # then misses count


def test_what_is_not_confirmed_does_not_coast():
    target = tracker()
    scan(target, 0.0, OUTSIDE)
    for k in range(1, 6):
        scan(target, k * DT, field=looking())
    assert len(target.tracks(5 * DT)["id"]) == 0
