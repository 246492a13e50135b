"""The watchdog stops and lands the vehicle when the loop ends or stalls, and never otherwise.

The program of its process runs here, on the clock of the flight; `tests/realtime/test_watchdog.py` has the
process.
"""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from alula.schemas.errors import LinkError
from alula.stages.flight.links.mavlink.signing import Signer
from alula.stages.flight.links.mavlink.wire import Wire
from alula.stages.flight.links.protocol import Place, Ward
from alula.stages.flight.loop.supervisor import Event, State
from alula.stages.flight.watchdog import companion, watchdog
from alula.stages.flight.watchdog.companion import REACTION_S, STALL_S, STOPPING_S, Frames, Takeover
from alula.stages.sim_vehicle.px4.modes import Px4Mode
from alula.stages.sim_vehicle.px4.vehicle import Px4Copter
from alula.stages.vehicles.setpoints import VelocitySetpoint
from support.flights.flights import BALL, mission
from support.scenes.small_scenes import line_plan
from support.vehicles.lockstep import Flight, Upset, interrupt, stall
from support.vehicles.mavlink_peer import m, vehicle
from support.vehicles.served_autopilot import Served, flight, stream, take_off
from support.vehicles.watchdogs import WatchdogHere

KEY = bytes(range(32))
MODE_ORDERS = (m.MAV_CMD_DO_SET_MODE,)


@pytest.fixture(scope="module")
def by_rates():
    return mission("cone-backup", scene=BALL, is_clear=True, plan=line_plan((0.3, 3.2, 1.0), (3.7, 3.2, 1.0)))


@pytest.fixture(scope="module")
def short():
    return mission(plan=line_plan((0.3, 2.0, 0.5), (2.7, 2.0, 0.5), 3.5), rate_hz=50.0)


@pytest.fixture(autouse=True)
def at_once(monkeypatch):
    """Rotors obey as soon as they are armed: two seconds less of each flight."""
    monkeypatch.setattr("alula.stages.sim_vehicle.ardupilot.copter.ArduCopter.ARMING_DELAY_S", 0.1)


class Modes(Flight):
    """A watched flight that keeps the vehicle's modes and when they were entered."""

    def __post_init__(self):
        super().__post_init__()
        self.watched, self.modes = True, []

    def tick(self, now):
        super().tick(now)
        name = self.copter.mode.name
        if not self.modes or self.modes[-1][1] != name:
            self.modes.append((now, name))

    @property
    def names(self):
        return [name for _, name in self.modes]

    def entered_mode(self, name):
        return next(at for at, each in reversed(self.modes) if each == name)

    @property
    def said(self):
        return self.watchdog.program.said


def test_a_loop_that_stalls_finds_its_vehicle_stopped_and_landing(by_rates):
    flown = Modes(by_rates, [Upset(State.FLY, 2.0, stall(1.5))]).fly()
    flown.judge()
    assert flown.names[-2:] == ["GUIDED", "LAND"]
    last_s = max(at for at, each in flown.packets() if each.get_type() == "SET_ATTITUDE_TARGET")
    assert STALL_S < flown.entered_mode("LAND") - last_s < REACTION_S
    assert flown.cause is Event.WATCHDOG
    assert flown.loop.ending.startswith("watchdog took over (the loop stalled for 1.5")
    assert flown.said == [
        "watchdog: the loop stalled, 0.21 s after its last tick; taking the vehicle over: LAND",
        "watchdog: the vehicle lands",
    ]
    assert not flown.copter.failsafe  # heartbeats went on


def test_a_loop_that_stalls_within_a_tick_knows_for_how_long(short):
    """It beats once more before it asks whether it was replaced."""

    def stop(flown):
        record = flown.loop._record

        def stopped(*words):
            flown.loop._record = record
            flown.time.sleep(1.5)
            record(*words)

        flown.loop._record = stopped

    flown = Modes(short, [Upset(State.FLY, 0.5, stop)]).fly()
    assert flown.names[-2:] == ["GUIDED", "LAND"]
    assert flown.loop.ending.startswith("watchdog took over (the loop stalled for 1.5")


def test_a_loop_that_stalls_without_control_changes_nothing(short):
    checks, arming = (Upset(state, 0.1, stall(0.6)) for state in (State.CHECKS, State.ARMING))
    landing = [Upset(State.FLY, 0.3, interrupt(1)), Upset(State.LAND, 0.5, stall(0.6))]
    for upsets, names in (([arming], ["GUIDED"]), ([checks, *landing], ["GUIDED", "LAND"])):
        flown = Modes(short, upsets).fly()
        assert not flown.upsets
        assert flown.names == ["STABILIZE", *names]
        assert flown.said == []
        assert flown.cause in (Event.STATE_STALE, Event.INTERRUPT)


def test_the_pilot_who_was_faster_keeps_the_vehicle(short):
    def both(flown):
        flown.copter.switch_to(5)
        flown.time.extra_s = 1.0

    flown = Modes(short, [Upset(State.FLY, 0.5, both), Upset(State.HAND_OVER, 0.5, interrupt(1))]).fly()
    assert flown.names[-1] == "LOITER"
    assert "LAND" not in flown.names
    assert flown.cause is Event.MODE_CHANGED
    assert flown.said[0].endswith("somebody else has already taken the vehicle over")


def test_the_pilot_takes_it_from_the_watchdog(short):
    def switch(flown):
        if flown.copter.mode.name == "LAND" and flown.time() - flown.entered_mode("LAND") > 0.5:
            flown.copter.switch_to(5)

    flown = Modes(short, [Upset(State.FLY, 0.5, stall(3.0)), Upset(State.HAND_OVER, 0.5, interrupt(1))])
    flown.each = switch
    flown.fly()
    assert flown.names[-2:] == ["LAND", "LOITER"]
    assert flown.said[-1] == "watchdog: somebody else has the vehicle now"


def test_a_loop_that_fails_lands_by_itself_and_by_its_watchdog_if_that_is_not_heard(short):
    def broken(*_):
        raise RuntimeError("no more")

    def deaf(flown):
        flown.link._orders.poll = lambda now_s: None  # orders are not repeated
        flown.link._orders._advance = flown.link._orders.poll
        flown.loop.guard.distance = broken

    for fails, names in ((lambda flown: setattr(flown.loop.guard, "distance", broken), ["LAND"]), (deaf, [])):
        flown = Modes(short, [Upset(State.FLY, 0.5, fails)])
        with pytest.raises(RuntimeError, match="no more"):
            flown.fly()
        assert flown.names[-1] == (names or ["GUIDED"])[-1]
        taken = flown.watchdog.program
        taken.step(flown.time())
        taken.step(flown.time() + 0.1)
        assert bool(taken.said) is not bool(names)
        assert not any("stalled" in words for words in taken.said)
        taken.close()


def left_alone(served, *, seconds=3.2, before=lambda served, link: None):
    """Modes of a vehicle whose loop ends at 1 m/s, with their times since then."""
    with flight(served=served) as (served, time, link):
        here = WatchdogHere(link.guarded())
        take_off(time, link)
        stream(time, link, 1.0, lambda s: VelocitySetpoint(np.array([1.0, 0, 0]), 0.0))
        before(served, link)
        here.beat(time(), is_in_control=True)
        here.program.step(time())
        here._socket.close()
        begin_s, found = time(), []
        for _ in range(round(seconds * 100)):
            time.sleep(0.01)
            here.program.step(time())
            mode = getattr(served.copter, "flown", served.copter.mode).name
            if not found or found[-1][1] != mode:
                found.append((time() - begin_s, mode))
        here.program.close()
        return found, here.program.said


def test_the_end_of_the_loop_needs_no_waiting():
    found, said = left_alone(None)
    assert found[-1][1] == "LAND"
    assert found[-1][0] <= 0.03
    assert said[0].startswith("watchdog: the loop ended, 0.01 s after its last tick")


class Px4(Served):
    kind, fast = Px4Copter, {"MPC_TKO_SPEED": 5.0, "MPC_TKO_RAMP_T": 0.25}


@pytest.mark.slow
def test_px4_holds_and_lands():
    found, _ = left_alone(Px4())
    assert [name for _, name in found[-2:]] == [Px4Mode.HOLD.name, Px4Mode.LAND.name]
    assert found[-2][0] <= 0.03
    assert found[-1][0] == pytest.approx(STOPPING_S, abs=0.1)


def test_a_vehicle_that_does_not_hold_lands_at_once():
    def refusing(served, link):
        enter = served.copter.set_mode
        served.copter.set_mode = lambda number: number != Px4Mode.HOLD and enter(number)

    found, _ = left_alone(Px4(), before=refusing)
    assert found[-1][1] == Px4Mode.LAND.name
    assert found[-1][0] < 0.1


def test_without_a_position_it_is_landed():
    with vehicle(address="?mode=guided_nogps", ready=False) as (_, _, link):
        settings = link.guarded().settings
    assert (settings["control"], settings["stopping"], settings["landing"]) == (20, None, 9)
    takeover = Takeover(settings)
    takeover.beat(companion.BEAT.pack(1, 5.0, True, 20, 5.0, 0, 1))
    takeover.begin(5.3)
    assert takeover.words == [
        "watchdog: the loop stalled, 0.30 s after its last tick; taking the vehicle over: LAND"
    ]
    orders = [each for each in read(takeover.poll(5.3)) if each.get_type() == "COMMAND_LONG"]
    assert [(each.command, each.param1, each.param2) for each in orders] == [(176, 1.0, 9.0)]


def read(frames):
    reader = m.MAVLink(None)
    return [message for frame in frames for message in reader.parse_buffer(frame)]


SETTINGS = {
    **{"system": 255, "component": 191, "vehicle": 1, "key": None, "link": 1},
    **{"control": 4, "stopping": 17, "landing": 9, "stop_name": "BRAKE", "land_name": "LAND"},
    **{"heartbeat": (0, 50, b"h" * 9), "stop": (76, 152, b"s" * 33), "land": (76, 152, b"l" * 33)},
}


def begun(**changed):
    """A takeover that began at 10 s."""
    takeover = Takeover(SETTINGS | changed)
    takeover.beat(companion.BEAT.pack(1, 9.79, True, 4, 9.7, 0, 1))
    assert takeover.is_missing(10.0)
    takeover.begin(10.0)
    return takeover


def run(takeover, seconds, mode, *, begin_s=10.0):
    """Orders in 0.01 s steps: times of stops and of landings."""
    stops, landings = [], []
    for step in range(round(100 * seconds)):
        now_s = begin_s + 0.01 * step
        takeover.frames.mode = mode(now_s)
        for frame in takeover.poll(now_s):
            payload = frame[10:-2]
            stops += [now_s] * (payload == b"s" * 33)
            landings += [now_s] * (payload == b"l" * 33)
    return stops, landings


def test_orders_are_repeated_until_the_mode_is_reported_and_again_if_it_is_lost():
    stops, landings = run(begun(), 13.0, lambda now_s: 4 if now_s < 10.3 else 17)
    assert np.diff([10.0, *stops, 10.3]).max() < 0.065
    assert (len(stops), stops[0]) == (6, 10.0)
    assert landings[0] == pytest.approx(10 + STOPPING_S, abs=0.011)
    assert landings[-1] > 12.9
    stops, _ = run(begun(), 1.0, lambda now_s: 4 if 10.5 < now_s < 10.6 else 17)
    assert len(stops) == 2


def test_it_ends_when_the_landing_is_confirmed_and_soon_if_it_never_is():
    takeover = begun()
    run(takeover, 4.0, lambda now_s: 17 if now_s < 12.1 else 9)
    assert takeover.is_over
    assert takeover.words[-1] == "watchdog: the vehicle lands"
    takeover = begun()
    stops, landings = run(takeover, 30.0, lambda _: None)
    assert stops[-1] == pytest.approx(11.0, abs=0.06)  # nothing is heard: then it is to land
    assert landings[-1] < 21.1
    assert takeover.is_over
    assert takeover.words[-1] == "watchdog: the vehicle did not confirm that it lands"


def test_a_farewell_ends_it_and_silence_without_control_does_not_begin_it():
    for messages in ([companion.FAREWELL], [b""]):
        takeover = Takeover(SETTINGS)
        takeover.beat(companion.BEAT.pack(1, 1.0, False, 4, 0.9, 0, 1))
        assert not takeover.is_missing(50.0)
        for message in messages:
            takeover.take(message)
        assert takeover.is_over


@given(st.binary(max_size=80), st.booleans(), st.booleans())
def test_any_bytes_are_heard_and_only_whole_frames_count(data, signed, is_datagram):
    frames = Frames(SETTINGS | {"key": KEY if signed else None})
    beat = m.MAVLink_heartbeat_message(2, 3, 209, 17, 4, 3)
    frame = bytes(beat.pack(m.MAVLink(None, 1, 1)))
    frames.take(data, is_datagram=is_datagram)
    assert frames.mode is None
    frames.take(b"" if not is_datagram else data + frame, is_datagram=is_datagram)
    if not is_datagram:
        for part in (frame[:7], frame[7:]):
            frames.take(bytes(600) + part if part == frame[:7] else part, is_datagram=False)
    assert frames.mode == (None if signed else 17)
    assert frames.is_armed


@given(st.binary(min_size=1, max_size=255), st.integers(0, 255))
def test_its_checksum_is_that_of_pymavlink(data, extra):
    from pymavlink.generator.mavcrc import x25crc

    assert companion.checksum(data, extra) == x25crc(data + bytes([extra])).crc


def test_older_frames_are_read_and_refusals_of_other_commands_are_not():
    frames = Frames(SETTINGS)
    old = m.MAVLink_heartbeat_message(2, 3, 81, 9, 4, 3).pack(m.MAVLink(None, 1, 1), force_mavlink1=True)
    frames.take(bytes(old), is_datagram=True)
    assert (frames.mode, frames.is_armed) == (9, False)
    for system, command, result, is_refused in (
        (1, 400, 4, 0),
        (2, 176, 4, 0),
        (1, 176, 0, 0),
        (1, 176, 4, 1),
    ):
        ack = m.MAVLink_command_ack_message(command, result).pack(m.MAVLink(None, system, 1))
        frames.take(bytes(ack), is_datagram=True)
        assert frames.is_refused == bool(is_refused)


def test_signed_frames_are_new_to_the_vehicle_and_make_no_others_old(tmp_path):
    wall, now = 1.8e9, [100.0]

    def signer(name):
        clock = {"clock": lambda: now[0], "wall_clock": lambda: wall + now[0] - 100.0}
        return Signer(KEY, file=tmp_path / name, **clock)

    ours, of_vehicle = signer("ours"), signer("vehicle")
    wire = Wire(255, 191, [], ours)
    heartbeat = m.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)
    frames = Frames(SETTINGS | {"key": KEY})

    def passes(frame):
        return of_vehicle.accepts(frame, 255, 191)

    for _ in range(3):  # the loop flies, stalls, is replaced, and goes on; then another run begins
        for _ in range(400):
            now[0] += 0.25
            assert passes(wire.pack(heartbeat))
        frames.stamp = max(frames.stamp, ours.newest)
        last = [frames.pack(*Wire.parts(heartbeat)) for _ in range(300)]
        assert all(passes(frame) for frame in last)
        assert not passes(last[0])
        assert passes(wire.pack(heartbeat))  # after SIGCONT
        ours = signer("ours")  # the file was not saved at the end
        wire, frames = Wire(255, 191, [], ours), Frames(SETTINGS | {"key": KEY})


def test_signed_heartbeats_are_heard_once_they_are_authentic_and_not_older_ones():
    frames = Frames(SETTINGS | {"key": KEY})

    def beat(mode, stamp, key=KEY):
        mav = m.MAVLink(None, 1, 1)
        mav.signing.secret_key, mav.signing.sign_outgoing, mav.signing.timestamp = key, True, stamp
        return bytes(m.MAVLink_heartbeat_message(2, 3, 209, mode, 4, 3).pack(mav))

    for frame, mode in (
        (beat(4, 1000), 4),
        (beat(17, 2000, bytes(32)), 4),
        (beat(17, 2000), 17),
        (beat(4, 1500), 17),
    ):
        frames.take(frame, is_datagram=True)
        assert frames.mode == mode


def test_a_late_tick_is_no_stall_and_a_flight_without_its_watchdog_goes_on(short):
    """The watchdog ends after a tick that was late."""

    def lose(flown):
        assert flown.said == []
        flown.watchdog.program.close()
        flown.watchdog.program.step = lambda now_s: None

    flown = Modes(short, [Upset(State.FLY, 0.5, stall(0.15)), Upset(State.FLY, 0.9, lose)]).fly()
    assert flown.cause is Event.PLAN_FINISHED
    assert flown.said == []
    assert sum("the watchdog has ended" in words for *_, words in flown.recorder.lines) == 1


def test_a_watchdog_that_is_held_up_or_gone_holds_nobody_up():
    here = WatchdogHere(Ward(dict(SETTINGS), lambda: Place(0, "stream"), lambda: (4, 0.0, 0)))
    for _ in range(5000):  # it reads none of them
        here.beat(1.0, is_in_control=True)
    assert not here.has_ended
    here.program.close()
    for _ in range(50):
        here.beat(1.0, is_in_control=True)
    assert here.has_ended
    assert not here.has_taken_over
    here.close()


def test_a_beat_that_is_being_written_does_not_count():
    takeover = Takeover(SETTINGS)
    takeover.beat(companion.BEAT.pack(1, 5.0, True, 4, 5.0, 0, 1))
    takeover.beat(companion.BEAT.pack(2, 9.0, False, 4, 5.0, 0, 1))
    assert takeover.is_missing(5.3)


def test_a_new_line_is_passed_on(tmp_path):
    import os

    files = [os.open(tmp_path / name, os.O_CREAT | os.O_RDWR) for name in "ab"]
    place = [Place(files[0], "stream")]
    here = WatchdogHere(Ward(dict(SETTINGS), lambda: place[0], lambda: (4, 0.0, 0)))
    for place[0] in (Place(None, "stream"), Place(files[1], "stream")):  # it dropped out, and is back
        here.beat(1.0, is_in_control=True)
        here.program.step(1.0)
    here._socket.close()
    here.program.step(1.0)
    here.program.close()
    assert [len((tmp_path / name).read_bytes()) for name in "ab"] == [0, 9 + 33 + 24]
    for file in files:
        os.close(file)


def test_a_process_that_does_not_start_ends_the_flight_before_it_begins(monkeypatch):
    ward = Ward(dict(SETTINGS), lambda: Place(0, "stream"), lambda: (4, 0.0, 0))
    for program, words in (
        ("/nowhere/python", "does not start: No such file"),
        ("/bin/true", "does not run"),
    ):
        monkeypatch.setattr(watchdog.sys, "executable", program)
        with pytest.raises(LinkError, match=words):
            watchdog.Watchdog(ward)


def test_links_without_orders_of_their_own_have_none():
    from alula.stages.flight.links.open_link import open_link

    assert watchdog.guard(open_link("sim:")) is None


def test_a_system_without_what_the_watchdog_needs_flies_without_and_says_so(monkeypatch, capsys):
    from alula.cli.verbs.fly.contact import NO_WATCHDOG, reach

    class Guarded:
        def open(self, within_s):
            return "a vehicle"

        def prepare(self):
            return []

        def guarded(self):
            raise AssertionError("no watchdog is possible")

    monkeypatch.delattr(watchdog.os, "memfd_create")
    contact = reach(Guarded(), "udp:14550", quiet=False)
    assert contact.watchdog is None
    assert NO_WATCHDOG in capsys.readouterr().err


def test_both_distances_are_said(by_rates):
    flown = Flight(by_rates, loop_words={"dry_run": True})

    def look(flown):
        if flown.loop is not None and flown.link.status.own_safety is not None:
            import dataclasses

            own = flown.link.status.own_safety
            flown.link.status.own_safety = dataclasses.replace(own, watched_s=REACTION_S)

    flown.each = look
    flown.fly()
    words = next(each.words for each in flown.loop.checks.verdicts if each.name == "failsafes")
    first, _, second = words.partition("it coasts at most ")[2].partition(" m when this program dies, ")
    assert second.endswith(" m when its computer does")
    needs, own = flown.loop.checks.needs, flown.link.status.own_safety
    assert float(first) == pytest.approx(needs.speed_m_s * REACTION_S + needs.stop_m, abs=0.06)
    assert float(second.split()[0]) == pytest.approx(needs.speed_m_s * own.alone_s + needs.stop_m, abs=0.06)
    assert math.isfinite(own.alone_s)
