"""`Link` to ArduPilot Copter or PX4 over MAVLink: `udpin:`, `udpout:`, `tcp:`, `serial:`."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from alula.schemas.errors import LinkError, UsageError
from alula.stages.flight.links.addresses import Address
from alula.stages.flight.links.mavlink.assembler import StateAssembler
from alula.stages.flight.links.mavlink.autopilots import (
    ALL_SETPOINTS,
    ARDUPILOT,
    Autopilot,
    autopilot_of,
    mode_command,
)
from alula.stages.flight.links.mavlink.hover import HoverThrottle
from alula.stages.flight.links.mavlink.orders import Addressee, Orders
from alula.stages.flight.links.mavlink.parameters import Parameters
from alula.stages.flight.links.mavlink.session import COMPONENT, GROUND_STATION, Session
from alula.stages.flight.links.mavlink.setpoints import SINK_M_S, SetpointEncoder
from alula.stages.flight.links.mavlink.telemetry import Telemetry
from alula.stages.flight.links.mocap import Mocap
from alula.stages.flight.links.options import LinkOptions
from alula.stages.flight.links.protocol import Order, VehicleState, VehicleStatus, Ward, check_height
from alula.stages.rotation import matrix_from_quat_wxyz
from alula.stages.vehicles.setpoints import RatesSetpoint, Setpoint

_ANSWER_S = 2.0
_OPTIONAL_S = 0.6  # for the answer of a vehicle that may not have a parameter
_TOGETHER_S = 1.2  # for the answers to many requests at once, of which each is repeated twice
_RESTORE_S = 4.0
_OTHERS_S = 1.2  # more than a heartbeat's period, to detect a second vehicle
_STREAM_S = 0.05
_STREAM_FIRST_S = 1.1  # set-points are sent this long before PX4's mode is changed
_STATE_S = 1.0  # after this time without state, intervals are requested again: it may have restarted
_REQUEST_AGAIN_S = 2.0
_ORIGIN_S = 1.0
_HOVER_TAU_S = 3.0
_OFF_GROUND_M = 0.2  # from here on its weight rests on its rotors
_SUNK_M = 0.3  # height from which it lands by itself
_SINK_MORE_S = 3.0
_SYNC_S = 0.5
_REASONS_S = 5.0  # between requests for the reasons why it does not arm
_NO_MESSAGE = re.compile(r"No ap_message for mavlink id \((\d+)\)")
_REQUESTS = 32  # time requests whose answers are awaited: 16 s of them
_GUIDED_NOGPS = (20, 0)
_LINK_OF_WATCHDOG = 1  # its packets are a stream of their own, whose time stamps cannot make others look old


def make_link(address: Address, options: LinkOptions) -> MavlinkLink:
    """Make the link for an address.

    Raises:
        UsageError: an option is unknown or has an invalid value.
        LinkError: signing lacks its file, or a system number is wrong.
    """
    return MavlinkLink(address, options)


class MavlinkLink:
    """A `Link` to an autopilot.

    It sends ten heartbeats a second, set-points as they come, commands until they are answered, and with
    motion capture its poses. It changes the parameters of `mavlink.autopilots`; `close` restores them.
    """

    def __init__(self, address: Address, options: LinkOptions) -> None:
        mode = address.options.get("mode", "guided")
        if mode not in ("guided", "guided_nogps"):
            raise UsageError(f"{address.scheme}: mode={mode}: must be guided or guided_nogps")
        self._options = options
        self._is_without_position = mode == "guided_nogps"
        rest = {name: value for name, value in address.options.items() if name != "mode"}
        self._session = Session(dataclasses.replace(address, options=rest), options, self._take)
        self._mocap = None if options.mocap is None else Mocap(options.mocap, options.frame)
        self._estimate = StateAssembler(options.frame, self._is_mocap_fresh)
        self._telemetry = Telemetry()
        self._addressee = Addressee(self._session.source, COMPONENT)
        self._autopilot: Autopilot = ARDUPILOT
        self._version: Any = None
        self._origin: Any = None
        self._origin_s = self._requested_s = self._streamed_s = self._sync_s = -math.inf
        self._reasons_s = -math.inf
        self._source: float | None = None  # of its position, by its parameter
        self._unknown: set[int] = set()  # numbers of messages that it does not have
        self._requests: dict[int, float] = {}  # time requests by their number [ns]: when they were sent [s]
        self._parameters: Parameters | None = None
        self._orders: Orders | None = None
        self._encoder: SetpointEncoder | None = None
        self._hover: HoverThrottle | None = None
        self._throttle_ms = -1  # time of the newest throttle that the vehicle reported
        self._stream: Callable[[int], Any] | None = None  # set-point repeated while `send` is not called
        self._ground_m = math.inf  # height at which it stood
        self._sinks_until_s = -math.inf  # it lands by velocities until then at the latest
        self._stream_since_s = math.inf  # start of the uninterrupted stream
        self._state: VehicleState | None = None

    @property
    def accepts(self) -> frozenset[type[Setpoint]]:
        """Kinds of set-points that can be sent."""
        return frozenset({RatesSetpoint}) if self._is_without_position else ALL_SETPOINTS

    @property
    def state(self) -> VehicleState | None:
        """The newest complete and finite state; None before the first and after the vehicle restarted."""
        return self._state

    @property
    def status(self) -> VehicleStatus:
        """The status, always the same object; `poll` updates it."""
        return self._telemetry.status

    @property
    def hover(self) -> HoverThrottle | None:
        """The hover throttle; None before `prepare`."""
        return self._hover

    @property
    def clipped(self) -> int:
        """Number of set-points that were changed by a limit."""
        return 0 if self._encoder is None else self._encoder.clipped

    @property
    def unsent(self) -> int:
        """Number of packets dropped because the line's buffer was full."""
        return self._session.unsent

    def open(self, timeout_s: float) -> str:
        """See `Link`; also raises LinkError if several vehicles answer, or this program cannot fly it."""
        try:
            if self._mocap is not None:
                self._mocap.open()
            self._session.open(timeout_s)
            return self._identify(timeout_s)
        except BaseException:
            self.close()
            raise

    def prepare(self) -> list[str]:
        """Set the parameters that flights need; a line for each change.

        Raises:
            LinkError: the vehicle is armed, so somebody may fly it; or it does not have or accept a
                parameter, and those changed before are restored.
        """
        if self._parameters is None:
            raise LinkError("the vehicle was not opened")
        if self.status.armed:
            raise LinkError("the vehicle is armed: its parameters are not changed")
        try:
            return self._prepare(self._parameters)
        except BaseException:
            try:
                self._telemetry.say(*self._parameters.restore(_RESTORE_S))
            except LinkError as error:
                self._telemetry.say(f"parameters could not be put back: {error}")
            raise

    def guarded(self) -> Ward:
        """What a watchdog process needs to stop and land the vehicle; after `open`."""
        autopilot, session = self._autopilot, self._session
        orders = [mode for mode in (autopilot.landing, autopilot.stopping) if mode is not None]
        customs = [autopilot.custom_of(mode) for mode in orders]
        names = [autopilot.mode_of(custom)[2] for custom in customs]
        heartbeat, *sent = session.parts(*(mode_command(mode) for mode in orders))
        signer = session.signer
        settings = {
            **{"system": session.source, "component": COMPONENT, "vehicle": session.target[0]},
            **{"key": None if signer is None else signer.key, "link": _LINK_OF_WATCHDOG},
            **{"heartbeat": heartbeat, "land": sent[0], "stop": sent[-1]},
            **{"land_name": names[0], "stop_name": names[-1]},
            **{"control": autopilot.custom_of(autopilot.control), "landing": customs[0]},
            "stopping": None if autopilot.stopping is None else customs[-1],
        }
        return Ward(settings, lambda: session.place, self._reported)

    def _reported(self) -> tuple[int, float, int]:
        beat, signer = self._telemetry.heartbeat, self._session.signer
        mode = 0 if beat is None else beat.custom_mode
        return mode, self._telemetry.beat_s, 0 if signer is None else signer.newest

    def read_parameters(self, names: Iterable[str]) -> dict[str, float]:
        """Values of parameters of a vehicle that was opened; those that it does not report are left out."""
        return {} if self._parameters is None else self._parameters.read_all(names, _ANSWER_S)

    def poll(self, now_s: float) -> None:
        """Receive all that has arrived, and send periodic messages."""
        self._forward_mocap(now_s)
        self._session.poll(now_s)
        before, self._state = self._state, self._estimate.state
        telemetry, status = self._telemetry, self._telemetry.status
        telemetry.poll(now_s)
        status.heard_s = self._session.heard_s
        status.bad_packets = self._session.bad + self._estimate.dropped
        status.lost_packets = self._session.lost
        if status.clock_jumps != self._estimate.jumps:
            status.clock_jumps = self._estimate.jumps
            telemetry.say("the vehicle's clock jumped: it may have restarted")
        status.clock = "its clock runs faster than that of this computer" if self._estimate.runs_fast else ""
        if self._orders is None:
            return
        if self._sinks_until_s > -math.inf:
            self._watch_sinking(self._orders, now_s)
        status.sinks = self._sinks_until_s > -math.inf
        self._orders.poll(now_s)
        if self._parameters is not None and (changed := self._parameters.poll(now_s)) is not None:
            status.changed = changed
        if now_s - self._sync_s >= _SYNC_S:
            self._sync_s = now_s
            self._request_time(now_s)
        if status.can_arm is False and not status.armed and now_s - self._reasons_s >= _REASONS_S:
            self._reasons_s = now_s
            self._session.send(self._session.command(dialect.MAV_CMD_RUN_PREARM_CHECKS, ()))
        if self._stream is not None and now_s - self._streamed_s >= _STREAM_S:
            self._streamed_s = now_s
            self._stream_since_s = min(self._stream_since_s, now_s)
            self._session.send(self._stream(self._session.time_ms(now_s)))
        if self._hover is not None and self._state is not None and self._state is not before:
            self._learn(self._hover, self._state)
        newest_s = -math.inf if self._state is None else self._state.received_s
        status.without_position = "" if now_s - newest_s <= _STATE_S else self._without_position(now_s)
        if now_s - newest_s > _STATE_S and now_s - self._requested_s > _REQUEST_AGAIN_S:
            self._request_intervals(now_s)

    def send(self, setpoint: Setpoint, now_s: float) -> None:
        """Send a set-point, see `Link.send`; also raises LinkError if it is not possible now."""
        if type(setpoint) not in self.accepts:
            raise LinkError(f"the vehicle takes no {type(setpoint).__name__} in this mode")
        if self._encoder is None:
            raise LinkError("a set-point before the vehicle was prepared")
        message = self._encoder.encode(setpoint, now_s, self._session.time_ms(now_s))
        self._stream = None
        self._stream_since_s = math.inf
        self._session.send(message)
        if (
            isinstance(setpoint, RatesSetpoint)
            and self._hover is not None
            and not self._autopilot.reports_thrust
        ):
            self._hover.record(message.thrust, now_s)

    def order(self, order: Order, now_s: float, height_m: float = 0.0) -> None:
        """Send a command; `poll` repeats it until it is done, refused or replaced by another command.

        ARM first takes control if the vehicle does not follow set-points yet. HOLD is a stream of
        zero-velocity set-points. TAKE_OFF of PX4 is a stream of the position set-point above. Both end with
        the next set-point or command, and neither changes the mode: a pilot who took over keeps control. LAND
        is a stream of attitudes down to 0.3 m where satellites misplace the position, which it would follow.

        Raises:
            LinkError: the command is not possible now.
        """
        if self._orders is None or self._encoder is None or self._parameters is None:
            raise LinkError("a command before the vehicle was prepared")
        if order is Order.SETTLE:
            if self._autopilot.settling is not None:
                self._parameters.start(self._autopilot.settling)
            return
        if order is Order.HOLD and self._is_without_position:
            raise LinkError("hold is refused: the mode guided_nogps has no position")
        self._sinks_until_s = -math.inf
        if order is Order.LAND and self._sinks(self._encoder, now_s):
            return
        if order is Order.TAKE_OFF:
            self._telemetry.satellites.take_off()
        is_climb = order is Order.TAKE_OFF and not self._autopilot.takes_off_by_command
        is_followed = order in (Order.ARM, Order.TAKE_CONTROL) and self._autopilot.streams_first
        stream = self._climb(self._encoder, height_m) if is_climb else self._encoder.stop
        if is_climb or order is Order.HOLD:
            self._orders.drop()
        else:
            streamed_s = max(now_s - self._stream_since_s, 0.0)
            wait_s = max(_STREAM_FIRST_S - streamed_s, 0.0) if is_followed else 0.0
            self._orders.start(order, now_s, height_m, wait_s)
        self._stream = stream if is_climb or is_followed or order is Order.HOLD else None
        if self._stream is None:
            self._stream_since_s = math.inf
        self._streamed_s = -math.inf
        self.poll(now_s)

    def _sinks(self, encoder: SetpointEncoder, now_s: float) -> bool:
        """Begin to land without a position, if satellites misplace the one that a landing mode would hold."""
        state, satellites, frame = self._state, self._telemetry.satellites, self._options.frame
        if state is None or not (satellites.are_misplaced and self.status.obeys):
            return False
        height_m = float(state.position[2]) - self._ground_m
        if not math.isfinite(height_m) or satellites.velocity is None:
            return False
        assert self._orders is not None
        nose = matrix_from_quat_wxyz(state.attitude_wxyz)[:, 0]
        yaw = frame.yaw_to_ned(math.atan2(nose[1], nose[0]))

        def stream(time_ms: int) -> Any:
            sinking = 0.0 if self._state is None else -float(self._state.velocity[2])
            return encoder.sink(np.array([*(satellites.velocity or (0.0, 0.0)), sinking]), yaw, time_ms)

        self._orders.drop()
        self._stream, self._streamed_s = stream, -math.inf
        self._sinks_until_s = now_s + max(height_m, 0.0) / SINK_M_S + _SINK_MORE_S
        self.poll(now_s)
        return True

    def _watch_sinking(self, orders: Orders, now_s: float) -> None:
        """Order the landing mode near the ground, which notices it and disarms."""
        state, status = self._state, self.status
        if status.mode and not status.obeys:  # somebody else flies it
            self._stream, self._sinks_until_s = None, -math.inf
        elif (
            now_s > self._sinks_until_s
            or self._telemetry.satellites.velocity is None
            or status.landed is True
            or (state is not None and state.position[2] - self._ground_m < _SUNK_M)
        ):
            self._stream, self._sinks_until_s = None, -math.inf
            orders.start(Order.LAND, now_s, 0.0)

    def close(self) -> None:
        """Restore changed parameters as far as the vehicle still answers, and disconnect; never raises.

        They stay changed if the vehicle is in the air and still in the mode that follows this program: they
        make it land.
        """
        self._stream = self._orders = None
        status = self.status
        try:
            if self._parameters is not None:
                if status.armed and status.obeys and status.landed is not True:
                    self._telemetry.say(
                        "it is in the air without set-points: its parameters stay changed, so that it lands"
                    )
                    self._telemetry.say(*self._parameters.leave())
                else:
                    self._telemetry.say(*self._parameters.restore(_RESTORE_S))
                throttles = self._options.flies_rates or self._options.watches_throttle
                for number in self._autopilot.intervals(1.0, flies_rates=throttles):
                    is_heartbeat = number == dialect.MAVLINK_MSG_ID_HEARTBEAT  # always sent once a second
                    self._session.send(self._interval(number, 1.0 if is_heartbeat else 0.0))
        except LinkError as error:
            self._telemetry.say(f"parameters could not be put back: {error}")
        finally:
            self._parameters = None
            if self._mocap is not None:
                self._mocap.close()
            self._session.close()

    def _identify(self, timeout_s: float) -> str:
        session, telemetry = self._session, self._telemetry
        if not session.wait(lambda: telemetry.heartbeat is not None, timeout_s):
            raise LinkError(f"{session.name}: no vehicle heartbeat within {timeout_s:g} s{session.refused()}")
        autopilot = autopilot_of(telemetry.heartbeat)
        if self._is_without_position:
            if autopilot is not ARDUPILOT:
                raise LinkError(f"{autopilot.name} has no mode guided_nogps")
            autopilot = dataclasses.replace(autopilot, control=_GUIDED_NOGPS)
        self._autopilot = telemetry.autopilot = autopilot
        telemetry.read_mode()
        if session.wait(lambda: bool(session.others), _OTHERS_S):
            systems = ", ".join(map(str, sorted({session.target[0], *session.others})))
            raise LinkError(f"several vehicles send heartbeats: {systems}; choose one with ?system=NUMBER")
        self._parameters = Parameters(session, autopilot.is_bytewise)
        request = session.command(
            dialect.MAV_CMD_REQUEST_MESSAGE, (float(dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION),)
        )
        if not session.wait(
            lambda: self._version is not None, _ANSWER_S, again=lambda: session.send(request)
        ):
            key = "; it signs its packets: does it need --signing-key?" if session.is_signed else ""
            raise LinkError(f"the vehicle does not report its capabilities (AUTOPILOT_VERSION){key}")
        needed = dialect.MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
        if not self._is_without_position:
            needed |= dialect.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
        if self._version.capabilities & needed != needed:
            raise LinkError("the vehicle's autopilot takes no set-points, according to its AUTOPILOT_VERSION")
        self._estimate = StateAssembler(
            self._options.frame, self._is_mocap_fresh
        )  # drops what waited in the socket
        self._request_intervals(self._options.clock())
        number = self._version.flight_sw_version
        version = ".".join(str(number >> shift & 0xFF) for shift in (24, 16, 8))
        return f"{autopilot.name} {version}, system {session.target[0]}"

    def _prepare(self, parameters: Parameters) -> list[str]:
        needed = self._autopilot.needed(flies_rates=self._options.flies_rates)
        lines = [line for each in needed if (line := parameters.change(each)) is not None]
        hover = parameters.read(self._autopilot.hover)
        if hover is None:
            raise LinkError(f"the vehicle does not report its parameter {self._autopilot.hover}")
        try:
            gravity = self._options.vehicle.body.gravity_m_s2
            self._hover = HoverThrottle(hover, gravity, tau_s=_HOVER_TAU_S)
        except ValueError as error:
            raise LinkError(f"{self._autopilot.hover}: {error}") from error
        if self._options.flies_rates:
            lines += self._slow_yaw(parameters)
        if self._mocap is not None:
            parameters.require(self._autopilot.fixed)
        for name in self._autopilot.ground_station:
            watched = parameters.read(name, _OPTIONAL_S)
            if watched is not None:
                if round(watched) != GROUND_STATION:
                    lines.append(
                        f"{name} is {watched:g}: the vehicle will not land when this program's heartbeats end"
                    )
                break
        name, uses_satellites = self._autopilot.position_source
        self._source = parameters.read(name, _OPTIONAL_S)
        self._telemetry.satellites.is_watched = self._mocap is None and (
            self._source is None or uses_satellites(self._source)
        )
        for name in self._autopilot.watched:
            parameters.read(name, _OPTIONAL_S)
        if self._autopilot.settling is not None:
            parameters.read(self._autopilot.settling.name, _OPTIONAL_S)
            self.status.settles = True
        more = (*self._autopilot.safety_parameters, *self._autopilot.responses)
        self.status.own_safety = self._autopilot.own_safety(
            parameters.read_all(dict.fromkeys(more), _TOGETHER_S), flies_rates=self._options.flies_rates
        )
        parameters.watch(self._autopilot.relied_on)
        target, limits = self._session.target, self._options.all_limits()
        self._encoder = SetpointEncoder(target, self._options.frame, limits, self._hover)
        self._orders = Orders(self._session, self._autopilot, self._telemetry)
        if self._autopilot.streams_first:  # so that a mode change is accepted at once
            self._stream = self._encoder.stop
        return lines

    def _slow_yaw(self, parameters: Parameters) -> list[str]:
        """A line if the vehicle's own filter is slower than its file says that it follows yaw rates."""
        name, given_s = self._autopilot.yaw_filter, self._options.vehicle.rates.axes_s[2]
        cutoff_hz = parameters.read(name, _OPTIONAL_S) if name else None
        if not cutoff_hz or 1 / (2 * math.pi * cutoff_hz) <= given_s:
            return []
        return [
            f"{name} is {cutoff_hz:g} Hz: the vehicle follows yaw rates more slowly than its file says "
            f"({given_s:g} s), and may swing and climb; ArduPilot's file is examples/vehicles/arducopter.toml"
        ]

    def _take(self, message: Any, now_s: float) -> None:
        kind = message.get_type()
        if kind == "PARAM_VALUE":
            if self._parameters is not None:
                self._parameters.take(message)
        elif kind == "COMMAND_ACK":
            is_ours = self._addressee.is_ours(message)  # called for every message, since it learns from each
            if is_ours and self._orders is not None:
                self._orders.take_answer(message, now_s)
        elif kind == "AUTOPILOT_VERSION":
            self._version = message
        elif kind == "ATTITUDE_TARGET":
            is_new = message.time_boot_ms != self._throttle_ms
            self._throttle_ms = message.time_boot_ms
            if self._hover is not None and is_new and math.isfinite(message.thrust):
                self._hover.record(message.thrust, now_s)
        elif kind == "TIMESYNC":
            self._take_time(message)
        elif kind == "GPS_GLOBAL_ORIGIN":
            self._origin = message
        else:
            self._estimate.take(message, now_s)
            for text in self._telemetry.take(message, now_s):
                if (unknown := _NO_MESSAGE.fullmatch(text)) is not None:
                    self._unknown.add(int(unknown[1]))
                if self._orders is not None:
                    self._orders.take_text(text, now_s)

    def _take_time(self, message: Any) -> None:
        """Process the first answer to a time request; the vehicle's own requests stay unanswered."""
        if message.tc1 > 0 and (requested_s := self._requests.pop(message.ts1, None)) is not None:
            self._estimate.synchronise(message.tc1 * 1e-9, requested_s)

    def _request_time(self, now_s: float) -> None:
        number = round(now_s * 1e9)
        self._requests[number] = now_s
        if len(self._requests) > _REQUESTS:
            del self._requests[next(iter(self._requests))]
        self._session.send(dialect.MAVLink_timesync_message(0, number))

    def _forward_mocap(self, now_s: float) -> None:
        if self._mocap is None:
            return
        messages = self._mocap.poll(now_s, self._session.start_s, as_odometry=self._autopilot.has_odometry)
        if self._session.vehicle is None:
            return
        for message in messages:
            self._session.send(message)
        needs_origin = self._autopilot.external_source is not None and self._origin is None
        if needs_origin and now_s - self._origin_s >= _ORIGIN_S:
            self._origin_s = now_s
            latitude, longitude, height = self._options.origin
            origin = (round(latitude * 1e7), round(longitude * 1e7), round(height * 1e3))
            self._session.send(
                dialect.MAVLink_set_gps_global_origin_message(self._session.target[0], *origin)
            )

    def _is_mocap_fresh(self, now_s: float) -> bool:
        return self._mocap is None or self._mocap.is_fresh(now_s)

    def _climb(self, encoder: SetpointEncoder, height_m: float) -> Callable[[int], Any]:
        """Stream of the position set-point above the present position."""
        check_height(height_m)
        if self._state is None:
            raise LinkError("take-off is refused: the vehicle has not reported its position")
        above = self._options.frame.position_to_ned(self._state.position + np.array([0.0, 0.0, height_m]))
        return lambda time_ms: encoder.position(above, time_ms)

    def _learn(self, hover: HoverThrottle, state: VehicleState) -> None:
        height_m = float(state.position[2])
        if not self.status.armed or self.status.landed:
            self._ground_m = height_m
        elif self._options.flies_rates and height_m - self._ground_m > _OFF_GROUND_M:
            hover.update(state)

    def _interval(self, number: int, rate_hz: float) -> Any:
        """SET_MESSAGE_INTERVAL; a rate of 0 selects the vehicle's default."""
        period_us = round(1e6 / rate_hz) if rate_hz else 0
        return self._session.command(dialect.MAV_CMD_SET_MESSAGE_INTERVAL, (float(number), float(period_us)))

    def _request_intervals(self, now_s: float) -> None:
        self._requested_s = now_s
        options = self._options
        throttles = options.flies_rates or options.watches_throttle
        intervals = self._autopilot.intervals(options.state_rate_hz, flies_rates=throttles)
        for number, rate_hz in intervals.items():
            if number not in self._unknown:
                self._session.send(self._interval(number, rate_hz))
        if self._origin is None and self._autopilot.external_source is not None:
            number = dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN
            self._session.send(self._session.command(dialect.MAV_CMD_REQUEST_MESSAGE, (float(number),)))

    def _without_position(self, now_s: float) -> str:
        """What its position needs and lacks, in words; empty where this is not known."""
        name, uses_satellites = self._autopilot.position_source
        source, external, words = self._source, self._autopilot.external_source, list[str]()
        if source is None:
            pass
        elif uses_satellites(source):
            if not self._telemetry.satellites.has_fix:
                words.append("its receivers of satellites report no fix")
        elif external is None:
            pass
        elif source == external and self._mocap is None:
            words.append(f"{name} is 6, external navigation, which this command sends only with --mocap")
        elif source == external and not self._is_mocap_fresh(now_s):
            words.append(f"{name} is 6, external navigation, but no poses arrive by --mocap")
        elif source == 0:
            words.append(f"{name} is 0: it has no source of positions")
        if self._origin is None and external is not None:
            words.append("it has no origin of its frame (GPS_GLOBAL_ORIGIN); --mocap sets one, or a fix")
        return "; ".join(words)
