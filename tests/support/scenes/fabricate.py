"""Small covers, scenes, plans and runs for tests, made without the stages that make real ones."""

import json
from math import gcd
from pathlib import Path

import msgspec
import numpy as np
from scipy.spatial import ConvexHull

from alula.schemas.artifacts.artifact import make_artifact
from alula.schemas.artifacts.kinds import COVER, PLAN, SCENE, VOXELS
from alula.schemas.artifacts.manifest import Guarantee
from alula.schemas.artifacts.provenance import RUN_METADATA, Provenance
from alula.schemas.log.foxglove import KeyValuePair, SceneEntity, SceneUpdate, Time
from alula.schemas.log.run import RUN_SCHEMA, RUN_VERSION, RunRecord, TrialResult, record_path


def exact_hull(points):
    """Vertices and primitive planes of integer points: facets by Qhull, everything else in integers."""
    points = np.unique(np.asarray(points, np.int64), axis=0)
    solid = ConvexHull(points)
    planes = set()
    for a, b, c in solid.simplices:
        normal = np.cross(points[b] - points[a], points[c] - points[a])
        sides = (points - points[a]) @ normal
        assert (sides <= 0).all() or (sides >= 0).all()
        normal = normal if (sides <= 0).all() else -normal
        normal = normal // gcd(*(int(x) for x in normal))
        planes.add((*map(int, normal), int(normal @ points[a])))
    return points[solid.vertices], np.array(sorted(planes))


def box(low, high):
    return exact_hull(
        [(x, y, z) for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    )


def _starts(parts):
    return np.concatenate([[0], np.cumsum([len(part) for part in parts])])


def _joined(parts, width):
    return np.concatenate(parts) if parts else np.empty((0, width))


def make_cover(hulls, g=0.05, offset=(0, 0, 0), summary=None, **fields):
    """A cover of hulls, each a pair of vertices and planes as `exact_hull` returns."""
    vertices = [v + np.asarray(offset) for v, _ in hulls]
    planes = [np.column_stack([p[:, :3], p[:, 3] + p[:, :3] @ np.asarray(offset)]) for _, p in hulls]
    every = _joined(planes, 4)
    return make_artifact(
        COVER,
        {
            "vertex": _joined(vertices, 3),
            "vertex_start": _starts(vertices),
            "plane_normal": every[:, :3],
            "plane_offset": every[:, 3],
            "plane_start": _starts(planes),
            "member_index": _joined([v[:1] for v in vertices], 3),
            "member_start": np.arange(len(hulls) + 1),
            "history": np.empty((0, 3)),
        },
        frame="world",
        unit="m",
        summary=summary or {},
        **(
            {
                "parameters": {"hulls": len(hulls)},
                "voxel_size_m": g,
                "sigma": 1.0,
                "min_overlap": 1,
                "conservativeness": 1.375,
                "certificate": {"covered": True},
                "guarantee": Guarantee("Every voxel lies inside a hull.", {"covers_voxels": True}),
            }
            | fields
        ),
    )


def make_scene(count=200, seed=3, low=(0, 0, 0), high=(4, 3, 2), color=None):
    rng = np.random.default_rng(seed)
    quat = rng.normal(size=(count, 4))
    return make_artifact(
        SCENE,
        {
            "mean": rng.uniform(low, high, (count, 3)),
            "scale": rng.uniform(0.01, 0.05, (count, 3)),
            "quat_wxyz": quat / np.linalg.norm(quat, axis=1, keepdims=True),
            "opacity": rng.uniform(0.1, 1, count),
            "color": rng.integers(0, 256, (count, 3)) if color is None else np.tile(color, (count, 1)),
        },
        frame="world",
        unit="m",
        parameters={},
        summary={"gaussians": count},
        source={"format": "ply"},
    )


def make_voxels():
    index = np.array([(x, y, 0) for x in range(4) for y in range(3)])
    return make_artifact(
        VOXELS,
        {"index": index, "overlap": np.ones(len(index))},
        frame="world",
        unit="m",
        parameters={},
        summary={"voxels": len(index)},
        voxel_size_m=0.05,
        sigma=1.0,
        min_overlap=1,
    )


def make_plan():
    """Two pieces along x: 0 to 1 m in one second, then to 3 m in two."""
    coefficient = np.zeros((2, 4, 8))
    coefficient[0, 0, :2] = 0, 1
    coefficient[1, 0, :2] = 1, 1
    coefficient[:, 2, 0] = 1
    return make_artifact(
        PLAN,
        {"time": [0, 1, 3], "coefficient": coefficient, "waypoint": [[0, 0, 1, 0], [3, 0, 1, 0]]},
        frame="world",
        unit="m",
        parameters={},
        summary={"duration_s": 3.0},
        radius_m=0.1,
        speed_m_s=1.0,
        certificate={},
        beyond_map_m=100.0,  # for maps that are a few obstacles
    )


def make_trial(index, outcome="reached", clearance=0.2, **fields):
    start, goal = [0.0, 0.5 * index, 1.0], [4.0, 0.5 * index, 1.0]
    known = {
        "start_m": start,
        "goal_m": goal,
        "collision": clearance < 0,
        "steps": 100,
        "duration_s": 10.0 + index,
        "path_length_m": 4.4 + 0.01 * index,
        "straight_length_m": 4.0,
        "map_clearance_m": clearance,
        "scene_clearance_m": None,
        "max_speed_m_s": 1.25,
        "filtered_steps": 40,
        "shortened_steps": 0,
        "infeasible_steps": 1,
        "fallback_steps": 2,
        "mean_jerk_m_s3": 0.75,
        "max_jerk_m_s3": 7.5,
    }
    return TrialResult(index=index, outcome=outcome, **(known | fields))


def make_record(trials, name="tiny", filter_name="polytope-cbf", summary=None, **fields):
    good = [t for t in trials if t.outcome == "reached" and not t.collision]
    count = lambda outcome: sum(t.outcome == outcome for t in trials)  # noqa: E731
    known = {
        "trials": len(trials),
        "success_rate": len(good) / len(trials),
        "success_interval": [0.3125, 0.9375],
        "collisions": sum(t.collision for t in trials),
        **{outcome: count(outcome) for outcome in ("reached", "stuck", "timeout", "refused")},
        "min_map_clearance_m": min(t.map_clearance_m for t in trials),
        "min_scene_clearance_m": None,
        "mean_path_ratio": float(np.mean([t.path_length_m / t.straight_length_m for t in good]))
        if good
        else None,
    }
    provenance = Provenance.now(RUN_SCHEMA, RUN_VERSION, {"vehicle": {"radius_m": 0.1}}, 4, [])
    return RunRecord(
        schema=RUN_SCHEMA,
        version=RUN_VERSION,
        provenance=provenance,
        name=name,
        filter=filter_name,
        vehicle="double-integrator",
        trials=list(trials),
        summary=known | (summary or {}),
        guarantee=Guarantee("The vehicle's sphere stays outside every hull.", {}),
        **fields,
    )


def write_run(log: Path, record: RunRecord, steps=60, timing=None, hulls=None) -> None:
    """An MCAP log with the channels of a run: sine-shaped paths, margins that dip in the middle."""
    from mcap.writer import Writer

    with log.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channels = {}
        for topic, schema in (
            ("/map", "foxglove.SceneUpdate"),
            ("/state", "alula.State"),
            ("/safety", "alula.Safety"),
        ):
            number = writer.register_schema(schema, "jsonschema", b"{}")
            channels[topic] = writer.register_channel(topic, "json", number)
        if hulls is not None:
            entity = SceneEntity(
                timestamp=Time(0, 0), frame_id="world", id="map", metadata=[KeyValuePair("hulls", str(hulls))]
            )
            writer.add_message(channels["/map"], 0, msgspec.json.encode(SceneUpdate(entities=[entity])), 0)
        for trial in record.trials:
            share = np.linspace(0, 1, steps)
            start, goal = np.array(trial.start_m), np.array(trial.goal_m)
            for step, s in enumerate(share):
                time = float(s * trial.duration_s)
                position = start + s * (goal - start) + [0, 0.3 * np.sin(3 * s), 0.1 * np.sin(9 * s)]
                least = trial.map_clearance_m or 0.0
                velocity = {"x": 1.0, "y": 0.0, "z": 0.0}
                messages = {
                    "/state": {
                        "position_m": dict(zip("xyz", position.tolist(), strict=True)),
                        "velocity_m_s": velocity,
                    },
                    "/safety": {
                        "h_m": None if step == 5 else least + abs(s - 0.5),
                        "status": 3 if step == 3 else 0,
                        "status_name": "recovering" if step == 3 else "ok",
                        "u_nom_m_s": velocity,
                        "u_safe_m_s": velocity,
                    },
                }
                for topic, fields in messages.items():
                    data = json.dumps({"trial": trial.index, "time_s": time} | fields).encode()
                    writer.add_message(channels[topic], int(1e9 * time), data, int(1e9 * time))
        stored = msgspec.structs.replace(record, timing=None)
        writer.add_metadata(
            RUN_METADATA,
            {
                "record": msgspec.json.encode(stored).decode(),
                "provenance": msgspec.json.encode(record.provenance).decode(),
            },
        )
        writer.finish()
    if timing is not None:
        record_path(log).write_bytes(msgspec.json.encode(msgspec.structs.replace(record, timing=timing)))
