"""Missions: gates as polynomial roots show them, waypoints within their tolerance, lap by lap."""

import dataclasses
import math
from itertools import pairwise

import msgspec
import numpy as np
import pytest

from alula.schemas.errors import InfeasibleError, UsageError
from alula.schemas.parameters.configs.plan import PlanConfig
from alula.schemas.scenarios.mission import Mission, PassTable, ZoneTable
from alula.stages.clearance import hull_obstacles
from alula.stages.compression.hulls import Hulls
from alula.stages.planning.adherence import PlanJudge, complaint, outcome_of_plan
from alula.stages.planning.plan import plan
from alula.stages.planning.plan_samples import sample_plan
from alula.stages.planning.trajectory import evaluate
from alula.stages.planning.verify import verify_plan
from support.scenes.covers import box_distance, boxes_cover

WALL = [[10, -30, 0, 12, -4, 20], [10, 4, 0, 12, 30, 20]]  # a door 0.8 m wide at x = 1, in cells of 0.1 m
CONFIG = PlanConfig(
    beyond_map_m=6.0, start=(0, 0, 1), goal=(0, 0, 1.2), radius_m=0.25, margin_m=0.1, speed_m_s=2.0
)
ASIDE = (3.0, 1.0, 1.0, 0.0, 1.0, 0.0, 0.5)
BACK = (1.1, 0.0, 1.0, -2.0, 0.0, 0.0, 0.4)  # through the door, towards the start


@pytest.fixture(scope="module")
def cover():
    return boxes_cover(WALL)


@pytest.fixture(scope="module")
def course(cover):
    """Two gates, three laps."""
    return plan(dataclasses.replace(CONFIG, gate=(ASIDE, BACK), loops=3), cover)


def crossings(made, gate):
    """Where and when the curve crosses a gate's plane, by roots of its polynomials: time, rising, offset."""
    centre, normal = np.array(gate[:3]), np.array(gate[3:6]) / math.hypot(*gate[3:6])
    time, c = made["time"], made["coefficient"][:, :3]
    found = []
    for k in range(len(c)):
        height = np.polynomial.Polynomial(normal @ c[k] - normal @ centre * (np.arange(8) == 0))
        for root in height.roots():
            t = root.real
            if abs(root.imag) < 1e-6 and -1e-6 <= t <= time[k + 1] - time[k] + 1e-6:
                at = evaluate(time, made["coefficient"], time[k] + t)[:3]
                found.append((time[k] + t, height.deriv()(t) > 0, float(np.linalg.norm(at - centre))))
    distinct = []
    for each in sorted(found):  # one at a knot is a root of both pieces
        if not distinct or each[0] - distinct[-1][0] > 1e-3:
            distinct.append(each)
    return distinct


def judged(made, cover, radius=0.15):
    judge = PlanJudge(made, [hull_obstacles(Hulls.from_cover(cover))], radius, 0.1)
    path = sample_plan(made, 0.004)
    times = np.minimum(0.004 * np.arange(len(path)), made["time"][-1])
    return judge, path, times


def test_each_lap_flies_through_each_gate_in_its_direction(course, cover):
    passes = course.manifest.passes
    assert [(each.lap, each.number) for each in passes] == [(i, j) for i in (1, 2, 3) for j in (1, 2)]
    for number, gate in enumerate((ASIDE, BACK), 1):
        planned = [each.time_s for each in passes if each.number == number]
        rising = [(at, off) for at, up, off in crossings(course, gate) if up]
        for time_s in planned:
            at, off = min(rising, key=lambda each: abs(each[0] - time_s))
            assert at == pytest.approx(time_s, abs=1e-6)
            assert off <= gate[6] - 0.25 + 1e-9  # the radius and the margin are kept from the rim
    assert box_distance(sample_plan(course, 0.01), WALL).min() >= 0.25
    assert course.manifest.summary["stops"] == 0
    certificate = verify_plan(course, cover=cover)
    assert certificate.covered
    (check,) = (each for each in certificate.checks if each.name == "start, vias, gates, goal")
    assert check.checked == 8
    judge, path, _ = judged(course, cover)
    result = judge.result(path)
    assert (result.missed, result.outside_m, complaint(result)) == ([], 0, None)
    assert [each.off_m for each in result.passes] == pytest.approx(
        [
            np.linalg.norm(np.array(via) - each.point_m)
            for via, each in zip(course.manifest.via_m, passes, strict=True)
        ],
        abs=1e-3,
    )


def test_a_curve_uses_the_room_of_a_gate(cover):
    wide, narrow = (
        plan(dataclasses.replace(CONFIG, gate=((*ASIDE[:6], radius),)), cover) for radius in (0.7, 0.16)
    )
    assert wide["time"][-1] < 0.97 * narrow["time"][-1]


def test_a_gate_only_just_wide_enough_is_flown_through(cover):
    body = CONFIG.radius_m - CONFIG.margin_m
    narrow = (*ASIDE[:6], body + 1e-3)
    made = plan(dataclasses.replace(CONFIG, gate=(narrow,)), cover)
    ((_, _, off),) = [each for each in crossings(made, narrow) if each[1]]
    assert off <= 0.5e-3 + 1e-9  # half of the room is left to the controller
    assert verify_plan(made, cover=cover).covered
    judge, path, _ = judged(made, cover)
    assert judge.result(path).missed == []
    with pytest.raises(InfeasibleError, match=r"gate 1 has a radius of 0\.149 m.* does not fit through"):
        plan(dataclasses.replace(CONFIG, gate=((*ASIDE[:6], body - 1e-3),)), cover)


def test_a_gate_in_an_obstacle_and_one_behind_a_wall_are_refused_with_a_sentence(cover):
    inside = (1.1, 1.0, 1.0, 1.0, 0.0, 0.0, 0.4)
    with pytest.raises(
        InfeasibleError, match=r"gate 1 at \(1.1 1 1\) is not free: no point of its opening keeps"
    ):
        plan(dataclasses.replace(CONFIG, gate=(inside,)), cover)
    before = (
        0.7,
        1.0,
        1.0,
        1.0,
        0.0,
        0.0,
        0.6,
    )  # 0.3 m before the wall: its disc is free, the way on is along
    made = plan(dataclasses.replace(CONFIG, gate=(before,)), cover)
    assert verify_plan(made, cover=cover).covered
    outside = dataclasses.replace(CONFIG, gate=(ASIDE,), bounds=(-1, -1, 0.3, 2.9, 2, 2))
    with pytest.raises(UsageError, match=r"gate 1, \(3 1 1\), is outside --bounds"):
        plan(outside, cover)


def test_a_gate_half_covered_is_passed_where_it_is_free(cover):
    half = (1.1, 0.5, 1.0, 1.0, 0.0, 0.0, 0.7)  # its centre is in the wall, the door beside it
    made = plan(dataclasses.replace(CONFIG, gate=(half,)), cover)
    assert np.linalg.norm(np.array(made.manifest.via_m[0]) - half[:3]) <= 0.7 - 0.25 + 1e-9
    assert verify_plan(made, cover=cover).covered


@pytest.mark.parametrize("alter", ["normal", "radius", "order", "lap"])
def test_verify_finds_gates_that_are_not_passed(course, cover, alter):
    passes = list(course.manifest.passes)
    if alter == "normal":
        passes[1] = msgspec.structs.replace(passes[1], normal=[1.0, 0.0, 0.0])
    elif alter == "radius":
        passes[0] = msgspec.structs.replace(passes[0], radius_m=0.35)
    elif alter == "order":
        passes[-2:] = passes[:-3:-1]
    else:
        passes += [msgspec.structs.replace(each, lap=4) for each in passes[:2]]
    made = dataclasses.replace(course, manifest=msgspec.structs.replace(course.manifest, passes=passes))
    failed = [check for check in verify_plan(made, cover=cover).checks if not check.ok]
    assert [check.name for check in failed] == ["start, vias, gates, goal"]
    assert "gate" in failed[0].first[0].fault


def test_the_judge_says_how_a_gate_was_missed(course, cover):
    door = (1.1, 0.0, 1.0, 1.0, 0.0, 0.0, 0.4)
    through = plan(dataclasses.replace(CONFIG, goal=(3, 0, 1), gate=(door,)), cover)
    judge, path, _ = judged(through, cover)
    backwards = judge.result(path[::-1])
    assert outcome_of_plan("reached", backwards) == "missed-via"
    assert complaint(backwards) == "gate 1 was missed: it was flown through against its direction"
    aside = judge.result(path + np.array([0, 0, 0.3]))
    off = aside.passes[0].off_m
    assert off == pytest.approx(0.3, abs=0.1)
    assert complaint(aside) == (
        f"gate 1 was missed: the vehicle crossed its plane {off:.3g} m from the centre, "
        f"{off - 0.25:.3g} m more than fits through"
    )
    large = PlanJudge(through, [hull_obstacles(Hulls.from_cover(cover))], 0.45, 0.1).result(path)
    assert complaint(large) == "gate 1 was missed: the vehicle does not fit through it"
    judge, path, _ = judged(course, cover)
    once = path[: int(course.manifest.passes[2].time_s / 0.004) - 20]
    missed = judge.result(once)
    assert missed.missed == [3, 4, 5, 6]
    assert complaint(missed) == "gate 1 of lap 2 was missed: its plane was not crossed in its direction"


def test_random_chords_pass_gates_as_dense_samples_show(course, cover):
    judge, _, _ = judged(course, cover)
    rng = np.random.default_rng(5)
    outcomes = []
    for _ in range(200):
        path = np.array([3, 1, 1]) + np.cumsum(rng.normal(size=(6, 3)) * 0.3, axis=0)
        share = np.linspace(0, 1, 2001)[:-1, None]
        dense = np.concatenate([a + share * (b - a) for a, b in pairwise(path)])
        height = dense[:, 1] - 1.0
        rising = np.flatnonzero((height[:-1] <= 0) & (height[1:] > 0))
        off = np.hypot(dense[rising, 0] - 3, dense[rising, 2] - 1)
        if len(off) and abs(off - 0.35).min() < 2e-3:
            continue  # too near to the rim for samples
        outcomes.append(bool((off <= 0.35).any()))
        assert judge.result(path).passes[0].passed == outcomes[-1]
    assert 20 < sum(outcomes) < len(outcomes) - 20


def test_a_gate_that_one_lap_misses_is_named_and_the_others_are_passed(course, cover):
    judge, path, _ = judged(course, cover)
    second = course.manifest.passes[2]
    missed = path.copy()
    near = np.abs(0.004 * np.arange(len(path)) - second.time_s) < 0.6  # until it is before the gate again
    missed[near] += np.array([0, 0, 0.6])
    result = judge.result(missed)
    assert result.missed == [3]
    assert complaint(result).startswith("gate 1 of lap 2 was missed: the vehicle crossed its plane 0.6")


TOLERANT = Mission(
    passes=(
        PassTable(point_m=(2.0, 1.5, 1.0), tolerance_m=0.4),
        PassTable(point_m=(3.0, -1.0, 1.0), hold_s=2.5),
    )
)
GOAL = dataclasses.replace(CONFIG, goal=(4, 1, 1))


@pytest.fixture(scope="module")
def visit(cover):
    return plan(GOAL, cover, mission=TOLERANT)


def test_a_tolerance_lets_the_curve_cut_the_corner_and_its_margin_is_kept(visit, cover):
    exact = Mission(passes=(PassTable(point_m=(2.0, 1.5, 1.0)), TOLERANT.passes[1]))
    assert visit["time"][-1] < plan(GOAL, cover, mission=exact)["time"][-1] - 0.1
    first, second = visit.manifest.passes
    _, path, _ = judged(visit, cover)
    closest = np.linalg.norm(path - first.point_m, axis=1).min()
    assert 0.1 < closest <= 0.4 - 0.1 + 1e-3  # less the margin of 0.1 m
    assert (first.tolerance_m, second.hold_s) == (0.4, 2.5)
    assert verify_plan(visit, cover=cover).covered


def test_a_plan_rests_where_it_holds_and_the_judge_measures_the_time(visit, cover):
    hold = visit.manifest.passes[1]
    times = np.linspace(hold.time_s, hold.time_s + 2.5, 50)
    at = [evaluate(visit["time"], visit["coefficient"], times, order)[:, :3] for order in range(3)]
    np.testing.assert_allclose(at[0], np.tile((3.0, -1.0, 1.0), (50, 1)), atol=1e-9)
    assert max(np.abs(each).max() for each in at[1:]) < 1e-6
    judge, path, time_s = judged(visit, cover)
    result = judge.result(path, time_s)
    assert result.missed == []
    assert 2.5 <= result.passes[1].held_s < 4.0
    stays = (time_s < hold.time_s + 0.5) | (time_s > hold.time_s + 2.6)
    hurried = judge.result(path[stays], np.arange(stays.sum()) * 0.004)
    assert hurried.missed == [2]
    assert complaint(hurried).startswith("via point 2 was missed: the vehicle left it after ")
    passes = [visit.manifest.passes[0], msgspec.structs.replace(hold, hold_s=3.0)]
    longer = dataclasses.replace(visit, manifest=msgspec.structs.replace(visit.manifest, passes=passes))
    (check,) = (each for each in verify_plan(longer, cover=cover).checks if not each.ok)
    assert check.first[0].fault == "the plan does not rest at the via point 2"


SLOW = ZoneTable(box_m=(1.5, -0.5, 0.0, 2.2, 0.8, 3.0), speed_m_s=0.4)


@pytest.mark.parametrize("smooth", [1.0, 1.5])
def test_in_a_zone_a_plan_is_slow_and_beside_it_fast(cover, smooth):
    config = dataclasses.replace(
        CONFIG, goal=(4, 0, 1), smooth=smooth, bounds=(-0.5, -0.5, 0.3, 4.5, 0.5, 1.7)
    )
    made = plan(config, cover, mission=Mission(zones=(SLOW,)))
    free = plan(config, cover)
    t = np.linspace(0, made["time"][-1], 20_001)[:-1]
    at, velocity = (evaluate(made["time"], made["coefficient"], t, order)[:, :3] for order in (0, 1))
    speed = np.linalg.norm(velocity, axis=1)
    low, high = np.array(SLOW.box_m[:3]), np.array(SLOW.box_m[3:])
    inside = ((at >= low) & (at <= high)).all(axis=1)
    assert inside.sum() > 1000
    assert 0.35 / smooth < speed[inside].max() <= 0.4
    assert speed[at[:, 0] > 2.4].max() > 1.0 / smooth
    assert made["time"][-1] > free["time"][-1] + 0.5
    assert verify_plan(made, cover=cover).covered
    zones = made.manifest.zones
    faster = [msgspec.structs.replace(zones[0], speed_m_s=0.3 / smooth)]
    (check,) = (
        each
        for each in verify_plan(
            dataclasses.replace(made, manifest=msgspec.structs.replace(made.manifest, zones=faster)),
            cover=cover,
        ).checks
        if not each.ok
    )
    assert check.name == "zones"
    assert "may be faster than" in check.first[0].fault
    unzoned = dataclasses.replace(free, manifest=msgspec.structs.replace(free.manifest, zones=zones))
    assert [each.name for each in verify_plan(unzoned, cover=cover).checks if not each.ok] == ["zones"]


def test_a_plan_whose_via_points_are_not_those_of_its_passes_is_no_plan(cover):
    made = plan(dataclasses.replace(GOAL, via=((2, 0, 1), (3, 0.5, 1))), cover)
    judge, path, _ = judged(made, cover)
    assert judge.result(path).missed == []
    assert judge.result(path + np.array([0, 0, 0.2])).missed == [1, 2]
    with pytest.raises(ValueError, match="more points than"):
        msgspec.structs.replace(made.manifest, passes=[])


def test_the_clock_waits_before_a_gate_and_within_each_tolerance(course, visit):
    from alula.stages.planning.adherence import waits
    from alula.stages.planning.plan_samples import curve_of

    options = waits(course, 0.15, 0.1)
    at = curve_of(course).at(np.array(options.via_s))[:, :3]
    for each, point, room, when in zip(
        course.manifest.passes, at, options.own_via_m, options.via_s, strict=True
    ):
        before = (np.array(each.point_m) - point) @ each.normal
        assert before == pytest.approx(room, abs=0.03)
        assert when < each.time_s
    assert waits(visit, 0.15, 0.07).own_via_m == [0.4, 0.07]
