"""Small covers, plans and scenes that flights are tested with."""

import itertools

import numpy as np

from alula.schemas.artifacts.artifact import make_artifact
from alula.schemas.artifacts.kinds import COVER, PLAN, SCENE
from alula.schemas.artifacts.manifest import Guarantee, InputRef, PlanPass
from alula.stages.planning.rest_to_rest import rest_to_rest
from support.scenes.covers import with_manifest

G = 0.1  # voxel size [m]


def box_cover(corners, frame="world"):
    corners = np.array(corners, np.int64).reshape(-1, 2, 3)
    n = len(corners)
    pick = np.array(list(itertools.product([0, 1], repeat=3)))
    vertex = np.array([[c[pick[j], range(3)] for j in range(8)] for c in corners]).reshape(-1, 3)
    return make_artifact(
        COVER,
        {
            "vertex": vertex,
            "vertex_start": 8 * np.arange(n + 1),
            "plane_normal": np.tile(np.vstack([np.eye(3), -np.eye(3)]), (n, 1)),
            "plane_offset": np.hstack([corners[:, 1], -corners[:, 0]]).ravel(),
            "plane_start": 6 * np.arange(n + 1),
            "member_index": corners[:, 0],
            "member_start": np.arange(n + 1),
            "history": np.empty((0, 3)),
        },
        frame=frame,
        unit="m",
        parameters={},
        summary={},
        guarantee=Guarantee("test", {"covered": True}),
        voxel_size_m=G,
        sigma=1.0,
        min_overlap=1,
        conservativeness=1.0,
        certificate={},
        made_from=[InputRef("scene", "alula/scene", "1.0", "0" * 64, "test.scene.npz")],
    )


def line_plan(start, end, duration_s=6.0, frame="world"):
    """Rest to rest by a septic in two pieces, from `start` to `end`."""
    shape = np.zeros(8)
    shape[4:] = np.array([35, -84, 70, -20]) / duration_s ** np.arange(4, 8)
    whole = np.zeros((4, 8))
    whole[:3] = np.outer(np.subtract(end, start), shape)
    whole[:3, 0] = start
    half = duration_s / 2
    second = np.zeros((4, 8))
    for row, moved in zip(whole[:3], second[:3], strict=True):
        shifted = np.polynomial.Polynomial(row)(np.polynomial.Polynomial([half, 1])).coef
        moved[: len(shifted)] = shifted
    return make_artifact(
        PLAN,
        {
            "time": np.array([0, half, duration_s]),
            "coefficient": np.array([whole, second]),
            "waypoint": np.zeros((2, 4)),
        },
        frame=frame,
        unit="m",
        parameters={},
        summary={},
        radius_m=0.15,
        speed_m_s=1.5,
        certificate={},
        beyond_map_m=100.0,  # the maps are a few obstacles
    )


def with_vias(plan, points, time_s):
    """The plan with points to pass, all at one time [s]."""
    passes = [
        PlanPass(kind="waypoint", number=number, time_s=time_s, point_m=point)
        for number, point in enumerate(points, 1)
    ]
    return with_manifest(plan, via_m=points, passes=passes)


def rest_plan(start, goal, speed_m_s, frame="world"):
    """Straight from rest to rest in one piece, with a peak speed [m/s]."""
    time, coefficient = rest_to_rest(start, goal, speed_m_s)
    return make_artifact(
        PLAN,
        {"time": time, "coefficient": coefficient, "waypoint": [[*start, 0], [*goal, 0]]},
        frame=frame,
        unit="m",
        parameters={},
        summary={},
        radius_m=0.1,
        speed_m_s=speed_m_s,
        certificate={},
        beyond_map_m=100.0,  # the maps are a few obstacles
    )


def ball_scene(centres, radius, frame="world", unit="m"):
    """Balls of one radius, or ellipsoids whose half-axes are the rows of `radius`."""
    n = len(centres)
    return make_artifact(
        SCENE,
        {
            "mean": np.array(centres),
            "scale": np.full((n, 3), radius),
            "quat_wxyz": np.tile([1.0, 0, 0, 0], (n, 1)),
            "opacity": np.ones(n),
            "color": np.zeros((n, 3)),
        },
        frame=frame,
        unit=unit,
        parameters={},
        summary={},
        source={},
    )


SLALOM = box_cover(
    [
        ((0, -20, 0), (120, -18, 32)),
        ((0, 60, 0), (120, 62, 32)),
        ((-4, -20, 0), (-2, 62, 32)),
        ((122, -20, 0), (124, 62, 32)),
        ((34, -18, 0), (38, 34, 32)),
        ((70, 8, 0), (74, 60, 32)),
    ]
)
"""A hall of 12 x 8 m with two screens, around which a way leads from (1, 1) to (11, 3)."""
