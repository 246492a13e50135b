"""Checks of the shapes and values of each kind of array."""

from __future__ import annotations

from collections.abc import Container, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.artifacts.kinds import ArrayRule, Kind
from alula.schemas.errors import ArtifactError

_ROWS = 2**15  # per block, so that a block stays in the cache between the steps of a check
_UNIT_NORM_TOLERANCE = 1e-3  # f32 quaternions normalised once are within 2e-7


def present(kind: Kind, names: Container[str]) -> list[ArrayRule]:
    """Rules of a kind's arrays, without the optional arrays that are missing."""
    return [rule for rule in kind.arrays if not rule.optional or rule.name in names]


def check_shapes(kind: Kind, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Check that equal names in the shapes of a kind are equal lengths.

    Raises:
        ArtifactError: a shape is wrong; the message names the array and the length.
    """
    lengths: dict[str, int] = {}
    for rule in present(kind, arrays):
        shape = arrays[rule.name].shape
        if len(shape) != len(rule.shape):
            raise ArtifactError(f"array {rule.name} has {len(shape)} axes, not {len(rule.shape)}")
        for have, want in zip(shape, rule.shape, strict=True):
            if isinstance(want, int):
                if have != want:
                    raise ArtifactError(f"array {rule.name} has shape {list(shape)}, not {list(rule.shape)}")
                continue
            name, plus, extra = want.partition("+")
            length = have - (int(extra) if plus else 0)
            if length < 0 or lengths.setdefault(name, length) != length:
                raise ArtifactError(f"array {rule.name} has shape {list(shape)}: {name} does not agree")


def check_arrays(kind: Kind, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Check the values of all arrays of a kind.

    Args:
        arrays: by name, with the shapes of the kind.

    Raises:
        ArtifactError: a value is wrong; the message names the array, the rule and the first row.
    """
    for rule in present(kind, arrays):
        bad = _first_offence(rule, arrays)
        if bad is not None:
            raise ArtifactError(f"array {rule.name}: {bad}")


def _first_offence(rule: ArrayRule, arrays: Mapping[str, NDArray[Any]]) -> str | None:
    array = arrays[rule.name]
    if array.dtype.kind == "f":
        finite = np.isfinite(array)
        if not finite.all():
            return f"not finite in row {_first_row(~finite)}"
    if rule.largest is not None and not (good := np.abs(array) <= rule.largest).all():
        return f"beyond {rule.largest:g} in row {_first_row(~good)}"
    match rule.rule:
        case "not_negative":
            if not (good := array >= 0).all():
                return f"negative in row {_first_row(~good)}"
        case "positive":
            if not (good := array > 0).all():
                return f"not positive in row {_first_row(~good)}"
        case "unit_interval":
            if not (good := (array >= 0) & (array <= 1)).all():
                return f"outside [0, 1] in row {_first_row(~good)}"
        case "unit_norm":
            for start in range(0, len(array), _ROWS):
                norm = _norm(array[start : start + _ROWS])
                if not (good := np.abs(norm - 1) <= _UNIT_NORM_TOLERANCE).all():
                    return f"not a unit quaternion in row {start + _first_row(~good)}"
        case "starts":
            assert rule.indexes is not None
            total = len(arrays[rule.indexes])
            if len(array) == 0 or array[0] != 0 or array[-1] != total or (np.diff(array) < 0).any():
                return f"does not partition the {total} rows of {rule.indexes}"
        case "knots":
            if len(array) < 2 or array[0] != 0:
                return "does not begin at 0, or has no second knot"
            if not (good := np.diff(array) > 0).all():
                return f"not strictly increasing at row {_first_row(~good) + 1}"
        case "strictly_increasing":
            if not (good := _lexicographically_increasing(array)).all():
                return f"not sorted and unique at row {_first_row(~good) + 1}"
        case _:
            pass
    return None


def _norm(rows: NDArray[Any]) -> NDArray[Any]:
    """Lengths of short rows, computed column by column, which is several times faster than by rows."""
    with np.errstate(over="ignore"):
        square = rows[:, 0] * rows[:, 0]
        for column in rows.T[1:]:
            square += column * column
    length: NDArray[Any] = np.sqrt(square)
    return length


def _lexicographically_increasing(array: NDArray[Any]) -> NDArray[np.bool_]:
    rows = array[:, None] if array.ndim == 1 else array
    before, after = rows[:-1], rows[1:]
    result = np.zeros(max(len(rows) - 1, 0), np.bool_)
    undecided = np.ones_like(result)
    for column in range(rows.shape[1]):
        result |= undecided & (before[:, column] < after[:, column])
        undecided &= before[:, column] == after[:, column]
    return result


def _first_row(mask: NDArray[np.bool_]) -> int:
    return int(np.argwhere(mask)[0][0])
