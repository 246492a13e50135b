"""Flights that their filter holds up get a new plan: whole flights in lock-step, and the parts of it."""

import dataclasses
import functools
import math
from types import SimpleNamespace

import numpy as np
import pytest

from alula import _core
from alula.schemas.errors import InfeasibleError, UsageError
from alula.schemas.parameters.configs.plan import PlanConfig
from alula.schemas.scenarios.scenario import decoded
from alula.schemas.scenarios.vehicle import read_vehicle
from alula.stages.clearance import segment_clearance
from alula.stages.filtering.protocol import FilterStatus
from alula.stages.flight.judge import judge
from alula.stages.flight.links.own_safety import Action, Failsafe, OwnSafety, WayHome
from alula.stages.flight.links.protocol import VehicleState
from alula.stages.flight.loop.plan_clock import PlanClock
from alula.stages.flight.loop.supervisor import Event
from alula.stages.flight.mission import make_clock
from alula.stages.flight.recorder.log import row_of
from alula.stages.flight.replan.of_mission import maps_of, replan_facts
from alula.stages.flight.replan.replanner import HeldUp
from alula.stages.flight.replan.task import ReplanAnswer, ReplanRequest, ReplanTask
from alula.stages.planning.adherence import PlanJudge
from alula.stages.planning.limits import beyond_followed
from alula.stages.planning.plan import plan
from alula.stages.planning.plan_samples import curve_of
from alula.stages.planning.verify import verify_plan
from support.flights.flights import BALL, PILLAR, mission
from support.flights.replanning import refusing, replanner_of
from support.paths import VEHICLES
from support.scenes.small_scenes import box_cover, line_plan
from support.vehicles.lockstep import Flight

BOX = box_cover([((18, 14, 0), (22, 30, 20))])  # x 1.8 to 2.2, y 1.4 to 3: only the filter knows it
ELSEWHERE = box_cover([((18, 60, 0), (22, 70, 20))])
START, GOAL = (0.3, 2.0, 1.0), (3.7, 2.0, 1.0)
BEFORE, AFTER = (0.8, 2.0, 1.0), (3.0, 1.6, 1.0)  # via points on either side of the box
TICK = 0.01
COPTER = read_vehicle(VEHICLES / "arducopter.toml")


def blocked(name="polytope-cbf", via=(), **fields):
    """A flight along a plan that leads through the box."""
    config = PlanConfig(beyond_map_m=6.0, start=START, goal=GOAL, via=via, radius_m=0.27, speed_m_s=1.0)
    words = {"max_time_s": 11.0, "replan_after_s": 1.0, "vehicle": COPTER} | fields
    return mission(name, cover=BOX, plan=plan(config, ELSEWHERE), is_clear=True, **words)


def flown(made, replanner=None, **words):
    flight = Flight(made, loop_words={"replanner": replanner}, **words).fly()
    flight.judge()  # no command is NaN, old or sent twice; the vehicle keeps clear of the box
    return flight


@functools.cache
def stuck():
    """The flight without new plans; it is held up from 6 s on."""
    return flown(blocked())


def sent(flight):
    """What was sent in each tick along the plan."""
    kept = [s.safety for s in flight.recorder.samples if s.safety is not None]
    return [(safety.time_s, safety.sent_values) for safety in kept]


@functools.cache
def through():
    """A flight with a new plan, through via points on either side of the box."""
    made = blocked("cone-backup", via=(BEFORE, AFTER), max_time_s=20.0)
    replanner, planner = replanner_of(made)
    return flown(made, replanner), replanner, planner


def rows_of(flight):
    """What `FlightRecorder.rows` keeps of a flight."""
    return np.array([row_of(s) for s in flight.recorder.samples if s.safety is not None])


def test_a_flight_that_is_stuck_arrives_with_a_new_plan():
    assert stuck().cause is Event.TIMED_OUT
    made = blocked(max_time_s=20.0)
    replanner, planner = replanner_of(made)
    flight = flown(made, replanner)
    assert flight.cause is Event.PLAN_FINISHED
    assert len(flight.loop.joined) == len(planner.requests) == 1
    assert planner.is_closed
    joined_s, made = flight.loop.joined[0]
    ((recorded_s, points),) = flight.recorder.plans
    assert recorded_s == pytest.approx(joined_s)
    expected = curve_of(made).at(np.linspace(0, made["time"][-1], len(points)))[:, :3]
    assert np.allclose(points, expected)
    ticks = [s.supervisor for s in flight.recorder.samples if s.safety]
    ticks = [tick for tick in ticks if joined_s - 2.1 < tick.time_s < joined_s - 0.05]
    assert ticks[-1].plan_s - ticks[-100].plan_s < 0.1  # it was held up for a second
    assert ticks[-1].plan_s - ticks[0].plan_s > 0.1  # and not for much longer


@pytest.mark.slow
@pytest.mark.parametrize("how", ["no path", "raises"])
def test_a_plan_that_failed_leaves_the_flight_as_it_was(how):
    made = blocked(replans=2)
    replanner, planner = replanner_of(made, answer=refusing)
    if how == "raises":
        planner.answer = lambda: 1 / 0
    flight = flown(made, replanner)
    assert len(planner.requests) == (2 if how == "no path" else 1)
    assert flight.loop.joined == []
    assert sent(flight) == sent(stuck())
    said = "there is no path" if how == "no path" else "no more new plans"
    assert any(said in words for _, words in flight.recorder.lines)


@pytest.mark.slow
def test_a_new_plan_passes_the_via_points_that_remain_and_keeps_what_the_filter_keeps():
    flight, _, planner = through()
    assert flight.cause is Event.PLAN_FINISHED
    assert planner.requests[0].via == (AFTER,)
    (_, made) = flight.loop.joined[0]
    assert made.manifest.radius_m == flight.made.world.static.keeps_m("hulls")
    assert verify_plan(made, cover=BOX).covered
    points = curve_of(made).at(np.linspace(0, made["time"][-1], 2000))[:, :3]
    ((_, obstacles),) = flight.made.obstacles
    assert segment_clearance(points[:-1], points[1:], obstacles).min() >= flight.made.world.static.keeps_m(
        "hulls"
    )


def test_each_part_of_a_flight_is_judged_by_the_plan_that_was_flown_then():
    flight, _, _ = through()
    rows = rows_of(flight)
    trial = judge(flight.made, rows, flight.cause, 1, flight.loop.joined)
    assert trial.outcome == "reached"
    assert trial.plan.missed == []
    assert len(trial.plan.closest_m) == 2
    alone = judge(flight.made, rows, flight.cause, 1)  # the first plan alone leads through the box
    assert alone.outcome == "off-plan"
    joined_s = flight.loop.joined[0][0]
    moved = rows.copy()
    moved[rows[:, 0] > joined_s + 2, 3] += 3.0
    assert judge(flight.made, moved, flight.cause, 1, flight.loop.joined).plan.outside_m > 1
    moved = rows.copy()
    moved[rows[:, 0] <= joined_s, 3] += 3.0
    assert judge(flight.made, moved, flight.cause, 1, flight.loop.joined).plan.outside_m > 1


def test_a_via_point_that_the_rest_of_the_flight_passes_by_is_missed():
    flight, _, _ = through()
    straight = plan(PlanConfig(beyond_map_m=6.0, start=(1.5, 2.0, 1.0), goal=GOAL, radius_m=0.25), BOX)
    path = rows_of(flight)[:, 1:4]
    at = int(np.argmax(np.linalg.norm(path - AFTER, axis=1) < 0.4))
    path[at:] = path[at - 1]
    found = flight.made.along.result(path, [(at, PlanJudge(straight, [], 0.15, 0.15))])
    assert found.missed == [2]


# Parts.


def task_of(made):
    return ReplanTask(replan_facts(made), made.world.vehicle, maps_of(made))


def request(position=(1.5, 2.0, 1.0), velocity=(0.0, 0.0, 0.0), **more):
    return ReplanRequest(
        **{
            "number": 1,
            "position": position,
            "velocity": velocity,
            "acceleration": (0.0, 0.0, 0.0),
            "via": (),
        }
        | more
    )


def test_a_vehicle_that_the_filter_stopped_a_little_too_near_gets_a_plan_from_the_nearest_free_point():
    made = blocked()
    keep = made.world.static.keeps_m("hulls")
    found = task_of(made).plan(request((1.8 - keep + 0.01, 2.0, 1.0)))
    start = curve_of(found).at(np.zeros(1))[0, :3]
    assert 1.8 - start[0] >= keep
    assert np.linalg.norm(start - (1.8 - keep + 0.01, 2.0, 1.0)) < 0.05
    with pytest.raises(InfeasibleError, match="nearer to an obstacle"):
        task_of(made).plan(request((1.72, 2.0, 1.0)))


def test_plans_keep_from_each_map_what_its_filter_keeps():
    words = {"scene": BALL, "plan": line_plan(START, GOAL), "is_clear": True, "inflation_m": 0.07}
    asked = request((1.4, 2.0, 1.0))
    made = mission("cone-backup", **words)
    found = task_of(made).plan(asked)
    assert found.manifest.radius_m == pytest.approx(0.15 + 0.1 + 0.07)
    assert verify_plan(found, scene=BALL).covered
    both = mission("polytope-cbf", cover=box_cover(PILLAR), **words | {"inflation_m": None})
    found = task_of(both).plan(asked)
    assert {each["map"]: each["keep_m"] for each in found.manifest.maps} == {"cover": 0.25, "scene": 0.25}
    assert verify_plan(found, cover=box_cover(PILLAR), scene=BALL).covered


@pytest.mark.parametrize(
    ("name", "is_followed"), [("polytope-cbf", True), ("cone-di", True), ("cone-backup", False)]
)
def test_plans_keep_to_what_the_vehicle_follows_of_the_set_points_that_it_gets(name, is_followed):
    more = {"scene": BALL} if name != "polytope-cbf" else {"cover": BOX}
    made = mission(name, plan=line_plan(START, GOAL), is_clear=True, vehicle=COPTER, **more)
    found = task_of(made).plan(request((1.3, 2.0, 1.0)))
    assert (beyond_followed(found, COPTER) == "") is is_followed


def test_a_request_that_cannot_be_sent_is_said_and_changes_nothing():
    looked = _Looked(blocked(replans=2))
    looked.planner.ask = lambda request: False
    assert looked.look(5.0) == []
    assert sum("could not be sent" in words for words in looked.lines) == 2


def test_a_plan_from_a_motion_begins_with_it():
    made = blocked()
    found = task_of(made).plan(request((1.0, 2.0, 1.0), (0.2, -0.5, 0.1), acceleration=(0.1, 0.2, 0.0)))
    row = curve_of(found).at(np.zeros(1))[0]
    np.testing.assert_allclose(row[:3], (1.0, 2.0, 1.0), atol=1e-9)
    np.testing.assert_allclose(row[3:6], (0.2, -0.5, 0.1), atol=1e-6)
    np.testing.assert_allclose(row[6:9], (0.1, 0.2, 0.0), atol=1e-5)


def test_no_plan_leads_lower_than_the_first_or_out_of_the_fence():
    wall = box_cover([((18, -90, 8), (22, 90, 16))])  # with room below, where the ground may be
    config = PlanConfig(beyond_map_m=6.0, start=START, goal=GOAL, radius_m=0.27)
    made = mission(cover=wall, plan=plan(config, ELSEWHERE), is_clear=True)
    found = task_of(made).plan(request((1.4, 2.0, 1.0)))
    points = curve_of(found).at(np.linspace(0, found["time"][-1], 500))[:, :3]
    assert points[:, 2].min() >= 1.0 - 1e-6
    low = mission(cover=wall, plan=plan(config, ELSEWHERE), is_clear=True, fence=(-1, 0, -1, 5, 4, 1.5))
    with pytest.raises(InfeasibleError):
        task_of(low).plan(request((1.4, 2.0, 1.0)))


def test_a_plan_from_which_a_failsafe_would_fly_into_the_map_is_refused():
    made = blocked()
    home = WayHome(height_m=1.0, setting="RTL_ALT 100")
    own = OwnSafety(
        (Failsafe("the radio is lost", Action.RETURN, "FS_THR_ENABLE 1", "FS_THR_ENABLE to 3"),), home
    )
    harmless = dataclasses.replace(own, failsafes=())
    asked = request(home=(0.3, 2.0, 0.0))
    task_of(made).plan(asked, harmless)
    with pytest.raises(InfeasibleError, match="flies home"):
        task_of(made).plan(asked, own)


@pytest.mark.parametrize(
    "fields",
    [{"replan_after_s": 0.0}, {"margin_m": 0.0}, {"filter": "none"}],
    ids=["off", "margin", "filter"],
)
def test_without_a_time_a_margin_or_a_filter_there_are_no_new_plans(fields):
    assert replan_facts(blocked(**fields) if "filter" not in fields else blocked("none")) is None


class _Looked:
    """A replanner that looks at a vehicle which is held up, at rest or in even motion."""

    def __init__(self, made, **words):
        self.replanner, self.planner = replanner_of(made, **words)
        self.clock, self.lines = make_clock(made), []

    def look(self, seconds, position=(1.5, 2.0, 1.0), now_s=0.0, velocity=(0.0, 0.0, 0.0)):
        """Plans that were joined; the position is that of the end."""
        joined, held_up = [], SimpleNamespace(status=FilterStatus.FILTERED, error_m=0.9)
        for i in range(round(seconds / TICK)):
            now = now_s + i * TICK
            state = VehicleState(
                received_s=now,
                position=np.array(position) - (seconds - i * TICK) * np.array(velocity),
                attitude_wxyz=np.array([1.0, 0, 0, 0]),
                velocity=np.array(velocity),
                omega=np.zeros(3),
            )
            found = self.replanner.tick(
                now, TICK, state, self.clock, held_up, None, lambda level, words: self.lines.append(words)
            )
            joined += [] if found is None else [found]
        return joined


def test_a_vehicle_that_moved_away_while_its_plan_was_made_does_not_join_it():
    looked = _Looked(blocked(), looks=300)
    assert looked.look(2.0) == []
    assert len(looked.planner.requests) == 1
    assert looked.look(3.0, (0.9, 2.0, 1.0), 2.0) == []
    assert any("from its new plan" in words for words in looked.lines)


def test_a_plan_that_took_seconds_is_joined_by_a_vehicle_that_still_stands_there():
    looked = _Looked(blocked(), looks=300)
    (joined,) = looked.look(4.1)
    assert joined.time_s == pytest.approx(0.0, abs=0.6)
    assert joined.rate < 0.2


def test_a_vehicle_joins_a_new_plan_where_it_is_and_as_fast_as_it_is():
    looked = _Looked(blocked(), looks=15)
    velocity = np.array([-0.05, -0.4, 0.1])
    (joined,) = looked.look(1.15, velocity=velocity)
    (request,) = looked.planner.requests
    np.testing.assert_allclose(request.velocity, velocity, atol=1e-9)
    asked_s = 0.99
    np.testing.assert_allclose(request.position, (1.5, 2.0, 1.0) - (1.15 - asked_s) * velocity, atol=0.01)
    target = joined.target()[0]
    assert joined.time_s == pytest.approx(0.15, abs=0.03)  # what the planning took
    np.testing.assert_allclose(target[:3], (1.5, 2.0, 1.0) - TICK * velocity, atol=0.01)
    np.testing.assert_allclose(target[3:6], velocity, atol=0.1)


def test_the_number_of_requests_is_bounded_and_a_dead_planner_is_not_asked():
    looked = _Looked(blocked(replans=2), answer=refusing)
    assert looked.look(20.0) == []
    assert len(looked.planner.requests) == 2
    assert sum("no more than 2" in words for words in looked.lines) == 1
    looked = _Looked(blocked())
    looked.planner.has_ended = True
    assert looked.look(20.0) == []
    assert looked.planner.requests == []
    assert len(looked.lines) == 1


def test_a_plan_that_is_not_a_number_is_not_joined():
    looked = _Looked(blocked())

    def broken(request):
        found = looked.planner.plan(request)
        kind, shape, raw = found.arrays["coefficient"]
        values = np.frombuffer(raw, kind).copy()
        values[5] = math.nan
        arrays = found.arrays | {"coefficient": (kind, shape, values.tobytes())}
        return ReplanAnswer(number=request.number, reason="", manifest=found.manifest, arrays=arrays)

    looked.planner.make = broken
    with pytest.raises(ValueError, match="finite"):  # the loop goes on without new plans
        looked.look(2.0)
    assert looked.replanner.joined == []


def held(**words):
    return HeldUp(after_s=2.0, near_m=0.3, **words)


def for_s(watch, seconds, rate, error_m=0.9, changed=1.0):
    """Ticks at a rate of the plan's time; whether one of them was held up."""
    found = False
    for i in range(round(seconds / TICK)):
        watch.time_s = getattr(watch, "time_s", 1.0) + rate * TICK
        is_changed = i % 10 < 10 * changed
        found |= watch.update(TICK, watch.time_s, error_m, is_changed=is_changed)
    return found


@pytest.mark.parametrize(
    ("words", "is_held"),
    [
        ({"rate": 0.02}, True),
        ({"rate": 0.2}, False),
        ({"rate": 0.02, "error_m": 0.25}, False),
        ({"rate": 0.02, "changed": 0.3}, False),
        ({"rate": 0.02, "changed": 0.7}, True),
    ],
)
def test_a_flight_is_held_up_when_its_filter_stops_the_time_along_the_plan(words, is_held):
    assert not for_s(held(), 1.9, 0.02)
    assert for_s(held(), 5.0, **words) is is_held


def test_progress_begins_the_time_anew():
    watch = held()
    assert not for_s(watch, 1.5, 0.0)
    assert not for_s(watch, 0.5, 1.0)
    assert not for_s(watch, 1.7, 0.0)
    assert for_s(watch, 0.5, 0.0)


@pytest.mark.parametrize("table", ["mission", "rules"])
def test_simulations_refuse_new_plans_in_words(table):
    with pytest.raises(UsageError, match=r"replan_after_s: simulate makes no new plans.* link sim: does"):
        decoded({"schema": "alula/scenario", "version": "2.0", table: {"replan_after_s": 2.0}})


def test_a_clock_enters_a_plan_at_a_time_and_rate_and_leaves_out_earlier_via_points():
    made = blocked()
    clock = PlanClock(made.curve, _core.PlanClockOptions(via_s=[1.0, 2.0], via_m=0.15))
    clock.enter(1.5, 0.4, 0.3)
    assert (clock.time_s, clock.rate) == (1.5, 0.4)
    row = made.curve.at(np.array([1.5]))[0]
    np.testing.assert_allclose(clock.target()[0, 3:6], 0.4 * row[3:6], atol=1e-12)
    assert clock.target()[0, 15] == pytest.approx(0.3)
    for _ in range(300):
        clock.advance(TICK, 0.2)  # too far for a via point to be passed
    assert clock.time_s == 2.0
    for wrong in ((-0.1, 0.5, 0.0), (1.0, 1.5, 0.0), (1.0, math.nan, 0.0), (1.0, 0.5, math.nan)):
        with pytest.raises(ValueError, match="entered"):
            clock.enter(*wrong)
