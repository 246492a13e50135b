"""Records of encounters made by hand, and rows of tables."""

from alula.schemas.artifacts.manifest import Guarantee
from alula.schemas.artifacts.provenance import Provenance
from alula.schemas.log.run import ObstacleResult, RunRecord, TrialResult
from papers.dracbf import tables as dracbf


def met(hit=False, closest=2.0, separation=1.5, warned=3.0, reaction=0.0):
    is_warned = warned is not None
    return ObstacleResult(
        closest_m=0.1 if hit else closest,
        separation_m=separation if is_warned else None,
        closing_m_s=10.0 if is_warned else None,
        detected_s=1.0,
        warned_s=warned,
        reaction_s=reaction if is_warned else None,
        avoid_s=0.5 if is_warned else None,
        collision=hit,
    )


def trial(index, obstacles, risk=0.0, clearance=None, spent=0.75):
    return TrialResult(
        index=index,
        start_m=[0.0, 0.0, 10.0],
        goal_m=[200.0, 0.0, 10.0],
        outcome="passed",
        collision=any(o.collision for o in obstacles) or (clearance is not None and clearance < 0),
        steps=100,
        duration_s=1.0,
        path_length_m=4.0,
        straight_length_m=200.0,
        map_clearance_m=clearance,
        scene_clearance_m=None,
        max_speed_m_s=4.0,
        filtered_steps=10,
        shortened_steps=0,
        infeasible_steps=2,
        fallback_steps=0,
        mean_jerk_m_s3=1.0,
        max_jerk_m_s3=10.0,
        obstacles=obstacles,
        active_steps=20,
        worst_violation_m_s2=0.25,
        risk_spent=spent,
        mission_risk=risk,
    )


def flown(scenario, variant, trials, mean_s=1e-5, **parameters):
    tree = {"rules": {"dt_s": 0.01}, "safety": {"dr-acbf": {"trigger": "cvar"}}, "estimation": {"sensor": {}}}
    for key, value in parameters.items():
        *parents, last = key.split("__")
        if parents[0] == "safety":
            parents[1] = parents[1].replace("_", "-")
        at = tree
        for name in parents:
            at = at.setdefault(name, {})
        at[last] = value
    record = RunRecord(
        schema="alula/run",
        version="1.0",
        provenance=Provenance.now("alula/run", "1.0", {**tree, "name": variant}, 0, []),
        name=variant,
        filter=variant,
        vehicle="sphere",
        trials=trials,
        summary={},
        guarantee=Guarantee(statement="", claims={}),
        timing={
            "filter_calls": 20,
            "filter_mean_s": mean_s,
            "filter_p50_s": mean_s,
            "filter_std_s": 0.0,
            "filter_p99_s": 2 * mean_s,
            "command_mean_s": [1e-5, 3e-5],
            "reaction_mean_s": [1e-5, 3e-5],
        },
    )
    return dracbf.Flown(scenario, variant, record)


def row_of(table, first):
    rows = [dict(zip(table.columns, row, strict=True)) for row in table.rows if row[0] == first]
    assert len(rows) == 1
    return rows[0]
