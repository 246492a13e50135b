"""Ticks of the stack of all filters: flights among hulls and thrown balls in a fence, on emulated cores.

Beside them unrelated states anywhere, with any attitude: the worst case for what a tick caches.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from cycles import cycles_per_instruction
from emulated import Replay, replay, single
from numpy.typing import NDArray

from alula import _core

FloatArray = NDArray[np.float64]
FLIGHTS, TICKS, ANYWHERE, BALL_EVERY = 6, 250, 250, 80
DT_S = 0.01
RADIUS_M = 0.1
SPREAD = np.diag([1e-4, 1e-4, 1e-4, 1e-2, 1e-2, 1e-2])[np.tril_indices(6)]
HULLS = {"radius_m": 0.2, "beta": 0.6, "kappa": 50.0, "dt_s": DT_S, "v_max": 1.5}
MOVING = {
    "radius_m": RADIUS_M,
    "a_max": 6.0,
    "latency_s": 0.08,
    "clearance_m": 0.5,
    "wall_room_m": 0.1,
    "v_max": 4.0,
}
FENCE = {"radius_m": RADIUS_M, "reserve_m": 0.05, "tick_s": DT_S}
VALUES = ("velocity", "acceleration", "sticks")
DETAILS = ("walls", "walls_are_full", "mode", "rows", "margin_m", "h_i", "regulation")


@dataclass(frozen=True, slots=True)
class Recorded:
    """Ticks of a stack and the host's results.

    Attributes:
        head: the configuration, as the inputs of the replay begin.
        rows: inputs of each tick.
        status: shape (ticks,).
        parts: status of each part, shape (ticks, 3).
        values: velocity, acceleration, sticks, and `DETAILS`, shape (ticks, 17).
        in_flight: false for unrelated states, shape (ticks,).
    """

    head: bytes
    rows: list[bytes]
    status: NDArray[np.int64]
    parts: NDArray[np.int64]
    values: NDArray[np.float32]
    in_flight: NDArray[np.bool_]

    def inputs(self, begin: int = 0, end: int | None = None) -> bytes:
        """Inputs of the replay for the ticks from `begin` to `end`."""
        chosen = self.rows[begin:end]
        return self.head + struct.pack("<I", len(chosen)) + b"".join(chosen)


def rounded_up(value: float) -> np.float32:
    """Round to single precision, up."""
    near = np.float32(value)
    return near if float(near) >= value else np.nextafter(near, np.float32(np.inf))


def thrown(rng: np.random.Generator, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return position and velocity of a ball that starts 4 m away and is thrown at the vehicle."""
    way = rng.normal(size=3) * [1, 1, 0.3]
    way *= 4.0 / np.linalg.norm(way)
    time = 4.0 / rng.uniform(3, 6)
    return x[:3] + way, (0.5 * time * x[3:6] - way) / time


def track(ball: tuple[FloatArray, FloatArray], number: int) -> FloatArray:
    """Return a row of tracks, in single precision."""
    row = np.concatenate([[number], *ball, SPREAD, [0.12]])
    return row.astype(np.float32).astype(float)[None]


def record(image: bytes, half_m: FloatArray, seed: int = 1) -> Recorded:
    """Fly through the hulls of a map that extends by `half_m` to either side of 0, and anywhere in it."""
    extent = float(half_m.max()) + 4.0
    fence = _core.Fence(box=(tuple((-half_m - 1.0).tolist()), tuple((half_m + 1.0).tolist())))
    geofence = _core.Geofence(fence, parameters=FENCE)
    stack = _core.OnboardStack(
        "velocity",
        "sticks",
        image=image,
        extent_m=extent,
        polytope_cbf=_core.PolytopeCbfConfig(**HULLS),
        dr_acbf=MOVING,
        geofence=geofence,
    )
    probe = _core.PolytopeCbf.from_image(image, extent_m=extent, **HULLS)
    rng, plant = np.random.default_rng(seed), _core.Racer(_core.RacerModel())
    rows, results, in_flight = [], [], []

    def place() -> FloatArray:
        p = rng.uniform(-half_m, half_m)
        while probe.psi(p[None])[1][0] < HULLS["radius_m"] + 0.1:
            p = rng.uniform(-half_m, half_m)
        return p

    def tick(x: FloatArray, nominal: FloatArray, balls: list[FloatArray], *, flying: bool) -> Any:
        at, u = np.array(single(x)), np.array(single(nominal))
        tracks = np.concatenate([np.empty((0, 29)), *balls])
        result = stack.filter(at, u, tracks, np.empty((0, 4)))
        head = struct.pack("<13f6fI3ff4f2I", *at, *[0.0] * 6, 0, *u, 0.0, *[0.0] * 4, len(tracks), 0)
        tail = b"".join(struct.pack("<I31f", int(r[0]), *r[1:28], r[28], 0, 0, 0) for r in tracks)
        rows.append(head + tail)
        results.append(result)
        in_flight.append(flying)
        return result

    for _ in range(FLIGHTS):
        x = np.r_[place(), 0, 0, 0, 1, np.zeros(6)]
        plant.reset(x)
        goal, balls = place(), []
        for step in range(TICKS):
            x = plant.state
            to_goal = goal - x[:3]
            if step % BALL_EVERY == BALL_EVERY // 2:
                balls = [*balls[-1:], (len(rows), thrown(rng, x), step)]
            seen = [track((p + (step - begin) * DT_S * v, v), number) for number, (p, v), begin in balls]
            nominal = 1.5 * to_goal / max(float(np.linalg.norm(to_goal)), 1.5)
            plant_command = tick(x, nominal, seen, flying=True).sticks
            for _ in range(5):
                plant.step(DT_S / 5, plant_command)
    for number in range(ANYWHERE):
        turn = rng.normal(size=4)
        x = np.r_[
            rng.uniform(-half_m, half_m),
            rng.uniform(-3, 3, 3),
            turn / np.linalg.norm(turn),
            rng.normal(scale=2, size=3),
        ]
        balls = [track(thrown(rng, x), 100000 + 2 * number + k) for k in range(2)]
        tick(x, rng.normal(size=3), balls, flying=False)
    numbers = [float(rounded_up(extent)), float(rounded_up(HULLS["radius_m"]))]
    order = ("radius_m", "a_max", "latency_s", "clearance_m", "wall_room_m", "v_max")
    head = struct.pack("<4I", 7, 0, 2, 8)
    head += struct.pack("<7f", 2.5, *numbers, *(HULLS[name] for name in ("beta", "kappa", "dt_s", "v_max")))
    head += struct.pack("<6f", *(MOVING[name] for name in order))
    values = [
        np.concatenate([getattr(r, v) for v in VALUES] + [[getattr(r, d) for d in DETAILS]]) for r in results
    ]
    return Recorded(
        head + geofence.config_words + geofence.fence_words,
        rows,
        np.array([r.status for r in results]),
        np.array([r.parts for r in results]),
        np.array(values, np.float32),
        np.array(in_flight),
    )


def mismatches(host: Recorded, found: Replay) -> int:
    """Count the ticks that differ from the host's in a bit."""
    ticks = found.ticks
    values = np.column_stack([ticks[name] for name in (*VALUES, *DETAILS)]).astype(np.float32)
    same = (host.values.view(np.uint32) == np.ascontiguousarray(values).view(np.uint32)).all(axis=1)
    return int((~(same & (host.status == ticks["status"]) & (host.parts == ticks["part"]).all(axis=1))).sum())


def measure(firmware: Path, work: Path, image: bytes, half_m: FloatArray) -> dict[str, Any]:
    """Measure all ticks on the M4, the M7 and the host; figures by name."""
    host = record(image, half_m)
    found: dict[str, Any] = {"host_target_mismatches": 0, "ticks": 0}
    for core in ("m4", "m7", "host"):
        out = replay(firmware, work, core, "stack", host.inputs(), image)
        found["host_target_mismatches"] += mismatches(host, out)
        found["ticks"] += len(out.ticks)
        name = f"{core}_all_filters"
        if core == "host":
            took = out.instructions / 1e3
            found[f"{name}_p50_us"] = float(np.median(took[host.in_flight]))
            found[f"{name}_p99_us"] = float(np.quantile(took[host.in_flight], 0.99))
            continue
        found[f"{name}_instructions"] = int(out.instructions.max())
        found[f"{name}_flight_instructions"] = int(out.instructions[host.in_flight].max())
        found[f"{name}_median_instructions"] = int(np.median(out.instructions[host.in_flight]))
        found[f"{name}_stack_bytes"] = out.stack_bytes
        if core == "m4":
            worst = max(int(out.instructions[host.in_flight].argmax()), 1)
            two = host.inputs(worst - 1, worst + 1)
            found[f"{name}_cycles_per_instruction"] = cycles_per_instruction(
                firmware, work, "stack", two, image
            )
    return found
