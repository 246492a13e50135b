"""Ticks of the geofence: recorded in simulated flights, replayed on emulated cores, compared with the host's.

A wall at 100 km/h, a fall from 70 m, random sticks, loss of radio and of navigation, a polytope with latency,
and the hulls of a map. In addition unrelated states anywhere in the fence, one after the other: the worst
case for the map data that a tick caches.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))  # fence_flights

import numpy as np
from cycles import cycles_per_instruction
from emulated import Flight, Replay, geofence_inputs, replay
from numpy.typing import NDArray

from alula import _core
from alula.schemas.artifacts.artifact import Artifact
from alula.stages.clearance import hull_obstacles
from alula.stages.compression.hulls import Hulls
from alula.stages.compression.onboard.layout import encode_map
from support.flights.fence_flights import fly_in

FloatArray = NDArray[np.float64]
WALL = ((-100.0, -100.0, 0.5), (40.0, 100.0, 100.0))
ROOM = ((-40.0, -40.0, 0.5), (40.0, 40.0, 60.0))
STARTS = ((-30.0, -30.0, 5.0), (30.0, 30.0, 50.0))
GROUND = ((-100.0, -100.0, 0.5), (100.0, 100.0, 200.0))
SLANTS = np.array([[x / 3, y / 3, 2 / 3, 35.0] for x in (-1, 1, -2, 2) for y in (-2, 2) if abs(x) == 1])
STATUSES = ("passed", "blended", "backup", "no-pilot", "hand-over", "refused")
DETAILS = ("lambda", "h_i", "distance_m", "margin_m", "v_towards")
NEVER = float("inf")
ANYWHERE = 150


@dataclass(frozen=True, slots=True)
class Scene:
    """A flight to be recorded.

    Attributes:
        start: a position to start from at rest, or a box of random safe states.
        stale: start and duration of a loss of navigation [s].
    """

    fence: _core.Fence
    pilot: _core.Pilot
    start: Any
    duration_s: float
    stale: tuple[float, float] = (NEVER, 0.0)
    parameters: dict[str, float] = field(default_factory=dict)
    speed_m_s: float = 15.0


@dataclass(frozen=True, slots=True)
class Answered:
    """Inputs of a replay, and the host's results, over all ticks.

    Attributes:
        status: shape (ticks,).
        values: command, lambda, h_I, distance, margin, v_c, shape (ticks, 9).
    """

    flights: list[Flight]
    status: NDArray[np.int64]
    values: NDArray[np.float32]


def scenes() -> list[Scene]:
    """Flights in boxes like the paper's."""
    plain, room = _core.Pilot("straight"), _core.Fence(box=ROOM)
    return [
        Scene(_core.Fence(box=WALL), plain, (0.0, 0.0, 50.0), 3.5),
        Scene(_core.Fence(box=GROUND), _core.Pilot("fall"), (0.0, 0.0, 70.0), 4.5),
        Scene(room, _core.Pilot("sticks"), STARTS, 1.5),
        Scene(room, _core.Pilot("aggressive"), STARTS, 1.5),
        Scene(room, _core.Pilot("silent", silent_after_s=0.5), STARTS, 1.5),
        Scene(_core.Fence(box=WALL), plain, (0.0, 0.0, 50.0), 1.8, stale=(1.0, 0.6)),
    ]


def polytope() -> list[Scene]:
    """A flight in a box cut by slanted faces, with latency."""
    return [
        Scene(
            _core.Fence(box=ROOM, faces=SLANTS),
            _core.Pilot("aggressive"),
            STARTS,
            1.5,
            parameters={"latency_s": 0.02, "radius_m": 0.15, "reserve_m": 0.5},
        ),
    ]


def scenes_in(cover: Artifact, image: bytes, half_m: FloatArray) -> list[Scene]:
    """Flights outside the hulls of a cover that extends by `half_m` to either side of 0."""
    box = (tuple((-half_m - 4.0).tolist()), tuple((half_m + 4.0).tolist()))
    fence = _core.Fence(box=box, image=image, keep_out=hull_obstacles(Hulls.from_cover(cover)))
    starts = (tuple((-half_m).tolist()), tuple(half_m.tolist()))
    return [
        Scene(fence, _core.Pilot(kind), starts, 1.0, parameters={"radius_m": 0.15}, speed_m_s=8.0)
        for kind in ("aggressive", "sticks", "straight")
    ]


def record(scene: Scene, seed: int) -> tuple[Flight, NDArray[np.int64], NDArray[np.float32]]:
    """Fly a scene on the host and record its ticks."""
    geofence = _core.Geofence(scene.fence, parameters=scene.parameters)
    is_place = np.ndim(scene.start) == 1
    (log,) = fly_in(
        geofence,
        start=np.r_[scene.start, 0, 0, 0, 1, np.zeros(6)].astype(float) if is_place else None,
        starts=None if is_place else scene.start,
        speed_m_s=scene.speed_m_s,
        pilot=scene.pilot,
        duration_s=scene.duration_s,
        losses=_core.Losses(from_s=scene.stale[0], for_s=scene.stale[1]),
        seed=seed,
        keeps_ticks=True,
        jobs=1,
    )
    time = np.arange(len(log["status"])) * float(np.float32(0.0025))
    states = log["racer"].astype(np.float32)
    states[(time >= scene.stale[0]) & (time < sum(scene.stale))] = np.nan
    flight = Flight(geofence.config_words, geofence.fence_words, states, log["sticks"].astype(np.float32))
    values = np.hstack([log["command"][:, 7:], log["figure"]]).astype(np.float32)
    return flight, log["status"].astype(np.int64), values


def anywhere(scene: Scene, seed: int) -> tuple[Flight, NDArray[np.int64], NDArray[np.float32]]:
    """Record unrelated states and sticks inside the fence, with the same geofence."""
    rng, (low, high) = np.random.default_rng(seed), np.array(scene.start)
    geofence = _core.Geofence(scene.fence, parameters=scene.parameters)
    places = rng.uniform(low, high, (20 * ANYWHERE, 3)).astype(np.float32).astype(float)
    inside = np.array([scene.fence.clearance(tuple(p), tuple(p)) > 0 for p in places.tolist()])
    assert inside.sum() >= ANYWHERE
    states = np.empty((ANYWHERE, 13), np.float32)
    states[:, :3] = places[inside][:ANYWHERE]
    way = rng.normal(size=(ANYWHERE, 3))
    states[:, 3:6] = (
        way / np.linalg.norm(way, axis=1)[:, None] * rng.uniform(0, scene.speed_m_s, (ANYWHERE, 1))
    )
    turn = rng.normal(size=(ANYWHERE, 4))
    states[:, 6:10] = turn / np.linalg.norm(turn, axis=1)[:, None]
    states[:, 10:] = rng.normal(scale=3, size=(ANYWHERE, 3))
    pilots = rng.uniform([0, -12, -12, -6], [1, 12, 12, 6], (ANYWHERE, 4)).astype(np.float32)
    status, values = [], []
    for x, pilot in zip(states.astype(float), pilots.astype(float), strict=True):
        u, name, detail = geofence.filter(x, pilot)
        status.append(STATUSES.index(name))
        values.append([*u, *(detail[key] for key in DETAILS)])
    flight = Flight(geofence.config_words, geofence.fence_words, states, pilots)
    return flight, np.array(status), np.array(values, np.float32)


def answered(flown: list[Scene], jumping: Scene) -> Answered:
    """Record the flights, and ticks anywhere in the fence of one of them."""
    parts = [record(scene, seed) for seed, scene in enumerate(flown)] + [anywhere(jumping, 1)]
    flights, status, values = zip(*parts, strict=True)
    return Answered(list(flights), np.concatenate(status), np.concatenate(values))


def mismatches(host: Answered, found: Replay) -> int:
    """Count the ticks that differ from the host's in a bit."""
    ticks = found.ticks
    values = np.column_stack([ticks["command"], *(ticks[name] for name in DETAILS)]).astype(np.float32)
    same = (host.values.view(np.uint32) == np.ascontiguousarray(values).view(np.uint32)).all(axis=1)
    return int((~(same & (host.status == ticks["status"]))).sum())


def traced(firmware: Path, work: Path, host: Answered, tick: int, image: bytes) -> float:
    """Maximum cycles per instruction of one tick, replayed after the tick before it."""
    starts = np.cumsum([0, *(len(flight.states) for flight in host.flights)])
    which = int(np.searchsorted(starts, tick, side="right")) - 1
    flight, at = host.flights[which], max(tick - int(starts[which]), 1)
    two = Flight(flight.config, flight.fence, flight.states[at - 1 : at + 1], flight.pilots[at - 1 : at + 1])
    inputs = geofence_inputs([two], has_map=bool(image))
    return cycles_per_instruction(firmware, work, "geofence", inputs, image)


def measure(firmware: Path, work: Path, cover: Artifact, half_m: FloatArray) -> dict[str, Any]:
    """Measure all ticks on the M4, the M7 and the host; figures by name."""
    found: dict[str, Any] = {"host_target_mismatches": 0, "ticks": 0}
    image = encode_map(cover, indexed=True)
    plain, cut, among = scenes(), polytope(), scenes_in(cover, image, half_m)
    for suffix, flown, jumping, raw in (
        ("", plain, plain[3], b""),
        ("_faces", cut, cut[0], b""),
        ("_map", among, among[0], image),
    ):
        host = answered(flown, jumping)
        inputs = geofence_inputs(host.flights, has_map=bool(raw))
        in_flight = np.arange(len(host.status)) < len(host.status) - ANYWHERE
        for core in ("m4", "m7", "host"):
            out = replay(firmware, work, core, "geofence", inputs, raw)
            found["host_target_mismatches"] += mismatches(host, out)
            found["ticks"] += len(out.ticks)
            name = f"{core}_geofence{suffix}"
            if core == "host":
                took = out.instructions / 1e3
                found[f"{name}_p50_us"] = float(np.median(took[in_flight]))
                found[f"{name}_p99_us"] = float(np.quantile(took[in_flight], 0.99))
                found[f"{name}_anywhere_p99_us"] = float(np.quantile(took[~in_flight], 0.99))
                continue
            found[f"{name}_instructions"] = int(out.instructions.max())
            found[f"{name}_flight_instructions"] = int(out.instructions[in_flight].max())
            found[f"{name}_median_instructions"] = int(np.median(out.instructions[in_flight]))
            stack = f"{core}_geofence_stack_bytes"
            found[stack] = max(out.stack_bytes, found.get(stack, 0))
            if core == "m4":
                worst = int(out.instructions[in_flight].argmax())
                found[f"{name}_cycles_per_instruction"] = traced(firmware, work, host, worst, raw)
    return found
