"""Before take-off: where the vehicle would fly by itself, from every point of the plan."""

import dataclasses
import itertools
import math
import re
import time

import numpy as np
import pytest

from alula._core import PolytopeSet
from alula.schemas.scenarios.vehicle import VelocitiesTable
from alula.stages.flight.links.mavlink.ardupilot_failsafes import ARDUPILOT_SAFETY, ardupilot_safety
from alula.stages.flight.links.mavlink.px4_failsafes import ConeHome
from alula.stages.flight.links.own_safety import Action, OwnSafety, WayHome
from alula.stages.flight.loop.departures import departures_at, departures_of
from alula.stages.flight.loop.failsafe_check import failsafe_faults
from alula.stages.flight.loop.supervisor import Event, State
from alula.stages.flight.loop.ways_home import closest_way_home
from alula.stages.planning.trajectory import evaluate
from alula.stages.sim_vehicle.common.packets import mavlink
from alula.stages.vehicles.velocity_lag import stop_m
from support.flights.flights import mission
from support.scenes.small_scenes import box_cover, line_plan
from support.vehicles.autopilot_client import Client
from support.vehicles.lockstep import Flight, Upset, fault

START, GOAL = (0.3, 2.0, 0.8), (3.7, 2.0, 0.8)
CEILING = [((-30, -30, 25), (80, 80, 28))]  # 2.5 m above the floor, everywhere
DEFAULTS = {
    "FS_THR_ENABLE": 1.0,
    "FS_OPTIONS": 16.0,
    "FS_DR_ENABLE": 2.0,
    "FS_EKF_ACTION": 1.0,
    "FENCE_ENABLE": 0.0,
    "BATT_MONITOR": 4.0,
    "BATT_FS_LOW_ACT": 0.0,
    "BATT_FS_CRT_ACT": 0.0,
    "BATT_LOW_VOLT": 10.5,
    "RTL_ALT": 1500.0,
    "RTL_CLIMB_MIN": 0.0,
    "RTL_CONE_SLOPE": 3.0,
}
LANDS, RETURNS = {"FS_THR_ENABLE": 3.0, "FS_DR_ENABLE": 1.0}, {"FS_THR_ENABLE": 1.0, "FS_DR_ENABLE": 2.0}


def actions(**changed):
    own = ardupilot_safety(DEFAULTS | changed)
    return {each.setting.split()[0]: each.action for each in own.failsafes}


def checked(parameters, cover=CEILING, **words):
    made = mission(cover=box_cover(cover), plan=line_plan(START, GOAL, 5.0), rate_hz=50.0)
    return Flight(made, parameters=parameters, loop_words={"dry_run": True, **words}).fly()


def test_a_return_through_the_ceiling_is_refused_with_the_parameters_to_change():
    flight = checked(RETURNS)
    assert flight.cause is Event.CHECK_FAILED
    words = flight.loop.checks.failure()
    assert words.startswith(
        "failsafes: when its radio is lost (FS_THR_ENABLE is 1) or its satellites are lost "
        "(FS_DR_ENABLE is 2) it flies home "
    )
    assert "(RTL_ALT is 1500 cm); from (" in words
    assert words.endswith(
        "that meets a hull, and 0.150 m are required; set FS_THR_ENABLE to 3 and FS_DR_ENABLE to 1 so that "
        "it does not fly home"
    )


@pytest.mark.every(3)
@pytest.mark.parametrize("parameters", [LANDS, {"RTL_ALT": 150.0}, LANDS | {"BATT_FS_LOW_ACT": 1}])
def test_landing_or_a_return_below_the_ceiling_is_flown(parameters):
    flight = checked(RETURNS | parameters)
    assert flight.cause is Event.CHECKS_PASSED_DRY, flight.loop.checks.failure()


@pytest.mark.every(3)
@pytest.mark.parametrize(
    ("parameters", "setting"),
    [
        ({"FS_THR_ENABLE": 1}, "FS_THR_ENABLE is 1"),
        ({"FS_DR_ENABLE": 2}, "FS_DR_ENABLE is 2"),
        ({"BATT_FS_LOW_ACT": 2}, "BATT_FS_LOW_ACT is 2"),
        ({"BATT_FS_CRT_ACT": 2, "BATT_CRT_MAH": 300}, "BATT_FS_CRT_ACT is 2"),
        ({"FENCE_ENABLE": 1}, "FENCE_ACTION is 1"),
    ],
)
def test_each_failsafe_that_flies_home_is_judged(parameters, setting):
    flight = checked(LANDS | parameters)
    assert flight.cause is Event.CHECK_FAILED
    assert f"({setting}) it flies home" in flight.loop.checks.failure()


@pytest.mark.slow
def test_the_refused_return_does_meet_the_ceiling():
    """Without this check, the same vehicle flies through the ceiling when its radio is lost."""
    made = mission(cover=box_cover(CEILING), plan=line_plan(START, GOAL, 5.0), rate_hz=50.0)
    blind = Flight(made, [Upset(State.FLY, 2.5, fault("radio-loss"))], parameters=RETURNS)
    blind.changes["PARAM_VALUE"] = lambda message: _say_landing(message)
    blind.fly()
    assert blind.cause is Event.FAILSAFE
    assert max(-down for _, _, _, down in blind.truth) > 2.5


def _say_landing(message):
    if (name := message.param_id.rstrip("\0")) in LANDS:
        message.param_value = LANDS[name]


def test_a_way_back_that_is_not_known_is_refused():
    flight = checked(LANDS | {"FS_THR_ENABLE": 5})
    assert "FS_THR_ENABLE is 5: when its radio is lost it flies back along a simplified way" in (
        flight.loop.checks.failure()
    )


@pytest.mark.every(2)
@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        (
            {"FENCE_RADIUS": 3.0},
            "FENCE_ALT_MAX is 100 m; FENCE_RADIUS is 3 m): it goes 0.8 to 0.8 m up and 3.4 m away",
        ),
        ({"FENCE_ALT_MAX": 0.5, "FENCE_TYPE": 1}, "FENCE_ALT_MAX is 0.5 m): it goes 0.8 to 0.8 m up"),
    ],
)
def test_a_plan_beyond_the_vehicles_own_fence_is_refused(parameters, words):
    flight = checked(LANDS | {"FENCE_ENABLE": 1, "FENCE_ACTION": 2} | parameters)
    assert flight.cause is Event.CHECK_FAILED
    assert f"the plan leaves the vehicle's own fence ({words}" in flight.loop.checks.failure()


def test_failsafes_by_their_parameters():
    n, land, home, back = Action.NONE, Action.STOP_OR_LAND, Action.RETURN, Action.RETRACE
    others = {"FS_DR_ENABLE": home, "FS_EKF_ACTION": land, "BATT_FS_LOW_ACT": n}
    assert actions() == {"FS_THR_ENABLE": home} | others
    assert actions(FS_OPTIONS=16.0 + 4.0 + 8.0) == others
    found = [actions(FS_THR_ENABLE=value)["FS_THR_ENABLE"] for value in range(8)]
    assert found == [n, home, home, land, back, back, home, land]
    found = [actions(BATT_FS_LOW_ACT=value)["BATT_FS_LOW_ACT"] for value in range(8)]
    assert found == [n, land, home, back, back, land, home, land]
    fence = {"FENCE_ENABLE": 1.0, "FENCE_TYPE": 7.0, "FENCE_ALT_MAX": 50.0, "FENCE_RADIUS": 30.0}
    found = [actions(**fence, FENCE_ACTION=value)["FENCE_ACTION"] for value in range(6)]
    assert found == [n, home, land, back, land, back]
    own = ardupilot_safety(DEFAULTS | fence | {"FENCE_ACTION": 1.0, "FENCE_MARGIN": 2.0})
    assert (own.highest_m, own.farthest_m, own.way_home.highest_m) == (50.0, 30.0, 48.0)
    assert ardupilot_safety({}).failsafes[0].action is n


def checked_values(values, path=((0.0, 0.0, 1.0), (3.0, 0.0, 1.0)), obstacles=(), **more):
    words = {"home": np.zeros(3), "radius_m": 0.1, "foot_m": 0.1} | more
    return failsafe_faults(
        ardupilot_safety(values), departures_at(np.array(path)), obstacles=obstacles, **words
    )


def test_a_radio_that_is_lost_while_landing_is_judged_unless_that_is_ignored_too():
    (radio,) = [
        each for each in ardupilot_safety(DEFAULTS | {"FS_OPTIONS": 20.0}).failsafes if "radio" in each.cause
    ]
    assert radio.cause == "its radio is lost while it lands"
    assert radio.action is Action.RETURN


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"RALLY_TOTAL": 2.0}, "RALLY_TOTAL is 2: it may fly to a rally point"),
        ({"RTL_ALT_TYPE": 1.0}, "RTL_ALT_TYPE is 1: its height is above the terrain"),
    ],
)
def test_a_return_to_a_place_or_height_that_is_not_known_is_refused_and_a_landing_is_not(changed, words):
    faults, _ = checked_values(DEFAULTS | changed)
    assert len(faults) == 1
    assert words in faults[0]
    assert faults[0].endswith("or set FS_THR_ENABLE to 3 and FS_DR_ENABLE to 1 so that it does not fly home")
    assert checked_values(DEFAULTS | LANDS | changed)[0] == []


@pytest.mark.parametrize("switch", ["FENCE_ENABLE", "FENCE_AUTOENABLE"])
def test_a_fence_with_a_bottom_is_judged_and_one_of_polygons_is_named(switch):
    fence = DEFAULTS | LANDS | {"FENCE_ENABLE": 0.0, switch: 1.0, "FENCE_ACTION": 2.0, "FENCE_ALT_MIN": 1.5}
    faults, _ = checked_values(fence | {"FENCE_TYPE": 8.0})
    assert faults == [
        "the plan leaves the vehicle's own fence (FENCE_ALT_MIN is 1.5 m): it goes 1.0 to 1.0 m up and 3.0 m "
        "away; widen or disable that fence"
    ]
    assert checked_values(fence | {"FENCE_TYPE": 8.0, "FENCE_ALT_MIN": 0.5})[0] == []
    faults, words = checked_values(fence | {"FENCE_TYPE": 7.0, "FENCE_TOTAL": 5.0})
    assert faults == []
    assert "(FENCE_TOTAL is 5) are not judged: keep the plan inside, or set FENCE_TYPE to 3" in words
    assert "judged" not in checked_values(fence | {"FENCE_TYPE": 7.0, "FENCE_TOTAL": 0.0})[1]
    assert "judged" not in checked_values(fence | {"FENCE_TYPE": 3.0, "FENCE_TOTAL": 5.0})[1]


@pytest.mark.parametrize(
    ("action", "words"), [(0, "only reports"), (1, ""), (2, "holds its height"), (3, "")]
)
def test_an_estimate_with_which_it_flies_on_is_named(action, words):
    faults, found = checked_values(DEFAULTS | LANDS | {"FS_EKF_ACTION": float(action)})
    assert faults == []
    assert ("FS_EKF_ACTION" in found) == bool(words)
    assert words in found


def test_heights_in_metres_are_those_in_centimetres():
    since = {name: value for name, value in DEFAULTS.items() if name not in ("RTL_ALT", "RTL_CLIMB_MIN")}
    before = ardupilot_safety(DEFAULTS | {"RTL_ALT": 1230.0, "RTL_CLIMB_MIN": 150.0}).way_home
    way = ardupilot_safety(since | {"RTL_ALT_M": 12.3, "RTL_CLIMB_MIN_M": 1.5})
    assert (way.way_home.height_m, way.way_home.climb_m) == pytest.approx((12.3, 1.5))
    assert (before.height_m, before.climb_m) == pytest.approx((12.3, 1.5))
    assert way.way_home.setting == "RTL_ALT_M is 12.3 m"
    assert way.unknown == ()
    assert set(since) | {"RTL_ALT_M"} <= set(ARDUPILOT_SAFETY)


def box(low, high):
    """An obstacle of any size, as a hull."""
    low, high = np.array(low, float), np.array(high, float)
    corner = np.array(list(itertools.product(*zip(low, high, strict=True))))
    return [
        (
            "a hull",
            PolytopeSet(
                normals=np.vstack([np.eye(3), -np.eye(3)]),
                offsets=np.concatenate([high, -low]),
                plane_start=np.array([0, 6]),
                vertices=corner,
                vertex_start=np.array([0, 8]),
            ),
        )
    ]


def test_ways_to_rest_follow_the_speed_and_its_limit():
    made = line_plan((0, 0, 1), (3, 0, 1), 4.0)
    law, time = (0.4, 0.1), np.linspace(0, 4, 101)
    velocity = evaluate(made["time"], made["coefficient"], time, 1)[:, :3]
    fastest = float(velocity[:, 0].max())
    for limit in (0.5 * fastest, 2 * fastest):
        found = departures_of(made, limit, law).around(np.column_stack([time, time]))
        flown = np.minimum(velocity[:, 0] * max(1.0, limit / fastest), limit)
        assert found.coast[:, 0] == pytest.approx(1.25 * (0.4 + 0.1 * flown) * flown, rel=1e-3)
        assert (found.point_m == 0).all()
        assert (found.coast_m == 0).all()


def test_a_flight_stays_within_the_bounds_of_its_intervals():
    made = line_plan((0, 0, 1), (3, 1, 1.4), 2.0)
    departures = departures_of(made, 3.0, (0.57, 0.185))
    rng = np.random.default_rng(0)
    interval = np.sort(rng.uniform(0, 2.0, (400, 2)) ** rng.choice([1.0, 3.0], (400, 1)), axis=1)
    found = departures.around(interval)
    for share in np.linspace(0, 1, 21):
        at = interval[:, 0] + share * np.ptp(interval, axis=1)
        here = departures.around(np.column_stack([at, at]))
        assert (np.linalg.norm(here.point - found.point, axis=1) <= found.point_m + 1e-12).all()
        assert (np.linalg.norm(here.coast - found.coast, axis=1) <= found.coast_m + 1e-12).all()
    path = evaluate(made["time"], made["coefficient"], np.linspace(0, 2, 5001))[:, :3]
    low, high, away = departures.extent(np.array([0.5, 0.0, 0.2]))
    off = path - [0.5, 0, 0.2]
    assert low <= off[:, 2].min() < low + 0.02
    assert high - 0.02 < off[:, 2].max() <= high
    assert away - 0.02 < np.hypot(off[:, 0], off[:, 1]).max() <= away


def test_a_thin_rod_between_two_samples_is_met():
    """A rod of 2 cm that only ways from a few hundredths of a second of the plan meet."""
    made = line_plan((0.0, 0.0, 1.0), (8.0, 0.0, 1.0), 5.0)
    time = np.linspace(0, 5, 51)
    at = evaluate(made["time"], made["coefficient"], time)[:, 0]
    k = int(np.diff(at).argmax())
    between = 0.5 * (at[k] + at[k + 1])
    assert at[k + 1] - at[k] > 0.3
    rod = box((between - 0.01, -0.01, 2.0), (between + 0.01, 0.01, 2.2))
    words = {"radius_m": 0.05, "foot_m": 0.2}
    way, home = WayHome(6.0), np.array([0.0, 3.0, 0.0])
    all_of_it = departures_of(made, 3.0, (0.0, 0.0))  # it rests at once
    sampled = departures_at(np.column_stack([at, 0 * at, 1 + 0 * at]))
    assert closest_way_home(way, sampled, home, rod, **words).distance_m > 0.13
    met = closest_way_home(way, all_of_it, home, rod, **words)
    assert met.distance_m < 0.05
    assert abs(met.at[0] - between) < 0.1
    own = dataclasses.replace(ardupilot_safety(DEFAULTS), way_home=way)
    assert failsafe_faults(own, sampled, home, rod, **words)[0] == []
    assert len(failsafe_faults(own, all_of_it, home, rod, **words)[0]) == 1
    aside = box((between - 0.01, 0.2, 2.0), (between + 0.01, 0.22, 2.2))
    clear = closest_way_home(way, all_of_it, home, aside, **words)
    assert 0.05 <= clear.distance_m <= 0.2
    assert clear.share == pytest.approx(1.0)
    faults, found = failsafe_faults(own, all_of_it, home, aside, **words)
    assert faults == []
    assert re.search(r"ways home from all of the plan are at least 0\.\d+ m clear of the map", found)


def test_a_rod_that_only_a_vehicle_meets_that_is_half_at_rest_is_met():
    point, coast = np.array([[0.0, 0.0, 1.0]]), np.array([[2.0, 0.0, 0.0]])
    for x in (0.37, 1.0, 1.61):  # rests are judged everywhere on the way, not at three points
        rod = box((x - 0.01, -0.01, 2.0), (x + 0.01, 0.01, 2.2))
        met = closest_way_home(
            WayHome(6.0), departures_at(point, coast), np.zeros(3), rod, radius_m=0.05, foot_m=0.2
        )
        assert met.distance_m < 0.05


@pytest.mark.parametrize(
    "way",
    [
        WayHome(4.0, slope=2.0),
        WayHome(2.5, climb_m=0.5, highest_m=3.0),
        ConeHome(4.0, slope=0.5, near_m=3.0, arrived_m=1.0),
    ],
)
@pytest.mark.parametrize("seed", range(6))
def test_no_way_home_of_ten_thousand_is_closer_than_the_bound(way, seed):
    rng = np.random.default_rng(seed)
    made = line_plan((-4, rng.uniform(-2, 2), 1.0), (4, rng.uniform(-2, 2), 1.3), 6.0)
    home, law = np.array([rng.uniform(-1, 1), rng.uniform(-1, 1), 0.0]), (0.3, 0.1)
    low = np.array([*rng.uniform(-4, 3, 2), rng.uniform(1.8, 3.5)])
    obstacle = box(low, low + rng.uniform(0.02, 1.0, 3))
    departures = departures_of(made, 2.5, law)
    bound = closest_way_home(way, departures, home, obstacle, radius_m=0.05, foot_m=0.2)
    at = rng.uniform(0, 6.0, 10_000)
    here = departures.around(np.column_stack([at, at]))
    rest = here.point + rng.uniform(0, 1, (10_000, 1)) * here.coast
    level = way.heights(rest[:, 2] - home[2], np.hypot(*(rest - home)[:, :2].T))
    knots = [
        here.point,
        rest,
        np.column_stack([rest[:, :2], level]),
        np.column_stack([np.tile(home[:2], (10_000, 1)), level]),
        np.tile([*home[:2], 0.2], (10_000, 1)),
    ]
    least = min(
        float(obstacle[0][1].clearance(np.ascontiguousarray(a), np.ascontiguousarray(b), math.inf, 1).min())
        for a, b in itertools.pairwise(knots)
    )
    assert bound.distance_m <= least + 1e-9
    if bound.distance_m < 0.05:
        assert least < 0.05 + 0.03  # up to the finest set, nothing is refused for nothing
    else:
        assert bound.distance_m >= 0.05 + 0.2 * (least - 0.05)


def test_a_way_home_that_begins_where_the_vehicle_comes_to_rest_meets_what_is_there():
    """A beam above, 0.6 m beyond the end of the path: a vehicle that stops at once never sees it."""
    cover = box_cover([((42, -10, 15), (46, 10, 18))])
    obstacles = mission(cover=cover, plan=line_plan(START, GOAL, 5.0)).obstacles
    path = np.column_stack([np.linspace(0, 3.6, 37), np.zeros(37), np.ones(37)])
    words = {"radius_m": 0.15, "foot_m": 0.2}

    def closest(coast_m):
        coast = np.tile([coast_m, 0.0, 0.0], (37, 1))
        return closest_way_home(WayHome(4.0), departures_at(path, coast), np.zeros(3), obstacles, **words)

    assert closest(0.0).distance_m == pytest.approx(0.6, abs=0.01)
    assert closest(0.8).distance_m <= 0
    assert closest(0.8).coast_m == pytest.approx(0.8)
    assert 0.15 <= closest(0.2).distance_m <= 0.4 + 1e-9


def test_a_wall_ahead_is_met_on_the_way_to_rest():
    """Behind the thin wall it is free again: only the way there meets it."""
    cover = box_cover([((40, -10, 0), (41, 10, 60))])
    obstacles = mission(cover=cover, plan=line_plan(START, GOAL, 5.0)).obstacles
    path = np.array([[3.5, 0.0, 1.0]])
    departures = departures_at(path, np.array([[1.2, 0.0, 0.0]]))
    met = closest_way_home(WayHome(9.0), departures, np.zeros(3), obstacles, radius_m=0.15, foot_m=0.2)
    assert met.distance_m <= 0


def test_the_check_takes_milliseconds():
    rng = np.random.default_rng(1)
    corners = rng.integers(-60, 60, (60, 3))
    cover = box_cover([(corner, corner + 4) for corner in corners])
    made = mission(cover=cover, plan=line_plan(START, GOAL, 5.0), is_clear=True)
    departures = departures_of(line_plan((0, 0, 1), (30, 0, 1), 60.0), 1.0, (0.57, 0.185))
    times = []
    for _ in range(5):
        begin = time.process_time()
        closest_way_home(WayHome(9.0), departures, np.zeros(3), made.obstacles, radius_m=0.15, foot_m=0.2)
        times.append(time.process_time() - begin)
    assert min(times) < 0.1  # for a plan of a minute


@pytest.mark.every(2)
@pytest.mark.parametrize("speed", [1.0, 2.0])
def test_the_simulated_autopilot_turns_home_within_the_distance_that_is_judged(speed):
    client = Client(parameters={"RTL_ALT": 600.0}).fly(3)
    for _ in range(120):
        client.target(7 | 448 | 2048, v=(speed, 0, 0))
        client.wait(0.05)
    begin = client.truth.position[0]
    assert client.command(mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH) == mavlink.MAV_RESULT_ACCEPTED
    farthest = begin
    while client.height < 5.5:
        client.wait(0.1)
        farthest = max(farthest, client.truth.position[0])
    judged = stop_m(VelocitiesTable().horizontal_lag, speed)
    assert 0.4 * judged < farthest - begin < judged


@pytest.mark.parametrize(
    ("way", "above", "away", "height"),
    [
        (WayHome(15.0), 2.0, 40.0, 15.0),
        (WayHome(15.0), 20.0, 40.0, 20.0),
        (WayHome(15.0, climb_m=3.0), 14.0, 40.0, 17.0),
        (WayHome(15.0, slope=3.0), 2.0, 1.0, 3.0),
        (WayHome(15.0, slope=3.0), 2.0, 0.1, 2.0),
        (WayHome(15.0, climb_m=1.0, slope=3.0), 2.0, 0.1, 3.0),
        (WayHome(0.0, lowest_m=0.3), 0.1, 9.0, 0.3),
        (WayHome(15.0, highest_m=8.0), 2.0, 40.0, 8.0),
        (WayHome(15.0, highest_m=8.0), 9.0, 40.0, 9.0),
    ],
)
def test_heights_of_the_way_home(way, above, away, height):
    assert way.heights(np.array([above]), np.array([away])) == pytest.approx([height])


@pytest.mark.every(2)
@pytest.mark.parametrize(
    "parameters",
    [
        {"RTL_ALT": 600.0},
        {"RTL_ALT": 0.0, "RTL_CLIMB_MIN": 150.0},
        {"RTL_ALT": 1500.0, "RTL_CONE_SLOPE": 1.0},
    ],
)
def test_the_simulated_autopilot_flies_home_as_high_as_predicted(parameters):
    client = Client(parameters={"RTL_LOIT_TIME": 100.0, "LAND_SPEED": 100.0} | parameters).fly(2)
    client.target(8 + 16 + 32 + 448 + 1024 + 2048, p=(4, 3, -2))
    client.wait(8)
    x, y, z = client.truth.position
    assert client.command(mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH) == mavlink.MAV_RESULT_ACCEPTED
    highest = 0.0
    while client.copter.is_armed and client.vehicle.time_s < 90:
        client.wait(0.5)
        highest = max(highest, client.height)
    own = ardupilot_safety(DEFAULTS | parameters)
    expected = own.way_home.heights(np.array([-z]), np.array([math.hypot(x, y)]))
    assert highest == pytest.approx(expected[0], abs=0.3)


def test_the_closest_way_home_agrees_with_a_search_of_points():
    rng = np.random.default_rng(4)
    corners = [tuple(sorted(pair)) for pair in rng.integers(-40, 40, (3, 2)).tolist()]
    low, high = np.array(corners).T / 10 + [[0, 0, 6.0], [0, 0, 6.5]]
    cover = box_cover([(np.round(10 * low), np.round(10 * high))])
    made = mission(cover=cover, plan=line_plan(START, GOAL, 5.0))
    path, home = rng.uniform([-5, -5, 0.5], [5, 5, 4], (40, 3)), np.array([0.2, -0.3, 0.1])
    way = WayHome(4.0, slope=2.0)
    found = closest_way_home(way, departures_at(path), home, made.obstacles, radius_m=-math.inf, foot_m=0.2)
    least = math.inf
    for point in path:
        level = home[2] + way.heights(point[2:] - home[2], np.array([math.hypot(*(point - home)[:2])]))
        knots = [point, [*point[:2], level[0]], [*home[:2], level[0]], [*home[:2], home[2] + 0.2]]
        for a, b in itertools.pairwise(knots):
            points = np.linspace(a, b, 400)
            box = [np.round(10 * low) / 10, np.round(10 * high) / 10]
            outside = np.maximum(np.maximum(box[0] - points, points - box[1]), 0.0)
            least = min(least, float(np.linalg.norm(outside, axis=1).min()))
    assert max(found.distance_m, 0.0) == pytest.approx(least, abs=0.02)


def test_a_parameter_that_decides_and_is_not_reported_is_a_fault():
    words = {
        "departures": departures_at(np.zeros((2, 3))),
        "home": np.zeros(3),
        "obstacles": [],
        "radius_m": 0.1,
        "foot_m": 0.1,
    }
    silent = failsafe_faults(ardupilot_safety({}), **words)[0]
    assert silent == ["the vehicle does not report FS_THR_ENABLE"]
    found = {name: value for name, value in DEFAULTS.items() if name != "RTL_ALT"}
    assert failsafe_faults(ardupilot_safety(found), **words)[0] == ["the vehicle does not report RTL_ALT"]
    assert failsafe_faults(ardupilot_safety(found | LANDS), **words)[0] == []


def test_without_the_parameters_nothing_is_claimed():
    faults, words = failsafe_faults(
        OwnSafety((), WayHome(15.0)),
        departures_at(np.zeros((2, 3))),
        np.zeros(3),
        [],
        radius_m=0.1,
        foot_m=0.1,
    )
    assert (faults, words) == ([], "none of them flies home")
