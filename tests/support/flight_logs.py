"""Samples, heads and records of flight logs."""

import numpy as np

from alula.schemas.provenance import Provenance
from alula.schemas.run import RUN_SCHEMA, RUN_VERSION, RunRecord
from alula.stages.flight.judge import guarantee_of, judge, summary_of
from alula.stages.flight.mission import head_facts
from alula.stages.flight.recorder.channels import FlightHead
from alula.stages.flight.recorder.samples import FilterSample, TickSample
from alula.stages.runlog.maps import map_message


def head_of(made):
    return FlightHead(
        provenance=Provenance.now(RUN_SCHEMA, RUN_VERSION, {"a": 1}, None, []),
        map_message=map_message(made.map, {"sigma": 1.0}, [np.zeros((1, 3))], "world", 0),
        **head_facts(made),
    )


def sample(i, x=0.0):
    three = (x, 2.0, 1.0)
    done = FilterSample(
        *(1, 0.5, 3, False, True, three, three, None, 0.1, 0.01 * i, 1.0, 1e-4, 1.2, 1.0, False, "velocity"),
        (0.1, 0.2, 0.3, 0.0),
    )
    return TickSample(
        *(0.01 * i, 1e-4, 2e-4, "fly", 0.001, three, three, (1.0, 0.0, 0.0, 0.0), three, "GUIDED"),
        *(True, False, 0.8, 1.0, done),
    )


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
