"""Reference implementations of the same results in plain numpy, as a careful user would write them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from measure import FloatArray
from numpy.typing import NDArray

from alula.schemas.artifacts.artifact import Artifact
from alula.stages.compression.hulls import Hulls
from alula.stages.reconstruction.formats.splats import Splats, sh0_from_color
from alula.stages.rotation import matrix_from_quat_wxyz

_REST = tuple(f"f_rest_{i}" for i in range(45))
_COLUMNS = (
    *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"),
    *_REST,
    *("opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
)


def write_inria_ply(path: Path, splats: Splats) -> None:
    """Write a `.ply` as a training run does: normals, spherical harmonics of degree 3, 248 bytes a row."""
    rows = np.zeros(len(splats), [(name, "<f4") for name in _COLUMNS])
    alpha = splats.opacity.astype(np.float64)
    groups: dict[tuple[str, ...], NDArray[Any]] = {
        ("x", "y", "z"): splats.mean,
        ("f_dc_0", "f_dc_1", "f_dc_2"): sh0_from_color(splats.color),
        _REST: np.random.default_rng(0).normal(scale=0.05, size=(len(splats), 45)),
        ("opacity",): (np.log(alpha) - np.log1p(-alpha))[:, None],
        ("scale_0", "scale_1", "scale_2"): np.log(splats.scale.astype(np.float64)),
        ("rot_0", "rot_1", "rot_2", "rot_3"): splats.quat_wxyz,
    }
    for names, values in groups.items():
        for i, name in enumerate(names):
            rows[name] = values[:, i]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}"]
    header += [*(f"property float {name}" for name in _COLUMNS), "end_header\n"]
    path.write_bytes("\n".join(header).encode() + rows.tobytes())


def ply_arrays(path: Path, min_opacity: float) -> dict[str, NDArray[Any]]:
    """Read the arrays of a scene from a file of `write_inria_ply`."""
    data = path.read_bytes()
    rows = np.frombuffer(data, [(name, "<f4") for name in _COLUMNS], offset=data.index(b"end_header\n") + 11)

    def columns(*names: str) -> FloatArray:
        return np.column_stack([rows[name] for name in names]).astype(np.float64)

    quat = columns("rot_0", "rot_1", "rot_2", "rot_3")
    arrays = {
        "mean": columns("x", "y", "z").astype(np.float32),
        "scale": np.exp(columns("scale_0", "scale_1", "scale_2")).astype(np.float32),
        "quat_wxyz": (quat / np.linalg.norm(quat, axis=1, keepdims=True)).astype(np.float32),
        "opacity": (1 / (1 + np.exp(-columns("opacity")[:, 0]))).astype(np.float32),
    }
    kept = arrays["opacity"] >= min_opacity
    return {name: values[kept] for name, values in arrays.items()}


def box_voxels(scene: Artifact, size: float) -> NDArray[np.int64]:
    """Keys of all voxels that the bounding box of an ellipsoid at level 1 touches, sorted and unique.

    The half-width along axis i is sqrt(Sigma_ii), plus a millionth of a voxel against rounding.
    """
    mean = scene["mean"].astype(np.float64)
    axes = matrix_from_quat_wxyz(scene["quat_wxyz"]) * scene["scale"].astype(np.float64)[:, None, :]
    half = np.sqrt((axes**2).sum(axis=2)) + 1e-6 * size
    lower = np.floor((mean - half) / size).astype(np.int64)
    extent = np.floor((mean + half) / size).astype(np.int64) - lower + 1
    count = extent.prod(axis=1)
    row = np.repeat(np.arange(len(mean)), count)
    at = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
    wide = extent[row]
    index = np.stack(
        [at // (wide[:, 1] * wide[:, 2]), at // wide[:, 2] % wide[:, 1], at % wide[:, 2]], axis=1
    )
    return np.unique(voxel_keys(lower[row] + index))


def voxel_keys(index: NDArray[Any]) -> NDArray[np.int64]:
    """One integer per voxel, in lexicographic order."""
    keys: NDArray[np.int64] = (index.astype(np.int64) + 2**20) @ np.array([2**42, 2**21, 1])
    return keys


class NumpyFilter:
    """The filter `polytope-cbf`, sound smoothing, in double precision; see native/onboard.

    The onboard code enlarges obstacles by the rounding to single precision, so results differ by about that.
    """

    def __init__(
        self, hulls: Hulls, *, radius_m: float, beta: float, kappa: float, dt_s: float, v_max: float
    ) -> None:
        self.normal, self.offset, self.start = hulls.normal_world, hulls.offset_m, hulls.plane_start[:-1]
        self.planes = np.diff(hulls.plane_start)
        self.radius, self.beta, self.kappa, self.dt, self.v_max = radius_m, beta, kappa, dt_s, v_max

    def __call__(self, x: FloatArray, u_nom: FloatArray) -> tuple[FloatArray, float]:
        """Filtered velocity [m/s] and margin of the smooth barrier [m]."""
        value = self.normal @ x - self.offset
        hard = np.maximum.reduceat(value, self.start)
        weight = np.exp(self.kappa * (value - np.repeat(hard, self.planes)))
        total = np.add.reduceat(weight, self.start)
        smooth = hard + np.log(total / self.planes) / self.kappa
        nearest = smooth.min()
        hull_weight = np.exp(-self.kappa * (smooth - nearest))
        weight *= np.repeat(hull_weight / total, self.planes)
        gradient: FloatArray = weight @ self.normal / hull_weight.sum()
        margin = float(nearest - np.log(hull_weight.sum()) / self.kappa) - self.radius
        row = -self.beta * margin
        if hard.min() < self.radius:
            return self._recover(gradient, row), margin
        u = u_nom * min(1.0, self.v_max / max(float(np.linalg.norm(u_nom)), 1e-12))
        u = self._project(gradient, row, u)
        return u * self._clear_fraction(value, hard, u), margin

    def _recover(self, gradient: FloatArray, row: float) -> FloatArray:
        norm = float(np.linalg.norm(gradient))
        return gradient / norm * min(row / norm, self.v_max) if norm > 1e-3 else np.zeros(3)

    def _project(self, gradient: FloatArray, row: float, u: FloatArray) -> FloatArray:
        along, square = float(gradient @ u), float(gradient @ gradient)
        if along >= row:
            return u
        if row > 0 and row * row > square * self.v_max**2:
            return self._recover(gradient, row)
        moved = u + gradient * ((row - along) / square)
        if row > 0 and moved @ moved > self.v_max**2:
            normal = gradient * (row / square)
            tangent = moved - normal
            return normal + tangent * np.sqrt((self.v_max**2 - normal @ normal) / (tangent @ tangent))
        return moved

    def _clear_fraction(self, value: FloatArray, hard: FloatArray, u: FloatArray) -> float:
        threshold = np.repeat(np.minimum(hard, self.radius), self.planes)
        above, change = value - threshold, self.normal @ u * self.dt
        end = above + change
        with np.errstate(divide="ignore", invalid="ignore"):
            crossing = -above / change
        enter = np.where((above >= 0) & (end < 0), crossing, 0.0)
        leave = np.where((above < 0) & (end >= 0), crossing, 2.0)
        separated = np.logical_or.reduceat((above >= 0) & (end >= 0), self.start)
        first, last = np.maximum.reduceat(enter, self.start), np.minimum.reduceat(leave, self.start)
        return float(np.where(~separated & (first < last), first, 1.0).min(initial=1.0))
