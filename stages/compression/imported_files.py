"""Reading of meshes, clouds and OctoMap files for `import-voxels`."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from alula.schemas.errors import ArtifactError, InputError
from alula.schemas.files import check_no_stream, reading
from alula.stages.alignment.cloud_files import SUFFIXES as CLOUDS
from alula.stages.alignment.cloud_files import points_of, read_cloud
from alula.stages.compression.element_counts import count_elements
from alula.stages.compression.imported import Cloud, ImportedSource, Mesh, Octree
from alula.stages.compression.mesh_gltf import read_glb
from alula.stages.compression.mesh_obj import read_obj
from alula.stages.compression.mesh_ply import read_ply
from alula.stages.compression.mesh_stl import read_stl
from alula.stages.reconstruction.formats.source import Source

MESHES, OCTREES = (".obj", ".stl", ".glb", ".ply"), (".bt", ".ot")
_ELEMENTS = {Mesh: "triangle", Cloud: "point"}
_MAGIC = {
    True: b"# Octomap OcTree binary file",
    False: b"# Octomap OcTree file",
}
_PAYLOAD = {"OcTree": 0, "ColorOcTree": 3}
_HEADER = 2**16  # bytes


def read_imported(path: Path) -> ImportedSource:
    """Read a mesh, a cloud or an octree, by the suffix; a PLY without faces is a cloud.

    The number of triangles or points must be that of `element_counts`, which counts it without the readers.

    Raises:
        InputError: it cannot be read, has nothing in it, or has something that this program cannot mark.
        ArtifactError: it is damaged.
    """
    suffix = path.suffix.lower()
    known = sorted({*MESHES, *OCTREES, *CLOUDS})
    if suffix not in known:
        raise InputError(f"{path}: maps end in {', '.join(known)}, not {suffix!r}")
    check_no_stream(path)
    if suffix == ".npz":
        return Cloud(read_cloud(path))
    with reading(path):
        raw = path.read_bytes()
    try:
        if suffix in OCTREES:
            return octree_of(raw)
        with np.errstate(invalid="ignore"):  # of numbers that are none, refused below
            found = _read(path, raw, suffix)
        elements = found.corners if isinstance(found, Mesh) else found.points
        what = _ELEMENTS[type(found)]
        if len(elements) == 0:
            raise InputError(f"holds no {what}s")
        count = count_elements(raw, suffix)
        if count is not None and count != len(elements):
            raise InputError(
                f"holds {count} {what}s by its bytes, but {len(elements)} were read; please report this file"
            )
        wrong = ~np.isfinite(elements.reshape(len(elements), -1)).all(axis=1)
        if wrong.any():
            part = " has a corner that" if isinstance(found, Mesh) else ""
            raise InputError(f"{what} {np.argmax(wrong)}{part} is not finite")
        return found
    except (ArtifactError, InputError) as error:
        raise error.reworded(f"{path}: {error}") from error


def _read(path: Path, raw: bytes, suffix: str) -> Mesh | Cloud:
    if suffix == ".obj":
        return read_obj(raw)
    if suffix == ".stl":
        return Mesh(read_stl(raw))
    if suffix == ".glb":
        return read_glb(Source(path))
    return read_ply(raw) if suffix == ".ply" else Cloud(points_of(raw, suffix))


def octree_of(raw: bytes) -> Octree:
    """Header and nodes of an OctoMap file; the nodes are decoded, and counted, where they are used.

    Raises:
        ArtifactError: it is damaged.
        InputError: it holds nodes of another kind.
    """
    head, mark, _ = raw[:_HEADER].partition(b"\ndata\n")
    first = head.split(b"\n", 1)[0].strip()
    if not mark or first not in _MAGIC.values():
        raise ArtifactError("is no OctoMap file: it has no header of one")
    fields: dict[str, str] = {}
    for line in head.decode("ascii", "replace").splitlines():
        key, *words = line.split() or ["#"]
        if key.startswith("#"):
            continue
        if key not in ("id", "size", "res") or key in fields or len(words) != 1:
            raise ArtifactError(f"its header has the line {line.strip()[:40]!r}, once too often or not known")
        fields[key] = words[0]
    is_binary = first == _MAGIC[True]
    kind = fields.get("id", "")
    if kind not in _PAYLOAD:
        raise InputError(f"holds an {kind[:40]!r}; only {' and '.join(_PAYLOAD)} can be read")
    try:
        text, nodes = fields["res"], int(fields["size"])
        if not (1e-9 < float(text) < 1e9 and nodes >= 0):  # also refuses an exponent that would take forever
            raise ValueError
        if "_" in text + fields["size"]:  # Python's own digits
            raise ValueError
        edge = Fraction(text)
    except (KeyError, ValueError) as error:
        raise ArtifactError("its header has no usable resolution and size") from error
    body: NDArray[np.uint8] = np.frombuffer(raw, np.uint8)[len(head) + len(mark) :]
    return Octree(np.ascontiguousarray(body), is_binary, 0 if is_binary else _PAYLOAD[kind], nodes, edge)
