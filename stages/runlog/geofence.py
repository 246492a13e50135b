"""What a log says of a flight in a geofence: where it was, what was wished and flown, how far from it."""

from __future__ import annotations

from typing import Any, BinaryIO, Self

import msgspec
import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.run import RunRecord, TrialResult
from alula.stages.runlog.ellipsoids import number, xyz
from alula.stages.runlog.fence_shell import fence_entities
from alula.stages.runlog.writer import GAP_S, LogWriter, log_message, logged_ticks, path_message, stamp
from alula.stages.simulation.geofence.world import FlownWorld

CHANNELS = {
    "/map": "foxglove.SceneUpdate",
    "/path": "foxglove.PosesInFrame",
    "/pose": "foxglove.PoseInFrame",
    "/state": "alula.State",
    "/safety": "alula.Safety",
    "/log": "foxglove.Log",
}
STATUSES = ("passed", "blended", "backup", "no-pilot", "hand-over", "refused")  # alula_geofence_status
_COLUMNS = {"state": 13, "pilot": 4, "command": 4, "figure": 5}


class FenceFlight(msgspec.Struct, frozen=True, kw_only=True):
    """One flight at the log's rate: T rows of numbers, as bytes so that a journal can hold them.

    `state` has position, velocity, attitude wxyz and rates, shape (T, 13); `pilot` and `command` throttle and
    rates, shape (T, 4), NaN without a pilot; `figure` lambda, h_I, the filter's distance, its margin and
    speed towards the fence, shape (T, 5); `distance` the least true one since the sample before, shape (T,);
    `status` a byte for each.
    """

    trial: int
    tick: bytes
    state: bytes
    pilot: bytes
    command: bytes
    figure: bytes
    distance: bytes
    status: bytes

    @classmethod
    def of(cls, trial: int, flown: dict[str, Any], tick_s: float, rate_hz: float) -> Self:
        """Every so many ticks as the rate says, and the last one."""
        sample = logged_ticks(len(flown["status"]) - 1, tick_s, rate_hz)
        least = flown["distance"][sample]
        least[1:] = np.minimum(least[1:], np.minimum.reduceat(flown["distance"], sample)[:-1])
        rows = {name: flown[name][sample].tobytes() for name in (*_COLUMNS, "status")}
        return cls(trial=trial, tick=sample.tobytes(), distance=least.tobytes(), **rows)

    def rows(self, name: str) -> FloatArray:
        """Of state, pilot, command or figure, shape (T, columns); of the distance, shape (T,)."""
        flat: FloatArray = np.frombuffer(getattr(self, name), np.float64)
        return flat.reshape(len(self.status), _COLUMNS[name]) if name in _COLUMNS else flat

    def time_s(self, tick_s: float) -> FloatArray:
        """When the samples are, shape (T,) [s]."""
        return np.frombuffer(self.tick, np.int64).astype(np.float64) * tick_s


def write_fence_log(
    stream: BinaryIO,
    record: RunRecord,
    flights: list[FenceFlight],
    world: FlownWorld,
    frame: str,
    *,
    tick_s: float,
) -> None:
    """Write a log of the flights that are shown; equal arguments give equal bytes.

    Channels as `write_log` writes them of a rigid body. In `/safety` the margin is the true distance to the
    fence less the vehicle's radius, h_m the filter's h_I, and lambda the pilot's share.

    Args:
        stream: where to write; the caller makes the file appear.
        record: the summary, of all trials.
        flights: some of them.
        world: the fence that is drawn.
        frame: name of the frame of all positions.
        tick_s: between two calls of the filter.
    """
    log = LogWriter(stream, CHANNELS)
    paths = [flight.rows("state")[:, :3] for flight in flights]
    log.send("/map", 0.0, {"deletions": [], "entities": fence_entities(world, paths, frame)})
    begin_s = 0.0
    for flight in flights:
        time, state, distance = flight.time_s(tick_s), flight.rows("state"), flight.rows("distance")
        pilot, command, figure = flight.rows("pilot"), flight.rows("command"), flight.rows("figure")
        log.send("/path", begin_s, path_message(state[:, :3], frame, begin_s))
        for i in range(len(time)):
            now_s = begin_s + float(time[i])
            common = {"trial": flight.trial, "time_s": round(float(time[i]), 9)}
            moved = _moved(state[i])
            pose = {"position": moved["position_m"], "orientation": moved["attitude"]}
            log.send("/pose", now_s, {"timestamp": stamp(now_s), "frame_id": frame, "pose": pose})
            log.send("/state", now_s, common | moved)
            answer = _answer(flight.status[i], float(distance[i]), figure[i], pilot[i], command[i])
            log.send("/safety", now_s, common | answer)
        begin_s += float(time[-1])
        log.send("/log", begin_s, log_message(_words(record.trials[flight.trial]), begin_s))
        begin_s += GAP_S
    log.finish(record)


def _moved(row: FloatArray) -> dict[str, Any]:
    w, x, y, z = (number(value) for value in row[6:10])
    return {
        "position_m": xyz(row[:3]),
        "velocity_m_s": xyz(row[3:6]),
        "attitude": {"x": x, "y": y, "z": z, "w": w},
        "omega_body_rad_s": xyz(row[10:13]),
    }


def _answer(
    status: int, distance_m: float, figure: FloatArray, pilot: FloatArray, command: FloatArray
) -> dict[str, Any]:
    share, h_i, _, margin, towards = figure
    said: dict[str, Any] = {
        "margin": number(distance_m),
        "margin_unit": "m",
        "status": status,
        "status_name": STATUSES[status],
        "lambda": number(share),
        "throttle_safe": number(command[0]),
        "rates_safe_rad_s": xyz(command[1:]),
    }
    if np.isfinite(pilot).all():
        said |= {"throttle_nom": number(pilot[0]), "rates_nom_rad_s": xyz(pilot[1:])}
    if abs(h_i) < 1e30:  # the largest float stands for one that was not evaluated
        said |= {"h_m": number(h_i), "allowance_m": number(margin), "towards_m_s": number(towards)}
    return said


def _words(trial: TrialResult) -> tuple[str, bool, bool]:
    words = f"trial {trial.index}: {trial.outcome} for {trial.duration_s:.2f} s"
    if trial.map_clearance_m is not None:
        words += f", least distance to the fence {trial.map_clearance_m:.4f} m"
    if trial.fence is not None:
        words += f", {trial.fence.interventions} interventions"
    return words, not trial.collision, trial.collision
