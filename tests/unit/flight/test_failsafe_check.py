"""Before take-off: where the vehicle would fly by itself, from every point of the plan."""

import itertools
import math

import numpy as np
import pytest

from alula.stages.flight.links.mavlink.ardupilot_failsafes import ardupilot_safety
from alula.stages.flight.links.own_safety import Action, OwnSafety, WayHome
from alula.stages.flight.loop.failsafe_check import closest_way_home, failsafe_faults
from alula.stages.flight.loop.supervisor import Event, State
from alula.stages.sim_vehicle.common.packets import mavlink
from support.autopilot_client import Client
from support.flights import mission
from support.lockstep import Flight, Upset, fault
from support.small_scenes import box_cover, line_plan

START, GOAL = (0.3, 2.0, 0.8), (3.7, 2.0, 0.8)
CEILING = [((-30, -30, 25), (80, 80, 28))]  # 2.5 m above the floor, everywhere
DEFAULTS = {
    "FS_THR_ENABLE": 1.0,
    "FS_OPTIONS": 16.0,
    "FS_DR_ENABLE": 2.0,
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
    own = ardupilot_safety((DEFAULTS | changed).get)
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
        "it lands where it is"
    )


@pytest.mark.parametrize("parameters", [LANDS, {"RTL_ALT": 150.0}, LANDS | {"BATT_FS_LOW_ACT": 1}])
def test_landing_or_a_return_below_the_ceiling_is_flown(parameters):
    flight = checked(RETURNS | parameters)
    assert flight.cause is Event.CHECKS_PASSED_DRY, flight.loop.checks.failure()


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


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        (
            {"FENCE_RADIUS": 3.0},
            "FENCE_ALT_MAX is 100 m; FENCE_RADIUS is 3 m): it goes 0.8 m up and 3.4 m away",
        ),
        ({"FENCE_ALT_MAX": 0.5, "FENCE_TYPE": 1}, "FENCE_ALT_MAX is 0.5 m): it goes 0.8 m up"),
    ],
)
def test_a_plan_beyond_the_vehicles_own_fence_is_refused(parameters, words):
    flight = checked(LANDS | {"FENCE_ENABLE": 1, "FENCE_ACTION": 2} | parameters)
    assert flight.cause is Event.CHECK_FAILED
    assert f"the plan leaves the vehicle's own fence ({words}" in flight.loop.checks.failure()


def test_failsafes_by_their_parameters():
    n, land, home, back = Action.NONE, Action.STOP_OR_LAND, Action.RETURN, Action.RETRACE
    assert actions() == {"FS_THR_ENABLE": home, "FS_DR_ENABLE": home, "BATT_FS_LOW_ACT": n}
    assert actions(FS_OPTIONS=20.0) == {"FS_DR_ENABLE": home, "BATT_FS_LOW_ACT": n}
    found = [actions(FS_THR_ENABLE=value)["FS_THR_ENABLE"] for value in range(8)]
    assert found == [n, home, home, land, back, back, home, land]
    found = [actions(BATT_FS_LOW_ACT=value)["BATT_FS_LOW_ACT"] for value in range(8)]
    assert found == [n, land, home, back, back, land, home, land]
    fence = {"FENCE_ENABLE": 1.0, "FENCE_TYPE": 7.0, "FENCE_ALT_MAX": 50.0, "FENCE_RADIUS": 30.0}
    found = [actions(**fence, FENCE_ACTION=value)["FENCE_ACTION"] for value in range(6)]
    assert found == [n, home, land, back, land, back]
    own = ardupilot_safety((DEFAULTS | fence | {"FENCE_ACTION": 1.0, "FENCE_MARGIN": 2.0}).get)
    assert (own.highest_m, own.farthest_m, own.way_home.highest_m) == (50.0, 30.0, 48.0)
    assert ardupilot_safety(lambda name: None).failsafes[0].action is n


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
    own = ardupilot_safety((DEFAULTS | parameters).get)
    expected = own.way_home.heights(np.array([-z]), np.array([math.hypot(x, y)]))
    assert highest == pytest.approx(expected[0], abs=0.3)


def test_the_closest_way_home_agrees_with_a_search_of_points():
    rng = np.random.default_rng(4)
    corners = [tuple(sorted(pair)) for pair in rng.integers(-40, 40, (3, 2)).tolist()]
    low, high = np.array(corners).T / 10 + [[0, 0, 6.0], [0, 0, 6.5]]
    cover = box_cover([(np.round(10 * low), np.round(10 * high))])
    made = mission(cover=cover, plan=line_plan(START, GOAL, 5.0))
    path, home = rng.uniform([-5, -5, 0.5], [5, 5, 4], (40, 3)), np.array([0.2, -0.3, 0.1])
    own = OwnSafety((), WayHome(4.0, slope=2.0))
    found = closest_way_home(own, path, home, made.obstacles, radius_m=-math.inf, foot_m=0.2)
    least = math.inf
    for point in path:
        level = home[2] + own.way_home.heights(
            point[2:] - home[2], np.array([math.hypot(*(point - home)[:2])])
        )
        knots = [point, [*point[:2], level[0]], [*home[:2], level[0]], [*home[:2], home[2] + 0.2]]
        for a, b in itertools.pairwise(knots):
            points = np.linspace(a, b, 400)
            box = [np.round(10 * low) / 10, np.round(10 * high) / 10]
            outside = np.maximum(np.maximum(box[0] - points, points - box[1]), 0.0)
            least = min(least, float(np.linalg.norm(outside, axis=1).min()))
    assert max(found.distance_m, 0.0) == pytest.approx(least, abs=0.02)


def test_a_parameter_that_decides_and_is_not_reported_is_a_fault():
    words = {"path": np.zeros((2, 3)), "home": np.zeros(3), "obstacles": [], "radius_m": 0.1, "foot_m": 0.1}
    silent = failsafe_faults(ardupilot_safety(lambda name: None), **words)[0]
    assert silent == ["the vehicle does not report FS_THR_ENABLE"]
    found = {name: value for name, value in DEFAULTS.items() if name != "RTL_ALT"}
    assert failsafe_faults(ardupilot_safety(found.get), **words)[0] == ["the vehicle does not report RTL_ALT"]
    assert failsafe_faults(ardupilot_safety((found | LANDS).get), **words)[0] == []


def test_without_the_parameters_nothing_is_claimed():
    faults, words = failsafe_faults(
        OwnSafety((), WayHome(15.0)), np.zeros((2, 3)), np.zeros(3), [], radius_m=0.1, foot_m=0.1
    )
    assert (faults, words) == ([], "none of them flies home")
