"""Ticks of the chord filter on emulated cores: flights among hulls with a lag, and states anywhere."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from emulated import chord_inputs, replay, single
from numpy.typing import NDArray

from alula import _core
from alula.stages.compression.onboard.cost import tick_instructions

FLIGHTS, TICKS, EVERY, ANYWHERE = 10, 80, 10, 300
RADIUS_M, BETA, LAG_S, DT_S, V_MAX = 0.15, 2.0, 0.35, 0.01, 1.0  # of the Crazyflie's app
FloatArray = NDArray[np.float64]
COUNTED = ("boxes", "hulls", "planes", "made", "rows", "soft")


def recorded(image: bytes, half: FloatArray) -> tuple[FloatArray, FloatArray, NDArray[np.int64], float]:
    """Fly through a field of hulls.

    Returns:
        States (ticks, 9): position, velocity, nominal velocity; the velocities (ticks, 3) and statuses of the
        host; and the extent [m].
    """
    config = _core.PolytopeCbfConfig(radius_m=RADIUS_M, beta=BETA, dt_s=DT_S, v_max=V_MAX)
    extent, rng = float(half.max()) + 2.0, np.random.default_rng(4)
    native = _core.OnboardChord(image, config, LAG_S, extent)
    left, states, found = math.exp(-DT_S / LAG_S), [], []

    def ask(x: FloatArray, v: FloatArray, u: FloatArray, *, keeps: bool) -> FloatArray:
        words = [single(x), single(v), single(u)]
        flown, status, *_ = native.filter(*words)
        if keeps:
            states.append(np.concatenate(words))
            found.append((flown, status))
        return np.array(flown)

    for _ in range(FLIGHTS):
        x, v = rng.uniform(-half, half), np.zeros(3)
        while native.filter(single(x), [0.0] * 3, [0.0] * 3)[2] < 0.05:
            x = rng.uniform(-half, half)
        goal = rng.uniform(-half, half)
        for tick in range(EVERY * TICKS):
            u = ask(x, v, 2 * (goal - x), keeps=tick % EVERY == 0)
            x = x + DT_S * u + LAG_S * (1 - left) * (v - u)
            v = u + left * (v - u)
    for _ in range(ANYWHERE):
        ask(rng.uniform(-half, half), rng.normal(size=3) / 2, rng.normal(size=3), keeps=True)
    u, status = (np.array(column) for column in zip(*found, strict=True))
    return np.array(states), u, status, extent


def measure(
    firmware: Path, work: Path, image: bytes, half: FloatArray, tight: dict[str, FloatArray]
) -> dict[str, Any]:
    """Figures of ticks replayed on both cores. `tight` gets the model's instructions over those counted."""
    states, want, status, extent = recorded(image, half)
    inputs = chord_inputs(states.astype(np.float32), [extent, RADIUS_M, BETA, LAG_S, DT_S, V_MAX])
    found: dict[str, Any] = {"host_target_mismatches": 0, "ticks": 0}
    for core in ("m4", "m7"):
        out = replay(firmware, work, core, "chord", inputs, image)
        same = (want.astype(np.float32) == out.ticks["u"]).all(axis=1) & (status == out.ticks["status"])
        found["host_target_mismatches"] += int((~same).sum())
        found["ticks"] += len(out.ticks)
        found[f"{core}_chord_instructions"] = int(out.instructions.max())
        found[f"{core}_chord_flight_instructions"] = int(out.instructions[: FLIGHTS * TICKS].max())
        found[f"{core}_chord_median_instructions"] = int(np.median(out.instructions[: FLIGHTS * TICKS]))
        found[f"{core}_chord_stack_bytes"] = out.stack_bytes
        looked = np.column_stack([out.ticks[word].astype(np.int64) for word in COUNTED])
        tight[f"{core}_chord"] = tick_instructions(looked, of_chord=True) / out.instructions
    return found
