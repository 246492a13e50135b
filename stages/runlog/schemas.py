"""Channels of a log, and JSON Schemas of their messages."""

from __future__ import annotations

from alula.stages.runlog.foxglove_schemas import (
    FLAG,
    FOXGLOVE_SCHEMAS,
    INTEGER,
    NUMBER,
    QUATERNION,
    TEXT,
    VECTOR,
    Schema,
    array,
    fields,
)

# Schemas by topic. Their order is that in the file.
FLIGHT_CHANNELS = {
    "/map": "foxglove.SceneUpdate",
    "/vehicle": "foxglove.SceneUpdate",
    "/path": "foxglove.PosesInFrame",
    "/state": "alula.State",
    "/safety": "alula.Safety",
    "/log": "foxglove.Log",
    "/pose": "foxglove.PoseInFrame",
    "/tf": "foxglove.FrameTransform",
}

SCHEMAS: dict[str, Schema] = {
    name: {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": name, **schema}
    for name, schema in {
        "alula.State": {
            **fields(
                trial=INTEGER,
                time_s=NUMBER,
                position_m=VECTOR,
                velocity_m_s=VECTOR,
                attitude=QUATERNION,
                omega_body_rad_s=VECTOR,
                rotor_thrust_n=array(NUMBER),
                thrust_n=NUMBER,
                torque_body_nm=VECTOR,
            ),
            "description": "Position and velocity in the world frame; time_s counts from the trial's start. "
            "For a rigid body also attitude (body to world), body rates, and thrusts of its rotors.",
        },
        "alula.Safety": {
            **fields(
                trial=INTEGER,
                time_s=NUMBER,
                h_m=NUMBER,
                status=INTEGER,
                status_name=TEXT,
                u_nom_m_s=VECTOR,
                u_safe_m_s=VECTOR,
                margin=NUMBER,
                margin_unit=TEXT,
                mode_name=TEXT,
                moving_clearance_m=NUMBER,
                infeasible=FLAG,
                certified=FLAG,
                certified_moving=FLAG,
                capped=FLAG,
                saturated=FLAG,
                active=INTEGER,
                candidates=INTEGER,
                rows=INTEGER,
                iterations=INTEGER,
                gate_m=NUMBER,
                a_nom_m_s2=VECTOR,
                a_safe_m_s2=VECTOR,
                realisation_error_m_s2=NUMBER,
                thrust_nom_n=NUMBER,
                torque_nom_body_nm=VECTOR,
                **{"lambda": NUMBER},
                fence_distance_m=NUMBER,
                allowance_m=NUMBER,
                towards_m_s=NUMBER,
                throttle_nom=NUMBER,
                throttle_safe=NUMBER,
                rates_nom_rad_s=VECTOR,
                rates_safe_rad_s=VECTOR,
                disturbance_m_s2=VECTOR,
                disturbance_bound_m_s2=NUMBER,
                added_margin_m=NUMBER,
                sent=TEXT,
                sent_values=array(NUMBER),
                solve_time_s=NUMBER,
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
            **fields(
                time_s=NUMBER,
                state=INTEGER,
                state_name=TEXT,
                event_name=TEXT,
                action_name=TEXT,
                mode=TEXT,
                armed=FLAG,
                landed=FLAG,
                battery_share=NUMBER,
                state_age_s=NUMBER,
                late_s=NUMBER,
                tick_s=NUMBER,
                fence_m=NUMBER,
                fence_h_m=NUMBER,
                fence_share=NUMBER,
                fence_flies=FLAG,
                plan_s=NUMBER,
                plan_rate=NUMBER,
                error_m=NUMBER,
            ),
            "description": "The supervisor's state, the vehicle's reports and the times of the loop, per "
            "tick. A step has the event that caused it and the action that was taken.",
        },
        "alula.Replay": {
            **fields(
                time_s=NUMBER,
                number=INTEGER,
                repeats=INTEGER,
                age_s=NUMBER,
                measured=array(NUMBER),
                target=array(NUMBER),
                decided=TEXT,
                decided_values=array(NUMBER),
                is_own=FLAG,
                sent=TEXT,
                sent_values=array(NUMBER),
            ),
            "description": "Inputs and set-points of each tick of a real flight, not rounded: the native "
            "flight repeats it bit by bit: the number of the tick since set-points began, the ticks left out "
            "before it; the age of the measured state (position, attitude as MRP, velocity, body rates); the "
            "reference (position to snap, yaw and its rates); the set-point decided, whether it was sent so, "
            "and the one sent.",
        },
        **FOXGLOVE_SCHEMAS,
    }.items()
}
