"""Samples, heads and records of flight logs."""

import numpy as np

from alula.schemas.artifacts.provenance import Provenance
from alula.schemas.log.channels import Safety, State, Supervisor
from alula.schemas.log.foxglove import UPRIGHT, Vector3
from alula.schemas.log.run import RUN_SCHEMA, RUN_VERSION, RunRecord
from alula.stages.flight.judge import guarantee_of, judge, summary_of
from alula.stages.flight.mission import head_facts
from alula.stages.flight.recorder.channels import FlightHead
from alula.stages.flight.recorder.samples import TickSample
from alula.stages.runlog.maps import map_message


def head_of(made):
    return FlightHead(
        provenance=Provenance.now(RUN_SCHEMA, RUN_VERSION, {"a": 1}, None, []),
        map_message=map_message(made.map, {"sigma": 1.0}, [np.zeros((1, 3))], "world", 0),
        **head_facts(made),
    )


def sample(i, x=0.0, **fields):
    """Tick i of a flight at (x, 2, 1); `fields` are of the supervisor."""
    three, time_s = Vector3(x, 2.0, 1.0), 0.01 * i
    known = {
        **{"time_s": time_s, "state": 4, "state_name": "fly", "mode": "GUIDED", "armed": True},
        **{"landed": False, "battery_share": 0.8, "state_age_s": 0.001, "late_s": 1e-4, "tick_s": 2e-4},
        **{"fence_m": 1.0, "fence_h_m": 1.2, "fence_share": 1.0, "fence_flies": False, "error_m": 0.1},
        **{"plan_s": time_s, "plan_rate": 1.0},
    }
    state = State(
        trial=0,
        time_s=time_s,
        position_m=three,
        velocity_m_s=three,
        attitude=UPRIGHT,
        omega_body_rad_s=three,
    )
    safety = Safety(
        trial=0,
        time_s=time_s,
        status=1,
        status_name="filtered",
        h_m=0.5,
        active=3,
        infeasible=False,
        certified=True,
        u_nom_m_s=three,
        u_safe_m_s=three,
        sent="velocity",
        sent_values=[0.1, 0.2, 0.3, 0.0],
        solve_time_s=1e-4,
    )
    return TickSample(Supervisor(**(known | fields)), state, safety)


def record_of(made, loop, recorder):
    trial = judge(made, recorder.rows, loop.supervision.cause)
    summary = summary_of(trial, loop.supervision, loop.taken)
    return RunRecord(
        schema=RUN_SCHEMA,
        version=RUN_VERSION,
        provenance=head_of(made).provenance,
        name="flight",
        filter=made.config.filter,
        vehicle="v",
        trials=[trial],
        summary=summary,
        guarantee=guarantee_of(made, trial),
    )
