"""Ticks of the stack: flights among hulls and thrown balls in a fence, on emulated cores.

Beside them unrelated states anywhere, each with two thrown balls: the worst case for what a tick caches.
"""

from __future__ import annotations

import math
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
FLIGHTS, TICKS, ANYWHERE, BALL_EVERY = 6, 250, 700, 80
DT_S, LAG_S = 0.01, 0.35
SPREAD = np.diag([1e-4, 1e-4, 1e-4, 1e-2, 1e-2, 1e-2])[np.tril_indices(6)]
HULLS = {"radius_m": 0.15, "beta": 2.0, "dt_s": DT_S, "v_max": 1.0}  # of the Crazyflie's app
MOVING = {
    "radius_m": 0.1,
    "a_max": 6.0,
    "latency_s": 0.02,
    "clearance_m": 0.3,
    "wall_room_m": 0.1,
    "v_max": 1.0,
}
VALUES = ("margin_m", "mode", "rows", "obstacle_rows", "failing", "horizon_s", "violation_m_s")


@dataclass(frozen=True, slots=True)
class Recorded:
    """Ticks of a stack and the host's results.

    Attributes:
        head: the configuration, as the inputs of the replay begin.
        rows: inputs of each tick.
        status: shape (ticks,).
        values: velocity, then `VALUES`, shape (ticks, 10).
        in_flight: false for unrelated states, shape (ticks,).
    """

    head: bytes
    rows: list[bytes]
    status: NDArray[np.int64]
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


def thrown(rng: np.random.Generator, p: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return position and velocity of a ball that starts 4 m away and is thrown at the vehicle."""
    way = rng.normal(size=3) * [1, 1, 0.3]
    way *= 4.0 / np.linalg.norm(way)
    time = 4.0 / rng.uniform(3, 6)
    return p + way, (0.5 * time * v - way) / time


def track(ball: tuple[FloatArray, FloatArray], number: int) -> FloatArray:
    """Return a row of tracks, in single precision."""
    row = np.concatenate([[number], *ball, SPREAD, [0.12]])
    return row.astype(np.float32).astype(float)[None]


def record(image: bytes, half_m: FloatArray, seed: int = 1) -> Recorded:
    """Fly through the hulls of a map that extends by `half_m` to either side of 0, and anywhere in it."""
    extent = float(half_m.max()) + 4.0
    fence = _core.Fence(box=(tuple((-half_m - 1.0).tolist()), tuple((half_m + 1.0).tolist())))
    stack = _core.OnboardStack(
        image, _core.PolytopeCbfConfig(**HULLS), LAG_S, extent, dr_acbf=MOVING, fence=fence
    )
    probe = _core.OnboardChord(image, _core.PolytopeCbfConfig(**HULLS), LAG_S, extent)
    rng, left = np.random.default_rng(seed), math.exp(-DT_S / LAG_S)
    rows, results, in_flight = [], [], []

    def tick(p: FloatArray, v: FloatArray, u: FloatArray, balls: list[FloatArray], *, flying: bool) -> Any:
        words = [single(p), single(v), single(u)]
        tracks = np.concatenate([np.empty((0, 29)), *balls])
        result = stack.filter(*words, tracks)
        head = struct.pack("<15f2I", *words[0], *words[1], *[0.0] * 6, *words[2], 0, len(tracks))
        tail = b"".join(struct.pack("<I31f", int(r[0]), *r[1:28], r[28], 0, 0, 0) for r in tracks)
        rows.append(head + tail)
        results.append(result)
        in_flight.append(flying)
        return result

    def place() -> FloatArray:
        p = rng.uniform(-half_m, half_m)
        while probe.filter(single(p), [0.0] * 3, [0.0] * 3)[2] < 0.05:
            p = rng.uniform(-half_m, half_m)
        return p

    for _ in range(FLIGHTS):
        p, v, goal, balls = place(), np.zeros(3), place(), []
        for step in range(TICKS):
            if step % BALL_EVERY == BALL_EVERY // 2:
                balls = [*balls[-1:], (len(rows), thrown(rng, p, v), step)]
            seen = [track((at + (step - begin) * DT_S * w, w), number) for number, (at, w), begin in balls]
            u = np.array(tick(p, v, 2 * (goal - p), seen, flying=True).velocity)
            p, v = p + DT_S * u + LAG_S * (1 - left) * (v - u), u + left * (v - u)
    for number in range(ANYWHERE):
        p, v = rng.uniform(-half_m, half_m), rng.normal(size=3) / 2
        balls = []
        for k in range(2):
            (at, way), since = thrown(rng, p, v), rng.uniform(0, 0.9)
            balls.append(track((at + since * way, way), 100000 + 2 * number + k))
        tick(p, v, rng.normal(size=3), balls, flying=False)
    numbers = [float(rounded_up(extent)), LAG_S, float(rounded_up(HULLS["radius_m"]))]
    head = struct.pack("<6f", *numbers, *(HULLS[name] for name in ("beta", "dt_s", "v_max")))
    order = ("radius_m", "a_max", "latency_s", "clearance_m", "wall_room_m", "v_max")
    head += struct.pack("<6f", *(MOVING[name] for name in order))
    values = [np.concatenate([r.velocity, [getattr(r, d) for d in VALUES]]) for r in results]
    return Recorded(
        head + stack.fence_words,
        rows,
        np.array([r.status for r in results]),
        np.array(values, np.float32),
        np.array(in_flight),
    )


def mismatches(host: Recorded, found: Replay) -> int:
    """Count the ticks that differ from the host's in a bit."""
    ticks = found.ticks
    values = np.column_stack([ticks[name] for name in ("velocity", *VALUES)]).astype(np.float32)
    same = (host.values.view(np.uint32) == np.ascontiguousarray(values).view(np.uint32)).all(axis=1)
    return int((~(same & (host.status == ticks["status"]))).sum())


def measure(firmware: Path, work: Path, image: bytes, half_m: FloatArray) -> dict[str, Any]:
    """Measure all ticks on the M4, the M7 and the host; figures by name."""
    host = record(image, half_m)
    found: dict[str, Any] = {"host_target_mismatches": 0, "ticks": 0}
    for core in ("m4", "m7", "host"):
        out = replay(firmware, work, core, "stack", host.inputs(), image)
        found["host_target_mismatches"] += mismatches(host, out)
        found["ticks"] += len(out.ticks)
        if core == "host":
            took = out.instructions / 1e3
            found["host_stack_p50_us"] = float(np.median(took[host.in_flight]))
            found["host_stack_p99_us"] = float(np.quantile(took[host.in_flight], 0.99))
            continue
        found[f"stack_{core}_worst_instructions"] = int(out.instructions.max())
        found[f"stack_{core}_flight_instructions"] = int(out.instructions[host.in_flight].max())
        found[f"stack_{core}_median_instructions"] = int(np.median(out.instructions[host.in_flight]))
        found[f"{core}_stack_filter_stack_bytes"] = out.stack_bytes
        if core == "m4":
            worst = max(int(out.instructions[host.in_flight].argmax()), 1)
            two = host.inputs(worst - 1, worst + 1)
            found["m4_stack_cycles_per_instruction"] = cycles_per_instruction(
                firmware, work, "stack", two, image
            )
    return found
