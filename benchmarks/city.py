"""Cities of any size: tiles of a street, repeated with jitter, written tile by tile as `.splat` files.

A city is a grid of square cells. Each cell holds one of the templates, turned by a multiple of 90 degrees
about the vertical, with noise on all centres and sizes, so that no two cells are equal. Memory holds one tile
at a time. Templates are the real tiles of a street where ALULA_DATA names the folder of scenes, else a piece
of the generated garden, stretched to a cell.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scenes
from measure import FloatArray
from numpy.typing import NDArray

from alula.stages.reconstruction.formats.registry import read_splats

CELL_M = 36.0
REAL_TILES = ("tile_x000_y003.splat", "tile_x001_y000.splat", "tile_x001_y001.splat")
_GARDEN = 50_000  # Gaussians of a piece: 3.1 m of the garden, stretched to a cell
_MOVED_M, _RESIZED = 0.02, 0.05  # standard deviations of the noise on centres, and on the logarithm of sizes
_ROW = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("quat", "u1", 4)])


@dataclass(frozen=True, slots=True)
class Template:
    """A tile centred on its cell: z up, metres; `rgba` and `quat_wxyz` as in the splat."""

    mean: FloatArray
    scale: FloatArray
    quat_wxyz: FloatArray
    rgba: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.mean)


def templates(data: Path | None) -> list[Template]:
    """Read the real tiles, or make pieces of the garden."""
    if data is not None:
        return [_read(data / "istanbul-outdoor" / name) for name in REAL_TILES]
    splats = scenes.garden(_GARDEN)
    mean, scale = splats.mean.astype(np.float64), splats.scale.astype(np.float64)
    side = float(np.ptp(mean[:, :2], axis=0).max())
    growth = CELL_M / side
    opacity = np.rint(255 * splats.opacity).astype(np.uint8)
    rgba = np.column_stack([splats.color, opacity])
    return [_centred(mean * growth, scale * growth, splats.quat_wxyz.astype(np.float64), rgba)]


def _read(path: Path) -> Template:
    splats = read_splats(path)
    rgba = np.column_stack([splats.color, np.rint(255 * splats.opacity).astype(np.uint8)])
    return _centred(
        splats.mean.astype(np.float64),
        splats.scale.astype(np.float64),
        splats.quat_wxyz.astype(np.float64),
        rgba,
    )


def _centred(mean: FloatArray, scale: FloatArray, quat: FloatArray, rgba: NDArray[np.uint8]) -> Template:
    low, high = np.percentile(mean[:, :2], [1, 99], axis=0)
    floor = np.percentile(mean[:, 2], 2)
    return Template(mean - np.array([*((low + high) / 2), floor]), scale, quat, rgba)


@dataclass(frozen=True, slots=True)
class City:
    """Files of a city, in the order of its cells, and their Gaussians."""

    files: list[Path]
    gaussians: int
    cells_across: int

    @property
    def area_km2(self) -> float:
        """Area of the cells [km^2]."""
        return len(self.files) * CELL_M**2 / 1e6


def write_city(folder: Path, gaussians: int, sources: Sequence[Template], seed: int = 0) -> City:
    """Write whole cells until there are at least `gaussians`.

    A cell depends on its number and the seed only. The grid is about as wide as long.
    """
    folder.mkdir(parents=True, exist_ok=True)
    average = float(np.mean([len(source) for source in sources]))
    across = max(1, math.ceil(math.sqrt(gaussians / average)))
    files: list[Path] = []
    written = 0
    while written < gaussians:
        number = len(files)
        path = folder / f"tile_{number:05d}.splat"
        row = _cell(sources[number % len(sources)], number, across, np.random.default_rng([seed, number]))
        row.tofile(path)
        files.append(path)
        written += len(row)
    return City(files, written, across)


def _cell(source: Template, number: int, across: int, rng: np.random.Generator) -> NDArray[np.void]:
    quarter = int(rng.integers(4))
    cosine, sine = ((1, 0), (0, 1), (-1, 0), (0, -1))[quarter]
    turn = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]], np.float64)
    count = len(source)
    place = np.array([number % across, number // across, 0.0]) * CELL_M
    row = np.empty(count, _ROW)
    row["mean"] = source.mean @ turn.T + place + _MOVED_M * rng.normal(size=(count, 3))
    row["scale"] = source.scale * np.exp(_RESIZED * rng.normal(size=(count, 3)))
    row["rgba"] = source.rgba
    half = math.pi / 4 * quarter
    w, x, y, z = source.quat_wxyz.T
    c, s = math.cos(half), math.sin(half)
    quat = np.column_stack([c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w])
    row["quat"] = np.clip(np.rint(quat * 128 + 128), 0, 255)
    return row
