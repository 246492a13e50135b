"""Gaussians of a scene as a browser draws them: those that contribute most, with their covariances."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from alula.schemas.artifacts.artifact import Artifact, describe_arrays
from alula.schemas.artifacts.mapping import let_go
from alula.schemas.artifacts.parts import Parts
from alula.schemas.parameters.configs.view import MOST_GAUSSIANS
from alula.stages.rotation import matrix_from_quat_wxyz
from alula.stages.show.drawing.content import Gaussians

_GRID_M = 2.0**-10  # centres are rounded to this, or to a sixteenth of a small Gaussian
_LARGEST = 1e12  # larger values cannot be shown, and their squares not be stored
THINNED_FROM = "thinned_from"  # entry of the summary of a thinned scene: number of Gaussians of the whole
_CHUNK = 1 << 18  # rows that are in memory at once in double precision
_MOST_GROWN = 6.0  # of a Gaussian that also stands for neighbours that are left out


def contribution(scene: Artifact) -> NDArray[np.float64]:
    """Opacity times the area of the projected ellipse along its shortest axis, shape (N,)."""
    area = np.empty(len(scene["opacity"]))
    for rows in _chunks(len(area)):
        axes = np.sort(np.asarray(scene["scale"][rows], np.float64), axis=1)
        area[rows] = np.asarray(scene["opacity"][rows], np.float64) * axes[:, 1] * axes[:, 2]
    let_go(scene["scale"])
    return area


@dataclass(frozen=True, slots=True)
class Choice:
    """Rows of Gaussians to show, and factors by which their longer semi-axes grow, both of shape (n,)."""

    row: NDArray[np.int64]
    grown: NDArray[np.float64]

    def of(self, some: NDArray[np.bool_]) -> Choice:
        """Some of the rows."""
        return Choice(self.row[some], self.grown[some])


def chosen(scene: Artifact, maximum: int = MOST_GAUSSIANS) -> Choice:
    """Choose at most `maximum` Gaussians by their contribution, evenly in space.

    Gaussian i is kept with the probability p_i = min(1, c w_i) of its contribution w_i, where the p_i add up
    to `maximum`: systematic sampling along a space-filling curve, without chance. The two longer semi-axes
    of a kept one grow by 1 / sqrt(p_i), within a limit, so that it covers the area of those that it stands
    for. The rows are in the order of the curve, in which neighbours compress well.
    """
    let_go(*scene.arrays.values())  # makes room, where a search tree was made of them before
    count = len(scene["mean"])
    if count <= maximum:
        return Choice(_along_curve(scene).astype(np.int64), np.ones(count))
    share = _shares(contribution(scene), maximum)
    order = _along_curve(scene)
    row, grown, total, reached = [], [], 0.0, 0.0
    for part in _chunks(count):
        own = share[order[part]]
        sums = np.cumsum(np.concatenate([[total], own]))[1:]
        steps = np.floor(sums + 0.5)
        kept = np.flatnonzero(np.diff(steps, prepend=reached) > 0)
        row.append(order[part][kept].astype(np.int64))
        grown.append(np.minimum(1 / np.sqrt(np.maximum(own[kept], 1e-9)), _MOST_GROWN))
        total, reached = float(sums[-1]), float(steps[-1])
    return Choice(np.concatenate(row)[:maximum], np.concatenate(grown)[:maximum])


def _chunks(count: int) -> Iterator[slice]:
    """Parts of so many rows."""
    return (slice(first, first + _CHUNK) for first in range(0, count, _CHUNK))


def _shares(weight: NDArray[np.float64], total: int) -> NDArray[np.float64]:
    """Probabilities min(1, c w) that add up to `total`, which is below their number; they replace w."""
    is_sure = np.zeros(len(weight), np.bool_)
    factor = 0.0
    for _ in range(100):
        rest = total - int(is_sure.sum())
        free = float(weight[~is_sure].sum())
        factor = rest / free if free > 0 else 0.0
        over = np.concatenate([weight[part] * factor > 1 for part in _chunks(len(weight))]) & ~is_sure
        if not over.any():
            break
        is_sure |= over
    weight *= factor
    weight[is_sure] = 1.0
    return np.minimum(weight, 1.0, out=weight)


def _along_curve(scene: Artifact) -> NDArray[np.uint32]:
    """Rows in the order of a space-filling curve, equal places in that of the rows."""
    points = np.asarray(scene["mean"])
    key = np.zeros(len(points), np.uint64)
    if not len(points):
        return key.astype(np.uint32)
    low, high = np.transpose([np.quantile(points[:, axis], (0.005, 0.995)) for axis in range(3)])
    for rows in _chunks(len(points)):
        cell = np.clip((points[rows] - low) / np.maximum(high - low, 1e-9) * 1023, 0, 1023).astype(np.uint64)
        key[rows] = (_morton(cell) << np.uint64(32)) | np.arange(
            rows.start, rows.start + len(cell), dtype=np.uint64
        )
    let_go(points)
    key.sort()
    return (key & np.uint64(2**32 - 1)).astype(np.uint32)


def _morton(cell: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Interleave the bits of three coordinates, ten of each."""
    code = np.zeros(len(cell), np.uint64)
    for bit in range(10):
        for axis in range(3):
            code |= ((cell[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return code


def thinned(parts: Parts, maximum: int) -> Artifact:
    """At most `maximum` Gaussians of a scene in parts, chosen and grown in each part as by `chosen`.

    Memory holds one part and the chosen Gaussians. The summary has the number of all as `THINNED_FROM`.
    """
    names = ("mean", "scale", "quat_wxyz", "opacity", "color")
    found: dict[str, list[NDArray[Any]]] = {name: [] for name in names}
    for part, ref in zip(parts, parts.refs, strict=True):
        choice = chosen(part, ref.count * maximum // max(parts.count, maximum))
        rows = {name: np.asarray(part[name])[choice.row] for name in names}
        is_short = np.arange(3) == rows["scale"].argmin(axis=1)[:, None]
        rows["scale"] = np.where(is_short, rows["scale"], rows["scale"] * choice.grown[:, None])
        for name, values in rows.items():
            found[name].append(values)
    arrays = {
        name: np.concatenate(values).astype(np.uint8 if name == "color" else np.float32)
        for name, values in found.items()
    }
    manifest = parts.manifest
    described = describe_arrays(parts.kind, manifest.frame, manifest.unit, arrays)
    summary = manifest.summary | {THINNED_FROM: parts.count}
    shown = msgspec.structs.replace(manifest, arrays=described, requires=[], summary=summary)
    return Artifact(shown, arrays)


def gaussians(name: str, scene: Artifact, choice: Choice, *, visible: bool = True) -> Gaussians:
    """Gaussians of some rows of a scene.

    Centres are rounded to a fraction of the smallest common size, far below what can be seen.
    """
    rows = choice.row
    scale = np.minimum(np.asarray(scene["scale"][rows], np.float64), _LARGEST)
    is_short = np.arange(3) == scale.argmin(axis=1)[:, None]
    scale = np.where(is_short, scale, scale * choice.grown[:, None])
    turn = matrix_from_quat_wxyz(np.asarray(scene["quat_wxyz"][rows], np.float64))
    half = turn * scale[:, None, :]
    mean = np.clip(np.asarray(scene["mean"][rows], np.float64), -_LARGEST, _LARGEST)
    if len(rows):
        small = float(np.quantile(scale.max(axis=1), 0.05)) / 16
        grid = min(_GRID_M, 2.0 ** np.floor(np.log2(max(small, 1e-9))))
        mean = np.round(mean / grid) * grid
    return Gaussians(
        name=name,
        mean=mean.astype(np.float32),
        covariance=(half @ half.transpose(0, 2, 1)).astype(np.float32),
        color=np.asarray(scene["color"])[rows],
        opacity=np.asarray(scene["opacity"][rows], np.float32),
        visible=visible,
    )
