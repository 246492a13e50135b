"""Ticks of dr-acbf on emulated cores: recorded encounters of examples/dr-acbf, and crowds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from dracbf import SCENARIO, record
from emulated import dr_acbf_inputs, replay, single
from numpy.typing import NDArray

from alula import _core
from alula.schemas.scenarios.scenario import read_scenario

ENCOUNTER_TICKS, CROWD = 1500, 8
FloatArray = NDArray[np.float64]
Asked = tuple[list[float], list[float], FloatArray, list[float]]
"""A tick of dr-acbf: position, velocity, tracks (n, 29), nominal command; all of them floats."""


def crowd(rng: np.random.Generator, tracks: int) -> Asked:
    """Make a tick with many obstacles that are close and approach."""
    at = rng.normal(size=(tracks, 3))
    at *= rng.uniform(1.5, 8.0, (tracks, 1)) / np.linalg.norm(at, axis=1)[:, None]
    velocity = -at * rng.uniform(0.3, 1.5, (tracks, 1)) + rng.normal(scale=0.5, size=(tracks, 3))
    spread = np.diag([0.02, 0.02, 0.02, 0.3, 0.3, 0.3])[np.tril_indices(6)]
    rows = np.column_stack(
        [np.arange(tracks), at, velocity, np.tile(spread, (tracks, 1)), np.full(tracks, 0.2)]
    )
    return [0.0, 0.0, 0.0], single(rng.normal(size=3)), rows.astype(np.float32).astype(float), [0.0, 0.0, 0.0]


def measure(firmware: Path, work: Path) -> dict[str, Any]:
    """Measure recorded encounters and crowds; figures by name."""
    recorded: list[Asked] = [
        (single(t.position), single(t.velocity), t.tracks.astype(np.float32).astype(float), single(t.nominal))
        for trial in record(read_scenario(SCENARIO), 3, 1)
        for t in trial
    ][:ENCOUNTER_TICKS]
    rng = np.random.default_rng(3)
    found: dict[str, Any] = {"host_target_mismatches": 0, "ticks": 0}
    for suffix, ticks in (("", recorded), (f"_{CROWD}_tracks", [crowd(rng, CROWD) for _ in range(150)])):
        native = _core.moving_filter("dr_acbf")
        reports = [native.filter(p, v, tracks, np.empty((0, 4)), u)[0] for p, v, tracks, u in ticks]
        want = np.array([report.acceleration for report in reports], np.float32)
        status = np.array([report.status for report in reports])
        for core in ("m4", "m7"):
            out = replay(firmware, work, core, "dr_acbf", dr_acbf_inputs(ticks))
            same = (want.view(np.uint32) == np.ascontiguousarray(out.ticks["a"]).view(np.uint32)).all(axis=1)
            found["host_target_mismatches"] += int((~(same & (status == out.ticks["status"]))).sum())
            found["ticks"] += len(out.ticks)
            found[f"{core}_dracbf{suffix}_instructions"] = int(out.instructions.max())
            found[f"{core}_dracbf{suffix}_median_instructions"] = int(np.median(out.instructions))
            found[f"{core}_dracbf_stack_bytes"] = max(
                out.stack_bytes, found.get(f"{core}_dracbf_stack_bytes", 0)
            )
    return found
