"""`Link` to a Crazyflie over CRTP with cflib: by radio, by USB, or by UDP to a simulated one.

radio://0/80/2M/E7E7E7E7E7?controller=mellinger
udp://127.0.0.1:19850?controller=oot&alula.radius=0.12&watchdog=1
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from alula.schemas.errors import LinkError
from alula.schemas.extras import require
from alula.stages.flight.links.addresses import Address
from alula.stages.flight.links.crazyflie.address_options import read_address_options
from alula.stages.flight.links.crazyflie.orders import Motion, Orders
from alula.stages.flight.links.crazyflie.parameters import Parameters
from alula.stages.flight.links.crazyflie.session import Session
from alula.stages.flight.links.crazyflie.setpoints import SetpointEncoder
from alula.stages.flight.links.mocap import PoseFeed
from alula.stages.flight.links.options import LinkOptions
from alula.stages.flight.links.protocol import Order, Place, VehicleState, VehicleStatus, Ward
from alula.stages.flight.links.vehicle_clock import VehicleClock
from alula.stages.vehicles.packed_attitude import expand_quat_wxyz
from alula.stages.vehicles.setpoints import AccelerationSetpoint, Setpoint, VelocitySetpoint

_STATE = [f"stateEstimateZ.{name}" for name in ("x", "y", "z", "vx", "vy", "vz", "quat")]
_STATE += [f"stateEstimateZ.rate{name}" for name in ("Roll", "Pitch", "Yaw")]
_STATUS = ["kalman.varX", "kalman.varY", "kalman.varZ", "pm.vbat", "supervisor.info"]
_REFUSED = "alula.refused"  # count of invalid parameters that the app rejected; it keeps the last valid ones
_STATUS_S, _OLD_S = 0.1, 1.0
_FARTHEST_M = 32.0  # a compressed position wraps around at 32.768
_KNOWN_M2 = 0.01  # maximum variance of a position that is good enough to fly
_EMPTY_V, _FULL_V = 3.0, 4.1  # while hovering
_SILENCE_S = 0.3  # the vehicle's own watchdog levels out at 0.5 s and stops the motors at 2 s
_NOTICE_S = 0.25
_ECHO_S = 0.2
_WRAP_MS = 1 << 24
_MAX_TEXTS = 100
_RESTORE_S = 3.0


def make_link(address: Address, options: LinkOptions) -> CrazyflieLink:
    """Make the link for an address.

    Raises:
        UsageError: an option is unknown or has an invalid value.
    """
    require("cflib")
    return CrazyflieLink(address, options)


class CrazyflieLink:
    """A `Link` to a Crazyflie.

    It sends set-points as they come, commands until they are answered, poses of motion capture, and with
    `watchdog=1` the notices of the emergency watchdog. After 0.3 s without a set-point it commands the
    vehicle's own high-level commander to hold the position. It changes the parameters of
    `crazyflie.parameters` and those named in the address; `close` restores them on the ground.
    """

    def __init__(self, address: Address, options: LinkOptions) -> None:
        given = read_address_options(address)
        self._udp = address.host_port() if address.scheme == "udp" else None
        self._kind, self._has_watchdog = given.kind, given.has_watchdog
        self._options = options
        self._session = Session(f"{address.scheme}:{address.place}", options)
        self._feed = None if options.mocap is None else PoseFeed(options.mocap, options.frame)
        self._status = VehicleStatus(is_estimator_ready=False)
        self._orders = Orders(self._session, self._status)
        self._parameters = Parameters(self._session, given.controller, given.parameters)
        self._encoder = SetpointEncoder(
            options.frame, options.all_limits(), options.vehicle.body.gravity_m_s2
        )
        self._clock = VehicleClock()
        self._state: VehicleState | None = None
        self._motion: Motion | None = None
        self._state_block: tuple[float, int, Mapping[str, float]] | None = None  # written by cflib's thread
        self._status_block: tuple[float, Mapping[str, float]] | None = None  # written by cflib's thread
        self._state_read: object = None  # the block that was read last
        self._status_read: object = None
        self._stamp_ms: int | None = None
        self._streamed_s: float | None = None
        self._noticed_s = self._echo_s = -math.inf
        self._period_ms = max(10, 10 * round(100 / options.state_rate_hz))
        self._lost = 0  # written by cflib's thread
        self._is_prepared = False

    @property
    def accepts(self) -> frozenset[type[Setpoint]]:
        """Kinds of set-points that can be sent: those that the controller follows."""
        return frozenset({self._kind})

    @property
    def state(self) -> VehicleState | None:
        """The newest complete and finite state; None before the first."""
        return self._state

    @property
    def status(self) -> VehicleStatus:
        """The status, always the same object; `poll` updates it."""
        return self._status

    @property
    def clipped(self) -> int:
        """Number of set-points that were changed by a limit."""
        return self._encoder.clipped

    def open(self, timeout_s: float) -> str:
        """See `Link`; also raises LinkError without cflib, or for firmware that is too old."""
        try:
            if self._feed is not None:
                self._feed.open()
            self._session.open(timeout_s)
            self._session.log("state", 1e-3 * self._period_ms, _STATE, self._take_state)
            app = [_REFUSED] if self._session.logs(_REFUSED) else []
            self._session.log("status", _STATUS_S, _STATUS + app, self._take_status)
            self._session.wait(lambda: None not in (self._state_block, self._status_block), 2.0)
        except BaseException:
            self.close()
            raise
        self.poll(self._options.clock())
        return f"Crazyflie at {self._session.uri}, CRTP {self._session.protocol}"

    def prepare(self) -> list[str]:
        """Set the parameters that flights need; a line for each change.

        Raises:
            LinkError: the vehicle does not have or accept one; those changed before are restored.
        """
        if self._state_block is None or self._status_block is None:
            raise LinkError("the vehicle was not opened, or sends no state")
        pose = None
        if self._feed is not None:
            self._session.wait(self._has_pose, 2.0)
            pose = self._feed.newest()
            if pose is None:
                raise LinkError("no pose from motion capture arrived within 2 s")
        try:
            lines = self._checked(lambda: self._parameters.change(pose))
        except BaseException:
            self._say(*self._parameters.restore(_RESTORE_S))
            raise
        self._is_prepared = True
        return lines

    def guarded(self) -> Ward | None:
        """What a watchdog process needs; None with `watchdog=1`, which stops the motors. After `prepare`."""
        if self._has_watchdog:
            return None
        floor = 0.0 if self._motion is None else self._motion.floor_m
        settings = {"uri": self._session.uri, "udp": self._udp, "floor_m": floor}
        nowhere = Place(None, "", None)
        return Ward(settings, lambda: nowhere, lambda: (0, -math.inf, 0), speaks_crtp=True)

    def configure(self, values: Mapping[str, float]) -> list[str]:
        """Set parameters, such as the app's `alula.radius`; `close` restores them. A line for each change.

        It may block: do not call it in flight.

        Raises:
            LinkError: the vehicle does not have or accept one, or the app rejects the combination.
        """
        return self._checked(lambda: self._parameters.set(values))

    def poll(self, now_s: float) -> None:
        """Receive all that has arrived, and send periodic messages."""
        self._forward_pose(now_s)
        session, status = self._session, self._status
        if session.lost is None and now_s - self._echo_s >= _ECHO_S:
            self._echo_s = now_s
            session.request_echo(now_s)
        status.heard_s, status.lost_packets = session.heard_s, self._lost
        self._read_state(now_s)
        self._read_status(now_s)
        self._say(*session.texts())
        if session.lost is not None:
            raise LinkError(f"{session.uri}: {session.lost}")
        if not self._is_prepared:
            return
        if self._streamed_s is not None and now_s - self._streamed_s > _SILENCE_S:
            self._say(f"no set-point for {_SILENCE_S:g} s: it holds its position")
            self._hold(now_s)
        self._orders.poll(now_s)
        is_watched = self._noticed_s > -math.inf  # once started, the notices must not stop
        if (is_watched or (self._has_watchdog and status.armed)) and now_s - self._noticed_s >= _NOTICE_S:
            self._noticed_s = now_s
            session.notice()

    def send(self, setpoint: Setpoint, now_s: float) -> None:
        """Send a set-point, see `Link.send`; also raises LinkError if it is not possible now."""
        if not self._is_prepared:
            raise LinkError("a set-point before the vehicle was prepared")
        if type(setpoint) is not self._kind:
            raise LinkError(f"the vehicle's controller takes no {type(setpoint).__name__}")
        if self._status.mode != "commanded":
            raise LinkError(f"a set-point while {self._status.mode}: take control first")
        if isinstance(setpoint, AccelerationSetpoint):
            full = self._encoder.full_state(setpoint, now_s)
            w, x, y, z = full.attitude_wxyz
            position, velocity = full.position.tolist(), full.velocity.tolist()
            acceleration, rates = full.acceleration.tolist(), full.omega
            # cflib documents degrees/s but writes thousandths of its argument; the firmware reads mrad/s.
            self._session.post_newest(
                "set-point",
                lambda vehicle: vehicle.commander.send_full_state_setpoint(
                    position, velocity, acceleration, [x, y, z, w], *rates
                ),
            )
        elif isinstance(setpoint, VelocitySetpoint):
            if self._motion is None:
                raise LinkError("a set-point before the vehicle reported its position")
            yaw_now = self._motion.yaw_rad - self._options.frame.yaw_rad
            speed, turn_deg_s = self._encoder.velocity(setpoint, yaw_now, now_s)
            vx, vy, vz = speed.tolist()
            self._session.post_newest(
                "set-point",
                lambda vehicle: vehicle.commander.send_velocity_world_setpoint(vx, vy, vz, turn_deg_s),
            )
        self._streamed_s = now_s

    def order(self, order: Order, now_s: float, height_m: float = 0.0) -> None:
        """Send a command; `poll` repeats it until it is done, refused or replaced by another command.

        NOTHING makes a vehicle that follows set-points hover by itself: without set-points it would fall.

        Args:
            height_m: take-off height above the present position [m].

        Raises:
            LinkError: the command is not possible now.
        """
        if not self._is_prepared:
            raise LinkError("a command before the vehicle was prepared")
        if order is Order.SETTLE:
            return
        if order is Order.NOTHING:
            if self._streamed_s is not None:
                self._hold(now_s)
            else:
                self._orders.start(order, now_s, 0.0, self._motion)
            return
        self._orders.start(order, now_s, height_m, self._motion)
        if order in (Order.TAKE_OFF, Order.HOLD, Order.LAND):
            self._streamed_s = None
            self._encoder.reset()

    def close(self) -> None:
        """Restore changed parameters if the vehicle is landed and answers, and disconnect; never raises."""
        try:
            if self._is_prepared and self._session.lost is None:
                if self._streamed_s is not None:
                    self._hold(self._options.clock())
                self._session.flush(1.0)
                if self._status.landed is not True:
                    known = "is in the air" if self._status.landed is False else "may be in the air"
                    self._say(f"it {known}: its parameters stay as they are", *self._parameters.leave())
                else:
                    self._say(*self._parameters.restore(_RESTORE_S))
                if self._noticed_s > -math.inf:
                    self._say("its emergency watchdog locks it now: restart it")
        except LinkError as error:
            self._say(str(error))
        finally:
            self._is_prepared = False
            if self._feed is not None:
                self._feed.close()
            self._session.close()

    def _checked(self, change: Callable[[], list[str]]) -> list[str]:
        """Apply a change and return its lines; raises LinkError if the app rejects it."""
        before = self._status_block
        lines = change()
        if (
            before is None
            or _REFUSED not in before[1]
            or not any(line.startswith("alula.") for line in lines)
        ):
            return lines
        changed_s = self._options.clock()
        self._session.wait(lambda: self._has_status_since(changed_s + _STATUS_S), _OLD_S)
        if self._status_block is not None and self._status_block[1][_REFUSED] != before[1][_REFUSED]:
            raise LinkError(
                "the app refuses its parameters: the combination is invalid, or one is out of range"
            )
        return lines

    def _has_status_since(self, time_s: float) -> bool:
        return self._status_block is not None and self._status_block[0] > time_s

    def _hold(self, now_s: float) -> None:
        self._streamed_s = None
        self._encoder.reset()
        self._orders.start(Order.HOLD, now_s, 0.0, self._motion)

    def _has_pose(self) -> bool:
        self._forward_pose(self._options.clock())
        return self._feed is not None and self._feed.newest() is not None

    def _forward_pose(self, now_s: float) -> None:
        if self._feed is None:
            return
        pose = self._feed.pose(now_s)
        if pose is None or self._session.lost is not None:
            return
        position, (w, x, y, z) = pose[0].tolist(), pose[1].tolist()
        self._session.post_newest("pose", lambda vehicle: vehicle.loc.send_extpose(position, [x, y, z, w]))

    def _take_state(self, stamp_ms: int, values: Mapping[str, float]) -> None:
        if self._state_block is not None:
            gap_ms = (stamp_ms - self._state_block[1]) % _WRAP_MS
            if gap_ms < _WRAP_MS // 2:  # otherwise it restarted
                self._lost += max(0, round(gap_ms / self._period_ms) - 1)
        self._state_block = (self._options.clock(), stamp_ms, values)

    def _take_status(self, _stamp_ms: int, values: Mapping[str, float]) -> None:
        self._status_block = (self._options.clock(), values)

    def _read_state(self, now_s: float) -> None:
        """Read the newest log block; skip it if it was read before, is invalid, or motion capture is old."""
        newest = self._state_block
        if newest is None or newest is self._state_read:
            return
        self._state_read = newest
        arrived_s, stamp_ms, values = newest
        before_ms = self._stamp_ms
        if before_ms is not None:  # 24 bits of milliseconds
            stamp_ms = before_ms + (stamp_ms - before_ms + _WRAP_MS // 2) % _WRAP_MS - _WRAP_MS // 2
        self._stamp_ms = stamp_ms
        arrival_s = self._clock.arrival(1e-3 * stamp_ms, arrived_s)
        self._status.clock_jumps = self._clock.jumps
        x, y, z, vx, vy, vz, quat, roll, pitch, yaw = (values[name] for name in _STATE)
        position = 1e-3 * np.array([x, y, z])
        if arrival_s is None:
            return
        if np.abs(position).max() > _FARTHEST_M:
            self._status.bad_packets += 1
            return
        if self._feed is not None and not self._feed.is_fresh(now_s):
            return  # without poses its estimate continues and drifts away
        velocity = 1e-3 * np.array([vx, vy, vz])
        omega = 1e-3 * np.array([roll, -pitch, yaw])  # the firmware logs the pitch rate with the other sign
        frame = self._options.frame
        w, i, j, k = expand_quat_wxyz(int(quat))
        heading = math.atan2(2 * (w * k + i * j), 1 - 2 * (j * j + k * k))
        floor = 0.0 if self._motion is None else self._motion.floor_m
        if self._status.armed is False:
            floor = float(position[2])
        self._motion = Motion(position, velocity, heading, floor)
        self._state = VehicleState(
            arrival_s,
            frame.position_from_local(position),
            frame.vector_from_local(velocity),
            frame.attitude_from_local(np.array([w, i, j, k])),
            omega,
            self._session.latency_s(now_s),
        )

    def _read_status(self, now_s: float) -> None:
        status, newest = self._status, self._status_block
        if newest is None or now_s - newest[0] > _OLD_S:
            status.armed = status.landed = status.battery_v = status.battery_share = None
            status.is_estimator_ready = None
            return
        _, values = newest
        variances = [values[name] for name in _STATUS[:3]]
        status.is_estimator_ready = self._state is not None and all(0 <= v < _KNOWN_M2 for v in variances)
        volts = values["pm.vbat"]
        status.battery_v = status.battery_share = None
        if math.isfinite(volts):
            status.battery_v = volts
            status.battery_share = min(max((volts - _EMPTY_V) / (_FULL_V - _EMPTY_V), 0.0), 1.0)
        if newest is not self._status_read:
            self._status_read = newest
            self._orders.update(int(values["supervisor.info"]))

    def _say(self, *lines: str) -> None:
        self._status.texts.extend(lines)
        del self._status.texts[:-_MAX_TEXTS]
