"""Logs of flights behind a list of filters: vehicle, obstacles, tracks, and each filter by its name."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, BinaryIO

import msgspec
import numpy as np

from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.log.channels import (
    OBSTACLES_TOPIC,
    OF_BARRIER,
    SAFETY_TOPIC,
    SIMULATED_TOPICS,
    Safety,
    State,
)
from alula.schemas.log.foxglove import Pose, PoseInFrame, Time
from alula.schemas.log.run import RunRecord, TrialResult
from alula.schemas.scenarios.check import TRACKING
from alula.stages.compression.hulls import Hulls
from alula.stages.filtering.protocol import FilterStatus
from alula.stages.runlog.cloud import cloud_message
from alula.stages.runlog.maps import world_message
from alula.stages.runlog.messages import (
    nanoseconds,
    number,
    obstacle_message,
    path_message,
    quaternion_of_mrp,
    transform_message,
    vehicle_message,
    verdict_message,
    xyz,
)
from alula.stages.runlog.piloted import pilot_fields
from alula.stages.runlog.writer import LogWriter
from alula.stages.simulation.judge import CAPPED, CERTIFIED, CERTIFIED_MOVING, INFEASIBLE, LIMITED
from alula.stages.simulation.result import WorldFlight

SIMULATED_EPOCH_NS = 946_684_800 * 10**9  # 2000-01-01T00:00:00Z, when each simulated run starts
_GAP_S = 1.0  # between trials, which follow one another in log time
MODES = ("nominal", "avoid", "hover")  # of filters among moving obstacles
_COUNTS = ("active", "candidates", "rows", "iterations")


def write_world_log(
    stream: BinaryIO,
    record: RunRecord,
    flights: list[WorldFlight],
    frame: str,
    *,
    dt_s: float,
    interface: str,
    filters: list[str],
    radii_m: list[float],
    radius_m: float,
    hulls: Hulls | None,
    scene: Artifact | None,
    sigma: float,
    faces: Any,
) -> None:
    """Write the log of the trials that are shown; equal arguments give equal bytes.

    `/map`, `/vehicle` and `/splat` come once, `/path` and `/log` for each trial, the others for each sample.
    Trials follow one another in log time, from `SIMULATED_EPOCH_NS` on, with a second between them.

    `/safety` is the last filter, of a pilot's flight with `pilot_fields`, and `/safety/NAME` each filter of a
    list of several. `/obstacles` has a sphere for each moving obstacle, and one of twice its radius at each
    track. `margin` of `/safety` is the barrier of the filter, `moving_clearance_m` the true clearance of
    moving obstacles.

    Args:
        flights: samples of those that are shown.
        dt_s: duration of a tick [s].
        interface: what the vehicle is commanded by.
        radii_m: of the moving obstacles [m].
        hulls: of cover and walls; None without any.
        scene: with ellipsoids; None without one.
        faces: of the fence, shape (L, 4), rows (n, d) with unit n and n . p <= d inside.
    """
    each = filters if len(filters) > 1 else []
    topics = [*SIMULATED_TOPICS, *([OBSTACLES_TOPIC] if radii_m else [])]
    topics += [f"{SAFETY_TOPIC}/{name}" for name in each]
    paths = [flight.rows("state")[:, :3] for flight in flights]
    once: dict[str, msgspec.Struct] = {
        "/map": world_message(hulls, scene, sigma, faces, paths, frame, SIMULATED_EPOCH_NS),
        "/vehicle": vehicle_message(radius_m, SIMULATED_EPOCH_NS),
    }
    if scene is not None:
        topics.append("/splat")
        once["/splat"] = cloud_message(scene, paths, frame, SIMULATED_EPOCH_NS)
    log, begin_s = LogWriter(stream, topics), 0.0
    for topic, message in once.items():
        log.send(topic, SIMULATED_EPOCH_NS, message)
    for flight in flights:
        trial = record.trials[flight.trial]
        begin_s = _GAP_S + _write_trial(
            log, begin_s, trial, flight, frame, dt_s, interface, filters, radii_m, radius_m
        )
    log.finish(record)


def _write_trial(
    log: LogWriter,
    begin_s: float,
    trial: TrialResult,
    flight: WorldFlight,
    frame: str,
    dt_s: float,
    interface: str,
    filters: list[str],
    radii_m: list[float],
    radius_m: float,
) -> float:
    """Write a trial that begins at a time after the start of the log; return that of its end [s]."""
    state, nominal, command = flight.rows("state"), flight.rows("nominal"), flight.rows("command")
    obstacles, tracks, margin = flight.rows("obstacles"), flight.rows("tracks"), flight.rows("margin")
    u_nominal, a_command, a_error = (flight.rows(name) for name in ("u_nominal", "a_command", "a_error"))
    rotors, gate, counts = (flight.rows(name) for name in ("rotor_thrust", "gate_m", "counts"))
    status, flags = flight.of_filters("each_status"), flight.of_filters("each_flags")
    mark = np.frombuffer(flight.mark, np.uint8)
    times: list[float] = flight.time_s(dt_s).tolist()
    by_rotors = interface in ("wrench", "body-rates")
    reach = np.array(radii_m, np.float64) + radius_m
    apart = np.linalg.norm(obstacles - state[:, None, :3], axis=2) - reach

    def of_filter(k: int, i: int) -> dict[str, Any]:
        value = number(margin[i, k]) if margin.shape[1] else None
        is_distance = not filters or filters[k] == "polytope-cbf"
        found = {"h_m": value} if is_distance else {"margin": value, "margin_unit": OF_BARRIER}
        if not filters:
            return found | {"status": 0, "status_name": "ok"}
        which, bits = FilterStatus(int(status[i, k])), int(flags[i, k])
        return found | {
            "status": int(which),
            "status_name": which.name.lower(),
            "mode_name": MODES[bits >> 4] if filters[k] in TRACKING else None,
            "infeasible": bool(bits & INFEASIBLE),
            "certified": bool(bits & CERTIFIED),
            "certified_moving": bool(bits & CERTIFIED_MOVING),
            "capped": bool(bits & CAPPED),
            "gate_m": number(gate[i, k]),
            **dict(zip(_COUNTS, map(int, counts[i, k]), strict=True)),
        }

    def of_body(i: int) -> dict[str, Any]:
        """Accelerations and the mission's wrench; nothing of velocities and sticks."""
        if interface in ("velocity", "sticks"):
            return {}
        found: dict[str, Any] = {"a_nom_m_s2": xyz(nominal[i])}
        if np.isfinite(a_command[i]).all():
            error = number(a_error[i])
            found |= {"a_safe_m_s2": xyz(a_command[i]), "realisation_error_m_s2": error}
        if by_rotors:
            found |= {"thrust_nom_n": number(u_nominal[i, 0]), "torque_nom_body_nm": xyz(u_nominal[i, 1:])}
        return found

    def messages(i: int, now_ns: int) -> Iterator[tuple[str, msgspec.Struct]]:
        pose = Pose(xyz(state[i, :3]), quaternion_of_mrp(state[i, 3:6]))
        yield "/pose", PoseInFrame(Time.of(now_ns), frame, pose)
        yield "/tf", transform_message(pose, frame, now_ns)
        head: dict[str, Any] = {"trial": trial.index, "time_s": round(times[i], 9)}
        yield (
            "/state",
            State(
                **head,
                position_m=pose.position,
                velocity_m_s=xyz(state[i, 6:9]),
                attitude=pose.orientation,
                omega_body_rad_s=xyz(state[i, 9:12]),
                thrust_n=number(command[i, 3]),
                torque_body_nm=xyz(command[i, 4:7]),
                rotor_thrust_n=[number(value) for value in rotors[i]] if by_rotors else None,
            ),
        )
        last = of_filter(len(filters) - 1, i) | {"saturated": bool(mark[i] & LIMITED)} | of_body(i)
        flown = command[i, :3]
        if interface == "velocity":
            last |= {"u_nom_m_s": xyz(nominal[i]), "u_safe_m_s": xyz(flown)}
        elif interface == "body-rates":
            last |= {"rates_safe_rad_s": xyz(flown)}
        elif interface == "sticks":
            last |= {"throttle_safe": number(command[i, 7]), "rates_safe_rad_s": xyz(command[i, 8:11])}
            last |= pilot_fields(flight, i)
        if radii_m:
            last["moving_clearance_m"] = number(apart[i].min())
        yield SAFETY_TOPIC, Safety(**head, **last)
        if len(filters) > 1:
            for k, name in enumerate(filters):
                yield f"{SAFETY_TOPIC}/{name}", Safety(trial=trial.index, **of_filter(k, i))
        if radii_m:
            yield OBSTACLES_TOPIC, obstacle_message(obstacles[i], tracks[i], radii_m, frame, now_ns)

    is_good = trial.outcome in ("reached", "held", "passed") and not trial.collision
    start = SIMULATED_EPOCH_NS + nanoseconds(begin_s)
    log.send("/path", start, path_message(state[:, :3], frame, start))
    now = start
    for i, time_s in enumerate(times):
        now = SIMULATED_EPOCH_NS + nanoseconds(begin_s + time_s)
        for topic, message in messages(i, now):
            log.send(topic, now, message)
    log.send("/log", now, verdict_message(_words(trial), now, is_good=is_good, collided=trial.collision))
    return begin_s + times[-1]


def _words(trial: TrialResult) -> str:
    words = f"trial {trial.index}: {trial.outcome} after {trial.duration_s:.2f} s"
    parts = {
        "hulls": trial.map_clearance_m,
        "ellipsoids": trial.scene_clearance_m,
        "the fence": trial.fence_clearance_m,
        "moving obstacles": trial.moving_clearance_m,
    }
    known = [f"{value:.3f} m of {name}" for name, value in parts.items() if value is not None]
    words += f", minimum clearance {', '.join(known)}" if known else ""
    return words if trial.fence is None else f"{words}, {trial.fence.interventions} interventions"
