"""Other readers of splat formats, differences of ours from them, and large files to time both."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from measure import FloatArray
from numpy.typing import NDArray
from peers import write_inria_ply
from tools import Silence

from alula.stages.reconstruction.formats.ply import encode_ply
from alula.stages.reconstruction.formats.registry import read_splats
from alula.stages.reconstruction.formats.splat import RECORD
from alula.stages.reconstruction.formats.splats import Splats, sh0_from_color
from alula.stages.reconstruction.import_splat import turned

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))  # splat_files

KINDS = ("mean", "scale", "rotation", "opacity")
EXACT = {"mean": 0.0, "scale": 1e-6, "rotation": 1e-6, "opacity": 1e-6}
CLOSE = {"mean": 1e-5, "scale": 1e-5, "rotation": 1e-3, "opacity": 1e-5}  # other roundings of the same codes

Values = tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]]  # mean, scale, quat_wxyz, opacity


@dataclass(frozen=True, slots=True)
class Oracle:
    """Another reader.

    Attributes:
        name: of the package that must be installed.
        load: the timed function; its result has the reader's own form.
        values: converts that result to means, linear scales, quaternions and opacities.
        tolerance: maximum difference by kind of value; see `differences`.
    """

    name: str
    load: Callable[[Path], Any]
    values: Callable[[Any], Values]
    tolerance: dict[str, float]

    @property
    def is_there(self) -> bool:
        """Return whether its package can be imported."""
        try:
            with Silence():
                import_module(self.name)
        except ImportError:
            return False
        return True


def _gsply(function: str) -> Callable[[Path], Any]:
    def load(path: Path) -> Any:
        with Silence():  # its compiler warns
            return getattr(import_module("gsply"), function)(str(path))

    return load


def _of_gsply(loaded: Any) -> Values:
    logit = np.asarray(loaded.opacities, np.float64).ravel()
    with np.errstate(over="ignore"):
        opacity = 1 / (1 + np.exp(-logit))
        return loaded.means, np.exp(np.asarray(loaded.scales, np.float64)), loaded.quats, opacity


def _open3d(path: Path) -> Any:
    with Silence():  # it prints on stdout and returns an empty cloud when it cannot read
        return import_module("open3d").t.io.read_point_cloud(str(path)).point


def _of_open3d(point: Any) -> Values:
    if "rot" not in point or "f_dc" not in point:  # without colours it leaves the scales logarithms
        raise ValueError("it read no Gaussians")
    mean, scale, quat, logit = (
        point[name].numpy().astype(np.float64) for name in ("positions", "scale", "rot", "opacity")
    )
    with np.errstate(over="ignore"):
        return mean, scale, quat, 1 / (1 + np.exp(-logit.ravel()))


# By format; a format without an oracle is compared only with reading its bytes.
ORACLES: dict[str, tuple[Oracle, ...]] = {
    "ply": (
        Oracle("gsply", _gsply("plyread"), _of_gsply, EXACT),
        Oracle("open3d", _open3d, _of_open3d, EXACT),
    ),
    "compressed-ply": (Oracle("gsply", _gsply("plyread"), _of_gsply, CLOSE),),
    "spz": (Oracle("gsply", _gsply("read_spz"), _of_gsply, CLOSE),),
    "splat": (Oracle("open3d", _open3d, _of_open3d, CLOSE | {"rotation": 0.04}),),  # middle 128
}


def differences(ours: Splats, theirs: Values) -> tuple[dict[str, float], str]:
    """Maximum difference of each kind, and the axis of the half turn between the frames, or `none`.

    Means are compared relative to the largest one, scales relatively, rotations by the angle
    [rad], opacities absolutely. Rows that are not finite on both sides are left out.

    Raises:
        ValueError: the numbers of rows differ, or ours applied a property that other readers do not know.
    """
    if ours.properties.applied:
        raise ValueError(f"it does not know what ours applied: {'; '.join(ours.properties.applied)}")
    mean, scale, quat, opacity = (np.asarray(values, np.float64) for values in theirs)
    if len(mean) != len(ours):
        raise ValueError(f"it read {len(mean)} rows, not {len(ours)}")
    other = replace(ours, mean=mean, scale=scale, quat_wxyz=quat, opacity=opacity)
    found = {axis: _largest(turned(ours, axis), other) for axis in ("none", "x", "y", "z")}
    turn = min(found, key=lambda axis: (found[axis]["mean"], found[axis]["rotation"]))
    return found[turn], turn


def _largest(ours: Splats, theirs: Splats) -> dict[str, float]:
    with np.errstate(all="ignore"):
        by_row = {
            "mean": np.abs(ours.mean - theirs.mean).max(axis=1)
            / np.nanmax(np.abs(theirs.mean), initial=1e-30),
            "scale": np.abs(ours.scale / np.maximum(theirs.scale, 1e-30) - 1).max(axis=1),
            "rotation": _angle(ours.quat_wxyz, theirs.quat_wxyz),
            "opacity": np.abs(ours.opacity - theirs.opacity),
        }
    finite = np.logical_and.reduce([np.isfinite(values) for values in by_row.values()])
    return {kind: float(values[finite].max(initial=0.0)) for kind, values in by_row.items()}


def _angle(a: NDArray[Any], b: NDArray[Any]) -> FloatArray:
    """Angle of the rotation between two quaternions [rad]; exact where it is small."""
    a, b = (
        q.astype(np.float64) / np.linalg.norm(q.astype(np.float64), axis=1, keepdims=True) for q in (a, b)
    )
    chord = np.minimum(np.linalg.norm(a - b, axis=1), np.linalg.norm(a + b, axis=1))
    angle: FloatArray = 4 * np.arcsin(np.minimum(chord / 2, 1.0))
    return angle


def _plain_ply(path: Path, splats: Splats) -> None:
    with path.open("wb") as file:
        file.writelines(encode_ply(splats))


def _splat(path: Path, splats: Splats) -> None:
    rows = np.zeros(len(splats), RECORD)
    rows["mean"], rows["scale"] = splats.mean, splats.scale
    length = np.linalg.norm(splats.quat_wxyz, axis=1, keepdims=True)
    rows["quat"] = np.clip(np.rint(splats.quat_wxyz / length * 128 + 128), 0, 255)
    rows["rgba"][:, :3], rows["rgba"][:, 3] = splats.color, np.rint(splats.opacity * 255)
    rows.tofile(path)


def _by_gsply(function: str, **options: Any) -> Callable[[Path, Splats], None]:
    def make(path: Path, splats: Splats) -> None:
        gsply = import_module("gsply")
        plain = path.with_suffix(".plain.ply")
        _plain_ply(plain, splats)
        with Silence():
            getattr(gsply, function)(str(path), gsply.plyread(str(plain)), **options)
        plain.unlink()

    return make


def _by_tests(encoder: str) -> Callable[[Path, Splats], None]:
    """Write a file with the tests' encoder; a format of several files becomes a folder of that name."""

    def make(path: Path, splats: Splats) -> None:
        files = import_module("support.files.splat_files")
        length = np.linalg.norm(splats.quat_wxyz, axis=1, keepdims=True)
        gaussians = files.Gaussians(
            *(np.asarray(a, np.float64) for a in (splats.mean, splats.scale, splats.quat_wxyz / length)),
            np.clip(splats.opacity.astype(np.float64), 1e-4, 1 - 1e-4),
            sh0_from_color(splats.color).astype(np.float64),
        )
        made = files.ENCODERS[encoder][1](gaussians)
        for name, raw in made.items():
            member = path if len(made) == 1 else path / name
            member.parent.mkdir(parents=True, exist_ok=True)
            member.write_bytes(raw)

    return make


@dataclass(frozen=True, slots=True)
class Large:
    """A generated file or folder to be timed, with `percent` of the requested number of Gaussians."""

    format: str
    label: str
    name: str
    make: Callable[[Path, Splats], None]
    percent: int = 100


LARGE = (
    Large("ply", "degree 3, 248 bytes a row", "three.ply", write_inria_ply),
    Large("ply", "degree 0, 68 bytes a row", "zero.ply", _plain_ply),
    Large("splat", "32 bytes a row", "made.splat", _splat),
    Large("compressed-ply", "by gsply", "made.compressed.ply", _by_gsply("plywrite", compressed=True), 20),
    Large("spz", "by gsply", "made.spz", _by_gsply("write_spz"), 20),
    Large("spz", "version 4", "four.spz", _by_tests("spz 4"), 20),
    Large("sog", "version 2", "made.sog", _by_tests("sog"), 5),
    Large("ksplat", "level 1", "made.ksplat", _by_tests("ksplat 1"), 20),
    Large("gltf", "GLB, single precision", "made.glb", _by_tests("glb"), 20),
    Large("nerfstudio", "folder", "made-run", _by_tests("nerfstudio"), 20),
    Large("json", "logarithms", "made.json", _by_tests("json"), 5),
)


@contextmanager
def large_file(large: Large, folder: Path, splats: Splats) -> Iterator[Path | None]:
    """Yield the file and delete it afterwards; None when its writer is missing or cannot write it."""
    path = folder / large.name
    try:
        large.make(path, splats)
        yield path if path.exists() and len(read_splats(path)) == len(splats) else None
    except ImportError:
        yield None
    finally:
        if path.is_dir():
            shutil.rmtree(path)
        path.unlink(missing_ok=True)
