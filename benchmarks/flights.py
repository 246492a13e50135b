"""Closed-loop flights among the ellipsoids of a room, and the time of a filter at each of their ticks."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from measure import FloatArray
from scenes import room

from alula import _core
from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.stages.compression.ellipsoids import retained, rows_of
from alula.stages.compression.voxelize import sigma_of_confidence
from alula.stages.filtering.bridge import NativeFilter
from alula.stages.filtering.protocol import FilterWorld
from alula.stages.filtering.registry import make_filter
from alula.stages.planning.rest_to_rest import rest_to_rest
from alula.stages.simulation.pairs import central_box, sample_pairs
from alula.stages.vehicles.bodies import plant_options, quadrotor, tracking_gains

CONFIDENCE, RADIUS_M, SPEED_M_S, DT_S = 0.99, 0.12, 3.1, 0.01
_MARGIN_M, _SEPARATION = 0.05, 0.3  # of starts and goals, as in `simulate`
_ROOM_M = 20.0
_STOP_FRACTION, _STOP_FLOOR_M, _TIME_FACTOR = 0.01, 0.05, 3.0  # of the ends of flights, as in `simulate`

Flown = dict[str, Any]  # native log

# Name of the figures, filter, parameters that are not the default.
FLOWN: tuple[tuple[str, str, Mapping[str, Any]], ...] = (
    ("cone_di", "cone-di", {}),
    ("cone_ecbf", "cone-ecbf", {}),
    ("cone_backup", "cone-backup", {}),
    ("cone_backup_hover", "cone-backup", {"policy": "hover"}),
    ("safer_splat", "safer-splat", {}),
    ("safer_splat_gated", "safer-splat", {"rows": "nearest"}),
    # The gate and the number of rows of cone-ecbf, for the time alone: too short for this barrier.
    (
        "safer_splat_same_gate",
        "safer-splat",
        {"rows": "nearest", "reaction_time_s": 0.6, "floor_m": 0.5, "count": 32},
    ),
)


@dataclass(frozen=True, slots=True)
class Arena:
    """A furnished room, the vehicle in it and the pairs to fly, as `simulate` sets them up.

    Attributes:
        splats: number of Gaussians.
        scene_s, index_s: time to make the Gaussians and the index [s].
    """

    splats: int
    scene_s: float
    index_s: float
    world: FilterWorld
    spec: _core.SimulationSpec
    tasks: list[_core.Task]

    def filter(self, name: str, parameters: Mapping[str, Any]) -> NativeFilter:
        """Make a filter for this room."""
        made = make_filter(name, self.world, parameters)
        assert isinstance(made, NativeFilter)
        return made

    def fly(self, safety_filter: NativeFilter, pairs: int | None = None) -> list[Flown]:
        """Fly all pairs, or the first `pairs`, on one thread."""
        return _core.simulate(self.spec, self.tasks[:pairs], [safety_filter.native], jobs=1)


def arena(gaussians: int, pairs: int, seed: int) -> Arena:
    """Make the built-in room with about `gaussians` Gaussians at confidence 0.99, and straight septics."""
    start = time.perf_counter()
    scene = room(gaussians)
    made = time.perf_counter()
    keep = RADIUS_M + scene.manifest.suggested_inflation_m  # type: ignore[attr-defined]
    rows = rows_of(scene, retained(scene, 0.0))
    before = time.perf_counter()
    index = _core.EllipsoidIndex(
        *(rows.mean, rows.scale, rows.quat_wxyz),
        sigma=sigma_of_confidence(CONFIDENCE),
        radius=keep,
        loss=rows.loss,
    )
    built = time.perf_counter()
    mean = np.asarray(scene["mean"], np.float64)
    lower, upper = central_box(mean, None, "Gaussians")
    drawn = sample_pairs(
        pairs,
        seed,
        (lower, upper),
        _SEPARATION * float(np.linalg.norm(upper - lower)),
        lambda points: index.clearance(points, cap=keep + _MARGIN_M, jobs=1),
        lambda _, distance: np.asarray(distance >= keep + _MARGIN_M),
    )
    body, gains = quadrotor(FASTBRIDGE), tracking_gains(FASTBRIDGE)
    return Arena(
        splats=len(mean),
        scene_s=made - start,
        index_s=built - before,
        world=FilterWorld(index=index, body=body, gains=gains, radius_m=keep, dt_s=DT_S),
        spec=_core.SimulationSpec(
            _core.VehicleSpec(body, gains=gains, plant=plant_options(FASTBRIDGE)),
            options=_core.FlightOptions(dt_s=DT_S),
            rules=_core.SimulationRules(
                lower=tuple((mean.min(axis=0) - _ROOM_M).tolist()),
                upper=tuple((mean.max(axis=0) + _ROOM_M).tolist()),
            ),
        ),
        tasks=[_task(start, goal) for start, goal in zip(drawn.start, drawn.goal, strict=True)],
    )


def _task(start: FloatArray, goal: FloatArray) -> _core.Task:
    """A straight septic from rest to rest."""
    yaw = math.atan2(goal[1] - start[1], goal[0] - start[0])
    curve = _core.ReferenceCurve(*rest_to_rest(start, goal, SPEED_M_S, yaw_rad=yaw))
    state = np.zeros(12)
    state[:3], state[5] = start, math.tan(yaw / 4)
    return _core.Task(
        state,
        _core.Mission.along(curve),
        max_time_s=_TIME_FACTOR * curve.duration_s,
        stop_distance_m=max(_STOP_FRACTION * math.dist(start, goal), _STOP_FLOOR_M),
    )


@dataclass(slots=True)
class Timed:
    """The repeated flights of one filter, and the times of all ticks, shape (repeats, ticks) [s]."""

    flights: list[Flown]
    filter_s: FloatArray
    tick_s: FloatArray
    differs: bool = False  # whether a repetition differed, which must not happen

    def figures(self, name: str) -> dict[str, float]:
        """Percentiles [us] over all repetitions, and `best`: over the minimum of each tick."""
        found: dict[str, float] = {
            f"{name}_flights": len(self.flights),
            f"{name}_reached": sum(flown["end"] == "reached" for flown in self.flights),
            f"{name}_ticks": self.filter_s.shape[1],
        }
        for kind, seconds in ((name, self.filter_s), (f"{name}_tick", self.tick_s)):
            for suffix, values in (("", seconds.ravel()), ("_best", seconds.min(axis=0))):
                p50, p99, maximum = 1e6 * np.percentile(values, [50, 99, 100])
                found |= {f"{kind}_p50{suffix}_us": p50, f"{kind}_p99{suffix}_us": p99}
                found[f"{kind}_max{suffix}_us"] = maximum
        return found


def fly_all(room: Arena, repeats: int) -> dict[str, Timed]:
    """Fly all filters in turns, so that other programs affect them alike, after one warm-up flight each."""
    filters = {name: room.filter(kind, parameters) for name, kind, parameters in FLOWN}
    for safety_filter in filters.values():
        room.fly(safety_filter, 1)
    found: dict[str, Timed] = {}
    for _ in range(repeats):
        for name, safety_filter in filters.items():
            flights = room.fly(safety_filter)
            seconds = [np.concatenate([f[part].ravel() for f in flights]) for part in ("filter_s", "tick_s")]
            if name not in found:
                found[name] = Timed(flights, *(part[None] for part in seconds))
                continue
            timed = found[name]
            if not all(map(_is_same, timed.flights, flights)):
                timed.differs = True
                continue
            timed.filter_s = np.vstack([timed.filter_s, seconds[0]])
            timed.tick_s = np.vstack([timed.tick_s, seconds[1]])
    return found


def _is_same(a: Flown, b: Flown) -> bool:
    names = ("end", "path", "state", "command", "nominal", "margin", "status", "flags", "rows", "iterations")
    return all(np.array_equal(a[name], b[name]) for name in names)


@dataclass(frozen=True, slots=True)
class Replay:
    """Ticks of flights behind an acceleration filter: its state and nominal acceleration."""

    state: FloatArray
    acceleration: FloatArray

    @classmethod
    def of(cls, flights: Sequence[Flown]) -> Replay:
        """Collect all ticks of some flights."""
        return cls(
            np.concatenate([flown["state"][:-1] for flown in flights]),
            np.concatenate([flown["nominal"] for flown in flights]),
        )

    def spread(self, count: int, seed: int) -> Replay:
        """Draw `count` ticks at random, without repetition."""
        rng = np.random.default_rng([seed, 2])
        rows = rng.permutation(len(self.state))[:count]
        return Replay(self.state[rows], self.acceleration[rows])

    def __len__(self) -> int:
        return len(self.state)

    def through(
        self, native: _core.SafetyFilter, *, seconds: float = math.inf, minimum: int = 0
    ) -> tuple[list[dict[str, Any]], FloatArray]:
        """Reports and CPU seconds of at least `minimum` ticks, and of as many more as fit the time.

        CPU time of the thread, because a busy machine interrupts any tick longer than a time slice.
        """
        reports, took = [], []
        end = time.perf_counter() + seconds
        for state, acceleration in zip(self.state.tolist(), self.acceleration.tolist(), strict=True):
            if time.perf_counter() > end and len(took) >= minimum:
                break
            before = time.thread_time()
            reports.append(native.filter(state, acceleration))
            took.append(time.thread_time() - before)
        return reports, np.array(took)
