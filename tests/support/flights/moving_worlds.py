"""The worlds of the DR-ACBF experiments, and vehicles that hold their course in them."""

from math import radians

import numpy as np

from alula._core import ObstacleSpec, obstacle_paths

DT = 0.01

# Both at 50 m: one from the side that turns in, one straight ahead.
SCENARIO_1 = [
    {
        "kind": "curving",
        "distance_m": 50,
        "azimuth_rad": (radians(20), radians(35)),
        "either_side": True,
        "speed_m_s": (5, 8),
        "heading_rad": (radians(25), radians(45)),
        "acceleration_m_s2": (0.2, 0.8),
        "max_speed_m_s": 12,
        "turn_rate_rad_s": 0.25,
        "release_m": 12,
    },
    {
        "kind": "accelerating",
        "distance_m": 50,
        "offset_sigma_m": (0, 0.3, 0.3),
        "speed_m_s": (5, 8),
        "acceleration_m_s2": (0.2, 0.8),
        "max_speed_m_s": 12,
    },
]

# One that crosses at 45 degrees from 150 m, one that comes head-on from 200 m.
SCENARIO_2 = [
    {
        "distance_m": 150,
        "azimuth_rad": (radians(45),) * 2,
        "crosses": True,
        "either_side": True,
        "speed_m_s": (5, 9),
        "meeting_sigma_m": (1, 1, 1),
    },
    {"distance_m": 200, "speed_m_s": (5, 9)},
]

# A hovering Crazyflie in a room: another one comes straight at it, and then something is thrown.
HARDWARE = [
    {
        "kind": "quadrotor",
        "radius_m": 0.1,
        "distance_m": 1.5,
        "speed_m_s": (2.35, 2.35),
        "acceleration_m_s2": (4, 4),
    },
    {
        "kind": "ballistic",
        "radius_m": 0.1,
        "distance_m": 2.5,
        "azimuth_rad": (-0.5, 0.5),
        "elevation_rad": (-0.1, 0.1),
        "speed_m_s": (2.3, 3.7),
        "meeting_sigma_m": (0, 0.03, 0.03),
        "drag_per_m": 0.02,
        "start_s": 1.5,
    },
]
MOCAP = {"kind": "mocap", "rate_hz": 120, "position_sigma_m": 0.001, "detection_probability": 0.99}


def obstacle(table, **changed):
    """The specification of a table above."""
    return ObstacleSpec(**(table | changed))


def vehicle_path(count, v=(4, 0, 0), p=(0, 0, 10), dt=DT):
    """Rows (p, v, a) of a vehicle that holds its course."""
    rows = np.zeros((count, 9))
    rows[:, :3] = np.asarray(p, float) + dt * np.arange(count)[:, None] * np.asarray(v, float)
    rows[:, 3:6] = v
    return rows


def closing(vehicle, path):
    """Distances and closing speeds of obstacle paths (trials, N, 9) to a vehicle's (N, 9)."""
    P, V = path[..., :3] - vehicle[:, :3], path[..., 3:6] - vehicle[:, 3:6]
    distance = np.linalg.norm(P, axis=-1)
    return distance, -(P * V).sum(-1) / distance


def paths(table, vehicle, dt=DT, **where):
    """Obstacle paths (trials, N, 9) of a table beside a vehicle."""
    return obstacle_paths(obstacle(table), vehicle, dt_s=dt, **where)


def angles(a, b):
    """Angles between vectors [rad]."""
    cosine = (a * b).sum(-1) / np.linalg.norm(a, axis=-1) / np.linalg.norm(b, axis=-1)
    return np.arccos(np.clip(cosine, -1, 1))
