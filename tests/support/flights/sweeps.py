"""Sweeps of runs whose numbers are known."""

from alula.schemas.artifacts.manifest import Guarantee
from alula.schemas.artifacts.provenance import Provenance
from alula.schemas.log.run import RunRecord, TrialResult
from alula.stages.reporting.material import Run
from papers.fastbridge.sweeps import Sweep


def trial(index, outcome="reached", collision=False, jerk=2.0, speed=1.0, steps=100, **fields):
    known = {
        "start_m": [0.0, 0.0, 1.0],
        "goal_m": [2.0, 0.0, 1.0],
        "duration_s": 0.01 * steps,
        "path_length_m": 2.5,
        "straight_length_m": 2.0,
        "map_clearance_m": None,
        "scene_clearance_m": -0.01 if collision else 0.1 + 0.01 * index,
        "filtered_steps": 10,
        "shortened_steps": 0,
        "infeasible_steps": 3,
        "fallback_steps": 0,
        "backup_steps": 5,
        "certified_steps": steps,
        "peak_realisation_error_m_s2": 0.5 * (index + 1),
        "min_gamma": 0.2 + index,
    }
    return TrialResult(
        **{
            **known,
            "index": index,
            "outcome": outcome,
            "collision": collision,
            "steps": steps,
            "mean_jerk_m_s3": jerk,
            "max_jerk_m_s3": 10 * jerk,
            "max_speed_m_s": speed,
            **fields,
        }
    )


SHIELDED = {
    "safety": {
        "filters": ["cone-ecbf"],
        "cone-ecbf": {"policy": "brake", "shield": True, "count": 64},
    }
}


def sweep(variant, speed, trials, scene="room", seconds=1e-4, parameters=None, filter_name=None):
    calls = sum(t.steps for t in trials)
    timing = {
        "filter_calls": calls,
        "filter_total_s": seconds * calls,
        "filter_p99_s": 2 * seconds,
        "tick_mean_s": 1.5 * seconds,
        "tick_p99_s": 3 * seconds,
        "tick_max_s": 9 * seconds,
        "overruns": 0,
    }
    record = RunRecord(
        schema="alula/run",
        version="1.0",
        provenance=Provenance.now("alula/run", "1.0", parameters or SHIELDED, 0, []),
        name=variant,
        filter=filter_name or variant,
        vehicle="test",
        trials=trials,
        summary={},
        guarantee=Guarantee(statement="none", claims={}),
        timing=timing,
    )
    return Sweep(scene, variant, speed, Run(f"{variant}@{speed}", record))
