"""Pre-flight checks: each of them fails for its own cause and reports its name."""

import dataclasses

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from alula.stages.flight.links.protocol import VehicleState, VehicleStatus
from alula.stages.flight.loop.frame_check import HandCheck, MotionCheck
from alula.stages.flight.loop.preflight import CHECKS, Observed, climb, verdicts
from alula.stages.flight.loop.supervisor import Event
from alula.stages.flight.mission import make_needs, wanted_setpoints
from alula.stages.vehicles.setpoints import RatesSetpoint
from support.flights.flights import START, fly, loop_of, mission
from support.scenes.small_scenes import box_cover, line_plan
from support.vehicles.fake_vehicle import FakeClock, FakeVehicle

LEVEL = np.array([1.0, 0, 0, 0])


def state(position=(START[0], START[1], 0.0), velocity=(0, 0, 0), quat=LEVEL, at=10.0, latency_s=0.01):
    return VehicleState(at, *(np.array(v, float) for v in (position, velocity, quat)), np.zeros(3), latency_s)


def observed(**fields):
    status = VehicleStatus(heard_s=9.9, armed=False, landed=True, battery_share=0.9, is_estimator_ready=True)
    for name in list(fields):
        if hasattr(status, name) and name != "state":
            setattr(status, name, fields.pop(name))
    usual = {
        "now_s": 10.0,
        "seconds": 2.0,
        "status": status,
        "state": state(),
        "accepts": frozenset(wanted_setpoints(MADE)),
        "states": 200,
        "ticks": 200,
    }
    return Observed(**{**usual, **fields})


MADE = mission()
NEEDS = make_needs(MADE, wanted_setpoints(MADE))


def failed(seen, needs=NEEDS):
    return [v.name for v in verdicts(seen, needs) if not v.holds]


def test_all_checks_hold_for_a_vehicle_that_is_ready():
    found = verdicts(observed(), NEEDS)
    assert [v.name for v in found if not v.holds] == []
    assert len({v.name for v in found}) == len(CHECKS) == 20


def test_the_start_says_which_point_of_the_world_is_placed_by_origin():
    cover = MADE.cover
    moved = msgspec.structs.replace(cover.manifest, map_origin_m=[450_000.0, 4_500_000.0, 0.0])
    made = mission(cover=dataclasses.replace(cover, manifest=moved))
    needs = make_needs(made, wanted_setpoints(made))

    def said(needs):
        return {v.name: v.words for v in verdicts(observed(), needs)}["start"]

    assert said(needs) == (
        f"{said(NEEDS)}; the map's origin, which --origin places, is (450000 4500000 0) m of the world"
    )


@pytest.mark.parametrize(
    ("fields", "names"),
    [
        ({"heard_s": None}, ["heartbeat"]),
        ({"heard_s": 8.0}, ["heartbeat"]),
        ({"trouble": "cannot set GUID_OPTIONS"}, ["parameters"]),
        ({"accepts": frozenset({RatesSetpoint})}, ["set-points"]),
        ({"hover": 0.5}, ["thrust"]),  # FastBridge's has 0.27: the fence would brake too late
        ({"hover": 0.15}, ["thrust"]),
        ({"hover": 0.35}, []),
        ({"state": None}, ["state", "latency", "level", "start", "clearance", "landing", "fence"]),
        ({"state": state(latency_s=0.7)}, ["state", "latency"]),
        ({"state": state(latency_s=0.04)}, ["latency"]),  # the geofence is made for 0.03 s
        ({"state": state(latency_s=np.nan)}, ["state", "latency"]),
        ({"state": state(at=9.8)}, ["state"]),
        ({"states": 30}, ["rate"]),
        ({"ticks": 150}, ["loop"]),
        ({"is_estimator_ready": False}, ["estimator"]),
        ({"is_estimator_ready": None}, ["estimator"]),
        ({"battery_share": 0.29}, ["battery"]),
        ({"battery_share": None}, ["battery"]),
        ({"battery_share": float("nan")}, ["battery"]),
        ({"battery_share": 90.0}, ["battery"]),  # the charge is from 0 to 1
        ({"landed": None}, ["on the ground"]),
        ({"armed": True}, ["on the ground"]),
        ({"landed": False}, ["on the ground"]),
        ({"armed": None}, ["on the ground"]),
        ({"is_failsafe": True}, ["on the ground"]),
        ({"state": state(quat=(0, 1, 0, 0))}, ["level"]),  # NED taken for ENU
        ({"state": state(quat=np.array([1, 0.2, 0, 0]) / np.hypot(1, 0.2))}, ["level"]),
        ({"state": state(velocity=(1, 0, 0))}, ["level"]),
        ({"state": state(quat=(0, 0, 0, 0))}, ["state", "level"]),  # would be level otherwise
        ({"state": state(quat=(float("nan"), 0, 0, 0))}, ["state", "level"]),
        ({"state": state(quat=(2, 0, 0, 0))}, ["state", "level"]),
        ({"state": state(velocity=(0, float("inf"), 0))}, ["state", "level"]),
        ({"state": state(at=60.0)}, ["state"]),  # in the future: it would never get too old
        ({"state": state((START[0], START[1], -99.5))}, ["start"]),  # higher than a take-off may be
        ({"state": state((START[0] + 0.51, START[1], 0))}, ["start"]),
        ({"state": state((START[0], START[1], 1.6))}, ["start"]),
        ({"state": state((START[0], START[1], 1.2))}, ["start"]),  # the start is below
        ({"state": state((-2.0, START[1], 0))}, ["start", "fence"]),
    ],
)
def test_each_check_refuses_and_names_itself(fields, names):
    assert failed(observed(**fields)) == names


@given(st.sampled_from([np.nan, np.inf, -np.inf]), st.integers(0, 2))
def test_numbers_that_are_none_pass_nothing(bad, axis):
    position = np.array([START[0], START[1], 0.0])
    position[axis] = bad
    assert failed(observed(state=state(position)))


def test_clearance_is_that_of_the_way_up_from_the_ground_and_over():
    needed = NEEDS.radius_m + NEEDS.margin_m
    floor = box_cover([((-20, 0, -2), (80, 60, 0))])
    roof = box_cover([((-20, 0, -2), (80, 60, 0)), ((0, 15, 6), (6, 25, 7))])
    beside = box_cover([((-20, 0, -2), (80, 60, 0)), ((4, 15, 0), (8, 25, 5))])
    for cover, names in ((floor, []), (roof, ["clearance"]), (beside, ["clearance"])):
        made = mission(cover=cover, is_clear=True)
        assert failed(observed(), make_needs(made, NEEDS.setpoints)) == names
    thick = box_cover([((-20, 0, -2), (80, 60, 2))])  # a floor that reaches 0.2 m above where it stands
    (verdict,) = [
        v
        for v in verdicts(observed(), make_needs(mission(cover=thick, is_clear=True), NEEDS.setpoints))
        if v.name == "clearance"
    ]
    assert f"{1.5 * needed - 0.2:.3f} m to " in verdict.words
    assert (
        f"begins {1.5 * needed:.3f} m up, and reaches 0.200 m above where the vehicle stands" in verdict.words
    )
    assert "use finer voxels or a higher start" in verdict.words
    for cover in (roof, beside):  # neither is below
        made = make_needs(mission(cover=cover, is_clear=True), NEEDS.setpoints)
        assert "finer voxels" not in " ".join(v.words for v in verdicts(observed(), made))
    way = climb(np.array([0.1, 0.2, 0.0]), np.array(START), needed)
    np.testing.assert_allclose(way, [[0.1, 0.2, needed], [0.1, 0.2, 1.0], START])
    above = climb(np.array([0.1, 0.2, 2.0]), np.array(START), needed)
    assert above[0, 2] == 2.0


def test_what_is_below_the_end_of_the_plan_is_the_ground_or_the_flight_is_refused():
    floor = ((-20, 0, -2), (80, 60, 0))
    table, shelf = ((33, 15, 0), (42, 25, 7)), ((36, 21, 3), (42, 25, 5))  # under (3.7, 2.0, 1.0)
    for boxes, names in (([floor], []), ([floor, table], ["landing"]), ([floor, shelf], ["landing"])):
        made = mission(cover=box_cover(boxes), is_clear=True)
        assert failed(observed(), make_needs(made, NEEDS.setpoints)) == names
    table_top = state((START[0], START[1], -3.0))  # the column reaches down to where it stands
    deep = mission(cover=box_cover([((33, 15, -20), (42, 25, -10))]), is_clear=True)
    assert "landing" in failed(observed(state=table_top), make_needs(deep, NEEDS.setpoints))


def test_the_plan_is_proven_again_against_the_map():
    assert mission().is_clear[0]
    through = mission(plan=line_plan((0.3, 1.0, 1.0), (3.7, 1.0, 1.0)))
    assert not through.is_clear[0]
    assert "plan" in failed(observed(), make_needs(through, NEEDS.setpoints))


def test_failing_checks_end_before_arming_and_say_which():
    through = mission(plan=line_plan((0.3, 1.0, 1.0), (3.7, 1.0, 1.0)))
    loop, vehicle = fly(through, position=(0.3, 1.0, 0.0))
    assert loop.supervision.cause is Event.CHECK_FAILED
    assert loop.checks.failure().startswith("plan: ")
    assert not loop.checks.is_of_link
    assert {order.value for order in vehicle.orders} == {"nothing"}


def test_an_estimator_is_waited_for_but_not_for_ever():
    def late(vehicle, now):
        vehicle.status.is_estimator_ready = now > 104.0

    loop, _ = fly(on_poll=late)
    assert loop.supervision.cause is Event.PLAN_FINISHED
    assert any("waiting for estimator" in words for _, words in loop.recorder.lines)

    def never(vehicle, now):
        vehicle.status.is_estimator_ready = False

    loop, _ = fly(on_poll=never)
    assert loop.supervision.cause is Event.CHECK_FAILED
    assert loop.checks.failure() == "estimator: not ready"


@pytest.mark.every(3)
@pytest.mark.parametrize("name", ["is_estimator_ready", "battery_share", "landed"])
def test_what_is_not_told_is_waited_for_and_then_refused(name):
    def late(vehicle, now):
        if now < 104.0:
            setattr(vehicle.status, name, None)
        elif vehicle.status.is_estimator_ready is None or vehicle.status.battery_share is None:
            setattr(vehicle.status, name, 0.9 if name == "battery_share" else True)
        elif vehicle.status.landed is None:
            vehicle.status.landed = True

    loop, _ = fly(on_poll=late)
    assert loop.supervision.cause is Event.PLAN_FINISHED
    assert any("waiting for" in words and "not reported" in words for _, words in loop.recorder.lines)

    def never(vehicle, now):
        setattr(vehicle.status, name, None)

    loop, vehicle = fly(on_poll=never)
    assert loop.supervision.cause is Event.CHECK_FAILED
    assert "not reported: the vehicle does not report" in loop.checks.failure()
    assert loop.checks.is_of_link
    assert {order.value for order in vehicle.orders} == {"nothing"}


def test_a_vehicle_that_tells_no_charge_flies_where_none_is_asked_for():
    def unreported(vehicle, now):
        vehicle.status.battery_share = None

    loop, _ = fly(mission(battery=0.0), on_poll=unreported)
    assert loop.supervision.cause is Event.PLAN_FINISHED


def test_a_low_battery_is_not_waited_for():
    loop, vehicle = fly(on_poll=lambda v, now: setattr(v.status, "battery_share", 0.1))
    assert loop.checks.failure() == "battery: 10%, 30% required"
    assert vehicle.clock() < 104


def test_a_place_comes_with_the_estimator_and_is_waited_for_like_it():
    def late(vehicle, now):
        vehicle.is_frozen = now < 104.0
        vehicle.status.is_estimator_ready = now > 104.0

    loop, _ = fly(on_poll=late)
    assert loop.supervision.cause is Event.PLAN_FINISHED


def carry(check, moves, frame):
    """Move the vehicle by hand along the axes of the map; positions are reported in `frame`."""
    position, now = np.zeros(3), 0.0
    check.update(state(frame @ position, at=now))
    for move in moves:
        for share in np.linspace(0, 1, 11)[1:]:
            moving = share < 1
            now += 0.1
            seen = frame @ (position + share * np.array(move, float))
            check.update(state(seen, velocity=(0.4 * moving, 0, 0), at=now))
        position = position + move
    return check


MOVES = [(0.5, 0.05, 0), (0.02, 0.45, 0.05), (0, 0.03, 0.4)]


def test_moves_by_hand_are_seen_as_they_are():
    check = carry(HandCheck(), MOVES, np.eye(3))
    assert check.verdict() == ""
    for height in (0.45, 0.25):  # in a hand, at rest
        check.update(state((0.0, 0.0, height)))
        assert "put the vehicle back" in check.prompt
    check.update(state((0.0, 0.0, 0.1)))
    assert check.prompt == ""
    assert "+x" in HandCheck().prompt


def test_a_vehicle_that_rests_in_a_hand_is_not_armed():
    vehicle = FakeVehicle(FakeClock(), (START[0], START[1], 0.0))
    armed = []

    def carried(v, now):
        if v.status.armed:
            armed.append(now)
            return
        steps = [min(1.0, max(0.0, now - 100.5 - 2 * i)) for i in range(3)]
        sideways = max(0.0, min(1.0, now - 107.5))  # back over the start, and held there until 125 s
        down = max(0.0, min(1.0, now - 125.0))
        left = np.array([1 - sideways, 1 - sideways, 1 - down])
        v.x[:3] = np.array([START[0], START[1], 0.0]) + 0.4 * np.array(steps) * left

    vehicle.on_poll = carried
    loop = loop_of(mission(), vehicle, by_hand=True)
    loop.run()
    assert armed[0] > 125.5
    said = [words for _, words in loop.recorder.lines if words.startswith("put the vehicle back")]
    assert len(said) == 1


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_mirrored_frame_is_seen_by_hand(axis):
    frame = np.eye(3)
    frame[axis, axis] = -1
    assert "mirrored" in carry(HandCheck(), MOVES, frame).verdict()


@given(st.floats(0.8, 2 * np.pi - 0.8), st.integers(0, 2))
def test_a_turned_frame_is_seen_by_hand(angle, axis):
    vector = np.zeros(3)
    vector[axis] = angle
    assert carry(HandCheck(), MOVES, Rotation.from_rotvec(vector).as_matrix()).verdict()


@given(st.floats(-0.3, 0.3), st.floats(-5, 5))
def test_a_frame_that_is_right_but_for_alignment_passes(angle, offset):
    turn = Rotation.from_rotvec([0, 0, angle]).as_matrix()
    assert carry(HandCheck(far_m=0.3), MOVES, turn).verdict() == ""


def test_by_hand_a_wrong_frame_is_refused_before_take_off():
    for frame, cause in ((np.eye(3), None), (np.diag([1.0, -1.0, 1.0]), Event.CHECK_FAILED)):
        vehicle = FakeVehicle(FakeClock(), (START[0], START[1], 0.0), frame=frame)

        def carried(v, now):
            if v.status.armed:
                return
            at = min(max(0.0, now - 100.5), 6.0)
            steps = [min(1.0, max(0.0, (at - 2 * i) / 1.0)) for i in range(3)]
            back = max(0.0, min(1.0, (now - 107.5) / 1.0))
            home = np.array([START[0], START[1] * v.frame[1, 1], 0.0])
            v.x[:3] = home + (1 - back) * 0.4 * np.array(steps)

        vehicle.on_poll = carried
        loop = loop_of(mission(), vehicle, by_hand=True)
        loop.run()
        asked = [words for _, words in loop.recorder.lines if words.startswith("move the vehicle")]
        assert len(asked) >= 2
        if cause is None:
            assert loop.checks.needs.frame == ""
            assert loop.supervision.cause is not Event.CHECK_FAILED, loop.checks.failure()
        else:
            assert loop.supervision.cause is cause
            assert "frame" in loop.checks.failure()
            assert not vehicle.status.armed


def wander(check, seen_position, seen_velocity, seconds=6.0, wind=0.0, noise=0.0, seed=0):
    """Vehicle that accelerates by its tilt; its positions and velocities are reported in two frames."""
    rng = np.random.default_rng(seed)
    p, v, dt = np.array([0, 0, 1.0]), np.zeros(3), 0.01
    for i in range(int(seconds / dt)):
        t = i * dt
        a = np.array([1.5 * np.sin(2 * t), 1.2 * np.cos(1.3 * t), 0.0])
        tilt = np.arctan2(np.linalg.norm(a[:2]), 9.81)
        axis = np.array([-a[1], a[0], 0.0]) / max(np.linalg.norm(a[:2]), 1e-9)
        quat = np.array([np.cos(tilt / 2), *(np.sin(tilt / 2) * axis)])
        check.update(
            VehicleState(
                t,
                seen_position @ p + rng.normal(0, noise, 3),
                seen_velocity @ v + rng.normal(0, noise, 3),
                quat,
                np.zeros(3),
            )
        )
        p, v = p + dt * v, v + dt * (a + np.array([wind, 0, 0]))
        v = v * (1 - 0.02 * dt)
    return check


def test_motion_in_one_frame_passes_with_noise_and_a_steady_push():
    for noise, wind in ((0.0, 0.0), (0.01, 0.0), (0.005, 0.4)):
        check = wander(MotionCheck(), np.eye(3), np.eye(3), noise=noise, wind=wind)
        assert check.wrong == ""
        assert check.is_decided


@given(st.floats(np.pi / 2, 1.5 * np.pi))
def test_a_frame_turned_against_the_attitude_is_seen_by_motion(angle):
    turn = Rotation.from_rotvec([0, 0, angle]).as_matrix()
    assert "accelerate" in wander(MotionCheck(), turn, turn).wrong


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_positions_mirrored_against_velocities_are_seen_by_motion(axis):
    mirror = np.eye(3)
    mirror[axis, axis] = -1
    found = wander(MotionCheck(), mirror, np.eye(3)).wrong
    assert ("positions do not move" in found) == (axis != 2)  # it does not move along z


def test_a_vehicle_in_a_turned_frame_is_landed_soon_after_take_off():
    turn = Rotation.from_rotvec([0, 0, np.pi]).as_matrix()
    free = mission(plan=line_plan((1.0, 3.0, 1.0), (3.7, 3.0, 1.0)), fence=(-9, -9, -1, 9, 9, 9))
    free = dataclasses.replace(free, is_clear=(True, "free"))
    loop, _ = fly(free, frame=turn, position=(-1.0, -3.0, 0.0))
    assert loop.supervision.cause is Event.FRAME_WRONG
    path = loop.recorder.positions("fly")
    assert np.linalg.norm(path[-1] - path[0]) < 1.0
