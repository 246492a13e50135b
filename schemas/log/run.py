"""Records of runs: the verdict on each flight and the summary, beside and inside the MCAP log."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal, Self

import msgspec

from alula.schemas.artifacts import contents
from alula.schemas.artifacts.contents import FenceSummary, RunParameters, RunSummary
from alula.schemas.artifacts.manifest import VERSION, Guarantee, Vector
from alula.schemas.artifacts.provenance import RUN_METADATA, Provenance
from alula.schemas.decode import MalformedError, decode_json
from alula.schemas.errors import ArtifactError, DamagedError, InputError
from alula.schemas.files import check_no_stream
from alula.schemas.log.mcap import metadata, open_log

RUN_SCHEMA = "alula/run"
RUN_VERSION = VERSION
RUN_SUFFIX = ".run.mcap"
MOST_RECORD_VALUES = 2**23  # of the JSON of a record: 200,000 trials

FLIGHT_METADATA = "alula/flight"  # at the beginning of the log of a real flight: known before it begins

# "stopped": a real flight that ended before its goal, by landing or because the pilot took over.
# "held": a vehicle that hovers or flies by a pilot did so for the whole time.
# "missed-via", "off-plan": it reached the goal of a plan, but missed a via point or gate, or left its tube.
Outcome = Literal[
    "reached", "stuck", "timeout", "refused", "passed", "stopped", "missed-via", "off-plan", "held"
]
PLAN_OUTCOMES: tuple[Outcome, ...] = ("missed-via", "off-plan")


class PassResult(msgspec.Struct, frozen=True, kw_only=True):
    """How a flown path passed a waypoint or gate of its plan.

    Attributes:
        name: such as "gate 2 of lap 1".
        passed: within its tolerance, or through its opening in its direction, after the one before.
        allowed_m: tolerance, or what the vehicle's radius leaves of that of the opening [m].
        off_m: minimum distance from a waypoint; distance from the centre of a gate where its plane was
            crossed in its direction, nearest to the centre if none was within; None if it never was [m].
        backwards: the gate's opening was flown through, against its direction.
        held_s: longest time within the tolerance of a waypoint where the plan holds [s].
    """

    name: str
    passed: bool
    allowed_m: float
    off_m: float | None
    backwards: bool = False
    held_s: float | None = None


class PlanResult(msgspec.Struct, frozen=True, kw_only=True):
    """Comparison of a flown path with its plan.

    Attributes:
        via_tolerance_m: distance within which a via point without its own tolerance counts as passed [m].
        closest_m: minimum distance to each via point, or centre of a gate, in their order, after the one
            before was passed [m].
        missed: numbers of those that were missed, from 1, over all laps.
        outside_m: maximum distance of the path from the tube about the plan, from below; 0 within it [m].
        passes: each of them.
    """

    via_tolerance_m: float
    closest_m: list[float]
    missed: list[int]
    outside_m: float
    passes: list[PassResult] = []


class ObstacleResult(msgspec.Struct, frozen=True, kw_only=True):
    """Encounter of a trial with one moving obstacle, by its true state; None for an event that did not occur.

    Attributes:
        closest_m: minimum distance of the centres over the run [m].
        separation_m: the same from the obstacle's warning until the vehicle has stopped hovering [m]. The
            obstacle's warning is the first one in which it is the most urgent obstacle.
        closing_m_s: closing speed at its warning [m/s].
        detected_s: simulated time of the first detection [s].
        warned_s: simulated time of its warning [s].
        reaction_s: simulated time from its warning until the command differs from the nominal one [s].
        avoid_s: simulated time from there to the end of hovering [s].
        collision: the vehicle touched it.
    """

    closest_m: float
    separation_m: float | None
    closing_m_s: float | None
    detected_s: float | None
    warned_s: float | None
    reaction_s: float | None
    avoid_s: float | None
    collision: bool


class FenceResult(msgspec.Struct, frozen=True, kw_only=True):
    """Flight by a pilot in a fence; steps are ticks of its filter, None an event that did not occur.

    `altered_passes` and `out_of_range` are 0 for a filter that works.

    Attributes:
        passed_steps: the pilot's command was passed.
        blended_steps: it was blended with the backup controller's.
        backup_steps: it was replaced by the backup controller's.
        no_pilot_steps: there was no command of a pilot.
        hand_over_steps: navigation was too old.
        refused_steps: no command could be computed.
        interventions: times that lambda fell below 1/2 after having been above 9/10.
        altered_passes: passed commands that are not the pilot's, bit by bit.
        out_of_range: commands beyond the limits.
        longest_backup_s: longest time of the backup controller alone [s].
        min_lambda: minimum of the regulation function.
        min_h_i_m: minimum of h_I [m].
        brake_distance_m: distance at the first intervention to the face or the map that it brakes for [m].
        stop_distance_m: distance to the same when first slower than 0.5 m/s after it [m].
    """

    passed_steps: int
    blended_steps: int
    backup_steps: int
    no_pilot_steps: int
    hand_over_steps: int
    refused_steps: int
    interventions: int
    altered_passes: int
    out_of_range: int
    longest_backup_s: float
    min_lambda: float | None
    min_h_i_m: float | None
    brake_distance_m: float | None
    stop_distance_m: float | None


class FilterCounts(msgspec.Struct, frozen=True, kw_only=True):
    """One filter in a flight behind a list of them; counts are steps.

    Attributes:
        name: of the filter.
        filtered: the command was changed by the filter's rows.
        backup: its backup policy flew.
        recovering: no command met its constraints.
        refused: it gave no command, and braking, rest or hovering stood in.
        infeasible: its program had no solution.
        certified: it proved a safe manoeuvre against all static obstacles.
        certified_moving: that manoeuvre was also clear of the tubes of all tracks.
        min_margin: minimum of its own barrier; None without an obstacle.
    """

    name: str
    filtered: int
    backup: int
    recovering: int
    refused: int
    infeasible: int
    certified: int
    certified_moving: int
    min_margin: float | None


class TrialResult(msgspec.Struct, frozen=True, kw_only=True):
    """Verdict on one flight.

    Clearances are those of the vehicle's sphere: negative means collision. They are computed after the
    flight, independently of the filter, over the continuous path. Jerk is the second difference of the
    velocity at the rate of the filter.

    Encounters with moving obstacles: "passed" means that all obstacles have receded, `map_clearance_m` is
    that of static walls, and `collision` is one with an obstacle or a wall. Flights in a geofence:
    `goal_m` is the last position.

    Attributes:
        index: number of the trial.
        start_m, goal_m: positions, world frame [m].
        outcome: end of the flight.
        collision: a clearance is negative, beyond rounding.
        steps: ticks of the filter.
        duration_s: simulated or, of a real flight, measured time [s].
        path_length_m: length of the flown path [m].
        straight_length_m: distance from start to goal [m].
        map_clearance_m: minimum clearance of the hulls of the cover [m].
        scene_clearance_m: minimum clearance of the ellipsoids of the scene [m].
        max_speed_m_s: [m/s].
        filtered_steps: the filter changed the command.
        shortened_steps: the step was cut short.
        infeasible_steps: no command met all constraints, or the filter refused.
        fallback_steps: the filter flew its recovery or backup.
        mean_jerk_m_s3, max_jerk_m_s3: [m/s^3].
        start_margin_m: psi - radius at the start, only among hulls; where negative, the filter guaranteed
            nothing for this flight [m].
        reference_speed_m_s: peak speed of the reference; None without one [m/s].
        mean_speed_m_s, max_acceleration_m_s2: of the body [m/s], [m/s^2].
        max_tracking_error_m: maximum distance from the reference [m].
        peak_realisation_error_m_s2: maximum difference of the acceleration and the commanded one; None where
            none is commanded [m/s^2].
        min_margin: minimum of the filter's barrier.
        min_gamma: minimum of r' A r - 1 over all ellipsoids as the filter grew them, at the rate of the
            filter; below 0 inside one; None where no filter reads them.
        backup_steps: the backup policy flew.
        certified_steps: a safe backup manoeuvre was proven to remain.
        capped_steps: the limit on the number of ellipsoids left some out.
        saturated_steps: the rotors, or the limits of a point, could not realise the command.
        line_clearance_m: clearance of the straight line from start to goal to hulls and ellipsoids [m].
        obstacles: one result per moving obstacle; this and what follows up to `mission_risk` only in
            encounters.
        active_steps: ticks in a manoeuvre or with a warning.
        refused_steps: the filter refused.
        iterations: of the filter's projection.
        worst_violation_m_s2: maximum violation of the filter's rows, as an acceleration [m/s^2].
        risk_spent: sum over steps of the risk that the flown rows left; None for filters without such rows.
        mission_risk: sum over windows of the risk of a collision.
        fence: only of a pilot in a fence.
        plan: only along a plan.
        fence_clearance_m: minimum clearance inside the faces of a fence; this and what follows only of
            simulated flights [m].
        moving_clearance_m: minimum clearance of moving obstacles [m].
        stale_steps: the last measurement was too old.
        certified_moving_steps: that manoeuvre was also clear of the tubes of all tracks.
        filters: one result for each filter, in their order.
    """

    index: int
    start_m: Vector
    goal_m: Vector
    outcome: Outcome
    collision: bool
    steps: int
    duration_s: float
    path_length_m: float
    straight_length_m: float
    map_clearance_m: float | None
    scene_clearance_m: float | None
    max_speed_m_s: float
    filtered_steps: int
    shortened_steps: int
    infeasible_steps: int
    fallback_steps: int
    mean_jerk_m_s3: float
    max_jerk_m_s3: float
    start_margin_m: float | None = None
    reference_speed_m_s: float | None = None
    mean_speed_m_s: float | None = None
    max_acceleration_m_s2: float | None = None
    max_tracking_error_m: float | None = None
    peak_realisation_error_m_s2: float | None = None
    min_margin: float | None = None
    min_gamma: float | None = None
    backup_steps: int | None = None
    certified_steps: int | None = None
    capped_steps: int | None = None
    saturated_steps: int | None = None
    line_clearance_m: float | None = None
    obstacles: list[ObstacleResult] | None = None
    active_steps: int | None = None
    refused_steps: int | None = None
    iterations: int | None = None
    worst_violation_m_s2: float | None = None
    risk_spent: float | None = None
    mission_risk: float | None = None
    fence: FenceResult | None = None
    plan: PlanResult | None = None
    fence_clearance_m: float | None = None
    moving_clearance_m: float | None = None
    stale_steps: int | None = None
    certified_moving_steps: int | None = None
    filters: list[FilterCounts] | None = None


class RunRecord(msgspec.Struct, frozen=True, kw_only=True):
    """Record of a run; `timing` is measured and differs from run to run.

    `summary` has at least these keys: trials, success_rate, success_interval (95 % Wilson), collisions,
    reached, stuck, timeout, refused, min_map_clearance_m, min_scene_clearance_m, mean_path_ratio
    (path over straight line, successful flights only).

    Attributes:
        schema: always "alula/run".
        version: of the kind.
        provenance: program, parameters and inputs.
        name: of the run.
        filter: name of the filter, or of the list of filters.
        vehicle: in words.
        trials: verdict on each flight, in their order.
        summary: numbers over all trials.
        guarantee: what holds for the flights.
        timing: measured times; null where nothing was measured.
    """

    schema: str
    version: str
    provenance: Provenance
    name: str
    filter: str
    vehicle: str
    trials: list[TrialResult]
    summary: dict[str, Any]
    guarantee: Guarantee
    timing: dict[str, Any] | None = None

    @classmethod
    def of(
        cls,
        provenance: Provenance,
        *,
        name: str,
        filter: str,
        vehicle: str,
        trials: list[TrialResult],
        summary: dict[str, Any],
        guarantee: Guarantee,
    ) -> Self:
        """Make the record of a run, without measured times.

        Args:
            provenance: that of the command; the record's also holds the summary.
            vehicle: in words.
        """
        return cls(
            schema=RUN_SCHEMA,
            version=RUN_VERSION,
            provenance=msgspec.structs.replace(provenance, summary=summary),
            name=name,
            filter=filter,
            vehicle=vehicle,
            trials=trials,
            summary=summary,
            guarantee=guarantee,
        )


def record_path(log: Path) -> Path:
    """Path of the record beside a log: R.run.json for R.run.mcap."""
    return log.with_suffix(".json")


def read_run(log: Path) -> RunRecord:
    """Read the record of a run from the log's metadata, and its timing from the file beside it.

    Raises:
        InputError: the log cannot be read.
        ArtifactError: it is not a run of alula's.
        DamagedError: truncated or corrupt.
    """
    with open_log(log) as file:
        raw = metadata(file, RUN_METADATA)
    if not raw or "record" not in raw[0]:
        raise ArtifactError(f"{log}: is an MCAP log, but not a run of alula's")
    try:
        record = decode_json(raw[0]["record"].encode(), RunRecord, most_values=MOST_RECORD_VALUES)
    except MalformedError as error:
        raise DamagedError(f"{log}: its summary is not valid ({error})") from error
    try:
        _check_record(record)
    except ValueError as error:
        raise DamagedError(f"{log}: its record is not valid ({error})") from error
    return msgspec.structs.replace(record, timing=_timing_beside(log))


def _check_record(record: RunRecord) -> None:
    """Check the values that readers of a record use.

    Raises:
        ValueError: a value is missing, of the wrong type or out of range.
    """
    contents.check(record.summary, RunSummary, "summary")
    if any(trial.fence is not None for trial in record.trials):
        if "worst_trial" not in record.summary:
            raise ValueError("`summary` has no `worst_trial`")
        contents.check(record.summary.get("fence"), FenceSummary, "summary.fence")
    contents.check(record.provenance.parameters, RunParameters, "parameters")
    if wild := contents.first_wild(msgspec.to_builtins(record.trials), "trials"):
        raise ValueError(f"`{wild}` is too large to be measured")


def _timing_beside(log: Path) -> dict[str, Any] | None:
    try:
        beside = record_path(log)
        check_no_stream(beside)
        timing = decode_json(beside.read_bytes(), RunRecord, most_values=MOST_RECORD_VALUES).timing
        contents.check(timing, contents.RunTiming, "timing")
        return timing
    except (OSError, InputError, ValueError):  # measured times of another format are none
        return None
