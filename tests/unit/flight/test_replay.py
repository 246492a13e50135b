"""Recorded flights through a simulated autopilot: the native flight repeats every set-point, bit by bit."""

import dataclasses
import json

import numpy as np
import pytest

from alula.schemas.errors import InputError
from alula.schemas.log.mcap import messages
from alula.stages.flight.mission import make_commander
from alula.stages.flight.recorder.log import FlightRecorder
from alula.stages.flight.replay import replay
from support.flights.flight_logs import head_of, record_of
from support.flights.flights import BALL, GOAL, START, mission
from support.flights.flights import fly as fly_fake
from support.flights.watched_flights import fly
from support.scenes.small_scenes import line_plan


def recorded(path, made, flown, **keywords):
    """The log of a flight, and the kinds of set-points of its link."""
    recorder = FlightRecorder(path, head_of(made), echo=False)
    loop, _ = flown(made, recorder=recorder, **keywords)
    assert recorder.finish(record_of(made, loop, recorder))
    assert recorder.dropped == 0
    return loop.link.accepts


def ticks_of(path):
    with path.open("rb") as file:
        return [json.loads(data) for _, data in messages(file, ("/replay",))]


def commander_of(made, accepts):
    return make_commander(made, accepts)


MISSIONS = {
    "velocity": lambda: mission(plan=line_plan(START, GOAL, 4.5)),
    "rates": lambda: mission("cone-backup", scene=BALL, is_clear=True),
    # an autopilot that follows accelerations late swings wide around the ball: nothing but the filter may act
    "acceleration": lambda: mission(
        "cone-di", scene=BALL, is_clear=True, fence=(-4.0, -4.0, -2.0, 8.0, 8.0, 5.0)
    ),
}


@pytest.mark.every(3)
@pytest.mark.parametrize("kind", MISSIONS)
def test_the_native_flight_repeats_a_flight_through_an_autopilot_bit_by_bit(tmp_path, kind):
    log, made = tmp_path / "f.run.mcap", MISSIONS[kind]()
    accepts = recorded(log, made, fly)
    ticks = ticks_of(log)
    assert len(ticks) > 300
    assert {tick["decided"] for tick in ticks} == {kind}
    assert all(tick["is_own"] for tick in ticks) == (
        kind != "rates"
    )  # the geofence always changes rates a little
    found = replay(log, commander_of(made, accepts))
    assert found.ticks == len(ticks)
    assert found.differing == []


def test_ticks_that_were_left_out_holds_and_the_fences_set_points_are_repeated_too(tmp_path):
    log = tmp_path / "f.run.mcap"
    made = mission("cone-backup", scene=BALL, is_clear=True, fence=(-1.0, 1.2, 0.0, 5.0, 2.6, 2.0))

    def fault(vehicle, now, begun=[]):  # noqa: B006  one list per function is what is wanted
        if vehicle.sent and not begun:
            begun.append(now)
        vehicle.is_frozen = bool(begun) and 1.5 < now - begun[0] < 1.8
        if begun and 1.0 < now - begun[0] < 1.02:
            vehicle.clock.extra_s.append(0.05)

    accepts = recorded(log, made, fly_fake, on_poll=fault)
    ticks = ticks_of(log)
    assert sum(tick["number"] == 0 for tick in ticks) > 1  # a hold, and on
    assert max(tick["repeats"] for tick in ticks) >= 4
    assert any(tick["sent"] and not tick["is_own"] for tick in ticks)
    assert replay(log, commander_of(made, accepts)).differing == []


def test_another_number_of_one_tick_is_found(tmp_path):
    """The comparison sees the last bit of one measurement."""
    log, made = tmp_path / "f.run.mcap", mission(velocity_lag_s=0.0)
    accepts = recorded(log, made, fly_fake)
    commander, step = commander_of(made, accepts), type(commander_of(made, accepts)).step
    calls = []

    class Other:
        """The same commander, but one measured number is the next double."""

        def step(self, inputs):
            calls.append(1)
            measured = inputs.measured.copy()
            if len(calls) == 100:
                measured[1] = np.nextafter(measured[1], 9.0)
            return step(commander, dataclasses.replace(inputs, measured=measured))

        reset, sent = commander.reset, commander.sent

    assert len(replay(log, Other()).differing) >= 1


def test_a_log_that_lacks_a_tick_is_refused(tmp_path):
    log, made = tmp_path / "f.run.mcap", mission()
    recorder = FlightRecorder(log, head_of(made), echo=False)
    tell, seen = recorder.tick, []

    def losing(sample):
        seen.append(1)
        if sample.replay is None or sample.replay.number != 50:
            tell(sample)

    recorder.tick = losing
    loop, _ = fly_fake(made, recorder=recorder)
    recorder.finish(None)
    with pytest.raises(InputError, match="missing"):
        replay(log, commander_of(made, loop.link.accepts))
