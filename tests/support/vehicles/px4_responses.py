"""Measurement of a PX4 multicopter through MAVLink, on the real program or the simulated one.

`measure` asks, arms, flies and lands, and returns the table; a line is one of `responses`.
"""

import math
import statistics
import struct

from pymavlink.dialects.v20 import ardupilotmega as m

OFFBOARD, HOLD, LAND = (6, 0), (4, 3), (4, 6)
HEIGHT_M = 1.5
_PERIOD_S = 0.05  # of set-points
_POSITION = 0xDF8  # mask: a position, any heading
_READY = 0x10  # bit of ESTIMATOR_STATUS: an absolute horizontal position
# Measured by `measure` on PX4 1.18 in its own simulation (sihsim_quadx, the parameters of its start script):
# bits, results of commands, modes, values of parameters, and medians of three measurements.
MEASURED = {
    "flags at rest": 0x3FF,
    "COM_ACT_FAIL_ACT": 0,
    "COM_DISARM_LAND": 2.0,
    "COM_DISARM_PRFLT": 10.0,
    "COM_FAIL_ACT_T": 5.0,
    "COM_FLTT_LOW_ACT": 0,
    "COM_LOW_BAT_ACT": 3,
    "COM_OBL_RC_ACT": 0,
    "COM_OF_LOSS_T": 1.0,
    "COM_RCL_EXCEPT": 0,
    "COM_RC_IN_MODE": 1,
    "COM_RC_OVERRIDE": 1,
    "EKF2_EV_CTRL": 0,
    "EKF2_GPS_CTRL": 7,
    "GF_ACTION": 2,
    "MIS_TAKEOFF_ALT": 2.5,
    "MPC_LAND_SPEED": 0.7,
    "MPC_THR_HOVER": 0.5,
    "MPC_TKO_SPEED": 1.5,
    "NAV_ACC_RAD": 2.0,
    "NAV_DLL_ACT": 0,
    "NAV_RCL_ACT": 2,
    "RTL_CONE_ANG": 45,
    "RTL_MIN_DIST": 10.0,
    "RTL_RETURN_ALT": 30.0,
    "RTL_TYPE": 0,
    "OFFBOARD without set-points, disarmed": m.MAV_RESULT_ACCEPTED,
    "its mode then": OFFBOARD,
    "arming in it": m.MAV_RESULT_TEMPORARILY_REJECTED,
    "arming with a stream": m.MAV_RESULT_ACCEPTED,
    "flags in flight": 0x37F,
    "landing": m.MAV_RESULT_ACCEPTED,
    "its mode after the landing": OFFBOARD,
    "position at rest [m]": 0.0122,
    "velocity at rest [m/s]": 0.0161,
    "take-off [s]": 9.86,
    "landing [s]": 8.58,
}
# What the real program is let: its estimate wanders, and a take-off and a landing with it.
SPREAD = {
    "position at rest [m]": (0.005, 0.06),
    "velocity at rest [m/s]": (0.005, 0.05),
    "take-off [s]": (6.5, 12.0),
    "landing [s]": (7.0, 11.0),
}

_PARAMETERS = [name for name in MEASURED if name.isupper() and " " not in name]


class Client:
    """A companion on a line, which keeps the newest message of each kind."""

    def __init__(self, line):
        self.line, self.newest, self.heard = line, {}, []
        self.system = 1

    def wait(self, seconds):
        """Let time pass; what is heard meanwhile, with its times."""
        found = []
        for at, message in self.line.listen(seconds):
            if message.get_type() == "BAD_DATA" or message.get_srcComponent() != 1:
                continue
            self.system = message.get_srcSystem()
            self.newest[message.get_type()] = message
            found.append((at, message))
        return found

    def until(self, holds, seconds):
        """Wait until something is so; how long it took, NaN if it did not become so."""
        begin = self.line.now
        while not holds():
            if self.line.now - begin > seconds:
                return math.nan
            self.wait(_PERIOD_S)
        return self.line.now - begin

    def command(self, number, *values):
        """Send a command; its result, None without an answer."""
        self.newest.pop("COMMAND_ACK", None)
        filled = [*map(float, values), *[0.0] * (7 - len(values))]
        self.line.send(m.MAVLink_command_long_message(self.system, 1, number, 0, *filled))
        self.until(lambda: getattr(self.newest.get("COMMAND_ACK"), "command", None) == number, 3.0)
        answer = self.newest.get("COMMAND_ACK")
        return None if answer is None else answer.result

    def mode(self, main, sub):
        return self.command(m.MAV_CMD_DO_SET_MODE, 1, main, sub)

    def flown(self):
        custom = self.newest["HEARTBEAT"].custom_mode
        return custom >> 16 & 0xFF, custom >> 24 & 0xFF

    def is_armed(self):
        return bool(self.newest["HEARTBEAT"].base_mode & m.MAV_MODE_FLAG_SAFETY_ARMED)

    def parameter(self, name):
        """Value of a parameter; None if there is none of the name."""
        self.newest.pop("PARAM_VALUE", None)
        self.line.send(m.MAVLink_param_request_read_message(self.system, 1, name.encode(), -1))
        self.until(lambda: getattr(self.newest.get("PARAM_VALUE"), "param_id", None) == name, 1.0)
        answer = self.newest.get("PARAM_VALUE")
        if answer is None:
            return None
        if isinstance(MEASURED[name], int):
            return struct.unpack("<i", struct.pack("<f", answer.param_value))[0]
        return round(answer.param_value, 4)

    def height_m(self):
        return -self.newest["LOCAL_POSITION_NED"].z

    def stream(self, place, holds, seconds):
        """Send a position set-point until something is so; how long it took, NaN if it did not become so."""
        begin = self.line.now
        while not holds():
            if self.line.now - begin > seconds:
                return math.nan
            target = (0, self.system, 1, m.MAV_FRAME_LOCAL_NED, _POSITION, *place, *[0.0] * 8)
            self.line.send(m.MAVLink_set_position_target_local_ned_message(*target))
            self.wait(_PERIOD_S)
        return self.line.now - begin


def measure(line):
    """Fly; the table."""
    client, found = Client(line), {}
    client.until(lambda: "HEARTBEAT" in client.newest, 20.0)
    for name, rate_hz in (("ESTIMATOR_STATUS", 5), ("LOCAL_POSITION_NED", 50), ("EXTENDED_SYS_STATE", 5)):
        client.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, getattr(m, f"MAVLINK_MSG_ID_{name}"), 1e6 / rate_hz)
    client.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, m.MAVLINK_MSG_ID_HEARTBEAT, 2e5)
    flags = lambda: getattr(client.newest.get("ESTIMATOR_STATUS"), "flags", 0)  # noqa: E731
    client.until(lambda: flags() & _READY and "LOCAL_POSITION_NED" in client.newest, 60.0)
    client.wait(4.0)
    found["flags at rest"] = flags()
    found |= _noise(client)
    found |= {name: client.parameter(name) for name in _PARAMETERS}
    found["OFFBOARD without set-points, disarmed"] = client.mode(*OFFBOARD)
    client.wait(1.0)
    found["its mode then"] = client.flown()
    found["arming in it"] = client.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    client.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 0)
    client.mode(*HOLD)
    client.wait(1.0)
    here = client.newest["LOCAL_POSITION_NED"]
    above = (here.x, here.y, here.z - HEIGHT_M)
    client.stream(above, lambda: False, 1.3)
    client.mode(*OFFBOARD)
    found["arming with a stream"] = client.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    found["take-off [s]"] = client.stream(above, lambda: client.height_m() + here.z > 0.95 * HEIGHT_M, 30.0)
    client.stream(above, lambda: False, 4.0)
    found["flags in flight"] = flags()
    found["landing"] = client.mode(*LAND)
    found["landing [s]"] = client.until(lambda: not client.is_armed(), 40.0)
    client.wait(1.0)
    found["its mode after the landing"] = client.flown()
    return found


def _noise(client):
    """Standard deviations of position and velocity at rest in 10 s, all axes."""
    rows = [each for _, each in client.wait(10.0) if each.get_type() == "LOCAL_POSITION_NED"]
    spread = lambda name: statistics.pstdev(getattr(row, name) for row in rows)  # noqa: E731
    return {
        "position at rest [m]": math.hypot(*map(spread, ("x", "y", "z"))),
        "velocity at rest [m/s]": math.hypot(*map(spread, ("vx", "vy", "vz"))),
    }
