"""Filters of tracks against references and against themselves: consistency, and the additions of SAFE-IMM."""

import numpy as np
import pytest
from scipy.stats import chi2

from support.flights.tracked import SIGMA, scan, tracker
from support.models.imm_model import Reference, SafeReference

DT = 0.05
WIDE = {"gate": 1e12}  # everything is taken
SINGLE = {"velocity": {"prior": (1, 0)}, "acceleration": {"prior": (0, 1)}}
STAY = (1, 0, 0, 1)
SAFE = dict.fromkeys(["gates_models", "heavy_tails", "adapts_transition", "winner_takes_all"], True)
LENT = {"acceleration": 3.0, "turn": 0.1}  # variances, to the models that have these
THREE = np.array([[0.986, 0.010, 0.004], [0.010, 0.986, 0.004], [0.015, 0.015, 0.970]])


def flight(rng, steps, doppler):
    """Detections of something that flies straight, then turns; at irregular times, some missing."""
    p, v, t, rows = np.array([40.0, 5.0, 10.0]), np.array([-7.0, 1.0, 0.3]), 3.0, []
    for k in range(steps):
        dt = rng.uniform(0.02, 0.1)
        a = np.array([0.0, 0.0, 0.0]) if k < steps // 2 else np.cross([0, 0, 0.4], v)
        p, v, t = p + dt * v + dt**2 / 2 * a, v + dt * a, t + dt
        root = rng.normal(size=(3, 3)) * 0.15
        R = root @ root.T + 0.01 * np.eye(3)
        z = None if k > 0 and rng.uniform() < 0.15 else rng.multivariate_normal(p, R)
        los = p / np.linalg.norm(p)
        rate = {"los": los, "rate": los @ v + 0.1 * rng.normal(), "sigma": 0.1} if doppler else {}
        rows.append((t, dt, z, R, rate))
    return rows


def follow(rows, reference, **options):
    """The largest difference to the reference over a flight, also 30 ms after each scan."""
    target, worst = tracker(**WIDE, **options), 0.0
    for k, (t, dt, z, R, rate) in enumerate(rows):
        seen = z is not None
        doppler = {"los": rate["los"][None], "range_rate": np.array([rate["rate"]])} if rate and seen else {}
        target.update(
            t, z[None] if seen else np.zeros((0, 3)), R[None] if seen else np.zeros((0, 3, 3)), **doppler
        )
        if k == 0:
            reference.start(z, R, **rate)
        else:
            reference.predict(dt)
            if seen:
                reference.correct(z, R, **rate)
        for ahead in (0.0, 0.03):
            x, P, a = reference.read(ahead)
            got = target.tracks(t + ahead)
            assert got["id"].tolist() == [1]
            errors = (
                np.concatenate([got["p"][0], got["v"][0]]) - x,
                (got["covariance"][0] - P) / max(1.0, np.abs(P).max()),
                got["a"][0] - a,
                got["turning"][0] - (1 - reference.mu[0] if reference.kinds[0] == "velocity" else 1),
            )
            worst = max(worst, *(np.abs(e).max() for e in errors))
    return worst


@pytest.mark.parametrize("kind", ["velocity", "acceleration"])
@pytest.mark.parametrize("doppler", [False, True])
def test_a_single_model_is_a_kalman_filter(kind, doppler):
    rows = flight(np.random.default_rng(1), 80, doppler)
    reference = Reference([kind], [[1.0]], [1.0], lent={})
    assert follow(rows, reference, transition=STAY, **SINGLE[kind]) < 1e-9


@pytest.mark.every(4)
@pytest.mark.parametrize("mixes", [False, True])
@pytest.mark.parametrize("doppler", [False, True])
@pytest.mark.parametrize("turn", [False, True])
def test_the_models_interact_as_in_the_reference(mixes, doppler, turn):
    rows = flight(np.random.default_rng(2), 80, doppler)
    kinds = ["velocity", "acceleration", "turn"][: 3 if turn else 2]
    transition = THREE if turn else [[0.992, 0.008], [0.015, 0.985]]
    prior = [0.9, 0.05, 0.05] if turn else [0.9, 0.1]
    reference = Reference(kinds, transition, prior, lent=LENT, mixes=mixes)
    assert follow(rows, reference, with_turn=turn, mixes=mixes) < 1e-9
    assert reference.mu[0] < 0.9  # there was something to tell apart


@pytest.mark.every(3)
@pytest.mark.parametrize("turn", [False, True])
@pytest.mark.parametrize("jamming", [False, True])
def test_safe_imm_is_as_in_the_reference(turn, jamming):
    rng = np.random.default_rng(3)
    rows = flight(rng, 120, doppler=True)
    rows = [
        (t, dt, None if z is None else z + np.array([0, 0, 3.0 * (k > 40 and rng.uniform() < 0.1)]), R, rate)
        for k, (t, dt, z, R, rate) in enumerate(rows)
    ]
    kinds = ["velocity", "acceleration", "turn"][: 3 if turn else 2]
    transition = THREE if turn else [[0.992, 0.008], [0.015, 0.985]]
    prior = [0.9, 0.05, 0.05] if turn else [0.9, 0.1]
    reference = SafeReference(kinds, transition, prior, lent=LENT)
    reference.jamming = jamming
    assert follow(rows, reference, with_turn=turn, jamming=jamming, **SAFE) < 1e-8
    assert reference.seen == {"gated", "heavy", "hard", "soft"}


def within(value, dof, samples):
    """Whether a sum of squares over independent samples fits chi^2, at one in a million."""
    low, high = chi2.ppf([5e-7, 1 - 5e-7], dof * samples)
    return low <= value <= high


@pytest.mark.parametrize("kind", ["velocity", "acceleration"])
def test_a_filter_that_knows_the_motion_is_consistent(kind):
    """Targets far apart in one tracker are independent samples: errors and innovations fit chi^2."""
    rng, n, q = np.random.default_rng(7), 150, 0.5
    grid = 1e4 * np.arange(n)[:, None] * [1.0, 0, 0]
    p, v, a = grid.copy(), rng.normal(0, 5, (n, 3)), np.zeros((n, 3))
    order = 2 if kind == "velocity" else 3
    if order == 3:
        a = rng.normal(0, 2, (n, 3))
    root = np.linalg.cholesky(q * noise_of(order))
    target = tracker(
        200, transition=STAY, start_variance=(0, 25, 4), acceleration_noise=q, jerk_noise=q, **SINGLE[kind]
    )
    for k in range(40):
        z = p + SIGMA * rng.normal(size=(n, 3))
        before = target.tracks(k * DT)
        if k > 0:
            S = before["covariance"][:, :3, :3] + SIGMA**2 * np.eye(3)
            assert within(squared(z - before["p"], S), 3, n)
        scan(target, k * DT, z)
        after = target.tracks(k * DT)
        assert after["id"].tolist() == list(range(1, n + 1))
        error = np.hstack([after["p"] - p, after["v"] - v])
        assert within(squared(error, after["covariance"]), 6, n)
        w = np.einsum("ij,njk->nik", root, rng.normal(size=(n, order, 3)))
        p = p + DT * v + DT**2 / 2 * a + w[:, 0]
        v = v + DT * a + w[:, 1]
        if order == 3:
            a = a + w[:, 2]


def noise_of(order):
    """Of white noise through `order` integrators over DT."""
    power = np.arange(order)[::-1]
    factorial = np.array([1, 1, 2])[power]
    total = power[:, None] + power + 1
    return DT**total / (total * factorial[:, None] * factorial)


def squared(error, covariance):
    """Sum of squared Mahalanobis distances."""
    return np.sum(error * np.linalg.solve(covariance, error[..., None])[..., 0])


@pytest.mark.parametrize("safe", [False, True])
def test_mixtures_do_not_promise_too_much(safe):
    """Errors of straight and manoeuvring targets are about as large as the covariances say, or smaller."""
    rng, n = np.random.default_rng(8), 120
    p = 1e4 * np.arange(n)[:, None] * [1.0, 0, 0]
    v = rng.normal(0, 5, (n, 3))
    pull = rng.normal(size=(n, 3))
    pull *= 2.0 / np.linalg.norm(pull, axis=1, keepdims=True)
    target = tracker(200, **(SAFE if safe else {}))
    nees = []
    for k in range(100):
        a = pull if 50 <= k < 80 else np.zeros((n, 3))
        scan(target, k * DT, p + SIGMA * rng.normal(size=(n, 3)))
        got = target.tracks(k * DT)
        assert len(got["id"]) == n
        nees.append(squared(np.hstack([got["p"] - p, got["v"] - v]), got["covariance"]) / n / 6)
        p, v = p + DT * v + DT**2 / 2 * a, v + DT * a
    assert max(nees) < 1.3
    assert min(nees) > 0.3


def straight(target, scans, rng, v=(6.0, 0.0, 0.0), jump=()):
    """Read-outs of something straight; `jump` moves some detections: (scan, offset)."""
    seen = []
    for k in range(scans):
        z = np.array(v) * k * DT + SIGMA * rng.normal(size=3) + dict(jump).get(k, 0.0)
        scan(target, k * DT, z)
        seen.append(target.tracks(k * DT))
    return seen


def turning(seen):
    return np.array([s["turning"][0] for s in seen])


def test_a_gated_model_does_not_take_an_outlier():
    """Constant acceleration leaves it out; under jamming the gate is twice as wide and it does not."""
    jump, a = {60: np.array([0.0, 1.8, 0.0])}, {}
    for name, options in {
        "open": {},
        "gated": {"gates_models": True},
        "jammed": {"gates_models": True, "jamming": True},
    }.items():
        seen = straight(tracker(**WIDE, **options), 61, np.random.default_rng(0), jump=jump.items())
        a[name] = seen[-1]["a"][0] - seen[-2]["a"][0]
    assert np.abs(a["gated"][1]) < 0.1 * np.abs(a["open"][1])
    assert np.array_equal(a["jammed"], a["open"])


def test_heavy_tails_do_not_believe_outliers():
    """The probabilities of the models move less with bad detections, whatever the degrees of freedom."""
    jump = {k: np.array([0.0, 4.0, 0.0]) for k in (60, 66, 72)}
    swing = []
    for options in {}, {"heavy_tails": True}, {"heavy_tails": True, "jamming": True}:
        moved = []
        for seed in range(8):
            seen = straight(tracker(**WIDE, **options), 80, np.random.default_rng(seed), jump=jump.items())
            moved.append(np.abs(np.diff(turning(seen))[[k - 1 for k in jump]]))
        swing.append(np.mean(moved))
    assert max(swing[1:]) < 0.5 * swing[0]


def manoeuvre(target, rng, a=(0.0, 3.0, 0.0)):
    """Straight for 60 scans, then accelerating for 40; the read-outs."""
    p, v, seen = np.zeros(3), np.array([6.0, 0, 0]), []
    for k in range(100):
        scan(target, k * DT, p + SIGMA * rng.normal(size=3))
        seen.append(target.tracks(k * DT))
        now = np.array(a) if k >= 60 else np.zeros(3)
        p, v = p + DT * v + DT**2 / 2 * now, v + DT * now
    return seen


def test_an_adapted_transition_follows_a_manoeuvre_sooner():
    """More of its acceleration is known after a second; the price is more of it where there is none."""
    onset, rest = [], []
    for options in {}, {"adapts_transition": True}:
        runs = [manoeuvre(tracker(**options), np.random.default_rng(seed)) for seed in range(10)]
        onset.append(np.mean([run[k]["a"][0, 1] for run in runs for k in range(70, 80)]))
        rest.append(np.mean([turning(run)[30:60].mean() for run in runs]))
    assert 1.3 * onset[0] < onset[1] < 3.0
    assert rest[0] < 0.2 < rest[1]


def test_the_winner_is_read_alone():
    """Straight: exactly no acceleration. Manoeuvre: all of constant acceleration's, not its share."""
    mixed = manoeuvre(tracker(), np.random.default_rng(4), a=(0.0, 6.0, 0.0))
    hard = manoeuvre(tracker(winner_takes_all=True), np.random.default_rng(4), a=(0.0, 6.0, 0.0))
    assert np.array_equal(turning(mixed), turning(hard))  # the probabilities stay soft
    for k in range(50, 58):
        assert np.array_equal(hard[k]["a"], np.zeros((1, 3)))
        assert mixed[k]["a"].all()
    for k in range(80, 100):
        assert 0.5 < mixed[k]["turning"][0] < 1
        assert hard[k]["a"] * mixed[k]["turning"] == pytest.approx(mixed[k]["a"], rel=1e-12)


def test_a_turn_model_knows_a_turn():
    """A circle at a constant rate: the third model's mixture is nearer to the velocity than without it."""
    errors = []
    for with_turn in False, True:
        rng, target, error = np.random.default_rng(6), tracker(with_turn=with_turn), []
        for k in range(160):
            angle = 1.2 * k * DT
            p = 8 / 1.2 * np.array([np.sin(angle), -np.cos(angle), 0])
            scan(target, k * DT, p + SIGMA * rng.normal(size=3))
            got = target.tracks(k * DT)
            error.append(np.linalg.norm(got["v"][0] - 8 * np.array([np.cos(angle), np.sin(angle), 0])))
        errors.append(np.sqrt(np.mean(np.square(error[60:]))))
    assert errors[1] < 0.9 * errors[0]


def test_perfect_sensors_leave_covariances_positive():
    """Nearly no noise after a wide start, several scans at one time: symmetric, positive semidefinite."""
    for with_turn in False, True:
        target = tracker(with_turn=with_turn, start_variance=(1e6, 1e6, 1e6))
        los = np.array([[0.6, 0.8, 0.0]])
        for k in range(50):
            p = np.array([30 - 4 * k * DT, 1e3, -7.0])
            for _ in range(2):
                rate = np.array([-4 * 0.6])
                scan(target, k * DT, p, sigma=0.0, los=los, range_rate=rate, range_rate_sigma=0.0)
            got = target.tracks(k * DT)
            P = got["covariance"][0]
            assert np.array_equal(P, P.T)
            assert np.linalg.eigvalsh(P).min() > -1e-14 * np.trace(P)
        assert got["id"].tolist() == [1]
        assert got["p"][0] == pytest.approx(p, abs=1e-3)
