"""Gaussians as a file holds them, before any rule was applied."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

SH_C0 = 0.28209479177387814  # 1 / (2 sqrt(pi)): the constant spherical harmonic

Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Splats:
    """What a decoder found: activated values, not yet checked row by row.

    Values may be NaN or infinite and quaternions have any length; `import_splat` decides on those.

    Attributes:
        format: name of the format.
        mean: centres, shape (N, 3), file frame and units.
        scale: one-sigma semi-axes, not negative, shape (N, 3), file units.
        quat_wxyz: rotation from local axes to the file frame, not normalised, shape (N, 4).
        opacity: alpha, shape (N,).
        color: red, green, blue, shape (N, 3).
        loss: what the format may have lost against the scene it was made from: `position` [file
            units], `scale_relative`, `rotation_rad`, `opacity`; a missing key is a loss of nothing.
        comments: free text found in the file.
        tags: what known comment lines say: `render_mode`, `antialiased`, `vertical_axis`, `generator`.
        notes: what a person should know about how the file was read.
    """

    format: str
    mean: NDArray[np.float32]
    scale: NDArray[np.float32]
    quat_wxyz: NDArray[np.float32]
    opacity: NDArray[np.float32]
    color: NDArray[np.uint8]
    loss: dict[str, float] = field(default_factory=dict)
    comments: tuple[str, ...] = ()
    tags: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.mean)


def color_from_sh0(sh0: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Base colour of constant spherical-harmonic coefficients: 0.5 + SH_C0 sh0, clamped; NaN is black."""
    value = np.nan_to_num(0.5 + SH_C0 * np.asarray(sh0, np.float64), nan=0.0)
    return np.rint(np.clip(value, 0.0, 1.0) * 255.0).astype(np.uint8)


def sh0_from_color(color: NDArray[np.uint8]) -> NDArray[np.float32]:
    """The coefficients whose base colour is `color`; inverse of `color_from_sh0`."""
    return ((np.asarray(color, np.float64) / 255.0 - 0.5) / SH_C0).astype(np.float32)
