"""Runs of a racing drone by a simulated pilot in a box: the scenario, with other values, flown."""

import msgspec
import numpy as np

from alula.schemas.scenarios.scenario import decoded
from alula.schemas.scenarios.vehicle import read_vehicle
from alula.stages.simulation.simulate import simulate_world
from support.flights.world_runs import set_value
from support.paths import VEHICLES

RACER = read_vehicle(VEHICLES / "racer7.toml")
TICK_S = float(np.float32(0.0025))  # as the native filter has it
BOX, STARTS = (-20, -20, 0.5, 20, 20, 40), (-15, -15, 3, 15, 15, 35)
ROOM = {
    "schema": "alula/scenario",
    "version": "2.0",
    "vehicle": {"type": "racer7"},
    "world": {"fence": {"box_m": BOX}},
    "mission": {
        "kind": "pilot",
        "start_box_m": STARTS,
        "start_speed_m_s": 10.0,
        "start_tilt_deg": 57.3,
        "pilot": {"kind": "aggressive"},
    },
    "safety": {"filters": ["geofence"]},
    "rules": {
        "dt_s": 0.0025,
        "plant_steps": 4,
        "max_time_s": 1.5,
        "trials": 10,
        "seed": 5,
        "logged": 2,
        "log_rate_hz": 50,
    },
}


def scenario(changes=None, start=None):
    """The room with other values by their paths, and with a given start instead of random ones."""
    tree = msgspec.msgpack.decode(msgspec.msgpack.encode(ROOM))
    for path, value in (changes or {}).items():
        set_value(tree, path, value)
    if start is not None:
        for key in ("start_box_m", "start_speed_m_s", "start_tilt_deg"):
            del tree["mission"][key]
        tree["mission"] |= start
    return decoded(tree, "test")


def fly(changes=None, start=None, jobs=1, **how):
    return simulate_world(scenario(changes, start), RACER, jobs=jobs, **how)
