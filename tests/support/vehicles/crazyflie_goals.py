"""Flights of the Crazyflie's real firmware behind its app, from the ground and straight to a goal."""

import time

import numpy as np

from support.vehicles.crazyflie_host import crazyflie

CLIMB_M_S, NEAR_M = 0.4, 0.1
STILL_S, STILL_M = 4.0, 0.02  # it has stopped
_CONTROLLER = ("stabilizer.controller", 6)  # the out-of-tree one


def fly_to_goal(folder, floor_m, start, goal, image, seed, within_m, max_time_s=25.0, **parameters):
    """Take off to `start` and fly by position set-points to `goal`, with parameters of the app.

    Args:
        floor_m: height on which it stands below `start` [m].
        within_m: distance from the goal at which the flight ends [m].

    Returns:
        True path after the take-off, shape (T, 3) [m], and its times [s].
    """
    import cflib.crtp
    from cflib.crazyflie import Crazyflie
    from cflib.crazyflie.syncCrazyflie import SyncCrazyflie

    cflib.crtp.init_drivers()
    with (
        crazyflie(folder, (*start[:2], floor_m), "--seed", str(seed), image=image) as vehicle,
        SyncCrazyflie(f"udp://127.0.0.1:{vehicle.port}", cf=Crazyflie(rw_cache=None)) as linked,
    ):
        firmware = linked.cf
        for name, value in (_CONTROLLER, *((f"alula.{name}", value) for name, value in parameters.items())):
            firmware.param.set_value(name, value)
        time.sleep(2.0)  # until it is calibrated and its estimate has settled
        firmware.supervisor.send_arming_request(True)
        time.sleep(0.5)
        climb_s = 1.0 + (start[2] - floor_m) / CLIMB_M_S
        firmware.high_level_commander.takeoff(start[2], climb_s)
        end_s = time.monotonic() + climb_s + 3.0
        while time.monotonic() < end_s and _distance(vehicle, start) > NEAR_M:
            time.sleep(0.02)
        begin, began_s = len(vehicle.truth), time.monotonic()
        while time.monotonic() - began_s < max_time_s:
            firmware.commander.send_position_setpoint(*map(float, goal), 0.0)
            time.sleep(0.02)
            if _distance(vehicle, goal) < within_m:
                break
            recent = [row[2:5] for row in vehicle.truth[begin:] if row[0] > time.monotonic() - STILL_S]
            is_old = time.monotonic() - began_s > STILL_S + 1.0
            if is_old and np.ptp(np.array(recent), axis=0).max() < STILL_M:
                break
        rows = np.array(vehicle.truth[begin:])
    return np.ascontiguousarray(rows[:, 2:5]), rows[:, 1]


def _distance(vehicle, point):
    return float(np.linalg.norm(np.array(vehicle.truth[-1][2:5]) - point))
