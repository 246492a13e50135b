"""The stack of onboard filters from Python: parts alone, walls, loops, refusals, and flights among hulls."""

import numpy as np
import pytest

from alula import _core
from alula.stages.compression.onboard.layout import encode_map
from support.fabricate import exact_hull, make_cover
from support.maps import decode, half_spaces

G = 0.05  # edge of a voxel [m]
OK, FILTERED, _, RECOVERING, REFUSED = range(5)
OUTCOMES = ("passed", "blended", "backup", "no-pilot", "hand-over", "refused")
EXTENT, RADIUS, ROOM, BRAKE, BALL = 8.0, 0.1, 0.1, 3.36, 0.12
HULLS = {"radius_m": 0.2, "beta": 0.6, "kappa": 50.0, "dt_s": 0.01, "v_max": 1.5}
MOVING = {"radius_m": RADIUS, "latency_s": 0.08, "clearance_m": 0.5, "wall_room_m": ROOM, "v_max": 4.0}
FENCE = {"radius_m": RADIUS, "reserve_m": 0.05, "tick_s": 0.01}
HALF = np.array([3.0, 3.0, 1.5])
LOW, HIGH = -HALF - 0.8, HALF + 0.8
NO_WALLS, NO_TRACKS = np.empty((0, 4)), np.empty((0, 29))


def cover(count=24):
    """Round hulls, 0.4 to 0.8 m across."""
    rng, parts = np.random.default_rng(1), []
    for _ in range(count):
        way = rng.normal(size=(30, 3))
        way /= np.linalg.norm(way, axis=1)[:, None]
        parts.append(
            exact_hull(np.rint(rng.uniform(-HALF, HALF) / G + way * rng.uniform(4, 8, 3)).astype(int))
        )
    return make_cover(parts, g=G)


COVER = cover()
IMAGE = encode_map(COVER, indexed=True)


def unit_rows(hull):
    """Unit normals and offsets (n, 4) of a decoded hull [m]."""
    rows = np.array([(*normal, offset * G) for normal, offset in half_spaces(hull)], float)
    return rows / np.linalg.norm(rows[:, :3], axis=1)[:, None]


ROWS = [unit_rows(hull) for hull in decode(encode_map(COVER, indexed=False))]


def psi(p):
    """The value of each hull at a position, and the normal of the plane that decides it."""
    values = [rows[:, :3] @ p - rows[:, 3] for rows in ROWS]
    normals = [rows[np.argmax(v), :3] for rows, v in zip(ROWS, values, strict=True)]
    return np.array([v.max() for v in values]), np.array(normals)


def geofence():
    return _core.Geofence(_core.Fence(box=(tuple(LOW.tolist()), tuple(HIGH.tolist()))), parameters=FENCE)


def stack(takes="velocity", gives="sticks", *, hulls=True, moving=True, fence=True, **others):
    parts = {"extent_m": EXTENT}
    if hulls:
        parts |= {"image": IMAGE, "polytope_cbf": _core.PolytopeCbfConfig(**HULLS)}
    if moving:
        parts |= {"dr_acbf": MOVING}
    if fence:
        parts |= {"geofence": geofence()}
    return _core.OnboardStack(takes, gives, **(parts | others))


def single(x):
    """Round to single precision."""
    return np.asarray(x, np.float32).astype(float)


def states(count, seed=3):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        turn = rng.normal(size=4)
        yield single(
            np.r_[
                rng.uniform(LOW, HIGH), rng.uniform(-2, 2, 3), turn / np.linalg.norm(turn), rng.normal(size=3)
            ]
        )


def ball(p, v, number):
    spread = np.diag([1e-4, 1e-4, 1e-4, 1e-2, 1e-2, 1e-2])[np.tril_indices(6)]
    return single(np.concatenate([[number], p, v, spread, [BALL]]))[None]


def test_polytope_cbf_alone_has_its_own_bits():
    one = stack(gives="velocity", moving=False, fence=False)
    other = _core.PolytopeCbf.from_image(IMAGE, extent_m=EXTENT, **HULLS)
    rng, seen = np.random.default_rng(5), set()
    for x in states(200):
        u_nom = single(rng.normal(size=3))
        result = one.filter(x, u_nom, NO_TRACKS, NO_WALLS)
        u, status, margin, _, _ = other.filter(x[:3].tolist(), u_nom.tolist())
        assert (result.status, result.margin_m) == (status, margin)
        assert (result.velocity == u).all()
        assert (result.acceleration == 0).all()
        assert (result.sticks == 0).all()
        seen.add(status)
    assert {OK, FILTERED, RECOVERING} <= seen


def test_dr_acbf_alone_has_its_own_bits():
    one = stack("acceleration", "acceleration", hulls=False, fence=False)
    other = _core.moving_filter("dr_acbf", MOVING)
    rng, floor, seen = np.random.default_rng(5), np.array([[0.0, 0.0, 1.0, 1.0]]), set()
    for x in states(200):
        a = single(rng.normal(scale=3, size=3))
        tracks = ball(x[:3] + rng.normal(size=3), rng.normal(scale=2, size=3), 4)
        result = one.filter(x, a, tracks, floor)
        report = other.filter(x[:3].tolist(), x[3:6].tolist(), tracks, floor, a.tolist())[0]
        assert (result.status, result.rows, result.mode) == (report.status, report.rows, report.mode)
        assert (result.acceleration == report.acceleration).all()
        seen.add(report.status)
    assert {FILTERED, RECOVERING} <= seen


def test_the_geofence_alone_has_its_own_bits():
    one, other = stack("sticks", hulls=False, moving=False), geofence()
    rng, seen = np.random.default_rng(5), set()
    for x in states(200):
        pilot = single(rng.uniform([0, -6, -6, -3], [1, 6, 6, 3]))
        if rng.uniform() < 0.1:
            x[int(rng.integers(13))] = np.inf
        if rng.uniform() < 0.1:
            pilot[int(rng.integers(4))] = np.nan
        result = one.filter(x, pilot, NO_TRACKS, NO_WALLS)
        command, outcome, detail = other.filter(x, pilot)
        assert OUTCOMES[result.outcome] == outcome
        assert (result.sticks == command).all()
        assert (result.h_i, result.regulation) == (detail["h_i"], detail["lambda"])
        seen.add(outcome)
    assert {"blended", "backup", "no-pilot"} <= seen


def binding_distance(speed):
    """Distance of a wall whose row just allows all accelerations of the box, head-on at this speed."""
    dt, lag, a_max = 0.01, MOVING["latency_s"] + BRAKE / (2 * 60), 6.0
    stop = speed + (np.sqrt(3) * a_max + BRAKE) * (dt + lag)
    return stop**2 / (2 * BRAKE) + speed * lag + RADIUS + ROOM


def test_walls_are_the_planes_before_which_the_vehicle_could_stop_from_the_least_additional_speed():
    one, counts = stack(), set()
    for x in states(100):
        one.reset()
        result = one.filter(x, np.zeros(3), NO_TRACKS, NO_WALLS)
        found = one.walls(result)
        gap, normal = psi(x[:3])
        gap = np.r_[gap, x[:3] - LOW, HIGH - x[:3]]
        normal = np.vstack([normal, np.eye(3), -np.eye(3)])
        reach = binding_distance(np.linalg.norm(x[3:6]))
        order = np.argsort(gap)
        _, first = np.unique(np.round(normal[order], 9) + 0.0, axis=0, return_index=True)
        order = order[first]  # of equal normals the nearest
        order = order[gap[order] < reach]
        gap, normal = gap[order], normal[order]
        room = gap - RADIUS - ROOM
        spare = np.copysign(np.sqrt(2 * BRAKE * np.abs(room)), room) + normal @ x[3:6]
        assert len(found) == result.walls
        assert result.walls == min(8, len(gap)) or np.abs(gap - reach).min() < 1e-3
        assert result.walls_are_full == (result.walls == 8)
        for wall, k in zip(found, np.argsort(spare), strict=False):
            away = np.abs(normal - wall[:3]).max(axis=1) + np.abs(gap - wall[3])
            near = int(away.argmin())
            assert away[near] < 1e-3
            assert wall[3] <= gap[near] + 1e-6
            assert spare[near] <= spare[k] + 1e-2
        counts.add(result.walls)
    assert {8} < counts


def test_walls_of_the_caller_come_first_and_count_beside_those_that_are_found():
    given = single([[0.0, 0.0, 1.0, 1.0], [0.6, 0.8, 0.0, 2.0]])
    one = stack(most_walls=3)
    x = next(states(1))
    result = one.filter(x, np.zeros(3), NO_TRACKS, given)
    assert result.walls == 5
    assert (one.walls(result)[:2] == given).all()


def test_the_loops_turn_a_velocity_into_the_thrust_and_tilt_of_its_acceleration():
    """Far from all constraints: a = 2.5 (v_d - v), level at first, so thrust is that of a_z + g."""
    one = stack("velocity", "sticks", hulls=False, fence=False)
    x = np.r_[np.zeros(3), 0.3, -0.2, 0.1, 1, np.zeros(6)]
    wanted = np.array([0.5, 0.4, 0.9])
    result = one.filter(x, wanted, NO_TRACKS, NO_WALLS)
    a = 2.5 * (wanted - x[3:6])
    assert result.status == OK
    assert result.acceleration == pytest.approx(a, abs=1e-6)
    thrust = 7.75474 * result.sticks[0] + 73.895455 * result.sticks[0] ** 2
    assert thrust == pytest.approx(a[2] + 9.81, abs=1e-4)
    force = a + np.array([0, 0, 9.81])
    axis = force / np.linalg.norm(force)
    assert result.sticks[1:] == pytest.approx(10 * np.array([-axis[1], axis[0], 0]), abs=1e-4)
    turning = one.filter(x, wanted, NO_TRACKS, NO_WALLS, yaw_rate_rad_s=0.7)
    assert turning.sticks[3] == pytest.approx(0.7, abs=1e-4)
    fast = one.filter(x, np.array([20.0, -9.0, 4.0]), NO_TRACKS, NO_WALLS).acceleration
    assert np.abs(fast).max() == 6
    assert fast / 6 == pytest.approx((np.array([20, -9, 4]) - x[3:6]) / 19.7, abs=1e-6)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_numbers_that_are_not_finite_are_refused_and_nothing_of_them_is_flown(bad):
    x = next(states(1))
    x[6:10] = 1, 0, 0, 0
    for fence in (True, False):
        one = stack(fence=fence)
        for field in range(3 + 13):
            assert one.filter(x, np.ones(3), NO_TRACKS, NO_WALLS).status < REFUSED
            at, nominal = x.copy(), np.ones(3)
            if field < 3:
                nominal[field] = bad
            else:
                at[field - 3] = bad
            result = one.filter(at, nominal, NO_TRACKS, NO_WALLS)
            assert result.status == REFUSED
            commands = np.concatenate([result.velocity, result.acceleration, result.sticks])
            assert np.isfinite(commands).all()
            if field < 6:
                assert (result.velocity == 0).all()
            if field >= 3 and not fence:
                hover = _core.RacerModel().throttle_for(9.81)
                assert result.sticks == pytest.approx([hover, 0, 0, 0], abs=1e-6)


@pytest.mark.parametrize(
    ("takes", "gives", "others"),
    [
        ("velocity", "sticks", {"hulls": False, "moving": False, "fence": False}),
        ("acceleration", "sticks", {}),
        ("sticks", "sticks", {}),
        ("velocity", "acceleration", {}),
        ("velocity", "sticks", {"moving": False}),
        ("velocity", "sticks", {"moving": False, "fence": False}),
        ("velocity", "velocity", {"fence": False}),
        ("velocity", "sticks", {"velocity_gain": 2.3}),
        ("velocity", "sticks", {"most_walls": 1000}),
        ("velocity", "sticks", {"dr_acbf": MOVING | {"dt_s": 0.02}}),
        ("velocity", "sticks", {"dr_acbf": MOVING | {"a_max": 9.6}}),
        ("velocity", "sticks", {"dr_acbf": MOVING | {"speed": 1.0}}),
        ("velocity", "sticks", {"image": IMAGE[:-1]}),
        ("position", "sticks", {}),
        ("sticks", "velocity", {"hulls": False, "moving": False}),
    ],
)
def test_bad_combinations_raise(takes, gives, others):
    with pytest.raises(ValueError, match=r"stack|no such option|truncated"):
        stack(takes, gives, **others)


def test_a_nominal_of_another_size_raises():
    with pytest.raises(ValueError, match="3 numbers"):
        stack().filter(next(states(1)), np.zeros(4), NO_TRACKS, NO_WALLS)


def fly(one, seed, *, has_radar, ticks=500):
    """Minimum psi and fence clearance of the centre, hits and throws, in a flight to random goals."""
    rng = np.random.default_rng(seed)

    def place():
        p = rng.uniform(-HALF, HALF)
        while psi(p)[0].min() < 0.35:
            p = rng.uniform(-HALF, HALF)
        return p

    plant = _core.Racer(_core.RacerModel())
    plant.reset(np.r_[place(), 0, 0, 0, 1, np.zeros(6)])
    one.reset()
    goal, closest, fence, hits, throws, is_hit, at, way = place(), np.inf, np.inf, 0, 0, True, None, None
    for tick in range(ticks):
        x = plant.state
        closest = min(closest, psi(x[:3])[0].min())
        fence = min(fence, (x[:3] - LOW).min(), (HIGH - x[:3]).min())
        if tick % 120 == 60:
            start = rng.normal(size=3) * [1, 1, 0.3]
            start *= 4 / np.linalg.norm(start)
            time = 4 / rng.uniform(3, 6)
            at, way, throws, is_hit = x[:3] + start, (0.5 * time * x[3:6] - start) / time, throws + 1, False
        tracks = ball(at, way, throws) if has_radar and throws else NO_TRACKS
        result = one.filter(
            x, 1.5 * (goal - x[:3]) / max(np.linalg.norm(goal - x[:3]), 1.5), tracks, NO_WALLS
        )
        assert result.status < REFUSED
        for _ in range(4):
            plant.step(0.0025, result.sticks)
            if throws:
                at = at + 0.0025 * way
                if not is_hit and np.linalg.norm(at - plant.state[:3]) < RADIUS + BALL:
                    hits, is_hit = hits + 1, True
    return closest, fence, hits, throws


def test_a_vehicle_dodges_thrown_balls_and_touches_neither_hulls_nor_fence():
    one = stack()
    seen, unseen = (
        np.array([fly(one, seed, has_radar=radar) for seed in range(6)]) for radar in (True, False)
    )
    for flights in (seen, unseen):
        assert flights[:, 0].min() > RADIUS
        assert flights[:, 1].min() > RADIUS
    assert seen[:, 3].sum() == 24
    assert seen[:, 2].sum() == 0
    assert unseen[:, 2].sum() > 8
