"""Tubes of moving obstacles in the shield: what is clear of them, and which input is flown because of it."""

import numpy as np
import pytest

from alula import _core
from support.models import backup_model as model
from support.models.wrench_flight import (
    BACKUP,
    HOVER,
    OK,
    RADIUS,
    VEHICLE,
    Flight,
    admissible_start,
    attitude_controlled,
    empty_scene,
    moving,
    random_scene,
    shield_of,
    tick,
    wall_scene,
)

POLICY = _core.BackupPolicy(VEHICLE, "brake")
HORIZON, RISK, ACCELERATION = 1.0, 0.05, 2.0  # the defaults
LEVEL = (HOVER, 0.0, 0.0, 0.0)


def track(position, velocity, covariance=1e-6, radius=0.1, number=1):
    """A row of tracks; a number is a multiple of the identity."""
    full = np.asarray(covariance, float) * (np.eye(6) if np.ndim(covariance) == 0 else 1)
    return np.array([number, *position, *velocity, *full[np.tril_indices(6)], radius])


def random_track(rng, number):
    """One that comes within a few metres of the origin in a second."""
    factor = rng.normal(size=(6, 6)) * rng.uniform(0.005, 0.08)
    at, when = rng.uniform(-2.5, 2.5, 3), rng.uniform(0, 1.5)
    velocity = 3 * rng.normal(size=3)
    return track(at - when * velocity, velocity, factor @ factor.T, rng.uniform(0, 0.3), number)


def gap(positions, row, own):
    """Minimum distance of the vehicle's ball to a tube along a path (N, 3) in steps of 1 ms, then at rest."""
    t = np.arange(0, HORIZON + 1e-9, 0.001)
    covariance = np.zeros((6, 6))
    covariance[np.tril_indices(6)] = row[7:28]
    covariance += np.tril(covariance, -1).T
    to_position = np.concatenate([np.tile(np.eye(3), (len(t), 1, 1)), t[:, None, None] * np.eye(3)], axis=2)
    spread = to_position @ covariance @ to_position.transpose(0, 2, 1) + np.diag(own)
    sigma = np.sqrt(np.linalg.eigvalsh(spread)[:, -1])
    radius = row[28] + np.sqrt((1 - RISK) / RISK) * sigma + ACCELERATION * t**2 / 2
    at = positions[np.minimum(np.arange(len(t)), len(positions) - 1)]
    away = np.linalg.norm(at - row[1:4] - t[:, None] * row[4:7], axis=1)
    return (away - RADIUS - radius).min()


def test_what_clears_the_tubes_agrees_with_samples():
    rng, verdicts, loose = np.random.default_rng(0), [], []
    shield = shield_of(empty_scene())
    for _ in range(8):
        x = np.concatenate(
            [np.zeros(3), 0.1 * rng.normal(size=3), 2 * rng.normal(size=3), rng.normal(size=3)]
        )
        seconds = shield.certify(x)["time_s"]
        positions, _ = model.manoeuvre(VEHICLE, model.Brake(), x, 0.01, round(seconds / 0.01))
        for _ in range(20):
            rows, own = np.array([random_track(rng, i) for i in range(2)]), rng.uniform(0, 1e-3, 3)
            shield.see(tracks=rows, position_variance=own.tolist())
            got = shield.certify(x)
            assert got["safe"]
            least = min(gap(positions, row, own) for row in rows)
            verdicts.append(got["clears_tubes"])
            if got["clears_tubes"]:
                assert least > -1e-5  # tracks are in single precision
            else:
                loose.append(least)
    # The rest at the end counts 1 cm, and a tube counts as at the end of a tick or as a chord of 1/16 s.
    assert max(loose) < 0.08
    assert 40 < sum(verdicts) < 140


def test_tubes_do_not_change_the_static_certificate():
    rng, scene = np.random.default_rng(3), random_scene(np.random.default_rng(3), 60)
    shield = shield_of(scene)
    for _ in range(40):
        x = np.concatenate([rng.uniform(-3, 3, 3), 0.1 * rng.normal(size=3), *rng.normal(size=(2, 3))])
        shield.see()
        bare = shield.certify(x)
        shield.see(tracks=np.array([random_track(rng, 1)]))
        seen = shield.certify(x)
        assert bare["clears_tubes"] == bare["rests"]
        assert {**seen, "clears_tubes": 0} == {**bare, "clears_tubes": 0}


@pytest.mark.parametrize("kind", [_core.ConeBackup, _core.ConeEcbf, _core.ShieldFilter])
def test_without_tracks_nothing_changes_in_any_bit(kind):
    """No tracks, none in an array, and one that is far away."""
    rng, scene = np.random.default_rng(5), wall_scene()
    map_ = _core.EllipsoidMap(scene.index)
    far = np.array([track((500, 0, 0), (1, 0, 0))])
    made = (
        [kind(POLICY, map_, RADIUS) for _ in range(3)]
        if kind is _core.ShieldFilter
        else [kind(POLICY, scene.index) for _ in range(3)]
    )
    for _ in range(60):
        x = np.concatenate([rng.uniform(0, 2.7, 1), rng.normal(size=2), *0.2 * rng.normal(size=(3, 3))])
        x[6] += 2
        u = (HOVER + rng.normal(), *0.02 * rng.normal(size=3))
        answers = [
            tick(one, x, u, **more)
            for one, more in zip(made, ({}, {"tracks": np.empty((0, 29))}, {"tracks": far}), strict=True)
        ]
        assert answers[0] == answers[1] == answers[2]
        assert answers[0]["certified_moving"] == answers[0]["certified"]


def filters():
    index = empty_scene().index
    return [
        _core.ShieldFilter(POLICY, _core.EllipsoidMap(index), RADIUS),
        _core.ConeBackup(POLICY, index),
        _core.ConeEcbf(POLICY, index),
    ]


CROSSING = np.array([track((2.2, -2.0, 0), (0, 3.0, 0))])  # in the way of a vehicle at 3 m/s, 0.7 s ahead


@pytest.mark.parametrize("number", range(3))
def test_a_vehicle_stops_before_a_tube_that_crosses_its_way(number):
    flown, free = filters()[number], filters()[number]
    x = moving((3, 0, 0), (0.1, 0, 0))
    assert shield_of(empty_scene()).certify(x)["safe"]
    ahead = tuple(attitude_controlled(VEHICLE, x, (4.0, 0, 0)))
    got = tick(flown, x, ahead, tracks=CROSSING)
    assert tick(free, x, ahead)["status"] != BACKUP
    assert got["certified"]
    if got["status"] == BACKUP:
        assert got["certified_moving"]


def test_braking_wins_where_only_it_is_clear_and_the_candidate_where_nothing_is():
    shield, found = shield_of(empty_scene()), set()
    for start in np.linspace(-1.5, 1.5, 61):
        flown, x = filters()[0], moving((3, 0, 0), (start, 0, 0))
        u = tuple(attitude_controlled(VEHICLE, x, (6.0, 0, 0)))
        shield.see(tracks=CROSSING)
        ahead, stop = shield.certify(x, first=u)["clears_tubes"], shield.certify(x)["clears_tubes"]
        got = tick(flown, x, u, tracks=CROSSING)
        assert got["certified"]
        assert got["certified_moving"] or not (ahead or stop)
        if ahead or not got["certified_moving"]:
            assert (got["status"], got["wrench"]) == (OK, list(u))
        else:  # braking, gently or at once, as far as it stays clear
            assert got["status"] == BACKUP
        found.add((ahead, stop, got["certified_moving"]))
    assert {(True, True, True), (False, True, True), (False, False, False)} <= found


def test_an_evading_command_is_flown_until_it_is_clear():
    """A ball comes straight at a hovering vehicle: to hover is clear at first, then what evades is flown."""
    flown, x, seen = filters()[0], moving((0, 0, 0)), []
    for step in range(60):
        row = np.array([track((-2.5 + 0.05 * step, 0, 0), (5.0, 0, 0))])
        u = tuple(attitude_controlled(VEHICLE, x, (0, 12.0, 0) if step > 5 else (0, 0, 0)))
        got = tick(flown, x, u, tracks=row)
        assert got["certified"]
        if not got["certified_moving"]:
            assert got["wrench"] == list(u)
        seen.append(got["certified_moving"])
        x = np.array(shield_of(empty_scene()).after(x, tuple(got["wrench"])))
        assert np.linalg.norm(x[:3] - row[0, 1:4]) > RADIUS + 0.1
    assert not seen[8]
    assert seen[-1]


@pytest.mark.parametrize(
    ("place", "bad"),
    [(1, np.nan), (5, np.inf), (7, -1.0), (8, np.nan), (27, np.inf), (28, -0.1), (28, np.nan)],
)
def test_a_track_without_meaning_is_everywhere(place, bad):
    row = track((50, 0, 0), (0, 0, 0))
    row[place] = bad
    for flown in filters():
        got = tick(flown, moving((1, 0, 0)), LEVEL, tracks=np.array([row]))
        assert got["certified"]
        assert not got["certified_moving"]
        assert got["wrench"] == list(LEVEL)


def test_more_tracks_than_the_capacity_or_a_variance_without_meaning_are_everywhere():
    row = track((50, 0, 0), (0, 0, 0))
    for tracks, own in (
        (np.tile(row, (129, 1)), (0, 0, 0)),
        (row[None], (0, np.nan, 0)),
        (row[None], (0, -1, 0)),
    ):
        got = tick(filters()[0], moving((0, 0, 0)), LEVEL, tracks=tracks, position_variance=own)
        assert got["certified"]
        assert not got["certified_moving"]
    assert tick(filters()[0], moving((0, 0, 0)), LEVEL, tracks=np.tile(row, (128, 1)))["certified_moving"]


@pytest.mark.parametrize(
    "options",
    [{"tube_risk": 0.0}, {"tube_risk": 1.0}, {"tube_horizon_s": 0.0}, {"tube_acceleration_m_s2": -1.0}],
)
def test_tubes_without_meaning_are_refused(options):
    with pytest.raises(ValueError, match="tube_"):
        _core.ShieldOptions(**options)


def test_a_wider_tube_is_clear_less_often():
    x, rows = moving((1.0, 0, 0)), np.array([track((0.7, -1.0, 0), (0, 1.0, 0), 1e-3)])
    clear = []
    for options in ({}, {"tube_risk": 0.6}, {"tube_acceleration_m_s2": 0.0}, {"tube_horizon_s": 0.3}):
        shield = shield_of(empty_scene(), **options)
        shield.see(tracks=rows)
        clear.append(shield.certify(x)["clears_tubes"])
    assert clear == [False, False, False, True]


def test_no_track_takes_the_static_certificate_from_a_flight():
    for seed in range(3):
        rng = np.random.default_rng(seed)
        scene = random_scene(rng)
        for kind in ("brake", "cone-escape"):
            policy = _core.BackupPolicy(VEHICLE, kind)
            flown = Tracked(_core.ConeBackup(policy, scene.index), rng)
            x = admissible_start(rng, _core.Shield(policy, scene.index))
            goal = 8 * rng.normal(size=3)
            flight = Flight(
                scene, VEHICLE, flown, x, lambda _, x, a=goal: attitude_controlled(VEHICLE, x, a), 120
            )
            assert all(report["certified"] for report in flight.reports)
            assert flight.clearance >= 0.01
            moving_too = [report["certified_moving"] for report in flight.reports]
            assert any(moving_too)


class Tracked:
    """A filter that sees a random track, another one every 20 ticks."""

    def __init__(self, native, rng):
        self.native, self.rng, self.count = native, rng, 0

    def filter(self, x, *args, **kwargs):
        if self.count % 20 == 0:
            self.row = random_track(self.rng, 1)
            self.row[1:4] += x[:3]
        self.count += 1
        self.row[1:4] += 0.01 * self.row[4:7]
        return self.native.filter(x, *args, tracks=self.row[None].copy(), **kwargs)
