"""Excess volume and CPU time of merging by blocks over those of merging at once, at equal numbers of hulls.

    python benchmarks/blocks.py

The street tiles are read from the folder that ALULA_DATA names; without it they are left out.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parent))

import numpy as np
import scenes

from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.parts import Parts
from alula.schemas.parameters.configs.merge import MergeConfig
from alula.stages.compression.merge import merge
from alula.stages.compression.merge_blocks import merge_blocks, plan_blocks

HULLS = (300, 1000)
ALONG = (2, 4, 8)  # blocks along the longest edge
ALLOWED = 1.05
VOXEL_M = 0.05


def inputs() -> Iterator[tuple[str, Artifact]]:
    """Yield voxels by name."""
    yield "room", scenes.voxels_of(scenes.room(400_000), VOXEL_M)
    yield "garden", scenes.voxels_of(scenes.metric(scenes.garden(1_000_000)), VOXEL_M)
    if data := os.environ.get("ALULA_DATA"):
        for name, (scale, edge) in scenes.REAL.items():
            yield name, scenes.voxels_of(scenes.real(Path(data) / name, scale), edge)


def measure(name: str, voxels: Artifact) -> bool:
    """Print one line per number of hulls and of blocks; whether no ratio is above `ALLOWED`."""
    extent = int(np.ptp(voxels["index"], axis=0).max()) + 1
    size = float(voxels.manifest.voxel_size_m)  # type: ignore[attr-defined]
    holds = True
    for hulls in HULLS:
        start = time.process_time()
        whole = merge(MergeConfig(hulls=hulls), voxels, jobs=1)
        taken = time.process_time() - start
        for along in ALONG:
            config = MergeConfig(hulls=hulls, block_m=-(-extent // along) * size)
            start = time.process_time()
            plan = plan_blocks(config, Parts.of(voxels))
            assert plan is not None
            (cover,) = merge_blocks(config, plan, jobs=1)
            cpu = (time.process_time() - start) / taken
            ratio = _excess(cover) / _excess(whole)
            holds = holds and ratio <= ALLOWED
            print(
                f"{name}: {plan.voxels:,} voxels, {hulls} hulls, {plan.blocks} blocks:"
                f" excess {ratio:.3f}, CPU {cpu:.2f}",
                flush=True,
            )
    return holds


def _excess(cover: Artifact) -> float:
    return float(cover.manifest.conservativeness) - 1  # type: ignore[attr-defined]


if __name__ == "__main__":
    results = [measure(name, voxels) for name, voxels in inputs()]
    raise SystemExit(0 if all(results) else 1)
