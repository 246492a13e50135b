"""Growth of time and memory from `.ply` to a verified cover, each size in a process of its own."""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import scenes
from measure import FloatArray
from peers import write_inria_ply
from tools import PATIENCE, Clock, Outcome, peak_mb, run_child, run_tool

from alula.schemas.artifacts.artifact import write_artifact
from alula.schemas.parameters.configs.merge import MergeConfig
from alula.stages.compression.merge import merge
from alula.stages.compression.verify import verify
from alula.stages.reconstruction.formats.registry import read_splats

VOXEL_M = 0.05
GAUSSIANS_PER_HULL = 500  # 1.5 million Gaussians get 3,000 hulls, others in proportion
STEPS = ("read", "voxelize", "merge", "verify")
TARGET_S, TARGET_MB = 4.0, 2000.0  # from 1.5 million Gaussians to the cover


def child(paths: list[str]) -> None:
    """Run in the new process: write a garden's file, or process one up to a verified cover."""
    request, answer = (Path(path) for path in paths)
    given = json.loads(request.read_text())
    figures = _make(given) if given["make"] else _pipeline(given)
    answer.write_text(json.dumps(figures))


def _make(given: dict[str, Any]) -> dict[str, Any]:
    path = Path(given["ply"])
    write_inria_ply(path, scenes.garden(given["gaussians"]))
    return {"megabytes": path.stat().st_size / 1e6}


def _pipeline(given: dict[str, Any]) -> dict[str, Any]:
    figures: dict[str, Any] = {"start_mb": peak_mb()}

    def taken(step: str, clock: Clock) -> None:
        figures.update({f"{step}_{name}": value for name, value in clock.seconds().items()})

    whole = Clock()
    clock = Clock()
    scene = scenes.metric(read_splats(Path(given["ply"])))
    taken("read", clock)
    clock = Clock()
    voxels = scenes.voxels_of(scene, VOXEL_M)
    taken("voxelize", clock)
    clock = Clock()
    cover = merge(MergeConfig(hulls=given["hulls"]), voxels)
    taken("merge", clock)
    taken("cover", whole)
    figures["cover_peak_mb"] = peak_mb()
    clock = Clock()
    certificate = verify(cover, voxels=voxels, scene=scene)
    taken("verify", clock)
    figures["peak_mb"] = peak_mb()
    write_artifact(Path(given["voxels"]), voxels)
    return figures | {
        "voxels": len(voxels["index"]),
        "hulls": cover.manifest.summary["hulls"],
        "half_planes": cover.manifest.summary["half_planes"],
        "union_ratio": cover.manifest.conservativeness,  # type: ignore[attr-defined]
        "covered": certificate.covered,
    }


def rows(gaussians: Sequence[int], limit_s: float, deadline: float) -> Iterator[dict[str, Any]]:
    """Measure one row per size; `paper_*` figures are those of the published rule on the same voxels.

    No process uses more CPU time than `limit_s` or runs beyond `deadline`, a time of the monotonic clock [s].
    """

    def left_s() -> float:
        return max(0.0, min(PATIENCE * limit_s, deadline - time.monotonic()))

    with tempfile.TemporaryDirectory(prefix="alula-bench-") as folder:
        ply, voxels = Path(folder, "garden.ply"), Path(folder, "garden.voxels.npz")
        for count in gaussians:
            row: dict[str, Any] = {"gaussians": count, "hulls_asked": max(1, count // GAUSSIANS_PER_HULL)}
            given = {"ply": str(ply), "voxels": str(voxels), "gaussians": count, "hulls": row["hulls_asked"]}
            made = ours = run_child("growth", given | {"make": True}, limit_s, left_s())
            if not made.note:
                ours = run_child("growth", given | {"make": False}, limit_s, left_s())
            row |= made.figures | ours.figures | {"note": ours.note}
            paper = Outcome(note="not tried")
            if not ours.note:
                options = {"hulls": row["hulls"], "method": "paper"}
                paper = run_tool("merge", voxels, limit_s, wall_s=left_s(), judged=False, **options)
            yield row | {f"paper_{k}": v for k, v in (paper.figures | {"note": paper.note}).items()}
            ply.unlink(missing_ok=True)


def exponents(rows: Sequence[dict[str, Any]]) -> dict[str, float]:
    """Slopes of log time and log memory over log voxels, and that of N log N.

    Memory is that of the process beyond its start, when libraries are loaded and nothing is read.
    """
    done = [row for row in rows if "voxels" in row]
    if len(done) < 2:
        return {}
    count = np.array([row["voxels"] for row in done], np.float64)

    def slope(values: FloatArray) -> float:
        return float(np.polyfit(np.log(count), np.log(np.maximum(values, 1e-9)), 1)[0])

    found = {"n_log_n": slope(count * np.log(count))}
    names = [f"{step}_cpu_s" for step in (*STEPS, "cover")]
    is_whole = all(row["paper_note"] == "" for row in done)
    for name in names + ["paper_cpu_s"] * is_whole:
        found[name] = slope(np.array([row[name] for row in done]))
    for who in ["", *["paper_"] * is_whole]:
        taken = [row[f"{who}peak_mb"] - row[f"{who}start_mb"] for row in done]
        found[f"{who}memory"] = slope(np.array(taken))
    return found
