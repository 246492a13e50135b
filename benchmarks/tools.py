"""Tools that cover obstacles by convex parts, each run in a process of its own and evaluated alike.

Each process may use a limited CPU time. CPU and wall time are those of the tool's call alone, without
starting Python or reading the input; CPU time counts all threads. Peak memory is that of the whole process.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1] / "examples"))  # the package `papers`

import importlib
import json
import math
import os
import resource
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from solids import Solids, measure, measure_along_lines, mesh_bytes, outside_every_hull

from alula.schemas.artifacts.artifact import Artifact, read_artifact
from alula.schemas.artifacts.kinds import VOXELS
from alula.schemas.parameters.configs.merge import MergeConfig
from alula.stages.compression.merge import merge
from alula.stages.compression.onboard.layout import encode_map
from papers.polymerge.voxel_mesh import voxel_mesh

_ERRORS = 8  # tolerance in standard errors of four draws: chance exceeds it about once in some hundred
HERE = str(Path(__file__).resolve().parent)
_START = """
import resource, sys
resource.setrlimit(resource.RLIMIT_CPU, ({limit}, {limit} + 5))
sys.path.append(sys.argv[1])
import {module}
{module}.child(sys.argv[2:])
"""
PATIENCE = 20  # wall seconds of a process per CPU second it may use, on a machine with much else to do
_VHACD_CELLS = (400_000, 4_000_000)  # of V-HACD's own grid: its default, and what fits in memory


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """Result of one process: `note` is empty when it is done, else it gives the reason.

    When the process took too long, `cpu_s` is the CPU time that it had used by then.
    """

    note: str = ""
    figures: dict[str, Any] = field(default_factory=dict)


def _cpu_s(who: int) -> float:
    used = resource.getrusage(who)
    return used.ru_utime + used.ru_stime


class Clock:
    """Wall and CPU seconds of this process since the clock was made."""

    def __init__(self) -> None:
        self._wall, self._cpu = time.perf_counter(), _cpu_s(resource.RUSAGE_SELF)

    def seconds(self) -> dict[str, float]:
        """Figures `wall_s` and `cpu_s`."""
        spent = _cpu_s(resource.RUSAGE_SELF) - self._cpu
        return {"wall_s": time.perf_counter() - self._wall, "cpu_s": spent}


def peak_mb() -> float:
    """Maximum resident memory of this process so far [MB], without that of its parent."""
    try:
        status = Path("/proc/self/status").read_text()
        return int(status.split("VmHWM:")[1].split()[0]) * 1024 / 1e6
    except (OSError, IndexError):
        unit = 1 if sys.platform == "darwin" else 1024
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


def run_child(module: str, arguments: dict[str, Any], limit_s: float, wall_s: float | None = None) -> Outcome:
    """Call `module.child` in a new process and read its figures.

    Args:
        module: a module of this folder.
        arguments: passed as JSON.
        limit_s: maximum CPU time of all threads together; the process is killed when it has used it [s].
        wall_s: maximum elapsed time [s]; by default many times `limit_s`.
    """
    too_slow = f"over {limit_s:.0f} s of CPU"
    if limit_s <= 0:
        return Outcome(note=too_slow, figures={"cpu_s": 0.0})
    with tempfile.TemporaryDirectory(prefix="alula-bench-") as folder:
        request, answer = Path(folder, "request.json"), Path(folder, "figures.json")
        request.write_text(json.dumps(arguments))
        code = _START.format(module=module, limit=math.ceil(limit_s))
        command = [sys.executable, "-P", "-c", code, HERE, str(request), str(answer)]
        before = _cpu_s(resource.RUSAGE_CHILDREN)
        try:
            done = subprocess.run(
                command,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
                timeout=PATIENCE * limit_s if wall_s is None else wall_s,
                check=False,
            )
        except subprocess.TimeoutExpired as late:
            spent = _cpu_s(resource.RUSAGE_CHILDREN) - before
            return Outcome(note=f"over {late.timeout:.0f} s", figures={"cpu_s": spent})
        spent = _cpu_s(resource.RUSAGE_CHILDREN) - before
        is_stopped = done.returncode == -signal.SIGXCPU
        if is_stopped or (done.returncode == -signal.SIGKILL and spent > 0.9 * limit_s):
            return Outcome(note=too_slow, figures={"cpu_s": spent})
        if not answer.exists():
            last = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
            return Outcome(note=f"failed: {last}")
        figures = json.loads(answer.read_text())
        return Outcome(note=figures.pop("note", ""), figures=figures)


def child(paths: list[str]) -> None:
    """Run in the new process: one tool on the obstacles of a file; write its polytopes and figures."""
    request, answer = (Path(path) for path in paths)
    given = json.loads(request.read_text())
    voxels = read_artifact(Path(given["voxels"]), VOXELS)
    try:
        if given["tool"] == "merge":
            solids, figures = _merge(voxels, given["options"])
        else:
            solids, figures = OTHERS[given["tool"]](*_mesh(voxels, given["mesh"]), given["options"])
    except ModuleNotFoundError as error:
        answer.write_text(json.dumps({"note": f"{error.name} is not installed"}))
        return
    arrays = {name: getattr(solids, name) for name in Solids.__dataclass_fields__}
    np.savez(given["output"], **arrays)
    answer.write_text(json.dumps(figures))


def run_tool(
    tool: str,
    voxels: Path,
    limit_s: float,
    *,
    judged: bool = True,
    mesh: Path | None = None,
    wall_s: float | None = None,
    **options: Any,
) -> Outcome:
    """Run one tool on an `alula/voxels` file; figures are times, memory and those of `judge`.

    Args:
        tool: "merge", "coacd" or "vhacd".
        voxels: path of the file; the result is judged against these voxels.
        limit_s: maximum CPU time of the process [s].
        judged: False leaves the figures of `judge` out.
        mesh: file of `write_mesh` that CoACD or V-HACD gets instead of the surface of the voxels.
        wall_s: see `run_child`.
        options: of the tool.
    """
    with tempfile.TemporaryDirectory(prefix="alula-bench-") as folder:
        output = Path(folder) / "solids.npz"
        given = {"tool": tool, "voxels": str(voxels), "output": str(output), "options": options}
        outcome = run_child("tools", given | {"mesh": None if mesh is None else str(mesh)}, limit_s, wall_s)
        if outcome.note or not judged:
            return outcome
        with np.load(output) as arrays:
            solids = Solids(**{name: arrays[name] for name in arrays.files})
    figures = judge(solids, np.asarray(read_artifact(voxels, VOXELS)["index"])) | outcome.figures
    figures["bytes_per_half_plane"] = figures["bytes"] / max(1, figures["half_planes"])
    return Outcome(figures=figures)


def judge(solids: Solids, voxels: np.ndarray) -> dict[str, Any]:
    """Evaluate a cover from its planes and vertices alone."""
    found, lines = measure(solids, voxels), measure_along_lines(solids, voxels)
    return {
        "hulls": len(solids),
        "flat_parts": int(solids.flat),
        "half_planes": len(solids.offset),
        "bytes": mesh_bytes(solids),
        "union_ratio": found.union_ratio,
        "union_ratio_error": found.error,
        "union_ratio_along_lines": lines.union_ratio,
        "agrees": abs(found.union_ratio - lines.union_ratio) < _ERRORS * lines.error + found.error + 1e-5,
        "excess": found.union_ratio - (1 - found.uncovered_volume),
        "uncovered_volume": found.uncovered_volume,
        "voxels_with_gap": found.voxels_with_gap,
        "voxels_outside_every_hull": outside_every_hull(solids, voxels),
    }


def _merge(voxels: Artifact, options: dict[str, Any]) -> tuple[Solids, dict[str, Any]]:
    config = MergeConfig(**options)
    start_mb = peak_mb()
    clock = Clock()
    cover = merge(config, voxels)
    figures: dict[str, Any] = {**clock.seconds(), "peak_mb": peak_mb(), "start_mb": start_mb}
    figures["union_ratio_stated"] = cover.manifest.conservativeness  # type: ignore[attr-defined]
    figures["bytes"] = len(encode_map(cover))
    return Solids.from_cover(cover), figures


def write_mesh(path: Path, corner: np.ndarray, triangle: np.ndarray) -> None:
    """Write a surface in voxel edges, as `voxel_mesh` and `density_mesh` return it."""
    np.savez(path, corner=corner, triangle=triangle)


def _mesh(voxels: Artifact, path: str | None) -> tuple[np.ndarray, np.ndarray]:
    """Corners and triangles of a file, or else of the surface of the voxels."""
    if path is None:
        corner, triangle = voxel_mesh(voxels["index"])
        return corner.astype(np.float64), triangle
    with np.load(path) as arrays:
        return arrays["corner"], arrays["triangle"]


def _coacd(
    corner: np.ndarray, triangle: np.ndarray, options: dict[str, Any]
) -> tuple[Solids, dict[str, Any]]:
    """Run CoACD with its defaults and a fixed seed."""
    coacd = importlib.import_module("coacd")
    origin = corner.min(axis=0)
    with Silence():
        coacd.set_log_level("off")
        clock = Clock()
        parts = coacd.run_coacd(coacd.Mesh(corner - origin, triangle), seed=0, **options)
        figures = {**clock.seconds(), "peak_mb": peak_mb(), "triangles": len(triangle)}
    return Solids.from_points([points + origin for points, _ in parts]), figures


def _vhacd(
    corner: np.ndarray, triangle: np.ndarray, options: dict[str, Any]
) -> tuple[Solids, dict[str, Any]]:
    """Run V-HACD 4 with its defaults, but a grid about as fine as the voxels where that is finer."""
    vhacdx = importlib.import_module("vhacdx")
    origin = corner.min(axis=0)
    cells = int(np.clip(np.prod(np.ptp(corner, axis=0)), *_VHACD_CELLS))
    with Silence():
        clock = Clock()
        parts = vhacdx.compute_vhacd(corner - origin, triangle.astype(np.uint32), resolution=cells, **options)
        figures = {**clock.seconds(), "peak_mb": peak_mb(), "triangles": len(triangle)}
    return Solids.from_points([np.asarray(points) + origin for points, _ in parts]), figures


OTHERS: dict[str, Callable[[np.ndarray, np.ndarray, dict[str, Any]], tuple[Solids, dict[str, Any]]]] = {
    "coacd": _coacd,
    "vhacd": _vhacd,
}


class Silence:
    """Suppress stdout and stderr, also of C code, which bypasses `sys.stdout`."""

    def __enter__(self) -> None:
        sys.stdout.flush()
        self._saved = [os.dup(1), os.dup(2)]
        nothing = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nothing, 1)
        os.dup2(nothing, 2)
        os.close(nothing)

    def __exit__(self, *_: object) -> None:
        for target, saved in enumerate(self._saved, start=1):
            os.dup2(saved, target)
            os.close(saved)
