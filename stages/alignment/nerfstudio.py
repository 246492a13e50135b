"""The frame that nerfstudio trains in, and its transform to the frame of the source poses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from alula.schemas.artifacts.manifest import Similarity
from alula.schemas.decode import MalformedError, decode_plain_json
from alula.schemas.errors import InputError
from alula.stages.alignment.similarity import inverse
from alula.stages.alignment.transforms import checked_similarity

TRANSFORMS = "dataparser_transforms.json"
_ORTHONORMAL = 1e-4


@dataclass(frozen=True, slots=True)
class TrainingFrame:
    """Similarity that nerfstudio applied to the poses before training: p_train = scale (A p_original + b).

    Attributes:
        original_from_training: p_original = A' (p_train / scale - b), the source poses' own frame.
    """

    original_from_training: Similarity
    facts: Mapping[str, Any]
    warnings: tuple[str, ...] = ()


def transform_files(path: Path) -> dict[str, Path]:
    """Find the JSON files of a training run.

    Args:
        path: the run's folder, or `dataparser_transforms.json` itself.

    Returns:
        The files by their role: `nerfstudio`, and `nerfstudio data` when there is a `transforms.json`.

    Raises:
        InputError: there is no `dataparser_transforms.json`.
    """
    found = path / TRANSFORMS if path.is_dir() else path
    if not found.is_file():
        missing = f"has no {TRANSFORMS}" if path.is_dir() else "does not exist"
        raise InputError(f"{path}: {missing}; nerfstudio writes {TRANSFORMS} into the folder of each run")
    files = {"nerfstudio": found}
    if (data := found.parent / "transforms.json").is_file():
        files["nerfstudio data"] = data
    return files


def parse_training_frame(text: str, name: str, data: str | None = None) -> TrainingFrame:
    """Parse `{"transform": 3x4 [A|b], "scale": s}`; A and b include `applied_transform` already.

    Args:
        data: text of the `transforms.json` in the same folder, where there is one.

    Raises:
        InputError: it is not JSON, has another shape, is not finite, A is not a rotation, or the scale is not
            between 1e-9 and 1e9.
    """
    found = _object(text, name)
    try:
        matrix = np.array(found["transform"], np.float64)
        scale = float(found["scale"])
    except KeyError as error:
        raise InputError(f"{name}: has no {error.args[0]!r}") from error
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name}: needs a 3x4 matrix `transform` and a number `scale`") from error
    if matrix.shape == (4, 4) and matrix[3].tolist() == [0.0, 0.0, 0.0, 1.0]:
        matrix = matrix[:3]
    if matrix.shape != (3, 4):
        raise InputError(f"{name}: `transform` must be 3x4")
    if not np.isfinite(matrix).all():
        raise InputError(f"{name}: a value of `transform` is not finite")
    if not (1e-9 <= scale <= 1e9):
        raise InputError(f"{name}: `scale` is {scale:g}, not between 1e-9 and 1e9")
    A, b = matrix[:, :3], matrix[:, 3]
    is_bounded = np.abs(A).max() <= 2  # larger values overflow in the product
    if not is_bounded or np.abs(A @ A.T - np.eye(3)).max() > _ORTHONORMAL or np.linalg.det(A) < 0:
        raise InputError(f"{name}: the first three columns of `transform` are no rotation")
    training_from_original = checked_similarity(scale * A, scale * b, name)
    facts = {"scale": scale, "transform": matrix.tolist()}
    return TrainingFrame(
        inverse(training_from_original), {"nerfstudio": facts}, _data_warnings(data) if data else ()
    )


def _data_warnings(text: str) -> tuple[str, ...]:
    """Warning about a scale that was applied when the data were made, which is not undone consistently."""
    applied = _object(text, "transforms.json").get("applied_scale", 1.0)
    if isinstance(applied, int | float) and applied == 1.0:
        return ()
    return (
        f"transforms.json has applied_scale {applied!r}: nerfstudio rescales its translations "
        "inconsistently, so the frame of the source poses may be shifted",
    )


def _object(text: str, name: str) -> dict[str, Any]:
    try:
        found: Any = decode_plain_json(text.encode())
    except MalformedError as error:
        raise InputError(f"{name}: is not JSON ({error})") from error
    if not isinstance(found, dict):
        raise InputError(f"{name}: is no JSON object")
    return found
