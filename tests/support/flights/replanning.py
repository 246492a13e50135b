"""New plans in lock-step flights: made at once, and given to the flight after some of its looks."""

import time

from alula.stages.flight.replan.of_mission import make_replanner, maps_of, replan_facts
from alula.stages.flight.replan.task import ReplanAnswer, ReplanTask, answer_to


class PlannerHere:
    """A `Planner` without a process."""

    has_ended = False

    def __init__(self, made, looks=5, answer=None):
        self.task = ReplanTask(replan_facts(made), made.world.vehicle, maps_of(made))
        self.looks, self.make = looks, answer or self.plan
        self.requests, self.ready, self.left, self.is_closed = [], None, 0, False

    def plan(self, request):
        return answer_to(self.task, request, None, time.monotonic)

    def ask(self, request):
        self.requests.append(request)
        self.ready, self.left = self.make(request), self.looks
        return True

    def answer(self):
        self.left -= 1
        found, self.ready = (self.ready, None) if self.left <= 0 else (None, self.ready)
        return found

    def close(self):
        self.is_closed = True


def refusing(request):
    """No plan."""
    return ReplanAnswer(number=request.number, reason="there is no path")


def replanner_of(made, **words):
    """The part of the loop, and its planner."""
    planner = PlannerHere(made, **words)
    return make_replanner(made, planner), planner
