"""What a run says of itself: one record per flight, beside and inside the MCAP log."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, Literal

import msgspec

from alula.schemas.errors import AlulaError, ArtifactError, DamagedError, InputError
from alula.schemas.manifest import VERSION, Guarantee
from alula.schemas.provenance import RUN_METADATA, Provenance

RUN_SCHEMA = "alula/run"
RUN_VERSION = VERSION
RUN_SUFFIX = ".run.mcap"

FLIGHT_METADATA = "alula/flight"  # at the beginning of the log of a real flight: what is known before it

# "stopped": a real flight that ended before its goal, by landing or in the hands of the pilot.
Outcome = Literal["reached", "stuck", "timeout", "refused", "passed", "inside", "outside", "stopped"]


class ObstacleResult(msgspec.Struct, frozen=True, kw_only=True):
    """How a trial met one moving obstacle; None for what never was. Of the truth, not of what was tracked.

    `closest_m` is the least distance of the centres over the run, `separation_m` that from its warning until
    the vehicle has stopped hovering. Its warning is the first in which it is the most urgent;
    `closing_m_s` the closing speed then; `reaction_s` the simulated time from it until the command is not
    the nominal one, `avoid_s` from there to the end of hovering.
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
    """What a flight in a geofence was like; steps are ticks of its filter, None stands for what never was.

    Steps in which the pilot's command was passed, blended, replaced by the backup controller's, or there was
    no pilot, navigation was too old, or nothing could be done. An intervention begins where lambda falls
    below 1/2, after having been above 9/10. `altered_passes` and `out_of_range` are 0 of a filter that works:
    passed commands that are not the pilot's bits, and commands beyond the limits. `brake_distance_m` is the
    distance to the fence at the first intervention, `stop_distance_m` that when first slower than 0.5 m/s
    after it.
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


class TrialResult(msgspec.Struct, frozen=True, kw_only=True):
    """How one flight ended.

    Clearances are those of the vehicle's sphere, so negative means collision; they are computed
    after the flight, independently of the filter, over the continuous path. `map_clearance_m` is
    against the hulls of the cover, `scene_clearance_m` against the ellipsoids when a scene was given. Jerk
    is the second difference of the velocity at the rate of the filter.

    What follows `max_jerk_m_s3` is of flights among ellipsoids, and None for others: the peak of the
    reference's speed, the speed and largest acceleration of the body, how far at most it was from the
    reference, the largest difference between the acceleration and the one that was commanded, the
    least barrier of the filter, the least r' A r - 1 over all ellipsoids as the filter grew them (below 0
    inside one; at the rate of the filter), and steps in which the backup policy flew, in which a safe backup
    manoeuvre was proven to remain, in which the cap on the number of ellipsoids cut some off, and in which
    the rotors could not do what was asked; and what the clearance of the straight line from start to goal
    would be, whose sphere meets an ellipsoid where it is negative.

    What follows `line_clearance_m` is of encounters with moving obstacles, and None for others: each
    obstacle, steps in a manoeuvre or with a warning, steps that the filter refused, iterations of its
    projection, the largest violation of its rows as an acceleration, the sum over steps of the risk that
    flown rows left (None for filters without such rows), and the sum over windows of the risk of a collision.
    There "passed" says that all obstacles have receded, `map_clearance_m` is that of static walls, and a
    `collision` is one with either.

    `fence` is of flights in a geofence, and None for others. There `map_clearance_m` is the least distance
    to the fence, faces and hulls, `goal_m` is where the flight ended, and a `collision` says that it left.
    """

    index: int
    start_m: list[float]
    goal_m: list[float]
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


class RunRecord(msgspec.Struct, frozen=True, kw_only=True):
    """The whole of a run's summary; `timing` is measured and so differs from run to run.

    `summary` holds at least: trials, success_rate, success_interval (95 % Wilson), collisions,
    reached, stuck, timeout, refused, min_map_clearance_m, min_scene_clearance_m, mean_path_ratio
    (path over straight line, successful flights only).
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


def record_path(log: Path) -> Path:
    """Where the summary beside a log lies: R.run.mcap has R.run.json."""
    return log.with_suffix(".json")


@contextmanager
def open_log(log: Path) -> Iterator[BinaryIO]:
    """An MCAP log, opened; whatever its reader or its codecs raise in the block says that it is damaged.

    Raises:
        InputError: the log cannot be read.
        ArtifactError: it is not an MCAP log.
        DamagedError: truncated or corrupt.
    """
    if log.is_dir():
        raise InputError(f"{log}: is a folder, not a run")
    try:
        with log.open("rb") as file:
            magic = file.read(8)
            if not magic:
                raise ArtifactError(f"{log}: is empty")
            if magic != b"\x89MCAP0\r\n":
                raise ArtifactError(f"{log}: is not an MCAP log")
            file.seek(0)
            yield file
    except AlulaError:
        raise
    except OSError as error:
        if error.errno != errno.EINVAL:  # what a footer that points before the start leads to
            raise InputError(f"{log}: cannot read: {error.strerror or error}") from error
        raise DamagedError(f"{log}: truncated or corrupt MCAP log (its footer is wrong)") from error
    except Exception as error:
        what = str(error) or type(error).__name__
        raise DamagedError(f"{log}: truncated or corrupt MCAP log ({what})") from error


def read_run(log: Path) -> RunRecord:
    """The summary of a run, from the log's metadata; timing comes from the file beside it.

    Raises:
        InputError: the log cannot be read.
        ArtifactError: it is not a run of alula's.
        DamagedError: truncated or corrupt.
    """
    from mcap.reader import make_reader

    with open_log(log) as file:
        raw = [
            r.metadata
            for r in make_reader(file, validate_crcs=True).iter_metadata()
            if r.name == RUN_METADATA
        ]
    if not raw or "record" not in raw[0]:
        raise ArtifactError(f"{log}: is an MCAP log, but not a run of alula's")
    try:
        record = msgspec.json.decode(raw[0]["record"], type=RunRecord)
    except msgspec.MsgspecError as error:
        raise DamagedError(f"{log}: its summary is not valid ({error})") from error
    return msgspec.structs.replace(record, timing=_timing_beside(log))


def _timing_beside(log: Path) -> dict[str, Any] | None:
    try:
        return msgspec.json.decode(record_path(log).read_bytes(), type=RunRecord).timing
    except (OSError, msgspec.MsgspecError):
        return None
