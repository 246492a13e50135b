"""Binary glTF: triangles, strips and fans at the nodes of the scene."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from fractions import Fraction
from typing import Any

import numpy as np

from alula.schemas.arrays import FloatArray, IntArray
from alula.schemas.errors import ArtifactError, InputError
from alula.stages.compression.imported import Mesh
from alula.stages.compression.polygons import check_indices, fan, loose_points, strip
from alula.stages.reconstruction.formats.gltf_accessors import FLOAT, Document, Node, Primitive, Tables, item
from alula.stages.reconstruction.formats.gltf_nodes import local_matrix, roots_of
from alula.stages.reconstruction.formats.source import Source

Matrix = list[list[Fraction]]  # the upper three rows of an affine map

_MODES = ("points", "lines", "a line loop", "a line strip", "triangles", "a triangle strip", "a triangle fan")
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_POSITION = (FLOAT, "i8", "i8n", "u8", "u8n", "i16", "i16n", "u16", "u16n")
_NO_SHAPES = re.compile(  # extensions that leave every triangle where it is
    r"[A-Z]+_(materials|texture|lights|xmp|audio|image)\w*"
    r"|KHR_(mesh_quantization|node_visibility)|EXT_(mesh_features|structural_metadata)|FB_ngon_encoding"
)
_PIECE = 26  # bits of a factor, whose products with single precision are exact
_KEPT = 192  # bits of a factor
_IDENTITY: Matrix = [[Fraction(int(i == k)) for k in range(4)] for i in range(3)]


def read_glb(source: Source) -> Mesh:
    """Read the triangles of a binary glTF file, in its scene's frame with y up.

    Transforms are composed in rational numbers, and each coordinate is rounded once. A node that mirrors
    turns its triangles, as the standard says. All numbers are read as their accessors define them: sparse,
    normalised, and of any type that KHR_mesh_quantization allows.

    Raises:
        ArtifactError: the file is damaged.
        InputError: the file has shapes or extensions that are not triangles at nodes.
    """
    if source.head[:4] != b"glTF":
        raise InputError("is no binary glTF: it does not begin like one")
    tables = Tables(source)
    document = tables.document
    if tables.notes:
        raise ArtifactError(f"glTF: {tables.notes[0]}")
    _check(document, tables)
    corners: list[FloatArray] = []
    loose, met = 0, set[tuple[int, int]]()
    for mesh, matrix in _placed(document):
        for number, primitive in enumerate(item(document.meshes, mesh, "mesh").primitives):
            what = f"mesh {mesh}, primitive {number}"
            index, points = _triangles(tables, primitive, what)
            if (mesh, number) not in met:
                met.add((mesh, number))
                loose += loose_points(index, len(points))
            with np.errstate(over="ignore", invalid="ignore"):  # values that are not finite are refused later
                moved = _moved(*_pieces(tables, primitive, matrix), points)
            corners.append(moved[_facing(index, matrix)])
    return Mesh(np.concatenate(corners) if corners else np.empty((0, 3, 3)), "y", loose=loose)


def _check(document: Document, tables: Tables) -> None:
    """Refuse by name what would be left out."""
    try:
        tree: dict[str, Any] = json.loads(tables.text, object_pairs_hook=_object)
        names = {str(name) for name in (*tree.get("extensionsUsed", []), *document.extensions_required)}
        names |= set(_extensions(tree))
    except (ValueError, TypeError, RecursionError) as error:
        raise ArtifactError(f"glTF: JSON: {str(error)[:100]}") from error
    for name in sorted(names):
        if not _NO_SHAPES.fullmatch(name):
            raise InputError(f"uses {name[:100]}, which is not supported; export plain triangles")
    if tree.get("skins") or tree.get("animations"):
        raise InputError("is animated; export one pose without skins and animations")
    for number, buffer in enumerate(document.buffers):
        if buffer.uri is not None and tables.external(number) is not None:
            raise InputError(f"buffer {number} is another file; pack all buffers into the .glb")
    for number, mesh in enumerate(document.meshes):
        if not mesh.primitives:
            raise ArtifactError(f"glTF: mesh {number} has no primitives")
        for primitive in mesh.primitives:
            if primitive.mode not in (_TRIANGLES, _STRIP, _FAN):
                name = _MODES[primitive.mode] if primitive.mode < len(_MODES) else f"mode {primitive.mode}"
                raise InputError(f"mesh {number} has {name}, and only triangles can be marked")
            if primitive.targets:
                raise InputError(f"mesh {number} has morph targets; export one shape without them")


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object of JSON whose names differ; of equal ones each reader takes another."""
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError(f"an object has a name twice, among {', '.join(found)}")
    return found


def _extensions(tree: Any) -> Iterator[str]:
    """Names of all extensions that any object of the file has."""
    if isinstance(tree, dict):
        found = tree.get("extensions")
        if isinstance(found, dict):
            yield from found
        for value in tree.values():
            yield from _extensions(value)
    elif isinstance(tree, list):
        for value in tree:
            yield from _extensions(value)


def _placed(document: Document) -> Iterator[tuple[int, Matrix]]:
    """Meshes of the scene with their global matrices; refuses those outside of the scene."""
    reached: set[int] = set()
    stack = [(index, _IDENTITY) for index in reversed(roots_of(document, []))]
    while stack:
        index, above = stack.pop()
        node = item(document.nodes, index, "node")
        if index in reached:
            raise ArtifactError(f"glTF: node {index} is reached twice: nodes must be a tree")
        reached.add(index)
        matrix = _times(above, _local(node, index))
        stack += [(child, matrix) for child in reversed(node.children)]
        if node.skin is not None:
            raise InputError(f"node {index} has a skin; export one pose without skins")
        if node.mesh is not None:
            yield node.mesh, matrix
    for index, node in enumerate(document.nodes):
        if node.mesh is not None and index not in reached:
            raise InputError(
                f"node {index} has a mesh, but is not in the default scene, so it would be missed"
            )
    for number in set(range(len(document.meshes))) - {node.mesh for node in document.nodes}:
        raise InputError(f"mesh {number} is at no node, so it would be missed")


def _local(node: Node, index: int) -> Matrix:
    """Matrix of a node without rounding."""
    _, is_identity = local_matrix(node, index)
    if is_identity:
        return _IDENTITY
    if node.matrix is not None:
        columns = [[Fraction(v) for v in node.matrix[4 * k : 4 * k + 4]] for k in range(4)]
        if [column[3] for column in columns] != [0, 0, 0, 1]:
            raise ArtifactError(f"glTF: node {index}: its matrix is not affine")
        return [[columns[k][i] for k in range(4)] for i in range(3)]
    x, y, z, w = (Fraction(v) for v in node.rotation or (0.0, 0.0, 0.0, 1.0))
    n = x * x + y * y + z * z + w * w
    turned = [
        [1 - 2 * (y * y + z * z) / n, 2 * (x * y - w * z) / n, 2 * (x * z + w * y) / n],
        [2 * (x * y + w * z) / n, 1 - 2 * (x * x + z * z) / n, 2 * (y * z - w * x) / n],
        [2 * (x * z - w * y) / n, 2 * (y * z + w * x) / n, 1 - 2 * (x * x + y * y) / n],
    ]
    scale = [Fraction(v) for v in node.scale or (1.0, 1.0, 1.0)]
    shift = [Fraction(v) for v in node.translation or (0.0, 0.0, 0.0)]
    return [[*(a * b for a, b in zip(turned[i], scale, strict=True)), shift[i]] for i in range(3)]


def _times(one: Matrix, other: Matrix) -> Matrix:
    if one == _IDENTITY or other == _IDENTITY:
        return other if one == _IDENTITY else one
    return [
        [_short(sum((row[j] * other[j][k] for j in range(3)), row[3] * (k == 3))) for k in range(4)]
        for row in one
    ]


def _short(value: Fraction) -> Fraction:
    """The value to 2^-192 of itself, so that deep trees of nodes need no long numbers."""
    if value.denominator.bit_length() <= _KEPT:
        return value
    shift = _KEPT + value.denominator.bit_length() - value.numerator.bit_length()
    return Fraction(round(value * Fraction(2) ** shift)) / Fraction(2) ** shift


def _triangles(tables: Tables, primitive: Primitive, what: str) -> tuple[IntArray, FloatArray]:
    """Corners of the triangles, shape (T, 3), and the stored positions, shape (V, 3)."""
    if "POSITION" not in primitive.attributes:
        raise InputError(f"{what} has no POSITION, so its triangles would be missed")
    points = tables.column(primitive.attributes["POSITION"], f"POSITION of {what}", ("VEC3",), _POSITION)
    if primitive.indices is None:
        index = np.arange(len(points.stored))
    else:
        column = tables.column(primitive.indices, f"indices of {what}", ("SCALAR",), ("u8", "u16", "u32"))
        index = column.stored[:, 0].astype(np.int64)
    check_indices(index, len(points.stored))
    stored = points.stored.astype(np.float64)
    if primitive.mode == _TRIANGLES:
        if len(index) % 3:
            raise ArtifactError(f"glTF: {what} has {len(index)} corners, and triangles have 3 each")
        return index.reshape(-1, 3), stored
    if len(index) < 3:
        raise ArtifactError(f"glTF: {what} has {len(index)} corners, and a strip or fan has 3 at least")
    return (strip if primitive.mode == _STRIP else fan)(index), stored


def _facing(index: IntArray, matrix: Matrix) -> IntArray:
    """Turn the triangles of a node that mirrors."""
    (a, b, c, _), (d, e, f, _), (g, h, i, _) = matrix
    mirrors = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) < 0
    return index[:, ::-1] if mirrors else index


def _pieces(tables: Tables, primitive: Primitive, matrix: Matrix) -> tuple[Matrix, float]:
    """The matrix for the stored numbers, and the smallest of them that counts."""
    accessor = tables.document.accessors[primitive.attributes["POSITION"]]
    if not accessor.normalized or accessor.component_type == 5126:
        return matrix, -np.inf
    bits = {5120: 7, 5121: 8, 5122: 15, 5123: 16}[accessor.component_type]
    largest = 2**bits - 1
    return [[*(v / largest for v in row[:3]), row[3]] for row in matrix], float(-largest)


def _moved(matrix: Matrix, lowest: float, stored: FloatArray) -> FloatArray:
    """Apply an affine map to numbers of at most 24 bits, with one rounding for each coordinate.

    Each factor is split into pieces of 26 bits, so that the products are exact, and sums carry their errors:
    the result differs from the exact one by 2^-52 of itself and 2^-75 of the largest product.
    """
    points = np.maximum(stored, lowest)
    if matrix == _IDENTITY:
        return points
    if not np.isfinite(points).all():
        return points
    columns = []
    for row in matrix:
        parts = [points[:, k] * piece for k in range(3) for piece in _split(row[k])]
        parts += [np.full(len(points), piece) for piece in _split(row[3])]
        total, errors = np.zeros(len(points)), np.zeros(len(points))
        for part in parts:
            new = total + part
            back = new - total
            errors += (total - (new - back)) + (part - back)
            total = new
        columns.append(total + errors)
    return np.stack(columns, axis=1)


def _split(value: Fraction) -> list[float]:
    """Four numbers of at most 26 bits whose sum is the value, to 2^-100 of it."""
    found = []
    for _ in range(4):
        if value == 0:
            break
        exponent = value.numerator.bit_length() - value.denominator.bit_length()
        unit = Fraction(2) ** (exponent - _PIECE + 2)
        piece = Fraction(round(value / unit)) * unit
        try:
            found.append(float(piece))
        except OverflowError:
            raise InputError("a node moves its mesh beyond the range of double precision") from None
        value -= piece
    return found
