"""Gaussians as decoded from a file, before any rule of the import applies."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from alula import _core

SH_C0 = 0.28209479177387814  # 1 / (2 sqrt(pi)): the constant spherical harmonic

LOSSES = ("position", "scale_relative", "rotation_rad")  # columns of `Loss.bound`


@dataclass(frozen=True, slots=True)
class Loss:
    """Bounds of the difference between the decoded Gaussians and those that the file was made from.

    Attributes:
        bound: per Gaussian, shape (N, 3), rounded up: the distance of the centre [file units], the relative
            excess of the true semi-axes, the angle of the rotation [rad].
        opacity: bound of the error of alpha.
        unbounded: quantities (`position`, `scale` or `rotation`) for which `bound` is not certain, each with
            the reason; empty when it is always certain.
    """

    bound: NDArray[np.float32]
    opacity: float = 0.0
    unbounded: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Level:
    """Files of one level of detail of a capture.

    Attributes:
        number: 0 is the finest; None for the environment, which belongs to no level.
        levels: number of levels of the capture.
        files: the files that were read, relative to the index.
        of: all files of the level.
        environment: file of the capture's environment; empty where there is none.
        index: path of the index, which tells captures apart; it enters no artifact.
    """

    number: int | None
    levels: int
    files: tuple[str, ...]
    of: tuple[str, ...]
    environment: str
    index: str


@dataclass(frozen=True, slots=True)
class Properties:
    """Properties of a file besides those that every splat has.

    Attributes:
        applied: sentences about those that changed the ellipsoids.
        unknown: names of those whose meaning is not known; they were not read.
    """

    applied: tuple[str, ...] = ()
    unknown: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Splats:
    """Result of a decoder: activated values, not yet checked row by row.

    Values may be NaN or infinite and quaternions may have any length; `import_splat` handles those.

    Attributes:
        mean: centres, shape (N, 3), file frame and units.
        scale: one-sigma semi-axes, not negative, shape (N, 3), file units.
        quat_wxyz: rotation from local axes to the file frame, not normalised, shape (N, 4).
        opacity: alpha, shape (N,).
        color: red, green, blue, shape (N, 3).
        loss: None when the format keeps single precision.
        tags: properties that the file states: `render_mode`, `antialiased`, `vertical_axis`, `generator`,
            `frame`.
        notes: notes for the user about the reading of the file.
        levels: levels of detail that the Gaussians come from; empty where the file is no part of a capture
            that is spread over several files.
    """

    format: str
    mean: NDArray[np.float32]
    scale: NDArray[np.float32]
    quat_wxyz: NDArray[np.float32]
    opacity: NDArray[np.float32]
    color: NDArray[np.uint8]
    loss: Loss | None = None
    comments: tuple[str, ...] = ()
    tags: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    levels: tuple[Level, ...] = ()
    properties: Properties = Properties()

    def __len__(self) -> int:
        return len(self.mean)

    def part(self, rows: slice | NDArray[np.bool_]) -> Splats:
        """Some of the Gaussians."""
        names = ("mean", "scale", "quat_wxyz", "opacity", "color")
        loss = None if self.loss is None else replace(self.loss, bound=self.loss.bound[rows])
        return replace(self, **{name: getattr(self, name)[rows] for name in names}, loss=loss)


def loss_bound(
    count: int, *, position: ArrayLike = 0.0, scale: ArrayLike = 0.0, rotation: ArrayLike = 0.0
) -> NDArray[np.float32]:
    """`Loss.bound` from one number or one per Gaussian for each column.

    Args:
        count: N.
        position: distance of centres [file units].
        scale: relative excess of semi-axes: a true one is at most (1 + scale) times the decoded one.
        rotation: angle [rad]; values above pi count as pi.
    """
    bound = np.empty((count, 3), np.float32)
    for column, values in enumerate((position, scale, np.minimum(rotation, np.pi))):
        bound[:, column] = rounded_up(values)
    return bound


def exp(values: ArrayLike) -> NDArray[np.float64]:
    """Exponential function with the same bits on every machine, unlike NumPy's.

    It is accurate enough for results in single precision.

    Args:
        values: of any shape; values beyond 200 count as 200.
    """
    exact = np.asarray(values, np.float64)
    return _core.portable_exp(np.ascontiguousarray(exact.ravel())).reshape(exact.shape)


def logistic(values: ArrayLike) -> NDArray[np.float64]:
    """Logistic function 1 / (1 + e^-x), with the properties of `exp`.

    Args:
        values: of any shape.
    """
    exact = np.asarray(values, np.float64)
    return _core.portable_logistic(np.ascontiguousarray(exact.ravel())).reshape(exact.shape)


def growth(values: ArrayLike) -> NDArray[np.float64]:
    """Relative growth e^x - 1 of a scale when its logarithm grows by x, rounded up.

    Args:
        values: x, of any shape.
    """
    return exp(values) * (1.0 + 2.0**-50) - 1.0


def rounded_up(values: ArrayLike) -> NDArray[np.float32]:
    """Round up to single precision; the result is infinite beyond its range.

    Args:
        values: of any shape.
    """
    exact = np.asarray(values, np.float64)
    with np.errstate(over="ignore"):
        near = exact.astype(np.float32)
    up: NDArray[np.float32] = np.where(near < exact, np.nextafter(near, np.float32(np.inf)), near)
    return up


def color_from_sh0(sh0: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Base colour of constant spherical-harmonic coefficients: 0.5 + SH_C0 sh0, clamped.

    Args:
        sh0: coefficients of any shape; a NaN gives the base colour 0.

    Returns:
        Colours from 0 to 255, same shape.
    """
    value = np.nan_to_num(0.5 + SH_C0 * np.asarray(sh0, np.float64), nan=0.0)
    return np.rint(np.clip(value, 0.0, 1.0) * 255.0).astype(np.uint8)


def sh0_from_color(color: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Constant spherical-harmonic coefficients of a base colour; inverse of `color_from_sh0`.

    Args:
        color: colours from 0 to 255, any shape.
    """
    return ((np.asarray(color, np.float64) / 255.0 - 0.5) / SH_C0).astype(np.float32)
