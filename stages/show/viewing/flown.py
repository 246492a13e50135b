"""Flown paths of runs by outcome and by run, contacts, and the flights to play."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula._core import EllipsoidSet, PolytopeSet
from alula.schemas.arrays import FloatArray
from alula.schemas.log.flights import Flight
from alula.schemas.log.run import TrialResult
from alula.stages.reporting.curves import encounter_clearance, paths_of
from alula.stages.reporting.material import NOT_JUDGED, OUTCOMES, Run, outcome_of
from alula.stages.reporting.palette import COLORS, run_color
from alula.stages.show.drawing.content import Body, Lines, Part, Play, Series, rgb, segments_of, tree_name
from alula.stages.show.viewing.active import ROUTINE, Numbered, deciding
from alula.stages.show.viewing.nearest import closest, to_balls, to_faces, to_obstacles
from alula.stages.show.viewing.shapes import UPRIGHT_WXYZ, balls
from alula.stages.vehicles.fence import fence_faces
from alula.stages.verdict import clearance_of

PLAY_HZ = 20.0
MOST_PLAYED_S = 120.0
_CONTACT = (215, 48, 31)
_RADIUS_M = 0.15  # of a vehicle whose size is not recorded
_LARGEST_M = 1e12
_MOST_ROWS = 5000  # of a flight that is played
_WORDS = {
    "reached": "reached its goal",
    "passed": "passed",
    "held": "flew for the whole time",
    "stuck": "got stuck",
    "timeout": "ran out of time",
    "refused": "was refused",
    "stopped": "was stopped",
    "missed-via": "missed a point to pass",
    "off-plan": "left its plan",
    "collision": "hit an obstacle",
    NOT_JUDGED: "was not judged",
}


def path_parts(runs: Sequence[Run]) -> list[Part]:
    """Flown paths coloured by outcome, their ends, and with several runs also paths coloured by run."""
    each = [[path for path in paths_of(run) if len(path.position_world) > 1] for run in runs]
    paths = [path for some in each for path in some]
    if not paths:
        return []
    parts: list[Part] = []
    size = max(float(np.ptp(path.position_world, axis=0).max()) for path in paths)
    for outcome in (*OUTCOMES, NOT_JUDGED):
        own = [path.position_world for path in paths if path.outcome == outcome]
        if not own:
            continue
        name, color = f"Flights/{outcome} ({len(own)})", rgb(COLORS[outcome])
        width = 3.0 if len(paths) <= 10 or outcome == "collision" else 1.5
        lines = np.concatenate([segments_of(points) for points in own])
        parts.append(Lines(name=f"{name}/paths", segments=lines, color=color, width_px=width))
        ends = np.array([points[-1] for points in own])
        parts.append(balls(f"{name}/ends", ends, max(0.02, size / 250), color))
    if len(runs) > 1:
        for k, (run, some) in enumerate(zip(runs, each, strict=True)):
            if some:
                lines = np.concatenate([segments_of(path.position_world) for path in some])
                name = f"Flights by run/{tree_name(run.label)}"
                parts.append(
                    Lines(name=name, segments=lines, color=rgb(run_color(k)), width_px=2.0, visible=False)
                )
    contacts = [place for run in runs if (place := _contacts(run)) is not None]
    if contacts:
        parts.append(balls("Contacts", np.concatenate(contacts), max(0.04, size / 120), _CONTACT))
    return parts


def _contacts(run: Run) -> FloatArray | None:
    """Positions of the vehicles that hit something, at their minimum margin; None without any."""
    found = []
    for trial in run.record.trials:
        flight = run.flights.get(trial.index)
        if flight is None or outcome_of(trial) != "collision" or not len(flight.time_s):
            continue
        found.append(flight.position_world[_worst_row(flight)])
    return np.array(found) if found else None


def _worst_row(flight: Flight) -> int:
    """Row of the states at the minimum margin, or the last one where no margin is known."""
    if not np.isfinite(flight.margin).any():
        return len(flight.time_s) - 1
    time = flight.margin_time_s[int(np.nanargmin(flight.margin))]
    return int(np.abs(flight.time_s - time).argmin())


def body_of(run: Run) -> Body:
    """Size of a run's vehicle by its recorded parameters; a radius of 0.15 m where there is none."""
    try:
        return _body(_vehicle_table(run))
    except (TypeError, ValueError, AttributeError, IndexError):
        return Body(radius_m=_RADIUS_M)


def _body(table: Any) -> Body:
    inner: Any = table.get("body") if isinstance(table.get("body"), Mapping) else table
    radius = float(inner.get("radius_m", table.get("radius_m", _RADIUS_M)))
    rotors = (
        (table.get("rotors") or {}).get("positions_m") if isinstance(table.get("rotors"), Mapping) else None
    )
    places = np.empty((0, 3))
    if rotors:
        places = np.column_stack([np.asarray(rotors, np.float64)[:, :2], np.zeros(len(rotors))])
    if not (0 < radius < _LARGEST_M and np.isfinite(places).all()):
        raise ValueError("a vehicle has a size")
    return Body(radius_m=radius, rotors_m=places)


def limits_of(run: Run) -> dict[str, float]:
    """Limits of the inputs that a run's parameters record, by the quantity of `Commands`."""
    table: Any = _vehicle_table(run)
    limits = table.get("limits") if isinstance(table.get("limits"), Mapping) else table
    found = {
        "velocity [m/s]": limits.get("max_speed_m_s", table.get("v_max_m_s")),
        "acceleration [m/s²]": limits.get("max_acceleration_m_s2", table.get("a_max_m_s2")),
    }
    return {key: float(value) for key, value in found.items() if isinstance(value, int | float)}


def _vehicle_table(run: Run) -> Mapping[str, Any]:
    parameters = run.record.provenance.parameters
    world = parameters.get("world")
    for table in (parameters.get("vehicle"), world.get("vehicle") if isinstance(world, Mapping) else None):
        if isinstance(table, Mapping):
            return table
    return {}


def faces_of(run: Run) -> FloatArray:
    """Faces of a run's fence by its recorded parameters, shape (L, 4); none without one."""
    parameters: Any = run.record.provenance.parameters
    world = parameters.get("world", parameters)
    table = world.get("fence") if isinstance(world, Mapping) else None
    none = np.empty((0, 4))
    try:
        if isinstance(table, list) and len(table) == 6:
            faces = fence_faces(table, ())
        elif isinstance(table, Mapping):
            faces = fence_faces(table.get("box_m"), table.get("faces") or ())
        else:
            return none
    except (TypeError, ValueError, IndexError):
        return none
    return faces if np.isfinite(faces).all() and np.abs(faces).max(initial=0) < _LARGEST_M else none


def worst_first(runs: Sequence[Run]) -> list[tuple[int, int]]:
    """Logged flights as (run, trial), by outcome and then by clearance, the worst first."""
    order: list[tuple[int, float, int, int]] = []
    for number, run in enumerate(runs):
        ends = {trial.index: trial for trial in run.record.trials}
        for index in run.flights:
            trial = ends.get(index)
            rank = len(OUTCOMES) if trial is None else OUTCOMES.index(outcome_of(trial))
            clearance = None if trial is None else _clearance(run, trial)
            order.append((-rank, np.inf if clearance is None else clearance, number, index))
    return [(number, index) for _, _, number, index in sorted(order)]


def _clearance(run: Run, trial: TrialResult) -> float | None:
    return encounter_clearance(run, trial) if trial.obstacles else clearance_of(trial)


def words_of(run: Run, index: int) -> tuple[str, str]:
    """Outcome of a logged flight, and its end in words."""
    trial = next((one for one in run.record.trials if one.index == index), None)
    if trial is None:
        return NOT_JUDGED, _WORDS[NOT_JUDGED]
    outcome = outcome_of(trial)
    joint = "of" if outcome == "held" else "after"
    words = f"{_WORDS.get(outcome, outcome)} {joint} {trial.duration_s:.1f} s"
    clearance = _clearance(run, trial)
    if clearance is None or not np.isfinite(clearance):
        return outcome, words
    if clearance < 0:
        return outcome, f"{words}, overlapping by {length_words(-clearance)}"
    return outcome, f"{words}, closest {length_words(clearance)}"


def length_words(length_m: float) -> str:
    """A length as a person reads it: centimetres below a metre."""
    return f"{100 * length_m:.1f} cm" if abs(length_m) < 1 else f"{length_m:.2f} m"


def play_of(
    run: Run,
    index: int,
    obstacles: Mapping[str, PolytopeSet | EllipsoidSet],
    several: bool,
    among: Numbered | None = None,
) -> Play:
    """Make a logged flight ready to be played.

    Args:
        obstacles: search trees of the parts of the world that it flew in, by name.
        several: there are several runs, so the label names this one.
        among: obstacles by the numbers in the log; None where they are not known.
    """
    flight = run.flights[index]
    row = _rows(flight.time_s)
    time = flight.time_s[row] - flight.time_s[row[0]]
    position = flight.position_world[row]
    turn = flight.quat_world_body_wxyz
    body = body_of(run)
    parts = {name: to_obstacles(position, each) for name, each in obstacles.items()}
    moving, track, radius = np.empty((len(row), 0, 3)), np.empty((len(row), 0, 3)), np.empty(0)
    if flight.moving is not None:
        moving, track = flight.moving.position_world[row], flight.moving.track_world[row]
        radius = flight.moving.radius_m
        parts["moving obstacles"] = to_balls(position, moving, radius)
    if len(faces := faces_of(run)):
        parts["fence"] = to_faces(position, faces)
    answer, status = _answers(flight, row)
    outcome, words = words_of(run, index)
    distances = {name: distance - body.radius_m for name, (distance, _) in parts.items()}
    own = np.min(list(distances.values()), axis=0) if distances else np.full(len(row), np.nan)
    worst = int(np.nanargmin(own)) if np.isfinite(own).any() else 0
    return Play(
        label=f"{run.label}, flight {index}" if several else f"flight {index}",
        outcome=outcome,
        words=words,
        run=run.label,
        trial=index,
        begin_s=float(flight.time_s[row[0]]),
        time_s=time,
        position_world=position,
        quat_world_body_wxyz=np.tile(UPRIGHT_WXYZ, (len(row), 1)) if turn is None else turn[row],
        body=body,
        obstacles_world=moving,
        tracks_world=track,
        obstacle_radius_m=radius,
        nearest_world=closest(list(parts.values()), len(row)),
        acts=_acts(flight, answer, len(row)),
        status=status,
        series=_series(flight, row, time, distances, answer, limits_of(run)),
        marked_s=float(time[worst]),
        decides=() if among is None else deciding(flight, run.record.filter, answer, among),
        plans=_new_plans(run, flight.time_s[row[0]], float(time[-1])),
    )


def _new_plans(run: Run, begin_s: float, end_s: float) -> tuple[tuple[float, FloatArray], ...]:
    """New plans of a real flight, by the time from which it follows them."""
    plans = [] if run.course is None else run.course.plans
    each = ((one.time_s - begin_s, one.position_world) for one in plans)
    return tuple((time, points) for time, points in each if 0 <= time <= end_s and len(points) > 1)


def _rows(time_s: FloatArray) -> Any:
    """Rows of samples about every 1 / PLAY_HZ s, at most `_MOST_ROWS`, with the first and the last."""
    _, rows = np.unique(np.floor((time_s - time_s[0]) * PLAY_HZ), return_index=True)
    if len(rows) > _MOST_ROWS:
        rows = rows[np.linspace(0, len(rows) - 1, _MOST_ROWS).round().astype(np.int64)]
    return np.unique(np.concatenate([rows, [0, len(time_s) - 1]]))


def _answers(flight: Flight, row: Any) -> tuple[Any, tuple[str, ...]]:
    """Rows of the filter's answers at the times of some states, and its statuses there."""
    if not len(flight.margin_time_s):
        return None, ("",) * len(row)
    at = np.clip(np.searchsorted(flight.margin_time_s, flight.time_s[row], "right") - 1, 0, None)
    if flight.each_status:
        lists = [[f"{name} {word}" for word in words] for name, words in flight.each_status.items()]
        return at, tuple(", ".join(words[i] for words in lists).lower() for i in at)
    return at, tuple(flight.status[i].lower() for i in at)


def _acts(flight: Flight, answer: Any, count: int) -> NDArray[np.bool_]:
    """Whether one of the filters changes the command, at the times of some states."""
    lists = list(flight.each_status.values()) or [flight.status]
    if answer is None:
        return np.zeros(count, np.bool_)
    found: NDArray[np.bool_] = np.any(
        [[words[i].lower() not in ROUTINE for i in answer] for words in lists], axis=0
    )
    return found


def _series(
    flight: Flight,
    row: Any,
    time: FloatArray,
    distances: Mapping[str, FloatArray],
    answer: Any,
    limits: Mapping[str, float],
) -> tuple[Series, ...]:
    found = [Series(label="speed", plot="speed [m/s]", time_s=time, value=flight.speed_m_s[row])]
    if distances:
        for name, value in distances.items():
            shown = np.where(np.isfinite(value), value, np.nan)
            found.append(Series(label=name, plot="clearance [m]", time_s=time, value=shown, limit=0.0))
    elif answer is not None and np.isfinite(flight.margin).any():
        plot = f"margin [{flight.margin_unit}]"
        found.append(Series(label="margin", plot=plot, time_s=time, value=flight.margin[answer], limit=0.0))
    if flight.commands is not None and answer is not None:
        for label, each in (("nominal", flight.commands.nominal), ("sent", flight.commands.filtered)):
            value = np.linalg.norm(each[answer], axis=1)
            plot, limit = f"command: {flight.commands.quantity}", limits.get(flight.commands.quantity)
            found.append(Series(label=label, plot=plot, time_s=time, value=value, limit=limit))
    if flight.regulation is not None and answer is not None:
        found.append(Series(label="λ", plot="pilot's share λ", time_s=time, value=flight.regulation[answer]))
    return tuple(found)
