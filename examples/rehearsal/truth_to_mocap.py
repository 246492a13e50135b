"""Use a simulation's true pose as motion capture: convert SIM_STATE for `alula fly --mocap`.

    python truth_to_mocap.py tcp:127.0.0.1:5762 127.0.0.1:9870 0.8 0.8 0

The first argument is a second port of ArduPilot's simulation, in pymavlink's notation; the second is the
address on which `alula fly --mocap udp:127.0.0.1:9870` listens; the rest is the present position in the map,
with x to the east.
"""

import json
import math
import socket
import sys

from pymavlink import mavutil

SIM_STATE, SET_INTERVAL = 108, 511
EARTH_M = 6_378_137.0


def main() -> None:
    """Forward poses until the simulation ends."""
    host, _, port = sys.argv[2].rpartition(":")
    out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    at = tuple(map(float, sys.argv[3:6])) or (0.0, 0.0, 0.0)
    link = mavutil.mavlink_connection(sys.argv[1], source_system=254)
    link.wait_heartbeat()
    link.mav.command_long_send(link.target_system, 1, SET_INTERVAL, 0, SIM_STATE, 10_000, 0, 0, 0, 0, 0)
    first = None
    while (state := link.recv_match(type="SIM_STATE", blocking=True, timeout=10)) is not None:
        degrees = (state.lat_int or 1e7 * state.lat) * 1e-7, (state.lon_int or 1e7 * state.lon) * 1e-7
        first = first or (*degrees, state.alt)
        north = math.radians(degrees[0] - first[0]) * EARTH_M
        east = math.radians(degrees[1] - first[1]) * EARTH_M * math.cos(math.radians(first[0]))
        w, x, y, z = state.q1, state.q2, state.q3, state.q4  # from north-east-down to forward-right-down
        half = math.sqrt(0.5)  # to east-north-up and forward-left-up
        attitude = half * (w + z), half * (x + y), half * (x - y), half * (w - z)
        length = math.hypot(*attitude)
        sample = {
            "time_s": link.timestamp,
            "position_m": (at[0] + east, at[1] + north, at[2] + state.alt - first[2]),
            "attitude_wxyz": [value / length for value in attitude],
            "velocity_m_s": (state.ve, state.vn, -state.vd),
        }
        out.sendto(json.dumps(sample).encode(), (host, int(port)))


if __name__ == "__main__":
    main()
