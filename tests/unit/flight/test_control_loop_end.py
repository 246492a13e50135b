"""Ends of flights over a fake vehicle: by Ctrl-C, by errors, when blocked, and near the goal."""

import numpy as np
import pytest

from alula.schemas.errors import LinkError
from alula.stages.flight.links.protocol import Order
from alula.stages.flight.loop.supervisor import Event, State
from support.flights.flights import START, after, fly, loop_of, mission
from support.scenes.small_scenes import line_plan
from support.vehicles.fake_vehicle import FakeClock, FakeVehicle

AS_PLANNED = ["checks", "arming", "take-off", "fly", "land", "done"]


@pytest.mark.every(2)
@pytest.mark.parametrize("seconds", [0.5, 3.0])
def test_ctrl_c_lands_and_a_second_waits_for_the_ground(seconds):
    clock = FakeClock()
    vehicle = FakeVehicle(clock, (START[0], START[1], 0.0))
    begun = []

    def asked():
        if vehicle.sent and not begun:
            begun.append(clock())
        past = clock() - begun[0] if begun else 0.0
        return (past > seconds) + (past > seconds + 0.3)

    loop = loop_of(mission(), vehicle, interrupts=asked)
    loop.run()
    assert loop.recorder.states[-2:] == ["land", "done"]
    assert loop.supervision.cause is Event.INTERRUPT
    assert vehicle.x[2] < 0.03
    assert any("motors stop on the ground only" in words for _, words in loop.recorder.lines)
    landed = [s for s in loop.recorder.samples if s.supervisor.state_name == "land"]
    assert all(s.supervisor.armed for s in landed if s.state.position_m.z > 0.05)


def test_an_error_of_the_loop_itself_lands_first():
    vehicle = FakeVehicle(FakeClock(), (START[0], START[1], 0.0))
    loop = loop_of(mission(), vehicle)

    def broken(sample):
        if loop.state is State.FLY:
            raise ZeroDivisionError

    loop.recorder.tick = broken
    with pytest.raises(ZeroDivisionError):
        loop.run()
    assert vehicle.orders[-1] is Order.LAND
    assert vehicle.status.mode == "LAND"


def test_its_last_words_are_said_again_when_the_line_was_busy():
    vehicle = FakeVehicle(FakeClock(), (START[0], START[1], 0.0))
    loop = loop_of(mission(), vehicle)
    order, refused = vehicle.order, []

    def busy(what, now, height_m=0.0):
        if what is Order.LAND and len(refused) < 3:
            refused.append(now)
            raise LinkError("busy")
        order(what, now, height_m)

    def broken(sample):
        if loop.state is State.FLY:
            raise ZeroDivisionError

    vehicle.order, loop.recorder.tick = busy, broken
    with pytest.raises(ZeroDivisionError):
        loop.run()
    assert len(refused) == 3
    assert vehicle.status.mode == "LAND"


def test_a_position_that_jumps_is_not_flown_on():
    def jump(vehicle):
        vehicle.x[:3] += (0, 0.6, 0)

    loop, _ = fly(on_poll=after(2.0, jump))
    assert loop.supervision.cause is Event.STATE_JUMPED
    assert loop.recorder.states == AS_PLANNED


def test_the_plan_waits_for_a_vehicle_that_was_moved_off():
    def push(vehicle, now, pushed=[]):  # noqa: B006  by 2 m/s for 0.6 s
        if vehicle.sent and now - vehicle.sent[0][0] > 2.0 and len(pushed) < 60:
            pushed.append(now)
            vehicle.x[1] += 0.02

    loop, _ = fly(on_poll=push)
    flown = [s.supervisor for s in loop.recorder.samples if s.safety]
    assert min(f.plan_rate for f in flown[220:]) < 0.6
    assert loop.supervision.cause is Event.PLAN_FINISHED
    steps = np.diff([f.plan_s for f in flown])
    assert steps.min() >= 0
    assert steps.max() <= 0.01 + 1e-9


def test_as_near_to_the_goal_as_the_filter_lets_it_is_there():
    beside = line_plan((0.3, 2.0, 1.0), (1.55, 1.2, 1.0))  # 0.25 m from the pillar; filters keep 0.45
    loop, _ = fly(mission(plan=beside, margin_m=0.3, near_m=1.0))
    assert loop.supervision.cause is Event.PLAN_FINISHED
    end = loop.recorder.positions("fly")[-1]
    assert 0.2 < np.linalg.norm(end - (1.55, 1.2, 1.0)) < 0.5
    assert 1.8 - end[0] > 0.4


class Hesitant(FakeVehicle):
    """Vehicle that disarms by order only, and refuses the first orders."""

    declined = 0

    def order(self, order, now_s, height_m=0.0):
        if order is Order.DISARM and self.declined < 2:
            self.declined += 1
            self.orders.append(order)
            self.status.refusals.append((order, "not landed"))
            return
        super().order(order, now_s, height_m)

    def step(self):
        armed = self.status.armed
        super().step()
        self.status.armed = armed


def test_a_vehicle_that_declines_to_disarm_after_landing_is_asked_again():
    vehicle = Hesitant(FakeClock(), (START[0], START[1], 0.0))
    loop = loop_of(mission(), vehicle)
    loop.run()
    assert loop.recorder.states == AS_PLANNED
    assert vehicle.declined == 2
    assert loop.supervision.cause is Event.PLAN_FINISHED
