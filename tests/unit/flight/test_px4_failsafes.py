"""PX4's failsafes and fence: read, judged against the map, and flown by the simulated PX4 as predicted."""

import math

import numpy as np
import pytest

from alula.stages.flight.links.mavlink.px4_failsafes import PX4_SAFETY, ConeHome, px4_safety
from alula.stages.flight.links.own_safety import Action
from alula.stages.flight.loop.departures import departures_at
from alula.stages.flight.loop.failsafe_check import failsafe_faults
from alula.stages.sim_vehicle.common.packets import mavlink as m
from alula.stages.sim_vehicle.px4.modes import Px4Mode
from alula.stages.sim_vehicle.px4.parameters import TABLE
from alula.stages.sim_vehicle.px4.vehicle import Px4Copter
from support.flights.flights import mission
from support.scenes.small_scenes import box_cover, line_plan
from support.vehicles.autopilot_client import Client
from support.vehicles.served_autopilot import Served, flight

DEFAULTS = {name: float(value) for name, (_, value) in TABLE.items() if name in PX4_SAFETY}
BOOTED = DEFAULTS | {"COM_OF_LOSS_T": 0.3, "COM_OBL_RC_ACT": 4.0, "COM_RCL_EXCEPT": 4.0}
PREPARED = BOOTED | {
    "RTL_RETURN_ALT": 60.0,
    "COM_LOW_BAT_ACT": 0.0,
    "COM_FLTT_LOW_ACT": 3.0,
}  # as of PX4 1.15
LANDS = {"NAV_RCL_ACT": 3.0, "COM_FLTT_LOW_ACT": 1.0}
N, LAND, HOME = Action.NONE, Action.STOP_OR_LAND, Action.RETURN


def actions(**changed):
    own = px4_safety(PREPARED | changed)
    return {each.setting.split()[0]: each.action for each in own.failsafes}


def faults(path=((0.0, 0.0, 0.8), (3.4, 0.0, 0.8)), obstacles=(), **changed):
    words = {"home": np.zeros(3), "radius_m": 0.15, "foot_m": 0.2}
    return failsafe_faults(
        px4_safety(PREPARED | changed), departures_at(np.array(path)), obstacles=obstacles, **words
    )


def test_failsafes_by_their_parameters():
    assert actions() == {
        "COM_OBL_RC_ACT": LAND,
        "NAV_RCL_ACT": HOME,
        "NAV_DLL_ACT": N,
        "COM_LOW_BAT_ACT": N,
        "COM_FLTT_LOW_ACT": HOME,
        "COM_ACT_FAIL_ACT": N,
        "COM_GNSSLOSS_ACT": N,
        "GF_ACTION": LAND,
    }
    for name, expected in {
        "COM_OBL_RC_ACT": [LAND, LAND, LAND, HOME, LAND, LAND],
        "NAV_RCL_ACT": [N, LAND, HOME, LAND, N, LAND, LAND],
        "NAV_DLL_ACT": [N, LAND, HOME, LAND, N, LAND, LAND],
        "COM_LOW_BAT_ACT": [N, HOME, LAND, HOME],
        "COM_FLTT_LOW_ACT": [N, N, N, HOME],
        "COM_ACT_FAIL_ACT": [N, LAND, LAND, HOME, LAND],
        "COM_GNSSLOSS_ACT": [N, HOME, LAND, LAND],
        "GF_ACTION": [N, N, LAND, HOME, LAND, LAND],
    }.items():
        assert [actions(**{name: float(value)})[name] for value in range(len(expected))] == expected
    assert actions(COM_WIND_MAX=8.0, COM_WIND_MAX_ACT=3.0)["COM_WIND_MAX_ACT"] is HOME
    assert "COM_WIND_MAX_ACT" not in actions(COM_WIND_MAX_ACT=3.0)
    assert actions(COM_FLT_TIME_MAX=300.0)["COM_FLT_TIME_MAX"] is HOME


@pytest.mark.parametrize(
    ("changed", "cause"),
    [
        ({}, "its radio is lost while it lands"),
        ({"COM_RCL_EXCEPT": 0.0}, "its radio is lost"),
        ({"COM_RCL_EXCEPT": 6.0}, None),
        ({"COM_RC_IN_MODE": 4.0}, None),
    ],
)
def test_a_lost_radio_counts_unless_it_is_excepted(changed, cause):
    causes = [each.cause for each in px4_safety(PREPARED | changed).failsafes if "radio" in each.cause]
    assert causes == ([] if cause is None else [cause])


def test_what_decides_and_is_not_reported_is_a_fault():
    assert px4_safety({}).unknown == ("NAV_RCL_ACT",)
    silent = {name: value for name, value in PREPARED.items() if name != "RTL_RETURN_ALT"}
    assert px4_safety(silent).unknown == ("RTL_RETURN_ALT",)
    assert px4_safety(silent | LANDS).unknown == ()


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"GF_MAX_HOR_DIST": 3.0}, "(GF_MAX_HOR_DIST is 3 m): it goes 0.8 to 0.8 m up and 3.4 m away"),
        ({"GF_MAX_VER_DIST": 0.5}, "(GF_MAX_VER_DIST is 0.5 m): it goes 0.8 to 0.8 m up"),
    ],
)
def test_a_plan_beyond_its_fence_is_refused(changed, words):
    (fault,) = faults(**LANDS, **changed)[0]
    assert words in fault


@pytest.mark.parametrize(
    ("changed", "words"),
    [({"RTL_TYPE": 2.0}, "RTL_TYPE is 2"), ({"RTL_CONE_ANG": 90.0}, "RTL_CONE_ANG is 90")],
)
def test_ways_home_that_are_not_known_are_refused_and_landing_is_not(changed, words):
    (fault,) = faults(**changed)[0]
    assert words in fault
    found, said = faults(**LANDS, **changed)
    assert found == []
    assert "polygon fences and rally points are not read" in said


def test_a_return_through_the_ceiling_is_refused_with_the_parameters_to_change():
    ceiling = box_cover([((-30, -30, 25), (80, 80, 28))])
    obstacles = mission(cover=ceiling, plan=line_plan((0.3, 2, 0.8), (3.7, 2, 0.8), 5.0)).obstacles
    (fault,) = faults(obstacles=obstacles)[0]
    assert fault.startswith(
        "when its radio is lost while it lands (NAV_RCL_ACT is 2) or its battery lasts just for the way home "
        "(COM_FLTT_LOW_ACT is 3) it flies home 4.0 m above the take-off (RTL_RETURN_ALT is 60 m)"
    )
    assert fault.endswith("set NAV_RCL_ACT to 3 and COM_FLTT_LOW_ACT to 1 so that it does not fly home")
    assert faults(obstacles=obstacles, **LANDS)[0] == []
    assert faults(obstacles=obstacles, RTL_RETURN_ALT=1.5)[0] == []


@pytest.mark.parametrize(
    ("above", "away", "height"),
    [(1.0, 20.0, 60.0), (1.0, 6.0, 6.0), (1.0, 3.0, 4.0), (1.0, 1.5, 3.0), (1.0, 0.2, 1.0), (9.0, 6.0, 9.0)],
)
def test_heights_within_the_cone(above, away, height):
    way = px4_safety(PREPARED).way_home
    assert isinstance(way, ConeHome)
    assert way.heights(np.array([above]), np.array([away])) == pytest.approx([height])
    without = px4_safety(PREPARED | {"RTL_CONE_ANG": 0.0}).way_home
    assert without.heights(np.array([above]), np.array([away])) == pytest.approx([60.0])


class ServedPx4(Served):
    kind, fast = Px4Copter, {"MPC_TKO_SPEED": 5.0}


def test_the_link_reads_them_all():
    with flight(served=ServedPx4(parameters={"NAV_RCL_ACT": 3, "RTL_RETURN_ALT": 7.0})) as (_, _, link):
        own = link.status.own_safety
        assert own == px4_safety(
            {name: float(np.float32(value)) for name, value in (BOOTED | {"NAV_RCL_ACT": 3.0}).items()}
            | {"RTL_RETURN_ALT": 7.0}
        )
        assert own.alone_s == pytest.approx(0.3)
        assert own.unknown == ()


class Px4Client(Client):
    kind = Px4Copter

    def up(self, north, height):
        """In Offboard, at rest at a place."""
        self.wait(0.6)
        for _ in range(24):
            self.target(0x9C7)
            self.wait(0.05)
        assert self.command(m.MAV_CMD_DO_SET_MODE, 1, 6, 0) == m.MAV_RESULT_ACCEPTED
        assert self.arm() == m.MAV_RESULT_ACCEPTED
        for _ in range(400):
            self.target(0xDF8, p=(north, 0, -height))
            self.wait(0.05)
            if math.dist(self.truth.position, (north, 0, -height)) < 0.1:
                return self
        raise AssertionError(self.truth.position)

    def highest(self):
        """Largest height until it lands."""
        found = 0.0
        while self.copter.is_armed and self.vehicle.time_s < 150:
            self.wait(0.5)
            found = max(found, self.height)
        return found


FAST = {"MPC_TKO_SPEED": 5.0, "MPC_TKO_RAMP_T": 0.25, "MPC_LAND_SPEED": 2.0, "MPC_Z_VEL_MAX_DN": 3.0}


@pytest.mark.every(2)
@pytest.mark.parametrize(
    ("north", "changed"),
    [
        (6.0, {}),
        (1.2, {}),
        (3.0, {"RTL_CONE_ANG": 0, "RTL_RETURN_ALT": 5.0}),
        (6.0, {"RTL_MIN_DIST": 5.0, "RTL_RETURN_ALT": 8.0}),
    ],
)
def test_the_simulated_px4_flies_home_as_high_as_predicted(north, changed):
    client = Px4Client(parameters=FAST | changed).up(north, 1.5)
    assert client.command(m.MAV_CMD_DO_SET_MODE, 1, 4, 5) == m.MAV_RESULT_ACCEPTED
    own = px4_safety(PREPARED | changed)
    expected = own.way_home.heights(np.array([1.5]), np.array([north]))[0]
    assert client.highest() == pytest.approx(expected, abs=0.3)


@pytest.mark.parametrize(
    ("changed", "mode"),
    [
        ({"GF_MAX_HOR_DIST": 2.0, "GF_ACTION": 3}, Px4Mode.RTL),
        ({"GF_MAX_HOR_DIST": 2.0, "GF_ACTION": 5}, Px4Mode.LAND),
        ({"GF_MAX_VER_DIST": 2.0, "GF_ACTION": 2}, Px4Mode.HOLD),
        ({"GF_MAX_VER_DIST": 2.0, "GF_ACTION": 1}, Px4Mode.OFFBOARD),
        ({"COM_FLT_TIME_MAX": 3}, Px4Mode.RTL),
    ],
)
def test_the_simulated_px4_keeps_its_fence_and_its_time(changed, mode):
    client = Px4Client(parameters=FAST | {"COM_FAIL_ACT_T": 0.0}).up(0.0, 1.5)
    for name, value in changed.items():
        assert client.copter.parameters.set(name, value)
    for _ in range(80):
        client.target(0xDF8, p=(4.0, 0, -3.0))
        client.wait(0.05)
    assert client.copter.flown is mode
    assert bool(client.copter.failsafe) == (mode is not Px4Mode.OFFBOARD)
