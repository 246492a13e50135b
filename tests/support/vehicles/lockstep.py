"""Whole flights in lock-step: simulated autopilot, socket, link and loop on one clock that nobody waits for.

Faults are put on the line, into the vehicle, the loop or the operator's hands while it flies (`Upset`), and
the flight is judged from outside: by where the vehicle truly was, by the packets that reached it, and by the
table.
"""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from alula.schemas.errors import LinkError
from alula.stages.clearance import path_clearance
from alula.stages.flight.links.mavlink.setpoints import ATTITUDE_MASK
from alula.stages.flight.links.open_link import open_link
from alula.stages.flight.links.options import LinkOptions
from alula.stages.flight.loop.supervisor import State
from alula.stages.flight.loop.supervisor_table import TABLE
from alula.stages.sim_vehicle.common.faults import Fault
from alula.stages.sim_vehicle.common.packets import mavlink
from alula.stages.sim_vehicle.common.quaternions import from_euler, to_mrp
from alula.stages.vehicles.frames import LocalFrame
from support.flights.flights import loop_of
from support.vehicles.autopilot_client import EXACT
from support.vehicles.fake_vehicle import Kept
from support.vehicles.mavlink_peer import Time
from support.vehicles.served_autopilot import Served
from support.vehicles.watchdogs import WatchdogHere

STALE_S = 0.15
_SETPOINTS = {"SET_ATTITUDE_TARGET", "SET_POSITION_TARGET_LOCAL_NED"}
_ORDERS = {
    mavlink.MAV_CMD_DO_SET_MODE,
    mavlink.MAV_CMD_COMPONENT_ARM_DISARM,
    mavlink.MAV_CMD_NAV_TAKEOFF,
    mavlink.MAV_CMD_NAV_LAND,
}
_BRISK = {
    **{"LAND_SPEED": 120.0, "WPNAV_SPEED_DN": 200.0, "MOT_SPOOL_TIME": 0.05},
    **{"FS_THR_ENABLE": 3.0, "FS_DR_ENABLE": 1.0},  # in rooms it must not fly home in an emergency
}


class Upset(NamedTuple):
    """What goes wrong once: so long after a state was entered, or when something is so in it.

    State None is before all else.
    """

    state: State | None
    after: float | Callable[["Flight"], bool]
    do: Callable[["Flight"], None]


@dataclass
class Flight(Served):
    """A flight, and all that can be done to it on the way; `Served` is its vehicle."""

    made: Any  # the mission
    upsets: list[Upset] = field(default_factory=list)
    limits: dict[str, float] = field(default_factory=dict)
    parameters: dict[str, float] = field(default_factory=dict)
    loop_words: dict[str, Any] = field(default_factory=dict)
    observe_s: float = 0.4
    watched: bool = False  # by the program of the watchdog process, on this clock
    noise: Any = EXACT  # of its estimate
    seed: int = 3
    terrain: Any = None

    def __post_init__(self):
        Served.__init__(self, self.noise, _BRISK | self.parameters, seed=self.seed, terrain=self.terrain)
        x, y, _ = self.made.start
        self.frame = LocalFrame(origin_enu_m=(-x, -y, 0.0))  # it boots below the plan's start
        self.interrupts = 0
        self.entered: dict[State, float] = {}
        self.muted: set[str] = set()
        self.changes: dict[str, Callable[[Any], None]] = {}  # of what the vehicle says, by kind of message
        self.truth: list[tuple[float, ...]] = []
        self.heard: list[tuple[float, bytes]] = []
        tell = self.vehicle._send
        self.vehicle._send = lambda message: tell(self._changed(message)) if self._is_told(message) else None
        self.time = _Stalling(self)
        self.recorder = Kept()
        self.loop = self.link = self.watchdog = None
        self.each = lambda flight: None
        self._upset(None)

    def _is_told(self, message):
        return message.get_type() not in self.muted

    def _changed(self, message):
        if (change := self.changes.get(message.get_type())) is not None:
            change(message)
        return message

    def _upset(self, now):
        """Do what is due."""
        for upset in list(self.upsets):
            at = self.entered.get(upset.state)
            if now is None or upset.state is None:
                is_due = now is None and upset.state is None
            elif at is None or self.loop.state is not upset.state:
                is_due = False
            else:
                is_due = upset.after(self) if callable(upset.after) else now - at >= upset.after
            if is_due:
                self.upsets.remove(upset)
                upset.do(self)

    def tick(self, now):
        """The vehicle lives until now."""
        self.each(self)
        self._upset(now)
        while True:
            try:
                data, self.peer = self.socket.recvfrom(4096)
            except BlockingIOError:
                break
            self.heard.append((now, data))
            self.vehicle.receive(data)
        self.begin = now if self.begin is None else self.begin
        for packet in self.vehicle.advance(now - self.begin):
            if self.peer is not None:
                self.socket.sendto(packet, self.peer)
        self.truth.append((now, *self.copter.airframe.truth.position))
        if self.watchdog is not None:
            self.watchdog.program.step(now)

    def cut(self):
        """The line is gone for good, and says so, as that of a serial port that was pulled out does."""

        def gone(*_):
            raise LinkError("the vehicle's line is gone")

        self.link._session._transport.receive = self.link._session._transport.send = gone

    def fly(self):
        """From opening the link to closing it; the flight itself."""
        rates = self.made.is_splat
        options = LinkOptions(frame=self.frame, clock=self.time, sleep=self.time.sleep, flies_rates=rates)
        self.link = link = open_link(f"udpout:127.0.0.1:{self.port}?system=1", options)
        link.clock = self.time  # the loop's, too
        try:
            link.open(5.0)
            link.prepare()
            if self.watched:
                self.watchdog = WatchdogHere(link.guarded())
            self.loop = loop = loop_of(
                self.made,
                link,
                recorder=self.recorder,
                interrupts=lambda: self.interrupts,
                watchdog=self.watchdog,
                **self.loop_words,
            )
            loop.checks._observe_s = self.observe_s
            limits = dataclasses.replace(loop.options.limits, **self.limits)
            assert limits.stale_s == STALE_S
            loop.options = dataclasses.replace(loop.options, limits=limits)
            self.recorder.step = self._stepped
            loop.run()
        finally:
            link.close()
            self.socket.close()
        return self

    def _stepped(self, at, taken):
        self.recorder.steps.append((at, taken))
        if taken.step.state is not taken.state:
            self.entered[taken.step.state] = self.time()

    @property
    def rows(self):
        """Rows of the table that were taken, in order."""
        return [(taken.state, taken.event) for _, taken in self.recorder.steps]

    @property
    def cause(self):
        """What ended it."""
        return self.loop.supervision.cause

    def path(self, *states):
        """Times and true positions while the supervisor was in these states, shape (T, 4)."""
        rows = np.array(self.truth)
        rows[:, 1:] = self.frame.position_from_ned(rows[:, 1:])
        ticks = np.array([s.supervisor.time_s for s in self.recorder.samples]) + self.loop._begin_s
        names = np.array([s.supervisor.state_name for s in self.recorder.samples])
        before = np.searchsorted(ticks, rows[:, 0] - 1e-6, side="right") - 1
        return rows[(before >= 0) & np.isin(names[before], [state.value for state in states])]

    def clearance(self, *states):
        """Least exact distance of the true path in these states to the map, less the vehicle's radius [m]."""
        return self.clearance_of(self.path(*states)[:, 1:])

    def clearance_of(self, path):
        """Of positions in the world, shape (T, 3)."""
        if len(path) == 0:
            return math.inf
        radius = self.made.world.vehicle.body.radius_m
        return min(float(path_clearance(path, each).min()) for _, each in self.made.obstacles) - radius

    def packets(self):
        """Set-points and orders of the link that reached the vehicle: (when, message), read by pymavlink."""
        reader = mavlink.MAVLink(None)
        found = []
        by_watchdog = set() if self.watchdog is None else self.watchdog.program.sent
        for at, data in self.heard:
            if data not in by_watchdog and int.from_bytes(data[7:10], "little") in (76, 82, 84):
                found += [(at, message) for message in reader.parse_buffer(data)]
        return found

    def judge(self, *, seen_is_true=True):
        """What must hold of every flight, whatever happened to it."""
        for (at, taken), (_, following) in zip(self.recorder.steps, self.recorder.steps[1:], strict=False):
            assert taken.step == TABLE[taken.state][taken.event], at
            assert following.state is taken.step.state
        assert self.loop.state is State.DONE
        assert self.clearance(State.FLY, State.HOLD) > 0
        was_handed_over = State.HAND_OVER in self.entered
        assert was_handed_over or not self.copter.is_armed
        self._judge_packets()
        self._judge_ages(seen_is_true)

    def _judge_packets(self):
        """Nothing that is no number, nothing of another tick, nothing twice, nothing after the hand-over."""
        begin, over_s = self.loop._begin_s, self.entered.get(State.HAND_OVER, math.inf)
        flown = {}
        for sample in self.recorder.samples:
            flown[round(1e3 * (begin + sample.supervisor.time_s - self.link._session.start_s))] = sample
        last_ms, moved_ms = -1, -1
        for at, message in self.packets():
            kind = message.get_type()
            fields = [v for name in message.fieldnames for v in np.atleast_1d(getattr(message, name))]
            assert all(math.isfinite(v) for v in fields if isinstance(v, float)), message
            if kind == "COMMAND_LONG":
                assert message.command not in _ORDERS or at <= over_s + 1.5 / self.made.config.rate_hz, (
                    message
                )
                continue
            assert kind in _SETPOINTS
            assert at <= over_s + 1.5 / self.made.config.rate_hz, message
            assert message.time_boot_ms >= last_ms
            last_ms = message.time_boot_ms
            if self._moves(message):
                assert last_ms > moved_ms
                moved_ms = last_ms
            if message.time_boot_ms in flown:
                sample = flown[message.time_boot_ms]
                is_flown = sample.safety is not None and sample.safety.sent
                assert is_flown or not self._moves(message), message
            else:
                assert not self._moves(message), message

    @staticmethod
    def _moves(message):
        """Whether it is more than the order to stand still, or to sink there."""
        if message.get_type() == "SET_ATTITUDE_TARGET":
            return message.type_mask != ATTITUDE_MASK
        return any((message.vx, message.vy, message.vz, message.afx, message.afy, message.afz))

    def _judge_ages(self, seen_is_true):
        """What was flown on was as old as it said, by the truth."""
        flown = [s for s in self.recorder.samples if s.safety is not None and s.safety.sent]
        assert all(s.supervisor.state_age_s <= STALE_S for s in flown)
        if not flown or not seen_is_true:
            return
        truth = self.path(State.FLY, State.HOLD, State.LAND)
        speed = np.linalg.norm(np.diff(truth[:, 1:], axis=0), axis=1) / np.diff(truth[:, 0])
        ticks = np.array([s.supervisor.time_s for s in flown]) + self.loop._begin_s
        there = np.stack([np.interp(ticks, truth[:, 0], truth[:, axis]) for axis in (1, 2, 3)], axis=1)
        off = np.linalg.norm(there - np.array([s.state.position_m.tuple for s in flown]), axis=1)
        assert off.max() <= (STALE_S + 0.03) * speed.max() + 0.03


class _Stalling(Time):
    """A clock that a fault can hold the loop up by."""

    def __init__(self, *peers):
        super().__init__(*peers)
        self.extra_s = 0.0

    def sleep(self, seconds):
        extra, self.extra_s = self.extra_s, 0.0
        while extra > 0:  # the others go on
            step, extra = min(extra, 0.01), extra - 0.01
            super().sleep(step)
        super().sleep(seconds)


def fault(kind, **fields):
    """One of the simulated vehicle's, from now on."""
    return lambda flight: flight.vehicle.inject(Fault(kind=kind, **fields))


def interrupt(times):
    """The operator has asked so often to end."""
    return lambda flight: setattr(flight, "interrupts", times)


def stall(seconds):
    """The loop's next tick comes late."""
    return lambda flight: setattr(flight.time, "extra_s", seconds)


def mute(*kinds):
    """The vehicle does not say these any more."""
    return lambda flight: flight.muted.update(kinds)


def unmute(flight):
    """The vehicle says everything again."""
    flight.muted.clear()


def blow(*wind_m_s):
    """Wind begins: east, north, up [m/s]."""
    return lambda flight: flight.copter.airframe.blow(wind_m_s)


def cut(flight):
    """See `Flight.cut`."""
    flight.cut()


def refuse(name):
    """The vehicle does not do that: `arm`, `take_off`, `set_mode`, `disarm`."""
    return lambda flight: setattr(flight.copter, name, lambda *_, **__: False)


def allow(name):
    """It does it again."""
    return lambda flight: flight.copter.__dict__.pop(name, None)


def set_back(flight):
    """The vehicle's clock, as by starting anew."""

    def change(message):
        message.time_boot_ms -= 1500

    flight.changes |= dict.fromkeys(("LOCAL_POSITION_NED", "ATTITUDE_QUATERNION", "ATTITUDE"), change)


def mirror(flight):
    """Velocities against positions."""

    def change(message):
        message.vx, message.vy, message.vz = -message.vx, -message.vy, -message.vz

    flight.changes["LOCAL_POSITION_NED"] = change


def unseen(flight):
    """The link does not know the mode any more, and not whether the vehicle follows."""
    flight.muted.add("HEARTBEAT")
    flight.link.status.obeys, flight.link.status.mode = False, ""


def topple(roll_rad=math.pi, *, falls=False, seconds=0.0):
    """It is turned over where it is, and held so for a while, or it has fallen to the floor."""

    def turn(flight):
        body = flight.copter.airframe
        north, east, down = body.truth.position
        attitude, sinks = from_euler(roll_rad, 0.0, 0.0), 0.5 if falls else 0.0
        motion = [north, east, 0.01 if falls else down, *to_mrp(attitude), 0.0, 0.0, sinks, 0.0, 0.0, 0.0]
        body._plant.reset(np.array(motion) * np.tile([1.0, -1.0, -1.0], 4))

    def do(flight):
        turn(flight)
        end_s, before = flight.time() + seconds, flight.each

        def each(flight):
            before(flight)
            if flight.time() < end_s:
                turn(flight)

        flight.each = each

    return do


def set_by_another(name, value):
    """Another station sets a parameter, and the vehicle tells everybody."""

    def do(flight):
        message = mavlink.MAVLink_param_set_message(1, 1, name.encode(), value, 9)
        flight.vehicle.receive(message.pack(mavlink.MAVLink(None, 254, 190)))

    return do


def nearly_up(flight):
    """Take-off is about to be over."""
    return flight.link.state.position[2] > 0.85 * flight.made.start[2]


def land_seen(flight):
    """The vehicle says that it is on the ground."""
    flight.changes["EXTENDED_SYS_STATE"] = lambda message: setattr(message, "landed_state", 1)
