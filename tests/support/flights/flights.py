"""Flights of the fake vehicle through the real loop, in no time at all."""

import dataclasses
import math

import numpy as np

from alula.schemas.parameters.configs.fly import FlyConfig
from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.stages.filtering.polytope_cbf import without_filter
from alula.stages.filtering.protocol import FilterResult, FilterStatus
from alula.stages.filtering.registry import make_filter
from alula.stages.flight.loop.checks import FlightChecks
from alula.stages.flight.loop.control_loop import ControlLoop
from alula.stages.flight.mission import (
    make_clock,
    make_commander,
    make_guard,
    make_mission,
    make_needs,
    make_options,
    wanted_setpoints,
)
from alula.stages.world.filters import flown_filter, plain
from support.scenes.small_scenes import ball_scene, box_cover, line_plan
from support.vehicles.fake_vehicle import FakeClock, FakeVehicle, Kept

PILLAR = [((18, 0, 0), (22, 15, 20))]  # x 1.8 to 2.2, y 0 to 1.5
START, GOAL = (0.3, 2.0, 1.0), (3.7, 2.0, 1.0)
BALL = ball_scene([(2.0, 2.2, 1.0), (2.0, -1.0, 1.0)], 0.3)  # in the way of the straight line


def mission(
    name="polytope-cbf",
    *,
    cover=None,
    scene=None,
    plan=None,
    is_clear=None,
    vehicle=FASTBRIDGE,
    tiles=None,
    **fields,
):
    """By default past a pillar."""
    needs_hulls = name == "polytope-cbf"
    is_splat = not needs_hulls and (scene is not None or name in ("shield", "cone-backup", "cone-ecbf"))
    cover = box_cover(PILLAR) if cover is None and scene is None else cover
    plan = plan or line_plan(START, GOAL)
    made = make_mission(
        FlyConfig(**{"filter": name, "allow_tight": True, **fields}),
        plan,
        vehicle,
        cover=cover,
        scene=scene,
        is_splat=is_splat,
        tiles=tiles,
    )
    return made if is_clear is None else dataclasses.replace(made, is_clear=(is_clear, "said so"))


def loop_of(
    made,
    vehicle,
    *,
    interrupts=lambda: 0,
    dry_run=False,
    by_hand=False,
    recorder=None,
    watchdog=None,
    replanner=None,
):
    """The loop for a mission over a fake vehicle."""
    commander = make_commander(made, vehicle.accepts)
    checks = FlightChecks(make_needs(made, wanted_setpoints(made)), by_hand=by_hand, patience_s=5.0)
    return ControlLoop(
        vehicle,
        commander,
        make_guard(made, vehicle.accepts),
        make_clock(made),
        checks,
        float(made.start[2]),
        recorder or Kept(),
        make_options(made.config, dry_run=dry_run),
        watchdog=watchdog,
        replanner=replanner,
        interrupts=interrupts,
        clock=vehicle.clock,
        sleep=vehicle.clock.sleep,
    )


def safety_of(made):
    """The filter of a flight as one of Python, before flights take it."""
    name, told = made.config.filter, made.world.told
    if name == "none":
        return None if made.is_splat else without_filter(told, {})
    return make_filter(name, told, plain(name, made.world.scenario.safety.parameters(name)))


def behind(made, changed):
    """The flight behind another filter."""
    world = made.world
    filters = [flown_filter(changed, world.lag_s, world.max_speed_m_s)]
    return dataclasses.replace(made, world=dataclasses.replace(world, filters=filters))


def refilter(loop, made, change=lambda inner: inner):
    """From now on fly behind a changed filter; what was sent before is forgotten."""
    changed = change(safety_of(made))
    loop.commander = make_commander(behind(made, changed), loop.link.accepts)
    return changed


def fly(made=None, on_poll=None, **keywords):
    """Fly; the loop and the vehicle."""
    made = made or mission()
    names = ("accepts", "frame", "state_hz", "position")
    given = {name: keywords.pop(name) for name in names if name in keywords}
    vehicle = FakeVehicle(FakeClock(), given.pop("position", (START[0], START[1], 0.0)), **given)
    if on_poll is not None:
        vehicle.on_poll = on_poll
    loop = loop_of(made, vehicle, **keywords)
    loop.run()
    return loop, vehicle


def after(seconds, do):
    """A fault `seconds` after the vehicle is first flown by set-points, done once."""
    begun, done = [], []

    def poll(vehicle, now):
        if vehicle.sent and not begun:
            begun.append(now)
        if begun and not done and now - begun[0] >= seconds:
            done.append(now)
            do(vehicle)

    return poll


class Breaking:
    """A filter that breaks after a number of calls: raises, gives NaN, refuses, or falls back."""

    kind = "velocity"

    def __init__(self, inner, how, at):
        self.inner, self.how, self.left = inner, how, at

    def reset(self):
        pass

    def __call__(self, state, nominal):
        self.left -= 1
        result = self.inner(state, nominal)
        if self.left > 0:
            return result
        if self.how == "raises":
            raise RuntimeError("no more")
        if self.how == "too fast":
            return FilterResult(np.array([0, 0, 14.0]), FilterStatus.OK, 1.0)
        if self.how == "nan":
            return FilterResult(np.array([math.nan, 0, 0]), FilterStatus.OK, 1.0)
        status = FilterStatus.REFUSED if self.how == "refuses" else FilterStatus.RECOVERING
        return FilterResult(np.zeros(3), status, 1.0)
