"""What tests of the simulated autopilot share: a vehicle in the air, and a client without a socket."""

import math

from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.stages.sim_vehicle.ardupilot.copter import ArduCopter
from alula.stages.sim_vehicle.common.estimator import EstimatorOptions
from alula.stages.sim_vehicle.common.packets import mavlink
from alula.stages.sim_vehicle.simulator import SimulatedVehicle

QUICK = EstimatorOptions(boot_time_s=0.5)
EXACT = EstimatorOptions(
    boot_time_s=0.5,
    position_noise_m=0.0,
    velocity_noise_m_s=0.0,
    attitude_noise_rad=0.0,
    rate_noise_rad_s=0.0,
    accelerometer_bias_m_s2=0.0,
)
GUIDED, LAND, RTL, LOITER, NOGPS = 4, 9, 6, 5, 20
RATES = 128  # the mask of SET_ATTITUDE_TARGET that ignores the attitude


def of(kind, messages):
    return [m for m in messages if m.get_type() == kind]


class Client:
    """A ground station or companion with stock pymavlink packing, on the vehicle's own clock."""

    kind = ArduCopter

    def __init__(self, *, options=QUICK, vehicle=FASTBRIDGE, parameters=None, seed=1, system=255, **channel):
        copter = self.kind(vehicle, parameters=parameters, options=options, seed=seed)
        self.vehicle = SimulatedVehicle(copter, seed=seed, **channel)
        self.copter = copter
        self.mav = mavlink.MAVLink(None, srcSystem=system, srcComponent=190)
        self.mav.robust_parsing = True
        self.heard = []
        self.bad = 0
        self.packets = []

    def send(self, message):
        self.vehicle.receive(bytes(message.pack(self.mav)))
        self.mav.seq = (self.mav.seq + 1) % 256

    def wait(self, seconds):
        """Let time pass; what is heard meanwhile."""
        found = []
        for packet in self.vehicle.advance(self.vehicle.time_s + seconds):
            self.packets.append(packet)
            for message in self.mav.parse_buffer(packet) or ():
                if message.get_type() == "BAD_DATA":
                    self.bad += 1
                else:
                    found.append(message)
        self.heard += found
        return found

    def command(self, number, *params):
        """Send a command; its result."""
        values = [*params, *[0.0] * (7 - len(params))]
        self.send(mavlink.MAVLink_command_long_message(1, 1, number, 0, *values))
        acks = [m for m in self.wait(0.01) if m.get_type() == "COMMAND_ACK" and m.command == number]
        assert len(acks) == 1
        assert (acks[0].target_system, acks[0].target_component) == (self.mav.srcSystem, 190)
        return acks[0].result

    def mode(self, number):
        return self.command(mavlink.MAV_CMD_DO_SET_MODE, 1, number)

    def arm(self, *, forced=False):
        return self.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1, 21196 if forced else 0)

    def interval(self, name, hertz):
        number = getattr(mavlink, f"MAVLINK_MSG_ID_{name}")
        assert self.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, number, 1e6 / hertz) == 0

    def fly(self, height=5.0):
        """In the air, hovering in GUIDED."""
        self.wait(0.6)
        assert self.mode(GUIDED) == 0
        assert self.arm() == 0
        self.wait(3.0)
        fast = {"WPNAV_SPEED_UP": 1000.0, "WPNAV_ACCEL_Z": 600.0, "TKOFF_SLEW_TIME": 0.25}
        if "PSC_JERK_Z" in self.copter.parameters:
            fast["PSC_JERK_Z"] = 50.0
        normal = {name: self.copter.parameters[name] for name in fast}
        for name, value in fast.items():
            self.copter.parameters.set(name, value)
        assert self.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, height) == 0
        begin = self.vehicle.time_s
        while abs(self.height - height) > 0.1 or abs(self.climb) > 0.1:
            assert self.vehicle.time_s < begin + 20
            self.wait(0.25)
        for name, value in normal.items():
            self.copter.parameters.set(name, value)
        self.wait(1.0)
        return self

    def rates(self, omega=(0.0, 0.0, 0.0), thrust=0.5, mask=RATES, q=(1.0, 0.0, 0.0, 0.0)):
        self.send(mavlink.MAVLink_set_attitude_target_message(0, 1, 1, mask, list(q), *omega, thrust))

    def stream(self, seconds, period=0.02, **setpoint):
        """Send set-points at 50 Hz for a while."""
        for _ in range(round(seconds / period)):
            self.rates(**setpoint)
            self.wait(period)

    def target(self, mask, p=(0, 0, 0), v=(0, 0, 0), a=(0, 0, 0), yaw=0.0, frame=1):
        self.send(
            mavlink.MAVLink_set_position_target_local_ned_message(0, 1, 1, frame, mask, *p, *v, *a, yaw, 0.0)
        )

    def texts(self):
        return [m.text for m in self.heard if m.get_type() == "STATUSTEXT"]

    def last(self, kind):
        return next(m for m in reversed(self.heard) if m.get_type() == kind)

    @property
    def truth(self):
        return self.copter.airframe.truth

    @property
    def height(self):
        return -self.truth.position[2]

    @property
    def climb(self):
        return -self.truth.velocity[2]

    @property
    def tilt(self):
        q = self.truth.attitude
        return math.acos(max(-1.0, min(1.0, 1 - 2 * (q[1] ** 2 + q[2] ** 2))))
