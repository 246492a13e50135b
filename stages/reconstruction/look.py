"""A first look at a splat of unknown origin: which way is up, how high it is, and where its matter lies."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray

_Centres = NDArray[np.floating[Any]]
_LAYERS = 200  # along the largest extent of nearly all Gaussians
_OUTER = 0.5  # percentile beyond which Gaussians have no say in the extent
_CLEAR = 1.3  # times as many Gaussians in the fullest layer as along any other axis: perhaps a floor
_FLOOR = 0.1, 2.0  # fraction of the Gaussians, and times as many as along any other axis: surely a floor
_COMPARABLE = (
    0.5  # fraction of the Gaussians of the fullest layer that another one apart from it needs to compare
)
_APART = 5  # layers between these two
_ONE_SIDED = 2.0  # times as many Gaussians above a floor as below it
_MATTER = 1.0  # percentile of a box around the matter
_WORTH = 0.5  # of the volume of all Gaussians: a smaller box is worth a crop
_GROWN = 0.05  # of its edges, by which that box is grown
CONVENTION = (0.0, -1.0, 0.0)  # up of most trainers, which take over COLMAP's axes


@dataclass(frozen=True, slots=True)
class Convention:
    """Up of a file by its format.

    Attributes:
        direction: unit vector in the frame of the splat.
        words: whose convention it is.
        is_stated: the format, or the file, states it; other formats leave it to the writer.
        decides: the header of this file states it, whatever the Gaussians look like.
    """

    direction: tuple[float, float, float] = CONVENTION
    words: str = "the axis -y of most trainers"
    is_stated: bool = False
    decides: bool = False


def convention_of(source: Mapping[str, Any]) -> Convention:
    """Up by the convention of a scene's format.

    A vertical axis that the header of the file states decides, except y without a sign: Brush writes that
    into every file, whatever its axes are, and its own reader takes -y for up. SPZ names its frame by the
    directions of x, y and z (RUB: right, up, back), which is RUB where the file names none; glTF is y up;
    nerfstudio trains with z up.
    """
    stated = str(source.get("tags", {}).get("vertical_axis", "")).lower()
    if stated != "y" and (named := re.fullmatch(r"([+-]?)([xyz])", stated)):
        sign, axis = (-1.0 if named[1] == "-" else 1.0), "xyz".index(named[2])
        return Convention(_axis(axis, sign), f"Vertical Axis: {named[0]}", True, True)
    frame = str(source["frame"]["file"])
    if (named := re.match(r"([LRUDFB]{3})\b", frame)) and (place := re.search("[UD]", named[1])):
        sign, axis = (1.0 if place[0] == "U" else -1.0), place.start()
        words = f"{'+' if sign > 0 else '-'}{'xyz'[axis]} of the frame {named[1]} of SPZ"
        return Convention(_axis(axis, sign), words, True)
    if frame.startswith("glTF"):
        return Convention(_axis(1, 1.0), "+y of glTF", True)
    if frame.startswith("nerfstudio"):
        return Convention(_axis(2, 1.0), "+z of nerfstudio", True)
    return Convention()


def _axis(axis: int, sign: float) -> tuple[float, float, float]:
    x, y, z = (sign if axis == i else 0.0 for i in range(3))
    return x, y, z


@dataclass(frozen=True, slots=True)
class Up:
    """The direction that is taken for up.

    Attributes:
        direction: unit vector in the frame of the splat.
        why: in words, for the reader of the project.
    """

    direction: tuple[float, float, float]
    why: str


def up_of(mean: _Centres, convention: Convention = Convention()) -> Up:
    """Up from the Gaussians alone: away from the floor, the fullest thin layer across an axis.

    Layers have the same thickness along all axes, 1 / 200 of the largest extent. Where neither side of the
    fullest layer has twice as many Gaussians as the other, up is +x, -y or +z, as most writers have it. So
    it is where the fullest layer says otherwise and a layer of comparable size lies elsewhere along the axis.

    A layer with a tenth of the Gaussians, and twice as many as any across another axis, is a floor. A layer
    with fewer decides only where the format does not state its frame, and never for x, which no format has
    up; else up is that of the convention.

    Args:
        mean: centres, shape (N, 3).
    """
    if convention.decides:
        return Up(convention.direction, f"the header of the file states {convention.words}")
    no_floor = Up(convention.direction, f"no floor stands out, so {convention.words} is taken")
    low, high = np.percentile(mean, (_OUTER, 100 - _OUTER), axis=0)
    thickness = float((high - low).max()) / _LAYERS
    if not thickness > 0:
        return no_floor
    layers = [_layer(mean[:, axis], float(low[axis]), float(high[axis]), thickness) for axis in range(3)]
    order = sorted(range(3), key=lambda axis: -layers[axis][0])
    share, below, above, other = layers[order[0]]
    if share < _CLEAR * layers[order[1]][0]:
        return no_floor
    is_floor = share >= _FLOOR[0] and share >= _FLOOR[1] * layers[order[1]][0]
    if not is_floor and (convention.is_stated or order[0] == 0):
        return Up(
            convention.direction,
            f"the fullest flat layer, across {'xyz'[order[0]]}, has only {share:.0%} of the Gaussians, too "
            f"few for a floor, so {convention.words} is taken; --up gives another",
        )
    is_positive, usual = below <= above, order[0] != 1
    is_odd = is_positive != usual and other >= _COMPARABLE * share  # the other layer may be the floor as well
    if is_odd or max(below, above) < _ONE_SIDED * min(below, above):
        is_positive = usual
    name = f"{'+' if is_positive else '-'}{'xyz'[order[0]]}"
    weak = (
        ""
        if is_floor and not is_odd
        else "; that is weak evidence: look at it in alula view, --up gives another"
    )
    return Up(
        _axis(order[0], 1.0 if is_positive else -1.0),
        f"a flat layer has {share:.0%} of the Gaussians, and {name} leads up from it{weak}",
    )


def up_given(axis: str) -> Up:
    """Up as the user gave it."""
    return Up(_axis("xyz".index(axis[1]), 1.0 if axis[0] == "+" else -1.0), "as given")


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


def _layer(
    coordinate: _Centres, low: float, high: float, thickness: float
) -> tuple[float, float, float, float]:
    """Fractions of the Gaussians in the fullest layer, on either side of it, and in the fullest one apart."""
    bins = max(1, round((high - low) / thickness))
    counts, _ = np.histogram(coordinate, bins, (low, low + bins * thickness))
    at, total = int(counts.argmax()), len(coordinate)
    apart = np.r_[counts[: max(at - _APART, 0)], counts[at + 1 + _APART :]]
    sides = int(counts[:at].sum()) / total, int(counts[at + 1 :].sum()) / total
    return counts[at] / total, *sides, int(apart.max(initial=0)) / total
