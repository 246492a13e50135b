"""Reading of meshes, clouds and OctoMap files for `import-voxels`."""

from __future__ import annotations

import json
import re
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.errors import ArtifactError, InputError
from alula.schemas.files import check_no_stream
from alula.stages.alignment.cloud_counts import check_cloud
from alula.stages.alignment.cloud_files import SUFFIXES as CLOUDS
from alula.stages.alignment.cloud_files import read_cloud
from alula.stages.compression.imported import Cloud, ImportedSource, Mesh, Octree

MESHES, OCTREES = (".obj", ".stl", ".glb", ".ply"), (".bt", ".ot")
_TRIANGLES = 4  # mode of glTF's primitives
_KNOWN_EXTENSIONS = re.compile(r"KHR_(materials|texture|lights|xmp|node_visibility)|KHR_mesh_quantization")
_MAGIC = {
    True: b"# Octomap OcTree binary file",
    False: b"# Octomap OcTree file",
}
_PAYLOAD = {"OcTree": 0, "ColorOcTree": 3}
_HEADER = 2**16  # bytes


def read_imported(path: Path) -> ImportedSource:
    """Read a mesh, a cloud or an octree, by the suffix; a PLY without faces is a cloud.

    Args:
        path: the file.

    Raises:
        InputError: it cannot be read, has nothing in it, or has something that this program cannot mark.
        ArtifactError: it is damaged.
        UsageError: the package that reads it is not installed.
    """
    suffix = path.suffix.lower()
    known = sorted({*MESHES, *OCTREES, *CLOUDS})
    if suffix not in known:
        raise InputError(f"{path}: maps end in {', '.join(known)}, not {suffix!r}")
    check_no_stream(path)
    try:
        with path.open("rb") as file:
            head = file.read(_HEADER)
    except OSError as error:
        raise InputError(f"{path}: cannot read: {error.strerror or error}") from error
    if suffix in OCTREES:
        return _octree(path)
    if suffix == ".ply" and _is_cloud(head):
        return _ply_cloud(path)
    return _mesh(path, suffix) if suffix in MESHES else Cloud(read_cloud(path))


def _is_cloud(head: bytes) -> bool:
    found = re.search(rb"^element face (\d+)", head.partition(b"end_header")[0], re.MULTILINE)
    return found is None or int(found[1]) == 0


def _ply_cloud(path: Path) -> Cloud:
    """Read points with trimesh, so that the most common format needs no extra."""
    import trimesh

    check_cloud(path)
    try:
        loaded = trimesh.load(path, process=False)
        points = np.asarray(loaded.vertices, np.float64).reshape(-1, 3)
    except Exception as error:
        words = (str(error) or repr(error)).splitlines()[0][:200]
        raise InputError(f"{path}: is no readable cloud: {words}") from error
    if len(points) == 0:
        raise InputError(f"{path}: holds no points")
    if not np.isfinite(points).all():
        row = int(np.argwhere(~np.isfinite(points))[0][0])
        raise InputError(f"{path}: point {row} is not finite")
    return Cloud(points)


def _mesh(path: Path, suffix: str) -> Mesh:
    import trimesh

    if suffix == ".obj":
        _check_obj(path)
    if suffix == ".glb":
        _check_glb(path)
    try:
        loaded = trimesh.load_scene(
            path, process=False, **({"skip_materials": True} if suffix == ".obj" else {})
        )
        shapes = loaded.dump()
    except Exception as error:
        raise InputError(
            f"{path}: is no readable mesh: {(str(error) or repr(error)).splitlines()[0][:200]}"
        ) from error
    if other := [type(shape).__name__ for shape in shapes if not isinstance(shape, trimesh.Trimesh)]:
        raise InputError(f"{path}: holds a {other[0]}, and only triangles can be marked")
    corners = [np.asarray(shape.vertices, np.float64)[np.asarray(shape.faces)] for shape in shapes]
    found = np.concatenate(corners) if corners else np.empty((0, 3, 3))
    if len(found) == 0:
        raise InputError(f"{path}: holds no triangles")
    if not np.isfinite(found).all():
        row = int(np.argwhere(~np.isfinite(found))[0][0])
        raise InputError(f"{path}: triangle {row} has a corner that is not finite")
    return Mesh(np.ascontiguousarray(found), "y" if suffix == ".glb" else "z")


def _check_obj(path: Path) -> None:
    """Refuse shapes that the reader would skip in silence."""
    found = re.search(rb"^\s*(surf|curv2?|l|p) ", path.read_bytes(), re.MULTILINE)
    if found:
        raise InputError(f"{path}: has elements {found[1].decode()!r}, and only faces can be marked")


def _check_glb(path: Path) -> None:
    """Refuse what the reader would skip: shapes that are compressed, instanced, or no triangles."""
    raw = path.read_bytes()
    try:
        if raw[:4] != b"glTF" or raw[16:20] != b"JSON":
            raise ValueError("it does not begin like a .glb")
        tree: Any = json.loads(raw[20 : 20 + int.from_bytes(raw[12:16], "little")])
        needed = [*tree.get("extensionsRequired", [])]
        needed += [name for name in tree.get("extensionsUsed", []) if "instancing" in name]
        modes = {p.get("mode", _TRIANGLES) for mesh in tree.get("meshes", []) for p in mesh["primitives"]}
    except (ValueError, TypeError, AttributeError, KeyError, RecursionError) as error:
        raise InputError(f"{path}: is no readable mesh: {str(error)[:200]}") from error
    if unknown := [name for name in needed if not _KNOWN_EXTENSIONS.match(str(name))]:
        raise InputError(f"{path}: requires {str(unknown[0])[:100]}, which is not supported")
    if modes - {_TRIANGLES}:
        raise InputError(f"{path}: holds shapes that are no lists of triangles, and only these can be marked")
    if tree.get("skins") or tree.get("animations"):
        raise InputError(f"{path}: is animated; export one pose without skins and animations")


def _octree(path: Path) -> Octree:
    raw = path.read_bytes()
    head, mark, _ = raw[:_HEADER].partition(b"\ndata\n")
    first = head.split(b"\n", 1)[0].strip()
    if not mark or first not in _MAGIC.values():
        raise ArtifactError(f"{path}: is no OctoMap file: it has no header of one")
    fields: dict[str, str] = {}
    for line in head.decode("ascii", "replace").splitlines():
        key, _, value = line.strip().partition(" ")
        if key and not key.startswith("#"):
            fields[key] = value.strip()
    is_binary = first == _MAGIC[True]
    kind = fields.get("id", "")
    if kind not in _PAYLOAD:
        raise InputError(f"{path}: holds an {kind[:40]!r}; only {' and '.join(_PAYLOAD)} can be read")
    try:
        text, nodes = fields["res"], int(fields["size"])
        if not (1e-9 < float(text) < 1e9 and nodes >= 0):  # also refuses an exponent that would take forever
            raise ValueError
        edge = Fraction(text)
    except (KeyError, ValueError) as error:
        raise ArtifactError(f"{path}: its header has no usable resolution and size") from error
    body: NDArray[np.uint8] = np.frombuffer(raw, np.uint8)[len(head) + len(mark) :]
    return Octree(np.ascontiguousarray(body), is_binary, 0 if is_binary else _PAYLOAD[kind], nodes, edge)
