"""Channels of a log, and JSON Schemas of their messages; foxglove.* follow Foxglove's own definitions."""

from __future__ import annotations

from typing import Any

# Schemas by topic. Their order is that in the file.
FLIGHT_CHANNELS = {
    "/map": "foxglove.SceneUpdate",
    "/path": "foxglove.PosesInFrame",
    "/state": "alula.State",
    "/safety": "alula.Safety",
    "/log": "foxglove.Log",
    "/pose": "foxglove.PoseInFrame",
}


def _object(**properties: Any) -> dict[str, Any]:
    return {"type": "object", "properties": properties}


def _array(items: Any) -> dict[str, Any]:
    return {"type": "array", "items": items}


_NUMBER = {"type": "number"}
_INTEGER = {"type": "integer"}
_TEXT = {"type": "string"}
_FLAG = {"type": "boolean"}
_TIME = {**_object(sec=_INTEGER, nsec=_INTEGER), "title": "time"}
_DURATION = {**_object(sec=_INTEGER, nsec=_INTEGER), "title": "duration"}
_VECTOR = {**_object(x=_NUMBER, y=_NUMBER, z=_NUMBER), "title": "foxglove.Vector3"}
_POINT = {**_VECTOR, "title": "foxglove.Point3"}
_QUATERNION = {**_object(x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER), "title": "foxglove.Quaternion"}
_POSE = {**_object(position=_VECTOR, orientation=_QUATERNION), "title": "foxglove.Pose"}
_COLOR = {**_object(r=_NUMBER, g=_NUMBER, b=_NUMBER, a=_NUMBER), "title": "foxglove.Color"}
_TRIANGLES = {
    **_object(
        pose=_POSE, points=_array(_POINT), color=_COLOR, colors=_array(_COLOR), indices=_array(_INTEGER)
    ),
    "title": "foxglove.TriangleListPrimitive",
}
_SPHERE = {**_object(pose=_POSE, size=_VECTOR, color=_COLOR), "title": "foxglove.SpherePrimitive"}
_ENTITY = {
    **_object(
        timestamp=_TIME,
        frame_id=_TEXT,
        id=_TEXT,
        lifetime=_DURATION,
        frame_locked={"type": "boolean"},
        metadata=_array(_object(key=_TEXT, value=_TEXT)),
        spheres=_array(_SPHERE),
        triangles=_array(_TRIANGLES),
    ),
    "title": "foxglove.SceneEntity",
}

SCHEMAS: dict[str, dict[str, Any]] = {
    name: {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": name, **schema}
    for name, schema in {
        "alula.State": {
            **_object(
                trial=_INTEGER,
                time_s=_NUMBER,
                position_m=_VECTOR,
                velocity_m_s=_VECTOR,
                attitude=_QUATERNION,
                omega_body_rad_s=_VECTOR,
                rotor_thrust_n=_array(_NUMBER),
                thrust_n=_NUMBER,
                torque_body_nm=_VECTOR,
            ),
            "description": "Position and velocity in the world frame; time_s counts from the trial's start. "
            "For a rigid body also attitude (body to world), body rates, and thrusts of its rotors.",
        },
        "alula.Safety": {
            **_object(
                trial=_INTEGER,
                time_s=_NUMBER,
                h_m=_NUMBER,
                status=_INTEGER,
                status_name=_TEXT,
                u_nom_m_s=_VECTOR,
                u_safe_m_s=_VECTOR,
                margin=_NUMBER,
                margin_unit=_TEXT,
                mode_name=_TEXT,
                moving_clearance_m=_NUMBER,
                infeasible=_FLAG,
                certified=_FLAG,
                certified_moving=_FLAG,
                capped=_FLAG,
                saturated=_FLAG,
                active=_INTEGER,
                candidates=_INTEGER,
                rows=_INTEGER,
                iterations=_INTEGER,
                gate_m=_NUMBER,
                a_nom_m_s2=_VECTOR,
                a_safe_m_s2=_VECTOR,
                realisation_error_m_s2=_NUMBER,
                thrust_nom_n=_NUMBER,
                torque_nom_body_nm=_VECTOR,
                **{"lambda": _NUMBER},
                fence_distance_m=_NUMBER,
                allowance_m=_NUMBER,
                towards_m_s=_NUMBER,
                throttle_nom=_NUMBER,
                throttle_safe=_NUMBER,
                rates_nom_rad_s=_VECTOR,
                rates_safe_rad_s=_VECTOR,
                disturbance_m_s2=_VECTOR,
                disturbance_bound_m_s2=_NUMBER,
                added_margin_m=_NUMBER,
                sent=_TEXT,
                sent_values=_array(_NUMBER),
                solve_time_s=_NUMBER,
            ),
            "description": "The filter's margin and status, the nominal and the filtered input. Among hulls: "
            "h_m and velocities. Among ellipsoids: the filter's own barrier, not in metres, and "
            "accelerations. Among moving obstacles: the mode of a filter that sees them, and their true "
            "clearance. Of a pilot in a geofence: the true distance as fence_distance_m, h_I as h_m "
            "after subtracting allowance_m, the regulation function lambda, throttles and rates. In a real "
            "flight also the set-point sent (rates: thrust per mass and body rates; acceleration, velocity: "
            "world frame, and the yaw), the time of the filter, the acceleration that the vehicle's model "
            "leaves out, as estimated, a bound on what is missing in the estimate, and the margin that the "
            "filter keeps in addition because of that bound, where there is the room.",
        },
        "alula.Supervisor": {
            **_object(
                time_s=_NUMBER,
                state=_INTEGER,
                state_name=_TEXT,
                event_name=_TEXT,
                action_name=_TEXT,
                mode=_TEXT,
                armed=_FLAG,
                landed=_FLAG,
                battery_share=_NUMBER,
                state_age_s=_NUMBER,
                late_s=_NUMBER,
                tick_s=_NUMBER,
                fence_m=_NUMBER,
                fence_h_m=_NUMBER,
                fence_share=_NUMBER,
                fence_flies=_FLAG,
                plan_s=_NUMBER,
                plan_rate=_NUMBER,
                error_m=_NUMBER,
            ),
            "description": "The supervisor's state, the vehicle's reports and the times of the loop, per "
            "tick. A step has the event that caused it and the action that was taken.",
        },
        "alula.Replay": {
            **_object(
                time_s=_NUMBER,
                number=_INTEGER,
                repeats=_INTEGER,
                age_s=_NUMBER,
                measured=_array(_NUMBER),
                target=_array(_NUMBER),
                decided=_TEXT,
                decided_values=_array(_NUMBER),
                is_own=_FLAG,
                sent=_TEXT,
                sent_values=_array(_NUMBER),
            ),
            "description": "Inputs and set-points of each tick of a real flight, not rounded: the native "
            "flight repeats it bit by bit: the number of the tick since set-points began, the ticks left out "
            "before it; the age of the measured state (position, attitude as MRP, velocity, body rates); the "
            "reference (position to snap, yaw and its rates); the set-point decided, whether it was sent so, "
            "and the one sent.",
        },
        "foxglove.PosesInFrame": _object(timestamp=_TIME, frame_id=_TEXT, poses=_array(_POSE)),
        "foxglove.PoseInFrame": _object(timestamp=_TIME, frame_id=_TEXT, pose=_POSE),
        "foxglove.SceneUpdate": _object(
            deletions=_array(_object(timestamp=_TIME, type=_INTEGER, id=_TEXT)), entities=_array(_ENTITY)
        ),
        "foxglove.Log": _object(
            timestamp=_TIME, level=_INTEGER, message=_TEXT, name=_TEXT, file=_TEXT, line=_INTEGER
        ),
    }.items()
}
