"""A vehicle for tests of flights: a rigid body or a point with modes, stepped by a clock that tests turn."""

import math

import numpy as np

from alula import _core
from alula.schemas.errors import LinkError
from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.stages.flight.links.protocol import Order, VehicleState, VehicleStatus
from alula.stages.vehicles.bodies import quadrotor
from alula.stages.vehicles.setpoints import AccelerationSetpoint, RatesSetpoint, VelocitySetpoint

STEP_S = 2.5e-3
_GAINS = _core.TrackingGains(max_tilt_rad=0.6)


class FakeClock:
    """Time that passes only when somebody sleeps."""

    def __init__(self):
        self.now_s = 100.0
        self.extra_s = []  # added to the next sleeps, one by one

    def __call__(self):
        return self.now_s

    def sleep(self, seconds):
        self.now_s += seconds + (self.extra_s.pop(0) if self.extra_s else 0.0)


class FakeVehicle:
    """A link and its vehicle: the body of FastBridge with a rate loop, and modes MANUAL, GUIDED, LAND.

    Faults are fields that tests set while it flies, or functions of the vehicle called at each poll.
    """

    def __init__(self, clock, position=(0.0, 0.0, 0.0), accepts=None, frame=None, state_hz=100.0):
        self.clock = clock
        self.status = VehicleStatus(
            armed=False, landed=True, mode="MANUAL", battery_share=0.9, is_estimator_ready=True
        )
        self.state = None
        self.accepts = accepts or frozenset({RatesSetpoint, AccelerationSetpoint, VelocitySetpoint})
        self.body = quadrotor(FASTBRIDGE)
        self._inertia, self._hover = list(self.body.inertia), self.body.hover_thrust
        self._command, self._row = np.zeros((1, 4)), np.zeros((1, 18))
        self.x = np.array([*position, 0, 0, 0, 0, 0, 0, 0, 0, 0.0])
        self.ground_m = position[2]
        self.frame = np.eye(3) if frame is None else np.asarray(frame, float)  # seen positions, velocities
        self.state_period_s = 1 / state_hz
        self.time_s = clock()
        self.setpoint, self.height_m, self.hold_at = None, 0.0, None
        self.sent, self.orders = [], []
        self.is_silent = self.is_frozen = self.refuses = False
        self.on_poll = lambda vehicle, now: None
        self.closed = False

    def open(self, timeout_s):
        return "a fake vehicle"

    def prepare(self):
        return []

    def close(self):
        self.closed = True

    def poll(self, now_s):
        self.on_poll(self, now_s)
        while self.time_s + STEP_S <= now_s:
            self.step()
        if self.is_silent:
            return
        self.status.heard_s = now_s
        if self.is_frozen:
            return
        if self.state is None or now_s - self.state.received_s >= self.state_period_s - 1e-9:
            self.state = self.seen(now_s)

    def seen(self, now_s):
        n = float(self.x[3:6] @ self.x[3:6])
        a, b, c = self.x[3:6].tolist()
        quat = np.array([(1 - n) / (1 + n), 2 * a / (1 + n), 2 * b / (1 + n), 2 * c / (1 + n)])
        return VehicleState(now_s, self.frame @ self.x[:3], self.frame @ self.x[6:9], quat, self.x[9:].copy())

    def order(self, order, now_s, height_m=0.0):
        self.orders.append(order)
        if self.refuses and order is not Order.NOTHING:
            self.status.refusals.append((order, "it does not want to"))
            return
        if order is Order.ARM:
            self.status.armed, self.status.mode = True, "GUIDED"
        elif order is Order.TAKE_OFF:
            self.height_m, self.status.mode = height_m, "GUIDED"
            self.hold_at = (self.x[:3] + np.array([0, 0, height_m])).tolist()
        elif order is Order.TAKE_CONTROL:
            self.status.mode = "GUIDED"
        elif order is Order.HOLD:
            self.hold_at, self.setpoint = self.x[:3].tolist(), None
        elif order is Order.LAND:
            self.status.mode, self.setpoint = "LAND", None
            self.hold_at = [*self.x[:2].tolist(), self.ground_m - 1.0]
        elif order is Order.STOP or (order is Order.DISARM and self.status.landed):
            self.status.armed = False
        self.status.obeys = self.status.mode == "GUIDED"

    def send(self, setpoint, now_s):
        if type(setpoint) not in self.accepts:
            raise LinkError("no such set-point")
        values = [np.atleast_1d(v) for v in (getattr(setpoint, name) for name in setpoint.__slots__)]
        assert np.isfinite(np.concatenate(values)).all()
        self.sent.append((now_s, self.status.mode, setpoint))
        if self.status.mode == "GUIDED":
            self.setpoint = setpoint

    def step(self):
        self.time_s += STEP_S
        if not self.status.armed:
            return
        self.x = self.body.step(self.x[None], self.wrench(), dt_s=STEP_S)[0]
        self.x[3:6] = _core.shadowed(self.x[None, 3:6])[0]
        height_m = float(self.x[2])
        if height_m <= self.ground_m:
            self.x[2], self.x[3:] = self.ground_m, 0.0
            height_m = self.ground_m
        self.status.landed = height_m < self.ground_m + 0.02
        if self.status.landed and self.status.mode == "LAND":
            self.status.armed = False

    def wrench(self):
        """Of the autopilot's own loops, shape (1, 4)."""
        position, velocity = self.x[:3].tolist(), self.x[6:9].tolist()
        if isinstance(self.setpoint, RatesSetpoint):
            self._command[0] = (self.setpoint.thrust_m_s2 * self.body.mass, *self._torque())
            return self.body.limited(self._command)
        if isinstance(self.setpoint, AccelerationSetpoint):
            acceleration = self.setpoint.acceleration
        elif isinstance(self.setpoint, VelocitySetpoint):
            acceleration = [4.0 * (u - v) for u, v in zip(self.setpoint.velocity, velocity, strict=True)]
        elif self.hold_at is None:
            self._command[0] = (self._hover if position[2] > self.ground_m else 0.0, 0.0, 0.0, 0.0)
            return self._command
        else:
            desired = [_within(1.5 * (q - p), 0.8) for p, q in zip(position, self.hold_at, strict=True)]
            acceleration = [4.0 * (u - v) for u, v in zip(desired, velocity, strict=True)]
        self._row[0, :9] = (*position, *velocity, *(_within(each, 4.0) for each in acceleration))
        return self.body.limited(_core.track(self.body, _GAINS, self.x[None], self._row)["wrench"])

    def _torque(self):
        """Of the rate loop."""
        (a, b, c), (i, j, k) = self.x[9:].tolist(), self._inertia
        u, v, w = self.setpoint.omega
        return (
            b * (k * c) - c * (j * b) + i * (u - a) / 0.02,
            c * (i * a) - a * (k * c) + j * (v - b) / 0.02,
            a * (j * b) - b * (i * a) + k * (w - c) / 0.02,
        )


def _within(value, limit):
    return -limit if value < -limit else min(value, limit)


class Kept:
    """A recorder that keeps everything."""

    def __init__(self):
        self.samples, self.steps, self.lines, self.plans = [], [], [], []

    def tick(self, sample):
        self.samples.append(sample)

    def step(self, time_s, taken):
        self.steps.append((time_s, taken))

    def plan(self, time_s, points):
        self.plans.append((time_s, points))

    def say(self, time_s, level, words):
        self.lines.append((level, words))

    @property
    def states(self):
        """The states one after another."""
        found = []
        for sample in self.samples:
            if not found or found[-1] != sample.supervisor.state_name:
                found.append(sample.supervisor.state_name)
        return found

    def positions(self, *states):
        kept = [s for s in self.samples if s.supervisor.state_name in states and s.state]
        return np.array([s.state.position_m.tuple for s in kept])


def norm(vector):
    return math.sqrt(float(np.dot(vector, vector)))
