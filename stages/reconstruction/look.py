"""A first look at a splat of unknown origin: which way is up, how high it is, and where its matter lies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray

_Centres = NDArray[np.floating[Any]]
_LAYERS = 200  # along the largest extent of nearly all Gaussians
_OUTER = 0.5  # percentile beyond which Gaussians have no say in the extent
_CLEAR = 1.3  # times as many Gaussians in the fullest layer as along any other axis: a floor
_ONE_SIDED = 2.0  # times as many Gaussians above a floor as below it
_NO_FLOOR = "no floor stands out, so the axis -y of most trainers is taken"
_MATTER = 1.0  # percentile of a box around the matter
_WORTH = 0.5  # of the volume of all Gaussians: a smaller box is worth a crop
_GROWN = 0.05  # of its edges, by which that box is grown
CONVENTION = (0.0, -1.0, 0.0)  # up of most trainers, which take over COLMAP's axes


@dataclass(frozen=True, slots=True)
class Up:
    """The direction that is taken for up.

    Attributes:
        direction: unit vector in the frame of the splat.
        why: in words, for the reader of the project.
    """

    direction: tuple[float, float, float]
    why: str


def up_of(mean: _Centres) -> Up:
    """Up from the Gaussians alone: away from the floor, the fullest thin layer across an axis.

    Layers have the same thickness along all axes, 1 / 200 of the largest extent. Where neither side of the
    fullest layer has twice as many Gaussians as the other, up is +x, -y or +z, as most writers have it. Where
    no axis has a layer that is clearly fuller than those of the others, up is -y, as most trainers write it.

    Args:
        mean: centres, shape (N, 3).
    """
    low, high = np.percentile(mean, (_OUTER, 100 - _OUTER), axis=0)
    thickness = float((high - low).max()) / _LAYERS
    if not thickness > 0:
        return Up(CONVENTION, _NO_FLOOR)
    layers = [_layer(mean[:, axis], float(low[axis]), float(high[axis]), thickness) for axis in range(3)]
    order = sorted(range(3), key=lambda axis: -layers[axis][0])
    share, below, above = layers[order[0]]
    if share < _CLEAR * layers[order[1]][0]:
        return Up(CONVENTION, _NO_FLOOR)
    is_positive = order[0] != 1 if max(below, above) < _ONE_SIDED * min(below, above) else below <= above
    direction = [0.0, 0.0, 0.0]
    direction[order[0]] = 1.0 if is_positive else -1.0
    x, y, z = direction
    name = f"{'+' if is_positive else '-'}{'xyz'[order[0]]}"
    return Up((x, y, z), f"a flat layer has {share:.0%} of the Gaussians, and {name} leads up from it")


def up_given(axis: str) -> Up:
    """Up as the user gave it.

    Args:
        axis: such as "+z".
    """
    direction = [0.0, 0.0, 0.0]
    direction["xyz".index(axis[1])] = 1.0 if axis[0] == "+" else -1.0
    x, y, z = direction
    return Up((x, y, z), "as given")


def up_of_cameras(R_scene_camera: FloatArray) -> Up:
    """Up from the cameras of a model, which people hold level: the mean of their upward axes.

    Args:
        R_scene_camera: axes x right, y down, z forward as columns, shape (N, 3, 3).
    """
    mean = -R_scene_camera[:, :, 1].mean(axis=0)
    length = float(np.linalg.norm(mean))
    if length < 0.2:
        return Up(CONVENTION, "the cameras point every way, so the axis -y of most trainers is taken")
    x, y, z = (round(float(one), 6) for one in mean / length)
    return Up((x, y, z), f"mean of the upward axes of {len(R_scene_camera)} cameras")


def height_of(mean: _Centres, up: tuple[float, float, float]) -> float:
    """Extent along up, without the outermost 0.5 % of the Gaussians at either end.

    Args:
        mean: centres, shape (N, 3).
        up: unit vector.
    """
    low, high = np.percentile(mean @ np.array(up), (_OUTER, 100 - _OUTER))
    return float(high - low)


def crop_of(mean: _Centres) -> tuple[FloatArray, FloatArray, float] | None:
    """Box around the matter, where that is much smaller than the box of all Gaussians.

    Args:
        mean: centres, shape (N, 3) [m].

    Returns:
        Lower and upper corner, and the fraction of the Gaussians inside; None where nothing is worth a crop.
    """
    low, high = np.percentile(mean, (_MATTER, 100 - _MATTER), axis=0)
    grown = _GROWN * (high - low)
    low, high = low - grown, high + grown
    whole = np.ptp(mean, axis=0)
    if float(np.prod(high - low)) >= _WORTH * float(np.prod(whole)) or not (high > low).all():
        return None
    inside = ((mean >= low) & (mean <= high)).all(axis=1)
    return low, high, float(inside.mean())


def _layer(coordinate: _Centres, low: float, high: float, thickness: float) -> tuple[float, float, float]:
    """Fractions of the Gaussians in the fullest layer, and on either side of it."""
    bins = max(1, round((high - low) / thickness))
    counts, _ = np.histogram(coordinate, bins, (low, low + bins * thickness))
    at, total = int(counts.argmax()), len(coordinate)
    return counts[at] / total, int(counts[:at].sum()) / total, int(counts[at + 1 :].sum()) / total
